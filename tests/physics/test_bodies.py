"""Free bodies that rods hold, in one step with them: momentum, statics and periods."""

import newton
import numpy as np
import pytest
import warp as wp
from chosen import DEVICE
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipkinc

import wrod
from wrod.bench.newton_bodies import (
    NYLON,
    RUBBER,
    TwoLinkArm,
    hung,
    momentum,
    pendulum,
    simulate,
    torsion,
)
from wrod.bench.newton_piles import Pile, energy_of

SolverDER = wrod.SolverDER


@pytest.mark.parametrize("scheme", ["euler", "bdf2", "midpoint"])
def test_momentum_of_a_cable_with_a_body_that_falls(scheme):
    """P(t) = P(0) + M g t, for a body as heavy as the cable, held beside its centre of mass."""
    assert momentum(scheme) < 1e-9
    assert momentum(scheme, inertia="consistent") < 1e-9


@pytest.mark.parametrize("end", ["pinned", "clamped"])
@pytest.mark.parametrize("mass", [1e-6, 0.2, 10.0])
def test_a_mass_hangs_on_a_cable(mass, end):
    """T = m g + w (L - s): the force at the top within 1e-6, every edge as long as its tension
    makes it; bodies of 1e-4 to 1e3 times the cable's mass."""
    model, body = hung(
        NYLON, mass, (1e-5 * mass,) * 3, length=0.5, start="clamped", end=end,
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
    period, expected = pendulum()
    assert period == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("scheme, error", [("bdf2", 2e-3), ("midpoint", 5e-4)])
def test_period_of_a_torsional_pendulum(scheme, error):
    """T = 2 pi sqrt((I + J / 3) L / GJ): a disc hung on a cable turns it, J the cable's own
    inertia about its axis."""
    period, expected = torsion(scheme)
    assert period == pytest.approx(expected, rel=error)


@pytest.mark.filterwarnings("ignore:this solver moves bodies")
@pytest.mark.parametrize("scheme, error", [("bdf2", 5e-3), ("midpoint", 1e-3)])
def test_a_spinning_book_flips(scheme, error):
    """Spun about the axis of its middle inertia, a body turns over as Euler's equations have it, in
    Jacobi's elliptic functions (Landau and Lifshitz, Mechanics, 37.10), to second order in the
    step; its angular momentum stays, in the precision of its state."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    SolverDER.register_custom_attributes(builder)
    book = builder.add_body()
    builder.add_shape_box(book, hx=0.02, hy=0.08, hz=0.12)
    points = np.linspace(1.0, 1.2, 5)[:, None] * [1.0, 0.0, 0.0]
    SolverDER.add_rod(builder, points, NYLON)
    model = builder.finalize(device=DEVICE)
    start = np.array([0.02, 8.0, 0.05], dtype=np.float32).astype(float)
    inertia = np.diag(model.body_inertia.numpy()[book]).astype(float)
    # Of the largest, the middle and the smallest inertia.
    a, b, c = inertia
    energy, momentum = inertia @ start**2, inertia**2 @ start**2
    assert a > b > c and momentum < b * energy
    most = [(energy * c - momentum) / (a * (c - a)), (energy * c - momentum) / (b * (c - b)),
            (momentum - energy * a) / (c * (c - a))]  # fmt: skip
    rate = np.sqrt((c - b) * (momentum - energy * a) / (a * b * c))
    m = (b - a) * (energy * c - momentum) / ((c - b) * (momentum - energy * a))
    x, y = start[:2] / np.sqrt(most[:2])
    begun = ellipkinc(np.arctan2(y, x), m)

    def off(steps):
        solver, state = SolverDER(model, bodies=[book], scheme=scheme), model.state()
        speeds = state.body_qd.numpy()
        speeds[book, 3:] = start
        state.body_qd.assign(speeds)
        found = []
        for _ in range(steps):
            solver.step(state, state, None, None, 2.0 / steps)
            turn = Rotation.from_quat(state.body_q.numpy()[book, 3:])
            spin = turn.inv().apply(state.body_qd.numpy()[book, 3:])
            found.append(spin)
            kept = turn.apply(inertia * spin)
            assert kept == pytest.approx(inertia * start, abs=1e-6 * np.sqrt(momentum))
        time = np.arange(1, steps + 1) * 2.0 / steps
        sn, cn, dn, _ = ellipj(begun - rate * time, m)
        exact = np.sqrt(most) * np.stack([cn, sn, dn], axis=1)
        assert exact[:, 1].min() < -7.5
        return np.abs(found - exact).max() / 8.0

    coarse, fine = off(240), off(480)
    assert fine < error and coarse / fine > 3.5


def test_joint_torques_of_an_arm_that_holds_a_cable():
    """Newton's Featherstone solver carries links and cable with the torques of statics."""
    arm = TwoLinkArm()
    arm.settle(1200)  # 1e-3 from where twice as many steps end
    expected = arm.statics()
    assert arm.torques() == pytest.approx(expected, rel=0.01)
    alone = 1.15 * 9.81 * np.array([0.8, 0.2])  # of the links
    assert (np.abs(expected) - alone > 0.02 * alone).all()


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
            builder, points, NYLON, start="pinned", end="pinned", end_body=bar, visible=False
        )
    return builder, bar


