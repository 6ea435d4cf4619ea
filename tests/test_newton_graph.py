"""Steps of SolverDER that ask nothing: no read-back, no allocation, in a graph of the caller's."""

from itertools import pairwise

import newton
import numpy as np
import pytest
import warp as wp
from chosen import DEVICE

import wrod
from wrod.newton_solver import notes

ROD = wrod.RodMaterial(radius=0.0016, gravito_bending_length=0.032, length=0.2)
SolverDER = wrod.SolverDER
DT = 0.004
# A GPU adds in an order of its own: launched steps differ from each other, too.
ROUNDING = 0.0 if DEVICE == "cpu" else 1e-9


def scene(with_bodies: bool, requires_grad: bool = False):
    """Cables over a cylinder, on each other and on the ground, one of them held by a free body."""
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    builder.add_ground_plane()
    turn = wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), 0.5 * np.pi)
    builder.add_shape_cylinder(-1, xform=wp.transform((0.05, 0.0, 0.02), turn), radius=0.01)
    line = np.linspace(0.0, 0.12, 13)[:, None]
    along = line * [1.0, 0.0, 0.0] + [0.0, 0.0, 0.034]
    across = (line - 0.06) * [0.0, 1.0, 0.0] + [0.05, 0.0, 0.040]
    held = {}
    if with_bodies:
        inertia = wp.mat33(*np.diag([1e-6] * 3).ravel())
        at = wp.transform((0.12, 0.0, 0.034), wp.quat_identity())
        bob = builder.add_body(xform=at, mass=0.005, inertia=inertia)
        held = dict(end="pinned", end_body=bob)
    SolverDER.add_rod(builder, along, ROD, **held)
    SolverDER.add_rod(builder, across, ROD)
    return builder.finalize(device=DEVICE, requires_grad=requires_grad)


def run(model, steps, graph):
    solver, states = SolverDER(model, rod_contact=0.3), (model.state(), model.state())

    def pair():
        solver.step(*states, None, None, DT)
        solver.step(*states[::-1], None, None, DT)

    pair()
    if graph:
        with wp.ScopedCapture(device=DEVICE) as capture:
            pair()
    for _ in range(steps):
        wp.capture_launch(capture.graph) if graph else pair()
    return solver, states[0]


@pytest.mark.parametrize("with_bodies", [False, True])
def test_captured_steps_are_the_same(with_bodies):
    """Two steps captured and replayed do what they do when launched one by one, to the last
    bit of a CPU."""
    model = scene(with_bodies)
    (plain, a), (captured, b) = run(model, 20, False), run(model, 20, True)
    start = model.der.node_q.numpy()
    assert np.abs(a.der.node_q.numpy() - start).max() > 0.01
    assert (a.der.node_contact_f.numpy() != 0).any()
    for name in ("node_q", "node_qd", "node_contact_f", "edge_director", "edge_spin"):
        size = ROD.radius if name == "edge_spin" else 1.0
        same = size * getattr(a.der, name).numpy(), size * getattr(b.der, name).numpy()
        np.testing.assert_allclose(*same, rtol=0.0, atol=ROUNDING, err_msg=name)
    np.testing.assert_allclose(a.body_q.numpy(), b.body_q.numpy(), rtol=0.0, atol=ROUNDING)
    assert not (plain.diverged.any() or captured.diverged.any())


