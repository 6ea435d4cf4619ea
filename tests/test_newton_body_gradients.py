"""Gradients of `SolverDER` on a `wp.Tape` through bodies that it moves, against differences."""

import contextlib
from functools import cache

import newton
import numpy as np
import pytest
import warp as wp
from chosen import DEVICE
from newton._src.geometry import narrow_phase
from scipy.spatial.transform import Rotation
from test_newton_gradients import (
    STATE,
    Differenced,
    balanced,
    f64,
    of_node,
    put,
    rounding_of,
    vec3d,
)

import wrod
from wrod.newton_solver.gradients import PROPERTIES

SolverDER = wrod.SolverDER
NAME = "create_narrow_phase_kernel_gjk_mpr"
BODY = ("body_q", "body_qd", "body_f")
# Steps of differences that single precision takes exactly.
EXACT = {
    "gravity": 2.0**-7, "body_q": 2.0**-15, "body_qd": 2.0**-9, "body_f": 2.0**-16,
    "tray": 2.0**-22,
}  # fmt: skip
# Where contact is pressed in by a few hundredths of a millimetre.
PRESSED = {
    "body_q": 2.0**-20, "body_qd": 2.0**-14, "gravity": 2.0**-9, "body_f": 2.0**-13, "node_q": 1e-6,
    "edge_spin": 2e-2, "tray": 2.0**-22,
}  # fmt: skip
LITTLE = ["edge_spin", "edge_stretching_stiffness", "node_twisting_stiffness", "rod_air_damping"]
# What a loss weighs poses and velocities of the body by, exact in single precision.
WEIGHTS = np.array([192, -128, 320, 256, 64, -192, 128, 20, 12, -26, 1, 2, -1]) / 64.0


