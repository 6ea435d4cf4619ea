"""The course of two arms: runs of work as filmed, and between them ways that keep clear."""

from __future__ import annotations

from itertools import product

import numpy as np

from wrod.errors import RobotError
from wrod.robot.arm import ARM_ROOM, Arm, HoldPath, gap_between
from wrod.robot.holds import HandFilm
from wrod.robot.transfer import Way, find_way

_CHECK = 0.05  # [s] between the points at which both arms are compared
_PAUSE = 0.2  # [s]


class Course:
    """Puts the frames of a scene together.

    Args:
        film: of the hands.
        arms: both.
        paths: their joint paths over all holds.
        waiting: joint positions (n,) where each arm waits [rad].
    """

    def __init__(self, film: HandFilm, arms: list[Arm], paths: list[HoldPath], waiting):
        self.film, self.arms, self.paths, self.waiting = film, arms, paths, waiting
        self.interval = float(np.median(np.diff(film.time)))
        self._time: list[float] = []
        self._frame: list[int] = []
        self._positions: list[list[np.ndarray]] = []

    def run(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times (F,) [s], frames of the film (F,) and joint positions (arm, F, n) [rad]."""
        time, count = self.film.time, len(self.film.time)
        patterns = self.film.closed @ [1, 2]
        edges = np.flatnonzero(np.diff(patterns)) + 1
        runs = [
            (int(first), int(stop) - 1)
            for first, stop in zip(np.r_[0, edges], np.r_[edges, count], strict=True)
            if patterns[first]
        ]
        clock, before = 0.0, None
        for first, last in runs:
            clock = self._between(before, first, clock)
            for frame in range(first, last + 1):
                self._add(clock + time[frame] - time[first], frame, self._at(frame))
            clock += float(time[last] - time[first])
            before = last
        if before is None or before < count - 1:
            self._between(before, None, clock)
        return np.array(self._time), np.array(self._frame), np.stack(self._positions, axis=1)

    def _add(self, time: float, frame: int, both) -> None:
        self._time.append(float(time))
        self._frame.append(int(frame))
        self._positions.append(np.stack(both))

    def _work(self, hand: int, frame: int | None) -> HoldPath | None:
        """What a hand is at in a frame."""
        for path in self.paths:
            hold = path.hold
            if frame is not None and hold.hand == hand and hold.first <= frame <= hold.last:
                return path
        return None

    def _at(self, frame: int | None) -> list[np.ndarray]:
        """Joint positions of both arms; one whose hand is not at work waits."""
        work = [self._work(hand, frame) for hand in range(2)]
        return [
            wait if path is None else path.positions[frame - path.hold.first]
            for path, wait in zip(work, self.waiting, strict=True)
        ]

    def _between(self, before: int | None, after: int | None, clock: float) -> float:
        """Add what lies between two runs; returns when the second begins [s]."""
        time, last = self.film.time, len(self.film.time) - 1
        if before is None and after == 0:
            return clock
        begin = 0 if before is None else before
        span = float(time[last if after is None else after] - time[begin])
        if before is None:
            self._add(clock, 0, self._at(None))
        motion, need = self._motion(before, after)
        whole = max(span, need)
        count = max(1, int(np.ceil(whole / self.interval - 1e-6)))
        steps = whole * np.arange(1, count + (after is None)) / count
        frames = np.searchsorted(time, time[begin] + steps + 1e-9, side="right") - 1
        frames = np.clip(frames, begin, last if after is None else max(after - 1, begin))
        for step, frame, *both in zip(steps, frames, *motion(steps), strict=True):
            self._add(clock + step, frame, both)
        return clock + whole

    def _motion(self, before: int | None, after: int | None):
        """Joint positions of both arms over seconds (k,), and how long they take [s].

        Raises:
            RobotError: an arm finds no way, or no order of their ways keeps the arms apart.
        """
        begin, end = self._at(before), self._at(after)
        options = []
        for hand, arm in enumerate(self.arms):
            at, to = self._work(hand, before), self._work(hand, after)
            if (at is None and to is None) or (at is to):
                options.append([None])
                continue
            stops = [None, self.waiting[hand]] if at is not None and to is not None else [None]
            ways = [
                find_way(
                    arm, begin[hand], end[hand],
                    leave=at is not None, arrive=to is not None, wait=stop,
                )
                for stop in stops
            ]  # fmt: skip
            options.append([way for way in ways if way is not None])
            if not options[-1]:
                raise RobotError(
                    f"arm {hand} finds no way from frame {before} to frame {after} of the film; "
                    "give the arms other places"
                )
        best: tuple[float, object] = (-np.inf, None)
        for need, ways, delays in _orders(options):

            def motion(t, ways=ways, delays=delays):
                return [
                    np.repeat(begin[k][None], len(t), axis=0) if way is None else way.at(t - delay)
                    for k, (way, delay) in enumerate(zip(ways, delays, strict=True))
                ]

            gap = self._gap(motion(np.arange(0.0, need + _CHECK, _CHECK)))
            if gap >= ARM_ROOM:
                return motion, need
            if gap > best[0]:
                best = gap, motion
        raise RobotError(
            f"the arms come within {1e3 * best[0]:.1f} mm of each other between frames {before} "
            f"and {after} of the film, whichever goes first; give them other places"
        )

    def _gap(self, both) -> float:
        one, other = (arm.capsules(q) for arm, q in zip(self.arms, both, strict=True))
        return float(gap_between(one, other).min())


def _orders(options: list[list[Way | None]]):
    """Ways of both arms, together or one after the other, the shortest first."""
    found = []
    for ways in product(*options):
        first, second = (0.0 if way is None else way.duration for way in ways)
        found.append((max(first, second), ways, (0.0, 0.0)))
        if first and second:
            found.append((first + second + _PAUSE, ways, (0.0, first + _PAUSE)))
            found.append((first + second + _PAUSE, ways, (second + _PAUSE, 0.0)))
    return sorted(found, key=lambda item: item[0])
