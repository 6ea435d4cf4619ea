"""How the house is laid out, out of the code's own imports: `python tests/house.py [FOLDER]`.

A room is a folder directly below `wrod`, a module that lies loose there, or one of `kernels`,
`training`, `scenes`. An arrow runs from a room to one that it imports, wherever in the file the
import stands. Rooms stand on the floor above the highest that they import.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

FOLDERS = {"wrod": "wrod", "kernels": "wrod.kernels", "training": "wrod.training",
           "scenes": "wrod.scenes"}  # fmt: skip
# What is counted as lines of the library, and what may have long functions.
COUNTED, KERNELS = ("wrod", "kernels", "training"), "wrod.kernels"
LONGEST, MOST_PARAMETERS = 80, 12
BEFORE = "21906267"  # the last commit without rooms


@dataclass
class House:
    """The files of a checkout by their modules, and what each imports of the others."""

    trees: dict[str, ast.Module]
    lines: dict[str, int]
    imports: dict[str, set[str]]
    long: list[tuple[str, int]]
    wide: list[tuple[str, int]]

    @property
    def file_circles(self) -> list[list[str]]:
        return circles(self.imports)

    @property
    def rooms(self) -> dict[str, set[str]]:
        """Room to the rooms that it imports."""
        out: dict[str, set[str]] = {room(m): set() for m in self.lines}
        for module, others in self.imports.items():
            out[room(module)] |= {room(o) for o in others} - {room(module)}
        return out


def room(module: str) -> str:
    return ".".join(module.split(".")[:2])


def read(folder: Path) -> House:
    """The house in a checkout."""
    trees: dict[str, ast.Module] = {}
    house = House(trees, {}, {}, [], [])
    for name, package in FOLDERS.items():
        for file in sorted((folder / name).rglob("*.py")):
            parts = [package, *file.relative_to(folder / name).with_suffix("").parts]
            module = ".".join(parts).removesuffix(".__init__")
            text = file.read_text()
            if name in COUNTED:
                house.lines[module] = text.count("\n")
            if module != "wrod":  # the face hands on names of everybody
                trees[module] = ast.parse(text)
    for module, tree in trees.items():
        house.lines.setdefault(module, 0)
        house.imports[module] = {o for o in _imported(tree, trees) if o != module}
        _measure(module, tree, house)
    return house


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """Everything below a node but expressions, in which nothing is imported or defined."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.stmt, ast.excepthandler, ast.match_case)):
            yield child
            yield from _statements(child)


def _imported(tree: ast.Module, known) -> set[str]:
    out = set()
    for node in _statements(tree):
        if isinstance(node, ast.Import):
            out |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                out.add(whole if whole in known else node.module)
    return out & set(known)


def _measure(module: str, tree: ast.Module, house: House) -> None:
    for node in _statements(tree):
        if not isinstance(node, ast.FunctionDef) or module.startswith(KERNELS):
            continue
        a = node.args
        count = sum(p.arg not in ("self", "cls") for p in a.posonlyargs + a.args + a.kwonlyargs)
        if node.end_lineno - node.lineno + 1 > LONGEST:
            house.long.append((f"{module}.{node.name}", node.end_lineno - node.lineno + 1))
        stub = len(node.body) == 1 and isinstance(node.body[0], ast.Expr)  # for type checkers only
        if count > MOST_PARAMETERS and not stub:
            house.wide.append((f"{module}.{node.name}", count))


def circles(imports: dict[str, set[str]]) -> list[list[str]]:
    """Groups that import each other in a loop (strongly connected components)."""
    names = list(imports)
    number = {name: k for k, name in enumerate(names)}
    pairs = [(number[a], number[b]) for a in names for b in imports[a] if b in number]
    graph = coo_matrix((np.ones(len(pairs)), np.reshape(pairs, (-1, 2)).T), shape=[len(names)] * 2)
    count, label = connected_components(graph, connection="strong")
    groups = [[names[k] for k in np.flatnonzero(label == g)] for g in range(count)]
    return sorted(sorted(group) for group in groups if len(group) > 1)


def arrows_up(rooms: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Arrows that have to go for the rooms to stand on floors: of each circle, those against the
    order in which the room with most arrows out over arrows in comes first."""
    out = []
    for group in circles(rooms):
        inside = {a: {b for b in rooms[a] if b in group} for a in group}
        order: list[str] = []
        while len(order) < len(group):
            left = {a for a in group if a not in order}
            gain = {a: len(inside[a] & left) - sum(a in inside[b] for b in left) for a in left}
            order.append(max(sorted(left), key=gain.__getitem__))
        out += [(a, b) for a in group for b in inside[a] if order.index(b) < order.index(a)]
    return out


def floors(rooms: dict[str, set[str]]) -> dict[str, int]:
    """Floor of every room, arrows up left out."""
    up = set(arrows_up(rooms))
    down = {a: {b for b in others if (a, b) not in up} for a, others in rooms.items()}
    floor: dict[str, int] = defaultdict(int)

    def stand(a: str) -> int:
        if not floor[a]:
            floor[a] = 1 + max((stand(b) for b in down[a]), default=0)
        return floor[a]

    return {a: stand(a) for a in rooms}


def figures(house: House) -> dict[str, int]:
    rooms = house.rooms
    return {
        "rooms": len(rooms),
        "floors": max(floors(rooms).values()),
        "arrows": sum(map(len, rooms.values())),
        "arrows up": len(arrows_up(rooms)),
        "circles of rooms": len(circles(rooms)),
        "circles of files": len(house.file_circles),
        "files": sum(n > 0 for n in house.lines.values()),
        "lines": sum(house.lines.values()),
        f"files over {LONGEST * 5} lines": sum(n > LONGEST * 5 for n in house.lines.values()),
        f"functions over {LONGEST} lines outside kernels": len(house.long),
        f"functions with over {MOST_PARAMETERS} parameters outside kernels": len(house.wide),
    }


def shortened(folder: Path) -> dict[str, int]:
    """By how many lines the commits since BEFORE shortened the library that did so; what moved to
    tests, examples or documents is not counted. Nothing where the history is not there."""
    command = ("git", "-C", str(folder), "log", "--no-merges", "--no-renames", "--numstat")
    asked = [*command, "--format=tformat:@", f"{BEFORE}..", "--", "*.py"]
    try:
        log = subprocess.run(asked, capture_output=True, text=True, check=False)
    except FileNotFoundError:  # no git
        return {}
    fewer = []
    for commit in log.stdout.split("@\n")[1:]:
        rows = [line.split("\t") for line in commit.split("\n") if line]
        taken = [(int(gone) - int(come), file) for come, gone, file in rows]
        inside = sum(n for n, file in taken if file.startswith(tuple(f"{f}/" for f in COUNTED)))
        fewer.append(max(0, min(inside, sum(n for n, _ in taken))))
    return {f"fewer lines, by {np.count_nonzero(fewer)} commits": sum(fewer)} if fewer else {}


if __name__ == "__main__":
    root = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    seen = read(root)
    for what, number in (figures(seen) | shortened(root)).items():
        print(f"{what:<50} {number:>7}")
    for a, b in arrows_up(seen.rooms):
        print(f"up: {a} -> {b}")
    for group in seen.file_circles:
        print("circle:", ", ".join(group))
    for name, count in sorted(seen.long + seen.wide, key=lambda x: -x[1]):
        print(f"{count:>5}  {name}")
