import dataclasses
import itertools
import math

import numpy as np
import pytest

import wrod
from wrod.errors import SceneError
from wrod.scene.phases import whole_rod
from wrod.scene.validate import open_stage, validation_errors

pytest.importorskip("pxr")


@pytest.fixture(scope="module")
def scene(tmp_path_factory, letter, letter_path):
    path = tmp_path_factory.mktemp("scene") / "letter.usdc"
    return wrod.export_usd(
        path,
        trajectory=letter,
        joint_path=letter_path,
        pattern=wrod.pattern("letter-C"),
        rod=wrod.rod("green-vps"),
    )


def world(prim, time):
    from pxr import UsdGeom

    return np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(prim)).T


def prims(stage):
    return {prim.GetName(): prim for prim in stage.Traverse()}


def test_stage_passes_openusds_validators(scene):
    assert validation_errors(scene) == []


def test_validators_do_catch_a_bad_stage(tmp_path):
    from pxr import Sdf, Usd, UsdGeom

    path = str(tmp_path / "bad.usda")
    stage = Usd.Stage.CreateNew(path)
    UsdGeom.Sphere.Define(stage, "/a").GetPrim().CreateRelationship("material:binding").AddTarget(
        Sdf.Path("/nowhere")
    )
    stage.Save()
    assert validation_errors(path)


def test_stage_is_small_metric_and_self_contained(scene, letter):
    from pxr import UsdGeom

    assert scene.stat().st_size < 5_000_000
    stage = open_stage(scene)
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0.0, len(letter) - 1.0)
    assert len(stage.GetUsedLayers()) <= 2 and stage.GetDefaultPrim().GetName() == "World"
    cameras = {p.GetName() for p in stage.Traverse() if p.IsA(UsdGeom.Camera)}
    assert cameras == {"top", "work", "perspective"}
    assert "wrod:time" in stage.GetRootLayer().documentation


def test_links_gripper_and_rod_are_the_arrays_at_every_time_code(scene, letter, letter_path):
    from pxr import UsdGeom

    stage = open_stage(scene)
    found = prims(stage)
    links = letter_path.robot.link_poses(letter_path.node_positions)
    base = letter_path.placement.world_from_base
    rod = UsdGeom.BasisCurves(found["rod"])
    shapes = whole_rod(letter)
    assert rod.GetWidthsAttr().Get()[0] == pytest.approx(0.0032)
    for code in range(len(letter)):
        for link in ("right_l1", "right_l4", "right_l6", "grasp"):
            pose = world(found[link], code)
            assert np.abs(pose - base @ links[link][code]).max() < 1e-6
        assert np.abs(pose[:3, 3] - letter.position[code]).max() < 1e-5
        points = np.array(rod.GetPointsAttr().Get(code))
        assert np.abs(points - shapes[code]).max() < 1e-6
        lengths = [np.linalg.norm(np.diff(p, axis=0), axis=1).sum() for p in (points, shapes[code])]
        assert lengths[0] == pytest.approx(lengths[1], abs=1e-5)


def test_whole_rod_keeps_its_length_and_ends(letter):
    shapes = whole_rod(letter)
    lengths = np.linalg.norm(np.diff(shapes, axis=1), axis=2).sum(1)
    # A rod that hangs stretches by w l^2 / (2 k_s) under its own weight; its lowest part, of about
    # 2 L_gb, does not hang.
    rod = wrod.rod("green-vps")
    hanging = rod.length - letter.arc_length
    stretched = rod.length + rod.weight * hanging**2 / (2 * rod.stretching_stiffness)
    # Chords of 4.4 mm on curvatures of up to 20 / m fall short by (kappa h)^2 / 24.
    short = rod.length * (20 * 0.0044) ** 2 / 24
    assert np.abs(lengths - stretched).max() < short + 3e-4
    assert np.abs(shapes[:, -1] - letter.position).max() < 2e-5
    assert np.abs(shapes[:, 0] - letter.contact[0]).max() < 1e-9
    laid = shapes[-1][np.linspace(0, 0.885, 201) < letter.arc_length[-1]]
    assert np.abs(laid[:, 2]).max() < 1e-9


def test_taut_rod_is_straight_and_an_unknown_shape_is_left_out():
    taut = wrod.plan(wrod.pattern("line"), wrod.rod("rope"), method="intuitive")
    rods = whole_rod(taut)
    assert np.abs(rods[:, -1] - taut.position).max() < 1e-9
    laid = np.linspace(0, 0.89, 201) <= taut.arc_length[40]
    assert np.abs(rods[40][laid, 2]).max() < 1e-9
    assert np.abs(rods[40][~laid, :2] - taut.contact[40, :2]).max() < 1e-9
    slack = dataclasses.replace(taut, position=taut.position * [1, 1, 0.8])
    assert np.abs(whole_rod(slack)[:, -1] - taut.contact).max() < 1e-9


