"""The markers' noise in time, slow noise included, from what cannot move: a grip's two markers.

Noise that hangs together from frame to frame looks like motion, except in the distance of two
markers on one rigid body. What that distance varies by is noise: a white part, and one that decays
from frame to frame (AR(1), as cameras leave whose errors change with the place).
"""

from dataclasses import dataclass

import numpy as np

# Slow noise and the mean over a recording are told apart by iteration.
_ROUNDS, _LARGEST = 20, 0.99
# Too few frames to tell a correlation from.
_FEWEST = 20


@dataclass(frozen=True)
class TimeNoise:
    """Noise of a marker's coordinate.

    Attributes:
        white: standard deviation of what is new in every frame [m].
        slow: of what decays over frames [m]; correlation: of that from one frame to the next.
    """

    white: float
    slow: float
    correlation: float

    @property
    def std(self) -> float:
        """Of both [m]."""
        return float(np.hypot(self.white, self.slow))

    def to_dict(self) -> dict[str, float]:
        return {
            "white_mm": 1e3 * self.white,
            "slow_mm": 1e3 * self.slow,
            "slow_correlation": self.correlation,
        }


def noise_in_time(positions: np.ndarray) -> TimeNoise | None:
    """Noise of (recording, frame, marker, 3) positions [m] by the distances of the first two
    markers and of the last two, medians over recordings; None where there are too few frames.

    Sample covariances c_k about a recording's own mean lack the variance of that mean; with it they
    are w + s, s r, s r^2 at lags of 0, 1 and 2 frames.
    """
    frames = positions.shape[1]
    if frames < _FEWEST:
        return None
    apart = np.linalg.norm(positions[:, :, [0, -2]] - positions[:, :, [1, -1]], axis=-1)
    off = apart - apart.mean(axis=1, keepdims=True)
    seen = np.array([np.median((off[:, k:] * off[:, : frames - k]).mean(axis=1)) for k in range(3)])
    lag = np.abs(np.subtract.outer(np.arange(frames), np.arange(frames)))
    mean, slow, white, rho = 0.0, 0.0, seen[0], 0.0
    for _ in range(_ROUNDS):
        c = seen + mean
        rho = float(np.clip(c[2] / c[1], 0.0, _LARGEST)) if c[1] > 0.0 else 0.0
        slow = min(c[1] / rho, c[0]) if rho > 0.0 else 0.0
        white = c[0] - slow
        mean = slow * (rho**lag).mean() + white / frames
    # Two markers err.
    return TimeNoise(float(np.sqrt(0.5 * white)), float(np.sqrt(0.5 * slow)), rho)
