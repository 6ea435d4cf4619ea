"""The loop that measures a rod: how high a folded heavy rod stands (Fig. material, corrected).

The rod lies flat, lifts off, turns over by 180 degrees, comes down and lies flat again; no tension
in the flat parts. Lengths are in L_gb, forces in k_b / L_gb^2.
"""

import numpy as np
from scipy.optimize import brentq, root

from wrod.errors import WrodError
from wrod.grasps.mesh import WEIGHT
from wrod.rods.batch import RodBatch
from wrod.rods.model import RodModel
from wrod.solvers.statics import EquilibriumSolver, prescribe

# Dimensionless stretching stiffness of a rod that is stretched by less than 1e-5.
_STRETCH_RATIO = 1e5
# Suspended length to start from; the solution is at 5.83.
_LENGTH = 5.0
# Short first steps; differences wide enough for the accuracy of the equilibria (1e-9).
_SEARCH = {"factor": 0.1, "eps": 1e-8}


def loop_height(edge_count: int = 128) -> float:
    """Height of the loop's top above the flat rod [L_gb], from the discrete rod's equilibrium.

    Two meshes are extrapolated.

    Raises:
        WrodError: the equilibrium was not found.
    """
    coarse, fine = (_Loop(n).height() for n in (edge_count // 2, edge_count))
    return (4.0 * fine - coarse) / 3.0


class _Loop:
    """Suspended part of the loop on `edge_count` edges of equal length, the flat parts clamped.

    Each clamp is a ghost edge that continues the flat part. Where the rod leaves it, node 1 in
    the middle of two equal edges, the moment is that of the flat part: none.
    """

    def __init__(self, edge_count: int):
        self.edge_count = edge_count
        u = (np.arange(edge_count) + 0.5) / edge_count

        def angle(overshoot: float) -> np.ndarray:
            return np.pi * u**2 * (3 - 2 * u) + 16 * overshoot * u**2 * (1 - u) ** 2

        # Turning past 180 degrees is what brings the rod back down to the table.
        theta = angle(brentq(lambda b: np.sin(angle(b)).sum(), 0.0, 3.0))
        edges = np.stack([np.cos(theta), 0 * theta, np.sin(theta)], axis=1)
        self.nodes = np.concatenate([np.zeros((1, 3)), np.cumsum(edges, axis=0)]) / edge_count

    def _solve(self, length: float, end: float) -> tuple[np.ndarray, np.ndarray]:
        """Curvatures where the rod leaves and meets the table, and nodes, for a length and end."""
        edge = length / self.edge_count
        inner = length * self.nodes
        inner = np.concatenate([[[-edge, 0, 0]], inner, inner[-1:] - [[edge, 0, 0]]])
        rod = RodModel(
            length=length,
            bending_stiffness=1.0,
            twisting_stiffness=2.0 / 3.0,
            stretching_stiffness=_STRETCH_RATIO,
            line_mass=WEIGHT,
            radius=1.0,
            gravity=1.0,
        )
        batch = RodBatch.of(rod, edge * np.arange(len(inner)), inner[None])
        prescribe(batch, clamped_nodes=(0, 1, -2, -1), clamped_angles=(0,))
        target = batch.state.dof.numpy().copy()
        target[0, -7:-4] = end, 0.0, 0.0
        target[0, -3:] = end - edge, 0.0, 0.0
        if not EquilibriumSolver(batch).solve(prescribed=target).converged.all():
            raise WrodError("the loop's equilibrium was not found; use more edges")
        nodes = batch.positions()[0]
        first, last = nodes[2] - nodes[1], nodes[-3] - nodes[-2]
        slopes = np.arctan2([first[2], last[2]], [first[0], last[0]])
        curvatures = 2.0 * np.tan(0.5 * slopes) / edge
        self.nodes = nodes[1:-1] / length  # the next solve starts from here
        return curvatures, nodes

    def height(self) -> float:
        """Height of the loop that leaves and meets the table without a bending moment.

        Along a heavy rod kappa^2 / 2 + n . t - w z is constant; with equal heights and no moment at
        either end the tension n_x is zero. (Asking for n_x and one moment is a double root.)
        """
        start = [_LENGTH, _LENGTH * self.nodes[-1, 0]]
        found = root(lambda p: self._solve(*p)[0], start, method="lm", options=_SEARCH)
        if np.abs(found.fun).max() > 1e-6:
            raise WrodError(f"the loop's free length was not found: {found.message}")
        z = self._solve(*found.x)[1][:, 2]
        top = int(np.argmax(z))
        # The parabola through the three highest nodes: the top lies between nodes.
        below, above = z[top - 1], z[top + 1]
        return z[top] - (above - below) ** 2 / (8.0 * (above - 2.0 * z[top] + below))