@wp.kernel
def measure(
    q: wp.array(dtype=wp.vec3d),
    body_q: wp.array(dtype=wp.transform),
    loss: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    wp.atomic_add(loss, 0, wp.float64(i + 1) * (q[i][0] + q[i][2]))
    if i < body_q.shape[0]:
        wp.atomic_add(loss, 0, wp.float64(body_q[i][2]))


class Taped:
    """Steps on a tape, from where the model is."""

    def __init__(self, model):
        self.model, self.solver = model, SolverDER(model, rod_contact=None)
        self.start, self.states = model.state(), [model.state() for _ in range(5)]
        velocity = np.random.default_rng(5).normal(size=self.start.der.node_qd.shape + (3,))
        self.start.der.node_qd.assign(0.3 * velocity - [0.0, 0.0, 0.5])
        self.loss = wp.zeros(1, dtype=wp.float64, device=DEVICE, requires_grad=True)

    def differentiate(self):
        first, tape = self.states[0], wp.Tape()
        for name in ("node_q", "node_qd", "edge_director", "edge_spin"):
            wp.copy(getattr(first.der, name), getattr(self.start.der, name))
        for name in ("body_q", "body_qd"):
            wp.copy(getattr(first, name), getattr(self.start, name))
        self.loss.zero_()
        with tape:
            for here, there in pairwise(self.states):
                self.solver.step(here, there, None, None, DT)
            arrays = [self.states[-1].der.node_q, self.states[-1].body_q]
            wp.launch(measure, len(self.start.der.node_q), arrays, [self.loss], device=DEVICE)
        tape.backward(self.loss)
        return tape

    def found(self):
        der = self.states[0].der
        arrays = der.node_q, der.node_qd, der.edge_spin, self.model.der.node_bending_stiffness
        return [array.grad.numpy().copy() for array in arrays]


@pytest.mark.skipif(DEVICE == "cpu", reason="a graph of a CPU keeps no arrays alive")
@pytest.mark.parametrize("with_bodies", [False, True])
def test_gradients_in_a_graph(with_bodies):
    """Steps on a tape and the way back, captured and replayed, give what they give launched; where
    a step has no gradients, no numbers."""
    taped = Taped(scene(with_bodies, requires_grad=True))
    tape = taped.differentiate()
    expected = taped.found()
    assert all((e != 0).any() for e in expected)
    tape.zero()
    with wp.ScopedCapture(device=DEVICE) as capture:
        kept = taped.differentiate()
    for _ in range(2):
        kept.zero()
        wp.capture_launch(capture.graph)
        for found, e in zip(taped.found(), expected, strict=True):
            np.testing.assert_allclose(found, e, rtol=0.0, atol=1e-8 * np.abs(e).max())
    velocity = taped.start.der.node_qd.numpy()
    velocity[0] = 1e9
    taped.start.der.node_qd.assign(velocity)
    kept.zero()
    wp.capture_launch(capture.graph)
    assert not np.isfinite(taped.found()[0][:13]).any()


@pytest.mark.skipif(DEVICE != "cpu", reason="a GPU captures them")
def test_a_graph_of_a_cpu_has_no_gradients():
    taped = Taped(scene(False, requires_grad=True))
    taped.differentiate()
    refused = pytest.raises(wrod.errors.RodError, match="in a graph has gradients on a GPU")
    with refused, wp.ScopedCapture(device=DEVICE):
        taped.differentiate()


def test_a_step_reads_and_allocates_nothing(monkeypatch):
    model = scene(with_bodies=True)
    solver, state = SolverDER(model, rod_contact=0.3), model.state()
    for _ in range(2):
        solver.step(state, state, None, None, DT)
    before = state.der.node_q.numpy().copy()

    def refuse(*_args, **_options):
        raise AssertionError("a step read back or allocated")

    with monkeypatch.context() as patched:
        # A CPU looks through the states, which are in its own memory.
        patched.setattr(notes, "refuse_what_is_no_number", lambda *_: None)
        patched.setattr(wp.array, "numpy", refuse)
        patched.setattr(wp.array, "__init__", refuse)
        patched.setattr(wp, "synchronize_device", refuse)
        for _ in range(5):
            solver.step(state, state, None, None, DT)
    assert np.abs(state.der.node_q.numpy() - before).max() > 1e-4


def test_a_rod_that_is_cut_out_of_a_graph_is_spoken_of():
    """What diverges in a replay is told by `diverged`, and in a warning of the next own step."""
    model = scene(with_bodies=False)
    solver, state = SolverDER(model), model.state()
    solver.step(state, state, None, None, DT)
    with wp.ScopedCapture(device=DEVICE) as capture:
        solver.step(state, state, None, None, DT)
    velocity = state.der.node_qd.numpy()
    velocity[0] = 1e9
    state.der.node_qd.assign(velocity)
    wp.capture_launch(capture.graph)
    assert solver.diverged.tolist() == [True, False]
    with pytest.warns(wrod.errors.WrodWarning, match="rods cut out.*: 0;"):
        solver.step(state, state, None, None, DT)


@pytest.mark.parametrize(("hold", "damping"), [("clamped", 0.0), ("pinned", 0.01)])
def test_changed_stiffness_in_a_graph(hold, damping):
    """Rods that become stiffer and softer, damped and bent otherwise go on in a captured step as
    rods that are made so (by "euler", which knows nothing of before, but how clamps bend what is
    damped); what has another radius is made anew."""
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    for side in (-1.0, 1.0):
        s = np.linspace(0.0, 0.12, 9)[:, None]
        SolverDER.add_rod(
            builder, s * [side, 0.3, 0.0] + [0.02 * side, 0.0, 0.0], ROD, start=hold, end=hold,
            internal_damping=damping, air_damping=1.0 + side * 0.5,
        )  # fmt: skip
    model = builder.finalize(device=DEVICE)
    der, rng = model.der, np.random.default_rng(7)
    der.node_natural_curvature.assign(rng.normal(size=(18, 2)))
    options = dict(scheme="euler", tolerance=1e-12, rod_contact=0.3, rod_stiffness=1e3)
    solver, state = SolverDER(model, **options), model.state()
    solver.step(state, state, None, None, DT)
    groups = solver._groups
    with wp.ScopedCapture(device=DEVICE) as capture:
        solver.step(state, state, None, None, DT)
    for _ in range(3):
        wp.capture_launch(capture.graph)
        for name in (
            "node_bending_stiffness", "node_twisting_stiffness", "edge_stretching_stiffness",
            "node_natural_curvature", "rod_internal_damping", "rod_air_damping",
        ):  # fmt: skip
            value = getattr(der, name).numpy()
            getattr(der, name).assign(value * rng.uniform(0.5, 2.0, size=value.shape))
        der.node_natural_twist.assign(rng.normal(size=18))
        solver.notify_model_changed(SolverDER.ROD_PROPERTIES)
        made, other = SolverDER(model, **options), model.state()
        for array in ("node_q", "node_qd", "edge_director", "edge_spin"):
            wp.copy(getattr(other.der, array), getattr(state.der, array))
        wp.capture_launch(capture.graph)
        made.step(other, other, None, None, DT)
        for array in ("node_q", "node_qd", "edge_director"):
            same = [getattr(s.der, array).numpy() for s in (state, other)]
            np.testing.assert_allclose(*same, rtol=0.0, atol=1e-9)
    assert solver._groups is groups
    der.rod_radius.assign(2.0 * der.rod_radius.numpy())
    solver.notify_model_changed(SolverDER.ROD_PROPERTIES)
    assert solver._groups is not groups
