"""Grasps of rods whose properties vary along them: functions of the contact's arc length. SI.

Each is walked from the grasp of the straight, uniform, isotropic rod of the same means into the rod
as it is: stiffnesses, masses, rest shape and law on its mesh. The laid rod has the twist that it
has at rest, so that no twisting moment acts at the contact; where it is twisted at rest its roll
turns along the pattern.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from wrod.errors import GraspError
from wrod.grasps.curved import CurvedGraspSolver
from wrod.grasps.curved_grasps import _EXTRAPOLATED, _GENTLE, _put, _same_way_round
from wrod.grasps.mesh import MIRROR, MIRROR_ROTATION, WEIGHT
from wrod.grasps.optimal import CLOSURES, EDGE_COUNT
from wrod.rods.batch import resolve_device
from wrod.rods.discretisation import mesh_arrays
from wrod.rods.model import RodModel

_CHUNK = 32
# How far two properties that differ by a factor e are apart, in natural curvatures [1/L_gb].
_PER_FACTOR = 1.0
_VARIED = ("stretching_stiffness", "bending_stiffness", "twisting_stiffness", "node_mass",
           "natural_curvature", "natural_twist")  # fmt: skip


@dataclass
class RodGrasps:
    """n grasps, in contact frames: x along the pattern's tangent, y to its left, z up. SI.

    Attributes:
        position: (n, 3) of the grip [m].
        rotation: (n, 3) rotation vectors of the grip's frame.
        force: (n, 3) of the table on the rod at the contact [N].
        converged: (n,) bool; a solution that satisfies equilibrium to the solver's tolerance.
        stable: (n,) bool; no negative eigenvalue of the energy's Hessian.
        eigenvalue: (n,) stiffness of the softest motion per length [N/m^2].
        twist: (n,) angle by which the grip's frame is twisted against the contact's [rad].
        shape: (n, nodes, 3) from contact to grip [m].
    """

    position: np.ndarray
    rotation: np.ndarray
    force: np.ndarray
    converged: np.ndarray
    stable: np.ndarray
    eigenvalue: np.ndarray
    twist: np.ndarray
    shape: np.ndarray

    def __len__(self) -> int:
        return len(self.position)


def solve_rod_grasps(
    model: RodModel,
    arc_length: np.ndarray,
    curvature: np.ndarray,
    *,
    closure: str = "zero_tension",
    roll: float = 0.0,
    edge_count: int = EDGE_COUNT,
    device: str | None = None,
    threads: int | None = None,
    progress: Callable[[int], object] | None = None,
) -> RodGrasps:
    """Optimal grasps of the rod where its point at `arc_length` touches the table.

    Args:
        model: the rod, arc length from the end that is laid first.
        arc_length: (n,) of the contacts, less than the rod's length [m].
        curvature: (n,) signed curvature of the pattern there [1/m].
        closure: "zero_tension", "min_force" or "min_friction".
        roll: of the rod's first director at its beginning, from left towards up [rad]. Natural
            twist turns it further along the rod.
        edge_count: edges of the finer of two meshes, which are extrapolated.
        device: "cpu", "cuda:0", "auto" or None (the first CUDA device if there is one).
        threads: CPU threads; default: one per core.
        progress: called with the number of grasps done after every chunk.

    Raises:
        GraspError: unknown closure, or inputs that are not on the rod.
    """
    if closure not in CLOSURES:
        raise GraspError(f"unknown closure {closure!r}; use one of {', '.join(CLOSURES)}")
    arc_length, curvature = np.broadcast_arrays(
        np.atleast_1d(np.asarray(arc_length, float)), np.asarray(curvature, float)
    )
    if not (np.isfinite(curvature).all() and (arc_length < model.length).all()):
        raise GraspError(
            f"contacts must lie on the rod, below {model.length:g} m, and curvatures be finite"
        )
    lgb = model.gravito_bending_length
    force_unit = model.mean_bending_stiffness / lgb**2
    unit = model.scaled(lgb, force_unit)
    at, kappa = arc_length / lgb, curvature * lgb
    base, rolled = roll + model.principal_angle, model.rolled(arc_length)
    device = resolve_device(device)
    workers = (threads or os.cpu_count() or 1) if device == "cpu" else 1
    size = max(1, min(_CHUNK, -(-len(at) // workers))) if device == "cpu" else len(at)

    def solve(first: int):
        part = slice(first, first + size)
        rods = (unit, at[part], kappa[part], base, rolled[part])
        result = _solve_chunk(*rods, CLOSURES[closure], edge_count, device)
        if progress is not None:
            progress(len(result.position))
        return result

    with ThreadPoolExecutor(workers) as pool:
        parts = list(pool.map(solve, range(0, len(at), size)))

    def join(name, factor=1.0):
        return factor * np.concatenate([getattr(part, name) for part in parts])

    right = kappa < 0.0
    mirror = np.where(right[:, None], MIRROR, 1.0)
    return RodGrasps(
        mirror * join("position", lgb),
        np.where(right[:, None], MIRROR_ROTATION, 1.0) * join("rotation"),
        mirror * join("force", force_unit),
        join("converged").astype(bool),
        join("stable").astype(bool),
        join("eigenvalue", force_unit / lgb**2),
        np.where(right, -1.0, 1.0) * join("twist") + rolled,
        mirror[:, None] * join("shape", lgb),
    )


def _solve_chunk(unit, at, kappa, base, rolled, closure, edge_count, device):
    """Coarse from a cold start, fine from coarse, then both combined."""

    def level(chosen, edges, guess=None, thrust=None):
        solver = RodGraspSolver(
            unit,
            at[chosen],
            kappa[chosen],
            base,
            rolled[chosen],
            edge_count=edges,
            closure=closure,
            device=device,
            guess=guess,
            thrust=thrust,
        ).run()
        return solver, solver.solution(eigenvalues=edges == edge_count)

    everything = np.arange(len(at))
    solver, coarse = level(everything, edge_count // 2)
    _, fine = level(everything, edge_count, solver.refined(), coarse.thrust)
    fine.converged &= coarse.converged
    lost = np.flatnonzero(~fine.converged)
    if lost.size:
        solver, cold = level(lost, edge_count)
        _, back = level(lost, edge_count // 2, solver.coarsened(), cold.thrust)
        cold.converged &= back.converged
        _put(coarse, lost, back)
        _put(fine, lost, cold)
    coarse.rotation = _same_way_round(coarse.rotation, fine.rotation)
    for name in _EXTRAPOLATED:
        value = getattr(fine, name)
        if value is not None:
            setattr(fine, name, (4.0 * value - getattr(coarse, name)) / 3.0)
    admissible = (fine.lowest > -1e-6) & (fine.force[:, 2] > 0)
    fine.converged &= admissible & fine.stable & (fine.turning < _GENTLE)
    return fine


class RodGraspSolver(CurvedGraspSolver):
    """Solves n grasps of one rod; right turns as left turns of the mirrored rod. Dimensionless.

    Args:
        unit: the rod in units of its L_gb and k_b / L_gb^2.
        at: (n,) arc length of the contacts.
        kappa: (n,) signed curvatures.
        base: of the first principal direction where the rod begins, from left towards up [rad].
        rolled: (n,) how far it has turned at the contact [rad].
    """

    def __init__(self, unit: RodModel, at, kappa, base, rolled, *, edge_count, **options):
        right = kappa < 0.0
        self.base = np.where(right, np.pi - base, base)
        angle = self.base + np.where(right, -rolled, rolled)
        super().__init__(
            unit.length - at,
            np.abs(kappa),
            np.full(len(at), unit.stretch_ratio),
            natural_curvature=np.zeros((len(at), 2)),
            poisson=unit.poisson,
            edge_count=edge_count,
            **options,
        )
        batch = self.batch
        rest = batch.rest_length.numpy()
        nodes = np.concatenate([-rest[:, :1], np.zeros((len(at), 1))], axis=1)
        nodes = np.concatenate([nodes, np.cumsum(rest[:, 1:], axis=1)], axis=1)
        self.goal = mesh_arrays(unit, at[:, None] + nodes)
        self.goal["natural_curvature"][right, :, 1] *= -1.0
        self.goal["natural_twist"][right] *= -1.0
        batch.set_softening(self.goal["softening"])
        self.begin = {name: _full(getattr(batch, name)) for name in _VARIED}
        extra = np.array([sum(m for s, m in unit.point_masses if s >= a) for a in at])
        self.load = unit.line_mass.integral(at, unit.length) + extra
        director = np.stack([0.0 * at, np.cos(angle), np.sin(angle)], axis=1)
        batch.set_configuration(batch.positions(), director=director)
        # What the walk's increments are measured by.
        self.natural = np.stack([self._way(), 0.0 * at], axis=1)

    def _way(self) -> np.ndarray:
        """(n,) how far the rod is from the straight, uniform one, as a natural curvature."""
        goal = self.goal
        bend = np.linalg.norm(goal["natural_curvature"], axis=2).max(axis=1)
        twist = np.abs(goal["natural_twist"]).max(axis=1)
        factor = np.abs(np.log(goal["bending_stiffness"])).max(axis=(1, 2))
        mass = np.abs(goal["node_mass"] - self.begin["node_mass"])[:, 2:].sum(axis=1)
        softer = goal["softening"][:, :, 0].max(axis=1) > 0.0
        return bend + twist + _PER_FACTOR * (factor + mass / WEIGHT + softer)

    def _bend(self, progress: np.ndarray) -> None:
        batch, p = self.batch, progress
        for name in _VARIED:
            begin, goal = self.begin[name], self.goal[name]
            share = p.reshape(-1, *(1,) * (goal.ndim - 1))
            array = getattr(batch, name)
            array.assign(np.ascontiguousarray((1.0 - share) * begin + share * goal))
        softening = self.goal["softening"].copy()
        softening[:, :, 0] *= p[:, None]
        batch.softening.assign(softening)
        load = (1.0 - p) * WEIGHT * self.inputs[0] + p * self.load
        self.weight.assign(load)
        # No twisting moment at the contact: across it the rod has its twist at rest.
        dof = batch.state.dof.numpy().copy()
        dof[:, 7] = dof[:, 3] + p * self.goal["natural_twist"][:, 1] * self._first_edge()
        batch.state.dof.assign(dof)

    def _first_edge(self) -> np.ndarray:
        return self.batch.rest_length.numpy()[:, 1]

    def _grip_frame(self):
        frame, *others = super()._grip_frame()
        # The grip holds the rod at one roll: its z axis is what pointed up where the rod begins.
        turn = 0.5 * np.pi - self.base
        c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
        t, side, first = np.moveaxis(frame, 2, 0)
        return np.stack([t, c * side + s * first, c * first - s * side], axis=2), *others

    def _rotation(self) -> np.ndarray:
        first, second = self.goal["natural_curvature"][:, -1].T
        c, s = np.cos(self.base), np.sin(self.base)
        way = self.natural
        self.natural = np.stack([s * first + c * second, s * second - c * first], axis=1)
        try:
            return super()._rotation()
        finally:
            self.natural = way


def _full(array) -> np.ndarray:
    return array.numpy().copy()
