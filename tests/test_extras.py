"""Functions of the API whose package is not installed: one sentence names the extra."""

import subprocess
import sys

import pytest

_PROGRAM = """
import gc, sys
gc.disable()
class Without:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {hidden!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Without())
import numpy as np
import wrod
wrod.rod("rope")
picture = np.zeros((60, 60), bool)
picture[20:23, 10:50] = True
def trajectory():
    return wrod.plan(wrod.pattern("line"), wrod.rod("rope"), "intuitive", spacing=0.02)
for call in {calls!r}:
    try:
        exec(call)
        print(call, "ran")
    except wrod.errors.WrodError as error:
        assert isinstance(error, ImportError)
        print(error)
"""
_NEEDED = {
    ("newton", "newton"): ["wrod.SolverDER", "from wrod.newton_solver import SolverDER"],
    ("cv2", "perception"): [
        "wrod.scan(picture, scale=0.001)",
        "wrod.trace_centerlines(picture)",
        "from wrod.perception.metric import MarkerLayout, find_markers\n"
        "find_markers(picture.astype('u1'), MarkerLayout('4x4', {0: picture[:4, :2] * 1.0}))",
    ],
    ("PIL", "perception"): [
        f"from wrod.perception.image import read_image; read_image({__file__!r})"
    ],
    ("torch", "train"): [
        "wrod.load_robot('sawyer')",
        "wrod.solve_joint_path(trajectory())",
        "import wrod.training.autograd",
        "from wrod.training.loop import Training",
        "import wrod.training.distil, wrod.training.moving, wrod.training.network",
    ],
    ("pytorch_kinematics", "robot"): ["wrod.load_robot('sawyer')"],
    ("pxr", "scene"): [
        "wrod.export_usd('never-written.usda', trajectory=trajectory())",
        "from wrod.scene.validate import open_stage; open_stage('never-written.usda')",
    ],
    ("gymnasium", "gym"): ["import wrod.deployment.environment"],
    ("mujoco", "peers"): ["from wrod.bench.mujoco_chain import require_mujoco; require_mujoco()"],
}


# Those without which the others cannot ask for theirs are hidden in a process of their own.
_FIRST = ["torch"]


@pytest.mark.parametrize("alone", [True, False])
def test_missing_packages_are_named_with_their_extras(tmp_path, alone):
    """Of each call the one that it needs, whatever else is missing."""
    needed = {k: calls for k, calls in _NEEDED.items() if (k[0] in _FIRST) == alone}
    calls = [call for part in needed.values() for call in part]
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM.format(hidden=[k[0] for k in needed], calls=calls)],
        capture_output=True, text=True, cwd=tmp_path,
    )  # fmt: skip
    said = [
        f"this needs {package}; install it with: pip install 'wrod[{extra}]'"
        for (package, extra), part in needed.items()
        for _ in part
    ]
    assert done.stdout.splitlines() == said, done.stderr
    assert not list(tmp_path.iterdir())
