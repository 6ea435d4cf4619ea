"""The whole job over time codes: the rod at every node of a trajectory, and what comes before the
first and after the last."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from wrod.patterns.curve import arc_length
from wrod.planning.beyond import Beyond, longest_free
from wrod.planning.shapes import with_shapes
from wrod.planning.tail import with_tail
from wrod.planning.trajectory import Trajectory
from wrod.scene.brought import turned

POINTS = 201  # of the centreline; 4 mm apart on the rods of Table 2
MOST = 120  # time codes before the first node, and after the last
_FALL = 0.3  # [s] in which a rod that is let go comes to lie, where that is not simulated
# [s] after letting go at which its shapes are kept; it lies at the last.
_FALLING = np.concatenate([np.linspace(0.0, 0.5, 11), np.linspace(0.7, 2.5, 10)])
_FRICTION = 0.4  # of a table that the plan does not know
_OPEN = 0.5  # share of the release after which the fingers are open
_LIES = 1e-4  # [m] above the end of the laid part, what is lower lies
# A rod as it is held (M, 3) [m], times (K,) since it was let go [s] -> (K, M, 3).
Falls = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Film:
    """Arm and rod at time codes; code k from 0 on is node k of the trajectory.

    Codes below 0 are approach and grasp, those beyond the last node release and retreat, as far
    apart in time as the nodes are on average.

    Attributes:
        code: (K,).
        time: (K,) [s], or None without a joint path.
        phase: K names, or None.
        node: (K,) nodes of the trajectory, the first before it and the last after it.
        positions: (K, n) [rad], or None.
        shapes: (K, M, 3) of the rod [m].
    """

    code: np.ndarray
    time: np.ndarray | None
    phase: list[str] | None
    node: np.ndarray
    positions: np.ndarray | None
    shapes: np.ndarray


@dataclass(frozen=True)
class Onward:
    """The rod beyond the plan: laid lengths (n,) [m] and shapes (n, M, 3) [m], the first the
    plan's last; contact (n, 3) [m]."""

    laid: np.ndarray
    shapes: np.ndarray
    contact: np.ndarray

    def at(self, laid: float) -> np.ndarray:
        """(M, 3) rod at a laid length [m]."""
        return shape_at(self.shapes, float(np.interp(laid, self.laid, np.arange(len(self.laid)))))


def shape_at(shapes: np.ndarray, node: float) -> np.ndarray:
    """Between two of shapes (n, ...), at a node that is no whole number."""
    low = min(int(node), len(shapes) - 2)
    share = node - low
    return (1 - share) * shapes[low] + share * shapes[low + 1]


def rods_of(trajectory, joint_path, pattern, points: int) -> tuple[np.ndarray, Onward | None]:
    """Shapes (T, points + n, 3) of the rod at the nodes [m], with as much of what hangs beyond the
    grip as stays off the table, and beyond the nodes where the joint path lays the tail."""
    share = 0.0
    if trajectory.beyond_grip:  # on the table the rest would push what lies
        share = longest_free(trajectory) / trajectory.beyond_grip
    if joint_path is not None and any(p["name"] == "tail" for p in joint_path.phases):
        # Shapes first: the solver knows the pattern's bends, and a tail's bends only by itself.
        known = pattern if hasattr(pattern, "sample") else None
        joined = with_tail(with_shapes(trajectory, known))
        if joined is not None:
            shapes, last = _to_its_end(joined, pattern, points, share), len(trajectory) - 1
            onward = Onward(joined.arc_length[last:], shapes[last:], joined.contact[last:])
            return shapes[: last + 1], onward
    return _to_its_end(trajectory, pattern, points, share), None


def _to_its_end(trajectory, pattern, points: int, share: float) -> np.ndarray:
    """(T, points + n, 3) rod at the nodes, with a share of what hangs beyond the grip [m]."""
    shapes = whole_rod(trajectory, pattern, points)
    hangs = Beyond.of(trajectory, share, len(trajectory))
    return shapes if hangs is None else np.concatenate([shapes, hangs.drawn[:, 1:]], axis=1)


