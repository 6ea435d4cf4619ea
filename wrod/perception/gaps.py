"""Gaps where a pen left the paper: ends of strokes that go on in each other are joined."""

from itertools import combinations

import numpy as np

from wrod.patterns.curve import arc_length
from wrod.perception.bridges import cubic
from wrod.perception.trace import Centerline

_LONGEST = 30.0  # gap, in half-widths of the stroke
_SHARE = 0.25  # of the shorter of the two strokes that a gap may be
_ASIDE = np.radians(35.0)  # most that either end may point past the other
_TANGENT = 8.0  # half-widths over which an end's direction is taken, at least ten pixels


def join_gaps(lines: list[Centerline]) -> tuple[list[Centerline], list[float]]:
    """Strokes joined wherever two ends go on in each other and neither has another choice.

    Returns:
        The strokes, longest first, and the lengths of the gaps that were bridged [px].
    """
    lines, gaps = list(lines), []
    while pair := _next(lines):
        i, i_last, j, j_last = pair
        first = lines[i] if i_last else _reversed(lines[i])
        second = _reversed(lines[j]) if j_last else lines[j]
        gaps.append(float(np.hypot(*(second.points[0] - first.points[-1]))))
        joined = _joined(first, second)
        lines = [line for k, line in enumerate(lines) if k not in (i, j)] + [joined]
    return sorted(lines, key=lambda line: -line.length), gaps


def _next(lines: list[Centerline]) -> tuple[int, bool, int, bool] | None:
    """Two ends that face each other and nothing else: (line, its last end?) twice."""
    ends = [(k, last) for k, line in enumerate(lines) if not line.closed for last in (False, True)]
    facing = [
        (a, b)
        for a, b in combinations(ends, 2)
        if a[0] != b[0] and _face(lines[a[0]], a[1], lines[b[0]], b[1])
    ]
    for a, b in facing:
        if sum(a in pair or b in pair for pair in facing) == 1:
            return (*a, *b)
    return None


def _face(first: Centerline, first_last: bool, second: Centerline, second_last: bool) -> bool:
    (p, u), (q, v) = _end(first, first_last), _end(second, second_last)
    gap = float(np.hypot(*(q - p)))
    longest = _LONGEST * min(first.radius, second.radius)
    if not 0.0 < gap <= min(longest, _SHARE * min(first.length, second.length)):
        return False
    chord = (q - p) / gap
    return bool(min(u @ chord, -(v @ chord)) > np.cos(_ASIDE))


def _end(line: Centerline, last: bool) -> tuple[np.ndarray, np.ndarray]:
    """Place (2,) and outward direction (2,) of an end."""
    points = line.points if last else line.points[::-1]
    back = arc_length(points[::-1])
    k = int(np.searchsorted(back, max(_TANGENT * line.radius, 10.0)))
    out = points[-1] - points[::-1][min(k, len(points) - 1)]
    return points[-1], out / max(float(np.hypot(*out)), 1e-12)


def _reversed(line: Centerline) -> Centerline:
    return Centerline(line.points[::-1], line.half_width[::-1])


def _joined(first: Centerline, second: Centerline) -> Centerline:
    """One stroke of two, with the cubic between them that leaves both along their directions."""
    (p, u), (q, v) = _end(first, True), _end(second, False)
    between = cubic(p, q, u, -v)
    width = np.linspace(first.half_width[-1], second.half_width[0], len(between) + 2)[1:-1]
    return Centerline(
        np.vstack([first.points, between, second.points]),
        np.concatenate([first.half_width, width, second.half_width]),
    )
