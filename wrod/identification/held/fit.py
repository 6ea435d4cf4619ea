"""One cable in the hand, with and without a weight: stiffness, and how it is bent at rest.

The cables found so far (docs/cables-in-hand.md) are bent by themselves, and differently after a
turn to either side: the sheath's friction keeps part of the last bend. A turn by a positive angle
leaves the natural curvature `lag` lower than the mean of both, a negative one as much higher.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from wrod.errors import DataError
from wrod.identification.held.equilibria import CableModel, markers
from wrod.identification.held.measurements import HeldCable

# Beyond this a marker's residual is another branch of equilibria, which no derivative leads to [m].
_SNAPPED = 0.1
_ITERATIONS, _TRIES, _ENOUGH = 12, 4, 1e-3
_STEPS = {"stiffness": 0.02, "curvature": 0.05, "lag": 0.05, "tilt": 0.01, "friction": 0.05}
_STEPS |= {"kept": 0.05}
# Bounds of how a cable yields, "friction" [1/m] and the logarithm of "kept" (see `CableModel`):
# friction that is all or nothing is another law.
YIELDING = {"friction": (1e-2, 5.0), "kept": (-3.0, -0.05)}
_EFFECTS = ("curvature", "lag", "yielding", "tilt")


@dataclass(frozen=True)
class HeldFit:
    """One cable's sets explained together.

    Attributes:
        names: of the parameters: "stiffness" (logarithm of B over 1 N m^2), "friction" [1/m],
            logarithm of "kept" and "tilt" [rad] of all sets (see `CableModel`), "curvature 0" and
            "lag 0" [1/m] of the first set, and so on.
        values, covariance: (P,) and (P, P); the covariance takes the residual for white noise.
        residual: (case, 2, 2) measured minus predicted, the sets one after the other [m].
        snapped: (case,) whether the model is on another branch there; these did not count.
        noise: standard deviation of a coordinate's residual [m].
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray
    snapped: np.ndarray
    noise: float

    def model(self, which: int, angle: float) -> CableModel:
        """The model of set number `which` at the hand's angle [rad]."""
        return _model(self.names, self.values, which, angle)


def fit_held(
    sets: Sequence[HeldCable], effects: Sequence[str] = ("curvature", "lag", "tilt"), *,
    use: np.ndarray | None = None, device: str = "cpu",
) -> HeldFit:  # fmt: skip
    """Fit one cable's sets by Levenberg and Marquardt's method.

    Args:
        sets: of one cable, with different weights at its tip.
        effects: of "curvature", "lag", "yielding" and "tilt"; none: a straight cable of one
            stiffness. A cable that yields has gone straight from its natural shape to where it
            hangs down, and from there to each angle.
        use: (case,) which angles of all sets to fit, the sets one after the other.

    Raises:
        DataError: no set, or an unknown effect.
    """
    if not sets:
        raise DataError("no set of a cable is given")
    unknown = [name for name in effects if name not in _EFFECTS]
    if unknown:
        raise DataError(f"unknown effect {unknown[0]!r}; use {', '.join(_EFFECTS)}")
    own = [f"{e} {k}" for e in ("curvature", "lag") if e in effects for k in range(len(sets))]
    shared = [*(YIELDING if "yielding" in effects else ()), *(e for e in ("tilt",) if e in effects)]
    names = ("stiffness", *own, *shared)
    step = np.array([_STEPS[name.split()[0]] for name in names])
    bounds = np.array([YIELDING.get(name, (-np.inf, np.inf)) for name in names]).T
    measured = np.concatenate([one.markers for one in sets])
    use = np.ones(len(measured), dtype=bool) if use is None else np.asarray(use, dtype=bool)

    def predict(many):
        return _predict(sets, names, many, device)

    values, here = _start(sets, names, predict, measured, use)
    damping = 1e-3
    for _ in range(_ITERATIONS):
        there = predict(values + np.diag(step))
        rates = np.stack([(t - here) / h for t, h in zip(there, step, strict=True)], axis=-1)
        kept = use & ~_snapped(measured - here)
        # Where a small change makes the cable snap there is no derivative.
        kept &= np.abs(rates * step).max(axis=(1, 2, 3)) < _SNAPPED
        matrix = rates[kept].reshape(-1, len(names))
        off = (measured - here)[kept].ravel()
        square = matrix.T @ matrix
        better = False
        for _ in range(_TRIES):
            add = damping * np.diag(np.diag(square) + 1e-12)
            move = np.linalg.solve(square + add, matrix.T @ off)
            trial = np.clip(values + np.clip(move, -10.0 * step, 10.0 * step), *bounds)
            (seen,) = predict([trial])
            left = _cost(measured - seen, use)
            better = left < _cost(measured - here, use)
            damping = damping / 5.0 if better else damping * 8.0
            if better:
                break
        if not better:
            break
        gained = 1.0 - left / _cost(measured - here, use)
        values, here = trial, seen
        if gained < _ENOUGH:
            break
    residual = measured - here
    freedom = max(matrix.shape[0] - len(names), 1)
    noise = float(np.sqrt((off**2).sum() / freedom))
    covariance = noise**2 * np.linalg.pinv(square)
    return HeldFit(names, values, covariance, residual, _snapped(residual), noise)


def _model(names, values, which, angle) -> CableModel:
    said = dict(zip(names, values, strict=True))
    bent = said.get(f"curvature {which}", 0.0) - said.get(f"lag {which}", 0.0) * np.sign(angle)
    cable = CableModel(float(np.exp(said["stiffness"])), bent, tilt=said.get("tilt", 0.0))
    return yielding(cable, said)


def yielding(cable: CableModel, said: dict[str, float]) -> CableModel:
    """The cable with "friction" and "kept" of what parameters say, where they do."""
    if "friction" not in said:
        return cable
    return replace(cable, friction=float(said["friction"]), kept=float(np.exp(said["kept"])))


def _predict(sets, names, many, device) -> np.ndarray:
    cases = [
        (one, float(angle), _model(names, values, which, angle))
        for values in many
        for which, one in enumerate(sets)
        for angle in one.angle
    ]
    return markers(cases, device)[0].reshape(len(many), -1, 2, 2)


def _start(sets, names, predict, measured, use):
    """The best of a few stiffnesses and curvatures, as cables lie on other branches far off, and
    what it predicts."""
    weight = max((one.cable_mass + one.tip_mass) * one.gravity * one.length**2 for one in sets)
    tries = []
    for stiffness in np.log(weight / np.geomspace(3.0, 30.0, 7)):
        for bend in (-2.0, -1.0, 0.0, 1.0, 2.0) if "curvature 0" in names else (0.0,):
            first = {"stiffness": stiffness, "curvature": bend, "friction": 0.5, "kept": -1.0}
            tries.append(np.array([first.get(name.split()[0], 0.0) for name in names]))
    predicted = predict(tries)
    best = int(np.argmin([_cost(measured - p, use) for p in predicted]))
    return tries[best], predicted[best]


def _snapped(residual: np.ndarray) -> np.ndarray:
    return np.linalg.norm(residual, axis=-1).max(axis=-1) > _SNAPPED


def _cost(residual: np.ndarray, use: np.ndarray) -> float:
    """Squares, those of a snapped cable cut off."""
    square = np.minimum((residual[use] ** 2).sum(axis=(1, 2)), _SNAPPED**2)
    return float(square.sum())
