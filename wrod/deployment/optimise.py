"""Plans that know the table: the grip's path is corrected until what stays lies on the pattern.

Optimal grasps say where the grip is to be if the laid part does not move. On a table of friction
0.2 to 0.6 it does: where the pattern bends, the rod slides as it touches down. The path has freedom
to spare, and this module uses it. Gauss-Newton with the derivatives of whole deployments
(`wrod.deployment.tangents`) finds smooth corrections of the grip's poses with which a sample of
rods and tables lie on the pattern, on average and at their worst.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import BSpline

from wrod.deployment.result import METRIC_POINTS, interpolation
from wrod.deployment.setup import DEVIATIONS, Disturbance
from wrod.deployment.simulate import Trial
from wrod.deployment.tangents import Directions, Laid, lay
from wrod.errors import PatternError
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.material import RodMaterial
from wrod.solvers.contact import Friction

# Spacing of the knots of the corrections [L_gb].
_KNOTS = 1.0
# How the optimisation lays: laid curves differ by 0.05 cm from those of the finest.
COARSE: dict[str, Any] = {"spacing": 0.01, "step": 0.02, "speed": 0.04}
FINE: dict[str, Any] = {"spacing": 0.005, "step": 0.02, "speed": 0.04}
# Largest edges of both [L_gb]: a correction must not be for what a coarse mesh does.
_COARSE_EDGE, _FINE_EDGE = 1.0 / 3.0, 1.0 / 6.0
# Cost of a correction of 1 L_gb along the whole path, and of its second differences, over that of
# an error of 1 L_gb.
_SIZE, _ROUGHNESS = 2e-3, 2e-3
# Largest change of a correction in one iteration [L_gb].
_STEP = 0.35
_ITERATIONS = 6
# An iteration that leaves more than this part of the error is the last.
_DONE = 0.95
# A correction that saves the sample less than this on average [m], a careful robot's jitter, fits
# its few rods and not the next, and is left out.
_WORTH = DEVIATIONS["jitter"]
# A single friction coefficient is taken to be known to this part.
_UNCERTAIN = 0.1
# Deviations of uniform variables, in those of normal ones whose middle 90 % they cover.
_REACH = 1.65
# Least radius of a rod that stretches less, over the rod's, and by how much less it does at most
# where it hangs from its end [L_gb]: no path lays rods alike that differ by more.
_THIN, _LESS_STRETCH = 0.3, 0.15
# Disturbed rods that are laid by the finished plan, none of which the optimisation has seen.
_UNSEEN = 6
_FIRST_SEED = 77_000
# What counts as slid, and as not on the pattern [m].
_SLID, _OFF = 1e-3, 5e-3


@dataclass(frozen=True)
class Spread:
    """What a plan is to be good for; deviations are standard deviations.

    Attributes:
        friction: least and largest coefficient [-].
        lgb_error: relative, of L_gb.
        natural_curvature: [1/m].
        stretch: whether every second rod of the sample stretches less, hardly if it may.
    """

    friction: tuple[float, float]
    lgb_error: float = DEVIATIONS["lgb_error"]
    natural_curvature: float = DEVIATIONS["natural_curvature"]
    stretch: bool = True

    @classmethod
    def of(cls, friction: float | tuple[float, float] | Spread) -> Spread:
        """That of a coefficient, known to a tenth, or of a range.

        Raises:
            PatternError: not positive and finite, or the first is larger than the second.
        """
        if isinstance(friction, Spread):
            return friction
        values = np.atleast_1d(np.asarray(friction, dtype=float))
        if len(values) == 1:
            values = values[0] * np.array([1.0 - _UNCERTAIN, 1.0 + _UNCERTAIN])
        if len(values) != 2 or not (np.isfinite(values).all() and 0 < values[0] <= values[1]):
            raise PatternError(
                f"friction is {friction!r}; give a positive coefficient or a range such as "
                "(0.2, 0.6)"
            )
        return cls((float(values[0]), float(values[1])))

    def sample(self, count: int, rod: RodMaterial) -> list[tuple]:
        """(rod, friction, disturbance) of rods that cover it evenly, from low friction to high."""
        low, high = self.friction
        share = (np.arange(count) + 0.5) / count if count > 1 else np.array([0.5])
        out = []
        for i, x in enumerate(share):
            # Sequences of different bases fill a square evenly, however few they are.
            one, two = (2.0 * _radical_inverse(i + 1, base) - 1.0 for base in (2, 3))
            disturbance = Disturbance(
                lgb_error=_REACH * self.lgb_error * one,
                natural_curvature=_REACH * self.natural_curvature * two,
            )
            held = _stretching_less(rod) if self.stretch and i % 2 else rod
            out.append((held, Friction(low + (high - low) * float(x)), disturbance))
        return out


def _stretching_less(rod: RodMaterial) -> RodMaterial:
    """A thinner rod with the same L_gb."""
    hanging = (rod.length / rod.gravito_bending_length) ** 2 / (4.0 * rod.stretch_ratio)
    part = np.sqrt(max(1.0 - _LESS_STRETCH / hanging, 0.0))
    return replace(rod, radius=max(_THIN, float(part)) * rod.radius)


def _radical_inverse(i: int, base: int) -> float:
    value, part = 0.0, 1.0 / base
    while i:
        i, digit = divmod(i, base)
        value, part = value + digit * part, part / base
    return value


def optimise(
    pattern: Pattern,
    rod: RodMaterial,
    trajectory: Trajectory,
    friction: float | tuple[float, float] | Spread,
    *,
    samples: int = 3,
    iterations: int = _ITERATIONS,
    hold: float = 0.05,
    judge: bool = True,
    device: str | None = "cpu",
    progress: Callable[[float], None] | None = None,
) -> Trajectory:
    """Correct a trajectory's positions until what stays on the table lies on the pattern.

    Rods that cover the spread of friction, L_gb, natural curvature and stretch are laid together
    with their derivatives by smooth displacements of the grip; a Gauss-Newton step, limited in
    size, reduces their squared errors, the worse ones weighing more, and what the corrections cost
    in size and roughness. The best of a few such steps is kept if it saves 0.3 mm on average. Then
    disturbed rods that none of this has seen are laid, on finer meshes: what is expected of the
    plan.

    Args:
        pattern: with the remainder that the trajectory lays.
        rod: what is laid.
        trajectory: to start from, as `wrod.plan` returns it.
        friction: a coefficient, known to a tenth, a range, or a `Spread`.
        samples: rods that are laid at a time.
        iterations: times that they are laid.
        hold: length of the free end that is held at first [m].
        judge: whether to lay the unseen rods, without which nothing is expected of the plan.
        device: "cpu", "cuda:0" or "auto".
        progress: called with the fraction done since the last call.

    Returns:
        The corrected trajectory. `metadata["optimised"]` holds the range of friction, the mean
        error of the sample at each iteration [m] and the largest correction [m];
        `metadata["expected"]` is what `expect` says.

    Raises:
        PatternError: friction is not usable, or the trajectory is too short to be laid.
    """
    spread = Spread.of(friction)
    lgb = rod.gravito_bending_length
    corrections = Corrections(pattern, trajectory, lgb, hold)
    cost = corrections.cost(_SIZE, _ROUGHNESS)
    x = np.zeros(3 * corrections.count)
    best, radius = None, _STEP
    history = []
    for _ in range(iterations):
        laid = laid_sample(
            pattern, rod, corrections, spread, x, samples=samples, hold=hold, device=device
        )
        parts = [misplacement(pattern, one) for one in laid]
        errors = np.array([np.hypot(*e.reshape(2, -1)).mean() for e, _ in parts])
        errors[[one.diverged for one in laid]] = np.inf
        value = 0.5 * (errors.mean() + errors.max())
        history.append(float(errors.mean()))
        if progress is not None:
            progress(1.0 / (iterations + 1))
        if best is not None and _DONE * best[0] < value <= best[0]:
            best = value, x, errors
            break
        if best is None or value < best[0]:
            best = value, x, errors
        else:
            radius *= 0.5
        if not np.isfinite(value):
            x = 0.5 * (x + best[1])
            continue
        matrix, slope = cost.copy(), cost @ x
        for (error, rates), weight in zip(parts, 0.5 + 0.5 * errors / errors.mean(), strict=True):
            scale = weight / (samples * METRIC_POINTS * lgb**2)
            matrix += scale * rates.T @ rates
            slope += scale * rates.T @ error
        step = -np.linalg.solve(matrix, slope)
        x = x + step * min(1.0, radius / np.abs(step).max())
    if history[0] - best[2].mean() < _WORTH:
        best = best[0], np.zeros_like(x), best[2]
    corrected = corrections.apply(best[1])
    expected = None
    if judge:
        expected = expect(pattern, rod, corrected, spread, hold=hold, device=device)
    if progress is not None:
        progress(1.0 / (iterations + 1))
    said = {
        "friction": list(spread.friction),
        "iterations": iterations,
        "errors": history,
        "largest_correction": float(lgb * np.abs(corrections.basis @ best[1].reshape(-1, 3)).max()),
    }
    metadata = {**corrected.metadata, "optimised": said, "expected": expected}
    return replace(corrected, metadata=metadata)


def laid_sample(
    pattern: Pattern,
    rod: RodMaterial,
    corrections: Corrections,
    spread: Spread,
    values: np.ndarray,
    *,
    samples: int = 3,
    hold: float = 0.05,
    device: str | None = "cpu",
) -> list[Laid]:
    """The rods that cover a spread, laid by a corrected path, with their derivatives by each of the
    corrections' values (3 count,) [L_gb]."""
    now = corrections.apply(values)
    rest = tail(pattern, rod, now)
    return lay(
        [
            Trial(pattern, held, now, law, how, rest)
            for held, law, how in spread.sample(samples, rod)
        ],
        [Directions.of_path(corrections.columns())] * samples,
        hold=hold,
        device=device,
        **_edged(COARSE, _COARSE_EDGE * rod.gravito_bending_length),
    )


