"""USD curves as cables, in and out.

A cable is a linear `UsdGeom.BasisCurves` with the attributes that Newton's own importer reads (the
proposal for deformable bodies in UsdPhysics): `physics:curvesBendStiffness` [N m^2],
`curvesTwistStiffness` [N m^2] and `curvesStretchStiffness` [N], or `youngsModulus` [Pa] and
`poissonsRatio`, and `density` [kg/m^3] on its physics material; `physics:thicknesses` (diameters)
or `widths` on the curve. Of wrod's own, on the curve: `wrod:airDamping` [1/s],
`wrod:internalDamping` [s], `wrod:start` and `wrod:end` ("free", "pinned" or "clamped", to the
world).
"""

from pathlib import Path

import newton
import numpy as np
from newton.usd import has_applied_api_schema

from wrod.errors import RodError
from wrod.newton_solver.attributes import HOLDS
from wrod.rods.discretisation import cells
from wrod.rods.model import RodModel

_SIMULATED, _MATERIAL = "PhysicsCurvesDeformableSimAPI", "PhysicsCurvesDeformableMaterialAPI"
_POISSON = 0.5
_PLACES = ("start", "end")
_DAMPINGS = {"air_damping": "wrod:airDamping", "internal_damping": "wrod:internalDamping"}


def add_curves(builder, source, add, **options) -> dict[str, list[int]]:
    """`SolverDER.add_usd`, which documents the arguments; `add` is `SolverDER.add_rod`."""
    from pxr import Usd, UsdGeom

    from wrod.scene.validate import open_stage

    stage = source
    if not isinstance(source, Usd.Stage):
        if not Path(source).is_file():
            raise RodError(f"there is no USD file {str(source)!r}")
        stage = open_stage(source)
    metre = UsdGeom.GetStageMetersPerUnit(stage)
    if not 1e-9 <= metre <= 1e6:
        raise RodError(f"metersPerUnit is {metre:g}; it must be from 1e-9 to 1e6")
    upright = np.eye(3)
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y:
        upright = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    found = {}
    cache = UsdGeom.XformCache()
    for prim in stage.Traverse():
        if not (prim.IsA(UsdGeom.BasisCurves) and has_applied_api_schema(prim, _SIMULATED)):
            continue
        path, curves = str(prim.GetPath()), UsdGeom.BasisCurves(prim)
        kind, wrap = curves.GetTypeAttr().Get(), curves.GetWrapAttr().Get()
        if kind != UsdGeom.Tokens.linear or wrap == UsdGeom.Tokens.periodic:
            raise RodError(f"{path} is {kind} and {wrap}; cables are linear curves with two ends")
        points = np.array(curves.GetPointsAttr().Get() or np.zeros((0, 3)), dtype=float)
        counts = np.array(curves.GetCurveVertexCountsAttr().Get() or [], dtype=int)
        if not len(counts) or counts.sum() != len(points) or counts.min() < 3:
            raise RodError(f"{path} has {len(points)} points in curves of {counts.tolist()}")
        world = np.array(cache.GetLocalToWorldTransform(prim))
        points = metre * (points @ world[:3, :3] + world[3, :3]) @ upright.T
        held = {side: prim.GetAttribute(f"wrod:{side}").Get() or "free" for side in _PLACES}
        damped = {
            name: prim.GetAttribute(at).Get()
            for name, at in _DAMPINGS.items()
            if prim.GetAttribute(at).HasAuthoredValue()
        }
        starts = np.concatenate([[0], np.cumsum(counts)])
        for k, count in enumerate(counts):
            of_one = points[starts[k] : starts[k] + count]
            length = float(np.linalg.norm(np.diff(of_one, axis=0), axis=1).sum())
            model = _model(prim, curves, k, len(counts), length, metre)
            label = path if len(counts) == 1 else f"{path}/{k}"
            rod = add(builder, of_one, model, label=label, **held, **(damped | options))
            found.setdefault(path, []).append(rod)
    return found


def _model(prim, curves, k: int, many: int, length: float, metre: float) -> RodModel:
    from pxr import UsdShade

    path = prim.GetPath()
    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
    if not material or not has_applied_api_schema(material.GetPrim(), _MATERIAL):
        raise RodError(f"{path} has no physics material with {_MATERIAL}; bind one to it")

    def of(name: str):
        return material.GetPrim().GetAttribute(f"physics:{name}").Get()

    widths = prim.GetAttribute("physics:thicknesses").Get() or curves.GetWidthsAttr().Get()
    widths = np.unique(np.array(widths if widths is not None else [], dtype=float))
    if len(widths) == many and many > 1:
        widths = np.array(curves.GetWidthsAttr().Get(), dtype=float)[[k]]
    if len(widths) != 1:
        raise RodError(f"{path} has widths {widths.tolist()}; give one for the whole curve")
    radius = 0.5 * metre * widths[0]
    area, second = np.pi * radius**2, 0.25 * np.pi * radius**4
    young, poisson = of("youngsModulus"), of("poissonsRatio")
    poisson = _POISSON if poisson is None else poisson
    stiffness = []
    # Stages are in their own unit of length and in kilograms: N m^2 = kg m^3 / s^2.
    for mode, power, factor in (
        ("Bend", 3, second), ("Twist", 3, second / (1.0 + poisson)), ("Stretch", 1, area),
    ):  # fmt: skip
        value = of(f"curves{mode}Stiffness")
        if value is None and young is None:
            raise RodError(f"{path}'s material has no physics:curves{mode}Stiffness")
        stiffness.append(young / metre * factor if value is None else value * metre**power)
    density = of("density")
    if not density:
        raise RodError(f"{path}'s material has no physics:density")
    return RodModel(
        length=length, bending_stiffness=(stiffness[0],) * 2, twisting_stiffness=stiffness[1],
        stretching_stiffness=stiffness[2], line_mass=density / metre**3 * area, radius=radius,
    )  # fmt: skip


