"""From a finished training to a controller that says where it comes from and how good it is."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from msgspec import to_builtins
from wrod.training.dataset import generate, largest_curvature, load
from wrod.training.loop import Training
from wrod.training.recipes import recipe
from wrod.training.score import held_out, score
from wrod.training.store import read_manifest

from wrod.controller.controller import Controller
from wrod.machine import machine_line
from wrod.rods.material import RodMaterial

# Grasps that one naturally curved rod's controller learns, where nothing else is said.
GRASPS = 3000


def finished(
    training: Training,
    folder: str | os.PathLike[str],
    *,
    test: int,
    seed: int,
    device: str,
    **metadata,
) -> Controller:
    """The trained controller, with the dataset, the range it is good for, and its score.

    Args:
        training: that has run.
        folder: of the dataset it learnt.
        test: fresh random inputs that it is scored on.
        seed: these are drawn with 10 000 more.
        device: where their grasps are solved.
        metadata: more to say.
    """
    manifest = read_manifest(folder)
    controller = training.controller(
        {
            "closure": manifest.closure,
            "machine": machine_line(device),
            "dataset": to_builtins(manifest),
            **metadata,
        }
    )
    rod = manifest.rod_inputs
    if rod is not None:
        # Some bends of a strongly curved rod have no grasp, and no controller.
        low, high = controller.range["curvature"]
        high = largest_curvature(folder, high)
        controller = controller.within("curvature", low, high)
    fresh = held_out(test, seed=10_000 + seed, device=device, rod=rod, closure=manifest.closure)
    controller.metadata["held_out"] = score(controller, *fresh)
    return controller


def controller_for(
    rod: RodMaterial,
    folder: str | os.PathLike[str],
    *,
    roll: float | str = "plane",
    grasps: int = GRASPS,
    steps: int | None = None,
    test: int = 300,
    seed: int = 0,
    device: str = "cpu",
    progress: Callable[[float], object] | None = None,
) -> Controller:
    """What `wrod dataset --rod` and `wrod train` make for a naturally curved rod, in one call.

    Args:
        rod: to be laid.
        folder: where dataset and checkpoints go.
        roll: see `generate`.
        grasps: to learn from.
        steps: of the optimiser; default: the recipe's.
        test: fresh inputs that the result is scored on.
        seed: of samples, weights and score.
        device: "cpu" or "cuda:0".
        progress: called with the share of the work that is done, 0 to 1.

    Raises:
        DataError: the folder cannot be used, or too few grasps converge.
    """
    folder, tell = Path(folder), progress or (lambda share: None)
    done = [0]

    def solved(count: int, total: int) -> None:
        done[0] += count
        tell(0.5 * done[0] / total)

    generate(
        folder / "dataset", grasps, seed=seed, shard_size=256, rod=rod, roll=roll,
        device=device, progress=solved,
    )  # fmt: skip
    chosen = recipe("curved")
    training = Training(
        chosen if steps is None else replace(chosen, steps=steps),
        load(folder / "dataset"),
        seed=seed,
        device=device,
        folder=folder,
        rod=read_manifest(folder / "dataset").rod_inputs,
    )
    training.resume()
    training.run(watch_every=100, progress=lambda now, all_, error: tell(0.5 + 0.5 * now / all_))
    return finished(training, folder / "dataset", test=test, seed=seed, device=device)
