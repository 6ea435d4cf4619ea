"""Gradients of `SolverDER` on a `wp.Tape`, against differences, and what is refused."""

import contextlib
from dataclasses import replace
from functools import cache

import newton
import numpy as np
import pytest
import warp as wp
from chosen import DEVICE
from hollows import ground_mesh
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import wrod
from wrod.errors import RodError
from wrod.newton_solver.gradients import PROPERTIES
from wrod.rods.law import Dahl, Plastic, StandardLinearSolid

SolverDER = wrod.SolverDER
STATE = ("node_q", "node_qd", "edge_director", "edge_spin")
STEPS = 5
f64, vec3d = wp.float64, wp.vec3d


@wp.func
def of_node(
    weight: wp.array(dtype=vec3d),
    q: wp.array(dtype=vec3d),
    v: wp.array(dtype=vec3d),
    director: wp.array(dtype=vec3d),
    spin: wp.array(dtype=f64),
    i: int,
):
    """What a loss is of a node and the edge after it."""
    w = weight[i]
    x = wp.dot(w, q[i]) + f64(0.05) * wp.dot(w, v[i]) + f64(9.0) * wp.dot(q[i], q[i])
    if i < spin.shape[0]:
        x += f64(0.2) * wp.dot(w, director[i]) + f64(0.003) * spin[i]
    return x


@wp.kernel
def measure(
    weight: wp.array(dtype=vec3d),
    q: wp.array(dtype=vec3d),
    v: wp.array(dtype=vec3d),
    director: wp.array(dtype=vec3d),
    spin: wp.array(dtype=f64),
    poses: wp.array(dtype=wp.transform),
    capsule: int,
    loss: wp.array(dtype=f64),
):
    i = wp.tid()
    x = of_node(weight, q, v, director, spin, i)
    if i == 0:  # in single precision, so that differences must not see it
        p = poses[capsule]
        x += f64(0.01) * (f64(p[0]) + f64(2.0) * f64(p[2]) + f64(3.0) * f64(p[3]) - f64(p[5]))
    wp.atomic_add(loss, 0, x)


@wp.kernel
def put(
    pose: wp.array(dtype=wp.transform),
    bodies: wp.array(dtype=int),
    poses: wp.array(dtype=wp.transform),
):
    i = wp.tid()
    poses[bodies[i]] = pose[i]


class Differenced:
    """Runs of a `model` from a `start`, of which `run` tells the loss, against differences; what
    has `changed` is what the solver is to be told before the next."""

    changed = 0

    def agrees(self, found, ways, size, allowance, **options):
        """A derivative along ways of arrays by name, all at once, with differences."""
        flags = {
            "gravity": newton.ModelFlags.MODEL_PROPERTIES,
            "friction": newton.ModelFlags.SHAPE_PROPERTIES,
        }
        of_state = {k: v for k, v in self.start.items() if k in ways}
        arrays = {k: self._array(k) for k in ways if k not in of_state}
        values = {k: array.numpy().copy() for k, array in arrays.items()}

        def put_off(k):
            for name, value in values.items():
                arrays[name].assign((value + k * size * ways[name]).astype(value.dtype))
                self.changed |= int(flags.get(name, SolverDER.ROD_PROPERTIES))

        def at(k):
            put_off(k)
            changed = {name: value + k * size * ways[name] for name, value in of_state.items()}
            return self.run(**changed, **options)[0]

        agree(found, at, size, allowance, list(ways))
        put_off(0)

    def _array(self, name):
        model = self.model
        others = {"gravity": model.gravity, "friction": model.shape_material_mu}
        return others.get(name, getattr(model.der, name, None))


