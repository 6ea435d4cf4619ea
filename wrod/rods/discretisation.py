"""The one place that puts a rod on a mesh.

A node carries what its Voronoi cell has: from the middle of the edge before it to the middle of the
edge after it. Stiffnesses, natural curvature and natural twist are means over the cell, mass is
what lies in it; an edge's stretching stiffness is its mean. Beyond a clamp stands a ghost edge that
has the clamp's direction: at the clamp's node only the cell's half on the rod bends and twists, so
that stiffnesses count more and what is there at rest less, by the share of the cell that is free
(`of_free_part`, to second order in the edge).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from wrod.errors import RodError
from wrod.rods.law import Softening
from wrod.rods.material import RodMaterial
from wrod.rods.model import Rod, RodModel
from wrod.rods.rotation import carried, unit

# Powers of the free share that quantities go with, each component's where they differ.
_BY_SHARE: dict[str, int | list[int]] = {
    "bending_stiffness": -1, "twisting_stiffness": -1, "coupling": -1, "natural_curvature": 1,
    "natural_twist": 1, "softening": [-2, 0], "inelastic": [0, 0, 1, 0],
}  # fmt: skip


def cells(edge: np.ndarray) -> np.ndarray:
    """(..., node) half of the edges around each node, of lengths (..., edge); complex if they
    are."""
    none = np.zeros_like(edge[..., :1])
    return 0.5 * (np.concatenate([none, edge], -1) + np.concatenate([edge, none], -1))


def of_free_part(share: np.ndarray, **values: np.ndarray) -> dict[str, np.ndarray]:
    """What nodes have of whose cells only a share bends and twists.

    Args:
        share: (..., node) free shares; it may be complex, as the values.
        values: (..., node) or (..., node, component), named as the arguments of `RodBatch`, and
            coupling of bending with twist.
    """
    out = {}
    for name, value in values.items():
        powers = np.array(_BY_SHARE[name], dtype=float)
        out[name] = value * (share if value.ndim == share.ndim else share[..., None]) ** powers
    return out


def in_principal(vector: np.ndarray, angle) -> np.ndarray:
    """(..., 2) components along the principal directions, by `angle` [rad] from m_1 towards m_2,
    of those along (m_1, m_2); complex if they or the angle are."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return vector @ np.array([[cosine, -sine], [sine, cosine]])


def models_of(rods: Rod | Sequence[Rod]) -> list[RodModel]:
    """The models of one rod, or of each of several; repeated ones are the same object."""
    if isinstance(rods, (RodModel, RodMaterial)):
        return [RodModel.of(rods)]
    known: dict[int, RodModel] = {}
    models = [known.setdefault(id(rod), RodModel.of(rod)) for rod in rods]
    if not models:
        raise RodError("there is no rod to put on a mesh; give one or more")
    return models


