"""Where rods are knotted."""

import numpy as np
from scipy.spatial import cKDTree

_TOUCH = 1.3  # rods nearer than so many times their thickness touch
_APART = 8.0  # of one rod, what is so many radii farther along
_ROOM = 0.03  # [m] about what touches


def knot_corners(rods: list[np.ndarray], radii: list[float]) -> np.ndarray | None:
    """(2, 3) corners of a box about what touches itself or another rod [m]; None if nothing does.

    Args:
        rods: (node, 3) of each [m].
        radii: [m].
    """
    radius = np.concatenate([np.full(len(rod), r) for rod, r in zip(rods, radii, strict=True)])
    which = np.concatenate([np.full(len(rod), k) for k, rod in enumerate(rods)])
    steps = [np.linalg.norm(np.diff(rod, axis=0), axis=1) for rod in rods]
    along = np.concatenate([np.concatenate([[0.0], np.cumsum(step)]) for step in steps])
    nodes = np.concatenate(rods)
    i, j = cKDTree(nodes).query_pairs(2.0 * _TOUCH * max(radii), output_type="ndarray").T
    thick = radius[i] + radius[j]
    near = np.linalg.norm(nodes[i] - nodes[j], axis=1) < _TOUCH * thick
    other = (which[i] != which[j]) | (np.abs(along[i] - along[j]) > _APART * radius[i])
    found = nodes[np.concatenate([i[near & other], j[near & other]])]
    if len(found) == 0:
        return None
    return np.stack([found.min(0) - _ROOM, found.max(0) + _ROOM])
