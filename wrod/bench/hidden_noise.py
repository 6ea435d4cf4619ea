"""Noise of many kinds on sets whose rods are known: what an identification must not take for a rod.

Every kind has the declared size; `pose` and `outliers` add what nobody declares.
"""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

# Of reported poses: position [m], rotation [rad].
_POSITION, _ROTATION = 5e-4, np.radians(0.5)
_OUTLIERS, _FAR = 0.01, 12.0

Data = dict[str, np.ndarray]


def _plain(rng, data: Data) -> np.ndarray:
    return rng.normal(size=data["centerline"].shape)


def _along_the_rod(rho: float) -> Callable:
    """Neighbouring markers err together: AR(1)."""

    def noise(rng, data):
        e = _plain(rng, data)
        for m in range(1, e.shape[1]):
            e[:, m] = rho * e[:, m - 1] + np.sqrt(1.0 - rho**2) * e[:, m]
        return e

    return noise


def _outliers(rng, data):
    """One marker in a hundred is somewhere else."""
    e = _plain(rng, data)
    return np.where(rng.random(e.shape[:2])[..., None] < _OUTLIERS, _FAR * e, e)


def _heavy_tails(rng, data):
    """Student's t with 4 degrees of freedom, of the declared variance."""
    return rng.standard_t(4, size=data["centerline"].shape) / np.sqrt(2.0)


def _pose(rng, data):
    """Poses are reported half a millimetre and half a degree off, anew in each trial."""
    trials = len(data["centerline"])
    for end in ("clamp", "grip"):
        data[f"{end}_position"] = data[f"{end}_position"] + _POSITION * rng.normal(size=(trials, 3))
        turn = Rotation.from_rotvec(_ROTATION * rng.normal(size=(trials, 3))).as_matrix()
        data[f"{end}_rotation"] = data[f"{end}_rotation"] @ turn
    return _plain(rng, data)


NOISES: dict[str, Callable] = {
    "white": _plain,
    "correlated-0.7": _along_the_rod(0.7),
    "correlated-0.8": _along_the_rod(0.8),
    "correlated-0.9": _along_the_rod(0.9),
    "outliers": _outliers,
    "heavy-tails": _heavy_tails,
    "pose": _pose,
}


def with_noise(data: Data, kind: str, seed: int) -> Data:
    """Measurements without noise of the markers, and then with it."""
    rng = np.random.default_rng([seed, 1])
    data = dict(data)
    noise = NOISES[kind](rng, data)
    data["centerline"] = data["centerline"] + float(data["noise_std"]) * noise
    return data
