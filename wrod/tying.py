"""Knots tied by a robot: rods laid along a designed pattern, then a few blind pick-and-place moves.

What is grasped is where the plan says, whether the rod lies there or not: there is no feedback
(paper, Sec. Application #2). A hand closes on whatever edge of a rod it finds between its fingers,
carries it over the others, and puts it down. At last both hands pull.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from wrod.deployment_setup import Disturbance
from wrod.knot_plan import KnotPlan
from wrod.topology import Recognition


@dataclass(frozen=True)
class Handling:
    """What distinguishes the handling of one trial from the next; the default is none.

    Attributes:
        laying: disturbance of the laying of each rod, one after the other.
        offset: (2, 2) by which each hand misses its place on the table [m].
        jitter: standard deviation of each coordinate of the hands' shaking [m].
        strength: (n,) pull that a grasp resists before the rod slips out, one grasp after the
            other [N]; empty: any.
        seed: of the shaking.
    """

    laying: tuple[Disturbance, ...] = ()
    offset: tuple = ((0.0, 0.0), (0.0, 0.0))
    jitter: float = 0.0
    strength: tuple[float, ...] = ()
    seed: int = 0

    @classmethod
    def random(cls, seed: int, strength: float = 0.6) -> Handling:
        """A trial of a careful laboratory: laying as `Disturbance.random`, hands placed within
        1 mm (standard deviation), jitter 0.3 mm, strength of a grasp log-normal about `strength`
        [N] with a deviation of 40 %."""
        rng = np.random.default_rng([seed, 7])
        return cls(
            tuple(Disturbance.random(1000 + 10 * seed + k) for k in range(2)),
            tuple(map(tuple, 1e-3 * rng.standard_normal((2, 2)))),
            0.3e-3,
            tuple(strength * np.exp(0.4 * rng.standard_normal(12))),
            seed,
        )


@dataclass
class TyingResult:
    """One trial. SI units, the table at z = 0.

    Attributes:
        laid, tied, pulled: the knot of the rods after laying, after the moves, and after pulling.
        wanted: the knot that the plan promises.
        load: (hand,) pull at the end [N].
        missed: moves whose hand found no rod.
        slipped: moves whose rod slipped out of the hand.
        blocked: a rod could not be laid, since another lay where it begins; what follows is then
            without meaning.
        diverged: no step converged any more.
        error: (rod,) mean distance of the laid rods from their patterns [m].
        rods: (node, 3) centrelines of every rod at the end [m]; `stages` those after laying, the
            moves and pulling.
        time, frames, hands, closed: of the film: (T,) times [s], (T, node, 3) of every rod (NaN
            before it is laid), (T, hand, 4, 4) poses of the hands, and (T, hand) whether a hand is
            at work: it may go elsewhere while it is not.
        duration: simulated time [s].
        steps: time steps taken.
    """

    laid: Recognition | None = None
    tied: Recognition | None = None
    pulled: Recognition | None = None
    wanted: str = ""
    load: np.ndarray = field(default_factory=lambda: np.zeros(2))
    missed: list[str] = field(default_factory=list)
    slipped: list[str] = field(default_factory=list)
    blocked: bool = False
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
    def success(self) -> bool:
        """Tied as wanted, still so after both hands pulled."""
        return self.why == "tied"

    @property
    def why(self) -> str:
        """ "tied", or why it is not, in a few words."""
        if self.blocked:
            return self.missed[0]
        if self.diverged:
            return "diverged"
        if self.tied is None or self.pulled is None:
            return "not pulled"
        if self.tied.name != self.wanted:
            after = f", slipped out of the grip: {self.slipped[0]}" if self.slipped else ""
            if self.missed:
                after += f", grasped nothing: {self.missed[0]}"
            return f"tied {self.tied.name}{after}"
        if "pull" in self.slipped:
            return f"slipped out of the grip: pull, {self.pulled.name}"
        if "pull" in self.missed:
            return "grasped nothing: pull"
        if self.pulled.name != self.wanted:
            return f"came loose: {self.pulled.name}"
        return "tied"


def tie(
    knot: KnotPlan,
    trials: list[Handling],
    method: str = "neural",
    *,
    friction: float = 0.6,
    rod_friction: float = 0.4,
    speed: float = 0.03,
    hand_speed: float = 0.06,
    step: float = 0.01,
    film_interval: float | None = None,
    device: str = "cpu",
    progress: Callable[[str], None] | None = None,
) -> list[TyingResult]:
    """Lay the rods of a knot one after the other, make its moves, and pull.

    Args:
        knot: the plan.
        trials: what disturbs each.
        method: of the laying, as for `wrod.plan`.
        friction: coefficient of rods on the table.
        rod_friction: of rods on rods.
        speed: at which the contact moves while a rod is laid [m/s].
        hand_speed: of hands that carry [m/s].
        step: largest time step [s].
        film_interval: keep the state at about its multiples [s]; None keeps no film.
        device: "cpu", "cuda:0", "auto".
        progress: called with what comes next.
    """
    from wrod.tying_course import Course
    from wrod.tying_laying import lay
    from wrod.tying_moves import make
    from wrod.tying_pull import pull

    progress = progress or (lambda what: None)
    course = Course(
        knot, trials, method, friction, rod_friction, speed, hand_speed, step, film_interval, device
    )
    for k in range(len(knot.rods)):
        progress(f"lay rod {k + 1}")
        lay(course, k)
    course.note("laid")
    course.bench.handle_roughly()
    for number, moves in enumerate(knot.steps, start=1):
        progress(f"move {number}")
        make(course, moves, f"move {number}")
    course.note("tied")
    if knot.pull:
        progress("pull")
        pull(course)
        course.note("pulled")
    return course.finished()
