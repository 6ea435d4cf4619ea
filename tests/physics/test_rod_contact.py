"""Contact between rods: derivatives, balance of forces, Coulomb's law, nothing passes through."""

import numpy as np
import pytest
import warp as wp
from vps import RADIUS, WEIGHT, G, momenta
from vps import rods as batch_of

from wrod.errors import RodError
from wrod.rods.batch import RodBatch
from wrod.solvers.coupled import CoupledSystem
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.friction import Friction
from wrod.solvers.rod_contact import RodContact
from wrod.solvers.statics import prescribe


def scene(*rods, gravity=(0.0, 0.0, 0.0), scenes=1, stiffer=1.0):
    """One row with the given rods (node, 3), end to end; bending stiffness as a factor."""
    position = np.concatenate(rods)
    cuts = np.cumsum([len(q) for q in rods])[:-1] - 1
    return batch_of(np.repeat(position[None], scenes, axis=0), gravity, stiffer=stiffer, cuts=cuts)


def line(axis, nodes=15, length=0.07, offset=(0.0, 0.0, 0.0)):
    position = np.zeros((nodes, 3))
    position[:, axis] = np.linspace(-length / 2, length / 2, nodes)
    return position + offset


def hold(batch, nodes):
    """Prescribe nodes and the edges between them."""
    nodes = list(nodes)
    prescribe(batch, clamped_nodes=nodes, clamped_angles=nodes[:-1])


def rough_pair(turn, seed, smooth, hardening=0.0):
    """Two wavy rods inside each other's thickness, turned against each other by `turn` [rad]."""
    rng = np.random.default_rng(seed)
    x = np.linspace(0, 1, 8)
    a, b = (np.column_stack([x - 0.5, *(0.006 * rng.normal(size=(2, 8)))]) for _ in range(2))
    c, s = np.cos(turn), np.sin(turn)
    b = b @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [0.0, 0.01, 0.165]
    batch = RodBatch(
        np.concatenate([a, b])[None],
        stretching_stiffness=1.0,
        bending_stiffness=1e-2,
        twisting_stiffness=1e-2,
    )
    batch.cut([7])
    contact = RodContact(
        batch, 0.09, Friction(0.0), stiffness=3.0, smooth=smooth, hardening=hardening
    )
    contact.prepare(batch.every_rod, batch.state.dof)
    contact.held_load.fill_(1e9)  # nothing of the matrix is left out for the sake of Newton
    contact.reach.fill_(1e9)
    contact.rubbing.iteration.fill_(5)
    return batch, contact


@pytest.mark.parametrize("turn", [0.0, 0.05, 0.3, np.pi / 2])
@pytest.mark.parametrize("smooth, hardening", [(False, 0.0), (True, 0.0), (False, 7.0)])
def test_derivatives_of_the_contact_energy(turn, smooth, hardening):
    """Forces against differences of the energy, the matrix against differences of the forces, for
    rods that cross and rods that lie along each other."""
    batch, contact = rough_pair(turn, 3, smooth, hardening)
    ones, gradient = batch.every_rod, batch.derivatives.gradient
    before = wp.clone(batch.state.dof)
    x = before.numpy().copy()

    def evaluate(dof):
        batch.state.dof.assign(dof)
        gradient.zero_()
        contact.add(ones, batch.state.dof, before)
        return contact.energy()[0], gradient.numpy()[0].copy()

    n, step = x.shape[1], 1e-6
    force, matrix = np.empty(n), np.empty((n, n))
    for k in range(n):
        change = np.zeros_like(x)
        change[0, k] = step
        up, down = evaluate(x + change), evaluate(x - change)
        force[k] = (up[0] - down[0]) / (2 * step)
        matrix[:, k] = (up[1] - down[1]) / (2 * step)
    got = evaluate(x)[1]
    assert np.abs(got).max() > 1e-3
    assert got == pytest.approx(force, abs=1e-8)

    # The skyline solver, column by column, of the matrix shifted away from singular.
    system, shift = CoupledSystem(contact), 0.7
    system.shift.fill_(shift)
    batch.derivatives.hessian.zero_()
    system.factorise(batch.derivatives.hessian, ones)
    inverse = np.empty((n, n))
    for k in range(n):
        column = np.zeros((1, 1, n))
        column[0, 0, k] = 1.0
        system.x.assign(column)
        system.solve(ones)
        inverse[:, k] = system.x.numpy()[0, 0]
    shifted = matrix + shift * np.eye(n)
    assert np.linalg.inv(inverse) == pytest.approx(shifted, abs=1e-6 * np.abs(matrix).max())
    assert system.negative_pivots.numpy()[0] == (np.linalg.eigvalsh(shifted) < 0).sum()


