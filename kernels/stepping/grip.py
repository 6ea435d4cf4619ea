"""A grip that carries the end of a rod along a path, and a free end that is held for a while."""

from typing import Any

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, TWO, angle_towards, put_node

THREE = wp.constant(wp.float64(3.0))


@wp.func
def spline(p0: Any, p1: Any, p2: Any, p3: Any, x: wp.float64):
    """Catmull-Rom spline between keys p1 and p2: continuous velocity."""
    x2 = x * x
    x3 = x2 * x
    return (
        (TWO * x3 - THREE * x2 + ONE) * p1
        + (x3 - TWO * x2 + x) * HALF * (p2 - p0)
        + (THREE * x2 - TWO * x3) * p2
        + (x3 - x2) * HALF * (p3 - p1)
    )


@wp.func
def key_position(keys: wp.array2d(dtype=wp.vec3d), r: int, k: int, x: wp.float64) -> wp.vec3d:
    last = keys.shape[1] - 1
    return spline(
        keys[r, wp.max(k - 1, 0)],
        keys[r, k],
        keys[r, wp.min(k + 1, last)],
        keys[r, wp.min(k + 2, last)],
        x,
    )


@wp.kernel
def prescribe(
    # Model:
    interval: wp.float64,
    e: int,
    position: wp.array2d(dtype=wp.vec3d),
    rotation: wp.array2d(dtype=wp.quatd),
    rest_length: wp.array2d(dtype=wp.float64),
    held_nodes: wp.array(dtype=wp.int32),
    release_time: wp.array(dtype=wp.float64),
    let_go_time: wp.array(dtype=wp.float64),
    # State in:
    running: wp.array(dtype=wp.int32),
    time: wp.array(dtype=wp.float64),
    step: wp.array(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    tangent_before: wp.array2d(dtype=wp.vec3d),
    director_before: wp.array2d(dtype=wp.vec3d),
    # State out:
    free_out: wp.array2d(dtype=wp.int32),
    dof_out: wp.array2d(dtype=wp.float64),
):
    """Hold the first nodes until `release_time` and carry the edge `e` until `let_go_time`.

    It begins in the grip, where the rod or what is laid of it ends, and lies along the grip's x
    axis, its first material director along the y axis.
    """
    r = wp.tid()
    if running[r] == 0:
        return
    now = time[r] + step[r]
    held = wp.where(now <= release_time[r], 1, 0)
    # The edges between held nodes are clamped; the one after them turns.
    for a in range(4 * held_nodes[r] - 1):
        free_out[r, a] = 1 - held
    carried = wp.where(now <= let_go_time[r], 1, 0)
    for a in range(4 * e, 4 * e + 7):
        free_out[r, a] = 1 - carried
    if carried == 0:
        return
    at = wp.clamp(now / interval, wp.float64(0.0), wp.float64(position.shape[1] - 1))
    k = wp.min(int(wp.floor(at)), position.shape[1] - 2)
    x = at - wp.float64(k)
    turn = wp.quat_slerp(rotation[r, k], rotation[r, k + 1], x)
    tangent = wp.quat_rotate(turn, wp.vec3d(ONE, wp.float64(0.0), wp.float64(0.0)))
    side = wp.quat_rotate(turn, wp.vec3d(wp.float64(0.0), ONE, wp.float64(0.0)))
    end = key_position(position, r, k, x)
    dof_out[r, 4 * e + 3] = angle_towards(
        side, tangent, dof_before[r, 4 * e + 3], tangent_before[r, e], director_before[r, e]
    )
    put_node(dof_out, r, e, end)
    put_node(dof_out, r, e + 1, end + rest_length[r, e] * tangent)
