"""What the bodies that SolverDER moves touch: closed forms of rest, slopes, rolling and impacts."""

import newton
import numpy as np
import pytest
import warp as wp
from chosen import DEVICE

import wrod
from wrod.bench.newton_laid import SIZE, Plugs, acceleration
from wrod.errors import WrodWarning

pytestmark = pytest.mark.filterwarnings("ignore:rods pass through")


@pytest.mark.parametrize("scheme", ["euler", "bdf2", "midpoint"])
def test_a_body_lands_and_stays(scheme):
    """No rebound beyond a hundredth of the fall; at rest the ground bears body and thread, which
    sink in by less than a hundredth of the body."""
    scene = Plugs([(0.0, 0.0, 0.05)])
    scene.begin(scheme=scheme)
    height = scene.run(60, 1 / 120)[:, 0, 2] - SIZE
    assert not scene.solver.diverged.any()
    landed = np.flatnonzero(height < 0.0)[0]
    assert height[landed:].max() < 3e-4
    assert -0.01 * SIZE < height[-1] < 0.0
    assert -scene.pressed()[2] == pytest.approx(scene.weight(), rel=1e-4)


def test_friction_holds_and_lets_go():
    """On a slope below arctan(mu) nothing creeps; above it g (sin - mu cos) is gained."""
    assert abs(acceleration(0.4)) < 1e-5
    expected = 9.81 * (np.sin(0.6) - 0.5 * np.cos(0.6))
    assert acceleration(0.6) == pytest.approx(expected, rel=2e-3)


def test_a_ball_rolls():
    """Without sliding it gains 5 / 7 g sin(angle)."""
    expected = 5.0 / 7.0 * 9.81 * np.sin(0.2)
    assert acceleration(0.2, round_ones=True) == pytest.approx(expected, rel=2e-3)


def test_bodies_meet_and_keep_their_momentum():
    """Of two bodies of cables of their own, one hits the other, beside its middle and afloat: they
    share their steps, and the momentum stays, to rounding; that of rotation within the step."""
    scene = Plugs([(0.0, 0.0, 0.0), (0.06, 0.012, 0.0)], gravity=0.0, ground=False, mu=0.3)
    scene.begin(velocity=[(0.5, 0.0, 0.0), (0.0, 0.0, 0.0)], tolerance=1e-9)
    x = scene.run(40)
    assert not scene.solver.diverged.any()
    (group,) = scene.solver._groups
    bodies, rods = group.bodies, group.dynamics
    mass = bodies.body.numpy()[0]["mass"]
    places, velocity = bodies.place.numpy()[0], bodies.velocity.numpy()[0]
    node_mass = group.batch.node_mass.numpy()[0][:, None]
    nodes, rates = group.batch.positions()[0], rods.velocities()[0]
    momentum = mass @ velocity + np.sum(node_mass * rates, axis=0)
    turning = bodies.momentum.numpy()[0].sum(axis=0)
    turning = turning + np.sum(mass[:, None] * np.cross(places, velocity), axis=0)
    turning = turning + np.sum(node_mass * np.cross(nodes, rates), axis=0)
    given = 0.5 * (mass[0] + node_mass.sum() / 2)
    assert x[-1, 1, 0] > 0.065
    assert momentum == pytest.approx([given, 0.0, 0.0], abs=1e-7 * given)
    # A step of first order, as an impact is, keeps this within its length.
    assert turning[2] == pytest.approx(0.0, abs=1e-2 * given * SIZE)
    assert abs(bodies.momentum.numpy()[0, 1, 2]) > 5e-2 * given * SIZE


def test_what_others_move_feels_a_body():
    """A kinematic platform bears the plug on it, and carries it along without its sliding."""
    scene = Plugs([(0.0, 0.0, 0.06)], ground=False)
    platform = scene.builder.add_link(
        xform=wp.transform((0.0, 0.0, 0.03), wp.quat_identity()), is_kinematic=True
    )
    scene.builder.add_shape_box(platform, hx=0.1, hy=0.1, hz=0.01, cfg=scene.cfg)
    scene.begin()
    before = scene.run(60, 1 / 120)[-1, 0]
    wrench = scene.solver.body_wrenches()[platform]
    assert wrench[2] == pytest.approx(-scene.weight(), rel=1e-4)

    def move(k, state):
        poses = state.body_q.numpy().copy()
        poses[platform, 0] = 0.025 * (1.0 - np.cos(np.pi * (k + 1) / 60))
        state.body_q.assign(poses)

    after = scene.run(60, 1 / 120, move)[-1, 0]
    assert after[0] - before[0] == pytest.approx(0.05, abs=1e-4)


