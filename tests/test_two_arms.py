"""Two arms do what two hands do in knots and cables: reach, speed, room, and the stage."""

from types import SimpleNamespace

import films
import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from wrod.errors import RobotError
from wrod.robot.arm import Arm
from wrod.robot.capsules import capsules_of
from wrod.robot.collision import CollisionModel
from wrod.robot.model import load_robot
from wrod.robot.placement import Placement
from wrod.robot.transfer_path import HandFollower, follow
from wrod.robot.transfers import Hand, HandFilm, find_grasps, find_transfers
from wrod.robot.two_arms import solve_two_arms
from wrod.scene.brought import with_waiting
from wrod.scene.render import moments
from wrod.scene.tying import export_scene
from wrod.scene.validate import open_stage, validation_errors

# The end of one of two rods, and one with fixtures; the others differ in their ways alone.
CASES = (
    "end of reef",
    "U cable",
    *(pytest.param(c, marks=pytest.mark.slow) for c in ("reef", "trefoil", "S cable")),
)


@pytest.fixture(scope="module", params=CASES)
def run(request, tmp_path_factory):
    """Film and scene of an application, as its plan commands it."""
    import torch

    torch.set_num_threads(1)
    case = request.param
    if case.endswith("cable"):
        given = films.cable_film(case)
    else:
        given = films.knot_film(case.removeprefix("end of "), 1 if "end" in case else None)
    path = tmp_path_factory.mktemp("scene") / "scene.usdc"
    scene = export_scene(path, **vars(given), facts={"case": case})
    return SimpleNamespace(case=case, film=given, scene=scene)


def world_poses(stage, number: int, name: str, codes) -> np.ndarray:
    """(code, 4, 4) of a link of an arm, as the stage has it."""
    from pxr import UsdGeom

    root = f"/World/Deployment_000/robot_{number}"
    (prim,) = (
        p
        for p in stage.Traverse()
        if p.GetName() == name and str(p.GetPath()).startswith(root + "/")
    )
    return np.array(
        [
            np.array(UsdGeom.XformCache(float(code)).GetLocalToWorldTransform(prim)).T
            for code in codes
        ]
    )


def test_both_arms_reach_every_frame_of_every_hold(run):
    """On the stage, each grasp stays fixed to its hand, with the held point between the pads."""
    assert run.scene.missing == []
    stage, frame = open_stage(run.scene.path), run.scene.arms.frame
    closed = run.film.closed
    film = HandFilm(run.film.time, run.film.hands, closed, tuple(run.film.rods))
    transfers = find_transfers(film)
    assert {transfer.hand for transfer in transfers} == set(range(closed.shape[1]))
    for transfer in transfers:
        first, last = (int(np.searchsorted(frame, k)) for k in (transfer.first, transfer.last))
        codes = np.unique(np.linspace(first, last, 12).astype(int))
        grasp = world_poses(stage, transfer.hand, "grasp", codes)
        held = np.linalg.inv(run.film.hands[frame[codes], transfer.hand]) @ grasp
        assert np.linalg.norm(held[:, :3, 3] - held[0, :3, 3], axis=1).max() < 2e-4
        turn = Rotation.from_matrix(held[0, :3, :3].T @ held[:, :3, :3]).magnitude()
        assert np.degrees(turn.max()) < 0.2
        point = np.linalg.inv(held[0])[:3, 3]  # the held point in the grasp's frame
        assert abs(point[1]) < 1e-6 and abs(point[0]) < 0.0065 and 0.0 <= point[2] < 0.013
        tangent = held[0, :3, :3].T @ transfer.rod[:, 0]
        assert abs(tangent[1]) < 1e-3  # the pads close across the rod


