"""The adjoint of what a batch's rods touch, in the steps of `wrod.solvers.adjoint.StepAdjoint`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrod.kernels.contact import edge_adjoint, plane_adjoint, planes, rolling, rolling_adjoint
from wrod.kernels.contact.law import ContactStep
from wrod.kernels.contact.shapes import Borne
from wrod.kernels.stepping.adjoint import EdgeBlock, RollBlock
from wrod.rods.arrays import filled
from wrod.rods.state import Derivatives
from wrod.solvers.carried_adjoint import CarriedAdjoint
from wrod.solvers.carried_shapes import CarriedShapes
from wrod.solvers.trace import contact_of, solids_of

if TYPE_CHECKING:
    from wrod.solvers.dynamics import Dynamics
    from wrod.solvers.property_adjoint import PropertyAdjoint


class ContactAdjoint:
    """What contact has in the matrix of steps, and what is wanted of what it remembers.

    Args:
        dynamics: that has taken the steps.
        step: `wrod.kernels.stepping.trace.OneStep` that is gone through.
        bristles: what friction remembers in it, as of `wrod.solvers.trace.bristle_arrays`.
        stiffness_of_mass: as of `wrod.solvers.adjoint.StepAdjoint`.

    Attributes:
        matrix: arrays of `wrod.kernels.stepping.adjoint.StepMatrix`, by name; without columns where
            nothing is touched like that.
        by_friction, by_shape: as of `StepAdjoint`.
        borne: how multipliers of bodies would move the shapes that they carry.
    """

    def __init__(
        self, dynamics: Dynamics, step: Any, bristles: dict, stiffness_of_mass: np.ndarray | None
    ):
        batch = self._batch = dynamics.batch
        rods, nodes = batch.rod_count, batch.node_count
        self._contact, self._solids = contact_of(dynamics), solids_of(dynamics)
        self._rolls = self._contact is not None and self._contact.holds_roll

        of_nodes, of_edges = nodes * (self._contact is not None), nodes - 1
        of_solids = of_edges * (self._solids is not None)
        self.matrix = {
            "coupling": batch.zeros(of_nodes, dtype=wp.mat33d),
            "block": batch.zeros(of_solids, dtype=EdgeBlock),
            "roll": batch.zeros(of_edges * self._rolls),
            "roll_with_next": batch.zeros(of_edges * self._rolls),
            "roll_of_node": batch.zeros(of_nodes * self._rolls, dtype=wp.vec3d),
            "roll_of_edge": batch.zeros(of_solids * self._rolls, dtype=RollBlock),
        }
        shapes = 0 if self._contact is None else self._contact.table.shape[1]
        self.by_friction = batch.zeros(shapes)
        vectors = {
            name: batch.zeros(shapes, dtype=wp.vec3d) for name in edge_adjoint.WantedShapes.vars
        }
        self.by_shape = filled(edge_adjoint.WantedShapes(), vectors)
        self.borne = Borne()
        self.borne.shift, self.borne.turn = (batch.zeros(0, dtype=wp.vec3d) for _ in range(2))
        if stiffness_of_mass is None:
            stiffness_of_mass = np.zeros((rods, nodes))
        self._stiffness_share = batch.array(stiffness_of_mass)
        burdened = np.full((rods, nodes), self._contact is not None and self._contact.burdened)
        self._burdened = batch.array(burdened, dtype=wp.int32)
        if self._contact is not None:
            self._per_mass = batch.array(stiffness_of_mass / self._contact.model.stiffness.numpy())
            own = ("active", "span", "dof", "dof_before")
            known = {
                "iteration": self._contact.ended,
                **{name: getattr(step, name) for name in own},
            }
            of_edges = {n for n in bristles if n.startswith("edge_")}
            self._of_nodes = filled(
                ContactStep(), known | {n: bristles[n] for n in bristles.keys() - of_edges}
            )
            self._of_edges = filled(
                ContactStep(), known | {n.removeprefix("edge_"): bristles[n] for n in of_edges}
            )

    @property
    def carried(self) -> CarriedShapes | None:
        """Shapes that move with the rods, if any do."""
        return None if self._solids is None else self._solids.carried

    def carry(self, bodies: Any) -> CarriedAdjoint:
        """Their adjoint in steps of these bodies (`BodySteps`)."""
        assert self.carried is not None
        filled(self.borne, {name: wp.zeros_like(self.by_shape.place) for name in Borne.vars})
        touched = self._solids.model, self._of_edges
        return CarriedAdjoint(self.carried, *touched, bodies, self.borne, self.by_shape)

    def add(self, step: Any, now: Any, at: Derivatives, matrix: Any) -> None:
        """Add to residual and matrix of a step, and let what is wanted of bristles at its end be
        wanted of the rods there; after `wrod.kernels.stepping.adjoint.weigh_spins`."""
        if self._contact is None:
            return
        batch = self._batch
        nodes, derivatives = [self._contact.model, self._of_nodes], [at.gradient, at.hessian]
        batch.launch_nodes(planes.contact, nodes, derivatives)
        coupling = self.matrix["coupling"]
        batch.launch_nodes(plane_adjoint.want_bristles, nodes, [now, coupling])
        if self._solids is not None:
            outputs = [now, at.gradient, self.matrix["block"]]
            inputs = [self._solids.model, self._of_edges]
            batch.launch_edges(edge_adjoint.want_bristles, inputs, outputs)
        if not self._rolls:
            return
        batch.launch_nodes(rolling.hold_roll, nodes, derivatives)
        for name in ("roll", "roll_with_next"):
            self.matrix[name].zero_()
        batch.launch_nodes(rolling_adjoint.want_node_rolls, [*nodes, step], [now, matrix])
        if self._solids is not None:
            outputs = [at.gradient, now, matrix]
            batch.launch_edges(rolling_adjoint.want_edge_rolls, [*inputs, step], outputs)

    def want_friction(self, levels: tuple, x: wp.array, properties: PropertyAdjoint) -> None:
        """From the solution x of a step to what it began from.

        Args:
            levels: `Wanted` at its end and at its start.
            x: (rod, 1, dof) the solution.
            properties: of the rods.
        """
        if self._contact is None:
            return
        batch, (now, before) = self._batch, levels
        rods, nodes = [batch.node_mass, properties.piece], self._of_nodes
        outputs = [before, self.by_friction, properties.model, properties.spins, self.by_shape]
        model = self._contact.model
        inputs = [model, self._stiffness_share, self._burdened, *rods, nodes, now, x]
        batch.launch_nodes(plane_adjoint.want_friction, inputs, outputs)
        if self._rolls:
            inputs = [model, nodes, x]
            batch.launch_nodes(rolling_adjoint.want_turned_nodes, inputs, [now, before])
        if self._solids is not None:
            inputs = [self._solids.model, self._per_mass, *rods, self._of_edges, now, x, self.borne]
            batch.launch_edges(edge_adjoint.want_friction, inputs, outputs)
