"""Smooth corrections of a grip's path."""

from dataclasses import replace

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from wrod.patterns.curve import smoothstep
from wrod.patterns.pattern import Pattern
from wrod.planning.shapes import contact_frame, led_along
from wrod.planning.trajectory import Trajectory
from wrod.rods.rotation import left_jacobian

# Spacing of the knots of the corrections [L_gb].
_KNOTS = 1.0


class Corrections:
    """Smooth corrections of a trajectory's poses: cubic splines over the laid length from `first`
    to `last` [m], constant beyond. They displace the grip in the frame of the contact (forward,
    left, up) [L_gb] and, unless they are `straight`, turn it by a rotation vector in that frame
    [rad]. `laid` is the laid length at each pose where it is not the trajectory's arc length. Over
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
        straight: bool = False,
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
        # (kind, T, 6) what a value of each kind moves and turns the grip by [m, rad].
        axes = self.frame.transpose(2, 0, 1)
        none = np.zeros_like(axes)
        moves, turns = np.dstack([lgb * axes, none]), np.dstack([none, axes])
        self.axes = moves if straight else np.concatenate([moves, turns])
        self.knots, self.lgb, self.trajectory = self.basis.shape[1], lgb, trajectory

    @property
    def count(self) -> int:
        """Number of values: those of a knot come together."""
        return self.knots * len(self.axes)

    def moves(self, values: np.ndarray) -> np.ndarray:
        """(T, 6) displacement [m] and rotation vector [rad] of the poses in the world frame, of
        values (count,) [L_gb, rad]."""
        return np.einsum("ctd,tk,kc->td", self.axes, self.basis, values.reshape(self.knots, -1))

    def nearest(self, moves: np.ndarray) -> np.ndarray:
        """(knot, n) values that come nearest to (T, n) in their own frames: these are as smooth as
        corrections are."""
        return np.linalg.lstsq(self.basis, moves, rcond=None)[0]

    def columns(self, values: np.ndarray | None = None) -> np.ndarray:
        """(count, T, 6) displacement [m] and spin [rad] of poses that are corrected by values, by
        each of these; without values, of what moves them."""
        rates = np.einsum("ctd,tk->kctd", self.axes, self.basis)
        rates = rates.reshape(-1, *rates.shape[2:])
        if values is not None:
            jacobian = left_jacobian(self.moves(values)[:, 3:])
            rates[..., 3:] = np.einsum("tij,ctj->cti", jacobian, rates[..., 3:])
        return rates

    def cost(self, size: float, roughness: float) -> np.ndarray:
        """(count, count) matrix of the quadratic cost of corrections, a turn of 1 rad as dear as a
        displacement of 1 L_gb; they are constant before the path is corrected, so that to begin
        with a slope is rough."""
        before = np.eye(self.knots)[[0, *range(self.knots)]]
        second = np.diff(before, 2, axis=0)
        one = size / self.knots * np.eye(self.knots) + roughness * second.T @ second
        return np.kron(one, np.eye(len(self.axes)))

    def largest(self, values: np.ndarray) -> dict[str, float]:
        """By how much values displace the grip at most [m], and turn it [rad]."""
        moves = self.moves(values).reshape(-1, 2, 3)
        correction, turn = np.linalg.norm(moves, axis=2).max(axis=0).tolist()
        return {"largest_correction": correction, "largest_turn": turn}

    def apply(self, values: np.ndarray) -> Trajectory:
        """The trajectory with corrected poses; the forces of its grasps no longer hold."""
        return moved(self.trajectory, self.moves(values))


def moved(trajectory: Trajectory, moves: np.ndarray) -> Trajectory:
    """The trajectory with its poses moved by (T, 6) displacement [m] and rotation vector [rad], and
    the shapes of its rod with them; the forces of its grasps no longer hold."""
    turn = Rotation.from_rotvec(moves[:, 3:]).as_matrix()
    shape, twist = trajectory.shape, trajectory.twist
    if twist is not None:  # to first order, as corrections are small
        twist = twist + np.einsum("td,td->t", moves[:, 3:], trajectory.rotation[..., 0])
    return replace(
        trajectory,
        position=trajectory.position + moves[:, :3],
        rotation=turn @ trajectory.rotation if moves[:, 3:].any() else trajectory.rotation,
        force=np.full_like(trajectory.force, np.nan),
        shape=None if shape is None else led_along(shape, moves[:, :3], turn),
        twist=twist,
        metadata={**trajectory.metadata, "contact_friction": None},
    )


def between(start: Trajectory, corrected: Trajectory) -> np.ndarray:
    """(T, 6) by which one is `moved` to the other."""
    turn = Rotation.from_matrix(corrected.rotation @ start.rotation.swapaxes(1, 2))
    return np.hstack([corrected.position - start.position, turn.as_rotvec()])


def with_share(start: Trajectory, corrected: Trajectory, share: float) -> Trajectory:
    """The trajectory that `corrected` began as, with that share of its corrections."""
    out = moved(start, share * between(start, corrected))
    said = dict(corrected.optimised)
    said.pop("rougher", None)  # was of all of them
    said |= {"share": share} | {k: share * said[k] for k in ("largest_correction", "largest_turn")}
    return replace(out, metadata={**corrected.metadata, "optimised": said})
