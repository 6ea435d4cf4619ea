"""Grasps on one mesh from given shapes, for those who look for more than the gentle one.

Dimensionless, straight isotropic rods.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wrod.grasps.levels import MeshLevel, WorkList, make_scratch, put
from wrod.grasps.mesh import WEIGHT
from wrod.grasps.results import Grasps
from wrod.kernels.grasping.closures import CONVERGED


class GraspSolver:
    """Solves n grasps on meshes of `edge_count` edges.

    Args:
        suspended_length, curvature, stretch_ratio: (n,) inputs; curvature >= 0.
        closure: one of `wrod.kernels.grasping.closures`; with ZERO_TENSION the thrust stays as it
            is given.
        device: Warp device.
        guess: (n, edge_count + 1, 3) nodes near the solution.
        thrust: (n,) F_x of the guess.
    """

    def __init__(
        self,
        suspended_length: np.ndarray,
        curvature: np.ndarray,
        stretch_ratio: np.ndarray,
        *,
        edge_count: int,
        closure: int,
        device: str,
        guess: np.ndarray,
        thrust: np.ndarray,
    ):
        n = len(suspended_length)
        self.closure, self.device = int(closure), device
        self.work = WorkList(n, device)
        self.work.index.assign(np.arange(n, dtype=np.int32))
        self.work.count.fill_(n)
        self.iterations = wp.zeros(n, dtype=wp.int32, device=device)
        self.level = level = MeshLevel(n, edge_count, device, self.iterations)

        def array(value):
            value = np.array(np.broadcast_to(value, n), dtype=np.float64)
            return wp.array(value, device=device)

        self.length = array(suspended_length)
        self.model = [
            array(stretch_ratio),
            array(curvature),
            array(WEIGHT * np.asarray(suspended_length)),
        ]
        level.lay(self.length, self.model[0], n)
        level.hang(self.work)
        guess = np.array(guess)
        # The contact holds the direction of the first edge.
        half = np.arctan(0.5 * np.asarray(curvature) * level.rest.contiguous().numpy()[:, 0])
        first = np.stack([np.cos(half), np.sin(half), np.zeros_like(half)], axis=1)
        guess[:, 1] = np.linalg.norm(guess[:, 1], axis=1)[:, None] * first
        put(level.shape, guess)
        put(level.curvature, curvature)
        put(level.thrust, thrust)

    def run(self) -> GraspSolver:
        """Iterate until every grasp has converged or failed."""
        slots = 1 if wp.get_device(self.device).is_cpu else self.level.rods
        scratch = make_scratch(slots, self.level.edges, self.device)
        self.level.solve(self.work, self.model, self.closure, scratch)
        self.level.read_out(self.level.rods)
        return self

    def refined(self) -> np.ndarray:
        """(n, 2 edge_count + 1, 3) guess for the mesh of half the edges."""
        level = self.level
        fine = MeshLevel(level.rods, 2 * level.edges, self.device, self.iterations)
        fine.lay(self.length, self.model[0], level.rods)
        fine.refine(self.work, level)
        return fine.shape.contiguous().numpy()

    def grasps(self) -> Grasps:
        """What was found, on this mesh."""
        level, read = self.level, self.level.read
        shape = level.shape.contiguous().numpy()
        return Grasps(
            position=shape[:, -1].copy(),
            rotation=read.rotation.contiguous().numpy().copy(),
            force=read.force.contiguous().numpy().copy(),
            force_jacobian=read.jacobian.contiguous().numpy().reshape(-1, 3, 3).copy(),
            shape=shape.copy(),
            converged=read.status.numpy() == CONVERGED,
            stable=read.negative.numpy() == 0,
        )

    def lowest(self) -> np.ndarray:
        """(n,) height of the lowest node."""
        return self.level.read.lowest.numpy()

    def turning(self) -> np.ndarray:
        """(n,) total turning of each rod [rad]."""
        return self.level.read.turning.numpy()

    def thrust(self) -> np.ndarray:
        """(n,) F_x at the contact."""
        return self.level.thrust.numpy().copy()
