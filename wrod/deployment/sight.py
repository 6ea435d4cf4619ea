"""What a camera sees of a rod while it is laid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrod import arguments
from wrod.deployment.tangents import Laid
from wrod.errors import RodError


@dataclass(frozen=True)
class Sight:
    """How a camera sees what lies.

    Attributes:
        noise: standard deviation of each coordinate of a point [m].
        spacing: between points along the rod [m].
        hidden: length of rod before and after the contact, and before the grip, that the arm hides
            [m].
        hanging: standard deviation of each of three coordinates of the rod that hangs, as a camera
            at the side measures it [m]; infinite: nothing looks there.
        pictures: of a look, while the grip stands, each with its own noise.
        seed: of the noise.
    """

    noise: float = 0.5e-3
    spacing: float = 0.01
    hidden: float = 0.03
    hanging: float = 1e-3
    pictures: int = 3
    seed: int = 0

    def __post_init__(self) -> None:
        length = arguments.number(0.0, 100.0)
        blind = type(self.hanging) is float and self.hanging == np.inf
        arguments.check_fields(
            self, RodError, noise=length, spacing=arguments.number(1e-4, 100.0), hidden=length,
            hanging=(lambda value: None) if blind else length,
            pictures=arguments.whole(1, 1000), seed=arguments.whole(),
        )  # fmt: skip


@dataclass(frozen=True)
class Seen:
    """Arc lengths (n,) and places (n, 3) of what is seen [m], and deviations (n, 3) of its noise
    [m], infinite for heights of what lies; the first `laid` points lie."""

    arc_length: np.ndarray
    place: np.ndarray
    deviation: np.ndarray
    laid: int

    @classmethod
    def of(cls, laid: Laid, s: float, sight: Sight, rng: np.random.Generator) -> Seen:
        """The rod as the camera sees it when a length `s` [m] is laid."""
        on = np.arange(0.0, s - sight.hidden, sight.spacing)
        off = np.arange(s + sight.hidden, laid.arc_length[-1] - sight.hidden, sight.spacing)
        at = np.concatenate([on, off if np.isfinite(sight.hanging) else off[:0]])
        deviation = np.full((len(at), 3), sight.hanging)
        deviation[: len(on)] = [sight.noise, sight.noise, np.inf]
        noise = np.where(np.isfinite(deviation), deviation, 0.0)
        place = interpolated(laid.arc_length, laid.centerline, at)
        place = place + noise * rng.standard_normal(place.shape)
        return cls(at, place, deviation, len(on))


def interpolated(arc_length: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(n, d) values (node, d) at arc lengths (n,)."""
    return np.stack([np.interp(at, arc_length, column) for column in values.T], axis=1)
