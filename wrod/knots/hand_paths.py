"""Ways of hands from place to place."""

from collections.abc import Callable

import numpy as np

from wrod.patterns.curve import arc_length, smoothstep


def hand_path(first: np.ndarray, last: np.ndarray, lift: float) -> Callable[[float], np.ndarray]:
    """A way over everything between two places on the table: up, across, down, rounded.

    Args:
        first, last: (3,) places [m].
        lift: height above them [m].

    Returns:
        The place (3,) at u, 0 to 1.
    """

    def at(u: float) -> np.ndarray:
        across = smoothstep((u - 0.15) / 0.7)
        rise = min(smoothstep(u / 0.4), smoothstep((1.0 - u) / 0.4))
        return first + across * (last - first) + np.array([0.0, 0.0, lift * rise])

    return at


def path_length(path: Callable[[float], np.ndarray]) -> float:
    """Length of a way [m]."""
    return float(arc_length(np.array([path(u) for u in np.linspace(0.0, 1.0, 60)]))[-1])