def test_cables_share_a_load():
    """A bar on two vertical cables, its centre of mass a quarter of the way off: 3 / 4 and 1 / 4 of
    its weight (moments about either cable)."""
    builder, bar = bar_on_cables()
    builder.body_com[bar] = wp.vec3(0.1, 0.0, 0.0)
    model = builder.finalize(device=DEVICE)
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
    body = builder.add_body(mass=1e-4, inertia=wp.mat33(*np.diag([1e-8] * 3).ravel()))
    ends = dict(start="clamped", start_body=body, end="clamped", end_body=body)
    SolverDER.add_rod(builder, points, RUBBER, air_damping=20.0, visible=False, **ends)
    model = builder.finalize(device=DEVICE)
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
    rod = SolverDER.add_rod(builder, points, NYLON, start="pinned", end="pinned", visible=False)
    SolverDER.attach(builder, rod, body, node=10, kind="pinned")
    model = builder.finalize(device=DEVICE)
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


def test_cables_lie_on_each_other():
    """Crossed cables come to rest in their order: the ground carries all, none sinks into another
    by more than 2 % of the radius, and one that touches no rods falls through the others."""
    pile = Pile(cables=3)
    pile.run(60)
    assert not pile.solver.diverged.any()
    assert pile.deepest < 0.02
    q = pile.state.der.node_q.numpy().reshape(3, -1, 3)
    middle = q[:, 10, 2] / pile.radius
    # The second lies across the first; the third across the second, and sags beside it.
    assert middle[0] < 1.2 < 2.0 < middle[1] < 3.2
    assert q[2, :, 2].max() / pile.radius > 3.0
    total = pile.state.der.node_contact_f.numpy().sum(axis=0)
    assert total[2] == pytest.approx(3 * pile.material.weight * 0.2, rel=0.02)


def heaps(scales):
    """Worlds of four cables that fall on each other, of L_gb scaled: (frame, world, node, 3)."""
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    builder.add_ground_plane()
    arc = np.linspace(-0.1, 0.1, 21)[:, None]
    for scale in scales:
        world = newton.ModelBuilder()
        SolverDER.register_custom_attributes(world)
        ways = [1.0, 0.12, 0.0], [-0.05, 1.0, 0.0], [1.0, -0.2, 0.0], [0.17, 1.0, 0.0]
        for k, way in enumerate(ways):
            rod = wrod.RodMaterial(0.003, 0.04 * scale, 0.2)
            points = arc * way + [0.004 * k, -0.01 * k, 0.006 + 0.009 * k]
            SolverDER.add_rod(world, points, rod, internal_damping=0.005, visible=False)
        builder.add_world(world)
    model = builder.finalize(device="cpu")
    solver, state, out = SolverDER(model, rod_contact=0.3), model.state(), []
    for _ in range(8):
        solver.step(state, state, None, None, 1 / 60)
        out.append(state.der.node_q.numpy().reshape(len(scales), -1, 3).copy())
    assert state.der.node_contact_f.numpy().any()
    return np.array(out)


