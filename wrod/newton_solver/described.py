"""`newton.Rod` descriptions as discrete elastic rods: chains, rings and branches."""

from __future__ import annotations

import newton
import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from wrod.arguments import array, check_fields, flag, number, optional
from wrod.errors import RodError
from wrod.newton_solver.attributes import capsules, weigh
from wrod.rods.model import RodModel
from wrod.rods.profile import Profile
from wrod.rods.rotation import angle_about, transport, unit

# A newton.Rod checks what it is made of, and not what it is given later.
_NUMBERS = (
    "radius", "youngs_modulus", "poissons_ratio", "shear_modulus", "stretch_rigidity",
    "bend_rigidity", "twist_rigidity",
)  # fmt: skip
_FIELDS = {
    "points": array((None, 3)), "edges": array((None, 2)), "quaternions": array((None, 4)),
    "rest_points": optional(array((None, 3))), "rest_quaternions": optional(array((None, 4))),
    "closed": flag, "rest_straight": flag, **dict.fromkeys(_NUMBERS, optional(number())),
}  # fmt: skip
# What joins the ends of a ring or of branches is a body; its share of the mass of one edge.
_JOINT_MASS = 0.01
# Of the shorter edge, over which the stiffness changes from joint to joint.
_STEP = 1e-6
# Of Newton's `add_rod`: how a cable looks, and what has no place in a rod that does not shear, has
# one damping, and is no articulation.
_LOOKS = {"label", "color"}
_WITHOUT_PLACE = {
    "stretch_damping", "shear_stiffness", "shear_damping", "twist_damping", "wrap_in_articulation",
    "junction_collision_filter",
}  # fmt: skip
_STRETCH = 1e5  # of a joint, where nothing says how stiff it is [N/m]: Newton's default


def add_described(
    builder, described: newton.Rod, density: float, joints: dict, add, **options
) -> list[tuple[int, list[int]]]:
    """`SolverDER.add_newton_rod`, which documents the arguments, `joints` those of Newton's
    `add_rod`; `add` is `SolverDER.add_rod`. The rods, and which edges each of them is made of."""
    check_fields(described, RodError, **_FIELDS)
    points = np.array(described.points, dtype=np.float64)
    if not ((np.array(described.edges) >= 0) & (np.array(described.edges) < len(points))).all():
        raise RodError(f"Rod: edges name other points than its {len(points)}")
    edges = [(int(a), int(b)) for a, b in described.edges]
    if described.closed:
        edges[-1] = (edges[-1][0], edges[0][0])
    frames = Rotation.from_quat(described.quaternions)
    directors, rest_points, rest_directors = frames.as_matrix()[:, :, 0], points, None
    if described.rest_points is not None:
        rest_points = np.array(described.rest_points, dtype=np.float64)
    if described.rest_quaternions is not None:
        rest_directors = Rotation.from_quat(described.rest_quaternions).as_matrix()[:, :, 0]
    chains = _chains(edges)
    ends = [node for chain in chains for node in (chain[0][0], chain[-1][1])]
    between = points[np.array(edges)]
    lengths = np.linalg.norm(between[:, 1] - between[:, 0], axis=1)
    model = _model(described, lengths, density, joints)
    if joints["bend_damping"] is not None:
        if options.get("internal_damping") is not None:
            raise RodError("give bend_damping or internal_damping: both say the same")
        stiffness = joints["bend_stiffness"]
        if stiffness is None:
            stiffness = model.bending_stiffness[0].values[0] / lengths.mean()
        options["internal_damping"] = joints["bend_damping"] / float(stiffness)
    met = {node: -1 for node in ends if ends.count(node) > 1}
    for node in met:
        met[node] = _add_joint(builder, points, edges, node, model)
    added = []
    label = options.pop("label", None)
    for k, chain in enumerate(chains):
        nodes = [chain[0][0], *(edge[1] for edge in chain)]
        rows = [edge[2] for edge in chain]
        model = _model(described, lengths[rows], density, joints)
        shape = _Shape(points[nodes], directors[rows])
        rest = _Shape(
            rest_points[nodes], (directors if rest_directors is None else rest_directors)[rows]
        )
        if rest_directors is None and described.rest_points is not None:
            rest = _Shape(rest.points, shape.carried_to(rest.points))
        ring = nodes[0] == nodes[-1]
        curvature, twist = rest.strains(ring, straight=described.rest_straight)
        held = {}
        for side, node in (("start", nodes[0]), ("end", nodes[-1])):
            if node in met:
                held |= {side: "clamped", f"{side}_body": met[node]}
        name = label if label is None or len(chains) == 1 else f"{label}/{k}"
        rod = add(
            builder, shape.points, model, director=shape.directors, rest_length=rest.lengths,
            natural_curvature=curvature, natural_twist=twist, label=name, **held, **options,
        )  # fmt: skip
        added.append((rod, rows))
    return added


