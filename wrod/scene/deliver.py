"""What `wrod plan` adds to a trajectory: joint path, scene and picture."""

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from wrod.files import write_atomically, write_picture
from wrod.robot.joint_path import JointPath
from wrod.scene.beside import painter
from wrod.scene.export import export_usd
from wrod.scene.page import write_deployment_page
from wrod.scene.phases import falling
from wrod.scene.render import four_moments


def deliver(
    out: Path,
    trajectory,
    joint_path: JointPath | None,
    pattern,
    rod,
    progress: Callable[[str], object] = lambda what: None,
) -> list[Path]:
    """Write joint_path.csv/.npz, scene.usdc and, with Newton, scene.png, with Viser, scene.html.

    Args:
        out: the folder.
        trajectory, pattern, rod: what was planned.
        joint_path: of the trajectory; None leaves the robot out.
        progress: told what is being written.

    Returns:
        The files written.
    """
    written = []
    if joint_path is not None:
        written += joint_path.save(out / "joint_path")
    progress("scene")
    shown: dict[str, Any] = {"pattern": pattern, "rod": rod, "falls": falling(trajectory)}
    scene = export_usd(out / "scene.usdc", trajectory=trajectory, joint_path=joint_path, **shown)
    written.append(scene)
    beside = painter()
    if beside is not None:
        beside.begin(scene)
    if find_spec("viser") is not None:
        progress("page")
        page = out / "scene.html"
        written.append(write_deployment_page(page, trajectory, joint_path, **shown))
    if find_spec("newton") is not None:
        progress("picture")
        drawn = None if beside is None else beside.finish()
        path = out / "scene.png"
        if drawn is None:
            written.append(write_picture(path, four_moments(scene)))
        else:
            written.append(write_atomically(path, lambda file: file.write(drawn), "wb"))
    return written
