"""The adjoint of a step's contact with planes that stand still: see
`wrod.kernels.stepping.adjoint`.

Whether a node touches, sticks or slides counts as it was. Its residual is b - N n, of a bristle's
pull b and the normal force N; the pull depends on the bristle before, on where the node came from
and, where it slides, on N.
"""

import warp as wp
from wrod.kernels.contact.planes import (
    PLANE,
    Touch,
    Touchable,
    coefficient,
    present_force,
    return_mapping,
    touch,
)
from wrod.kernels.contact.rolling import by_logarithms
from wrod.kernels.contact.rolling_adjoint import node_angle, node_rolled
from wrod.kernels.elastic.frames import HALF, ONE, ZERO
from wrod.kernels.linear.banded_lu import ALONE
from wrod.kernels.stepping.adjoint import solved
from wrod.kernels.stepping.model_adjoint import WantedModel
from wrod.kernels.stepping.trace import OneStep, Wanted

wp.set_module_options({"enable_backward": False})


@wp.struct
class Pressed:
    """A node on a plane: stiffness of its bristle against stretching (a matrix), derivative of the
    pull by the normal force and by the coefficient, and by how much it slides (none of these where
    it sticks), the normal force and its derivatives by where the node is at the end of the step and
    was at its start, against the normal, by the relaxation time, and by the logarithm of the
    radius, which is in the depth and in the skin."""

    tangential: wp.mat33d
    by_force: wp.vec3d
    by_coefficient: wp.vec3d
    slides: wp.float64
    force: wp.float64
    slope: wp.float64
    remembered: wp.float64
    by_relaxation: wp.float64
    by_radius: wp.float64


@wp.func
def pressed(m: Touchable, step: OneStep, c: Touch, r: int, k: int, i: int) -> Pressed:
    out = Pressed()
    dt = step.span[r]
    law = present_force(m, c.depth, c.closing, dt, r, i)
    mu = coefficient(m, step.sliding[r, k, i], r, k)
    held = return_mapping(c.bristle, c.normal, m.stiffness[r, i], mu * law[0])
    out.tangential = held.tangential
    out.slides = held.slides
    if held.slides > ZERO:
        way = wp.normalize(c.bristle)
        out.by_force = mu * way
        out.by_coefficient = law[0] * way
    out.force = law[0]
    out.slope = law[1]
    lag = m.relaxation[r, i] / dt
    out.by_relaxation = law[1] / (ONE + lag) * wp.min(c.closing, c.depth) / dt
    if c.closing < c.depth:
        out.remembered = law[1] * lag / (ONE + lag)
    skin = m.skin[r, i]
    thick = HALF * m.stiffness[r, i] * skin
    if c.depth + lag * wp.min(c.closing, c.depth) < skin:
        thick = wp.float64(law[0])
    out.by_radius = m.radius[r, i] * (law[1] - out.remembered) - thick
    return out


@wp.kernel
def find_unknown(
    # Model:
    model: Touchable,
    # State in:
    chosen: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    # State out:
    touching_out: wp.array(dtype=wp.int32),
):
    """Say of the chosen rods whether they touch a plane in a way that has no adjoint: one that
    moves, or that turns them. Launched over (rod, node)."""
    r, i = wp.tid()
    if chosen[r] == 0:
        return
    for k in range(model.shapes.shape[1]):
        known = model.shapes[r, k].moves == 0 and model.rolling[r] == ZERO
        if model.shapes[r, k].kind == PLANE and not known:
            c = touch(model, dof, dof_before, wp.vec3d(), r, k, i)
            if c.force > ZERO:
                touching_out[r] = 1


