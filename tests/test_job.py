"""The whole job: from a neutral pose to the rod, laid, and back."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation, RotationSpline

import wrod
from wrod.planning.tail import tail, with_tail
from wrod.robot.attempt import hanging_rod
from wrod.robot.job import GRASP_TIME, PHASES
from wrod.robot.joint_path import JointPath
from wrod.robot.kinematics import grasp_poses
from wrod.robot.stand import stays


@pytest.fixture(scope="module")
def line():
    return wrod.plan(wrod.pattern("line"), wrod.rod("green-vps"), method="numeric", device="cpu")


@pytest.fixture(scope="module")
def job(line):
    import torch

    torch.set_num_threads(1)
    return wrod.solve_joint_path(line, "ur5e", whole_job=True)


def part(job, name):
    (phase,) = [p for p in job.phases if p["name"] == name]
    return (job.time > phase["start"] - 1e-6) & (job.time < phase["end"] + 1e-6)


def test_phases_follow_each_other_from_rest_to_rest(job):
    assert [p["name"] for p in job.phases] == list(PHASES)
    edges = [p["start"] for p in job.phases] + [job.phases[-1]["end"]]
    assert edges[0] == 0.0 and edges[-1] == pytest.approx(job.time[-1])
    assert all(a["end"] == b["start"] for a, b in zip(job.phases, job.phases[1:], strict=False))
    for edge in edges:
        assert np.abs(job.velocities[round(edge * 100)]).max() < 1e-6
    for name in ("grasp", "release"):
        still = job.positions[part(job, name)]
        assert len(still) == 100 * GRASP_TIME + 1 and np.ptp(still, axis=0).max() < 1e-15
    np.testing.assert_allclose(job.positions[0], job.neutral, atol=1e-12)
    np.testing.assert_allclose(job.positions[-1], job.neutral, atol=1e-12)
    assert (np.diff(job.arc_length) >= -1e-12).all()
    assert np.ptp(job.arc_length[part(job, "approach")]) == 0.0


def test_limits_of_every_joint_hold_throughout(job):
    robot = job.robot
    step = np.diff(job.time)[:, None]
    speed = np.diff(job.positions, axis=0) / step
    assert np.abs(speed - (job.velocities[1:] + job.velocities[:-1]) / 2).max() < 2e-3
    assert (np.abs(speed) < robot.velocity).all()
    gain = np.diff(job.velocities, axis=0) / step
    assert (np.abs(gain) < 1.01 * robot.acceleration).all()
    # Jerk jumps within a sample; differences of differences average it.
    assert (np.abs(np.diff(gain, axis=0) / step[1:]) < 1.05 * robot.jerk).all()
    assert ((job.positions > robot.lower) & (job.positions < robot.upper)).all()


def test_laying_is_where_the_plan_is(job, line):
    at = np.column_stack([np.interp(job.node_time, job.time, q) for q in job.positions.T])
    poses = job.placement.world_from_base @ grasp_poses(job.robot, at)
    assert np.linalg.norm(poses[:, :3, 3] - line.position, axis=1).max() < 2e-4
    laying = job.phases[2]
    assert job.node_time[0] == pytest.approx(laying["start"])
    assert job.node_time[-1] <= laying["end"] + 1e-9


def test_hand_comes_and_goes_along_its_fingers(job):
    for name, order in (("approach", slice(None, None, -1)), ("retreat", slice(None))):
        poses = grasp_poses(job.robot, job.positions[part(job, name)][order])
        away = poses[:, :3, 3] - poses[0, :3, 3]
        along = -away @ poses[0, :3, 2]
        beside = np.linalg.norm(away + along[:, None] * poses[0, :3, 2], axis=1)
        first = np.argmax(along > 0.99 * 0.03)
        assert first > 0 and beside[:first].max() < 1e-3
        assert (np.diff(along[:first]) > -1e-6).all()


def test_arm_keeps_off_table_and_hanging_rod(job, line):
    """By points on the shapes, not by the distances that the path was found with."""
    base = job.placement.world_from_base
    rng = np.random.default_rng(0)
    hanging, left = hanging_rod(line)[0], hanging_rod(with_tail(line))[-1]
    assert np.ptp(left, axis=0).max() < 0.1
    for name, rod in (("approach", KDTree(hanging)), ("retreat", KDTree(left))):
        positions = job.positions[part(job, name)][::10]
        poses = job.robot.link_poses(positions)
        for shape in job.robot.shapes("collision"):
            if shape.kind != "cylinder" or shape.link in ("base_link", "shoulder_link"):
                continue
            turn = rng.normal(size=(60, 2))
            turn /= np.linalg.norm(turn, axis=1, keepdims=True)
            high = rng.uniform(-0.5, 0.5, 60) * shape.size[1]
            skin = np.column_stack([turn * shape.size[0], high, np.ones(60)])
            world = (base @ poses[shape.link] @ shape.pose @ skin.T)[:, :3].swapaxes(1, 2)
            assert world[..., 2].min() > 0.0
            if shape.link != "gripper":
                assert rod.query(world.reshape(-1, 3))[0].min() > 0.015


def test_tail_is_laid_straight_on_as_simulated_deployments_lay_it(job, line):
    """What hangs from the hand at the pattern's end is planned as in a simulation, not dropped."""
    rod, on = wrod.rod("green-vps"), part(job, "tail")
    found = tail(wrod.pattern("line"), rod, line)
    poses = job.placement.world_from_base @ grasp_poses(job.robot, job.positions[on])
    laid = job.arc_length[on]
    assert laid[0] == pytest.approx(line.arc_length[-1], abs=1e-9)
    assert rod.length - laid[-1] < 4.5 * rod.gravito_bending_length  # a UR5e reaches no further
    wanted = CubicSpline(found.laid, found.position)(laid)
    assert np.linalg.norm(poses[:, :3, 3] - wanted, axis=1).max() < 5e-4
    assert poses[-1, 2, 3] > 0.012  # there is room for the fingers
    np.testing.assert_allclose(
        found.contact[:, 1:], line.contact[-1:, 1:].repeat(len(found.laid), 0)
    )
    # One hold over pattern and tail: the rod is not twisted.
    hold = (
        line.rotation[0].T
        @ (job.placement.world_from_base @ grasp_poses(job.robot, job.node_positions[:1]))[
            0, :3, :3
        ]
    )
    turned = RotationSpline(found.laid, Rotation.from_matrix(found.rotation))(laid)
    off = Rotation.from_matrix(poses[:, :3, :3]).inv() * turned * Rotation.from_matrix(hold)
    assert np.degrees(off.magnitude().max()) < 0.2


