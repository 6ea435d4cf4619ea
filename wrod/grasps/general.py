"""Grasps of rods whose properties vary along them, from arrays on the mesh. Dimensionless.

The laid rod keeps its roll: between contact and table there is no twist, so no twisting moment at
the contact either. Its bending moment is what the pattern's curvature and the rod's own make it. At
the grip the bending moment is zero, as for a straight rod, which leaves the rod's natural curvature
there; its twisting moment is what the grip's roll has to supply. One freedom is left, as before.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import warp as wp

from wrod.grasps.device_results import FIELDS, SHAPES, at_once, empty_results, result_bytes
from wrod.grasps.growth import growth
from wrod.grasps.inputs import GraspOptions
from wrod.grasps.levels import (
    WIDE_BLOCK,
    Ladder,
    MeshLevel,
    launch,
    make_scratch,
    make_task,
    per_rod,
    put,
)
from wrod.grasps.mesh import ghost, node_weights, tolerance, two_sided_rest_lengths
from wrod.kernels.grasping import general_rod, iteration, memory, reading
from wrod.kernels.linear.frontal import row_width, stencil_entries
from wrod.machine import worker_threads
from wrod.rods.batch import RodBatch
from wrod.rods.discretisation import of_free_part
from wrod.rods.state import Derivatives
from wrod.solvers.stability import smallest_eigenvalue
from wrod.solvers.statics import prescribe

# Solved at once at most, on a CPU and on a GPU; fewer than these a thread of Python gains nothing.
_CPU_CHUNK, _CUDA_CHUNK, _CPU_LEAST = 64, 8192, 16
# Numbers that an edge's properties are.
_PROPERTIES = 14
# How much of a rod's own properties is added at once at first: natural curvature [1/L_gb], or the
# share by which a stiffness differs. The twist that natural curvature brings grows with the length.
_INCREMENT, _LONG = 0.5, 4.0


# Rods on meshes from contact (node 0) to grip, dimensionless, without ghosts: arguments of
# `RodBatch` by name, and the weight (n, edges + 1) of every node.
RodArrays = dict[str, np.ndarray]
# Where iterations on both meshes ended, (n, numbers) each: state, thrust and family.
Ends = tuple[np.ndarray, ...]
Rows = slice | np.ndarray


def _mirrored(rods: RodArrays, rows: np.ndarray) -> RodArrays:
    """With the chosen rods as in a mirror: their second directors turn round."""
    sign = np.where(rows, -1.0, 1.0)[:, None]
    curvature = rods["natural_curvature"] * np.stack([np.ones_like(sign), sign], axis=2)
    return rods | {"natural_curvature": curvature, "natural_twist": sign * rods["natural_twist"]}


def _departure(rods: RodArrays) -> np.ndarray:
    """(n,) how far each rod is from a straight uniform one of unit stiffness."""
    size = np.linalg.norm(rods["natural_curvature"], axis=2).max(axis=1)
    size = size + np.abs(rods["natural_twist"]).max(axis=1)
    size += np.abs(np.log(rods["bending_stiffness"])).max(axis=(1, 2))
    c, kept = np.moveaxis(rods["softening"], 2, 0)
    return size + np.abs(c * (1.0 - kept)).max(axis=1)


def curved_rods(
    length: np.ndarray,
    stretch_ratio: np.ndarray,
    natural_curvature: np.ndarray,
    poisson: float,
    edges: int,
) -> RodArrays:
    """Uniform isotropic rods with natural curvature (n, 2) towards +y (left) and +z (up)."""
    rest = two_sided_rest_lengths(length, edges)
    n, nodes = len(length), edges + 1
    # The first material director at the contact points up, the second to the right.
    natural = np.stack([natural_curvature[:, 1], -natural_curvature[:, 0]], axis=1)
    return RodArrays(
        rest_length=rest,
        stretching_stiffness=np.repeat(stretch_ratio[:, None], edges, axis=1),
        bending_stiffness=np.ones((n, nodes, 2)),
        twisting_stiffness=np.full((n, nodes), 1.0 / (1.0 + poisson)),
        natural_curvature=np.repeat(natural[:, None], nodes, axis=1),
        natural_twist=np.zeros((n, nodes)),
        softening=np.broadcast_to([0.0, 1.0], (n, nodes, 2)).copy(),
        weight=node_weights(rest),
    )


def solve_general(
    length: np.ndarray,
    curvature: np.ndarray,
    stretch_ratio: np.ndarray,
    rods: Callable[[int], RodArrays],
    roll: np.ndarray,
    options: GraspOptions,
    start: Ends | None = None,
) -> dict[str, np.ndarray]:
    """Fields of `Grasps` for rods given by their arrays, and where `options.curvatures` asks for it
    "coarse" and "fine", (n, node, 2) curvatures of the nodes on both meshes, 0 at the grip, and
    "coarse_end" and "fine_end", where the iterations ended.

    Args:
        length, curvature, stretch_ratio: (n,) suspended length, signed curvature of the pattern,
            and stretch ratio of the uniform straight rod that the solver starts from.
        rods: the rods on meshes of so many edges.
        roll: (n,) angle about the tangent, at the contact, from up to the first director [rad].
        start: where iterations of nearly the same rods ended, and NaN where there is nothing to
            begin with; what is not found from there is sought as without.
    """
    edges = options.edge_count
    right = curvature < 0.0
    on_cpu, n = options.device == "cpu", len(length)
    workers = worker_threads(options.threads) if on_cpu else 1
    least = min(n, _CPU_LEAST)
    size = max(least, min(_CPU_CHUNK if on_cpu else _CUDA_CHUNK, -(-n // workers)), 1)
    # Properties on both meshes and results, twice while they are put together, stay in this
    # machine's memory.
    kept = 2.0 * result_bytes(edges, sensitivities=False, shapes=options.shapes)
    kept += 8.0 * 1.5 * edges * _PROPERTIES
    scratch = stencil_entries(4) + 4 * row_width(4) + _PROPERTIES + 24
    working = Ladder.bytes_each(edges, options.device) + 8.0 * edges * (24 if on_cpu else scratch)
    if on_cpu:
        size = at_once(n, size, kept, workers * working, "cpu")
    else:
        at_once(n, n, kept, 0.0, "cpu")
        size = at_once(size, size, 0.0, working, options.device)
    meshes = [_mirrored(rods(count), right) for count in (edges // 2, edges)]
    roll = np.where(right, -roll, roll)

    def solve_rows(rows: np.ndarray, start: Ends | None) -> dict[str, np.ndarray]:
        return _solve_chunk(
            length[rows],
            curvature[rows],
            stretch_ratio[rows],
            [{name: value[rows] for name, value in mesh.items()} for mesh in meshes],
            roll[rows],
            options,
            None if start is None else (start[0][rows], start[1][rows]),
        )

    def solve(first: int) -> dict[str, np.ndarray]:
        rows = np.arange(first, min(first + size, n))
        known = rows[:0] if start is None else rows[~np.isnan(start[0][rows, 0])]
        parts, rest = [], rows
        if len(known) > 0:
            part = solve_rows(known, start)
            found = part["converged"]
            rest = np.setdiff1d(rows, known[found])
            parts.append({name: value[found] for name, value in part.items()})
        if len(rest) > 0:
            parts.append(solve_rows(rest, None))
        back = np.argsort(np.concatenate([np.setdiff1d(rows, rest), rest]))
        part = {name: np.concatenate([p[name] for p in parts])[back] for name in parts[0]}
        if options.progress is not None:
            options.progress(len(part["position"]))
        return part

    with ThreadPoolExecutor(workers) as pool:
        parts = list(pool.map(solve, range(0, n, size)))
    out = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    out["twist"][right] *= -1.0
    for name in {"coarse", "fine"} & out.keys():
        out[name][right, :, 1] *= -1.0
    return out


class _HeldByRoll(RodBatch):
    """Rods whose grips, pinned and free to turn, hold the roll about the tangent there: the last
    edge spins by `kernels.grasping.grip_torque`'s c as it turns.

    A torque that follows a tangent has no energy, and of its stiffness the symmetric part counts.
    That has a moment M/2 (u x dt) beyond the last edge, by which the last half edge gives way.
    """

    def evaluate(self, *, order: int = 2, **options) -> Derivatives:
        out = super().evaluate(order=order, **options)
        if order < 2:
            return out
        length = np.linalg.norm(np.diff(self.positions()[:, -2:], axis=1), axis=2)
        m1, m2 = np.moveaxis(self.material_directors()[:, -1], 1, 0)
        k1, k2 = self.natural_curvature.numpy()[:, -1].T[..., None]
        b1, b2 = self.bending_stiffness.numpy()[:, -1].T[..., None, None]
        half = 0.5 * self.rest_length.numpy()[:, -1:]
        # The last free node, and the angle of the edge after it, which is held.
        node, angle = self.dof_count - 7, self.dof_count - 4
        hessian, spin = out.hessian.numpy(), half * (k2 * m1 - k1 * m2) / length
        row = hessian[:, angle, ::-1]  # by the ten before and the angle itself
        moment = out.gradient.numpy()[:, angle, None] / length
        own = row[:, 7:10, None] * spin[:, None]
        own = own + own.transpose(0, 2, 1) + row[:, 10, None, None] * _square(spin)
        own -= (0.25 * half * moment**2)[..., None] * (_square(m2) / b1 + _square(m1) / b2)
        for i in range(3):
            for j in range(i + 1):
                hessian[:, node + i, i - j] += own[:, i, j]
            for j in range(4):
                hessian[:, node + i, i + 4 - j] += spin[:, i] * row[:, 3 + j]
        out.hessian.assign(hessian)
        return out


def _square(vector: np.ndarray) -> np.ndarray:
    """(n, 3, 3) products of components (n, 3)."""
    return vector[:, :, None] * vector[:, None]


class _GeneralLevel:
    """General rods on one mesh: a straight rod's grasp there, then their own."""

    def __init__(self, rods: RodArrays, roll: np.ndarray, device: str, ladder: Ladder):
        rest = rods["rest_length"]
        n, edges = rest.shape
        self.rods, self.roll, self.device = rods, roll, device
        self.straight = level = MeshLevel(n, edges, device, ladder.iterations)
        # The straight rod's Newton iteration hardly has to move on the new mesh.
        put(level.rest, rest)
        length = rest.sum(axis=1)
        put(level.tolerance, tolerance(rest, rods["stretching_stiffness"].max(axis=1), 1e-9))

        def array(value, dtype=wp.float64):
            return wp.array(np.ascontiguousarray(value), dtype=dtype, device=device)

        self.model = model = general_rod.GeneralRod()
        model.rest, model.stretch_ratio = level.rest, ladder.model[0]
        for name, value in rods.items():
            if value is not rest:
                kind = wp.vec2d if value.ndim == 3 else wp.float64
                setattr(model, name.removesuffix("_stiffness"), array(value, kind))
        self.weight, self.roll_array = array(rods["weight"].sum(axis=1)), array(roll)
        most = _INCREMENT * np.minimum(1.0, _LONG / length)
        increment = most / np.maximum(_departure(rods), 1e-300)
        # The first step is made larger before it is taken.
        self.increment = array(np.minimum(increment, 1.0) / 2.0)
        self.state = per_rod(device, n, edges + 1, 7)
        self.family, self.twist = per_rod(device, n, 7), per_rod(device, n)

    def _begin(self, ladder: Ladder, closure: int) -> None:
        """With the straight rod's grasp."""
        level, fine, device = self.straight, ladder.levels[-1], self.device
        n, edges = level.rods, level.edges
        wp.copy(level.curvature, fine.curvature)
        wp.copy(level.thrust, fine.thrust)
        wp.copy(level.family, fine.family)
        inputs = [fine.edges, fine.rest, fine.shape, edges, level.rest, level.curvature]
        launch(device, general_rod.interpolate_shape, n, inputs, [level.shape], WIDE_BLOCK)
        level.solve(ladder.work, ladder.model, closure, ladder.scratch)
        inputs = [edges, level.shape, self.roll_array, level.family]
        launch(device, general_rod.start_general, n, inputs, [self.state, self.family], WIDE_BLOCK)

    def solve(self, ladder: Ladder, closure: int, end: np.ndarray | None) -> None:
        """From where the iterations of nearly these rods ended, or from straight rods."""
        level, device = self.straight, self.device
        n, edges = level.rods, level.edges
        if end is None:
            self._begin(ladder, closure)
        else:
            wp.copy(level.curvature, ladder.model[1])
            state, thrust, family = np.split(end, [7 * (edges + 1), 7 * (edges + 1) + 1], axis=1)
            put(self.state, state.reshape(n, edges + 1, 7))
            put(level.thrust, thrust[:, 0])
            put(self.family, family)
        slots = 1 if wp.get_device(device).is_cpu else n
        read = level.read
        # The curvature is the target's by now.
        model = [self.model.stretch_ratio, level.curvature, self.weight]
        task = make_task(model, level.tolerance, self.increment, closure)
        task.place = 0.0 if end is None else 1.0
        state = [self.state, level.curvature, level.thrust, self.family]
        ladder.work.launch(
            iteration.solve_general,
            [edges, self.model, task, make_scratch(slots, edges, device, 4), *state],
            [read],
        )
        read.shape = self.state
        inputs = [edges, level.rest, self.model.natural_curvature, self.roll_array, self.state]
        outputs = [read.rotation, read.lowest, read.turning, self.twist]
        launch(device, reading.read_general, n, inputs, outputs, WIDE_BLOCK)

    def curvatures(self) -> np.ndarray:
        """(n, node, 2) of the nodes in their material frames, 0 at the grip."""
        level = self.straight
        n, edges = level.rods, level.edges
        bent = wp.zeros((n, edges + 1), dtype=wp.vec2d, device=self.device)
        inputs = [edges, level.rest, level.curvature, self.state]
        launch(self.device, memory.read_curvature, n, inputs, [bent], WIDE_BLOCK)
        return bent.numpy()

    def end(self) -> np.ndarray:
        """(n, numbers) where the iterations ended."""
        state, thrust, family = (
            value.contiguous().numpy() for value in (self.state, self.straight.thrust, self.family)
        )
        return np.concatenate([state.reshape(len(state), -1), thrust[:, None], family], axis=1)

    def eigenvalue(self, rows: Rows) -> np.ndarray:
        """Smallest eigenvalues of these rods as they are held."""
        batch = self._held(rows)
        prescribe(batch, clamped_nodes=(0, 1, -1), clamped_angles=(0, -1))
        return smallest_eigenvalue(batch)

    def growth(self, rows: Rows) -> np.ndarray:
        """Of small departures of what is laid; see `growth.growth`."""
        return growth(self._held(rows))

    def _held(self, rows: Rows) -> RodBatch:
        rods = {name: value[rows] for name, value in self.rods.items()}
        state = self.state.contiguous().numpy()[rows]
        shape, director = state[:, :, :3], state[:, :-1, 3:6]
        rest = rods["rest_length"]
        # Clamped at the contact by a ghost edge along x, to which the first edge stands half of the
        # curvature's angle, and half of the contact's cell bends.
        half = ghost(self.straight.curvature.numpy()[rows], rest)[0]
        behind = np.zeros((len(rest), 1, 3))
        behind[:, 0, 0] = -rest[:, 0]
        c, s = np.cos(half), np.sin(half)
        x, y, z = director[:, 0].T
        held = np.stack([c * x + s * y, c * y - s * x, z], axis=1)

        padded = {
            name: np.concatenate([value[:, :1], value], axis=1)
            for name, value in rods.items()
            if name != "weight"
        }
        share = np.ones((len(rest), rest.shape[1] + 2))
        share[:, 1] = 0.5
        bent = {k: v for k, v in padded.items() if k not in ("rest_length", "stretching_stiffness")}
        padded |= of_free_part(share, **bent)
        # The last node's twist goes on for half an edge to the grip, its moment what it was.
        cell = 0.5 * (rest[:, -2] + rest[:, -1])
        longer = 1.0 + 0.5 * rest[:, -1] / cell
        excess = state[:, -2, 6] / cell - padded["natural_twist"][:, -2]
        padded["twisting_stiffness"][:, -2] /= longer
        padded["natural_twist"][:, -2] += excess * (1.0 - longer)
        batch = _HeldByRoll(
            np.concatenate([behind, shape], axis=1),
            **padded,
            director=np.concatenate([held[:, None], director], axis=1),
            device=self.device,
        )
        twist = np.zeros((len(rest), batch.node_count))
        twist[:, 2:-1] = state[:, 1:-1, 6]
        batch.state.reference_twist.assign(twist)
        return batch


