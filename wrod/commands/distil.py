"""`wrod distil`: from optimised plans of random patterns to a network that corrects plans."""

from pathlib import Path

import click

from wrod import cost
from wrod.machine import printed_as_json


@click.command(name="distil", short_help="Train a network that corrects plans for a table.")
@click.option(
    "--size", type=click.IntRange(min=1), required=True, help="Optimised plans to learn from."
)
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--steps", type=click.IntRange(min=1), default=500, show_default=True)
@click.option("--device", default="cpu", show_default=True, help="cpu, cuda:0 or auto.")
@cost.force_option
@click.option("--json", "as_json", is_flag=True, help="Print figures for machines.")
def command(
    size: int, out: Path, seed: int, steps: int, device: str, force: bool, as_json: bool
) -> None:
    """Optimise plans of random patterns for random tables, and train a network on them.

    `wrod plan --friction 0.3 --method distilled` asks the network instead of optimising. Plans are
    kept in OUT/plans: the same command goes on where a killed one was. Every process that torchrun
    starts takes its share of them, and the same command without it trains on all. A GPU optimises
    64 at a time.

    \b
      torchrun --nproc-per-node 32 --no-python wrod distil --size 400 --out DIR
    """
    from wrod.training.dataset import Rank
    from wrod.training.plans import generate, load

    rank = Rank.from_environment()
    cost.settle(
        cost.Cost(cost.CORRECTED_PLAN * size / rank.count, 1e9, 3e4 * size),
        f"{size} optimised plans", out, "ask for fewer", force=force, quiet=as_json,
    )  # fmt: skip
    with cost.progress_bar(
        unit="plan", desc="plans", position=rank.local_index, total=-(-size // rank.count),
        quiet=as_json,
    ) as bar:  # fmt: skip
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
        from wrod.training.distil import distil

        with cost.progress_bar(unit="step", desc="steps", total=steps, quiet=as_json) as bar:
            corrector = distil(
                load(out / "plans"), steps=steps, seed=seed, progress=lambda: bar.update(1)
            )
        path = corrector.save(out / "corrections.safetensors")
        figures |= corrector.metadata | {"plans": good}
        figures["written"].append(str(path))
    if printed_as_json(figures, as_json):
        return
    click.echo(f"plans {good}, {bad} patterns could not be laid")
    if rank.count == 1:
        click.echo(
            f"{figures['held_out']} plans held out err by {figures['static']:.3f} L_gb without "
            f"corrections, {figures['error']:.3f} by the network's, {figures['optimised']:.3f} by "
            "their own"
        )
    for one in figures["written"]:
        click.echo(f"wrote {one}")
