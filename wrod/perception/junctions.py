"""Which arms belong to the same strand, over the whole picture.

Junctions are merged along stretches that two strands share, each is paired for least bending
energy, and where energies are close the mask is the witness.
"""

import numpy as np

from wrod.perception.bridges import HIDDEN_END, best_pairing, bridge, ranked_pairings
from wrod.perception.network import Junction, Network

# Energies as in `bridges`.
SHARED_WIDTH = 1.3  # clearance of a visibly shared stretch, in units of one strand's
SHARED_PRICE = 0.15  # price of a shared stretch that looks like one strand, per strand radius
MISFIT = 0.03  # price of leaving bare, or of overshooting, the junction's whole patch of the mask
CLOSE = 4.0  # pairings within this factor of the best (and HIDDEN_END) call on the mask
DOUBT = 0.2  # lead over the next best pairing below which a junction is doubtful


def share_stretches(network: Network) -> None:
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
        trials = [trial for trial in trials if trial[0] > 0]
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
        (a, b): np.vstack(
            [junction.ports[a].position, bridge(junction, a, b, radius), junction.ports[b].position]
        )
        for a, b in {pair for _, pairs in close for pair in pairs}
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
    extent = max(int(np.count_nonzero(zone)), 1)
    for _, pairs in close:
        covered = arms > 0
        beside = 0
        for pair in pairs:
            covered |= drawn[pair] > 0
            beside += np.count_nonzero((drawn[pair] > 0) & ~patch)
        misfits.append(float((np.count_nonzero(zone & ~covered) + beside) / extent))
    return misfits


def _draw(canvas: np.ndarray, points: np.ndarray, thickness: int) -> None:
    import cv2

    line = np.round(points * 16).astype(np.int32)[:, None]
    cv2.polylines(canvas, [line], False, 1, thickness, shift=4)