def test_arms_never_jump(run):
    """Joints keep their speed limits from frame to frame, and so do the hands."""
    arms = run.scene.arms
    step = np.diff(arms.time)
    assert step.min() > 0.0
    speed = np.abs(np.diff(arms.positions, axis=1)) / step[:, None]
    assert (speed / arms.robot.velocity).max() <= 1.0
    assert (speed / arms.robot.velocity).max() == pytest.approx(arms.load)
    stage = open_stage(run.scene.path)
    for number in range(2):
        way = world_poses(stage, number, "grasp", range(len(arms.frame)))[:, :3, 3]
        assert (np.linalg.norm(np.diff(way, axis=0), axis=1) / step).max() < 0.7  # [m/s]
    assert (np.diff(arms.frame) >= 0).all()
    assert set(np.diff(arms.frame)) <= {0, 1}  # no frame of the film is left out


def sampled(arms, number: int, codes) -> list[np.ndarray]:
    """Points inside each collision shape, with its radius: (code, n, 4)."""
    poses = arms.robot.link_poses(arms.positions[number, codes])
    base = arms.placements[number].world_from_base
    out = []
    for shape in arms.robot.shapes("collision"):
        ((start, end, radius),) = capsules_of(shape)
        local = start + np.linspace(0.0, 1.0, 25)[:, None] * (end - start)
        frames = base @ poses[shape.link]
        points = np.einsum("kij,nj->kni", frames[:, :3, :3], local) + frames[:, None, :3, 3]
        out.append(np.concatenate([points, np.full((*points.shape[:2], 1), radius)], axis=2))
    return out


def test_arms_keep_clear_of_each_other(run):
    """Against distances between points of their shapes, searched without the arms' own code."""
    arms = run.scene.arms
    codes = np.arange(0, len(arms.frame), 2)
    one, other = (sampled(arms, number, codes) for number in range(2))
    least = np.inf
    for k in range(len(codes)):
        for a in one:
            tree = cKDTree(a[k, :, :3])
            for b in other:
                gap = tree.query(b[k, :, :3])[0].min() - a[0, 0, 3] - b[0, 0, 3]
                least = min(least, gap)
    assert least > 0.018  # [m]
    # Points are farther apart than what they are points of, half of the frames than all.
    assert arms.gap < least + 1e-6
    assert arms.gap >= 0.018


def test_arms_stay_above_the_table(run):
    """Corners of the fingers no deeper than a rod gives way, the rest of the arm clear of it."""
    arms = run.scene.arms
    hands = [s for s in arms.robot.shapes("visual") if s.link == "gripper" and s.kind == "box"]
    codes = np.arange(len(arms.frame))
    for number in range(2):
        poses = arms.robot.link_poses(arms.positions[number])
        base = arms.placements[number].world_from_base
        for shape in hands:
            frames = base @ poses[shape.link] @ shape.pose
            reach = np.abs(frames[:, 2, :3]) @ (np.array(shape.size) / 2)
            assert (frames[:, 2, 3] - reach).min() > -0.0016
        for shape, points in zip(
            arms.robot.shapes("collision"), sampled(arms, number, codes), strict=True
        ):
            fixed = shape.link in ("pedestal", "right_arm_base_link", "base", "right_l0")
            fingers = shape.link == "gripper" and shape.kind == "cylinder"
            if not (fixed or fingers):
                assert (points[..., 2] - points[..., 3]).min() > 0.0


def test_stage_is_in_order(run):
    from pxr import UsdGeom

    path = run.scene.path
    assert path.stat().st_size < 5_000_000
    assert validation_errors(path) == []
    stage = open_stage(path)
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    count = len(run.scene.arms.frame)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0.0, count - 1.0)
    names = {prim.GetName() for prim in stage.Traverse()}
    assert {"robot_0", "robot_1", "table", "top", "perspective", "side", "close"} <= names
    assert ("fixture_00" in names) == run.case.endswith("cable")
    root = stage.GetPrimAtPath("/World/Deployment_000")
    clock, simulated = (
        [root.GetAttribute(f"wrod:{name}").Get(float(code)) for code in range(count)]
        for name in ("time", "simulatedTime")
    )
    assert (np.diff(clock) > 0.0).all() and (np.diff(simulated) >= 0.0).all()
    assert simulated[-1] == pytest.approx(run.film.time[-1])
    facts = root.GetCustomDataByKey("wrod")
    assert facts["case"] == run.case
    assert facts["arms"]["arm_gap"] == pytest.approx(run.scene.arms.gap)
    told = moments(stage)
    assert len(told) == 4 and max(told.values()) == count - 1
    for k, radius in enumerate(run.film.radii):
        rod = UsdGeom.BasisCurves.Get(stage, f"/World/Deployment_000/rod_{k}")
        assert rod.GetWidthsAttr().Get()[0] == pytest.approx(2 * radius)
        for code in np.linspace(0, count - 1, 20).astype(int):
            assert np.isfinite(np.array(rod.GetPointsAttr().Get(float(code)))).all()


