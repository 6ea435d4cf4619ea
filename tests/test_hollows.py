"""Meshes with hollows: the gap of edges and its derivatives, rods in folds and bowls."""

import newton
import numpy as np
import pytest
import warp as wp
from chosen import DEVICE
from hollows import ground_mesh
from wrod.kernels.contact.gap import Gap, edge_gap
from wrod.kernels.contact.shapes import Shape

import wrod
from wrod.solvers import solids

SolverDER = wrod.SolverDER

RADIUS = 0.005


@wp.kernel
def measure(
    shape: Shape, x: wp.array(dtype=wp.vec3d), size: wp.array(dtype=wp.vec2d),
    out: wp.array(dtype=Gap),
):  # fmt: skip
    i = wp.tid()
    q = x[2 * i]
    out[i] = edge_gap(shape, q, x[2 * i + 1] - q, size[i][0], size[i][1])


def gaps(mesh, ends, c=1e-4, radius=RADIUS):
    """Of edges (edge, 2, 3)."""
    n = len(ends)
    x = wp.array(ends.reshape(-1, 3), dtype=wp.vec3d, device="cpu")
    size = np.broadcast_to(np.column_stack(np.broadcast_arrays(c, radius)), (n, 2))
    size = wp.array(np.ascontiguousarray(size), dtype=wp.vec2d, device="cpu")
    out = wp.zeros(n, dtype=Gap, device="cpu")
    inputs = [solids.shape_record(mesh), x, size]
    wp.launch(measure, n, inputs=inputs, outputs=[out], device="cpu")
    return out.numpy()


def waves(x, y):
    return 0.02 * np.sin(20 * x) * np.cos(15 * y)


def edges_over(generator, n, height=waves, length=0.02):
    """Random edges that touch, or nearly."""
    ends = np.empty((n, 2, 3))
    ends[:, 0, :2] = generator.uniform(-0.2, 0.2, (n, 2))
    angle = generator.uniform(0, 2 * np.pi, n)
    ends[:, 1, :2] = ends[:, 0, :2] + length * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ends[..., 2] = height(ends[..., 0], ends[..., 1]) + generator.uniform(0.8, 1.1, (n, 2)) * RADIUS
    return ends


