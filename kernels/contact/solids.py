"""Solids that edges of rods touch: signed distance, outward normal, and how the distance bends.

All in the solid's own frame, in float64. A solid of revolution about z is a figure in the
half-plane (radius, z): where the nearest point lies on a straight side of it, the distance bends
only around the axis, by n_radius / radius; where it is a corner, also along the meridian, by
1 / distance.
Triangles of meshes are found by Warp in float32 and measured again in float64, so that forces are
smooth. Those that enclose nothing are sheets with two sides.
"""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, ZERO

BOX = wp.constant(1)
CYLINDER = wp.constant(2)
SPHERE = wp.constant(3)
CAPSULE = wp.constant(4)
CONE = wp.constant(5)
ELLIPSOID = wp.constant(6)
MESH = wp.constant(7)
# Of the search for the nearest point of an ellipsoid.
HALVINGS = wp.constant(70)


@wp.struct
class Surface:
    """Signed distance of a point from a solid, outward normal, the distance's second derivative."""

    distance: wp.float64
    normal: wp.vec3d
    bend: wp.mat33d


@wp.func
def side_of(x: wp.float64) -> wp.float64:
    return wp.where(x < ZERO, -ONE, ONE)


@wp.func
def box_surface(p: wp.vec3d, half: wp.vec3d) -> Surface:
    out = Surface()
    d = wp.vec3d(wp.abs(p[0]) - half[0], wp.abs(p[1]) - half[1], wp.abs(p[2]) - half[2])
    side = wp.vec3d(side_of(p[0]), side_of(p[1]), side_of(p[2]))
    over = wp.vec3d(wp.max(d[0], ZERO), wp.max(d[1], ZERO), wp.max(d[2], ZERO))
    distance = wp.length(over)
    if distance > ZERO:
        # Only edges and corners bend the distance.
        out.distance = distance
        out.normal = wp.cw_mul(over, side) / distance
        across = wp.mat33d()
        for c in range(3):
            if d[c] > ZERO:
                across[c, c] = ONE
        out.bend = (across - wp.outer(out.normal, out.normal)) / distance
        return out
    k = int(0)
    if d[1] > d[0]:
        k = int(1)
    if d[2] > d[k]:
        k = int(2)
    out.distance = d[k]
    n = wp.vec3d(ZERO, ZERO, ZERO)
    n[k] = side[k]
    out.normal = n
    return out


@wp.struct
class Meridian:
    """The same of a figure in the half-plane; `corner` is 1 where its nearest point is one."""

    distance: wp.float64
    out: wp.float64
    up: wp.float64
    corner: wp.float64


@wp.func
def revolved(p: wp.vec3d, across: wp.float64, f: Meridian) -> Surface:
    """The solid of revolution of a figure, at a point `across` from the axis."""
    s = Surface()
    radial = wp.vec3d(ONE, ZERO, ZERO)
    if across > ZERO:
        radial = wp.vec3d(p[0] / across, p[1] / across, ZERO)
    around = wp.vec3d(-radial[1], radial[0], ZERO)
    s.distance = f.distance
    s.normal = f.out * radial + wp.vec3d(ZERO, ZERO, f.up)
    if across > wp.float64(1.0e-12):
        s.bend = (f.out / across) * wp.outer(around, around)
    if f.corner > ZERO and f.distance != ZERO:
        along = f.up * radial - wp.vec3d(ZERO, ZERO, f.out)
        s.bend = s.bend + wp.outer(along, along) / f.distance
        if across <= wp.float64(1.0e-12):
            s.bend = s.bend + wp.outer(around, around) / f.distance
    return s


@wp.func
def cylinder_surface(p: wp.vec3d, radius: wp.float64, half: wp.float64) -> Surface:
    f = Meridian()
    across = wp.sqrt(p[0] * p[0] + p[1] * p[1])
    out = across - radius
    up = wp.abs(p[2]) - half
    side = side_of(p[2])
    if out > ZERO and up > ZERO:
        f.distance = wp.sqrt(out * out + up * up)
        f.out = out / f.distance
        f.up = side * up / f.distance
        f.corner = ONE
    elif out >= up:
        f.distance = out
        f.out = ONE
    else:
        f.distance = up
        f.up = side
    return revolved(p, across, f)


@wp.func
def capsule_surface(p: wp.vec3d, radius: wp.float64, half: wp.float64) -> Surface:
    f = Meridian()
    across = wp.sqrt(p[0] * p[0] + p[1] * p[1])
    up = p[2] - wp.clamp(p[2], -half, half)
    size = wp.sqrt(across * across + up * up)
    f.distance = size
    f.out = ONE
    if size > ZERO:
        f.out = across / size
        f.up = up / size
    f.corner = wp.where(up != ZERO, ONE, ZERO)
    s = revolved(p, across, f)
    s.distance = size - radius
    return s


