"""Junctions of the skeleton: which arms belong to the same strand.

Where strands cross, touch or overlap, their skeleton is not theirs: it runs between them. Pixels
there are set aside; what remains are clean arms that end in ports around a junction. Ports are
paired so that the bending energy of the bridges between them is least (mBEST, Choi et al. 2023),
here jointly for all ports of a junction, with strand ends that hide under another strand, with
stretches that two strands share, and with the mask as witness where the energies are close.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from wrod.perception.refine import arc_length, smooth
from wrod.perception.skeleton import Skeleton

# Energies are made dimensionless with the strand's radius r: E = r * integral of curvature^2.
HIDDEN_END = 1.5  # price of a strand end at a junction: a bridge that turns by some 70 degrees
SHARED_WIDTH = 1.3  # clearance of a visibly shared stretch, in units of one strand's
SHARED_PRICE = 0.15  # price of a shared stretch that looks like one strand, per strand radius
MISFIT = 0.03  # price of leaving bare or overshooting the whole shared patch of the mask
CLOSE = 4.0  # pairings within this factor of the best (and HIDDEN_END) call on the mask
LAYER = 2.0
DOUBT = 0.2
MARGIN, MARGIN_FROM = 0.75, 4.0
WINDOW = 8.0
SLACK = 0.5
CLEAN = 1.18  # a strand alone has at most this clearance, in units of its own
ADOPTION = 7.0  # how far a junction looks for a free end that it lacks, in strand radii
LARGEST_ENUMERATION = 8  # ports; beyond it the pairing is a minimum-weight matching


@dataclass
class Port:
    """End of a clean arm at a junction.

    Attributes:
        chain: index of the chain; side: 0 at its first, 1 at its last clean pixel.
        position: (2,) [px]; direction: (2,) unit tangent that points into the junction.
        curvature: signed, as seen when travelling into the junction [1/px].
    """

    chain: int
    side: int
    position: np.ndarray
    direction: np.ndarray
    curvature: float


@dataclass
class Junction:
    """Attributes:
    ports: arms that end here.
    pixels: skeleton pixels that belong to no single strand.
    spine: (n, 2) points of a stretch that two strands share, None at a plain junction.
    """

    ports: list[Port]
    pixels: np.ndarray
    spine: np.ndarray | None = None


@dataclass
class Network:
    """Clean arms and the junctions between them.

    Attributes:
        arms: chain index -> (first, last + 1) clean pixel of that chain.
        junctions: with at least one port each.
        radius: median strand half-width [px].
        free: ports whose side of the arm ends in no junction.
    """

    skeleton: Skeleton
    arms: dict[int, tuple[int, int]]
    junctions: list[Junction]
    radius: float
    free: list[Port] = field(default_factory=list)


def build_network(skeleton: Skeleton) -> Network:
    """Prune burrs, cut the arms back to where a strand runs alone, and group their ends."""
    chains, clearance = skeleton.chains, skeleton.clearance
    inside = np.concatenate([c.pixels for c in chains if len(c.pixels)] or [np.zeros(0, int)])
    radius = float(np.median(clearance[inside])) if len(inside) else 0.0
    group = _Groups(skeleton.junctions.tolist())
    for a, b in skeleton.links.tolist():
        group.join(a, b)

    arms, loose = {}, {j: [j] for j in skeleton.junctions.tolist()}
    for number, chain in enumerate(chains):
        if _is_burr(skeleton, chain, radius):
            continue
        first, last = (0, len(chain.pixels)) if chain.closed else _clean(skeleton, chain, radius)
        ends = [n for n in chain.nodes if n >= 0]
        if last - first < (2.0 * radius if len(ends) == 2 else 2):
            for node in ends:
                loose[node].extend(chain.pixels.tolist())
            if len(ends) == 2:
                group.join(*ends)
            continue
        arms[number] = (first, last)
        for node, cut in zip(chain.nodes, (chain.pixels[:first], chain.pixels[last:]), strict=True):
            if node >= 0:
                loose[node].extend(cut.tolist())

    members: dict[int, Junction] = {}
    for junction in skeleton.junctions.tolist():
        root = members.setdefault(group.find(junction), Junction([], np.zeros(0, int)))
        root.pixels = np.concatenate([root.pixels, np.array(loose[junction], int)])
    network = Network(skeleton, arms, [], radius)
    for number in arms:
        chain = chains[number]
        if chain.closed:
            continue
        for side, node in enumerate(chain.nodes):
            port = _port(network, number, side)
            if node >= 0:
                members[group.find(node)].ports.append(port)
            else:
                network.free.append(port)
    for junction in members.values():
        if len(junction.ports) == 1:
            network.free.append(junction.ports[0])
        elif junction.ports:
            network.junctions.append(junction)
    _adopt_free_ends(network)
    _share_stretches(network)
    return network


class _Groups:
    """Union-find over junction pixels."""

    def __init__(self, items):
        self.parent = {item: item for item in items}

    def find(self, item):
        while self.parent[item] != item:
            self.parent[item] = item = self.parent[self.parent[item]]
        return item

    def join(self, a, b):
        self.parent[self.find(a)] = self.find(b)


def _is_burr(skeleton: Skeleton, chain, radius: float) -> bool:
    """A free end that hardly leaves the disc of its junction is the outline's, not a strand's."""
    if chain.closed or (chain.nodes[0] < 0) == (chain.nodes[1] < 0):
        return False
    node = max(chain.nodes)
    away = np.hypot(*(skeleton.points[chain.pixels] - skeleton.points[node]).T)
    if away.max(initial=0.0) < skeleton.clearance[node] + 0.5 * radius + 1.5:
        return True
    outside = skeleton.clearance[chain.pixels][away > skeleton.clearance[node]]
    return bool(len(chain.pixels) < 4.0 * radius and outside.max(initial=0.0) < 0.7 * radius)


def _clean(skeleton: Skeleton, chain, radius: float) -> tuple[int, int]:
    """Range of pixels where the chain is the middle of one strand."""
    points, clearance = skeleton.points[chain.pixels], skeleton.clearance[chain.pixels]
    n = len(points)
    if n == 0:
        return 0, 0
    own = np.partition(clearance, n // 4)[n // 4]
    wide = clearance > CLEAN * own + SLACK
    limits = []
    for side, node in enumerate(chain.nodes):
        away = slice(None) if side == 0 else slice(None, None, -1)
        if node < 0:
            # The skeleton of an end bends towards a corner of it.
            limits.append(min(int(1.5 * radius), n // 3))
            continue
        offset = points[away] - skeleton.points[node]
        alone = (offset**2).sum(1) > (skeleton.clearance[node] + 1.0) ** 2
        alone &= ~wide[away]
        limits.append(int(alone.argmax()) if alone.any() else n)
    # Next to where strands part, the skeleton still leans towards the other one.
    spare = n - sum(limits) - int(MARGIN_FROM * radius)
    margin = int(np.clip(spare / 2, 0, MARGIN * radius))
    limits = [a + margin * (node >= 0) for a, node in zip(limits, chain.nodes, strict=True)]
    return limits[0], n - limits[1]


@lru_cache(maxsize=256)
def _end_fit(n: int) -> np.ndarray:
    """Weights (3, n) of a parabola's coefficients from the first of n points, least squares."""
    u = np.arange(n, dtype=float)
    order = 3 if n >= 8 else 2
    return np.pad(np.linalg.pinv(np.vander(u, order, increasing=True)), ((0, 3 - order), (0, 0)))


