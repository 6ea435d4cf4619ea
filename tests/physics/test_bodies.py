"""Free bodies that rods hold, in one step with them: momentum, statics and periods."""

import newton
import numpy as np
import pytest
import warp as wp

import wrod

SolverDER = wrod.SolverDER
SOFT = wrod.RodMaterial(radius=0.0016, gravito_bending_length=0.032, length=0.2)
# A cable of nylon: 10 kg stretch it by 0.8 %.
STIFF = wrod.RodMaterial.from_youngs_modulus(1e9, radius=0.002, length=0.5, density=1150.0)
EDGES = 20


def hung(
    material, mass, inertia, *, length=0.2, way=(0.0, 0.0, -1.0), gravity=-9.81, start="free",
    end="clamped", centre=(0.0, 0.0, 0.0),
):  # fmt: skip
    """A model of one cable with a body at its end, and the body."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, gravity))
    SolverDER.register_custom_attributes(builder)
    points = np.linspace(0.0, length, EDGES + 1)[:, None] * np.array(way)
    body = builder.add_body(
        xform=wp.transform(tuple(points[-1]), wp.quat_identity()), mass=mass,
        inertia=wp.mat33(*np.diag(inertia).ravel()), com=wp.vec3(*centre),
    )  # fmt: skip
    SolverDER.add_rod(builder, points, material, start=start, end=end, end_body=body, visible=False)
    return builder.finalize(device="cpu"), body


def simulate(model, steps, dt, state=None, each=None, **options):
    solver = SolverDER(model, **options)
    state = model.state() if state is None else state
    for k in range(steps):
        solver.step(state, state, None, None, dt)
        if each is not None:
            each(k, state)
    assert not solver.diverged.any()
    return solver, state


def period_of(samples, dt):
    """Mean period of what swings about 0 [s]."""
    x = np.array(samples)
    i = np.flatnonzero(x[:-1] * x[1:] < 0)
    crossings = i + x[i] / (x[i] - x[i + 1])
    assert len(crossings) >= 4
    return 2.0 * np.diff(crossings).mean() * dt


@pytest.mark.parametrize("scheme", ["euler", "bdf2", "midpoint"])
def test_momentum_of_a_cable_with_a_body_that_falls(scheme):
    """P(t) = P(0) + M g t, for a body as heavy as the cable, held beside its centre of mass."""
    model, body = hung(
        SOFT, 0.002, (2e-7, 3e-7, 4e-7), way=(1.0, 0.0, 0.0), centre=(0.01, 0.003, 0.002)
    )
    node_mass, mass = model.der.node_mass.numpy(), float(model.body_mass.numpy()[body])
    state = model.state()
    velocity = np.zeros((EDGES + 1, 3))
    velocity[8:18, 1] = 1.0
    state.der.node_qd.assign(velocity)
    first = node_mass @ velocity
    total = mass + node_mass.sum()
    dt, steps = 0.004, 60
    solver, state = simulate(model, steps, dt, state, scheme=scheme, tolerance=1e-9)
    last = node_mass @ state.der.node_qd.numpy()
    last += mass * solver._groups[0].bodies.velocity.numpy()[0, 0]
    expected = first + total * steps * dt * np.array(model.gravity.numpy()[0], dtype=float)
    assert np.abs(last - expected).max() < 1e-9 * np.linalg.norm(expected)
    turn = state.body_q.numpy()[body, 3:]
    assert abs(turn[3]) < 0.99  # it has been whirled round


@pytest.mark.parametrize("end", ["pinned", "clamped"])
@pytest.mark.parametrize("mass", [1e-6, 0.2, 10.0])
def test_a_mass_hangs_on_a_cable(mass, end):
    """T = m g + w (L - s): the force at the top within 1e-6, every edge as long as its tension
    makes it; bodies of 1e-4 to 1e3 times the cable's mass."""
    model, body = hung(
        STIFF, mass, (1e-5 * mass,) * 3, length=0.5, start="clamped", end=end,
        centre=(0.0, 0.0, -0.005),
    )  # fmt: skip
    der, mass = model.der, float(model.body_mass.numpy()[body])
    options = dict(scheme="euler", tolerance=1e-9)
    solver, state = simulate(model, 150, 0.05, **options)
    g = -float(model.gravity.numpy()[0, 2])
    node_mass = der.node_mass.numpy()
    below = (mass + node_mass[::-1].cumsum()[::-1][1:]) * g
    lengths = -np.diff(state.der.node_q.numpy()[:, 2])
    rest = der.edge_rest_length.numpy()
    strain = below / der.edge_stretching_stiffness.numpy()
    assert lengths / rest - 1.0 == pytest.approx(strain, rel=1e-3)
    assert state.body_q.numpy()[body, 2] == pytest.approx(-lengths.sum(), abs=1e-6)
    reaction = solver._groups[0].dynamics.reaction.numpy()[0]
    top = reaction[2] + reaction[6]
    assert top == pytest.approx((mass + node_mass.sum()) * g, rel=1e-6)


