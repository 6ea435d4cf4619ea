"""Shapes that rods touch, where they are, and where they come from."""

import warp as wp
from wrod.kernels.elastic.frames import TWO, ZERO

NOTHING = wp.constant(-1)
PLANE = wp.constant(0)
# What moves a shape, if anything does: others, or the rods' own steps.
BY_OTHERS = wp.constant(1)
WITH_RODS = wp.constant(2)


@wp.struct
class Shape:
    """An obstacle in its own frame: the half-space z < 0, a solid of
    `wrod.kernels.contact.solids` with its sizes, or nothing, which fills a row. A box has half
    sizes `size`; cylinder, capsule and cone, about z, have radius size[0] and half height size[1];
    a mesh lies within size[0] of its origin, and size[1] is less where it has hollows. One that
    moves (`BY_OTHERS`, `WITH_RODS`) has come from the pose before in this step."""

    kind: int
    position: wp.vec3d
    rotation: wp.quatd
    size: wp.vec3d
    mesh: wp.uint64
    moves: int
    position_before: wp.vec3d
    rotation_before: wp.quatd


@wp.func
def shape_displacement(shape: Shape, q: wp.vec3d) -> wp.vec3d:
    """How far the shape has carried its point that is at q now."""
    if shape.moves == 0:
        return wp.vec3d(ZERO, ZERO, ZERO)
    p = wp.quat_rotate_inv(shape.rotation, q - shape.position)
    return q - shape.position_before - wp.quat_rotate(shape.rotation_before, p)


@wp.func
def shape_turn(shape: Shape, axis: wp.vec3d) -> wp.float64:
    """By how much the shape has turned about an axis, but for the third power of its turn."""
    if shape.moves == 0:
        return ZERO
    d = shape.rotation * wp.quat_inverse(shape.rotation_before)
    way = TWO * wp.dot(wp.vec3d(d[0], d[1], d[2]), axis)
    return wp.where(d[3] < ZERO, -way, way)


@wp.func
def shape_before(shape: Shape) -> Shape:
    """Where it was at the start of the step."""
    out = shape
    if shape.moves != 0:
        out.position = shape.position_before
        out.rotation = shape.rotation_before
    return out


@wp.struct
class Borne:
    """How multipliers of the balance of what carries shapes would move these (rod, shape): a shift
    of what is at the origin, and a turn; nothing where nothing moves with the rods."""

    shift: wp.array2d(dtype=wp.vec3d)
    turn: wp.array2d(dtype=wp.vec3d)


@wp.func
def beside(x: wp.vec3d, b: Borne, q: wp.vec3d, r: int, k: int) -> wp.vec3d:
    """A node's multiplier, less what the shape would move it."""
    if b.shift.shape[1] == 0:
        return x
    return x - b.shift[r, k] - wp.cross(b.turn[r, k], q)
