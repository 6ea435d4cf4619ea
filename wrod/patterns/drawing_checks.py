"""What a drawing must hold before its libraries read it: they have no bounds of their own."""

import math
import re
from collections import deque
from itertools import product
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from wrod.errors import PatternError
from wrod.files.markup import MAX_ELEMENTS, read_markup
from wrod.files.reading import shown

# Of a curve that is laid: a pattern has at most 20 000 points, and lies within 100 m.
MOST_NUMBERS, MOST_STROKES, LONGEST = 100_000, 2_000, 200.0
_LONG_ATTRIBUTE, _DEEPEST_BLOCK = 10_000, 50
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)")


def check_svg(path: Path) -> None:
    """Refuse an SVG file that is none, or that stands for more shapes than it holds.

    Raises:
        PatternError: names the element.
    """
    root = read_markup(path, "an SVG drawing", error=PatternError, deepest=100, entities=True)
    if _local(root.tag) != "svg":
        raise PatternError(f"{path}: its root element is <{root.tag}>, not <svg>; give a drawing")
    numbers = 0
    for element in root.iter():
        for name, value in element.attrib.items():
            if name in ("d", "points"):
                numbers += len(_NUMBER.findall(value))
            elif name in ("transform", "style", "viewBox") and len(value) > _LONG_ATTRIBUTE:
                raise PatternError(
                    f"{path}: a <{_local(element.tag)}> has a {name} of {len(value)} "
                    "letters; simplify the drawing"
                )
    if numbers > MOST_NUMBERS:
        raise PatternError(
            f"{path}: holds {numbers} coordinates; at most {MOST_NUMBERS} are read, so simplify "
            "the drawing"
        )
    _check_uses(root, path)


def _local(name: str) -> str:
    """A name without the prefix of its namespace."""
    return name.rpartition(":")[2]


def _check_uses(root: ElementTree.Element, path: Path) -> None:
    """Refuse references that lead back to themselves, or multiply."""
    named = {element.get("id"): element for element in root.iter() if element.get("id")}
    sizes: dict[int, float] = {}
    # Depth first, without recursion: (element, whether what is below it is counted).
    stack: list[tuple[ElementTree.Element, bool]] = [(root, False)]
    open_ones: set[int] = set()
    while stack:
        element, counted = stack.pop()
        below = list(element)
        if _local(element.tag) == "use":
            name = next((v for k, v in element.attrib.items() if _local(k) == "href" and v), "")
            target = named.get(name.removeprefix("#"))
            below += [] if target is None else [target]
        if counted:
            open_ones.discard(id(element))
            sizes[id(element)] = 1.0 + sum(sizes[id(one)] for one in below)
            continue
        if id(element) in sizes:
            continue
        open_ones.add(id(element))
        stack.append((element, True))
        for one in below:
            if id(one) in open_ones:
                raise PatternError(f"{path}: a <use> leads back to itself; redraw that shape")
            stack.append((one, False))
    if sizes[id(root)] > MAX_ELEMENTS:
        raise PatternError(
            f"{path}: its <use> elements stand for {sizes[id(root)]:.3g} shapes; at most "
            f"{MAX_ELEMENTS} are read"
        )


def check_dxf(document, path: Path) -> None:
    """Refuse a DXF document whose blocks stand for more shapes than any drawing has.

    Args:
        document: of ezdxf.

    Raises:
        PatternError: or a block holds itself, or is not there.
    """
    sizes: dict[str, float] = {}

    def size(name: str, above: tuple[str, ...]) -> float:
        if name in above or len(above) > _DEEPEST_BLOCK:
            raise PatternError(f"{path}: the block {shown(name)} holds itself; explode it")
        if name not in sizes:
            block = document.blocks.get(name)
            sizes[name] = 0.0 if block is None else shapes(block, (*above, name))
        return sizes[name]

    def shapes(layout, above: tuple[str, ...]) -> float:
        total = 0.0
        for entity in layout:
            times = 1.0
            if entity.dxftype() == "INSERT":
                rows, columns = entity.dxf.get("row_count", 1), entity.dxf.get("column_count", 1)
                times = max(abs(float(rows) * float(columns)), 1.0) * size(entity.dxf.name, above)
            total += times
        return total

    total = shapes(document.modelspace(), ())
    if total > MAX_ELEMENTS:
        raise PatternError(
            f"{path}: its blocks stand for {total:.3g} shapes; at most {MAX_ELEMENTS} are read"
        )


def check_stroke(points: np.ndarray, path: Path) -> np.ndarray:
    """Points (n, 2) [m] as they are.

    Raises:
        PatternError: one is not finite, or farther out than any table.
    """
    if not (np.abs(points) <= LONGEST).all():
        raise PatternError(
            f"{path}: a shape reaches farther than {LONGEST:g} m, or its numbers are not finite; "
            "check its coordinates and its transformations"
        )
    return points


def count_points(length: float, spacing: float, path: Path) -> int:
    """How many points a bent piece gets.

    Args:
        length: of the piece [m].
        spacing: of the points [m].

    Raises:
        PatternError: it is longer than any table.
    """
    if not length <= LONGEST:
        raise PatternError(
            f"{path}: a curve is {length:.3g} m long; a pattern lies within 100 m, so check the "
            "drawing's units"
        )
    return max(9, int(np.ceil(length / spacing)) + 1)


def chained(strokes: list[np.ndarray], near: float) -> list[np.ndarray]:
    """Strokes that meet end to end, as CAD programs write them, joined to one.

    Args:
        strokes: (n, 2) points of each.
        near: ends at less than this distance meet [m].
    """
    ends: dict[tuple[int, int], deque[tuple[int, bool]]] = {}

    def cell(point: np.ndarray) -> tuple[int, int]:
        return math.floor(point[0] / near), math.floor(point[1] / near)

    for k, stroke in enumerate(strokes):
        for last in (False, True):
            ends.setdefault(cell(stroke[-1 if last else 0]), deque()).append((k, last))
    used = [False] * len(strokes)

    def next_to(point: np.ndarray) -> np.ndarray | None:
        """An unused stroke that meets the point, turned so that it leaves from there."""
        x, y = cell(point)
        best = None
        for i, j in product((-1, 0, 1), repeat=2):
            here = ends.get((x + i, y + j), deque())
            while here and used[here[0][0]]:
                here.popleft()
            for k, last in here:
                if best is not None and k > best[0]:
                    break
                end = strokes[k][-1 if last else 0]
                if not used[k] and math.dist(end, point) < near:
                    best = (k, last)
                    break
        if best is None:
            return None
        k, last = best
        used[k] = True
        return strokes[k][::-1] if last else strokes[k]

    done = []
    for k, stroke in enumerate(strokes):
        if used[k]:
            continue
        used[k] = True
        after, before = [stroke], []
        while (found := next_to(after[-1][-1])) is not None:
            after.append(found)
        first = stroke
        while (found := next_to(first[0])) is not None:
            first = found[::-1]
            before.append(first)
        pieces = [*before[::-1], *after]
        done.append(np.concatenate([pieces[0], *(piece[1:] for piece in pieces[1:])]))
    return done