def add_cable(
    builder, described: newton.Rod, cfg, joints: dict, options: dict, add
) -> tuple[list[int], list[int]]:
    """`SolverDER.add_cable`, which documents the arguments, `joints` and `options` being those of
    Newton's `add_rod`; `add` is `SolverDER.add_rod`."""
    if strange := sorted(set(options) - _LOOKS - _WITHOUT_PLACE):
        raise RodError(f"add_cable knows no {strange[0]!r}; give arguments of Newton's add_rod")
    density = (builder.default_shape_cfg if cfg is None else cfg).density
    look = {name: value for name, value in options.items() if name in _LOOKS}
    bodies = [-1] * len(described.edges)
    for rod, edges in add_described(builder, described, density, joints, add, **look):
        weigh(builder, rod)
        # Of an edge that is halved the first half counts.
        for edge, body in zip(edges, capsules(builder, rod), strict=False):
            bodies[edge] = body
    return bodies, [builder.joint_child.index(body) for body in bodies]


class _Shape:
    """A polygon (node, 3) with a director (node - 1, 3) on every edge; single edges are halved."""

    def __init__(self, points: np.ndarray, directors: np.ndarray):
        if len(points) == 2:
            points = np.array([points[0], points.mean(axis=0), points[1]])
            directors = np.repeat(directors, 2, axis=0)
        self.points = points
        steps = np.diff(points, axis=0)
        self.lengths = np.linalg.norm(steps, axis=1)
        self.tangents = steps / self.lengths[:, None]
        across = directors - np.sum(directors * self.tangents, axis=1)[:, None] * self.tangents
        self.directors = across / np.linalg.norm(across, axis=1)[:, None]

    def carried_to(self, points: np.ndarray) -> np.ndarray:
        """Directors turned the shortest way to the tangents of another polygon."""
        return transport(self.directors, self.tangents, unit(np.diff(points, axis=0)))

    def strains(self, ring: bool, straight: bool) -> tuple[np.ndarray, np.ndarray]:
        """Curvature (node, 2) and twist (node,) of this shape as `RodBatch` measures them [1/m], or
        none; an end has those of the node beside it, in a ring of its own place."""
        count = len(self.points)
        curvature, twist = np.zeros((count, 2)), np.zeros(count)
        if straight:
            return curvature, twist
        for i in range(1, count - 1):
            curvature[i], twist[i] = self._bend(i - 1, i)
        for i, beside in (0, 1), (count - 1, count - 2):
            curvature[i], twist[i] = curvature[beside], twist[beside]
            if ring:
                curvature[i], twist[i] = self._bend(count - 2, 0)
        return curvature, twist

    def _bend(self, e: int, f: int) -> tuple[np.ndarray, float]:
        t, u, a, b = self.tangents[e], self.tangents[f], self.directors[e], self.directors[f]
        length = 0.5 * (self.lengths[e] + self.lengths[f])
        kappa = [a @ u - b @ t, np.cross(t, a) @ u - np.cross(u, b) @ t]
        angle = angle_about(u, transport(a, t, u), b)
        return np.array(kappa) / ((1.0 + t @ u) * length), float(angle / length)


