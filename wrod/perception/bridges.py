"""Bridges between the ports of a junction: their bending energy, and how to pair the ports.

Ports are paired so that the bending energy of the bridges between them is least (mBEST, Choi et
al. 2023), jointly for all ports of a junction, with strand ends that hide under another strand and
with stretches that two strands share.
"""

from functools import lru_cache

import numpy as np

from wrod.patterns.curve import arc_length
from wrod.perception.network import Junction
from wrod.perception.refine import smooth

# Energies are made dimensionless with the strand's radius r: E = r * integral of curvature^2.
HIDDEN_END = 1.5  # price of a strand end at a junction: a bridge that turns by some 70 degrees
LAYER = 2.0  # length over which a break of curvature is evened out, in strand radii
LARGEST_ENUMERATION = 8  # ports; beyond it the pairing is a minimum-weight matching


class _Unrolled:
    """Coordinates along and across the spine of a junction, in which the spine is straight."""

    def __init__(self, spine: np.ndarray, radius: float):
        self.spine = smooth(spine, np.ones(len(spine)), 6.0 * max(radius, 1.5))
        self.arc = arc_length(self.spine)
        tangent = np.gradient(self.spine, axis=0)
        self.tangents = tangent / np.hypot(*tangent.T)[:, None]
        (ax, ay), (bx, by) = self.tangents[[0, -1]]
        # Mean curvature along the spine [1/px].
        self.curvature = np.arctan2(ax * by - ay * bx, ax * bx + ay * by) / self.arc[-1]

    def flatten(self, position: np.ndarray, direction: np.ndarray):
        ends, tangents = self.spine[[0, -1]], self.tangents[[0, -1]]
        side = int(np.argmin(((position - ends) ** 2).sum(1)))
        t = tangents[side]
        rotation = np.array([t, [-t[1], t[0]]])
        offset = rotation @ (position - ends[side])
        return offset + [side * self.arc[-1], 0.0], rotation @ direction

    def restore(self, points: np.ndarray) -> np.ndarray:
        along, across = points.T
        inside = np.clip(along, 0.0, self.arc[-1])
        base = np.column_stack([np.interp(inside, self.arc, self.spine[:, i]) for i in (0, 1)])
        t = np.column_stack([np.interp(inside, self.arc, self.tangents[:, i]) for i in (0, 1)])
        t /= np.hypot(*t.T)[:, None]
        normal = np.column_stack([-t[:, 1], t[:, 0]])
        return base + (along - inside)[:, None] * t + across[:, None] * normal


def _flat_ports(junction: Junction, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    positions = np.array([p.position for p in junction.ports])
    directions = np.array([p.direction for p in junction.ports])
    curvatures = np.array([p.curvature for p in junction.ports])
    if junction.spine is not None:
        unrolled = _Unrolled(junction.spine, radius)
        flat = [unrolled.flatten(*pair) for pair in zip(positions, directions, strict=True)]
        positions, directions = (np.array(a) for a in zip(*flat, strict=True))
        curvatures = curvatures - np.where(directions[:, 0] > 0, 1.0, -1.0) * unrolled.curvature
    return positions, directions, curvatures


def bending_energy(
    positions: np.ndarray, directions: np.ndarray, curvatures: np.ndarray, radius: float
) -> np.ndarray:
    """Least bending energy (k, k) of a bridge from each port to each other, times the radius.

    A clamped cubic over the chord d that starts at angle a and ends at angle b to it stores
    the integral of curvature^2 = 4 (a^2 + a b + b^2) / d. Where its curvature does not continue
    that of the arms, a layer of length l is bent by the jump: l jump^2 at either end.
    """
    chord = positions[None] - positions[:, None]
    length = np.maximum(np.hypot(chord[..., 0], chord[..., 1]), radius)
    heading = np.arctan2(chord[..., 1], chord[..., 0])
    out = np.arctan2(directions[:, 1], directions[:, 0])
    turn = (out[:, None] - heading + np.pi) % (2 * np.pi) - np.pi
    arrive = (out[None] + np.pi - heading + np.pi) % (2 * np.pi) - np.pi
    jump_out = curvatures[:, None] + (4.0 * turn + 2.0 * arrive) / length
    jump_in = curvatures[None] + (2.0 * turn + 4.0 * arrive) / length
    layer = np.minimum(LAYER * radius, length / 4)
    bent = 4.0 * (turn**2 + turn * arrive + arrive**2) / length
    return radius * (bent + layer * (jump_out**2 + jump_in**2))


@lru_cache(maxsize=32)
def _pairings(k: int) -> tuple[tuple[tuple[int, int], ...], ...]:
    """All ways to pair some of k ports."""

    def split(ports):
        if not ports:
            yield ()
            return
        first, *rest = ports
        yield from split(rest)
        for i, other in enumerate(rest):
            for tail in split(rest[:i] + rest[i + 1 :]):
                yield ((first, other), *tail)

    return tuple(split(list(range(k))))


def ranked_pairings(junction: Junction, radius: float) -> list[tuple[float, tuple]]:
    """Pairings of the junction's ports with their energies, least first."""
    positions, directions, curvatures = _flat_ports(junction, radius)
    k = len(positions)
    energy = bending_energy(positions, directions, curvatures, radius)
    if k == 2:
        # Two arms and nothing else: one strand with a burr, whatever its bend.
        return [(float(energy[0, 1]), ((0, 1),))]
    if k > LARGEST_ENUMERATION:
        return [_matching(energy)]
    ranked = [
        (sum(energy[a, b] for a, b in pairs) + HIDDEN_END * (k - 2 * len(pairs)), pairs)
        for pairs in _pairings(k)
    ]
    return sorted(ranked, key=lambda item: item[0])


def best_pairing(junction: Junction, radius: float) -> tuple[float, tuple]:
    """Pairing of least energy, and that energy."""
    return ranked_pairings(junction, radius)[0]


def _matching(energy: np.ndarray) -> tuple[float, tuple]:
    import networkx as nx

    graph = nx.Graph()
    k = len(energy)
    for a in range(k):
        for b in range(a):
            graph.add_edge(a, b, weight=2 * HIDDEN_END - energy[a, b])
    graph.remove_edges_from([e for e in graph.edges if graph.edges[e]["weight"] <= 0])
    pairs = tuple(sorted(tuple(sorted(p)) for p in nx.max_weight_matching(graph)))
    total = sum(energy[a, b] for a, b in pairs) + HIDDEN_END * (k - 2 * len(pairs))
    return float(total), pairs


def cubic(p: np.ndarray, q: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Points (n, 2) of the cubic from p to q that leaves along u and arrives along v, unit vectors;
    about a pixel apart and without its ends [px]."""
    chord = np.hypot(*(q - p))
    t = np.linspace(0.0, 1.0, max(int(chord), 2) + 1)[1:-1, None]
    return (
        (2 * t**3 - 3 * t**2 + 1) * p
        + (t**3 - 2 * t**2 + t) * chord * u
        + (3 * t**2 - 2 * t**3) * q
        + (t**3 - t**2) * chord * v
    )


def bridge(junction: Junction, a: int, b: int, radius: float) -> np.ndarray:
    """Points (n, 2) of the least-energy bridge from port a to port b, without the ports."""
    positions, directions, _ = _flat_ports(junction, radius)
    points = cubic(positions[a], positions[b], directions[a], -directions[b])
    if junction.spine is not None:
        points = _Unrolled(junction.spine, radius).restore(points)
    return points