def mesh_arrays(
    rods: Rod | Sequence[Rod],
    arc_length: np.ndarray,
    *,
    clamped: tuple[bool, bool] = (False, False),
    held: int | None = None,
) -> dict[str, np.ndarray]:
    """Rods on meshes, as the arguments of `RodBatch`, in the principal directions of each section.

    Args:
        rods: one for all meshes, or one each; their units are those of the result.
        arc_length: (rod, node) or (node,) unstretched arc length of the nodes, ascending [m]. It
            need not cover the rod. Ghost nodes are included, at any distance.
        clamped: whether (first, last) edges are ghosts.
        held: edge that is clamped, on both sides of which rods bend as if they ended there.

    Returns:
        rest_length, stretching_stiffness (rod, node - 1); twisting_stiffness, natural_twist,
        node_mass (rod, node); bending_stiffness, natural_curvature, softening (rod, node, 2);
        inelastic (rod, node, 4); gravity (rod, 3), downwards.

    Raises:
        RodError: there are not as many rods as meshes, the nodes do not ascend, or `held` is not
            between edges.
    """
    models = models_of(rods)
    s = np.atleast_2d(np.asarray(arc_length, dtype=np.float64))
    if s.ndim != 2 or s.shape[1] < 3:
        raise RodError(f"arc_length has shape {s.shape}; give (rod, node) with 3 nodes or more")
    if held is not None and not 0 < held < s.shape[1] - 2:
        raise RodError(f"held is {held}; give an edge between others, 1 to {s.shape[1] - 3}")
    count = max(len(models), len(s))
    if {len(models), len(s)} - {1, count}:
        raise RodError(f"{len(models)} rods and {len(s)} meshes; give one each, or one for all")
    if not (np.diff(s, axis=1) > 0.0).all():
        raise RodError("arc_length does not ascend along every rod")
    if len(models) == 1:
        parts = [_on_mesh(models[0], s, clamped, held)]
    else:
        s = np.broadcast_to(s, (count, s.shape[1]))
        rows: dict[int, list[int]] = {}
        for row, model in enumerate(models):
            rows.setdefault(id(model), []).append(row)
        parts = [_on_mesh(models[r[0]], s[r], clamped, held) for r in rows.values()]
        order = np.argsort(np.concatenate([*rows.values()]), kind="stable")
        return {k: np.concatenate([p[k] for p in parts])[order] for k in parts[0]}
    return parts[0]


