"""What holds the rod until the hand does: a post on the table, with a clip below the grip."""

from __future__ import annotations

import numpy as np

from wrod.planning.trajectory import Trajectory

_BELOW = 0.09  # [m] along the rod, from its end to the clip: the hand has the rest
_ASIDE = 0.12  # [m] from the rod to the post
_POST, _CLIP = 0.008, 0.004  # [m] radii
_BEARINGS = 12


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
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(shape, axis=0), axis=1)))
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
