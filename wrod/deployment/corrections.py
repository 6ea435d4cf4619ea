"""Smooth corrections of a grip's path."""

from dataclasses import replace

import numpy as np
from scipy.interpolate import BSpline

from wrod.patterns.curve import smoothstep
from wrod.patterns.pattern import Pattern
from wrod.planning.shapes import contact_frame, led_along
from wrod.planning.trajectory import Trajectory

# Spacing of the knots of the corrections [L_gb].
_KNOTS = 1.0


class Corrections:
    """Smooth displacements of a trajectory's positions: cubic splines over the laid length from
    `first` to `last` [m], constant beyond, in the frame of the contact (forward, left, up) and in
    L_gb. `laid` is the laid length at each pose where it is not the trajectory's arc length. Over
    the length `rise` [m] from `first` on they come up from nothing, if that is not 0."""

    def __init__(
        self,
        pattern: Pattern,
        trajectory: Trajectory,
        lgb: float,
        first: float,
        laid: np.ndarray | None = None,
        last: float = np.inf,
        rise: float = 0.0,
    ):
        s = trajectory.arc_length
        last = min(last, float(s[-1]))
        on = (s if laid is None else laid) - trajectory.remainder_length
        on = np.clip(on, -pattern.remainder_length, pattern.length)
        self.frame = contact_frame(pattern.sample(on)[1])
        pieces = max(int(np.ceil((last - first) / (_KNOTS * lgb))), 2)
        inner = np.linspace(first, last, pieces + 1)
        knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
        self.basis = BSpline.design_matrix(np.clip(s, first, last), knots, 3).toarray()
        if rise > 0.0:
            self.basis *= smoothstep((s - first) / rise)[:, None]
        self.count, self.lgb, self.trajectory = self.basis.shape[1], lgb, trajectory

    def displacement(self, values: np.ndarray) -> np.ndarray:
        """(T, 3) displacement [m] in the world frame, of values (3 count,) [L_gb]."""
        return self.lgb * np.einsum("tij,tk,kj->ti", self.frame, self.basis, values.reshape(-1, 3))

    def nearest(self, moves: np.ndarray) -> np.ndarray:
        """(count, 3) values [L_gb] that come nearest to (T, 3) in the frame of the contact [L_gb]:
        these are as smooth as corrections are."""
        return np.linalg.lstsq(self.basis, moves, rcond=None)[0]

    def columns(self) -> np.ndarray:
        """(3 count, T, 6) displacement of the poses by each value [m/L_gb]."""
        rates = self.lgb * np.einsum("tij,tk->kjti", self.frame, self.basis)
        return np.pad(rates.reshape(-1, *rates.shape[2:]), ((0, 0), (0, 0), (0, 3)))

    def cost(self, size: float, roughness: float) -> np.ndarray:
        """(3 count, 3 count) matrix of the quadratic cost of corrections; they are constant before
        the path is corrected, so that to begin with a slope is rough."""
        before = np.eye(self.count)[[0, *range(self.count)]]
        second = np.diff(before, 2, axis=0)
        one = size / self.count * np.eye(self.count) + roughness * second.T @ second
        return np.kron(one, np.eye(3))

    def apply(self, values: np.ndarray) -> Trajectory:
        """The trajectory with corrected positions; the forces of its grasps no longer hold."""
        return moved(self.trajectory, self.displacement(values))


def moved(trajectory: Trajectory, displacement: np.ndarray) -> Trajectory:
    """The trajectory with positions displaced by (T, 3) [m], and the shapes of its rod with them;
    the forces of its grasps no longer hold."""
    shape = trajectory.shape
    return replace(
        trajectory,
        position=trajectory.position + displacement,
        force=np.full_like(trajectory.force, np.nan),
        shape=None if shape is None else led_along(shape, displacement),
        metadata={**trajectory.metadata, "contact_friction": None},
    )


def with_share(start: Trajectory, corrected: Trajectory, share: float) -> Trajectory:
    """The trajectory that `corrected` began as, with that share of its corrections."""
    out = moved(start, share * (corrected.position - start.position))
    said = dict(corrected.optimised)
    said.pop("rougher", None)  # was of all of them
    said |= {"share": share, "largest_correction": share * said["largest_correction"]}
    return replace(out, metadata={**corrected.metadata, "optimised": said})
