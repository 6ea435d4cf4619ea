"""Alexander and Jones polynomials of knot diagrams, in integers.

The Alexander polynomial is a minor of the matrix of Fox derivatives, evaluated modulo a prime at
as many points as it has coefficients. The Jones polynomial is the Kauffman bracket: crossings are
glued one after the other to a growing tangle (Bar-Natan 2007), so that the cost follows the width
of the diagram, not two to the power of its crossings.
"""

import numpy as np

# For each curve, the (crossing, over) pairs that it meets, in its own order.
Visits = tuple[tuple[tuple[int, bool], ...], ...]
# Products of two residues fit into 64 bits; coefficients must stay below half of it.
_PRIME = 2**31 - 1


def alexander(visits: Visits, sign: np.ndarray) -> dict[int, int]:
    """Alexander polynomial in one variable of a diagram (`wrod.knots.topology.Diagram`)."""
    arcs, rows = 0, {}
    whole = False
    for curve in visits:
        under = [k for k, (_, over) in enumerate(curve) if not over]
        if not under:  # passes over everything: its arc has no end
            whole = True
            for crossing, _ in curve:
                rows.setdefault(crossing, {})["over"] = arcs
            arcs += 1
            continue
        first = arcs
        for step in range(len(curve)):
            crossing, over = curve[(under[0] + 1 + step) % len(curve)]
            row = rows.setdefault(crossing, {})
            if over:
                row["over"] = arcs
            else:
                row["in"] = arcs
                arcs += 1
                row["out"] = arcs if arcs < first + len(under) else first
    if whole and len(visits) > 1:
        return {}  # lies above the others: they are not linked
    count = len(rows)
    if count < 2:
        return {0: 1}
    points = np.arange(2, count + 2)
    matrix = np.zeros((len(points), count, count), dtype=np.int64)
    for number, (crossing, row) in enumerate(sorted(rows.items())):
        into, out = ("in", "out") if sign[crossing] > 0 else ("out", "in")
        matrix[:, number, row["over"]] += 1 - points
        matrix[:, number, row[into]] += points
        matrix[:, number, row[out]] -= 1
    values = _determinants(matrix[:, 1:, 1:] % _PRIME)
    return _normalised(_interpolate(points, values))


def _determinants(matrix: np.ndarray) -> list[int]:
    """Determinants modulo the prime of (k, n, n) residues."""
    m = matrix.copy()
    k, n, _ = m.shape
    result = np.ones(k, dtype=np.int64)
    every = np.arange(k)
    for c in range(n):
        pivot = c + np.argmax(m[:, c:, c] != 0, axis=1)
        swapped = pivot != c
        m[every, c], m[every, pivot] = m[every, pivot].copy(), m[every, c].copy()
        value = m[:, c, c]
        result = result * value % _PRIME
        result = np.where(swapped, (_PRIME - result) % _PRIME, result)
        inverse = np.array([pow(int(v), -1, _PRIME) if v else 0 for v in value])
        factor = m[:, c + 1 :, c] * inverse[:, None] % _PRIME
        m[:, c + 1 :] = (m[:, c + 1 :] - factor[:, :, None] * m[:, None, c] % _PRIME) % _PRIME
    return [int(v) for v in result]


def _interpolate(points, values: list[int]) -> list[int]:
    """Coefficients, of smallest size modulo the prime, of the polynomial through the points."""
    points = [int(x) for x in points]
    divided = list(values)
    for order in range(1, len(points)):
        for k in range(len(points) - 1, order - 1, -1):
            gap = pow(points[k] - points[k - order], -1, _PRIME)
            divided[k] = (divided[k] - divided[k - 1]) * gap % _PRIME
    out = [0]
    for x, value in zip(points[::-1], divided[::-1], strict=True):
        shifted = [0, *out]
        out = [(s - x * o) % _PRIME for s, o in zip(shifted, [*out, 0], strict=True)]
        out[0] = (out[0] + value) % _PRIME
    return [c - _PRIME if c > _PRIME // 2 else c for c in out]


def _normalised(coefficients: list[int]) -> dict[int, int]:
    present = [k for k, c in enumerate(coefficients) if c]
    if not present:
        return {}
    sign = 1 if coefficients[present[0]] > 0 else -1
    return {k - present[0]: sign * coefficients[k] for k in present}


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


def polynomial_text(p: dict[float, int], variable: str = "t") -> str:
    """A polynomial in words, such as "1 t^1 + 1 t^3 - 1 t^4"."""
    terms = [f"{v:+d} {variable}^{e:g}" for e, v in sorted(p.items())]
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
    # The same link with one curve reversed: t^(-3 lk) V, lk = 1 and 2.
    for hand, other in (("right", "left"), ("left", "right")):
        for name, linking in (("Solomon link", 2),):
            shift = -3.0 * linking if hand == "right" else 3.0 * linking
            reversed_ = {e + shift: v for e, v in table[f"{hand} {name}"].items()}
            table[f"{other} {name}, antiparallel"] = reversed_
    whitehead = {-1.5: -1, -0.5: 1, 0.5: -2, 1.5: 1, 2.5: -2, 3.5: 1}
    table["Whitehead link"], table["mirrored Whitehead link"] = whitehead, _mirror(whitehead)
    return {frozenset(p.items()): name for name, p in table.items()}


KNOWN = _table()