@pytest.mark.parametrize("smooth", [False, True])
def test_long_edges_that_cross_touch_at_their_own_distance(smooth):
    """Edges of 20 radii that cross anywhere along them are as deep as they are."""
    depth = 0.1 * RADIUS
    above = line(1, 4, 60 * RADIUS, (3 * RADIUS, 2 * RADIUS, 2 * RADIUS - depth))
    batch = scene(line(0, 4, 60 * RADIUS), above)
    contact = RodContact(batch, RADIUS, Friction(0.3), smooth=smooth)
    assert contact.depth.numpy().max() == pytest.approx(depth, rel=1e-9)


def test_rods_of_one_row_do_not_feel_each_other_apart():
    """Two rods in a row move as each does alone, whatever the direction of the cut."""
    a = line(0) + 0.01 * line(0)[:, [0]] ** 2 / 0.07
    b = line(1, offset=(0.0, 0.3, 0.1))[::-1]
    pair, single = scene(a, b, gravity=(0, 0, -G)), scene(b, gravity=(0, 0, -G))
    for batch, i in ((pair, 15), (single, 0)):
        hold(batch, [i, i + 1])
        contact = RodContact(batch, RADIUS, Friction(0.3))
        Dynamics(
            batch, scheme="euler", radius=RADIUS, contact=contact, keeps_recording=True
        ).advance(0.05, 5e-3)
    assert pair.positions()[0, 15:] == pytest.approx(single.positions()[0], abs=1e-9)


@pytest.mark.parametrize("scheme", ["euler", "bdf2"])
def test_momentum_when_two_free_rods_collide(scheme):
    batch = scene(line(0, offset=(0, 0.0005, 0)), line(1, offset=(0.0007, 0, 3 * RADIUS)))
    contact = RodContact(batch, RADIUS, Friction(0.3))
    dynamics = Dynamics(batch, scheme=scheme, radius=RADIUS, contact=contact, keeps_recording=True)
    velocity = np.zeros((1, 30, 3))
    velocity[0, 15:] = [0.03, 0.05, -0.1]
    dynamics.set_velocity(velocity)
    before = momenta(dynamics)
    assert not dynamics.advance(0.04, 1e-3).diverged[0]
    after = momenta(dynamics)
    assert dynamics.velocities()[0, :15, 2].mean() < -0.02  # it was hit
    assert after[0] == pytest.approx(before[0], abs=1e-9 * np.linalg.norm(before[0]))
    # Angular momentum has the order of the scheme.
    assert after[1] == pytest.approx(before[1], abs=0.02 * np.linalg.norm(before[1]))