def test_heaps_beside_others_do_what_they_do_alone():
    """To the last bit, however many steps the others take."""
    scales = (1.0, 1.3, 0.8)
    together = heaps(scales)
    for world, scale in enumerate(scales):
        assert (together[:, world] == heaps([scale])[:, 0]).all()


def test_a_heap_gains_no_energy():
    """With what is stored in contact, to the work of what is left unbalanced; without it, the heap
    seems to gain as it swings on its contacts."""
    pile = Pile(cables=4)
    dynamics = pile.solver._groups[0].dynamics
    whole, partly = [], []
    for _ in range(45):
        pile.step(1 / 60)
        whole.append(energy_of(dynamics))
        partly.append(dynamics.energy()[0])
    scale = abs(whole[0])
    assert np.diff(whole).max() < 1e-9 * scale
    assert np.diff(partly).max() > 1e-7 * scale


def test_cables_pass_through_what_touches_no_rods():
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    builder.add_ground_plane()
    line = np.linspace(-0.05, 0.05, 11)
    for k, touches in enumerate((True, False)):
        points = np.zeros((11, 3))
        points[:, k], points[:, 2] = line, 0.002 + 0.01 * k
        SolverDER.add_rod(builder, points, RUBBER, touches_rods=touches, air_damping=5.0)
    model = builder.finalize(device=DEVICE)
    _, state = simulate(model, 40, 0.01, scheme="euler", rod_contact=0.3)
    assert state.der.node_q.numpy()[:, 2].max() < 1.1 * RUBBER.radius


def test_a_cable_over_a_cable_holds_two_weights():
    """Bobs on both ends of a cable that lies over a taut one: the taut one's ends carry all, and
    the forces that hold them do not change when the bobs touch nothing but their cable."""
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    beam = np.zeros((11, 3))
    beam[:, 1] = np.linspace(-0.1, 0.1, 11)
    SolverDER.add_rod(builder, beam, NYLON, start="clamped", end="clamped", visible=False)
    arc = np.linspace(-0.1, 0.1, 21)
    hanging = np.zeros((21, 3))
    bend = 0.012
    turn = np.clip(arc / bend, -0.5 * np.pi, 0.5 * np.pi)
    hanging[:, 0] = bend * np.sin(turn)
    hanging[:, 2] = bend * (np.cos(turn) - 1.0) - np.maximum(np.abs(arc) - 0.5 * np.pi * bend, 0.0)
    hanging[:, 2] += NYLON.radius + RUBBER.radius + 1e-5
    bobs = []
    for end in (0, -1):
        bobs.append(
            builder.add_body(
                xform=wp.transform(tuple(hanging[end]), wp.quat_identity()), mass=0.02,
                inertia=wp.mat33(*np.diag([1e-6] * 3).ravel()),
            )
        )  # fmt: skip
    ends = dict(start="clamped", start_body=bobs[0], end="clamped", end_body=bobs[1])
    SolverDER.add_rod(builder, hanging, RUBBER, visible=False, air_damping=5.0, **ends)
    model = builder.finalize(device=DEVICE)
    solver, state = simulate(model, 120, 0.01, scheme="euler", rod_contact=0.5)
    assert not solver.diverged.any()
    (group,) = solver._groups
    reaction = group.dynamics.reaction.numpy()[0]
    world = [h for h in group.hold.numpy()[0] if h["kind"] and h["slot"] < 0]
    carried = sum(reaction[4 * h["node"] + 2] + reaction[4 * h["other"] + 2] for h in world)
    expected = (0.04 + model.der.node_mass.numpy().sum()) * 9.81
    assert carried == pytest.approx(expected, rel=0.01)
    assert np.abs(state.body_qd.numpy()[bobs]).max() < 0.02
