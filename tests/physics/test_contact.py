"""Contact and friction against what a rigid block, a wheel and a rope do."""

import numpy as np
import pytest
from vps import (
    CONTACT,
    LGB,
    RADIUS,
    STIFFNESS,
    WEIGHT,
    G,
    Pull,
    half_turn,
    rods,
    rope,
    straight,
    tensions,
)

from wrod.errors import RodError
from wrod.rods.batch import RodBatch
from wrod.solvers.contact import Contact
from wrod.solvers.dynamics import SCHEMES, Dynamics
from wrod.solvers.friction import Friction, FrictionField
from wrod.solvers.solids import Box, Cylinder, Plane


def on_slope(angles, friction, axis=0, **options):
    """Rods that have come to rest on a level table, which is then tilted by `angles` [deg]."""
    angles = np.radians(angles)
    batch = rods(straight(len(angles), axis=axis))
    contact = Contact(batch, RADIUS, CONTACT, friction)
    dynamics = Dynamics(
        batch,
        scheme="euler",
        radius=RADIUS,
        contact=contact,
        tolerance=1e-9,
        **options,
        keeps_recording=True,
    )
    dynamics.advance(0.02, 2e-3)
    gravity = np.zeros((len(angles), 3))
    for part in np.linspace(0.0, 1.0, 17)[1:]:  # a sudden tilt would jerk it loose
        gravity[:, 0], gravity[:, 2] = G * np.sin(part * angles), -G * np.cos(part * angles)
        batch.gravity.assign(gravity)
        dynamics.advance(0.02 + 0.16 * part, 2e-3)
    return dynamics


def acceleration(dynamics, start=0.3, stop=0.5):
    dynamics.advance(start, 2e-3)
    before = dynamics.velocities().mean(axis=1)[:, 0]
    dynamics.advance(stop, 2e-3)
    return (dynamics.velocities().mean(axis=1)[:, 0] - before) / (stop - start)


def test_rest_on_the_table():
    """Its own weight sinks a rod by less than 5 % of its radius, and the table carries it all."""
    batch = rods(straight(height=1.5 * RADIUS))
    contact = Contact(batch, RADIUS, CONTACT, Friction(0.5))
    Dynamics(batch, scheme="euler", radius=RADIUS, contact=contact, keeps_recording=True).advance(
        0.3, 2e-3
    )
    z = batch.positions()[0, :, 2]
    assert 0.95 * RADIUS < z.min() <= z.max() < RADIUS
    assert contact.force.numpy()[0].sum(axis=0)[2] == pytest.approx(WEIGHT * 0.07, rel=1e-4)
    # What it stores is the work of that force on the way down.
    dof, stored = batch.state.dof.numpy().copy(), []
    for lift in (1e-9, -1e-9):
        lifted = dof.copy()
        lifted[:, 2::4] += lift
        batch.state.dof.assign(lifted)
        stored.append(contact.energy()[0])
    assert (stored[1] - stored[0]) / 2e-9 == pytest.approx(WEIGHT * 0.07, rel=1e-4)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("step", [1e-3, 4e-3])
def test_a_dropped_rod_stays_down(scheme, step):
    """From 0.3 m it does not come up again, and no energy comes from anywhere but the contact's
    own give, in which it has sunk by less than a tenth of the radius."""
    batch = rods(straight(height=0.3))
    contact = Contact(batch, RADIUS, CONTACT, Friction(0.5))
    dynamics = Dynamics(batch, scheme=scheme, radius=RADIUS, contact=contact, keeps_recording=True)
    energy, height = [dynamics.energy()[0]], []
    for time in np.arange(0.02, 0.6, 0.02):
        assert not dynamics.advance(time, step).diverged[0]
        energy.append(dynamics.energy()[0])
        height.append(batch.positions()[0, :, 2].max())
    assert max(height[13:]) < RADIUS  # it lands after 0.247 s
    assert height[-1] > 0.95 * RADIUS
    assert np.diff(energy).max() < WEIGHT * 0.07 * 0.1 * RADIUS


