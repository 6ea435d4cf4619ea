"""Deployments in simulation: a grip lays a rod along a pattern on a table with friction."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp

from wrod import arguments
from wrod.deployment.assembly import assemble
from wrod.deployment.beyond import edges_beyond, hung_beyond
from wrod.deployment.bounds import (
    check_release,
    refuse_another_pattern,
    refuse_another_rod,
    refuse_coarse_edges,
    refuse_endless,
)
from wrod.deployment.discretisation import USUAL, Discretisation
from wrod.deployment.fixtures import Fixtures
from wrod.deployment.result import Deployment, deployment_error
from wrod.deployment.setup import Disturbance, Setup, disturb, mesh, prepare_deployment
from wrod.deployment.sharing_out import chunks, shared_out
from wrod.deployment.trial import Trial
from wrod.errors import RodError
from wrod.kernels.stepping import pace
from wrod.patterns.pattern import Pattern
from wrod.planning.pace import PACES, USUAL_PACE
from wrod.planning.shapes import with_remainder_of
from wrod.planning.tail import tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.device import resolve_device
from wrod.rods.model import Rod
from wrod.rods.state import node_positions
from wrod.solvers.compiling import compile_steps
from wrod.solvers.friction import Friction, FrictionField
from wrod.solvers.readback import read
from wrod.solvers.recording import launching


@arguments.checked(
    RodError,
    friction=arguments.either(
        arguments.like("a wrod.Friction", "static", "kinetic"), arguments.number(0.0, 1e3)
    ),
    disturbance=arguments.optional(arguments.like("a wrod.Disturbance", "jitter")),
    fixtures=arguments.optional(arguments.like("a wrod.Fixtures", "items", "gates")),
)
def simulate_deployment(
    pattern: Pattern,
    rod: Rod,
    trajectory: Trajectory,
    friction: Friction | float = 0.6,
    *,
    disturbance: Disturbance | None = None,
    fixtures: Fixtures | None = None,
    **options,
) -> Deployment:
    """Lay `rod` along `pattern` by moving the grip along `trajectory`.

    The free end's first 5 cm are held along the pattern until more than that is laid. The
    rest hangs from the grip, which holds its end as a clamp. At the end of the pattern the
    grip rests and the rod is measured; then the grip lays the tail straight ahead by the same
    method, opens when 1 L_gb is left, and the rod is measured again.

    Args:
        pattern: the pattern of the plan; its remainder is added if the trajectory has one.
        rod: what is laid, a `RodMaterial` or a `RodModel`; it may differ from the plan's in all
            but length and radius (of a `Trial` in those, too).
        trajectory: of the grip, as `wrod.plan` returns it; the rod is held at its roll.
        friction: a `Friction`, or the coefficient of both kinds.
        disturbance: what makes this trial differ from the ideal.
        fixtures: posts and clips on the table; the robot's displacement does not move them.
        options: those of `simulate_deployments`.

    Raises:
        PatternError, RodError: the trajectory is too short, or was planned for another pattern or
            for a rod of another length or radius; or an option is not usable.
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


@launching()
@arguments.checked(
    RodError,
    trials=arguments.several(
        arguments.like("a wrod.Trial", "pattern", "rod", "trajectory", "friction"), least=0
    ),
    hold=arguments.number(0.0, 100.0),
    release=arguments.optional(arguments.number(0.0, 100.0)),
    speed=PACES,
    discretisation=arguments.like("a wrod.Discretisation", "spacing", "step", "scheme"),
    frame_interval=arguments.optional(arguments.number(1e-5, 1e6)),
    threads=arguments.optional(arguments.whole(0, 4096)),
    friction_field=arguments.optional(arguments.like("a wrod.FrictionField", "factor", "x", "y")),
    beyond_grip=arguments.flag,
)
def simulate_deployments(
    trials: list[Trial],
    *,
    hold: float = 0.05,
    release: float | None = None,
    speed: float = USUAL_PACE,
    discretisation: Discretisation = USUAL,
    frame_interval: float | None = None,
    device: arguments.DeviceLike = "cpu",
    threads: int | None = None,
    friction_field: FrictionField | None = None,
    beyond_grip: bool = False,
    progress: Callable[[float], object] | None = None,
) -> list[Deployment]:
    """Simulate many deployments at once; those that diverge are flagged and the others go on.

    Damping is the rods': a rod that has no `air_damping` of its own is laid with 1 /s.

    Args:
        trials: what to simulate.
        hold: length of the free end that is laid and held along the pattern at first [m]; 0: the
            rod hangs from the grip's first pose with its free end on the pattern's first point,
            and that point alone is held until the grip is there.
        release: laid length at which the free end is let go [m]; default: `hold`. A grip that keeps
            the rod taut, as method "intuitive" does, snatches what is let go before the rod lies
            beyond it: give 1 L_gb more for it.
        speed: at which the contact moves [m/s], slower where the grip has far to go; the tail is
            laid twice as fast.
        discretisation: how finely it is computed.
        frame_interval: keep the rod's states at its multiples [s].
        device: "cpu", "cuda:0", "auto".
        threads: CPU threads; default: one per core, but no more than OMP_NUM_THREADS says.
        friction_field: how the table's friction varies over x and y; default: it does not.
        beyond_grip: lay the whole rods, what hangs beyond the grip with them (of trajectories with
            `beyond_grip`, together): it touches the table, not the rod that lies there.
        progress: called with the fraction done since the last call, of all trials.
    """
    hold, release = float(hold), float(hold if release is None else release)
    check_release(hold, release)
    if not trials:
        return []
    device = resolve_device(device)
    refuse_endless(trials, speed, discretisation, frame_interval)
    plans = {(id(t.pattern), id(t.rod), id(t.trajectory), t.another_rod): t for t in trials}
    for trial in plans.values():
        refuse_other_plans(trial)
    compile_steps(device, "grip")
    setups = prepare_trials(trials, hold, release, speed, discretisation, beyond_grip)
    options: dict[str, Any] = dict(
        device=device, friction_field=friction_field, keeps_recording=device == "cpu"
    )

    def run(chunk: list[int], still_wanted: Callable[[], None]) -> list[Deployment]:
        def report(fraction: float) -> None:
            still_wanted()
            if progress is not None:
                progress(fraction * len(chunk) / len(trials))

        given, prepared = [trials[i] for i in chunk], [setups[i] for i in chunk]
        with launching():  # of this thread
            return _simulate(given, prepared, discretisation, frame_interval, report, **options)

    return shared_out(run, *chunks(len(trials), device, threads))