@wp.func
def cone_surface(p: wp.vec3d, radius: wp.float64, half: wp.float64) -> Surface:
    """Apex at z = half, a disc of that radius at z = -half."""
    f = Meridian()
    across = wp.sqrt(p[0] * p[0] + p[1] * p[1])
    slant = wp.sqrt(radius * radius + wp.float64(4.0) * half * half)
    # Along the slant from the rim to the apex, and outwards from it.
    along_out = -radius / slant
    along_up = wp.float64(2.0) * half / slant
    x = across - radius
    z = p[2] + half
    s = x * along_out + z * along_up
    d = x * along_up - z * along_out
    inside = d <= ZERO and z >= ZERO
    if inside:
        if d >= -z:
            f.distance = d
            f.out = along_up
            f.up = -along_out
        else:
            f.distance = -z
            f.up = -ONE
    elif d > ZERO and s >= ZERO and s <= slant:
        f.distance = d
        f.out = along_up
        f.up = -along_out
    elif s > slant and z > ZERO:
        up = p[2] - half
        f.distance = wp.sqrt(across * across + up * up)
        f.out = across / f.distance
        f.up = up / f.distance
        f.corner = ONE
    elif x <= ZERO:
        f.distance = -z
        f.up = -ONE
    else:
        f.distance = wp.sqrt(x * x + z * z)
        f.out = x / f.distance
        f.up = z / f.distance
        f.corner = ONE
    return revolved(p, across, f)


@wp.func
def sphere_surface(p: wp.vec3d, radius: wp.float64) -> Surface:
    s = Surface()
    size = wp.length(p)
    s.distance = size - radius
    s.normal = wp.vec3d(ZERO, ZERO, ONE)
    if size > ZERO:
        s.normal = p / size
        s.bend = (wp.identity(3, dtype=wp.float64) - wp.outer(s.normal, s.normal)) / size
    return s


@wp.func
def ellipsoid_excess(p: wp.vec3d, a: wp.vec3d, t: wp.float64) -> wp.float64:
    total = wp.float64(-1.0)
    for c in range(3):
        x = a[c] * p[c] / (a[c] * a[c] + t)
        total += x * x
    return total


@wp.func
def ellipsoid_surface(p: wp.vec3d, a: wp.vec3d) -> Surface:
    """The nearest point is x_i = a_i^2 p_i / (a_i^2 + t), t the largest root of
    sum (a_i p_i / (a_i^2 + t))^2 = 1 (Eberly, Distance from a point to an ellipsoid, 2013)."""
    s = Surface()
    least = wp.min(a[0], wp.min(a[1], a[2]))
    largest = wp.max(a[0], wp.max(a[1], a[2]))
    low = wp.float64(-least * least)
    reach = wp.length(p)
    high = wp.float64(largest * reach)
    if ellipsoid_excess(p, a, low + wp.float64(1.0e-9) * least * least) <= ZERO:
        # Near the middle plane of the shortest axis, deep inside.
        s.distance = reach - least
        s.normal = wp.vec3d(ZERO, ZERO, ONE)
        if reach > ZERO:
            s.normal = p / reach
        return s
    for _k in range(HALVINGS):
        t = HALF * (low + high)
        if ellipsoid_excess(p, a, t) > ZERO:
            low = t
        else:
            high = t
    t = HALF * (low + high)
    w = wp.vec3d(ZERO, ZERO, ZERO)
    x = wp.vec3d(ZERO, ZERO, ZERO)
    by_p = wp.vec3d(ZERO, ZERO, ZERO)
    by_t = wp.float64(0.0)
    slope = wp.vec3d(ZERO, ZERO, ZERO)
    turn = wp.mat33d()
    for c in range(3):
        m = a[c] * a[c] + t
        w[c] = p[c] / m
        x[c] = a[c] * a[c] * p[c] / m
        by_p[c] = a[c] * a[c] * p[c] / (m * m)
        by_t += a[c] * a[c] * p[c] * p[c] / (m * m * m)
        slope[c] = p[c] / (m * m)
        turn[c, c] = ONE / m
    size = wp.length(w)
    n = w / size
    s.normal = n
    s.distance = wp.dot(p - x, n)
    turn = turn - wp.outer(slope, by_p) / by_t
    s.bend = ((wp.identity(3, dtype=wp.float64) - wp.outer(n, n)) / size) * turn
    s.bend = HALF * (s.bend + wp.transpose(s.bend))
    return s