def test_crossing_rods_pressed_together():
    """The lower rod, held, carries the weight of the upper one and a load on it; friction keeps
    it balanced. Penetration is that of the law of contact, below 5 % of the radius."""
    batch = scene(
        line(0, nodes=9, length=0.02, offset=(0, 0.008, 0)),
        line(0, nodes=9, length=0.02, offset=(0, -0.008, 0)),
        line(1, nodes=16, length=0.075, offset=(0, 0, 2.05 * RADIUS)),
        gravity=(0, 0, -G),
    )
    hold(batch, range(9))
    free = batch.free.numpy() != 0
    free[:, 36 : 36 + 35] = False
    batch.set_free(free)
    load = np.zeros((1, 34, 3))
    load[0, 25:27, 2] = -0.02
    batch.point_load.assign(load)
    contact = RodContact(batch, RADIUS, Friction(0.4))
    dynamics = Dynamics(
        batch,
        scheme="euler",
        radius=RADIUS,
        contact=contact,
        air_damping=30.0,
        keeps_recording=True,
    )
    dynamics.advance(1.0, 4e-3)
    force = contact.forces()[0]
    expected = 0.04 + WEIGHT * 0.075
    assert force[18:].sum(axis=0) == pytest.approx([0, 0, expected], abs=1e-4 * expected)
    assert force[:18].sum(axis=0) == pytest.approx(-force[18:].sum(axis=0), abs=1e-12)
    law = contact.pieces.law.numpy()[0]
    share = expected / 2
    pairs = (contact.depth.numpy() > 0).sum()
    assert pairs >= 2
    if pairs == 2:
        p = np.sqrt(2 * share * law["skin"] / law["stiffness"])
        assert contact.penetration.numpy()[0] == pytest.approx(p, rel=0.05)
    assert 0 < contact.penetration.numpy()[0] < 0.05 * RADIUS


def on_rails(angles, friction, smooth=False):
    """A rod across two held rods, at rest, then tilted about the rails by `angles` [deg]."""
    angles = np.radians(angles)
    rails = [line(1, nodes=7, length=0.024, offset=(x, 0.0005, 0)) for x in (-0.015, 0.0155)]
    rod = line(0, nodes=15, length=0.07, offset=(0.0, 0, 2 * RADIUS))
    # Straight under its weight, so that it is a block.
    batch = scene(*rails, rod, gravity=(0, 0, -G), scenes=len(angles), stiffer=50.0)
    prescribe(batch, clamped_nodes=range(14), clamped_angles=range(14))
    contact = RodContact(batch, RADIUS, friction, smooth=smooth)
    dynamics = Dynamics(
        batch,
        scheme="euler",
        radius=RADIUS,
        contact=contact,
        air_damping=0.0,
        tolerance=1e-8,
        keeps_recording=True,
    )
    dynamics.air_damping.fill_(30.0)
    dynamics.advance(0.2, 4e-3)
    gravity = np.zeros((len(angles), 3))
    for part in np.linspace(0, 1, 17)[1:]:
        gravity[:, 0], gravity[:, 2] = G * np.sin(part * angles), -G * np.cos(part * angles)
        batch.gravity.assign(gravity)
        dynamics.advance(0.2 + 0.2 * part, 4e-3)
    return dynamics


def test_friction_holds_and_slides():
    """A rod on two rails slides along itself if and only if tan(angle) > mu, with
    a = g (sin - mu cos)."""
    angles = np.array([0.0, 15.0, 20.0, 24.0, 35.0])  # arctan(0.4) = 21.8
    dynamics = on_rails(angles, Friction(0.4))
    dynamics.air_damping.zero_()
    velocity = []
    for time in (0.41, 0.43):
        dynamics.advance(time, 1e-3)
        velocity.append(dynamics.velocities()[:, 14:, 0].mean(axis=1).copy())
    a = np.radians(angles)
    expected = np.where(np.tan(a) > 0.4, G * (np.sin(a) - 0.4 * np.cos(a)), 0.0)
    assert (velocity[1] - velocity[0]) / 0.02 == pytest.approx(expected, abs=5e-3 * G)


def test_smooth_rods_slide_down_the_slightest_slope():
    """Without friction a = g sin(angle) over two edges at slopes of a percent."""
    angles = np.degrees([0.003, 0.01])
    dynamics = on_rails(angles, Friction(0.0), smooth=True)
    dynamics.air_damping.zero_()
    dynamics.velocity.zero_()
    start = dynamics.batch.positions()[:, 14:, 0].mean(axis=1).copy()
    dynamics.advance(0.8, 1e-3)
    travelled = dynamics.batch.positions()[:, 14:, 0].mean(axis=1) - start
    assert travelled == pytest.approx(0.5 * G * np.sin(np.radians(angles)) * 0.4**2, rel=0.02)