class Scene(Differenced):
    """Two rods with a preferred bend, in worlds of their own unless they may touch each other; a
    hand that moves holds the first, and a tray that moves may have what they lie on."""

    def __init__(
        self,
        ends=("clamped", "free"),
        attached=False,
        internal=0.01,
        dt=0.01,
        states=2,
        ground=False,
        law=None,
        mass=None,
        curled=False,
        crossed=0.0,
        hung=None,
        **options,
    ):
        self.dt, self.states, self.ground, self.crossed = dt, states, ground, crossed
        self.steps = STEPS + bool(ground)  # until all that is to slide has slid
        self.kinked = ground or law is not None or crossed  # forces have corners
        self.options = {"tolerance": 1e-13, "max_iterations": 60} | options
        material = wrod.RodMaterial(radius=0.004, gravito_bending_length=0.08, length=0.3)
        if law is not None:
            material = replace(wrod.RodModel.of(material), law=law)
        s = np.linspace(0.0, 0.3, 9)
        line = np.stack([s, 0.01 * np.sin(9.0 * s), 0.02 * np.cos(7.0 * s)], axis=1)
        if ground:
            line[:, 1:] = np.stack([0.01 * (1.0 - np.cos(9.0 * s)), 0.0037 + 0.0005 * s], axis=1)
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, -9.8125))
        SolverDER.register_custom_attributes(builder)
        together = "rod_contact" in options
        if not together:
            builder.begin_world()
        self.hand = builder.add_link(is_kinematic=True)
        weight = -1
        if hung is not None:  # a body that moves with the rods
            weight = builder.add_body(
                xform=wp.transform(line[-1], wp.quat_identity()), mass=0.01,
                com=wp.vec3(0.005, -0.0025, 0.0), inertia=wp.mat33(2e-6 * np.eye(3)),
            )  # fmt: skip
            ends = ends[0], hung
        SolverDER.add_rod(
            builder, line, material, start=ends[0],
            start_body=-1 if ends[0] == "free" else self.hand, end=ends[1], end_body=weight,
            internal_damping=internal, air_damping=0.3,
        )  # fmt: skip
        if attached:
            SolverDER.attach(builder, 0, self.hand, node=4)
        if not together:
            builder.end_world()
            builder.begin_world()
        other = line[:, [1, 0, 2]] * 1.1 - [0.2 * together, 0.0, 0.0]
        if crossed:  # the second lies on the first, at this angle
            way = np.array([np.cos(crossed), np.sin(crossed), 0.0])
            line[:, 1:] = 0.0
            other = line[2] + [0.003, 0.0, 0.00799] + (s - 0.08)[:, None] * way
        SolverDER.add_rod(
            builder, other, material, start="clamped", air_damping=0.6,
            internal_damping=internal, visible=False,
        )  # fmt: skip
        if not together:
            builder.end_world()
        cfg = newton.ModelBuilder.ShapeConfig(mu=0.02 if curled else 0.25)
        tray = -1
        carried = ground in ("tray", "slab", "rough tray")
        if carried and mass is None:
            tray = builder.add_link(is_kinematic=True)
        elif carried:  # which others move by forces, so that rods press it gently
            cfg.density = 0.0
            tray = builder.add_link(mass=mass, inertia=mass * 1e-3 * np.eye(3))
        if ground in ("solids", "tray"):
            self._add_solids(builder, tray, cfg)
        elif ground in ("rough", "rough tray"):
            heights = np.random.default_rng(7).uniform(-1.5e-4, 1.5e-4, (17, 17))
            vertices, triangles = ground_mesh(lambda x, y: heights, 17, 0.2)
            mesh = newton.Mesh(vertices + [0.15, 0.15, 0.0], triangles.ravel())
            builder.add_shape_mesh(tray, mesh=mesh, cfg=cfg)
        elif ground == "slab":
            builder.add_shape_plane(body=tray, width=0.0, length=0.0, cfg=cfg)
        elif ground:
            builder.add_ground_plane(cfg=cfg)
        model = self.model = builder.finalize(device=DEVICE, requires_grad=True)
        self.capsule = int(model.der.rod_body.numpy()[0]) + 4
        rng = np.random.default_rng(2)
        der = model.der
        if not ground or curled:  # what is bent at rest keeps its roll on the ground
            curvature = rng.normal(size=der.node_natural_curvature.numpy().shape)
            der.node_natural_curvature.assign(curvature)
        if law is not None:  # stiffer about one axis than about the other
            bending = der.node_bending_stiffness.numpy() * [1.0, 0.7]
            der.node_bending_stiffness.assign(bending)
        noise = 1e-5 if ground or crossed else 5e-4 if together else 0.003
        self.start = {
            "node_q": der.node_q.numpy() + noise * rng.normal(size=(18, 3)),
            "node_qd": (0.01 if crossed else 0.3) * rng.normal(size=(18, 3)),
            "edge_director": der.edge_director.numpy() + 0.2 * rng.normal(size=(16, 3)),
            "edge_spin": 3.0 * rng.normal(size=16),
        }
        if crossed:
            self.start["node_qd"][9:] += [0.05, 0.1, -0.1]
        if hung is not None:  # what it holds begins on it
            self.start["node_q"][7:9] = der.node_q.numpy()[7:9]
            self.start["edge_director"][7] = der.edge_director.numpy()[7]
        self.on_body = hung is not None
        # Rods that may touch go by radii in a step.
        n = np.arange(self.steps)[:, None] * (0.3 if together else 1.0)
        tilt = 0.0 if together else 0.3
        turn = Rotation.from_rotvec(n * [0.03, 0.05, -0.04] + [0.0, tilt, 0.0]).as_quat()
        poses = np.concatenate([n * [0.01, 0.005, 0.003], turn], axis=1)
        if ground:
            poses = 0.2 * n * [0.01, 0.005, 0.001, 0.0, 0.0, 0.2, 0.0] + [*[0.0] * 6, 1.0]
        poses = poses[:, None]
        if carried:
            turn = Rotation.from_rotvec(n * [2e-4, -1e-4, 0.01]).as_quat()
            ways = np.concatenate([n * [0.001, -0.0005, 5e-6], turn], axis=1)
            poses = np.concatenate([poses, ways[:, None]], axis=1)
        self.moved = wp.array([self.hand, tray][: poses.shape[1]], dtype=int, device=DEVICE)
        self.start["poses"] = np.round(poses * 2**20) / 2**20  # so that steps of them are exact
        self.weight = wp.array(rng.normal(size=(18, 3)), dtype=vec3d, device=DEVICE)
        self.solver = SolverDER(model, **self.options)
        self.reused = [model.state() for _ in range(states)]

    def _add_solids(self, builder, body, cfg):
        """What the rods lie on, side by side."""

        def at(x, y, depth, turn=(0.0, 0.0, 0.0)):
            quaternion = Rotation.from_rotvec(turn).as_quat()
            return wp.transform((x, y, 3e-5 - depth), wp.quat(*quaternion))

        along = (0.5 * np.pi, 0.0, 0.0)
        builder.add_shape_box(body, xform=at(0.02, 0.0, 0.1), hx=0.04, hy=0.05, hz=0.1, cfg=cfg)
        builder.add_shape_sphere(body, xform=at(0.11, 0.01, 0.05), radius=0.05, cfg=cfg)
        builder.add_shape_capsule(
            body, xform=at(0.2, 0.02, 0.03, along), radius=0.03, half_height=0.05, cfg=cfg
        )
        builder.add_shape_cylinder(
            body, xform=at(0.27, 0.02, 0.02, along), radius=0.02, half_height=0.05, cfg=cfg
        )
        builder.add_shape_ellipsoid(
            body, xform=at(0.0, 0.2, 0.04), rx=0.1, ry=0.08, rz=0.04, cfg=cfg
        )
        box = newton.Mesh.create_box(0.05, 0.04, 0.03, compute_inertia=False)
        builder.add_shape_mesh(body, xform=at(0.01, 0.33, 0.03, (0.0, 0.0, 0.3)), mesh=box, cfg=cfg)

    def run(self, tape=None, warm=0, capsule=True, **changed):
        """Loss, first state and poses; the first `warm` steps are not on the tape. Without one,
        solver and states are those of the run before."""
        model, start, solver, states = self.model, self.start | changed, self.solver, self.reused
        if tape is None and self.changed:
            solver.notify_model_changed(self.changed)
            self.changed = 0
        given = np.asarray(start["poses"], dtype=np.float32)
        poses = [wp.array(p, dtype=wp.transform, device=DEVICE, requires_grad=True) for p in given]
        if tape is not None:
            solver = SolverDER(model, **self.options)
            states = [model.state() for _ in range(self.states)]
        for name in STATE:
            getattr(states[0].der, name).assign(start[name])
        for name in ("body_q", "body_qd") if self.on_body else ():
            wp.copy(getattr(states[0], name), getattr(model, name))
        loss = wp.zeros(1, dtype=f64, device=DEVICE, requires_grad=True)

        def step(k):
            one, other = states[k % len(states)], states[(k + 1) % len(states)]
            wp.launch(put, len(self.moved), [poses[k], self.moved], [one.body_q], device=DEVICE)
            solver.step(one, other, None, None, self.dt)
            return other

        for k in range(warm):
            step(k)
        with contextlib.nullcontext() if tape is None else tape:
            for k in range(warm, self.steps):
                end = step(k)
            arrays = [getattr(end.der, name) for name in STATE]
            arrays += [end.body_q, self.capsule]
            wp.launch(measure, 18, [self.weight, *arrays], [loss], device=DEVICE)
        value = float(loss.numpy()[0])
        if capsule:  # that part of the loss, in double precision
            value += self._of_capsule(end) - self._of_capsule(end, single=True)
        return value, loss, states[0], poses

    def _of_capsule(self, state, single=False):
        if single:
            p = state.body_q.numpy()[self.capsule].astype(float)
            return 0.01 * (p[0] + 2.0 * p[2] + 3.0 * p[3] - p[5])
        q, d = state.der.node_q.numpy()[4:6], state.der.edge_director.numpy()[4]
        t = (q[1] - q[0]) / np.linalg.norm(q[1] - q[0])
        turn = Rotation.from_matrix(np.column_stack([d, np.cross(t, d), t])).as_quat()
        turn *= np.sign(turn @ state.body_q.numpy()[self.capsule, 3:])
        middle = q.mean(axis=0)
        return 0.01 * (middle[0] + 2.0 * middle[2] + 3.0 * turn[0] - turn[2])

    def gradients(self, **options):
        tape = wp.Tape()
        _, loss, state, poses = self.run(tape, **options)
        tape.backward(loss)
        der = self.model.der
        out = {name: getattr(state.der, name).grad.numpy() for name in STATE}
        out |= {name: getattr(der, name).grad for name in PROPERTIES}
        out = {
            k: v if isinstance(v, np.ndarray) or v is None else v.numpy() for k, v in out.items()
        }
        out["gravity"] = self.model.gravity.grad.numpy()
        out["friction"] = self.model.shape_material_mu.grad.numpy()
        out["poses"] = np.stack([p.grad.numpy() for p in poses])
        return {k: v.astype(float) for k, v in out.items() if v is not None}


