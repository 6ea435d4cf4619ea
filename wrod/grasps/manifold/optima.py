"""The optimal grasps of a straight pattern, and whether they are stable. Dimensionless."""

from dataclasses import dataclass

import numpy as np

from wrod.grasps.held_rods import HeldRods
from wrod.grasps.inputs import CLOSURES
from wrod.grasps.manifold.sampler import Patch
from wrod.grasps.nudge import Nudges, nudge
from wrod.grasps.results import Grasps
from wrod.grasps.solver import GraspSolver


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