def write_curves(model: newton.Model, state: newton.State, path: str | Path) -> Path:
    """`SolverDER.write_usd`, which documents the arguments."""
    from pxr import Sdf, Usd, UsdGeom, UsdShade, Vt

    path, der = Path(path), model.der
    if path.suffix not in (".usd", ".usda", ".usdc"):
        raise RodError(f"{str(path)!r} is no USD file; end it with .usd, .usda or .usdc")
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/cables").GetPrim())
    arrays = {name: getattr(der, name).numpy() for name in (
        "rod_first_node", "rod_first_edge", "rod_node_count", "rod_radius", "rod_air_damping",
        "rod_internal_damping", "rod_start_hold", "rod_end_hold", "rod_start_body", "rod_end_body",
        "node_mass", "node_bending_stiffness", "node_twisting_stiffness", "node_natural_curvature",
        "node_natural_twist", "node_inelastic", "node_softening", "rod_quadratic_drag",
        "edge_rest_length", "edge_stretching_stiffness",
    )}  # fmt: skip
    names = {kind: name for name, kind in HOLDS.items()}
    for rod in range(len(arrays["rod_node_count"])):
        of = {name: values[rod] for name, values in arrays.items() if name.startswith("rod")}
        nodes = slice(of["rod_first_node"], of["rod_first_node"] + of["rod_node_count"])
        edges = slice(of["rod_first_edge"], of["rod_first_edge"] + of["rod_node_count"] - 1)
        bend, twist, stretch = _uniform(arrays, nodes, edges, rod)
        prim = f"/cables/cable_{rod}"
        curves = UsdGeom.BasisCurves.Define(stage, prim)
        points = state.der.node_q.numpy()[nodes].astype(np.float32)
        curves.CreateTypeAttr(UsdGeom.Tokens.linear)
        curves.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
        curves.CreateCurveVertexCountsAttr([len(points)])
        curves.CreateWidthsAttr([2.0 * of["rod_radius"]])
        curves.SetWidthsInterpolation(UsdGeom.Tokens.constant)
        body = curves.GetPrim()
        body.AddAppliedSchema(_SIMULATED)
        thick = body.CreateAttribute("physics:thicknesses", Sdf.ValueTypeNames.FloatArray)
        thick.Set([2.0 * of["rod_radius"]])
        of_what = body.CreateAttribute("physics:thicknesses:elementType", Sdf.ValueTypeNames.Token)
        of_what.Set("constant")
        for side in _PLACES:
            held = names[int(of[f"rod_{side}_hold"])] if of[f"rod_{side}_body"] < 0 else "free"
            body.CreateAttribute(f"wrod:{side}", Sdf.ValueTypeNames.Token).Set(held)
        for name, at in _DAMPINGS.items():
            body.CreateAttribute(at, Sdf.ValueTypeNames.Double).Set(float(of[f"rod_{name}"]))
        material = UsdShade.Material.Define(stage, f"{prim}/material")
        material.GetPrim().AddAppliedSchema(_MATERIAL)
        volume = np.pi * of["rod_radius"] ** 2 * arrays["edge_rest_length"][edges].sum()
        for name, value in {
            "curvesBendStiffness": bend, "curvesTwistStiffness": twist,
            "curvesStretchStiffness": stretch,
            "density": arrays["node_mass"][nodes].sum() / volume,
        }.items():  # fmt: skip
            at = material.GetPrim().CreateAttribute(f"physics:{name}", Sdf.ValueTypeNames.Float)
            at.Set(float(value))
        UsdShade.MaterialBindingAPI.Apply(body).Bind(material, materialPurpose="physics")
    path.parent.mkdir(parents=True, exist_ok=True)
    stage.Export(str(path))
    return path


def _uniform(arrays: dict, nodes: slice, edges: slice, rod: int) -> list[float]:
    """Bending, twisting and stretching stiffness of a rod that USD has words for."""
    more = [arrays[f"node_{name}"][nodes] for name in ("natural_curvature", "natural_twist")]
    more += [arrays["node_inelastic"][nodes][:, :3], arrays["node_softening"][nodes][:, 0]]
    more.append(arrays["rod_quadratic_drag"][rod])
    inner = slice(nodes.start + 1, nodes.stop - 1)
    of = (
        arrays["node_bending_stiffness"][inner].ravel(),
        arrays["node_twisting_stiffness"][inner],
        arrays["edge_stretching_stiffness"][edges],
        arrays["node_mass"][nodes] / cells(arrays["edge_rest_length"][None, edges])[0],
    )
    varies = any(np.ptp(values) > 1e-6 * np.abs(values).max() for values in of)
    if varies or any(np.any(values != 0) for values in more):
        raise RodError(
            f"rod {rod} varies along itself or in direction, is not straight at rest, softens, has "
            "a past or quadratic drag; USD has no words for that"
        )
    return [float(values.mean()) for values in of[:3]]
