"""Which equilibrium a clamped rod is in: a stable one, and of several the one that was measured.

A rod that is led to its poses from straight may arrive at an equilibrium that no rod keeps (an arch
that stands upright in its own plane falls to one side), or nowhere. Each trial is therefore relaxed
from more shapes: the measured one, and, where it stands on a saddle, what it falls to on either
side. Stable ones come before unstable ones; among those the nearest to the markers is the rod's.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import eigh

from wrod.rods.state import full_hessian

# Shapes whose RMS distance is below this share of the free length are one equilibrium.
_SAME = 1e-3
# A stable equilibrium this near to the measured shape is the rod's.
_NEAR = 0.05
# A rod is far from its measured shape at so many times what noise leaves, and where there are
# some, so many times the distance that a quarter of them are within.
_FAR, _FARTHER, _SOME = 2.0, 1.5, 8
# How far the middle of a rod is rolled to find one whose section lies another way [rad]. A round
# rod that is straight at rest has no other way: its twist evens out at once.
_ROLL = 0.5 * np.pi
# Whole turns beyond the least twist, in its sense, with how its middle is rolled; and what rods
# that still stand far are tried with: a robot's last joint turns by two either way.
_LEAST = tuple(product((0, -1), (0.0, _ROLL, -_ROLL)))
_MORE = tuple((turns, 0.0) for turns in (1, -2, 2))
# Of several turns some shape comes nearer by chance, where the model lacks an effect: they, and
# whatever a rod is put on by the base model, have to be nearer than this share of the distance.
_CLEARLY = 0.5
# Size of the push off a saddle, over the free length.
_PUSH = 0.02
# What falls off one saddle may land on another.
_FALLS = 4


@dataclass(frozen=True)
class FoundBranch:
    """What is known of the equilibria of one trial.

    Attributes:
        negative: eigenvalues below zero of the chosen one: 0 is stable.
        found: distinct stable equilibria that were found.
        start: where the chosen one was reached from: the "measured" shape, "straight", "saddle".
    """

    negative: int
    found: int
    start: str


class _Tried:
    """States of every rod from one start, with what came of it."""

    def __init__(self, solver, reached: np.ndarray, shape: np.ndarray | None, start: str):
        self.state, self.start = solver.saved(), start
        self.position = solver.batch.positions()[:, 1:-1]
        self.negative = solver.negative.copy()
        self.finite = np.isfinite(self.position).all(axis=(1, 2))
        self.reached = reached & self.finite
        self.away = np.zeros(len(reached))
        if shape is not None:
            off = np.sqrt(((self.position - shape) ** 2).sum(axis=2).mean(axis=1))
            self.away = np.where(np.isfinite(off), off, np.inf)


def from_measured(solver, setups, shape: np.ndarray) -> tuple[_Tried, np.ndarray]:
    """What every rod relaxes to from its measured shape (rod, node, 3), and (rod,) whether that
    leaves no doubt: stable, near that shape, and not twisted by half a turn, which may go both
    ways."""
    tried = _Tried(solver, _relaxed(solver, setups, shape), shape, "measured")
    twist = np.abs(solver.total_twist()) < 0.9 * np.pi
    return tried, _stands_near(tried, setups) & twist


def _stands_near(tried: _Tried, setups) -> np.ndarray:
    near = tried.away < _NEAR * float(np.real(setups[0].length))
    return tried.reached & (tried.negative == 0) & near


def to_measured(
    solver, setups, shape: np.ndarray, floor: float = 0.0, every: bool = False, clearly=False
) -> bool:
    """Put rods that stand far from their measured shapes, where others do not, on another
    equilibrium beside that shape, if there is one that is nearer; whether any was put.

    It may be one that is wound the other way or by whole turns more, of which poses say nothing, or
    whose section lies another way between the clamps: a rod that is stiffer one way than the other
    may roll to either side in a strong bend.

    Args:
        floor: RMS distance that noise leaves [m]; every: ask it of all rods; clearly: only where
            half the distance and more is gone.
    """
    led = _Tried(solver, np.ones(len(shape), dtype=bool), shape, "led")
    same = _SAME * float(np.real(setups[0].length))
    least = max(_FAR * floor, same)
    if len(shape) >= _SOME:
        least = max(least, _FARTHER * np.quantile(led.away, 0.25))
    asked = led.away > (0.0 if every else least)
    state, off, put = led.state, led.away.copy(), False
    alike = all(map(_is_round, setups))
    for tries in (_LEAST, _MORE):
        share = _CLEARLY if clearly or tries is _MORE else 1.0
        for turns, roll in tries if asked.any() else ():
            if roll and alike:
                continue
            solver.shape_to(setups, shape, turns=turns, roll=roll)
            solver.restore(led.state, ~asked)  # at rest, they cost nothing
            tried = _Tried(solver, solver.relax(setups), shape, "measured")
            # Squares tell: of noise both have the same.
            nearer = (
                asked & _stands_near(tried, setups) & (tried.away**2 + same**2 < (share * off) ** 2)
            )
            if nearer.any():
                solver.restore(state)
                solver.restore(tried.state, nearer)
                state, off, put = solver.saved(), np.where(nearer, tried.away, off), True
        asked &= off > least
    solver.restore(state)
    return put


def _is_round(setup) -> bool:
    """Whether a rod resists bends in every direction alike, and none more than its opposite."""
    uneven = setup.bending[..., 0] != setup.bending[..., 1]
    return not any(map(np.any, (uneven, setup.natural_curvature, setup.coupling)))


def settle(
    solver, setups, walked: np.ndarray, shape: np.ndarray | None, measured: _Tried | None
) -> list[FoundBranch]:
    """Put every rod of a `ClampedSolver` that was led to its poses on its branch.

    Args:
        walked: (rod,) whether it arrived.
        shape: (rod, node, 3) measured positions of the nodes between the clamps, if there are any;
            measured: what they relax to.

    Returns:
        one entry per rod; `found` is 0 where a rod has no equilibrium.
    """
    tried = [_Tried(solver, walked, shape, "straight")]
    first = tried[0]
    if measured is not None:
        tried.append(measured)
    saddle = np.logical_and.reduce([~t.reached | (t.negative > 0) for t in tried])
    if saddle.any():
        size = _PUSH * float(np.real(setups[0].length))
        for side in (-1.0, 1.0):
            last = first
            for _ in range(_FALLS):
                modes = softest_mode(solver, last)
                pushed = last.position + side * size * modes
                reached = _relaxed(solver, setups, pushed, last.state)
                last = _Tried(solver, reached, shape, "saddle")
                tried.append(last)
                if not (saddle & (~last.reached | (last.negative > 0))).any():
                    break
    return _chosen(solver, tried, float(np.real(setups[0].length)))


def _chosen(solver, tried: list[_Tried], length: float) -> list[FoundBranch]:
    out = []
    picks = np.zeros(len(tried[0].reached), dtype=int)
    for r in range(len(picks)):
        ranked = [k for k, t in enumerate(tried) if t.reached[r]]
        stable = [k for k in ranked if tried[k].negative[r] == 0]
        distinct: list[int] = []
        for k in stable:
            apart = [
                np.sqrt(((tried[k].position[r] - tried[j].position[r]) ** 2).sum(axis=1).mean())
                for j in distinct
            ]
            if all(a > _SAME * length for a in apart):
                distinct.append(k)
        pool = distinct or ranked or [0]
        # Where the rod was led to is preferred unless another one is clearly nearer.
        best = min(pool, key=lambda k: (tried[k].away[r] + _SAME * length * (k > 0), k))
        picks[r] = best
        negative, start = int(tried[best].negative[r]), tried[best].start
        out.append(FoundBranch(negative, len(distinct) or len(ranked), start))
    for k, t in enumerate(tried):
        if (picks == k).any():
            solver.restore(t.state, picks == k)
    solver.negative = np.array([b.negative for b in out])
    return out


def _relaxed(solver, setups, shape: np.ndarray, state=None) -> np.ndarray:
    """Bring every rod to equilibrium from a shape; (rod,) whether it got there."""
    solver.shape_to(setups, shape, state)
    return solver.relax(setups)


def softest_mode(solver, at: _Tried) -> np.ndarray:
    """(rod, node, 3) displacement of the lowest eigenvector of every unstable rod, of largest size
    1; zero for the others."""
    solver.restore(at.state)
    batch = solver.batch
    batch.evaluate(order=2)
    band = batch.derivatives.hessian.numpy()
    free = batch.free.numpy() != 0
    out = np.zeros((len(band), batch.node_count, 3))
    for r in np.flatnonzero(at.finite & (~at.reached | (at.negative > 0))):
        own = np.flatnonzero(free[r])
        _, vectors = eigh(full_hessian(band[r])[np.ix_(own, own)], subset_by_index=[0, 0])
        vector = np.zeros(batch.dof_count + 1)
        vector[own] = vectors[:, 0]
        move = vector.reshape(-1, 4)[:, :3]
        out[r] = move / max(np.linalg.norm(move, axis=1).max(), 1e-300)
    return out[:, 1:-1]
