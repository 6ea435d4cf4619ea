"""`wrod dataset`: optimal grasps over the whole range, in shards."""

import json
from pathlib import Path

import click

from wrod import cost
from wrod.commands.options import CLOSURE, DEVICE, ROLL, RodOptions
from wrod.machine import machine_line
from wrod.options import FOLDER, gathered, option, own_options, refuse_idle_options
from wrod.telling import asked, json_option, tell


@click.command(name="dataset", short_help="Solve grasps to train a controller with.")
@own_options
@CLOSURE
@gathered("rod_options", RodOptions)
@DEVICE
@cost.force_option
@json_option
def command(
    closure: str,
    rod_options: RodOptions,
    device: str,
    size: int = option("Number of samples.", required=True),
    out: Path = option(None, type=FOLDER, required=True),
    seed: int = option(None, default=0),
    sensitivities: bool = option(
        "Store the derivatives by the inputs (zero_tension only).",
        "--sensitivities/--no-sensitivities",
        default=True,
    ),
    roll_text: str | None = option(ROLL, "--roll"),
    shard_size: int | None = option("Samples per file; default 2048."),
) -> None:
    """Solve grasps at low-discrepancy samples of (l_s, kappa, k_s), or of one rod alone.

    Grasps of one naturally curved rod, such as the model.json of `wrod identify`, are what `wrod
    train` makes a controller for that rod from.

    The same command goes on where a killed one was. Every process that torchrun starts takes its
    share of the shards, and a GPU of its own where there are several; the dataset stays the same:

    \b
      torchrun --nproc-per-node 4 --no-python wrod dataset --size 1000000 --out DIR
    """
    from wrod.planning.roll import read_roll
    from wrod.training.dataset import SHARD_SIZE, Rank, generate
    from wrod.training.store import row_bytes

    if sensitivities and closure != "zero_tension":
        refuse_idle_options(f"--closure {closure}", "sensitivities")
    rod = rod_options.read() if rod_options.given else None
    roll = read_roll(roll_text, rod)
    rank = Rank.from_environment()
    label = "grasps" if rank.count == 1 else f"grasps of rank {rank.index}"
    shard_size = shard_size or SHARD_SIZE
    cost.settle(
        cost.grasps(
            size, row_bytes(sensitivities), min(shard_size, size), sensitivities=sensitivities,
            device=rank.device(device), ranks=rank.count,
        ),
        f"{size} grasps", "ask for fewer, or for a smaller --shard-size",
    )  # fmt: skip
    with cost.progress_bar(
        unit="grasp", desc=label, position=rank.local_index, total=size // rank.count
    ) as bar:
        outcome = generate(
            out, size, seed=seed, closure=closure, sensitivities=sensitivities,
            shard_size=shard_size, rod=rod, device=device, rank=rank,
            roll="plane" if roll is None else roll, progress=cost.counting(bar),
        )  # fmt: skip
    figures = {
        "samples": outcome.samples,
        "solved_now": outcome.solved,
        "unconverged": outcome.unconverged,
        "unstable": outcome.unstable,
        "seconds": outcome.seconds,
        "seconds_until_first": outcome.first,
        "per_second": outcome.solved / outcome.seconds,
        "rank": rank.index,
        "ranks": rank.count,
        "machine": machine_line(rank.device(device)),
        "written": [str(out)],
    }
    if asked("json"):
        click.echo(json.dumps(figures))  # one line, for ranks share a stream
        return
    tell(
        figures,
        f"{label}: {outcome.samples}, {outcome.solved} solved now in {outcome.seconds:.1f} s "
        f"({figures['per_second']:.0f} per second), the first after {outcome.first:.2f} s",
        f"not converged {outcome.unconverged}, unstable {outcome.unstable}; left out",
    )