@pytest.mark.parametrize("restitution", [0.0, 0.3, 0.7])
def test_restitution(restitution):
    """The speed after an impact over that before it, in steps that resolve the contact."""
    batch = rods(straight(nodes=5, height=RADIUS + 0.01), gravity=0.0)
    contact = Contact(batch, RADIUS, CONTACT, Friction(0.5), restitution=restitution)
    dynamics = Dynamics(
        batch, scheme="bdf2", radius=RADIUS, contact=contact, keeps_recording=True, tolerance=1e-8,
        force_scale=0.01,
    )  # fmt: skip
    velocity = np.zeros((1, 5, 3))
    velocity[0, :, 2] = -0.5
    dynamics.set_velocity(velocity)
    dynamics.advance(0.05, 2e-5)
    # A viscous contact that only pushes leaves a hundredth at least.
    expected = 0.5 * max(restitution, 0.01)
    assert dynamics.velocities()[0, :, 2] == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("axis", [0, 1])
def test_block_on_a_slope(axis):
    """Slides if and only if tan(angle) > mu, with a = g (sin - mu cos)."""
    angles = np.array([10.0, 25.0, 30.5, 31.5, 50.0])  # arctan(0.6) = 30.96
    got = acceleration(on_slope(angles, Friction(0.6), axis))
    a = np.radians(angles)
    expected = np.where(np.tan(a) > 0.6, G * (np.sin(a) - 0.6 * np.cos(a)), 0.0)
    assert got == pytest.approx(expected, abs=1e-5 * G)


def test_static_and_kinetic_friction_differ():
    angles = np.array([20.0, 29.0, 33.0])
    got = acceleration(on_slope(angles, Friction(0.6, 0.3)))
    a = np.radians(angles)
    expected = np.where(np.tan(a) > 0.6, G * (np.sin(a) - 0.3 * np.cos(a)), 0.0)
    assert got == pytest.approx(expected, abs=1e-5 * G)


def test_each_rod_has_its_own_friction():
    coefficients = [Friction(0.0), Friction(0.2), Friction(0.5)]
    got = acceleration(on_slope([20.0] * 3, coefficients))
    a = np.radians(20.0)
    expected = [G * np.sin(a), G * (np.sin(a) - 0.2 * np.cos(a)), 0.0]
    assert got == pytest.approx(expected, abs=1e-5 * G)


def test_friction_varies_over_the_table():
    """A block that slides from friction 0.1 onto 0.5 stops where its energy is used up."""
    ice = (-1.0, 1.0), (-0.5, 0.5), (201, 2)
    field = FrictionField.of(lambda x, y: np.where(y < 0.05, 0.2, 1.0), *ice)
    batch = rods(straight())
    contact = Contact(batch, RADIUS, CONTACT, Friction(0.5), friction_field=field)
    dynamics = Dynamics(batch, scheme="euler", radius=RADIUS, contact=contact, keeps_recording=True)
    dynamics.advance(0.1, 2e-3)
    velocity = np.zeros((1, 15, 3))
    velocity[:, :, 1] = 0.6
    dynamics.set_velocity(velocity)
    dynamics.advance(1.0, 2.5e-4)
    # v^2 / 2 = g (0.1 s_1 + 0.3 s_2 + 0.5 s_3): between the grid's points it is their mean.
    rest = (0.6**2 / 2 / G - 0.1 * 0.045 - 0.3 * 0.005) / 0.5
    assert batch.positions()[0, :, 1].mean() == pytest.approx(0.05 + rest, abs=3e-4)


def test_wheel_rolls_down_a_slope():
    """A rod across the slope rolls: a = 2/3 g sin(angle) of a solid cylinder, while it grips."""
    got = acceleration(on_slope([10.0, 25.0], Friction(0.6, rolling=True), axis=1))
    assert got == pytest.approx(2 / 3 * G * np.sin(np.radians([10.0, 25.0])), rel=1e-4)


