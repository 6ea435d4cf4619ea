"""What a trajectory is to be expected to do on a table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from wrod import arguments
from wrod.deployment.discretisation import Discretisation
from wrod.deployment.result import interpolation, metric_points
from wrod.deployment.setup import Disturbance
from wrod.deployment.simulate import Trial
from wrod.deployment.spread import Spread, stretching
from wrod.deployment.tangents import Laid, Watch
from wrod.deployment.together import Asked, Course, follow
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.model import Rod
from wrod.solvers.friction import Friction

# How rods are laid where plans are made, where these are judged, and where what lies is compared
# with a picture: points of the first two are 0.2 and 0.1 mm from those of edges of 5 mm and steps
# of 10 ms, and means of their errors 0.07 and 0.04 mm; what is judged by steps of 40 ms errs by up
# to 0.08 mm more where the rod hardly slides, by which plans would be told apart.
# Residual forces of the first two, which change what lies by 0.003 mm.
COARSE = Discretisation(spacing=0.01, step=0.04, tolerance=1e-3)
JUDGING = replace(COARSE, spacing=0.0075, step=0.02)
FINE = Discretisation(spacing=0.005, step=0.02)
# Speed of the contact [m/s].
PACE = 0.04
# Largest edges of the first two [L_gb]: a correction must not be for what a coarse mesh does.
_COARSE_EDGE, _JUDGING_EDGE = 1.0 / 3.0, 1.0 / 4.5
# Disturbed rods that are laid by the finished plan, none of which the optimisation has seen.
_UNSEEN = 10
# Friction of a table that nobody measured, and rods that are laid on such tables.
UNMEASURED, _FORESEEN = (0.2, 0.6), 4
_FIRST_SEED = 77_000
# What counts as slid, and as not on the pattern [m].
_SLID, _OFF = 1e-3, 5e-3
# Frictions that are tried, in parts of the largest that was asked for, where a plan cannot be laid
# up to that, and the largest of a table.
_ROUGHER, _ROUGHEST = (1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0), 2.0
# Standard errors by which a plan has to be better than another to be preferred to it.
_SURE = 1.0


def expect(
    pattern: Pattern,
    rod: Rod,
    trajectory: Trajectory,
    friction: float | tuple[float, float] | Spread,
    *,
    trials: int = _UNSEEN,
    hold: float = 0.05,
    pace: float = PACE,
    coarse: bool = False,
    device: arguments.DeviceLike = "cpu",
    watch: Watch | None = None,
) -> dict:
    """What a trajectory is to be expected to do on a table: disturbed rods, laid in simulation.

    The disturbances are those of a careful laboratory (`Disturbance.random`), placement and jitter
    included; friction runs from the least to the largest, and rods stretch as believed or less
    (`Spread.stretch`). Meshes may be `coarse`: what lies differs by 0.05 cm, in a third of the
    time. `watch` is that of `wrod.deployment.tangents.lay`.

    Returns:
        Plain JSON values: friction (trials,) [-]; error_mean (trials,), their mean and deviation
        "mean", "deviation" [m]; error_robot (trials,): the same from where the robot, misplaced,
        has the pattern, which is what the plan can answer for; "slides": stretches (from, to) of
        the pattern's arc length [m] where the rod slides by more than 1 mm in half of the trials;
        "off": stretches that lie more than 5 mm from there in any, each with the friction from
        which on it does not in any trial (None: in none of them); "holds_from": the friction from
        which on nothing does (None: none); "error_along": (50,) mean over the trials along
        the pattern [m]; diverged: how many did.
    """
    course = expecting(pattern, rod, [trajectory], friction, trials, pace, coarse)
    how: dict[str, Any] = {"hold": hold, "watch": watch}
    (expected,) = follow([course], device=device, **how)[0]
    return expected


def foresee(
    pattern: Pattern,
    rod: Rod,
    trajectory: Trajectory,
    friction: float | tuple[float, float] | None = None,
    *,
    device: arguments.DeviceLike = None,
    watch: Watch | None = None,
) -> dict:
    """`expect` for a table, or for one that nobody measured: four rods, coarse meshes."""
    how: dict[str, Any] = {"device": device or "auto", "watch": watch}
    if friction is None:
        friction, how = UNMEASURED, {**how, "trials": _FORESEEN, "coarse": True}
    return expect(pattern, rod, trajectory, friction, **how)


def expecting(
    pattern: Pattern,
    rod: Rod,
    trajectories: list[Trajectory],
    friction: float | tuple[float, float] | Spread,
    trials: int = _UNSEEN,
    pace: float = PACE,
    coarse: bool = False,
) -> Course[list[dict]]:
    """`expect` of several trajectories of a pattern, with the same disturbed rods for all."""
    unseen = Unseen.of(pattern, rod, friction, trials)
    lgb = rod.gravito_bending_length
    how = {"discretisation": coarse_mesh(lgb) if coarse else judging_mesh(lgb), "speed": pace}
    laid = yield Asked([one for t in trajectories for one in unseen.laid_by(t)], None, how)
    return [unseen.told(laid[first : first + trials]) for first in range(0, len(laid), trials)]


def rougher(
    pattern: Pattern, rod: Rod, trajectories: list[Trajectory], expected: dict, pace: float = PACE
) -> Course[list[float | None]]:
    """For each stretch of what `expect` says is "off", the least of a few larger frictions from
    which on the undisturbed rod stays within 5 mm there by one of these trajectories; None: none
    up to 2, or the stretch holds from a friction that was asked for. Empty where none was tried."""
    lost = [least is None for *_, least in expected["off"]]
    mus = expected["friction"][-1] * np.array(_ROUGHER)
    mus = mus[mus <= _ROUGHEST]
    if not (any(lost) and len(mus)):
        return []
    trials = [
        Trial(pattern, rod, path, Friction(mu), tail=Tail.none(path))
        for path in trajectories
        for mu in mus.tolist()
    ]
    how = {"discretisation": coarse_mesh(rod.gravito_bending_length), "speed": pace}
    laid = yield Asked(trials, None, how)
    error = distances(pattern, laid)
    error[[one.diverged for one in laid]] = np.inf
    error = error.reshape(len(trajectories), len(mus), -1)
    s, _ = metric_points(pattern)
    out: list[float | None] = []
    for (start, stop, _), asked in zip(expected["off"], lost, strict=True):
        inside = (s >= start) & (s <= stop)
        bad = np.all(np.any(error[..., inside] > _OFF, axis=2), axis=0)
        out.append(_holds_from(mus, bad) if asked else None)
    return out


@dataclass(frozen=True)
class Unseen:
    """Disturbed rods by which plans of a pattern are judged, which no correction was made for."""

    pattern: Pattern
    rods: list[Rod]
    frictions: np.ndarray
    disturbances: list[Disturbance]
    beside: np.ndarray

    @classmethod
    def of(
        cls,
        pattern: Pattern,
        rod: Rod,
        friction: float | tuple[float, float] | Spread,
        count: int = _UNSEEN,
    ) -> Unseen:
        """So many, on tables from the least friction to the largest."""
        spread = Spread.of(friction)
        disturbances = [Disturbance.random(_FIRST_SEED + k) for k in range(count)]
        mus, parts = spread.unseen(count, rod)
        rods = [stretching(rod, part) for part in parts] if spread.stretch else [rod] * count
        table = np.column_stack([mus, parts]) - spread.middle(rod)
        own = [(one.lgb_error, one.natural_curvature) for one in disturbances]
        return cls(pattern, rods, mus, disturbances, np.column_stack([own, table]))

    def laid_by(self, trajectory: Trajectory) -> list[Trial]:
        """The rods, to be laid by a trajectory."""
        rest, mus = Tail.none(trajectory), self.frictions.tolist()
        return [
            Trial(self.pattern, held, trajectory, Friction(mu), one, rest)
            for held, mu, one in zip(self.rods, mus, self.disturbances, strict=True)
        ]

    def told(self, laid: list[Laid]) -> dict:
        """What `expect` says of a trajectory by which they lie like this."""
        pattern, mus = self.pattern, self.frictions
        error = distances(pattern, laid)
        own = np.array(
            [
                _robot_errors(pattern, one.arc_length, one.centerline, disturbance)
                for one, disturbance in zip(laid, self.disturbances, strict=True)
            ]
        )
        s, _ = metric_points(pattern)
        slid = [np.interp(s + pattern.remainder_length, x.arc_length, x.slip) > _SLID for x in laid]
        bad = own > _OFF
        off = [
            [start, stop, _holds_from(mus, np.any(bad[:, (s >= start) & (s <= stop)], axis=1))]
            for start, stop in _stretches(s, np.any(bad, axis=0))
        ]
        means = error.mean(axis=1)
        return {
            "friction": mus.tolist(),
            "error_mean": means.tolist(),
            "error_robot": own.mean(axis=1).tolist(),
            "beside": self.beside.tolist(),
            "mean": float(means.mean()),
            "deviation": float(means.std()),
            "slides": _stretches(s, np.mean(slid, axis=0) >= 0.5),
            "off": off,
            "holds_from": _holds_from(mus, np.any(bad, axis=1)),
            "error_along": error.mean(axis=0).tolist(),
            "diverged": int(sum(one.diverged for one in laid)),
        }


def is_better(after: dict, before: dict, among: float = 1.0) -> bool:
    """Whether a plan lays the same disturbed rods better than another, by what `expect` says of
    both: by more than the standard error of what they differ by, misplacement aside. The best
    `among` several has to be better by so much that chance makes none of them so any sooner."""
    mean, doubt = balanced(_saved([after], before)[:, 0], np.array(before["beside"]))
    sure = -ndtri(ndtr(-_SURE) / among)
    return bool(after["diverged"] <= before["diverged"] and mean > sure * doubt)


def independent(rivals: list[dict], before: dict) -> float:
    """How many plans that have nothing to do with each other are as likely to beat another by
    chance as these, by what `expect` says of them: 1 where all differ from it alike, as by steps of
    one direction. Of their correlation that is the square of the sum of the eigenvalues over the
    sum of their squares (Bretherton et al. 1999), which few rods make larger by chance."""
    saved = _saved([x for x in rivals if np.isfinite(x["error_robot"]).all()], before)
    if not saved.size:
        return 1.0
    _, rest, free, _ = _beside_aside(saved, np.array(before["beside"]))
    rest = rest[:, rest.any(axis=0)]  # one that differs in nothing beats nothing
    if rest.shape[1] < 2 or free < 2:
        return float(max(rest.shape[1], 1))
    shared = (free * np.corrcoef(rest.T) ** 2 - 1.0) / (free - 1.0)
    count = rest.shape[1]
    return float(count**2 / np.clip(shared.sum(), count, count**2))


def _saved(rivals: list[dict], before: dict) -> np.ndarray:
    """(rod, plan) by which rods lie nearer by rivals than by another plan [m]."""
    return np.array([np.subtract(before["error_robot"], x["error_robot"]) for x in rivals]).T


def balanced(errors: np.ndarray, beside: np.ndarray) -> tuple[float, float]:
    """Mean of errors (rod,), and its standard error, as if the rods lay evenly about the middle,
    beside which they are by (rod, kind): of few rods one plan answers to a stiffer one and another
    to a softer one, and their sum is chance. What errors answer linearly to is taken out."""
    mean, rest, _, doubt = _beside_aside(errors, beside)
    return float(mean), float(doubt * np.linalg.norm(rest))


def _beside_aside(
    errors: np.ndarray, beside: np.ndarray
) -> tuple[np.ndarray, np.ndarray, int, float]:
    """Mean (...) of errors (rod, ...) in the middle, their residuals (rod, ...), how many of these
    are free, and the standard error of the mean over their norm."""
    design = np.column_stack([np.ones(len(errors)), beside])
    fit, _, rank, _ = np.linalg.lstsq(design, errors)
    if rank >= len(errors):
        design, fit, rank = design[:, :1], errors.mean(axis=0)[None], 1
    free = len(errors) - int(rank)
    doubt = np.sqrt(np.linalg.pinv(design.T @ design)[0, 0] / max(free, 1))
    return fit[0], errors - design @ fit, free, float(doubt)


def robot_error(
    pattern: Pattern, arc_length: np.ndarray, centerline: np.ndarray, disturbance: Disturbance
) -> float:
    """e_mean [m] of what lies from where the robot, misplaced by the disturbance, has the pattern.

    Misplacement moves whatever is laid, and says nothing of how it was laid.
    """
    return float(_robot_errors(pattern, arc_length, centerline, disturbance).mean())


def _robot_errors(
    pattern: Pattern, arc_length: np.ndarray, centerline: np.ndarray, disturbance: Disturbance
) -> np.ndarray:
    """(50,) of `robot_error` [m]."""
    (origin,), _, _ = pattern.sample(-pattern.remainder_length)
    s, meant = metric_points(pattern)
    target = disturbance.displaced(meant, origin)
    lies = interpolation(s + pattern.remainder_length, arc_length) @ centerline
    return np.hypot(*(lies - target)[:, :2].T)


def coarse_mesh(lgb: float) -> Discretisation:
    """By which plans of a rod of that L_gb [m] are made."""
    return replace(COARSE, spacing=min(COARSE.spacing, _COARSE_EDGE * lgb))


def judging_mesh(lgb: float) -> Discretisation:
    """By which they are judged."""
    return replace(JUDGING, spacing=min(JUDGING.spacing, _JUDGING_EDGE * lgb))


def _holds_from(frictions: np.ndarray, bad: np.ndarray) -> float | None:
    """The least of some frictions, ascending, from which on none is bad; None: there is none."""
    first = int(np.flatnonzero(bad)[-1]) + 1 if bad.any() else 0
    return float(frictions[first]) if first < len(frictions) else None


def _stretches(s: np.ndarray, chosen: np.ndarray) -> list[list[float]]:
    """From and to where the chosen points lie, each of which stands for what is nearest to it."""
    borders = np.concatenate([s[:1], 0.5 * (s[1:] + s[:-1]), s[-1:]])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], chosen.astype(int), [0]])))
    return borders[edges].reshape(-1, 2).tolist()


def misplacement(pattern: Pattern, laid: Laid) -> tuple[np.ndarray, np.ndarray]:
    """(2 x 50,) horizontal displacement of what lies at the points of the metric [m], and (2 x 50,
    column) its derivatives."""
    s, target = metric_points(pattern)
    weights = interpolation(s + pattern.remainder_length, laid.arc_length)
    error = (weights @ laid.centerline[:, :2] - target[:, :2]).T.ravel()
    rates = np.einsum("pn,cnd->dpc", weights, laid.tangent[:, :, :2])
    return error, rates.reshape(2 * len(s), -1)


def distances(pattern: Pattern, laid: list[Laid]) -> np.ndarray:
    """(rod, 50) horizontal distances of what lies from the points of the metric [m]."""
    return np.array([np.hypot(*misplacement(pattern, one)[0].reshape(2, -1)) for one in laid])