def upright(places: np.ndarray) -> np.ndarray:
    """(n, 4, 4) of a hand that reaches down at (n, 3)."""
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    poses[:, :3, :3] = films.UPRIGHT
    poses[:, :3, 3] = places
    return poses


def two_hands(first, second) -> HandFilm:
    """Both at work all the time, 12 frames."""
    hands = np.stack([upright(np.asarray(first)), upright(np.asarray(second))], axis=1)
    return HandFilm(0.4 * np.arange(len(hands)), hands, np.ones((len(hands), 2), dtype=bool), ())


GROUND = np.array([[-0.2, -0.2, 0.0], [0.2, 0.2, 0.0]])
LINE = np.linspace(0.0, 1.0, 12)[:, None] * [0.1, 0.0, 0.0] + [-0.1, -0.1, 0.004]


def test_hands_too_near_each_other_are_refused():
    with pytest.raises(RobotError, match="two hands at work come within"):
        solve_two_arms(two_hands(LINE, LINE + [0.0, 0.02, 0.0]), GROUND)


def test_hand_out_of_reach_is_refused():
    with pytest.raises(RobotError, match="reach"):
        solve_two_arms(two_hands(LINE, LINE * [1, 1, 0] + [0.0, 0.0, 2.5]), GROUND)


def test_too_fast_a_hand_is_refused():
    robot = load_robot("sawyer")
    model = CollisionModel(robot)
    hand = Hand.of(model)
    arm = Arm(robot, model, hand, Placement(0.6, 0.0, -0.25))
    transfer = find_transfers(two_hands(LINE, LINE + [0.0, 0.25, 0.0]))[0]
    grasps = find_grasps(transfer, hand)
    before = np.zeros(7)
    path = follow(HandFollower(arm, transfer, grasps, np.full(11, 0.4), before))
    assert len(path.positions) == 12
    with pytest.raises(RobotError, match="as fast as it can"):
        follow(HandFollower(arm, transfer, grasps, np.full(11, 0.004), before))


@pytest.mark.parametrize(
    "change",
    [
        {"time": np.zeros(12)},
        {"closed": np.ones((12, 3), dtype=bool)},
        {"hands": np.full((12, 2, 4, 4), np.nan)},
    ],
)
def test_films_that_do_not_fit_are_refused(change):
    film = two_hands(LINE, LINE + [0.0, 0.25, 0.0])
    with pytest.raises(RobotError, match="film"):
        HandFilm(**{**vars(film), **change})


def test_waiting_rod_is_brought_without_stretching():
    time = 0.2 * np.arange(40)
    hanging = np.column_stack([0.1 + 0 * time, 0 * time, 0.003 + 0.01 * np.arange(40)])
    rod = np.tile(hanging, (40, 1, 1))
    rod[:30] = np.nan
    shown = with_waiting(rod, time, GROUND, 0.003)
    assert np.array_equal(shown[30:], rod[30:])
    edges = np.linalg.norm(np.diff(shown, axis=1), axis=2)
    assert edges == pytest.approx(0.01)
    assert shown[..., 2].min() > 0.003 - 1e-9
    assert shown[0, :, 1] == pytest.approx(-0.2)  # straight beside what is laid
    assert np.ptp(shown[0, :, 2]) < 1e-9
    assert np.abs(shown[29] - shown[30]).max() < 1e-6  # it arrives
    assert np.linalg.norm(np.diff(shown[:30], axis=0), axis=2).max() < 0.12  # [m] in 0.2 s
