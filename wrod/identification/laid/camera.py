"""Where the camera stood that took the photographs of laid rods, found from what hangs.

All photographs are taken to be by one camera that looked straight down, off the middle of the
pictures by the same distance. The pattern's dots fix the table's plane; how far what hangs from
the grip is shown from where it hangs tells the three numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from wrod.errors import DataError
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.identification.laid.placement import moved, rigid, seen_from
from wrod.identification.laid.scenario import LaidRod

# Points that are nearest to a place so high above the table tell of the camera [m].
_HANGING = 4e-3
# A point farther than this from the predicted rod says no more [m]: that tail hangs otherwise.
_CAP = 15e-3
# A picture with fewer hanging points counts for less.
_FULL = 30
# Prior: standard deviations of the place about the pictures' middle [m] and of the logarithm of
# the height about 0.7 m, and what one of them is worth against a picture's distance [m].
_PLACE, _HEIGHT, _LOG_HEIGHT, _WORTH = 0.1, 0.7, 0.3, 1e-3
_PRIOR = np.array([_PLACE, _PLACE, _LOG_HEIGHT])
# Placing and finding are repeated until the camera moves less than so far, in its priors' units.
_ROUNDS, _STILL = 6, 0.02
# Where the search begins, about the last camera.
_SIMPLEX = np.vstack([np.zeros(3), np.diag([0.08, 0.08, -0.3])])


@dataclass(frozen=True)
class OverheadCamera:
    """A camera that looks straight down on a table.

    Attributes:
        right, up: place of the point below it from the middle of the picture, in the pattern's
            frame [m].
        height: above the table [m]; infinite: no perspective.
    """

    right: float = 0.0
    up: float = 0.0
    height: float = np.inf

    def below(self, photograph: LaidPhotograph) -> np.ndarray:
        """(2,) the point of the table below the camera [m]."""
        return photograph.middle + np.array([self.right, self.up])

    def view(
        self, photograph: LaidPhotograph, arc_length: np.ndarray, nodes: np.ndarray
    ) -> np.ndarray:
        """(n, 2) what it shows of a rod, on the table's plane [m]; see `seen_from`."""
        return seen_from(arc_length, nodes, self.below(photograph), self.height)


# What is found hangs on where that began, as cameras aside on one line are hardly told apart.
_STARTS = [OverheadCamera(x, y, _HEIGHT) for x in (-0.1, 0.0, 0.1) for y in (-0.1, 0.0, 0.1)]


def begin(photograph: LaidPhotograph, rod: LaidRod) -> tuple[_Tail | None, ...]:
    """What tells of the camera in one picture, by every camera that a search begins at."""
    return tuple(_Tail.of(photograph, rod, camera) for camera in _STARTS)


def find_camera(
    photographs: Sequence[LaidPhotograph],
    rods: Sequence[LaidRod],
    begun: Sequence[tuple[_Tail | None, ...]] | None = None,
) -> OverheadCamera:
    """The camera that brings predicted rods nearest to what is seen hanging.

    Every picture is first placed by one rigid motion, then the sum over pictures of the mean
    distance of the hanging points, each cut at 15 mm, is made least; until the camera stays. It
    begins at the best of nine places, and the best camera of all rounds is taken.

    Args:
        photographs: of laid rods; rods: where a simulation lays each.
        begun: of each, what `begin` returns, where several cameras are found in the same pictures.

    Raises:
        DataError: photographs and rods differ in number, or no point hangs in any picture.
    """
    if len(photographs) != len(rods):
        raise DataError(f"{len(photographs)} photographs and {len(rods)} rods; give one rod each")
    pairs = list(zip(photographs, rods, strict=True))
    if begun is None:
        begun = [begin(*pair) for pair in pairs]
    seen = [_Round.of(camera, [own[k] for own in begun]) for k, camera in enumerate(_STARTS)]
    last = min(seen, key=lambda one: one.least)
    for _ in range(_ROUNDS):
        # Which place of the rod is nearest changes by jumps: no derivatives.
        before = _vector(last.camera)
        found = minimize(
            last.cost, before, method="Nelder-Mead",
            options={"xatol": 1e-3, "fatol": 1e-6, "maxfev": 200,
                     "initial_simplex": before + _SIMPLEX},
        ).x  # fmt: skip
        camera = _camera(found)
        last = _Round.of(camera, [_Tail.of(*pair, camera) for pair in pairs])
        seen.append(last)
        if np.abs((found - before) / _PRIOR).max() < _STILL:
            break
    return min(seen, key=lambda one: one.least).camera


