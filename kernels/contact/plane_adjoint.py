"""The adjoint of a step's contact with planes that stand still: see
`wrod.kernels.stepping.adjoint`.

Whether a node touches, sticks or slides counts as it was. Its residual is b - N n, of a bristle's
pull b and the normal force N; the pull depends on the bristle before, on where the node came from
and, where it slides, on N.
"""

import warp as wp
from wrod.kernels.contact.planes import (
    PLANE,
    Touchable,
    coefficient,
    damped_force,
    present_force,
    return_mapping,
    touch,
)
from wrod.kernels.elastic.frames import HALF, ZERO
from wrod.kernels.linear.banded_lu import ALONE
from wrod.kernels.stepping.adjoint import solved
from wrod.kernels.stepping.model_adjoint import WantedModel
from wrod.kernels.stepping.trace import OneStep, Wanted

wp.set_module_options({"enable_backward": False})


@wp.func
def worth(
    wanted: wp.vec3d,
    w: wp.vec3d,
    normal: wp.vec3d,
    dt: wp.float64,
    mu: wp.float64,
    bristle: wp.vec3d,
    depth: wp.float64,
    closing: wp.float64,
    stiffness: wp.float64,
    relaxation: wp.float64,
    skin: wp.float64,
) -> wp.float64:
    """What is `wanted` of the bristle at the step's end, times it, less w times the residual."""
    force = damped_force(depth, closing, relaxation, dt, stiffness, skin)[0]
    pull = return_mapping(bristle, normal, stiffness, mu * force).pull
    return wp.dot(wanted, pull) / stiffness - wp.dot(w, pull - force * normal)


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
    moves, or that turns them or keeps their roll. Launched over (rod, node)."""
    r, i = wp.tid()
    if chosen[r] == 0:
        return
    for k in range(model.shapes.shape[1]):
        known = model.shapes[r, k].moves == 0
        known = known and model.rolling[r] == ZERO and model.roll_friction[r, k] < ZERO
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
            mu = coefficient(model, step.sliding[r, k, i], r, k)
            _0, _1, _2, _3, _4, by_bristle, by_depth, by_closing, _8, _9, _10 = wp.grad(worth)(
                now.bristle[r, k, i], wp.vec3d(), c.normal, step.span[r], mu, c.bristle, c.depth,
                c.closing, model.stiffness[r, i], model.relaxation[r, i], model.skin[r, i],
            )  # fmt: skip
            pushed = by_depth + by_closing + wp.dot(by_bristle, c.normal)
            wanted += by_bristle - pushed * c.normal
            law = present_force(model, c.depth, c.closing, step.span[r], r, i)
            held = return_mapping(c.bristle, c.normal, model.stiffness[r, i], mu * law[0])
            if held.slides > ZERO:
                way = wp.normalize(c.bristle)
                coupling = coupling - (mu * law[1]) * wp.outer(way, c.normal)
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
            mu = coefficient(model, step.sliding[r, k, i], r, k)
            _0, _1, _2, _3, by_mu, by_bristle, by_depth, by_closing, of, lag, skin = wp.grad(worth)(
                now.bristle[r, k, i], w, c.normal, step.span[r], mu, c.bristle, c.depth,
                c.closing, stiffness, model.relaxation[r, i], model.skin[r, i],
            )  # fmt: skip
            bristle = by_bristle - wp.dot(by_bristle, c.normal) * c.normal
            wanted += by_closing * c.normal - bristle
            wp.atomic_add(by_coefficient, r, k, by_mu)
            by_stiffness += of
            by_relaxation += lag
            by_radius += by_depth * model.radius[r, i] + skin * model.skin[r, i]
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
