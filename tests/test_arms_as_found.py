"""Arms as their makers' files describe them: grippers, xacro, SRDF, meshes, what stands around."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from test_robot_model import own_arm

import wrod
from wrod.errors import RobotError, WrodWarning
from wrod.robot.collision import CollisionModel
from wrod.robot.grip import Grip
from wrod.robot.kinematics import grasp_poses
from wrod.robot.model import load_robot
from wrod.robot.obstacles import Obstacles
from wrod.robot.placement import Placement, candidates, off_pedestal
from wrod.robot.urdf import read_urdf
from wrod.robot.variation import _UNITS, _Freedom
from wrod.scene.workplace import table_under


def with_fingers(path):
    """A file whose sixth link carries a stator and on it a jaw that turns, ahead along x."""
    text = path.read_text().replace(
        "</robot>",
        '<link name="stator"/><link name="mover"/>'
        '<joint name="fixed_stator" type="fixed"><parent link="k6"/><child link="stator"/>'
        '<origin xyz="0.05 0 0"/></joint>'
        '<joint name="jointGripper" type="revolute"><parent link="stator"/><child link="mover"/>'
        '<origin xyz="0.05 0 0"/><axis xyz="0 1 0"/>'
        '<limit lower="-1.5" upper="0" velocity="2" effort="9"/></joint></robot>',
    )
    path.write_text(text)
    return path


def test_a_jaw_that_turns_is_no_joint_of_the_arm(tmp_path):
    path = with_fingers(own_arm(tmp_path))
    assert read_urdf(path).flange() == "k6"
    with pytest.warns(wrod.errors.WrodWarning, match="stator beyond the flange 'k6' give way"):
        arm = load_robot(path)
    assert arm.joint_names == tuple(f"a{k}" for k in range(6))


def test_gripper_points_along_the_axis_that_turns_the_flange(tmp_path):
    """As on arms whose last joint turns about x: the hand is ahead, not above."""
    path = own_arm(tmp_path)
    last = path.read_text().rindex('<axis xyz="0 0 1"/>')
    text = path.read_text()
    path.write_text(text[:last] + '<axis xyz="1 0 0"/>' + text[last + len('<axis xyz="0 0 1"/>') :])
    arm = load_robot(with_fingers(path))
    zero = np.zeros((1, 6))
    local = np.linalg.inv(arm.link_poses(zero)["k6"][0]) @ grasp_poses(arm, zero)[0]
    np.testing.assert_allclose(local[:3, 3], [0.15, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(local[:3, 2], [1.0, 0.0, 0.0], atol=1e-9)  # the fingers
    # Turning the last joint rolls the hand on the spot.
    turned = grasp_poses(arm, np.array([[0, 0, 0, 0, 0, 1.0]]))[0]
    np.testing.assert_allclose(turned[:3, 3], grasp_poses(arm, zero)[0, :3, 3], atol=1e-9)


def test_xacro_is_expanded(tmp_path, monkeypatch):
    pytest.importorskip("xacro")
    urdf = own_arm(tmp_path)
    text = urdf.read_text().replace("<robot ", '<robot xmlns:xacro="http://ros.org/wiki/xacro" ', 1)
    text = text.replace('xyz="0.03 0 0.2"', 'xyz="${2 * reach} 0 0.2"')
    text = text.replace("<link ", '<xacro:property name="reach" value="0.015"/><link ', 1)
    path = tmp_path / "own.xacro"
    for name in ("xacro", "wrod", "re"):  # what lies there is not run
        (tmp_path / f"{name}.py").write_text("raise SystemExit(77)")
    monkeypatch.chdir(tmp_path)
    path.write_text(text)
    q = np.linspace(-1.0, 1.0, 6)[None]
    np.testing.assert_allclose(
        grasp_poses(load_robot(path), q), grasp_poses(load_robot(urdf), q), atol=1e-12
    )


def test_what_makers_leave_in_their_files_does_not_matter(tmp_path):
    """No axis of what is fixed, other programs' attributes, and a wrist that carries the gripper's
    link."""
    path = own_arm(tmp_path)
    plain = grasp_poses(load_robot(path), np.linspace(-1.0, 1.0, 6)[None])
    text = path.read_text().replace("k6", "gripper_link").replace('"a5"', '"wrist_rotate"')
    text = text.replace("<limit ", '<limit drake:acceleration="2.5" ', 1)
    text = text.replace(
        "</robot>",
        '<link name="tool"/><joint name="to_tool" type="fixed"><parent link="gripper_link"/>'
        '<child link="tool"/><axis xyz="0 0 0"/></joint></robot>',
    )
    path.write_text(text)
    with pytest.warns(wrod.errors.WrodWarning, match="tool beyond the flange 'gripper_link'"):
        arm = load_robot(path)
    np.testing.assert_allclose(grasp_poses(arm, np.linspace(-1.0, 1.0, 6)[None]), plain, atol=1e-12)
    load_robot(path, tip="tool")


def test_packages_without_ros_and_of_another_name(tmp_path):
    """`$(find ...)` and `package://` lead to the package around the file, whatever its name."""
    pytest.importorskip("xacro")
    folder = tmp_path / "handed_on" / "urdf"
    folder.mkdir(parents=True)
    text = own_arm(folder).read_text()
    xacro = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
    inner = text[text.index(">", text.index("<robot")) + 1 : text.rindex("</robot>")]
    mesh = '<visual><geometry><mesh filename="package://maker/meshes/a.stl"/></geometry></visual>'
    inner = inner.replace('<link name="k0"/>', f'<link name="k0">{mesh}</link>')
    assert mesh in inner
    (folder / "arm_macro.xacro").write_text(f'<robot name="arm" {xacro}>{inner}</robot>')
    include = '<xacro:include filename="$(find maker)/urdf/arm_macro.xacro"/>'
    for name in ("arm.xacro", "expands.urdf"):
        (folder / name).write_text(f'<robot name="arm" {xacro}>{include}</robot>')
        with pytest.raises(RobotError, match=r"a\.stl' is missing"):
            read_urdf(folder / name)
    (tmp_path / "handed_on" / "meshes").mkdir()
    (tmp_path / "handed_on" / "meshes" / "a.stl").write_bytes(b"")
    for name in ("arm.xacro", "expands.urdf"):
        assert read_urdf(folder / name).flange() == "k6"


def test_pairs_of_an_srdf_are_not_checked(tmp_path):
    path = own_arm(tmp_path)
    text = path.read_text()
    for k in (0, 2):
        shape = '<collision><geometry><sphere radius="0.03"/></geometry></collision>'
        text = text.replace(f'<link name="k{k}"/>', f'<link name="k{k}">{shape}</link>')
    path.write_text(text)

    def pairs():
        model = CollisionModel(load_robot(path))
        return {frozenset((model.links[i], model.links[j])) for i, j in model.pairs}

    before = pairs()
    assert frozenset(("k0", "k6")) in before
    (tmp_path / "own.srdf").write_text(
        '<robot name="own"><disable_collisions link1="k0" link2="k6" reason="Never"/></robot>'
    )
    assert before - pairs() == {frozenset(("k0", "k6"))}


def test_meshes_are_measured_as_they_are_where_capsules_doubt(tmp_path):
    pytest.importorskip("coal")
    from wrod.robot.exact import ExactShapes

    path = own_arm(tmp_path)
    shapes = [s for s in load_robot(path).shapes("collision") if s.kind == "mesh"]
    exact = ExactShapes(shapes * 2)
    # Corners 0, 30, 30, 60 mm: two of them side by side, 50 mm along x apart leave 20 mm.
    other = np.eye(4)
    other[0, 3] = 0.05
    assert exact.gap(0, 1, np.eye(4), other) == pytest.approx(0.02, abs=1e-9)
    other[0, 3] = 0.01
    assert exact.gap(0, 1, np.eye(4), other) == 0.0
    turned = np.eye(4)
    turned[:3, :3] = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]  # upside down: lowest at -60 mm
    turned[2, 3] = 0.1
    assert exact.lowest(0, turned[None])[0] == pytest.approx(0.04, abs=1e-9)


@pytest.fixture(scope="module")
def line():
    green = wrod.rod("green-vps")
    return wrod.plan(wrod.pattern("line"), green, "numeric", spacing=0.01, device="cpu")


def obstacles(tmp_path, **entry):
    path = tmp_path / "cell.json"
    path.write_text(json.dumps([{"kind": "box", **entry}]))
    return Obstacles.load(path)


def test_an_obstacle_in_degrees_is_refused_and_one_in_millimetres_asked_after(tmp_path):
    box = {"size": [0.1, 0.1, 0.1], "xyz": [0.5, 0, 0]}
    with pytest.raises(RobotError, match=r"obstacle 1: .*turned by .* 90\.0] rad \(degrees"):
        obstacles(tmp_path, **box, rpy=[0, 0, 90])
    with pytest.warns(WrodWarning, match="obstacle 1: stands 60 m off"):
        found = obstacles(tmp_path, **box | {"xyz": [60, 0, 0]})
    assert len(found.shapes) == 1


def test_the_hanging_rod_keeps_clear_of_what_the_arm_would_miss(tmp_path, line):
    place = Placement(0.35, -0.25, -0.3, 0.0)
    foot = (line.contact @ place.base_from_world[:3, :3].T + place.base_from_world[:3, 3])[25]
    post = obstacles(tmp_path, size=[0.02, 0.02, 0.12], xyz=[foot[0], foot[1], -0.24])
    with pytest.raises(RobotError, match=r"the hanging rod comes within \d+ mm of an obstacle at"):
        wrod.solve_joint_path(line, "ur5e", place, obstacles=post)
    path = wrod.solve_joint_path(line, "ur5e", table_height=-0.3, obstacles=post)
    pose = path.placement.base_from_world
    shapes = line.shape @ pose[:3, :3].T + pose[:3, 3]
    near = np.linalg.norm(shapes[..., :2] - foot[:2], axis=-1)[shapes[..., 2] < -0.18]
    assert near.min() > 0.01
    # And it is seen where it stands.
    file = wrod.export_usd(tmp_path / "scene.usdc", trajectory=line, joint_path=path)
    stage = Usd.Stage.Open(str(file))
    (shape,) = stage.GetPrimAtPath("/World/Deployment_000/obstacles").GetChildren()
    seen = UsdGeom.XformCache().GetLocalToWorldTransform(shape).ExtractTranslation()
    robot = stage.GetPrimAtPath("/World/Deployment_000/robot")
    base = UsdGeom.XformCache().GetLocalToWorldTransform(robot)
    assert np.allclose(base.GetInverse().Transform(seen), [foot[0], foot[1], -0.24], atol=1e-9)


def test_an_obstacle_in_the_way_is_named_and_one_beside_is_kept_clear_of(
    tmp_path, line, monkeypatch
):
    free = wrod.solve_joint_path(line, "ur5e")
    place = free.placement
    poses = grasp_poses(free.robot, free.node_positions)
    hand, behind = poses[:, :3, 3], poses[:, :3, 3] - 0.12 * poses[:, :3, 2]
    wall = obstacles(tmp_path, size=[0.1, 0.1, 0.1], xyz=behind[len(hand) // 2].tolist())
    with (
        monkeypatch.context() as short,
        pytest.raises(RobotError, match=r"and the obstacle (overlap by|come within)"),
    ):
        short.setattr("wrod.robot.solve._REFINED", 1)
        short.setattr("wrod.robot.solve._DEEPER", 0)
        wrod.solve_joint_path(line, "ur5e", place, obstacles=wall, grip_angle=free.grip.angle)
    # A wall 12 cm behind everything that the hand does, which the elbow need not touch.
    reach = np.abs(hand[:, 1]).max() + 0.25
    wall = obstacles(tmp_path, size=[1.0, 0.05, 0.4], xyz=[0.3, float(reach), 0.2])
    path = wrod.solve_joint_path(line, "ur5e", place, obstacles=wall)
    assert path.metadata["gap"]["obstacle"] > 0.005
    starts, ends, radii = wall.capsules()
    model = CollisionModel(path.robot)
    import torch

    q = torch.from_numpy(path.node_positions.copy())
    a, b = (p.numpy() for p in model.points(path.robot.jacobian.frames(q)))
    # By points on the capsules of both, densely.
    u = np.linspace(0.0, 1.0, 9)[:, None]
    wall_points = (starts[:, None] * (1 - u) + ends[:, None] * u).reshape(-1, 3)
    mine = (a[:, :, None] * (1 - u) + b[:, :, None] * u)[::5, model.depth >= 1]
    gap = np.linalg.norm(mine[..., None, :] - wall_points, axis=-1).min((0, 2, 3))
    assert (gap - model.radius[model.depth >= 1] - radii.max()).min() > 0.0


def test_an_arm_in_a_world_of_its_own_is_placed_as_one_without(tmp_path, line):
    """Files that begin with a world, a cell or a bench hold the arm somewhere in it."""
    bare = own_arm(tmp_path)
    held = bare.read_text().replace(
        '<link name="k0"/>',
        '<link name="world"/><link name="k0"/><joint name="held" type="fixed">'
        '<parent link="world"/><child link="k0"/><origin xyz="1.5 -0.4 0.8"/></joint>',
    )
    (tmp_path / "held.urdf").write_text(held)
    alone, inside = load_robot(bare), load_robot(tmp_path / "held.urdf")
    np.testing.assert_allclose(inside.mount[:3, 3], [1.5, -0.4, 0.8])
    places = [candidates(line, arm, 6) for arm in (alone, inside)]
    assert places[0]
    for one, other in zip(*places, strict=True):
        moved = np.array([one.x + 1.5, one.y - 0.4, one.z + 0.8, one.yaw])
        np.testing.assert_allclose([other.x, other.y, other.z, other.yaw], moved, atol=1e-9)
    tables = [
        table_under(line.contact, SimpleNamespace(placement=place[0], robot=arm), 0.002)
        for place, arm in zip(places, (alone, inside), strict=True)
    ]
    np.testing.assert_allclose(tables[1].low, tables[0].low + [1.5, -0.4], atol=1e-9)
    assert tables[1].floor == pytest.approx(tables[0].floor + 0.8)


def test_the_wide_foot_of_a_pedestal_stands_under_the_table(tmp_path, line):
    """As Baxter's, 0.9 m deep and half a metre below its shoulders: no table was ever before it."""
    bare = own_arm(tmp_path)
    standing = bare.read_text().replace(
        '<link name="k0"/>',
        '<link name="k0"/><link name="foot"><collision><origin xyz="0.2 0 -0.75"/><geometry>'
        '<box size="1.3 0.9 0.1"/></geometry></collision></link><joint name="stand" type="fixed">'
        '<parent link="k0"/><child link="foot"/></joint>',
    )
    (tmp_path / "standing.urdf").write_text(standing)
    alone, arm = load_robot(bare), load_robot(tmp_path / "standing.urdf")
    over, through = (0.0, -0.1), (-0.75,)
    assert candidates(line, alone, heights=over) == candidates(line, arm, heights=over) != []
    assert candidates(line, alone, heights=through) and not candidates(line, arm, heights=through)


