"""A USD stage as a Newton model that is only looked at: every gprim a shape, curves as capsules."""

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.errors import SceneError, needed_extras
from wrod.scene.validate import open_stage

# Time codes, shapes, points of one shape, and metres beyond which nothing of ours is.
_LATEST, _MOST_PARTS, _MOST_POINTS, _FARTHEST = 1e9, 5_000, 1_000_000, 1e6
_MOVES = 1e-9  # [m] a prim that moves less stands still
_AWAY = 1e3  # [m] below, where what is invisible for a time is kept


@dataclass
class _Part:
    """A gprim of the stage and the rows of the model's shapes that show it."""

    prim: Any
    kind: str
    size: np.ndarray
    color: tuple[float, float, float]
    moving: bool
    first: int = -1  # first body, -1 where it stands still
    shape: int = -1  # first shape
    count: int = 1


class NewtonScene:
    """A stage in Newton, for its cameras and viewers.

    Args:
        path: a stage of `export_usd`, or any stage of spheres, cylinders, capsules, boxes, meshes
            and linear curves.
        hidden: names of prims that are left out with all below them (`robot`, ...).

    Attributes:
        stage: the stage; `cameras` are its cameras by name.
        model, state: of Newton; `state.body_q` holds the poses of the last `update`.
        start, end: first and last time code.

    Raises:
        SceneError: the file is no stage, nothing in it can be shown, or a hidden name is unknown.
    """

    @needed_extras()
    def __init__(self, path: str | os.PathLike[str], hidden: tuple[str, ...] = ()):
        import wrod.kernels  # noqa: F401  # before Newton: starts Warp quietly

        # isort: split
        import newton
        from pxr import UsdGeom

        self._path = path
        self.stage = open_stage(path)
        self.cameras = {
            prim.GetName(): prim for prim in self.stage.Traverse() if prim.IsA(UsdGeom.Camera)
        }
        self.start, self.end = self.stage.GetStartTimeCode(), self.stage.GetEndTimeCode()
        if not all(abs(time) <= _LATEST for time in (self.start, self.end)):
            raise SceneError(f"{path}: its time codes run from {self.start:g} to {self.end:g}")
        self._parts = self._collect(path, hidden)
        builder = newton.ModelBuilder()
        for part in self._parts:
            self._add(builder, part)
        self.model = builder.finalize(skip_validation_inertia=True)  # nothing weighs
        self.state = self.model.state()
        self._poses = self.state.body_q.numpy() if self.model.body_count else np.zeros((0, 7))
        self._scales = self.model.shape_scale.numpy()
        self.update(self.start)

    def camera(self, name: str):
        """The prim of a camera.

        Raises:
            SceneError: the stage has no camera of that name, or its field of view is none.
        """
        from pxr import UsdGeom

        if name not in self.cameras:
            raise SceneError(
                f"{self._path}: no camera {name!r}; its cameras are "
                f"{', '.join(self.cameras) or 'none'}"
            )
        lens = UsdGeom.Camera(self.cameras[name]).GetCamera()
        if not 0.0 < lens.GetFieldOfView(lens.FOVVertical) < 180.0:
            raise SceneError(
                f"{self._path}: camera {name!r} has a focal length of {lens.focalLength:g} and an "
                f"aperture of {lens.verticalAperture:g}; both must be positive numbers"
            )
        return self.cameras[name]

    def update(self, time: float) -> None:
        """Move everything to a time code."""
        from pxr import UsdGeom

        cache = UsdGeom.XformCache(time)
        for part in self._parts:
            if not part.moving:
                continue
            rows = slice(part.first, part.first + part.count)
            if part.kind == "curve":
                poses, half = _capsules(part.prim, time, cache)
                self._poses[rows] = poses
                self._scales[part.shape : part.shape + part.count, 1] = half
            else:
                self._poses[rows] = _pose7(_world(part.prim, cache))
            if UsdGeom.Imageable(part.prim).ComputeVisibility(time) == UsdGeom.Tokens.invisible:
                self._poses[rows, 2] -= _AWAY
        if self.model.body_count:
            self.state.body_q.assign(self._poses.astype(np.float32))
        self.model.shape_scale.assign(self._scales)
        self.model.bvh_refit_shapes(self.state)

    def _collect(self, path, hidden: tuple[str, ...]) -> list[_Part]:
        from pxr import Usd, UsdGeom

        unknown = set(hidden)
        parts = []
        times = np.linspace(self.start, self.end, 7) if self.end > self.start else [self.start]
        caches = [UsdGeom.XformCache(t) for t in times]
        walk = iter(Usd.PrimRange(self.stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
        for prim in walk:
            if prim.GetName() in hidden:
                unknown.discard(prim.GetName())
                walk.PruneChildren()
                continue
            shape = _shape_of(prim)
            if shape is None:
                continue
            kind, size = shape
            worlds = [_world(prim, cache) for cache in caches]
            _check_part(path, prim, kind, size, worlds)
            if len(parts) >= _MOST_PARTS:
                raise SceneError(f"{path}: holds more than {_MOST_PARTS} shapes; hide some")
            moving = any(np.abs(w - worlds[0]).max() > _MOVES for w in worlds[1:])
            moving |= UsdGeom.Imageable(prim).GetVisibilityAttr().GetNumTimeSamples() > 1
            if kind == "curve":
                moving |= UsdGeom.Points(prim).GetPointsAttr().GetNumTimeSamples() > 1
            given = UsdGeom.Gprim(prim).GetDisplayColorAttr().Get()
            red, green, blue = (
                np.nan_to_num(np.clip(given[0], 0.0, 1.0)) if given else (0.5, 0.5, 0.5)
            )
            color = (float(red), float(green), float(blue))
            parts.append(_Part(prim, kind, size, color, moving))
        if unknown:
            raise SceneError(f"{path}: no prim is named {', '.join(sorted(unknown))}")
        if not parts:
            raise SceneError(f"{path}: holds nothing that can be shown")
        return parts

    def _add(self, builder, part: _Part) -> None:
        import newton
        from pxr import UsdGeom

        cache = UsdGeom.XformCache(self.start)
        weightless = newton.ModelBuilder.ShapeConfig(density=0.0)
        color = tuple(float(c) ** (1 / 2.2) for c in part.color)
        label = str(part.prim.GetPath())
        if part.kind == "curve":
            poses, half = _capsules(part.prim, self.start, cache)
            part.count, size = len(poses), np.column_stack([np.full(len(half), part.size[0]), half])
        else:
            poses, size = _pose7(_world(part.prim, cache))[None], part.size[None]
        part.first, part.shape = builder.body_count, builder.shape_count
        for pose, extent in zip(poses, size, strict=True):
            body, place = -1, pose
            if part.moving:
                body, place = builder.add_body(xform=pose, is_kinematic=True, label=label), None
            options = {"xform": place, "color": color, "label": label, "cfg": weightless}
            if part.kind == "sphere":
                builder.add_shape_sphere(body, radius=extent[0], **options)
            elif part.kind == "cylinder":
                builder.add_shape_cylinder(body, radius=extent[0], half_height=extent[1], **options)
            elif part.kind == "box":
                hx, hy, hz = map(float, extent)
                builder.add_shape_box(body, hx=hx, hy=hy, hz=hz, **options)
            elif part.kind == "mesh":
                mesh = UsdGeom.Mesh(part.prim)
                points = np.array(mesh.GetPointsAttr().Get(self.start), dtype=np.float32)
                faces = np.array(mesh.GetFaceVertexIndicesAttr().Get(self.start), dtype=np.int32)
                builder.add_shape_mesh(
                    body, mesh=newton.Mesh(points, faces, compute_inertia=False), **options
                )
            else:
                builder.add_shape_capsule(body, radius=extent[0], half_height=extent[1], **options)


def _check_part(path, prim, kind: str, size, worlds: list[np.ndarray]) -> None:
    """Refuse a shape that cannot be drawn, which Newton would not.

    Raises:
        SceneError: names the prim.
    """
    from pxr import Usd, UsdGeom

    where, time = f"{path}: {prim.GetPath()}", Usd.TimeCode.EarliestTime()
    if size.dtype.kind not in "fiu" or not (np.isfinite(size) & (size > 0.0)).all():
        raise SceneError(f"{where} is a {kind} without a size: {size.tolist()}")
    if not all((np.abs(world) <= _FARTHEST).all() for world in worlds):
        raise SceneError(f"{where} has no place: its transformation is flat, or not finite")
    if kind not in ("mesh", "curve"):
        return
    gprim = UsdGeom.PointBased(prim)
    points = np.array(gprim.GetPointsAttr().Get(time) or [], dtype=float).reshape(-1, 3)
    if not len(points) or len(points) > _MOST_POINTS or not (np.abs(points) <= _FARTHEST).all():
        raise SceneError(
            f"{where} has {len(points)} points, of which none may be missing, farther than "
            f"{_FARTHEST:g} m, or not finite; at most {_MOST_POINTS} are drawn"
        )
    if kind == "curve":
        counts = np.array(UsdGeom.BasisCurves(prim).GetCurveVertexCountsAttr().Get(time) or [0])
        if counts.min() < 2 or counts.sum() != len(points):
            raise SceneError(f"{where} has {len(points)} points in curves of {counts.tolist()}")
        return
    faces = np.array(UsdGeom.Mesh(prim).GetFaceVertexIndicesAttr().Get(time) or [-1])
    triangles = len(UsdGeom.Mesh(prim).GetFaceVertexCountsAttr().Get(time))
    if len(faces) != 3 * triangles or faces.min() < 0 or faces.max() >= len(points):
        raise SceneError(f"{where} has faces of points that are not there")


def _shape_of(prim) -> tuple[str, np.ndarray] | None:
    """Kind and size in Newton's terms (half extents) of a gprim, or None."""
    from pxr import Usd, UsdGeom

    time = Usd.TimeCode.EarliestTime()
    if prim.IsA(UsdGeom.Sphere):
        return "sphere", _sizes(UsdGeom.Sphere(prim).GetRadiusAttr().Get(time))
    for schema, kind in ((UsdGeom.Cylinder, "cylinder"), (UsdGeom.Capsule, "capsule")):
        if prim.IsA(schema):
            gprim = schema(prim)
            if gprim.GetAxisAttr().Get() != UsdGeom.Tokens.z:
                raise SceneError(f"{prim.GetPath()}: only cylinders along z are shown")
            values = gprim.GetRadiusAttr().Get(time), gprim.GetHeightAttr().Get(time)
            return kind, _sizes(*values) * [1.0, 0.5]
    if prim.IsA(UsdGeom.Cube):
        scale = np.ones(3)
        for op in UsdGeom.Xformable(prim).GetOrderedXformOps():
            if op.GetOpType() == UsdGeom.XformOp.TypeScale:
                scale *= np.array(op.Get(time))
        return "box", scale * _sizes(UsdGeom.Cube(prim).GetSizeAttr().Get(time)) / 2
    if prim.IsA(UsdGeom.BasisCurves):
        widths = UsdGeom.BasisCurves(prim).GetWidthsAttr().Get(time)
        return "curve", np.array([widths[0] / 2 if widths else 0.001])
    if prim.IsA(UsdGeom.Mesh):
        counts = UsdGeom.Mesh(prim).GetFaceVertexCountsAttr().Get(time)
        return ("mesh", np.ones(1)) if counts and set(counts) == {3} else None
    return None


def _sizes(*values) -> np.ndarray:
    """As an array; NaN where the stage has none."""
    return np.array([np.nan if value is None else value for value in values], dtype=float)


def _world(prim, cache) -> np.ndarray:
    """(4, 4) column-vector pose of a prim in the world, its scale removed."""
    matrix = np.array(cache.GetLocalToWorldTransform(prim)).T
    with np.errstate(invalid="ignore", divide="ignore"):  # `_check_part` says it
        matrix[:3, :3] /= np.linalg.norm(matrix[:3, :3], axis=0)
    return matrix


def _pose7(pose: np.ndarray) -> np.ndarray:
    return np.concatenate([pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_quat()])


def _capsules(prim, time: float, cache) -> tuple[np.ndarray, np.ndarray]:
    """Poses (M - 1, 7) and half lengths (M - 1,) of the segments of all curves of a prim."""
    from pxr import UsdGeom

    curve = UsdGeom.BasisCurves(prim)
    world = _world(prim, cache)
    points = np.array(curve.GetPointsAttr().Get(time), dtype=np.float64)
    points = points @ world[:3, :3].T + world[:3, 3]
    counts = np.array(curve.GetCurveVertexCountsAttr().Get(time))
    joined = np.ones(len(points) - 1, bool)
    joined[np.cumsum(counts)[:-1] - 1] = False
    start, delta = points[:-1][joined], np.diff(points, axis=0)[joined]
    length = np.linalg.norm(delta, axis=1)
    along = np.where(length[:, None] > 1e-12, delta / np.maximum(length, 1e-12)[:, None], [0, 0, 1])
    # Shortest turn from z: (cross, 1 + cos), a half turn about x where they are opposite.
    quaternion = np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(along)), 1 + along[:, 2]])
    quaternion[along[:, 2] < -1 + 1e-9] = [1.0, 0.0, 0.0, 0.0]
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    return np.column_stack([start + delta / 2, quaternion]), length / 2
