"""Rods in Newton scenes: closed forms, worlds side by side, held ends, and what is refused."""

from dataclasses import replace

import newton
import numpy as np
import pytest
import warp as wp
from chosen import DEVICE

import wrod
from wrod.errors import RodError, WrodWarning
from wrod.rods.model import RodModel

ROD = wrod.RodMaterial(radius=0.0016, gravito_bending_length=0.032, length=0.2)
SolverDER = wrod.SolverDER
ROOT = 1.875104068711961  # first root of cos(x) cosh(x) = -1


def scene(gravity=-9.81):
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, gravity))
    SolverDER.register_custom_attributes(builder)
    return builder


def straight(nodes, length, height=0.0, axis=0, shift=(0.0, 0.0, 0.0)):
    points = np.zeros((nodes, 3))
    points[:, axis] = np.linspace(0.0, length, nodes)
    points[:, 2] += height
    return points + shift


def simulate(model, steps, dt, each=None, **options):
    """State after some steps; `each(k, state)` may write the state before a step."""
    solver = SolverDER(model, **options)
    state, other = model.state(), model.state()
    for k in range(steps):
        if each is not None:
            each(k, state)
        solver.step(state, other, None, None, dt)
        state, other = other, state
    return solver, state


def nodes(state, rod=None):
    q = state.der.node_q.numpy()
    if rod is None:
        return q
    der = rod[0].der
    first, count = der.rod_first_node.numpy()[rod[1]], der.rod_node_count.numpy()[rod[1]]
    return q[first : first + count]


def place(model, state, body, position, rotation=(0.0, 0.0, 0.0, 1.0)):
    poses = state.body_q.numpy().copy()
    poses[body] = [*position, *rotation]
    state.body_q.assign(poses)


def test_quadratic_drag_of_a_model():
    """v = v_t tanh(g t / v_t), v_t^2 = g / q, of a rod that falls beside one without."""
    drags, builder = (1.5, 0.0), scene()
    for k, q in enumerate(drags):
        rod = replace(RodModel.of(ROD), quadratic_drag=q)
        SolverDER.add_rod(builder, straight(9, 0.2, shift=(0.0, 0.1 * k, 0.0)), rod)
    _, state = simulate(builder.finalize(device=DEVICE), 200, 0.002)
    speed = -state.der.node_qd.numpy()[:, 2].reshape(2, 9)
    terminal = np.sqrt(9.81 / drags[0])
    assert speed[0] == pytest.approx(terminal * np.tanh(9.81 * 0.4 / terminal), rel=1e-4)
    assert speed[1] == pytest.approx(9.81 * 0.4, rel=1e-4)


def test_sag_of_cantilevers():
    """Tip deflection of a clamped rod of N edges under its weight: w L^4 / (8 k_b) (1 + 1/N^2).

    The moment at node j, w (L - x_j)^2 / 2, turns it by M h / k_b, at the clamp by half of that;
    summed over the nodes this is the beam's formula with exactly that mesh error.
    """
    length, count = 0.02, 11
    builder = scene()
    for k, end in enumerate(("start", "end")):  # one batch, the clamp on either side
        points = straight(count, length, shift=(0.0, 0.1 * k, 0.0))
        SolverDER.add_rod(builder, points, ROD, air_damping=2e3, visible=False, **{end: "clamped"})
    model = builder.finalize(device=DEVICE)
    _, state = simulate(model, 60, 0.01, scheme="euler")
    expected = -ROD.weight * length**4 / (8 * ROD.bending_stiffness)
    expected *= 1.0 + 1.0 / (count - 1) ** 2
    for rod, tip in ((0, -1), (1, 0)):
        sag = nodes(state, (model, rod))[tip, 2]
        assert sag == pytest.approx(expected, rel=5e-4)  # it sags by 1.5 % of its length


def test_frequency_of_a_cantilever():
    """omega = 1.8751^2 sqrt(k_b / (m L^4)) within 1 %, and no gain of energy in the swing."""
    length, count = 0.1, 26
    line = ROD.weight / ROD.gravity
    omega = ROOT**2 * np.sqrt(ROD.bending_stiffness / line) / length**2
    x = ROOT * np.linspace(0.0, 1.0, count)
    ratio = (np.sinh(ROOT) - np.sin(ROOT)) / (np.cosh(ROOT) + np.cos(ROOT))
    mode = np.cosh(x) - np.cos(x) - ratio * (np.sinh(x) - np.sin(x))
    velocity = np.zeros((count, 3))
    velocity[:, 2] = 0.01 * length * omega * mode / mode[-1]
    builder = scene(gravity=0.0)
    SolverDER.add_rod(builder, straight(count, length), ROD, start="clamped", velocity=velocity)
    samples = 60
    heights = []
    simulate(
        builder.finalize(device=DEVICE),
        2 * samples + 20,
        2 * np.pi / omega / samples,
        lambda k, state: heights.append(nodes(state)[-1, 2]),
    )
    z = np.array(heights[1:])
    i = np.flatnonzero(z[:-1] * z[1:] < 0)
    crossings = i + z[i] / (z[i] - z[i + 1])
    assert len(crossings) >= 4
    assert 2 * np.diff(crossings).mean() == pytest.approx(samples, rel=0.01)
    assert np.abs(z).max() <= 0.01 * length * 1.01


