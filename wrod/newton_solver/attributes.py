"""What a rod is in a Newton model: its custom attributes, and how one is added to a builder."""

from bisect import bisect_right
from typing import Any

import newton
import numpy as np
import warp as wp
from newton import Model, ModelBuilder

from wrod.arguments import whole
from wrod.errors import RodError
from wrod.newton_solver.meshed import MeshedRod

FREE, PINNED, CLAMPED = 0, 1, 2
HOLDS = {"free": FREE, "pinned": PINNED, "clamped": CLAMPED}
NAMESPACE = "der"
ROD, NODE, EDGE, HOLD = "der:rod", "der:node", "der:edge", "der:hold"
_ABOVE_ZERO = ("rod_radius", "edge_rest_length", "node_mass")
_COLOR = (0.16, 0.42, 0.62)


def _moved(name: str, turn_only: bool):
    """Callback that carries vectors of nodes or edges along when a builder is copied elsewhere.

    A builder's pose reaches bodies only: every rod owns at least one, which tells where it went.
    """

    def move(values: list, context: dict) -> list:
        source, target = context["builder"], context["destination_builder"]
        offset = context["entity_offsets"]["body"]

        def column(key):
            return source.custom_attributes[f"der:rod_{key}"].values

        out = list(values)
        for body, first, count in zip(
            column("body"), column(f"first_{name}"), column("node_count"), strict=True
        ):
            a, b = source.body_q[body], target.body_q[body + offset]
            if np.allclose(a, b, rtol=0.0, atol=1e-7):
                continue
            before: Any = wp.transformd(*a)  # its stubs know the single precision's
            after: Any = wp.transformd(*b)
            place: Any = wp.transform_multiply(after, wp.transform_inverse(before))
            rows = range(first, first + count - (name == "edge"))
            for i in rows:
                v: Any = wp.vec3d(*out[i])
                v = wp.transform_vector(place, v) if turn_only else wp.transform_point(place, v)
                out[i] = np.array(v)
        return out

    return move


STATE = ("node_q", "node_qd", "node_contact_f", "edge_director", "edge_spin")
_WHOLE, _NUMBER, _BODY = wp.int32, wp.float64, {"default": -1, "references": "body"}
_ATTRIBUTES: list[tuple[str, str, Any, dict[str, Any]]] = [
    (ROD, "rod_world", _WHOLE, {"default": -1, "references": "world"}),
    (ROD, "rod_first_node", _WHOLE, {"references": NODE}),
    (ROD, "rod_first_edge", _WHOLE, {"references": EDGE}),
    (ROD, "rod_node_count", _WHOLE, {}),
    (ROD, "rod_body", _WHOLE, _BODY),
    (ROD, "rod_visible", _WHOLE, {}),
    (ROD, "rod_touches_rods", _WHOLE, {"default": 1}),
    (ROD, "rod_weighs", _WHOLE, {}),  # whether its capsules have mass, and hold it without
    (ROD, "rod_start_hold", _WHOLE, {}),
    (ROD, "rod_start_body", _WHOLE, _BODY),
    (ROD, "rod_end_hold", _WHOLE, {}),
    (ROD, "rod_end_body", _WHOLE, _BODY),
    (ROD, "rod_radius", _NUMBER, {}),
    (ROD, "rod_air_damping", _NUMBER, {}),
    (ROD, "rod_quadratic_drag", _NUMBER, {}),
    (ROD, "rod_internal_damping", _NUMBER, {}),
    (EDGE, "edge_rest_length", _NUMBER, {}),
    (EDGE, "edge_stretching_stiffness", _NUMBER, {}),
    (HOLD, "hold_rod", _WHOLE, {"references": ROD}),
    (HOLD, "hold_node", _WHOLE, {}),
    (HOLD, "hold_kind", _WHOLE, {}),
    (HOLD, "hold_body", _WHOLE, _BODY),
    (NODE, "node_mass", _NUMBER, {}),
    (NODE, "node_bending_stiffness", wp.vec2d, {}),
    (NODE, "node_twisting_stiffness", _NUMBER, {}),
    (NODE, "node_natural_curvature", wp.vec2d, {}),
    (NODE, "node_natural_twist", _NUMBER, {}),
    (NODE, "node_softening", wp.vec2d, {}),
    (NODE, "node_inelastic", wp.vec4d, {}),
    (NODE, "node_q", wp.vec3d, {"reference_value_transformer": _moved("node", turn_only=False)}),
    (NODE, "node_qd", wp.vec3d, {"reference_value_transformer": _moved("node", turn_only=True)}),
    (NODE, "node_contact_f", wp.vec3d, {}),
    (
        EDGE,
        "edge_director",
        wp.vec3d,
        {"reference_value_transformer": _moved("edge", turn_only=True)},
    ),
    (EDGE, "edge_spin", _NUMBER, {}),
]


