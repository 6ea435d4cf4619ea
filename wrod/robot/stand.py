"""What holds the rod until the hand does: a post on the table, with a clip below the grip.

The clip opens to the side away from its post, as a fork does.
"""

import numpy as np

from wrod.patterns.curve import arc_length
from wrod.planning.trajectory import Trajectory
from wrod.robot.arm import gap_between

_BELOW = 0.09  # [m] along the rod, from its end to the clip: the hand has the rest
_ASIDE = 0.12  # [m] from the rod to the post
_POST, _CLIP = 0.008, 0.004  # [m] radii
_BEARINGS = 12
# Of the laying from the stand [m]: of the rod's surface, of the arm; and the fork's open end, where
# the rod was.
_ROD_ROOM, _ROOM, _FORK = 0.003, 0.01, 0.02


def stands(trajectory: Trajectory, capsules) -> list[list]:
    """Posts that leave the hand room, the freest first: each a list of capsules [start (3,), end
    (3,), radius] in the table's frame [m], the post and then its clip.

    Args:
        trajectory: at whose first pose the rod waits; none without its shapes.
        capsules: of the arm at that pose, (C, 3) starts and ends and (C,) radii there.
    """
    if trajectory.shape is None or not np.isfinite(trajectory.shape[0]).all():
        return []
    shape = trajectory.shape[0][::-1]
    arc = arc_length(shape)
    below = min(_BELOW, 0.5 * arc[-1])
    held = np.array([np.interp(below, arc, axis) for axis in shape.T])
    start, end, radius = capsules
    share = np.linspace(0.0, 1.0, 9)[:, None, None]
    links = (start + share * (end - start)).reshape(-1, 3)
    room = np.tile(radius, len(share))
    found = []
    for bearing in 2.0 * np.pi * np.arange(_BEARINGS) / _BEARINGS:
        top = held + _ASIDE * np.array([np.cos(bearing), np.sin(bearing), 0.0])
        foot = top * [1.0, 1.0, 0.0]
        level = np.clip(links[:, 2], 0.0, top[2])
        post = np.column_stack([np.tile(top[:2], (len(level), 1)), level])
        free = float((np.linalg.norm(links - post, axis=1) - room).min())
        found.append(
            (free, [[foot.tolist(), top.tolist(), _POST], [top.tolist(), held.tolist(), _CLIP]])
        )
    return [parts for _, parts in sorted(found, key=lambda item: -item[0])]


def stays(stand: list, arm, trajectory: Trajectory, rod_radius: float) -> bool:
    """Whether a stand is out of the way of arm and rod until the hand opens.

    Args:
        stand: capsules as `stands` gives them.
        arm: its capsules all the while, (K, C, 3) starts and ends, (C,) radii, at the table.
        trajectory: as far as the rod is laid, with its shapes.
        rod_radius: [m].
    """
    start, end, radius = (np.array(part) for part in zip(*stand, strict=True))
    if gap_between(arm, (start[None], end[None], radius)).min() < _ROOM:
        return False
    ahead = (end[1] - start[1]) / np.linalg.norm(end[1] - start[1])
    end[1] -= _FORK * ahead
    points = np.concatenate([trajectory.shape.reshape(-1, 3), trajectory.contact])
    for a, b, thick in zip(start, end, radius, strict=True):
        share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        away = np.linalg.norm(points - a - share[:, None] * (b - a), axis=1)
        if away.min() < thick + rod_radius + _ROD_ROOM:
            return False
    return True
