"""Equilibria of batches of rods: damped Newton on the elastic and gravitational energy."""

from dataclasses import dataclass

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.stepping import continuation
from wrod.kernels.stepping import newton_iteration as newton
from wrod.rods.batch import RodBatch
from wrod.rods.state import Derivatives, RodState
from wrod.solvers.banded import BandedSystem
from wrod.solvers.inertia import rounding_of, usual_force
from wrod.solvers.recording import launching, record, replay

# Largest change of an edge in one Newton step, as a fraction of its length.
_STEP_LIMIT = 0.5
_INDICES = arguments.indices
_SMALLEST_FRACTION = 1e-4
_SMALLEST_PROGRESS = 1e-3
# Rounds of launches that a solver makes before it records one, which costs about as much.
_LAUNCHED = 16
# Shifts of a matrix, and halvings of a step, that are tried: more than can be.
_MOST_SHIFTS, _MOST_HALVINGS = 30, 30


@dataclass(frozen=True)
class Equilibria:
    """What `solve_equilibria` found, rod by rod (NumPy).

    Attributes:
        converged: (rod,) whether the rod is in equilibrium to the tolerance.
        iterations: (rod,) Newton iterations spent.
        residual: (rod,) largest unbalanced force over the rod's force scale.
        negative_pivots: (rod,) negative eigenvalues of the free Hessian; 0 for a stable rod.
        progress: (rod,) fraction of the continuation that was reached; 1 where it converged.
    """

    converged: np.ndarray
    iterations: np.ndarray
    residual: np.ndarray
    negative_pivots: np.ndarray
    progress: np.ndarray


