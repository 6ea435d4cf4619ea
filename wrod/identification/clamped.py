"""Shapes and wrenches of clamped rods for many candidate models at once, with exact derivatives.

The batch holds candidate x trial rods. Beyond each clamp stands a ghost edge that carries the
clamp's frame; at the clamp's node only half of the Voronoi length bends and twists, so stiffnesses
count twice and natural curvatures half there (second order in the edge length).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from wrod.batch import RodBatch, RodState
from wrod.errors import DataError
from wrod.identification.setup import Setup
from wrod.kernels import banded
from wrod.kernels.loads import dead_loads
from wrod.kernels.softened_bending import softened_bending_rate
from wrod.kernels.stretching import stretching_rate
from wrod.kernels.twisting import twisting_rate
from wrod.statics import BandedSystem, EquilibriumSolver

COMPLEX_STEP = 1e-30
_WAYPOINTS = 8
_PATIENCE, _WALK_PATIENCE = 12, 60
_WIND_PASSES = 12
_WIND_TOLERANCE = 1e-7


@dataclass
class Prediction:
    """What a model predicts; every array may carry a parameter's rate as imaginary part.

    Attributes:
        position: (C, T, M, 3) markers [m].
        frame: (C, T, M, 3, 3) columns m1, m2, tangent there.
        force, torque: (C, T, 3) of the gripper on the rod, about its end [N], [N m].
    """

    position: np.ndarray
    frame: np.ndarray
    force: np.ndarray
    torque: np.ndarray


@dataclass
class _Arrays:
    """A list of setups laid out for the batch: candidate x trial in one leading axis."""

    rest_length: np.ndarray
    stretching_stiffness: np.ndarray
    bending_stiffness: np.ndarray
    twisting_stiffness: np.ndarray
    natural_curvature: np.ndarray
    natural_twist: np.ndarray
    softening: np.ndarray
    node_mass: np.ndarray
    gravity: np.ndarray


class ClampedSolver:
    """Equilibria of `candidate_count` models in T trials; the state is kept between calls.

    Args:
        setups: one model for each candidate, of the same node count and trials.
        device: Warp device.

    Raises:
        DataError: a trial of the first solution does not reach its reported poses.
    """

    def __init__(self, setups: Sequence[Setup], *, device: str = "cpu", start=None):
        first = setups[0]
        self.candidate_count, self.trial_count = len(setups), len(first.clamp_position)
        self.edge_count = len(first.fraction) - 1
        self.device = device
        arrays = _arrays(setups)
        poses = _poses(setups)
        straight = self._straight(setups, arrays.rest_length)
        self.batch = RodBatch(
            straight,
            director=np.repeat(poses[0][1][:, None, :, 0], self.edge_count + 2, axis=1),
            device=device,
            **vars(arrays),
        )
        free = np.ones(self.batch.dof_count, dtype=bool)
        free[:7] = False
        free[-7:] = False
        self.batch.set_free(free)
        self.system: BandedSystem | None = None
        if start is None:
            self._walk_to(setups, poses)
        else:
            self.restore(start)

    # ---- states -------------------------------------------------------------------------------

    def saved(self) -> tuple[np.ndarray, ...]:
        """Copies of the state's arrays, (candidate x trial, ...)."""
        s = self.batch.state
        return tuple(a.numpy().copy() for a in (s.dof, s.tangent, s.director, s.reference_twist))

    def restore(self, saved: tuple[np.ndarray, ...], rods: np.ndarray | None = None) -> None:
        """Put a saved state back, for the given rods only if a mask (candidate x trial) is given.

        A state of fewer candidates is repeated for all of them.
        """
        s = self.batch.state
        for array, value in zip(
            (s.dof, s.tangent, s.director, s.reference_twist), saved, strict=True
        ):
            repeats = self.batch.rod_count // len(value)
            value = np.tile(value, (repeats,) + (1,) * (value.ndim - 1))
            if rods is not None:
                value = np.where(
                    rods.reshape((-1,) + (1,) * (value.ndim - 1)), value, array.numpy()
                )
            array.assign(value)

    def total_twist(self) -> np.ndarray:
        """(candidate x trial,) twist of every rod from clamp to clamp [rad]."""
        state = self.batch.state
        angle = state.dof.numpy()[:, 3::4]
        return angle[:, -1] - angle[:, 0] + state.reference_twist.numpy()[:, 1:-1].sum(axis=1)

    # ---- equilibria ---------------------------------------------------------------------------

    def solve(self, setups: Sequence[Setup], *, walk: bool = True) -> np.ndarray:
        """Bring every rod to equilibrium with its model; (C, T) whether it got there.

        Without `walk` the clamps go to their new poses at once and a rod that does not follow is
        given up: for a fit it is cheaper to try a shorter step.
        """
        self._assign(setups)
        twist = self.total_twist()
        targets = self._prescribed(*_poses(setups), setups)
        if not walk:
            batch, before = (
                self.batch,
                RodState.zeros(self.batch.rod_count, self.batch.node_count, self.device),
            )
            before.assign(batch.state)
            dof = batch.state.dof.numpy().copy()
            held = batch.free.numpy() == 0
            dof[held] = targets[held]
            batch.state.dof.assign(dof)
            batch.transport_frames(before, batch.state, batch.every_rod)
            targets = None
        reached = self._equilibrium(setups, targets, 1e-9)
        # A rod that gained a turn has jumped to another equilibrium.
        reached &= np.abs(self.total_twist() - twist) < np.pi
        return reached.reshape(-1, self.trial_count)

    def _equilibrium(self, setups, targets, tolerance) -> np.ndarray:
        batch = self.batch
        wind = np.repeat(np.real([s.wind for s in setups]), self.trial_count, axis=0)
        windy = bool(np.any(wind))
        for _ in range(_WIND_PASSES if windy else 1):
            before = batch.point_load.numpy().copy()
            load = _wind_load(batch.positions(), wind) + np.real(self._dead_force(setups))
            batch.point_load.assign(load)
            solver = EquilibriumSolver(batch)
            result = solver.solve(
                prescribed=targets,
                tolerance=tolerance,
                max_iterations=_PATIENCE if targets is None else _WALK_PATIENCE,
            )
            scale = solver.force_scale.numpy()[:, None, None]
            if np.abs(load - before).max(axis=None, initial=0, where=np.isfinite(load)) <= (
                _WIND_TOLERANCE * scale.max()
            ):
                break
        return result.converged

    def _dead_force(self, setups: Sequence[Setup]) -> np.ndarray:
        """(rod, node, 3) forces of the setups, none on the ghosts."""
        shape = (self.trial_count, self.edge_count + 1, 3)
        force = np.concatenate([np.broadcast_to(s.force, shape) for s in setups])
        return np.pad(force, ((0, 0), (1, 1), (0, 0)))

    def _walk_to(self, setups: Sequence[Setup], poses) -> None:
        """From straight and untwisted to the reported poses, the gripper turning the short way."""
        (a, ra), (b, rb) = poses
        start = (
            a
            + np.repeat([np.real(s.length) for s in setups], self.trial_count)[:, None]
            * (ra[:, :, 2])
        )
        turn = Rotation.from_matrix(np.swapaxes(ra, 1, 2) @ rb).as_rotvec()
        for step in range(1, _WAYPOINTS + 1):
            f = step / _WAYPOINTS
            frame = ra @ Rotation.from_rotvec(f * turn).as_matrix()
            targets = self._prescribed((a, ra), (start + f * (b - start), frame), setups)
            converged = self._equilibrium(setups, targets, 1e-6 if step < _WAYPOINTS else 1e-9)
        # Large steps may let a slack rod pass through itself and keep a turn too many. The roll of
        # the clamps is less than half a turn from the untwisted state, so whole turns come out.
        for _ in range(_WAYPOINTS):
            turns = np.rint(self.total_twist() / (2 * np.pi))
            if not turns.any():
                break
            targets = self.batch.state.dof.numpy().copy()
            targets[:, -4] -= 2 * np.pi * turns
            converged = self._equilibrium(setups, targets, 1e-9)
        if not converged.all():
            trial = int(np.argmin(converged)) % self.trial_count
            raise DataError(
                f"the rod of trial {trial} finds no equilibrium at its reported poses; check "
                "length, L_gb and the poses"
            )

    def _straight(self, setups, rest_length) -> np.ndarray:
        a = np.concatenate([np.real(s.clamp_position) for s in setups])
        t = np.concatenate([np.real(s.clamp_rotation) for s in setups])[:, :, 2]
        s = np.cumsum(np.pad(rest_length[:, 1:], ((0, 0), (1, 0))), axis=1)
        s = np.concatenate([-rest_length[:, :1], s], axis=1)
        return a[:, None] + s[:, :, None] * t[:, None]

    def _prescribed(self, clamp, grip, setups) -> np.ndarray:
        """(rod, dof): where the clamps' nodes, ghosts and angles have to be."""
        (a, ra), (b, rb) = clamp, grip
        batch = self.batch
        h = batch.rest_length.numpy()[:, :1]
        principal = np.repeat(np.real([s.principal_angle for s in setups]), self.trial_count)
        dof = batch.state.dof.numpy().copy()
        tangent, director = batch.state.tangent.numpy(), batch.state.director.numpy()
        dof[:, 0:3], dof[:, 4:7] = a - h * ra[:, :, 2], a
        dof[:, -7:-4], dof[:, -3:] = b, b + h * rb[:, :, 2]
        for edge, column, frame in ((0, 3, ra), (-1, -4, rb)):
            carried = _transport(director[:, edge], tangent[:, edge], frame[:, :, 2])
            angle = np.arctan2(
                np.sum(np.cross(frame[:, :, 2], carried) * frame[:, :, 0], axis=1),
                np.sum(carried * frame[:, :, 0], axis=1),
            )
            angle += principal
            # The same angle on the turn that the rod is on.
            dof[:, column] = angle + 2 * np.pi * np.rint((dof[:, column] - angle) / (2 * np.pi))
        return dof

    def _assign(self, setups: Sequence[Setup]) -> None:
        arrays = vars(_arrays(setups))
        self.batch.set_softening(arrays.pop("softening"))
        for name, value in arrays.items():
            array = getattr(self.batch, name)
            array.assign(np.ascontiguousarray(np.broadcast_to(value, _shape(array))))

    # ---- what the sensors see ------------------------------------------------------------------

    def predict(self, setups: Sequence[Setup]) -> Prediction:
        """Markers and wrench in the present state."""
        zero = np.zeros((self.batch.rod_count, self.batch.dof_count))
        self.batch.evaluate(order=1)
        return self._observe(setups, zero, zero)

    def predict_rates(self, rates: Sequence[Sequence[Setup]]) -> list[Prediction]:
        """The present prediction with a derivative as imaginary part, for each list of setups.

        Args:
            rates: setups whose imaginary parts are `COMPLEX_STEP` times a parameter's rate; one
                list, a setup for each candidate, for every parameter.
        """
        batch, count = self.batch, len(rates)
        if self.system is None or self.system.x.shape[1] != count:
            self.system = BandedSystem(batch, right_hand_sides=count)
        system = self.system
        batch.evaluate(order=2)
        system.factorise(batch.derivatives.hessian, batch.every_rod)
        gradient_rate = np.empty((batch.rod_count, count, batch.dof_count))
        step = np.zeros_like(gradient_rate)
        wind_rate = []
        for j, setups in enumerate(rates):
            gradient_rate[:, j] = self._gradient_rate(setups)
            step[:, j] = self._prescribed_rate(setups)
            wind = np.repeat([s.wind for s in setups], self.trial_count, axis=0)
            wind_rate.append(np.imag(wind) / COMPLEX_STEP)
        wind = np.repeat(np.real([s.wind for s in rates[0]]), self.trial_count, axis=0)
        product = self._times_hessian(step)
        free_step = np.zeros_like(step)
        load_rate = np.zeros_like(step)
        windy = bool(np.any(wind) or np.any(wind_rate))
        for _ in range(_WIND_PASSES if windy else 1):
            if windy:
                for j in range(count):
                    load_rate[:, j] = self._wind_rate(
                        wind, wind_rate[j], step[:, j] + free_step[:, j]
                    )
            system.x.assign(load_rate - gradient_rate - product)
            system.solve(batch.every_rod)
            change = np.abs(system.x.numpy() - free_step).max(initial=0.0)
            free_step = system.x.numpy().copy()
            if change <= _WIND_TOLERANCE * np.abs(free_step).max(initial=1e-300):
                break
        step += free_step
        reaction_rate = self._times_hessian(step) + gradient_rate - load_rate
        return [
            self._observe(setups, step[:, j], reaction_rate[:, j]) for j, setups in enumerate(rates)
        ]

    def _times_hessian(self, vectors: np.ndarray) -> np.ndarray:
        batch = self.batch
        product = wp.zeros(vectors.shape, dtype=wp.float64, device=self.device)
        wp.launch(
            banded.multiply,
            dim=vectors.shape,
            inputs=[
                batch.every_rod,
                batch.derivatives.hessian,
                wp.array(vectors, dtype=wp.float64, device=self.device),
            ],
            outputs=[product],
            device=self.device,
        )
        return product.numpy()

    def _gradient_rate(self, setups: Sequence[Setup]) -> np.ndarray:
        """(rod, dof) derivative of the energy's gradient along the setups' imaginary parts."""
        batch, device = self.batch, self.device
        rate = {}
        for name, value in vars(_arrays(setups)).items():
            array = getattr(batch, name)
            value = np.broadcast_to(np.imag(value) / COMPLEX_STEP, _shape(array))
            rate[name] = wp.array(np.ascontiguousarray(value), dtype=array.dtype, device=device)
        out = wp.zeros_like(batch.derivatives.gradient)
        rods, nodes, state = batch.rod_count, batch.node_count, batch.state
        wp.launch(
            stretching_rate,
            dim=(rods, nodes - 1),
            inputs=[
                batch.rest_length,
                batch.stretching_stiffness,
                rate["rest_length"],
                rate["stretching_stiffness"],
                state.dof,
            ],
            outputs=[out],
            device=device,
        )
        names = ("rest_length", "bending_stiffness", "natural_curvature", "softening")
        wp.launch(
            softened_bending_rate,
            dim=(rods, nodes - 2),
            inputs=[getattr(batch, n) for n in names]
            + [rate[n] for n in names]
            + [state.dof, state.director],
            outputs=[out],
            device=device,
        )
        names = ("rest_length", "twisting_stiffness", "natural_twist")
        wp.launch(
            twisting_rate,
            dim=(rods, nodes - 2),
            inputs=[getattr(batch, n) for n in names]
            + [rate[n] for n in names]
            + [state.dof, state.reference_twist],
            outputs=[out],
            device=device,
        )
        no_load = wp.zeros_like(batch.point_load)
        no_energy = wp.zeros_like(batch.derivatives.energy)
        for mass, gravity in (
            (rate["node_mass"], batch.gravity),
            (batch.node_mass, rate["gravity"]),
        ):
            wp.launch(
                dead_loads,
                dim=(rods, nodes),
                inputs=[mass, gravity, no_load, batch.load_factor, batch.every_rod, state.dof],
                outputs=[no_energy, out],
                device=device,
            )
        rate = out.numpy().copy()
        force = np.imag(self._dead_force(setups)) / COMPLEX_STEP
        rate -= np.pad(force, ((0, 0), (0, 0), (0, 1))).reshape(rods, -1)[:, :-1]
        return rate

    def _prescribed_rate(self, setups: Sequence[Setup]) -> np.ndarray:
        """(rod, dof) rates of the clamps' degrees of freedom."""
        step = np.zeros((self.batch.rod_count, self.batch.dof_count))
        (a, ra), (b, rb) = _poses(setups, keep=np.imag)
        ta, tb = (r[:, :, 2] for r in (ra, rb))
        (_, ra0), (_, rb0) = _poses(setups)
        h = self.batch.rest_length.numpy()[:, :1]
        h_rate = np.repeat([np.imag(s.length) for s in setups], self.trial_count) / self.edge_count
        h_rate = h_rate[:, None]
        step[:, 0:3], step[:, 4:7] = a - h * ta - h_rate * ra0[:, :, 2], a
        step[:, -7:-4], step[:, -3:] = b, b + h * tb + h_rate * rb0[:, :, 2]
        principal = np.repeat(np.imag([s.principal_angle for s in setups]), self.trial_count)
        # Time-parallel reference directors do not spin: what is left is the spin of the frame.
        step[:, 3] = np.sum(ra[:, :, 0] * ra0[:, :, 1], axis=1) + principal
        step[:, -4] = np.sum(rb[:, :, 0] * rb0[:, :, 1], axis=1) + principal
        return step / COMPLEX_STEP

    def _wind_rate(self, wind, wind_rate, step) -> np.ndarray:
        position = self.batch.positions() + 1j * COMPLEX_STEP * _nodes(step)
        load = np.imag(_wind_load(position, wind + 1j * COMPLEX_STEP * wind_rate)) / COMPLEX_STEP
        rate = np.zeros((len(step), load.shape[1], 4))
        rate[:, :, :3] = load
        return rate.reshape(len(step), -1)[:, :-1]

    def _observe(self, setups, step, reaction_rate) -> Prediction:
        """Markers, frames and wrench, rates as imaginary parts."""
        batch, i = self.batch, 1j * COMPLEX_STEP
        principal = np.repeat([s.principal_angle for s in setups], self.trial_count)[:, None]
        q = batch.positions() + i * _nodes(step)
        tangent, m1 = _edge_frames(batch, step, principal)
        gradient = batch.derivatives.gradient.numpy() + i * reaction_rate
        force = gradient[:, -7:-4] + gradient[:, -3:]
        arm = q[:, -1] - q[:, -2]
        torque = np.cross(arm, gradient[:, -3:]) + gradient[:, -4:-3] * tangent[:, -1]
        # The banded Hessian is symmetric. The rate of the gradient in the frames that moved along
        # also holds the holonomy of turning the end's tangent, half the twisting moment across it.
        torque = torque - 0.5j * np.real(gradient[:, -4:-3]) * np.imag(tangent[:, -1])
        shape = (self.candidate_count, self.trial_count)
        markers, frames = [], []
        for c, setup in enumerate(setups):
            rods = slice(c * self.trial_count, (c + 1) * self.trial_count)
            weights = _marker_weights(setup)
            markers.append(np.einsum("mn,tnk->tmk", weights, q[rods]))
            frames.append(_frames_at(weights, tangent[rods], m1[rods]))
        return Prediction(
            np.stack(markers),
            np.stack(frames),
            force.reshape(*shape, 3),
            torque.reshape(*shape, 3),
        )