def test_stand_holds_the_rod_below_the_hand_and_out_of_its_way(job, line):
    (foot, top, thick), (joint, held, _) = job.stand
    assert foot[:2] == top[:2] and foot[2] == 0.0 and joint == top
    steps = np.linalg.norm(np.diff(line.shape[0], axis=0), axis=1)
    along = np.append(0.0, np.cumsum(steps))
    clip = [np.interp(along[-1] - 0.09, along, axis) for axis in line.shape[0].T]
    np.testing.assert_allclose(held, clip, atol=1e-3)
    share = np.linspace(0.0, 1.0, 200)[:, None]
    post = KDTree(np.array(foot) + share * (np.array(top) - foot))
    base, rng = job.placement.world_from_base, np.random.default_rng(1)
    assert job.stand_stays
    poses = job.robot.link_poses(job.positions[::20])
    for shape in job.robot.shapes("collision"):
        if shape.kind == "cylinder":
            turn = rng.normal(size=(60, 2))
            turn *= shape.size[0] / np.linalg.norm(turn, axis=1, keepdims=True)
            high = rng.uniform(-0.5, 0.5, 60) * shape.size[1]
            skin = np.column_stack([turn, high, np.ones(60)])
            world = (base @ poses[shape.link] @ shape.pose @ skin.T)[:, :3].swapaxes(1, 2)
            assert post.query(world.reshape(-1, 3))[0].min() > thick + 0.005
    rods = np.concatenate([line.shape.reshape(-1, 3), line.contact])
    assert post.query(rods)[0].min() > thick + 0.0016


def test_a_stand_where_the_rod_comes_does_not_stay(job, line):
    far = np.full((1, 1, 3), 5.0)
    away = far, far + [0.0, 0.0, 0.1], np.array([0.01])
    (foot, top, thick), (_, held, thin) = job.stand
    assert stays([[foot, top, thick], [top, held, thin]], away, line, 0.0016)
    at = line.contact[100] * [1.0, 1.0, 0.0]
    moved = [at, at + [0.0, 0.0, 0.2], thick], [at + [0.0, 0.0, 0.2], np.array(held), thin]
    assert not stays(list(moved), away, line, 0.0016)
    beside = np.array([[top]]) + 0.012  # an arm that comes by
    assert not stays(job.stand, (beside, beside, np.array([0.005])), line, 0.0016)


def test_an_arm_that_cannot_lay_the_tail_lets_go_of_it(line, monkeypatch):
    from wrod.robot import job as module

    monkeypatch.setattr(module, "tails", lambda *a: iter(()))
    path = wrod.solve_joint_path(line, "ur5e", whole_job=True)
    assert [p["name"] for p in path.phases] == [name for name in PHASES if name != "tail"]
    assert path.arc_length[-1] == pytest.approx(line.arc_length[-1])


def test_phases_are_saved(job, tmp_path):
    job.save(tmp_path / "joint_path")
    again = JointPath.load(tmp_path / "joint_path.npz")
    assert again.phases == job.phases
    assert '"phases"' in (tmp_path / "joint_path.csv").read_text().splitlines()[0]


