"""Kernels that tests launch, compiled ahead and several at a time: `make setup` does it.

All of wrod's, also those that only a GPU has use for; what tests launch of Newton's; their own.
"""

import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from pytest import ExitCode

from wrod.commands import compile as ahead
from wrod.machine import usable_cores
from wrod.side_by_side import run

# Modules of Newton that tests launch no adjoint of: with it a compiler takes four times as long.
FORWARD = (
    "geometry.inertia",
    "geometry.sdf_contact",
    "sim.articulation",
    "solvers.featherstone.kernels",
    "solvers.mujoco.kernels",
    "solvers.vbd.rigid_vbd_kernels",
    "solvers.xpbd.kernels",
    "viewer.kernels",
)
_NEWTON = (
    *FORWARD,
    "geometry.broad_phase_nxn",
    "geometry.differentiable_contacts",
    "geometry.narrow_phase",
    "sim.collide",
    "solvers.solver",
)
# What Newton makes kernels of as it meets what it is asked for: in the tests that ask.
_MET = (
    "test_newton_arms.py::test_an_arm_under_mujoco_feels_its_cable",
    "test_newton_arms.py::test_a_box_is_dragged_over_the_floor",
    "test_newton_body_contact.py::test_bodies_meet_and_keep_their_momentum",
    "test_bench_newton.py::test_many_worlds",
)
_GPU = (
    "dense_lanes",
    "factor_lanes",
    "banded_ends",
    "banded_lanes",
    "skyline_ends",
    "skyline_lanes",
    "condensing",
)
_SUMS = "map_add"
_HERE = Path(__file__).parent


def leave_out_adjoints() -> str:
    """Out of what is compiled of Newton's from now on, and of sums; the folder that all is compiled
    to."""
    import warp as wp
    import wrod.kernels  # noqa: F401  which starts Warp quietly

    for name in FORWARD:
        wp.get_module(f"newton._src.{name}").options["enable_backward"] = False
    # Tapes add up adjoints of copies by kernels that Warp makes as it meets them, of a module that
    # is compiled anew with each: here are all, in one order.
    wp.get_module(_SUMS).options["enable_backward"] = False
    for kind in (wp.spatial_vector, wp.transform, wp.float32, wp.float64, wp.vec3d):
        for size in (1, 2):  # one of its own where an array has one element
            array = wp.zeros(size, dtype=kind, device="cpu")
            wp.map(wp.add, array, array, out=array, return_kernel=True)
    return wp.config.kernel_cache_dir


def _compile(name: str) -> str | None:
    """Do a part of the work; what went wrong, if anything."""
    import warp as wp

    try:
        if name.startswith("wrod.kernels."):
            return ahead._compile("cpu", name)
        sys.path += [str(_HERE), str(_HERE / "physics")]
        leave_out_adjoints()
        if name != _SUMS:
            import_module(name)
        wp.force_load("cpu", [wp.get_module(name)], block_dim=1)
    except Exception as error:
        return f"{name}: not compiled ({error})"
    return None


def _meet(jobs: int) -> str | None:
    """Run tests for what they compile, whatever they find; what went wrong, if anything."""
    tests = [str(_HERE / name) for name in _MET]
    command = [sys.executable, "-m", "pytest", "-qq", "-n", str(jobs), "--dist", "loadfile", *tests]
    done = subprocess.run(command, capture_output=True, text=True, cwd=_HERE.parent)
    if done.returncode in (ExitCode.OK, ExitCode.TESTS_FAILED):
        return None
    return f"kernels of tests: not compiled ({(done.stdout + done.stderr)[-300:].strip()})"


def _files() -> Iterator[tuple[str, Path]]:
    """(module, file) of tests, and of wrod but for its kernels."""
    for file in _HERE.rglob("*.py"):
        yield file.stem, file
    for file in (_HERE.parent / "wrod").rglob("*.py"):
        yield ".".join(file.relative_to(_HERE.parent).with_suffix("").parts), file


def main() -> int:
    """Compile them; how many were not."""
    names = [f"newton._src.{name}" for name in _NEWTON] + ahead._wanted(rare=True)
    names += [f"wrod.kernels.linear.{name}" for name in _GPU] + [_SUMS]
    names += [name for name, file in _files() if "\n@wp.kernel" in file.read_text()]
    jobs = min(usable_cores(), 8)  # each imports all that it may be asked for
    wrong = [said for _, said in run(_compile, [(name,) for name in names], jobs)]
    wrong.append(_meet(min(jobs, len(_MET))))
    for said in filter(None, wrong):
        print(said, file=sys.stderr)
    return len(list(filter(None, wrong)))


if __name__ == "__main__":
    sys.exit(main())