def test_rod_of_a_controllers_plan_is_the_solvers(letter):
    bare = dataclasses.replace(letter, shape=None)
    pattern = wrod.pattern("letter-C")
    assert np.abs(whole_rod(bare, pattern) - whole_rod(letter)).max() < 1e-5
    assert np.abs(whole_rod(bare) - whole_rod(letter)).max() < 2e-4
    neural = wrod.plan(pattern, wrod.rod("green-vps"), method="neural")
    rods = whole_rod(neural, pattern)
    assert np.abs(rods[:, -1] - neural.position).max() < 1e-9
    assert np.abs(rods - whole_rod(letter)).max() < 5e-4
    moved = dataclasses.replace(bare, position=letter.position + [0.004, 0.0, 0.0])
    assert np.abs(whole_rod(moved)[:, -1] - letter.contact).max() < 1e-9


def test_pattern_is_given_as_it_was_planned(tmp_path):
    """`plan` lays a remainder before a circle, which the pattern in hand does not have."""
    circle = wrod.pattern("circle")
    plan = wrod.plan(circle, wrod.rod("green-vps"), method="neural")
    assert plan.metadata["remainder_length"] > 0.05
    rods = whole_rod(plan, circle)
    assert np.abs(rods[:, -1] - plan.position).max() < 1e-9
    shown = wrod.export_usd(tmp_path / "c.usdc", trajectory=plan, pattern=circle)
    assert validation_errors(shown) == []


def test_figures_of_the_plan_are_on_the_stage(scene, letter, letter_path):
    stage = open_stage(scene)
    prim = stage.GetPrimAtPath("/World/Deployment_000")
    figures = prim.GetCustomDataByKey("wrod")
    assert figures["pattern"] == "letter-C" and figures["method"] == "numeric"
    assert figures["rod"]["gravito_bending_length"] == pytest.approx(0.032)
    assert figures["joint_path"]["duration"] == pytest.approx(letter_path.metadata["duration"])
    assert prim.GetAttribute("wrod:arcLength").Get(10) == pytest.approx(letter.arc_length[10])
    assert prim.GetAttribute("wrod:time").Get(10) == pytest.approx(letter_path.node_time[10])


def test_scene_without_a_robot_shows_the_gripper_alone(tmp_path, letter):
    path = wrod.export_usd(tmp_path / "s.usda", trajectory=letter)
    assert validation_errors(path) == []
    stage = open_stage(path)
    found = prims(stage)
    assert "robot" not in found
    pose = world(found["gripper"], 12)
    grasp = pose[:3, 3] + 0.15 * pose[:3, 2]
    assert np.abs(grasp - letter.position[12]).max() < 1e-6


def test_a_batch_stands_in_a_grid_on_one_floor(tmp_path, letter, letter_path):
    other = wrod.plan(wrod.pattern("line"), wrod.rod("rope"), method="intuitive")
    path = wrod.export_usd(
        tmp_path / "batch.usdc",
        trajectory=[letter, other, letter],
        joint_path=[letter_path, None, letter_path],
        rod=[wrod.rod("green-vps"), wrod.rod("rope"), wrod.rod("green-vps")],
    )
    assert validation_errors(path) == []
    stage = open_stage(path)
    origins = []
    for number in range(3):
        prim = stage.GetPrimAtPath(f"/World/Deployment_{number:03d}")
        origins.append(world(prim, 0)[:3, 3])
        assert prim.GetChild("rod")
    apart = [np.linalg.norm(a - b) for a, b in itertools.pairwise(origins)]
    assert min(apart) > 1.0
    legs = [p for p in stage.Traverse() if p.GetName() == "leg_0"]
    feet = []
    for leg in legs:
        from pxr import Usd, UsdGeom

        box = UsdGeom.BBoxCache(Usd.TimeCode(0), ["default"]).ComputeWorldBound(leg)
        feet.append(box.ComputeAlignedRange().GetMin()[2])
    assert np.ptp(feet) < 1e-6


