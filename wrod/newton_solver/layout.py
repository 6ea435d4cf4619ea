"""Rods of a Newton model as rows of a batch."""

import numpy as np
from newton import Model

from wrod.errors import RodError
from wrod.kernels.stepping.bodies import Hold
from wrod.kernels.stepping.exchange import OutsideNode
from wrod.newton_solver.attributes import CLAMPED, FREE
from wrod.newton_solver.holds import Holds
from wrod.rods.batch import RodBatch
from wrod.rods.discretisation import of_free_part

_ELASTIC = ("bending_stiffness", "twisting_stiffness", "natural_curvature", "natural_twist")
_OF_LAWS = ("softening", "inelastic")

# What is deeper in a shape by so many radii where it is held begins inside it.
_INSIDE = 0.5


class Layout:
    """Rows of rods, end to end with cut edges between them; every row has as many rods, with as
    many nodes and clamps, as the others.

    A clamped end has one node more in the batch than in the model: the rod goes on into the clamp
    by an edge, whose direction is the clamp's. That node has no mass.

    Args:
        model: the Newton model.
        rows: (row, rod) indices of the rods into the model's.
        holds: what holds them.

    Attributes:
        places: (row, node) records of `wrod.kernels.stepping.exchange.OutsideNode`.
        rod: (row, node) the rod of each node.
        ghost: (row, node) whether a node is inside a clamp.
        cuts: indices of the cut edges.
    """

    def __init__(self, model: Model, rows: np.ndarray, holds: Holds):
        self.model, self.rows, self.holds = model, rows, holds
        der = model.der
        firsts = der.rod_first_node.numpy(), der.rod_first_edge.numpy()
        counts = der.rod_node_count.numpy()
        self._start = {}
        columns = []
        for row, rods in enumerate(rows):
            places, ends = [], []
            for rod in rods:
                node, edge, count = int(firsts[0][rod]), int(firsts[1][rod]), int(counts[rod])
                lead, tail = (kind == CLAMPED for kind in holds.ends[rod])
                self._start[row, int(rod)] = len(places) + lead
                last = count - 2
                if lead:
                    places.append((node, edge, 0, node, -1, rod))
                for i in range(count):
                    owns = i <= last
                    after = edge + i if owns else (edge + last if tail else -1)
                    places.append((node + i, after, owns, 0, 0, rod))
                if tail:
                    places.append((node + count - 1, -1, 0, node + last, 1, rod))
                ends.append(len(places) - 1)
            columns.append(places)
            self.cuts = tuple(ends[:-1])
        table = np.array(columns, dtype=np.int64)
        self.places = np.zeros(table.shape[:2], dtype=OutsideNode.numpy_dtype())
        for k, name in enumerate(("node", "edge", "owns", "along", "ghost")):
            self.places[name] = table[..., k]
        self.rod, self.ghost = table[..., 5], table[..., 4] != 0
        self.node_count = table.shape[1]

    @property
    def edges(self) -> np.ndarray:
        """(row, edge) whose properties an edge has: a cut those of the edge before."""
        out = self.places["edge"][:, :-1].copy()
        for cut in self.cuts:
            out[:, cut] = out[:, cut - 1]
        return out

    def capsules(self) -> np.ndarray:
        """(row, node - 1) body that shows each edge and goes with it, or -1."""
        der = self.model.der
        visible, first = der.rod_visible.numpy() != 0, der.rod_body.numpy()
        rod, edge = self.rod[:, :-1], self.places["edge"][:, :-1]
        shown = visible[rod] & (self.places["owns"][:, :-1] != 0)
        body = first[rod] + edge - der.rod_first_edge.numpy()[rod]
        return np.where(shown & ~np.isin(body, self.holds.bodies), body, -1).astype(int)

    def node_values(self, name: str) -> np.ndarray:
        """(row, node, ...) of an attribute of rods, for every node."""
        return getattr(self.model.der, f"rod_{name}").numpy()[self.rod]

    def rod_mass(self) -> np.ndarray:
        """(row, node) mass of the rod of each node [kg]."""
        der = self.model.der
        return self._sums(der.node_mass.numpy(), der.rod_first_node.numpy())

    def line_density(self) -> np.ndarray:
        """(row, node) mass per length of the rod of each node [kg/m]."""
        return self.rod_mass() / self.rod_length()

    def rod_length(self) -> np.ndarray:
        """(row, node) rest length of the rod of each node [m]."""
        der = self.model.der
        return self._sums(der.edge_rest_length.numpy(), der.rod_first_edge.numpy())

    def _sums(self, values: np.ndarray, first: np.ndarray) -> np.ndarray:
        """(row, node) sum of values over the rod of each node; rods lie one after the other."""
        order = np.argsort(first)
        total = np.empty(len(first))
        total[order] = np.add.reduceat(values, first[order])
        return total[self.rod]

    def stiffest_edges(self, stiffness: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """(row,) the edge by whose `stiffness` (row, edge) the rods of a row press each other: that
        of the stiffest rod that may meet one as stiff, such as itself, if that is longer than half
        a turn around its section."""
        length = self.rod_length()
        own = self.places["owns"][:, :-1] != 0
        out = np.empty(len(stiffness), dtype=int)
        for r, values in enumerate(stiffness):
            order = np.flatnonzero(own[r])[np.argsort(-values[own[r]], kind="stable")]
            first = order[0]
            others = order[self.rod[r, order] != self.rod[r, first]]
            alone = length[r, first] < np.pi * radius[r, first]
            out[r] = others[0] if alone and len(others) else first
        return out

    def near_clamps(self, holds: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """(row, edge) edges inside clamps, and those of rods that a body holds together with others
        which are nearer to it along the rod than half a turn of their tightest bend."""
        out = self.ghost[:, :-1] | self.ghost[:, 1:]
        inside = np.zeros(out.shape[1], dtype=bool)
        for row, records in enumerate(holds):
            records = records[records["kind"] > 0]
            bodies, counts = np.unique(records["body"], return_counts=True)
            for h in records[np.isin(records["body"], bodies[(counts > 1) & (bodies >= 0)])]:
                out[row, self._beside(row, int(h["node"]), inside, radius[row])] = True
        return out

    def beside_holds(
        self, holds: np.ndarray, slot: np.ndarray, depth: np.ndarray, radius: np.ndarray
    ) -> np.ndarray:
        """(row, shape, edge) edges that do not touch a shape on the body in `slot` (row, shape)
        since it holds them: those that begin inside, at the hold (`depth` over the radius), and
        those nearer to there along the rod than half a turn of their tightest bend."""
        out = np.zeros(depth.shape, dtype=bool)
        for row, records in enumerate(holds):
            for h in records[(records["kind"] > 0) & (records["slot"] >= 0)]:
                for k in np.flatnonzero(slot[row] == h["slot"]):
                    inside = depth[row, k] > _INSIDE
                    out[row, k, self._beside(row, int(h["node"]), inside, radius[row])] = True
        return out

    def _beside(self, row: int, node: int, inside: np.ndarray, radius: np.ndarray) -> list[int]:
        """Edges on both sides of a node: those `inside` (edge,), and so many more that they reach
        half a turn of the tightest bend further."""
        rest, out = self.model.der.edge_rest_length.numpy(), []
        for way in (-1, 1):
            edge, length, left = node - (way < 0), 0.0, False
            while 0 <= edge < len(radius) and self.places["owns"][row, edge]:
                left |= not inside[edge]
                if length > np.pi * radius[edge]:
                    break
                out.append(edge)
                if left:
                    length += float(rest[self.places["edge"][row, edge]])
                edge += way
        return out

    def make_batch(self, gravity: np.ndarray) -> RodBatch:
        """The rods in their first shapes under `gravity` (row, 3), with what is held not free."""
        der = self.model.der
        n, edges = self.places["node"], self.edges
        position = der.node_q.numpy()[n]
        rest = der.edge_rest_length.numpy()[edges]
        for row, i in zip(*np.nonzero(self.ghost), strict=True):
            way = self.places["ghost"][row, i]
            held, beyond = position[row, i - way], position[row, i - 2 * way]
            away = (held - beyond) / np.linalg.norm(held - beyond)
            position[row, i] = held + rest[row, i if way < 0 else i - 1] * away
        self._refuse_coincidence(position)
        directors = der.edge_director.numpy()[edges]
        for cut in self.cuts:
            gap = position[:, cut + 1] - position[:, cut]
            axis = np.eye(3)[np.abs(gap).argmin(axis=1)]
            across = np.cross(gap, axis)
            directors[:, cut] = across / np.linalg.norm(across, axis=1, keepdims=True)
        batch = RodBatch(
            position,
            rest_length=rest,
            **self.elasticity(),
            **self._of_nodes(_OF_LAWS),
            node_mass=np.where(self.ghost, 0.0, der.node_mass.numpy()[n]),
            gravity=gravity,
            director=directors,
            device=str(self.model.device),
        )
        batch.cut(self.cuts)
        return batch

    def elasticity(self) -> dict[str, np.ndarray]:
        """Stiffnesses and the shape at rest, named as the arrays of `RodBatch`."""
        stretching = self.model.der.edge_stretching_stiffness.numpy()[self.edges]
        return {"stretching_stiffness": stretching, **self._of_nodes(_ELASTIC)}

    def _of_nodes(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        der, n = self.model.der, self.places["node"]
        values = {name: getattr(der, f"node_{name}").numpy()[n] for name in names}
        return of_free_part(self.free_share, **values)

    def _refuse_coincidence(self, position: np.ndarray) -> None:
        for cut in self.cuts:
            apart = np.linalg.norm(position[:, cut + 1] - position[:, cut], axis=1)
            if not (apart > 0).all():
                row = int(np.argmin(apart))
                a, b = self.rod[row, cut], self.rod[row, cut + 1]
                raise RodError(
                    f"rod {a} ends at the very point at which rod {b} begins; clamp one of them, "
                    "or let one run the other way"
                )

    @property
    def free_share(self) -> np.ndarray:
        """(row, node) share of a node's cell that bends and twists: half of it where a clamp at an
        end holds the node."""
        out = np.ones(self.ghost.shape)
        for row, i in zip(*np.nonzero(self.ghost), strict=True):
            out[row, i - self.places["ghost"][row, i]] = 0.5
        return out

    def hold_records(self, slots: list[dict[int, int]]) -> np.ndarray:
        """(row, hold) records of `wrod.kernels.stepping.bodies.Hold`, with the slots of bodies that
        move with the rods, by row."""
        rows = []
        for row, rods in enumerate(self.rows):
            held = [h for rod in rods for h in self.holds.of(int(rod))]
            rows.append([self._record(row, h, slots[row]) for h in held])
        width = max(1, max(map(len, rows)))
        out = np.zeros((len(rows), width), dtype=Hold.numpy_dtype())
        out["rotation"][..., 3] = 1.0
        out["slot"] = -1
        for row, records in enumerate(rows):
            for k, record in enumerate(records):
                out[row, k] = record
        return out

    def _record(self, row: int, h, slots: dict[int, int]):
        first = self._start[row, h.rod]
        node = first + h.node
        other, edge = node + 1, node
        if h.ghost:
            other = node + h.ghost
            edge = min(node, other)
        return (
            2 if h.kind == CLAMPED else 1, h.body, slots.get(h.body, -1), node, other, edge,
            h.reach, h.position, h.rotation,
        )  # fmt: skip

    def free(self, holds: np.ndarray) -> np.ndarray:
        """(row, dof) which degrees of freedom nothing holds."""
        out = np.ones((len(self.rows), 4 * self.node_count - 1), dtype=bool)
        for row, records in enumerate(holds):
            for h in records:
                if h["kind"] == FREE:
                    continue
                for i in (h["node"], h["other"])[: h["kind"]]:
                    out[row, 4 * i : 4 * i + 3] = False
                if h["kind"] == 2:
                    out[row, 4 * h["edge"] + 3] = False
        return out
