"""What a simulated deployment starts from: mesh, first shape, tail, and the grip's schedule."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from wrod import arguments
from wrod.deployment.grip_path import KEY_INTERVAL, GripSchedule, smooth_noise
from wrod.errors import PatternError, RodError
from wrod.grasps.mesh import rest_lengths
from wrod.grasps.optimal import solve_grasps
from wrod.patterns.curve import arc_length as along
from wrod.patterns.curve import smoothstep
from wrod.patterns.pattern import Pattern
from wrod.planning.pace import TAIL_FASTER, GripPath
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.model import Rod, RodModel
from wrod.rods.rotation import angle_about, carried, one_hemisphere, unit

# The mesh stays fine for this long beyond what is laid, in L_gb: the boundary layer at the contact.
_FINE_BEYOND = 4.0
_COARSE_RATIO = 3.0
# Seconds: from the first equilibrium to the trajectory's first pose, rest before each measurement.
_APPROACH, _REST, _FALL = 1.0, 0.8, 1.2
# More of them for every whole turn that the grip twists the rod by before it deploys.
_TURN = 2.0


# Standard deviations of a careful laboratory [m, -, m, rad, 1/m].
DEVIATIONS: dict[str, float] = {
    "jitter": 0.3e-3,
    "lgb_error": 0.03,
    "placement": 0.5e-3,
    "yaw": float(np.radians(0.2)),
    "natural_curvature": 0.2,
}
# How long a slip of the grip takes [s].
_SLIPPING = 0.3


@dataclass(frozen=True)
class Disturbance:
    """What distinguishes one trial from the next; the default is none.

    Attributes:
        jitter: standard deviation of each coordinate of the grip's smooth shaking [m].
        lgb_error: relative error of the L_gb that the plan believed in: the true one is
            (1 + lgb_error) times as large.
        offset: (2,) displacement of the robot, and of all it does, against the pattern [m].
        yaw: its rotation about the pattern's first point [rad].
        natural_curvature: curvature of the rod at rest, in the horizontal plane where it is laid
            flat [1/m].
        slip: how far the rod slips through the grip while it is deployed, so that more of it hangs
            (or less, if negative) [m].
        seed: of the shaking, and of when the rod slips.
        shaking_time: for which it is drawn at least [s]: deployments that take different times, up
            to this, shake alike as long as both go on.
    """

    jitter: float = 0.0
    lgb_error: float = 0.0
    offset: tuple[float, float] = (0.0, 0.0)
    yaw: float = 0.0
    natural_curvature: float = 0.0
    seed: int = 0
    slip: float = 0.0
    shaking_time: float = 0.0

    @arguments.checked(RodError)
    def __post_init__(self) -> None:
        number = arguments.number(-1e6, 1e6)
        arguments.check_fields(
            self, RodError, jitter=arguments.number(0.0, 1e3),
            lgb_error=arguments.number(-0.99, 10.0), offset=arguments.array((2,)),
            yaw=arguments.number(-arguments.ONCE_ROUND, arguments.ONCE_ROUND),
            natural_curvature=number, seed=arguments.whole(), slip=number,
            shaking_time=arguments.number(0.0, 1e5),
        )  # fmt: skip

    @classmethod
    @arguments.checked(
        RodError,
        seed=arguments.whole(),
        slip=arguments.number(0.0, 1e3),
        only=arguments.some_of(DEVIATIONS),
    )
    def random(
        cls, seed: int, *, slip: float = 0.0, only: Collection[str] = tuple(DEVIATIONS)
    ) -> Disturbance:
        """A trial like those of a careful laboratory: `DEVIATIONS`, or `only` those that are named,
        and the standard deviation `slip` [m]."""
        rng = np.random.default_rng(seed)
        one = {name: value if name in only else 0.0 for name, value in DEVIATIONS.items()}
        offset = one["placement"] * rng.standard_normal(2)
        return cls(
            jitter=one["jitter"],
            lgb_error=one["lgb_error"] * float(rng.standard_normal()),
            offset=(float(offset[0]), float(offset[1])),
            yaw=float(one["yaw"] * rng.standard_normal()),
            natural_curvature=one["natural_curvature"] * float(rng.standard_normal()),
            seed=seed,
            slip=slip * float(rng.standard_normal()),
        )

    def displaced(self, points: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Points (n, 3) that the robot means, where it has them: turned about `origin` (3,) and
        shifted [m]."""
        return self.turned(points - origin) + (origin + np.array([*self.offset, 0.0]))

    def turned(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors (..., 3) turned about z by the yaw."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return vectors @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def mesh(rod: Rod, laid: float, spacing: float, node_count: int | None = None):
    """(node,) rest arc lengths: fine where the rod is laid or about to be, coarse beyond.

    With `node_count` the spacing is what gives that many nodes.
    """
    fine = min(rod.length, laid + _FINE_BEYOND * rod.gravito_bending_length)
    measure = fine + (rod.length - fine) / _COARSE_RATIO
    edges = int(np.ceil(measure / spacing)) if node_count is None else node_count - 1
    at = np.linspace(0.0, measure, edges + 1)
    return np.where(at <= fine, at, fine + _COARSE_RATIO * (at - fine))


@dataclass(frozen=True)
class Setup:
    """One rod ready to be deployed; SI units, the table's contact plane at z = 0.

    Attributes:
        arc_length: (node,) rest arc length of the nodes, from the free end [m].
        position: (node, 3) first shape [m].
        director: (3,) first material director of the first edge.
        origin: (3,) below the pattern's first point, about which a disturbance turns the robot.
        schedule: the grip's motion.
        approach: how long the grip takes to the trajectory's first pose [s].
        measure_time: when the first measurement is due, the grip still holding [s].
        end_time: when the second is due [s].
        covered: (key,) laid length that the trajectory has come to at each key [m].
        lift: of the rod's middle over the pattern's plane, which is here on the table [m].
    """

    arc_length: np.ndarray
    position: np.ndarray
    director: np.ndarray
    origin: np.ndarray
    schedule: GripSchedule
    approach: float
    measure_time: float
    end_time: float
    covered: np.ndarray | None = None
    lift: tuple[float, float, float] = (0.0, 0.0, 0.0)


def prepare_deployment(
    pattern: Pattern,
    rod: Rod,
    trajectory: Trajectory,
    arc_length: np.ndarray,
    tail: Tail,
    *,
    hold: float,
    release: float,
    speed: float,
) -> Setup:
    """Lay the first `hold` metres along the pattern and hang the rest from the grip; undisturbed.

    The hanging part starts as the equilibrium for a moment-free grip and is carried to the
    trajectory's own pose there, which for an optimal trajectory is the same.

    Raises:
        PatternError: the trajectory is shorter than two nodes beyond `hold`.
    """
    laid, lgb = trajectory.arc_length, rod.gravito_bending_length
    first = int(np.argmin(np.abs(laid - hold)))
    if first > len(laid) - 3:
        raise PatternError(
            f"{pattern.source}: the trajectory lays {laid[-1]:.3f} m in {len(laid)} poses and the "
            f"first {hold:g} m are held; give a longer pattern, a shorter spacing or a smaller hold"
        )
    start = float(laid[first])
    offset = -pattern.remainder_length
    (contact,), (tangent,), (curvature,) = pattern.sample(start + offset)
    side = np.cross([0.0, 0.0, 1.0], tangent)
    frame = np.column_stack([tangent, side, [0.0, 0.0, 1.0]])
    suspended = (rod.length - start) / lgb
    if RodModel.of(rod).law.at_rest is None and trajectory.shape is not None:
        # It would remember to have hung elsewhere.
        shape = np.asarray(trajectory.shape[first])
        s = along(shape)
        s *= suspended / s[-1]
    else:
        hangs = _hanging(float(suspended), float(curvature * lgb), float(rod.stretch_ratio))
        shape = contact + lgb * hangs @ frame.T
        rest = rest_lengths(np.array([suspended]), len(shape) - 1)[0]
        s = np.concatenate([[0.0], np.cumsum(rest)])
    position = np.empty((len(arc_length), 3))
    on_table = arc_length <= start * (1.0 + 1e-9)
    position[on_table] = pattern.sample(arc_length[on_table] + offset)[0]
    hanging = CubicSpline(start + lgb * s, shape)
    position[~on_table] = hanging(np.minimum(arc_length[~on_table], start + lgb * s[-1]))

    path = GripPath(laid[first:], trajectory.position[first:], trajectory.rotation[first:])
    tip = position[-1] - position[-2]
    # It begins with the twist that it has at rest.
    rolled = float(RodModel.of(rod).rolled(arc_length[-1]))
    turn = Rotation.from_rotvec([rolled, 0.0, 0.0]).as_matrix()
    begin = position[-1], _frame_without_twist(frame, position, on_table, tip) @ turn
    twist = 0.0 if trajectory.twist is None else float(trajectory.twist[first])
    turns = _whole_turns(begin[1], trajectory.rotation[first], twist - rolled)
    schedule, approach, measure_time, end_time, covered = _schedule(
        path, tail, begin, turns, release, int(on_table.sum()), speed
    )
    # The rod's centreline is a radius above the table.
    lift = 0.0, 0.0, rod.radius - pattern.sample(0.0)[0][0, 2]
    schedule = replace(schedule, position=schedule.position + lift)
    (origin,), (ahead,), _ = pattern.sample(offset)
    origin[2] = 0.0
    director = np.cross([0.0, 0.0, 1.0], ahead)
    return Setup(
        arc_length, position + lift, director, origin, schedule, approach, measure_time, end_time,
        covered, lift,
    )  # fmt: skip


@lru_cache(maxsize=1024)
def _hanging(suspended: float, curvature: float, stretch_ratio: float) -> np.ndarray:
    """(node, 3) of the optimal grasp, dimensionless; a plan is laid again and again."""
    return solve_grasps([suspended], [curvature], [stretch_ratio], device="cpu").shape[0]


def disturb(setup: Setup, disturbance: Disturbance) -> Setup:
    """The same deployment by a robot that shakes and stands elsewhere; the shaking begins once the
    grip has come to the trajectory."""
    schedule = setup.schedule
    position = schedule.position
    if disturbance.jitter > 0.0:
        count = len(position)
        rng = np.random.default_rng(disturbance.seed)
        drawn = max(count, int(np.ceil(disturbance.shaking_time / KEY_INTERVAL)))
        shaking = smooth_noise(rng, drawn, disturbance.jitter, 0.05 / KEY_INTERVAL)[:count]
        fade = 1.0 - blend(KEY_INTERVAL * np.arange(count), setup.approach)
        position = position + fade[:, None] * shaking
    if disturbance.slip != 0.0:
        position = position + _slipped(setup, disturbance)
    return replace(
        setup,
        position=disturbance.displaced(setup.position, setup.origin),
        director=disturbance.turned(setup.director),
        schedule=replace(
            schedule,
            position=disturbance.displaced(position, setup.origin),
            rotation=_about_z(schedule.rotation, disturbance.yaw),
        ),
    )


def _about_z(quaternions: np.ndarray, angle: float) -> np.ndarray:
    """Rotations (n, 4) turned about z by `angle` [rad]; neighbours stay neighbours."""
    x, y, z, w = quaternions.T
    c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
    return np.column_stack([c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z])


def _slipped(setup: Setup, disturbance: Disturbance) -> np.ndarray:
    """(key, 3) displacement of the grip along the rod: nothing, then all of the slip, from
    some moment on while the rod is deployed."""
    rng = np.random.default_rng([disturbance.seed, 1])
    start = rng.uniform(setup.approach, max(setup.measure_time - _SLIPPING, setup.approach))
    t = KEY_INTERVAL * np.arange(len(setup.schedule.position))
    share = 1.0 - blend(t - start, _SLIPPING / 0.7)
    along = Rotation.from_quat(setup.schedule.rotation).apply([1.0, 0.0, 0.0])
    return disturbance.slip * share[:, None] * along


def blend(t: np.ndarray, approach: float) -> np.ndarray:
    """From where the rod hangs at first (1) to where the trajectory begins (0)."""
    return 1.0 - smoothstep(t / (0.7 * approach))


def _frame_without_twist(frame, position, on_table, tip) -> np.ndarray:
    """The contact frame carried along the hanging part to the grip, x axis along the rod."""
    edges = np.diff(position[int(on_table.sum()) - 1 :], axis=0)
    side = carried(frame[:, 1], np.vstack([frame[:, 0], unit(edges)]))[-1]
    x = tip / np.linalg.norm(tip)
    side = side - (side @ x) * x
    side /= np.linalg.norm(side)
    return np.column_stack([x, side, np.cross(x, side)])


def _whole_turns(untwisted: np.ndarray, rotation: np.ndarray, twist: float) -> int:
    """How often the grip turns the rod about itself on the way from one frame to the other, so
    that it is twisted by `twist` in the end."""
    x = rotation[:, 0]
    shortest, _ = Rotation.align_vectors(x[None], untwisted[None, :, 0])
    angle = angle_about(x, shortest.apply(untwisted[:, 1]), rotation[:, 1])
    return int(np.rint((twist - angle) / (2.0 * np.pi)))


def _schedule(path, tail, begin, turns, release, held_nodes, speed):
    """Approach, deploy, rest, lay the tail, let go, rest."""
    deploy, laid = path.timed(speed)
    approach = _APPROACH + _TURN * abs(turns)
    tail_path = None
    lay, tail_laid = 0.0, None
    if len(tail.laid) > 3:
        tail_path = GripPath(tail.laid, tail.position, tail.rotation)
        lay, tail_laid = tail_path.timed(TAIL_FASTER * speed)
    measure_time = approach + deploy + _REST
    let_go_time = measure_time + lay + 0.5 * _REST
    end_time = let_go_time + _FALL
    t = np.arange(0.0, let_go_time + 2 * KEY_INTERVAL, KEY_INTERVAL)
    covered = laid(t - approach)
    position, rotation = path(covered)
    if tail_path is not None:
        late = t > measure_time
        after = tail_path(tail_laid(t[late] - measure_time))
        position[late] = after[0]
        rotation = Rotation.concatenate([rotation[~late], after[1]])
    share = blend(t, approach)
    position += share[:, None] * (begin[0] - position[0])
    turn = (Rotation.from_matrix(begin[1]) * rotation[0].inv()).as_rotvec()
    rotation = Rotation.from_rotvec(share[:, None] * turn) * rotation
    spin = 2.0 * np.pi * turns * (1.0 - share)
    rotation = rotation * Rotation.from_rotvec(spin[:, None] * [1.0, 0.0, 0.0])
    # Not before the rod has come to rest at the trajectory's first pose.
    at = np.searchsorted(covered, release)
    let_free = max(float(t[min(int(at), len(t) - 1)]), approach)
    schedule = GripSchedule(
        position, one_hemisphere(rotation.as_quat()), held_nodes, let_free, let_go_time
    )
    return schedule, approach, measure_time, end_time, covered