def expect(
    pattern: Pattern,
    rod: RodMaterial,
    trajectory: Trajectory,
    friction: float | tuple[float, float] | Spread,
    *,
    trials: int = _UNSEEN,
    hold: float = 0.05,
    device: str | None = "cpu",
) -> dict:
    """What a trajectory is to be expected to do on a table: disturbed rods, laid in simulation.

    The disturbances are those of a careful laboratory (`Disturbance.random`), placement and jitter
    included; friction runs from the least to the largest.

    Returns:
        Plain JSON values: friction (trials,) [-]; error_mean (trials,), their mean and deviation
        "mean", "deviation" [m]; "slides": stretches (from, to) of the pattern's arc length [m]
        where the rod slides by more than 1 mm in half of the trials; "off": stretches that lie more
        than 5 mm from the pattern in any, each with the friction from which on it does not in any
        trial (None: in none of them); diverged: how many did.
    """
    spread = Spread.of(friction)
    mus = np.linspace(*spread.friction, trials)
    rest = tail(pattern, rod, trajectory)
    laid = lay(
        [
            Trial(pattern, rod, trajectory, Friction(mu), Disturbance.random(_FIRST_SEED + k), rest)
            for k, mu in enumerate(mus.tolist())
        ],
        hold=hold,
        device=device,
        **_edged(FINE, _FINE_EDGE * rod.gravito_bending_length),
    )
    error = np.array([np.hypot(*misplacement(pattern, one)[0].reshape(2, -1)) for one in laid])
    s = np.linspace(0.0, pattern.length, METRIC_POINTS)
    slid = np.array([np.interp(s + pattern.remainder_length, x.arc_length, x.slip) for x in laid])
    off = []
    for start, stop in _stretches(s, np.any(error > _OFF, axis=0)):
        inside = (s >= start) & (s <= stop)
        bad = (error[:, inside] > _OFF).any(axis=1)
        last = int(np.flatnonzero(bad)[-1])
        off.append([start, stop, float(mus[last + 1]) if last + 1 < trials else None])
    means = error.mean(axis=1)
    return {
        "friction": mus.tolist(),
        "error_mean": means.tolist(),
        "mean": float(means.mean()),
        "deviation": float(means.std()),
        "slides": _stretches(s, np.mean(slid > _SLID, axis=0) >= 0.5),
        "off": off,
        "diverged": int(sum(one.diverged for one in laid)),
    }