def register(builder: ModelBuilder) -> None:
    """Declare the frequencies der:rod, der:node, der:edge, der:hold and their attributes; repeat at
    will."""
    for name in ("rod", "node", "edge", "hold"):
        builder.add_custom_frequency(ModelBuilder.CustomFrequency(name=name, namespace=NAMESPACE))
    model, state = Model.AttributeAssignment.MODEL, Model.AttributeAssignment.STATE
    for frequency, name, dtype, more in _ATTRIBUTES:
        how = {"assignment": state if name in STATE else model, **more}
        builder.add_custom_attribute(
            ModelBuilder.CustomAttribute(
                name=name, namespace=NAMESPACE, frequency=frequency, dtype=dtype, **how
            )
        )


def add_rod(
    builder: ModelBuilder,
    rod: MeshedRod,
    held: tuple[tuple[str, int], tuple[str, int]],
    damping: tuple[float | None, float | None],
    touches_rods: bool,
    look: tuple[bool, tuple | None, str | None],
) -> int:
    """Add a rod; its index.

    Args:
        held: how, and by what body, the first and the last node are.
        damping: by air and inside; None is the rod's.
        look: whether it is shown, in which colour, and its label.

    Raises:
        RodError: the builder knows no rods, or no such body, or the rod's damping relaxes.
    """
    _refuse_stranger(builder)
    for name, (kind, body) in zip(("start", "end"), held, strict=True):
        if kind not in HOLDS:
            raise RodError(f"{name} is {kind!r}; use one of {', '.join(HOLDS)}")
        _refuse_body(builder, f"{name}_body", body)
        if kind == "free" and body != -1:
            raise RodError(
                f"{name}_body is {body}, and {name} is 'free'; give {name}='clamped' or 'pinned'"
            )
    model, (visible, color, label) = rod.model, look
    own = (model.air_damping, model.internal_damping or 0.0)
    air, internal = (o if given is None else given for o, given in zip(own, damping, strict=True))
    if internal and model.relaxation_time:
        raise RodError(
            f"rod has a relaxation_time of {model.relaxation_time:g} s, and SolverDER knows no "
            "internal damping that relaxes; give dataclasses.replace(rod, relaxation_time=0.0)"
        )
    counts = builder._custom_frequency_counts
    first_node, first_edge = counts.get(NODE, 0), counts.get(EDGE, 0)
    label = label or f"rod_{counts.get(ROD, 0)}"
    body = _add_bodies(builder, rod.points, rod.directors, model.radius, visible, color, label)
    _add_nodes(builder, rod)
    (start, start_body), (end, end_body) = held
    added = builder.add_custom_values(
        **{
            "der:rod_first_node": first_node,
            "der:rod_first_edge": first_edge,
            "der:rod_node_count": len(rod.points),
            "der:rod_body": body,
            "der:rod_visible": int(visible),
            "der:rod_touches_rods": int(touches_rods),
            "der:rod_weighs": 0,
            "der:rod_start_hold": HOLDS[start],
            "der:rod_start_body": start_body,
            "der:rod_end_hold": HOLDS[end],
            "der:rod_end_body": end_body,
            "der:rod_radius": model.radius,
            "der:rod_air_damping": float(air),
            "der:rod_quadratic_drag": model.quadratic_drag * model.weight / model.gravity,
            "der:rod_internal_damping": float(internal),
        }
    )
    return added["der:rod_node_count"]


def _refuse_body(builder: ModelBuilder, name: str, body: int) -> None:
    """Refuse to be held by what is no body, or goes with a rod."""
    if not -1 <= body < builder.body_count:
        raise RodError(
            f"{name} is {body}; give a body of the builder (it has {builder.body_count}), or -1 "
            "for the world"
        )
    values = builder.custom_attributes
    # Rods bring their bodies along when they are added: so first ones grow from rod to rod.
    rod = bisect_right(values["der:rod_body"].values or [], body) - 1
    if rod >= 0 and values["der:rod_visible"].values[rod] and body in capsules(builder, rod):
        raise RodError(f"{name} is {body}, which shows rod {rod} and goes with it; give another")