def test_derivatives_of_the_gap():
    """Gradients of distance and s, and second derivatives, by differences of the distance, of its
    gradient and of s; a few reach over the border of a triangle, where they jump."""
    mesh = solids.Mesh(
        *ground_mesh(waves), center=(0.01, 0.0, 0.02), rotation=(0.02, 0.1, -0.05, 0.99)
    )
    turn = mesh._mesh.points.numpy().reshape(-1, 3)
    assert len(turn) == 625
    rotation = wp.quat_to_matrix(solids.shape_record(mesh).rotation)
    rotation = np.array(rotation).reshape(3, 3)
    ends = edges_over(np.random.default_rng(3), 400) @ rotation.T + np.array(mesh.center)
    c, radius, h = 1e-4, RADIUS, 1e-8
    here = gaps(mesh, ends)
    touch = here["distance"] < RADIUS
    assert touch.sum() > 150
    size = np.linalg.norm(here["head"] + here["tail"], axis=1)
    folds = touch & (size < 0.9999)
    assert folds.sum() > 20  # of folds, where normals differ
    off = {}

    def note(name, found, expected, scale):
        error = np.abs(found - expected)[touch] / scale
        off.setdefault(name, []).append(error.reshape(touch.sum(), -1).max(axis=1))

    for a in range(6):
        shift = np.zeros((2, 3))
        shift[a // 3, a % 3] = h
        up, down = gaps(mesh, ends + shift), gaps(mesh, ends - shift)
        by = {n: (up[n] - down[n]) / (2 * h) for n in ("distance", "head", "tail", "s")}
        side, k = ("head", "tail")[a // 3], a % 3
        note("slope", by["distance"], here[side][:, k], 1.0)
        note("s", by["s"], here[f"s_by_{side}"][:, k], 1e3)
        mixed = here["mixed"]
        bend = (here["by_head"][:, :, k], mixed[:, :, k]) if a < 3 else (mixed[:, k], None)
        note("bend", by["head"], bend[0], 1e3)
        note("bend", by["tail"], bend[1] if a < 3 else here["by_tail"][:, :, k], 1e3)
    for name, up, down in (
        ("by_rounding", gaps(mesh, ends, c + h), gaps(mesh, ends, c - h)),
        ("by_radius", gaps(mesh, ends, c, radius + h), gaps(mesh, ends, c, radius - h)),
    ):
        for part in ("distance", "head", "tail", "s"):
            found = (up[part] - down[part]) / (2 * h)
            note(name, found, here[name][part], 1.0 if part == "distance" else 1e3)
    for name, errors in off.items():
        assert np.quantile(np.max(errors, axis=0), 0.9) < 1e-5, name


def test_flat_parts_of_a_hollow_mesh_are_planes():
    """The gap of edges on a floor of many triangles before a wall is that of a plane, wherever
    the edges lie on them; half a triangle from the wall, and over a ridge, as well."""
    mesh = solids.Mesh(*ground_mesh(lambda x, y: np.where(x > 0.25, 0.1, 0.0)))
    assert mesh._hollow
    generator = np.random.default_rng(5)
    ends = edges_over(generator, 300, lambda x, y: 0.0 * x)
    found = gaps(mesh, ends)
    slope = ends[:, 1, 2] - ends[:, 0, 2]
    s = np.clip(0.5 - slope / 1e-4, 0.0, 1.0)
    expected = ends[:, 0, 2] + s * slope + 0.5e-4 * (s - 0.5) ** 2
    near = expected < 1.2 * RADIUS
    assert near.sum() > 200
    assert found["distance"][near] == pytest.approx(expected[near], abs=1e-12)
    assert found["s"][near] == pytest.approx(s[near], abs=1e-8)
    assert found["normal"][near] == pytest.approx(
        np.array([[0.0, 0.0, 1.0]] * near.sum()), abs=1e-9
    )


def lay(height, points, mu, gravity=(0.0, 0.0, -9.81), n=3, **options):
    """A stiff rod over a mesh, its solver and state."""
    builder = newton.ModelBuilder(gravity=gravity)
    SolverDER.register_custom_attributes(builder)
    vertices, triangles = ground_mesh(height, n)
    cfg = newton.ModelBuilder.ShapeConfig(mu=mu)
    builder.add_shape_mesh(-1, mesh=newton.Mesh(vertices, triangles.ravel()), cfg=cfg)
    material = wrod.RodMaterial(radius=RADIUS, gravito_bending_length=0.5, length=1.0)
    SolverDER.add_rod(builder, points, material, **options)
    model = builder.finalize(device=DEVICE)
    return SolverDER(model), model.state()


SIDES = 0.5  # slope of a gutter's


@pytest.mark.parametrize("part", [0.95, 1.05])
def test_a_gutter_holds_by_both_sides(part):
    """A rod in a gutter along x lies on both sides, each of which bears W / (2 cos), and slides
    along it where the slope is steeper than mu / cos, by what is left of its weight."""
    mu, cos = 0.3, 1.0 / np.hypot(1.0, SIDES)
    slope = np.arctan(part * mu / cos)
    gravity = 9.81 * np.array([np.sin(slope), 0.0, -np.cos(slope)])
    line = np.linspace((-0.1, 0.0, RADIUS / cos), (0.1, 0.0, RADIUS / cos), 11)
    solver, state = lay(lambda x, y: SIDES * np.abs(y), line, mu, tuple(gravity))
    for _ in range(20):
        solver.step(state, state, None, None, 0.005)
    assert not solver.diverged.any()
    start = state.der.node_qd.numpy().copy()
    for _ in range(20):
        solver.step(state, state, None, None, 0.005)
    z, v = state.der.node_q.numpy()[:, 2], state.der.node_qd.numpy()
    assert z * cos == pytest.approx(RADIUS, abs=0.03 * RADIUS)
    expected = 9.81 * max(0.0, np.sin(slope) - mu * np.cos(slope) / cos)
    assert (v - start)[:, 0] / 0.1 == pytest.approx(expected, abs=0.003 * 9.81)
    assert np.abs(v[:, 1:]).max() < 1e-4


def test_a_rod_across_a_bowl_touches_with_both_ends():
    """It hangs between them, as far from the middle of the sphere as its radius says."""
    ball, half = 0.3, 0.08
    depth = np.sqrt((ball - RADIUS) ** 2 - half**2)
    line = np.linspace((-half, 0.0, ball - depth), (half, 0.0, ball - depth), 6)
    solver, state = lay(
        lambda x, y: ball - np.sqrt(np.maximum(ball**2 - x**2 - y**2, 0.0)), line, 0.3, n=121,
        internal_damping=0.05, air_damping=5.0,
    )  # fmt: skip
    for _ in range(60):
        solver.step(state, state, None, None, 1 / 60)
    assert not solver.diverged.any()
    q, v = state.der.node_q.numpy(), state.der.node_qd.numpy()
    assert np.abs(v).max() < 1e-3
    far = np.linalg.norm(q - [0.0, 0.0, ball], axis=1)
    assert ball - far[[0, -1]] == pytest.approx(RADIUS, abs=0.05 * RADIUS)
    assert (ball - far[1:-1] > 1.2 * RADIUS).all()
    pushed = state.der.node_contact_f.numpy()
    assert np.abs(pushed[1:-1]).max() < 1e-9 * pushed[0, 2]
    weight = 9.81 * solver.model.der.node_mass.numpy().sum()
    assert pushed[:, 2].sum() == pytest.approx(weight, rel=1e-3)


@pytest.mark.parametrize("mu", [0.4, 0.0])
def test_rods_come_to_rest_on_waves(mu):
    """Rods that are dropped, bent, and slide over waves, or off their rim, are never cut out."""
    angle = np.linspace(0.0, 1.5, 16)
    for turn in (0.0, 1.0, 2.0):
        line = 0.1 * np.stack([np.cos(angle + turn), np.sin(angle + turn), 0 * angle + 0.4], axis=1)
        velocity = np.tile([1.0, -0.5, -0.5], (16, 1))
        solver, state = lay(waves, line, mu, n=12, velocity=velocity, internal_damping=0.02)
        for _ in range(30):
            solver.step(state, state, None, None, 1 / 60)
        assert not solver.diverged.any()
        q = state.der.node_q.numpy()
        on_it = np.abs(q[:, :2]).max(axis=1) < 0.3
        assert (q[on_it, 2] > waves(*q[on_it, :2].T) - 0.01).all()  # which is of coarse triangles


def test_a_bowl_that_falls_on_a_rod_keeps_the_momentum_of_both():
    """A free body with a hollow meets a free rod, with friction and no gravity: momentum is that of
    before within what a state's floats can hold, angular momentum to second order in the step."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    SolverDER.register_custom_attributes(builder)
    vertices, triangles = ground_mesh(lambda x, y: 0.7 * np.hypot(x, y), 9, 0.05)
    cup = builder.add_body(
        xform=wp.transform((0.0, 0.0, -0.02), wp.quat_rpy(0.1, 0.2, 0.0)), mass=0.02,
        inertia=wp.mat33(1e-5 * np.eye(3)),
    )  # fmt: skip
    cfg = newton.ModelBuilder.ShapeConfig(mu=0.5, density=0.0)
    builder.add_shape_mesh(cup, mesh=newton.Mesh(vertices, triangles.ravel()), cfg=cfg)
    material = wrod.RodMaterial(radius=RADIUS, gravito_bending_length=0.1, length=1.0)
    SolverDER.add_rod(builder, np.linspace((-0.1, 0.01, 0.03), (0.1, 0.0, 0.03), 17), material)
    model = builder.finalize(device=DEVICE)
    solver, state = SolverDER(model, bodies=[cup]), model.state()
    speed = state.body_qd.numpy()
    speed[cup] = [0.1, 0.0, 0.5, 0.0, 1.0, 0.5]
    state.body_qd.assign(speed)
    contacts = newton.CollisionPipeline(model).contacts()
    mass, inertia = 0.02, 1e-5

    def momenta():
        q, v = state.der.node_q.numpy(), state.der.node_qd.numpy()
        m = model.der.node_mass.numpy()[:, None]
        pose, way = (
            state.body_q.numpy()[cup].astype(float),
            state.body_qd.numpy()[cup].astype(float),
        )
        linear = (m * v).sum(axis=0) + mass * way[:3]
        angular = np.cross(q, m * v).sum(axis=0)
        return linear, angular + mass * np.cross(pose[:3], way[:3]) + inertia * way[3:]

    linear, angular = momenta()
    pushed = 0.0
    for _ in range(240):
        solver.step(state, state, None, contacts, 0.0005)
        pushed = max(pushed, np.abs(state.der.node_contact_f.numpy()).max())
    assert pushed > 0.05 and not solver.diverged.any()
    now = momenta()
    assert now[0] == pytest.approx(linear, abs=1e-8)
    assert now[1] == pytest.approx(angular, abs=5e-8)