def test_sticking_does_not_creep():
    """A simulated minute on a slope that asks for 95 % of the friction that there is."""
    dynamics = on_slope(np.degrees([np.arctan(0.57)]), Friction(0.6))
    dynamics.advance(1.0, 0.01)
    before, slip = dynamics.batch.positions().copy(), dynamics.contact.slip.numpy().copy()
    dynamics.advance(61.0, 0.02)
    assert np.abs(dynamics.batch.positions() - before).max() < 1e-9
    assert (dynamics.contact.slip.numpy() == slip).all()


def test_sliding_rod_stops_and_stays():
    """From speed v it slides v^2 / (2 mu g), then sticks."""
    batch = rods(straight())
    contact = Contact(batch, RADIUS, CONTACT, Friction(0.4))
    dynamics = Dynamics(batch, scheme="euler", radius=RADIUS, contact=contact, keeps_recording=True)
    dynamics.advance(0.1, 2e-3)
    before = batch.positions()[0, :, 0].mean()
    velocity = np.zeros((1, 15, 3))
    velocity[:, :, 1] = 0.3
    dynamics.set_velocity(velocity)
    dynamics.advance(0.5, 2.5e-4)
    distance = 0.3**2 / (2 * 0.4 * G)
    assert batch.positions()[0, :, 1].mean() == pytest.approx(distance, rel=0.01)
    assert contact.slip.numpy().mean() == pytest.approx(distance, rel=0.01)
    assert abs(batch.positions()[0, :, 0].mean() - before) < 1e-6
    resting = batch.positions().copy()
    dynamics.advance(2.0, 5e-3)
    assert np.abs(batch.positions() - resting).max() < 1e-6


def test_tilted_plane_is_a_slope():
    """The same acceleration when the table is turned instead of gravity."""
    angle = np.radians(40.0)
    normal = np.array([np.sin(angle), 0.0, np.cos(angle)])
    down = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    s = np.linspace(0.0, 0.07, 15)
    batch = rods((s[:, None] * down + RADIUS * normal)[None])
    contact = Contact(batch, RADIUS, CONTACT, Friction(0.5), shapes=(Plane(normal=tuple(normal)),))
    dynamics = Dynamics(batch, scheme="euler", radius=RADIUS, contact=contact, keeps_recording=True)
    dynamics.advance(0.2, 2e-3)
    before = dynamics.velocities()[0].mean(axis=0) @ down
    dynamics.advance(0.4, 2e-3)
    got = (dynamics.velocities()[0].mean(axis=0) @ down - before) / 0.2
    assert got == pytest.approx(G * (np.sin(angle) - 0.5 * np.cos(angle)), rel=1e-4)


@pytest.mark.parametrize(
    ("shape", "distance"),
    [
        (
            Cylinder((0.0, 0.0, 0.0), radius=0.01, half_height=0.05, axis=(0, 1, 0)),
            lambda q: np.hypot(q[:, 0], q[:, 2]) - 0.01,
        ),
        (
            Box((0.0, 0.0, 0.0), half_size=(0.02, 0.05, 0.01)),
            lambda q: np.linalg.norm(np.maximum(np.abs(q) - [0.02, 0.05, 0.01], 0.0), axis=1),
        ),
    ],
    ids=["cylinder", "box"],
)
def test_rod_hangs_over_a_fixture(shape, distance):
    """A rod dropped over a fixture drapes over it: it touches, it does not pass through, and
    friction keeps it from sliding off."""
    position = straight(nodes=81, height=0.012 + RADIUS, length=0.32)
    position[:, :, 0] -= 0.16
    batch = rods(position)
    # A point that carries the whole rod needs a stiffer contact than a table does.
    contact = Contact(batch, RADIUS, 8 * CONTACT, Friction(0.6), shapes=(shape,))
    dynamics = Dynamics(
        batch,
        scheme="euler",
        radius=RADIUS,
        contact=contact,
        air_damping=10.0,
        keeps_recording=True,
    )
    assert not dynamics.advance(1.5, 4e-3).diverged.any()
    q = batch.positions()[0]
    at = np.arange(20 * 80 + 1) / 20  # on edges too, not at nodes alone
    gap = distance(np.column_stack([np.interp(at, np.arange(81), x) for x in q.T]))
    assert 0.95 * RADIUS < gap.min() < RADIUS
    assert q[0, 2] < -0.03
    assert q[-1, 2] < -0.03
    force = contact.force.numpy()[0].sum(axis=0)
    assert force[2] == pytest.approx(WEIGHT * 0.32, rel=0.02)


