"""The adjoint of a batch's time steps: see `wrod.kernels.stepping.adjoint`."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import warp as wp

from wrod.kernels.linear import banded_lu
from wrod.kernels.stepping import adjoint as kernels
from wrod.kernels.stepping import midpoint_adjoint, model_adjoint
from wrod.kernels.stepping.body_adjoint import BodySteps, WantedBodies
from wrod.kernels.stepping.pace import Pace
from wrod.kernels.stepping.trace import OneStep, Wanted, go_back, recall_step
from wrod.rods.arrays import filled
from wrod.rods.state import Derivatives, RodState
from wrod.solvers.body_adjoint import BodyAdjoint
from wrod.solvers.contact_adjoint import ContactAdjoint
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.inelastic_adjoint import InelasticAdjoint
from wrod.solvers.inertia import add_inertia
from wrod.solvers.kept_pairs import LawShares
from wrod.solvers.pair_adjoint import PairAdjoint
from wrod.solvers.property_adjoint import PropertyAdjoint
from wrod.solvers.steps import SCHEMES
from wrod.solvers.trace import (
    Record,
    StepParts,
    bristle_arrays,
    make_wanted,
    require_differentiable,
    step_arrays,
)
from wrod.solvers.viscosity import Viscosity


class StepAdjoint:
    """Goes through steps backwards.

    Set what is wanted of the end in `now` (and what is known of earlier times in `before` and
    `older`), call `go_back` for a record, and find there what is wanted of its start. What is left
    of a start at which motion began anew is all in `now`, once `settle` has been called.

    Args:
        dynamics: that has taken the steps.
        moved: (rod, dof) what is not free but moved by `Dynamics.motion`; what is neither stays.
        air_of_mass: (rod, node) air damping that goes with the nodes' mass; default: of the rod.
        stiffness_of_mass: (rod, node) stiffness of contact per mass of the rod in the row that a
            node is of, if it goes with it; default: it does not.

    Attributes:
        now, before, older: `wrod.kernels.stepping.trace.Wanted` at the end of a step, at its
            start, and a step earlier; edges are differentiated by the turn of their frames.
        model: `wrod.kernels.stepping.model_adjoint.WantedModel`, summed up until `clear`.
        by_friction: (rod, shape) derivatives by the coefficients of friction, likewise.
        by_shape: `wrod.kernels.contact.edge_adjoint.WantedShapes` of those that moved, summed up
            until it is taken.
        held: (rod, dof) what is wanted of what is moved, at the end of the step gone through last.
        step: that step, `wrod.kernels.stepping.trace.OneStep`.
        gradient: (rod, dof) its residual.
        levels: all that is wanted, of rods and bodies, as in `now`, `before` and `older`.
        bodies: the adjoint of the bodies that hold rods, or None.

    Raises:
        RodError: see `require_differentiable`.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        moved: np.ndarray,
        air_of_mass: np.ndarray | None = None,
        stiffness_of_mass: np.ndarray | None = None,
        pair_law: LawShares | None = None,
    ):
        require_differentiable(dynamics)
        batch = self.batch = dynamics.batch
        self.dynamics, device = dynamics, batch.device
        rods, nodes, dofs = batch.rod_count, batch.node_count, batch.dof_count
        viscous = dynamics.viscosity.exists
        self.viscosity = Viscosity(batch, dynamics.viscosity.time.numpy() if viscous else 0.0)

        floats = batch.zeros
        self.now, self.before, self.older = (make_wanted(dynamics) for _ in range(3))
        arrays = {name: wp.zeros_like(a) for name, a in step_arrays(dynamics).items()}
        bristles = {name: wp.zeros_like(a) for name, a in bristle_arrays(dynamics).items()}
        recalled = [*arrays.values(), *bristles.values()]
        arrays["active"] = floats(dtype=wp.int32)
        self.step = filled(OneStep(), arrays)
        self._end = filled(OneStep(), arrays)
        self._goes_halfway = SCHEMES[dynamics._scheme] == "midpoint"
        if self._goes_halfway:
            own = ("active", "dof", "tangent", "director")
            filled(self._end, {name: wp.zeros_like(arrays[name]) for name in own})
            self._end.span = self._end.whole
            self._turn = floats(nodes - 1)
        self._state = RodState(
            arrays["dof"], arrays["tangent"], arrays["director"], arrays["twist"]
        )
        paced = {name: arrays[name] for name in ("active", "coefficient", "span")}
        self._pace = filled(Pace(), {**paced, "starting": paced["active"]})
        self._at = Derivatives.zeros(rods, dofs, device)
        self.gradient = self._at.gradient
        self._by_end, self._by_start, self._moment = (
            floats(nodes - 1, dtype=wp.vec3d) for _ in range(3)
        )
        self._spin_inertia, self._wanted = floats(nodes - 1), floats(dofs)
        self._contact = ContactAdjoint(dynamics, self.step, bristles, stiffness_of_mass)
        self.by_friction, self.by_shape = self._contact.by_friction, self._contact.by_shape
        turns = self._by_end, self._by_start
        self._pairs = PairAdjoint.of(dynamics, self.step, turns, pair_law)
        self._past = None if batch.inelastic is None else InelasticAdjoint(batch)
        skew, rate = floats(0), floats(0, 0, dtype=wp.vec2d)
        if self._past is not None:
            skew, rate = self._past.skew, self._past.rate
        self._matrix = filled(
            kernels.StepMatrix(),
            dict(
                hessian=self._at.hessian, spin_inertia=self._spin_inertia, moment=self._moment,
                by_end=self._by_end, skew=skew, rate=rate, **self._contact.matrix,
            ),
        )  # fmt: skip
        self._factor = floats(dofs, banded_lu.BAND)
        self._held, self.held = floats(dofs), floats(dofs)
        self.bodies = None if dynamics.bodies is None else BodyAdjoint(dynamics.bodies)
        moved = np.asarray(moved, dtype=np.int32)
        self._x = floats(1, dofs, dtype=banded_lu.ALONE)
        if self.bodies is not None:
            self.bodies.pairs = self._pairs
            carried = (dynamics.bodies.carried.numpy() != 0) & (batch.free.numpy() == 0)
            moved = np.where(carried, 2, moved)
            self._x = self.bodies.x
            if self._contact.carried is not None:
                self.bodies.touch(self._contact.carry(self.bodies.step))
            recalled += [getattr(self.bodies.step, name) for name in BodySteps.vars]
        if self._past is not None:
            recalled.append(self._past.node)
        self._parts, self.levels = StepParts(recalled), self._all_wanted()
        self.moved = batch.array(moved, dtype=wp.int32)
        none = floats(0)
        self._edge_mass = none if dynamics.edge_mass is None else dynamics.edge_mass
        self._viscous_time = self.viscosity.time if viscous else floats(0, dtype=wp.vec4d)
        self._drag = floats(0, dtype=wp.vec2d) if dynamics.drag is None else dynamics.drag
        self._properties = PropertyAdjoint(dynamics, self._viscous_time, air_of_mass)
        self.model, self.by_spins = self._properties.model, self._properties.spins

    def _all_wanted(self) -> list[StepParts]:
        """Of rods and bodies, as in `now`, `before` and `older`."""
        wanted = [[(Wanted, level)] for level in (self.now, self.before, self.older)]
        if self.bodies is not None:
            of_bodies = self.bodies.now, self.bodies.before, self.bodies.older
            for level, own in zip(wanted, of_bodies, strict=True):
                level.append((WantedBodies, own))
        return [
            StepParts([getattr(one, name) for struct, one in level for name in struct.vars])
            for level in wanted
        ]

    def clear(self) -> None:
        """Want nothing any more."""
        for level in self.levels:
            level.clear()
        self._properties.clear()
        self.by_friction.zero_()
        if self.bodies is not None:
            self.bodies.clear()

    def go_back(self, record: Record, held=None, place=None) -> None:
        """Go from the end of a record to its start.

        Args:
            place: called with every step before it is gone through, to put shapes that moved to
                where they were.
            held: called with where rods are (`OneStep`), once or, where steps go on from their
                middle, twice a step: `held` is what is wanted of what is moved there.
        """
        capturing = wp.get_device(self.batch.device).is_capturing
        for back in range(record.most):
            go = partial(self._go_back_once, record, back, held, place)
            if back and capturing and record.unsound is not None:
                wp.capture_if(record.unsound[1][back : back + 1], go)
            else:
                go()

    def _go_back_once(self, record: Record, back: int, held, place) -> None:
        batch, end = self.batch, self._end
        if self._goes_halfway:
            # A step ends where the next one began.
            start = self.step.dof_before, self.step.director_before
            after = record.end if back == 0 else start
            for own, there in zip((end.dof, end.director), after, strict=True):
                wp.copy(own, there)
        self.recall(record, back)
        if place is not None:
            place(self.step)
        if self._goes_halfway:
            batch.launch(midpoint_adjoint.find_halfway, batch.rod_count, [self.step], [end.active])
        if self._past is not None:
            self._past.want_flowed(self.step, self.now, self.model)
        self._settle(self.step.active, self._end)
        if self._goes_halfway:
            self._go_to_middle()
            if held is not None:
                held(self._end)
        self._factorise()
        self._solve()
        self.by_spins.zero_()
        self._contact.want_friction((self.now, self.before), self._x, self._properties)
        if self._pairs is not None:
            self._pairs.want_before(self.now, self.before, self.model)
        levels = self.before, self.older
        self._properties.want(record.gravity, self.step, self._x, levels)
        self._want_before()
        if held is not None:
            held(self.step)
        levels = [level.part for level in self.levels]
        self.levels[0].launch(go_back, [self.step.active], levels)

    def recall(self, record: Record, back: int) -> None:
        """Take up the step that is `back` before the last of each rod, in `step`."""
        outputs = [self._parts.part, self.step.active]
        self._parts.launch(recall_step, [record.steps, record.count, back], outputs)
        if self.bodies is not None:
            self.bodies.find_ends(self.step)
        if self._past is not None:
            self._past.measure_skew(self.step)

    def settle(self, chosen: wp.array) -> None:
        """Let what is wanted of strains at the start of the rods that are not 0 in `chosen` (rod,)
        be wanted of their configuration there; `step` must be the first of all."""
        if self._past is not None:
            self._past.want_begun(chosen, self.now, self.model)
        start = OneStep()
        start.dof, start.director = self.step.dof_before, self.step.director_before
        self._settle(chosen, start)

    def _settle(self, chosen: wp.array, at: Any) -> None:
        if self.viscosity.exists:
            inputs = [chosen, at.dof, at.director]
            self.batch.launch_nodes(model_adjoint.want_strained, inputs, [self.now])

    def _go_to_middle(self) -> None:
        """From the ends of steps of the midpoint rule."""
        batch, step, end = self.batch, self.step, self._end
        ways, kinds = [self._by_end, self._by_start], [batch.free, self.moved]
        batch.launch_edges(
            midpoint_adjoint.want_angles,
            [*kinds, step],
            [end, self.now, self.before, self.held, self._turn, *ways],
        )
        batch.launch_nodes(
            midpoint_adjoint.want_places,
            [*kinds, step, end, self._turn, *ways],
            [self.now, self.before, self.held],
        )
        if self.bodies is not None:
            self.bodies.go_to_middle(end, self.held)

    def _factorise(self) -> None:
        """A_n^T of the step, as `Dynamics` puts A_n together."""
        batch, dynamics, step, at = self.batch, self.dynamics, self.step, self._at
        self.viscosity.flow(self._pace, step.strain, step.strain_older)
        batch.evaluate(
            order=2, state=self._state, out=at, active=step.active, model=self.viscosity.model,
            energy=False, energies=None if self._past is None else self._past.energies,
        )  # fmt: skip
        add_inertia(dynamics, step, at)
        batch.launch_edges(kernels.measure_turns, [step], [self._by_end, self._by_start])
        inputs = [dynamics.mass, dynamics.air_damping, step]
        batch.launch_edges(kernels.weigh_spins, inputs, [self._spin_inertia, self._moment])
        self._contact.add(step, self.now, at, self._matrix)
        if self._pairs is not None:
            self._pairs.weigh(self.now, at.gradient, self._moment)
        batch.launch_dofs(
            kernels.assemble, [self._banded, batch.free, self._matrix], [self._factor]
        )
        batch.launch_lanes(banded_lu.factorise, [self._banded], [self._factor])
        if self._pairs is not None:
            self._pairs.factorise(self._matrix)

    @property
    def _banded(self) -> wp.array:
        """(rod,) whose matrix of the step is banded."""
        return self.step.active if self._pairs is None else self._pairs.banded

    def _solve(self) -> None:
        batch, step, now = self.batch, self.step, self.now
        batch.launch_edges(kernels.want_turns, [step], [now])
        batch.launch_nodes(
            kernels.load_wanted, [batch.free, step, now, self._by_end], [self._wanted, self._x]
        )
        if self.bodies is not None:
            self.bodies.load(step, self._matrix, self.gradient, now)
        batch.launch_lanes(kernels.solve, [self._banded, self._factor], [self._x])
        if self._pairs is not None:
            self._pairs.solve(self._x)
        if self.bodies is not None:
            self.bodies.solve(step, self._wanted)
        batch.launch_dofs(
            kernels.want_held,
            [batch.free, step.active, self._matrix, self._wanted, self._x],
            [self._held],
        )
        if self._pairs is not None:
            self._pairs.want_held(self._held)
        batch.launch_edges(
            kernels.want_turns_before, [step.active, self._spin_inertia, self._x], [now]
        )

    def _want_before(self) -> None:
        batch, dynamics, step = self.batch, self.dynamics, self.step
        batch.launch_nodes(
            kernels.want_before,
            [dynamics.mass, self._edge_mass, dynamics.air_damping, self._drag]
            + [step, self.now, self._by_start, self._x],
            [self.before, self.older],
        )
        if self.bodies is not None:
            self.bodies.want_before(step, self.model.gravity)
        if self._past is not None:
            self._past.want_before(step, self._x, self.now, self.before, self.model)
        batch.launch_nodes(
            kernels.want_still,
            [batch.free, self.moved, step.active, self._by_end, self._by_start, self._held],
            [self.before, self.held],
        )