def test_what_spins_freely_loses_of_second_order():
    """Of a rod that spins in space the midpoint rule keeps the angular momentum; the two-step
    formula loses by how it begins, 1.3 times the square of the turn in a step and of second order
    from the first step on, and then next to nothing."""
    spin = 10.0

    def kept(dt, scheme):
        builder = scene(gravity=0.0)
        points = straight(21, 0.5, shift=(-0.25, 0.0, 0.0))
        rod = wrod.RodMaterial(radius=0.004, gravito_bending_length=0.3, length=0.5)
        SolverDER.add_rod(builder, points, rod, velocity=np.cross([0.0, 0.0, spin], points))
        model = builder.finalize(device=DEVICE)
        mass, found = model.der.node_mass.numpy()[:, None], []

        def note(k, state):
            q, v = state.der.node_q.numpy(), state.der.node_qd.numpy()
            found.append((mass * np.cross(q, v)).sum(axis=0)[2])

        _, state = simulate(model, round(0.25 / dt), dt, note, scheme=scheme, tolerance=1e-9)
        note(0, state)
        return 1.0 - np.array(found) / found[0]

    coarse, fine = kept(1 / 240, "bdf2"), kept(1 / 480, "bdf2")
    assert coarse[1] / fine[1] > 3.5 and coarse[-1] / fine[-1] > 3.5
    assert coarse.max() < 1.5 * (spin / 240) ** 2
    assert abs(coarse[-1] - coarse[5]) < 0.1 * coarse[-1]
    assert np.abs(kept(1 / 240, "midpoint")).max() < 1e-10


def test_rest_on_the_ground_and_friction_of_the_shape():
    """The ground carries the weight; tilted gravity moves the rod if and only if tan > mu."""
    builder = scene()
    mu = 0.6
    builder.default_shape_cfg.mu = mu
    for _ in range(2):
        builder.begin_world()
        SolverDER.add_rod(builder, straight(15, 0.07, 1.2 * ROD.radius), ROD)
        builder.end_world()
    builder.add_ground_plane(height=0.0)
    model = builder.finalize(device=DEVICE)
    slopes = np.radians([28.0, 34.0])  # arctan(0.6) = 30.96
    solver = SolverDER(model, scheme="euler")
    state = model.state()
    steps, dt = 40, 5e-3

    def tilt(part):
        gravity = np.zeros((3, 3))
        gravity[:2, 0] = 9.81 * np.sin(part * slopes)
        gravity[:2, 2] = -9.81 * np.cos(part * slopes)
        gravity[2, 2] = -9.81
        model.gravity.assign(gravity)
        solver.notify_model_changed(newton.ModelFlags.MODEL_PROPERTIES)

    for _ in range(steps):
        solver.step(state, state, None, None, dt)
    force = state.der.node_contact_f.numpy().reshape(2, -1, 3).sum(axis=1)
    assert force[:, 2] == pytest.approx(ROD.weight * 0.07, rel=1e-3)
    assert 0.95 * ROD.radius < nodes(state)[:, 2].min() <= nodes(state)[:, 2].max() < ROD.radius
    before = nodes(state).reshape(2, -1, 3).mean(axis=1)
    for part in np.linspace(0.0, 1.0, 17)[1:]:  # a sudden tilt would jerk it loose
        tilt(part)
        solver.step(state, state, None, None, dt)
    for _ in range(steps):
        solver.step(state, state, None, None, dt)
    moved = (nodes(state).reshape(2, -1, 3).mean(axis=1) - before)[:, 0]
    assert moved[0] < 1e-3 * ROD.radius
    t = steps * dt
    slide = 9.81 * (np.sin(slopes[1]) - mu * np.cos(slopes[1])) * t**2 / 2
    assert moved[1] == pytest.approx(slide, rel=0.25)  # it began while the tilt was growing


def test_boxes_and_cylinders_and_their_friction():
    """A rod falls across a box and a cylinder and comes to rest a radius above both tops."""
    builder = scene()
    builder.add_shape_box(
        -1, xform=wp.transform((0.02, 0, 0.01), wp.quat_identity()), hx=0.01, hy=0.05, hz=0.01
    )
    turned = wp.quat_from_axis_angle(wp.vec3(1, 0, 0), np.pi / 2)
    builder.add_shape_cylinder(
        -1, xform=wp.transform((0.08, 0, 0.015), turned), radius=0.005, half_height=0.05
    )
    builder.add_shape_plane(plane=(0.0, 0.0, 1.0, 1.0), width=0.1, length=0.0)
    SolverDER.add_rod(
        builder, straight(21, 0.1, 0.023), ROD, internal_damping=0.05, air_damping=5.0
    )
    model = builder.finalize(device=DEVICE)
    with pytest.warns(WrodWarning, match=r"pass through 1 shapes: .*plane"):
        _, state = simulate(model, 80, 5e-3, scheme="euler")
    q, force = nodes(state), state.der.node_contact_f.numpy()
    assert force.sum(axis=0)[2] == pytest.approx(ROD.weight * 0.1, rel=0.01)
    on_box = (q[:, 0] > 0.011) & (q[:, 0] < 0.029)
    assert q[on_box, 2].max() == pytest.approx(0.02 + ROD.radius, abs=0.05 * ROD.radius)
    top = np.abs(q[:, 0] - 0.08) < 0.004
    assert force[top, 2].sum() > 0.2 * ROD.weight * 0.1


