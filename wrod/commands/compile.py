"""`wrod compile`: kernels compiled before they are needed, several at a time."""

from __future__ import annotations

import json
import os
import time
from multiprocessing import parent_process
from pathlib import Path

import click

from wrod import cost
from wrod.commands.options import DEVICE
from wrod.machine import usable_cores
from wrod.options import option, own_options
from wrod.side_by_side import run
from wrod.telling import asked, json_option

# Kernels that a CPU has no use for.
_OF_A_GPU = ("_lanes", "_ends", "condensing")
# What takes a compiler longest, which is begun first, after the pictures; a kernel after a colon
# has a module of its own.
_LONG = (
    "grasping.sensitivity",
    "grasping.iteration:solve_straight",
    "elastic.bending:elasticity",
    "elastic.softened_bending:softened_elasticity",
    "elastic.inelastic:inelastic_energy",
    "elastic.bend_twist:bend_twist_energy",
    "stepping.motion_tangents",
    "linear.banded_lu:assemble",
)
# What few commands launch: for rods that touch rods or what has edges, those that are curved by
# nature or bodies of Newton's. Gradients are for programs: no command launches an adjoint.
_OF_GRADIENTS = "adjoint"
_RARE = (
    "grasping.iteration:solve_general",
    "contact.depths",
    "contact.edges",
    "contact.energies",
    "linear.coupling",
    "contact.rods",
    "grasping.reading:read_general",
    "grasping.general_rod",
    "grasping.memory:follow_flow",
    "grasping.memory:read_curvature",
    "contact.pairs",
    "contact.touching",
    "linear.skyline",
    "linear.skyline_order",
    "stepping.hands",
    "stepping.bodies",
    "stepping.body_system",
    "stepping.body_exchange",
    "stepping.body_contact",
    "stepping.body_meetings",
    "stepping.body_shapes",
    "stepping.carrying",
    "stepping.exchange",
    "stepping.adjoint:assemble",
    "stepping.adjoint:fill_coupled",
)
_PICTURE, _ALL = "pictures of scenes", "all"  # kernels that are no module's


@click.command(name="compile", short_help="Compile kernels before they are needed.")
@DEVICE
@own_options
@json_option
def command(
    device: str,
    jobs: int | None = option("Processes at a time; at most (default) one a core."),
    rare: bool = option("On a CPU also what few commands launch.", "--all"),
) -> None:
    """Fill Warp's kernel cache, so that other commands do not have to wait for a compiler.

    Kernels are compiled once on a machine, by whatever needs them first; here they are side by
    side. Left out on a CPU, unless --all is given, are those of knots, of fixtures with edges, of
    the rod solver's grasps of naturally curved rods, of Newton's solver, and of gradients; on a GPU
    those of Newton's solver's gradients. What is there already is not compiled again. `make setup`
    does this.
    """
    import warp as wp

    from wrod.files.writing import keeps
    from wrod.machine import machine_line
    from wrod.rods.device import resolve_device

    device = resolve_device(device)
    keeps(Path(wp.config.kernel_cache_dir))
    clock = time.perf_counter()
    jobs = min(jobs or usable_cores(), usable_cores())
    work = cost.Cost((cost.KERNELS + rare * cost.RARE_KERNELS) / jobs)
    cost.settle(work, "the kernels, where none is there yet")
    kernels = _wanted(rare) if device == "cpu" else [_ALL]
    parts = [(device, part) for part in (_PICTURE, *kernels)]
    done = cost.progress_bar(run(_compile, parts, jobs), total=len(parts), desc="kernels")
    failed = [wrong for _, wrong in done if wrong]
    seconds = time.perf_counter() - clock
    if asked("json"):
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
    return [name for name in names if not name.endswith(_OF_A_GPU)]


def _wanted(rare: bool) -> list[str]:
    """What to compile for a CPU: modules, and kernels that have their own ("module:kernel")."""
    first, last = ([f"wrod.kernels.{name}" for name in names] for names in (_LONG, _RARE))
    last += [name for name in _modules() if name.endswith(_OF_GRADIENTS)]
    names = first + [name for name in _modules() if name not in first + last]
    return last[:2] + names + last[2:] if rare else names


def _compile(device: str, what: str) -> str | None:
    """Do a part of the work; what went wrong, if anything."""
    if parent_process() is not None:  # what compilers print is not for the terminal
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        os.close(nowhere)
    try:
        if what == _PICTURE:
            _draw()
        elif what == _ALL:
            _compile_for_gpu(device)
        else:
            _compile_module(what)
    except Exception as error:
        return f"{what}: not compiled ({error})"[:300]
    return None


def _compile_module(name: str) -> None:
    from importlib import import_module

    import warp as wp

    # Others put kernels of their own into some modules once they are imported or first used.
    for other in _modules():
        import_module(other)
    import wrod.solvers.dynamics  # noqa: F401
    from wrod.kernels.stepping import deployment_tangents

    deployment_tangents.vector_of(deployment_tangents.PACK)

    place, _, kernel = name.partition(":")
    home = import_module(place)
    module = getattr(home, kernel).module if kernel else wp.get_module(place)
    if module.kernels:
        wp.force_load("cpu", [module], block_dim=1)


def _compile_for_gpu(device: str) -> None:
    """A GPU's compiler is given all that it needs at once."""
    from wrod.grasps.levels import compile_kernels
    from wrod.solvers.compiling import compile_steps

    compile_steps(device)
    compile_kernels(device, sensitivities=True)


def _draw() -> None:
    """Draw next to nothing, if all is there that it takes: Newton's kernels are compiled for it."""
    from importlib.util import find_spec

    if all(find_spec(name) for name in ("newton", "pxr")):
        from wrod.scene.render import compile_pictures

        compile_pictures()
