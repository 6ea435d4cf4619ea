"""Equilibria of clamped rods for many candidate models at once.

The batch holds candidate x trial rods, laid out by `wrod.identification.clamped.layout`.
"""

import operator
from collections.abc import Sequence

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from wrod.errors import DataError
from wrod.identification.clamped.branches import FoundBranch, from_measured, settle
from wrod.identification.clamped.layout import (
    batch_arrays,
    coupling_of,
    dead_force,
    end_poses,
    full_shape,
    inelastic_of,
    law_layers,
    wind_load,
)
from wrod.identification.clamped.sensing import END, Prediction, View
from wrod.identification.clamped.sensitivity import WIND_PASSES, Sensitivity
from wrod.identification.clamped.setup import ClampedSetup
from wrod.kernels.elastic.bend_twist import bend_twist_energy
from wrod.kernels.elastic.inelastic import inelastic_energy
from wrod.rods.arrays import never_bent
from wrod.rods.batch import RodBatch
from wrod.rods.rotation import angle_about, transport
from wrod.rods.state import RodState
from wrod.solvers.statics import EquilibriumSolver, prescribe

_WAYPOINTS = 8
# Over the force scale, by how much a wind's load is another one where rods have moved to; a rod at
# which it goes on changing by more than the second is not at rest.
_SAME_WIND, _SETTLED_WIND = 1e-9, 1e-6
_PATIENCE, _WALK_PATIENCE, _FALL_PATIENCE = 12, 60, 150