def on_its_side(natural, roll, nodes=15, bend=10.0):
    """A rod that lies along an arc, its natural curvature across it, pressed down by its weight:
    nodes stay where they are, angles are free. The torque B kappa kappa_0 sin(angle) of all inner
    nodes wants to lay it down, mu_r w L R is what the table can hold."""
    angle = bend * np.linspace(0.0, 0.07, nodes)
    # The law of contact at the depth that carries the weight.
    depth = np.sqrt(2 * WEIGHT * 0.01 * RADIUS / CONTACT)
    height = np.full(nodes, RADIUS - depth)
    position = np.column_stack([np.sin(angle) / bend, (1 - np.cos(angle)) / bend, height])
    batch = RodBatch(
        np.repeat(position[None], len(natural), axis=0),
        stretching_stiffness=4 * STIFFNESS / RADIUS**2,
        bending_stiffness=STIFFNESS,
        twisting_stiffness=STIFFNESS / 1.5,
        natural_curvature=np.array([[[k, 0.0]] for k in natural]),
        node_mass=WEIGHT / G * 0.07 / nodes,
        director=(0.0, 0.0, 1.0),
    )
    free = np.zeros(batch.dof_count, dtype=bool)
    free[3::4] = True
    batch.set_free(free)
    law = Friction(0.5, roll=roll)
    contact = Contact(batch, RADIUS, CONTACT, law, keeps_roll=True)
    return Dynamics(
        batch, scheme="euler", radius=RADIUS, contact=contact, air_damping=2000.0,
        force_scale=WEIGHT * LGB, tolerance=1e-9, keeps_recording=True,
    )  # fmt: skip


@pytest.mark.parametrize("step", [5e-3, 0.05])
def test_roll_is_held_up_to_a_bound(step):
    """Below it a naturally curved rod on its side holds its roll for a minute and does not creep,
    above it it rolls to where sin(angle) = mu_r w L R / (B kappa kappa_0 L), whatever the step."""
    nodes, roll, bend = 15, 0.3, 10.0
    edge = 0.07 / (nodes - 1)
    held = roll * WEIGHT * 0.07 * RADIUS
    at_bound = held / (STIFFNESS * bend * edge * (nodes - 2))
    dynamics = on_its_side(at_bound * np.array([0.5, 0.95, 1.5, 3.0]), roll)
    turned = []
    for time in (5.0, 65.0):
        assert not dynamics.advance(time, step).diverged.any()
        turned.append(np.abs(dynamics.batch.state.dof.numpy()[:, 3::4].mean(axis=1)))
    # The bristle's own give: mu_r / 600 of a radian and a little.
    assert (turned[1][:2] < 0.02).all()
    assert np.abs(turned[1] - turned[0])[:2].max() < 1e-9
    expected = np.pi / 2 - np.arcsin(1.0 / np.array([1.5, 3.0]))
    assert turned[1][2:] == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("step", [5e-3, 0.05])
