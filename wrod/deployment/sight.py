"""What a camera sees of a rod while it is laid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrod import arguments
from wrod.deployment.tangents import Laid
from wrod.errors import DataError, RodError

# Points of a rod are no further apart than that much of what is between them along it, and so many
# deviations of noise.
_STRETCHED, _BEYOND = 1.1, 8.0
# Where a point lies against where it is believed to, its neighbours do, but for so many deviations
# of noise and so much of what is between them; up to this share of the points of a picture may be
# no points of the rod.
_APART, _TURNED, _FEW = 5.0, 0.05, 0.25
# Points of which one can be told to be none of the rod.
_LEAST = 4


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

    @classmethod
    def told(
        cls,
        arc_length: np.ndarray,
        place: np.ndarray,
        s: float,
        length: float,
        deviations: tuple[float, float],
        where: str,
    ) -> Seen:
        """What a camera tells when `s` [m] of a rod of such a length [m] is laid: arc lengths (n,)
        and places (n, 2) or (n, 3) [m], with deviations of what lies and of what hangs [m].

        Raises:
            DataError: these are not points of a rod; says in which picture.
        """
        at, place = (
            arguments.floats(value, f"{where}: {name}", DataError)
            for value, name in ((arc_length, "arc lengths"), (place, "points"))
        )
        flat = place.ndim == 2 and place.shape[1] == 2
        if at.ndim != 1 or place.shape not in ((len(at), 2), (len(at), 3)) or not len(at):
            raise DataError(
                f"{where} has arc lengths {at.shape} and points {place.shape}; give (n,) and "
                "(n, 2) or (n, 3), and leave out a picture of nothing"
            )
        if not (np.isfinite(at).all() and np.isfinite(place).all()):
            raise DataError(f"{where} has points that are not finite; leave out what is not seen")
        for deviation, name in zip(deviations, ("noise", "hanging"), strict=True):
            if not 0.0 < deviation < np.inf:
                raise DataError(f"{name} is {deviation!r}; give a positive deviation in metres")
        if at.min() < 0.0 or at.max() > length:
            raise DataError(
                f"{where} has arc lengths from {at.min():.4g} to {at.max():.4g} m on a rod of "
                f"{length:.4g} m"
            )
        order = np.argsort(at, kind="stable")
        order = order[at[order] <= s] if flat else order
        at, place = at[order], np.pad(place[order], ((0, 0), (0, 1 if flat else 0)))
        lies = at <= s
        if not lies.any():
            raise DataError(
                f"{where} has no point that lies, up to {s:.4g} m along the rod; leave it out"
            )
        deviation = np.where(lies[:, None], [deviations[0], deviations[0], np.inf], deviations[1])
        # No two points of a rod are further apart than along it.
        used = np.where(np.isfinite(deviation), place, 0.0)
        apart = np.linalg.norm(np.diff(used, axis=0), axis=1)
        along, noise = np.diff(at), max(deviations)
        far = np.flatnonzero(apart > _STRETCHED * along + _BEYOND * noise)
        if len(far):
            k = int(far[0])
            raise DataError(
                f"{where} has points at {at[k]:.4g} and {at[k + 1]:.4g} m along the rod that are "
                f"{apart[k]:.4g} m apart; give metres, each point with its own arc length"
            )
        return cls(at, place, deviation, int(lies.sum()))

    def smooth(self, residual: np.ndarray, where: str) -> Seen:
        """Without those of what lies that are apart from their neighbours, as no rod is, by what
        they are from where they are believed to lie (laid, 2) [m].

        Raises:
            DataError: these are more than a few.
        """
        n, at = self.laid, self.arc_length[: self.laid]
        if n < _LEAST:
            return self
        steps = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        beside = np.argsort(steps, axis=1, kind="stable")[:, 1:5]
        apart = np.linalg.norm(residual - np.median(residual[beside], axis=1), axis=1)
        far = np.abs(at[beside] - at[:, None]).max(axis=1)
        kept = apart <= _APART * self.deviation[:n, 0] + _TURNED * far
        if n - kept.sum() > _FEW * n:
            raise DataError(
                f"{where} has {n - kept.sum()} of {n} points apart from their neighbours; give "
                "each point with its own arc length"
            )
        one = np.append(kept, np.ones(len(self.arc_length) - n, dtype=bool))
        return Seen(self.arc_length[one], self.place[one], self.deviation[one], int(kept.sum()))


def interpolated(arc_length: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(n, d) values (node, d) at arc lengths (n,)."""
    return np.stack([np.interp(at, arc_length, column) for column in values.T], axis=1)