def _transport(v: np.ndarray, t: np.ndarray, u: np.ndarray) -> np.ndarray:
    axis = np.cross(t, u)
    cosine = np.sum(t * u, axis=1, keepdims=True)
    along = np.sum(axis * v, axis=1, keepdims=True) / np.maximum(1.0 + cosine, 1e-12)
    return cosine * v + np.cross(axis, v) + along * axis


def _nodes(dof: np.ndarray) -> np.ndarray:
    return np.pad(dof, ((0, 0), (0, 1))).reshape(len(dof), -1, 4)[:, :, :3]


def _shape(array: wp.array) -> tuple[int, ...]:
    extra = array.dtype._shape_ if hasattr(array.dtype, "_shape_") else ()
    return tuple(array.shape) + tuple(extra)


def _poses(setups: Sequence[Setup], keep=np.real):
    """((a, R_A), (b, R_B)) of every rod."""
    return tuple(
        tuple(keep(np.concatenate([getattr(s, f"{end}_{part}") for s in setups])) for part in parts)
        for end, parts in (("clamp", ("position", "rotation")), ("grip", ("position", "rotation")))
    )


def _arrays(setups: Sequence[Setup]) -> _Arrays:
    """Lay setups out for the batch, ghosts included; complex if they are."""
    rows: dict[str, list] = {name: [] for name in _Arrays.__dataclass_fields__}
    for s in setups:
        n = len(s.fraction) - 1
        h = s.length / n
        share = np.ones(n + 1)
        share[[0, -1]] = 0.5
        c, d = np.cos(s.principal_angle), np.sin(s.principal_angle)
        k = s.natural_curvature
        principal = np.stack([c * k[:, 0] + d * k[:, 1], -d * k[:, 0] + c * k[:, 1]], axis=1)
        rows["rest_length"].append(np.full(n + 2, h))
        rows["stretching_stiffness"].append(np.pad(s.stretching, 1, mode="edge"))
        rows["bending_stiffness"].append(_with_ghosts(s.bending / share[:, None]))
        rows["twisting_stiffness"].append(_with_ghosts(s.twisting / share))
        rows["natural_curvature"].append(_with_ghosts(principal * share[:, None]))
        rows["natural_twist"].append(_with_ghosts(s.natural_twist * share))
        rows["softening"].append(
            _with_ghosts(s.softening / np.stack([share**2, np.ones(n + 1)], axis=1))
        )
        rows["node_mass"].append(np.pad(s.line_mass * h * share + s.node_mass, 1))
        rows["gravity"].append(s.gravity)
    trials = len(setups[0].clamp_position)
    return _Arrays(**{name: np.repeat(np.stack(v), trials, axis=0) for name, v in rows.items()})


