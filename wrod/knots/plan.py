"""Knot plans: what is laid where, which moves tie it, and how it is pulled.

A plan is JSON, in metres, beside the files of its patterns:

    {"format": "wrod-knot-1", "name": "trefoil", "knot": "right trefoil",
     "rods": [{"rod": "pink-vps-thick", "pattern": "trefoil.csv"}],
     "steps": [[{"hand": 0, "rod": 0, "at": 0.3, "to": [0.03, -0.06], "lift": 0.05, "turn": 0}]],
     "pull": [{"rod": 0, "at": 0.01, "where": [x, y], "direction": [-1, 0], "distance": 0.1},
              {"rod": 0, "at": 0.8, "where": [x, y], "direction": [1, 1], "distance": 0.1}],
     "load": 0.3}

`at` is the arc length of what is grasped, from the end that is laid first; `to` where it is put, on
a way of height `lift`, let go at `lay_height` radii; `where` the place of the grasp if an earlier
move has put the rod there, by default the pattern's point at `at`.
The moves of one step are made at the same time, each by another hand. Pulls grasp the rod at
`where`; they end at `distance` or when both hands pull with `load` [N].
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from wrod import arguments
from wrod.errors import DataError
from wrod.files import read_json, schemas
from wrod.files.schemas import Move, Pull
from wrod.patterns.pattern import Pattern
from wrod.records import checked_fields
from wrod.rods.catalogue import rod
from wrod.rods.material import RodMaterial

_IS_RUN = arguments.like("a (pattern, rod)", "__len__", "__getitem__")
_IS_MOVE = arguments.like("a Move", "hand", "rod", "at", "to")


@checked_fields(
    DataError,
    rods=arguments.several(_IS_RUN),
    steps=arguments.several(arguments.several(_IS_MOVE), least=0),
    pull=arguments.several(arguments.like("a Pull", "rod", "at", "where"), least=0),
    load=arguments.number(above=0.0, high=1e6),
    rod_names=arguments.several(arguments.text, least=0),
)
@dataclass(frozen=True)
class KnotPlan:
    """A knot to tie.

    Attributes:
        name: of the plan.
        knot: what it shall be, as `wrod.knots.topology` names it.
        rods: (pattern, rod) in the order in which they are laid.
        steps: moves that are made at the same time, step by step.
        pull: one for each hand, or none.
        load: pull of both hands at which pulling ends [N].
        rod_names: what the rods are called.

    Raises:
        DataError: names what is wrong.
    """

    name: str
    knot: str
    rods: tuple[tuple[Pattern, RodMaterial], ...]
    steps: tuple[tuple[Move, ...], ...]
    pull: tuple[Pull, ...] = ()
    load: float = 0.3
    rod_names: tuple[str, ...] = ()

    @classmethod
    @arguments.checked(DataError)
    def load_plan(cls, path: str | os.PathLike[str]) -> KnotPlan:
        """Read a plan and its patterns.

        Raises:
            DataError: the file is missing or not such a plan; names the entry.
            PatternError: a pattern cannot be read.
        """
        path = Path(path)
        found = read_json(path, schemas.KnotPlan, "a knot plan")
        rods = tuple(
            (Pattern.load(path.parent / entry.pattern, smoothing=0.0), rod(entry.rod))
            for entry in found.rods
        )
        steps = tuple(map(tuple, found.steps))
        names = tuple(entry.rod for entry in found.rods)
        try:
            return cls(found.name, found.knot, rods, steps, tuple(found.pull), found.load, names)
        except DataError as reason:
            raise DataError(f"{path}: {reason}") from None

    def __post_init__(self) -> None:
        is_pattern = arguments.like("a wrod.Pattern", "sample", "length", "remainder_length")
        is_rod = arguments.like("a wrod.RodMaterial", "radius", "length", "gravito_bending_length")
        for k, run in enumerate(self.rods):
            pair = isinstance(run, (tuple, list)) and len(run) == 2
            if not pair or is_pattern(run[0]) or is_rod(run[1]):
                raise DataError(f"rod {k} is no (wrod.Pattern, wrod.RodMaterial)")
        object.__setattr__(self, "rods", tuple(map(tuple, self.rods)))
        object.__setattr__(self, "steps", tuple(map(tuple, self.steps)))
        for name in ("pull", "rod_names"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        self._check_moves()

    def _check_moves(self) -> None:
        if len(self.pull) not in (0, 2):
            raise DataError(f"pulls with {len(self.pull)} hands; give two, or none")
        for number, step in enumerate(self.steps):
            hands = [move.hand for move in step]
            if len(set(hands)) < len(hands) or not set(hands) <= {0, 1} or not hands:
                raise DataError(f"step {number} needs one move for each of hands 0 and 1")
        moves: list[Move | Pull] = [m for step in self.steps for m in step]
        for move in [*moves, *self.pull]:
            if not 0 <= move.rod < len(self.rods):
                raise DataError(f"a move names rod {move.rod}; there are {len(self.rods)}")
            if not 0.0 <= move.at <= self.rods[move.rod][1].length:
                raise DataError(f"a move grasps at {move.at:g} m, beyond the rod's ends")