def agree(found, at, size, allowance, name=None):
    """A derivative is that of `at`, by a difference of second order, of fourth, or, since a solve
    that ends early or a contact that changes may spoil a difference, of fourth at the size of
    several at which it changes least where that is halved, which knows nothing of what is found."""
    values = cache(at)

    def second(k):
        return (values(k) - values(-k)) / (2.0 * k * size)

    def fourth(k):
        return (4.0 * second(k) - second(2 * k)) / 3.0

    for difference in (second, fourth):  # of which the latter takes two runs more
        if found == pytest.approx(difference(1), rel=1e-6, abs=allowance):
            return
    sizes = (0.25, 0.5, 1, 2, 4)
    steady = min(sizes[1:], key=lambda k: abs(fourth(k) - fourth(k / 2)))
    assert found == pytest.approx(fourth(steady), rel=1e-6, abs=allowance), (name, steady)


# Of single precision.
SINGLE = ("gravity", "poses", "friction")
EVERY = (*STATE, *PROPERTIES, *SINGLE)


def rounding_of(scene, **options):
    """What a loss is known to: its last places, and what runs alike differ by on a GPU, which adds
    in an order of its own."""
    values = [scene.run(**options)[0] for _ in range(1 if DEVICE == "cpu" else 4)]
    return 4.0 * max(np.finfo(float).eps * abs(values[0]), np.ptp(values))


