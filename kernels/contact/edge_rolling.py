"""What keeps the roll of an edge on a solid, and how that follows the solid, for the adjoint of
steps."""

import warp as wp
from wrod.kernels.contact.law import ContactStep, Touchable
from wrod.kernels.contact.rolling import Rolled, rolled
from wrod.kernels.contact.shapes import Shape, shape_turn
from wrod.kernels.elastic.frames import ONE, TWO, edge

wp.set_module_options({"enable_backward": False})


@wp.func
def edge_rolled(
    m: Touchable,
    step: ContactStep,
    stiffness: wp.float64,
    force: wp.float64,
    r: int,
    k: int,
    i: int,
) -> Rolled:
    turn = step.turned[r, k, i] + step.dof[r, 4 * i + 3] - step.dof_before[r, 4 * i + 3]
    turn -= shape_turn(m.shapes[r, k], wp.normalize(edge(step.dof, r, i)))
    return rolled(turn, stiffness, wp.abs(m.radius[r, i]), m.roll_friction[r, k], force)


@wp.struct
class ShapeTurned:
    """How the turn of a shape about an edge follows the edge, and rotations of the shape now and at
    the start of the step."""

    by_edge: wp.vec3d
    now: wp.vec3d
    at_start: wp.vec3d


@wp.func
def follow_turn(shape: Shape, e: wp.vec3d) -> ShapeTurned:
    """Of `shape_turn`."""
    d = shape.rotation * wp.quat_inverse(shape.rotation_before)
    sign = wp.where(d[3] < wp.float64(0.0), -ONE, ONE)
    v = sign * wp.vec3d(d[0], d[1], d[2])
    w = sign * d[3]
    length = wp.length(e)
    t = e / length
    out = ShapeTurned()
    out.by_edge = (TWO / length) * (v - wp.dot(v, t) * t)
    out.now = w * t + wp.cross(v, t)
    out.at_start = wp.cross(v, t) - w * t
    return out