def end_to_end(parts: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Arrays of several rods as those of one row; `RodBatch.cut` the edges between them, which get
    the length of the edge before."""
    out = {"gravity": parts[0]["gravity"]}
    for name in parts[0].keys() - out.keys():
        columns = []
        for part in parts:
            value = part[name]
            between = name in ("rest_length", "stretching_stiffness") and part is not parts[-1]
            columns.append(np.concatenate([value, value[:, -1:]], axis=1) if between else value)
        out[name] = np.concatenate(columns, axis=1)
    return out


def damping(
    models: Sequence[RodModel], air_damping: float, internal_damping: float
) -> dict[str, Any]:
    """(rod,) radius, air_damping and internal_damping as `Dynamics` takes them; the numbers are for
    rods that say nothing of it."""
    inside = [m.internal_damping for m in models]
    return {
        "radius": np.array([m.radius for m in models]),
        "air_damping": np.array([m.air_damping or air_damping for m in models]),
        "internal_damping": np.array([internal_damping if b is None else b for b in inside]),
    }


def quadratic_drag(models: Sequence[RodModel], edge: np.ndarray) -> np.ndarray | None:
    """(rod, node, 2) drag of nodes as `Dynamics.set_drag` takes it, per velocity squared [kg/m], of
    rods with edges of these unstretched lengths (rod, edge) [m]; None where no rod has any.

    Air does not feel what the rod weighs where: the drag per mean line mass is that of every piece.
    """
    drag = np.array([m.quadratic_drag * m.weight / m.gravity for m in models])
    if not drag.any():
        return None
    return (drag[:, None] * cells(edge))[..., None] * [0.0, 1.0]


def _on_mesh(
    model: RodModel, s: np.ndarray, clamped: tuple[bool, bool], held: int | None
) -> dict[str, np.ndarray]:
    rods, nodes = s.shape
    middle = 0.5 * (s[:, 1:] + s[:, :-1])
    low = np.concatenate([s[:, :1], middle], axis=1)
    high = np.concatenate([middle, s[:, -1:]], axis=1)
    if clamped[0]:
        low[:, 1] = s[:, 1]
    if clamped[1]:
        high[:, -2] = s[:, -2]
    # The kernels' cells: half of the edges around a node, of its only edge at an end.
    rest = np.diff(s, axis=1)
    around = cells(rest)
    share = np.ones((rods, nodes))
    mass_share = np.ones((rods, nodes), dtype=bool)
    for is_clamped, node, ghost in ((clamped[0], 1, 0), (clamped[1], -2, -1)):
        if is_clamped:
            share[:, node] = (high[:, node] - low[:, node]) / around[:, node]
            mass_share[:, ghost] = False
    mass = np.where(mass_share, model.line_mass.mean(low, high) * (high - low), 0.0)
    if held is not None:
        high[:, held], low[:, held + 1] = s[:, held], s[:, held + 1]
        pair = slice(held, held + 2)
        share[:, pair] = ((high - low) / around)[:, pair]

    def mean(profile):
        return profile.mean(low, high)

    model = model.turned(-model.principal_angle) if model.principal_angle else model
    softening, inelastic = np.zeros((rods, nodes, 2)), np.zeros((rods, nodes, 4))
    if isinstance(model.law, Softening):
        softening[:] = model.law.softening
    inelastic[:] = model.law.inelastic
    for place, extra in model.point_masses:
        _hang(mass, s, place, extra, clamped)
    gravity = np.zeros((rods, 3))
    gravity[:, 2] = -model.gravity
    return {
        "rest_length": rest,
        "stretching_stiffness": model.stretching_stiffness.mean(s[:, :-1], s[:, 1:]),
        "node_mass": mass,
        "gravity": gravity,
        **of_free_part(
            share,
            bending_stiffness=np.stack([mean(b) for b in model.bending_stiffness], axis=2),
            twisting_stiffness=mean(model.twisting_stiffness),
            natural_curvature=np.stack([mean(k) for k in model.natural_curvature], axis=2),
            natural_twist=mean(model.natural_twist),
            softening=softening,
            inelastic=inelastic,
        ),
    }


def _hang(mass: np.ndarray, s: np.ndarray, place: float, extra: float, clamped) -> None:
    """Share a point mass between the two nodes around it, so that its middle stays where it is."""
    first, last = int(clamped[0]), s.shape[1] - 1 - int(clamped[1])
    for row, nodes in enumerate(s):
        slack = 1e-9 * (nodes[last] - nodes[first])
        if not nodes[first] - slack <= place <= nodes[last] + slack:
            continue
        i = int(np.clip(np.searchsorted(nodes, place, side="right") - 1, first, last - 1))
        part = np.clip((place - nodes[i]) / (nodes[i + 1] - nodes[i]), 0.0, 1.0)
        mass[row, i] += (1.0 - part) * extra
        mass[row, i + 1] += part * extra


def directors_at_rest(
    rods: Rod | Sequence[Rod], arc_length: np.ndarray, position: np.ndarray, director: np.ndarray
) -> np.ndarray:
    """(rod, edge, 3) first material directors of rods that lie with the twist that they have at
    rest.

    Args:
        rods: one, or one for each of the rows.
        arc_length: (rod, node) [m].
        position: (rod, node, 3).
        director: (rod, 3) of the rods' beginnings, across the first edges.
    """
    tangent = unit(np.diff(position, axis=1))
    across = unit(
        director - np.sum(director * tangent[:, 0], axis=1, keepdims=True) * tangent[:, 0]
    )
    first = carried(across, tangent)
    middle = 0.5 * (arc_length[:, 1:] + arc_length[:, :-1])
    pairs = zip(models_of(rods), middle, strict=True)
    angle = np.stack([model.rolled(s) for model, s in pairs])[..., None]
    return np.cos(angle) * first + np.sin(angle) * np.cross(tangent, first)


def principal_directors(
    rods: Rod | Sequence[Rod], director: np.ndarray, tangent: np.ndarray
) -> np.ndarray:
    """First principal directions of the sections whose first material director is given.

    Args:
        rods: one, or one for each of the rows.
        director: (rod, 3) or (rod, edge, 3), or one (3,) for all.
        tangent: (rod, 3) or (rod, edge, 3) unit tangents there.
    """
    angle = np.array([model.principal_angle for model in models_of(rods)])
    director = np.broadcast_to(np.asarray(director, dtype=np.float64), tangent.shape)
    if not angle.any():
        return director
    angle = angle.reshape(-1, *(1,) * (tangent.ndim - 1))
    along = np.sum(director * tangent, axis=-1, keepdims=True)
    across = director - along * tangent
    return np.cos(angle) * across + np.sin(angle) * np.cross(tangent, across)
