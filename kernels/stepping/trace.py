"""Keeping what steps were made of, for what goes through them backwards.

Every rod has taken its own number of steps; going backwards, all begin with their last.
"""

import warp as wp
from wrod.kernels.elastic.frames import ZERO
from wrod.kernels.stepping.pace import Pace

wp.set_module_options({"enable_backward": False})


@wp.struct
class Kept:
    """Steps of rods, (step, rod, ...): `span` and `whole` are the times to where forces are taken
    and to the end of a step, `left` is that from there to `until`; configurations are those where
    forces are taken, at the start (`before`) and a step earlier (`older`), velocities and strains
    of the last two; strains are there if the material is viscous, what friction remembers at the
    start (shape, node) if something can be touched."""

    coefficient: wp.array2d(dtype=wp.vec3d)
    span: wp.array2d(dtype=wp.float64)
    whole: wp.array2d(dtype=wp.float64)
    left: wp.array2d(dtype=wp.float64)
    dof: wp.array3d(dtype=wp.float64)
    tangent: wp.array3d(dtype=wp.vec3d)
    director: wp.array3d(dtype=wp.vec3d)
    twist: wp.array3d(dtype=wp.float64)
    dof_before: wp.array3d(dtype=wp.float64)
    tangent_before: wp.array3d(dtype=wp.vec3d)
    director_before: wp.array3d(dtype=wp.vec3d)
    dof_older: wp.array3d(dtype=wp.float64)
    velocity: wp.array3d(dtype=wp.float64)
    velocity_older: wp.array3d(dtype=wp.float64)
    strain: wp.array3d(dtype=wp.vec4d)
    strain_older: wp.array3d(dtype=wp.vec4d)
    bristle: wp.array4d(dtype=wp.vec3d)
    sliding: wp.array4d(dtype=wp.int32)


@wp.struct
class OneStep:
    """One step of every rod, (rod, ...), as in `Kept`, but `left` from where forces are taken;
    `active` of those that took it."""

    active: wp.array(dtype=wp.int32)
    coefficient: wp.array(dtype=wp.vec3d)
    span: wp.array(dtype=wp.float64)
    whole: wp.array(dtype=wp.float64)
    left: wp.array(dtype=wp.float64)
    dof: wp.array2d(dtype=wp.float64)
    tangent: wp.array2d(dtype=wp.vec3d)
    director: wp.array2d(dtype=wp.vec3d)
    twist: wp.array2d(dtype=wp.float64)
    dof_before: wp.array2d(dtype=wp.float64)
    tangent_before: wp.array2d(dtype=wp.vec3d)
    director_before: wp.array2d(dtype=wp.vec3d)
    dof_older: wp.array2d(dtype=wp.float64)
    velocity: wp.array2d(dtype=wp.float64)
    velocity_older: wp.array2d(dtype=wp.float64)
    strain: wp.array2d(dtype=wp.vec4d)
    strain_older: wp.array2d(dtype=wp.vec4d)
    bristle: wp.array3d(dtype=wp.vec3d)
    sliding: wp.array3d(dtype=wp.int32)


@wp.kernel
def keep_step(
    # State in:
    pace: Pace,
    count: wp.array(dtype=wp.int32),
    now: OneStep,
    # Out:
    kept: Kept,
):
    """Keep accepted steps as long as there is room. Launched over (rod, dof)."""
    r, a = wp.tid()
    k = count[r]
    if pace.accepted[r] == 0 or k >= kept.span.shape[0]:
        return
    if a == 0:
        kept.coefficient[k, r] = pace.coefficient[r]
        kept.span[k, r] = pace.span[r]
        kept.whole[k, r] = pace.step[r]
        kept.left[k, r] = pace.until[r] - pace.time[r]
    kept.dof[k, r, a] = now.dof[r, a]
    kept.dof_before[k, r, a] = now.dof_before[r, a]
    kept.dof_older[k, r, a] = now.dof_older[r, a]
    kept.velocity[k, r, a] = now.velocity[r, a]
    kept.velocity_older[k, r, a] = now.velocity_older[r, a]
    if a < now.tangent.shape[1]:
        kept.tangent[k, r, a] = now.tangent[r, a]
        kept.director[k, r, a] = now.director[r, a]
        kept.tangent_before[k, r, a] = now.tangent_before[r, a]
        kept.director_before[k, r, a] = now.director_before[r, a]
    if a < now.twist.shape[1]:
        kept.twist[k, r, a] = now.twist[r, a]
    if a < now.strain.shape[1]:
        kept.strain[k, r, a] = now.strain[r, a]
        kept.strain_older[k, r, a] = now.strain_older[r, a]
    if a < now.bristle.shape[2]:
        for m in range(now.bristle.shape[1]):
            kept.bristle[k, r, m, a] = now.bristle[r, m, a]
            kept.sliding[k, r, m, a] = now.sliding[r, m, a]


