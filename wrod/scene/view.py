"""A deployment in the browser: a live viewer on this machine, or one self-contained page (Newton
on Viser)."""

import os
import time as clock
from collections.abc import Callable
from math import radians
from pathlib import Path

from wrod.errors import needed_extras
from wrod.files import write_text
from wrod.scene.newton_model import NewtonScene
from wrod.scene.page_parts import named
from wrod.scene.stage import FRAMES_PER_SECOND

_ADDRESS, _PORT = "127.0.0.1", 8080  # this machine only
_DEFAULT = "perspective"  # camera; stages of others may have none
_STRIDE = 2  # every other time code is enough for a page


def _viewer(model, port: int, verbose: bool):
    import viser  # noqa: F401  # Newton's own error of it names no module
    from newton.viewer import ViewerViser

    viewer = ViewerViser(host=_ADDRESS, port=port, label="wrod", verbose=verbose)
    viewer.set_model(model)
    return viewer


def _look_through(camera, viewer) -> None:
    """Begin with the view of a camera of the stage; with the viewer's own where it is None."""
    if camera is None:
        return
    from pxr import UsdGeom

    lens = UsdGeom.Camera(camera).GetCamera()
    frustum = lens.frustum
    first = viewer.server.initial_camera
    first.position = tuple(frustum.position)
    ahead = frustum.ComputeViewDirection()
    first.look_at = tuple(frustum.position + lens.focusDistance * ahead)
    # The mouse turns the view about `up`: the vertical, unless the camera looks along it.
    first.up = (0.0, 0.0, 1.0) if abs(ahead[2]) < 0.99 else tuple(frustum.ComputeUpVector())
    first.fov = radians(lens.GetFieldOfView(lens.FOVVertical))


@needed_extras()
def write_page(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    camera: str = _DEFAULT,
    hidden: tuple[str, ...] = (),
    progress: Callable[[int, int], object] | None = None,
) -> Path:
    """Write a stage as one HTML page that plays the deployment, without outside links.

    It begins with the view of one of the stage's cameras.

    Raises:
        SceneError: no stage, no such camera, or Newton or Viser is missing.
    """
    scene = NewtonScene(path, hidden)
    eye = scene.camera(camera) if camera != _DEFAULT or scene.cameras else None
    viewer = _viewer(scene.model, _PORT, False)
    try:
        _look_through(eye, viewer)
        recording = viewer.server.get_scene_serializer()
        count = int(scene.end - scene.start) // _STRIDE + 1
        for number in range(count):
            scene.update(scene.start + number * _STRIDE)
            viewer.begin_frame(number * _STRIDE / FRAMES_PER_SECOND)
            viewer.log_state(scene.state)
            viewer.end_frame()
            recording.insert_sleep(_STRIDE / FRAMES_PER_SECOND)
            if progress is not None:
                progress(number + 1, count)
        page = named(recording.as_html(), Path(path).stem)
    finally:
        viewer.close()
    return write_text(out, page)


@needed_extras()
def view(path: str | os.PathLike[str], port: int = _PORT) -> None:
    """Play a stage in a browser on this machine, again and again, until interrupted.

    Raises:
        SceneError: no stage, or Newton or Viser is missing.
    """
    scene = NewtonScene(path)
    viewer = _viewer(scene.model, port, True)
    _look_through(scene.cameras.get(_DEFAULT), viewer)
    code, shown = scene.start, 0.0
    try:
        while True:
            if viewer.should_step():
                code = scene.start if code >= scene.end else code + 1.0
                shown += 1.0 / FRAMES_PER_SECOND
                scene.update(code)
            viewer.begin_frame(shown)
            viewer.log_state(scene.state)
            viewer.end_frame()
            clock.sleep(1.0 / FRAMES_PER_SECOND)
    except KeyboardInterrupt:
        pass
    finally:
        viewer.close()
