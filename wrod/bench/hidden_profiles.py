"""Clamped rods on which one quantity changes along the rod by another law than any plug-in's.

A straight line or a constant may come near enough to such a rod to leave little more than noise,
with numbers that are wrong. What is right is a profile; a stretch that is built comes near to a
step or a bump.
"""

from collections.abc import Callable

import numpy as np

from wrod.bench.continuous_rod import Experiment, tangent_turn
from wrod.bench.hidden_effects import Hidden, Truth, _between, _in_plane, stiff_along
from wrod.identification.clamped.profiles import KNOTS


def _quadratic(rng) -> Callable:
    return np.square


def _step(rng) -> Callable:
    place = _between(rng, 0.4, 0.6)
    return lambda u: 1.0 / (1.0 + np.exp((place - u) / 0.03))


def _bump(rng) -> Callable:
    place, width = _between(rng, 0.35, 0.65), _between(rng, 0.12, 0.2)
    return lambda u: np.exp(-0.5 * ((u - place) / width) ** 2)


def _half_taper(rng) -> Callable:
    return lambda u: 0.03 * np.logaddexp(0.0, (2.0 * u - 1.0) / 0.03)


_SHAPES = {"quadratic": _quadratic, "step": _step, "bump": _bump, "half taper": _half_taper}


def _drawn(rng, shape: str, length: float) -> Callable:
    """From arc lengths (K,) to (K,) values from about 0 to about 1, rising or falling."""
    law, falling = _SHAPES[shape](rng), rng.random() < 0.5
    return lambda s: law(1.0 - s / length if falling else s / length)


def _truth(name: str, rod, **profiles: Callable) -> dict[str, Truth]:
    """What a report says of profiles at knots."""
    places = np.linspace(0.0, rod.length, KNOTS)
    return {
        name: {
            (f"{key}_at_{1e3 * s:.0f}_mm",): (float(value),)
            for key, profile in profiles.items()
            for s, value in zip(places, profile(places), strict=True)
        }
    }


def _stiffness(rng, rod, shape: str) -> Hidden:
    size, change = _drawn(rng, shape, rod.length), rng.choice([-1.0, 1.6])
    change *= rng.uniform(0.35, 0.55)

    def factor(s):
        return 1.0 + change * size(s)

    return Hidden(stiff_along(factor), _truth("profile_of_stiffness", rod, stiffness_ratio=factor))


def _curvature(rng, rod, shape: str) -> Hidden:
    size = _drawn(rng, shape, rod.length)
    vector = _in_plane(rng, 0.3, 0.55) / rod.gravito_bending_length

    def curvature(s):
        return vector[:, None] * size(s)

    # As the profile's report has them.
    first, second = tangent_turn(vector)[:, None] * np.ones(1)
    told = {
        "curvature_1": lambda s: first * size(s),
        "curvature_2": lambda s: second * size(s),
    }
    return Hidden(Experiment(curvature=curvature), _truth("profile_of_curvature", rod, **told))


def _weight(rng, rod, shape: str) -> Hidden:
    size, gain = _drawn(rng, shape, rod.length), rng.choice([-0.8, 1.6])
    gain *= rng.uniform(0.35, 0.55)
    line = rod.weight / rod.gravity
    told = _truth("profile_of_weight", rod, weight_ratio=lambda s: 1.0 + gain * size(s))
    return Hidden(Experiment(mass=lambda s: gain * line * size(s)[None]), told)


PROFILES: dict[str, Callable] = {
    f"{quantity}, {shape}": lambda rng, rod, of=of, shape=shape: of(rng, rod, shape)
    for quantity, of in (("stiffness", _stiffness), ("curvature", _curvature), ("weight", _weight))
    for shape in _SHAPES
}
