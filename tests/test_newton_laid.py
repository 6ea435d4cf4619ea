"""Rods that touch shapes on free bodies which SolverDER moves: rest, friction, impacts."""

import newton
import numpy as np
import pytest
import warp as wp
from chosen import DEVICE
from scipy.spatial.transform import Rotation

import wrod
from wrod.bench.newton_laid import (
    BAR,
    CABLE,
    Simulation,
    along,
    borne,
    collision,
    over_its_block,
    slide,
)
from wrod.errors import RodError, WrodWarning


@pytest.mark.parametrize("density", [0.5, 500.0, 5000.0])
def test_cables_bear_a_box(density):
    """The force on two sagging cables is the weight of the box, of a 300th to 35 times theirs,
    within 1e-6; nothing is deeper in the other than 5 % of a radius."""
    found, weight, scene = borne(density, DEVICE)
    assert not scene.solver.diverged.any()
    assert found == pytest.approx(weight, rel=1e-6)
    assert 0.0 < scene.solver._groups[0].contact.penetration()[0] < 0.05 * CABLE.radius


@pytest.mark.parametrize("scheme", ["euler", "bdf2", "midpoint"])
def test_a_ball_hits_a_cable(scheme):
    """Afloat, beside the middle, with friction: momentum stays to rounding, that of rotation within
    the step (of first order in an impact); the ball has given a third of it away, and spins."""
    before, after, motion = collision(scheme, device=DEVICE)
    given = before[0]
    assert np.abs(after[:3] - before[:3]).max() < 1e-12 * given
    assert np.abs(after[3:] - before[3:]).max() < 2e-3 * given * 0.05
    assert 0.3 < motion[0] < 0.7 and np.abs(motion[3:]).max() > 1.0


def test_friction_on_bars_holds_and_lets_go():
    """On two bars down a slope below arctan(mu) a box does not creep; above it gains
    g (sin - mu cos)."""
    assert abs(slide(0.4, device=DEVICE)) < 1e-5
    assert slide(0.6, device=DEVICE) == pytest.approx(
        9.81 * (np.sin(0.6) - 0.5 * np.cos(0.6)), rel=3e-3
    )


@pytest.mark.parametrize(("density", "pushed", "most"), [(0.5, 0.5, 120), (5000.0, 0.0, 66)])
def test_steps_of_what_slides_are_kept(density, pushed, most):
    """A light box that slides to rest on two cables, and one that is heavier than these: in a
    second of 60 steps hardly any is halved (by the derivative of friction alone, 180 and 75)."""
    scene = Simulation(density=density)
    for y in (-0.04, 0.04):
        scene.rod(along(0, 0.6, 30, (0.0, y, 0.0)), start="clamped", end="clamped", air_damping=5)
    box = scene.box((0.0, 0.0, 0.0231))
    scene.begin(DEVICE)
    scene.throw(box, (pushed, 0.4 * pushed, 0.0))
    scene.run(60, 1.0 / 60.0, box)
    assert scene.pressed()[2] == pytest.approx(-scene.weight(box), rel=0.1)
    assert scene.solver._groups[0].dynamics.step_count.numpy()[0] <= most


def test_friction_stays_in_its_cone():
    """A ball that slides along a bar: the tangential part of the force is mu times the normal one,
    which points to its centre."""
    scene = Simulation(mu=0.3)
    scene.rod(along(0, 0.6, 6), BAR, start="clamped", end="clamped")
    ball = scene.ball((0.047, 0.0, 0.0239))
    scene.begin(DEVICE)
    scene.throw(ball, (0.4, 0.0, 0.0))
    for _ in range(3):
        scene.run(1)
        force, (group,) = scene.pressed(), scene.solver._groups
        centre, nodes = group.bodies.place.numpy()[0, 0], group.batch.positions()[0]
        first, last = nodes[(nodes[:, 0] < centre[0]).sum() - 1 :][:2]
        way = last - first
        foot = first + way * (way @ (centre - first)) / (way @ way)
        normal = (foot - centre) / np.linalg.norm(foot - centre)
        pressing = force @ normal
        sliding = force - pressing * normal
        assert pressing > 0.01
        assert sliding == pytest.approx([0.3 * pressing, 0.0, 0.0], rel=5e-3, abs=5e-3 * pressing)