def _camera(x: np.ndarray) -> OverheadCamera:
    return OverheadCamera(float(x[0]), float(x[1]), float(np.exp(x[2])))


def _vector(camera: OverheadCamera) -> np.ndarray:
    return np.array([camera.right, camera.up, np.log(camera.height)])


@dataclass(frozen=True)
class _Round:
    """A camera, and the pictures' hanging points, placed as it shows the rods."""

    camera: OverheadCamera
    tails: list[_Tail]

    @classmethod
    def of(cls, camera: OverheadCamera, tails: Sequence[_Tail | None]) -> _Round:
        heard = [tail for tail in tails if tail is not None]
        if not heard:
            raise DataError("nothing hangs in any photograph, so nothing tells of the camera")
        return cls(camera, heard)

    def cost(self, x: np.ndarray) -> float:
        """What is to be made least, of another camera while the pictures stay."""
        far = sum(tail.weight * tail.miss(_camera(x)) for tail in self.tails)
        off = x / _PRIOR - [0.0, 0.0, np.log(_HEIGHT) / _LOG_HEIGHT]
        return far + _WORTH * float(off @ off)

    @cached_property
    def least(self) -> float:
        return self.cost(_vector(self.camera))


@dataclass(frozen=True)
class _Tail:
    """A picture's hanging points, moved to where the prediction is, and the rod above the table."""

    points: np.ndarray
    nodes: np.ndarray
    middle: np.ndarray
    centre: np.ndarray
    motion: np.ndarray

    @classmethod
    def of(cls, photograph: LaidPhotograph, rod: LaidRod, camera: OverheadCamera) -> _Tail | None:
        if not rod.reached:
            return None
        placed = rigid(photograph, camera.view(photograph, rod.arc_length, rod.nodes))
        count = int(np.ptp(rod.arc_length) / 1e-3) + 2
        fine = rod.at(np.linspace(rod.arc_length[0], rod.arc_length[-1], count))
        points, motion = photograph.points, np.array([placed.turn, *placed.shift])
        one = cls(points, fine, photograph.middle, points.mean(axis=0), motion)
        near = cdist(points, one._shown(camera)).argmin(axis=1)
        hanging = fine[near, 2] > _HANGING
        if not hanging.any():
            return None
        # What lies is seen where it is, whatever the camera; the neighbours above it are kept.
        above = fine[:, 2] > 0.25 * _HANGING
        return replace(one, points=points[hanging], nodes=fine[above])

    @property
    def weight(self) -> float:
        return min(len(self.points) / _FULL, 1.0)

    def miss(self, camera: OverheadCamera) -> float:
        """Mean distance of the points from the rod as the camera shows it [m], each cut."""
        near = cdist(self.points, self._shown(camera)).min(axis=1)
        return float(np.minimum(near, _CAP).mean())

    def _shown(self, camera: OverheadCamera) -> np.ndarray:
        below = self.middle + np.array([camera.right, camera.up])
        high = np.minimum(np.maximum(self.nodes[:, 2], 0.0), 0.7 * camera.height)
        ratio = 1.0 / (1.0 - high / camera.height) if np.isfinite(camera.height) else 1.0 + 0 * high
        curve = below + (self.nodes[:, :2] - below) * ratio[:, None]
        return moved(self.motion, curve, self.centre)
