"""`wrod compile`: kernels compiled before they are needed, several at a time."""

from __future__ import annotations

import json
import subprocess
import sys
import time

import click

from wrod import cost
from wrod.commands.options import DEVICE, options
from wrod.machine import usable_cores

# A plan whose scene is drawn, for the kernels of Newton that this takes; nothing else of it counts.
_EXAMPLE = ["plan", "line", "--rod", "green-vps", "--no-expect", "--no-shapes"]
# Kernels that a CPU has no use for.
_OF_A_GPU = ("_lanes", "_ends", "condensing")


@click.command(name="compile", short_help="Compile kernels before they are needed.")
@options(DEVICE)
@click.option(
    "--jobs", type=click.IntRange(min=1), help="Processes at a time; default: one a core."
)
@click.option("--json", "as_json", is_flag=True, help="Print figures for machines.")
def command(device: str, jobs: int | None, as_json: bool) -> None:
    """Fill Warp's kernel cache, so that no other command has to wait for a compiler.

    Kernels are compiled once on a machine, by whatever needs them first; here all of them are, side
    by side. What is there already is not compiled again. `make setup` does this.
    """
    from concurrent.futures import ThreadPoolExecutor

    from tqdm import tqdm

    from wrod.machine import machine_line
    from wrod.rods.device import resolve_device

    device = resolve_device(device)
    clock = time.perf_counter()
    jobs = jobs or usable_cores()
    work = cost.Cost(cost.KERNELS / jobs)
    cost.settle(work, "all kernels, where none is there yet", None, "", quiet=as_json)
    names = _modules() if device == "cpu" else []
    parts = [["--picture"], *([device, *names[k::jobs]] for k in range(jobs if names else 1))]
    with ThreadPoolExecutor(jobs) as pool:
        done = pool.map(_run, parts)
        quiet = as_json or None
        failed = [one for one in tqdm(done, total=len(parts), desc="kernels", disable=quiet) if one]
    seconds = time.perf_counter() - clock
    if as_json:
        figures = {"seconds": seconds, "failed": failed, "machine": machine_line(device)}
        click.echo(json.dumps(figures))
        return
    for one in failed:
        click.echo(f"wrod: warning: {one}", err=True)
    click.echo(machine_line(device))
    click.echo(f"kernels are compiled, in {seconds:.0f} s")


def _modules() -> list[str]:
    """Names of the modules of kernels."""
    import pkgutil

    import wrod.kernels

    names = [m.name for m in pkgutil.walk_packages(wrod.kernels.__path__, "wrod.kernels.")]
    # Others put kernels of their own into these once they are imported.
    names.sort(key=lambda name: not name.endswith(("elastic.bending", "elastic.section")))
    return [name for name in names if not name.endswith(_OF_A_GPU)]


def _run(what: list[str]) -> str | None:
    """Do a part of the work in a process of its own; what went wrong, if anything."""
    run = [sys.executable, "-P", "-m", "wrod.commands.compile", *what]
    done = subprocess.run(run, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if done.returncode == 0:
        return None
    last = (done.stderr.strip().splitlines() or ["no reason was given"])[-1]
    return f"{what[0].strip('-')}: not all is compiled ({last[:300]})"


def _compile(device: str, names: list[str]) -> None:
    """Modules for a CPU; a GPU's compiler is given all that it needs at once."""
    from importlib import import_module

    import warp as wp

    import wrod.solvers.dynamics  # noqa: F401  # with all the kernels that commands have

    if device != "cpu":
        from wrod.grasps.levels import compile_kernels
        from wrod.solvers.compiling import compile_steps

        compile_steps(device)
        compile_steps(device, coupled=True)
        compile_kernels(device, sensitivities=True)
    for name in names:
        module = wp.get_module(import_module(name).__name__)
        if module.kernels:
            wp.force_load("cpu", [module], block_dim=1)


def _draw() -> None:
    """Plan the example, if all is there that its scene takes."""
    import tempfile
    from importlib.util import find_spec

    from wrod.commands import main

    if all(find_spec(name) for name in ("newton", "pxr", "pytorch_kinematics")):
        with tempfile.TemporaryDirectory() as folder:
            main([*_EXAMPLE, "--out", folder], standalone_mode=False)


if __name__ == "__main__":
    if sys.argv[1] == "--picture":
        _draw()
    else:
        _compile(sys.argv[1], sys.argv[2:])
