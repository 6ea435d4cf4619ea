"""Fillets: tight bends of a curve replaced by arcs between the tangents beside them."""

import itertools

import numpy as np

_LARGEST_TURN = np.radians(170.0)  # of a fillet: the tangents of a hairpin meet far away


def fillets(
    s: np.ndarray, points: np.ndarray, heading: np.ndarray, curvature: np.ndarray, bound: float
) -> np.ndarray:
    """A curve whose bends beyond a bound are fillets: line, arc of radius 1 / bound, line.

    A bend is widened until the tangents at its ends are long enough for the arc. Where its
    neighbours leave no room, the arc is as wide as fits; a hairpin stays as it is. Between its
    bends the curve keeps its place.

    Args:
        s: (n,) arc length of the first curve, evenly spaced from 0 [m].
        points, heading, curvature: (n, 2) [m], (n,) [rad] and (n,) [1/m] of it at s.
        bound: largest amount of curvature [1/m].

    Returns:
        (m, 3) knots of the new curve, between which all three change evenly: its arc length [m],
        its heading there [rad], and the arc length of the first curve that belongs there [m].
    """
    runs = bends(curvature, bound)
    needs = [np.tan(min(abs(heading[b] - heading[a]), _LARGEST_TURN) / 2) for a, b in runs]
    # The leg between two bends is shared as their fillets need it.
    cuts = [0]
    for ((_, first), (last, _)), (one, other) in zip(
        itertools.pairwise(runs), itertools.pairwise(needs), strict=True
    ):
        total = one + other  # of turns back over themselves none needs anything
        cuts.append(
            first + (int((last - first) * one / total) if total > 0.0 else (last - first) // 2)
        )
    cuts.append(len(s) - 1)
    knots, at, shift = [], 0, 0.0
    for (a, b), low, high in zip(runs, cuts[:-1], cuts[1:], strict=True):
        widened = np.arange(max(a - low, high - b) + 1)
        i, j = np.maximum(a - widened, low), np.minimum(b + widened, high)
        found = _fillet(points, heading, i, j, 1.0 / bound)
        if found is None:
            continue
        first, last, radius, before, after = found
        if radius * np.abs(curvature[a : b + 1]).max() < 1.0:
            continue
        kept = slice(at, first + 1)
        knots.append(np.column_stack([s[kept] + shift, heading[kept], s[kept]]))
        ends = heading[[first, last]]
        middle = s[first + int(np.abs(heading[first : last + 1] - ends.mean()).argmin())]
        arc = radius * abs(ends[1] - ends[0])
        place = s[first] + shift + np.cumsum([before, arc / 2, arc / 2, after])
        partners = [
            min(s[first] + before, middle), middle, max(s[last] - after, middle), s[last]
        ]  # fmt: skip
        turned = [ends[0], ends.mean(), ends[1], ends[1]]
        knots.append(np.column_stack([place, turned, partners])[:-1])
        at, shift = last, place[-1] - s[last]
    knots.append(np.column_stack([s[at:] + shift, heading[at:], s[at:]]))
    return np.concatenate(knots)


def bends(curvature, bound) -> list[tuple[int, int]]:
    """First and last index of every run of curvature beyond the bound, of one sign."""
    beyond = np.where(np.abs(curvature) > bound, np.sign(curvature), 0.0)
    edges = np.flatnonzero(np.diff(beyond)) + 1
    runs = itertools.pairwise([0, *edges.tolist(), len(beyond)])
    return [(first, last - 1) for first, last in runs if beyond[first]]


def _fillet(points, heading, i, j, radius):
    """The narrowest fillet between the tangents at one of the pairs i, j of indices.

    Returns its ends' indices, its radius and the lengths of the lines before and after its arc;
    None where no two tangents meet.
    """
    turn = np.abs(heading[j] - heading[i])
    chord = points[j] - points[i]
    ahead, behind = (np.column_stack([np.cos(a), np.sin(a)]) for a in (heading[i], heading[j]))
    sine = ahead[:, 0] * behind[:, 1] - ahead[:, 1] * behind[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        before = (chord[:, 0] * behind[:, 1] - chord[:, 1] * behind[:, 0]) / sine
        after = (ahead[:, 0] * chord[:, 1] - ahead[:, 1] * chord[:, 0]) / sine
        fits = np.minimum(before, after) / np.tan(turn / 2)
    fits[~np.isfinite(fits) | (turn > _LARGEST_TURN) | (turn < 1e-3)] = 0.0
    if not (fits > 0.0).any():
        return None
    wide = fits >= radius
    k = int(wide.argmax()) if wide.any() else int(fits.argmax())
    radius = min(radius, float(fits[k]))
    used = radius * np.tan(turn[k] / 2)
    return int(i[k]), int(j[k]), radius, float(before[k] - used), float(after[k] - used)
