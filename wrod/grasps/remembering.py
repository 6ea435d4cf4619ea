"""Grasps of a rod that remembers how it was bent, while it is laid from its beginning.

What it remembers at a contact is what it went through at the contacts before: laying is slow. All
contacts are solved at once, as linear rods that have the moments, and the stiffness, which the
sweep before found; then every material point goes through its curvatures once more. Where sweeps
no longer change the grips, moments are those of the law.
"""

import numpy as np
import warp as wp
from scipy.interpolate import Akima1DInterpolator

from wrod.grasps.general import RodArrays
from wrod.kernels.elastic.inelastic import Inelastic
from wrod.kernels.grasping.memory import follow_flow
from wrod.rods.law import BendingLaw

# Contacts are at most so far from each other [L_gb]: what happens to a point in between is a
# straight way.
CLOSE = 0.1
# Grips that move less from sweep to sweep [L_gb] are found.
_SAME, SWEEPS = 1e-5, 60
# Least stiffness of a linear rod that stands for one that yields, over that of the rod.
_LEAST = 0.1


def between(contact: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """(N,) the increasing contacts (n,) and so many evenly between them that none is farther than
    `longest` from the next, and (n,) which of them were given."""
    counts = np.maximum(np.ceil(np.diff(contact) / longest - 1e-9).astype(int), 1)
    given = np.concatenate([[0], np.cumsum(counts)])
    return np.interp(np.arange(given[-1] + 1), given, contact), given


class History:
    """What the rod went through from its first contact on, dimensionless.

    Args:
        law: of bending, lengths in L_gb.
        contact: (n,) arc length of the contacts, increasing.
        length: (n,) suspended there.
        meshes: of the rods from contact to grip, by their numbers of edges; `general.RodArrays`.
    """

    def __init__(
        self, law: BendingLaw, contact: np.ndarray, length: np.ndarray, meshes: dict[int, RodArrays]
    ):
        self.law, self.contact, self.meshes = law.inelastic, contact, meshes
        end = contact[-1] + length[-1]
        beyond = max(int(np.ceil(length[-1] / CLOSE)), 2)
        # Points that are all met by contacts at the same distances.
        self._point = np.concatenate(
            [contact, np.linspace(contact[-1], end, beyond + 1)[1:]]
        )
        self._rods = dict(meshes)
        self._grip: np.ndarray | None = None
        self.settled = np.zeros(len(contact), dtype=bool)

    def rods(self, edges: int) -> RodArrays:
        """Linear rods that have the moments found last."""
        return self._rods[edges]

    def follow(self, grip: np.ndarray, bent: dict[int, np.ndarray]) -> bool:
        """Go once more through the curvatures (n, node, 2) at the nodes of each mesh, where the
        grips are at (n, 3); whether nothing changes any more."""
        if self._grip is not None:
            moved = np.linalg.norm(grip - self._grip, axis=1)
            self.settled = np.maximum.accumulate(np.nan_to_num(moved, nan=np.inf)) < _SAME
        self._grip = grip
        if self.settled.all():
            return True
        for edges, curvature in bent.items():
            self._rods[edges] = self._gone_through(self.meshes[edges], curvature)
        return False

    def _gone_through(self, rods: RodArrays, bent: np.ndarray) -> RodArrays:
        natural, stiffness = rods["natural_curvature"], rods["bending_stiffness"]
        excess = np.nan_to_num(bent - natural)
        excess[:, -1] = 0.0
        start = np.zeros_like(rods["rest_length"][:, :1])
        node = self.contact[:, None] + np.cumsum(
            np.concatenate([start, rods["rest_length"]], axis=1), axis=1
        )
        before = self._before(node, excess, stiffness)
        count = excess[..., 0].size
        lagging, tangent = self._flow(
            excess.reshape(1, count, 2), stiffness.reshape(count, 2), before.reshape(2, count, 2)
        )
        lagging, tangent = (value.reshape(excess.shape) for value in (lagging, tangent))
        share = self.law[1]
        # The linear rod with this moment here, as stiff as the law goes on.
        softer = np.maximum(1.0 - share * (1.0 - tangent), _LEAST)
        moment = excess - share * (excess - lagging)
        return rods | {
            "bending_stiffness": stiffness * softer,
            "natural_curvature": natural + excess - moment / softer,
        }

    def _before(self, node: np.ndarray, excess: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        """(2, n, node, 2) excess and z of the nodes at the contact before theirs; 0 at the first's."""
        points, count = self._point, len(node)
        path = np.zeros((count, len(points), 2))
        for i in range(count):
            path[i, i:] = _between(node[i], excess[i], points[i:])
        of_points = np.stack([np.interp(points, node[0], stiffness[0, :, k]) for k in (0, 1)], 1)
        lagging, _ = self._flow(path, of_points, np.zeros((2, len(points), 2)))
        before = np.zeros((2, *excess.shape))
        for i in range(1, count):
            for state, value in zip(before, (path, lagging), strict=True):
                state[i] = _between(points[i - 1 :], value[i - 1, i - 1 :], node[i])
        return before

    def _flow(
        self, excess: np.ndarray, stiffness: np.ndarray, start: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """z and its derivatives (step, point, 2) along excess curvatures, from excess and z."""
        steps, count, _ = excess.shape
        number, share, scale, time = self.law
        node = np.zeros(count, dtype=Inelastic.numpy_dtype())
        node["law"], node["share"], node["scale"], node["time"] = number, share, scale, time
        node["span"] = np.inf
        node["excess"], node["lagging"] = start
        weight = stiffness / stiffness.mean(axis=1, keepdims=True)
        arrays = [wp.array(value, dtype=wp.vec2d, device="cpu") for value in (excess, weight)]
        out = [wp.empty((steps, count), dtype=wp.vec2d, device="cpu") for _ in range(2)]
        state = wp.array(node, dtype=Inelastic, device="cpu")
        wp.launch(follow_flow, count, [*arrays, state], out, device="cpu")
        return out[0].numpy(), out[1].numpy()


def _between(at: np.ndarray, value: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Values (n, 2) at increasing places (n,) between them, without overshooting at kinks."""
    return Akima1DInterpolator(at, value)(np.clip(wanted, at[0], at[-1]))
