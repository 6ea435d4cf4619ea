"""Bodies that Newton's own solvers move, and cables that pull at them."""

import warnings

import newton
import numpy as np
import pytest
import warp as wp
from chosen import DEVICE

import wrod
from wrod.bench.newton_bodies import Slider, TwoLinkArm, period_and_rate, trembles
from wrod.errors import WrodWarning

SolverDER = wrod.SolverDER


def test_an_arm_under_mujoco_feels_its_cable():
    """Joint torques against statics that `solve_equilibria` finds, within 1 %; rods add no degree
    of freedom, and their capsules are where their edges are."""
    pytest.importorskip("mujoco_warp")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", newton.NewtonWarning)  # joints outside articulations
        arm = TwoLinkArm(mujoco=True, visible=True)
    assert arm.arm.mj_model.nv == 2
    arm.settle(400, 0.002)
    torques = arm.torques()
    assert np.abs(torques).min() > 2.0
    assert torques == pytest.approx(arm.statics(), rel=0.01)
    nodes = arm.state.der.node_q.numpy()
    middles = 0.5 * (nodes[1:] + nodes[:-1])
    assert arm.state.body_q.numpy()[2:, :3] == pytest.approx(middles, abs=1e-6)


def test_fixed_joints_collapse_without_the_rods():
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    post = builder.add_link(mass=1.0)
    builder.add_articulation([builder.add_joint_fixed(-1, post)])
    points = np.linspace(0.0, 0.1, 6)[:, None] * np.array([1.0, 0.0, 0.0])
    material = wrod.RodMaterial(radius=0.0016, gravito_bending_length=0.032, length=0.2)
    SolverDER.add_rod(builder, points, material)
    builder.collapse_fixed_joints()
    assert builder.body_count == 5
    model = builder.finalize(device=DEVICE)
    solver, state = SolverDER(model), model.state()
    solver.step(state, state, None, None, 0.01)
    fallen = state.body_q.numpy()[:, 2]
    assert (fallen < -1e-4).all()


def test_a_box_is_dragged_over_the_floor():
    """Newton's XPBD moves the box and knows the floor; the cable's tension is the friction, of the
    box's weight and of what the cable presses it down with, within 1 %."""
    friction, speed, dt, length = 0.4, 0.1, 0.002, 0.3
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    builder.default_shape_cfg.mu = friction
    builder.add_ground_plane()
    box = builder.add_body(xform=wp.transform((0.0, 0.0, 0.03), wp.quat_identity()))
    builder.add_shape_box(
        box, hx=0.05, hy=0.05, hz=0.03,
        cfg=newton.ModelBuilder.ShapeConfig(density=400.0, mu=friction),
    )  # fmt: skip
    start = np.array([0.05 + length, 0.0, 0.005])
    hand = builder.add_body(xform=wp.transform(tuple(start), wp.quat_identity()), is_kinematic=True)
    points = np.linspace(0.0, length, 13)[:, None] * [1.0, 0.0, 0.0] + [0.05, 0.0, 0.005]
    SolverDER.add_rod(
        builder, points,
        wrod.RodMaterial.from_youngs_modulus(1e8, 0.002, length, density=1150.0),
        start="pinned", start_body=box, end="pinned", end_body=hand,
        air_damping=2.0, internal_damping=0.002,
    )  # fmt: skip
    model = builder.finalize(device=DEVICE)
    floor, cable = newton.solvers.SolverXPBD(model, iterations=8), SolverDER(model, bodies="none")
    pipeline = newton.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, other = model.state(), model.state()
    pulls, places = [], []
    for k in range(250):
        state.clear_forces()
        cable.add_body_forces(state)
        pipeline.collide(state, contacts)
        floor.step(state, other, None, contacts, dt)
        poses = other.body_q.numpy()
        poses[hand] = [*(start + [speed * (k + 1) * dt, 0.0, 0.0]), 0.0, 0.0, 0.0, 1.0]
        other.body_q.assign(poses)
        cable.step(state, other, None, None, dt, moved=other)
        pulls.append(cable.body_wrenches()[box, :3])
        places.append(poses[box, 0])
        state, other = other, state
    pull = np.mean(pulls[150:], axis=0)
    assert (places[-1] - places[150]) / (99 * dt) == pytest.approx(speed, rel=0.01)
    weight = 9.81 * float(model.body_mass.numpy()[box])
    assert pull[0] == pytest.approx(friction * (weight - pull[2]), rel=0.01)
    assert abs(pull[2]) < 0.02 * weight