class EquilibriumSolver:
    """Allocates once what `solve` needs for a batch; `solve` is a chain of launches, which a CPU
    keeps recorded for the next one. What the batch's arrays hold may change in between.

    Args:
        batch: the rods; their state is the starting guess and, afterwards, the result.

    Attributes:
        force_scale: (rod,) what residuals are measured against [force]: the largest of k_b / L^2,
            weight and point loads.
    """

    def __init__(self, batch: RodBatch):
        self.batch = batch
        rods, device = batch.rod_count, batch.device
        self.force_scale, self.length_scale = batch.zeros(), batch.zeros()
        self.system = BandedSystem(batch)
        self.trial, self._start = (RodState.zeros(rods, batch.node_count, device) for _ in range(2))
        self._begin = wp.zeros_like(batch.state.dof)
        self.trial_derivatives = Derivatives.zeros(rods, 1, device)
        self.trial_derivatives.gradient = wp.zeros_like(batch.derivatives.gradient)

        self.active, self.searching, self.retry, self.converged, self.iterations = (
            batch.zeros(dtype=wp.int32) for _ in range(5)
        )
        self.slope, self.fraction, self.shift_unit = (batch.zeros() for _ in range(3))
        self.residual, self.tolerance = batch.zeros(), batch.zeros()
        # Whether to take another round, or to try once more within one, and how often it was.
        self._goes_on, self._again, self._rounds, self._tried = (
            wp.zeros(1, dtype=wp.int32, device=device) for _ in range(4)
        )
        self._recorded: dict[tuple[int, bool], wp.Graph | None] = {}
        self._made = 0  # rounds of launches, before the first recording
        self._launched = batch.launched

    def _measure(self) -> None:
        """Scales of the rods as they are now."""
        batch = self.batch
        load = np.linalg.norm(batch.point_load.numpy(), axis=2).sum(axis=1)
        self.force_scale.assign(np.maximum(usual_force(batch), load))
        self.length_scale.assign(batch.rest_length.numpy().sum(axis=1))

    @arguments.checked(
        RodError,
        prescribed=arguments.optional(arguments.numbers_of_any_shape),
        tolerance=arguments.number(1e-16, 1e3),
        max_iterations=arguments.whole(1, 1_000_000),
    )
    def solve(
        self,
        *,
        prescribed: np.ndarray | None = None,
        ramp_loads: bool = False,
        tolerance: float = 1e-9,
        max_iterations: int = 100,
    ) -> Equilibria:
        """Bring every rod to equilibrium.

        A rod that does not converge in one go from its starting guess returns to it and walks
        there in smaller increments of the prescribed degrees of freedom and, if `ramp_loads`, of
        the loads (from none); increments halve on failure and double on success.

        Args:
            prescribed: (rod, dof) values that the degrees of freedom which are not free move to;
                default: where they are.
            ramp_loads: let the continuation raise the loads from zero as well.
            tolerance: largest residual, relative to the force scale (or what rounding leaves).
            max_iterations: of Newton, for each increment: first with steps limited in length only,
                then, from the same start, with a line search on the energy.
        """
        batch = self.batch
        rods = batch.rod_count
        self._measure()
        if self._launched != batch.launched:
            self._launched = batch.launched
            self._recorded.clear()
        start, begin = self._start, self._begin
        start.assign(batch.state)
        wp.copy(begin, batch.state.dof)
        target = begin
        if prescribed is not None:
            prescribed = np.broadcast_to(prescribed, (rods, batch.dof_count))
            if not np.isfinite(prescribed).all():
                raise RodError("a prescribed degree of freedom is not finite")
            target = batch.array(prescribed)

        can_walk = ramp_loads or prescribed is not None
        done = np.zeros(rods)
        increment = np.ones(rods)
        pending = np.ones(rods, dtype=bool)
        converged = np.zeros(rods, dtype=bool)
        iterations = np.zeros(rods, dtype=np.int64)
        residual = np.full(rods, np.inf)
        rounding = rounding_of(batch, self.length_scale.numpy(), self.force_scale.numpy())[:, 0]
        self.tolerance.assign(np.maximum(tolerance, rounding))
        while pending.any():
            progress = np.minimum(done + increment, 1.0)
            missed = pending.copy()
            for search in (False, True):
                self.active.assign(missed.astype(np.int32))
                self._place(start, begin, target, progress, ramp_loads)
                iterations += self._iterate(max_iterations, search)
                residual[missed] = self.residual.numpy()[missed]
                missed &= self.converged.numpy() == 0
                if not missed.any():
                    break
            reached = pending & ~missed
            self._copy(reached, batch.state, start)
            done[reached] = progress[reached]
            increment[reached] = 2.0 * increment[reached]
            increment[missed] = 0.5 * np.minimum(increment, 1.0 - done)[missed]
            converged |= reached & (done >= 1.0)
            pending &= ~converged
            if not can_walk:
                break
            pending &= ~missed | (increment >= _SMALLEST_PROGRESS)
        batch.load_factor.fill_(1.0)
        return Equilibria(
            converged, iterations, residual, self.system.negative_pivots.numpy().copy(), done
        )

    def _place(self, start, begin, target, progress, ramp_loads) -> None:
        """Set prescribed values and loads for this increment, frames carried along."""
        batch = self.batch
        progress = batch.array(progress)
        self._copy(self.active, start, batch.state)
        batch.launch_dofs(
            continuation.interpolate_prescribed,
            [self.active, batch.free, begin, target, progress],
            [batch.state.dof],
        )
        batch.transport_frames(start, batch.state, self.active)
        if ramp_loads:
            wp.copy(batch.load_factor, progress)

    def _copy(self, chosen, source: RodState, target: RodState) -> None:
        if isinstance(chosen, np.ndarray):
            chosen = self.batch.array(chosen, dtype=wp.int32)
        self.batch.copy_states(chosen, source, target)

    def _iterate(self, max_iterations: int, search: bool) -> np.ndarray:
        """Newton on the active rods until each has converged or stopped; iterations per rod.

        A CPU replays what it has launched before, which compiles the kernels: most of the time of
        a long solution would go into making launches, and of a short one into recording them."""
        self.converged.zero_()
        self.system.shift.zero_()
        self.iterations.zero_()
        self._rounds.zero_()

        def take_round() -> None:
            self._correct(search)
            self._look(max_iterations)

        def take_rounds() -> None:
            self._look(max_iterations)
            wp.capture_while(self._goes_on, take_round)

        key, device = (max_iterations, search), wp.get_device(self.batch.device)
        graph = self._recorded.get(key)
        if graph is None and device.is_cpu:
            for _ in range(max(_LAUNCHED - self._made, 1)):
                self._look(max_iterations)
                if not self._goes_on.numpy()[0]:
                    return self.iterations.numpy().astype(np.int64)
                self._correct(search)
                self._made += 1
            graph = record(self.batch.device, take_rounds)
            self._recorded[key] = graph  # none beside threads that may launch
        if graph is None:
            take_rounds()
        else:
            replay(graph)
        return self.iterations.numpy().astype(np.int64)

    def _look(self, max_iterations: int) -> None:
        """Where every active rod is, and whether any has to go on."""
        batch, out, system = self.batch, self.batch.derivatives, self.system
        batch.evaluate(order=2, active=self.active)
        # The factorisation comes first: at equilibrium its pivots tell the stability.
        system.factorise(out.hessian, self.active)
        batch.launch_lanes(
            newton.measure_residual,
            [batch.free, self.force_scale, self.length_scale, self.tolerance]
            + [out.gradient, self.active],
            [self.residual, self.converged],
        )
        self._ask(self.active, max_iterations, self._rounds, self._goes_on)

    def _ask(self, chosen: wp.array, most: int, asked: wp.array, answer: wp.array) -> None:
        """Whether any rod is chosen, `most` times at most."""
        self.batch.launch_lanes(newton.ask_any, [chosen, most, asked], [answer], rods=1)

    def _correct(self, search: bool) -> None:
        """A step of every active rod."""
        batch, out, system = self.batch, self.batch.derivatives, self.system
        batch.launch(newton.count_active, batch.rod_count, [self.active], [self.iterations])
        self._make_definite(out.hessian)
        wp.copy(system.x, out.gradient.reshape(system.x.shape))
        system.solve(self.active)
        self._step(search)

    def _make_definite(self, hessian: wp.array) -> None:
        """Raise the shift of every rod with negative pivots until its matrix is definite."""
        self._tried.zero_()
        self._choose_shift(self.active, hessian)

        def factorise_again() -> None:
            self.system.factorise(hessian, self.retry)
            self._choose_shift(self.retry, hessian)

        wp.capture_while(self._again, factorise_again)

    def _choose_shift(self, chosen: wp.array, hessian: wp.array) -> None:
        batch, system = self.batch, self.system
        batch.launch(
            newton.choose_shift,
            batch.rod_count,
            [chosen, batch.free, hessian, system.negative_pivots],
            [system.shift, self.shift_unit, self.retry],
        )
        self._ask(self.retry, _MOST_SHIFTS, self._tried, self._again)

    def _step(self, search: bool) -> None:
        batch, out, system = self.batch, self.batch.derivatives, self.system
        batch.launch_lanes(
            newton.start_line_search,
            [wp.float64(_STEP_LIMIT), self.active, batch.free]
            + [batch.state.dof, out.gradient, system.x],
            [self.slope, self.fraction, self.searching],
        )
        if search:
            self._tried.zero_()
            self._ask(self.searching, _MOST_HALVINGS, self._tried, self._again)
            wp.capture_while(self._again, self._try_step)
        else:
            self._judge(search)
        # A rod that found no descent has a fraction of zero and takes its own state back.
        self._take(self.active)
        batch.copy_states(self.active, self.trial, batch.state)

    def _take(self, chosen: wp.array) -> None:
        """The trial state: a fraction of the step on."""
        batch, trial = self.batch, self.trial
        batch.launch_spread(
            newton.take_trial_step,
            batch.dof_count,
            [chosen, batch.state.dof, self.system.x, self.fraction],
            [trial.dof],
        )
        batch.transport_frames(batch.state, trial, chosen)

    def _try_step(self) -> None:
        """Energy of the trial state, and whether it will do."""
        self._take(self.searching)
        self.batch.evaluate(
            order=1, state=self.trial, out=self.trial_derivatives, active=self.searching
        )
        self._judge(True)
        self._ask(self.searching, _MOST_HALVINGS, self._tried, self._again)

    def _judge(self, search: bool) -> None:
        self.batch.launch(
            newton.judge_trial_step,
            self.batch.rod_count,
            [int(search), wp.float64(_SMALLEST_FRACTION), self.force_scale, self.length_scale]
            + [self.shift_unit, self.batch.derivatives.energy, self.trial_derivatives.energy]
            + [self.slope, self.fraction, self.searching, self.system.shift],
        )