@wp.func
def mesh_corner(mesh: wp.uint64, face: int, k: int) -> wp.vec3d:
    return wp.vec3d(wp.mesh_get_point(mesh, 3 * face + k))


@wp.func
def on_segment(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d) -> wp.float64:
    e = b - a
    return wp.clamp(wp.dot(p - a, e) / wp.max(wp.dot(e, e), wp.float64(1.0e-300)), ZERO, ONE)


@wp.func
def triangle_surface(
    p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, side: wp.float64, size: wp.float64
) -> Surface:
    """Of a triangle, seen from the side on which p is; of a surface's, from outside: p is inside
    (side -1) or outside (1) where its nearest point is on the border."""
    s = Surface()
    face = wp.normalize(wp.cross(b - a, c - a))
    height = wp.dot(p - a, face)
    foot = p - height * face
    within = (
        wp.length_sq(face) > ZERO
        and wp.dot(wp.cross(b - a, foot - a), face) >= ZERO
        and wp.dot(wp.cross(c - b, foot - b), face) >= ZERO
        and wp.dot(wp.cross(a - c, foot - c), face) >= ZERO
    )
    if within:
        turned = wp.where(side == ZERO and height < ZERO, -ONE, ONE)
        s.distance = turned * height
        s.normal = turned * face
        return s
    # The nearest point of the three sides.
    best = wp.float64(1.0e300)
    point = wp.vec3d(a)
    along = wp.vec3d(ZERO, ZERO, ZERO)
    corner = bool(False)
    for k in range(3):
        u = a
        v = b
        if k == 1:
            u = b
            v = c
        if k == 2:
            u = c
            v = a
        f = on_segment(p, u, v)
        x = u + f * (v - u)
        d = wp.length(p - x)
        if d < best:
            best = wp.float64(d)
            point = wp.vec3d(x)
            along = wp.normalize(v - u)
            corner = wp.min(f, ONE - f) == ZERO
    sign = wp.where(side < ZERO, -ONE, ONE)
    s.distance = sign * best
    s.normal = face
    if best > wp.float64(1.0e-9) * size:
        s.normal = (sign / best) * (p - point)
        bend = wp.identity(3, dtype=wp.float64) - wp.outer(s.normal, s.normal)
        if not corner:
            bend = bend - wp.outer(along, along)
        s.bend = bend / (sign * best)
    return s


@wp.func
def mesh_surface(p: wp.vec3d, mesh: wp.uint64, size: wp.float64) -> Surface:
    s = Surface()
    reach = float(wp.float64(4.0) * size)
    q = wp.mesh_query_point_sign_normal(mesh, wp.vec3(p), reach)
    if not q.result:
        s.distance = wp.length(p)
        s.normal = wp.vec3d(ZERO, ZERO, ONE)
        return s
    a = mesh_corner(mesh, q.face, 0)
    b = mesh_corner(mesh, q.face, 1)
    c = mesh_corner(mesh, q.face, 2)
    side = wp.float64(1.0)
    if q.sign < 0.0:
        # Behind its nearest triangle; what a surface does not enclose is outside.
        around = wp.mesh_query_point_sign_winding_number(mesh, wp.vec3(p), reach)
        side = wp.where(around.sign < 0.0, -ONE, ZERO)
    return triangle_surface(p, a, b, c, side, size)


# Written out at every place that asks, this takes a GPU's compiler minutes.
@wp.func(inline=False)
def solid_surface(kind: int, size: wp.vec3d, mesh: wp.uint64, p: wp.vec3d) -> Surface:
    s = Surface()
    if kind == BOX:
        s = box_surface(p, size)
    elif kind == CYLINDER:
        s = cylinder_surface(p, size[0], size[1])
    elif kind == SPHERE:
        s = sphere_surface(p, size[0])
    elif kind == CAPSULE:
        s = capsule_surface(p, size[0], size[1])
    elif kind == CONE:
        s = cone_surface(p, size[0], size[1])
    elif kind == ELLIPSOID:
        s = ellipsoid_surface(p, size)
    elif kind == MESH:
        s = mesh_surface(p, mesh, size[0])
    return s


@wp.func
def extent(kind: int, size: wp.vec3d) -> wp.float64:
    """Radius of a ball about the solid's origin that holds it."""
    if kind == SPHERE:
        return size[0]
    if kind == MESH:
        return size[0]
    if kind == CAPSULE:
        return size[0] + size[1]
    return wp.length(size)