@pytest.mark.parametrize("told", [True, False])
def test_rods_go_on_where_another_solver_has_moved_bodies(told):
    """What falls has fallen by g t^2 / 2; a loop in which rods would be those of two steps ago,
    as other solvers do not carry them over, is named."""
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    box = builder.add_body(xform=wp.transform((1.0, 0.0, 0.0), wp.quat_identity()))
    builder.add_shape_box(box, hx=0.05, hy=0.05, hz=0.05)
    points = np.linspace(0.0, 0.1, 6)[:, None] * np.array([1.0, 0.0, 0.0])
    material = wrod.RodMaterial(radius=0.0016, gravito_bending_length=0.032, length=0.2)
    SolverDER.add_rod(builder, points, material)
    model = builder.finalize(device=DEVICE)
    boxes, cable = newton.solvers.SolverXPBD(model), SolverDER(model, scheme="midpoint")
    state, other, dt = model.state(), model.state(), 0.005

    def go_on(steps):
        nonlocal state, other
        for _ in range(steps):
            state.clear_forces()
            boxes.step(state, other, None, None, dt)
            if told:
                cable.step(state, other, None, None, dt, moved=other)
            else:
                cable.step(other, other, None, None, dt)
            state, other = other, state

    if not told:
        with pytest.warns(wrod.errors.WrodWarning, match="moved=other"):
            go_on(3)
        return
    go_on(20)
    assert state.der.node_q.numpy()[:, 2] == pytest.approx(-0.5 * 9.81 * 0.1**2, rel=1e-6)
    assert state.body_q.numpy()[box, 2] == pytest.approx(-0.5 * 9.81 * 0.1**2, rel=0.06)


@pytest.mark.parametrize(
    ("ratio", "scheme", "late", "relaxation"),
    [(0.2, "bdf2", 0.0, 1.0), (0.2, "euler", 1.0, 1.0), (1.0, "bdf2", 2.0, 1.0 / 3.0)],
)
def test_the_load_of_the_step_before(ratio, scheme, late, relaxation):
    """A slider on a spring swings with all of its cable: w^2 = k / (M + m); a step that the load is
    late damps by m / (M + m) w^2 h / 2 (see `wrod.bench.newton_bodies`)."""
    period, rate = period_and_rate(Slider(ratio, scheme, relaxation).run(370))  # three turns
    assert period == pytest.approx(1.0, abs=1e-3)
    expected = late * ratio / (1.0 + ratio) * (2.0 * np.pi) ** 2 / 240 / 2.0
    assert rate == pytest.approx(-expected, abs=1e-4 + 2e-3 * expected)


def test_a_cable_too_heavy_for_what_holds_it():
    """Under a quarter of the body's mass nothing trembles; above it does, unless loads are relaxed
    by less than 2 / (1 + 4 m / M)."""
    assert not trembles(0.9 * 0.25, "bdf2")
    assert trembles(1.2 * 0.25, "bdf2")
    assert not trembles(1.0, "bdf2", 0.9 * 0.4)
    assert trembles(1.0, "bdf2", 1.2 * 0.4)


