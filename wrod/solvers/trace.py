"""What steps were made of: kept while they are taken, for their adjoint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrod.errors import RodError
from wrod.kernels.contact import plane_adjoint
from wrod.kernels.stepping import trace as kernels
from wrod.solvers.body_adjoint import body_steps
from wrod.solvers.contact import Contact
from wrod.solvers.edge_contact import EdgeContact
from wrod.solvers.kept_pairs import SLOTS
from wrod.solvers.steps import SCHEMES

if TYPE_CHECKING:
    from wrod.solvers.dynamics import Dynamics
    from wrod.solvers.newton_steps import NewtonSteps


class StepParts:
    """Arrays (rod, ...), whatever they hold, as words of four bytes: kernels copy all at once.

    Args:
        arrays: contiguous; those without numbers are left out.

    Attributes:
        part: of `wrod.kernels.stepping.trace.Part`.
        words: of a row in all.
    """

    def __init__(self, arrays: Sequence[wp.array]):
        self._arrays = [a for a in arrays if a.size]
        parts, self.words = [], 0
        for array in self._arrays:
            rods, size = len(array), wp.types.type_size_in_bytes(array.dtype)
            part = kernels.Part()
            part.words = wp.array(
                ptr=array.ptr, dtype=wp.int32, shape=(rods, array.size * size // (4 * rods)),
                device=array.device,
            )  # fmt: skip
            part.first = self.words
            parts.append(part)
            self.words += part.words.shape[1]
        self.part = wp.array(parts, dtype=kernels.Part, device=self._arrays[0].device)
        self._dim = len(self._arrays[0]), len(parts), max(p.words.shape[1] for p in parts)

    def room(self, steps: int) -> wp.array:
        """(step, rod, word) of nothing yet."""
        shape = (steps, self._dim[0], self.words)
        return wp.zeros(shape, dtype=wp.int32, device=self.part.device)

    def launch(self, kernel: wp.Kernel, inputs: list, outputs: list) -> None:
        """Launch a kernel over (rod, part, word)."""
        wp.launch(kernel, self._dim, inputs, outputs, device=self.part.device)

    def clear(self) -> None:
        for array in self._arrays:
            array.zero_()

    def clone(self) -> list[wp.array]:
        return [wp.clone(array) for array in self._arrays]

    def assign(self, arrays: list[wp.array]) -> None:
        """What `clone` has returned."""
        for own, other in zip(self._arrays, arrays, strict=True):
            wp.copy(own, other)


def contact_of(dynamics: NewtonSteps) -> Contact | None:
    """The contact whose adjoint is known, of nodes with planes and of edges with solids."""
    return next((c for c in dynamics.contacts if isinstance(c, Contact)), None)


def solids_of(dynamics: NewtonSteps) -> EdgeContact | None:
    """That of edges alone, where there is any."""
    touched = contact_of(dynamics)
    return None if touched is None else touched.solids


def bristle_arrays(dynamics: Dynamics) -> dict[str, wp.array]:
    """What friction with shapes remembers, of nodes and ("edge_...") edges: bristles, whether they
    slid, and how far they are turned if they keep the roll."""
    touched, solids = contact_of(dynamics), solids_of(dynamics)
    names = ["bristle", "sliding"]
    names += ["turned"] if touched is not None and touched.holds_roll else []
    return {
        f"{prefix}{name}": contact.bristles.arrays[name]
        for prefix, contact in (("", touched), ("edge_", solids))
        if contact is not None
        for name in names
    }


def step_arrays(dynamics: Dynamics) -> dict[str, wp.array]:
    """What the step is made of that `dynamics` takes now, by the names of `kernels.OneStep`."""
    viscosity, present = dynamics.viscosity, dynamics.present
    arrays = {n: getattr(present, n) for n in kernels.OneStep.vars if n != "active"}
    out = {name: array for name, array in arrays.items() if array is not None}
    if viscosity.exists:
        out |= {"strain": viscosity.strain, "strain_older": viscosity.strain_older}
    if dynamics.rod_contact is not None:
        out |= dynamics.rod_contact.kept.arrays()
    return out


def beside_rods(dynamics: Dynamics) -> list[wp.array]:
    """What it is made of besides: bristles, bodies, by the names of `BodySteps`, and what nodes
    remember."""
    bodies, past = dynamics.bodies, dynamics.batch.inelastic
    out = [*bristle_arrays(dynamics).values(), *([] if bodies is None else body_steps(bodies))]
    return out if past is None else [*out, past]


def require_differentiable(dynamics: Dynamics) -> None:
    """See that steps have an adjoint.

    Raises:
        RodError: rods have laws of their own or a past, or damping that relaxes.
    """
    batch = dynamics.batch
    of_memory = batch.inelastic is not None
    if len(batch.energies) > of_memory or batch.layers:
        raise RodError("gradients of motion know no laws of the caller's own")
    if of_memory and (SCHEMES[dynamics._scheme] == "midpoint" or not dynamics.viscosity.exists):
        raise RodError(
            "gradients of motion know rods with a past by the bdf2 and euler schemes only, with "
            "internal damping given for every node"
        )
    if dynamics.viscosity.relaxes:
        raise RodError(
            "gradients of motion know no internal damping that relaxes; leave Dynamics.relax out"
        )
    touched = contact_of(dynamics)
    if touched is not None and touched.friction_field is not None:
        raise RodError("gradients of motion do not know friction that varies from place to place")
    if dynamics.rod_contact is not None and not dynamics.rod_contact.settles_loads:
        raise RodError("gradients of motion know a RodContact that settles its loads only")


def make_wanted(dynamics: Dynamics) -> Any:
    """`Wanted` of nothing yet."""
    batch, zeros = dynamics.batch, dynamics.batch.zeros
    nodes = batch.node_count
    out = kernels.Wanted()
    out.dof, out.velocity, out.turn = (zeros(n) for n in (*[batch.dof_count] * 2, nodes - 1))
    out.strain = zeros(nodes if dynamics.viscosity.exists else 0, dtype=wp.vec4d)
    known = bristle_arrays(dynamics)
    for name in ("bristle", "edge_bristle", "turned", "edge_turned"):
        shape = known[name].shape[1:] if name in known else (0, 0)
        setattr(out, name, zeros(*shape, dtype=wp.float64 if "turned" in name else wp.vec3d))
    out.lagging = zeros(0 if batch.inelastic is None else nodes, dtype=wp.vec2d)
    contact = dynamics.rod_contact
    pairs = (0, 0) if contact is None else contact.kept.partner.shape[1:]
    out.pair_partner, out.pair_bristle = (zeros(*pairs, dtype=t) for t in (wp.int32, wp.vec2d))
    return out


@dataclass(frozen=True)
class Record:
    """Steps that a `Trace` has kept.

    Attributes:
        steps: (step, rod, word) of what they were made of; see `StepParts`.
        count: (rod,) steps of each, on the device; `most` is the largest.
        gravity: (rod,) that they were taken under.
        end: (rod, dof) configuration, and (rod, edge) reference directors, after the last.
        unsound: (rod,) whose steps have no adjoint, and (step,) whether any rod has taken more than
            so many, where both were to be found out on the device.
    """

    steps: wp.array
    count: wp.array
    most: int
    gravity: wp.array
    end: tuple[wp.array, wp.array]
    unsound: tuple[wp.array, wp.array] | None = None


class Trace:
    """Keeps what steps are made of (a `wrod.solvers.newton_steps.Follower`), by kernels alone.

    33 numbers a node and step, 8 more of a viscous material and 3.5 for each shape to be touched (7
    where some are solids); and 7 a node each time that it is asked.

    Args:
        dynamics: whose steps; its `follower` is to be this.
        room: steps of a rod that are kept between two calls of `take`.
    """

    def __init__(self, dynamics: Dynamics, room: int):
        batch = self.batch = dynamics.batch
        self.room = room
        self._diverged = dynamics.diverged
        self.count = wp.zeros(batch.rod_count, dtype=wp.int32, device=batch.device)
        self._touched = wp.zeros(batch.rod_count, dtype=wp.int32, device=batch.device)
        self._contact = contact_of(dynamics)
        self._solids = solids_of(dynamics)
        self._parts = StepParts([*step_arrays(dynamics).values(), *beside_rods(dynamics)])
        self._kept = self._parts.room(room)
        self._others: list[Any] = [c for c in dynamics.contacts if c is not self._contact]
        self._remembering = [c for c in self._others if hasattr(c, "keep")]
        for contact in self._remembering:
            contact.make_room(room)

    def follow(self, dynamics: NewtonSteps) -> None:
        """Keep the accepted steps."""
        batch, accepted = self.batch, dynamics.accepted
        ends = accepted, batch.state.dof, dynamics.start.dof
        for contact in self._others:
            contact.find_unknown(*ends, self._touched)
        for contact in self._remembering:
            contact.keep(accepted, self.count)
        contact = self._contact
        if self._solids is not None:
            self._solids.find_unknown(contact.step_of(self._solids, *ends), self._touched)
        if contact is not None:
            inputs = [contact.model, contact.step_of(contact, *ends)]
            batch.launch_nodes(plane_adjoint.find_unknown, inputs, [self._touched])
        self._parts.launch(
            kernels.keep_step, [accepted, self.count, self._parts.part], [self._kept]
        )
        dynamics._per_rod(kernels.count_step, [accepted], [self.count])

    def take(self) -> Record:
        """What was kept since it was asked last; waits for the device, or in a graph has all the
        room there is and finds out there what is unsound.

        Raises:
            RodError: a rod was cut out, has taken more steps than there is room for, or touched
            something whose contact has no adjoint.
        """
        if wp.get_device(self.batch.device).is_capturing:
            return self._take_in_graph()
        device_count = wp.clone(self.count)
        count, touched = device_count.numpy(), self._touched.numpy().copy()
        self.count.zero_()
        self._touched.zero_()
        most = int(count.max())
        cut = self._diverged.numpy() != 0
        if cut.any():
            raise RodError(
                f"no time step of row {int(np.flatnonzero(cut)[0])} of rods converged, so that it "
                "has no gradients; take a shorter one, or a larger tolerance"
            )
        if most > self.room:
            raise RodError(
                f"row {int(count.argmax())} took {most} time steps where gradients have room for "
                f"{self.room}; take a shorter step"
            )
        if touched.any():
            raise RodError(
                f"row {int(np.flatnonzero(touched)[0])} of rods touches something in this step "
                "through which gradients are not there; they are through planes that stand still, "
                "through solids, where rods begin outside them and are straight at rest if it "
                f"moves with them, and through rods, where an edge touches up to {SLOTS} later ones"
            )
        return self._record(device_count, most)

    def _take_in_graph(self) -> Record:
        count, batch, most = wp.clone(self.count), self.batch, self.room
        unsound = wp.zeros_like(count)
        more = wp.zeros(self.room, dtype=wp.int32, device=batch.device)
        inputs = [most, self._touched, self._diverged]
        batch.launch(kernels.find_unsound, batch.rod_count, inputs, [count, unsound, more])
        self.count.zero_()
        self._touched.zero_()
        return self._record(count, most, (unsound, more))

    def _record(self, count: wp.array, most: int, unsound=None) -> Record:
        state = self.batch.state
        return Record(
            wp.clone(self._kept[: max(most, 1)]),  # none of rods that were cut out
            count,
            most,
            wp.clone(self.batch.gravity),
            (wp.clone(state.dof), wp.clone(state.director)),
            unsound,
        )
