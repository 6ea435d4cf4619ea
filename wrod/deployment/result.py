"""What a simulated deployment left on the table, and how far that is from the pattern."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path

import numpy as np

from wrod.arguments import checked
from wrod.errors import DataError
from wrod.files import check_arrays, read_fields, suffixed, write_npz
from wrod.patterns.pattern import Pattern
from wrod.records import brief, freeze

# Points of the accuracy metric (Eq. metric, N = 50).
METRIC_POINTS = 50
_FORMAT = "wrod-deployment-1"


@brief
@dataclass(frozen=True, eq=False)
class Deployment:
    """A simulated deployment. SI units; heights are those of the pattern's plane, in which the
    centreline of a rod lies that rests on the table.

    Attributes:
        arc_length: (node,) rest arc length from the free end, including a remainder [m].
        centerline: (node, 3) the rod at the end of the pattern, the grip still holding [m].
        error_mean, error_std: e_mean and sigma (Eq. metric) of that rod: horizontal distances
            between points of the same arc length on pattern and rod [m].
        released_centerline, released_error_mean, released_error_std: the same after the grip laid
            the tail down and let go.
        contact_force: (node, 3) force of table and fixtures on each node, the grip still holding
            [N].
        slip: (node,) how far each node slid on the table until then [m].
        diverged: no step converged any more; everything above is from the last good step.
        duration: simulated time [s].
        steps: time steps taken.
        frames: (frame, node, 3) the rod at the multiples of the frame interval [m], or None.
        hand: (frame, 4, 4) pose of the grip, x along the rod, at the same times [m], or None.
        let_go: when it let go [s], or None.
        released_speed: speed of the fastest node when the released rod is measured [m/s].
        penetration: how deep the rod is then in any fixture [m].

    Raises:
        DataError: an array is not as docs/formats.md has it of a deployment's file.
    """

    arc_length: np.ndarray
    centerline: np.ndarray
    error_mean: float
    error_std: float
    released_centerline: np.ndarray
    released_error_mean: float
    released_error_std: float
    contact_force: np.ndarray
    slip: np.ndarray
    diverged: bool
    duration: float
    steps: int
    frames: np.ndarray | None = None
    hand: np.ndarray | None = None
    let_go: float | None = None
    released_speed: float = 0.0
    penetration: float = 0.0

    def __post_init__(self):
        freeze(self, check_arrays(self._present(), "Deployment", "Deployment"))

    def _present(self) -> dict:
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {"format": _FORMAT} | {k: v for k, v in values.items() if v is not None}

    @checked(DataError)
    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write everything as an NPZ file (a suffix .csv or .npz of `path` is replaced)."""
        return write_npz(suffixed(path, ".npz"), units="SI: m, N, s", **self._present())

    @classmethod
    @checked(DataError)
    def load(cls, path: str | os.PathLike[str]) -> Deployment:
        """Read what `save` wrote.

        Raises:
            DataError: the file is missing, truncated or not a deployment.
        """
        return cls(**read_fields(path, "Deployment"))


def errors_along(
    pattern: Pattern, arc_length: np.ndarray, centerline: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Arc length on the pattern (50,) and horizontal distance there (50,) between the pattern and
    the rod's point of the same arc length [m].

    Args:
        pattern: with its remainder, on which no points are taken.
        arc_length: (node,) arc length from the free end [m].
        centerline: (node, 3) [m].
    """
    s, target = metric_points(pattern)
    on_rod = [
        np.interp(s + pattern.remainder_length, arc_length, centerline[:, c]) for c in range(2)
    ]
    return s, np.hypot(*(np.array(on_rod) - target[:, :2].T))


@lru_cache(maxsize=256)
def metric_points(pattern: Pattern) -> tuple[np.ndarray, np.ndarray]:
    """Arc length (50,) and position (50, 3) [m]; a pattern is laid again and again."""
    s = np.linspace(0.0, pattern.length, METRIC_POINTS)
    return s, pattern.sample(s)[0]


def deployment_error(
    pattern: Pattern, arc_length: np.ndarray, centerline: np.ndarray
) -> tuple[float, float]:
    """e_mean and sigma [m] (Eq. metric, N = 50) of a rod, as a camera above sees it; arguments as
    those of `errors_along`."""
    error = errors_along(pattern, arc_length, centerline)[1]
    return float(error.mean()), float(error.std())


def interpolation(at: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(point, node) weights that interpolate linearly between ascending nodes (node,) at (point,),
    beyond them along the last edges."""
    i = np.clip(np.searchsorted(nodes, at) - 1, 0, len(nodes) - 2)
    share = (at - nodes[i]) / (nodes[i + 1] - nodes[i])
    out = np.zeros((len(at), len(nodes)))
    rows = np.arange(len(at))
    out[rows, i], out[rows, i + 1] = 1.0 - share, share
    return out
