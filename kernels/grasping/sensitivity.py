"""Derivatives of a grasp by its inputs, with the factorisation of its own system."""

import warp as wp
from wrod.kernels.elastic.frames import ONE, ZERO
from wrod.kernels.grasping.bordered import make_border
from wrod.kernels.grasping.closures import CONVERGED
from wrod.kernels.grasping.contact_edge import (
    first_direction,
    ghost_load,
    ghost_motion,
    half_turn,
    half_turn_rate,
)
from wrod.kernels.grasping.reading import rotation_rate
from wrod.kernels.grasping.scratch import Scratch
from wrod.kernels.grasping.straight_rod import WEIGHT, evaluate, gradient_rate, point
from wrod.kernels.linear.frontal import make_elimination

eliminate, recover, _ = make_elimination(3)
border = make_border(3)
vector5 = border.vector


@wp.kernel
def find_sensitivities(
    # Model:
    edges: int,
    rest: wp.array2d(dtype=wp.float64),
    rest_rate: wp.array2d(dtype=wp.float64),
    stretch_ratio: wp.array(dtype=wp.float64),
    # In:
    curvature: wp.array(dtype=wp.float64),
    shape: wp.array3d(dtype=wp.float64),
    rotation: wp.array2d(dtype=wp.float64),
    status: wp.array(dtype=wp.int32),
    scratch: Scratch,
    # Out:
    rates_out: wp.array2d(dtype=wp.float64),
):
    """Derivatives of position, rotation vector and force by (l_s, kappa, k_s), zero tension.

    An input acts on the free nodes through the gradient's own rate, and through ghost and first
    node, which turn with the curvature and with the length of the first edge.
    """
    r = wp.tid()
    slot = r % scratch.condensed.shape[0]
    if status[r] != CONVERGED:
        for i in range(27):
            rates_out[r, i] = ZERO
        return
    kappa = curvature[r]
    h0 = rest[r, 0]
    half = half_turn(kappa, h0)
    d = first_direction(half)
    length = wp.length(point(shape, r, 1))
    vector = wp.vec3d(rotation[r, 0], rotation[r, 1], rotation[r, 2])
    evaluate(rest, stretch_ratio[r], kappa, shape, r, slot, edges, scratch.stiffness, scratch.load)
    for j in range(3):
        along_length = wp.where(j == 0, ONE, ZERO)
        along_curvature = wp.where(j == 1, ONE, ZERO)
        along_ratio = wp.where(j == 2, ONE, ZERO)
        gradient_rate(
            rest, rest_rate, stretch_ratio[r], along_ratio, kappa, shape, r, slot, edges,
            along_length, scratch.load,
        )  # fmt: skip
        eliminate(scratch.stiffness, scratch.load, slot, edges, scratch.factor, scratch.condensed)
        h0_rate = along_length * rest_rate[r, 0]
        angle_rate = half_turn_rate(kappa, h0, along_curvature, h0_rate)
        ghost = ghost_motion(half, h0, angle_rate, h0_rate)
        turn = (angle_rate * length) * wp.vec3d(-d[1], d[0], ZERO)
        f = border.residual(scratch.condensed, slot, turn, ZERO)
        extra = ghost_load(scratch.stiffness, slot, ghost)
        for i in range(3):
            f[i] = f[i] + extra[i]
        thrust = vector5(ZERO, ZERO, ZERO, ZERO, ONE)
        v = border.solve(border.matrix(scratch.condensed, slot, d, thrust), -f)
        node_1 = turn + v[0] * d
        grip = wp.vec3d(v[1], v[2], v[3])
        border.put_motion(scratch.motion, slot, edges, node_1, v)
        recover(scratch.factor, slot, edges, ONE, scratch.motion)
        force = wp.vec3d(ZERO, ZERO, along_length * WEIGHT)
        force -= border.grip_gradient(scratch.condensed, slot)
        force -= border.grip_rate(scratch.condensed, slot, node_1, v)
        spin = rotation_rate(
            rest, rest_rate, shape, scratch.motion, vector, r, slot, edges, along_length
        )
        for i in range(3):
            rates_out[r, 3 * i + j] = grip[i]
            rates_out[r, 9 + 3 * i + j] = spin[i]
            rates_out[r, 18 + 3 * i + j] = force[i]
