"""What hangs beyond the grip: its shape, the table and the arm."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

import wrod
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


def test_where_it_runs_into_the_hand_is_said():
    """Straight along the fingers, which hold it: into the palm, a sphere of 5 cm, 12 cm away."""
    from wrod.robot.beyond import met_beyond

    points = np.column_stack([np.linspace(0.0, 0.15, 20), np.zeros(20)])
    plan = wrod.plan(wrod.Pattern.from_points(points), replace(ROD, length=0.4), spacing=0.01)
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
