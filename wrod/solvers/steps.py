"""What a batch of rods carries from time step to time step."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.lanes import WARP
from wrod.kernels.stepping.pace import Pace
from wrod.kernels.stepping.trace import OneStep
from wrod.rods.arrays import filled
from wrod.rods.batch import RodBatch
from wrod.rods.device import OnDevice
from wrod.rods.state import RodState, node_positions

SCHEMES = ("euler", "bdf2", "midpoint")


class Motion(Protocol):
    """What moves prescribed degrees of freedom: called at the start of every step, it writes where
    they are at the end of the step into `state.dof` and may change `batch.free`.

    It does so by kernels alone: on a GPU the launches of a long `Dynamics.advance` are recorded and
    replayed."""

    def prescribe(self, running: wp.array, time: wp.array, step: wp.array, start: RodState): ...


@dataclass(frozen=True)
class Progress:
    """Where a call of `Dynamics.advance` got, rod by rod (NumPy).

    Attributes:
        time: (rod,) time reached.
        diverged: (rod,) whether the rod was cut out because no step converged; its state is the
            last good one.
        steps: (rod,) accepted steps since the start of the simulation.
        iterations: (rod,) Newton iterations since then.
    """

    time: np.ndarray
    diverged: np.ndarray
    steps: np.ndarray
    iterations: np.ndarray


class Steps(OnDevice):
    """Where the time steps of a batch's rods are, every rod at its own pace.

    Args:
        batch: the rods, at rest in their initial configuration.

    Attributes:
        time, until, step, step_before: (rod,) present time, time to reach, this and the last step.
        span, coefficient: (rod,) time from the start of the step to where its forces are, and the
            scheme's coefficients (`wrod.kernels.stepping.dynamics`).
        running, starting, active, converged, accepted, rejected, diverged: (rod,) where each is.
        start: configurations at the start of the step.
        velocity, velocity_older, dof_older: (rod, dof) of the last steps.
        pace: all that is (rod,) above, for kernels.
        present: the present step, for kernels, without what is viscous or touches
            (`wrod.kernels.stepping.trace.OneStep`).
        taken: (rod,) part of the last Newton step that was taken.
        reaction: (rod, dof) forces that held prescribed degrees of freedom at the end of the last
            step.
    """

    # The system of the Newton iterations, what couples edges in it, and what residuals and
    # positions are measured against: who takes the steps says them.
    system: Any
    rod_contact: Any
    force_scale: wp.array
    length_scale: wp.array

    def __init__(self, batch: RodBatch):
        self.batch = batch
        rods, device = batch.rod_count, batch.device
        self.start = RodState.zeros(rods, batch.node_count, device)
        self.start.assign(batch.state)

        floats = batch.zeros

        def ints():
            return batch.zeros(dtype=wp.int32)

        self.step_tolerance, self.residual = floats(), floats()
        self.time, self.until, self.step, self.step_before = (floats() for _ in range(4))
        self.span, self._no_step = floats(), floats()
        # Why a rod leaves its scheme.
        self.leaves, self.touching = ints(), ints()
        self.wanted_step = floats()
        self.taken = wp.ones(rods, dtype=wp.float64, device=device)
        self.coefficient = batch.zeros(dtype=wp.vec3d)
        self.running, self.starting, self.active, self.converged = (ints() for _ in range(4))
        self.iteration, self.iteration_count = ints(), ints()
        self.accepted, self.rejected, self.diverged, self.step_count = (ints() for _ in range(4))
        self.pace = filled(Pace(), {name: getattr(self, name) for name in Pace.vars})
        self.velocity, self.velocity_older, self.reaction = (
            batch.zeros(batch.dof_count) for _ in range(3)
        )
        self.dof_older = wp.clone(batch.state.dof)
        self._end = wp.clone(batch.state.dof)
        state, start = batch.state, self.start
        self.present = filled(
            OneStep(),
            {
                "active": self.active, "coefficient": self.coefficient, "span": self.span,
                "whole": self.step, "time": self.time, "until": self.until, "dof": state.dof,
                "tangent": state.tangent, "director": state.director,
                "twist": state.reference_twist, "dof_before": start.dof,
                "tangent_before": start.tangent, "director_before": start.director,
                "dof_older": self.dof_older, "velocity": self.velocity,
                "velocity_older": self.velocity_older,
            },
        )  # fmt: skip

    @arguments.checked(RodError, velocity=arguments.numbers_of_any_shape)
    def set_velocity(self, velocity: np.ndarray) -> None:
        """(rod, node, 3) velocities of the nodes now; the edges do not spin."""
        batch = self.batch
        dof = np.zeros((batch.rod_count, batch.node_count, 4))
        dof[:, :, :3] = arguments.spread(
            velocity, dof[:, :, :3].shape, "Dynamics: velocity", RodError
        )
        self.velocity.assign(dof.reshape(batch.rod_count, -1)[:, :-1])
        self.step_before.zero_()

    def velocities(self) -> np.ndarray:
        """(rod, node, 3) velocities of the nodes."""
        return node_positions(self.velocity.numpy())

    def _per_rod(self, kernel, inputs, outputs=()) -> None:
        self.batch.launch(kernel, self.batch.rod_count, inputs, outputs, WARP)


def unit_pace(batch: RodBatch, *coefficient: float) -> Pace:
    """Every rod at time 0 in an accepted step of length 1, where rates are differences with three
    coefficients: for kernels that derivatives of steps share with those of rods at rest."""
    rods, device, pace = batch.rod_count, batch.device, Pace()
    pace.accepted, pace.time = batch.every_rod, batch.zeros()
    pace.coefficient = wp.full(rods, wp.vec3d(*coefficient), dtype=wp.vec3d, device=device)
    pace.step = wp.ones(rods, dtype=wp.float64, device=device)
    return pace