def _with_ghosts(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values[:1], values, values[-1:]])


def _wind_load(position: np.ndarray, wind: np.ndarray) -> np.ndarray:
    """(rod, node, 3) forces of a cross-flow on the edges between the clamps."""
    edge = position[:, 2:-1] - position[:, 1:-2]
    length = np.sqrt(np.sum(edge * edge, axis=2, keepdims=True))
    t = edge / length
    w = wind[:, None] * np.ones_like(t)
    across = w - np.sum(w * t, axis=2, keepdims=True) * t
    # The tiny floor keeps the square root analytic in still air.
    speed = np.sqrt(np.sum(across * across, axis=2, keepdims=True) + 1e-60)
    half = 0.5 * length * speed * across
    load = np.zeros_like(position)
    load[:, 1:-2] += half
    load[:, 2:-1] += half
    return load


def _edge_frames(batch: RodBatch, step: np.ndarray, principal: np.ndarray):
    """(rod, edge, 3) tangents and m1 of every edge, rates as imaginary parts."""
    i = 1j * COMPLEX_STEP
    q = batch.positions()
    edge, edge_rate = np.diff(q, axis=1), np.diff(_nodes(step), axis=1)
    length = np.linalg.norm(edge, axis=2, keepdims=True)
    t = edge / length
    t_rate = (edge_rate - np.sum(edge_rate * t, axis=2, keepdims=True) * t) / length
    p = batch.material_directors()
    angle, spin = (
        -np.real(principal)[..., None],
        (step[:, 3::4] - np.imag(principal) / COMPLEX_STEP),
    )
    m1 = np.cos(angle) * p[:, :, 0] + np.sin(angle) * p[:, :, 1]
    m1_rate = spin[..., None] * np.cross(t, m1) - np.sum(t_rate * m1, axis=2, keepdims=True) * t
    return t + i * t_rate, m1 + i * m1_rate


