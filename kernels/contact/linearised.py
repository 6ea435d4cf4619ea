"""Derivatives of a rod's contact with a plane over one time step, of stick and of slip."""

import warp as wp
from wrod.kernels.contact.planes import (
    Touchable,
    coefficient,
    friction_factor,
    present_force,
    return_mapping,
    touch,
)
from wrod.kernels.contact.rolling import held_turn, node_turn
from wrod.kernels.elastic.frames import ONE, ZERO, node

wp.set_module_options({"enable_backward": False})


@wp.kernel
def linearise_contact(
    # Model:
    model: Touchable,
    # State in:
    step: wp.array(dtype=wp.float64),
    accepted: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    bristle: wp.array3d(dtype=wp.vec3d),
    sliding: wp.array3d(dtype=wp.int32),
    turned: wp.array3d(dtype=wp.float64),
    # Out:
    friction_out: wp.array2d(dtype=wp.mat33d),
    coupling_out: wp.array2d(dtype=wp.mat33d),
    by_coefficient_out: wp.array2d(dtype=wp.vec3d),
    push_out: wp.array2d(dtype=wp.vec3d),
    memory_out: wp.array2d(dtype=wp.mat33d),
    sliding_memory_out: wp.array2d(dtype=wp.mat33d),
    roll_out: wp.array2d(dtype=wp.float64),
    torque_out: wp.array2d(dtype=wp.float64),
):
    """Of each node: friction's derivative by the bristle, by the normal displacement, by the
    coefficient; the residual of contact; and what, of contact and of friction alone, depends on
    where the node was before, as the normal force is viscous; and how stiffly and by which torque
    its roll is held. The bound of a roll that slides is taken as constant."""
    r, i = wp.tid()
    if accepted[r] == 0:
        return
    friction = wp.mat33d()
    coupling = wp.mat33d()
    by_coefficient = wp.vec3d()
    push = wp.vec3d()
    memory = wp.mat33d()
    roll = wp.vec2d(ZERO, ZERO)
    sliding_memory = wp.mat33d()
    c = touch(model, dof, dof_before, bristle[r, 0, i], r, 0, i)
    if c.force > ZERO:
        law = present_force(model, c.depth, c.closing, step[r], r, i)
        mu = coefficient(model, sliding[r, 0, i], r, 0)
        factor = friction_factor(model.field, model.place, node(dof, r, i))
        slope = (mu * law[0]) * wp.vec3d(factor[1], factor[2], ZERO)
        mu = mu * factor[0]
        lag = model.relaxation[r, i] / step[r]
        remembered = ZERO
        if c.closing < c.depth:
            remembered = law[1] * lag / (ONE + lag)
        n = c.normal
        memory = -remembered * wp.outer(n, n)
        held = return_mapping(c.bristle, n, model.stiffness[r, i], mu * law[0])
        if held.slides > ZERO:
            way = c.bristle / wp.length(c.bristle)
            coupling = wp.outer(way, slope - mu * law[1] * n)
            by_coefficient = factor[0] * law[0] * way
            sliding_memory = mu * remembered * wp.outer(way, n)
        friction = held.tangential
        push = held.pull - law[0] * n
        if model.roll_friction[r, 0] >= ZERO:
            arm = model.radius[r, i]
            turn = node_turn(dof, dof_before, turned[r, 0, i], r, i)
            limit = model.roll_friction[r, 0] * law[0] * arm
            roll = held_turn(turn, model.stiffness[r, i] * arm * arm, limit)
    friction_out[r, i] = friction
    coupling_out[r, i] = coupling
    by_coefficient_out[r, i] = by_coefficient
    push_out[r, i] = push
    memory_out[r, i] = memory + sliding_memory
    sliding_memory_out[r, i] = sliding_memory
    roll_out[r, i] = roll[1]
    torque_out[r, i] = roll[0]
