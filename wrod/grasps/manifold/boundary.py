"""The boundary of the manifold of grasps (paper, Alg. bisection). Dimensionless."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wrod import arguments
from wrod.errors import GraspError
from wrod.grasps.held_rods import HeldRods
from wrod.grasps.inputs import check_inputs
from wrod.grasps.manifold.grips import EDGE_COUNT, grasp_shapes, in_chunks, taut_position
from wrod.rods.device import resolve_device

# How a ray ends at its low end.
DIPS, TOUCHES, FOLDS, EMPTY = 0, 1, 2, 3
# The rod goes under the table nearer to the contact than this, or further along [L_gb].
_AT_CONTACT = 0.5
_TOLERANCE = 1e-4  # of the suspended length
_SMALLEST_RADIUS = 0.02  # of the suspended length
_FIRST_STEP, _STEP_GROWTH, _LARGEST_STEP = 0.004, 1.5, 0.04
_MAX_STEPS = 80


@dataclass(frozen=True)
class Boundary:
    """Where rays from the contact enter and leave the manifold of grasps of a straight pattern.

    Attributes:
        suspended_length, stretch_ratio: (m,) inputs.
        angle: (k,) angle of each ray from the pattern's tangent [rad].
        tight: (m, k) largest distance: beyond it the rod pulls up at the contact, F_z < 0 (region
            I) [L_gb].
        low: (m, k) smallest distance of the interval below `tight`: below it the rod goes under
            the table (region III), or cannot be followed past a fold [L_gb].
        kind: (m, k) how the low end comes about: the rod DIPS at the contact, TOUCHES the table
            further along, or FOLDS; EMPTY where no distance is admissible, and tight equals low.
    """

    suspended_length: np.ndarray
    stretch_ratio: np.ndarray
    angle: np.ndarray
    tight: np.ndarray
    low: np.ndarray
    kind: np.ndarray


def boundary(
    suspended_length,
    stretch_ratio,
    angle=None,
    *,
    device: arguments.DeviceLike = None,
    edge_count: int = EDGE_COUNT,
    threads: int | None = None,
    progress: Callable[[int], object] | None = None,
) -> Boundary:
    """Boundary of the manifold for every pair (l_s, k_s), all rays in one batch.

    On each ray the rod is pulled taut and let in. Both ends are bracketed and then found to 1e-4
    of the suspended length by bisection, sped up by secants (Illinois).

    Args:
        suspended_length, stretch_ratio: broadcast to (m,).
        angle: (k,) rays, within (0, pi) [rad]; default: every 5 degrees.
        device, edge_count, threads, progress: as in `equilibrium`; progress counts rays.

    Raises:
        GraspError: inputs that are not finite or out of range.
    """
    ls, _, ks = check_inputs(suspended_length, 0.0, stretch_ratio)
    angle = np.radians(np.arange(5.0, 176.0, 5.0)) if angle is None else np.atleast_1d(angle)
    if angle.ndim != 1 or not np.all((angle > 0.0) & (angle < np.pi)):
        raise GraspError("the angles of rays must be within (0, pi)")
    device = resolve_device(device)
    shapes = grasp_shapes(ls, np.zeros_like(ls), ks, edge_count, device, threads)
    rays = np.tile(angle, len(ls))
    owner = np.repeat(np.arange(len(ls)), len(angle))

    def solve(chunk: slice):
        mine = owner[chunk]
        rods = HeldRods(ls[mine], ks[mine], shapes[mine], device=device)
        found = Rays(rods, rays[chunk]).search()
        if progress is not None:
            progress(len(mine))
        return found

    parts = in_chunks(solve, len(rays), device, threads)
    table = (len(ls), len(angle))
    tight, low, kind = (np.concatenate(list(x)).reshape(table) for x in zip(*parts, strict=True))
    return Boundary(ls, ks, angle, tight, low, kind)


class Rays:
    """Rods whose grips stand on rays from the contact, one rod a ray."""

    def __init__(self, rods: HeldRods, angle: np.ndarray):
        self.rods, self.length = rods, rods.length
        self.direction = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=1)
        self.radius = np.zeros(len(angle))

    def pull_taut(self) -> None:
        """From wherever the rods stand to taut on their rays."""
        everyone = np.ones(len(self.radius), dtype=bool)
        self.rods.continue_to(self.rods.grip_position())
        position = taut_position(self.direction * self.length[:, None], self.length)
        self.move(np.linalg.norm(position, axis=1), everyone)

    def move(self, radius: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Lead the chosen rods to a distance; (n,) bool: who arrived."""
        arrived = self.rods.continue_to(self.direction * radius[:, None], chosen)
        self.radius = np.linalg.norm(self.rods.grip_position(), axis=1)
        return arrived

    def vertical_force(self) -> np.ndarray:
        return self.rods.force()[:, 2]

    def search(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(n,) tight and low distances and how the low end comes about."""
        self.pull_taut()
        # First out to where the rod pulls up, then in to where it rests on the table.
        self._step_until(lambda: self.vertical_force() < 0.0, +1.0)
        pulls = self.vertical_force() < 0.0
        outer, f_outer = self.radius.copy(), self.vertical_force()
        self._step_until(lambda: self.vertical_force() >= 0.0, -1.0)
        rests = self.vertical_force() >= 0.0
        tight = self._root(outer, f_outer, self.vertical_force, pulls & rests)
        found = pulls & rests & (self.rods.lift() > -1e-6)
        low, kind = tight.copy(), np.full(len(tight), EMPTY)
        inner = self.radius.copy()
        lift = self.rods.lift()
        self._step_until(lambda: self.rods.lift() < 0.0, -1.0, found)
        sags = found & (self.rods.lift() < 0.0)
        edge = self._root(inner, lift, self.rods.lift, sags)
        dips = self.rods.lowest() < _AT_CONTACT
        low[sags] = edge[sags]
        kind[sags] = np.where(dips, DIPS, TOUCHES)[sags]
        folds = found & ~sags
        low[folds], kind[folds] = self.radius[folds], FOLDS
        return tight, low, kind

    def _step_until(self, reached, sign: float, chosen=None) -> None:
        """Step along the rays until `reached()`, until a rod is lost, or until there is no more."""
        pending = np.ones(len(self.radius), dtype=bool) if chosen is None else chosen.copy()
        pending &= ~reached()
        step = np.full(len(self.radius), _FIRST_STEP)
        for _ in range(_MAX_STEPS):
            if not pending.any():
                break
            target = self.radius + sign * step * self.length
            pending &= (target > _SMALLEST_RADIUS * self.length) & (target < 1.3 * self.length)
            arrived = self.move(target, pending)
            pending &= arrived & ~reached()
            step = np.minimum(step * _STEP_GROWTH, _LARGEST_STEP)

    def _root(self, other, f_other, measure, chosen: np.ndarray) -> np.ndarray:
        """Distance at which `measure` changes sign between `other` and where the rods stand."""
        a, fa = other.copy(), f_other.copy()
        b, fb = self.radius.copy(), measure()
        pending = chosen & (fa * fb < 0.0)
        for _ in range(40):
            pending &= np.abs(b - a) > _TOLERANCE * self.length
            if not pending.any():
                break
            c = b - fb * (b - a) / np.where(fb == fa, 1.0, fb - fa)
            # Never closer to an end than half of the tolerance: that end would not move away.
            low, high = np.minimum(a, b), np.maximum(a, b)
            room = np.minimum(0.5 * _TOLERANCE * self.length, 0.5 * (high - low))
            c = np.clip(c, low + room, high - room)
            lost = ~self.move(np.where(pending, c, self.radius), pending) & pending
            pending &= ~lost
            f = measure()
            crossed = pending & (f * fb < 0.0)
            same = pending & ~crossed
            a[crossed], fa[crossed] = b[crossed], fb[crossed]
            fa[same] *= 0.5  # Illinois: the end that stays counts half
            b[pending], fb[pending] = self.radius[pending], f[pending]
        return b
