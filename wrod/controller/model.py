"""The neural controller's formula, once for NumPy and torch: `xp` is either module.

A chain hangs from a learnt boundary layer: the network gives the forces F_y, F_z at the contact,
and F_x where the closure leaves a thrust, the closed form of the elastic catenary carries them up
to the grip, and the network adds what bending changes, which no longer grows with the length. Even
outputs see kappa squared only and odd ones carry a factor kappa, so right turns mirror left turns
exactly. The rotation is a normalised quaternion, so it is one. Everything is dimensionless.
"""

import math

WEIGHT = 0.5
# x, y and z beyond the catenary; F_y, F_z; quaternion (w, x, y, z); F_x, if there is one, where it
# vanishes with kappa squared; and F_x that is there on a straight pattern too.
OUTPUTS, WITH_THRUST, WITH_PULL = 9, 10, 11
FEATURES = 8
_LONGEST, _SOFTEST = 50.0, 150.0
_THREADED, _TRAJECTORY = 2**18, 4096
# Bending rounds the catenary's kink where the rod's weight balances F_z; any value near 1 will do.
_ROUNDING = 1.0


def features(xp, inputs):
    """(n, FEATURES) what the network sees of (n, 3) inputs; even in kappa."""
    ls, kappa, ks = inputs[:, 0], inputs[:, 1], inputs[:, 2]
    bend = kappa * kappa
    return xp.stack(
        [
            2.0 * xp.log(ls) / math.log(_LONGEST) - 1.0,
            2.0 / ls - 1.0,
            2.0 * xp.exp(-0.25 * ls) - 1.0,
            xp.sqrt(bend + 0.25) - 1.7,
            2.0 / (1.0 + bend) - 1.0,
            2.0 * _SOFTEST / ks - 1.0,
            xp.log(ks / 1500.0) / math.log(10.0),
            0.5 * ls / xp.sqrt(ks) - 0.5,
        ],
        -1,
    )


def end_of_chain(xp, inputs, force):
    """(x, y, z) end of an elastic chain that carries -F at its start and its weight above, of
    inputs (n, 3) and forces (n, 3).

    Its slope is (-F_x, -F_y, w s - F_z), rounded by bending, over T, stretched by T / k_s.
    """
    ls, ks = inputs[:, 0], inputs[:, 2]
    force_x, force_y, force_z = force[:, 0], force[:, 1], force[:, 2]
    pull = xp.sqrt(force_x * force_x + force_y * force_y + _ROUNDING**2)
    top = WEIGHT * ls - force_z
    angle = xp.asinh(top / pull) + xp.asinh(force_z / pull)
    rise = xp.sqrt(top * top + pull * pull) - xp.sqrt(force_z * force_z + pull * pull)
    reach = angle / WEIGHT + ls / ks
    return -force_x * reach, -force_y * reach, rise / WEIGHT + 0.5 * ls * (top - force_z) / ks


def decode(xp, inputs, raw):
    """Outputs (position (n, 3), quaternion (n, 4), force (n, 3)) of `raw` (n, OUTPUTS), (n,
    WITH_THRUST) or (n, WITH_PULL)."""
    kappa = inputs[:, 1]
    odd = kappa / xp.sqrt(1.0 + kappa**2)
    thrust = kappa * odd * raw[:, OUTPUTS] if raw.shape[1] >= WITH_THRUST else 0.0 * kappa
    if raw.shape[1] == WITH_PULL:
        thrust = thrust + raw[:, WITH_THRUST]
    force = xp.stack([thrust, kappa * raw[:, 3], raw[:, 4]], -1)
    x, y, z = end_of_chain(xp, inputs, force)
    position = xp.stack([x + raw[:, 0], y + odd * raw[:, 1], z + raw[:, 2]], -1)
    quaternion = xp.stack([raw[:, 5], odd * raw[:, 6], raw[:, 7], odd * raw[:, 8]], -1)
    quaternion = quaternion / xp.sqrt(xp.sum(quaternion * quaternion, -1))[:, None]
    return position, quaternion, force


def encode(xp, inputs, position, quaternion, force, columns=OUTPUTS):
    """The raw outputs (n, columns) that `decode` turns into these grasps; kappa must not be
    zero."""
    kappa = inputs[:, 1]
    odd = kappa / xp.sqrt(1.0 + kappa**2)
    x, y, z = end_of_chain(xp, inputs, force)
    # Of both parts of a pull no more is known than their sum.
    pull = force[:, 0] / (1.0 + kappa * odd)
    thrust = pull if columns == WITH_PULL else force[:, 0] / (kappa * odd)
    raw = [
        position[:, 0] - x,
        (position[:, 1] - y) / odd,
        position[:, 2] - z,
        force[:, 1] / kappa,
        force[:, 2],
        quaternion[:, 0],
        quaternion[:, 1] / odd,
        quaternion[:, 2],
        quaternion[:, 3] / odd,
        thrust,
        pull,
    ]
    return xp.stack(raw[:columns], -1)


def rotation_vector(xp, quaternion):
    """(n, 3) rotation vectors [rad] of (n, 4) unit quaternions (w, x, y, z) with w > 0."""
    vector = quaternion[:, 1:]
    # The offset is far below rounding of any rotation but zero.
    sine = xp.sqrt(xp.sum(vector * vector, -1) + 1e-30)
    return (2.0 * xp.atan2(sine, quaternion[:, 0]) / sine)[:, None] * vector


def _product(xp, left, right):
    """left @ right, for a trajectory's worth of rows without the threads of NumPy's BLAS.

    It starts them above 2^18 products and waits for the last, which on a busy machine takes a
    hundred times as long as the product itself.
    """
    rows = max(1, _THREADED // math.prod(right.shape)) if xp.__name__ == "numpy" else len(left)
    if rows >= len(left) or len(left) > _TRAJECTORY:
        return left @ right
    return xp.concatenate([left[i : i + rows] @ right for i in range(0, len(left), rows)])


def layers(xp, parameters, hidden, activation):
    """Hidden layers with their activation, and the last without."""
    count = sum(name.startswith("weight.") for name in parameters)
    for layer in range(count):
        hidden = _product(xp, hidden, parameters[f"weight.{layer}"].T) + parameters[f"bias.{layer}"]
        if layer < count - 1:
            hidden = activation(hidden)
    return hidden


def chain(xp, parameters, inputs):
    """The default network: tanh layers, then `decode`."""
    hidden = layers(xp, parameters, features(xp, inputs), xp.tanh)
    raw = parameters["mean"] + parameters["scale"] * hidden
    position, quaternion, force = decode(xp, inputs, raw)
    return position, rotation_vector(xp, quaternion), force, None


def paper(xp, parameters, inputs):
    """The paper's network: standardised inputs, ReLU, position and rotation vector; no force.

    It is trained on left turns; right turns are their mirror images.
    """
    side = xp.where(inputs[:, 1] < 0.0, -1.0, 1.0)
    left = xp.stack([inputs[:, 0], side * inputs[:, 1], inputs[:, 2]], -1)
    hidden = (left - parameters["mean"]) / parameters["scale"]
    out = layers(xp, parameters, hidden, lambda value: value * (value > 0.0))
    rotation = xp.stack([side * out[:, 3], out[:, 4], side * out[:, 5]], -1)
    return xp.stack([out[:, 0], side * out[:, 1], out[:, 2]], -1), rotation, None, None