def _edged(how: dict[str, Any], longest: float) -> dict[str, Any]:
    """Options of `lay` with edges of at most that length [m]."""
    return {**how, "spacing": min(how["spacing"], longest)}


def _stretches(s: np.ndarray, chosen: np.ndarray) -> list[list[float]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], chosen.astype(int), [0]])))
    return [[float(s[i]), float(s[j - 1])] for i, j in zip(edges[::2], edges[1::2], strict=True)]


class Corrections:
    """Smooth displacements of a trajectory's positions: cubic splines over the laid length, in the
    frame of the contact (forward, left, up) and in L_gb."""

    def __init__(self, pattern: Pattern, trajectory: Trajectory, lgb: float, first: float):
        s = trajectory.arc_length
        on = np.clip(trajectory.pattern_arc_length, -pattern.remainder_length, pattern.length)
        tangent = pattern.sample(on)[1]
        up = np.broadcast_to([0.0, 0.0, 1.0], tangent.shape)
        self.frame = np.stack([tangent, np.cross(up, tangent), up], axis=-1)
        pieces = max(int(np.ceil((s[-1] - first) / (_KNOTS * lgb))), 2)
        inner = np.linspace(first, s[-1], pieces + 1)
        knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
        self.basis = BSpline.design_matrix(np.clip(s, first, s[-1]), knots, 3).toarray()
        self.count, self.lgb, self.trajectory = self.basis.shape[1], lgb, trajectory

    def displacement(self, values: np.ndarray) -> np.ndarray:
        """(T, 3) displacement [m] in the world frame, of values (3 count,) [L_gb]."""
        return self.lgb * np.einsum("tij,tk,kj->ti", self.frame, self.basis, values.reshape(-1, 3))

    def columns(self) -> np.ndarray:
        """(3 count, T, 6) displacement of the poses by each value [m/L_gb]."""
        rates = self.lgb * np.einsum("tij,tk->kjti", self.frame, self.basis)
        return np.pad(rates.reshape(-1, *rates.shape[2:]), ((0, 0), (0, 0), (0, 3)))

    def cost(self, size: float, roughness: float) -> np.ndarray:
        """(3 count, 3 count) matrix of the quadratic cost of corrections."""
        second = np.diff(np.eye(self.count), 2, axis=0)
        one = size / self.count * np.eye(self.count) + roughness * second.T @ second
        return np.kron(one, np.eye(3))

    def apply(self, values: np.ndarray) -> Trajectory:
        """The trajectory with corrected positions; the forces of its grasps no longer hold."""
        return moved(self.trajectory, self.displacement(values))


