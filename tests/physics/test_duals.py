"""Newton's method over the kink of Coulomb's law, on springs that one bristle holds."""

import numpy as np
import warp as wp
from wrod.kernels.contact.duals import bristle_stiffness, next_dual

COUNT, MOST = 400, 30
STIFFNESS, LIMIT = 1.0e4, 1.0e-4


@wp.kernel
def balance(
    by_direction: int,
    spring: wp.array(dtype=wp.mat22d),
    load: wp.array(dtype=wp.vec2d),
    stretch: wp.array(dtype=wp.vec3d),
    residual: wp.array2d(dtype=wp.float64),
):
    """Newton's iterations of spring b + friction(b) = load; `by_direction` leaves duals out."""
    n = wp.tid()
    b = stretch[n]
    w = wp.vec3d()
    before = wp.vec3d()
    normal = wp.vec3d(wp.float64(0.0), wp.float64(0.0), wp.float64(1.0))
    none = wp.vec3d()
    limit = wp.float64(LIMIT)
    k = wp.float64(STIFFNESS)
    for turn in range(MOST):
        w = wp.where(by_direction != 0, next_dual(none, none, b, limit), w)
        if by_direction == 0 and turn > 0:
            w = next_dual(w, before, b, limit)
        pull = (k * limit / wp.max(wp.length(b), limit)) * b
        flat = wp.vec2d(b[0], b[1])
        left = spring[n] * flat + wp.vec2d(pull[0], pull[1]) - load[n]
        residual[n, turn] = wp.length(left)
        m = bristle_stiffness(b, w, normal, k, limit)
        change = wp.inverse(spring[n] + wp.mat22d(m[0, 0], m[0, 1], m[1, 0], m[1, 1])) * left
        before = b
        b = b - wp.vec3d(change[0], change[1], wp.float64(0.0))
    stretch[n] = b


def residuals(by_direction: bool) -> np.ndarray:
    """(problem, iteration) over the friction's bound."""
    rng = np.random.default_rng(7)
    turn = np.linalg.qr(rng.normal(size=(COUNT, 2, 2)))[0]
    soft = STIFFNESS * 10.0 ** rng.uniform(-5, 0, (COUNT, 2))
    spring = np.einsum("nij,nj,nkj->nik", turn, soft, turn)
    # Some hold in the end, others slide.
    load = STIFFNESS * LIMIT * rng.uniform(-2, 2, (COUNT, 2))
    start = np.pad(LIMIT * rng.normal(size=(COUNT, 2)) * 30.0, ((0, 0), (0, 1)))
    out = wp.zeros((COUNT, MOST), dtype=wp.float64, device="cpu")
    arrays = [
        wp.array(spring, dtype=wp.mat22d, device="cpu"),
        wp.array(load, dtype=wp.vec2d, device="cpu"),
        wp.array(start, dtype=wp.vec3d, device="cpu"),
    ]
    wp.launch(balance, COUNT, [int(by_direction), *arrays, out], device="cpu")
    return out.numpy() / (STIFFNESS * LIMIT)


def test_duals_settle_what_directions_throw_to_and_fro():
    """The potential is strongly convex: what has no residual is at its only minimum."""
    assert ((residuals(False) > 1e-9).sum(axis=1) <= 10).all()
    assert (residuals(True)[:, -1] > 1e-9).mean() > 0.4
