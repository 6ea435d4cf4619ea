"""Which knot a rod is tied in: diagrams of curves in space, and how open rods are closed.

A curve is projected along a direction; crossings of the projection, with what passes over and what
under, make a diagram, and its polynomials (`wrod.knots.polynomials`) do not depend on how the curve
lies. They are exact: integers throughout. The Jones polynomial names the knot, since the Alexander
polynomial confuses the two hands of a trefoil, and a reef knot with a granny.
"""

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.errors import RodError
from wrod.knots.polynomials import KNOWN, Visits, jones, polynomial_text

# Closing points lie this many times the rods' extent away.
_FAR = 20.0
_CLOSURES = 15  # of open rods, each in a random direction
# A crossing this close to a vertex (fraction of the segment) is looked at from elsewhere.
_GENERIC = 1e-9
_ATTEMPTS = 20


@dataclass(frozen=True)
class Diagram:
    """Crossings of closed curves seen along a direction.

    Attributes:
        visits: for each curve, the (crossing, over) pairs that it meets, in its own order.
        sign: (crossing,) +1 right-handed, -1 left-handed.
        curves: (crossing, 2) the curves that pass over and under.
    """

    visits: Visits
    sign: np.ndarray
    curves: np.ndarray

    def linking_number(self) -> int:
        """Half the signed crossings between the first two curves (Gauss linking number)."""
        between = (self.curves == [0, 1]).all(1) | (self.curves == [1, 0]).all(1)
        return int(self.sign[between].sum()) // 2

    def jones_polynomial(self) -> dict[float, int]:
        """{power of t: coefficient}; powers are halves for links of an even number of curves."""
        return jones(self.visits, self.sign)


@dataclass(frozen=True)
class Recognition:
    """What rods are tied in.

    Attributes:
        name: "unknot", "right trefoil", "reef knot", ...; a knot that has no name here is called
            by its Jones polynomial.
        share: fraction of the random closures that gave this name [-].
        counts: {name: number of closures}.
    """

    name: str
    share: float
    counts: dict[str, int]

    def share_of(self, name: str) -> float:
        """Fraction of the closures that show this knot [-]."""
        return self.counts.get(name, 0) / sum(self.counts.values())


def diagram(curves: list[np.ndarray] | np.ndarray, seed: int = 0) -> Diagram:
    """Diagram of closed curves, seen along a random direction.

    Args:
        curves: closed polygons (n, 3), the last vertex joined to the first; or one of them.
        seed: of the direction. Another is taken where a crossing falls on a vertex.

    Raises:
        RodError: a curve is not a polygon of three or more finite points, or curves touch.
    """
    if isinstance(curves, np.ndarray) and curves.ndim == 2:
        curves = [curves]
    polygons = [_checked(curve) for curve in curves]
    for attempt in range(_ATTEMPTS):
        turn = Rotation.random(rng=np.random.default_rng([seed, attempt]))
        found = _crossings([turn.apply(polygon) for polygon in polygons])
        if found is not None:
            return found
    raise RodError("curves touch each other: no projection has clean crossings; move them apart")


def name_of(curves: list[np.ndarray] | np.ndarray, seed: int = 0) -> str:
    """Name of a knot or link of closed curves (arguments as those of `diagram`)."""
    powers = diagram(curves, seed).jones_polynomial()
    return KNOWN.get(frozenset(powers.items()), f"Jones {polynomial_text(powers)}")


def recognise_knot(rod: np.ndarray) -> Recognition:
    """Knot of one open rod: its ends are joined far away, in random directions, and the most
    frequent knot counts.

    Args:
        rod: (node, 3) centreline.

    Raises:
        RodError: the rod is not a line of three or more finite points, or touches itself.
    """
    rod = _checked(rod)
    centre, reach = _extent([rod])
    far = centre + _FAR * reach * _directions(_CLOSURES)
    return _majority([name_of(np.vstack([rod, point]), k) for k, point in enumerate(far)])


