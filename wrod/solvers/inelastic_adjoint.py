"""The adjoint of rods whose bending remembers, beside that of their steps."""

from __future__ import annotations

from typing import Any

import warp as wp

from wrod.kernels.elastic.inelastic import DAHL
from wrod.kernels.stepping import inelastic_adjoint as kernels
from wrod.rods.batch import RodBatch


class InelasticAdjoint:
    """Goes through memory backwards, with the steps of `wrod.solvers.adjoint.StepAdjoint`.

    Attributes:
        node: (rod, node) what nodes remember at the start of the step gone through last.
        skew, rate: of `wrod.kernels.stepping.adjoint.StepMatrix`; without columns where no law has
            a tangent that is not symmetric.
    """

    def __init__(self, batch: RodBatch):
        self._batch = batch
        self.node = wp.clone(batch.inelastic)
        nodes = batch.node_count
        lopsided = bool((batch.inelastic.numpy()["law"] == int(DAHL)).any())
        columns = nodes if lopsided else 0
        self.skew = batch.zeros(columns)
        self.rate = batch.zeros(columns, 11, dtype=wp.vec2d)

    @property
    def energies(self) -> list:
        """The batch's, as they were in the step gone through last."""
        past = self._batch.inelastic
        return [(k, self.node if n is past else n) for k, n in self._batch.energies]

    def _launch(self, kernel, inputs: list, outputs: list) -> None:
        own = [self._batch.elastic_model, self.node]
        self._batch.launch_inner(kernel, [*own, *inputs], outputs)

    def measure_skew(self, step: Any) -> None:
        """Of the step that was taken up."""
        if self.skew.shape[1]:
            self._launch(kernels.measure_skew, [step], [self.skew, self.rate])

    def want_flowed(self, step: Any, now: Any, model: Any) -> None:
        """What later steps want of memory, of the step's end."""
        self._launch(kernels.want_flowed, [step], [now, model])

    def want_before(self, step: Any, x: wp.array, now: Any, before: Any, model: Any) -> None:
        """From the end of the step to its start."""
        self._launch(kernels.want_remembered, [step, x, now], [before, model])

    def want_begun(self, chosen: wp.array, now: Any, model: Any) -> None:
        """Of the rods that are not 0 in `chosen` (rod,), which have never been elsewhere."""
        self._launch(kernels.want_begun, [chosen], [now, model])
