"""Knots tied by a robot: rods laid along a designed pattern, then a few blind pick-and-place moves.

What is grasped is where the plan says, whether the rod lies there or not: there is no feedback
(paper, Sec. Application #2). A hand closes on whatever edge of a rod it finds between its fingers,
carries it over the others, and puts it down. At last both hands pull.
"""

from collections.abc import Callable

from wrod import arguments
from wrod.errors import RodError
from wrod.knots.laying import lay
from wrod.knots.moves import make
from wrod.knots.plan import KnotPlan
from wrod.knots.pull import pull
from wrod.knots.trials import Handling, TyingResult
from wrod.knots.tying_run import TyingRun


@arguments.checked(
    RodError,
    knot=arguments.like("a KnotPlan", "rods", "steps", "pull"),
    trials=arguments.several(arguments.like("a Handling", "laying")),
    friction=arguments.number(0.0, 1e3),
    rod_friction=arguments.number(0.0, 1e3),
    speed=arguments.number(1e-4, 10.0),
    hand_speed=arguments.number(1e-4, 10.0),
    step=arguments.number(1e-5, 1.0),
    film_interval=arguments.optional(arguments.number(1e-4, 1e6)),
)
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
    device: arguments.DeviceLike = "cpu",
    progress: Callable[[str], object] | None = None,
) -> list[TyingResult]:
    """Lay the rods of a knot one after the other, make its moves, and pull what is tied.

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
    progress = progress or (lambda what: None)
    run = TyingRun(
        knot, trials, method, friction, rod_friction, speed, hand_speed, step, film_interval, device
    )
    for k in range(len(knot.rods)):
        progress(f"lay rod {k + 1}")
        lay(run, k)
    run.note("laid")
    for number, moves in enumerate(knot.steps, start=1):
        progress(f"move {number}")
        make(run, moves, f"move {number}")
        run.keep(f"move {number}")
    run.note("tied")
    if knot.pull:
        progress("pull")
        pull(run)
        run.note("pulled")
    return run.finished()