def test_sticking_does_not_creep():
    """A simulated minute at 90 % of the friction that there is."""
    dynamics = on_rails(np.degrees([np.arctan(0.36)]), Friction(0.4))
    dynamics.advance(1.0, 0.01)
    before = dynamics.batch.positions().copy()
    dynamics.advance(61.0, 0.05)
    assert np.abs(dynamics.batch.positions() - before).max() < 1e-3 * RADIUS


@pytest.mark.parametrize(("speed", "step"), [(0.1, 0.02), (0.1, 0.005), (1.0, 0.02)])
def test_nothing_tunnels(speed, step):
    """A rod thrown onto two held ones bounces off, however long the step that is asked for."""
    rails = [line(1, nodes=9, offset=(x, 0, 0)) for x in (-0.02, 0.02)]
    batch = scene(*rails, line(0, offset=(0, 0.001, 4 * RADIUS)))
    prescribe(batch, clamped_nodes=range(18), clamped_angles=range(18))
    dynamics = Dynamics(
        batch,
        scheme="euler",
        radius=RADIUS,
        contact=RodContact(batch, RADIUS, Friction(0.3)),
        keeps_recording=True,
    )
    velocity = np.zeros((1, 33, 3))
    velocity[0, 18:, 2] = -speed
    dynamics.set_velocity(velocity)
    duration = 12 * RADIUS / speed
    for time in np.linspace(0, duration, 25)[1:]:
        dynamics.advance(time, step)
        above_rails = batch.positions()[0, [18 + 3, 18 + 11], 2]
        assert above_rails.min() > 1.5 * RADIUS
    assert above_rails.min() > 2.5 * RADIUS


def test_bad_rod_contacts_are_refused():
    batch = scene(line(0), line(1, offset=(0, 0, 0.01)))
    with pytest.raises(RodError, match="radius"):
        RodContact(batch, 0.0, Friction(0.3))
    with pytest.raises(RodError, match="radius has shape"):
        RodContact(batch, np.ones(7), Friction(0.3))
    with pytest.raises(RodError, match="stiffness"):
        RodContact(batch, RADIUS, Friction(0.3), stiffness=-1.0)
    with pytest.raises(RodError, match="two RodContact"):
        contact = RodContact(batch, RADIUS, Friction(0.3))
        Dynamics(batch, radius=RADIUS, contact=[contact, contact])
    with pytest.raises(RodError, match="inside each other"):
        RodContact(scene(line(0), line(1, offset=(0, 0, RADIUS))), RADIUS, Friction(0.3))
    with pytest.raises(RodError, match="more than 1 partners"):
        RodContact(scene(line(0), line(1, offset=(0, 0, 0.003))), RADIUS, Friction(0.3), partners=1)
    with pytest.raises(RodError, match="cannot cut"):
        batch.cut([28])
    with pytest.raises(RodError, match="cannot cut"):
        batch.cut([40])


def test_friction_is_bounded_by_the_load_of_its_own_step():
    """|F_t| <= mu N of the same step, within a twentieth, of a rod that slides while its load falls
    by a quarter in each step."""
    mu = 0.4
    dynamics = on_rails([30.0], Friction(mu))
    dynamics.air_damping.zero_()
    contact, gravity = dynamics.contacts[0], dynamics.batch.gravity.numpy().copy()
    stiffness = contact.pieces.law.numpy()[0]["stiffness"]
    slot = np.arange(contact.load.shape[2])
    shares = []
    for k in range(8):
        gravity[:, 2] *= 0.75
        dynamics.batch.gravity.assign(gravity)
        assert not dynamics.advance(0.4 + 4e-3 * (k + 1), 4e-3).diverged.any()
        load = contact.load.numpy().copy()
        held = (slot < contact.partner_count.numpy()[:, :, None]) & (load > 0)
        pull = stiffness * np.linalg.norm(contact.bristle.numpy(), axis=3)
        shares.append((pull[held] / (mu * load[held])).max())
    assert max(shares) < 1.05
    assert np.mean(shares) > 0.98  # it slides all the while
