"""Deployments with their derivatives: how what lies answers to the grip's path and to the rod."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from wrod import arguments
from wrod.deployment.assembly import assemble
from wrod.deployment.carried_tangents import LaidTangents
from wrod.deployment.discretisation import USUAL, Discretisation
from wrod.deployment.grip_path import KEY_INTERVAL
from wrod.deployment.remembered import LaidParts, LastDeployments
from wrod.deployment.result import interpolation
from wrod.deployment.setup import Setup, blend
from wrod.deployment.sharing_out import chunks, shared_out
from wrod.deployment.simulate import nodes_needed, prepare_trials
from wrod.deployment.trial import Trial
from wrod.errors import RodError
from wrod.rods.device import resolve_device
from wrod.rods.discretisation import in_principal
from wrod.rods.model import RodModel
from wrod.rods.rotation import left_jacobian, one_hemisphere
from wrod.solvers.compiling import compile_steps
from wrod.solvers.friction import FrictionField
from wrod.solvers.recording import launching

Watch = Callable[[np.ndarray], object]
# What of a direction counts as nothing before it begins, over its largest: splines ring back from
# there, by a quarter of it from pose to pose.
_RINGING = 1e-9


@dataclass(frozen=True)
class Directions:
    """Along what a deployment is differentiated: columns, each a rate of all that follows.

    Attributes:
        path: (column, T, 6) displacement [m] and rotation vector [rad], in the world frame, of each
            pose of the trajectory.
        friction: (column,) of the static and the kinetic coefficient [-]; or (column, point), where
            it varies over the table: of those under points spread evenly along the rod.
        stiffness: (column,) of the logarithm of the rod's stiffness in stretching, bending and
            twisting, its weight unchanged: three times that of L_gb [-].
        natural_curvature: (column,) of the curvature at rest towards the left of the laid rod
            [1/m].
    """

    path: np.ndarray
    friction: np.ndarray
    stiffness: np.ndarray
    natural_curvature: np.ndarray

    def __post_init__(self) -> None:
        if np.ndim(self.friction) == 1:
            object.__setattr__(self, "friction", np.asarray(self.friction)[:, None])

    @classmethod
    def of_path(cls, path: np.ndarray) -> Directions:
        """Displacements of the path alone: (column, T, 6)."""
        none = np.zeros(len(path))
        return cls(np.asarray(path, dtype=float), none, none, none)

    @classmethod
    def of_rod(cls, nodes: int) -> Directions:
        """Three columns: friction, logarithm of the stiffness, natural curvature. `nodes` is T."""
        one = np.eye(3)
        return cls(np.zeros((3, nodes, 6)), one[0], one[1], one[2])

    def __add__(self, other: Directions) -> Directions:
        """The columns of both."""
        names = ("path", "stiffness", "natural_curvature")
        path, *rod = (np.concatenate([getattr(d, n) for d in (self, other)]) for n in names)
        points = max(d.friction.shape[1] for d in (self, other))
        friction = [np.broadcast_to(d.friction, (len(d), points)) for d in (self, other)]
        return Directions(path, np.concatenate(friction), *rod)

    def __len__(self) -> int:
        return len(self.path)


@dataclass(frozen=True)
class Laid:
    """What lies at the end of the pattern, the grip still holding, and its derivatives.

    Attributes:
        arc_length: (node,) rest arc length from the free end [m].
        centerline: (node, 3), at the height of the pattern's plane [m].
        tangent: (column, node, 3) derivative along each direction.
        slip: (node,) how far each node slid on the table [m].
        diverged: no step converged any more; the rest is from the last good one.
        steps: time steps taken.
    """

    arc_length: np.ndarray
    centerline: np.ndarray
    tangent: np.ndarray
    slip: np.ndarray
    diverged: bool
    steps: int


def lay(
    trials: list[Trial],
    directions: list[Directions] | None = None,
    displacements: list[np.ndarray] | None = None,
    *,
    hold: float = 0.05,
    release: float | Sequence[float | None] | None = None,
    speed: float = 0.02,
    discretisation: Discretisation = USUAL,
    friction_field: FrictionField | None = None,
    device: arguments.DeviceLike = "cpu",
    watch: Watch | None = None,
    remembered: Sequence[LastDeployments] | None = None,
) -> list[Laid]:
    """Lay rods until the end of their patterns, with the derivatives of what lies.

    The derivatives are those of the steps that are taken: every tangent solves the linearised step
    with its exact Jacobian, contact, stick and slip included. The grip's time law, the time steps
    and torques at which a roll slides count as given. Where a node passes from sticking to sliding,
    the laid curve has a kink in its parameters, and the derivative is that of the side on which the
    deployment went.

    Args:
        trials: what to lay, without fixtures.
        directions: of each trial, all with the same number of columns; None: no derivatives.
        displacements: (T, 6) of each trial: displacement [m] and rotation vector [rad] of the
            trajectory's poses, their time law unchanged.
        release: as in `simulate_deployments`, for all or for each.
        hold, speed, discretisation, friction_field, device: see `simulate_deployments`;
            derivatives are those of "euler" and "bdf2".
        watch: called now and then with the (rod,) times [s]; what it raises ends the laying.
        remembered: of each trial, on a CPU: deployments before it, from which it goes on where it
            began like one of them; of its directions, those that are not of the path alone tell.

    Raises:
        RodError: a trial has fixtures or lets the rod roll, the rod drags the air quadratically, or
            the scheme is "midpoint", while derivatives are wanted; or the directions do not match
            the trials.
    """
    device = resolve_device(device)
    if directions is not None:
        _check(trials, directions, discretisation.scheme)
    compile_steps(device, "grip", *([] if directions is None else ["tangents"]))
    if displacements is None:
        displacements = [np.zeros((len(trial.trajectory), 6)) for trial in trials]
    released = release if isinstance(release, Sequence) else [release] * len(trials)
    spacing, fine = discretisation.spacing, discretisation.laid
    count = discretisation.node_count or nodes_needed(trials, spacing, fine)
    mesh = replace(discretisation, node_count=count)

    def run(part: list[int], still_wanted: Callable[[], None]) -> list[Laid]:
        def progress(times: np.ndarray) -> None:
            still_wanted()
            if watch is not None:
                watch(times)

        given, moved = [trials[k] for k in part], [displacements[k] for k in part]
        told = None if directions is None else [directions[k] for k in part]
        with launching():
            setups = prepare_trials(given, hold, [released[k] for k in part], speed, mesh)
            before = None if remembered is None else remembered[part[0]]
            how = device, friction_field, progress, before
            return _laid(given, setups, told, moved, mesh, *how)

    parts, workers = chunks(len(trials), device)
    if remembered is not None:
        parts = [[k] for k in range(len(trials))]
    return shared_out(run, parts, workers)


def _laid(
    trials: list[Trial],
    setups: list[Setup],
    directions: list[Directions] | None,
    displacements: list[np.ndarray],
    discretisation: Discretisation,
    device: str,
    friction_field: FrictionField | None,
    progress: Watch,
    remembered: LastDeployments | None,
) -> list[Laid]:
    """`lay` of the trials of one batch."""
    moves = [_over_keys(*one) for one in zip(trials, setups, displacements, strict=True)]
    setups = [_displaced(*one) for one in zip(setups, moves, strict=True)]
    columns = None if directions is None else _columns(trials, setups, directions, moves)
    batch, contact, dynamics = assemble(
        trials,
        setups,
        discretisation,
        device=device,
        keeps_recording=device == "cpu",
        friction_field=friction_field,
    )
    tangents = None
    if columns is not None:
        dynamics.follower = tangents = LaidTangents(batch, contact, *columns)
    if remembered is not None:
        parts, (one,), (setup,) = LaidParts(batch, contact, dynamics, tangents), trials, setups
        early = [c[0, ~columns[0][0].any(axis=(1, 2))] for c in columns[1:4]] if columns else []
        how = one.disturbance
        told = RodModel.of(one.rod), one.friction, how.lgb_error, how.natural_curvature
        told = *told, friction_field, discretisation, early
        time = remembered.begun(told, setup, parts, discretisation.step)
        for stop in remembered.stops(setup.measure_time, time):
            dynamics.advance(stop, discretisation.step, progress=progress)
            remembered.keep(stop, parts)
    end = dynamics.advance(
        np.array([s.measure_time for s in setups]), discretisation.step, progress=progress
    )
    # The last nodes are the ghosts of the grips.
    positions, slip = batch.positions()[:, :-1], contact.slip.numpy()[:, :-1]
    rates = np.zeros((len(trials), 0, *positions.shape[1:]))
    if tangents is not None:
        rates = tangents.values()[:, :, :-1]
    laid = []
    for k, setup in enumerate(setups):
        lies, went = positions[k] - setup.lift, slip[k].copy()
        diverged, steps = bool(end.diverged[k]), int(end.steps[k])
        laid.append(Laid(setup.arc_length, lies, rates[k], went, diverged, steps))
    return laid


def _check(trials: list[Trial], directions: list[Directions], scheme: str) -> None:
    if scheme == "midpoint":
        raise RodError("derivatives of a deployment know no midpoint; take scheme euler or bdf2")
    if len(directions) != len(trials) or len({len(d) for d in directions}) > 1:
        raise RodError(
            f"{len(trials)} trials have {len(directions)} sets of directions of "
            f"{sorted({len(d) for d in directions})} columns; give one set for each, of one size"
        )
    for trial, columns in zip(trials, directions, strict=True):
        if trial.fixtures is not None or trial.friction.rolling:
            raise RodError(
                "derivatives of a deployment know the table alone, with friction that does not "
                "roll; leave fixtures and rolling out"
            )
        if RodModel.of(trial.rod).quadratic_drag > 0.0:
            raise RodError(
                "derivatives of a deployment know drag that grows with the velocity alone; give a "
                "rod without quadratic_drag, which slow deployments do not feel"
            )
        if columns.path.shape[1] != len(trial.trajectory):
            raise RodError(
                f"directions of {columns.path.shape[1]} poses for a trajectory of "
                f"{len(trial.trajectory)}; give one for each pose"
            )


def _columns(trials, setups, directions: list[Directions], moves: list[np.ndarray]):
    """(rod, column, key, 6) rates of the grip, of one rod where all are alike, (rod, column, node)
    of friction, (rod, column) of the stiffness, (rod, column, 2) of the natural curvature, and
    (rod, column) when each column begins [s]."""
    found: dict[tuple, np.ndarray] = {}
    paths = []
    for trial, setup, columns, move in zip(trials, setups, directions, moves, strict=True):
        moved = id(move) if move.any() else None
        key = id(columns.path), id(setup.covered), trial.disturbance.yaw, moved
        if key not in found:
            rates = _over_keys(trial, setup, columns.path)
            # Rotation vectors add up to a rotation's spin by its left Jacobian.
            if moved is not None:
                spin = np.einsum("kij,ckj->cki", left_jacobian(move[:, 3:]), rates[..., 3:])
                rates = np.concatenate([rates[..., :3], spin], axis=2)
            found[key] = rates
        paths.append(found[key])
    if len(found) == 1:
        paths = paths[:1]
    keys = max(rates.shape[1] for rates in paths)
    path = np.stack(
        [np.pad(r, ((0, 0), (0, keys - r.shape[1]), (0, 0)), mode="edge") for r in paths]
    )
    stiffness, left = (
        np.stack([getattr(d, n) for d in directions]) for n in ("stiffness", "natural_curvature")
    )
    held = [RodModel.of(t.rod).turned(t.trajectory.roll).principal_angle for t in trials]
    bends = (
        left[:, :, None] * np.stack([in_principal(np.array([1.0, 0.0]), a) for a in held])[:, None]
    )
    friction = np.stack([_under(*each) for each in zip(trials, setups, directions, strict=True)])
    size = np.abs(path).max(axis=3)
    moves = size > _RINGING * size.max(axis=2, keepdims=True)
    first = np.where(moves.any(axis=2), moves.argmax(axis=2) - 2, keys)
    always = (stiffness != 0.0) | (left != 0.0) | friction.any(axis=2)
    return path, friction, stiffness, bends, KEY_INTERVAL * np.where(always, -2, first)


def _under(trial: Trial, setup: Setup, columns: Directions) -> np.ndarray:
    """(column, node + 1) rates of the coefficient of friction under a rod's nodes, and under the
    ghost of the grip, which feels none."""
    at = np.linspace(0.0, trial.rod.length, max(columns.friction.shape[1], 2))
    rates = np.broadcast_to(columns.friction, (len(columns), len(at)))
    return np.pad(rates @ interpolation(setup.arc_length, at).T, ((0, 0), (0, 1)))


def _over_keys(trial: Trial, setup: Setup, values: np.ndarray) -> np.ndarray:
    """(..., key, 6) of the grip's keys out of (..., T, 6) of the trajectory's poses; the grip comes
    to the first as it comes to the trajectory, and keeps the last after the pattern's end."""
    t = KEY_INTERVAL * np.arange(len(setup.schedule.position))
    share = 1.0 - blend(t, setup.approach)
    out = CubicSpline(trial.trajectory.arc_length, values, axis=-2)(setup.covered) * share[:, None]
    turn = Rotation.from_euler("z", trial.disturbance.yaw).as_matrix()
    return (out.reshape(*out.shape[:-1], 2, 3) @ turn.T).reshape(out.shape)


def _displaced(setup: Setup, move: np.ndarray) -> Setup:
    """The setup with its keys displaced by (key, 6)."""
    if not move.any():
        return setup
    schedule = setup.schedule
    turned = Rotation.from_rotvec(move[:, 3:]) * Rotation.from_quat(schedule.rotation)
    schedule = replace(
        schedule,
        position=schedule.position + move[:, :3],
        rotation=one_hemisphere(turned.as_quat()),
    )
    return replace(setup, schedule=schedule)