def whole_rod(trajectory: Trajectory, pattern=None, points: int = POINTS) -> np.ndarray:
    """Points of the rod at each node, at the same places of the material throughout.

    The laid part follows the contact points; the suspended part is the trajectory's `shape`.
    Without one (a controller computes none), the rod solver is asked for the same grasps; theirs
    is the shape where the grips agree. A grip that is as far from the contact as the rod is long
    (the intuitive one) leaves the rod nothing but the straight line. Where neither holds, the
    shape is not known: the curve stops at the contact.

    Args:
        trajectory: grip poses, with `shape` (T, nodes, 3) where the planner computed it [m].
        pattern: `Pattern` of the trajectory, whose curvature is better than that of its nodes.
        points: of the centreline.

    Returns:
        (T, points, 3) [m], from the free end to the grip.
    """
    laid = np.asarray(trajectory.arc_length) - trajectory.arc_length[0]
    table = CubicSpline(laid, trajectory.contact)
    shape = trajectory.shape
    if shape is None:
        shape = _straight(trajectory, laid)
    if shape is None:
        shape = with_shapes(trajectory, pattern if hasattr(pattern, "sample") else None).shape
    rods = np.empty((len(laid), points, 3))
    if shape is None:
        for k, end in enumerate(laid):
            rods[k] = table(np.linspace(0.0, end, points))
        return rods
    hanging = arc_length(shape)
    total = float(np.median(laid + hanging[:, -1]))
    material = np.linspace(0.0, total, points)
    for k, end in enumerate(laid):
        below = material <= end
        rods[k, below] = table(material[below])
        share = (material[~below] - end) / (total - end)
        rods[k, ~below] = CubicSpline(hanging[k], shape[k])(share * hanging[k, -1])
    return rods


def _straight(trajectory: Trajectory, laid: np.ndarray) -> np.ndarray | None:
    """Straight suspended parts (T, 2, 3) where the rod is taut within 1 %, else None."""
    rod = trajectory.metadata.get("rod")
    if not isinstance(rod, dict) or "length" not in rod:
        return None
    distance = np.linalg.norm(trajectory.position - trajectory.contact, axis=1)
    if np.abs(distance - (rod["length"] - laid)).max() > 0.01 * rod["length"]:
        return None
    return np.stack([trajectory.contact, trajectory.position], axis=1)


def covered(trajectory, rest: np.ndarray | None) -> np.ndarray:
    """(n, 3) points of the table on which the rod comes to lie [m], of the pattern and of the rod
    at `rest` (M, 3), let go of; None: it is held to the end."""
    if rest is None:
        return trajectory.contact
    height = np.full(len(rest), trajectory.contact[-1, 2])
    return np.concatenate([trajectory.contact, np.column_stack([rest[:, :2], height])])


def falling(trajectory) -> Falls:
    """How the rod of a trajectory falls when it is let go: (M, 3) as it is held [m], times (K,)
    since then [s] -> (K, M, 3). It is simulated, on the table that the plan was laid on, once: what
    it is asked for later is the same rod, whatever points that has. It is drawn straight ahead
    where the trajectory does not say its rod, or the simulation does not end."""
    expected = trajectory.expected or {}
    friction = float(np.mean(expected.get("friction", _FRICTION)))
    rod = trajectory.rod
    simulated = []

    def falls(shape: np.ndarray, time: np.ndarray) -> np.ndarray:
        from wrod.deployment.left_alone import Fall

        if rod is not None and not simulated:
            simulated.append(Fall.of(rod, shape, _FALLING[-1], friction))
        found = simulated[0] if simulated else None
        if found is None:
            return np.stack([let_go(shape, at / _FALL) for at in time])
        return found.at(shape, time)

    return falls