def recognise_pair(first: np.ndarray, second: np.ndarray) -> Recognition:
    """Knot that joins two open rods: the first end of one is joined far away to the first end of
    the other, the last to the last.

    That closes a reef knot to the composite of a right and a left trefoil, a granny to that of two
    trefoils of one hand, and rods that are not tied to each other to an unknot. (Each rod closed by
    itself would not do: a reef knot, which two rubber bands make as well, is then not linked.)

    Args:
        first, second: (node, 3) centrelines, both beginning with the standing end.

    Raises:
        RodError: as for `recognise_knot`.
    """
    first, second = _checked(first), _checked(second)
    centre, reach = _extent([first, second])
    far = centre + _FAR * reach * _directions(2 * _CLOSURES).reshape(_CLOSURES, 2, 3)
    return _majority(
        [
            name_of(np.vstack([first, last, second[::-1], begin]), k)
            for k, (begin, last) in enumerate(far)
        ]
    )


def _checked(curve: np.ndarray) -> np.ndarray:
    points = np.asarray(curve, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 3:
        raise RodError(f"a curve is an array of {points.shape}; give (n, 3) points, n >= 3")
    if not np.isfinite(points).all():
        raise RodError(f"point {int(np.argmax(~np.isfinite(points).all(1)))} is not finite")
    return points


def _extent(rods: list[np.ndarray]) -> tuple[np.ndarray, float]:
    points = np.vstack(rods)
    centre = (points.min(0) + points.max(0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def _directions(count: int) -> np.ndarray:
    raw = np.random.default_rng(0).standard_normal((count, 3))
    return raw / np.linalg.norm(raw, axis=1)[:, None]


def _majority(names: list[str]) -> Recognition:
    counts = Counter(names)
    name, most = counts.most_common(1)[0]
    return Recognition(name, most / len(names), dict(counts))


def _crossings(polygons: list[np.ndarray]) -> Diagram | None:
    """Crossings as seen along z from above; None if one is too close to a vertex."""
    owner = np.concatenate([np.full(len(p), k) for k, p in enumerate(polygons)])
    index = np.concatenate([np.arange(len(p)) for p in polygons])
    start = np.vstack(polygons)
    along = np.vstack([np.roll(p, -1, axis=0) - p for p in polygons])
    size = np.array([len(p) for p in polygons])[owner]
    # Boxes of the segments, so that few pairs are looked at closely.
    low = np.minimum(start, start + along)[:, :2].T
    high = np.maximum(start, start + along)[:, :2].T
    apart = [below[:, None] > above for below, above in zip(low, high, strict=True)]
    i, j = np.nonzero(np.triu(~(apart[0] | apart[0].T | apart[1] | apart[1].T), 1))
    step = np.abs(index[i] - index[j])
    neighbours = (owner[i] == owner[j]) & ((step == 1) | (step == size[i] - 1))
    i, j = i[~neighbours], j[~neighbours]
    gap = start[j] - start[i]
    area = _cross(along[i], along[j])
    parallel = area == 0.0
    safe = np.where(parallel, 1.0, area)
    a = np.where(parallel, -1.0, _cross(gap, along[j]) / safe)
    b = np.where(parallel, -1.0, _cross(gap, along[i]) / safe)
    touching = (a > -_GENERIC) & (a < 1 + _GENERIC) & (b > -_GENERIC) & (b < 1 + _GENERIC)
    inside = (a > _GENERIC) & (a < 1 - _GENERIC) & (b > _GENERIC) & (b < 1 - _GENERIC)
    if (touching & ~inside).any():
        return None
    i, j, a, b, area = i[inside], j[inside], a[inside], b[inside], area[inside]
    height = start[i, 2] + a * along[i, 2] - start[j, 2] - b * along[j, 2]
    if (height == 0.0).any():
        return None
    above = height > 0.0
    sign = np.where(above, 1, -1) * np.sign(area).astype(int)
    pairs = np.where(above[:, None], np.c_[owner[i], owner[j]], np.c_[owner[j], owner[i]])
    visits: list[list] = [[] for _ in polygons]
    for k in range(len(i)):
        visits[owner[i[k]]].append((index[i[k]] + a[k], k, bool(above[k])))
        visits[owner[j[k]]].append((index[j[k]] + b[k], k, not above[k]))
    ordered = []
    for curve in visits:
        curve.sort()
        if any(one[0] == other[0] for one, other in pairwise(curve)):
            return None
        ordered.append(tuple((k, over) for _, k, over in curve))
    return Diagram(tuple(ordered), sign, np.reshape(pairs, (-1, 2)))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