def _port(network: Network, number: int, side: int) -> Port:
    skeleton, (first, last) = network.skeleton, network.arms[number]
    pixels = skeleton.chains[number].pixels[first:last]
    if side:
        pixels = pixels[::-1]
    window = min(len(pixels), max(int(WINDOW * network.radius), 12))
    position, outward, bend = _end_fit(window) @ skeleton.points[pixels[:window]]
    speed = np.hypot(*outward)
    # Travelling the other way turns the sign of the curvature.
    curvature = 2.0 * (outward[1] * bend[0] - outward[0] * bend[1]) / speed**3
    return Port(number, side, position, -outward / speed, float(curvature))


def _adopt_free_ends(network: Network) -> None:
    """Give a junction that lacks an arm the free end that points at it across a narrow seam.

    Where a strand dives under another, shade may cut it off on one side.
    """
    for junction in network.junctions:
        if len(junction.ports) % 2 == 0 or not network.free:
            continue
        reach = np.array([port.position for port in network.free])
        middle = np.mean([port.position for port in junction.ports], axis=0)
        toward = middle - reach
        distance = np.hypot(*toward.T)
        aim = (toward * [port.direction for port in network.free]).sum(1) / distance
        near = (aim > 0.8) & (distance < ADOPTION * network.radius)
        if near.any():
            best = int(np.where(near, distance, np.inf).argmin())
            if all(port.chain != network.free[best].chain for port in junction.ports):
                junction.ports.append(network.free.pop(best))


