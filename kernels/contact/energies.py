"""Elastic energy of contact: what normal forces and bristles that hold would give back."""

import warp as wp
from wrod.kernels.contact.edges import edge_touch
from wrod.kernels.contact.law import ContactStep, Touchable
from wrod.kernels.contact.pair_contact import Pieces, Rubbing, nearest_of_edges
from wrod.kernels.contact.planes import touch
from wrod.kernels.elastic.frames import HALF, ZERO

THIRD = wp.constant(wp.float64(1.0 / 3.0))


@wp.func
def normal_energy(p: wp.float64, stiffness: wp.float64, skin: wp.float64) -> wp.float64:
    """Of which `wrod.kernels.contact.law.normal_force` is the derivative."""
    if p <= ZERO:
        return ZERO
    if p < skin:
        return HALF * THIRD * stiffness * p * p * p / skin
    return HALF * stiffness * (p * (p - skin) + THIRD * skin * skin)


@wp.func
def touch_energy(
    m: Touchable,
    step: ContactStep,
    depth: wp.float64,
    stiffness: wp.float64,
    r: int,
    k: int,
    i: int,
) -> wp.float64:
    """Of a piece that touches."""
    arm = m.radius[r, i] * step.turned[r, k, i]
    held = wp.length_sq(step.bristle[r, k, i]) + arm * arm
    return normal_energy(depth, stiffness, m.skin[r, i]) + HALF * stiffness * held


@wp.kernel
def add_node_energy(
    # Model:
    model: Touchable,
    # State in:
    step: ContactStep,
    # State out:
    energy: wp.array(dtype=wp.float64),
):
    """Of nodes that touch planes."""
    r, i = wp.tid()
    for k in range(model.shapes.shape[1]):
        c = touch(model, step, r, k, i)
        if c.force > ZERO:
            stored = touch_energy(model, step, c.depth, model.stiffness[r, i], r, k, i)
            wp.atomic_add(energy, r, stored)


@wp.kernel
def add_edge_energy(
    # Model:
    model: Touchable,
    # State in:
    step: ContactStep,
    # State out:
    energy: wp.array(dtype=wp.float64),
):
    """Of edges that touch solids."""
    r, i = wp.tid()
    if model.radius[r, i] == ZERO:
        return
    for k in range(model.shapes.shape[1]):
        c = edge_touch(model, step, r, k, i)
        if c.force > ZERO:
            stored = touch_energy(model, step, c.depth, c.stiffness, r, k, i)
            wp.atomic_add(energy, r, stored)


@wp.kernel
def add_pair_energy(
    # Model:
    m: Pieces,
    # State in:
    dof: wp.array2d(dtype=wp.float64),
    partner_count: wp.array2d(dtype=wp.int32),
    partner: wp.array3d(dtype=wp.int32),
    rubbing: Rubbing,
    # State out:
    energy: wp.array(dtype=wp.float64),
):
    """Of rods that touch rods."""
    r, i = wp.tid()
    law = m.law[r]
    for k in range(partner_count[r, i]):
        j = partner[r, i, k]
        p = m.radius[r, i] + m.radius[r, j] - nearest_of_edges(m, dof, r, i, j).distance
        if p > ZERO:
            held = HALF * law.tangential * wp.length_sq(rubbing.bristle[r, i, k])
            normal = normal_energy(p, law.stiffness, law.skin)
            hard = law.hardening * law.stiffness
            normal += normal_energy(p - law.hard_depth, hard, law.hard_skin)
            wp.atomic_add(energy, r, normal + held)