def test_nothing_of_the_workplace_floats_or_intersects(scene, letter):
    """The table's top touches the rod, its legs the floor, and the pedestal stands on it."""
    from pxr import Usd, UsdGeom

    stage = open_stage(scene)
    cache = UsdGeom.BBoxCache(Usd.TimeCode(len(letter) - 1), ["default"])
    found = prims(stage)

    def span(prim):
        box = cache.ComputeWorldBound(prim).ComputeAlignedRange()
        return np.array(box.GetMin()), np.array(box.GetMax())

    table = stage.GetPrimAtPath("/World/Deployment_000/table/top")
    floor = span(found["floor"])[1][2]
    assert span(table)[1][2] == pytest.approx(-0.0016, abs=1e-6)
    assert span(found["rod"])[0][2] == pytest.approx(-0.0016, abs=1e-5)
    assert span(found["leg_2"])[0][2] == pytest.approx(floor, abs=1e-6)
    assert span(found["leg_2"])[1][2] == pytest.approx(span(table)[0][2], abs=1e-6)
    assert span(found["pedestal"])[0][2] == pytest.approx(floor, abs=1e-6)
    top_low, top_high = span(table)
    contact = letter.contact
    assert (contact[:, :2] > top_low[:2]).all() and (contact[:, :2] < top_high[:2]).all()


def test_the_table_reaches_to_where_the_rod_falls(letter):
    from wrod.scene.phases import covered
    from wrod.scene.workplace import table_under

    aside = letter.contact[-1] + np.linspace(0.0, 0.6, 20)[:, None] * [-0.6, 0.8, 0.1]
    table = table_under(covered(letter, aside), None, 0.0016)
    for lying in (aside, letter.contact):
        assert (lying[:, :2] > table.low + 0.1).all() and (lying[:, :2] < table.high - 0.1).all()
    assert table.top == pytest.approx(letter.contact[:, 2].min() - 0.0016)


@pytest.mark.parametrize("bearing", np.linspace(0.0, 2.0 * np.pi, 17)[:-1])
def test_the_table_is_off_the_pedestal_wherever_the_pattern_lies(bearing):
    from types import SimpleNamespace

    from wrod.robot.placement import Placement
    from wrod.scene.workplace import COLUMN, table_under

    place = Placement(*(0.4 * np.array([np.cos(bearing), np.sin(bearing)])), -0.3, 0.7)
    contact = 0.1 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [-1, -1, 0]])
    robot = SimpleNamespace(mount=np.eye(4))
    table = table_under(contact, SimpleNamespace(placement=place, robot=robot), 0.002)
    assert np.hypot(*np.clip(0.0, table.low, table.high)) >= COLUMN
    pose = place.base_from_world
    lies = contact @ pose[:3, :3].T + pose[:3, 3]
    assert (lies[:, :2] > table.low).all() and (lies[:, :2] < table.high).all()
    assert (table.high - table.low >= 0.2).all()


@pytest.mark.parametrize(
    "change, says",
    [
        ({"trajectory": None}, "needs a trajectory"),
        ({"trajectory": []}, "the list is empty"),
        ({"shapes": np.zeros((3, 10, 3))}, r"shapes are \(3, 10, 3\); give \(185, points, 3\)"),
        ({"pattern": np.zeros((4, 5))}, r"pattern .* not \(4, 5\)"),
    ],
)
def test_bad_input_is_named_and_writes_nothing(tmp_path, letter, change, says):
    with pytest.raises(SceneError, match=says):
        wrod.export_usd(tmp_path / "s.usdc", **({"trajectory": letter} | change))
    assert list(tmp_path.iterdir()) == []


def test_mismatched_joint_path_and_suffix_are_named(tmp_path, letter, letter_path):
    shorter = dataclasses.replace(
        letter, **{n: getattr(letter, n)[:50] for n in ("arc_length", "contact", "position")},
        rotation=letter.rotation[:50], force=letter.force[:50], shape=letter.shape[:50],
    )  # fmt: skip
    with pytest.raises(SceneError, match="has 185 nodes and the trajectory 50"):
        wrod.export_usd(tmp_path / "s.usdc", trajectory=shorter, joint_path=letter_path)
    with pytest.raises(SceneError, match=r"suffixes \.usdc"):
        wrod.export_usd(tmp_path / "s.obj", trajectory=letter)
    with pytest.raises(SceneError, match="no such file"):
        open_stage(tmp_path / "gone.usdc")
    (tmp_path / "junk.usdc").write_bytes(b"PXR-USDC" + bytes(50))
    with pytest.raises(SceneError, match=r"junk\.usdc: not a readable USD stage .*; give"):
        open_stage(tmp_path / "junk.usdc")


