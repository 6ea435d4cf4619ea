"""Clean arms of the skeleton, and the junctions between them.

Where strands cross, touch or overlap, their skeleton is not theirs: it runs between them. Pixels
there are set aside; what remains are clean arms that end in ports around a junction.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from wrod.errors import PerceptionError
from wrod.perception.skeleton import Skeleton

# Lengths in units of the strand's radius, unless said otherwise.
CLEAN, SLACK = 1.18, 0.5  # a strand alone has at most this clearance: share of its own, plus [px]
MARGIN = 0.75  # cut off besides: next to where strands part the skeleton leans to the other one
MARGIN_FROM = 4.0  # arms shorter than this keep all that they have
WINDOW = 8.0  # over which the direction and curvature of an arm's end are fitted
ADOPTION = 7.0  # how far a junction looks for a free end that it lacks
# Of pieces of skeleton in all, and at one junction: with more it is no picture of rods, and pairing
# them takes minutes.
_MOST_CHAINS, _MOST_PORTS = 3_000, 200


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
    """Prune burrs, cut the arms back to where a strand runs alone, and group their ends.

    Raises:
        PerceptionError: there are more pieces, or more of them meet in one place, than rods make.
    """
    chains, clearance = skeleton.chains, skeleton.clearance
    refuse_a_texture(len(chains), _MOST_CHAINS, "pieces of line stand out of the background")
    inside = np.concatenate([c.pixels for c in chains if len(c.pixels)] or [np.zeros(0, int)])
    radius = float(np.median(clearance[inside])) if len(inside) else 0.0
    group = DisjointSet(skeleton.junctions.tolist())
    for a, b in skeleton.links.tolist():
        group.merge(a, b)

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
                group.merge(*ends)
            continue
        arms[number] = (first, last)
        for node, cut in zip(chain.nodes, (chain.pixels[:first], chain.pixels[last:]), strict=True):
            if node >= 0:
                loose[node].extend(cut.tolist())

    members: dict[int, Junction] = {}
    for junction in skeleton.junctions.tolist():
        root = members.setdefault(group[junction], Junction([], np.zeros(0, int)))
        root.pixels = np.concatenate([root.pixels, np.array(loose[junction], int)])
    network = Network(skeleton, arms, [], radius)
    for number in arms:
        chain = chains[number]
        if chain.closed:
            continue
        for side, node in enumerate(chain.nodes):
            port = _port(network, number, side)
            if node >= 0:
                members[group[node]].ports.append(port)
            else:
                network.free.append(port)
    for junction in members.values():
        if len(junction.ports) == 1:
            network.free.append(junction.ports[0])
        elif junction.ports:
            network.junctions.append(junction)
    _adopt_free_ends(network)
    most = max((len(junction.ports) for junction in network.junctions), default=0)
    refuse_a_texture(most, _MOST_PORTS, "pieces of line meet in one place")
    return network


def refuse_a_texture(count: int, most: int, what: str) -> None:
    """Raise a PerceptionError if there are more `what` than pictures of rods have."""
    if count > most:
        raise PerceptionError(
            f"{count} {what}, and {most} are the most that rods or strokes make; it is a texture "
            "or noise: crop the picture to the plain sheet or table, or blur it"
        )


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