def test_a_block_bears_the_cable_that_it_holds():
    """It hangs down over the block's edge, which presses on it; where the block holds it, it does
    not. The cable above carries the weight of all within 1e-6."""
    top, weight, pressing = over_its_block(DEVICE)
    assert top == pytest.approx(weight, rel=1e-6)
    assert pressing > 0.1


def test_what_is_held_inside_is_not_thrown_out():
    """A cable that a ball holds at its centre, and one at its surface: afloat and straight they
    stay, and no edge is pressed."""
    scene = Simulation((0.0, 0.0, 0.0))
    ball = scene.ball((0.0, 0.0, 0.0))
    for first in (0.0, 0.021):
        points = along(0, 0.2, 40, (0.1 + first, first, 0.0))
        scene.rod(points, start="clamped", start_body=ball)
    scene.begin(DEVICE)
    scene.run(20)
    assert np.abs(scene.state.der.node_qd.numpy()).max() < 1e-9
    assert np.abs(scene.pressed()).max() == 0.0


def test_a_fast_ball_does_not_pass_through():
    """At 4 m/s a ball goes 66 mm a step, over a cable of 6 mm; a cable that is held at both ends
    stops it, in shorter steps."""
    scene = Simulation((0.0, 0.0, 0.0))
    scene.rod(along(1, 0.6, 30), start="clamped", end="clamped")
    ball = scene.ball((-0.1, 0.0, 0.0))
    scene.begin(DEVICE)
    scene.throw(ball, (4.0, 0.0, 0.0))
    for _ in range(6):
        scene.run(1, 1 / 60, ball)
        middle = scene.state.der.node_q.numpy()[15, 0]
        assert scene.state.body_q.numpy()[ball, 0] < middle
    assert not scene.solver.diverged.any()


def test_a_loose_body_is_moved_if_asked():
    """A ball that holds nothing is left to others, unless it is named: one that touches rods, of
    their world."""
    scene = Simulation()
    scene.rod(along(0, 0.6, 30), start="clamped", end="clamped")
    ball = scene.ball((0.0, 0.0, 0.05))
    bare = scene.builder.add_body(mass=0.1, inertia=wp.mat33(*np.diag([1e-4] * 3).ravel()))
    scene.begin(DEVICE, bodies="free")
    scene.run(4)
    assert scene.state.body_q.numpy()[ball, 2] == np.float32(0.05)
    solver = wrod.SolverDER(scene.model, bodies=[ball])
    contacts = newton.Contacts(0, 0, device=DEVICE)
    solver.step(scene.state, scene.state, None, contacts, 0.01)
    fallen = 0.05 - scene.state.body_q.numpy()[ball, 2]
    assert fallen == pytest.approx(9.81 * 1e-4, rel=1e-3)
    with pytest.raises(RodError, match=r"may touch one.*with a shape that collides"):
        wrod.SolverDER(scene.model, bodies=[bare])


def test_worlds_of_laid_boxes():
    """Two worlds of a box on a cable do what one does alone."""
    places = []
    for worlds in (1, 2):
        scene = Simulation()
        scene.rod(along(0, 0.6, 30, (0.0, 0.03, 0.0)), start="clamped", end="clamped")
        scene.rod(along(0, 0.6, 30, (0.0, -0.03, 0.0)), start="clamped", end="clamped")
        scene.box((0.0, 0.0, 0.03))
        builder = newton.ModelBuilder()
        wrod.SolverDER.register_custom_attributes(builder)
        builder.replicate(scene.builder, worlds)
        model = builder.finalize(device=DEVICE)
        boxes = np.flatnonzero(model.body_mass.numpy() > 0.05)
        solver = wrod.SolverDER(model, bodies=boxes)
        state, contacts = model.state(), newton.Contacts(0, 0, device=DEVICE)
        for _ in range(24):
            solver.step(state, state, None, contacts, 1 / 120)
        places.append(state.body_q.numpy()[boxes, :3])
    assert places[0].shape == (1, 3) and places[0][0, 2] < 0.02
    np.testing.assert_allclose(places[1], np.repeat(places[0], 2, axis=0), atol=1e-7)


