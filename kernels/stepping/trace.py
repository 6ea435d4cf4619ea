"""Keeping what steps were made of, for what goes through them backwards.

Every rod has taken its own number of steps; going backwards, all begin with their last. What a step
is made of are rows of arrays, which are copied as words of four bytes, whatever they hold.
"""

import warp as wp


@wp.struct
class Part:
    """An array (rod, word), and the place of its first word in a row of all."""

    words: wp.array2d(dtype=wp.int32)
    first: int


@wp.struct
class OneStep:
    """One step of every rod, (rod, ...): `active` of those that took it; `span` and `whole` are the
    times to where forces are taken and to the end of the step, which is at `time` on the way to
    `until`; configurations are those where forces are taken, at the start (`before`) and a step
    earlier (`older`), velocities and strains of the last two; strains are there if the material is
    viscous; and the pairs of edges that touch at the end (edge, slot), with their bristles and
    whether they slid at the start. Of shapes: `wrod.kernels.contact.law.ContactStep`."""

    active: wp.array(dtype=wp.int32)
    coefficient: wp.array(dtype=wp.vec3d)
    span: wp.array(dtype=wp.float64)
    whole: wp.array(dtype=wp.float64)
    time: wp.array(dtype=wp.float64)
    until: wp.array(dtype=wp.float64)
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
    pair_partner: wp.array3d(dtype=wp.int32)
    pair_bristle: wp.array3d(dtype=wp.vec2d)
    pair_load: wp.array3d(dtype=wp.float64)
    pair_sliding: wp.array3d(dtype=wp.int32)


@wp.func
def left_of(step: OneStep, r: int) -> wp.float64:
    """Time from where forces are taken to `until`."""
    return step.until[r] - step.time[r] + (step.whole[r] - step.span[r])


@wp.kernel
def keep_step(
    # State in:
    accepted: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    part: wp.array(dtype=Part),
    # Out: (step, rod, word)
    kept: wp.array3d(dtype=wp.int32),
):
    """Keep accepted steps as long as there is room. Launched over (rod, part, word)."""
    r, p, a = wp.tid()
    k = count[r]
    if accepted[r] != 0 and k < kept.shape[0] and a < part[p].words.shape[1]:
        kept[k, r, part[p].first + a] = part[p].words[r, a]


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
def find_unsound(
    # State in:
    most: int,
    touched: wp.array(dtype=wp.int32),
    diverged: wp.array(dtype=wp.int32),
    # State in and out:
    count: wp.array(dtype=wp.int32),
    # Out:
    unsound_out: wp.array(dtype=wp.int32),
    more_out: wp.array(dtype=wp.int32),
):
    """Which rods' steps have no adjoint, and (step,) whether any rod has taken more than so many;
    what goes back through a graph cannot refuse them."""
    r = wp.tid()
    unsound = wp.where(count[r] > most or touched[r] != 0 or diverged[r] != 0, 1, 0)
    unsound_out[r] = unsound
    count[r] = wp.min(wp.max(count[r], unsound), most)
    for k in range(count[r]):
        more_out[k] = 1


@wp.kernel
def spoil(
    # In:
    unsound: wp.array(dtype=wp.int32),
    # Out:
    wanted: wp.array(dtype=Part),
):
    """What is wanted of rods whose steps have no adjoint is no number, and with it all gradients.
    Launched over (rod, part, word)."""
    r, p, a = wp.tid()
    if unsound[r] != 0 and a < wanted[p].words.shape[1]:
        wanted[p].words[r, a] = -1


@wp.kernel
def recall_step(
    # In:
    kept: wp.array3d(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    back: int,
    # Out:
    part: wp.array(dtype=Part),
    active_out: wp.array(dtype=wp.int32),
):
    """The step that is `back` before the last of each rod. Launched over (rod, part, word)."""
    r, p, a = wp.tid()
    k = count[r] - 1 - back
    if p == 0 and a == 0:
        active_out[r] = wp.where(k >= 0, 1, 0)
    if k >= 0 and a < part[p].words.shape[1]:
        part[p].words[r, a] = kept[k, r, part[p].first + a]


@wp.struct
class Wanted:
    """What a loss wants of rods at one time, its derivatives (rod, ...): by nodes and by the turn
    of each edge's frame about it (`dof`), by velocities, by how far the reference frame has turned
    while the edge's has not (`turn`, of each edge), by the strains that a viscous material
    remembers, by the bristles (shape, node or edge) of friction and of what keeps the roll, and by
    the curvatures that nodes have of their own whose bending remembers, and by the bristles of
    pairs of edges, with the later one of each (edge, slot)."""

    dof: wp.array2d(dtype=wp.float64)
    velocity: wp.array2d(dtype=wp.float64)
    turn: wp.array2d(dtype=wp.float64)
    strain: wp.array2d(dtype=wp.vec4d)
    bristle: wp.array3d(dtype=wp.vec3d)
    edge_bristle: wp.array3d(dtype=wp.vec3d)
    turned: wp.array3d(dtype=wp.float64)
    edge_turned: wp.array3d(dtype=wp.float64)
    lagging: wp.array2d(dtype=wp.vec2d)
    pair_partner: wp.array3d(dtype=wp.int32)
    pair_bristle: wp.array3d(dtype=wp.vec2d)


@wp.kernel
def go_back(
    # State in:
    active: wp.array(dtype=wp.int32),
    # State in and out:
    now: wp.array(dtype=Part),
    before: wp.array(dtype=Part),
    older: wp.array(dtype=Part),
):
    """The start of the step is the end of the one before. Launched over (rod, part, word)."""
    r, p, a = wp.tid()
    if active[r] != 0 and a < now[p].words.shape[1]:
        now[p].words[r, a] = before[p].words[r, a]
        before[p].words[r, a] = older[p].words[r, a]
        older[p].words[r, a] = 0


@wp.kernel
def drop(
    # In:
    chosen: wp.array(dtype=wp.int32),
    # Out:
    wanted: wp.array(dtype=Part),
):
    """Nothing is wanted of what was before the chosen rods began anew. Launched over
    (rod, part, word)."""
    r, p, a = wp.tid()
    if chosen[r] != 0 and a < wanted[p].words.shape[1]:
        wanted[p].words[r, a] = 0
