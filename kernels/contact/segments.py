"""Closest points of two segments, smooth also where they are parallel.

Between p = q_0 + s (q_1 - q_0) and p' = q_2 + t (q_3 - q_2) the distance is taken as D = sqrt(m),

    m = min over s, t in [0, 1] of |p - p'|^2 + rho (s - 1/2)^2 + rho' (t - 1/2)^2.

The small terms rho make the minimum unique, so that s and t move continuously and D has a
continuous gradient while one segment turns past parallel to the other; plain closest points jump
from end to end there. By the envelope theorem the gradient of m is that of |p - p'|^2 at fixed s
and t. With rho = 0.01 h^2 (edges of length h) D is up to h^2 / (400 D) too large.
"""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO

wp.set_module_options({"enable_backward": False})

SMOOTHING = wp.constant(wp.float64(0.01))


@wp.struct
class Nearest:
    """Closest points: fractions s, t, which of them are free (1) or at an end (0), the vector
    `gap` from the second point to the first, the smoothed distance, and the edges."""

    s: wp.float64
    t: wp.float64
    free_s: wp.float64
    free_t: wp.float64
    gap: wp.vec3d
    distance: wp.float64
    first: wp.vec3d
    second: wp.vec3d


@wp.func
def nearest(
    q0: wp.vec3d,
    q1: wp.vec3d,
    q2: wp.vec3d,
    q3: wp.vec3d,
    rho_first: wp.float64,
    rho_second: wp.float64,
) -> Nearest:
    out = Nearest()
    e = q1 - q0
    f = q3 - q2
    c = q0 - q2
    ee = wp.dot(e, e) + rho_first
    ef = wp.dot(e, f)
    ff = wp.dot(f, f) + rho_second
    u = HALF * rho_first - wp.dot(c, e)
    v = HALF * rho_second + wp.dot(c, f)
    det = ee * ff - ef * ef
    s = (u * ff + v * ef) / det
    t = (v * ee + u * ef) / det
    if s <= ZERO or s >= ONE or t <= ZERO or t >= ONE:
        # The minimum of a convex function over the square is on its border: the best of four sides.
        best = wp.float64(1.0e300)
        for side in range(4):
            x = wp.float64(side % 2)
            y = wp.clamp((v + x * ef) / ff, ZERO, ONE)
            if side >= 2:
                y = x
                x = wp.clamp((u + y * ef) / ee, ZERO, ONE)
            value = ee * x * x - TWO * ef * x * y + ff * y * y - TWO * (u * x + v * y)
            if value < best:
                best = value
                s = x
                t = y
    out.s = s
    out.t = t
    out.free_s = wp.where(s > ZERO and s < ONE, ONE, ZERO)
    out.free_t = wp.where(t > ZERO and t < ONE, ONE, ZERO)
    out.gap = c + s * e - t * f
    a = s - HALF
    b = t - HALF
    out.distance = wp.sqrt(wp.dot(out.gap, out.gap) + rho_first * a * a + rho_second * b * b)
    out.first = e
    out.second = f
    return out
