"""Stages with two rods, fixtures and two arms."""

import numpy as np
import pytest

import wrod
from wrod.deployment.fixtures import Fixtures
from wrod.errors import SceneError
from wrod.scene.render import draw_moments
from wrod.scene.tying import export_scene, knot_corners

PATTERN = wrod.pattern("line")


COUNT = 25


def film(count=COUNT):
    """Two rods; the second is laid at the third frame."""
    s = np.linspace(0.0, 0.3, 20)
    one = np.column_stack([s, 0 * s, 0 * s + 0.003])
    rods = [np.tile(one, (count, 1, 1)), np.tile(one + [0, 0.05, 0], (count, 1, 1))]
    rods[1][:2] = np.nan
    return rods


def export(path, **options):
    return export_scene(
        path,
        time=0.2 * np.arange(COUNT),
        rods=film(),
        names=["green-vps", "pink-vps-thick"],
        radii=[0.0016, 0.0032],
        patterns=[PATTERN, PATTERN],
        **options,
    )


def test_rods_and_fixtures_are_on_the_stage(tmp_path):
    from pxr import Usd, UsdGeom

    scene = Fixtures.along(PATTERN, [0.1, 0.3], gap=0.01)
    written = export(tmp_path / "scene.usda", fixtures=scene, facts={"why": "tied"})
    assert written.missing == [] and written.arms is None
    stage = Usd.Stage.Open(str(written.path))
    rod = UsdGeom.BasisCurves.Get(stage, "/World/Deployment_000/rod_1")
    waiting = np.array(rod.GetPointsAttr().Get(0.0))
    laid = np.array(rod.GetPointsAttr().Get(2.0))
    assert np.isfinite(waiting).all()
    assert waiting[:, 1].max() < -0.07  # beside the pattern, until it is laid
    assert laid[:, 1] == pytest.approx(0.05)
    assert rod.GetWidthsAttr().Get()[0] == pytest.approx(0.0064)
    posts = [p for p in stage.Traverse() if p.GetName().startswith("fixture_")]
    assert len(posts) == 4
    prim = stage.GetPrimAtPath("/World/Deployment_000")
    assert prim.GetAttribute("wrod:time").Get(3.0) == pytest.approx(0.6)
    assert prim.GetCustomDataByKey("wrod")["why"] == "tied"


def test_arms_that_cannot_are_left_out_and_named(tmp_path):
    hands = np.tile(np.eye(4), (COUNT, 2, 1, 1))
    hands[:, :, 2, 3] = 3.0  # [m] above the table
    written = export(tmp_path / "arms.usdc", hands=hands)
    assert written.arms is None
    assert len(written.missing) == 1 and "arms" in written.missing[0]


def test_bad_scenes_are_refused(tmp_path):
    with pytest.raises(SceneError, match="suffix"):
        export(tmp_path / "scene.obj")
    with pytest.raises(SceneError, match="nodes"):
        export_scene(
            tmp_path / "scene.usda",
            time=np.arange(3),
            rods=film(),
            names=["", ""],
            radii=[0.001, 0.001],
            patterns=[PATTERN],
        )


def test_knot_is_where_rods_touch_and_nowhere_else():
    s = np.linspace(-0.2, 0.2, 101)
    along = np.column_stack([s, 0 * s, 0 * s + 0.003])
    across = np.column_stack([0 * s + 0.05, s, 0 * s + 0.009])
    low, high = knot_corners([along, across], [0.003, 0.003])
    assert (low + high) / 2 == pytest.approx([0.05, 0.0, 0.006], abs=2e-3)
    assert (high - low < 0.08).all()
    assert knot_corners([along], [0.003]) is None
    assert knot_corners([along, across + [0.0, 0.0, 0.01]], [0.003, 0.003]) is None


def test_stage_without_arms_names_no_moments(tmp_path):
    written = export(tmp_path / "scene.usdc")
    with pytest.raises(SceneError, match="names no moments"):
        draw_moments(written.path, tmp_path / "moments.png")
    assert not (tmp_path / "moments.png").exists()
