"""Stages with two rods, fixtures and two arms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import wrod
from wrod.errors import SceneError
from wrod.fixtures import Fixtures
from wrod.scene.tying import export_scene

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
    path, missing = export(tmp_path / "scene.usda", fixtures=scene, facts={"why": "tied"})
    assert missing == []
    stage = Usd.Stage.Open(str(path))
    rod = UsdGeom.BasisCurves.Get(stage, "/World/Deployment_000/rod_1")
    waiting = np.array(rod.GetPointsAttr().Get(0.0))
    laid = np.array(rod.GetPointsAttr().Get(2.0))
    assert np.isfinite(waiting).all()
    assert waiting[:, 1].max() < -0.09  # beside the pattern, until it is laid
    assert laid[:, 1] == pytest.approx(0.05)
    assert rod.GetWidthsAttr().Get()[0] == pytest.approx(0.0064)
    posts = [p for p in stage.Traverse() if p.GetName().startswith("fixture_")]
    assert len(posts) == 4
    prim = stage.GetPrimAtPath("/World/Deployment_000")
    assert prim.GetAttribute("wrod:time").Get(3.0) == pytest.approx(0.6)
    assert prim.GetCustomDataByKey("wrod")["why"] == "tied"


def test_both_arms_follow_their_hands(tmp_path):
    """Each gripper's grasp point is where its hand is, in every frame."""
    from pxr import Usd, UsdGeom

    down = Rotation.from_matrix([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]]).as_matrix()
    hands = np.tile(np.eye(4), (COUNT, 2, 1, 1))
    hands[:, :, :3, :3] = down
    x = np.linspace(0.0, 1.0, COUNT)
    hands[:, 0, :3, 3] = np.column_stack([0.1 + 0.1 * x, 0 * x, 0.0032 + 0.1 * np.sin(np.pi * x)])
    hands[:, 1, :3, 3] = np.column_stack([0.4 - 0.1 * x, 0.05 * x, 0.1 - 0.05 * x])
    path, missing = export(tmp_path / "arms.usdc", hands=hands)
    assert missing == []
    stage = Usd.Stage.Open(str(path))
    for number in range(2):
        root = f"/World/Deployment_000/robot_{number}"
        grasp = [
            p
            for p in stage.Traverse()
            if p.GetName() == "grasp" and str(p.GetPath()).startswith(root)
        ]
        assert len(grasp) == 1
        for code in range(0, COUNT, 6):
            pose = UsdGeom.Xformable(grasp[0]).ComputeLocalToWorldTransform(float(code))
            at = np.array(pose.ExtractTranslation())
            assert at == pytest.approx(hands[code, number, :3, 3], abs=1e-3)


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
