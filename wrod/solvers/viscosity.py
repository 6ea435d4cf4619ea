"""Internal damping of a batch in time steps: see `wrod.kernels.stepping.viscosity`."""

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.elastic.model import ElasticModel
from wrod.kernels.stepping import viscosity as kernels
from wrod.kernels.stepping.pace import Pace
from wrod.rods.arrays import filled
from wrod.rods.batch import RodBatch


class Viscosity:
    """A Kelvin-Voigt material's elastic stand-in, step by step.

    Args:
        batch: the rods.
        time: Kelvin-Voigt time, (rod,) of all strains, or (rod, node, 4), broadcast: of the first
            and second bending and the twisting at each node, and of the stretching of the edge
            after it [time]. Given like that, strains are measured even if all are 0.

    Attributes:
        exists: whether strains are measured; the following is there only then.
        model: what `RodBatch.evaluate` takes as `model`.
        strain, strain_older: (rod, node) strains at the start of the step, and of the one before.

    Raises:
        RodError: a time is negative or not finite, or does not broadcast.
    """

    def __init__(self, batch: RodBatch, time: np.ndarray | float):
        self.batch, nodes = batch, batch.node_count
        self.time = batch.zeros(nodes, dtype=wp.vec4d)
        # (rod,) of the stretching: rounding in stiff edges grows with it.
        self.stretching_time = batch.zeros()
        # (1 or rod, node) in which viscous moments of bending and twisting relax.
        self.relaxation = wp.zeros((1, nodes), dtype=wp.float64, device=batch.device)
        self.relaxes = False
        self.set_time(time)
        each = np.ndim(time) > 1
        self.exists = each or bool(np.any(time))
        self.model = None
        if not self.exists:
            return
        model = batch.elastic_model
        own = {name: wp.clone(getattr(model, name)) for name in ElasticModel.vars}
        self.model = filled(ElasticModel(), own)
        self.strain, self.strain_older = (batch.zeros(nodes, dtype=wp.vec4d) for _ in range(2))

    def set_time(self, time: np.ndarray | float) -> None:
        """Another Kelvin-Voigt time, given as before.

        Raises:
            RodError: as above.
        """
        shape = (*self.time.shape, 4)
        time = np.asarray(time, dtype=float)
        if time.ndim == 1:
            time = time[:, None, None]
        try:
            time = np.broadcast_to(time, shape)
        except ValueError:
            raise RodError(
                f"internal damping has shape {time.shape}; give (rod,) or {shape}"
            ) from None
        if not (np.isfinite(time) & (time >= 0)).all():
            raise RodError("internal damping must be finite and not negative")
        self.time.assign(np.ascontiguousarray(time))
        self.stretching_time.assign(time[:, :, 3].max(axis=1))

    def relax(self, time: np.ndarray | float) -> None:
        """Let viscous moments of bending and twisting relax, from none where the rods are now; of
        rods without any nothing does.

        Args:
            time: (rod,) or (1 or rod, node) [time].

        Raises:
            RodError: a time is negative or not finite, or there are others than that.
        """
        time = np.asarray(time, dtype=float)
        if time.ndim < 2:
            rods, nodes = self.time.shape
            time = arguments.spread(time, (rods,), "Dynamics.relax: time", RodError)
            time = np.repeat(time[:, None], nodes, axis=1)
        if not (np.isfinite(time) & (time >= 0.0)).all():
            raise RodError("time in which damping relaxes must be finite and not negative")
        if not (self.exists and time.any()):
            return
        self.relaxes = True
        self.relaxation = self.batch.array(time)
        self._measure(self.batch.every_rod)
        wp.copy(self.strain_older, self.strain)

    def restart(self, chosen: wp.array) -> None:
        """Let rods that are not 0 in `chosen` (rod,) have relaxed where they are now."""
        if self.relaxes:
            self._measure(chosen)
            inputs = [chosen, self.strain]
            self.batch.launch_nodes(kernels.shift_strains, inputs, [self.strain_older])

    def _measure(self, chosen: wp.array) -> None:
        s = self.batch.state
        places = [chosen, s.dof, s.director, s.reference_twist]
        self.batch.launch_nodes(kernels.measure_strains, places, [self.strain])

    def begin(self, pace: Pace) -> None:
        """Let the rest shape of the rods that start a step flow as their history says."""
        if not self.exists:
            return
        if not self.relaxes:
            self._measure(pace.starting)
        self.flow(pace, self.strain, self.strain_older)

    def flow(self, pace: Pace, strain: wp.array, strain_older: wp.array) -> None:
        """The same for a history of strains (rod, node)."""
        if not self.exists:
            return
        batch, model = self.batch, [self.batch.elastic_model, self.time]
        past = [pace, strain, strain_older]
        batch.launch_edges(kernels.flow_stretching, [*model, *past], [self.model])
        batch.launch_inner(kernels.flow_bending, [*model, self.relaxation, *past], [self.model])

    def finish(self, pace: Pace) -> None:
        """Carry the strains of accepted steps over to the next, from where forces are taken, which
        midpoint steps go on from."""
        if not self.exists:
            return
        batch, s = self.batch, self.batch.state
        if self.relaxes:
            inputs = [pace, self.relaxation, s.dof, s.director, s.reference_twist]
            batch.launch_nodes(kernels.relax_strains, inputs, [self.strain, self.strain_older])
        else:
            batch.launch_nodes(
                kernels.shift_strains, [pace.accepted, self.strain], [self.strain_older]
            )