def test_newton_shows_the_same_poses(scene, letter, letter_path):
    pytest.importorskip("newton")
    from wrod.scene.newton_model import NewtonScene

    shown = NewtonScene(scene)
    labels = shown.model.body_label
    rod = [i for i, label in enumerate(labels) if label.endswith("/rod")]
    shapes = whole_rod(letter)
    assert len(rod) == shapes.shape[1] - 1
    palm = next(i for i, label in enumerate(labels) if label.endswith("gripper/cylinder_0"))
    grip = letter_path.robot.link_poses(letter_path.node_positions)["gripper"]
    base = letter_path.placement.world_from_base
    for code in (0, 40, len(letter) - 1):
        shown.update(code)
        poses = shown.state.body_q.numpy()
        middles = (shapes[code][1:] + shapes[code][:-1]) / 2
        assert np.abs(poses[rod, :3] - middles).max() < 1e-5
        flange = base @ grip[code] @ [0, 0, 0.006, 1]
        assert np.abs(poses[palm, :3] - flange[:3]).max() < 1e-5


def test_newtons_own_importer_reads_the_stage(scene, letter_path):
    newton = pytest.importorskip("newton")
    pytest.importorskip("newton_usd_schemas", reason="newton's USD importer needs its schemas")
    builder = newton.ModelBuilder()
    builder.add_usd(str(scene), load_visual_shapes=True)
    from pxr import UsdGeom

    stage = open_stage(scene)
    solids = [p for p in stage.Traverse() if p.IsA(UsdGeom.Gprim) and not p.IsA(UsdGeom.Curves)]
    labels = list(builder.shape_label)
    assert sorted(labels) == sorted(str(p.GetPath()) for p in solids)
    tip = stage.GetPrimAtPath(next(label for label in labels if label.endswith("gripper/box_8")))
    place = builder.shape_transform[labels.index(str(tip.GetPath()))]
    assert np.abs(np.array(place)[:3] - world(tip, 0)[:3, 3]).max() < 1e-5


def test_unknown_hidden_prim_is_named(scene):
    pytest.importorskip("newton")
    from wrod.scene.newton_model import NewtonScene

    with pytest.raises(SceneError, match="no prim is named unicorn"):
        NewtonScene(scene, ("unicorn",))
    hidden = NewtonScene(scene, ("robot",))
    assert not any("right_l3" in label for label in hidden.model.shape_label)


def test_turn_of_a_capsule_points_along_its_segment(tmp_path):
    from pxr import Usd, UsdGeom
    from scipy.spatial.transform import Rotation

    from wrod.scene.newton_model import _capsules

    stage = Usd.Stage.CreateInMemory()
    curve = UsdGeom.BasisCurves.Define(stage, "/c")
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [1, 2, 1], [1, 2, -2], [0, 1, 0.5]])
    curve.CreatePointsAttr(points.tolist())
    curve.CreateCurveVertexCountsAttr([len(points)])
    poses, half = _capsules(curve.GetPrim(), 0.0, UsdGeom.XformCache(0))
    along = Rotation.from_quat(poses[:, 3:]).apply([0, 0, 1]) * half[:, None]
    assert np.abs(poses[:, :3] - along - points[:-1]).max() < 1e-6
    assert np.abs(poses[:, :3] + along - points[1:]).max() < 1e-6
    assert math.isclose(half[4], np.linalg.norm(points[5] - points[4]) / 2, rel_tol=1e-6)


@pytest.mark.parametrize(("name", "up"), [("perspective", (0, 0, 1)), ("top", (0, 1, 0))])
def test_browser_view_begins_with_the_stages_camera(scene, name, up):
    from types import SimpleNamespace

    from pxr import UsdGeom

    from wrod.scene.view import _look_through

    stage = open_stage(scene)
    camera = prims(stage)[name]
    first = SimpleNamespace()
    _look_through(camera, SimpleNamespace(server=SimpleNamespace(initial_camera=first)))
    pose = world(camera, 0.0)
    assert first.position == pytest.approx(tuple(pose[:3, 3]), abs=1e-6)
    ahead = np.subtract(first.look_at, first.position)
    focus = UsdGeom.Camera(camera).GetFocusDistanceAttr().Get()
    assert ahead == pytest.approx(-focus * pose[:3, 2], abs=1e-5)
    assert first.up == pytest.approx(up, abs=1e-6)
    lens = UsdGeom.Camera(camera)
    half = lens.GetVerticalApertureAttr().Get() / lens.GetFocalLengthAttr().Get() / 2.0
    assert math.tan(first.fov / 2.0) == pytest.approx(half, rel=1e-6)
