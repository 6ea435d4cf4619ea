"""`wrod bench controller`: errors over the whole range, and time of a trajectory."""

import resource
import subprocess
import sys
import time
from pathlib import Path

import click

from wrod import cost
from wrod.machine import machine_line
from wrod.options import option, own_options
from wrod.telling import json_option, tell

NODES = 200  # of the trajectory that is timed: the paper's rods at 4 mm
_COLD = (
    "import sys, numpy as np, wrod\n"
    "name = sys.argv[1] if len(sys.argv) > 1 else None\n"
    f"wrod.Controller.load(name).predict(np.linspace(1.0, 50.0, {NODES}), 1.0, 1500.0)\n"
)


@click.command(name="controller")
@click.argument("weights", nargs=-1, type=click.Path(dir_okay=False, path_type=Path))
@own_options
@json_option
def command(
    weights: tuple[Path, ...],
    count: int = option(None, default=2000),
    seed: int = option(None, default=1),
    device: str = option("Of the numeric solver.", default="auto"),
) -> None:
    """Compare controllers with the numeric solver on the same random inputs.

    WEIGHTS are controller files; without any, those that ship. The inputs cover the whole
    range; no training has seen them. Times are those of a trajectory of 200 nodes: warm, and in a
    new process with all imports.
    """
    from wrod.controller.controller import SHIPPED, Controller
    from wrod.rods.device import resolve_device
    from wrod.training.score import held_out, score

    device = resolve_device(device)
    controllers = {str(path): Controller.load(path) for path in weights}
    shipped = not controllers
    if shipped:
        controllers = {name: Controller.load(closure=closure) for closure, name in SHIPPED.items()}
    closures = {controller.closure for controller in controllers.values()}
    cost.settle(
        cost.grasps(
            len(closures) * count, 0, 4096, sensitivities=False,
            device="cpu" if device == "cpu" else "cuda", ranks=1,
        ),
        f"{count} grasps of {len(closures)} closures", "ask for a smaller --count",
    )  # fmt: skip
    solved = {c: held_out(count, seed=seed, device=device, closure=c) for c in closures}
    rows = [
        {
            "controller": name,
            **score(controller, *solved[controller.closure]),
            **_warm(controller),
            **_cold([] if shipped else [name]),
        }
        for name, controller in controllers.items()
    ]
    tell(
        {"machine": machine_line(device), "seed": seed, "rows": rows},
        f"{count} random inputs of the whole range, seed {seed}; lengths in L_gb",
        *(
            f"{row['controller']}:\n"
            f"  six outputs   MAE {row['mean_absolute_error']:.2e}\n"
            f"  position      mean {row['position_error_mean']:.2e}, 99th percentile "
            f"{row['position_error_p99']:.2e}, largest {row['position_error_max']:.2e}\n"
            f"  rotation      99th percentile {row['rotation_error_p99']:.2e}, largest "
            f"{row['rotation_error_max']:.2e} rad\n"
            f"  left out      {row['left_out']} that the solver gave no result for\n"
            f"  {NODES} nodes     {1e3 * row['predict_seconds']:.2f} ms (median; slowest of 50 "
            f"{1e3 * row['predict_seconds_max']:.2f} ms)\n"
            f"  cold process  {row['cold_seconds']:.2f} s with imports (user and system "
            f"{row['cold_cpu_seconds']:.2f} s)"
            for row in rows
        ),
    )


def _warm(controller) -> dict:
    """Wall time [s] of predicting a trajectory in a process that has done so before."""
    import numpy as np

    inputs = (np.linspace(1.0, 50.0, NODES), np.linspace(-3.5, 3.5, NODES), 1500.0)
    controller.predict(*inputs)
    times = []
    for _ in range(50):
        clock = time.perf_counter()
        controller.predict(*inputs)
        times.append(time.perf_counter() - clock)
    return {"predict_seconds": float(np.median(times)), "predict_seconds_max": max(times)}


def _cold(arguments: list[str]) -> dict:
    """Wall and processor time [s] of a new process that imports, loads and predicts once."""

    def processor() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    clock, before = time.perf_counter(), processor()
    subprocess.run(
        [sys.executable, "-P", "-c", _COLD, *arguments], check=True, start_new_session=True
    )
    return {"cold_seconds": time.perf_counter() - clock, "cold_cpu_seconds": processor() - before}
