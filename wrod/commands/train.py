"""`wrod train`: a controller from a dataset, or from nothing with --generate."""

import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import click

from wrod import cost
from wrod.errors import DataError
from wrod.options import FOLDER, gathered, option
from wrod.telling import asked, json_option, tell


@dataclass(frozen=True)
class _Asked:
    """What is trained, on what, and for how long."""

    dataset: Path | None = option("Dataset that `wrod dataset` wrote.", type=FOLDER)
    generate: int | None = option(
        "Solve N grasps first; a fifth of them during training, where the network errs most.",
        metavar="N",
    )
    out: Path = option(None, type=FOLDER, required=True)
    name: str | None = option(
        "default, paper, or curved for the grasps of one naturally curved rod; default: by the "
        "dataset.",
        "--recipe",
    )
    seed: int = option(None, default=0)
    steps: int | None = option("Optimiser steps; default: the recipe's.")
    batch: int | None = option("Grasps per step (the first).")
    width: int | None = option("Units of a hidden layer.")
    sensitivity_weight: float | None = option("Of the derivatives.")
    minutes: float | None = option("Stop by then.")
    rows: int | None = option("Most grasps of the dataset to hold.")
    test: int = option("Fresh random inputs that the result is scored on.", default=2000)
    device: str = option("cpu, cuda:0 or auto.", default="auto")

    def recipe(self, usual: str):
        """The recipe named, with the options that were given."""
        from wrod.training.recipes import recipe as find

        recipe = find(usual if self.name is None else self.name)
        names = ("steps", "batch", "width", "sensitivity_weight")
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        recipe = replace(recipe, **given)
        return replace(recipe, largest_batch=max(recipe.largest_batch, recipe.batch))

    def settle(self, recipe, device: str) -> None:
        """Say what training takes, with the grasps solved for it and for its test, or refuse it."""
        from wrod.training.store import row_bytes

        work = cost.training(
            recipe.steps, recipe.batch, recipe.width, recipe.depth,
            self.generate or self.rows or 0, device=device,
        )  # fmt: skip
        seconds = min(work.seconds, 60.0 * (self.minutes or math.inf))
        tested = cost.grasps(self.test, 0, self.test, sensitivities=False, device=device, ranks=1)
        solved = cost.grasps(
            self.generate or 0, row_bytes(True), 2048, sensitivities=True, device=device, ranks=1
        )
        seconds += tested.seconds + solved.seconds
        memory, disk = max(work.memory, tested.memory), work.disk + solved.disk
        cost.settle(
            cost.Cost(seconds, memory, disk), f"{recipe.steps} steps of {recipe.batch} grasps",
            "give fewer --steps or --test, a smaller --batch or --width, or --minutes",
        )  # fmt: skip


@click.command(name="train", short_help="Train a controller and score it.")
@gathered("how", _Asked)
@cost.force_option
@json_option
def command(how: _Asked) -> None:
    """Train the neural controller and score it against the numeric solver.

    From the grasps of one naturally curved rod (`wrod dataset --rod`) it makes a controller for
    that rod, which `wrod plan --controller` takes.

    The same command resumes from the last checkpoint in --out. With equal seed and steps (without
    --minutes) it gives the same weights on the same machine.
    """
    from wrod.files import write_json
    from wrod.rods.device import resolve_device
    from wrod.training.dataset import GraspTable, generate, load
    from wrod.training.finish import finished
    from wrod.training.loop import Training
    from wrod.training.store import read_manifest

    if (how.dataset is None) == (how.generate is None):
        raise DataError("give either --dataset DIR or --generate N")
    rod = None if how.dataset is None else _rod_of(how.dataset)
    recipe, device = how.recipe("default" if rod is None else "curved"), resolve_device(how.device)
    how.settle(recipe, device)
    dataset, refine = how.dataset, (how.generate or 0) // 5
    if dataset is None:
        dataset, size = how.out / "dataset", how.generate - refine
        with cost.progress_bar(unit="grasp", desc="grasps", total=size) as bar:
            generate(dataset, size, seed=how.seed, device=device, progress=cost.counting(bar))
    table = load(dataset, how.rows)
    training = Training(
        recipe,
        table,
        seed=how.seed,
        device=device,
        folder=how.out,
        refine=refine,
        solve=lambda inputs: GraspTable.solve(inputs, device, table.sensitivity is not None),
        rod=rod,
    )
    resumed = training.resume()
    _train(training, resumed, how.minutes)
    controller = finished(
        training, dataset, test=how.test, seed=how.seed, device=device,
        # With --generate, the dataset is part of the one command.
        dataset_command=None if how.generate else read_manifest(dataset).command(dataset),
        command="wrod train " + " ".join(_arguments()),
    )  # fmt: skip
    written = [
        controller.save(how.out / "controller.safetensors"),
        write_json(how.out / "controller.json", controller.metadata),
        training.write_history(how.out / "history.csv"),
    ]
    told = {"resumed": resumed, "written": [str(path) for path in written]}
    summary = controller.metadata | told
    if asked("json"):
        tell(summary)
    else:
        _say(training, summary)


def _rod_of(dataset: Path):
    """What a dataset says of its one curved rod; None for one of all straight rods.

    Raises:
        DataError: it is of one straight rod.
    """
    from wrod.training.store import read_manifest

    rod = read_manifest(dataset).rod_inputs
    if rod is not None and rod.is_straight:
        raise DataError(
            f"{dataset}: holds grasps of one straight rod, and the controller that ships knows "
            "those of all; plan with it"
        )
    return rod


def _train(training, resumed: bool, minutes: float | None) -> None:
    total = training.recipe.steps
    with cost.progress_bar(unit="step", initial=training.step, total=total) as bar:

        def progress(done: int, total: int, error: float) -> None:
            bar.set_postfix(validation_mae=f"{error:.2e}")
            bar.update(done - bar.n)

        if not resumed:
            training.checkpoint()  # says now, not after the training, if it cannot be written
        training.run(minutes=minutes, progress=progress)


def _say(training, summary: dict) -> None:
    click.echo(
        f"{training.recipe.name}: {training.step} steps in {training.seconds:.0f} s on "
        f"{summary['samples']} grasps"
    )
    for key in ("validation", "held_out"):
        values = summary[key]
        click.echo(
            f"{key.replace('_', ' '):>10}: MAE {values['mean_absolute_error']:.2e}, position error "
            f"p99 {values['position_error_p99']:.2e} L_gb, largest "
            f"{values['position_error_max']:.2e} ({values['grasps']} grasps)"
        )
    click.echo(summary["machine"])
    for path in summary["written"]:
        click.echo(f"wrote {path}")


def _arguments() -> list[str]:
    """The command's own arguments as they were given."""
    given = sys.argv[1:]
    return given[given.index("train") + 1 :] if "train" in given else given
