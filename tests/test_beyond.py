"""What hangs beyond the grip: its shape, the table and the arm."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

import wrod
from wrod.errors import RodError
from wrod.patterns.shapes import straight, strokes, turn
from wrod.planning.beyond import Beyond, longest_free
from wrod.planning.trajectory import Trajectory
from wrod.rods.model_file import rod_as_json

ROD = wrod.RodMaterial(0.0016, 0.03, 0.3)


def held(angles, beyond: float, height: float, rod=ROD) -> Trajectory:
    """Poses 3 cm apart at a height [m], where the rod leaves the grip at angles [rad] above ahead;
    the one before has laid the rod below."""
    count = len(angles)
    ahead = np.column_stack([0.03 * np.arange(count), np.zeros((count, 2))])
    turns = Rotation.from_rotvec(np.outer(angles, [0.0, -1.0, 0.0])).as_matrix()
    return Trajectory(
        np.linspace(0.0, 0.1, count), ahead, ahead + [0.0, 0.0, height], turns,
        np.full((count, 3), np.nan), {"rod": rod_as_json(rod)}, beyond_grip=beyond,
    )  # fmt: skip


@pytest.mark.parametrize("length", [0.5, 2.0, 6.0])
def test_it_hangs_as_the_elastica_does(length):
    """k_b theta'' = w (b - s) cos(theta), theta(0) the grip's, theta'(b) = 0, k_b = 2 w L_gb^3."""
    angles = np.array([-0.8, 0.0, 1.2, 1.5])
    found = Beyond.of(held(angles, 0.03 * length, 1.0)).shape
    s = np.linspace(0.0, length, 400)
    for angle, shape in zip(angles, found, strict=True):
        end = solve_bvp(
            lambda s, y: np.array([y[1], 0.5 * (length - s) * np.cos(y[0])]),
            lambda a, b, angle=angle: np.array([a[0] - angle, b[1]]),
            s, np.array([angle - (angle + 1.4) * (1.0 - np.exp(-s)), -np.exp(-s)]), tol=1e-8,
            max_nodes=20_000,
        )  # fmt: skip
        assert end.success
        tip = np.trapezoid([np.cos(end.sol(s)[0]), np.sin(end.sol(s)[0])], s, axis=1)
        np.testing.assert_allclose((shape[-1] - shape[0])[[0, 2]] / 0.03, tip, atol=0.02)


def test_what_touches_the_table_is_said_and_how_much_may_be_left():
    down = held(np.full(3, -0.5 * np.pi), 0.2, 0.1)
    hangs = Beyond.of(down)
    assert hangs.touches.all() and hangs.lies_on.all()  # on the contacts below it
    free = longest_free(down)
    assert 0.1 - 0.2 / 32 - 1e-3 < free < 0.1
    assert not Beyond.of(replace(down, beyond_grip=free)).touches.any()
    lengths = np.linalg.norm(np.diff(hangs.drawn, axis=1), axis=2).sum(axis=1)
    assert hangs.drawn[..., 2].min() == 0.0
    np.testing.assert_allclose(lengths, 0.2, rtol=0.03)
    high = held(np.full(3, -0.5 * np.pi), 0.2, 0.3)
    assert not Beyond.of(high).touches.any() and longest_free(high) == 0.2
    assert Beyond.of(held(np.zeros(3), 0.0, 0.1)) is None


def test_scenes_show_it():
    from wrod.scene.phases import rods_of

    points = np.column_stack([np.linspace(0.0, 0.12, 20), np.zeros(20)])
    pattern = wrod.Pattern.from_points(points)
    path = wrod.plan(pattern, ROD, spacing=0.02, left=3)
    shapes, _ = rods_of(path, None, pattern, 50)
    assert path.beyond_grip == pytest.approx(0.09) and longest_free(path) == path.beyond_grip
    np.testing.assert_allclose(shapes[:, 49], path.position, atol=1e-6)
    lengths = np.linalg.norm(np.diff(shapes[:, 49:], axis=1), axis=2).sum(axis=1)
    np.testing.assert_allclose(lengths, 0.09, rtol=0.03)
    assert rods_of(wrod.plan(pattern, ROD, spacing=0.02), None, pattern, 50)[0].shape[1] == 50


@pytest.fixture(scope="module")
def bend():
    """An eased quarter turn that ends straight, and how it is laid."""
    heading, _ = strokes(0.0, straight(0.06), turn(90.0, 0.05, 0.06), straight(0.03))
    s = np.linspace(0.0, heading.x[-1], 400)
    steps = np.diff(s) * np.exp(1j * heading(0.5 * (s[1:] + s[:-1])))
    points = np.insert(np.cumsum(steps), 0, 0.0)
    pattern = wrod.Pattern.from_points(np.column_stack([points.real, points.imag]))
    how = dict(discretisation=wrod.Discretisation(0.004, 0.02), speed=0.03, threads=1)
    return pattern, how


def planned(pattern, length: float):
    rod = wrod.RodMaterial(0.0016, 0.018, length)
    return rod, wrod.plan(pattern, rod, method="numeric", spacing=0.01, left=4, device="cpu")


def test_it_is_laid_with_the_rod_and_moves_nothing_that_lies(bend):
    pattern, how = bend
    rod, plan = planned(pattern, 0.34)
    known, whole = (
        wrod.simulate_deployment(pattern, rod, plan, 0.4, frame_interval=0.5, beyond_grip=b, **how)
        for b in (False, True)
    )
    n = len(known.arc_length)
    assert plan.beyond_grip > 0.03 and whole.arc_length[-1] == pytest.approx(rod.length)
    assert np.array_equal(whole.arc_length[:n], known.arc_length)
    # All that joins them is the tolerance of the steps, which both sides of the grip count for.
    assert np.abs(whole.centerline[:n] - known.centerline).max() < 1e-8
    assert whole.error_mean == pytest.approx(known.error_mean, abs=1e-9)
    assert not whole.contact_force[n:].any()
    still = Beyond.of(plan).shape[-1]
    still += whole.centerline[n - 1] - still[0]
    way = np.linspace(0.0, plan.beyond_grip, len(still))
    hangs = np.column_stack([np.interp(whole.arc_length[n:] - known.arc_length[-1], way, c)
                             for c in still.T])  # fmt: skip
    assert np.abs(hangs - whole.centerline[n:]).max() < 1e-3  # the grip holds 0.4 mm straight


def test_what_comes_down_lies_on_the_table_and_goes_on_when_the_grip_opens(bend):
    pattern, how = bend
    rod, plan = planned(pattern, 0.5)
    whole = wrod.simulate_deployment(pattern, rod, plan, 0.4, beyond_grip=True, **how)
    beyond = whole.arc_length > plan.rod.length
    lies = beyond & whole.contact_force.any(axis=1)
    assert Beyond.of(plan).touches[-1] and lies[-1] and not lies[beyond.argmax()]
    # No edge is strained by more than by the weight of all that is beyond, E A = 8 w L_gb^3 / r^2.
    strain = plan.beyond_grip * rod.radius**2 / (8.0 * rod.gravito_bending_length**3)
    for shape in (whole.centerline, whole.released_centerline):
        assert shape[:, 2].min() > -0.1 * rod.radius
        lengths = np.linalg.norm(np.diff(shape, axis=0), axis=1)
        np.testing.assert_allclose(lengths, np.diff(whole.arc_length), rtol=strain)
    assert whole.released_centerline[:, 2].max() < rod.radius and whole.released_speed < 1e-2
    # The table bears what the grip does not.
    load = whole.contact_force[beyond, 2].sum() / (rod.weight * plan.beyond_grip)
    assert 0.5 < load < 1.0
    ends = replace(plan, beyond_grip=0.0)
    trials = [wrod.Trial(pattern, one.rod, one, wrod.Friction(0.4)) for one in (plan, ends)]
    with pytest.raises(RodError, match="lay them apart"):
        wrod.simulate_deployments(trials, beyond_grip=True, **how)


def test_where_it_runs_into_the_hand_is_said_and_another_hold_taken(monkeypatch):
    """Straight along the fingers, which hold it: into the palm, a sphere of 5 cm, 12 cm away."""
    from wrod.robot.beyond import met_beyond

    points = np.column_stack([np.linspace(0.0, 0.15, 20), np.zeros(20)])
    plan = wrod.plan(wrod.Pattern.from_points(points), replace(ROD, length=0.4), spacing=0.02)
    path = wrod.solve_joint_path(plan, "sawyer", grip_angle=0.0)
    way = np.linspace(0.0, 0.2, 101)
    straight = plan.position[:, None] + way[:, None] * plan.rotation[:, None, :, 0]
    nodes = np.arange(len(plan))
    stiff = Beyond(nodes, plan.arc_length, straight, plan.contact, ROD.radius)
    met = met_beyond(path, stiff)
    assert met.link == "gripper" and met.laid == 0.0
    assert met.free == pytest.approx(0.12 - 0.05 - ROD.radius - 0.005, abs=0.003)
    short = Beyond(nodes, plan.arc_length, straight[:, :25], plan.contact, ROD.radius)
    assert met_beyond(path, short) is None
    # A hand that need not hold it so keeps clear of it.
    from wrod.robot.attempt import ArmTask

    monkeypatch.setattr(ArmTask, "_beyond", stiff)
    turned = wrod.solve_joint_path(plan, "sawyer")
    assert turned.grip.angle > 0.5 and met_beyond(turned, stiff) is None
