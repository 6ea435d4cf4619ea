"""The way of a grip that also goes back, to lay a stretch anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from wrod.deployment.corrections import Corrections
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import with_tail
from wrod.planning.trajectory import Trajectory, followed_by, part_of

# Over how long a way the grip turns round, and how far apart its new poses are [m].
_TURN, _SPACING = 0.01, 0.005


class GripWay:
    """Poses of a grip over the length that it has gone, forwards and back.

    Attributes:
        path: its poses; `arc_length` is the length gone [m], which exceeds the laid length by twice
            what was laid anew.
        laid: (T,) laid length at each pose [m].
    """

    def __init__(self, path: Trajectory, laid: np.ndarray | None = None):
        self.path, self.laid = path, path.arc_length if laid is None else laid

    def followed_by_tail(self, pattern: Pattern, length: float) -> GripWay:
        """The way, and so much of the tail after it [m], as far as there is one."""
        longer = with_tail(self.path, pattern)
        return self if longer is None else GripWay(longer).until(self.end + length + 1e-9)

    @property
    def end(self) -> float:
        """Length of the whole way [m]."""
        return float(self.path.arc_length[-1])

    def until(self, gone: float) -> GripWay:
        """Its beginning, up to that length [m]."""
        n = int(np.searchsorted(self.path.arc_length, gone, side="right"))
        return GripWay(part_of(self.path, slice(0, n)), self.laid[:n])

    def laid_at(self, gone: float) -> float:
        """Laid length [m] where so much of the way is gone."""
        return float(np.interp(gone, self.path.arc_length, self.laid))

    def corrections(
        self, pattern: Pattern, lgb: float, first: float, last: float, rise: float = 0.0
    ) -> Corrections:
        """Of the poses beyond `first`, the same for all beyond `last` [m of the way]."""
        return Corrections(pattern, self.path, lgb, first, self.laid, last, rise, straight=True)

    def back(self, gone: float, to: float) -> tuple[GripWay, float]:
        """From where `gone` [m] is gone back until `to` [m] is laid, and on from there as the way
        would have gone; and the length that is gone at the turn [m].

        The poses back are those that the grip had when it came forwards for the last time; it does
        not go back beyond where that began.
        """
        done = self.until(gone)
        n, start = len(done.laid), done.path.arc_length[-1]
        backwards = np.flatnonzero(np.diff(done.laid) <= 0.0)
        first = int(backwards[-1]) + 1 if len(backwards) else 0
        now, end = float(done.laid[-1]), float(self.laid[-1])
        to = min(max(to, float(self.laid[first])), now - 2.0 * _TURN)
        turn = now - to + _TURN
        whole = turn + end - to + 0.5 * _TURN
        x = np.linspace(0.0, whole, int(np.ceil(whole / _SPACING)) * 20 + 1)
        at = [0.0, _TURN, turn - _TURN, turn, turn + _TURN, whole]
        pace = np.interp(x, at, [0.0, -1.0, -1.0, 0.0, 1.0, 1.0])
        s = now + np.concatenate([[0.0], np.cumsum(0.5 * np.diff(x) * (pace[1:] + pace[:-1]))])
        x, s = x[20::20], s[20::20]
        s[-1] = end
        known = self.laid[first:]
        contact, position = (
            CubicSpline(known, points[first:])(s)
            for points in (self.path.contact, self.path.position)
        )
        rotation = RotationSpline(known, Rotation.from_matrix(self.path.rotation[first:]))(s)
        path = followed_by(
            replace(done.path, shape=None, twist=None),
            arc_length=start + x, contact=contact, position=position,
            rotation=rotation.as_matrix(), force=np.full_like(position, np.nan),
        )  # fmt: skip
        return GripWay(path, np.concatenate([self.laid[:n], s])), float(start + turn)
