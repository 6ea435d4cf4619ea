"""The timeline of two arms: runs of work as filmed, and between them ways that keep clear."""

import numpy as np

from wrod.errors import RobotError
from wrod.robot.arm import ARM_ROOM, Arm, gap_between
from wrod.robot.transfer_path import TransferPath
from wrod.robot.transfers import HandFilm
from wrod.robot.transit import Transit, find_way

_CHECK = 0.05  # [s] between the points at which both arms are compared
_PAUSE = 0.2  # [s]


class ArmTimeline:
    """Puts the frames of a scene together.

    Args:
        film: of the hands.
        arms: both.
        paths: their joint paths over all transfers.
        waiting: joint positions (n,) where each arm waits [rad].
    """

    def __init__(self, film: HandFilm, arms: list[Arm], paths: list[TransferPath], waiting):
        self.film, self.arms, self.paths, self.waiting = film, arms, paths, waiting
        self.interval = float(np.median(np.diff(film.time)))
        self._time: list[float] = []
        self._frame: list[int] = []
        self._positions: list[np.ndarray] = []

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

    def _work(self, hand: int, frame: int | None) -> TransferPath | None:
        """What a hand is at in a frame."""
        for path in self.paths:
            one = path.transfer
            if frame is not None and one.hand == hand and one.first <= frame <= one.last:
                return path
        return None

    def _at(self, frame: int | None) -> list[np.ndarray]:
        """Joint positions of both arms; one whose hand is not at work waits."""
        work = [self._work(hand, frame) for hand in range(2)]
        return [
            wait if path is None else path.positions[frame - path.transfer.first]
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
        work = [(self._work(h, before), self._work(h, after)) for h in range(2)]
        moving = [h for h, (at, to) in enumerate(work) if at is not to]

        def find(hand: int, stops: str, other) -> Transit | None:
            """From the "rod" of the run before, or where the arm "waits", to either."""
            here = {"r": begin[hand], "w": self.waiting[hand]}[stops[0]]
            there = {"r": end[hand], "w": self.waiting[hand]}[stops[1]]
            at, to = work[hand]
            leave, arrive = stops[0] == "r" and at is not None, stops[1] == "r" and to is not None
            for wait in (None, self.waiting[hand]):
                way = find_way(
                    self.arms[hand], here, there,
                    leave=leave, arrive=arrive, wait=wait, other=other,
                )  # fmt: skip
                if way is not None:
                    return way
            return None

        together = [find(h, "rr", None) if h in moving else None for h in range(2)]
        plan = [(h, 0.0, way) for h, way in enumerate(together) if way is not None]
        if len(plan) == len(moving):
            need = max((way.duration for _, _, way in plan), default=0.0)
            if self._gap(_played(plan, begin, np.arange(0.0, need + _CHECK, _CHECK))) >= ARM_ROOM:
                return lambda t: _played(plan, begin, t), need
        # One after the other, each keeping clear of where the other stands.
        orders = [[(h, "rr") for h in order] for order in (moving, moving[::-1])]
        if len(moving) == 2:
            orders += [[(a, "rw"), (b, "rr"), (a, "wr")] for a, b in ((0, 1), (1, 0))]
        best: tuple[float, list] = (np.inf, [])
        for order in orders:
            if len(order) == 3 and best[1]:
                break  # no need to step aside
            found = self._one_by_one(order, begin, find)
            if found is not None:
                best = min(best, found, key=lambda item: item[0])
        if best[1]:
            return lambda t: _played(best[1], begin, t), best[0]
        raise RobotError(
            f"the arms cannot pass each other between frames {before} and {after} of the film, "
            f"whichever goes first, and keep {1e3 * ARM_ROOM:g} mm apart; give them other places"
        )

    def _one_by_one(self, order, begin, find) -> tuple[float, list] | None:
        """Seconds and parts (arm, begin [s], way) of moves one after the other."""
        clock, parts, now = 0.0, [], list(begin)
        for hand, stops in order:
            way = find(hand, stops, self.arms[1 - hand].capsules(now[1 - hand][None]))
            if way is None:
                return None
            parts.append((hand, clock, way))
            clock += way.duration + _PAUSE
            now[hand] = way.legs[-1].knots[-1]
        return clock - _PAUSE, parts

    def _gap(self, both) -> float:
        one, other = (arm.capsules(q) for arm, q in zip(self.arms, both, strict=True))
        return float(gap_between(one, other).min())


def _played(parts: list[tuple[int, float, Transit]], begin, time: np.ndarray) -> list[np.ndarray]:
    """Joint positions (k, n) of both arms at times (k,) [s]; one at rest stays where it is."""
    out = [np.repeat(q[None], len(time), axis=0) for q in begin]
    for hand, start, way in parts:
        later = time >= start
        out[hand][later] = way.at(time[later] - start)
    return out