def _solve_chunk(
    length, curvature, stretch_ratio, meshes, roll, options: GraspOptions, start: Ends | None
) -> dict[str, np.ndarray]:
    device, closure = options.device, options.closure
    n, edges = meshes[1]["rest_length"].shape
    inputs = [
        wp.array(value, dtype=wp.float64, device=device)
        for value in (length, curvature, stretch_ratio)
    ]
    ladder = Ladder(n, edges, device, False)
    ladder.expect(inputs, 0, n, sort=False)
    if start is None:
        ladder.climb(n, closure)
    coarse, fine = (_GeneralLevel(mesh, roll, device, ladder) for mesh in meshes)
    for level, end in zip((coarse, fine), start or (None, None), strict=True):
        level.solve(ladder, closure, end)
    out = empty_results(n, edges, device, sensitivities=False, shapes=options.shapes)
    levels = coarse.straight, fine.straight
    ladder.judge(levels, inputs[1], n, extrapolate=options.extrapolate, out=out)
    names = FIELDS + SHAPES if options.shapes else FIELDS
    result = {name: getattr(out, name).numpy() for name in names}
    share = 1.0 / 3.0 if options.extrapolate else 0.0
    twist = fine.twist.numpy()
    result["twist"] = twist + share * (twist - coarse.twist.numpy())
    if options.curvatures:
        result |= {"coarse": coarse.curvatures(), "fine": fine.curvatures()}
        result |= {"coarse_end": coarse.end(), "fine_end": fine.end()}
    if options.eigenvalues:
        # What is not found from a start is sought once more.
        rows = slice(None) if start is None else np.flatnonzero(result["converged"])
        for name, of in (("eigenvalue", fine.eigenvalue), ("growth", fine.growth)):
            result[name] = np.full(n, np.nan)
            if result["converged"].any() or start is None:
                result[name][rows] = of(rows)
    return result
