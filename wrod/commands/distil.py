"""`wrod distil`: from optimised plans of random patterns to a network that corrects plans."""

from pathlib import Path

import click

from wrod import cost
from wrod.options import FOLDER, option, own_options
from wrod.telling import json_option, tell

# What laying a rod once takes of the time of a plan, in which it is laid five times.
_LAID_ONCE = 0.2


@click.command(name="distil", short_help="Train a network that corrects plans for a table.")
@own_options
@cost.force_option
@json_option
def command(
    size: int = option("Optimised plans to learn from.", required=True),
    out: Path = option(None, type=FOLDER, required=True),
    seed: int = option(None, default=0),
    steps: int = option("Of each training.", default=3000),
    rounds: int = option(
        "Times that a network lays all patterns, and the next learns from that.", default=2
    ),
    device: str = option("cpu, cuda:0 or auto.", default="cpu"),
) -> None:
    """Optimise plans of random patterns for random tables, and train a network on them.

    `wrod plan --friction 0.3 --method distilled` asks the network instead of optimising. It learns
    what would lie, by models of the errors near corrections that were tried; so its own are tried
    on all patterns, and a network is trained anew, for some rounds. Plans are kept in OUT/plans:
    the same command goes on where a killed one was. Every process that torchrun starts optimises
    its share of them, and the same command without it trains on all. A GPU works on 64 at a time.

    \b
      torchrun --nproc-per-node 32 --no-python wrod distil --size 400 --out DIR
    """
    from wrod.rods.device import resolve_device
    from wrod.training.dataset import Rank
    from wrod.training.plans import generate

    device = resolve_device(device)  # refused before anything is computed
    rank = Rank.from_environment()
    visits = 0 if rank.count > 1 else rounds
    work = cost.CORRECTED_PLAN * size / rank.count * (1.0 + _LAID_ONCE * visits)
    cost.settle(cost.Cost(work, 1e9, 3e4 * size), f"{size} optimised plans", "ask for fewer")
    with cost.progress_bar(
        unit="plan", desc="plans", position=rank.local_index, total=-(-size // rank.count)
    ) as bar:
        good, bad = generate(
            out / "plans",
            size,
            seed=seed,
            rank=rank,
            device=device,
            progress=lambda: bar.update(1),
        )
    figures: dict = {"plans": good, "not_laid": bad, "written": [str(out / "plans")]}
    if rank.count == 1:
        corrector = _trained(out / "plans", size, seed, steps, rounds, device)
        path = corrector.save(out / "corrections.safetensors")
        figures |= corrector.metadata | {"plans": good}
        figures["written"].append(str(path))
    lines = [f"plans {good}, {bad} patterns could not be laid"]
    if rank.count == 1:
        before = figures["before"]
        laid = "" if before is None else f", {before:.3f} where the network before laid them"
        lines.append(
            f"{figures['held_out']} plans held out err by {figures['static']:.3f} L_gb without "
            f"corrections, {figures['error']:.3f} by the network's as far as their models tell"
            f"{laid}, {figures['optimised']:.3f} by their own"
        )
    tell(figures, *lines)


def _trained(plans: Path, size: int, seed: int, steps: int, rounds: int, device: str):
    """The last of the networks, each of which learns from what the one before laid, too."""
    from wrod.training.distil import distil
    from wrod.training.plan_files import load
    from wrod.training.plans import visit_all

    for k in range(1, rounds + 2):
        samples = load(plans)
        with cost.progress_bar(unit="step", desc="steps", total=steps) as bar:
            corrector = distil(samples, steps=steps, seed=seed, progress=lambda: bar.update(1))
        if k <= rounds:
            with cost.progress_bar(unit="plan", desc="laid", total=size) as bar:
                visit_all(
                    plans, size, corrector, k, seed=seed, device=device,
                    progress=lambda: bar.update(1),
                )  # fmt: skip
    return corrector