def _add_nodes(builder: ModelBuilder, rod: MeshedRod) -> None:
    nodes, count = rod.nodes, len(rod.points)
    builder.add_custom_values_batch(
        {
            "der:node_mass": float(nodes["node_mass"][i]),
            "der:node_bending_stiffness": wp.vec2d(*nodes["bending_stiffness"][i]),
            "der:node_twisting_stiffness": float(nodes["twisting_stiffness"][i]),
            "der:node_natural_curvature": wp.vec2d(*nodes["natural_curvature"][i]),
            "der:node_natural_twist": float(nodes["natural_twist"][i]),
            "der:node_softening": wp.vec2d(*nodes["softening"][i]),
            "der:node_inelastic": wp.vec4d(*nodes["inelastic"][i]),
            "der:node_q": rod.points[i],
            "der:node_qd": rod.velocity[i],
        }
        for i in range(count)
    )
    builder.add_custom_values_batch(
        {
            "der:edge_rest_length": float(rod.rest[i]),
            "der:edge_stretching_stiffness": float(nodes["stretching_stiffness"][i]),
            "der:edge_director": rod.directors[i],
        }
        for i in range(count - 1)
    )


def attach(builder: ModelBuilder, rod: int, body: int, node: int, kind: str) -> None:
    """`SolverDER.attach`, which documents the arguments."""
    _refuse_stranger(builder)
    count = builder._custom_frequency_counts.get(ROD, 0)
    if whole(0, count - 1)(rod):
        raise RodError(f"rod is {rod!r}; give the index of one of the builder's {count} rods")
    nodes = builder.custom_attributes["der:rod_node_count"].values[rod]
    last = nodes - 1 if kind == "pinned" else nodes - 2
    if kind not in ("pinned", "clamped"):
        raise RodError(f"kind is {kind!r}; use pinned or clamped")
    if whole(0, last)(node):
        raise RodError(f"node is {node!r}; rod {rod} has nodes 0 to {last} that can be {kind}")
    _refuse_body(builder, "body", body)
    held = _held_nodes(builder, rod)
    new = {node} if kind == "pinned" else {node, node + 1}
    if held & new:
        raise RodError(f"node {min(held & new)} of rod {rod} is held already; give another one")
    builder.add_custom_values(
        **{
            "der:hold_rod": int(rod),
            "der:hold_node": int(node),
            "der:hold_kind": HOLDS[kind],
            "der:hold_body": int(body),
        }
    )


def capsules(builder: ModelBuilder, rod: int) -> range:
    """The bodies that show a rod's edges."""
    values = [builder.custom_attributes[f"der:rod_{n}"].values[rod] for n in ("body", "node_count")]
    return range(values[0], values[0] + values[1] - 1)


def weigh(builder: ModelBuilder, rod: int) -> None:
    """Give a rod's capsules their edges' mass, without which one holds its edge."""
    values = builder.custom_attributes
    first = values["der:rod_first_node"].values[rod]
    radius = values["der:rod_radius"].values[rod]
    values["der:rod_weighs"].values[rod] = 1
    for i, body in enumerate(capsules(builder, rod)):
        mass = sum(values["der:node_mass"].values[first + i : first + i + 2]) / 2
        builder.body_mass[body], builder.body_inv_mass[body] = mass, 1.0 / mass
        inertia = np.eye(3) * mass * radius**2
        builder.body_inertia[body] = wp.mat33(inertia)
        builder.body_inv_inertia[body] = wp.mat33(np.linalg.inv(inertia))


def _refuse_stranger(builder: ModelBuilder) -> None:
    """Refuse a builder that does not know all of what rods are."""
    if not all(builder.has_custom_attribute(f"{NAMESPACE}:{name}") for _, name, *_ in _ATTRIBUTES):
        raise RodError(
            "the builder does not know rods; call SolverDER.register_custom_attributes(builder) "
            "before SolverDER.add_rod"
        )


