"""Meshes with hollows: the gap of edges and its derivatives, rods in folds and bowls."""

import numpy as np
import pytest
import warp as wp
from wrod.kernels.contact.gap import Gap, edge_gap
from wrod.kernels.contact.shapes import Shape

from wrod.solvers import solids

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


def ground(height, n=25, size=0.3):
    """A surface of triangles, of so many points a side, over (-size, size)^2."""
    x = np.linspace(-size, size, n)
    a, b = np.meshgrid(x, x, indexing="ij")
    vertices = np.stack([a, b, height(a, b)], axis=-1).reshape(-1, 3)
    i = np.arange(n * n).reshape(n, n)
    p, q, r, s = (i[u, v].ravel() for u in (np.s_[:-1], np.s_[1:]) for v in (np.s_[:-1], np.s_[1:]))
    return vertices, np.concatenate([np.column_stack([p, r, s]), np.column_stack([p, s, q])])


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
    mesh = solids.Mesh(*ground(waves), center=(0.01, 0.0, 0.02), rotation=(0.02, 0.1, -0.05, 0.99))
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
    mesh = solids.Mesh(*ground(lambda x, y: np.where(x > 0.25, 0.1, 0.0)))
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
