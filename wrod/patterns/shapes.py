"""Built-in patterns, each a closed-form curvature along the arc length.

A turn eases its curvature in and out with the quintic smoothstep, so curvature and its first two
derivatives are continuous: the friction that a pattern asks for stays finite everywhere.
"""

from math import pi, radians

import numpy as np
from scipy.interpolate import PPoly

from wrod.patterns.curve import heading_of_curvature, heading_of_curve

_SMOOTHSTEP = np.array([6.0, -15.0, 10.0, 0.0, 0.0, 0.0])


def straight(length: float) -> list[tuple[float, float, float]]:
    return [(length, 0.0, 0.0)]


def turn(degrees: float, radius: float, ease: float) -> list[tuple[float, float, float]]:
    """Turn by an angle (left positive) on `radius` [m], eased over `ease` [m] at each end."""
    curvature = np.sign(degrees) / radius
    arc = abs(radians(degrees)) * radius - ease
    if arc < 0.0:
        raise ValueError(f"a turn of {degrees} degrees on {radius} m has no room for two eases")
    return [(ease, 0.0, curvature), (arc, curvature, curvature), (ease, curvature, 0.0)]


def strokes(angle: float, *parts: list[tuple[float, float, float]]) -> tuple[PPoly, np.ndarray]:
    """Heading of a chain of (length, first curvature, last curvature) pieces."""
    pieces = [piece for part in parts for piece in part if piece[0] > 0.0]
    lengths = np.array([piece[0] for piece in pieces])
    coefficients = np.stack(
        [
            (last - first) * _SMOOTHSTEP / length ** np.arange(5.0, -1.0, -1.0)
            + first * np.eye(6)[5]
            for length, first, last in pieces
        ],
        axis=1,
    )
    curvature = PPoly(coefficients, np.concatenate([[0.0], np.cumsum(lengths)]))
    return heading_of_curvature(curvature, radians(angle)), np.zeros(2)


SHAPES = {
    "line": lambda: strokes(0.0, straight(0.5)),
    "circle": lambda: strokes(0.0, [(2 * pi * 0.085, 1 / 0.085, 1 / 0.085)]),
    # From a crest, so that it starts along x: two periods of 0.28 m, amplitude 35 mm.
    "sine": lambda: heading_of_curve(lambda t: (0.28 * t, 0.035 * np.cos(2 * pi * t)), 2.0),
    "letter-U": lambda: strokes(-90.0, straight(0.14), turn(180.0, 0.05, 0.10), straight(0.14)),
    "letter-C": lambda: strokes(130.0, straight(0.02), turn(260.0, 0.07, 0.10), straight(0.02)),
    "letter-L": lambda: strokes(-90.0, straight(0.20), turn(90.0, 0.036, 0.055), straight(0.10)),
    "letter-A": lambda: strokes(
        72.0,
        straight(0.13),
        turn(-144.0, 0.030, 0.07),
        straight(0.13),
        turn(252.0, 0.032, 0.08),
        straight(0.08),
    ),
    "letter-S": lambda: strokes(
        130.0, straight(0.02), turn(225.0, 0.052, 0.10), turn(-225.0, 0.052, 0.10), straight(0.02)
    ),
}