def balanced(ways, gradients):
    """Derivative along all ways by name at once, and the ways: uphill, so that nothing cancels, and
    so far that each says as much of the sum as the middling one, where 30 times as far does it."""
    ways = {k: np.abs(way) * np.where(gradients[k] < 0.0, -1.0, 1.0) for k, way in ways.items()}
    parts = {k: (gradients[k] * way).sum() for k, way in ways.items()}
    middling = np.median(list(parts.values()))
    factor = {k: min(30.0, middling / max(part, 1e-300)) for k, part in parts.items()}
    return sum(factor[k] * parts[k] for k in parts), {k: factor[k] * ways[k] for k in ways}


def compare(scene, names, size=1e-4, together=False, **options):
    """Gradients with differences, of properties one by one or `together`."""
    found = scene.gradients(**options)
    rounding = rounding_of(scene, **options)
    all_ways = {}
    for name in names:
        if name not in found:
            continue
        rng, shape = np.random.default_rng(list(name.encode())), found[name].shape
        way, step = rng.normal(size=shape), size
        if name in SINGLE:
            way = rng.integers(-2, 3, size=shape).astype(float)
            way[-1] = 1.0
            step = {"gravity": 2.0**-7, "poses": 2.0**-16, "friction": 2.0**-10}[name]
        if name == "poses":
            way[: options.get("warm", 0)] = 0.0
            step *= 2.0**-6 if scene.kinked else 1.0
            if scene.ground in ("tray", "slab", "rough tray"):  # by whose height forces go
                step *= 2.0**-3
                way[..., 6] = 0.0
        elif name == "friction" and scene.ground not in (False, True, "slab"):
            step *= 2.0**-5
        elif name == "gravity" and scene.ground:  # more of it lets nodes slide that stick
            step *= 2.0**-4
        elif name in PROPERTIES and "natural" not in name:
            way *= getattr(scene.model.der, name).numpy()
        if scene.on_body and name in STATE:
            way[7:9] = 0.0
        little = ["edge_spin", "edge_stretching_stiffness"]  # which count little
        if scene.crossed or scene.options.get("scheme") == "midpoint":
            little.append("node_natural_curvature")
        damping = name in ("rod_air_damping", "rod_internal_damping")
        if name in little or (damping and (scene.ground or scene.crossed)):
            way *= 1000.0 if scene.crossed and name == "edge_spin" else 30.0
        elif name == "node_q" and scene.kinked:  # the skin in which contact begins is thin
            way *= 0.01
        if together and name in PROPERTIES:
            all_ways[name] = way * step
            continue
        parts = found[name] * way
        single = 1e-7 * np.abs(parts).sum() if name in SINGLE else 0.0
        scene.agrees(parts.sum(), {name: way}, step, rounding / step + single, **options)
    if together:
        total, all_ways = balanced(all_ways, found)
        scene.agrees(total, all_ways, 1.0, rounding, **options)


