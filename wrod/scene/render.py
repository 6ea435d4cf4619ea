"""Headless pictures of a stage through its own cameras (Newton's ray tracer, CPU or GPU)."""

import os
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from wrod.errors import SceneError, needed_extras
from wrod.files import write_picture
from wrod.scene.newton_model import NewtonScene
from wrod.scene.validate import open_stage

_SKY, _GROUND = (0.50, 0.51, 0.55), (0.20, 0.19, 0.18)
_SUN = (-0.35, 0.40, -0.85)
_BACKGROUND = (226, 230, 236)
_RAYS = 4  # a pixel
_MOMENT = (720, 540)  # of each of the four of a scene
_GUTTER = ((2, 2), (2, 2), (0, 0))  # of white about each
_TYING = ("side", "close")  # cameras; the second without the arms, which hide the rods
_ARMS = {"robot_0", "robot_1"}
_GAP, _PAPER = 4, 255  # [pixels], grey
# A stage that takes every kernel that larger ones take.
_LEAST = """#usda 1.0
( startTimeCode = 0
  endTimeCode = 1 )
def Sphere "ball" {
    double radius = 0.1
    double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 1: (0, 0, 1) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def Camera "perspective" {}
"""


class Renderer:
    """Draws a stage through one of its cameras.

    Args:
        path: the stage.
        camera: name of a camera on it.
        size: width and height [pixels].
        hidden: names of prims to leave out.

    Raises:
        SceneError: no stage, no such camera, a size that is not positive, or Newton is missing.
    """

    @needed_extras()
    def __init__(
        self,
        path: str | os.PathLike[str],
        camera: str = "perspective",
        size: tuple[int, int] = (960, 720),
        hidden: tuple[str, ...] = (),
    ):
        if min(size) < 1 or max(size) > 8192:
            raise SceneError(f"picture size {size[0]} x {size[1]} is not within 1 ... 8192 pixels")
        import wrod.kernels  # noqa: F401  # before Newton: starts Warp quietly

        # isort: split
        import warp as wp
        from newton.sensors import SensorCamera

        self.scene = NewtonScene(path, hidden)
        self._sensor = SensorCamera(self.scene.model)
        self._sensor.create_default_light(
            direction=wp.normalize(wp.vec3(*_SUN)), color=(0.72, 0.71, 0.68)
        )
        self._sensor.set_ambient_light(_SKY, _GROUND)
        red, green, blue = _BACKGROUND
        self._clear = SensorCamera.ClearData(clear_color=(blue << 16) | (green << 8) | red)
        self._config = SensorCamera.RenderConfig(
            enable_shadows=True, anti_aliasing=SensorCamera.AntiAliasing.SSAA
        )
        device = self.scene.model.device
        self._rays_of = partial(
            SensorCamera.compute_camera_rays_pinhole_usd, *size, sample_count=_RAYS, device=device
        )
        self._color = self._sensor.allocate_image_color(1, *size)
        self.look(camera)

    def look(self, camera: str) -> None:
        """Draw through another camera from now on."""
        self._camera = self.scene.camera(camera)
        self._rays = self._rays_of(self._camera)

    def frame(self, time: float) -> np.ndarray:
        """(height, width, 3) picture at a time code, uint8 RGB."""
        self.scene.update(time)
        views = self._sensor.compute_camera_transforms_usd(self._camera, time=time)
        self._sensor.update(
            self.scene.state,
            views,
            self._rays,
            color_image=self._color,
            clear_data=self._clear,
            render_config=self._config,
        )
        packed = np.ascontiguousarray(self._color.numpy()[0])
        return packed.view(np.uint8).reshape(*packed.shape, 4)[..., :3].copy()


def compile_pictures() -> None:
    """Draw next to nothing, for which Newton's kernels are compiled where they are not yet."""
    with tempfile.TemporaryDirectory() as folder:
        stage = Path(folder) / "least.usda"
        stage.write_text(_LEAST)
        Renderer(stage, size=(8, 8)).frame(0.0)