# ------------------------------------------------------------------ stretches shared by two strands
def _share_stretches(network: Network) -> None:
    """Merge junctions with an odd number of ports along the arms between them.

    Strands that meet at a small angle merge into one arm. Alone, each of its junctions would have
    to end a strand; together they pair all their outer ports. Mergers are made while they lower
    the energy of the whole picture, the best first.
    """
    while True:
        odd = [j for j in network.junctions if len(j.ports) % 2]
        if len(odd) < 2:
            return
        trials = [_merged(network, route) for route in _routes_between(network, odd)]
        trials = [(gain, *rest) for gain, *rest in trials if gain > 0]
        if not trials:
            return
        _, joined, parts, shared = max(trials, key=lambda trial: trial[0])
        network.junctions = [j for j in network.junctions if all(j is not p for p in parts)]
        network.junctions.append(joined)
        for number in shared:
            del network.arms[number]


def _routes_between(network: Network, odd: list[Junction]) -> list[tuple[list, list]]:
    """(junctions, arms between them) from one odd junction to another, over at most one even."""
    home = {(p.chain, p.side): j for j in network.junctions for p in j.ports}
    routes = []
    for start in odd:
        for port in start.ports:
            middle = home.get((port.chain, 1 - port.side))
            if middle is None or middle is start:
                continue
            if len(middle.ports) % 2:
                if id(start) < id(middle):
                    routes.append(([start, middle], [port.chain]))
                continue
            for onward in middle.ports:
                end = home.get((onward.chain, 1 - onward.side))
                if end is None or end is start or end is middle or len(end.ports) % 2 == 0:
                    continue
                if onward.chain != port.chain and id(start) < id(end):
                    routes.append(([start, middle, end], [port.chain, onward.chain]))
    return routes


def _merged(network: Network, route: tuple[list, list]) -> tuple[float, Junction, list, list]:
    """Energy gained by merging the junctions of a route, and the merged junction."""
    parts, shared = route
    skeleton = network.skeleton
    stretches = [skeleton.chains[n].pixels[slice(*network.arms[n])] for n in shared]
    ports = [p for j in parts for p in j.ports if p.chain not in shared]
    pixels = np.concatenate([*(j.pixels for j in parts), *stretches])
    length = sum(map(len, stretches)) / network.radius
    spine = skeleton.points[stretches[0]] if len(shared) == 1 and length > 4.0 else None
    joined = Junction(ports, pixels, spine)
    alone = np.median(
        [np.median(skeleton.clearance[skeleton.chains[p.chain].pixels]) for p in ports]
    )
    narrow = sum(np.count_nonzero(skeleton.clearance[s] < SHARED_WIDTH * alone) for s in stretches)
    price = SHARED_PRICE * narrow / network.radius
    gain = sum(best_pairing(j, network.radius)[0] for j in parts)
    return gain - best_pairing(joined, network.radius)[0] - price, joined, parts, shared


# ------------------------------------------------------------------ bending energy of bridges
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


def bridge(junction: Junction, a: int, b: int, radius: float) -> np.ndarray:
    """Points (n, 2) of the least-energy bridge from port a to port b, without the ports."""
    positions, directions, _ = _flat_ports(junction, radius)
    p, q, u, v = positions[a], positions[b], directions[a], -directions[b]
    chord = np.hypot(*(q - p))
    n = max(int(chord), 2)
    t = np.linspace(0.0, 1.0, n + 1)[1:-1, None]
    points = (
        (2 * t**3 - 3 * t**2 + 1) * p
        + (t**3 - 2 * t**2 + t) * chord * u
        + (3 * t**2 - 2 * t**3) * q
        + (t**3 - t**2) * chord * v
    )
    if junction.spine is not None:
        points = _Unrolled(junction.spine, radius).restore(points)
    return points