def test_period_of_a_pendulum_with_a_heavy_bob():
    """T = 2 pi sqrt(l / g) with l = (m L^2 + w L^2 / 3) / (m L + w L / 2): a bob of 100 times the
    cable's mass, pinned at both ends, within 0.2 %."""
    length, mass = 0.5, 0.7
    model, body = hung(STIFF, mass, (1e-5,) * 3, length=length, start="pinned", end="pinned")
    _, state = simulate(model, 60, 0.05, scheme="euler")  # the cable takes its length
    long = -float(state.body_q.numpy()[body, 2])
    cable = STIFF.weight / STIFF.gravity * length
    arm = (mass + cable / 3.0) * long / (mass + cable / 2.0)
    expected = 2.0 * np.pi * np.sqrt(arm / 9.81)
    speed = 0.05
    motion = state.body_qd.numpy()
    motion[body, 0] = speed
    state.body_qd.assign(motion)
    velocity = state.der.node_qd.numpy()
    velocity[:, 0] = speed * -state.der.node_q.numpy()[:, 2] / long
    state.der.node_qd.assign(velocity)
    dt, places = expected / 80, []
    simulate(
        model, 240, dt, state, lambda k, s: places.append(s.body_q.numpy()[body, 0]),
        scheme="midpoint",
    )  # fmt: skip
    assert period_of(places, dt) == pytest.approx(expected, rel=2e-3)
    swing = speed * expected / (2.0 * np.pi)
    assert max(places[-80:]) == pytest.approx(swing, rel=0.01)


@pytest.mark.parametrize("scheme, error", [("bdf2", 2e-3), ("midpoint", 5e-4)])
def test_period_of_a_torsional_pendulum(scheme, error):
    """T = 2 pi sqrt((I + J / 3) L / G J'): a disc hung on a cable turns it, J the cable's own
    inertia about its axis."""
    length, inertia = 0.2, 2e-7
    model, body = hung(
        SOFT, 1e-3, (1e-6, 1e-6, inertia), length=length, gravity=0.0, start="clamped"
    )
    stiffness = model.der.node_twisting_stiffness.numpy()[1]
    own = 0.5 * SOFT.radius**2 * SOFT.weight / SOFT.gravity * length
    expected = 2.0 * np.pi * np.sqrt((inertia + own / 3.0) * length / stiffness)
    state = model.state()
    rate = 0.5 * 2.0 * np.pi / expected
    motion = state.body_qd.numpy()
    motion[body, 5] = rate
    state.body_qd.assign(motion)
    state.der.edge_spin.assign(-rate * (np.arange(EDGES) + 0.5) / EDGES)
    dt, turns = expected / 100, []

    def note(k, state):
        q = state.body_q.numpy()[body]
        turns.append(2.0 * np.arctan2(q[5], q[6]))

    simulate(model, 260, dt, state, note, scheme=scheme, tolerance=1e-8)
    assert period_of(turns, dt) == pytest.approx(expected, rel=error)
    assert max(turns[-100:]) == pytest.approx(0.5, rel=5e-3)


def bar_on_cables(count=2):
    """A bar of 1 kg on cables of several lengths, all solved together."""
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    bar = builder.add_body(mass=1.0, inertia=wp.mat33(*np.diag([0.01, 0.02, 0.02]).ravel()))
    for x in np.linspace(-0.2, 0.2, count):
        points = np.zeros((11, 3))
        points[:, 0] = x
        points[:, 2] = np.linspace(0.3, 0.0, 11)
        SolverDER.add_rod(
            builder, points, STIFF, start="pinned", end="pinned", end_body=bar, visible=False
        )
    return builder, bar


