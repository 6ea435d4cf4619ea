"""What `wrod plan` adds to a trajectory: joint path, scene and picture."""

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from wrod.errors import SceneError
from wrod.robot.joint_path import JointPath
from wrod.scene.export import export_usd
from wrod.scene.render import Renderer, save_png, time_codes

PICTURE_SIZE = (720, 540)  # of each of the four


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
    scene = export_usd(
        out / "scene.usdc", trajectory=trajectory, joint_path=joint_path, pattern=pattern, rod=rod
    )
    written.append(scene)
    if find_spec("viser") is not None:
        from wrod.scene.page import write_deployment_page

        progress("page")
        page = out / "scene.html"
        written.append(
            write_deployment_page(page, trajectory, joint_path, pattern=pattern, rod=rod)
        )
    if find_spec("newton") is not None:
        progress("picture")
        written.append(draw_scene(scene, out / "scene.png"))
    return written


def draw_scene(scene: Path, path: Path) -> Path:
    """Write four moments of a scene, seen in perspective, as one PNG.

    Raises:
        SceneError: see `wrod.scene.render.Renderer`.
    """
    renderer = Renderer(scene, "perspective", PICTURE_SIZE)
    codes = time_codes(renderer.scene.start, renderer.scene.end, 4)
    if len(codes) < 4:
        raise SceneError(f"{scene}: has too few time codes for four pictures")
    first, second, third, fourth = (renderer.frame(float(code)) for code in codes)
    rows = [np.hstack([first, second]), np.hstack([third, fourth])]
    return save_png(path, np.vstack(rows))