def test_planes_have_ends():
    """A rod comes to rest on a tilted sheet; one beyond its end falls as freely as any."""
    builder = scene()
    turn = wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), 0.1)
    builder.add_shape_plane(xform=wp.transform((0.05, 0.0, 0.0), turn), width=0.12, length=0.06)
    for beyond in (0.0, 0.06):
        points = straight(6, 0.1, 2.0 * ROD.radius) + [0.0, beyond, 0.0]
        SolverDER.add_rod(builder, points, ROD)
    q = nodes(simulate(builder.finalize(device=DEVICE), 40, 5e-3, scheme="euler")[1])
    height = q[:6] @ [0.0, -np.sin(0.1), np.cos(0.1)]
    np.testing.assert_allclose(height, ROD.radius, rtol=0.01)
    fallen = 0.5 * 9.81 * 0.2**2 * (1.0 + 1.0 / 40)
    np.testing.assert_allclose(q[6:, 2], 2.0 * ROD.radius - fallen, rtol=1e-6)


def different_rods():
    """Points, material and holds of rods that differ in everything."""
    soft = wrod.RodMaterial(radius=0.002, gravito_bending_length=0.02, length=0.2)
    return [
        (straight(12, 0.06, 0.05), ROD, dict(start="clamped", internal_damping=0.02)),
        (straight(9, 0.05, 0.03, axis=1), soft, dict(end="pinned", air_damping=3.0)),
        (straight(12, 0.08, 0.012), soft, dict(natural_curvature=(5.0, -3.0))),
    ]


def test_worlds_do_not_mix():
    """Rods of several node counts in worlds of their own do what each does alone."""
    together = scene()
    for points, material, options in different_rods():
        together.begin_world()
        SolverDER.add_rod(together, points, material, **options)
        together.end_world()
    together.add_ground_plane()
    model = together.finalize(device=DEVICE)
    _, state = simulate(model, 20, 0.01)
    for rod, (points, material, options) in enumerate(different_rods()):
        alone = scene()
        SolverDER.add_rod(alone, points, material, **options)
        alone.add_ground_plane()
        _, expected = simulate(alone.finalize(device=DEVICE), 20, 0.01)
        got = nodes(state, (model, rod))
        assert np.abs(got - points).max() > 1e-3
        assert np.abs(got - nodes(expected)).max() < 1e-9


def test_replicated_worlds_move_rods_and_keep_shapes_apart():
    """Copies turned and shifted do the same in their places, each on its own table."""
    world = scene()
    SolverDER.add_rod(world, straight(9, 0.04, 0.012), ROD, internal_damping=0.02)
    world.add_shape_box(
        -1, xform=wp.transform((0.02, 0, 0), wp.quat_identity()), hx=0.05, hy=0.05, hz=0.01
    )
    turn = wp.quat_from_axis_angle(wp.vec3(0, 0, 1), np.pi / 2)
    places = [wp.transform_identity(), wp.transform((3.0, -2.0, 0.5), turn)]
    builder = scene()
    builder.replicate(world, copy_count=2, xforms=places)
    model = builder.finalize(device=DEVICE)
    solver, state = simulate(model, 20, 0.01)
    assert not solver.diverged.any()
    first, second = nodes(state, (model, 0)), nodes(state, (model, 1))
    assert first[:, 2].min() == pytest.approx(0.01 + ROD.radius, abs=0.05 * ROD.radius)
    moved = np.column_stack([-first[:, 1] + 3.0, first[:, 0] - 2.0, first[:, 2] + 0.5])
    assert np.abs(second - moved).max() < 1e-6  # Newton's poses are float32


def test_a_world_without_shapes():
    """A rod falls freely beside a world that has a table."""
    builder = scene()
    for has_table in (False, True):
        builder.begin_world()
        SolverDER.add_rod(builder, straight(4 + has_table, 0.02, ROD.radius), ROD)
        if has_table:
            at = wp.transform((0, 0, -0.1), wp.quat_identity())
            builder.add_shape_box(-1, xform=at, hx=0.5, hy=0.1, hz=0.1)
        builder.end_world()
    model = builder.finalize(device=DEVICE)
    _, state = simulate(model, 20, 0.005)
    fallen = 0.5 * 9.81 * 0.1**2
    assert nodes(state, (model, 0))[:, 2] == pytest.approx(ROD.radius - fallen, rel=0.02)
    assert nodes(state, (model, 1))[:, 2].min() > 0.95 * ROD.radius


