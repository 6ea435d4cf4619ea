"""Meshes with hollows for tests."""

import numpy as np


def ground_mesh(height, n=25, size=0.3):
    """Vertices and triangles of a surface, of so many points a side, over (-size, size)^2."""
    x = np.linspace(-size, size, n)
    a, b = np.meshgrid(x, x, indexing="ij")
    vertices = np.stack([a, b, height(a, b)], axis=-1).reshape(-1, 3)
    i = np.arange(n * n).reshape(n, n)
    p, q, r, s = (i[u, v].ravel() for u in (np.s_[:-1], np.s_[1:]) for v in (np.s_[:-1], np.s_[1:]))
    return vertices, np.concatenate([np.column_stack([p, r, s]), np.column_stack([p, s, q])])
