"""The law of a contact, whatever touches: nodes and planes, edges and solids or edges, bodies.

Normal force: zero apart, quadratic over a thin skin, then linear in the penetration p, so that its
slope is continuous. Friction: an elastic bristle between rod and shape carries the load while it
sticks; where the load exceeds mu N the bristle slides on (return mapping, as in elastoplasticity),
so that a node that sticks does not creep however long it is loaded.

While the penetration p grows or shrinks at a rate, the normal force is that of p + tau dp/dt, never
attractive: a Kelvin-Voigt solid, whose tau decides how fast things bounce off each other. In a step
that begins apart only the part in touch counts.

A node that stuck at the end of the last step slides at the static coefficient, one that slid at the
kinetic one: within a step the law is fixed, and Newton converges.

Another law needs its energy (`energies`), how Newton's method is led over its kink (`duals`) and
its derivatives (`plane_adjoint`, `edge_adjoint`, `pair_tangent`) besides.
"""

import warp as wp
from wrod.kernels.contact.shapes import Shape
from wrod.kernels.elastic.frames import HALF, ONE, ZERO

# Way on which a rod meets something in a step of which two-step differences may still reach over
# it, over the radius: what they throw back then is lost in the contact's own give.
IMPACT_WAY = wp.constant(wp.float64(0.1))


@wp.struct
class Touchable:
    """What pieces of rods, nodes or edges, may touch, and how: (rod, shape) shapes, coefficients of
    friction, and those that keep the roll (below 0 where it is free); (rod, piece) radius (an edge
    of radius 0 touches nothing), stiffness, skin, relaxation time; (rod,) 1 where friction turns
    the rod; and how friction varies over x and y, see `friction_factor`. Where shapes move with the
    rods: (rod, shape) weight that one edge is to bear, and (rod, shape, edge) 1 where an edge does
    not touch a shape; otherwise empty. Where others move them by forces: (rod, shape) stiffness
    that all edges may have on its body together (0: any), which body, (body,) edges near it."""

    shapes: wp.array2d(dtype=Shape)
    static_friction: wp.array2d(dtype=wp.float64)
    kinetic_friction: wp.array2d(dtype=wp.float64)
    roll_friction: wp.array2d(dtype=wp.float64)
    radius: wp.array2d(dtype=wp.float64)
    stiffness: wp.array2d(dtype=wp.float64)
    skin: wp.array2d(dtype=wp.float64)
    relaxation: wp.array2d(dtype=wp.float64)
    rest_length: wp.array2d(dtype=wp.float64)
    rolling: wp.array(dtype=wp.float64)
    field: wp.array2d(dtype=wp.float64)
    place: wp.vec4d
    burden: wp.array2d(dtype=wp.float64)
    firmest: wp.array2d(dtype=wp.float64)
    bearer: wp.array2d(dtype=wp.int32)
    near: wp.array(dtype=wp.int32)
    apart: wp.array3d(dtype=wp.int8)


@wp.struct
class ContactStep:
    """A step of rods that touch shapes: (rod,) 1 in `active` of those that are looked at; time to
    where forces are, and configurations (rod, dof) there and at the start; what friction remembers
    from there, (rod, shape, piece): bristles, 1 where they slid in the last step, and how far those
    are turned that keep the roll. (rod,) `iteration` is its number, below 0 where the step has
    ended; `stretch` and `dual` go on from iteration to iteration (`duals`)."""

    active: wp.array(dtype=wp.int32)
    span: wp.array(dtype=wp.float64)
    dof: wp.array2d(dtype=wp.float64)
    dof_before: wp.array2d(dtype=wp.float64)
    bristle: wp.array3d(dtype=wp.vec3d)
    sliding: wp.array3d(dtype=wp.int32)
    turned: wp.array3d(dtype=wp.float64)
    iteration: wp.array(dtype=wp.int32)
    stretch: wp.array3d(dtype=wp.vec3d)
    dual: wp.array3d(dtype=wp.vec3d)


@wp.func
def normal_force(p: wp.float64, stiffness: wp.float64, skin: wp.float64) -> wp.vec2d:
    """Force at the penetration p and its slope."""
    if p <= ZERO:
        return wp.vec2d(ZERO, ZERO)
    if p < skin:
        return wp.vec2d(HALF * stiffness * p * p / skin, stiffness * p / skin)
    return wp.vec2d(stiffness * (p - HALF * skin), stiffness)


