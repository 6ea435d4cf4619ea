"""Solids that rods touch: distances against brute force, derivatives, rods at rest on all."""

import newton
import numpy as np
import pytest
import warp as wp
from wrod.kernels.contact.solids import solid_surface

import wrod
from wrod.errors import RodError
from wrod.newton_solver.shapes import _ground
from wrod.solvers import solids

SolverDER = wrod.SolverDER
ROD = wrod.RodMaterial(radius=0.0016, gravito_bending_length=0.032, length=0.2)
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


@wp.kernel
def measure(
    kind: int, size: wp.vec3d, mesh: wp.uint64, point: wp.array(dtype=wp.vec3d),
    distance: wp.array(dtype=wp.float64), normal: wp.array(dtype=wp.vec3d),
    bend: wp.array(dtype=wp.mat33d),
):  # fmt: skip
    i = wp.tid()
    s = solid_surface(kind, size, mesh, point[i])
    distance[i] = s.distance
    normal[i] = s.normal
    bend[i] = s.bend


def surface(shape, points):
    kind, _, _, size = shape._describe()
    mesh = shape._mesh.id if isinstance(shape, solids.Mesh) else wp.uint64(0)
    n = len(points)
    out = [wp.zeros(n, dtype=t, device="cpu") for t in (wp.float64, wp.vec3d, wp.mat33d)]
    points = wp.array(points, dtype=wp.vec3d, device="cpu")
    inputs = [kind, wp.vec3d(*map(float, size)), mesh, points]
    wp.launch(measure, n, inputs=inputs, outputs=out, device="cpu")
    return [a.numpy() for a in out]


def octahedron():
    corner = np.concatenate([np.diag([0.5, 0.7, 0.9]), -np.diag([0.5, 0.7, 0.9])])
    faces = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    return solids.Mesh(corner, np.array(faces))


ORIGIN = (0.0, 0.0, 0.0)
SHAPES = [
    solids.Box(ORIGIN, (0.5, 0.7, 0.9)),
    solids.Cylinder(ORIGIN, 0.6, 0.8),
    solids.Sphere(ORIGIN, 0.7),
    solids.Capsule(ORIGIN, 0.4, 0.5),
    solids.Cone(ORIGIN, 0.6, 0.8),
    solids.Ellipsoid(ORIGIN, (0.5, 0.7, 0.9)),
    octahedron(),
]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_distance_normal_and_bend(shape):
    """The distance is 1-Lipschitz with slope 1; normal and bend are its derivatives by central
    differences; a step by the distance against the normal ends on the surface."""
    generator = np.random.default_rng(4)
    points = generator.normal(size=(400, 3))
    distance, normal, bend = surface(shape, points)
    near = (distance > 0.02) & (distance < 1.5)
    assert near.sum() > 150
    points, distance, normal, bend = points[near], distance[near], normal[near], bend[near]
    assert np.linalg.norm(normal, axis=1) == pytest.approx(1.0, abs=1e-9)
    on_surface = surface(shape, points - 0.999999 * distance[:, None] * normal)[0]
    assert np.abs(on_surface - 1e-6 * distance).max() < 1e-8
    h = 1e-5
    slope = np.empty_like(points)
    turn = np.empty_like(bend)
    for c in range(3):
        up, down = (surface(shape, points + s * h * np.eye(3)[c]) for s in (1.0, -1.0))
        slope[:, c] = (up[0] - down[0]) / (2 * h)
        turn[:, :, c] = (up[1] - down[1]) / (2 * h)
    # A few differences reach across the border of a face, where the bend jumps.
    assert np.quantile(np.abs(slope - normal).max(axis=1), 0.97) < 1e-6
    assert np.quantile(np.abs(turn - bend).max(axis=(1, 2)), 0.97) < 1e-5


def test_distance_of_an_ellipsoid_against_a_search():
    """The nearest of 400 000 points of the surface is as far, but for their spacing."""
    axes = np.array([0.5, 0.7, 0.9])
    u, v = np.meshgrid(np.linspace(0, np.pi, 500), np.linspace(0, 2 * np.pi, 800))
    ball = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], axis=2)
    on_it = axes * ball.reshape(-1, 3)
    points = np.random.default_rng(2).normal(size=(30, 3))
    points = points[(points**2 / axes**2).sum(axis=1) > 1.0]
    expected = [np.linalg.norm(on_it - p, axis=1).min() for p in points]
    assert surface(SHAPES[5], points)[0] == pytest.approx(np.array(expected), abs=1e-4)


