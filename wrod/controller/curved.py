"""The formula of a controller for one naturally curved rod, for NumPy and torch (`xp`).

Such a rod hangs as a straight one does, but for its twist: right turns are no mirror images of
left ones, and the roll of the grip winds with the length. The network knows the rotation without
the twist, and the twist beside it. The rod's own curvature moves the grip around in a small circle
as it winds: position and rotation are a slow part and two more, by the cosine and the sine of the
twist. The chain of `wrod.controller.model` carries the forces up. Everything is dimensionless.
"""

import math

from wrod.controller.model import end_of_chain, layers, rotation_vector

FEATURES = 7
# Slow parts: x, y, z beyond the chain; F_x, F_y over kappa, F_z; quaternion; twist; rest of F_y.
SLOW, _WINDING = 12, 7
OUTPUTS = SLOW + 2 * _WINDING
_TINY = 1e-12


def features(xp, inputs):
    """(n, FEATURES) what the network sees of (n, 3) inputs, before they are standardised."""
    ls, kappa = inputs[:, 0], inputs[:, 1]
    bend = 1.0 + kappa * kappa
    return xp.stack(
        [
            xp.log(ls), 1.0 / ls, xp.exp(-0.25 * ls), ls, kappa, kappa / xp.sqrt(bend), 1.0 / bend
        ],
        -1,
    )  # fmt: skip


def decode(xp, inputs, raw):
    """(position (n, 3), untwisted quaternion (n, 4), force (n, 3), twist (n,)) of raw outputs."""
    kappa, twist = inputs[:, 1], raw[:, 10]
    winding = (
        xp.cos(twist)[:, None] * raw[:, SLOW : SLOW + _WINDING]
        + xp.sin(twist)[:, None] * raw[:, SLOW + _WINDING :]
    )
    force = xp.stack([raw[:, 3], kappa * raw[:, 4] + raw[:, 11], raw[:, 5]], -1)
    chain = xp.stack(end_of_chain(xp, inputs, force), -1)
    position = chain + raw[:, :3] + winding[:, :3]
    quaternion = raw[:, 6:10] + winding[:, 3:]
    quaternion = quaternion / xp.sqrt(xp.sum(quaternion * quaternion, -1))[:, None]
    return position, quaternion, force, twist


def encode(xp, inputs, position, quaternion, force, twist):
    """(n, SLOW) raw outputs that `decode` turns into these grasps; kappa must not be zero."""
    chain = end_of_chain(xp, inputs, force)
    columns = [position[:, i] - chain[i] for i in range(3)]
    columns += [force[:, 0], force[:, 1] / inputs[:, 1], force[:, 2]]
    columns += [quaternion[:, i] for i in range(4)]
    return xp.stack([*columns, twist, 0.0 * twist], -1)


def curved(xp, parameters, inputs):
    """Position, rotation vector without the twist, force and twist of (n, 3) inputs."""
    seen = (features(xp, inputs) - parameters["input_mean"]) / parameters["input_scale"]
    hidden = layers(xp, parameters, seen, xp.tanh)
    raw = parameters["mean"] + parameters["scale"] * hidden
    position, quaternion, force, twist = decode(xp, inputs, raw)
    return position, rotation_vector(xp, quaternion), force, twist


def twisted(xp, vector, twist):
    """Rotation vectors (n, 3), no longer than pi, of rotations (n, 3) after a turn by `twist` (n,)
    about x."""
    angle = xp.sqrt(xp.sum(vector * vector, -1) + _TINY**2)
    share = xp.sin(0.5 * angle) / angle
    x, y, z = (share * vector[:, i] for i in range(3))
    w, c, s = xp.cos(0.5 * angle), xp.cos(0.5 * twist), xp.sin(0.5 * twist)
    turned = xp.stack([c * w - s * x, c * x + s * w, c * y + s * z, c * z - s * y], -1)
    turned = xp.where((turned[:, :1] < 0.0), -turned, turned)
    return rotation_vector(xp, turned)


def untwisted(rotation, twist):
    """Rotation vectors (n, 3), without the turn by `twist` (n,) about x that comes first (NumPy).

    They are the shorter way round where that is less than half a turn, which it is for the gentle
    branch of grasps.
    """
    import numpy as np

    return twisted(np, rotation, np.remainder(-twist + math.pi, 2.0 * math.pi) - math.pi)