def test_where_there_is_no_way_the_path_stays_and_says_so(line, monkeypatch):
    from wrod.errors import WrodWarning
    from wrod.robot import job as module

    monkeypatch.setattr(module, "find_way", lambda *a, **k: None)
    with pytest.warns(WrodWarning, match="begins and ends at the rod: no way between"):
        path = wrod.solve_joint_path(line, "ur5e", whole_job=True)
    assert [p["name"] for p in path.phases] == ["lay"] and "no way" in path.metadata["no_approach"]


def test_a_pattern_that_turns_further_than_the_hand_is_told_so():
    from types import SimpleNamespace

    from wrod.robot.model import load_robot
    from wrod.robot.solve import turning

    angle = np.linspace(0.0, 2 * np.pi, 200)
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    for name, room in (("panda", 2 * 2.8973), ("gen3", np.inf)):
        course = SimpleNamespace(contact=ring, arc_length=angle, spin=0.0)
        task = SimpleNamespace(trajectory=course, robot=load_robot(name))
        turned, there = turning(task)
        assert turned == pytest.approx(2 * np.pi, abs=0.05)
        assert there == pytest.approx(room)


def test_hand_leaves_the_rod_aside_where_it_cannot_go_back(job, monkeypatch):
    from wrod.robot import transit
    from wrod.robot.arm import Arm
    from wrod.robot.collision import CollisionModel
    from wrod.robot.transfers import Hand

    model = CollisionModel(job.robot)
    arm = Arm(job.robot, model, Hand.of(model), job.placement)
    straight = transit._straight
    monkeypatch.setattr(
        transit, "_straight", lambda a, q, d, far: None if d[2] < 0 else straight(a, q, d, far)
    )
    leg = transit.retreat(arm, job.node_positions[0])
    poses = arm.grasps(leg.knots)
    moved = (poses[-1, :3, 3] - poses[0, :3, 3]) @ poses[0, :3, :3]
    np.testing.assert_allclose(np.abs(moved), [transit._ASIDE, 0.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(poses[-1, :3, :3], poses[0, :3, :3], atol=1e-4)


def test_scene_shows_every_phase(line, job, tmp_path):
    from pxr import UsdGeom

    from wrod.scene.phases import whole_rod
    from wrod.scene.validate import open_stage, validation_errors

    path = wrod.export_usd(
        tmp_path / "job.usdc", trajectory=line, joint_path=job, rod=wrod.rod("green-vps")
    )
    assert validation_errors(path) == []
    stage = open_stage(path)
    first, last = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    assert first < -5 and last > len(line) + 5
    prim = stage.GetPrimAtPath("/World/Deployment_000")
    time, phase = prim.GetAttribute("wrod:time"), prim.GetAttribute("wrod:phase")
    assert time.Get(first) == 0.0 and time.Get(last) == pytest.approx(job.time[-1])
    codes = np.arange(first, last + 1)
    assert (np.diff([time.Get(code) for code in codes]) > 0).all()
    assert [p["name"] for p in job.phases] == list(dict.fromkeys(phase.Get(c) for c in codes))
    rod = stage.GetPrimAtPath("/World/Deployment_000/rod").GetAttribute("points")
    shapes = whole_rod(with_tail(line))[: len(line)]
    for code, shape in ((first, shapes[0]), (0, shapes[0]), (len(line) - 1, shapes[-1])):
        assert np.abs(np.array(rod.Get(code)) - shape).max() < 1e-6
    lying = np.array(rod.Get(last))
    assert np.abs(lying[:, 2]).max() < 1e-3

    def length(points):
        return np.linalg.norm(np.diff(points, axis=0), axis=1).sum()

    opening = next(code for code in codes if phase.Get(code) == "release")
    assert length(lying) == pytest.approx(length(np.array(rod.Get(opening))), rel=1e-6)
    assert length(lying) == pytest.approx(length(shapes[-1]), rel=1e-3)
    # The tail lies before the hand opens, but for what the fingers hold.
    assert (np.array(rod.Get(opening))[:, 2] < 2e-3).mean() > 0.8
    clip = UsdGeom.Imageable(stage.GetPrimAtPath("/World/Deployment_000/holder/clip"))
    assert [clip.ComputeVisibility(c) for c in (first, 0, last)] == ["inherited"] * 3
    in_the_way = replace(job, metadata={**job.metadata, "stand_stays": False})
    there = [in_the_way.holds_stand(time.Get(c)) for c in (first, 0, last)]
    assert there == [True, True, False]
    # The hand is away from the rod when the scene begins and ends, and on it in between.
    reached = line.position[[0, -1]]
    for code, grip in ((first, reached[0]), (last, reached[1])):
        place = hand_at(job, time.Get(code))
        assert np.linalg.norm(place - grip) > 0.05


def hand_at(job, time):
    from wrod.robot.kinematics import grasp_poses

    q = np.array([[np.interp(time, job.time, column) for column in job.positions.T]])
    return (job.placement.world_from_base @ grasp_poses(job.robot, q)[0])[:3, 3]