def moved(trajectory: Trajectory, displacement: np.ndarray) -> Trajectory:
    """The trajectory with positions displaced by (T, 3) [m], and the shapes of its rod with them;
    the forces of its grasps no longer hold."""
    shape = trajectory.shape
    if shape is not None:
        share = np.linspace(0.0, 1.0, shape.shape[1]) ** 2
        shape = shape + share[None, :, None] * displacement[:, None]
    return replace(
        trajectory,
        position=trajectory.position + displacement,
        force=np.full_like(trajectory.force, np.nan),
        shape=shape,
        metadata={**trajectory.metadata, "contact_friction": None},
    )


def misplacement(pattern: Pattern, laid: Laid) -> tuple[np.ndarray, np.ndarray]:
    """(2 x 50,) horizontal displacement of what lies at the points of the metric [m], and (2 x 50,
    column) its derivatives."""
    s = np.linspace(0.0, pattern.length, METRIC_POINTS)
    target = pattern.sample(s)[0][:, :2]
    weights = interpolation(s + pattern.remainder_length, laid.arc_length)
    error = (weights @ laid.centerline[:, :2] - target).T.ravel()
    rates = np.einsum("pn,cnd->dpc", weights, laid.tangent[:, :, :2])
    return error, rates.reshape(2 * len(s), -1)
