"""Contact of edges with boxes and cylinders: derivatives, closed forms, nothing passes through."""

import numpy as np
import pytest
import warp as wp
from vps import CONTACT, RADIUS, WEIGHT, G, Pull, half_turn, rods, rope, straight, tensions

from wrod.solvers.contact import Contact
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.friction import Friction
from wrod.solvers.rod_contact import RodContact
from wrod.solvers.solids import Box, Cylinder, Plane
from wrod.solvers.statics import prescribe

TURN = (0.0, 0.0, float(np.sin(0.3)), float(np.cos(0.3)))
SHAPES = {
    "pin": Cylinder((0.0, 0.0, 0.0), 0.0005, 0.004),
    "post": Cylinder((0.0, 0.001, 0.0), 0.01, 0.003, axis=(0.3, 0.1, 1.0)),
    "box": Box((0.001, 0.0, 0.0), (0.004, 0.003, 0.002), TURN),
}


def distance(shape, q):
    """Signed distance (n,) of points q (n, 3), by NumPy alone."""
    p = q - np.array(shape.center)
    if isinstance(shape, Box):
        x, y, z, w = shape.rotation
        c, s = w * w - z * z, 2 * w * z
        d = np.abs(p @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])) - shape.half_size
        assert x == y == 0
    else:
        axis = np.array(shape.axis) / np.linalg.norm(shape.axis)
        up = p @ axis
        across = np.linalg.norm(p - up[:, None] * axis, axis=1)
        d = np.column_stack([across - shape.radius, np.abs(up) - shape.half_height])
    return np.linalg.norm(np.maximum(d, 0.0), axis=1) + np.minimum(d.max(axis=1), 0.0)


def along(nodes, points=200):
    """Points of all edges, not their ends alone."""
    at = np.arange(points * (len(nodes) - 1) + 1) / points
    return np.column_stack([np.interp(at, np.arange(len(nodes)), x) for x in nodes.T])


def sticks(shape, count, seed, deepest=0.5):
    """Straight rods of three edges in random directions that touch `shape`."""
    rng, out = np.random.default_rng(seed), []
    while len(out) < count:
        towards, direction = rng.standard_normal((2, 3))
        centre = np.array(shape.center) + towards / np.linalg.norm(towards) * rng.uniform(0, 0.013)
        direction /= np.linalg.norm(direction)
        nodes = centre + np.outer(np.linspace(-1, 1, 4), direction) * 0.0075
        depth = RADIUS - distance(shape, along(nodes)).min()
        if 0.02 * RADIUS < depth < deepest * RADIUS:
            out.append(nodes)
    return np.array(out)


@pytest.mark.parametrize("name", SHAPES)
def test_depth_is_that_of_the_nearest_point(name):
    """Against the closest of 200 points on every edge."""
    shape = SHAPES[name]
    nodes = sticks(shape, 40, seed=1)
    contact = Contact(rods(nodes), RADIUS, 1e5, Friction(0.0), shapes=(shape,))
    expected = [RADIUS - distance(shape, along(q)).min() for q in nodes]
    # Points are 0.025 mm apart: on a bend of radius 2 mm the nearest is 4e-8 m too far at most.
    assert contact.penetration() == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("rolling", [False, True])
@pytest.mark.parametrize("name", SHAPES)
def test_hessian_is_the_derivative_of_the_forces(name, rolling):
    """Without friction, exactly; edges and corners of boxes and rims of cylinders included."""
    batch = rods(sticks(SHAPES[name], 24, seed=2), gravity=(0.0, 0.0, 0.0))
    law = Friction(0.0, rolling=rolling)
    contact = Contact(batch, RADIUS, 1e5, law, shapes=(SHAPES[name],))
    dof = batch.state.dof.numpy().copy()
    # The rods have moved in this step, so that bristles know where to slide.
    moved = dof + 1e-4 * np.random.default_rng(3).standard_normal(dof.shape)
    before = wp.array(moved, device=batch.device)

    def forces(dof):
        out = batch.derivatives
        out.gradient.zero_()
        out.hessian.zero_()
        batch.state.dof.assign(dof)
        contact.add(batch.every_rod, batch.state.dof, before)
        return out.gradient.numpy().copy(), out.hessian.numpy().copy(), contact.energy()

    force, band, _ = forces(dof)
    size = dof.shape[1]
    matrix, numeric = np.zeros((2, len(dof), size, size))
    slope = np.zeros_like(force)
    for a in range(size):
        for k in range(min(a, 10) + 1):
            matrix[:, a, a - k] = matrix[:, a - k, a] = band[:, a, k]
        step = np.zeros(size)
        step[a] = 1e-8
        up, down = forces(dof + step), forces(dof - step)
        numeric[:, :, a] = (up[0] - down[0]) / 2e-8
        slope[:, a] = (up[2] - down[2]) / 2e-8
    error = np.abs(matrix - numeric).max(axis=(1, 2)) / np.abs(matrix).max(axis=(1, 2))
    # A kink of the law (face to edge) may lie within the difference's step.
    assert np.sort(error)[-3] < 1e-6
    assert slope == pytest.approx(force, abs=1e-6 * np.abs(force).max())


