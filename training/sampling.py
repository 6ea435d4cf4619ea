"""Where the grasp map is sampled: low-discrepancy points, dense where the map bends most.

Inputs are dimensionless, in the order (l_s [L_gb], kappa [1/L_gb], k_s [-]), kappa >= 0: right
turns are mirror images of left turns.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import qmc

from wrod.errors import DataError, RodError, WrodWarning
from wrod.planning.roll import TILT
from wrod.rods.model import Rod, RodModel

INPUTS = ("suspended_length", "curvature", "stretch_ratio")
# What the controller is made for (Sec. Training the Neural Controller covers the same rods).
RANGE = {
    "suspended_length": (1.0, 50.0),
    "curvature": (0.0, 3.5),
    "stretch_ratio": (150.0, 15000.0),
}
# How far a controller of one rod may be asked beside that rod's k_s.
_SAME_STRETCH = 1e-3
# Samples reach a little over the range, so that its faces are interpolated as well.
_SAMPLED = {
    "suspended_length": (0.94, 53.0),
    "curvature": (0.0, 3.65),
    "stretch_ratio": (135.0, 16500.0),
}
# How far beyond a rod's own lengths its samples reach.
_BEYOND = 1.06
_LOG_SHARE = 0.7
# What a rod may have of its own and still be known to a controller.
_OF_NO_MATTER = (
    "internal_damping", "relaxation_time", "air_damping", "quadratic_drag", "stretching_stiffness"
)  # fmt: skip
MAX_INDEX = 2**30


@dataclass(frozen=True)
class RodInputs:
    """What every sample of one rod's dataset has in common, dimensionless.

    Attributes:
        length: of the rod [L_gb].
        stretch_ratio: k_s [-].
        natural_curvature: (left, up) of the rod as it is laid [1/L_gb].
        poisson: Poisson's ratio.
    """

    length: float
    stretch_ratio: float
    natural_curvature: tuple[float, float] = (0.0, 0.0)
    poisson: float = 0.5

    @classmethod
    def of(cls, rod: Rod, roll: float | str = "plane") -> RodInputs:
        """A rod laid with this roll of its first director from left to up [rad]; "plane", "up" and
        "tilted" turn its natural curvature to the left, upwards, or 30 degrees up from the left.

        Raises:
            RodError: its grasps depend on more than these inputs.
        """
        stretch_ratio = rod.stretch_ratio
        if isinstance(rod, RodModel):
            # How a rod is damped does not change its grasps, how it stretches is an input.
            aside = [n for n in rod.not_uniform() if n not in _OF_NO_MATTER]
            if aside or not rod.stretching_stiffness.is_constant:
                raise RodError(
                    "a controller learns the grasps of a uniform, isotropic, linear rod, and this "
                    f"one has its own {', '.join(aside or ['stretching_stiffness'])}; `wrod plan` "
                    "solves such a rod's grasps without a controller"
                )
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", WrodWarning)
                rod = rod.material()
        lgb, size = rod.gravito_bending_length, math.hypot(*rod.natural_curvature)
        raised = {"up": 0.5 * math.pi, "plane": 0.0, "tilted": TILT}  # [rad]
        if isinstance(roll, str):
            held = size * math.cos(raised[roll]), size * math.sin(raised[roll])
        else:
            held = rod.curvature_held(roll)
        own = (float(lgb * held[0]), float(lgb * held[1]))
        return cls(rod.length / lgb, stretch_ratio, own, rod.poisson)

    @property
    def range(self) -> dict[str, tuple[float, float]]:
        """Smallest and largest of each input that a controller of this rod is made for."""
        low, high = RANGE["suspended_length"]
        ks = self.stretch_ratio
        return {
            "suspended_length": (low, min(high, max(self.length, 2.0 * low))),
            "curvature": RANGE["curvature"],
            "stretch_ratio": (ks * (1.0 - _SAME_STRETCH), ks * (1.0 + _SAME_STRETCH)),
        }

    @property
    def is_straight(self) -> bool:
        return tuple(self.natural_curvature) == (0.0, 0.0)


def sample(first: int, count: int, seed: int, rod: RodInputs | None = None) -> np.ndarray:
    """(count, 3) inputs number `first`, `first` + 1, ... of the scrambled Sobol' sequence `seed`.

    With `rod` they are that rod's: lengths up to its own, its k_s, and curvatures of either sign
    where it is naturally curved, for then right turns are no mirror images.

    Every input depends on its number and the seed alone, however the sequence is cut up.

    Raises:
        DataError: the sequence has no such numbers.
    """
    if first < 0 or count < 0 or first + count > MAX_INDEX:
        raise DataError(f"samples {first} to {first + count} asked for; there are {MAX_INDEX}")
    sequence = qmc.Sobol(d=3, scramble=True, bits=30, rng=np.random.default_rng(seed))
    if count == 0:
        return np.empty((0, 3))
    # SciPy warns where a first draw is no power of two; one point is.
    head = sequence.random(1) if first == 0 else np.empty((0, 3))
    if first:
        sequence.fast_forward(first)
    return to_inputs(np.concatenate([head, sequence.random(count - len(head))]), rod)


def to_inputs(unit: np.ndarray, rod: RodInputs | None = None) -> np.ndarray:
    """(n, 3) inputs of points of the unit cube.

    The map bends most where the rod is short: l_s has the density a / l_s + b. It depends on k_s
    through powers of 1 / k_s, hence log-uniform, and on kappa evenly.
    """
    low, high = _SAMPLED["suspended_length"]
    if rod is not None:
        high = min(high, max(_BEYOND * rod.length, 2.0 * low))
    # The distribution function of a mixture has no inverse in closed form: tabulate it.
    length = np.geomspace(low, high, 4097)
    share = _LOG_SHARE * np.log(length / low) / np.log(high / low)
    share += (1.0 - _LOG_SHARE) * (length - low) / (high - low)
    ls = np.interp(unit[:, 0], share, length)
    low, high = _SAMPLED["curvature"]
    kappa = low + (high - low) * unit[:, 1]
    if rod is not None:
        if not rod.is_straight:
            kappa = high * (2.0 * unit[:, 1] - 1.0)
        return np.stack([ls, kappa, np.full(len(unit), rod.stretch_ratio)], axis=1)
    low, high = _SAMPLED["stretch_ratio"]
    return np.stack([ls, kappa, low * (high / low) ** unit[:, 2]], axis=1)


def sample_worst(
    inputs: np.ndarray, error: np.ndarray, first: int, count: int, seed: int
) -> np.ndarray:
    """(count, 3) new inputs where a model errs most.

    Args:
        inputs: (n, 3) where the model was validated.
        error: (n,) its errors there.
        first: number of the first candidate in the sequence; those before are known.
        count: inputs wanted; four times as many candidates compete.
        seed: of the sequence.
    """
    candidates = sample(first, 4 * count, seed)
    _, nearest = cKDTree(_even(inputs)).query(_even(candidates))
    # The Gumbel trick draws without replacement in proportion to the error.
    noise = np.random.default_rng((seed, first)).gumbel(size=len(candidates))
    score = np.log(error[nearest] + 1e-12) + noise
    return candidates[np.sort(np.argsort(-score)[:count])]


def _even(inputs: np.ndarray) -> np.ndarray:
    """Coordinates in which the samples lie about evenly."""
    return np.stack([np.log(inputs[:, 0]), inputs[:, 1], 0.3 * np.log(inputs[:, 2])], axis=1)
