"""The bordered Newton system of a naturally curved rod's optimal grasp.

Beside what the straight rod's system has, the roll of the grip is an unknown, and the balance of
the first edge's angle is an equation: no twisting moment at the contact, where the ghost edge and
the first edge share one roll. `border` names the degrees of freedom that border coordinates are.
"""

import warp as wp
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.linear.banded import banded_entry
from wrod.kernels.linear.border import worst_imbalance
from wrod.kernels.stepping.newton_iteration import largest_safe_fraction

wp.set_module_options({"enable_backward": False})


@wp.kernel
def condense(
    # Model:
    border: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    # In:
    active: wp.array(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
    solution: wp.array3d(dtype=wp.float64),
    # Out:
    condensed_out: wp.array3d(dtype=wp.float64),
    reaction_out: wp.array2d(dtype=wp.float64),
):
    """Static condensation on the border coordinates, one row of it a thread."""
    r, i = wp.tid()
    if active[r] == 0:
        return
    n = gradient.shape[1]
    a = border[i]
    force = gradient[r, a]
    for j in range(border.shape[0]):
        condensed_out[r, i, j] = banded_entry(hessian, r, a, border[j])
    for b in range(wp.max(0, a - HALF_BANDWIDTH), wp.min(n, a + HALF_BANDWIDTH + 1)):
        if free[r, b] != 0:
            h = banded_entry(hessian, r, a, b)
            force -= h * solution[r, 0, b]
            for j in range(border.shape[0]):
                condensed_out[r, i, j] = condensed_out[r, i, j] - h * solution[r, 1 + j, b]
    reaction_out[r, i] = force


@wp.kernel
def measure_imbalance(
    # Model:
    free: wp.array2d(dtype=wp.int32),
    # In:
    active: wp.array(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.float64),
    # Out:
    imbalance_out: wp.array(dtype=wp.float64),
):
    """Largest unbalanced force of the free degrees of freedom."""
    r = wp.tid()
    if active[r] == 0:
        return
    imbalance_out[r] = worst_imbalance(free, gradient, r, 0, 0)


@wp.kernel
def take_step(
    # Model:
    border: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    limit: wp.float64,
    # In:
    active: wp.array(dtype=wp.int32),
    residual_weight: wp.array(dtype=wp.float64),
    motion: wp.array2d(dtype=wp.float64),
    # State in and out:
    solution: wp.array3d(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
):
    """Move every degree of freedom by the step that belongs to a motion of the border.

    `residual_weight` 1 is a Newton step, 0 a step along the family of balanced rods.
    """
    r = wp.tid()
    if active[r] == 0:
        return
    n = dof.shape[1]
    count = border.shape[0]
    for a in range(n):
        value = wp.float64(0.0)
        if free[r, a] != 0:
            value = residual_weight[r] * solution[r, 0, a]
            for j in range(count):
                value += solution[r, 1 + j, a] * motion[r, j]
        solution[r, 0, a] = -value
    for j in range(count):
        solution[r, 0, border[j]] = motion[r, j]
    fraction = largest_safe_fraction(dof, solution, r, limit)
    for a in range(n):
        dof[r, a] = dof[r, a] + fraction * solution[r, 0, a]