def time_codes(start: float, end: float, frames: int) -> np.ndarray:
    """`frames` evenly spaced whole time codes from start to end; the last alone for one."""
    if frames < 1:
        raise SceneError(f"{frames} frames were asked for; give 1 or more")
    if frames == 1:
        return np.array([end])
    return np.unique(np.round(np.linspace(start, end, frames)))


def render(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    camera: str = "perspective",
    frames: int = 1,
    size: tuple[int, int] = (960, 720),
    hidden: tuple[str, ...] = (),
    progress: Callable[[int, int], object] | None = None,
) -> list[Path]:
    """Write PNG pictures of a stage.

    Args:
        path: the stage.
        out: a .png file for one picture, or a folder for `<camera>_0000.png` ...
        camera: name of a camera on the stage: "top", "work" or "perspective" of `export_usd`.
        frames: how many, evenly from first to last time code; one is the last.
        size: width and height [pixels].
        hidden: names of prims to leave out.
        progress: called with (done, total).

    Returns:
        The files written.

    Raises:
        SceneError: see `Renderer`; or several frames for one file.
    """
    out = Path(out)
    single = out.suffix.lower() == ".png"
    if single and frames != 1:
        raise SceneError(f"{out}: {frames} frames do not fit in one picture; give a folder")
    renderer = Renderer(path, camera, size, hidden)
    written = []
    times = time_codes(renderer.scene.start, renderer.scene.end, frames)
    for number, time in enumerate(times):
        target = out if single else out / f"{camera}_{int(time):04d}.png"
        written.append(write_picture(target, renderer.frame(float(time))))
        if progress is not None:
            progress(number + 1, len(times))
    return written


def four_moments(scene: Path) -> np.ndarray:
    """(height, width, 3) four moments of a scene, uint8 RGB: all of it, rod and hand twice, and
    from above what lies in the end.

    Raises:
        SceneError: see `Renderer`.
    """
    renderer = Renderer(scene, "perspective", _MOMENT, ("grip_path",))
    codes = time_codes(renderer.scene.start, renderer.scene.end, 4)
    if len(codes) < 4:
        raise SceneError(f"{scene}: has too few time codes for four pictures")
    pictures = []
    for camera, code in zip(("perspective", "work", "work", "top"), codes, strict=True):
        renderer.look(camera)
        pictures.append(np.pad(renderer.frame(float(code)), _GUTTER, constant_values=255))
    return np.vstack([np.hstack(pictures[:2]), np.hstack(pictures[2:])])


def draw_moments(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    size: tuple[int, int] = (400, 300),
    progress: Callable[[int, int], object] | None = None,
) -> Path:
    """Write one PNG with a column for every moment that a stage names, a row for every camera.

    Args:
        path: a stage of `wrod.scene.tying.export_scene`.
        out: the picture.
        size: of each [pixels].
        progress: called with (done, total).

    Raises:
        SceneError: the stage names no moments, or see `Renderer`.
    """
    rows, done = [], 0
    for camera in _TYING:
        stage = open_stage(path)
        codes = moments(stage)
        if not codes:
            raise SceneError(f"{path}: names no moments; give a number of frames instead")
        arms = {prim.GetName() for prim in stage.Traverse()} & _ARMS
        renderer = Renderer(path, camera, size, tuple(arms) if camera == "close" else ())
        row = []
        for code in codes.values():
            row += [np.full((size[1], _GAP, 3), _PAPER, dtype=np.uint8), renderer.frame(code)]
            done += 1
            if progress is not None:
                progress(done, len(codes) * len(_TYING))
        rows += [np.full((_GAP, sum(p.shape[1] for p in row[1:]), 3), _PAPER, dtype=np.uint8)]
        rows.append(np.hstack(row[1:]))
    return write_picture(out, np.vstack(rows[1:]))


def moments(stage) -> dict[str, float]:
    """Time codes of a stage's moments by name, in the order of time."""
    for prim in stage.Traverse():
        told = prim.GetCustomDataByKey("wrod") or {}
        if "moments" in told:
            return dict(sorted(told["moments"].items(), key=lambda item: item[1]))
    return {}