@wp.func
def damped_force(
    depth: wp.float64,
    closing: wp.float64,
    relaxation: wp.float64,
    dt: wp.float64,
    stiffness: wp.float64,
    skin: wp.float64,
) -> wp.vec2d:
    """Force at a penetration that has grown by `closing` in the time dt, and its slope."""
    lag = relaxation / dt
    law = normal_force(depth + lag * wp.min(closing, depth), stiffness, skin)
    return wp.vec2d(law[0], (ONE + lag) * law[1])


@wp.func
def present_force(
    m: Touchable, depth: wp.float64, closing: wp.float64, dt: wp.float64, r: int, i: int
) -> wp.vec2d:
    """`damped_force` of a piece."""
    return damped_force(depth, closing, m.relaxation[r, i], dt, m.stiffness[r, i], m.skin[r, i])


@wp.func
def coefficient(m: Touchable, sliding: int, r: int, k: int) -> wp.float64:
    """Of friction: what slid goes on sliding at the kinetic one."""
    return wp.where(sliding != 0, m.kinetic_friction[r, k], m.static_friction[r, k])


@wp.struct
class Bristle:
    """What a bristle holds: its pull and its stiffness (a matrix), and by how much it slides."""

    pull: wp.vec3d
    tangential: wp.mat33d
    slides: wp.float64


@wp.func
def return_mapping(
    bristle: wp.vec3d, normal: wp.vec3d, stiffness: wp.float64, limit: wp.float64
) -> Bristle:
    """Coulomb's return mapping: a bristle of that stretch pulls by `limit` at most."""
    out = Bristle()
    across = wp.identity(3, dtype=wp.float64) - wp.outer(normal, normal)
    k = wp.float64(stiffness)
    size = wp.length(bristle)
    if stiffness * size > limit:
        k = limit / size
        across = across - wp.outer(bristle, bristle) / (size * size)
        out.slides = size - limit / stiffness
    out.pull = k * bristle
    out.tangential = k * across
    return out


@wp.func
def friction_factor(field: wp.array2d(dtype=wp.float64), place: wp.vec4d, q: wp.vec3d) -> wp.vec3d:
    """Bilinear value at q of a field (y, x) over the plane z = 0, and its derivatives by x and y;
    `place` is its first point and its spacing. Constant beyond its border."""
    nx = field.shape[1]
    ny = field.shape[0]
    if nx == 1 and ny == 1:
        return wp.vec3d(field[0, 0], ZERO, ZERO)
    u = (q[0] - place[0]) / place[2]
    v = (q[1] - place[1]) / place[3]
    inside_x = wp.where(u > ZERO and u < wp.float64(nx - 1), ONE, ZERO)
    inside_y = wp.where(v > ZERO and v < wp.float64(ny - 1), ONE, ZERO)
    u = wp.clamp(u, ZERO, wp.float64(nx - 1))
    v = wp.clamp(v, ZERO, wp.float64(ny - 1))
    i = wp.min(int(u), nx - 2)
    j = wp.min(int(v), ny - 2)
    u = u - wp.float64(i)
    v = v - wp.float64(j)
    low = field[j, i] + u * (field[j, i + 1] - field[j, i])
    high = field[j + 1, i] + u * (field[j + 1, i + 1] - field[j + 1, i])
    by_u = (ONE - v) * (field[j, i + 1] - field[j, i])
    by_u += v * (field[j + 1, i + 1] - field[j + 1, i])
    return wp.vec3d(
        low + v * (high - low), inside_x * by_u / place[2], inside_y * (high - low) / place[3]
    )


@wp.func
def note_touch(
    touching: wp.array(dtype=wp.int32),
    r: int,
    depth: wp.float64,
    closing: wp.float64,
    radius: wp.float64,
):
    """An impact (2) is what was apart and comes nearer by more than a part of the radius; all else
    that is within reach touches (1)."""
    if closing > depth and closing > IMPACT_WAY * radius:
        wp.atomic_max(touching, r, 2)
    else:
        wp.atomic_max(touching, r, 1)
