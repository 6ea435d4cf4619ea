"""The second engine is right where closed forms are known, and agrees where another has played."""

import pytest

pytest.importorskip("mujoco", reason="MuJoCo is not installed (pip install wrod[peers])")

import numpy as np

import wrod
from wrod.bench.mujoco_chain import chain, put_down_in_mujoco
from wrod.bench.put_down import put_down
from wrod.deployment.setup import Disturbance
from wrod.solvers.friction import Friction

ROD = wrod.rod("green-vps")
LGB = ROD.gravito_bending_length
HOW = dict(weight=ROD.weight, radius=ROD.radius)


def straight(length, count, height):
    x = np.linspace(0.0, length, count + 1)
    return np.column_stack([x, 0.0 * x, height + 0.0 * x])


@pytest.mark.parametrize("gamma, drop, reach", [(1.0, 0.12347, 0.99125), (10.0, 0.70020, 0.65635)])
def test_a_heavy_cantilever_droops(gamma, drop, reach):
    """Gamma = w L^3 / B; the elastica by collocation."""
    edge, count, held = 0.005, 32, 3
    length = edge * (count - held + 0.5)  # level in the middle of the last segment that is held
    one = chain(
        straight(edge * count, count, 1.0), [0.0, 1.0, 0.0], held=held, hand=False, friction=0.3,
        stiffness=ROD.weight * length**3 / gamma, **HOW,
    )  # fmt: skip
    one.step(1800)
    nodes = one.nodes()
    level = nodes[held] - nodes[held - 1]
    assert abs(level[2]) < 5e-3 * edge  # welds give way a little, which is taken off
    tip = nodes[-1] - 0.5 * (nodes[held] + nodes[held - 1])
    assert (tip[0] * level[2] - tip[2] * level[0]) / edge / length == pytest.approx(drop, rel=5e-3)
    assert tip[0] / length == pytest.approx(reach, rel=5e-3)


@pytest.mark.parametrize("slope", [0.28, 0.32])
def test_a_rod_slides_where_the_slope_is_steeper_than_friction(slope):
    mu, tilt, seconds = 0.3, np.arctan(slope), 0.1
    down = 9.81 * np.array([0.0, np.sin(tilt), -np.cos(tilt)])
    one = chain(
        straight(0.2, 25, ROD.radius), [0.0, 1.0, 0.0], stiffness=ROD.bending_stiffness,
        friction=mu, hand=False, gravity=tuple(down), **HOW,
    )  # fmt: skip
    at = []
    for _ in range(4):
        one.step(round(seconds / one.model.opt.timestep), air=0.0)
        at.append(one.nodes()[:, 1].mean())
    speed = np.diff(at) / seconds
    if slope < mu:
        assert np.abs(speed).max() < 2e-5  # regularised friction creeps
    else:
        along = 9.81 * (np.sin(tilt) - mu * np.cos(tilt))
        assert np.diff(speed) / seconds == pytest.approx(along, rel=0.05)


def test_the_hanging_part_has_the_shape_of_the_grasp():
    """Held level at the table, by the hand where a rod that hardly stretches is to be held."""
    suspended, edge, laid = 8.0, 0.1, 4
    grasp = wrod.solve_grasps([suspended], [0.0], [1e5])
    path = np.cumsum(np.linalg.norm(np.diff(grasp.shape[0], axis=0), axis=1))
    s = np.concatenate([[0.0], path])
    count = round(suspended / edge)
    hang = np.column_stack(
        [np.interp(np.linspace(0.0, suspended, count + 1), s, c) for c in grasp.shape[0].T]
    )
    before = np.column_stack([np.arange(-laid, 0) * edge, np.zeros(laid), np.zeros(laid)])
    nodes = LGB * np.concatenate([before, hang]) + [0.0, 0.0, ROD.radius]
    one = chain(
        nodes, [0.0, 1.0, 0.0], stiffness=ROD.bending_stiffness, friction=0.6, held=laid,
        lengths=np.full(laid + count, edge * LGB), **HOW,
    )  # fmt: skip
    target = LGB * grasp.position[0] + [0.0, 0.0, ROD.radius]
    begin = one.data.mocap_pos[0].copy()
    for share in np.linspace(0.0, 1.0, 100):
        one.data.mocap_pos[0] = begin + share * (target - begin)
        one.step()
    one.step(300)
    assert np.abs(one.nodes() - nodes).max() < 0.03 * LGB


@pytest.mark.parametrize("mu", [0.02, 0.3, 1.0])
def test_a_bent_rod_straightens_as_in_our_own_engine(mu):
    arc = wrod.Pattern.from_points(
        [(0.05 * np.sin(a), 0.05 * (1.0 - np.cos(a))) for a in np.linspace(0.0, np.pi, 60)]
    )
    s, place = put_down_in_mujoco(arc, ROD, mu, step=0.001)
    ((own_s, own, _, _),) = put_down(
        [(arc, ROD, Friction(mu), Disturbance())], node_count=33, step=0.005
    )
    left, own_left = (
        np.linalg.norm((x - arc.sample(at)[0])[:, :2], axis=1)
        for at, x in ((s, place), (own_s, own))
    )
    assert left.mean() == pytest.approx(own_left.mean(), rel=0.06)
    assert np.abs(left - np.interp(s, own_s, own_left)).max() < 0.003
