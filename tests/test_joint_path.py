import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation, RotationSpline
from wrod.scenes.sawyer import JOINTS

import wrod
from wrod.errors import DataError, RobotError
from wrod.robot.collision import segment_distance
from wrod.robot.grip import Grip
from wrod.robot.joint_path import JointPath
from wrod.robot.model import load_robot
from wrod.robot.placement import Placement


def in_world(path, positions):
    """Poses (K, 4, 4) of the grasp in the trajectory's frame, from the table of the joints."""
    poses = []
    for row in positions:
        pose, angles = np.eye(4), iter(row)
        for name, _, _, xyz, rpy, limits in JOINTS:
            if name in ("head_pan", "pedestal_fixed"):
                continue
            step = np.eye(4)
            step[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
            step[:3, 3] = xyz
            if limits is not None:
                step[:3, :3] = step[:3, :3] @ Rotation.from_rotvec([0, 0, next(angles)]).as_matrix()
            pose = pose @ step
        pose[:3, 3] += pose[:3, 2] * 0.15
        poses.append(pose)
    place = path.placement
    turn = Rotation.from_rotvec([0, 0, place.yaw]).as_matrix()
    poses = np.array(poses)
    poses[:, :3, 3] = (poses[:, :3, 3] - [place.x, place.y, place.z]) @ turn
    poses[:, :3, :3] = turn.T @ poses[:, :3, :3]
    return poses


@pytest.fixture
def short_search(monkeypatch):
    """What cannot be reached is not searched for near every branch."""
    monkeypatch.setattr("wrod.robot.solve._REFINED", 1)
    monkeypatch.setattr("wrod.robot.solve._DEEPER", 0)


@pytest.fixture
def first_branch(monkeypatch):
    """Where any path will do, no second one is improved."""
    monkeypatch.setattr("wrod.robot.attempt._TRIED", 1)


def test_grip_is_held_at_every_node(letter, letter_path):
    poses = in_world(letter_path, letter_path.node_positions)
    assert np.linalg.norm(poses[:, :3, 3] - letter.position, axis=1).max() < 1e-4
    held = letter.rotation.transpose(0, 2, 1) @ poses[:, :3, :3]  # grasp in the rod's frame
    turn = Rotation.from_matrix(held[0].T @ held).magnitude()
    assert np.degrees(turn.max()) < 0.1  # one hold over the whole path: the rod is not twisted
    # The pads close across the rod: the grasp's y is perpendicular to the tangent.
    assert np.abs(held[:, 0, 1]).max() < 1e-3


def test_grip_is_held_between_the_nodes(letter, letter_path):
    """Against a curve that the path was not made from: splines over the arc length."""
    fine = np.linspace(0.0, letter.arc_length[-1], 40 * len(letter))
    track = CubicSpline(letter.arc_length, letter.position)(fine)
    frames = RotationSpline(letter.arc_length, Rotation.from_matrix(letter.rotation))(fine)
    poses = in_world(letter_path, letter_path.positions[::9])
    tree = KDTree(track)
    near = tree.query(poses[:, :3, 3])[1].clip(1, len(fine) - 2)
    # Distance to the polyline of the fine points, not to the nearest of them.
    ahead, offset = track[near + 1] - track[near - 1], poses[:, :3, 3] - track[near]
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    across = offset - (offset * ahead).sum(1)[:, None] * ahead
    assert np.linalg.norm(across, axis=1).max() < 1e-4
    hold = letter.rotation[0].T @ in_world(letter_path, letter_path.node_positions[:1])[0, :3, :3]
    turned = frames[near] * Rotation.from_matrix(hold)
    off = (Rotation.from_matrix(poses[:, :3, :3]).inv() * turned).magnitude()
    assert np.degrees(off.max()) < 0.1
    assert letter_path.metadata["position_error"] < 1e-6
    assert np.degrees(letter_path.metadata["rotation_error"]) < 1e-3


def test_between_the_nodes_it_is_what_a_finer_plan_gives(letter, letter_path):
    from wrod.bench.robot import against_finer

    found = against_finer(
        letter_path, wrod.pattern("letter-C"), wrod.rod("green-vps"), "numeric", letter
    )
    assert found["finer_mm"] < 0.02 and found["finer_deg"] < 0.01


def test_path_is_one_branch_within_the_limits(letter_path):
    robot = letter_path.robot
    assert letter_path.names == tuple(f"right_j{i}" for i in range(7))
    assert (letter_path.positions > robot.lower + 0.02).all()
    assert (letter_path.positions < robot.upper - 0.02).all()
    assert np.abs(np.diff(letter_path.positions, axis=0)).max() < 0.01
    assert letter_path.metadata["step_beyond_turn"] < 0.05


def test_timing_keeps_the_limits_and_the_rate(letter_path):
    robot, time = letter_path.robot, letter_path.time
    step = np.diff(time)
    assert np.allclose(step, 0.01, rtol=1e-9)
    velocity = np.diff(letter_path.positions, axis=0) / step[:, None]
    acceleration = np.diff(velocity, axis=0) / 0.01
    jerk = np.diff(acceleration, axis=0) / 0.01
    assert (np.abs(velocity) <= robot.velocity).all()
    assert (np.abs(acceleration) <= robot.acceleration).all()
    assert (np.abs(jerk) <= robot.jerk).all()
    assert np.abs(letter_path.velocities[[0, -1]]).max() < 1e-9
    assert letter_path.arc_length[[0, -1]] == pytest.approx([0.0, 0.46], abs=0.01)
    assert (np.diff(letter_path.arc_length) > -1e-12).all()
    middle = (letter_path.velocities[1:] + letter_path.velocities[:-1]) / 2
    assert np.abs(middle - velocity).max() < 1e-4
    assert (np.diff(letter_path.node_time) > 0).all()


@pytest.mark.usefixtures("first_branch")
def test_an_arm_that_is_fast_enough_is_at_each_pose_when_that_is_due(letter, letter_path):
    own = replace(letter, metadata={**letter.metadata, "optimised": {"pace": 0.04}})
    robot = letter_path.robot
    fast = replace(
        robot, velocity=1e3 * robot.velocity, acceleration=1e3 * robot.acceleration,
        jerk=1e3 * robot.jerk,
    )  # fmt: skip
    for plan, asked, pace in ((letter, None, 0.02), (own, None, 0.04), (own, 0.3, 0.3)):
        path = wrod.solve_joint_path(plan, fast, letter_path.placement, pace=asked)
        assert path.pace == path.steady_pace == pace
        assert path.slowed["most"] == pytest.approx(1.0, abs=1e-3) and not path.slowed["at"]
        due = wrod.pose_times(plan, asked)
        np.testing.assert_allclose(path.node_time, due, atol=2e-3)
        # And between the nodes, whichever way the travel is counted.
        even = (path.time > 0.5) & (path.time < due[-1] - 0.5)
        laid = np.interp(path.time, due, letter.arc_length)
        np.testing.assert_allclose(path.arc_length[even], laid[even], atol=2e-4)


@pytest.mark.usefixtures("first_branch")
def test_an_arm_that_its_limits_slow_down_says_where(letter, letter_path):
    from wrod.commands.plan_summary import _laid_slowly
    from wrod.robot.timing import laid_slowly

    assert _laid_slowly(letter_path.metadata) == []
    robot = letter_path.robot
    slow = replace(robot, velocity=0.7 * np.abs(letter_path.velocities).max(axis=0))
    path = wrod.solve_joint_path(letter, slow, letter_path.placement)
    assert (np.abs(path.velocities) <= slow.velocity).all()
    ratio = np.diff(path.node_time) / np.diff(wrod.pose_times(letter))
    assert path.slowed["most"] == pytest.approx(ratio.max()) and ratio.min() > 1.02
    assert path.slowed["at"] == [letter.arc_length[[0, -1]].tolist()]
    assert path.steady_pace == pytest.approx(0.02 / path.slowed["most"], rel=2e-3)
    (said,) = _laid_slowly(path.metadata)
    assert "at 0.02 m/s where 0.000 to 0.458 m are laid: it is up to 1.4 times as slow" in said
    laid = np.linspace(0.0, 0.5, 6)
    times = [0.0, 1.0, 3.5, 4.5, 5.5, 8.0]
    assert laid_slowly(np.arange(6.0), np.array(times), laid) == (2.5, [[0.1, 0.2], [0.4, 0.5]])


@pytest.mark.usefixtures("first_branch")
def test_fast_grip_is_slowed_to_the_joint_limits(letter, letter_path):
    fast = wrod.solve_joint_path(letter, placement=letter_path.placement, pace=5.0)
    load = fast.metadata["load"]
    assert max(load.values()) == pytest.approx(1.0, abs=0.1)
    assert max(load.values()) <= 1.0 + 1e-6
    assert fast.metadata["duration"] < letter_path.metadata["duration"] / 2


def test_where_the_grip_turns_back_alone_it_is_slow(letter_path):
    """Joints that turn back within two millimetres of half a metre of travel."""
    from wrod.robot.timing import Course, gently, schedule

    robot, u = letter_path.robot, np.linspace(0.0, 0.5, 20001)
    bend = np.outer(np.sqrt((u - 0.3) ** 2 + 2e-4**2), 3.0 + np.arange(7))
    spline = CubicSpline(u, bend)
    even = Course(lambda x, n=0: spline(0.0 * x + 0.1, n), 0.5)
    steady = schedule(robot, even, 0.05, gently)
    timing = schedule(robot, Course(spline, 0.5), 0.05, gently)
    assert 0.05 / timing.stretched < 0.01
    assert timing.duration < 1.5 * steady.duration
    time = np.arange(0.0, timing.duration, 1e-3)
    travel, rate = timing.travel(time)
    assert 0.01 < rate.max() < 0.05 + 1e-12
    assert travel[[0, -1]] == pytest.approx([0.0, 0.5], abs=1e-6) and (np.diff(travel) >= 0).all()
    np.testing.assert_allclose(np.gradient(travel, 1e-3)[1:-1], rate[1:-1], atol=1e-5)
    inside = np.abs(travel - 0.25) < 0.2
    assert abs(travel[inside][rate[inside].argmin()] - 0.3) < 2e-3
    np.testing.assert_allclose(timing.time_of(travel[500:-500:100]), time[500:-500:100], atol=1e-6)
    q = spline(travel)
    for limit in (robot.velocity, robot.acceleration, robot.jerk):
        q = np.diff(q, axis=0) / 1e-3
        assert (np.abs(q) <= limit).all()


def test_nothing_collides(letter, letter_path):
    """Spheres along the table's primitives, against table, pedestal and each other."""
    robot = letter_path.robot
    poses = robot.link_poses(letter_path.node_positions[::5])
    spheres = {
        "right_l2": [((0, 0, z), 0.06) for z in np.linspace(-0.09, 0.25, 9)],
        "right_l4": [((0, 0, z), 0.045) for z in np.linspace(-0.04, 0.26, 9)],
        "right_l5": [((0, 0, 0.1), 0.06)],
        "right_l6": [((0, 0.015, z), 0.055) for z in (-0.035, 0.015)],
        "gripper": [((0, 0, z), 0.012) for z in np.linspace(0.055, 0.15, 9)],
    }
    world = {
        link: [(poses[link] @ np.array([*at, 1.0]), radius) for at, radius in balls]
        for link, balls in spheres.items()
    }
    for link, balls in world.items():
        for centre, radius in balls:
            if link != "right_l2":
                assert (centre[:, 2] - radius > letter_path.placement.z).all()
            beside = np.hypot(centre[:, 0] + 0.02, centre[:, 1]) - radius - 0.18
            above = centre[:, 2] - radius - 0.02
            assert (np.maximum(beside, above) > 0).all()  # pedestal
    for first, second in (
        ("right_l2", "gripper"),
        ("right_l2", "right_l6"),
        ("right_l4", "gripper"),
    ):
        for a, radius_a in world[first]:
            for b, radius_b in world[second]:
                assert (np.linalg.norm(a - b, axis=1) > radius_a + radius_b).all()
    assert min(letter_path.metadata["gap"].values()) > 0.005


def test_segment_distance_against_many_points():
    import torch

    rng = np.random.default_rng(1)
    p, q, r, s = torch.from_numpy(rng.normal(size=(4, 20, 3)))
    t = torch.linspace(0, 1, 400, dtype=torch.float64)[:, None, None]
    first, second = p + t * (q - p), r + t * (s - r)
    brute = (first[:, None] - second[None]).norm(dim=-1).amin((0, 1))
    exact = segment_distance(p, q, r, s)
    assert (exact <= brute + 1e-12).all() and (brute - exact).max() < 0.02
    parallel = segment_distance(p, q, p + torch.tensor([0.0, 0, 9]), q + torch.tensor([0.0, 0, 9]))
    assert (parallel <= 9.0 + 1e-9).all()


def test_what_a_path_costs_has_its_gradient():
    """Links, table, laid and hanging rod, an obstacle, limits, long steps and singularities."""
    from wrod.robot.collision import CollisionModel
    from wrod.robot.redundancy import PathCost, Surroundings, gaps

    robot, rng = load_robot("sawyer"), np.random.default_rng(1)
    model, count = CollisionModel(robot), 12
    q = rng.uniform(-1.5, 1.5, 7) + 0.15 * np.cumsum(rng.normal(size=(count, 7)), axis=0)
    laid = np.column_stack([np.linspace(0.3, 0.8, 60), np.zeros(60), np.full(60, -0.2)])
    ends = rng.normal(size=(2, count, 3, 3))
    around = Surroundings(
        -0.2, laid, 5 * np.arange(count), 0.003, (*ends, np.full(3, 0.2)), "obstacle",
        0.5 * rng.normal(size=(count, 12, 3)),
    )  # fmt: skip
    import torch

    near = gaps(model, torch.from_numpy(q), around)
    assert len(near) == 5 and all((gap < 0.035).any() for gap in near.values())
    cost = PathCost(robot, model, count, longest=0.1, singular_weight=2e4)
    value, gradient = cost.penalty(q, around, True)
    assert value == pytest.approx(cost.penalty(q, around)[0], rel=1e-12)
    for _ in range(3):
        way, step = rng.normal(size=q.shape), 1e-6
        ahead, behind = (cost.penalty(q + s * way, around)[0] for s in (step, -step))
        slope = (ahead - behind) / (2 * step)
        assert np.vdot(gradient, way) == pytest.approx(slope, rel=1e-6, abs=1e-6 * value)


def test_files_hold_the_path(tmp_path, letter_path):
    table, arrays = letter_path.save(tmp_path / "joint_path")
    lines = table.read_text().splitlines()
    assert lines[1].split(",")[:2] == ["time [s]", "right_j0 [rad]"]
    rows = np.loadtxt(table, delimiter=",", skiprows=2)
    assert np.abs(rows[:, 1:] - letter_path.positions).max() < 1e-7
    back = JointPath.load(arrays, letter_path.robot)
    assert back.names == letter_path.names and back.placement == letter_path.placement
    assert np.array_equal(back.positions, letter_path.positions)
    assert back.metadata == letter_path.metadata
    arrays.write_bytes(arrays.read_bytes()[:200])
    with pytest.raises(DataError, match=r"joint_path\.npz: is not"):
        JointPath.load(arrays)


@pytest.mark.parametrize("angle", [0.0, 0.6, math.pi / 2])
def test_grip_angle_is_between_fingers_and_leaving_rod(angle):
    hold = Grip(angle, 0.7).rotation
    fingers, leaving = hold[:, 2], np.array([-1.0, 0.0, 0.0])  # in the rod's frame
    assert np.isclose(np.linalg.det(hold), 1.0)
    assert math.acos(np.clip(fingers @ leaving, -1, 1)) == pytest.approx(angle, abs=1e-7)
    assert abs(hold[0, 1]) < 1e-12


def test_rod_can_cross_the_fingers(letter):
    path = wrod.solve_joint_path(letter, grip_angle=math.pi / 2)
    poses = in_world(path, path.node_positions)
    across = np.einsum("ti,ti->t", poses[:, :3, 2], letter.rotation[:, :, 0])
    assert np.abs(across).max() < 1e-4


@pytest.mark.usefixtures("short_search")
@pytest.mark.parametrize(
    "placement, says",
    [
        ((1.6, 0.0, -0.3, 0.0), r"out of reach at node \d+ \(arc length 0\.\d+ m\).* mm and"),
        (
            (0.35, 0.0, 0.6, 0.0),
            r"(passes its limit|out of reach|overlap|come within).* at node \d+",
        ),
    ],
)
def test_unreachable_placement_says_where_and_by_how_much(letter, placement, says):
    with pytest.raises(RobotError, match=says) as error:
        wrod.solve_joint_path(letter, placement=placement, grip_angle=0.0)
    assert "placed at x" in str(error.value) and "placement 'auto'" in str(error.value)


@pytest.mark.usefixtures("short_search", "first_branch")
def test_joint_limit_is_named_with_node_and_amount(letter, letter_path):
    with pytest.raises(RobotError, match=r"joint right_j\d comes within .* rad of its limit of"):
        wrod.solve_joint_path(
            letter, placement=letter_path.placement, grip_angle=0.0, limit_margin=1.6
        )


@pytest.mark.usefixtures("short_search")
def test_circle_too_often_passes_the_last_joints_limit(letter_path):
    """Two turns of a hanging rod are more than the wrist has."""
    count = 60
    turn = np.linspace(0, 4 * np.pi, count)
    position = np.column_stack(
        [0.05 * np.cos(turn), 0.05 * np.sin(turn), np.linspace(0.8, 0.3, count)]
    )
    up = Rotation.from_rotvec([0, -np.pi / 2, 0])
    frames = (Rotation.from_rotvec(np.outer(turn, [0, 0, 1])) * up).as_matrix()
    flat = position * [1, 1, 0]
    spiral = wrod.Trajectory(turn * 0.05, flat, position, frames, np.full((count, 3), np.nan))
    with pytest.raises(
        RobotError, match=r"joint right_j\d passes its limit of .* rad by .* at node"
    ):
        wrod.solve_joint_path(spiral, placement=letter_path.placement, grip_angle=0.0)


def test_bad_arguments_are_named(letter):
    for options, says in [
        ({"placement": "here"}, "placement 'here' is not 'auto'"),
        ({"placement": (0, 0, np.nan, 0)}, "finite numbers only"),
        ({"grip_angle": 3.0}, "grip angle is 3.0"),
        ({"rate": 0}, "rate is 0"),
        ({"robot": "puma"}, "unknown robot 'puma'"),
    ]:
        with pytest.raises(RobotError, match=says):
            wrod.solve_joint_path(letter, **options)
    # What a trajectory is made of is checked, and nobody changes it afterwards.
    with pytest.raises(ValueError, match="read-only"):
        letter.position[7, 1] = np.nan


def test_placement_text_is_in_degrees():
    place = Placement.parse("0.5, -0.1, -0.3, 90")
    assert place == Placement(0.5, -0.1, -0.3, math.pi / 2)
    there = place.base_from_world @ [1.0, 0.0, 0.0, 1.0]
    assert there[:3] == pytest.approx([0.5, 0.9, -0.3])
    with pytest.raises(RobotError, match=r"yaw of 90 rad, .* in four numbers in radians"):
        Placement.parse((0.5, -0.1, -0.3, 90.0))
    assert Placement.parse((0.5, -0.1, -0.3, 6.2832)).yaw == 6.2832  # once round, as it is written


def test_same_input_gives_the_same_path(letter, letter_path):
    again = wrod.solve_joint_path(letter)
    assert np.array_equal(again.positions, letter_path.positions)


@pytest.mark.slow
@pytest.mark.parametrize("rod", ["pink-vps", "green-vps", "rope"])
@pytest.mark.parametrize(
    "pattern", ["line", "circle", "sine", "letter-U", "letter-C", "letter-L", "letter-A"]
)
@pytest.mark.parametrize("published", [False, True])
def test_every_pattern_and_rod_has_a_path(request, pattern, rod, published):
    from wrod.bench.robot import run_case

    folder = request.getfixturevalue("shared") / "patterns" if published else None
    row = run_case(pattern, rod, "numeric", folder)
    assert "error" not in row, row
    assert row["position_mm"] < 0.1 and row["rotation_deg"] < 0.1
    assert row["limit_margin"] > 0.02 and row["gap_mm"] > 5.0
    assert row["beyond"] < 0.05


@pytest.mark.usefixtures("first_branch")
def test_robot_object_is_used_as_it_is(letter, letter_path):
    arm = load_robot("sawyer", gripper_length=0.2)
    path = wrod.solve_joint_path(letter, robot=arm, placement=letter_path.placement)
    assert path.robot is arm and path.metadata["gripper_length"] == 0.2
