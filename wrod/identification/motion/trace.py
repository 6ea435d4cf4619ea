"""What the residual of a motion looks like as mechanics, before any effect is fitted: the missing
force, a field along the rod in every frame, and prints, ways for it to come about.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wrod.identification.clamped.trace import Print
from wrod.identification.effect import Model
from wrod.identification.motion.data import MotionMeasurements
from wrod.identification.motion.inverse import InverseMotion, inverse_motion
from wrod.identification.motion.prints import find_prints
from wrod.identification.motion.tension import base_setup

# Time between two frames that are looked at, in all recordings and in the one that is shown [s].
_SPACING, _SHOWN_SPACING = 0.2, 0.02
# Edges between neighbouring markers: nothing is integrated, so the mesh may be finer than a fit's,
# whose own error would look like a stiffness.
_SUBDIVISIONS = 4
# Distances that markers may seem to sit from where the model puts them [m]; below the first a mesh
# cannot be trusted.
_PLACEMENTS = 1e-3 * np.array([0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0])
# Sizes that the missing force may have in a frame, over the weight.
_SIZES = np.logspace(-2, 1.5, 43)


@dataclass(frozen=True)
class MissingForce:
    """The force per length that a model lacks, over the rod's weight per length.

    Attributes:
        recording, frame: (S,) where it was looked at.
        arc_length: (K,) of the markers from one grip to the other [m].
        laboratory: (S, K, 3) along x, y, z.
        material: (S, K, 3) along m1, m2 and the tangent.
        size: (S,) root of its mean square in a frame, as the likeliest prior has it.
        stderr: (K,) how well a component is known in one frame.
    """

    recording: np.ndarray
    frame: np.ndarray
    arc_length: np.ndarray
    laboratory: np.ndarray
    material: np.ndarray
    size: np.ndarray
    stderr: np.ndarray

    def mean(self, frame: str) -> tuple[np.ndarray, np.ndarray]:
        """(K, 3) mean over all frames in the "laboratory" or "material" frame, and its standard
        error from the scatter between recordings."""
        value = getattr(self, frame)
        names = np.unique(self.recording)
        means = np.stack([value[self.recording == r].mean(axis=0) for r in names])
        scatter = means.std(axis=0, ddof=1) if len(names) > 1 else np.full(means[0].shape, np.nan)
        return means.mean(axis=0), scatter / np.sqrt(len(names))


@dataclass(frozen=True)
class MotionTrace:
    """The evidence before any fit.

    Attributes:
        force: what the base model lacks in frames of all recordings that were looked at.
        shown: the same in one recording, closely.
        prints: ways for it to come about, the most telling first.
        steps: (names, share) as the print that adds most joins those before it.
        remaining: share of what the first step leaves that each other print takes away, by name.
        unexplained: (S,) size of what no print takes away, over the weight.
        placement: how far the markers seem to sit beside the centreline [m].
    """

    force: MissingForce
    shown: MissingForce
    prints: tuple[Print, ...]
    steps: tuple[tuple[tuple[str, ...], float], ...]
    remaining: dict[str, float]
    unexplained: np.ndarray
    placement: float

    def to_dict(self) -> dict:
        """The part `trace` of `report.json`."""
        force = self.force
        return {
            "missing_force": {
                "unit": "weight of the rod per length",
                "frames": len(force.frame),
                "size": _percentiles(force.size),
                "size_that_no_print_takes_away": _percentiles(self.unexplained),
                "arc_length": force.arc_length.tolist(),
                "mean_in_laboratory": _with_error(*force.mean("laboratory")),
                "mean_in_material": _with_error(*force.mean("material")),
            },
            "marker_placement_mm": 1e3 * self.placement,
            "prints": [p.to_dict() for p in self.prints],
            "together": [{"prints": list(names), "share": share} for names, share in self.steps],
            "share_of_what_the_first_leaves": self.remaining,
        }


def trace_motion(
    measurements: MotionMeasurements,
    base: Model,
    values: np.ndarray,
    recordings,
    shown: int,
    *,
    device: str = "cpu",
) -> MotionTrace | None:
    """The missing force and the prints of recordings, about a base model; None where recordings
    are too short, or too broken by lost frames, to tell accelerations.

    Args:
        base, values: the base model.
        recordings: those to look at.
        shown: a recording to look at closely.
    """
    m = measurements
    setup = base_setup(m, _SUBDIVISIONS)
    setup = base.setup(setup, values)
    seen = inverse_motion(m, setup, recordings, _every(_SPACING, m), device=device)
    if seen is None:
        return None
    if shown not in seen.recording:
        shown = int(seen.recording[0])
    weighed = _Field(seen, m, _smooth)
    prints, steps, remaining = find_prints(seen, weighed.arc_length, weighed.weigh)
    # What a print takes away is no misplaced marker.
    placement = weighed.placement
    close = inverse_motion(m, setup, [shown], _every(_SHOWN_SPACING, m), device=device)
    force, shown_force = (_Field(s, m, _rough, placement).missing_force() for s in (seen, close))
    return MotionTrace(force, shown_force, prints, steps, remaining, weighed.size, placement)


def _every(spacing: float, m: MotionMeasurements) -> int:
    return max(1, round(spacing * m.rate))


def _smooth(place: np.ndarray) -> np.ndarray:
    """(K, K) correlation of what no print takes away: alike over a fifth of the rod, so that what
    is rougher counts as a marker beside its place."""
    distance = place[:, None] - place
    return np.exp(-0.5 * (distance / (0.2 * place[-1])) ** 2) + 1e-9 * np.eye(len(place))


def _rough(place: np.ndarray) -> np.ndarray:
    """(K, K) correlation of the force that is shown: a kink's changes sign between markers."""
    return np.exp(-np.abs(place[:, None] - place) / np.diff(place).mean())