class Derivative:
    """A Newton step of a scene beside that of its residual's finite differences.

    Two bodies, one of which holds a cable whose first edge, one node of which moves with the body,
    presses on the other; and a second cable does.
    """

    def __init__(self, box: bool):
        scene = Simulation((0.0, 0.0, 0.0), mu=0.0)
        turn = wp.quat_rpy(0.03, 0.02, 0.3)
        half = (0.02, 0.02, 0.02)
        for at in ((0.0, 0.0, 0.0), (0.055, 0.0, 0.0)):
            scene.box(at, half, turn) if box else scene.ball(at)
        scene.rod(along(0, 0.3, 6, (0.15, 0.0, 0.0224)), start="clamped", start_body=0)
        scene.rod(along(1, 0.2, 6, (0.055, 0.0, -0.0224)))
        scene.begin(DEVICE, tolerance=1e-16)
        scene.run(1, 1e-5)
        (group,) = scene.solver._groups
        # How damping turns with the normal is left out of the matrix, of rods and of bodies.
        group.contact._edges.model.relaxation.zero_()
        self.group, self.steps, self.bodies = group, group.dynamics, group.bodies
        steps = self.steps
        steps.until.assign(steps.time.numpy() + 1e-3)
        steps.wanted_step.fill_(1e-3)
        for array, value in ((steps.running, 1), (steps.starting, 1), (steps.leaves, 2)):
            array.fill_(value)
        steps._begin()
        self.free = np.flatnonzero(group.batch.free.numpy()[0])
        self.size = len(self.free) + 6 * self.bodies.place.shape[1]
        self.start = [a.numpy().copy() for a in (group.batch.state.dof, *self._motion())]
        random = np.random.default_rng(0)
        self.start[0][0, self.free] += 1e-5 * random.standard_normal(len(self.free))

    def _motion(self):
        return self.bodies.place, self.bodies.turn

    def residual(self, z: np.ndarray) -> np.ndarray:
        """Of rods and bodies, after free degrees of freedom and bodies have moved by z."""
        dof, place, turn = (a.copy() for a in self.start)
        dof[0, self.free] += z[: len(self.free)]
        for k, xi in enumerate(z[len(self.free) :].reshape(-1, 6)):
            place[0, k] += xi[:3]
            turn[0, k] = (Rotation.from_rotvec(xi[3:]) * Rotation.from_quat(turn[0, k])).as_quat()
        steps, bodies, batch = self.steps, self.bodies, self.group.batch
        for array, values in zip(
            (batch.state.dof, *self._motion()), (dof, place, turn), strict=True
        ):
            array.assign(values)
        steps.active.fill_(1)
        steps.iteration.zero_()
        bodies.put(steps.active, steps.start)
        steps._iterate(1e-3, 1e-9)
        gradient = batch.derivatives.gradient.numpy()[0, self.free]
        return np.concatenate([gradient, bodies._residual.numpy()[0].ravel()])

    def step(self) -> np.ndarray:
        """Newton's, after `residual`."""
        steps, bodies = self.steps, self.bodies
        assert steps.active.numpy()[0] == 1
        steps.system.factorise(self.group.batch.derivatives.hessian, steps.active)
        bodies.load(steps)
        steps.system.solve(steps.active)
        bodies.solve(steps)
        return np.concatenate([steps.system.x.numpy()[0, 0, self.free], bodies._step.numpy()[0]])