def test_drilling_is_held_up_to_a_bound(step):
    """A stiff rod that lies on a table is turned about the vertical by a couple at its ends: below
    mu w L^2 / 4, the moment of friction about its middle, it does not creep in a minute, above it
    spins up as fast as the moment that is left over tells, whatever the step."""
    length, nodes, law, share = 0.07, 15, 0.5, np.array([0.5, 0.95, 1.2])
    stretching = 4e3 * STIFFNESS / RADIUS**2
    batch = rods(straight(len(share), nodes, length=length), stiffer=1e3, stretching=stretching)
    contact = Contact(batch, RADIUS, CONTACT, Friction(law))
    dynamics = Dynamics(
        batch, scheme="euler", radius=RADIUS, contact=contact, air_damping=0.0, tolerance=1e-9,
        keeps_recording=True,
    )  # fmt: skip
    dynamics.advance(0.5, 5e-3)
    bound = law * WEIGHT * length**2 / 4
    load = np.zeros((len(share), nodes, 3))
    couple = share * bound / length
    load[:, -1, 1], load[:, 0, 1] = couple, -couple
    batch.point_load.assign(load)

    def heading():
        q = batch.positions()
        return np.arctan2(*(q[:, -1] - q[:, 0])[:, 1::-1].T)

    dynamics.advance(0.6, min(step, 5e-3))
    inertia = np.sum(batch.node_mass.numpy()[0] * (np.linspace(0, length, nodes) - length / 2) ** 2)
    turned = 0.5 * (share[2] - 1.0) * bound / inertia * 0.1**2
    assert heading()[2] == pytest.approx(turned, rel=0.1)
    dynamics.advance(5.0, step)
    at_first = heading()[:2]
    assert np.abs(at_first).max() < 1e-3  # the bristles' give
    dynamics.advance(65.0, step)
    assert np.abs(heading()[:2] - at_first).max() < 1e-9


def test_bad_contacts_are_refused():
    batch = rods(straight())
    with pytest.raises(RodError, match="friction"):
        Friction(0.3, 0.4)
    with pytest.raises(RodError, match="friction"):
        Friction(float("nan"))
    with pytest.raises(RodError, match="radius"):
        Contact(batch, 0.0, CONTACT, Friction(0.3))
    with pytest.raises(RodError, match="field of friction"):
        FrictionField(np.ones((1, 3)), (0, 1), (0, 1))
    with pytest.raises(RodError, match="roll"):
        Friction(0.3, roll=-1.0)
    with pytest.raises(RodError, match="restitution"):
        Contact(batch, RADIUS, CONTACT, Friction(0.3), restitution=1.0)
    with pytest.raises(RodError, match="direction"):
        Contact(batch, RADIUS, CONTACT, Friction(0.3), shapes=(Plane(normal=(0, 0, 0)),))
    with pytest.raises(RodError, match="sizes"):
        Contact(batch, RADIUS, CONTACT, Friction(0.3), shapes=(Box((0, 0, 0), (1, 0, 1)),))


@pytest.mark.parametrize(
    "friction, post, edge, stiffness",
    # The last is thinner than the rod, whose edges are half as long as its own radius.
    [(0.15, 0.02, 4e-3, 5e5), (0.3, 0.02, 4e-3, 5e5), (0.3, 0.0005, 0.8e-3, 5e6)],
)
def test_capstan(friction, post, edge, stiffness):
    """A flexible rod pulled over a cylinder, half a turn, against a load: the tensions are in the
    ratio exp(mu pi)."""
    load = 0.2
    batch = rope(half_turn(post + RADIUS, edge), [0.0, 0.0, -load], edge)
    shapes = (Cylinder((0, 0, 0), post, 0.05, axis=(0, 1, 0)),)
    contact = Contact(batch, RADIUS, stiffness, Friction(friction), shapes=shapes)
    dynamics = Dynamics(
        batch,
        scheme="euler",
        radius=RADIUS,
        contact=contact,
        air_damping=20.0,
        motion=Pull(batch, [0.0, 0.0, -1.0]),
        keeps_recording=True,
    )
    dynamics.advance(0.2, 2e-3)
    tension = tensions(batch)
    assert tension[1] == pytest.approx(load, rel=0.01)
    assert tension[-2] / tension[1] == pytest.approx(np.exp(friction * np.pi), rel=0.03)
    assert contact.penetration()[0] < 0.05 * RADIUS