@wp.kernel
def want_bristles(
    # Model:
    model: Touchable,
    # State in:
    step: OneStep,
    # State in and out:
    now: Wanted,
    # Out:
    coupling_out: wp.array2d(dtype=wp.mat33d),
):
    """What is wanted of the bristles at the step's end, of the nodes there; and what of friction is
    missing in the step's symmetric matrix. Launched over (rod, node)."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    coupling = wp.mat33d()
    wanted = wp.vec3d(ZERO, ZERO, ZERO)
    for k in range(model.shapes.shape[1]):
        c = touch(model, step.dof, step.dof_before, step.bristle[r, k, i], r, k, i)
        if c.force > ZERO:
            p = pressed(model, step, c, r, k, i)
            pull = now.bristle[r, k, i] / model.stiffness[r, i]
            wanted += p.tangential * pull - (p.slope * wp.dot(p.by_force, pull)) * c.normal
            coupling = coupling - p.slope * wp.outer(p.by_force, c.normal)
    coupling_out[r, i] = coupling
    for a in range(3):
        now.dof[r, 4 * i + a] = now.dof[r, 4 * i + a] + wanted[a]


@wp.kernel
def want_friction(
    # Model:
    model: Touchable,
    stiffness_share: wp.array2d(dtype=wp.float64),
    node_mass: wp.array2d(dtype=wp.float64),
    piece: wp.array(dtype=wp.int32),
    # State in:
    step: OneStep,
    now: Wanted,
    x: wp.array3d(dtype=ALONE),
    # State in and out:
    before: Wanted,
    by_coefficient: wp.array2d(dtype=wp.float64),
    by: WantedModel,
    by_piece: wp.array2d(dtype=wp.float64),
):
    """What is wanted of bristles and nodes at the step's start, of the coefficients (rod, shape),
    of masses, lengths and radii: contact damps by sqrt(mass / stiffness), and its stiffness goes
    with the length of a node's cell and by `stiffness_share` (rod, node), if there is one, with the
    mass of a piece of the row and against the radius. Launched over (rod, node)."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    w = solved(x, r, i)
    wanted = wp.vec3d(ZERO, ZERO, ZERO)
    stiffness = model.stiffness[r, i]
    by_stiffness = wp.float64(0.0)
    by_relaxation = wp.float64(0.0)
    by_radius = wp.float64(0.0)
    for k in range(model.shapes.shape[1]):
        c = touch(model, step.dof, step.dof_before, step.bristle[r, k, i], r, k, i)
        bristle = wp.vec3d(ZERO, ZERO, ZERO)
        if c.force > ZERO:
            p = pressed(model, step, c, r, k, i)
            after = now.bristle[r, k, i] / stiffness
            pull = after - w
            bristle = p.tangential * pull
            force = wp.dot(w, c.normal) + wp.dot(p.by_force, pull)
            if model.roll_friction[r, k] >= ZERO:
                h = node_rolled(model, step, p.force, r, k, i)
                by_step = -node_angle(x, r, i)
                by_end = now.turned[r, k, i] / h.whole
                force += h.per_force * (by_step + by_end)
                wp.atomic_add(by_coefficient, r, k, h.per_coefficient * (by_step + by_end))
                parts = by_logarithms(h, by_step, by_end)
                by_stiffness += parts[0] / stiffness
                by_radius += parts[1]
            wanted += (p.remembered * force) * c.normal - bristle
            wp.atomic_add(by_coefficient, r, k, wp.dot(p.by_coefficient, pull))
            by_stiffness += p.force * force / stiffness
            by_relaxation += p.by_relaxation * force
            by_radius += p.by_radius * force
            if p.slides > ZERO:
                # What slides pulls alike, however stiff its bristle is, which then is shorter.
                by_stiffness -= p.force * wp.dot(p.by_force, after) / stiffness
            else:
                by_stiffness -= wp.dot(c.bristle, w)
        before.bristle[r, k, i] = bristle
    for a in range(3):
        before.dof[r, 4 * i + a] = before.dof[r, 4 * i + a] + wanted[a]
    if node_mass[r, i] > ZERO:
        damped = HALF * model.relaxation[r, i] * by_relaxation
        by.node_mass[r, i] = by.node_mass[r, i] + damped / node_mass[r, i]
        by_stiffness -= damped / stiffness
        wp.atomic_add(by_piece, r, piece[i], stiffness_share[r, i] * by_stiffness)
        if stiffness_share[r, i] > ZERO:
            by_radius -= stiffness * by_stiffness
        by.radius[r, i] = by.radius[r, i] + by_radius
        cell = wp.float64(0.0)
        for n in range(wp.max(i - 1, 0), wp.min(i + 1, model.rest_length.shape[1])):
            cell += model.rest_length[r, n]
        for n in range(wp.max(i - 1, 0), wp.min(i + 1, model.rest_length.shape[1])):
            wp.atomic_add(by.rest_length, r, n, by_stiffness * stiffness / cell)
