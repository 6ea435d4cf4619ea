"""Rods of a Newton model as rows of a batch."""

from __future__ import annotations

import numpy as np
from newton import Model

from wrod.kernels.stepping.exchange import Span
from wrod.newton_solver.attributes import CLAMPED, FREE
from wrod.rods.batch import RodBatch


class Layout:
    """Rods with as many nodes, and as many clamps, as each other.

    A clamped end has one node more in the batch than in the model: the rod goes on into the clamp
    by an edge, whose direction is the clamp's.

    Args:
        model: the Newton model.
        rods: indices of the rods into the model's.
        holds: (rod, 2) what holds their starts and ends: FREE, PINNED or CLAMPED.

    Attributes:
        count: nodes of each rod in the model.
        first_node, first_edge: (rod,) where they begin in the model.
        lead: (rod,) nodes in the batch before them, 0 or 1.
    """

    def __init__(self, model: Model, rods: np.ndarray, holds: np.ndarray):
        der = model.der
        self.model, self.holds = model, holds
        self.count = int(der.rod_node_count.numpy()[rods[0]])
        self.first_node = der.rod_first_node.numpy()[rods]
        self.first_edge = der.rod_first_edge.numpy()[rods]
        self.lead = (holds[:, 0] == CLAMPED).astype(int)
        nodes = self.count + int((holds[0] == CLAMPED).sum())
        # Nodes and edges of the model for those of the batch; what a clamp adds repeats the last.
        at = np.arange(nodes) - self.lead[:, None]
        self._nodes = self.first_node[:, None] + np.clip(at, 0, self.count - 1)
        self._edges = self.first_edge[:, None] + np.clip(at[:, :-1], 0, self.count - 2)
        self._at_start = (at == 0) & (holds[:, :1] == CLAMPED)
        self._at_end = (at == self.count - 1) & (holds[:, 1:] == CLAMPED)

    def spans(self) -> np.ndarray:
        """(rod,) records of `wrod.kernels.stepping.exchange.Span`."""
        out = np.zeros(len(self.lead), dtype=Span.numpy_dtype())
        out["node"], out["edge"], out["lead"] = self.first_node, self.first_edge, self.lead
        out["count"] = self.count
        return out

    def make_batch(self, gravity: np.ndarray) -> RodBatch:
        """The rods in their first shapes under `gravity` (rod, 3), with held ends not free."""
        der, n, e = self.model.der, self._nodes, self._edges
        # A clamp holds from the first node on: only the half of that node's length which is free
        # bends and twists, so it is twice as stiff, and turns by half as much at rest.
        stiffer = np.where(self._at_start | self._at_end, 2.0, 1.0)
        position = der.node_q.numpy()[n]
        starts, ends = self._at_start.any(axis=1), self._at_end.any(axis=1)
        position[starts, 0] -= position[starts, 2] - position[starts, 1]
        position[ends, -1] += position[ends, -2] - position[ends, -3]
        batch = RodBatch(
            position,
            rest_length=der.edge_rest_length.numpy()[e],
            stretching_stiffness=der.edge_stretching_stiffness.numpy()[e],
            bending_stiffness=der.node_bending_stiffness.numpy()[n] * stiffer[:, :, None],
            twisting_stiffness=der.node_twisting_stiffness.numpy()[n] * stiffer,
            natural_curvature=der.node_natural_curvature.numpy()[n] / stiffer[:, :, None],
            natural_twist=der.node_natural_twist.numpy()[n] / stiffer,
            softening=der.node_softening.numpy()[n] * stiffer[:, :, None] ** [-2.0, 0.0],
            inelastic=der.node_inelastic.numpy()[n] * stiffer[:, :, None] ** [0.0, 0.0, -1.0, 0.0],
            node_mass=der.node_mass.numpy()[n],
            gravity=gravity,
            director=der.edge_director.numpy()[e],
            device=str(self.model.device),
        )
        batch.set_free(self._free(batch.dof_count))
        return batch

    def _free(self, dof_count: int) -> np.ndarray:
        free = np.ones((len(self.lead), dof_count), dtype=bool)
        for row, lead in enumerate(self.lead):
            for side, kind in enumerate(self.holds[row]):
                if kind == FREE:
                    continue
                # First column of the end's node, and of the clamp's angle and node beyond it.
                end = 4 * (lead + side * (self.count - 1))
                free[row, end : end + 3] = False
                if kind == CLAMPED:
                    inside = slice(end - 4, end) if side == 0 else slice(end + 3, end + 7)
                    free[row, inside] = False
        return free