@pytest.mark.parametrize(
    ("options", "states"),
    [
        ({}, 2),
        ({"scheme": "euler", "internal": 0.0}, STEPS + 1),
        ({"max_step": 0.004}, 1),
        ({"scheme": "midpoint"}, 2),
        ({"scheme": "midpoint", "max_step": 0.004, "attached": True}, STEPS + 1),
        ({"scheme": "midpoint", "inertia": "consistent", "ends": ("pinned", "clamped")}, 1),
        ({"inertia": "consistent", "ends": ("pinned", "clamped")}, 2),
        ({"rod_contact": 0.3, "ends": ("free", "free"), "attached": True, "max_step": 0.006}, 2),
    ],
)
def test_gradients_against_differences(options, states):
    """Of a loss on all that the last state holds, by all that the first held, by every property,
    gravity of each world and every pose of the hand, within 1e-6; with states that alternate, one
    that is its own successor (and substeps), and one for each step; with rods that share a row."""
    # Nothing damps what the midpoint rule lets ring: the loss is less smooth by what is stiff.
    size = 2e-5 if options.get("scheme") == "midpoint" else 5e-5
    compare(Scene(states=states, **options), EVERY, size=size)


@pytest.mark.parametrize(
    ("friction", "options"),
    [
        (0.2, {"crossed": 1.3}),
        (5.0, {"crossed": 1.3, "scheme": "euler"}),
        (0.2, {"crossed": 0.15, "dt": 0.005, "max_step": 0.003}),
        (0.2, {"crossed": 1.3, "smooth_rods": True, "attached": True}),
        (0.2, {"crossed": 1.3, "hung": "clamped"}),
        (5.0, {"crossed": 1.3, "hung": "pinned", "scheme": "midpoint"}),
    ],
)
def test_gradients_through_rods_on_each_other(friction, options):
    """Of two that cross, or nearly lie along each other, and slide or stick; and where a free body
    hangs on one of them; by all properties at once."""
    compare(Scene(rod_contact=friction, **options), EVERY, size=1e-5, together=True)


@pytest.mark.parametrize(
    ("law", "options"),
    [
        (StandardLinearSolid(0.8, 0.03), {"scheme": "euler"}),
        (Plastic(2.0, 0.3), {"max_step": 0.006}),
        (Dahl(2.0, 0.3), {}),
    ],
)
def test_gradients_through_rods_with_a_past(law, options):
    """Of what a section remembers, in both directions of bending, from before its first step on."""
    compare(Scene(law=law, **options), EVERY, size=5e-5)


def test_motion_that_goes_on_from_before_the_tape():
    """What was before the tape counts as given."""
    compare(Scene(), ("poses",), warm=2)


