"""Functions of the API whose package is not installed: one sentence names the extra."""

import subprocess
import sys

_PROGRAM = """
import gc, sys
gc.disable()
hidden = []
class Without:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Without())
import numpy as np
import wrod
wrod.rod("rope")
picture = np.zeros((60, 60), bool)
picture[20:23, 10:50] = True
def trajectory():
    return wrod.plan(wrod.pattern("line"), wrod.rod("rope"), "intuitive", spacing=0.02)
for hidden, calls in {asked!r}:
    for call in calls:
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


def test_missing_packages_are_named_with_their_extras(tmp_path):
    """Of each call the one that it needs, whatever else is missing. Without torch the calls of
    other packages cannot ask for theirs, so it is there while these run."""
    order = sorted(_NEEDED, key=lambda needed: needed[0] != "torch")
    others = [package for package, _ in order if package != "torch"]
    # An arm's kinematics, which is asked for before torch, needs that, too.
    first = ["torch", *(name for name in others if name != "pytorch_kinematics")]
    asked = [(first if key[0] == "torch" else others, _NEEDED[key]) for key in order]
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM.format(asked=asked)],
        capture_output=True, text=True, cwd=tmp_path,
    )  # fmt: skip
    said = [
        f"this needs {package}; install it with: pip install 'wrod[{extra}]'"
        for package, extra in order
        for _ in _NEEDED[package, extra]
    ]
    assert done.stdout.splitlines() == said, done.stderr
    assert not list(tmp_path.iterdir())