def film(joint_path, shapes: np.ndarray, onward: Onward | None, falls: Falls) -> Film:
    """What a joint path and a rod at the nodes (T, M, 3) [m], and beyond them, show.

    The rod hangs as the first node has it until it is grasped. What is suspended when the fingers
    open, with the tail laid what they held, `falls` onto the table.
    """
    count = len(shapes)
    nodes = np.arange(count)
    if joint_path is None:
        return Film(nodes.astype(float), None, None, nodes, None, shapes)
    at = joint_path.node_time
    step = (at[-1] - at[0]) / max(count - 1, 1)
    end = joint_path.time[-1]
    before, after = (min(MOST, round(span / step)) for span in (at[0], end - at[-1]))
    time = np.concatenate(
        [
            np.linspace(0.0, at[0], before, endpoint=False),
            at,
            np.linspace(end, at[-1], after, endpoint=False)[::-1],
        ]
    )
    code = np.arange(-before, count + after)
    played = [np.interp(time, joint_path.time, q) for q in joint_path.positions.T]
    positions = np.column_stack(played)
    positions[before : before + count] = joint_path.node_positions
    node = np.clip(code, 0, count - 1)
    shown = shapes[node]
    opened, last = opening(joint_path), shapes[-1]
    if onward is not None:
        laid = np.interp(time, joint_path.time, joint_path.arc_length)
        for k in np.flatnonzero(time > at[-1]):
            shown[k] = onward.at(laid[k])
        last = onward.at(joint_path.arc_length[-1])
    let = time > opened
    if let.any():
        shown[let] = falls(last, time[let] - opened)
    phase = [joint_path.phase_at(t) for t in time]
    return Film(code.astype(float), time, phase, node, positions, shown)


def opening(joint_path) -> float:
    """When the fingers let go [s]; never, where the path ends with the laying."""
    for phase in joint_path.phases:
        if phase["name"] == "release":
            return phase["start"] + _OPEN * (phase["end"] - phase["start"])
    return float("inf")


def with_release(
    joint_path, shapes: np.ndarray, time: np.ndarray, onward: Onward | None, falls: Falls
) -> tuple[np.ndarray, np.ndarray]:
    """Shapes (T + n, M, 3) [m] and their times [s] with those of the tail that is laid and of the
    rod that is let go and `falls`."""
    parts, times = [shapes], [time]
    if onward is not None:
        (phase,) = [phase for phase in joint_path.phases if phase["name"] == "tail"]
        rates = np.linspace(phase["start"], phase["end"], len(onward.laid) + 1)[1:]
        laid = np.interp(rates, joint_path.time, joint_path.arc_length)
        parts.append(np.stack([onward.at(length) for length in laid]))
        times.append(rates)
    opened = opening(joint_path)
    if np.isfinite(opened):
        parts.append(falls(parts[-1][-1], _FALLING))
        times.append(opened + _FALLING)
    return np.concatenate(parts), np.concatenate(times)


def let_go(shape: np.ndarray, share: float) -> np.ndarray:
    """(M, 3) rod whose suspended part has fallen a share of the way to lie straight ahead [m]."""
    rise = np.flatnonzero(shape[:, 2] > shape[:, 2].min() + _LIES)
    if len(rise) == 0 or rise[0] == 0 or share <= 0.0:
        return shape.copy()
    share = min(share, 1.0)
    first = int(rise[0]) - 1  # the last point that lies
    steps = np.diff(shape[first:], axis=0)
    lengths = np.linalg.norm(steps, axis=1, keepdims=True)
    along = shape[first] - shape[first - 1] if first > 0 else steps[0]
    ahead = along * [1.0, 1.0, 0.0]
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-12)
    pieces = turned(ahead, steps / np.maximum(lengths, 1e-12), 1 - share)
    fallen = shape.copy()
    fallen[first + 1 :] = shape[first] + np.cumsum(lengths * pieces, axis=0)
    return fallen