def _chains(edges: list[tuple[int, int]]) -> list[list[tuple[int, int, int]]]:
    """Edges (from, to, index) in chains between nodes where others than two edges meet."""
    at: dict[int, list[int]] = {}
    for k, edge in enumerate(edges):
        for node in edge:
            at.setdefault(node, []).append(k)
    left, out = set(range(len(edges))), []

    def follow(node: int, k: int) -> None:
        chain = []
        while k in left:
            left.remove(k)
            a, b = edges[k]
            after = b if node == a else a
            chain.append((node, after, k))
            node = after
            if len(at[node]) != 2:
                break
            k = next((j for j in at[node] if j in left), -1)
        out.append(chain)

    for node, around in at.items():
        if len(around) != 2:
            for k in around:
                if k in left:
                    follow(node, k)
    for k in range(len(edges)):  # rings without a branch
        if k in left:
            follow(edges[k][0], k)
    return out


def _rigidities(described: newton.Rod, area: float) -> list[float | None]:
    """Of the section, against stretching [N], bending and twisting [N m^2]; None if not given."""
    if described.bend_rigidity is not None:
        return [getattr(described, f"{name}_rigidity") for name in ("stretch", "bend", "twist")]
    young, shear = described.youngs_modulus, described.shear_modulus
    if young is None:
        return [None] * 3
    if shear is None:
        shear = young / (2.0 * (1.0 + described.poissons_ratio))
    second = area**2 / (4.0 * np.pi)
    return [young * area, young * second, 2.0 * shear * second]


def _of_joints(stiffness: float, lengths: np.ndarray) -> Profile:
    """A rigidity that is the stiffness of each joint times the length of what bends there, half of
    the edges beside it."""
    if np.ptp(lengths) < 1e-3 * lengths.max():
        return Profile(stiffness * lengths.mean())
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    middle = 0.5 * (ends[1:] + ends[:-1])
    bends = 0.5 * np.concatenate(
        [[2.0 * lengths[0]], lengths[1:] + lengths[:-1], [2.0 * lengths[-1]]]
    )
    step = _STEP * lengths.min()
    knots = np.column_stack([middle - step, middle + step]).ravel()
    return Profile(stiffness * np.repeat(bends, 2)[1:-1], knots)


def _model(described: newton.Rod, lengths: np.ndarray, density: float, joints: dict) -> RodModel:
    """Of a chain of edges of these lengths."""
    radius = 0.1 if described.radius is None else described.radius
    given = [joints[f"{name}_stiffness"] for name in ("stretch", "bend", "twist")]
    found = _rigidities(described, np.pi * radius**2)
    found = [r if k is None else _of_joints(k, lengths) for k, r in zip(given, found, strict=True)]
    stretch, bend, twist = found
    if bend is None:
        raise RodError(
            "the newton.Rod has no stiffness; give it youngs_modulus and poissons_ratio, its four "
            "section rigidities, or bend_stiffness"
        )
    twist = bend if twist is None else twist
    stretch = _STRETCH * lengths.mean() if stretch is None else stretch
    return RodModel(
        length=float(lengths.sum()),
        bending_stiffness=(bend, bend), twisting_stiffness=twist, stretching_stiffness=stretch,
        line_mass=density * np.pi * radius**2, radius=radius,
    )  # fmt: skip


def _add_joint(builder, points, edges, node: int, model: RodModel) -> int:
    """A light body that joins the ends at a node."""
    step = min(np.linalg.norm(points[a] - points[b]) for a, b in edges if node in (a, b))
    mass = _JOINT_MASS * float(model.line_mass.values[0]) * step
    return builder.add_body(
        xform=wp.transform(tuple(points[node]), wp.quat_identity()), mass=mass,
        inertia=wp.mat33(*np.diag([mass * step**2] * 3).ravel()),
    )  # fmt: skip