@pytest.mark.filterwarnings("ignore:this solver moves bodies with shapes")
def test_a_free_body_with_an_endless_plane_bears_a_cable():
    """A cable that falls on a heavy plate stays on it and brings it down with it, afloat: momentum
    stays, and the plate, whose plane has no ends, does what one does that is a box."""
    found = []
    for endless in (True, False):
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
        wrod.SolverDER.register_custom_attributes(builder)
        plate = builder.add_body(mass=0.05, inertia=wp.mat33(1e-4 * np.eye(3)))
        cfg = newton.ModelBuilder.ShapeConfig(density=0.0, mu=0.5)
        if endless:
            builder.add_shape_plane(body=plate, width=0.0, length=0.0, cfg=cfg)
        else:
            under = wp.transform((0.0, 0.0, -0.1), wp.quat_identity())
            builder.add_shape_box(plate, xform=under, hx=1.0, hy=1.0, hz=0.1, cfg=cfg)
        material = wrod.RodMaterial(radius=0.004, gravito_bending_length=0.08, length=0.2)
        points = np.outer(np.linspace(0.0, 0.2, 9), [1.0, 0.0, 0.0]) + [0.0, 0.0, 0.006]
        wrod.SolverDER.add_rod(builder, points, material, velocity=np.tile([0.2, 0, -0.3], (9, 1)))
        model = builder.finalize(device=DEVICE)
        solver, state = wrod.SolverDER(model, bodies=[plate], tolerance=1e-9), model.state()
        for _ in range(60):
            solver.step(state, state, None, None, 1e-3)
        assert not solver.diverged.any()
        mass = model.der.node_mass.numpy()[:, None]
        momentum = np.sum(mass * state.der.node_qd.numpy(), axis=0)
        momentum = momentum + 0.05 * state.body_qd.numpy()[plate, :3]
        assert momentum == pytest.approx(mass.sum() * np.array([0.2, 0.0, -0.3]), abs=1e-7)
        assert state.body_qd.numpy()[plate, 2] < -0.01
        found.append(state.der.node_q.numpy())
    np.testing.assert_allclose(found[0], found[1], atol=1e-7)


@pytest.mark.parametrize("flat", [True, False])
def test_what_a_body_presses_a_cable_against_holds_it(flat):
    """A box of 300 times the cable's weight lies on it, on the ground or on a table: the cable
    sinks into that by a twentieth of its radius at most, and is pressed by the box's weight."""
    builder = newton.ModelBuilder()
    wrod.SolverDER.register_custom_attributes(builder)
    builder.default_shape_cfg.mu = 0.5
    if flat:
        builder.add_ground_plane()
    else:
        under = wp.transform((0.0, 0.0, -0.1), wp.quat_identity())
        builder.add_shape_box(-1, xform=under, hx=1.0, hy=1.0, hz=0.1)
    material = wrod.RodMaterial(radius=0.004, gravito_bending_length=0.08, length=0.2)
    for y in (-0.02, 0.02):
        points = np.outer(np.linspace(-0.1, 0.1, 9), [1.0, 0.0, 0.0]) + [0.0, y, 0.004]
        wrod.SolverDER.add_rod(builder, points, material, internal_damping=0.01)
    box = builder.add_body(xform=wp.transform((0.0, 0.0, 0.0281), wp.quat_identity()))
    builder.add_shape_box(box, hx=0.03, hy=0.03, hz=0.02, cfg=newton.ModelBuilder.ShapeConfig(
        density=2e4, mu=0.5))  # fmt: skip
    model = builder.finalize(device=DEVICE)
    solver, state = wrod.SolverDER(model, bodies=[box]), model.state()
    detection = newton.CollisionPipeline(model)
    contacts = detection.contacts()
    for _ in range(60):
        detection.collide(state, contacts)
        solver.step(state, state, None, contacts, 1 / 120)
    assert not solver.diverged.any()
    height = state.der.node_q.numpy()[:, 2]
    assert height.min() > 0.95 * 0.004
    assert np.abs(state.body_qd.numpy()[box]).max() < 1e-3
    own = 9.81 * model.der.node_mass.numpy().sum()
    pressed = state.der.node_contact_f.numpy()[:, 2]
    assert pressed.sum() == pytest.approx(own, rel=1e-3)  # from below, less what is above
    assert state.body_q.numpy()[box, 2] == pytest.approx(0.028, abs=5e-4)


def test_without_contacts_it_says_so():
    scene = Plugs([(0.0, 0.0, 0.05)])
    model = scene.builder.finalize(device=DEVICE)
    solver, state = wrod.SolverDER(model), model.state()
    with pytest.warns(WrodWarning, match=r"\('plug'\).*given no contacts.*CollisionPipeline"):
        solver.step(state, state, None, None, 0.01)
