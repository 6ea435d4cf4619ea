"""Rods held at the contact and at the grip, whose grip walks to where it should be.

Node 0 is a ghost and node 1 the contact, which together clamp the tangent; the last node is the
grip, whose orientation is free. The grip walks in polar coordinates about the contact: its
direction turns at a constant rate while its distance changes linearly, so that a rod which is taut
at both ends stays taut on the way.
"""

import warp as wp
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.elastic.frames import HALF, ONE, ZERO, node
from wrod.kernels.grasping.closures import CONVERGED, FAILED
from wrod.kernels.linear.banded import banded_entry
from wrod.kernels.stepping.newton_iteration import safe_fraction


@wp.func
def point_on_way(start: wp.vec3d, target: wp.vec3d, progress: wp.float64) -> wp.vec3d:
    """Point at `progress` (0...1) between two points other than the origin."""
    r = wp.length(start)
    s = wp.length(target)
    u = start / r
    v = target / s
    distance = (ONE - progress) * r + progress * s
    axis = wp.cross(u, v)
    sine = wp.length(axis)
    if sine < wp.float64(1.0e-9):
        return (ONE - progress) * start + progress * target
    angle = wp.atan2(sine, wp.dot(u, v))
    across = wp.cross(axis / sine, u)
    turned = progress * angle
    return distance * (wp.cos(turned) * u + wp.sin(turned) * across)


@wp.func
def grip_balance(
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    solution: wp.array3d(dtype=wp.float64),
    r: int,
    i: int,
    column: int,
) -> wp.float64:
    """What the free degrees of freedom take off row i of the grip in column `column`."""
    n = solution.shape[2]
    a = n - 3 + i
    value = wp.float64(0.0)
    for b in range(wp.max(0, a - HALF_BANDWIDTH), n):
        if free[r, b] != 0:
            value += banded_entry(hessian, r, a, b) * solution[r, column, b]
    return value


@wp.func
def worst_imbalance(
    free: wp.array2d(dtype=wp.int32), gradient: wp.array2d(dtype=wp.float64), r: int
) -> wp.float64:
    """Largest unbalanced force of the free degrees of freedom."""
    worst = wp.float64(0.0)
    for a in range(gradient.shape[1]):
        if free[r, a] != 0:
            value = wp.abs(gradient[r, a])
            # Comparisons with a NaN are false, so that one is not lost.
            if not (value <= worst) and wp.isfinite(worst):
                worst = wp.float64(value)
    return worst


@wp.kernel
def condense_grip(
    # In:
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
    solution: wp.array3d(dtype=wp.float64),
    # Out:
    reaction_out: wp.array(dtype=wp.vec3d),
    stiffness_out: wp.array(dtype=wp.mat33d),
):
    """Force that holds the grip, and its derivative by the grip's position."""
    r = wp.tid()
    if active[r] == 0:
        return
    n = gradient.shape[1]
    force = wp.vec3d()
    stiffness = wp.mat33d()
    for i in range(3):
        force[i] = gradient[r, n - 3 + i] - grip_balance(free, hessian, solution, r, i, 0)
        for j in range(3):
            k = banded_entry(hessian, r, n - 3 + i, n - 3 + j)
            stiffness[i, j] = k - grip_balance(free, hessian, solution, r, i, 1 + j)
    reaction_out[r] = force
    stiffness_out[r] = stiffness


@wp.func
def walk_on(
    start: wp.vec3d,
    target: wp.vec3d,
    limit: wp.float64,
    free: wp.array2d(dtype=wp.int32),
    r: int,
    # State in and out:
    solution: wp.array3d(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    progress: wp.array(dtype=wp.float64),
    increment: wp.array(dtype=wp.float64),
):
    """From an equilibrium on along the exact tangent of the grip's way."""
    n = dof.shape[1]
    grip = node(dof, r, n // 4)
    ahead = wp.min(ONE, progress[r] + increment[r])
    change = point_on_way(start, target, ahead) - grip
    for a in range(n):
        value = wp.float64(0.0)
        if free[r, a] != 0:
            for j in range(3):
                value -= solution[r, 1 + j, a] * change[j]
        solution[r, 0, a] = value
    for j in range(3):
        solution[r, 0, n - 3 + j] = change[j]
    fraction = safe_fraction(dof, solution, r, limit, 0, 1)
    if fraction < ONE:
        ahead = progress[r] + fraction * (ahead - progress[r])
        increment[r] = ahead - progress[r]
        change = point_on_way(start, target, ahead) - grip
    for a in range(n - 3):
        dof[r, a] = dof[r, a] + fraction * solution[r, 0, a]
    for j in range(3):
        dof[r, n - 3 + j] = grip[j] + change[j]
    progress[r] = ahead


@wp.kernel
def walk_grip(
    # Model:
    start: wp.array(dtype=wp.vec3d),
    target: wp.array(dtype=wp.vec3d),
    tolerance: wp.array(dtype=wp.float64),
    limit: wp.float64,
    patience: int,
    free: wp.array2d(dtype=wp.int32),
    # State in:
    gradient: wp.array2d(dtype=wp.float64),
    # State in and out:
    solution: wp.array3d(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    progress: wp.array(dtype=wp.float64),
    # The last equilibrium on the way, to go back to; the size of the next step.
    dof_saved: wp.array2d(dtype=wp.float64),
    progress_saved: wp.array(dtype=wp.float64),
    increment: wp.array(dtype=wp.float64),
    waited: wp.array(dtype=wp.int32),
    iterations: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    status: wp.array(dtype=wp.int32),
    # Out:
    residual_out: wp.array(dtype=wp.float64),
):
    """One step of every walking rod.

    A rod in balance short of its target walks on along the exact tangent, one out of balance takes
    a Newton step, and one that has not found its balance in `patience` steps goes back to its last
    equilibrium and walks on in smaller steps; one that cannot stays there, as failed.
    """
    r = wp.tid()
    if active[r] == 0:
        return
    n = gradient.shape[1]
    arrived = progress[r] >= ONE
    worst = worst_imbalance(free, gradient, r)
    residual_out[r] = worst
    iterations[r] = iterations[r] + 1
    wanted = tolerance[r]
    if not arrived:
        wanted = wp.max(wanted, wp.float64(1.0e-4))

    if worst <= wanted:
        for a in range(n):
            dof_saved[r, a] = dof[r, a]
        progress_saved[r] = progress[r]
        if arrived:
            status[r] = CONVERGED
            active[r] = 0
            return
        if waited[r] <= 3:
            increment[r] = wp.float64(1.7) * increment[r]
        waited[r] = 0
        walk_on(start[r], target[r], limit, free, r, solution, dof, progress, increment)
        return

    waited[r] = waited[r] + 1
    if waited[r] > patience or not wp.isfinite(worst):
        increment[r] = HALF * HALF * increment[r]
        for a in range(n):
            dof[r, a] = dof_saved[r, a]
        progress[r] = progress_saved[r]
        # A walk that has not begun has nothing to go back to.
        if increment[r] < wp.float64(1.0e-3) or progress[r] < ZERO:
            status[r] = FAILED
            active[r] = 0
        # The way back is no evidence for larger steps.
        waited[r] = 4
        return

    for a in range(n):
        solution[r, 0, a] = wp.where(free[r, a] != 0, -solution[r, 0, a], ZERO)
    fraction = safe_fraction(dof, solution, r, limit, 0, 1)
    if fraction < ONE and progress_saved[r] >= ZERO:
        # So long a step may end on another branch: the next iteration goes back.
        waited[r] = patience
    for a in range(n):
        dof[r, a] = dof[r, a] + fraction * solution[r, 0, a]