@pytest.mark.parametrize("box", [True, False])
def test_newton_steps_are_those_of_differences(box):
    """The matrix of rods, bodies and what touches between them is the residual's derivative."""
    scene = Derivative(box)
    z = np.zeros(scene.size)
    z[len(scene.free) :] = 1e-5 * np.random.default_rng(1).standard_normal(z.size - len(scene.free))
    residual = scene.residual(z)
    push = scene.bodies.push.numpy()[0, 1, 6]
    step = scene.step()
    matrix = np.empty((z.size, z.size))
    for k, e in enumerate(1e-8 * np.eye(z.size)):
        matrix[:, k] = (scene.residual(z + e) - scene.residual(z - e)) / 2e-8
    assert push > 0.1
    largest = np.abs(residual).max()
    assert np.abs(matrix @ step - residual).max() < 2e-4 * largest
    # Without what touches add to the coupling it is not.
    scene.residual(z)
    scene.bodies.touch.zero_()
    assert np.abs(matrix @ scene.step() - residual).max() > 1e-2 * largest


def test_forces_and_moments_are_equal_and_opposite():
    """Of curved rods whose roll a ball holds by friction, in the middle of a Newton step: forces on
    nodes, their moments and torques about edges, and the ball's wrench add up to nothing."""
    scene = Simulation((0.0, 0.0, 0.0))
    for y, z in ((-0.005, 0.023), (0.005, -0.023)):
        scene.rod(along(0, 0.2, 6, (0.0, y, z)), natural_curvature=np.array([0.5, 0.0]))
    ball = scene.ball((0.0, 0.0, 0.0), 0.021)
    scene.begin(DEVICE)
    scene.run(1, 1e-5, ball)
    (group,) = scene.solver._groups
    batch, bodies, steps = group.batch, group.bodies, group.dynamics
    random = np.random.default_rng(0)
    dof = batch.state.dof.numpy() + 1e-5 * random.standard_normal(batch.state.dof.shape)
    dof[:, 3::4] += 0.01 * random.standard_normal(dof[:, 3::4].shape)
    batch.state.dof.assign(dof)
    batch.derivatives.gradient.zero_()
    bodies.clear_contact()
    group.contact.add(batch.every_rod, batch.state.dof, steps.start.dof)
    gradient = np.append(batch.derivatives.gradient.numpy()[0], 0.0).reshape(-1, 4)
    force, torque, nodes = gradient[:, :3], gradient[:-1, 3], batch.positions()[0]
    tangent = np.diff(nodes, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    push, place = bodies.push.numpy()[0, 0], bodies.place.numpy()[0, 0]
    assert np.abs(torque).max() > 1e-6 and push[6] > 0.1
    assert force.sum(axis=0) + push[:3] == pytest.approx(np.zeros(3), abs=1e-14 * push[6])
    moment = np.cross(nodes, force).sum(axis=0) + (torque[:, None] * tangent).sum(axis=0)
    moment = moment + push[3:6] + np.cross(place, push[:3])
    assert moment == pytest.approx(np.zeros(3), abs=1e-14 * push[6])
    group.contact._edges.model.rolling.fill_(1.0)
    with pytest.raises(RodError, match="cannot roll; use rolling=False"):
        group.contact.carry(group.contact._edges.carried, np.zeros((1, 1, 13)))


@pytest.mark.skipif(DEVICE != "cpu", reason="a GPU is not waited for to look at the first state")
@pytest.mark.parametrize("height", [-0.01, 0.0, 1.01 * CABLE.radius])
def test_rods_that_begin_in_the_ground_are_named(height, recwarn):
    """A plane pushes at once all that lies in it: the rod would fly."""
    builder = newton.ModelBuilder()
    wrod.SolverDER.register_custom_attributes(builder)
    builder.add_ground_plane()
    for place in (0.5, height):
        points = np.linspace((0.0, 0.0, place), (0.3, 0.0, place), 7)
        wrod.SolverDER.add_rod(builder, points, CABLE)
    model = builder.finalize()
    state = model.state()
    wrod.SolverDER(model).step(state, state, None, None, 1e-3)
    told = [str(one.message) for one in recwarn if issubclass(one.category, WrodWarning)]
    assert any("rod 1 begins" in said for said in told) == (height < CABLE.radius)
