"""Shapes, curves, poses and materials on a USD stage."""

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.rods.rotation import one_hemisphere

_MATERIALS = "/World/Materials"


class Materials:
    """Preview materials of a stage, one per colour."""

    def __init__(self, stage):
        from pxr import UsdGeom

        self._stage, self._known = stage, {}
        UsdGeom.Scope.Define(stage, _MATERIALS)

    def bind(self, prim, color) -> None:
        """Give a gprim a colour (linear RGB): display colour and preview surface."""
        from pxr import Gf, Sdf, UsdGeom, UsdShade

        color = tuple(round(float(c), 4) for c in color)
        if color not in self._known:
            path = f"{_MATERIALS}/material_{len(self._known):02d}"
            material = UsdShade.Material.Define(self._stage, path)
            shader = UsdShade.Shader.Define(self._stage, f"{path}/surface")
            shader.CreateIdAttr("UsdPreviewSurface")
            kinds = Sdf.ValueTypeNames
            shader.CreateInput("diffuseColor", kinds.Color3f).Set(Gf.Vec3f(*color))
            shader.CreateInput("roughness", kinds.Float).Set(0.55)
            shader.CreateInput("metallic", kinds.Float).Set(0.0)
            output = shader.CreateOutput("surface", kinds.Token)
            material.CreateSurfaceOutput().ConnectToSource(output)
            self._known[color] = material
        UsdGeom.Gprim(prim).CreateDisplayColorAttr([Gf.Vec3f(*color)])
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(self._known[color])


def set_pose(prim, poses: np.ndarray, times=None) -> None:
    """Pose of an Xform or gprim in its parent, static (4, 4) or at time codes (T, 4, 4).

    Parts that do not move are written once.
    """
    from pxr import Gf, UsdGeom

    poses = np.asarray(poses, dtype=np.float64).reshape(-1, 4, 4)
    translations = poses[:, :3, 3]
    # Readers interpolate: neighbours must not take the long way.
    quaternions = one_hemisphere(Rotation.from_matrix(poses[:, :3, :3]).as_quat())  # x, y, z, w
    xform = UsdGeom.Xformable(prim)

    def write(op, values, make):
        op.Set(make(values[0]))  # what readers see that know no time
        if times is None or np.ptp(values, axis=0).max() < 1e-12:
            return
        for code, value in zip(times, values, strict=True):
            op.Set(make(value), float(code))

    precision = UsdGeom.XformOp.PrecisionDouble
    write(xform.AddTranslateOp(precision), translations, lambda v: Gf.Vec3d(*map(float, v)))
    write(
        xform.AddOrientOp(precision),
        quaternions,
        lambda v: Gf.Quatd(float(v[3]), Gf.Vec3d(*map(float, v[:3]))),
    )


def add_shape(stage, path: str, kind: str, size, pose, materials: Materials, color):
    """Define a sphere, cylinder (along z) or box with its extent, pose and material."""
    from pxr import Gf, UsdGeom

    if kind == "sphere":
        gprim = UsdGeom.Sphere.Define(stage, path)
        gprim.CreateRadiusAttr(float(size[0]))
        reach = np.full(3, size[0])
    elif kind == "cylinder":
        gprim = UsdGeom.Cylinder.Define(stage, path)
        gprim.CreateRadiusAttr(float(size[0]))
        gprim.CreateHeightAttr(float(size[1]))
        gprim.CreateAxisAttr(UsdGeom.Tokens.z)
        reach = np.array([size[0], size[0], size[1] / 2])
    else:
        gprim = UsdGeom.Cube.Define(stage, path)
        gprim.CreateSizeAttr(1.0)
        reach = np.full(3, 0.5)
    gprim.CreateExtentAttr([Gf.Vec3f(*map(float, -reach)), Gf.Vec3f(*map(float, reach))])
    set_pose(gprim.GetPrim(), pose)
    if kind == "box":
        gprim.AddScaleOp().Set(Gf.Vec3f(*map(float, size)))
    materials.bind(gprim.GetPrim(), color)
    return gprim


def add_mesh(stage, path: str, vertices, faces, scale, pose, materials: Materials, color):
    """Define a triangle mesh."""
    from pxr import UsdGeom, Vt

    mesh = UsdGeom.Mesh.Define(stage, path)
    points = np.ascontiguousarray(vertices * np.asarray(scale), dtype=np.float32)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(
        Vt.IntArray.FromNumpy(np.ascontiguousarray(faces, np.int32).ravel())
    )
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(
        Vt.Vec3fArray.FromNumpy(np.stack([points.min(0), points.max(0)]).astype(np.float32))
    )
    set_pose(mesh.GetPrim(), pose)
    materials.bind(mesh.GetPrim(), color)
    return mesh


def add_curve(stage, path: str, points, width: float, materials: Materials, color, times=None):
    """Define a tube of round section along a polyline, still (M, 3) or moving (T, M, 3) [m].

    Args:
        width: diameter of the tube [m].
        times: (T,) time codes of a moving one.
    """
    from pxr import Usd, UsdGeom, Vt

    points = np.asarray(points, dtype=np.float32)
    moving = points.ndim == 3
    frames = points if moving else points[None]
    curve = UsdGeom.BasisCurves.Define(stage, path)
    curve.CreateTypeAttr(UsdGeom.Tokens.linear)
    curve.CreateWrapAttr(UsdGeom.Tokens.nonperiodic)
    curve.CreateCurveVertexCountsAttr(Vt.IntArray([frames.shape[1]]))
    curve.CreateWidthsAttr(Vt.FloatArray([float(width)]))
    curve.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    position, extent = curve.CreatePointsAttr(), curve.CreateExtentAttr()
    pad = np.float32(width / 2)
    codes = [Usd.TimeCode.Default()]  # what readers see that know no time
    if moving:
        frames = np.concatenate([frames[:1], frames])
        codes += [Usd.TimeCode(float(code)) for code in times]
    for code, frame in zip(codes, frames, strict=True):
        bounds = np.stack([frame.min(0) - pad, frame.max(0) + pad])
        position.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(frame)), code)
        extent.Set(Vt.Vec3fArray.FromNumpy(bounds), code)
    materials.bind(curve.GetPrim(), color)
    return curve