def test_cables_share_a_load():
    """A bar on two vertical cables, its centre of mass a quarter of the way off: 3 / 4 and 1 / 4 of
    its weight (moments about either cable)."""
    builder, bar = bar_on_cables()
    builder.body_com[bar] = wp.vec3(0.1, 0.0, 0.0)
    model = builder.finalize(device="cpu")
    solver, _ = simulate(model, 200, 0.05, scheme="euler", tolerance=1e-9)
    (group,) = solver._groups
    reaction = group.dynamics.reaction.numpy()[0].copy()
    held = group.layout._start
    tops = [reaction[4 * held[0, rod] + 2] for rod in range(2)]
    cable = model.der.node_mass.numpy()[:11].sum() * 9.81
    assert sum(tops) == pytest.approx(9.81 + 2 * cable, rel=1e-5)
    assert tops[1] == pytest.approx(0.75 * 9.81 + cable, rel=0.01)


def test_a_closed_loop_held_by_a_body():
    """Both ends of a cable on one small body close it: weightless, it becomes a circle."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    SolverDER.register_custom_attributes(builder)
    # A racetrack, from the middle of a straight side on, where both ends have one direction.
    side, radius = 0.04, 0.04
    arc = np.linspace(0.0, 4 * side + 2 * np.pi * radius, 41)[:, None]
    turn = np.clip((arc - side) / radius, 0.0, np.pi) + np.clip(
        (arc - 3 * side - np.pi * radius) / radius, 0.0, np.pi
    )
    way = np.diff(arc, axis=0) * np.hstack([np.cos(turn), np.sin(turn), 0.0 * turn])[:-1]
    points = np.concatenate([np.zeros((1, 3)), way.cumsum(axis=0)])
    points -= np.linspace(0.0, 1.0, 41)[:, None] * points[-1]
    points[[1, -2]] = [[points[1, 0], 0.0, 0.0], [-points[1, 0], 0.0, 0.0]]
    body = builder.add_body(mass=1e-4, inertia=wp.mat33(*np.diag([1e-8] * 3).ravel()))
    ends = dict(start="clamped", start_body=body, end="clamped", end_body=body)
    SolverDER.add_rod(builder, points, SOFT, air_damping=20.0, visible=False, **ends)
    model = builder.finalize(device="cpu")
    _, state = simulate(model, 100, 0.05, scheme="euler")
    q = state.der.node_q.numpy()
    assert np.abs(q[0] - q[-1]).max() < 1e-7
    centre = q[:-1].mean(axis=0)
    radii = np.linalg.norm(q[:-1] - centre, axis=1)
    perimeter = np.linalg.norm(np.diff(q, axis=0), axis=1).sum()
    assert radii == pytest.approx(perimeter / (2.0 * np.pi), rel=0.005)


def test_a_body_held_in_the_middle_of_a_cable():
    """A weight in the middle of a cable between two pins: the pins carry both weights, and along
    the cable their forces are its tension."""
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    arc = np.linspace(0.0, 0.5, 21)
    half = 0.2  # half the distance of the pins
    drop = np.sqrt(0.25**2 - half**2)
    points = np.zeros((21, 3))
    points[:, 0] = (arc - 0.25) * half / 0.25
    points[:, 2] = -drop * (1.0 - np.abs(arc - 0.25) / 0.25)
    body = builder.add_body(
        xform=wp.transform(tuple(points[10]), wp.quat_identity()), mass=0.5,
        inertia=wp.mat33(*np.diag([1e-4] * 3).ravel()),
    )  # fmt: skip
    rod = SolverDER.add_rod(builder, points, STIFF, start="pinned", end="pinned", visible=False)
    SolverDER.attach(builder, rod, body, node=10, kind="pinned")
    model = builder.finalize(device="cpu")
    solver, state = simulate(model, 150, 0.05, scheme="euler")
    q = state.der.node_q.numpy()
    reaction = solver._groups[0].dynamics.reaction.numpy()[0]
    ends = reaction[[0, 2, 80, 82]]
    weight = (0.5 + model.der.node_mass.numpy().sum()) * 9.81
    assert ends[1] + ends[3] == pytest.approx(weight, rel=1e-5)
    edge = q[1] - q[0]
    length = np.linalg.norm(edge)
    rest = model.der.edge_rest_length.numpy()[0]
    pull = model.der.edge_stretching_stiffness.numpy()[0] * (length / rest - 1.0)
    up = ends[1] - model.der.node_mass.numpy()[0] * 9.81
    assert -(ends[0] * edge[0] + up * edge[2]) / length == pytest.approx(pull, rel=1e-4)
    assert np.abs(state.body_q.numpy()[body, :3] - q[10]).max() < 1e-6