@launching()
@arguments.checked(RodError)
def solve_equilibria(batch: RodBatch, **options) -> Equilibria:
    """Bring every rod of `batch` to equilibrium; see `EquilibriumSolver.solve` for the options."""
    return EquilibriumSolver(batch).solve(**options)


@arguments.checked(RodError, clamped_nodes=_INDICES, pinned_nodes=_INDICES, clamped_angles=_INDICES)
def prescribe(
    batch: RodBatch, *, clamped_nodes=(), pinned_nodes=(), clamped_angles=()
) -> np.ndarray:
    """Mask (rod, dof) of free degrees of freedom, and set it on `batch`.

    Args:
        clamped_nodes, pinned_nodes: node indices (negative from the end) whose position is
            prescribed. Two clamped neighbours prescribe the direction of the edge between them.
            The rod then begins in the middle of that edge, half an edge early, unless the batch
            was made with `RodBatch.of(..., clamped=...)`, by which it begins at the inner node.
        clamped_angles: edge indices whose material angle is prescribed.
    """
    free = np.ones((batch.rod_count, batch.dof_count), dtype=bool)
    for i in (*clamped_nodes, *pinned_nodes):
        a = 4 * (i % batch.node_count)
        free[:, a : a + 3] = False
    for i in clamped_angles:
        free[:, 4 * (i % (batch.node_count - 1)) + 3] = False
    batch.set_free(free)
    return free