def test_tapes_may_be_used_again():
    """A second tape, and the first one after `zero`, say the same."""
    scene = Scene(states=STEPS + 1)
    first = scene.gradients()
    tape = wp.Tape()
    _, loss, state, poses = scene.run(tape)
    for _ in range(2):
        tape.zero()
        scene.model.gravity.grad.zero_()
        tape.backward(loss)
    for name in STATE:
        found = getattr(state.der, name).grad.numpy()
        np.testing.assert_allclose(found, first[name], rtol=1e-9, atol=1e-12)
    found = np.stack([p.grad.numpy() for p in poses])
    np.testing.assert_allclose(found, first["poses"], rtol=1e-5, atol=1e-6)


def cable(builder, height=1.0, **options):
    points = np.linspace(0.0, 0.2, 6)[:, None] * [1.0, 0.0, 0.0] + [0.0, 0.0, height]
    material = wrod.RodMaterial(radius=0.004, gravito_bending_length=0.08, length=0.2)
    return SolverDER.add_rod(builder, points, material, visible=False, **options)


def taped_step(builder, dt=0.01, count=1, **options):
    model = builder.finalize(device=DEVICE, requires_grad=True)
    solver, state = SolverDER(model, **options), model.state()
    with wp.Tape():
        for _ in range(count):
            solver.step(state, state, None, None, dt)
    return model


def make():
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    return builder


def test_what_has_no_gradients_has_none():
    builder = make()
    cable(builder)
    model = taped_step(builder)
    for name in ("node_softening", "node_inelastic"):
        assert getattr(model.der, name).grad is None
    assert all(getattr(model.der, name).grad is not None for name in PROPERTIES)


def test_what_has_no_gradients_is_refused():
    """By the step, when a tape is recorded; without one it is taken."""
    builder = make()
    cable(builder, height=0.006, natural_curvature=(2.0, 0.0))
    tray = builder.add_link(is_kinematic=True)
    builder.add_shape_plane(body=tray, width=0.0, length=0.0)
    with pytest.raises(RodError, match="touches something"):
        taped_step(builder, count=20)
    builder = make()
    cable(builder)
    model = builder.finalize(device=DEVICE, requires_grad=True)
    solver, state = SolverDER(model, scheme="midpoint"), model.state(requires_grad=False)
    solver.step(state, state, None, None, 0.01)
    with wp.Tape(), pytest.raises(RodError, match="a state has no gradients"):
        SolverDER(model).step(state, state, None, None, 0.01)
    with wp.Tape(), pytest.raises(RodError, match="loads of rods"):
        solver.add_body_forces(state)


def test_a_tape_without_gradients_records_nothing():
    builder = make()
    cable(builder)
    model = builder.finalize(device=DEVICE)
    solver, state, tape = SolverDER(model), model.state(), wp.Tape()
    with tape:
        solver.step(state, state, None, None, 0.01)
    assert tape.launches == []


SOLIDS = [1, 1, 1, 0, 1, 1]


@pytest.mark.parametrize(
    ("ground", "rubs", "options"),
    [
        (True, [1], {}),
        ("solids", SOLIDS, {}),
        (True, [1], {"curled": True}),
        ("solids", [1] * 6, {"curled": True}),
        ("tray", SOLIDS, {}),
        ("tray", SOLIDS, {"max_step": 0.003}),
        ("tray", [1] * 6, {"curled": True}),
        ("tray", SOLIDS, {"mass": 0.01}),
        ("tray", SOLIDS, {"mass": 1.0}),
        ("slab", [1], {}),
        ("slab", [1], {"mass": 1.0, "max_step": 0.003}),
        ("rough", [1], {}),
        ("rough", [1], {"curled": True}),
        ("rough tray", [1], {}),
    ],
)
def test_gradients_over_the_ground(ground, rubs, options):
    """Of cables that a hand drags over the ground, over a mesh with hollows, or over a box, a ball,
    a capsule, a cylinder, an ellipsoid and a mesh, where they slide and stick, by friction as well;
    and by the poses of a tray that carries these, or a plane without ends, along and turns them,
    also of one that rods must not press firmly; by all properties at once. Those that are bent at
    rest keep their roll."""
    names = [n for n in EVERY if n != "node_natural_curvature" or "curled" in options]
    scene = Scene(ground=ground, dt=0.005, **options)
    # Where edges roll an iteration more or less is seen, where heights matter the skin.
    size = 4e-6 if ground is True or "curled" not in options else 4e-5
    if ground in ("rough", "rough tray"):  # one side takes over from another within little
        size = 1e-6
    compare(scene, names, size=size, together=True)
    by_friction = scene.model.shape_material_mu.grad.numpy()[-len(rubs) :]
    assert ((by_friction != 0.0) == np.array(rubs)).all()


