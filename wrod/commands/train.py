"""`wrod train`: a controller from a dataset, or from nothing with --generate."""

import sys
from pathlib import Path

import click

from wrod import cost
from wrod.options import FOLDER, USUAL
from wrod.telling import asked, json_option, tell


@click.command(name="train", short_help="Train a controller and score it.")
@click.option(
    "--dataset",
    type=FOLDER,
    help="Dataset that `wrod dataset` wrote.",
)
@click.option(
    "--generate",
    type=int,
    metavar="N",
    help="Solve N grasps first; a fifth of them during training, where the network errs most.",
)
@click.option("--out", type=FOLDER, required=True, help=USUAL["out"])
@click.option(
    "--recipe",
    "name",
    help="default, paper, or curved for the grasps of one naturally curved rod; default: by the "
    "dataset.",
)
@click.option("--seed", default=0, show_default=True, help=USUAL["seed"])
@click.option("--steps", type=int, help="Optimiser steps; default: the recipe's.")
@click.option("--batch", type=int, help="Grasps per step (the first).")
@click.option("--width", type=int, help="Units of a hidden layer.")
@click.option("--sensitivity-weight", type=float, help="Of the derivatives.")
@click.option("--minutes", type=float, help="Stop by then.")
@click.option("--rows", type=int, help="Most grasps of the dataset to hold.")
@click.option(
    "--test",
    default=2000,
    show_default=True,
    help="Fresh random inputs that the result is scored on.",
)
@click.option("--device", default="auto", show_default=True, help="cpu, cuda:0 or auto.")
@cost.force_option
@json_option
def command(
    dataset: Path | None,
    generate: int | None,
    out: Path,
    seed: int,
    minutes: float | None,
    rows: int | None,
    test: int,
    device: str,
    **settings,
) -> None:
    """Train the neural controller and score it against the numeric solver.

    From the grasps of one naturally curved rod (`wrod dataset --rod`) it makes a controller for
    that rod, which `wrod plan --controller` takes.

    The same command resumes from the last checkpoint in --out. With equal seed and steps (without
    --minutes) it gives the same weights on the same machine.
    """
    from wrod.errors import DataError
    from wrod.rods.device import resolve_device
    from wrod.training.dataset import GraspTable, load
    from wrod.training.finish import finished
    from wrod.training.loop import Training
    from wrod.training.store import read_manifest

    if (dataset is None) == (generate is None):
        raise DataError("give either --dataset DIR or --generate N")
    rod = None if dataset is None else _rod_of(dataset)
    recipe = _recipe("default" if rod is None else "curved", **settings)
    device = resolve_device(device)
    cost.settle(
        _cost(recipe, generate, rows, minutes, test, device),
        f"{recipe.steps} steps of {recipe.batch} grasps",
        "give fewer --steps or --test, a smaller --batch or --width, or --minutes",
    )  # fmt: skip
    refine = 0
    if generate is not None:
        refine = generate // 5
        dataset = _generate(out / "dataset", generate - refine, seed, device)
    table = load(dataset, rows)
    training = Training(
        recipe,
        table,
        seed=seed,
        device=device,
        folder=out,
        refine=refine,
        solve=lambda inputs: GraspTable.solve(inputs, device, table.sensitivity is not None),
        rod=rod,
    )
    resumed = training.resume()
    _train(training, resumed, minutes)
    controller = finished(
        training, dataset, test=test, seed=seed, device=device,
        # With --generate, the dataset is part of the one command.
        dataset_command=None if generate else read_manifest(dataset).command(dataset),
        command="wrod train " + " ".join(_arguments()),
    )  # fmt: skip
    summary = {k: v for k, v in controller.metadata.items()}
    written = _write(controller, training, summary, out)
    summary["resumed"] = resumed
    summary["written"] = [str(path) for path in written]
    if asked("json"):
        tell(summary)
    else:
        _say(training, summary)


def _rod_of(dataset: Path):
    """What a dataset says of its one curved rod; None for one of all straight rods.

    Raises:
        DataError: it is of one straight rod.
    """
    from wrod.errors import DataError
    from wrod.training.store import read_manifest

    rod = read_manifest(dataset).rod_inputs
    if rod is not None and rod.is_straight:
        raise DataError(
            f"{dataset}: holds grasps of one straight rod, and the controller that ships knows "
            "those of all; plan with it"
        )
    return rod


def _recipe(usual: str, name: str | None, **changes):
    """The recipe named, with the options that were given."""
    from dataclasses import replace

    from wrod.training.recipes import recipe as find

    recipe = find(usual if name is None else name)
    recipe = replace(recipe, **{k: v for k, v in changes.items() if v is not None})
    recipe = replace(recipe, largest_batch=max(recipe.largest_batch, recipe.batch))
    return recipe


def _cost(
    recipe, generate: int | None, rows: int | None, minutes: float | None, test: int, device: str
):
    """Of the training, and of the grasps that are solved for it and for its test."""
    from dataclasses import replace

    from wrod.training.store import row_bytes

    held = generate or rows or 0
    whole = cost.training(
        recipe.steps, recipe.batch, recipe.width, recipe.depth, held, device=device
    )
    if minutes is not None:
        whole = replace(whole, seconds=min(whole.seconds, 60.0 * minutes))
    tested = cost.grasps(test, 0, test, sensitivities=False, device=device, ranks=1)
    memory, seconds = max(whole.memory, tested.memory), whole.seconds + tested.seconds
    whole = replace(whole, seconds=seconds, memory=memory)
    if generate is None:
        return whole
    solved = cost.grasps(
        generate, row_bytes(True), 2048, sensitivities=True, device=device, ranks=1
    )
    return replace(whole, seconds=whole.seconds + solved.seconds, disk=whole.disk + solved.disk)


def _train(training, resumed: bool, minutes: float | None) -> None:
    total = training.recipe.steps
    with cost.progress_bar(unit="step", initial=training.step, total=total) as bar:

        def progress(done: int, total: int, error: float) -> None:
            bar.set_postfix(validation_mae=f"{error:.2e}")
            bar.update(done - bar.n)

        if not resumed:
            training.checkpoint()  # says now, not after the training, if it cannot be written
        training.run(minutes=minutes, progress=progress)


def _write(controller, training, summary: dict, out: Path) -> list[Path]:
    from wrod.files import write_json

    return [
        controller.save(out / "controller.safetensors"),
        write_json(out / "controller.json", summary),
        training.write_history(out / "history.csv"),
    ]


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


def _generate(folder: Path, size: int, seed: int, device: str) -> Path:
    from wrod.training.dataset import generate

    with cost.progress_bar(unit="grasp", desc="grasps", total=size) as bar:
        generate(folder, size, seed=seed, device=device, progress=cost.counting(bar))
    return folder


def _arguments() -> list[str]:
    """The command's own arguments as they were given."""
    given = sys.argv[1:]
    return given[given.index("train") + 1 :] if "train" in given else given