def nodes_needed(trials: list[Trial], spacing: float, laid: float | None = None) -> int:
    """Nodes for edges of that length [m] where each rod is laid, or where `laid` [m] of it are."""
    refuse_coarse_edges([t.rod for t in trials], spacing)
    return max(len(mesh(t.rod, laid or t.trajectory.arc_length[-1], spacing)) for t in trials)


def refuse_other_plans(trial: Trial) -> None:
    """Refuse a trajectory of another pattern, or of a rod of another length or radius.

    Raises:
        PatternError, RodError: says which.
    """
    refuse_another_pattern(trial.trajectory, with_remainder_of(trial.pattern, trial.trajectory))
    if not trial.another_rod:
        refuse_another_rod(trial.trajectory, trial.rod, ("length", "radius"))


def prepare_trials(
    trials: list[Trial],
    hold: float,
    release: float | Sequence[float | None] | None,
    speed: float,
    discretisation: Discretisation,
    beyond_grip: bool = False,
) -> list[Setup]:
    """All rods of a batch share one number of nodes: the largest that the spacing asks for.

    Trials that differ in their disturbances alone share one undisturbed setup. `release` is of all,
    or of each; None is `hold`.
    """
    each = release if isinstance(release, Sequence) else [release] * len(trials)
    spacing, laid = discretisation.spacing, discretisation.laid
    count = discretisation.node_count or nodes_needed(trials, spacing, laid)
    beyond = edges_beyond(trials, spacing) if beyond_grip else 0
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
                mesh(trial.rod, laid or trial.trajectory.arc_length[-1], spacing, count),
                trial.tail or tail(pattern, trial.rod, trial.trajectory),
                hold=hold,
                release=hold if released is None else released,
                speed=speed,
            )
            if beyond:
                undisturbed[key] = hung_beyond(
                    undisturbed[key], trial.rod, trial.trajectory, beyond
                )
        setups.append(disturb(undisturbed[key], trial.disturbance))
    return setups


def _simulate(
    trials: list[Trial],
    setups: list[Setup],
    discretisation: Discretisation,
    frame_interval: float | None,
    report: Callable[[float], object],
    **options,
) -> list[Deployment]:
    batch, contact, dynamics = assemble(trials, setups, discretisation, **options)
    ends = np.array([setup.end_time for setup in setups])
    frames = None
    if frame_interval is not None:
        number = int(np.floor(ends.max() / frame_interval + 1e-9)) + 1
        first = np.zeros((len(trials), number, batch.dof_count))
        first[:, 0] = batch.state.dof.numpy()
        frames = wp.array(first, dtype=wp.float64, device=batch.device)
    done = 0.0

    def note(times: np.ndarray) -> None:
        nonlocal done
        now = float(np.mean(np.minimum(times / ends, 1.0)))
        report(now - done)
        done = now

    held, force, slip = (wp.clone(a) for a in (batch.state.dof, contact.force, contact.slip))
    until = wp.array(ends, dtype=wp.float64, device=batch.device)

    def measure() -> None:
        """Of rods that the grip has laid; none waits for others to go on."""
        found = [batch.state.dof, contact.force, contact.slip, dynamics.pace]
        batch.launch_lanes(pace.measure, [until, *found], [held, force, slip])

    end = dynamics.advance(
        np.array([s.measure_time for s in setups]), discretisation.step,
        frames=frames, frame_interval=frame_interval or 1.0, progress=note, then=measure,
    )  # fmt: skip
    note(ends)
    count = len(setups[0].arc_length)  # the last nodes may be the ghosts of the grips
    laid, force, slip = (
        a[:, :count] for a in (node_positions(read(held)), read(force), read(slip))
    )
    released, film = batch.positions()[:, :count], None if frames is None else frames.numpy()
    speed = np.linalg.norm(dynamics.velocities()[:, :count], axis=2).max(axis=1)
    penetration = contact.penetration()
    deployments = []
    for k, (trial, setup) in enumerate(zip(trials, setups, strict=True)):
        pattern = with_remainder_of(trial.pattern, trial.trajectory)
        now, later = laid[k] - setup.lift, released[k] - setup.lift
        pictures = hand = None
        if film is not None:
            number = int(np.floor(end.time[k] / frame_interval + 1e-9)) + 1
            pictures = node_positions(film[k, :number])[:, :count] - setup.lift
            hand = setup.schedule.poses(frame_interval * np.arange(number))
            hand[:, :3, 3] -= setup.lift
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