class _Field:
    """A force in every frame on its own, as the prior of what is missing.

    Its size is the likeliest for the frame, so that a frame of slow motion counts as much as one of
    fast.

    Args:
        correlation: along the rod, out of the markers' arc lengths.
        placement: distance that markers sit from where the model puts them [m]; default: the
            likeliest.
    """

    def __init__(
        self,
        seen: InverseMotion,
        m: MotionMeasurements,
        correlation: Callable,
        placement: float | None = None,
    ):
        self.seen = seen
        setup, place = seen.setup, seen.setup.marker_node[1:-1]
        n = seen.velocity.shape[1]
        self.arc_length = m.marker_arc_length[1:-1] - m.marker_arc_length[1]
        hats = np.stack([np.interp(np.arange(n), place, e) for e in np.eye(len(place))], 1)
        weight = np.linalg.norm(setup.gravity) * setup.node_length
        nodal = np.einsum("n,nk,ce->ncke", weight, hats, np.eye(3)).reshape(n, 3, -1)
        self.see = seen.force(np.broadcast_to(nodal, (len(seen.frame), *nodal.shape)))
        self.prior = np.kron(correlation(self.arc_length), np.eye(3))
        columns = (4 * setup.marker_node[:, None] + np.arange(3)).ravel()
        moved = seen.stiffness[:, :, columns]
        self.moved = moved @ moved.transpose(0, 2, 1)
        self.expected = self.see @ self.prior @ self.see.transpose(0, 2, 1)
        self.fit(seen.missing, placement)

    def fit(self, missing: np.ndarray, placement: float | None = None) -> None:
        """Give the field, and the markers' places, the sizes that make `missing` likeliest."""
        noise = self.seen.noise
        tried = [
            (_likeliest(noise + error**2 * self.moved, self.expected, missing), error)
            for error in (_PLACEMENTS if placement is None else [placement])
        ]
        (_, self.size), self.placement = min(tried, key=lambda t: t[0][0])
        self.covariance = noise + self.placement**2 * self.moved
        self.covariance += self.size[:, None, None] ** 2 * self.expected
        self.root = np.linalg.cholesky(self.covariance)

    def weigh(self, missing: np.ndarray):
        """For `find_prints`."""
        self.fit(missing)
        noise = np.linalg.solve(self.root, np.linalg.cholesky(self.seen.noise))
        return self.whiten, np.sum(noise**2, axis=(1, 2))

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """(S, Q, ...) over the square root of what is expected of noise and missing force."""
        flat = columns.reshape(*columns.shape[:2], -1)
        return np.linalg.solve(self.root, flat).reshape(columns.shape)

    def missing_force(self) -> MissingForce:
        """The likeliest field of every frame."""
        seen, place = self.seen, self.seen.setup.marker_node[1:-1]
        prior = self.size[:, None, None] ** 2 * self.prior
        gain = np.linalg.solve(self.covariance, self.see @ prior).transpose(0, 2, 1)
        force = np.einsum("skq,sq->sk", gain, seen.missing).reshape(len(gain), -1, 3)
        variance = np.diagonal(prior - gain @ self.see @ prior, axis1=1, axis2=2)
        variance = variance.reshape(len(gain), -1, 3).mean(axis=(0, 2))
        own = np.einsum("skij,ski->skj", seen.frames[:, place], force)
        stderr = np.sqrt(np.maximum(variance, 0.0))
        return MissingForce(
            seen.recording, seen.frame, self.arc_length, force, own, self.size, stderr
        )


def _likeliest(noise, expected, missing) -> tuple[float, np.ndarray]:
    """Misfit, and size (S,) of a field of covariance `expected` that makes each frame likeliest."""
    root = np.linalg.cholesky(noise)
    white = np.linalg.solve(root, expected)
    size, vectors = np.linalg.eigh(np.linalg.solve(root, white.transpose(0, 2, 1)))
    seen = np.einsum("sqk,sq->sk", vectors, np.linalg.solve(root, missing[..., None])[..., 0])
    total = 1.0 + _SIZES[:, None, None] ** 2 * np.maximum(size, 0.0)
    misfit = np.sum(seen**2 / total + np.log(total), axis=2)
    volume = 2.0 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum()
    return float(misfit.min(axis=0).sum() + volume), _SIZES[np.argmin(misfit, axis=0)]


def _percentiles(values: np.ndarray) -> dict[str, float]:
    found = np.percentile(values, [10, 50, 90]).tolist()
    return dict(zip(("p10", "median", "p90"), found, strict=True))


def _with_error(value: np.ndarray, stderr: np.ndarray) -> dict[str, list]:
    return {"value": value.tolist(), "stderr": np.nan_to_num(stderr).tolist()}
