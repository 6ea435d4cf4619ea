"""Hands that hold single edges of rods and carry them."""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, ZERO, angle_towards

wp.set_module_options({"enable_backward": False})


@wp.kernel
def carry(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    edge: wp.array2d(dtype=wp.int32),
    times: wp.array(dtype=wp.float64),
    first_position: wp.array2d(dtype=wp.vec3d),
    last_position: wp.array2d(dtype=wp.vec3d),
    first_rotation: wp.array2d(dtype=wp.quatd),
    last_rotation: wp.array2d(dtype=wp.quatd),
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
    """Put every held edge where its hand is at the end of the step: its middle at the position, its
    tangent along the hand's x axis, its first material director along the y axis."""
    r, h = wp.tid()
    e = edge[r, h]
    if running[r] == 0 or e < 0:
        return
    now = time[r] + step[r]
    x = wp.clamp((now - times[0]) / (times[1] - times[0]), ZERO, ONE)
    middle = wp.lerp(first_position[r, h], last_position[r, h], x)
    turn = wp.quat_slerp(first_rotation[r, h], last_rotation[r, h], x)
    tangent = wp.quat_rotate(turn, wp.vec3d(ONE, ZERO, ZERO))
    side = wp.quat_rotate(turn, wp.vec3d(ZERO, ONE, ZERO))
    reach = (HALF * rest_length[r, e]) * tangent
    dof_out[r, 4 * e + 3] = angle_towards(
        side, tangent, dof_before[r, 4 * e + 3], tangent_before[r, e], director_before[r, e]
    )
    for c in range(3):
        dof_out[r, 4 * e + c] = middle[c] - reach[c]
        dof_out[r, 4 * e + 4 + c] = middle[c] + reach[c]
