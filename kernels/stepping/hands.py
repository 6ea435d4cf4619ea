"""Hands that hold single edges of rods and carry them."""

import warp as wp
from wrod.kernels.elastic.frames import ONE, ZERO, angle_towards

wp.set_module_options({"enable_backward": False})


@wp.kernel
def carry(
    # Model: (rod, hand) and keys (rod, hand, key); the hand's point is at this part of its edge
    rest_length: wp.array2d(dtype=wp.float64),
    edge: wp.array2d(dtype=wp.int32),
    part: wp.array2d(dtype=wp.float64),
    times: wp.array(dtype=wp.float64),
    position: wp.array3d(dtype=wp.vec3d),
    rotation: wp.array3d(dtype=wp.quatd),
    free: wp.array2d(dtype=wp.int32),
    # State in:
    running: wp.array(dtype=wp.int32),
    time: wp.array(dtype=wp.float64),
    step: wp.array(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    tangent_before: wp.array2d(dtype=wp.vec3d),
    director_before: wp.array2d(dtype=wp.vec3d),
    # State out:
    dof_out: wp.array2d(dtype=wp.float64),
):
    """Put every held edge where its hand is at the end of the step: its point at the position, its
    tangent along the hand's x axis, its first material director along the y axis. What is free of
    it stays as it is."""
    r, h = wp.tid()
    e = edge[r, h]
    if running[r] == 0 or e < 0:
        return
    now = time[r] + step[r]
    k = int(0)
    while k < times.shape[0] - 2 and times[k + 1] < now:
        k += 1
    x = wp.clamp((now - times[k]) / (times[k + 1] - times[k]), ZERO, ONE)
    point = wp.lerp(position[r, h, k], position[r, h, k + 1], x)
    turn = wp.quat_slerp(rotation[r, h, k], rotation[r, h, k + 1], x)
    tangent = wp.quat_rotate(turn, wp.vec3d(ONE, ZERO, ZERO))
    side = wp.quat_rotate(turn, wp.vec3d(ZERO, ONE, ZERO))
    along = rest_length[r, e] * tangent
    head = point - part[r, h] * along
    tail = point + (ONE - part[r, h]) * along
    a = 4 * e
    if free[r, a + 3] == 0:
        dof_out[r, a + 3] = angle_towards(
            side, tangent, dof_before[r, a + 3], tangent_before[r, e], director_before[r, e]
        )
    for c in range(3):
        if free[r, a + c] == 0:
            dof_out[r, a + c] = head[c]
        if free[r, a + 4 + c] == 0:
            dof_out[r, a + 4 + c] = tail[c]
