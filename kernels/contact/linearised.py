"""Derivatives of a rod's contact with a plane over one time step, of stick and of slip."""

import warp as wp
from wrod.kernels.contact.law import (
    ContactStep,
    Touchable,
    coefficient,
    friction_factor,
    present_force,
    return_mapping,
)
from wrod.kernels.contact.planes import touch
from wrod.kernels.contact.rolling import node_rolled
from wrod.kernels.elastic.frames import ONE, ZERO, node


@wp.struct
class LinearContact:
    """How contact at a node answers, over a time step.

    Attributes:
        friction, by_coefficient: friction's derivative by the bristle and by the coefficient.
        push: residual of contact.
        memory, sliding_memory: what, of contact and of friction alone, depends on where the node
            was before, as the normal force is viscous.
        roll, torque: how stiffly, and by which torque, its roll is held.
    """

    friction: wp.mat33d
    by_coefficient: wp.vec3d
    push: wp.vec3d
    memory: wp.mat33d
    sliding_memory: wp.mat33d
    roll: wp.float64
    torque: wp.float64


@wp.kernel
def linearise_contact(
    # Model:
    model: Touchable,
    # State in:
    step: ContactStep,
    # Out:
    contact_out: wp.array2d(dtype=LinearContact),
    coupling_out: wp.array2d(dtype=wp.mat33d),
):
    """Of each node, and friction's derivative by the normal displacement. The bound of a roll that
    slides is taken as constant."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    out = LinearContact()
    coupling = wp.mat33d()
    c = touch(model, step, r, 0, i)
    if c.force > ZERO:
        law = present_force(model, c.depth, c.closing, step.span[r], r, i)
        mu = coefficient(model, step.sliding[r, 0, i], r, 0)
        factor = friction_factor(model.field, model.place, node(step.dof, r, i))
        slope = (mu * law[0]) * wp.vec3d(factor[1], factor[2], ZERO)
        mu = mu * factor[0]
        lag = model.relaxation[r, i] / step.span[r]
        remembered = ZERO
        if c.closing < c.depth:
            remembered = law[1] * lag / (ONE + lag)
        n = c.normal
        out.memory = -remembered * wp.outer(n, n)
        held = return_mapping(c.bristle, n, model.stiffness[r, i], mu * law[0])
        if held.slides > ZERO:
            way = c.bristle / wp.length(c.bristle)
            coupling = wp.outer(way, slope - mu * law[1] * n)
            out.by_coefficient = factor[0] * law[0] * way
            out.sliding_memory = mu * remembered * wp.outer(way, n)
            out.memory = out.memory + out.sliding_memory
        out.friction = held.tangential
        out.push = held.pull - law[0] * n
        if model.roll_friction[r, 0] >= ZERO:
            roll = node_rolled(model, step, law[0], r, 0, i)
            out.torque = roll.torque
            out.roll = roll.stiffness
    contact_out[r, i] = out
    coupling_out[r, i] = coupling