def pressed(mass, substeps, frames=20, **options):
    """A box on a slider that Featherstone's solver moves falls 2 mm onto two cables on the ground:
    heights of its bottom and of the cables' lowest node over the radius, frame by frame."""
    radius = 0.005
    builder = newton.ModelBuilder()
    wrod.SolverDER.register_custom_attributes(builder)
    builder.add_ground_plane()
    material = wrod.RodMaterial.from_youngs_modulus(2e6, radius, 0.25, density=1150.0)
    for y in (-0.05, 0.05):
        points = np.column_stack([np.linspace(-0.125, 0.125, 26), np.full(26, y), [radius] * 26])
        wrod.SolverDER.add_rod(
            builder, points, material, internal_damping=0.02, air_damping=1.0, visible=False
        )
    link = builder.add_link()
    cfg = newton.ModelBuilder.ShapeConfig(density=mass / (0.1 * 0.16 * 0.04))
    builder.add_shape_box(link, hx=0.05, hy=0.08, hz=0.02, cfg=cfg)
    start = wp.transform((0.0, 0.0, 2.0 * radius + 0.022), wp.quat_identity())
    slider = builder.add_joint_prismatic(-1, link, axis=wp.vec3(0.0, 0.0, 1.0), parent_xform=start)
    builder.add_articulation([slider])
    model = builder.finalize(device=DEVICE)
    arm = newton.solvers.SolverFeatherstone(model)
    cable = wrod.SolverDER(model, **options)
    state, other = model.state(), model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    found = []
    for k in range(frames * substeps):
        state.clear_forces()
        cable.add_body_forces(state)
        arm.step(state, other, None, None, 1.0 / (60.0 * substeps))
        cable.step(state, other, None, None, 1.0 / (60.0 * substeps), moved=other)
        state, other = other, state
        if (k + 1) % substeps == 0:
            bottom = state.body_q.numpy()[link, 2] - 0.02
            found.append((bottom / radius, state.der.node_q.numpy()[:, 2].min() / radius))
    return np.array(found)


@pytest.mark.parametrize("mass", [0.02, 0.14, 1.4, 14.0])
def test_bodies_of_other_solvers_lie_on_cables(mass):
    """However heavy and however light: 14 kg on cables of 23 g sank through them and the ground,
    and 0.14 kg were thrown off by damping that is a step late."""
    bottom, lowest = pressed(mass, substeps=4).T
    assert bottom.min() > 1.9 and lowest.min() > 0.93
    assert bottom[3:].max() < 2.01
    assert bottom[-5:] == pytest.approx([1.946 if mass > 1.0 else 1.96] * 5, abs=0.01)


@pytest.mark.parametrize("mass", [0.02, 0.14, 14.0])
def test_bodies_of_other_solvers_lie_on_cables_in_long_steps(mass):
    """All were thrown off in 120 steps a second, by edges each of which was to bear them alone."""
    bottom, lowest = pressed(mass, substeps=2).T
    assert bottom.min() > 1.6 and lowest.min() > 0.93
    assert bottom[3:].max() < 2.1
    assert bottom[-5:] == pytest.approx([1.87] * 5, abs=0.02)


@pytest.mark.skipif(DEVICE != "cpu", reason="a GPU is not asked")
def test_steps_that_shake_a_light_body_are_spoken_of():
    with pytest.warns(WrodWarning, match="gets their load a step late"):
        pressed(0.14, substeps=1, frames=4)


@pytest.mark.skipif(DEVICE != "cpu", reason="a GPU is not asked")
def test_links_that_were_nowhere_yet_are_spoken_of():
    """A link without a place is at the origin until kinematics are evaluated, also for what it
    holds."""
    for evaluated in (False, True):
        builder = newton.ModelBuilder()
        wrod.SolverDER.register_custom_attributes(builder)
        link = builder.add_link(mass=0.5, inertia=wp.mat33(np.eye(3) * 1e-3))
        start = wp.transform((0.0, 0.0, 0.6), wp.quat_identity())
        turn = builder.add_joint_revolute(-1, link, axis=wp.vec3(0.0, 1.0, 0.0), parent_xform=start)
        builder.add_articulation([turn])
        points = np.linspace(0.0, 0.2, 6)[:, None] * [1.0, 0.0, 0.0] + [0.0, 0.0, 0.6]
        rod = wrod.rod("green-vps")
        wrod.SolverDER.add_rod(
            builder, points, rod, start="clamped", start_body=link, visible=False
        )
        model = builder.finalize(device=DEVICE)
        state = model.state()
        if evaluated:
            newton.eval_fk(model, model.joint_q, model.joint_qd, model)
        newton.eval_fk(model, model.joint_q, model.joint_qd, state)
        cable = wrod.SolverDER(model)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", WrodWarning)
            cable.step(state, state, None, None, 1e-3)
        told = any("begins 0.6 m from where body" in str(one.message) for one in said)
        assert told == (not evaluated)
        held = np.linalg.norm(state.der.node_q.numpy()[0] - [0.0, 0.0, 0.6])
        assert held < 1e-6 or not evaluated