def test_held_ends_follow_kinematic_bodies():
    """Place, direction and twist of both ends go with their bodies, on every substep's way."""
    builder = scene(gravity=0.0)
    left = builder.add_body(is_kinematic=True, label="left")
    right = builder.add_body(
        xform=wp.transform((0.1, 0, 0), wp.quat_identity()), is_kinematic=True, label="right"
    )
    points = straight(11, 0.1)
    SolverDER.add_rod(
        builder, points, ROD, director=(0, 1, 0), internal_damping=0.02,
        start="clamped", start_body=left, end="clamped", end_body=right,
    )  # fmt: skip
    model = builder.finalize(device=DEVICE)
    steps = 50

    def move(k, state):
        part = (k + 1) / steps
        place(model, state, left, (0.01 * part, 0.0, 0.01 * part))
        twist = wp.quat_from_axis_angle(wp.vec3(1, 0, 0), 1.5 * np.pi * part)
        place(model, state, right, (0.1, 0.0, 0.0), twist)

    _, state = simulate(model, steps, 0.01, move, max_step=0.005)
    q, director = nodes(state), state.der.edge_director.numpy()
    assert q[0] == pytest.approx([0.01, 0.0, 0.01], abs=1e-7)
    assert q[-1] == pytest.approx([0.1, 0.0, 0.0], abs=1e-7)
    # Directions at the clamps: bending and twisting move the first free edge away only by a part.
    for edge in (q[1] - q[0], q[-1] - q[-2]):
        assert edge[0] / np.linalg.norm(edge) > 0.95
    assert director[0] @ [0, 1, 0] > 0.9
    assert director[-1] @ [0, 0, -1] > 0.9  # y turned by 270 degrees about x
    assert np.abs(state.body_q.numpy()[left, :3] - [0.01, 0, 0.01]).max() < 1e-6


def test_moving_shapes_push_and_drag():
    """A kinematic belt carries a rod along by friction; a kinematic box pushes another."""
    builder = scene()
    belt = builder.add_link(is_kinematic=True, label="belt")
    flat = newton.ModelBuilder.ShapeConfig(density=0.0, mu=0.5)
    at = wp.transform((0.0, 0.0, -0.01), wp.quat_identity())
    builder.add_shape_box(belt, xform=at, hx=0.5, hy=0.1, hz=0.01, cfg=flat)
    SolverDER.add_rod(builder, straight(11, 0.05, ROD.radius, axis=1), ROD)
    pusher = builder.add_link(
        xform=wp.transform((0, 1.0, 0.01), wp.quat_identity()), is_kinematic=True, label="pusher"
    )
    builder.add_shape_box(pusher, hx=0.01, hy=0.1, hz=0.01, cfg=flat)
    builder.add_ground_plane(height=-0.02)
    ice = newton.ModelBuilder.ShapeConfig(mu=0.0)
    table = wp.transform((0.0, 1.0, -0.01), wp.quat_identity())
    builder.add_shape_box(-1, xform=table, hx=0.5, hy=0.1, hz=0.01, cfg=ice)
    SolverDER.add_rod(
        builder, straight(11, 0.05, ROD.radius, axis=1, shift=(0.02, 0.975, 0.0)), ROD
    )
    model = builder.finalize(device=DEVICE)
    steps, dt = 60, 1 / 120
    way = 0.08

    def move(k, state):
        part = max(k - 9, 0) / steps  # at first it settles on the belt
        smooth = way * part**3 * (10 - 15 * part + 6 * part**2)
        place(model, state, belt, (smooth, 0.0, 0.0))
        place(model, state, pusher, (smooth, 1.0, 0.01))

    solver, state = simulate(model, steps + 10, dt, move, max_step=dt / 2)
    assert not solver.diverged.any()
    carried, pushed = nodes(state, (model, 0)), nodes(state, (model, 1))
    # The belt's acceleration stays below mu g: the rod sticks to it.
    assert np.abs(carried[:, 0] - way).max() < 0.02 * ROD.radius
    # The pusher's face ends at its half size plus the way; without friction the rod ran ahead.
    assert pushed[:, 0].min() > 0.01 + way + 0.95 * ROD.radius
    assert np.ptp(pushed[:, 0]) < ROD.radius