def test_no_place_is_varied_into_what_the_arm_stands_on(line):
    """As of an arm that reaches no line before it, whose rod then lay through its stand."""
    arm = load_robot("ur5e")
    place = candidates(line, arm, 1)[0]
    keeps_off = off_pedestal(arm, line, place.z)
    assert all(map(keeps_off, candidates(line, arm, heights=(place.z,))))
    middle = place.to_base(line.contact)[len(line.contact) // 2]
    onto = arm.mount[:2, 3] - middle[:2]  # the line's middle onto the arm's axis
    assert not keeps_off(replace(place, x=place.x + onto[0], y=place.y + onto[1]))
    task = SimpleNamespace(robot=arm, trajectory=line, free_height=False)
    branch = SimpleNamespace(placement=place, grip=Grip(0.5, 0.0))
    freedom = _Freedom(task, branch, fixed=False)
    moved = np.append(onto, [0.0, 0.0, 0.0])
    assert freedom.allows(0.0 * moved) and not freedom.allows(moved / _UNITS[:5])
    assert _Freedom(task, branch, fixed=True).allows(np.zeros(2))  # a given place is the user's


def test_of_an_arm_without_shapes_it_is_said_that_nothing_is_checked(tmp_path):
    path = own_arm(tmp_path)
    text = path.read_text()
    start, end = text.index("<collision>"), text.index("</collision>") + len("</collision>")
    path.write_text(text[:start] + text[end:])
    with pytest.warns(wrod.errors.WrodWarning, match="no link of the arm has a collision shape"):
        CollisionModel(load_robot(path))
