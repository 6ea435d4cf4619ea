"""Two rods bent into loops that lie through each other: reef knot, granny, and no knot.

Each rod comes from its own side, turns round in a loop, and goes back; flat, the loops cross six
times, and over and under decide what it is.
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from wrod.patterns.curve import arc_length
from wrod.rods.material import RodMaterial

# Whether the first rod passes over (+1) at its crossings, one after the other.
BENDS = {
    "reef knot": (1, -1, 1, 1, -1, 1),
    "right granny knot": (1, -1, 1, -1, 1, -1),
    "unknot": (1, 1, 1, 1, 1, 1),
}
_FINE = 6000


def bend(name: str, rods: list[RodMaterial], loop: float = 0.045, leg: float = 0.30):
    """Centrelines of two rods that lie on a table, the upper ones lifted over the lower.

    Args:
        name: of `BENDS`.
        rods: the two.
        loop: radius of the loops [m].
        leg: length of each leg [m].

    Returns:
        Lines, (node, 3) each [m], and rest arc lengths (node,); edges are as long as thick.
    """
    flat, s = _loop(loop, 0.4 * loop, 0.6 * loop, leg)
    other = flat * [-1.0, 1.0]
    first, second = np.array(_crossings(flat, other)).T
    thick = sum(rod.radius for rod in rods)
    lines, arcs = [], []
    over = np.array(BENDS[name])
    for rod, plane, at, upper in (
        (rods[0], flat, first, over > 0),
        (rods[1], other, second, over < 0),
    ):
        away = (s[:, None] - s[at[upper]]) / (3.0 * thick)
        lift = 1.3 * thick * np.exp(-(away**4)).max(axis=1, initial=0.0)
        line = np.column_stack([plane, rod.radius + lift])
        arc = arc_length(line)
        even = np.linspace(0.0, arc[-1], int(np.ceil(arc[-1] / (2.0 * rod.radius))) + 1)
        lines.append(np.column_stack([np.interp(even, arc, c) for c in line.T]))
        arcs.append(arc_length(lines[-1]))
    return lines, arcs


def _loop(radius: float, half_gap: float, centre: float, leg: float):
    """(_FINE, 2) from the left at y = half_gap round a circle at (centre, 0), and back; and the
    arc length (_FINE,)."""
    phi = np.arcsin(half_gap / radius)
    neck = centre - radius * np.cos(phi)
    x = np.linspace(neck - leg, neck, 2000)
    t = np.linspace(np.pi - phi, phi - np.pi, 4000)[1:-1]
    outline = np.concatenate(
        [
            np.column_stack([x, np.full_like(x, half_gap)]),
            np.column_stack([centre + radius * np.cos(t), radius * np.sin(t)]),
            np.column_stack([x[::-1], np.full_like(x, -half_gap)]),
        ]
    )
    arc = arc_length(outline)
    even = np.linspace(0.0, arc[-1], _FINE)
    line = np.column_stack([np.interp(even, arc, c) for c in outline.T])
    # The neck's corners are rounded.
    return gaussian_filter1d(line, 0.25 * radius / even[1], axis=0, mode="nearest"), even


def _crossings(one: np.ndarray, other: np.ndarray) -> list[tuple[int, int]]:
    """Segments of two plane polylines that cross, in the order of the first."""
    d, along = np.diff(one, axis=0), np.diff(other, axis=0)
    # Segments that cross are no farther apart, from middle to middle, than half of both.
    reach = 0.5 * sum(np.linalg.norm(steps, axis=1).max() for steps in (d, along))
    middles = cKDTree(one[:-1] + 0.5 * d), cKDTree(other[:-1] + 0.5 * along)
    near = enumerate(middles[0].query_ball_tree(middles[1], 1.001 * reach))
    i, j = np.array([(i, j) for i, own in near for j in sorted(own)], dtype=int).reshape(-1, 2).T
    gap, d, along = (other[j] - one[i]).T, d[i].T, along[j].T
    area = d[0] * along[1] - d[1] * along[0]
    area = np.where(area == 0.0, np.nan, area)
    a = (gap[0] * along[1] - gap[1] * along[0]) / area
    b = (gap[0] * d[1] - gap[1] * d[0]) / area
    cross = (a >= 0) & (a < 1) & (b >= 0) & (b < 1)
    return list(zip(i[cross].tolist(), j[cross].tolist(), strict=True))