@wp.kernel
def squared_distance(
    q: wp.array(dtype=vec3d), target: wp.array(dtype=vec3d), loss: wp.array(dtype=f64)
):
    i = wp.tid()
    wp.atomic_add(loss, 0, wp.length_sq(q[i] - target[i]))


def test_a_stiffness_is_found_by_descent():
    """From where a cable is after 0.2 s, that of bending, which was taken 40 % too large."""
    builder = make()
    cable(builder, start="clamped")
    model = builder.finalize(device=DEVICE, requires_grad=True)
    solver = SolverDER(model, tolerance=1e-10)
    stiffness = model.der.node_bending_stiffness
    true = stiffness.numpy().copy()
    loss = wp.zeros(1, dtype=f64, device=DEVICE, requires_grad=True)

    def move(factor):
        stiffness.assign(true * factor)
        solver.notify_model_changed(SolverDER.ROD_PROPERTIES)
        state, other = model.state(), model.state()
        for _ in range(20):
            solver.step(state, other, None, None, 0.01)
            state, other = other, state
        return state.der.node_q

    target = wp.clone(move(1.0), requires_grad=False)

    def evaluate(logarithm):
        factor, tape = float(np.exp(logarithm[0])), wp.Tape()
        loss.zero_()
        with tape:
            q = move(factor)
            wp.launch(squared_distance, len(q), [q, target], [loss], device=DEVICE)
        tape.backward(loss)
        slope = float((stiffness.grad.numpy() * true).sum()) * factor
        value = float(loss.numpy()[0])
        tape.zero()
        return 1e6 * value, np.array([1e6 * slope])

    found = minimize(evaluate, np.log([1.4]), jac=True, method="L-BFGS-B")
    assert np.exp(found.x[0]) == pytest.approx(1.0, rel=1e-4)


def test_what_a_reset_undoes_has_no_gradients():
    """Steps before a reset on the tape change nothing after it."""
    builder = make()
    cable(builder, start="clamped")
    model = builder.finalize(device=DEVICE, requires_grad=True)
    target = wp.clone(model.der.node_q, requires_grad=False)
    loss = wp.zeros(1, dtype=f64, device=DEVICE, requires_grad=True)
    found = []
    for before in (2, 0):
        solver, state, tape = SolverDER(model, tolerance=1e-10), model.state(), wp.Tape()
        with tape:
            for k in range(before + 3):
                if k == before > 0:
                    solver.reset(state)
                solver.step(state, state, None, None, 0.01)
            inputs = [state.der.node_q, target]
            wp.launch(squared_distance, len(target), inputs, [loss], device=DEVICE)
        tape.backward(loss)
        found.append(model.der.node_bending_stiffness.grad.numpy().copy())
        tape.zero()
    assert np.abs(found[0]).max() > 1e-3
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9, atol=1e-12)


def test_gradients_of_states_on_the_way_are_kept_if_asked():
    """They are what a tape says that begins there, but for the step before, which is given."""
    builder = make()
    cable(builder)
    model = builder.finalize(device=DEVICE, requires_grad=True)
    target = wp.zeros_like(model.der.node_q, requires_grad=False)
    loss = wp.zeros(1, dtype=f64, device=DEVICE, requires_grad=True)
    solver = SolverDER(model, scheme="euler", tolerance=1e-10)
    states, found = [model.state() for _ in range(4)], []
    for first in (0, 1):
        states[1].der.node_q.retain_grad = first == 0
        tape = wp.Tape()
        with tape:
            for k in range(first, 3):
                solver.step(states[k], states[k + 1], None, None, 0.01)
            inputs = [states[3].der.node_q, target]
            wp.launch(squared_distance, len(target), inputs, [loss], device=DEVICE)
        tape.backward(loss)
        found.append(states[1].der.node_q.grad.numpy().copy())
        assert not states[2].der.node_q.grad.numpy().any()
        tape.zero()
    assert np.abs(found[0]).max() > 0.1
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9, atol=1e-12)