@wp.kernel
def count_step(
    # State in:
    accepted: wp.array(dtype=wp.int32),
    # State in and out:
    count: wp.array(dtype=wp.int32),
):
    r = wp.tid()
    if accepted[r] != 0:
        count[r] = count[r] + 1


@wp.kernel
def recall_step(
    # In:
    kept: Kept,
    count: wp.array(dtype=wp.int32),
    back: int,
    # Out:
    step: OneStep,
):
    """The step that is `back` before the last of each rod. Launched over (rod, dof)."""
    r, a = wp.tid()
    k = count[r] - 1 - back
    if a == 0:
        step.active[r] = wp.where(k >= 0, 1, 0)
    if k < 0:
        return
    if a == 0:
        step.coefficient[r] = kept.coefficient[k, r]
        step.span[r] = kept.span[k, r]
        step.whole[r] = kept.whole[k, r]
        step.left[r] = kept.left[k, r] + (kept.whole[k, r] - kept.span[k, r])
    step.dof[r, a] = kept.dof[k, r, a]
    step.dof_before[r, a] = kept.dof_before[k, r, a]
    step.dof_older[r, a] = kept.dof_older[k, r, a]
    step.velocity[r, a] = kept.velocity[k, r, a]
    step.velocity_older[r, a] = kept.velocity_older[k, r, a]
    if a < step.tangent.shape[1]:
        step.tangent[r, a] = kept.tangent[k, r, a]
        step.director[r, a] = kept.director[k, r, a]
        step.tangent_before[r, a] = kept.tangent_before[k, r, a]
        step.director_before[r, a] = kept.director_before[k, r, a]
    if a < step.twist.shape[1]:
        step.twist[r, a] = kept.twist[k, r, a]
    if a < step.strain.shape[1]:
        step.strain[r, a] = kept.strain[k, r, a]
        step.strain_older[r, a] = kept.strain_older[k, r, a]
    if a < step.bristle.shape[2]:
        for m in range(step.bristle.shape[1]):
            step.bristle[r, m, a] = kept.bristle[k, r, m, a]
            step.sliding[r, m, a] = kept.sliding[k, r, m, a]


@wp.struct
class Wanted:
    """What a loss wants of rods at one time, its derivatives (rod, ...): by nodes and by the turn
    of each edge's frame about it (`dof`), by velocities, by how far the reference frame has turned
    while the edge's has not (`turn`, of each edge), by the strains that a viscous material
    remembers, by the bristles (shape, node) of friction, and by the curvatures that nodes have of
    their own whose bending remembers."""

    dof: wp.array2d(dtype=wp.float64)
    velocity: wp.array2d(dtype=wp.float64)
    turn: wp.array2d(dtype=wp.float64)
    strain: wp.array2d(dtype=wp.vec4d)
    bristle: wp.array3d(dtype=wp.vec3d)
    lagging: wp.array2d(dtype=wp.vec2d)


@wp.kernel
def go_back(
    # State in:
    active: wp.array(dtype=wp.int32),
    # State in and out:
    now: Wanted,
    before: Wanted,
    older: Wanted,
):
    """The start of the step is the end of the one before. Launched over (rod, dof)."""
    r, a = wp.tid()
    if active[r] == 0:
        return
    now.dof[r, a] = before.dof[r, a]
    before.dof[r, a] = older.dof[r, a]
    older.dof[r, a] = ZERO
    now.velocity[r, a] = before.velocity[r, a]
    before.velocity[r, a] = older.velocity[r, a]
    older.velocity[r, a] = ZERO
    if a < now.turn.shape[1]:
        now.turn[r, a] = before.turn[r, a]
        before.turn[r, a] = older.turn[r, a]
        older.turn[r, a] = ZERO
    if a < now.strain.shape[1]:
        now.strain[r, a] = before.strain[r, a]
        before.strain[r, a] = older.strain[r, a]
        older.strain[r, a] = wp.vec4d()
    if a < now.lagging.shape[1]:
        now.lagging[r, a] = before.lagging[r, a]
        before.lagging[r, a] = wp.vec2d()
    if a < now.bristle.shape[2]:
        for m in range(now.bristle.shape[1]):
            now.bristle[r, m, a] = before.bristle[r, m, a]
            before.bristle[r, m, a] = wp.vec3d()
