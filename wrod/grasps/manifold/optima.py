"""The optimal grasps of a straight pattern, and whether they are stable. Dimensionless."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from wrod.grasps.held_rods import HeldRods
from wrod.grasps.inputs import CLOSURES
from wrod.grasps.levels import MeshLevel, WorkList, make_scratch, put
from wrod.grasps.manifold.sampler import Patch
from wrod.grasps.mesh import WEIGHT
from wrod.grasps.nudge import Nudges, nudge
from wrod.grasps.results import Grasps
from wrod.kernels.grasping.closures import CONVERGED


class GraspSolver:
    """Solves n grasps of straight isotropic rods on meshes of `edge_count` edges, from shapes that
    are given: for those who look for more than the gentle one.

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


@dataclass(frozen=True)
class Optimum:
    """An optimal grasp of a straight pattern: no curvature at contact and grip, and a closure.

    position, force (3,) are extrapolated from two meshes; shape (node, 3) and eigenvalue belong to
    the finer; snaps_at is the smallest sideways nudge of the grip that makes it snap [L_gb].
    """

    position: np.ndarray
    force: np.ndarray
    shape: np.ndarray
    eigenvalue: float
    stable: bool
    snaps_at: float


def find_optima(
    patches: list[Patch], length: float, ratio: float, closure: str, device: str
) -> tuple[list[Optimum], Nudges]:
    """Polish every grip of the manifold's low edges into an optimal grasp, and test those found.

    Rods without curvature at the contact stand on these edges; optimal grasps are among them.
    """
    seeds = np.concatenate([patch.shape[:, -1] for patch in patches])
    force = np.concatenate([patch.force[:, -1] for patch in patches])

    def polish(shape: np.ndarray, thrust: np.ndarray) -> tuple[GraspSolver, Grasps]:
        n = len(shape)
        solver = GraspSolver(
            np.full(n, length),
            np.zeros(n),
            np.full(n, ratio),
            edge_count=shape.shape[1] - 1,
            closure=CLOSURES[closure],
            device=device,
            guess=shape,
            thrust=thrust,
        ).run()
        return solver, solver.grasps()

    thrust = np.zeros(len(seeds)) if closure == "zero_tension" else force[:, 0]
    solver, coarse = polish(seeds, thrust)
    size = np.linalg.norm(coarse.force, axis=1)
    good = coarse.converged & (coarse.force[:, 2] > 0.0)
    good &= (solver.lowest() > -1e-6) & (solver.turning() < 2.0 * np.pi)
    chosen: list[int] = []
    for i in np.flatnonzero(good)[np.argsort(size[good], kind="stable")]:
        if all(np.linalg.norm(coarse.position[i] - coarse.position[j]) > 1e-3 for j in chosen):
            chosen.append(int(i))
    _, fine = polish(solver.refined()[chosen], solver.thrust()[chosen])
    rods = HeldRods(
        np.full(len(chosen), length), np.full(len(chosen), ratio), fine.shape, device=device
    )
    rods.continue_to(rods.grip_position())
    eigenvalue, stable = rods.eigenvalue(), rods.negative_pivots() == 0
    nudges = nudge(fine.shape, length, ratio, device=device)
    optima = [
        Optimum(
            position=(4.0 * fine.position[i] - coarse.position[j]) / 3.0,
            force=(4.0 * fine.force[i] - coarse.force[j]) / 3.0,
            shape=fine.shape[i],
            eigenvalue=float(eigenvalue[i]),
            stable=bool(stable[i]),
            snaps_at=float(nudges.snaps_at[i]),
        )
        for i, j in enumerate(chosen)
    ]
    return optima, nudges
