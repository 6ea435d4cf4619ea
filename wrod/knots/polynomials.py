"""Jones polynomials of knot diagrams, in integers: Kauffman brackets.

Crossings are glued one after the other to a growing tangle (Bar-Natan 2007), so that the cost
follows the width of the diagram, not two to the power of its crossings.
"""

import numpy as np

# For each curve, the (crossing, over) pairs that it meets, in its own order.
Visits = tuple[tuple[tuple[int, bool], ...], ...]


def jones(visits: Visits, sign: np.ndarray) -> dict[float, int]:
    """Jones polynomial of a diagram."""
    corners, loops = _planar_diagram(visits, sign)
    # {how the open ends are joined: {power of A: coefficient}}
    states: dict[tuple, dict[int, int]] = {(): {0: 1}}
    for _ in range(loops):
        states = {ends: _times_loop(p) for ends, p in states.items()}
    waiting, seen = list(corners), set()
    while waiting:
        best = max(waiting, key=lambda four: len(seen.intersection(four)))
        waiting.remove(best)
        seen.symmetric_difference_update([label for label in set(best) if best.count(label) == 1])
        a, b, c, d = best
        glued: dict[tuple, dict[int, int]] = {}
        for ends, polynomial in states.items():
            for power, pairs in ((1, ((a, b), (c, d))), (-1, ((a, d), (b, c)))):
                joined, closed = _join(ends, pairs)
                term = {e + power: v for e, v in polynomial.items()}
                for _ in range(closed):
                    term = _times_loop(term)
                into = glued.setdefault(joined, {})
                for e, v in term.items():
                    into[e] = into.get(e, 0) + v
        states = glued
    bracket = {e: v for e, v in states[()].items() if v}
    bracket = _without_loop(bracket)
    writhe = int(sign.sum())
    odd = -1 if writhe % 2 else 1
    return {-(e - 3 * writhe) / 4: odd * v for e, v in sorted(bracket.items(), reverse=True) if v}


def _planar_diagram(visits: Visits, sign) -> tuple[list[tuple[int, int, int, int]], int]:
    """Edge labels around each crossing, counterclockwise from the under strand that comes in, and
    the number of curves without crossings."""
    around: dict[int, dict[str, int]] = {}
    label, loops = 0, 0
    for curve in visits:
        count = len(curve)
        loops += count == 0
        for k, (crossing, over) in enumerate(curve):
            strand = around.setdefault(crossing, {})
            side = "over" if over else "under"
            strand[f"{side} in"] = label + k
            strand[f"{side} out"] = label + (k + 1) % count
        label += count
    corners = []
    for crossing, strand in sorted(around.items()):
        # Looking along the under strand, a right-handed crossing's over strand goes to the right.
        right, left = ("over out", "over in")
        if sign[crossing] < 0:
            right, left = left, right
        corners.append((strand["under in"], strand[right], strand["under out"], strand[left]))
    return corners, loops


def _join(ends: tuple, pairs) -> tuple[tuple, int]:
    """Join open ends (pairs of labels) by further strands; returns the new pairs, and how many
    loops closed."""
    joined = list(ends)
    closed = 0
    for first, second in pairs:
        if first == second:
            closed += 1
            continue
        strand = [first, second]
        for side in (0, 1):
            for other in joined:
                if strand[side] in other:
                    joined.remove(other)
                    strand[side] = other[0] if other[1] == strand[side] else other[1]
                    break
            if strand[0] == strand[1]:
                closed += 1
                break
        else:
            joined.append((min(strand), max(strand)))
    return tuple(sorted(joined)), closed


def _times_loop(p: dict[int, int]) -> dict[int, int]:
    """Times -A^2 - A^-2, what a closed loop counts."""
    out: dict[int, int] = {}
    for e, v in p.items():
        for shift in (2, -2):
            out[e + shift] = out.get(e + shift, 0) - v
    return out


def _without_loop(p: dict[int, int]) -> dict[int, int]:
    """Divided by -A^2 - A^-2, which the bracket of any diagram allows."""
    rest, out = dict(p), {}
    while any(rest.values()):
        top = max(e for e, v in rest.items() if v)
        value = rest.pop(top)
        out[top - 2] = -value
        rest[top - 4] = rest.get(top - 4, 0) - value
    return out


def _product(p: dict[float, int], q: dict[float, int]) -> dict[float, int]:
    out: dict[float, int] = {}
    for a, x in p.items():
        for b, y in q.items():
            out[a + b] = out.get(a + b, 0) + x * y
    return {e: v for e, v in out.items() if v}


def _mirror(p: dict[float, int]) -> dict[float, int]:
    return {-e: v for e, v in p.items()}


def polynomial_text(p: dict[float, int]) -> str:
    """A polynomial in words, such as "1 t^1 + 1 t^3 - 1 t^4"."""
    terms = [f"{v:+d} t^{e:g}" for e, v in sorted(p.items())]
    return " ".join(terms) or "0"


def _table() -> dict[frozenset, str]:
    """Jones polynomials of the knots that have a name (KnotInfo; right hands here)."""
    trefoil = {1.0: 1, 3.0: 1, 4.0: -1}
    one_hand = {
        "trefoil": trefoil,
        "5_1": {2.0: 1, 4.0: 1, 5.0: -1, 6.0: 1, 7.0: -1},
        "5_2": {1.0: 1, 2.0: -1, 3.0: 2, 4.0: -1, 5.0: 1, 6.0: -1},
        "granny knot": _product(trefoil, trefoil),
        # Links; the powers belong to the orientation in which the linking number is positive.
        "Hopf link": {0.5: -1, 2.5: -1},
        "Solomon link": {1.5: -1, 3.5: -1, 4.5: 1, 5.5: -1},
    }
    table = {
        "unknot": {0.0: 1},
        "figure-eight": {-2.0: 1, -1.0: -1, 0.0: 1, 1.0: -1, 2.0: 1},
        "reef knot": _product(trefoil, _mirror(trefoil)),
        "unlink": {-0.5: -1, 0.5: -1},
    }
    for name, p in one_hand.items():
        table[f"right {name}"], table[f"left {name}"] = p, _mirror(p)
    # The same link with one curve reversed: t^(-3 lk) V, lk = 2 and -2.
    for hand, other, shift in (("right", "left", -6.0), ("left", "right", 6.0)):
        reversed_ = {e + shift: v for e, v in table[f"{hand} Solomon link"].items()}
        table[f"{other} Solomon link, antiparallel"] = reversed_
    whitehead = {-1.5: -1, -0.5: 1, 0.5: -2, 1.5: 1, 2.5: -2, 3.5: 1}
    table["Whitehead link"], table["mirrored Whitehead link"] = whitehead, _mirror(whitehead)
    return {frozenset(p.items()): name for name, p in table.items()}


KNOWN = _table()