def test_replayed_launches_do_what_fresh_ones_do():
    """Across other step lengths of one substep, other gravity and moved shapes."""
    results = []
    for replays in (True, False):
        builder = scene()
        grip = builder.add_link(
            xform=wp.transform((0, 0, 0.02), wp.quat_identity()), is_kinematic=True
        )
        SolverDER.add_rod(builder, straight(12, 0.08, 0.02), ROD, start="clamped", start_body=grip)
        at = wp.transform((0.05, 0, 0), wp.quat_identity())
        table = builder.add_shape_box(-1, xform=at, hx=0.1, hy=0.1, hz=0.01)
        model = builder.finalize(device=DEVICE)
        solver, state = SolverDER(model, max_step=0.004), model.state()
        for group in solver._groups:
            group.dynamics.keeps_recording = replays
        for k in range(30):
            place(model, state, grip, (-1e-3 * k, 0, 0.02))
            if k == 10:
                model.gravity.assign(model.gravity.numpy() * [1.0, 1.0, 2.0])
                solver.notify_model_changed(newton.ModelFlags.MODEL_PROPERTIES)
            if k == 20:
                poses = model.shape_transform.numpy()
                poses[table, 2] = -0.002
                model.shape_transform.assign(poses)
                solver.notify_model_changed(newton.ModelFlags.SHAPE_PROPERTIES)
            solver.step(state, state, None, None, (0.004, 0.012)[k // 5 % 2])
        assert not solver.diverged.any()
        results.append(nodes(state))
    assert results[0][-1, 2] < 0.009 + ROD.radius  # it followed the table down
    assert np.abs(results[0] - results[1]).max() < 1e-12


def test_rods_touch_themselves_if_asked():
    """The upper half of a folded rod comes to lie on the lower one, or falls through it."""
    soft = wrod.RodMaterial(radius=0.0008, gravito_bending_length=0.008, length=0.2)
    leg, fold = np.linspace(0.0, 0.05, 21), np.linspace(-np.pi / 2, np.pi / 2, 8)[1:-1]
    turn = 0.0045
    lower = np.column_stack([leg, 0 * leg])
    bend = np.column_stack([leg[-1] + turn * np.cos(fold), turn + turn * np.sin(fold)])
    side = np.concatenate([lower, bend, [[0.0, 2 * turn]] + lower[::-1] * [1.0, 0.0]])
    points = np.column_stack([side[:, 0], 0 * side[:, 0], side[:, 1] + soft.radius])
    nearest = []
    for friction in (0.4, None):
        builder = scene()
        SolverDER.add_rod(
            builder, points, soft, start="clamped", internal_damping=0.02, air_damping=5.0
        )
        builder.add_ground_plane()
        model = builder.finalize(device=DEVICE)
        solver, state = simulate(model, 90, 1 / 120, scheme="euler", self_contact=friction)
        assert not solver.diverged.any()
        q = nodes(state)
        below = np.stack([np.interp(np.linspace(0, 20, 801), range(21), x) for x in q[:21].T], 1)
        nearest.append(np.linalg.norm(q[-12:, None] - below, axis=2).min() / soft.radius)
    assert nearest[0] == pytest.approx(2.0, rel=0.05)
    assert nearest[1] < 1.0


def test_capsules_show_the_edges():
    builder = scene()
    SolverDER.add_rod(builder, straight(8, 0.05, 0.1), ROD, start="clamped")
    SolverDER.add_rod(builder, straight(8, 0.05, 0.2), ROD, start="pinned", visible=False)
    model = builder.finalize(device=DEVICE)
    assert model.body_count == 8
    _, state = simulate(model, 10, 0.01)
    q, poses = nodes(state, (model, 0)), state.body_q.numpy()[:7]
    assert np.abs(poses[:, :3] - 0.5 * (q[1:] + q[:-1])).max() < 1e-6
    edges = np.diff(q, axis=0)
    for pose, edge, director in zip(poses, edges, state.der.edge_director.numpy(), strict=False):
        turn = wp.quat(*map(float, pose[3:]))
        z = np.array(wp.quat_rotate(turn, wp.vec3(0, 0, 1)))
        assert z @ edge / np.linalg.norm(edge) == pytest.approx(1.0, abs=1e-6)
        assert np.array(wp.quat_rotate(turn, wp.vec3(1, 0, 0))) @ director == pytest.approx(1.0)


def test_states_from_outside_and_reset():
    """A state that is set back goes on from there, as a new solver would and to the last bit,
    however long ago it was; reset starts over."""
    builder = scene()
    SolverDER.add_rod(builder, straight(8, 0.05, 0.02), ROD, start="clamped")
    SolverDER.add_rod(builder, straight(8, 0.05, 0.02, axis=1), ROD, start="pinned")
    builder.add_ground_plane()
    model = builder.finalize(device=DEVICE)
    solver, state = simulate(model, 10, 0.01)
    kept = model.state()
    kept.assign(state)
    a, b = model.state(), model.state()
    for _ in range(5):
        solver.step(state, state, None, None, 0.01)
    solver.step(kept, a, None, None, 0.01)
    SolverDER(model).step(kept, b, None, None, 0.01)
    assert np.abs(nodes(a) - nodes(kept)).max() > 1e-5
    assert np.array_equal(nodes(a), nodes(b))
    solver.reset(a)
    assert np.array_equal(nodes(a), model.der.node_q.numpy())
    assert not a.der.node_qd.numpy().any()


def test_diverging_rod_is_cut_out_and_can_be_reset():
    """One world's gravity throws its rod farther in the shortest step than Newton can follow."""
    builder = scene()
    for _ in range(2):
        builder.begin_world()
        SolverDER.add_rod(builder, straight(8, 0.05), ROD, start="clamped")
        builder.end_world()
    model = builder.finalize(device=DEVICE)
    solver = SolverDER(model)
    state, start = model.state(), model.state()
    gravity = model.gravity.numpy().copy()
    wild = gravity.copy()
    wild[0, 2] = -1e16
    model.gravity.assign(wild)
    solver.notify_model_changed(newton.ModelFlags.MODEL_PROPERTIES)
    with pytest.warns(WrodWarning, match="rods cut out because no time step converged: 0"):
        solver.step(state, state, None, None, 0.01)
        if DEVICE != "cpu":  # a GPU is not waited for: what it says is heard by the next step
            wp.synchronize()
            solver.step(state, state, None, None, 0.01)
    assert solver.diverged.tolist() == [True, False]
    assert np.abs(nodes(state, (model, 1)) - nodes(start, (model, 1))).max() > 1e-5
    model.gravity.assign(gravity)
    solver.notify_model_changed(newton.ModelFlags.MODEL_PROPERTIES)
    mask = wp.array([True, False, False], dtype=wp.bool, device=DEVICE)
    moved = nodes(state, (model, 1)).copy()
    solver.reset(state, mask)
    assert np.array_equal(nodes(state, (model, 1)), moved)
    solver.step(state, state, None, None, 0.01)
    assert not solver.diverged.any()
    assert nodes(state, (model, 0))[-1, 2] < 0.0


def test_errors_say_what_to_call():
    bare = newton.ModelBuilder()
    points = straight(5, 0.1)
    relaxing = replace(RodModel.of(ROD), internal_damping=0.2, relaxation_time=0.1)
    with pytest.raises(RodError, match="register_custom_attributes"):
        SolverDER.add_rod(bare, points, ROD)
    with pytest.raises(RodError, match="register_custom_attributes"):
        SolverDER(bare.finalize(device=DEVICE))
    with pytest.raises(RodError, match=r"no rods; .*SolverDER\.add_rod"):
        SolverDER(scene().finalize(device=DEVICE))
    for wrong, match in [
        (dict(points=points[:2]), "3 or more"),
        (dict(points=points[[0, 1, 1, 2]]), "points 1 and 2 coincide"),
        (dict(points=points * np.nan), "finite numbers only"),
        (dict(material=3.0), "wrod.RodMaterial"),
        (dict(start="glued"), "free, pinned, clamped"),
        (dict(start="pinned", start_body=7), "start_body is 7"),
        (dict(director=(1, 0, 0)), "along the rod's first edge"),
        (dict(natural_curvature=np.zeros((3, 2))), "natural_curvature has shape"),
        (dict(air_damping=-1.0), "air_damping"),
        (dict(material=relaxing), "relaxation_time of 0.1 s"),
    ]:
        builder = scene()
        with pytest.raises(RodError, match=match):
            SolverDER.add_rod(builder, **{"points": points, "material": ROD, **wrong})
        assert builder.body_count == 0
    builder = scene()
    SolverDER.add_rod(builder, points, ROD)
    model = builder.finalize(device=DEVICE)
    with pytest.raises(RodError, match="scheme"):
        SolverDER(model, scheme="rk4")
    solver = SolverDER(model)
    with pytest.raises(RodError, match="dt is"):
        solver.step(model.state(), model.state(), None, None, 0.0)
    with pytest.raises(RodError, match=r"call model\.state"):
        solver.step(scene().finalize(device=DEVICE).state(), model.state(), None, None, 0.01)


def test_natural_curvature_bends_a_rod_to_its_circle():
    """Without weight a rod of natural curvature (c, 0) becomes an arc towards its first director,
    of total angle c times the length."""
    curved = wrod.RodMaterial(0.0016, 0.032, 0.2, natural_curvature=(12.0, 0.0))
    builder = scene(gravity=0.0)
    length, count = 0.1, 21
    for material, curvature in ((curved, None), (ROD, (0.0, 12.0))):
        SolverDER.add_rod(
            builder, straight(count, length), material, start="clamped", director=(0, 1, 0),
            natural_curvature=curvature, air_damping=50.0,
        )  # fmt: skip
    model = builder.finalize(device=DEVICE)
    _, state = simulate(model, 60, 0.05, scheme="euler")
    angle = 12.0 * length
    tip = np.array([np.sin(angle), 1.0 - np.cos(angle)]) * length / angle
    for rod, axis in ((0, 1), (1, 2)):
        q = nodes(state, (model, rod))
        assert np.abs(q[-1, [0, axis]] - tip).max() < length * (angle / count) ** 2
        assert np.abs(q[:, 3 - axis]).max() < 1e-9


def test_a_bent_wire_keeps_its_curvature():
    """A plastic cable in an arc of curvature k springs back to (1 - r) (k - k_y)."""
    from dataclasses import replace

    from wrod.rods.law import Plastic

    bent, yields, hardening, count = 20.0, 5.0, 0.2, 21
    wire = replace(wrod.RodModel.of(ROD), law=Plastic(yields, hardening))
    angle = bent * np.linspace(0.0, 0.1, count)
    arc = np.column_stack([np.sin(angle), 0 * angle, 1 - np.cos(angle)]) / bent
    builder = scene(gravity=0.0)
    SolverDER.add_rod(builder, arc, wire, start="clamped", air_damping=40.0)
    _, state = simulate(builder.finalize(device=DEVICE), 60, 0.1, scheme="euler")
    turn = np.diff(nodes(state), axis=0)[[0, -1]]
    turn = np.arccos(turn[0] @ turn[1] / np.linalg.norm(turn, axis=1).prod())
    kept = (1 - hardening) * (bent - yields)
    # The clamp's own node keeps half of what the others do.
    assert turn == pytest.approx(kept * 0.1 * (1 - 1 / (count - 1)), rel=0.01)


def test_changed_properties_are_taken_up():
    """Twice the stiffness halves the sag, after ROD_PROPERTIES."""
    builder = scene()
    SolverDER.add_rod(builder, straight(9, 0.02), ROD, start="clamped", air_damping=2e3)
    model = builder.finalize(device=DEVICE)
    solver, state = simulate(model, 40, 0.01, scheme="euler")
    sag = nodes(state)[-1, 2]
    model.der.node_bending_stiffness.assign(2 * model.der.node_bending_stiffness.numpy())
    solver.notify_model_changed(SolverDER.ROD_PROPERTIES)
    for _ in range(40):
        solver.step(state, state, None, None, 0.01)
    assert nodes(state)[-1, 2] == pytest.approx(sag / 2, rel=0.01)


@pytest.mark.parametrize("smooth", [False, True])
def test_smooth_rods_slide_over_rods(smooth):
    """A stiff rod across two others, without friction, on a slope of 1 %, gains g sin(angle) over
    more than an edge: no corner holds it back."""
    radius, angle, dt, steps = 0.001, 0.01, 2e-3, 200
    builder = newton.ModelBuilder(gravity=(9.81 * np.sin(angle), 0.0, -9.81 * np.cos(angle)))
    SolverDER.register_custom_attributes(builder)
    stiff = wrod.RodModel.of(
        wrod.RodMaterial.from_youngs_modulus(1e9, radius=radius, length=0.07, density=1150.0)
    )
    for x in (-0.015, 0.0155):
        line = np.linspace(-0.012, 0.012, 7)[:, None] * [0.0, 1.0, 0.0] + [x, 0.0005, 0.0]
        SolverDER.add_rod(builder, line, stiff, start="clamped", end="clamped", visible=False)
    line = np.linspace(-0.035, 0.035, 15)[:, None] * [1.0, 0.0, 0.0] + [0.0, 0.0, 2 * radius]
    SolverDER.add_rod(builder, line, stiff, visible=False, internal_damping=1e-3)
    model = builder.finalize(device=DEVICE)
    solver, state = SolverDER(model, rod_contact=0.0, smooth_rods=smooth), model.state()
    for _ in range(steps):
        solver.step(state, state, None, None, dt)
    assert not solver.diverged.any()
    gone = state.der.node_q.numpy()[14:, 0].mean()
    free = 0.5 * 9.81 * np.sin(angle) * (dt * steps) ** 2
    assert gone == pytest.approx(free, rel=0.01)


@pytest.mark.skipif("cuda" in DEVICE, reason="a GPU is not waited for")
@pytest.mark.parametrize("name", ["node_q", "node_qd", "edge_director", "edge_spin", "body_q"])
def test_what_is_no_number_is_refused_by_name(name):
    builder = scene()
    hand = builder.add_body(is_kinematic=True, label="hand")
    for k in range(2):
        SolverDER.add_rod(builder, straight(6, 0.1, 0.1 + k), ROD, start="clamped", start_body=hand)
    model = builder.finalize(device=DEVICE)
    solver, state = SolverDER(model), model.state()
    array = getattr(state, name) if name == "body_q" else getattr(state.der, name)
    values = array.numpy().copy()
    values[hand if name == "body_q" else -2] = np.nan
    array.assign(values)
    before = state.der.node_q.numpy().copy()
    expected = "body_q of body '.*hand'" if name == "body_q" else f"{name} of .* of rod 1"
    with pytest.raises(RodError, match=f"{expected} is not finite"):
        solver.step(state, state, None, None, 1e-3)
    np.testing.assert_array_equal(state.der.node_q.numpy(), before)
    solver.reset(state)
    state.body_q.assign(model.body_q)
    solver.step(state, state, None, None, 1e-3)
    assert np.isfinite(state.der.node_q.numpy()).all()


def test_rods_that_were_changed_behind_the_builder_are_named():
    def built():
        builder = newton.ModelBuilder()
        wrod.SolverDER.register_custom_attributes(builder)
        for y in (0.0, 0.1):
            points = np.linspace([0.0, y, 1.0], [0.3, y, 1.0], 9)
            wrod.SolverDER.add_rod(builder, points, ROD, start="clamped")
        wrod.SolverDER.attach(builder, 0, -1, node=5)
        return builder

    assert wrod.SolverDER(built().finalize(device="cpu")).rod_count == 2
    for name in ("rod_radius", "rod_node_count", "node_q", "hold_rod"):
        model, builder = built().finalize(device="cpu"), built()
        delattr(model.der, name)
        with pytest.raises(RodError, match=f"has lost the attribute der:{name}"):
            wrod.SolverDER(model)
        del builder.custom_attributes[f"der:{name}"]
        with pytest.raises(RodError, match="does not know rods"):
            wrod.SolverDER.attach(builder, 0, -1, node=3)
    for name, wrong in (("rod_node_count", (9, 10)), ("rod_first_edge", (0, 9))):
        model = built().finalize(device="cpu")
        getattr(model.der, name).assign(np.array(wrong, dtype=np.int32))
        with pytest.raises(RodError, match="are not where"):
            wrod.SolverDER(model)
    for name, wrong in (
        ("rod_end_body", 10**6),
        ("hold_kind", -7),
        ("node_mass", 0),
        ("rod_radius", -1),
    ):
        model = built().finalize(device="cpu")
        array = getattr(model.der, name)
        array.assign(np.full_like(array.numpy(), wrong))
        with pytest.raises(RodError, match=f"der:{name} holds what"):
            wrod.SolverDER(model)
    model = built().finalize(device="cpu")
    solver, state = wrod.SolverDER(model), model.state()
    del state.der.edge_director
    with pytest.raises(RodError, match="does not hold this model's rods"):
        solver.step(state, state, None, None, 1e-3)


POST, THIN, STRAIGHT = 0.05, 0.002, 0.12  # radii of a post and of a rope over it, its ends [m]
HUNG, LINE_MASS = 0.2, 0.004  # what hangs at the rope [kg], and the rope [kg/m]


def rope_over_post(friction, edge=0.004, radius=POST, **options):
    """(solver, model, state) of a rope that hangs half a turn around a post made of three edges,
    first with a mass at its end, last held by a hand."""
    builder = scene()
    stiff = dict(bending_stiffness=1e3, twisting_stiffness=1e3, stretching_stiffness=1e6)
    post = RodModel(length=0.1, line_mass=1.0, radius=radius, **stiff)
    axis = straight(4, 0.1, axis=1, shift=(0.0, -0.05, 0.0))
    SolverDER.add_rod(builder, axis, post, start="clamped", end="clamped")
    reach = radius + THIN
    turn = np.pi * reach
    s = np.linspace(0.0, 2 * STRAIGHT + turn, round((2 * STRAIGHT + turn) / edge) + 1)
    angle = np.pi - np.clip((s - STRAIGHT) / reach, 0.0, np.pi)
    points = reach * np.stack([np.cos(angle), 0.0 * s, np.sin(angle)], axis=1)
    points[:, 2] -= np.maximum(STRAIGHT - s, 0.0) + np.maximum(s - STRAIGHT - turn, 0.0)
    soft = dict(bending_stiffness=2e-6, twisting_stiffness=1.5e-6, stretching_stiffness=4e3)
    rope = RodModel(
        length=1.0, line_mass=LINE_MASS, radius=THIN, point_masses=((0.0, HUNG),), **soft
    )
    hand = builder.add_link(
        xform=wp.transform(wp.vec3(*points[-1]), wp.quat_identity()), is_kinematic=True
    )
    damping = dict(air_damping=2.0, internal_damping=0.02)
    SolverDER.add_rod(builder, points, rope, end="pinned", end_body=hand, **damping)
    model = builder.finalize(device=DEVICE)
    return SolverDER(model, rod_contact=friction, **options), model, hand, points[-1]


@pytest.mark.parametrize(
    ("radii", "friction", "rate"),
    [
        (25, 0.25, 60), (25, 0.5, 120), (25, 0.8, 240), (5, 0.25, 60), (6, 0.25, 60),
        (12, 0.4, 240),
    ],
)  # fmt: skip
def test_rope_over_a_post_made_of_rods(radii, friction, rate):
    """It rubs with its inner side, which goes by R / (R + r) slower than its middle: T' = mu n R /
    (R + r). Along the rope this pulls around its middle, by mu n r, which a shear force of that
    size balances, as nothing else does in a soft rope: n + mu r n' = T / (R + r). So tensions grow
    by exp(a phi), a + mu a^2 r / (R + r) = mu R / (R + r); the pull does not tremble, over thin
    posts by no more than what the edges' corners do."""
    post = radii * THIN
    solver, model, hand, place_of_hand = rope_over_post(friction, radius=post)
    state, dt, pulls = model.state(), 1 / rate, []
    z = place_of_hand[2]
    for k in range(round(1.5 / dt)):
        z -= 0.02 * dt * min(1.0, k * dt / 0.3)
        place(model, state, hand, (place_of_hand[0], 0.0, z))
        solver.step(state, state, None, None, dt)
        if k >= 1.2 / dt:
            pulls.append(np.linalg.norm(solver.body_wrenches()[hand, :3]))
    assert np.std(pulls) < (0.02 if radii > 18 else 0.08) * np.mean(pulls)
    q = state.der.node_q.numpy()
    light = LINE_MASS * 9.81
    tension = HUNG * 9.81 - light * q[4, 2], np.mean(pulls) + light * z
    inner, lean = friction * post / (post + THIN), friction * THIN / (post + THIN)
    grows = (np.sqrt(1.0 + 4.0 * lean * inner) - 1.0) / (2.0 * lean)
    assert tension[1] / tension[0] == pytest.approx(
        np.exp(grows * np.pi), rel=0.015 if radii > 18 else 0.025
    )


def test_as_many_edges_as_a_turn_has_touch_a_post():
    solver, model, _, _ = rope_over_post(0.25, edge=0.002)
    state = model.state()
    solver.step(state, state, None, None, 1 / 240)
    assert not solver.diverged.any()


def test_smooth_rods_that_wind_around_each_other_are_told():
    solver, model, _, _ = rope_over_post(0.25, smooth_rods=True)
    state = model.state()
    with pytest.warns(WrodWarning, match="smooth_rods=False where they wind around each other"):
        for _ in range(2):
            solver.step(state, state, None, None, 1 / 240)