def _marker_weights(setup: Setup) -> np.ndarray:
    """(M, node) weights of the nodes, ghosts included, in each marker's position.

    Cubic Lagrange between the clamps; beyond one, inside a gripper, along its ghost edge.
    """
    n = len(setup.fraction) - 1
    u = setup.marker_arc_length / setup.length * n
    where = np.real(u)
    nodes = np.clip(np.floor(where) - 1, 0, n - 3).astype(int)[:, None] + np.arange(1, 5)
    shares = _lagrange(u[:, None] + 1, nodes)
    outside = (where < -1e-9) | (where > n + 1e-9)
    if outside.any():
        nodes[outside, :2] = np.where(where[outside] < 0, 0, n + 1)[:, None] + np.arange(2)
        shares[outside] = 0.0
        shares[outside, :2] = _lagrange(u[outside, None] + 1, nodes[outside, :2])
    weights = np.zeros((len(u), n + 3), dtype=u.dtype)
    np.put_along_axis(weights, nodes, shares, axis=1)
    return weights


def _lagrange(x: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(M, k) weights of the polynomial through (M, k) nodes at (M, 1) places."""
    gaps = nodes[:, :, None] - nodes[:, None, :] + np.eye(nodes.shape[1])
    factors = (x[:, :, None] - nodes[:, None, :]) / gaps
    same = np.eye(nodes.shape[1], dtype=bool)
    return np.prod(np.where(same, 1.0, factors), axis=2)


def _frames_at(weights: np.ndarray, tangent: np.ndarray, m1: np.ndarray) -> np.ndarray:
    """(T, M, 3, 3) frames: those of the edges averaged at nodes, interpolated, orthonormalised."""

    def at_markers(edges):
        padded = np.concatenate([edges[:, :1], edges, edges[:, -1:]], axis=1)
        return np.einsum("mn,tnk->tmk", weights, 0.5 * (padded[:, 1:] + padded[:, :-1]))

    t, d = at_markers(tangent), at_markers(m1)
    t = t / np.sqrt(np.sum(t * t, axis=2, keepdims=True))
    d = d - np.sum(d * t, axis=2, keepdims=True) * t
    d = d / np.sqrt(np.sum(d * d, axis=2, keepdims=True))
    return np.stack([d, np.cross(t, d), t], axis=3)
