"""Which rods of a Newton model are solved together: those that a free body or contact may join."""

import numpy as np
from newton import Model
from scipy.cluster.hierarchy import DisjointSet

from wrod.newton_solver.attributes import CLAMPED
from wrod.newton_solver.holds import Holds
from wrod.newton_solver.owned import loose_bodies


def find_rows(
    model: Model, holds: Holds, own: np.ndarray, colliding: np.ndarray, touching: bool
) -> list[np.ndarray]:
    """Rods that step together, (row, rod) arrays of rows with rods alike.

    Args:
        model: the Newton model.
        holds: what holds its rods.
        own: (body,) whether a body moves with rods.
        colliding: (body,) which of those have shapes that rods and other bodies touch: all rods of
            a world with such a body share a row.
        touching: whether rods touch each other: then those of a world share a row.
    """
    der = model.der
    count = len(holds.ends)
    joined = DisjointSet(range(count))
    by_body: dict[int, int] = {}
    by_world: dict[int, int] = {}
    by_collision: dict[int, int] = {}
    worlds, joins = der.rod_world.numpy(), der.rod_touches_rods.numpy() != 0
    shared = set(loose_bodies(model, holds, own).values())
    for rod in range(count):
        if any(colliding[h.body] for h in holds.of(rod) if h.body >= 0):
            shared.add(int(worlds[rod]))
    for rod in range(count):
        held_by = [h.body for h in holds.of(rod) if h.body >= 0 and own[h.body]]
        partners = [by_body.setdefault(body, rod) for body in held_by]
        if int(worlds[rod]) in shared:
            partners.append(by_collision.setdefault(int(worlds[rod]), rod))
        if touching and joins[rod]:
            partners.append(by_world.setdefault(int(worlds[rod]), rod))
        for partner in partners:
            joined.merge(partner, rod)
    nodes, clamped = der.rod_node_count.numpy(), holds.ends == CLAMPED
    alike: dict[tuple, list[list[int]]] = {}
    for rods in map(sorted, joined.subsets()):
        kind = tuple((int(nodes[r]), *map(bool, clamped[r])) for r in rods)
        alike.setdefault(kind, []).append(rods)
    return [np.array(group) for group in alike.values()]