class ClampedSolver:
    """Equilibria of `candidate_count` models in T trials; the state is kept between calls.

    Args:
        setups: one model for each candidate, of the same node count and trials.
        device: Warp device.
        start: a state to begin with; by default rods are led to their poses from straight, and
            put on their stable branch (`branches`, one entry per rod).
        shape: (T, node, 3) measured positions of the nodes, to choose that branch by.

    Raises:
        DataError: a trial of the first solution does not reach its reported poses.
    """

    def __init__(
        self, setups: Sequence[ClampedSetup], *, device: str = "cpu", start=None, shape=None
    ):
        first = setups[0]
        self.candidate_count, self.trial_count = len(setups), len(first.clamp_position)
        self.edge_count = len(first.fraction) - 1
        self.device = device
        arrays = batch_arrays(setups)
        poses = end_poses(setups)
        straight = self._straight(setups, arrays["rest_length"])
        self.batch = RodBatch(
            straight,
            director=np.repeat(poses[0][1][:, None, :, 0], self.edge_count + 2, axis=1),
            device=device,
            **arrays,
        )
        self._assign_sections(setups)
        self._are = list(setups)
        prescribe(self.batch, clamped_nodes=(0, 1, -2, -1), clamped_angles=(0, -1))
        self.sensitivity = Sensitivity(self.batch, self.trial_count, self.edge_count)
        self._equilibria = EquilibriumSolver(self.batch)
        self.principal = np.zeros(self.batch.rod_count)
        self.negative = np.zeros(self.batch.rod_count, dtype=int)
        self.branches: list[FoundBranch] = []
        if start is None:
            self._find(setups, poses, shape)
        else:
            self.restore(start)

    # ---- states -------------------------------------------------------------------------------

    def saved(self) -> tuple[np.ndarray, ...]:
        """Copies of the state's arrays, (candidate x trial, ...)."""
        s = self.batch.state
        arrays = (s.dof, s.tangent, s.director, s.reference_twist)
        return (*(a.numpy().copy() for a in arrays), self.principal.copy())

    def begin(self, setups: Sequence[ClampedSetup], saved: tuple[np.ndarray, ...]) -> None:
        """Be as a new solver of these models, which begins with a saved state."""
        self._assign(setups)
        self.negative[:] = 0
        self.restore(saved)

    def restore(self, saved: tuple[np.ndarray, ...], rods: np.ndarray | None = None) -> None:
        """Put a saved state back, for the given rods only if a mask (candidate x trial) is given.

        A state of fewer candidates is repeated for all of them.
        """
        s = self.batch.state
        *arrays, principal = saved

        def merged(value, present):
            repeats = self.batch.rod_count // len(value)
            value = np.tile(value, (repeats,) + (1,) * (value.ndim - 1))
            if rods is None:
                return value
            return np.where(rods.reshape((-1,) + (1,) * (value.ndim - 1)), value, present)

        for array, value in zip(
            (s.dof, s.tangent, s.director, s.reference_twist), arrays, strict=True
        ):
            array.assign(merged(value, array.numpy()))
        self.principal = merged(principal, self.principal)

    def total_twist(self) -> np.ndarray:
        """(candidate x trial,) twist of every rod from clamp to clamp [rad]."""
        state = self.batch.state
        angle = state.dof.numpy()[:, 3::4]
        return angle[:, -1] - angle[:, 0] + state.reference_twist.numpy()[:, 1:-1].sum(axis=1)

    # ---- equilibria ---------------------------------------------------------------------------

    def solve(self, setups: Sequence[ClampedSetup], *, walk: bool = True) -> np.ndarray:
        """Bring every rod to equilibrium with its model; (C, T) whether it got there.

        Without `walk` the clamps go to their new poses at once and a rod that does not follow is
        given up: for a fit it is cheaper to try a shorter step.
        """
        self._assign(setups)
        self._turn_principal(setups)
        twist = self.total_twist()
        clamp, grip = end_poses(setups)
        targets = self._prescribed(clamp, grip, setups)
        if not walk:
            held = self.batch.free.numpy() == 0
            self._move_to(np.where(held, targets, self.batch.state.dof.numpy()))
            targets = None
        reached = self._equilibrium(setups, targets, 1e-9)
        # A rod that gained a turn has jumped to another equilibrium.
        reached &= np.abs(self.total_twist() - twist) < np.pi
        return reached.reshape(-1, self.trial_count)

    def _equilibrium(self, setups, targets, tolerance, patience=None) -> np.ndarray:
        batch, solver = self.batch, self._equilibria
        wind = np.repeat(np.real([s.wind for s in setups]), self.trial_count, axis=0)
        windy = bool(np.any(wind))
        load, dead = wind_load(batch.positions(), wind), np.real(dead_force(setups))
        for _ in range(WIND_PASSES if windy else 1):
            before = load
            batch.point_load.assign(load + dead)
            result = solver.solve(
                prescribed=targets,
                tolerance=tolerance,
                max_iterations=patience or (_PATIENCE if targets is None else _WALK_PATIENCE),
            )
            self.negative = result.negative_pivots
            if not windy:
                return result.converged
            load = wind_load(batch.positions(), wind)
            # Of each rod, over its forces; that of one which is lost is NaN.
            change = np.abs(load - before).max(axis=(1, 2)) / solver.force_scale.numpy()
            if not (change > _SAME_WIND).any():
                break
        return result.converged & ~(change > _SETTLED_WIND)

    def _find(self, setups: Sequence[ClampedSetup], poses, shape) -> None:
        """Lead every rod to its poses, and from there to its branch."""
        count = self.batch.rod_count
        measured = None
        if shape is not None:
            shape = np.tile(shape, (self.candidate_count, 1, 1))
            straight = self.saved()
            measured, certain = from_measured(self, setups, shape)
            if certain.all():
                self.branches = [FoundBranch(0, 1, "measured")] * count
                return
            self.restore(straight)
        walked = self._walk_to(setups, poses)
        if walked.all() and measured is None and not self.negative.any():
            self.branches = [FoundBranch(0, 1, "straight")] * count
            return
        self.branches = settle(self, setups, walked, shape, measured)
        lost = [b.found == 0 for b in self.branches]
        if any(lost):
            trial = int(np.argmax(lost)) % self.trial_count
            raise DataError(
                f"the rod of trial {trial} finds no equilibrium at its reported poses; check "
                "length, L_gb and the poses"
            )

    def shape_to(
        self, setups: Sequence[ClampedSetup], shape: np.ndarray, state=None, turns=0, roll=0.0
    ) -> None:
        """Put the rods' (rod, node, 3) nodes between the clamps somewhere, the clamps to their
        poses, and the least twist evenly along them, with whole `turns` more in its sense (-1: the
        least of the other sense), and their middle rolled by an angle [rad]; or leave it as in a
        saved `state`."""
        self._assign(setups)
        clamp, grip = end_poses(setups)
        (a, ra), (b, rb) = clamp, grip
        batch = self.batch
        h = batch.rest_length.numpy()[:, :1]
        nodes = np.concatenate(
            [(a - h * ra[:, :, 2])[:, None], shape, (b + h * rb[:, :, 2])[:, None]], axis=1
        )
        nodes[:, 1], nodes[:, -2] = a, b
        if state is None:
            batch.set_configuration(nodes, director=ra[:, :, 0])
            dof = self._prescribed(clamp, grip, setups)
            share = np.linspace(0.0, 1.0, dof[:, 3::4].shape[1])
            batch.state.dof.assign(dof)
            twist = self.total_twist()
            least = twist - 2 * np.pi * np.rint(twist / (2 * np.pi))
            more = least - twist + 2 * np.pi * np.sign(least) * turns
            dof[:, 3::4] = dof[:, 3:4] + share * (dof[:, -4] + more - dof[:, 3])[:, None]
            dof[:, 3::4] += roll * np.sin(np.pi * share)
            batch.state.dof.assign(dof)
            self.principal = self._principal_of(setups)
            return
        self.restore(state)
        dof = batch.state.dof.numpy().copy()
        for axis in range(3):
            dof[:, axis::4] = nodes[:, :, axis]
        self._move_to(dof)

    def _move_to(self, dof: np.ndarray) -> None:
        """Put the rods' degrees of freedom elsewhere and carry the frames along."""
        batch = self.batch
        before = RodState.zeros(batch.rod_count, batch.node_count, self.device)
        before.assign(batch.state)
        batch.state.dof.assign(dof)
        batch.transport_frames(before, batch.state, batch.every_rod)

    def _principal_of(self, setups: Sequence[ClampedSetup]) -> np.ndarray:
        """(candidate x trial,) angle of the principal directions in the models."""
        return np.repeat(np.real([s.principal_angle for s in setups]), self.trial_count)

    def relax(self, setups: Sequence[ClampedSetup]) -> np.ndarray:
        """Equilibrium of every rod from where it is; (rod,) whether it got there."""
        return self._equilibrium(setups, None, 1e-9, _FALL_PATIENCE)

    def _walk_to(self, setups: Sequence[ClampedSetup], poses) -> np.ndarray:
        """From straight and untwisted to the reported poses, the gripper turning the short way."""
        (a, ra), (b, rb) = poses
        length = np.repeat([np.real(s.length) for s in setups], self.trial_count)
        start = a + length[:, None] * ra[:, :, 2]
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
        return converged

    def _turn_principal(self, setups: Sequence[ClampedSetup]) -> None:
        """Turn the directors that the solver carries to the principal directions of the models.

        Were only the clamps' to turn, the rod would be twisted on the way and might stay so.
        """
        principal = self._principal_of(setups)
        dof = self.batch.state.dof.numpy().copy()
        dof[:, 3::4] += (principal - self.principal)[:, None]
        self.batch.state.dof.assign(dof)
        self.principal = principal

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
        principal = self._principal_of(setups)
        dof = batch.state.dof.numpy().copy()
        tangent, director = batch.state.tangent.numpy(), batch.state.director.numpy()
        dof[:, 0:3], dof[:, 4:7] = a - h * ra[:, :, 2], a
        dof[:, -7:-4], dof[:, -3:] = b, b + h * rb[:, :, 2]
        for edge, column, frame in ((0, 3, ra), (-1, -4, rb)):
            carried = transport(director[:, edge], tangent[:, edge], frame[:, :, 2])
            angle = angle_about(frame[:, :, 2], carried, frame[:, :, 0]) + principal
            # The same angle on the turn that the rod is on.
            dof[:, column] = angle + 2 * np.pi * np.rint((dof[:, column] - angle) / (2 * np.pi))
        return dof

    def _assign(self, setups: Sequence[ClampedSetup]) -> None:
        """Be rods of these models, which they may be already."""
        if len(setups) == len(self._are) and all(map(operator.is_, setups, self._are)):
            return
        self._are = list(setups)
        arrays = batch_arrays(setups)
        self.batch.set_softening(arrays.pop("softening"))
        for name, value in arrays.items():
            array = getattr(self.batch, name)
            array.assign(np.ascontiguousarray(np.broadcast_to(value, full_shape(array))))
        self._assign_sections(setups)

    def _assign_sections(self, setups: Sequence[ClampedSetup]) -> None:
        """Laws of bending and couplings beyond what `batch_arrays` holds."""
        self.batch.set_layers([(np.real(k), np.real(c)) for k, c in law_layers(setups)])
        coupling = np.real(coupling_of(setups))
        kept = dict(self.batch.energies)
        self.batch.energies.clear()
        if coupling.any():
            self.batch.add_energy(bend_twist_energy, coupling)
        yielding = np.real(inelastic_of(setups))
        if yielding[..., 1].any():
            # Nothing of a trial is remembered: each equilibrium is that of a rod never bent before.
            self.batch.add_energy(inelastic_energy, never_bent(self.batch, yielding))
        for i, (kernel, number) in enumerate(self.batch.energies):
            if kernel in kept:  # what is recorded goes on with it
                wp.copy(kept[kernel], number)
                self.batch.energies[i] = kernel, kept[kernel]

    # ---- what the sensors see ------------------------------------------------------------------

    def predict(self, setups: Sequence[ClampedSetup]) -> Prediction:
        """Markers and wrench in the present state."""
        zero = np.zeros((self.batch.rod_count, self.batch.dof_count))
        self.batch.evaluate(order=1)
        return View(self.batch).observe(setups, zero, zero[:, -END:])

    def predict_rates(self, rates, wanted=None) -> list[Prediction]:
        """The present prediction with its derivatives; see `Sensitivity.predict_rates`."""
        return self.sensitivity.predict_rates(rates, wanted)