@pytest.fixture(autouse=True, scope="module")
def detection_of_one_kind():
    """Newton makes, hashes and loads kernels alike for every scene whose collisions it detects."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(narrow_phase, NAME, cache(getattr(narrow_phase, NAME)))
        yield


@wp.kernel
def measure(
    weight: wp.array(dtype=vec3d),
    q: wp.array(dtype=vec3d),
    v: wp.array(dtype=vec3d),
    director: wp.array(dtype=vec3d),
    spin: wp.array(dtype=f64),
    poses: wp.array(dtype=wp.transform),
    speeds: wp.array(dtype=wp.spatial_vector),
    body: int,
    of_body: wp.array(dtype=f64),
    loss: wp.array(dtype=f64),
):
    i = wp.tid()
    x = of_node(weight, q, v, director, spin, i)
    if i == 0:
        for k in range(7):
            x += of_body[k] * f64(poses[body][k])
        for k in range(6):
            x += of_body[7 + k] * f64(speeds[body][k])
    wp.atomic_add(loss, 0, x)


class Scene(Differenced):
    """A rod that a free body with an eccentric centre of mass holds: by its start, its end, and at
    its middle. Runs without a tape share a solver, which is told of what has changed."""

    steps = 4
    dt = 0.01
    solver = None
    tray = -1

    def __init__(self, holds: tuple[str, str, str | None], **options):
        self.options = {"tolerance": 1e-13, "max_iterations": 60} | options
        material = wrod.RodMaterial(radius=0.004, gravito_bending_length=0.08, length=0.3)
        s = np.linspace(0.0, 0.3, 9)
        line = np.stack([s, 0.01 * np.sin(9.0 * s), 0.02 * np.cos(7.0 * s)], axis=1)
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, -9.8125))
        SolverDER.register_custom_attributes(builder)
        self.body = builder.add_body(
            xform=wp.transform((-0.01, 0.02, 0.03), wp.quat_rpy(0.3, 0.2, -0.1)), mass=0.02,
            com=wp.vec3(0.01, -0.005, 0.0075),
            inertia=wp.mat33(2e-6, 1e-7, 0.0, 1e-7, 3e-6, 2e-7, 0.0, 2e-7, 4e-6),
        )  # fmt: skip
        start, end = (-1 if kind == "free" else self.body for kind in holds[:2])
        SolverDER.add_rod(
            builder, line, material, start=holds[0], start_body=start, end=holds[1],
            end_body=end, internal_damping=0.01, air_damping=0.3, visible=False,
        )  # fmt: skip
        if holds[2] is not None:
            SolverDER.attach(builder, 0, self.body, node=4, kind=holds[2])
        model = self.model = builder.finalize(device=DEVICE, requires_grad=True)
        der, rng = model.der, np.random.default_rng(2)
        # What the body holds begins on it: a state that says otherwise is put there.
        off = np.ones((9, 1))
        off[[0, 8, 4, 5]] = np.array([holds[0], holds[1], holds[2], holds[2]])[:, None] == "free"
        off[[4, 5]] = holds[2] is None
        self.start = {
            "node_q": der.node_q.numpy() + 3e-4 * off * rng.normal(size=(9, 3)),
            "node_qd": 0.3 * rng.normal(size=(9, 3)),
            "edge_director": der.edge_director.numpy() + 0.2 * off[:8] * rng.normal(size=(8, 3)),
            "edge_spin": 3.0 * rng.normal(size=8),
            "body_q": model.body_q.numpy()[self.body].astype(float),
            "body_qd": np.array([0.25, -0.125, 0.5, 2.0, -1.0, 3.0]),
            "body_f": np.array([64, 32, -128, 1, 2, -1]) * 2.0**-10,
        }
        curvature = rng.normal(size=der.node_natural_curvature.numpy().shape)
        der.node_natural_curvature.assign(curvature)
        self.weight = wp.array(rng.normal(size=(9, 3)), dtype=vec3d, device=DEVICE)

    def run(self, tape=None, **changed):
        """Loss, in double precision and on the tape, and both states."""
        start, states = self.start | changed, [self.model.state() for _ in range(2)]
        self.ways = [
            wp.array([pose], dtype=wp.transform, device=DEVICE, requires_grad=True)
            for pose in start.get("tray", ())
        ]
        for name in STATE:
            getattr(states[0].der, name).assign(start[name])
        for state in states:
            for name in BODY:
                array = getattr(state, name)
                values = array.numpy()
                values[self.body] = start[name]
                array.assign(values)
        if tape is not None or self.solver is None:
            solver = SolverDER(self.model, **self.options)
        else:
            solver = self.solver
            solver.notify_model_changed(self.changed)
        if tape is None:
            self.solver, self.changed = solver, 0
        loss = wp.zeros(1, dtype=f64, device=DEVICE, requires_grad=True)
        of_body = wp.array(WEIGHTS, dtype=f64, device=DEVICE)
        with contextlib.nullcontext() if tape is None else tape:
            for k in range(self.steps):
                end = states[(k + 1) % 2]
                solver.step(states[k % 2], end, None, self.contacts(k, states[k % 2]), self.dt)
            arrays = [getattr(end.der, name) for name in STATE]
            arrays += [end.body_q, end.body_qd, self.body, of_body]
            wp.launch(measure, 9, [self.weight, *arrays], [loss], device=DEVICE)
        single = np.concatenate([getattr(end, n).numpy()[self.body] for n in BODY[:2]])
        exact = self._exactly(solver, single[3:7])
        return float(loss.numpy()[0]) + WEIGHTS @ (exact - single), loss, states

    def _exactly(self, solver, near):
        """Pose and velocity of the body as the solver has them."""
        bodies = solver._groups[0].bodies
        (slot,) = np.flatnonzero(bodies.body.numpy()[0]["index"] == self.body)
        place, quat = bodies.place.numpy()[0, slot], bodies.turn.numpy()[0, slot]
        quat = quat * np.sign(quat @ near)
        turn = Rotation.from_quat(quat)
        model = self.model
        inertia = turn.as_matrix() @ model.body_inertia.numpy()[self.body].astype(float)
        spin = np.linalg.solve(inertia @ turn.as_matrix().T, bodies.momentum.numpy()[0, slot])
        origin = place - turn.apply(model.body_com.numpy()[self.body])
        return np.concatenate([origin, quat, bodies.velocity.numpy()[0, slot], spin])

    def contacts(self, k, state):
        """What collision detection finds in a state."""

    def gradients(self):
        tape = wp.Tape()
        _, loss, states = self.run(tape)
        tape.backward(loss)
        arrays = {name: getattr(states[0].der, name) for name in STATE}
        arrays |= {name: getattr(self.model.der, name) for name in PROPERTIES}
        arrays["gravity"] = self.model.gravity
        out = {k: a.grad.numpy().astype(float) for k, a in arrays.items() if a.grad is not None}
        for name in BODY:
            out[name] = getattr(states[0], name).grad.numpy()[self.body].astype(float)
        # Forces act in every step, whichever state it begins in.
        out["body_f"] = out["body_f"] + states[1].body_f.grad.numpy()[self.body]
        if self.ways:
            out["tray"] = np.stack([way.grad.numpy()[0].astype(float) for way in self.ways])
        return out


@pytest.mark.parametrize(
    ("holds", "options"),
    [
        (("clamped", "free", None), {}),
        (("pinned", "clamped", None), {"scheme": "euler", "max_step": 0.006}),
        (("free", "pinned", "clamped"), {"inertia": "consistent"}),
        (("pinned", "clamped", None), {"scheme": "midpoint", "max_step": 0.006}),
    ],
)
def test_gradients_through_a_free_body(holds, options):
    """Of a loss on the last state of rod and body, by all that the first held, by forces on the
    body, by every property and gravity, within 1e-6; what is of single precision, within 1e-7 of
    its parts."""
    agrees(Scene(holds, **options), EXACT, together=False)


def agrees(scene, exact, little=(), without=(), together=True):
    """Derivatives with differences, by steps of `exact` where those are of single precision; of
    properties one by one or `together`."""
    found = {k: g for k, g in scene.gradients().items() if k not in without}
    rounding = rounding_of(scene)
    all_ways = {}
    assert set(found) >= {*STATE, *BODY, "gravity", "node_bending_stiffness"}
    for name, gradient in found.items():
        rng, size = np.random.default_rng(list(name.encode())), exact.get(name, 5e-5)
        way = rng.normal(size=gradient.shape)
        if name in EXACT:
            way = rng.integers(-2, 3, size=gradient.shape).astype(float)
            way[-1] = 1.0
            if name == "body_f":
                way[3:] /= 16.0
        elif name in PROPERTIES and "natural" not in name:
            way *= getattr(scene.model.der, name).numpy()
        if name in [*LITTLE, *little]:
            way *= 30.0
        if together and name in PROPERTIES:
            all_ways[name] = way * size
            continue
        parts = gradient * way
        # Of poses on the way, what each end of a step wants is added up in single precision.
        single = {"tray": 2e-7}.get(name, 1e-7) * np.abs(parts).sum() if name in EXACT else 0.0
        scene.agrees(parts.sum(), {name: way}, size, rounding / size + single)
    if together:
        total, all_ways = balanced(all_ways, found)
        scene.agrees(total, all_ways, 1.0, rounding)


class Dragged(Scene):
    """A box or a ball that a rod drags over the ground, over a box or a ball that a hand moves (the
    `tray`) or, where `stacked`, over another box on it; what detection finds in the first run is
    given in all."""

    steps = 3

    def __init__(self, friction: float, stacked=False, is_round=False, tray=None, **options):
        self.options = {"tolerance": 1e-13, "max_iterations": 60} | options
        material = wrod.RodMaterial(radius=0.004, gravito_bending_length=0.08, length=0.3)
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, -9.8125))
        SolverDER.register_custom_attributes(builder)
        builder.default_shape_cfg.mu = friction
        builder.default_shape_cfg.density = 1000.0
        if tray is None:
            builder.add_ground_plane()
        else:
            self.tray = builder.add_link(is_kinematic=True)
        if tray == "box":
            below = wp.transform((0.0, 0.0, -0.05))
            builder.add_shape_box(self.tray, xform=below, hx=0.2, hy=0.2, hz=0.05)
        elif tray == "ball":
            below = wp.transform((0.004, 0.002, -0.5))
            builder.add_shape_sphere(self.tray, xform=below, radius=0.5)
        deep, top = 5.0 * 2.0**-16, 0.0
        if stacked:
            below = builder.add_body(xform=wp.transform((0.01, 0.005, 0.015 - deep)))
            builder.add_shape_box(below, hx=0.05, hy=0.04, hz=0.015)
            top = 0.03 - 2.0 * deep
        self.body = builder.add_body(
            xform=wp.transform((0.0, 0.0, 0.02 + top - deep), wp.quat_rpy(0.0, 0.0, 0.3))
        )
        if is_round:
            builder.add_shape_sphere(self.body, radius=0.02)
        else:
            builder.add_shape_box(self.body, hx=0.025, hy=0.015, hz=0.02)
        s = np.linspace(0.0, 0.3, 9)
        line = np.stack([0.01 + s, 0.03 * s, 0.045 + top + 0.02 * s], axis=1)
        SolverDER.add_rod(
            builder, line, material, start="clamped", start_body=self.body, end="pinned",
            internal_damping=0.01, air_damping=0.3, visible=False,
        )  # fmt: skip
        if stacked:
            SolverDER.attach(builder, 0, below, node=4, kind="pinned")
        model = self.model = builder.finalize(device=DEVICE, requires_grad=True)
        der, rng = model.der, np.random.default_rng(2)
        self.start = {
            "node_q": der.node_q.numpy(),
            "node_qd": 0.1 * rng.normal(size=(9, 3)),
            "edge_director": der.edge_director.numpy(),
            "edge_spin": 3.0 * rng.normal(size=8),
            "body_q": model.body_q.numpy()[self.body].astype(float),
            "body_qd": np.array([0.25, -0.125, 0.0, 0.0, 0.0, 1.0]),
            "body_f": np.array([64, 32, -2048, 1, 2, -1]) * 2.0**-10,
        }
        if tray is not None:  # along, up, and turned
            way = np.array([8.0, -4.0, 0.25, 0.5, -0.25, 8.0, 0.0]) * 2.0**-14
            self.start["tray"] = np.arange(1, 1 + self.steps)[:, None] * way + np.eye(7)[6]
        self.weight = wp.array(rng.normal(size=(9, 3)), dtype=vec3d, device=DEVICE)
        self._found, self._detection = [], newton.CollisionPipeline(model)

    def contacts(self, k, state):
        if self.ways:
            moved = wp.array([self.tray], dtype=int, device=DEVICE)
            wp.launch(put, 1, [self.ways[k], moved], [state.body_q], device=DEVICE)
        if len(self._found) <= k:
            self._found.append(self._detection.contacts())
            self._detection.collide(state, self._found[k])
        return self._found[k]


class Laid(Dragged):
    """A box on a taut rod, which hangs between two places, is pulled along by a hand or lies on
    another one; where it `holds`, also on its own end."""

    def __init__(self, friction: float, holds=False, pulls=False, crosses=False, **options):
        material = wrod.RodMaterial(radius=0.004, gravito_bending_length=0.08, length=0.3)
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, -9.8125))
        SolverDER.register_custom_attributes(builder)
        builder.default_shape_cfg.mu = friction
        builder.default_shape_cfg.density = 500.0
        high = 0.02 + 0.004 - 2.0**-14
        self.body = builder.add_body(
            xform=wp.transform((0.155, 0.005, high), wp.quat_rpy(0.0, 0.0, 0.3))
        )
        builder.add_shape_box(self.body, hx=0.03, hy=0.015, hz=0.02)
        self.hand = builder.add_link(is_kinematic=True) if pulls else -1
        s = np.linspace(0.0, 0.3, 9)
        line = np.stack([s, 0.003 * np.sin(9.0 * s), 0.0 * s], axis=1)
        SolverDER.add_rod(
            builder, line, material, start="pinned", start_body=self.hand, end="clamped",
            end_body=self.hand, internal_damping=0.01, air_damping=0.3, visible=False,
        )  # fmt: skip
        if holds:
            up = np.stack([0.16 + 0.0 * s, 0.005 + 0.1 * s, high + 0.03 + s], axis=1)
            SolverDER.add_rod(
                builder, up, material, start="clamped", start_body=self.body, end="pinned",
                visible=False,
            )  # fmt: skip
        if crosses:
            bow = 0.15 + 0.004 * np.sin(11.0 * s)  # without two edges that are as heavy
            below = np.stack([bow + 0.2 * (s - 0.14), s - 0.14, 0.0 * s - 0.00799], axis=1)
            SolverDER.add_rod(
                builder, below, material, start="pinned", end="pinned", internal_damping=0.01,
                visible=False,
            )  # fmt: skip
        self.options = {"tolerance": 1e-13, "max_iterations": 60, "bodies": [self.body]} | options
        model = self.model = builder.finalize(device=DEVICE, requires_grad=True)
        der, rng = model.der, np.random.default_rng(2)
        count = len(der.node_q)
        self.start = {
            "node_q": der.node_q.numpy(),
            "node_qd": 0.02 * rng.normal(size=(count, 3)),
            "edge_director": der.edge_director.numpy(),
            "edge_spin": 3.0 * rng.normal(size=len(der.edge_spin)),
            "body_q": model.body_q.numpy()[self.body].astype(float),
            "body_qd": np.array([0.25, -0.125, 0.0, 0.0, 0.0, 1.0]),
            "body_f": np.array([64, 32, -1024 if holds else -128, 1, 2, -1]) * 2.0**-10,
        }
        if friction > 0.5 or pulls:  # gently, from rest: an impact that sticks may end in two ways
            self.start["body_qd"], self.dt = np.zeros(6), 0.002
        self.weight = wp.array(rng.normal(size=(count, 3)), dtype=vec3d, device=DEVICE)
        self._found, self._detection = [], newton.CollisionPipeline(model)

    def contacts(self, k, state):
        if self.hand >= 0:
            way = 2.0**-14 * (k + 1) * np.array([8.0, -4.0, 1.0, 0.0, 0.0, 0.0, 0.0])
            pose = wp.array([way + np.eye(7)[6]], dtype=wp.transform, device=DEVICE)
            moved = wp.array([self.hand], dtype=int, device=DEVICE)
            wp.launch(put, 1, [pose, moved], [state.body_q], device=DEVICE)
        return super().contacts(k, state)


@pytest.mark.parametrize(
    ("friction", "stacked", "options"),
    [
        (0.3, False, {}),
        (1.5, False, {"scheme": "euler", "max_step": 0.006}),
        (0.0, True, {}),
        (0.3, True, {"max_step": 0.006}),
        (0.3, True, {"is_round": True}),
    ],
)
def test_gradients_through_what_bodies_touch(friction, stacked, options):
    """A box that slides on the ground, one that sticks to it, two boxes on each other, and a ball
    on a box."""
    scene = Dragged(friction, stacked, **options)
    agrees(scene, PRESSED | {"body_q": 2.0**-19, "node_q": 4e-6}, ["node_qd"])
    agrees_by_friction(scene)


@pytest.mark.parametrize(
    ("friction", "options"),
    [
        (0.0, {"scheme": "euler", "max_step": 0.006}),
        (0.0, {"holds": True}),
        (0.1, {"max_iterations": 300, "max_step": 0.006}),
        (3.0, {"scheme": "euler", "max_step": 0.0015}),
        (0.1, {"pulls": True}),
        (1.0, {"pulls": True}),
        (3.0, {"crosses": True, "rod_contact": 0.3}),
        (3.0, {"crosses": True, "rod_contact": 0.3, "smooth_rods": True, "max_step": 0.0015}),
    ],
)
def test_gradients_through_a_body_on_rods(friction, options):
    """A box that slides on a rod, sticks to it, is pulled along by it, and lies on rods that touch
    each other, as capsules and as splines; and one that another rod holds besides."""
    scene = Laid(friction, **options)
    exact = PRESSED
    if friction > 0.5:
        exact = dict.fromkeys(PROPERTIES, 2e-5) | {k: v / 8.0 for k, v in PRESSED.items()}
        exact |= {"node_q": 3e-8, "edge_spin": 1e-3, "rod_internal_damping": 1e-4}
    elif options.get("pulls"):  # of steps from 2^-6 to 2^-11 five agree; at 2^-9 a solve ends early
        exact = exact | {"gravity": 2.0**-8}
    if scene.dt < 0.01:  # of what counts little in so short a time
        exact = exact | {"rod_air_damping": 1e-3, "node_bending_stiffness": 2e-3}
    # Rods that are bent at rest keep their roll, which a difference would begin.
    agrees(scene, exact, ["rod_internal_damping"], without=["node_natural_curvature"])
    assert agrees_by_friction(scene).any() == (friction < 3.0)  # nothing slides


@pytest.mark.parametrize(
    ("friction", "options"),
    [
        (0.3, {"tray": "box"}),
        (1.5, {"tray": "box", "scheme": "euler", "max_step": 0.006}),
        (0.3, {"tray": "box", "is_round": True}),
        (0.3, {"tray": "ball", "max_step": 0.006}),
    ],
)
def test_gradients_through_what_is_moved_against_a_body(friction, options):
    """Of a box that slides on one that a hand moves along, up and around, or sticks to it; of a
    ball on it, and of a box on a ball."""
    scene = Dragged(friction, **options)
    agrees(scene, PRESSED | {"body_q": 2.0**-19})
    agrees_by_friction(scene)


def agrees_by_friction(scene):
    mu = scene.model.shape_material_mu
    slope = mu.grad.numpy().astype(float)
    if mu.numpy().any():
        scene.agrees(slope.sum(), {"friction": np.ones_like(slope)}, 2.0**-14, 1e-9)
    return slope