def test_rod_leans_on_a_pin_between_two_nodes():
    """A beam on two supports under its weight w, propped in the middle of its middle edge by a pin
    that is thinner than a tenth of the edge: the pin carries 5/8 w L, and the rod does not sink
    in."""
    length, nodes = 0.10, 22
    position = straight(nodes=nodes, height=0.0, length=length)
    pin = Cylinder((length / 2, 0.0, -RADIUS - 0.0002), 0.0002, 0.05, axis=(0, 1, 0))
    batch = rods(position)
    prescribe(batch, clamped_nodes=[0, nodes - 1], clamped_angles=[0])
    contact = Contact(batch, RADIUS, 8 * CONTACT, Friction(0.3), shapes=(pin,))
    dynamics = Dynamics(
        batch,
        scheme="euler",
        radius=RADIUS,
        contact=contact,
        air_damping=20.0,
        keeps_recording=True,
    )
    assert not dynamics.advance(1.0, 5e-3).diverged.any()
    assert 0.0 < contact.penetration()[0] < 0.05 * RADIUS
    force = contact.force.numpy()[0]
    assert force[:, 2].sum() == pytest.approx(5 / 8 * WEIGHT * length, rel=0.01)
    assert np.flatnonzero(force[:, 2]).tolist() == [nodes // 2 - 1, nodes // 2]
    assert force[nodes // 2, 2] == pytest.approx(force[nodes // 2 - 1, 2], rel=1e-3)


@pytest.mark.parametrize("shape", ["pin", "corner"])
@pytest.mark.parametrize("friction", [0.2, 0.4])
def test_capstan_over_what_is_thinner_than_an_edge(shape, friction):
    """A rope drawn through 40 degrees over a pin of 0.3 mm, or over the corner of a box, with edges
    of 4 mm: tensions in the ratio exp(mu phi). A polygon that turns on less than an edge pulls now
    more, now less; over the passage of one edge that evens out."""
    turn, edge, load = np.radians(20.0), 4e-3, 0.2
    fixture = {
        "pin": Cylinder((0.0, 0.0, -0.0003), 0.0003, 0.05, axis=(0, 1, 0)),
        "corner": Box(
            (0.0, 0.0, -0.01 * np.sqrt(2.0)),
            (0.01, 0.05, 0.01),
            (0.0, float(np.sin(np.pi / 8)), 0.0, float(np.cos(np.pi / 8))),
        ),
    }[shape]
    out = np.array([np.cos(turn), 0.0, -np.sin(turn)])
    left = out * [-1.0, 1.0, 1.0]
    s = edge * (np.arange(10) + 0.5)
    top = np.array([0.0, 0.0, RADIUS / np.cos(turn)])
    position = np.concatenate([top + s[::-1, None] * left, top + s[:, None] * out])
    batch = rope(position, load * left, edge)
    contact = Contact(batch, RADIUS, 1e6, Friction(friction), shapes=(fixture,))
    dynamics = Dynamics(
        batch,
        scheme="euler",
        radius=RADIUS,
        contact=contact,
        air_damping=20.0,
        motion=Pull(batch, out),
        keeps_recording=True,
    )
    ratios, until = [], 0.3
    for _ in range(8):
        dynamics.advance(until, 4e-3)
        tension = tensions(batch)
        ratios.append(tension[-2] / tension[1])
        until += edge / 8 / 0.01
        assert contact.penetration()[0] < 0.05 * RADIUS
    assert np.mean(ratios) == pytest.approx(np.exp(2 * turn * friction), rel=0.03)


@pytest.mark.parametrize("axis", [0, 1])
def test_block_on_a_tilted_box(axis):
    """On a wall edges lie flat: they slide as on a plane, with g (sin - mu cos)."""
    angle = np.radians(40.0)
    down = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    up = np.array([np.sin(angle), 0.0, np.cos(angle)])
    along_axis = down if axis == 0 else np.array([0.0, 1.0, 0.0])
    s = np.linspace(0.0, 0.07, 8)
    nodes = s[:, None] * along_axis + RADIUS * up
    half = angle / 2
    wall = Box(tuple(-0.01 * up), (0.3, 0.3, 0.01), (0.0, np.sin(half), 0.0, np.cos(half)))
    batch = rods(nodes[None])
    contact = Contact(batch, RADIUS, CONTACT, Friction(0.5), shapes=(wall,))
    dynamics = Dynamics(batch, scheme="euler", radius=RADIUS, contact=contact, keeps_recording=True)
    dynamics.advance(0.2, 4e-3)
    before = dynamics.velocities()[0].mean(axis=0) @ down
    dynamics.advance(0.3, 4e-3)
    got = (dynamics.velocities()[0].mean(axis=0) @ down - before) / 0.1
    assert got == pytest.approx(G * (np.sin(angle) - 0.5 * np.cos(angle)), rel=1e-3)


@pytest.mark.parametrize("speed", [0.5, 5.0])
def test_nothing_tunnels_through_a_pin(speed):
    """A rod thrown sideways at a pin of 0.3 mm, by up to 25 radii in a step, wraps round it."""
    position = straight(nodes=16, height=0.0, length=0.075)
    position[:, :, 1] = -0.02
    pin = Cylinder((0.0375, 0.0, 0.0), 0.0003, 0.05)
    batch = rods(position, gravity=(0.0, 0.0, 0.0))
    contact = Contact(batch, RADIUS, 100 * CONTACT, Friction(0.3), shapes=(pin,))
    dynamics = Dynamics(
        batch, scheme="euler", radius=RADIUS, contact=contact, air_damping=5.0, keeps_recording=True
    )
    velocity = np.zeros((1, 16, 3))
    velocity[:, :, 1] = speed
    dynamics.set_velocity(velocity)
    touched = False
    for k in range(1, 11):
        assert not dynamics.advance(0.06 / speed * k / 5, 8e-3).diverged.any()
        nodes = batch.positions()[0]
        line = along(nodes)
        assert distance(pin, line).min() > 0.0
        # Seen from above it is still on the near side of the pin, where it crosses the pin's x.
        at = np.abs(line[:, 0] - 0.0375).argmin()
        assert line[at, 1] < 0.0
        touched = touched or bool(np.abs(contact.force.numpy()).max() > 0.0)
    assert touched


def test_rods_of_a_batch_touch_their_own_fixtures():
    """Different fixtures, and different numbers of them, side by side as alone."""
    position = straight(count=3, height=RADIUS, length=0.07)
    post = Cylinder((0.033, 0.0, 0.0), 0.002, 0.004, axis=(0, 1, 0))
    block = Box((0.05, 0.0, 0.0), (0.004, 0.05, 0.003))
    scenes = [[Plane(), post], [Plane()], [Plane(), block, post]]
    position[:, :, 2] += 0.004

    def end(rows):
        batch = rods(position[rows])
        contact = Contact(
            batch, RADIUS, 8 * CONTACT, Friction(0.4), shapes=[scenes[r] for r in rows]
        )
        Dynamics(
            batch, scheme="euler", radius=RADIUS, contact=contact, keeps_recording=True
        ).advance(0.15, 5e-3)
        return batch.positions()

    together = end([0, 1, 2])
    for r in range(3):
        assert end([r])[0] == pytest.approx(together[r], abs=1e-12)
    assert np.abs(together[0] - together[1]).max() > 1e-3


def test_a_load_that_sinks_a_rod_deep_is_no_tunnelling():
    """A contact that is far too soft gives way by more than half a radius, and holds."""
    pin = Cylinder((0.0, 0.0, -RADIUS - 0.001), 0.001, 0.05, axis=(0, 1, 0))
    position = straight(nodes=12, height=0.0, length=0.066)
    position[:, :, 0] -= 0.033
    batch = rods(position)
    soft = WEIGHT * 0.066 / (0.7 * RADIUS * 0.006)
    contact = Contact(batch, RADIUS, soft, Friction(0.6), shapes=(pin,))
    dynamics = Dynamics(
        batch,
        scheme="euler",
        radius=RADIUS,
        contact=contact,
        air_damping=20.0,
        keeps_recording=True,
    )
    assert not dynamics.advance(0.3, 5e-3).diverged.any()
    assert 0.5 * RADIUS < contact.penetration()[0] < RADIUS
    assert contact.force.numpy()[0, :, 2].sum() == pytest.approx(WEIGHT * 0.066, rel=0.05)


def test_capstan_of_rod_on_rod():
    """A rope drawn half a turn around a thicker rod: it rubs with its inner side, which goes by R /
    (R + r) slower than its middle, so that power balances for tensions in the ratio
    exp(mu pi R / (R + r))."""
    post, edge, load, friction = 6e-3, 0.8e-3, 0.2, 0.3
    reach = post + RADIUS
    # The post first: the rope's end is the row's.
    nodes = np.concatenate([[[0.0, -0.03, 0.0], [0.0, 0.03, 0.0]], half_turn(reach, edge)])
    batch = rope(nodes, [0.0, 0.0, -load], edge, post=True)
    radius = np.full((1, batch.node_count - 1), RADIUS)
    radius[0, 0] = post
    contact = RodContact(batch, radius, Friction(friction), stiffness=1e4, partners=64)
    dynamics = Dynamics(
        batch, scheme="euler", radius=radius, contact=contact, air_damping=20.0,
        motion=Pull(batch, [0.0, 0.0, -1.0]), keeps_recording=True
    )  # fmt: skip
    ratios, until = [], 0.1
    for _ in range(4):
        assert not dynamics.advance(until, 2e-3).diverged.any()
        tension = tensions(batch)
        ratios.append(tension[-2] / tension[3])
        until += edge / 4 / 0.01
    assert contact.penetration.numpy()[0] < 0.05 * RADIUS
    exact = np.exp(friction * np.pi * post / (post + RADIUS))
    assert np.mean(ratios) == pytest.approx(exact, rel=0.02)
