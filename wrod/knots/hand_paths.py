"""Ways of hands from place to place."""

from collections.abc import Callable

import numpy as np


def smooth(x: float) -> float:
    """The quintic smoothstep from 0 to 1."""
    x = float(np.clip(x, 0.0, 1.0))
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def hand_path(first: np.ndarray, last: np.ndarray, lift: float) -> Callable[[float], np.ndarray]:
    """A way over everything between two places on the table: up, across, down, rounded.

    Args:
        first, last: (3,) places [m].
        lift: height above them [m].

    Returns:
        The place (3,) at u, 0 to 1.
    """

    def at(u: float) -> np.ndarray:
        across = smooth((u - 0.15) / 0.7)
        rise = min(smooth(u / 0.4), smooth((1.0 - u) / 0.4))
        return first + across * (last - first) + np.array([0.0, 0.0, lift * rise])

    return at


def path_length(path: Callable[[float], np.ndarray]) -> float:
    """Length of a way [m]."""
    points = np.array([path(u) for u in np.linspace(0.0, 1.0, 60)])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
