"""What steps want of the rods' properties."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrod.kernels.stepping import model_adjoint
from wrod.solvers.inertia import line_density

if TYPE_CHECKING:
    from wrod.solvers.dynamics import Dynamics


class PropertyAdjoint:
    """Sums up what steps want of rods' stiffness, shape, damping, masses and loads.

    Args:
        dynamics: that has taken the steps.
        viscous_time: (rod, node) of every strain; without columns if there is none.
        air_of_mass: as of `wrod.solvers.adjoint.StepAdjoint`.

    Attributes:
        model: `wrod.kernels.stepping.model_adjoint.WantedModel`, summed up until `clear`.
        spins: (rod, piece) what a step wants of the inertia of edges about themselves.
        piece: (node,) the piece of the row that a node is of.
    """

    def __init__(self, dynamics: Dynamics, viscous_time: wp.array, air_of_mass: np.ndarray | None):
        batch = dynamics.batch
        self._batch, self._dynamics, self._viscous_time = batch, dynamics, viscous_time
        nodes = batch.node_count
        model = self.model = model_adjoint.WantedModel()
        columns = dict.fromkeys(("rest_length", "stretching"), nodes - 1)
        columns["viscous_time"] = viscous_time.shape[1]
        for name, kind in model_adjoint.WantedModel.vars.items():
            shape = () if name == "gravity" else (columns.get(name, nodes),)
            setattr(model, name, batch.zeros(*shape, dtype=kind.type.dtype))
        if air_of_mass is None:
            air_of_mass = np.repeat(dynamics.air_damping.numpy()[:, None], nodes, axis=1)
        self._air_of_mass = batch.array(air_of_mass)
        self._stillest = batch.array(np.argmin(air_of_mass, axis=1), dtype=wp.int32)
        # An edge's inertia goes with the mass of its piece of the row.
        ends = np.array([*batch.cut_edges, nodes - 1])
        piece = np.searchsorted(ends, np.arange(nodes))
        total = np.stack([batch.node_mass.numpy()[:, piece == k].sum(axis=1)
                          for k in range(len(ends))], axis=1)  # fmt: skip
        share = dynamics.mass.numpy()[:, 3::4] / np.maximum(total[:, piece[:-1]], 1e-300)
        self.piece = batch.array(piece, dtype=wp.int32)
        self._spin_share = batch.array(share)
        density = line_density(batch)
        density[:, list(batch.cut_edges)] = 0.0
        self._density = batch.array(density)
        self.spins = batch.zeros(len(ends))

    def clear(self) -> None:
        """Want nothing any more."""
        for name in model_adjoint.WantedModel.vars:
            getattr(self.model, name).zero_()

    def want(self, gravity: wp.array, step: Any, x: wp.array, levels: tuple) -> None:
        """Add what a step wants of the properties, and of strains before it.

        Args:
            gravity: (rod,) that it was taken under.
            step: `wrod.kernels.stepping.trace.OneStep`.
            x: (rod, 1, dof) its multipliers.
            levels: `wrod.kernels.stepping.trace.Wanted` at its start, and a step earlier.
        """
        batch = self._batch
        inputs = [batch.elastic_model, self._viscous_time, step, x]
        batch.launch_edges(model_adjoint.want_stretching, inputs, [*levels, self.model])
        batch.launch_inner(model_adjoint.want_bending, inputs, [*levels, self.model])
        batch.launch_nodes(
            model_adjoint.want_masses,
            [self._air_of_mass, self._dynamics.air_damping, self._stillest, self._dynamics.mass]
            + [batch.node_mass, batch.load_factor, gravity, batch.rest_length]
            + [self._spin_share, self.piece, step, x],
            [self.spins, self.model],
        )
        batch.launch_nodes(
            model_adjoint.share_spins, [self._density, self.piece, self.spins], [self.model]
        )
