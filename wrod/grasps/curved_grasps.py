"""Grasps of naturally curved rods on two meshes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields

import numpy as np

from wrod.grasps.curved import CurvedGraspSolver
from wrod.grasps.mesh import MIRROR, MIRROR_ROTATION
from wrod.grasps.solver import GraspSolution, GraspSolver


def _solve_chunk(
    ls,
    kappa,
    ks,
    closure,
    device,
    edge_count,
    extrapolate,
    sensitivities,
    eigenvalues,
    shapes,
    natural,
    poisson,
) -> GraspSolution:
    """Coarse from a cold start, fine from coarse, then both combined."""

    def level(chosen, edges, guess=None, thrust=None) -> tuple[GraspSolver, GraspSolution]:
        kind, rod = GraspSolver, {}
        if natural is not None:
            kind, rod = CurvedGraspSolver, {"natural_curvature": natural[chosen]}
            rod["poisson"] = poisson
        solver = kind(
            ls[chosen],
            kappa[chosen],
            ks[chosen],
            edge_count=edges,
            closure=closure,
            device=device,
            guess=guess,
            thrust=thrust,
            **rod,
        ).run()
        return solver, solver.solution(
            sensitivities=sensitivities,
            # Those of the coarse mesh are of no use: nothing is extrapolated from them.
            eigenvalues=eigenvalues and edges == edge_count,
            shapes=shapes,
        )

    everything = slice(None)
    solver, coarse = level(everything, edge_count // 2)
    _, fine = level(everything, edge_count, solver.refined(), coarse.thrust)
    fine.converged &= coarse.converged
    fine.iterations += coarse.iterations
    lost = np.flatnonzero(~fine.converged)
    if lost.size:
        # Too coarse a mesh to start from: start on the fine one and come back from there.
        solver, cold = level(lost, edge_count)
        _, back = level(lost, edge_count // 2, solver.coarsened(), cold.thrust)
        cold.converged &= back.converged
        cold.iterations += back.iterations + fine.iterations[lost]
        _put(coarse, lost, back)
        _put(fine, lost, cold)
    if extrapolate:
        coarse.rotation = _same_way_round(coarse.rotation, fine.rotation)
        for name in _EXTRAPOLATED:
            value = getattr(fine, name)
            if value is not None:
                setattr(fine, name, (4.0 * value - getattr(coarse, name)) / 3.0)
    admissible = (fine.lowest > -1e-6) & (fine.force[:, 2] > 0)
    fine.converged &= admissible & fine.stable & (fine.turning < _GENTLE)
    return fine


_EXTRAPOLATED = (
    "position",
    "rotation",
    "twist",
    "force",
    "force_jacobian",
    "position_sensitivity",
    "rotation_sensitivity",
    "force_sensitivity",
)
# Grasps on the gentle branch turn by less than this, those that have looped by more.
_GENTLE = 2.0 * np.pi


def _same_way_round(vectors: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Rotation vectors (n, 3) of the same rotations, with no full turn between them and `like`:
    those of two meshes may lie on either side of half a turn."""
    angle = np.linalg.norm(vectors, axis=1, keepdims=True)
    axis = vectors / np.maximum(angle, 1e-300)
    turns = np.rint(((like - vectors) * axis).sum(axis=1, keepdims=True) / (2.0 * np.pi))
    return vectors + 2.0 * np.pi * turns * axis


def _put(target: GraspSolution, where: np.ndarray, source: GraspSolution) -> None:
    for field in fields(GraspSolution):
        value = getattr(target, field.name)
        if value is not None and getattr(source, field.name) is not None:
            value[where] = getattr(source, field.name)


def solve_curved(
    ls, kappa, ks, closure, device, edge_count, extrapolate, eigenvalues, shapes, natural, poisson,
    size, threads, progress,
) -> dict:  # fmt: skip
    """Fields of `Grasps`; inputs as of `solve_grasps`, NumPy."""
    natural = natural.copy()
    # Right turns are solved as left turns of the mirrored rod.
    natural[kappa < 0, 0] *= -1.0
    size = max(1, min(size, -(-len(ls) // threads)))
    chunks = [slice(i, i + size) for i in range(0, len(ls), size)]

    def solve(chunk: slice) -> GraspSolution:
        result = _solve_chunk(
            ls[chunk], np.abs(kappa[chunk]), ks[chunk], closure, device, edge_count, extrapolate,
            False, eigenvalues, shapes, natural[chunk], poisson,
        )  # fmt: skip
        if progress is not None:
            progress(len(result.position))
        return result

    with ThreadPoolExecutor(threads) as pool:
        parts = list(pool.map(solve, chunks))

    def join(name):
        return np.concatenate([getattr(part, name) for part in parts])

    right = kappa < 0
    names = ["position", "rotation", "force", "converged", "stable", "iterations", "residual"]
    names += ["force_jacobian", "twist"] + ["shape", "arc_length"] * shapes
    names += ["eigenvalue"] * eigenvalues
    out = {name: join(name) for name in names}
    out["twist"][right] *= -1.0
    out["rotation"][right] *= MIRROR_ROTATION
    for name in ("position", "force", "shape"):
        if name in out:
            out[name][right] *= MIRROR
    out["force_jacobian"][right] *= np.outer(MIRROR, MIRROR)
    return out
