"""What holds a model's rods, in the frames of the bodies that do."""

from dataclasses import dataclass

import newton
import numpy as np
from newton import BodyFlags, JointType
from scipy.spatial.transform import Rotation

from wrod.newton_solver.attributes import CLAMPED, FREE


@dataclass(frozen=True)
class Held:
    """A node, or an edge from there on, that a body holds.

    Attributes:
        rod, node: which.
        kind: PINNED (a node) or CLAMPED (an edge).
        body: what holds it; -1: the world.
        ghost: 0 of an edge of the rod; -1 or 1 where a clamp at an end goes on before or behind it.
        reach: signed distance to the edge's other node [m].
        position, rotation: (3,), (4,) of the node and of the edge's frame (tangent, director,
            their cross product; xyzw) in the body's.
    """

    rod: int
    node: int
    kind: int
    body: int
    ghost: int
    reach: float
    position: np.ndarray
    rotation: np.ndarray


class Holds:
    """What holds the rods of a model.

    Attributes:
        ends: (rod, 2) FREE, PINNED or CLAMPED: start and end of every rod.
    """

    def __init__(self, model: newton.Model):
        der = model.der
        names = ("first_node", "first_edge", "node_count")
        self._span = [getattr(der, f"rod_{name}").numpy() for name in names]
        self._q, self._director = der.node_q.numpy(), der.edge_director.numpy()
        self._rest = der.edge_rest_length.numpy()
        self._bodies = model.body_q.numpy().astype(float)
        sides = ("start", "end")
        self.ends = np.stack([getattr(der, f"rod_{s}_hold").numpy() for s in sides], axis=1)
        carriers = np.stack([getattr(der, f"rod_{s}_body").numpy() for s in sides], axis=1)
        self._of: dict[int, list[Held]] = {r: [] for r in range(len(self.ends))}
        for rod, side in zip(*np.nonzero(self.ends != FREE), strict=True):
            rod, node = int(rod), int(side * (self._span[2][rod] - 1))
            kind, body = int(self.ends[rod, side]), int(carriers[rod, side])
            self._add(rod, node, kind, body, ghost=2 * int(side) - 1)
        for rod, node, kind, body in _attachments(der):
            self._add(rod, node, kind, body, ghost=0)
        for rod, edge, body in _weightless_capsules(model):
            self._add(rod, edge, CLAMPED, body, ghost=0)
        self.bodies = sorted({h.body for held in self._of.values() for h in held if h.body >= 0})

    def of(self, rod: int) -> list[Held]:
        """What is held of a rod."""
        return self._of[rod]

    def _add(self, rod: int, node: int, kind: int, body: int, ghost: int) -> None:
        first_node, first_edge, count = (int(a[rod]) for a in self._span)
        edge = min(node, count - 2)
        length, turn = self._frame(first_node + edge, first_edge + edge)
        ghost = ghost if kind == CLAMPED else 0
        if ghost:
            # The clamp has the direction at the node, which a bent shape's first edge has half an
            # edge later: what turns it between two edges goes on to there.
            beyond, next_turn = self._frame(first_node + edge - ghost, first_edge + edge - ghost)
            bend = (turn.inv() * next_turn).as_rotvec()
            turn = turn * Rotation.from_rotvec(-length / (length + beyond) * bend)
        place = self._q[first_node + node]
        if body >= 0:
            carrier = Rotation.from_quat(self._bodies[body, 3:])
            place = carrier.inv().apply(place - self._bodies[body, :3])
            turn = carrier.inv() * turn
        reach = ghost * float(self._rest[first_edge + edge]) if ghost else length
        self._of[rod].append(Held(rod, node, kind, body, ghost, reach, place, turn.as_quat()))

    def _frame(self, node: int, edge: int) -> tuple[float, Rotation]:
        """Length and frame of the edge after a node."""
        way = self._q[node + 1] - self._q[node]
        length = float(np.linalg.norm(way))
        tangent, director = way / length, self._director[edge]
        frame = np.column_stack([tangent, director, np.cross(tangent, director)])
        return length, Rotation.from_matrix(frame)


def _attachments(der) -> list[tuple[int, int, int, int]]:
    """Rod, node, kind and body of what `SolverDER.attach` has added."""
    if getattr(der, "hold_rod", None) is None:
        return []
    names = ("rod", "node", "kind", "body")
    columns = (getattr(der, f"hold_{name}").numpy() for name in names)
    return [(int(r), int(n), int(k), int(b)) for r, n, k, b in zip(*columns, strict=True)]


def _weightless_capsules(model: newton.Model) -> list[tuple[int, int, int]]:
    """Rod, edge and body of capsules that the scene has taken the mass of, as Newton's solvers are
    told that a body stays where it is put: they hold their edges."""
    der, mass = model.der, model.body_mass.numpy()
    first, count = der.rod_body.numpy(), der.rod_node_count.numpy()
    out = []
    for rod in np.flatnonzero(der.rod_weighs.numpy()):
        own = np.arange(first[rod], first[rod] + count[rod] - 1)
        out += [(int(rod), int(b - first[rod]), int(b)) for b in own[mass[own] == 0.0]]
    return out


def free_bodies(model: newton.Model) -> np.ndarray:
    """(body,) whether a body has mass, is not kinematic, and no joint but a free one."""
    if model.body_count == 0:
        return np.zeros(0, dtype=bool)
    free = model.body_flags.numpy() & int(BodyFlags.DYNAMIC) != 0
    free &= model.body_mass.numpy() > 0
    if model.joint_count:
        kinds = model.joint_type.numpy()
        for name in ("joint_parent", "joint_child"):
            ends = getattr(model, name).numpy()
            bound = ends[(kinds != JointType.FREE) & (ends >= 0)]
            free[bound] = False
    return free