def scenes():
    def at(z, turn=None):
        return wp.transform((0.0, 0.0, z), turn or wp.quat_identity())

    lying = wp.quat_from_axis_angle(wp.vec3(0, 1, 0), np.pi / 2)
    upside_down = wp.quat_from_axis_angle(wp.vec3(1, 0, 0), np.pi)
    triangles = np.array(solids_of_cube()).ravel()
    cube = newton.Mesh(0.05 * CUBE, triangles, compute_inertia=False)
    flat = newton.Heightfield(np.zeros((4, 4)), 4, 4, hx=0.2, hy=0.2)
    return {
        "sphere": lambda b: b.add_shape_sphere(-1, xform=at(-0.5), radius=0.5),
        "capsule": lambda b: b.add_shape_capsule(
            -1, xform=at(-0.05, lying), radius=0.05, half_height=0.2
        ),
        "cone": lambda b: b.add_shape_cone(
            -1, xform=at(-0.1, upside_down), radius=0.2, half_height=0.1
        ),
        "ellipsoid": lambda b: b.add_shape_ellipsoid(-1, xform=at(-0.1), rx=0.9, ry=0.5, rz=0.1),
        "mesh": lambda b: b.add_shape_mesh(-1, xform=at(-0.05), mesh=cube),
        "convex": lambda b: b.add_shape_convex_hull(-1, xform=at(-0.05), mesh=cube),
        "heightfield": lambda b: b.add_shape_heightfield(heightfield=flat, xform=at(0.0)),
    }


def solids_of_cube():
    """Triangles of CUBE, anticlockwise from outside."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(CUBE)
    out = []
    for corners, equation in zip(hull.simplices, hull.equations, strict=True):
        a, b, c = CUBE[corners]
        out.append(corners if np.cross(b - a, c - a) @ equation[:3] > 0 else corners[::-1])
    return out


@pytest.mark.parametrize("name", list(scenes()))
def test_a_rod_rests_on_every_shape_of_newton(name):
    """Where z = 0 is the top of the shape: it carries the weight, and no edge sinks in."""
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    builder.default_shape_cfg.mu = 0.8
    scenes()[name](builder)
    points = np.zeros((10, 3))
    points[:, 0] = np.linspace(-0.03, 0.03, 10)
    points[:, 2] = 1.05 * ROD.radius
    SolverDER.add_rod(builder, points, ROD, air_damping=20.0, internal_damping=0.02, visible=False)
    model = builder.finalize(device="cpu")
    solver, state = SolverDER(model, scheme="euler"), model.state()
    for _ in range(60):
        solver.step(state, state, None, None, 0.01)
    assert not solver.diverged.any()
    force = state.der.node_contact_f.numpy().sum(axis=0)
    assert force[2] == pytest.approx(ROD.weight * 0.06, rel=0.01)
    contact = solver._groups[0].contact
    assert contact.penetration()[0] < 0.02 * ROD.radius
    assert state.der.node_q.numpy()[4:6, 2] == pytest.approx(ROD.radius, abs=0.1 * ROD.radius)


def test_a_height_field_is_a_closed_surface():
    """Its volume, by the divergence theorem, is that of the ground beneath it."""
    data = np.random.default_rng(1).random((5, 6))
    field = newton.Heightfield(data, 5, 6, hx=1.0, hy=0.5, min_z=0.0, max_z=1.0)
    vertices, triangles = _ground(field, np.ones(3))
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0
    z = np.asarray(field.data)
    split = (2 * z[:-1, :-1] + z[:-1, 1:] + z[1:, :-1] + 2 * z[1:, 1:]) / 6.0
    assert volume == pytest.approx(2.0 * (0.5 + split.mean()), rel=1e-6)


def test_what_rods_do_to_bodies_that_they_touch():
    """A rod at rest on a body that others move presses on it with its weight, off its centre."""
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    tray = builder.add_body(is_kinematic=True, label="tray")
    at = wp.transform((0.1, 0.0, -0.02), wp.quat_identity())
    builder.add_shape_box(tray, xform=at, hx=0.2, hy=0.05, hz=0.02)
    points = np.zeros((10, 3))
    points[:, 0], points[:, 2] = np.linspace(0.2, 0.26, 10), ROD.radius
    SolverDER.add_rod(builder, points, ROD, air_damping=20.0, visible=False)
    model = builder.finalize(device="cpu")
    solver, state = SolverDER(model, scheme="euler"), model.state()
    for _ in range(40):
        solver.step(state, state, None, None, 0.01)
    weight = ROD.weight * 0.06
    wrench = solver.body_wrenches()[tray]
    assert wrench[2] == pytest.approx(-weight, rel=1e-3)
    lever = 0.23 - float(model.body_com.numpy()[tray, 0])
    assert wrench[4] == pytest.approx(weight * lever, rel=1e-3)
    state.clear_forces()
    solver.add_body_forces(state)
    assert state.body_f.numpy()[tray] == pytest.approx(wrench, rel=1e-5, abs=1e-9)


def test_refusals():
    with pytest.raises(RodError, match="sizes must be positive"):
        solids.shape_record(solids.Ellipsoid(ORIGIN, (1.0, 1.0, 0.0)))
    with pytest.raises(RodError, match="indices of its vertices"):
        solids.Mesh(CUBE, np.array([[0, 1, 9]]))
