"""A simulator's step as a `wp.Tape` has it: its arrays, and what it was made of."""

from __future__ import annotations

import weakref
from dataclasses import dataclass

import newton
import warp as wp

from wrod.errors import RodError
from wrod.solvers.trace import Record

# What a state holds of rods.
STATE = ("node_q", "node_qd", "edge_director", "edge_spin")


def numbers_of(array: wp.array | None, columns: int, device) -> wp.array:
    """An array of vectors of single precision as one of numbers."""
    if array is None or array.size == 0:
        return wp.zeros((0, columns), dtype=wp.float32, device=device)
    return wp.array(
        ptr=array.ptr, dtype=wp.float32, shape=(array.size, columns), device=array.device
    )


def gradient_of(array: wp.array | None, columns: int, device) -> wp.array:
    """What is wanted of an array, as numbers; without any if it has no gradient."""
    return numbers_of(None if array is None else array.grad, columns, device)


@dataclass(eq=False)
class StepEnd:
    """Arrays that a step has read or written: of `STATE`, the poses of bodies that others move,
    and poses, velocities and forces of those that move with rods."""

    rods: tuple[wp.array, ...]
    body_q: wp.array | None
    own: tuple[wp.array | None, ...]

    @classmethod
    def of(cls, state: newton.State, poses: newton.State | None = None) -> StepEnd:
        rods = tuple(getattr(state.der, name) for name in STATE)
        if any(a.grad is None for a in rods):
            raise RodError(
                "a state has no gradients; make it by model.state() of a model that was finalized "
                "with requires_grad=True"
            )
        # Forces of contact pass nothing on, which None says and zeros would not.
        state.der.node_contact_f.requires_grad = False
        own = state.body_q, state.body_qd, state.body_f
        return cls(rods, (state if poses is None else poses).body_q, own)

    def gradients(self) -> list[wp.array]:
        return [a.grad for a in self.rods]

    def arrays(self) -> list[wp.array]:
        every = [*self.rods, self.body_q, *self.own]
        return [a for a in every if a is not None and a.grad is not None and a.size]


@dataclass(eq=False)
class Taken:
    """A step of a group.

    Attributes:
        record: the time steps of the rods in it.
        changed: (row,) which began anew from the state.
        rotation: (row, hold) of what is held, at its start.
        director: (edge,) directors that were read.
        poses_before, poses: (body,) at its start and at its end.
        yielding: how stiff shapes were that are pressed gently.
        duration: how long it was [s].
        previous: the step before on the same tape.
        wanted: what later steps want of what no state holds, at its end and before.
        wanted_of_poses: (body, 7) what the next one wants of `poses`.
        meetings: what bodies touched, as `BodyContact.kept` has it.
        wanted_of_meetings: what the next one wants of the bristles there.
    """

    record: Record
    changed: wp.array
    rotation: wp.array
    director: wp.array
    poses_before: wp.array
    poses: wp.array
    yielding: list[wp.array]
    duration: float
    previous: Taken | None
    tape: weakref.ref
    wanted: list[list[wp.array]] | None = None
    wanted_of_poses: wp.array | None = None
    meetings: tuple[wp.array, ...] | None = None
    wanted_of_meetings: wp.array | None = None
