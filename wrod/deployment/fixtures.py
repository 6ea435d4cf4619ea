"""Fixtures on the table: posts and clips, between which a cable is to be laid.

A scene file is JSON, in metres, in the pattern's frame; z = 0 is the table:

    {"format": "wrod-fixtures-1", "name": "U",
     "fixtures": [
       {"name": "left", "cylinder": {"center": [0, 0.02, 0], "radius": 0.005, "height": 0.006}},
       {"name": "right", "box": {"center": [0, -0.02, 0], "size": [0.02, 0.01, 0.006], "yaw": 0}}],
     "gates": [["left", "right"]], "note": "why they stand there"}

Fixtures stand on their `center` and rise by their height (a box's third size); yaw is in degrees.
A gate is the gap between two fixtures, named as they stand to the left and to the right of the
cable, and gates are listed in the order in which the cable passes them.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wrod import arguments
from wrod.errors import SceneError
from wrod.files import read_json, schemas, write_atomically
from wrod.files.reading import shown
from wrod.patterns.pattern import Pattern
from wrod.records import checked_fields
from wrod.solvers.solids import Box, Cylinder, Plane

_FORMAT = "wrod-fixtures-1"
# A rod is at rest if no part of it is faster [m/s].
_STILL = 1e-3
_IS_FIXTURE = arguments.like("a Fixture", "name", "shape")
_IS_GATE = arguments.several(arguments.text, least=2)


@checked_fields(SceneError, shape=arguments.like("a Cylinder or Box", "center", "_describe"))
@dataclass(frozen=True)
class Fixture:
    """A post or the wall of a clip.

    Attributes:
        name: what gates call it.
        shape: a `Cylinder` (upright) or `Box` [m].
    """

    name: str
    shape: Box | Cylinder

    @property
    def top(self) -> float:
        """Height of its upper end above the table [m]."""
        return self.shape.center[2] + self._half

    @property
    def _half(self) -> float:
        """Of its height [m]."""
        shape = self.shape
        return shape.half_height if isinstance(shape, Cylinder) else shape.half_size[2]

    @property
    def yaw(self) -> float:
        """Rotation of a box about the vertical [rad]."""
        if isinstance(self.shape, Cylinder):
            return 0.0
        _, _, z, w = self.shape.rotation
        return 2.0 * math.atan2(z, w)


@dataclass(frozen=True)
class GatesPassed:
    """Whether a cable lies between the fixtures.

    Attributes:
        gates: (gate,) whether it passes each gate, once, from the right side and below the tops.
        order: whether it passes the gates in their order.
        still: whether it is at rest.
        placed: all of it.
    """

    gates: np.ndarray
    order: bool
    still: bool = True

    @property
    def placed(self) -> bool:
        return bool(self.gates.all() and self.order and self.still)

    def __str__(self) -> str:
        if self.placed:
            return f"between the fixtures of all {len(self.gates)} gates"
        missed = ", ".join(str(k + 1) for k in np.flatnonzero(~self.gates))
        if missed:
            return f"not in gate {missed}"
        return "gates passed out of order" if not self.order else "still moving"


@dataclass(frozen=True)
class Fixtures:
    """All fixtures of a scene, and its gates.

    Attributes:
        items: the fixtures.
        gates: pairs of names (left, right), in the order in which the cable passes them.
        name: of the scene.
        note: where it comes from.
    """

    items: tuple[Fixture, ...]
    gates: tuple[tuple[str, str], ...] = ()
    name: str = "fixtures"
    note: str = ""

    def __post_init__(self) -> None:
        arguments.check_fields(
            self, SceneError, items=arguments.several(_IS_FIXTURE, least=0),
            gates=arguments.several(_IS_GATE, least=0), name=arguments.text, note=arguments.text,
        )  # fmt: skip
        object.__setattr__(self, "items", tuple(self.items))
        object.__setattr__(self, "gates", tuple(map(tuple, self.gates)))
        names = [item.name for item in self.items]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise SceneError(f"{self.name}: fixture {min(twice)!r:.80} is named twice")
        for gate in self.gates:
            for name in gate:
                if name not in names:
                    raise SceneError(
                        f"{self.name}: gate {shown(list(gate))} names {name!r:.80}, which is no "
                        "fixture"
                    )

    @property
    def shapes(self) -> tuple:
        """What rods touch: the table and the fixtures."""
        return (Plane(), *(item.shape for item in self.items))

    @classmethod
    @arguments.checked(SceneError)
    def load(cls, path: str | os.PathLike[str]) -> Fixtures:
        """Read a scene file.

        Raises:
            SceneError: the file is missing or not such a scene; names the fixture.
        """
        path = Path(path)
        found = read_json(path, schemas.Fixtures, "a scene of fixtures", error=SceneError)
        items = tuple(
            _fixture(entry, f"{path}: fixture {k}") for k, entry in enumerate(found.fixtures)
        )
        name = path.stem if found.name is None else found.name
        try:
            return cls(items, tuple(found.gates), name, found.note)
        except SceneError as error:
            raise SceneError(f"{path}: {error}") from None

    @classmethod
    @arguments.checked(
        SceneError,
        stations=arguments.array((None,)),
        gap=arguments.array((), (None,)),
        radius=arguments.number(above=0.0, high=100.0),
        height=arguments.number(above=0.0, high=100.0),
    )
    def along(
        cls,
        pattern: Pattern,
        stations: np.ndarray,
        *,
        gap: float | np.ndarray,
        radius: float = 0.005,
        height: float = 0.008,
        name: str | None = None,
    ) -> Fixtures:
        """A pair of posts on both sides of a pattern at each station.

        Args:
            pattern: the cable's way.
            stations: (n,) arc lengths [m].
            gap: (n,) clear width between the posts of each pair [m].
            radius, height: of the posts [m].
        """
        position, tangent, _ = pattern.sample(np.asarray(stations, dtype=float))
        gap = np.asarray(gap, dtype=float)
        if gap.shape not in ((), (len(position),)) or not (gap > 0.0).all():
            raise SceneError(
                f"gap is {gap.tolist()!r:.80}; give a positive width, or one for each of the "
                f"{len(position)} stations"
            )
        gap = np.broadcast_to(gap, (len(position),))
        items, gates = [], []
        for k, (point, along) in enumerate(zip(position, tangent, strict=True)):
            side = np.array([-along[1], along[0]]) * (gap[k] / 2 + radius)
            names = (f"{k + 1}-left", f"{k + 1}-right")
            for label, sign in zip(names, (1.0, -1.0), strict=True):
                x, y = np.round(point[:2] + sign * side, 5)
                post = Cylinder((float(x), float(y), height / 2), radius, height / 2)
                items.append(Fixture(label, post))
            gates.append(names)
        return cls(tuple(items), tuple(gates), name or pattern.name)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write a scene file that `load` reads."""
        entries = []
        for item in self.items:
            shape = item.shape
            x, y, z = (float(v) for v in shape.center)
            what: dict = {"center": [x, y, round(z - item._half, 9)]}
            if isinstance(shape, Cylinder):
                kind, what["radius"], what["height"] = "cylinder", shape.radius, 2 * item._half
            else:
                kind, what["size"] = "box", [2 * v for v in shape.half_size]
                what["yaw"] = math.degrees(item.yaw)
            entries.append({"name": item.name, kind: what})

        def write(file):
            note = {"note": self.note} if self.note else {}
            head = json.dumps({"format": _FORMAT, "name": self.name, **note})[:-1]
            rows = ",\n  ".join(json.dumps(entry) for entry in entries)
            gates = ", ".join(json.dumps(gate) for gate in self.gates)
            file.write(f'{head},\n "fixtures": [\n  {rows}],\n "gates": [{gates}]}}\n')

        return write_atomically(path, write)

    @arguments.checked(
        SceneError,
        centerline=arguments.array((None, 3)),
        radius=arguments.number(above=0.0, high=100.0),
        speed=arguments.number(0.0),
    )
    def judge(self, centerline: np.ndarray, radius: float, speed: float = 0.0) -> GatesPassed:
        """Whether a rod lies between the fixtures, and stays there.

        It passes a gate if its centreline, seen from above, crosses the line between the two
        fixtures exactly once, with the left fixture to its left, and if the rod's middle is there
        below both tops. It stays if no part of it moves faster than 1 mm/s.

        Args:
            centerline: (node, 3), z from the height at which a rod rests on the table [m].
            radius: of the rod [m].
            speed: of its fastest part [m/s].
        """
        centerline = np.asarray(centerline)  # of Warp, it may be
        by_name = {item.name: item for item in self.items}
        passed, places = [], []
        for names in self.gates:
            left, right = (by_name[name] for name in names)
            at = _passes(
                centerline, np.array(left.shape.center[:2]), np.array(right.shape.center[:2])
            )
            low = min(left.top, right.top)
            good = len(at) == 1 and at[0][1] > 0 and at[0][2] + radius < low
            passed.append(good)
            places.append(at[0][0] if at else -1.0)
        gates = np.array(passed, dtype=bool)
        through = np.array(places)[gates] if len(gates) else np.zeros(0)
        return GatesPassed(gates, bool((np.diff(through) > 0).all()), speed < _STILL)


