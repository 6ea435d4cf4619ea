"""Trials of a knot: what disturbs one, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wrod import arguments
from wrod.deployment.setup import Disturbance
from wrod.errors import RodError
from wrod.knots.fingers import PAD_FRICTION
from wrod.knots.topology import Recognition
from wrod.records import checked_fields

# Part of a rod's random closures that has to show its knot: ends that lie inside a loop make it a
# matter of the closure.
CLEAR = 0.75
# And once it is pulled: a tight knot turns the ends of its rods about each other, and closures that
# pass on the other side of a turned end show a knot of more crossings. Those of rods that have come
# apart all show none, and those of a granny never a reef knot.
STILL = 0.2


@checked_fields(
    RodError,
    laying=arguments.several(arguments.like("a wrod.Disturbance", "jitter", "offset"), least=0),
    offset=arguments.array((2, 3)),
    jitter=arguments.number(0.0, 1e3),
    pad_friction=arguments.several(arguments.number(0.0, 100.0), least=0),
    seed=arguments.whole(),
)
@dataclass(frozen=True)
class Handling:
    """What distinguishes the handling of one trial from the next; the default is none.

    Attributes:
        laying: disturbance of the laying of each rod, one after the other.
        offset: (2, 3) by which each hand misses its place; fingertips that would go below the
            table stop on it [m].
        jitter: standard deviation of each coordinate of the hands' shaking [m].
        pad_friction: (n,) friction of the fingertips on the rod, one grasp after the other, which
            decides when it slips out (`wrod.knots.fingers.holding_force`); empty: it never does.
        seed: of the shaking.
    """

    laying: tuple[Disturbance, ...] = ()
    offset: tuple = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    jitter: float = 0.0
    pad_friction: tuple[float, ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        offset = np.asarray(self.offset, dtype=float).tolist()
        for name, value in (("laying", self.laying), ("pad_friction", self.pad_friction)):
            object.__setattr__(self, name, tuple(value))
        object.__setattr__(self, "offset", tuple(map(tuple, offset)))

    @classmethod
    @arguments.checked(RodError, seed=arguments.whole())
    def random(cls, seed: int) -> Handling:
        """A trial of a careful laboratory: laying as `Disturbance.random`, hands placed within
        1 mm (standard deviation of each coordinate), jitter 0.3 mm, friction of the fingertips
        log-normal about 0.55 with a deviation of 30 %."""
        seed = int(seed)  # a narrow one of NumPy would overflow below
        rng = np.random.default_rng([seed, 7])
        return cls(
            tuple(Disturbance.random(1000 + 10 * seed + k) for k in range(2)),
            tuple(map(tuple, 1e-3 * rng.standard_normal((2, 3)))),
            0.3e-3,
            tuple(PAD_FRICTION * np.exp(0.3 * rng.standard_normal(12))),
            seed,
        )


@dataclass
class TyingResult:
    """One trial. SI units, the table at z = 0.

    Attributes:
        laid, tied: the knot of the rods after laying, and after the moves.
        tight: when both hands first pulled with the plan's load; None if they never did.
        pulled: at the end, after they kept up that pull, or as tied if that was not the knot.
        wanted: the knot that the plan promises.
        load: (hand,) pull at the end [N].
        strongest: largest pull that both hands came to [N].
        crept: way that the hands went while they kept up the pull, both together: how far the knot
            gave [m].
        held: the pull was reached, kept up for `wrod.knots.pull.HOLD` seconds, and the knot gave
            less than `wrod.knots.pull.CREEP` diameters of its thinnest rod.
        missed: moves whose hand found no rod.
        slipped: moves whose rod slipped out of the hand.
        diverged: no step converged any more.
        error: (rod,) mean distance of the laid rods from their patterns [m].
        stages: (node, 3) centrelines of every rod [m] when it was "laid", after each "move 1", ...,
            when it was "tied", "tight" and "pulled".
        time, frames, hands, closed: of the film: (T,) times [s], (T, node, 3) of every rod (NaN
            before it is laid), (T, hand, 4, 4) poses of the hands, and (T, hand) whether a hand is
            at work: it may go elsewhere while it is not.
        duration: simulated time [s].
        steps: time steps taken.
    """

    laid: Recognition | None = None
    tied: Recognition | None = None
    tight: Recognition | None = None
    pulled: Recognition | None = None
    wanted: str = ""
    load: np.ndarray = field(default_factory=lambda: np.zeros(2))
    strongest: float = 0.0
    crept: float = 0.0
    held: bool = False
    missed: list[str] = field(default_factory=list)
    slipped: list[str] = field(default_factory=list)
    diverged: bool = False
    error: list[float] = field(default_factory=list)
    stages: dict[str, list[np.ndarray]] = field(default_factory=dict)
    time: np.ndarray | None = None
    frames: list[np.ndarray] = field(default_factory=list)
    hands: np.ndarray | None = None
    closed: np.ndarray | None = None
    duration: float = 0.0
    steps: int = 0

    @property
    def is_tied(self) -> bool:
        """The moves made the knot that was wanted, clearly."""
        tied = self.tied
        return tied is not None and tied.name == self.wanted and tied.share >= CLEAR

    @property
    def success(self) -> bool:
        """Tied as wanted, and it held the pull of both hands."""
        return self.why == "tied"

    @property
    def why(self) -> str:
        """ "tied", or why it is not, in a few words."""
        if self.diverged:
            return "diverged"
        if self.tied is not None and not self.is_tied:
            clear = self.tied.share >= CLEAR
            after = f", slipped out of the grip: {self.slipped[0]}" if self.slipped else ""
            if self.missed:
                after += f", grasped nothing: {self.missed[0]}"
            return f"tied {self.tied.name if clear else 'nothing clear'}{after}"
        if self.tied is None or self.pulled is None:
            return "not pulled"
        if "pull" in self.slipped:
            return f"slipped out of the grip: pull, {self.pulled.name}"
        if "pull" in self.missed:
            return "grasped nothing: pull"
        if self.pulled.share_of(self.wanted) < STILL:
            return f"came loose: {self.pulled.name}"
        if self.tight is None:
            return "gave way before the full pull"
        if not self.held:
            return "gave too far under the pull"
        return "tied"