def _held_nodes(builder: ModelBuilder, rod: int) -> set[int]:
    """Nodes of a rod of the builder that something holds."""

    def values(name):
        return builder.custom_attributes[f"der:{name}"].values or {}

    out = set()
    if values("rod_start_hold")[rod] != FREE:
        out.add(0)
    if values("rod_end_hold")[rod] != FREE:
        out.add(values("rod_node_count")[rod] - 1)
    for k in range(builder._custom_frequency_counts.get(HOLD, 0)):
        if values("hold_rod")[k] == rod:
            node = values("hold_node")[k]
            out |= {node, node + values("hold_kind")[k] - 1}
    return out


def _add_bodies(builder, points, directors, radius, visible, color, label) -> int:
    """A kinematic capsule on every edge, or one body without shape; the first one's index.

    A joint without axes ties each to the world: SolverMuJoCo takes no body without a joint, and
    makes such ones mocap bodies, which cost no degree of freedom; a fixed joint would be lost in
    `collapse_fixed_joints`, and in an articulation forward kinematics would put it back.
    """
    config = ModelBuilder.ShapeConfig(
        density=0.0, has_shape_collision=False, has_particle_collision=False, collision_group=0
    )
    first = builder.body_count
    rest = np.linalg.norm(np.diff(points, axis=0), axis=1)
    for i in range(len(rest) if visible else 1):
        z = (points[i + 1] - points[i]) / rest[i]
        frame = np.column_stack([directors[i], np.cross(z, directors[i]), z])
        turn = wp.quat_from_matrix(wp.mat33(*frame.ravel()))
        middle = wp.vec3(*(0.5 * (points[i] + points[i + 1])))
        place = wp.transform(middle, turn)
        body = builder.add_link(xform=place, is_kinematic=True, label=f"{label}/edge_{i}")
        builder.add_joint_d6(-1, body, parent_xform=place, label=f"{label}/joint_{i}")
        if visible:
            builder.add_shape_capsule(
                body,
                radius=radius,
                half_height=0.5 * rest[i],
                cfg=config,
                color=color or _COLOR,
                label=f"{label}/capsule_{i}",
            )
    return first


def require(model: newton.Model):
    """The model's namespace of rods.

    Raises:
        RodError: the model has none, or what says where they are was changed.
    """
    rods = getattr(model, NAMESPACE, None)
    held = {name for kind, name, *_ in _ATTRIBUTES if kind == HOLD}
    there = {name: getattr(rods, name, None) is not None for _, name, *_ in _ATTRIBUTES}
    if not any(there.values()):
        raise RodError(
            "the model has no rods; call SolverDER.register_custom_attributes(builder) and "
            "SolverDER.add_rod(builder, ...) before builder.finalize()"
        )
    if not any(there[name] for name in held):  # none where nothing holds a rod in its middle
        there |= dict.fromkeys(held, True)
    for name in [name for name, is_there in there.items() if not is_there]:
        raise RodError(f"the model has lost the attribute der:{name} of its rods; build it anew")
    counts, nodes = rods.rod_node_count.numpy(), len(rods.node_q)
    ends = np.stack(
        [rods.rod_first_node.numpy() + counts, rods.rod_first_edge.numpy() + counts - 1]
    )
    if (counts < 2).any() or not (
        np.array_equal(np.sort(ends[0]), np.cumsum(counts[np.argsort(ends[0])]))
        and np.array_equal(np.sort(ends[1]), np.cumsum(counts[np.argsort(ends[1])] - 1))
        and counts.sum() == nodes and len(rods.edge_rest_length) == nodes - len(counts)
    ):  # fmt: skip
        raise RodError(
            "the model's rods are not where der:rod_node_count, rod_first_node and rod_first_edge "
            "have them; leave these as SolverDER.add_rod wrote them"
        )
    for kind, name, dtype, more in _ATTRIBUTES:
        array = getattr(rods, name, None)
        if array is None:  # no holds
            continue
        values, size = array.numpy(), {ROD: len(counts), NODE: nodes, EDGE: nodes - len(counts)}
        bodies = [-1, model.body_count] if more is _BODY else [0, len(HOLDS)]
        indices = name.endswith(("body", "hold", "kind"))
        if (
            array.dtype is not dtype
            or (kind != HOLD and len(values) != size[kind])
            or not np.isfinite(values).all()
            or (indices and ((values < bodies[0]) | (values >= bodies[1])).any())
            or (name in _ABOVE_ZERO and not (values > 0.0).all())
        ):
            raise RodError(f"the model's der:{name} holds what no rod of it has; build it anew")
    return rods
