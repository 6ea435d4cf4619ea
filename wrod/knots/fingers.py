"""What the two fingers of a gripper hold of a rod that they close on."""

import numpy as np

# Least force of a Robotiq 2F-85 (20 to 235 N, its manual): soft rods are not gripped harder [N].
GRIP_FORCE = 20.0
# Friction of fingertips on what they hold: 0.3 is the least that Robotiq's manual of the Hand-E
# reckons with (silicone pads, oily steel), 1 is rubber on rubber; their geometric mean.
PAD_FRICTION = 0.55
# A hand finds a rod whose centreline is this near [m].
REACH = 0.012


def holding_force(
    radius: np.ndarray | float,
    height: np.ndarray | float,
    tip: np.ndarray | float,
    friction: np.ndarray | float = PAD_FRICTION,
) -> np.ndarray:
    """Force that takes a round rod out of two flat, upright pads that press with `GRIP_FORCE` [N].

    Pads that reach below the rod's axis press on its sides, and friction holds 2 mu F. Pads that
    end above it touch it with their lower edges, where its surface leans by alpha, sin(alpha) =
    (tip - height) / radius, and squeeze it out downwards unless friction holds against that: what
    is left is 2 F (mu cos(alpha) - sin(alpha)), nothing from tan(alpha) = mu on.

    Args:
        radius: of the rod [m].
        height: of its axis over the table [m].
        tip: height of the pads' lower ends [m].
        friction: coefficient of the pads on the rod.
    """
    lean = np.clip((np.asarray(tip, dtype=float) - height) / radius, 0.0, 1.0)
    return np.maximum(2.0 * GRIP_FORCE * (friction * np.sqrt(1.0 - lean**2) - lean), 0.0)