# ------------------------------------------------------------------ the mask as witness
def resolve(network: Network, mask: np.ndarray) -> list[list[tuple[float, tuple]]]:
    """Ranked pairings of every junction, the chosen first.

    Where several pairings have nearly the same energy, each is drawn and charged for the part
    of the mask that it leaves bare and for what it covers beside the mask.
    """
    choices = []
    for junction in network.junctions:
        ranked = ranked_pairings(junction, network.radius)
        limit = CLOSE * ranked[0][0] + 0.5 * HIDDEN_END
        close = [item for item in ranked[:6] if item[0] <= limit]
        if len(close) > 1:
            charged = [
                (energy + MISFIT * misfit, pairs)
                for (energy, pairs), misfit in zip(
                    close, _misfits(network, junction, close, mask), strict=True
                )
            ]
            ranked = sorted(charged, key=lambda item: item[0]) + ranked[len(close) :]
        choices.append(ranked)
    return choices


def is_doubtful(network: Network, choices: list[list[tuple[float, tuple]]]) -> bool:
    """Whether some junction is not a plain crossing, or its next best pairing is hardly worse."""
    for junction, ranked in zip(network.junctions, choices, strict=True):
        if len(junction.ports) not in (2, 4) or junction.spine is not None:
            return True
        if len(ranked) > 1 and ranked[1][0] - ranked[0][0] < DOUBT:
            return True
    return not network.arms


def _misfits(network: Network, junction: Junction, close: list, mask: np.ndarray) -> list[float]:
    """Area where bridges and mask disagree around the junction, in units of radius^2."""
    import cv2

    skeleton, radius = network.skeleton, network.radius
    bridges = {
        pair: np.vstack(
            [
                junction.ports[pair[0]].position,
                bridge(junction, *pair, radius),
                junction.ports[pair[1]].position,
            ]
        )
        for pair in {pair for _, pairs in close for pair in pairs}
    }
    everything = np.vstack([skeleton.points[junction.pixels], *bridges.values()])
    pad = int(3 * radius) + 2
    low = np.maximum(np.floor(everything.min(0)).astype(int) - pad, 0)
    high = np.minimum(np.ceil(everything.max(0)).astype(int) + pad, mask.shape[1::-1])
    patch = mask[low[1] : high[1], low[0] : high[0]] > 0
    zone = np.zeros(patch.shape, np.uint8)
    for point, clearance in zip(
        skeleton.points[junction.pixels] - low, skeleton.clearance[junction.pixels], strict=True
    ):
        cv2.circle(zone, np.round(point).astype(int).tolist(), max(int(clearance), 1), 1, -1)
    zone = (zone > 0) & patch
    arms = np.zeros(patch.shape, np.uint8)
    thickness = max(round(2 * radius), 1)
    for port in junction.ports:
        first, last = network.arms[port.chain]
        pixels = skeleton.chains[port.chain].pixels[first:last]
        near = pixels[: int(4 * radius)] if port.side == 0 else pixels[-int(4 * radius) :]
        _draw(arms, skeleton.points[near] - low, thickness)
    drawn = {}
    for pair, points in bridges.items():
        drawn[pair] = np.zeros(patch.shape, np.uint8)
        _draw(drawn[pair], points - low, thickness)
    misfits = []
    extent = max(np.count_nonzero(zone), 1)
    for _, pairs in close:
        covered = arms > 0
        beside = 0
        for pair in pairs:
            covered |= drawn[pair] > 0
            beside += np.count_nonzero((drawn[pair] > 0) & ~patch)
        misfits.append((np.count_nonzero(zone & ~covered) + beside) / extent)
    return misfits


def _draw(canvas: np.ndarray, points: np.ndarray, thickness: int) -> None:
    import cv2

    line = np.round(points * 16).astype(np.int32)[:, None]
    cv2.polylines(canvas, [line], False, 1, thickness, shift=4)
