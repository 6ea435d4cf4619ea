"""Deployments in simulation: a grip lays a rod along a pattern on a table with friction."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np
import warp as wp

from wrod import arguments
from wrod.deployment.fixtures import Fixtures
from wrod.deployment.grip_path import GripMotion
from wrod.deployment.result import Deployment, deployment_error
from wrod.deployment.setup import (
    Disturbance,
    Setup,
    disturb,
    mesh,
    prepare_deployment,
)
from wrod.errors import RodError
from wrod.machine import require_memory
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import Tail, tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.batch import RodBatch
from wrod.rods.device import resolve_device
from wrod.rods.discretisation import quadratic_drag
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel
from wrod.rods.state import node_positions
from wrod.solvers.compiling import compile_steps
from wrod.solvers.contact import Contact, Friction, FrictionField, Plane
from wrod.solvers.dynamics import Dynamics

# The table gives way by this fraction of the radius under the rod's weight; where the rod touches
# down, which loads it with about 2 w L_gb at a point, that makes some 1 % of the radius.
_SINKING = 1.0 / 600.0
_SINKING_AT_POSTS = _SINKING / 10.0
# Beyond these a deployment takes weeks; what a node holds in states and factors.
_MOST_STEPS, _MOST_NODES, _NODE_BYTES = 2e7, 2e5, 4096.0
# How far the grip may move in a step [m], and how long an edge may be [L_gb].
_LONGEST_MOVE, _LONGEST_EDGE = 0.05, 3.0
# Rods stepped at once on a CPU, and cores from which on threads, which cannot record their launches
# and spend several times the processor time, are faster than one that replays them.
_CPU_CHUNK, _MANY_CORES = 16, 8


@dataclass(frozen=True)
class Trial:
    """One deployment to simulate; see `simulate_deployment`."""

    pattern: Pattern
    rod: RodModel | RodMaterial
    trajectory: Trajectory
    friction: Friction
    disturbance: Disturbance = field(default_factory=Disturbance)
    tail: Tail | None = None
    fixtures: Fixtures | None = None


@arguments.checked(
    RodError,
    pattern=arguments.like("a wrod.Pattern", "sample", "length", "remainder_length"),
    rod=arguments.like("a wrod.RodMaterial", "radius", "length", "gravito_bending_length"),
    trajectory=arguments.like("a wrod.Trajectory", "arc_length", "position", "rotation"),
    friction=arguments.either(
        arguments.like("a wrod.Friction", "static", "kinetic"), arguments.number(0.0, 1e3)
    ),
    disturbance=arguments.optional(arguments.like("a wrod.Disturbance", "jitter")),
    fixtures=arguments.optional(arguments.like("a wrod.Fixtures", "items", "gates")),
)
def simulate_deployment(
    pattern: Pattern,
    rod: RodModel | RodMaterial,
    trajectory: Trajectory,
    friction: Friction | float = 0.6,
    *,
    disturbance: Disturbance | None = None,
    fixtures: Fixtures | None = None,
    **options,
) -> Deployment:
    """Lay `rod` along `pattern` by moving the grip along `trajectory`.

    The free end's first 5 cm are held along the pattern until more than that is laid. The
    rest hangs from the grip, which holds the last edge as a clamp. At the end of the pattern the
    grip rests and the rod is measured; then the grip lays the tail straight ahead by the same
    method, opens when 1 L_gb is left, and the rod is measured again.

    Args:
        pattern: the pattern of the plan; its remainder is added if the trajectory has one.
        rod: what is laid, a `RodMaterial` or a `RodModel`; it may differ from the plan's.
        trajectory: of the grip, as `wrod.plan` returns it; the rod is held at its roll.
        friction: a `Friction`, or the coefficient of both kinds.
        disturbance: what makes this trial differ from the ideal.
        fixtures: posts and clips on the table; the robot's displacement does not move them.
        options: those of `simulate_deployments`.

    Raises:
        PatternError, RodError: the trajectory is too short, or an option is not usable.
    """
    trial = Trial(
        pattern,
        rod,
        trajectory,
        friction if isinstance(friction, Friction) else Friction(friction),
        disturbance or Disturbance(),
        fixtures=fixtures,
    )
    return simulate_deployments([trial], **options)[0]


@arguments.checked(
    RodError,
    trials=arguments.several(
        arguments.like("a wrod.Trial", "pattern", "rod", "trajectory", "friction"), least=0
    ),
    hold=arguments.number(0.0, 100.0),
    release=arguments.optional(arguments.number(0.0, 100.0)),
    speed=arguments.number(1e-5, 100.0),
    spacing=arguments.number(1e-5, 1.0),
    node_count=arguments.optional(arguments.whole(4, 100_000)),
    step=arguments.number(1e-6, 1.0),
    scheme=arguments.text,
    air_damping=arguments.optional(arguments.number(0.0, 1e6)),
    internal_damping=arguments.optional(arguments.number(0.0, 1e6)),
    tolerance=arguments.number(1e-15, 1.0),
    frame_interval=arguments.optional(arguments.number(1e-5, 1e6)),
    device=arguments.optional(arguments.text),
    threads=arguments.optional(arguments.whole(0, 4096)),
    friction_field=arguments.optional(arguments.like("a wrod.FrictionField", "factor", "x", "y")),
    progress=arguments.optional(arguments.callback),
)
def simulate_deployments(
    trials: list[Trial],
    *,
    hold: float = 0.05,
    release: float | None = None,
    speed: float = 0.02,
    spacing: float = 0.005,
    node_count: int | None = None,
    step: float = 0.01,
    scheme: str = "euler",
    air_damping: float | None = None,
    internal_damping: float | None = None,
    tolerance: float = 1e-5,
    frame_interval: float | None = None,
    device: str | None = "cpu",
    threads: int | None = None,
    friction_field: FrictionField | None = None,
    progress: Callable[[float], object] | None = None,
) -> list[Deployment]:
    """Simulate many deployments at once; those that diverge are flagged and the others go on.

    Args:
        trials: what to simulate.
        hold: length of the free end that is laid and held along the pattern at first [m]; 0: the
            rod hangs from the grip's first pose with its free end on the pattern's first point,
            and that point alone is held until the grip is there.
        release: laid length at which the free end is let go [m]; default: `hold`.
        speed: at which the contact moves [m/s], slower where the grip has far to go; the tail is
            laid twice as fast.
        spacing: length of the edges where the rod is laid [m].
        node_count: nodes of every rod instead, so that results do not depend on which trials are
            simulated together; default: what the longest needs.
        step: largest time step [s].
        scheme: "euler", "bdf2" or "midpoint".
        air_damping: drag per mass and velocity [1/s]; default: the rod's own, or 1 where it says
            nothing.
        internal_damping: Kelvin-Voigt time of the material [s]; default: the rod's own.
        tolerance: of a step's residual forces, over the weight of one L_gb of rod.
        frame_interval: keep the rod's states at its multiples [s].
        device: "cpu", "cuda:0", "auto".
        threads: CPU threads; default: one, which replays recorded launches, or one per core where
            there are eight or more.
        friction_field: how the table's friction varies over x and y; default: it does not.
        progress: called with the fraction done since the last call, of all trials.
    """
    release = hold if release is None else release
    _check_pace(speed, spacing, hold, release)
    if not trials:
        return []
    device = resolve_device(device)
    _refuse_endless(trials, speed, spacing, step, frame_interval)
    compile_steps(device)
    setups = prepare_trials(trials, hold, release, speed, spacing, node_count)
    options: dict[str, Any] = dict(
        scheme=scheme, air_damping=air_damping, internal_damping=internal_damping,
        tolerance=tolerance, device=device, friction_field=friction_field,
    )  # fmt: skip
    chunks, workers = _chunks(len(trials), device, threads)
    parallel = workers > 1 and len(chunks) > 1
    # Recording is the process's: threads would record each other's launches.
    options["keeps_recording"] = device == "cpu" and not parallel

    def report(fraction: float, count: int) -> None:
        if progress is not None:
            progress(fraction * count / len(trials))

    def run(chunk: list[int]) -> list[Deployment]:
        return _simulate(
            [trials[i] for i in chunk],
            [setups[i] for i in chunk],
            step,
            frame_interval,
            lambda fraction: report(fraction, len(chunk)),
            **options,
        )

    if parallel:
        with ThreadPoolExecutor(workers) as pool:
            return list(chain.from_iterable(pool.map(run, chunks)))
    return list(chain.from_iterable(map(run, chunks)))


def _check_pace(speed: float, spacing: float, hold: float, release: float) -> None:
    for name, value in (("speed", speed), ("spacing", spacing)):
        if not (np.isfinite(value) and value > 0):
            raise RodError(f"{name} is {value!r}; give a positive finite number")
    if not (np.isfinite(hold) and hold >= 0):
        raise RodError(f"hold is {hold!r}; give a length in metres, or 0 for a free end")
    if not release >= hold:
        raise RodError(f"release is {release!r} m; give at least the {hold:g} m that are held")


def _chunks(count: int, device: str, threads: int | None) -> tuple[list[list[int]], int]:
    """Trials that are simulated at once, and the threads that do."""
    cores, size, workers = os.cpu_count() or 1, count, 1
    if device == "cpu":
        workers = threads or (cores if cores >= _MANY_CORES else 1)
        size = max(1, min(_CPU_CHUNK, -(-count // workers)))
    every = list(range(count))
    return [every[first : first + size] for first in range(0, count, size)], workers


def _refuse_endless(trials: list[Trial], speed, spacing, step, frame_interval) -> None:
    """Refuse what no machine ends, or this one has no memory for, or steps and edges that miss
    what happens, before anything is laid."""
    _refuse_coarse_edges(trials, spacing)
    if speed * step > _LONGEST_MOVE:
        raise RodError(
            f"the grip moves {speed * step:g} m in a step of {step:g} s at {speed:g} m/s, too far "
            f"for what happens between; give a step or a speed that makes it {_LONGEST_MOVE:g} m"
        )
    longest = max(float(trial.rod.length) for trial in trials)
    nodes, duration = longest / spacing + 100.0, 2.0 * longest / speed
    if duration / step > _MOST_STEPS or nodes > _MOST_NODES:
        raise RodError(
            f"{longest:g} m of rod at {speed:g} m/s in steps of {step:g} s and edges of "
            f"{spacing:g} m take {duration / step:.2g} steps of {nodes:.2g} nodes; give a larger "
            "speed, step or spacing"
        )
    frames = 0.0 if frame_interval is None else duration / frame_interval
    require_memory(
        len(trials) * nodes * (_NODE_BYTES + 24.0 * frames),
        f"{len(trials)} trials of {nodes:.0f} nodes"
        + (f" and {frames:.0f} frames" if frames else ""),
        "ask for fewer trials or frames, or a larger spacing",
    )


def _refuse_coarse_edges(trials: list[Trial], spacing: float) -> None:
    longest = _LONGEST_EDGE * min(float(trial.rod.gravito_bending_length) for trial in trials)
    if spacing > longest:
        raise RodError(
            f"spacing is {spacing:g} m, and an edge of {longest:.2g} m is the longest that bends "
            "as this rod does; give less"
        )


def nodes_needed(trials: list[Trial], spacing: float) -> int:
    """Nodes for edges of that length [m] where each rod is laid."""
    _refuse_coarse_edges(trials, spacing)
    return max(len(mesh(t.rod, t.trajectory.arc_length[-1], spacing)) for t in trials)


def with_remainder_of(pattern: Pattern, trajectory: Trajectory) -> Pattern:
    """The pattern with the remainder that the trajectory lays before it."""
    length = float(trajectory.metadata.get("remainder_length", 0.0))
    if length > 0.0 and pattern.remainder_length == 0.0:
        return pattern.with_remainder(length)
    return pattern


def prepare_trials(
    trials: list[Trial],
    hold: float,
    release: float | Sequence[float | None] | None,
    speed: float,
    spacing: float,
    node_count: int | None,
) -> list[Setup]:
    """All rods of a batch share one number of nodes: the largest that the spacing asks for.

    Trials that differ in their disturbances alone share one undisturbed setup. `release` is of all,
    or of each; None is `hold`.
    """
    each = release if isinstance(release, Sequence) else [release] * len(trials)
    count = node_count or nodes_needed(trials, spacing)
    undisturbed: dict[tuple, Setup] = {}
    setups = []
    for trial, released in zip(trials, each, strict=True):
        plan = trial.pattern, trial.rod, trial.trajectory, trial.tail
        key = (*map(id, plan), released)
        if key not in undisturbed:
            pattern = with_remainder_of(trial.pattern, trial.trajectory)
            undisturbed[key] = prepare_deployment(
                pattern,
                trial.rod,
                trial.trajectory,
                mesh(trial.rod, trial.trajectory.arc_length[-1], spacing, count),
                trial.tail or tail(pattern, trial.rod, trial.trajectory),
                hold=hold,
                release=hold if released is None else released,
                speed=speed,
            )
        setups.append(disturb(undisturbed[key], trial.disturbance))
    return setups


def _simulate(
    trials: list[Trial],
    setups: list[Setup],
    step: float,
    frame_interval: float | None,
    report: Callable[[float], object],
    **options,
) -> list[Deployment]:
    batch, contact, dynamics = assemble(trials, setups, **options)
    ends = np.array([setup.end_time for setup in setups])
    frames = None
    if frame_interval is not None:
        count = int(np.floor(ends.max() / frame_interval + 1e-9)) + 1
        first = np.zeros((len(trials), count, batch.dof_count))
        first[:, 0] = batch.state.dof.numpy()
        frames = wp.array(first, dtype=wp.float64, device=batch.device)
    done = 0.0

    def note(times: np.ndarray) -> None:
        nonlocal done
        now = float(np.mean(np.minimum(times / ends, 1.0)))
        report(now - done)
        done = now

    advance = dict(frames=frames, frame_interval=frame_interval or 1.0, progress=note)
    dynamics.advance(np.array([s.measure_time for s in setups]), step, **advance)
    held, force, slip = (
        part.copy() for part in (batch.positions(), contact.force.numpy(), contact.slip.numpy())
    )
    end = dynamics.advance(ends, step, **advance)
    note(ends)
    released, film = batch.positions(), None if frames is None else frames.numpy()
    speed = np.linalg.norm(dynamics.velocities(), axis=2).max(axis=1)
    penetration = contact.penetration()
    deployments = []
    for k, (trial, setup) in enumerate(zip(trials, setups, strict=True)):
        pattern = with_remainder_of(trial.pattern, trial.trajectory)
        sink = np.array([0.0, 0.0, trial.rod.radius - pattern.sample(0.0)[0][0, 2]])
        now, later = held[k] - sink, released[k] - sink
        pictures = hand = None
        if film is not None:
            count = int(np.floor(end.time[k] / frame_interval + 1e-9)) + 1
            pictures = node_positions(film[k, :count]) - sink
            hand = setup.schedule.poses(frame_interval * np.arange(count))
            hand[:, :3, 3] -= sink
        deployments.append(
            Deployment(
                setup.arc_length,
                now,
                *deployment_error(pattern, setup.arc_length, now),
                later,
                *deployment_error(pattern, setup.arc_length, later),
                force[k],
                slip[k],
                bool(end.diverged[k]),
                float(end.time[k]),
                int(end.steps[k]),
                pictures,
                hand,
                setup.schedule.let_go_time,
                released_speed=float(speed[k]),
                penetration=float(penetration[k]),
            )
        )
    return deployments


def assemble(
    trials: list[Trial],
    setups: list[Setup],
    *,
    scheme: str = "euler",
    air_damping: float | None = None,
    internal_damping: float | None = None,
    tolerance: float = 1e-5,
    device: str = "cpu",
    keeps_recording: bool = False,
    friction_field: FrictionField | None = None,
) -> tuple[RodBatch, Contact, Dynamics]:
    """The rods of prepared trials, what they touch, and what steps them; see
    `simulate_deployments`."""
    batch, rods = _batch(trials, setups, device)
    radius = np.array([rod.radius for rod in rods])
    load = np.array([rod.weight * rod.gravito_bending_length for rod in rods])
    contact = Contact(
        batch,
        radius,
        _stiffness(rods, [t.fixtures for t in trials]),
        [t.friction for t in trials],
        [[Plane()] if t.fixtures is None else list(t.fixtures.shapes) for t in trials],
        keeps_roll=np.array([RodModel.of(t.rod).has_sides for t in trials]),
        friction_field=friction_field,
    )
    drag = quadratic_drag(rods, np.stack([setup.arc_length for setup in setups]))
    dynamics = Dynamics(
        batch,
        scheme=scheme,
        radius=radius,
        drag=None if drag is None else np.stack([np.zeros_like(drag), drag], axis=2),
        air_damping=np.array([_damping(air_damping, rod.air_damping or 1.0) for rod in rods]),
        internal_damping=np.array(
            [_damping(internal_damping, rod.internal_damping) for rod in rods]
        ),
        contact=contact,
        motion=GripMotion(
            batch,
            [setup.schedule for setup in setups],
            [rod.principal_angle for rod in rods],
        ),
        force_scale=load,
        tolerance=tolerance,
        keeps_recording=keeps_recording,
    )
    return batch, contact, dynamics


def _stiffness(rods: list[RodModel], fixtures: list[Fixtures | None]) -> np.ndarray:
    """(rod,) contact stiffness per length [Pa].

    Fixtures carry the rod's bending, not its weight: a post presses with about k_b / L_gb^2, some
    2 w L_gb, on an edge or two.
    """
    sinking = [_SINKING if f is None else _SINKING_AT_POSTS for f in fixtures]
    return np.array(
        [rod.weight / (part * rod.radius) for rod, part in zip(rods, sinking, strict=True)]
    )


def _damping(asked: float | None, own: float) -> float:
    return own if asked is None else asked


def _batch(trials, setups, device) -> tuple[RodBatch, list[RodModel]]:
    """The rods as they are: with the L_gb that they have, not the one that the plan believed, and
    described in the directors of the laid rod, the first to its left, the second above it."""
    held = []
    models = {id(trial.rod): trial.rod for trial in trials}
    models = {key: RodModel.of(rod) for key, rod in models.items()}
    for trial in trials:
        rod, bent = models[id(trial.rod)], trial.disturbance
        rod = rod.stiffened((1.0 + bent.lgb_error) ** 3)
        held.append(rod.turned(trial.trajectory.roll).bent(bent.natural_curvature))
    batch = RodBatch.of(
        held,
        np.stack([setup.arc_length for setup in setups]),
        np.stack([setup.position for setup in setups]),
        director=np.stack([setup.director for setup in setups]),
        device=device,
    )
    return batch, held
