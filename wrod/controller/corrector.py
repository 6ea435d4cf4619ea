"""The distilled corrections of a grip's path: what optimised plans do, from what lies around the
contact, in NumPy, or in torch while it is trained."""

from __future__ import annotations

import math
import os
import warnings
from dataclasses import dataclass
from importlib import resources

import numpy as np

from wrod.controller.model import layers
from wrod.controller.trained import Trained
from wrod.errors import OutOfRangeWarning

# Where the curvature is seen, from behind the contact to ahead of it [L_gb].
WINDOW = np.arange(-4.0, 6.01, 0.5)
_OTHERS = 6
FEATURES = len(WINDOW) + _OTHERS
OUTPUTS = 3
# Beyond these the distance from an end does not matter [L_gb].
_FAR = 6.0
_RANGE = ("friction", "curvature", "rod_length", "stretch_ratio")


@dataclass(frozen=True)
class CorrectorInputs:
    """What a corrector is asked about, dimensionless.

    Attributes:
        laid: (T,) laid length, increasing [L_gb].
        curvature: (T,) signed, of the pattern at the contacts [1/L_gb].
        rod_length: [L_gb].
        stretch_ratio: k_s [-].
        friction: of the table [-].
    """

    laid: np.ndarray
    curvature: np.ndarray
    rod_length: float
    stretch_ratio: float
    friction: float

    def features(self) -> np.ndarray:
        """(T, FEATURES): curvature over the window, none where nothing is laid; laid length and
        length to be laid, suspended length, k_s, friction and its inverse."""
        around = self.laid[:, None] + WINDOW
        seen = np.interp(around, self.laid, self.curvature, left=0.0, right=0.0)
        left = self.laid[-1] - self.laid
        ones = np.ones_like(left)
        others = [
            2.0 * np.minimum(self.laid, _FAR) / _FAR - 1.0,
            2.0 * np.minimum(left, _FAR) / _FAR - 1.0,
            np.log(np.maximum(self.rod_length - self.laid, 1.0) / 10.0),
            math.log(self.stretch_ratio / 1500.0) / math.log(10.0) * ones,
            math.log(self.friction / 0.35) * ones,
            0.3 / self.friction * ones - 1.0,
        ]
        return np.column_stack([seen, *others])

    def figures(self) -> dict[str, float]:
        """Those that a range is said of."""
        sharpest = float(np.abs(self.curvature).max())
        values = (self.friction, sharpest, self.rod_length, self.stretch_ratio)
        return dict(zip(_RANGE, values, strict=True))


def formula(xp, parameters: dict, features):
    """(n, 3) corrections (forward, left, up) [L_gb] of (n, FEATURES); right turns mirror left turns
    exactly."""
    count = len(WINDOW)
    mirrored = xp.concatenate([-features[:, :count], features[:, count:]], -1)
    one, other = (layers(xp, parameters, x, xp.tanh) for x in (features, mirrored))
    even, odd = 0.5 * (one + other), 0.5 * (one - other)
    return parameters["scale"] * xp.stack([even[:, 0], odd[:, 1], even[:, 2]], -1)


class Corrector(Trained):
    """A trained map from what lies around a contact to the correction of the grip there.

    Attributes:
        metadata: range, seed and figures of the training.
        range: smallest and largest friction [-], largest curvature [1/L_gb], length [L_gb] and k_s
            [-] of what it learnt.
    """

    kind, writer = "Corrector", "distil"

    def _settle(self) -> None:
        self.range = {name: tuple(self.metadata["range"][name]) for name in _RANGE}

    def _probe(self) -> tuple[np.ndarray, ...]:
        return (formula(np, self._parameters, np.zeros((1, FEATURES))).reshape(1, OUTPUTS),)

    @classmethod
    def load(cls, path: str | os.PathLike[str] | None = None) -> Corrector:
        """Read a corrector that `wrod distil` wrote; None is the one that ships.

        Raises:
            DataError: the file is missing, truncated or not a corrector.
        """
        if path is None:
            shipped = resources.files("wrod.scenes") / "controller"
            path = str(shipped / "corrections.safetensors")
        return cls._read(path)

    def predict(self, course: CorrectorInputs) -> np.ndarray:
        """(T, 3) corrections of the grip's position (forward, left, up) in the contact's frame
        [L_gb].

        Warns:
            OutOfRangeWarning: it learnt nothing of the kind.
        """
        outside = [
            f"{name} {value:.3g} ({low:.3g} to {high:.3g})"
            for (name, value), (low, high) in zip(
                course.figures().items(), self.range.values(), strict=True
            )
            if not low <= value <= high
        ]
        if outside:
            warnings.warn(
                f"the corrections were not learnt for {', '.join(outside)} and may be wrong; let "
                "--friction optimise the plan (method 'auto')",
                OutOfRangeWarning,
                stacklevel=2,
            )
        return formula(np, self._parameters, course.features())
