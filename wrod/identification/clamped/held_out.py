"""Trials held out: what a model leaves of those that it was not fitted to, in folds."""

from dataclasses import dataclass

import numpy as np

from wrod.identification.clamped.fit import Fit, fit_models
from wrod.identification.clamped.laboratory import Laboratory

_FOLDS = 4


@dataclass(frozen=True)
class HeldOut:
    """What train trials are off by that a fit has not seen, in folds.

    Attributes:
        rms: of the markers [m]; residual: (t, R) of everything, as independent numbers.
    """

    rms: float
    residual: np.ndarray

    @property
    def squares(self) -> np.ndarray:
        """(t,) chi squared of every trial."""
        return (self.residual**2).sum(axis=1)

    def moved_by(self, other: "HeldOut") -> np.ndarray:
        """(t,) squares by which another model moves the prediction of every trial."""
        return ((self.residual - other.residual) ** 2).sum(axis=1)


def held_out_error(laboratory: Laboratory, fit: Fit) -> HeldOut:
    """What a model leaves of train trials that it was not fitted to."""
    m, trials = laboratory.measurements, laboratory.measurements.train
    count = min(_FOLDS, len(trials))
    fold = np.arange(len(trials)) % count
    fits = [fit] * count
    if len(fit.values):
        weights = (fold != np.arange(count)[:, None]).astype(float)
        fits = fit_models(
            laboratory,
            [fit.model] * count,
            [fit.values] * count,
            weights=weights,
            origin=fit,
            race=False,
        )
    error = np.empty((len(trials), laboratory.target.shape[1]))
    for k, own in enumerate(fits):
        left = fold == k
        seen = laboratory.observe(own.model, own.values, trials=trials[left])
        error[left] = laboratory.target[trials[left]] - seen
    markers = m.centerline[0].size
    read = error[:, :markers][laboratory.read[trials, :markers]]
    return HeldOut(float(np.sqrt(3.0 * (read**2).mean())), laboratory.whiten(error, trials))
