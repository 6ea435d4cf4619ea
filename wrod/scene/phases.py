"""The whole job over time codes: what comes before and after the nodes of a trajectory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MOST = 120  # time codes before the first node, and after the last
_FALL = 0.3  # [s] in which a rod that is let go comes to lie
_OPEN = 0.5  # share of the release after which the fingers are open
_LIES = 1e-4  # [m] above the end of the laid part, what is lower lies


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


def film(joint_path, shapes: np.ndarray) -> Film:
    """What a joint path and a rod at the nodes (T, M, 3) [m] show.

    The rod hangs as the first node has it until it is grasped. What is suspended when the fingers
    open falls straight ahead onto the table: drawn so, not simulated.
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
    opened = opening(joint_path)
    for k in np.flatnonzero(time > opened):
        shown[k] = let_go(shapes[-1], (time[k] - opened) / _FALL)
    phase = [joint_path.phase_at(t) for t in time]
    return Film(code.astype(float), time, phase, node, positions, shown)


def opening(joint_path) -> float:
    """When the fingers let go [s]; never, where the path ends with the laying."""
    for phase in joint_path.phases:
        if phase["name"] == "release":
            return phase["start"] + _OPEN * (phase["end"] - phase["start"])
    return float("inf")


def with_release(joint_path, shapes: np.ndarray, time: np.ndarray):
    """Shapes (T + n, M, 3) [m] and their times [s] with those of the rod that is let go."""
    opened = opening(joint_path)
    if not np.isfinite(opened):
        return shapes, time
    shares = np.linspace(0.0, 1.0, 8)
    fallen = np.stack([let_go(shapes[-1], share) for share in shares])
    return np.concatenate([shapes, fallen]), np.concatenate([time, opened + _FALL * shares])


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
    # Turned by a share of the angle, each piece in the plane of its own direction and ahead.
    pieces = steps / np.maximum(lengths, 1e-12)
    angle = np.arccos(np.clip(pieces @ ahead, -1.0, 1.0))[:, None]
    aside = pieces - (pieces @ ahead)[:, None] * ahead
    aside = aside / np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)
    turned = np.cos((1 - share) * angle) * ahead + np.sin((1 - share) * angle) * aside
    fallen = shape.copy()
    fallen[first + 1 :] = shape[first] + np.cumsum(lengths * turned, axis=0)
    return fallen
