"""From paired ports to ordered strands: follow, bridge gaps, find the true ends."""

from dataclasses import dataclass

import numpy as np

from wrod.perception.bridges import bending_energy, bridge
from wrod.perception.network import Junction, Network

GAP = 6.0  # longest break of a strand that is bridged, in strand radii
GAP_ENERGY = 0.15  # largest bending energy of such a bridge (some 20 degrees at either side)
LOOP = 0.005  # most that is paid to dissolve a loop beside strands with ends


@dataclass
class Strand:
    """Raw course of a strand.

    Attributes:
        points: (n, 2) [px]; alone: (n,) bool, no other strand is near.
        closed: the last point is followed by the first.
    """

    points: np.ndarray
    alone: np.ndarray
    closed: bool


def link_strands(network: Network, choices: list[list[tuple[float, tuple]]]) -> list[Strand]:
    """Ordered strands of the whole picture.

    A junction's second-best pairing is taken where that dissolves a closed loop for less than
    `LOOP`: among curves with ends, a loop on its own is the rarer reading.
    """
    gaps = _gaps(network)
    chosen = [0] * len(choices)
    routes = _routes(network, choices, chosen, gaps)
    loops = sum(closed for _, closed in routes)
    while loops and loops < len(routes):
        trials = []
        for j, ranked in enumerate(choices):
            for k in range(1, min(len(ranked), 4)):
                rise = ranked[k][0] - ranked[chosen[j]][0]
                if chosen[j] == 0 and rise < LOOP:
                    trials.append((rise, j, k))
        for _, j, k in sorted(trials):
            trial = [*chosen]
            trial[j] = k
            rerouted = _routes(network, choices, trial, gaps)
            fewer = sum(closed for _, closed in rerouted)
            if fewer < loops:
                chosen, routes, loops = trial, rerouted, fewer
                break
        else:
            break
    return [_strand(network, route, closed) for route, closed in routes]


def _gaps(network: Network) -> list[Junction]:
    """Pairs of free ends that face each other across a short break of the mask."""
    free = network.free
    if len(free) < 2:
        return []
    # A free arm is cut back from its tip; both cuts belong to the distance.
    positions = np.array([p.position for p in free])
    directions = np.array([p.direction for p in free])
    energy = bending_energy(
        positions, directions, np.array([p.curvature for p in free]), network.radius
    )
    chord = positions[None] - positions[:, None]
    distance = np.hypot(*chord.transpose(2, 0, 1))
    facing = (chord * directions[:, None]).sum(-1) > 0
    allowed = facing & facing.T & (distance < (GAP + 5.0) * network.radius)
    allowed &= energy < GAP_ENERGY
    pairs = [tuple(pair) for pair in np.argwhere(np.triu(allowed, 1))]
    taken, gaps = set(), []
    for a, b in sorted(pairs, key=lambda pair: energy[pair] + 0.01 * distance[pair]):
        if taken.isdisjoint((a, b)) and free[a].chain != free[b].chain:
            taken.update((a, b))
            gaps.append(Junction([free[a], free[b]], np.zeros(0, int)))
    return gaps


def _routes(network, choices, chosen, gaps) -> list[tuple[list, bool]]:
    """Each strand as its sequence of (chain, side entered, junction to the next, ports there)."""
    onward = {}
    for junction, ranked, k in zip(network.junctions, choices, chosen, strict=True):
        for a, b in ranked[k][1]:
            _connect(onward, junction, a, b)
    for gap in gaps:
        _connect(onward, gap, 0, 1)
    routes, seen = [], set()

    def follow(chain, side):
        route = []
        while chain not in seen:
            seen.add(chain)
            step = onward.get((chain, 1 - side))
            route.append((chain, side, step))
            if step is None:
                return route, False
            port = step[0].ports[step[2]]
            chain, side = port.chain, port.side
        return route, True

    for number in network.arms:
        for side in (0, 1):
            closed = network.skeleton.chains[number].closed
            if number not in seen and not closed and (number, side) not in onward:
                routes.append(follow(number, side))
    for number in network.arms:
        if number in seen:
            continue
        if network.skeleton.chains[number].closed:
            seen.add(number)
            routes.append(([(number, 0, None)], True))
        else:
            routes.append(follow(number, 0))
    return routes


def _connect(onward: dict, junction: Junction, a: int, b: int) -> None:
    for here, there in ((a, b), (b, a)):
        port = junction.ports[here]
        onward[port.chain, port.side] = (junction, here, there)


def _strand(network: Network, route: list, closed: bool) -> Strand:
    pieces, alone = [], []
    for chain, side, step in route:
        first, last = network.arms[chain]
        pixels = network.skeleton.chains[chain].pixels[first:last]
        pieces.append(network.skeleton.points[pixels[::-1] if side else pixels])
        alone.append(np.ones(len(pixels), bool))
        if step is not None:
            junction, here, there = step
            pieces.append(bridge(junction, here, there, network.radius))
            alone.append(np.zeros(len(pieces[-1]), bool))
    return Strand(np.vstack(pieces), np.concatenate(alone), closed)