def _passes(line: np.ndarray, left: np.ndarray, right: np.ndarray) -> list[tuple]:
    """(place along the line in nodes, +1 if `left` is to its left, height) of each crossing of the
    segment between two points, seen from above."""
    start, step = line[:-1, :2], np.diff(line[:, :2], axis=0)
    across = right - left
    area = step[:, 0] * across[1] - step[:, 1] * across[0]
    gap = left - start
    safe = np.where(area == 0.0, 1.0, area)
    a = (gap[:, 0] * across[1] - gap[:, 1] * across[0]) / safe
    b = (gap[:, 0] * step[:, 1] - gap[:, 1] * step[:, 0]) / safe
    hit = (area != 0.0) & (a >= 0.0) & (a < 1.0) & (b > 0.0) & (b < 1.0)
    height = line[:-1, 2] + a * np.diff(line[:, 2])
    return [(k + a[k], -int(np.sign(area[k])), height[k]) for k in np.flatnonzero(hit)]


def _fixture(entry: schemas.Fixture, where: str) -> Fixture:
    if (entry.cylinder is None) == (entry.box is None):
        raise SceneError(f"{where} ({entry.name}): give either 'cylinder' or 'box'")
    if entry.cylinder is not None:
        (x, y, z), half = entry.cylinder.center, entry.cylinder.height / 2
        return Fixture(entry.name, Cylinder((x, y, z + half), entry.cylinder.radius, half))
    x, y, z = entry.box.center
    width, depth, height = entry.box.size
    half = (width / 2, depth / 2, height / 2)
    turn = math.radians(entry.box.yaw) / 2
    rotation = (0.0, 0.0, math.sin(turn), math.cos(turn))
    return Fixture(entry.name, Box((x, y, z + half[2]), half, rotation))
