"""A stage in metres, Z up, with time codes; its lights and cameras, and its file."""

import os
import tempfile
from pathlib import Path

import numpy as np

from wrod.errors import SceneError
from wrod.files import write_atomically

SUFFIXES = (".usdc", ".usda", ".usd")
FRAMES_PER_SECOND = 24.0
_VIEW = 36.0  # [deg] that a view sees, upright
_FILLED = float(np.tan(np.radians(_VIEW) / 2)) / 1.12  # tangent of half the angle that is filled


def stage_path(path: str | os.PathLike[str]) -> Path:
    """The path of a stage to be written.

    Raises:
        SceneError: it has another suffix.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise SceneError(f"{path}: a stage needs one of the suffixes {', '.join(SUFFIXES)}")
    return path


def write_stage(stage, path: Path) -> Path:
    """Write a stage, whole or not at all.

    Raises:
        SceneError: OpenUSD could not.
    """
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / f"scene{path.suffix}"
        if not stage.GetRootLayer().Export(str(draft)):
            raise SceneError(f"{path}: the stage could not be written")
        data = draft.read_bytes()
    return write_atomically(path, lambda file: file.write(data), "wb")


def set_in_time(prim, name: str, values, codes) -> None:
    """A number of a prim at time codes."""
    from pxr import Sdf

    attribute = prim.CreateAttribute(name, Sdf.ValueTypeNames.Double, custom=True)
    for code, value in zip(codes, values, strict=True):
        attribute.Set(float(value), float(code))


def new_stage(first: float, last: float):
    """In-memory stage of time codes `first` to `last`."""
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.CreateInMemory("scene.usda")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetTimeCodesPerSecond(FRAMES_PER_SECOND)
    stage.SetFramesPerSecond(FRAMES_PER_SECOND)
    stage.SetStartTimeCode(float(first))
    stage.SetEndTimeCode(float(last))
    world = UsdGeom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(world.GetPrim())
    return stage


def add_lights(stage) -> None:
    """A sun from above and behind the viewer, and an even sky."""
    from pxr import Gf, UsdGeom, UsdLux

    UsdGeom.Scope.Define(stage, "/World/Lights")
    sun = UsdLux.DistantLight.Define(stage, "/World/Lights/sun")
    sun.CreateIntensityAttr(2.5)
    sun.CreateAngleAttr(2.0)
    sun.AddRotateXYZOp().Set(Gf.Vec3f(-30.0, 25.0, 0.0))
    sky = UsdLux.DomeLight.Define(stage, "/World/Lights/sky")
    sky.CreateIntensityAttr(0.6)
    sky.CreateColorAttr(Gf.Vec3f(0.93, 0.96, 1.0))


def add_camera(stage, name: str, eye, target, up=(0.0, 0.0, 1.0), fov: float = 40.0):
    """Perspective camera at `eye`, 4:3, with a vertical field of view [degrees]."""
    from pxr import Gf, UsdGeom

    UsdGeom.Scope.Define(stage, "/World/Cameras")
    camera = UsdGeom.Camera.Define(stage, f"/World/Cameras/{name}")
    view = Gf.Matrix4d().SetLookAt(Gf.Vec3d(*eye), Gf.Vec3d(*target), Gf.Vec3d(*up))
    camera.AddTransformOp().Set(view.GetInverse())
    camera.CreateHorizontalApertureAttr(36.0)
    camera.CreateVerticalApertureAttr(27.0)
    camera.CreateFocalLengthAttr(float(13.5 / np.tan(np.radians(fov) / 2)))
    camera.CreateFocusDistanceAttr(float(np.linalg.norm(np.subtract(eye, target))))
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.01, 200.0))
    return camera


def add_cameras(stage, points: np.ndarray, front: np.ndarray, pattern: np.ndarray) -> np.ndarray:
    """`top`, high over the pattern, and `perspective` on everything.

    Args:
        points: (n, 3) of what `perspective` must see [m].
        front: (2,) horizontal direction that the robot faces.
        pattern: (2, 3) corners of what `top` must see [m].

    Returns:
        (3,) whence `perspective` looks.
    """
    corners = np.asarray(pattern, dtype=float)
    fov, middle = 14.0, corners.mean(0)
    half = np.ptp(corners[:, :2], axis=0) / 2
    # The image is 4:3 with its upper edge towards +y, as a camera hung over the table gives it.
    height = 1.08 * max(half[1], half[0] * 3 / 4) / np.tan(np.radians(fov) / 2)
    eye = (middle[0], middle[1], corners[:, 2].max() + height)
    add_camera(stage, "top", eye, middle, (0.0, 1.0, 0.0), fov)

    back = np.array([*(0.80 * front + 0.95 * np.array([front[1], -front[0]])), 0.50])
    add_view(stage, "perspective", points, back)
    return back


def add_view(stage, name: str, points: np.ndarray, back, later: dict | None = None) -> None:
    """Camera that looks at all of points (n, 3) [m] from the direction `back` (3,).

    Args:
        later: time code -> other points to look at; the camera moves between codes.
    """
    eye, middle = standing(points, back)
    camera = add_camera(stage, name, eye, middle, fov=_VIEW)
    if later:
        from pxr import Gf

        (place,) = camera.GetOrderedXformOps()
        for code, other in later.items():
            eye, middle = standing(other, back)
            view = Gf.Matrix4d().SetLookAt(Gf.Vec3d(*eye), Gf.Vec3d(*middle), Gf.Vec3d(0, 0, 1))
            place.Set(view.GetInverse(), float(code))


def standing(
    points: np.ndarray, back, wide: float = 4 / 3, tangent: float = _FILLED
) -> tuple[np.ndarray, np.ndarray]:
    """Where a camera stands (3,) that looks at all of points (n, 3), and what it looks at (3,) [m].

    Args:
        back: (3,) direction from which it looks.
        wide: width over height of its picture.
        tangent: of half the angle, upright, that the points are to fill.
    """
    back = np.asarray(back, dtype=float) / np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    frame = np.stack([right, np.cross(back, right), back])
    local = points @ frame.T
    middle = (local.min(0) + local.max(0)) / 2
    across = (np.abs(local - middle)[:, :2] / [wide, 1.0]).max(1)
    distance = (local[:, 2] - middle[2] + across / tangent).max()
    return (middle + [0.0, 0.0, distance]) @ frame, middle @ frame
