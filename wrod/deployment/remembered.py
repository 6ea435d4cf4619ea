"""A deployment as it was on the way, so that another that begins like it goes on from there.

Where a path is corrected from some pose on, everything before is as it was: steps that were taken
need not be taken again. What a deployment carries from step to step is kept now and then, and laid
beside the grip's motion up to then.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import dataclass, field
from hashlib import sha256

import numpy as np
import warp as wp

from wrod.deployment.carried_tangents import LaidTangents
from wrod.deployment.grip_path import KEY_INTERVAL, GripSchedule
from wrod.deployment.setup import Setup
from wrod.kernels.stepping.pace import Pace
from wrod.rods.batch import RodBatch
from wrod.solvers.contact import Contact
from wrod.solvers.dynamics import Dynamics

# Between two moments that are kept [s], and deployments that are.
_EVERY, _RUNS = 0.4, 4
# Positions [m] and quaternions of a grip that count as the same.
_SAME = 1e-6
# Keys that the grip's place at a moment depends on beyond it.
_AHEAD = 2
# Processor time of a node for each step of a deployment, and of each column of its derivatives
# besides [s]. Of a core of an EPYC.
_LAID, _DERIVED = 6.8e-6, 7.4e-8


@dataclass(frozen=True)
class _Moment:
    """What a deployment carried at a time [s]: arrays of its own, and of its tangents."""

    time: float
    arrays: list[np.ndarray]
    tangents: list[np.ndarray]


@dataclass
class _Run:
    """One deployment: what it began as, its grip's motion, and its moments."""

    told: bytes
    schedule: GripSchedule
    moments: list[_Moment] = field(default_factory=list)


class LastDeployments:
    """The last deployments of a rod without fixtures, for `wrod.deployment.tangents.lay`.

    Attributes:
        effort: processor time that deployments have taken, as it is reckoned, so that what depends
            on it does not depend on the machine [s].
    """

    def __init__(self) -> None:
        self.runs: list[_Run] = []
        self.effort = 0.0

    def stops(self, end: float, since: float) -> Iterator[float]:
        """Times [s] between two at which to keep what is carried."""
        first = int(since / _EVERY + 1e-6) + 1
        yield from (k * _EVERY for k in range(first, int(np.ceil(end / _EVERY - 1e-6))))

    def begun(self, told: tuple, setup: Setup, parts: LaidParts, step: float) -> float:
        """Let a deployment that is `told` by such values, and has such a setup, go on from where
        one was that began alike; the time [s] of that, 0 where none did. It takes steps [s]."""
        told = told, setup.arc_length, setup.position, setup.director
        said = sha256(pickle.dumps(told)).digest()
        schedule, best = setup.schedule, _Run(said, setup.schedule)
        for run in self.runs:
            if run.told == said:
                until = min(_alike(run.schedule, schedule), parts.quiet)
                moments = [one for one in run.moments if one.time <= until]
                if len(moments) > len(best.moments):
                    best.moments = moments
        self.runs = [*self.runs[1 - _RUNS :], best]
        begun = best.moments[-1].time if best.moments else 0.0
        if best.moments:
            parts.put(best.moments[-1])
        each = _LAID + _DERIVED * (0 if parts.tangents is None else parts.tangents.count)
        self.effort += each * parts.batch.node_count * (setup.measure_time - begun) / step
        return begun

    def keep(self, time: float, parts: LaidParts) -> None:
        """What the last deployment that has begun carries at a time [s]."""
        self.runs[-1].moments.append(parts.taken(time))


@dataclass(frozen=True)
class LaidParts:
    """What carries a deployment of one rod."""

    batch: RodBatch
    contact: Contact
    dynamics: Dynamics
    tangents: LaidTangents | None

    @property
    def quiet(self) -> float:
        """Time [s] until which no column of the tangents that moves the grip has begun."""
        return np.inf if self.tangents is None else self.tangents.first_late

    def taken(self, time: float) -> _Moment:
        arrays = [one.numpy().copy() for one in self._arrays()]
        tangents = [] if self.tangents is None else self.tangents.early()
        return _Moment(time, arrays, tangents)

    def put(self, moment: _Moment) -> None:
        for ours, value in zip(self._arrays(), moment.arrays, strict=True):
            ours.assign(value)
        self.dynamics.start.assign(self.batch.state)
        if self.tangents is not None:
            self.tangents.begin_with(moment.tangents)

    def _arrays(self) -> list[wp.array]:
        state, dynamics, viscosity = self.batch.state, self.dynamics, self.dynamics.viscosity
        arrays = [getattr(dynamics, name) for name in Pace.vars]
        arrays += [dynamics.velocity, dynamics.velocity_older, dynamics.dof_older]
        if viscosity.exists:
            arrays += [viscosity.strain, viscosity.strain_older]
        if self.batch.inelastic is not None:
            arrays.append(self.batch.inelastic)
        arrays += [state.dof, state.tangent, state.director, state.reference_twist]
        contact = self.contact
        arrays += [*contact.bristles.arrays.values(), contact.slip]
        return [*arrays, contact.force]


def _alike(one: GripSchedule, other: GripSchedule) -> float:
    """Time [s] until which two grips move alike and hold and let go of the same."""
    if (one.held_nodes, one.release_time) != (other.held_nodes, other.release_time):
        return 0.0
    count = min(len(one.position), len(other.position))
    apart = [
        np.abs(a[:count] - b[:count]).max(axis=1) > _SAME
        for a, b in ((one.position, other.position), (one.rotation, other.rotation))
    ]
    differ = np.flatnonzero(np.any(apart, axis=0))
    until = KEY_INTERVAL * ((differ[0] if len(differ) else count) - _AHEAD)
    return float(min(until, one.let_go_time, other.let_go_time))
