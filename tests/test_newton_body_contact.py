"""What the bodies that SolverDER moves touch: closed forms of rest, slopes, rolling and impacts."""

import numpy as np
import pytest
import warp as wp
from chosen import DEVICE

import wrod
from wrod.bench.newton_touching import SIZE, Plugs, acceleration
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
    scene.begin([(0.5, 0.0, 0.0), (0.0, 0.0, 0.0)], tolerance=1e-9)
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


def test_without_contacts_it_says_so():
    scene = Plugs([(0.0, 0.0, 0.05)])
    model = scene.builder.finalize(device=DEVICE)
    solver, state = wrod.SolverDER(model), model.state()
    with pytest.warns(WrodWarning, match=r"\('plug'\).*given no contacts.*CollisionPipeline"):
        solver.step(state, state, None, None, 0.01)
