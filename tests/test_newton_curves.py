"""Cables in USD files: what is written is read, by Newton's own importer too."""

from dataclasses import replace

import newton
import numpy as np
import pytest
from chosen import DEVICE
from pxr import Usd, UsdGeom

import wrod
from wrod.errors import RodError
from wrod.rods.law import Softening

RADIUS, LENGTH = 0.004, 0.5


def scene(**changes):
    builder = newton.ModelBuilder()
    wrod.SolverDER.register_custom_attributes(builder)
    x = np.linspace(0.0, LENGTH, 21)
    for k, young in enumerate((2e6, 6e6)):
        material = wrod.RodMaterial.from_youngs_modulus(young, RADIUS, LENGTH, density=1150.0)
        rod = replace(wrod.RodModel.of(material), **changes)
        points = np.column_stack([x, 0.1 * k + 0 * x, 0.3 + 0.1 * np.sin(2 * x)])
        wrod.SolverDER.add_rod(
            builder, points, rod, start="clamped", internal_damping=0.01 * (k + 1)
        )
    return builder.finalize(device=DEVICE)


def read(source):
    builder = newton.ModelBuilder()
    wrod.SolverDER.register_custom_attributes(builder)
    found = wrod.SolverDER.add_usd(builder, source)
    return found, builder.finalize(device=DEVICE)


def test_there_and_back(tmp_path):
    model = scene()
    path = wrod.SolverDER.write_usd(model, model.state(), tmp_path / "cables.usda")
    found, again = read(path)
    assert list(found.values()) == [[0], [1]]
    for name in (
        "node_q", "node_mass", "node_bending_stiffness", "node_twisting_stiffness",
        "edge_stretching_stiffness", "rod_radius", "rod_internal_damping", "rod_start_hold",
    ):  # fmt: skip
        a, b = (getattr(m.der, name).numpy() for m in (model, again))
        assert b == pytest.approx(a, rel=1e-5, abs=1e-7), name


def test_newtons_importer_reads_the_same_cables(tmp_path):
    pytest.importorskip("newton_usd_schemas", reason="newton's USD importer needs its schemas")
    model = scene()
    path = wrod.SolverDER.write_usd(model, model.state(), tmp_path / "cables.usda")
    builder = newton.ModelBuilder()
    builder.add_usd(str(path))
    assert builder.body_count == 40
    sizes = np.array([list(v) for v in builder.shape_scale])
    assert sizes[:, 0] == pytest.approx(RADIUS)
    lengths = np.linalg.norm(np.diff(model.der.node_q.numpy()[:21], axis=0), axis=1)
    assert sizes[:20, 1] == pytest.approx(0.5 * lengths, rel=1e-5)
    total = model.der.node_mass.numpy().sum()
    assert sum(builder.body_mass) == pytest.approx(total, rel=1e-4)


def test_units_and_axes_of_the_stage(tmp_path):
    """Centimetres, y up, and moved: the cable is where the stage has it."""
    model = scene()
    path = wrod.SolverDER.write_usd(model, model.state(), tmp_path / "cables.usda")
    stage = Usd.Stage.Open(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.Xformable(stage.GetPrimAtPath("/cables")).AddTranslateOp().Set((0.0, 5.0, 0.0))
    _, moved = read(stage)
    a, b = model.der.node_q.numpy(), moved.der.node_q.numpy()
    assert b == pytest.approx(0.01 * np.column_stack([a[:, 0], -a[:, 2], a[:, 1] + 5.0]), abs=1e-7)
    assert moved.der.rod_radius.numpy() == pytest.approx(0.01 * RADIUS)
    assert moved.der.node_bending_stiffness.numpy() == pytest.approx(
        1e-6 * model.der.node_bending_stiffness.numpy(), rel=1e-5
    )


def test_what_usd_cannot_say_is_refused(tmp_path):
    for changes in (
        {"natural_curvature": (1.0, 0.0)}, {"law": Softening(10.0, 0.5)}, {"quadratic_drag": 0.5},
        {"line_mass": wrod.Profile((0.05, 0.1), (0.0, LENGTH))}, {"point_masses": ((0.2, 1e-3),)},
    ):  # fmt: skip
        model = scene(**changes)
        with pytest.raises(RodError, match="no words"):
            wrod.SolverDER.write_usd(model, model.state(), tmp_path / "cables.usda")
    with pytest.raises(RodError, match="no USD file"):
        read(tmp_path / "nothing.usda")
    model = scene()
    path = wrod.SolverDER.write_usd(model, model.state(), tmp_path / "cables.usda")
    stage = Usd.Stage.Open(str(path))
    UsdGeom.BasisCurves(stage.GetPrimAtPath("/cables/cable_0")).CreateTypeAttr("cubic")
    with pytest.raises(RodError, match="linear"):
        read(stage)
    for metre in (1e300, 0.0, float("nan")):
        UsdGeom.SetStageMetersPerUnit(stage, metre)
        with pytest.raises(RodError, match="metersPerUnit"):
            read(stage)
