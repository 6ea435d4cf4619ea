"""Internal variables of a batch in time steps: see `wrod.kernels.elastic.inelastic`."""

import warp as wp

from wrod.kernels.elastic import inelastic as kernels
from wrod.rods.batch import RodBatch


class InternalVariables:
    """What rods whose bending remembers have become, step by step.

    Before its first step a rod has gone straight from its natural shape to where it is: slowly, if
    it relaxes.

    Args:
        batch: the rods; without a law that remembers all this does nothing.
    """

    def __init__(self, batch: RodBatch):
        self.batch = batch
        self._ever = wp.full(batch.rod_count, float("inf"), dtype=wp.float64, device=batch.device)
        self.finish(batch.every_rod, self._ever)

    def begin(self, starting: wp.array, span: wp.array) -> None:
        """The rods that start a step bend for the time `span` (rod,) until forces are taken."""
        if self.batch.inelastic is not None:
            self.batch.launch_nodes(kernels.begin_flow, [starting, span], [self.batch.inelastic])

    def finish(self, accepted: wp.array, step: wp.array) -> None:
        """Carry the state at the end of accepted steps of durations `step` over to the next."""
        batch, state = self.batch, self.batch.state
        if batch.inelastic is None:
            return
        inputs = [batch.elastic_model, accepted, step, state.dof, state.director]
        batch.launch_inner(kernels.finish_flow, inputs, [batch.inelastic])

    def forget(self, chosen: wp.array) -> None:
        """The rods that are not 0 in `chosen` (rod,) have never been bent."""
        if self.batch.inelastic is not None:
            self.batch.launch_nodes(kernels.forget_flow, [chosen], [self.batch.inelastic])

    def restart(self, chosen: wp.array) -> None:
        """They have never been elsewhere."""
        self.forget(chosen)
        self.finish(chosen, self._ever)
