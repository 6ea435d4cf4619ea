"""Plans for a table: from a pattern, a rod and a friction to the trajectory of the grip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from wrod import arguments
from wrod.errors import GraspError, PatternError
from wrod.patterns.pattern import Pattern
from wrod.planning.hold import LEFT, held_near
from wrod.planning.plan import plan_grasps
from wrod.planning.remainder import lead_ins, prepare
from wrod.planning.sources import DISTILLED, check_method
from wrod.planning.trajectory import Trajectory
from wrod.rods.model import Rod

if TYPE_CHECKING:
    from wrod.controller.controller import Controller


@arguments.checked(
    PatternError,
    pattern=arguments.like("a wrod.Pattern", "sample", "length", "remainder_length"),
    spacing=arguments.number(2e-4, 10.0),
)
@arguments.checked(
    GraspError,
    remainder=arguments.either(arguments.flag, arguments.number(0.0, 100.0)),
    roll=arguments.optional(arguments.either(arguments.text, arguments.number(-7.0, 7.0))),
    spin=arguments.number(-100.0, 100.0),
    controller=arguments.like("a wrod.Controller", "predict", "out_of_range"),
    friction=arguments.optional(
        arguments.either(arguments.number(0.0, 100.0), arguments.array((2,)))
    ),
    pace=arguments.optional(arguments.either(arguments.number(5e-4, 10.0), arguments.array((2,)))),
    time_limit=arguments.optional(arguments.number(0.0)),
    left=arguments.optional(arguments.either(arguments.flag, arguments.number(1.0, 1e3))),
)
def plan(
    pattern: Pattern,
    rod: Rod,
    method: str = "auto",
    *,
    closure: str | None = None,
    spacing: float = 0.0025,
    remainder: bool | float | None = None,
    roll: float | str | None = None,
    spin: float = 0.0,
    controller: Controller | None = None,
    friction: float | tuple[float, float] | None = None,
    pace: float | tuple[float, float] | None = None,
    time_limit: float | None = None,
    left: bool | float | None = None,
    expect: bool = False,
    device: arguments.DeviceLike = None,
    progress: Callable[[int, int], object] | None = None,
) -> Trajectory:
    """Trajectory of the grip that lays `rod` along `pattern`.

    Args:
        pattern: where the rod is to lie.
        rod: what is laid; grasps of a `RodModel` that varies are of the piece that hangs.
        method: "neural" (optimal grasps from the trained controller; of a naturally curved rod
            without a controller of its own, from the rod solver), "numeric" (from the rod solver),
            "auto" (neural where the controller was trained, numeric elsewhere) or "intuitive"
            (straight above the contact); or "distilled": "auto", corrected for `friction` by a
            network that learnt it from optimised plans, in milliseconds.
        closure: "zero_tension", "min_force" or "min_friction"; "neural" knows its controller's
            only (the first, for the one that ships). None: the given controller's; without one,
            what lays best for "auto" (`favoured_closure`), the paper's "zero_tension" for others.
        spacing: largest distance between the contact nodes [m].
        remainder: lay a remainder before the pattern (paper, Sec. Accuracy): None where the free
            end is expected to spring off by more than 0.15 L_gb at friction 0.3 (`free_end`),
            with `friction` the length of two that is expected better; True, False, or a length [m].
        roll: how the rod is put into the grip: the laid rod's first material director is turned
            by it from left towards up [rad]; or "plane" and "up", which turn its natural curvature
            into the table's plane to the side to which the pattern turns in all, or upwards; None
            is "plane", or where waves would grow "tilted", 30 degrees up from it (docs/loop.md).
        spin: by how much the hand turns besides about a rod without sides, which twists it [rad].
            With `friction`, grasps know the twist as far as the table is expected to hold it.
        controller: what "neural" and "auto" ask; None is the one that ships, for straight rods.
        friction: of the table, a coefficient (known to a tenth) or a range: the path is corrected
            until what stays lies on the pattern (docs/deployment.md; a minute). None: as it is.
        pace: of the contact on that table [m/s], 0.04 by default; of a range the fastest harmless.
        time_limit: [s] of each path's correction, after which it ends with the best so far.
        left: what hangs from the grip when the pattern is laid [L_gb], at least 1; of the rest see
            `Trajectory.beyond_grip`. True: 4; False: all there is; None: True with `friction`.
        expect: lay the finished plan, too, on tables of `friction` or 0.2 to 0.6, for `expected`.
        device: where the solver runs: "cpu", "cuda:0" or None for its choice; progress: called with
            the nodes done since the last call and the number of all nodes.

    Returns:
        One pose per contact node; `metadata` names method, closure, solver, rod, pattern,
        remainder, the friction that the laid pattern ("required_friction") and the rod where it
        touches down ("contact_friction") ask for, and the warnings given; with `friction`,
        "distilled", or "optimised" and "expected" (`optimise`); with `expect`, "expected"
        (`wrod.deployment.expectation.expect`). "natural_share" is the smallest share
        of its natural curvature that a grasp of a varying rod was made with (`grasps.relaxed`).

    Raises:
        PatternError, RodError: under 1 L_gb is left hanging, bends are too tight, a rod too thick.
        GraspError: unknown method, friction for the intuitive one, a grasp that did not converge
            (names node and inputs), or a controller that was made for another rod.

    Warns:
        StabilityWarning: some grasps are elastically unstable, or close to it.
        WrodWarning: some grasps are of a rod closer to straight.
        OutOfRangeWarning: some nodes are outside what the controller was trained for.
    """
    check_method(method, friction, pace, time_limit)
    rod, beyond = _held(pattern, rod, remainder, friction is not None if left is None else left)
    how: dict[str, Any] = dict(
        closure=closure, spacing=spacing, roll=roll, spin=spin, controller=controller,
        device=device, progress=progress,
    )  # fmt: skip
    asked = {"pace": pace, "time_limit": time_limit}
    made = _planned(pattern, rod, method, remainder, friction, asked, expect, how)
    return replace(made, beyond_grip=beyond) if beyond else made


def _held(pattern: Pattern, rod, remainder, left: bool | float):
    """The rod as far as the grip, and what is beyond [m]."""
    if left is False:
        return rod, 0.0
    near = held_near(prepare(pattern, rod, remainder), rod, LEFT if left is True else left)
    return near, rod.length - near.length


def _planned(
    pattern: Pattern,
    rod,
    method: str,
    remainder,
    friction,
    asked,
    expect: bool,
    how: dict[str, Any],
) -> Trajectory:
    """The plan that `how` asks for, corrected for a table of such a friction, of the pattern with
    the best of its remainders, and what is expected of it where that is asked for."""
    if friction is None and not expect:
        return plan_grasps(pattern, rod, method, remainder=remainder, **how)
    from wrod.deployment.rivals import own_or_straight

    chosen = remainder is None and friction is not None and method != DISTILLED
    led = lead_ins(pattern, rod) if chosen else [prepare(pattern, rod, remainder)]
    if friction is None:
        trajectory = own_or_straight(led[0], rod, method, None, how)
    else:
        trajectory = _corrected(led, rod, method, friction, asked, how)
    if expect and "expected" not in trajectory.metadata:
        from wrod.deployment.expectation import foresee

        expected = foresee(led[0], rod, trajectory, friction, device=how["device"])
        trajectory.metadata["expected"] = expected
    return trajectory


def _corrected(
    led: list[Pattern], rod, method: str, friction, asked: dict[str, Any], how: dict[str, Any]
) -> Trajectory:
    """The plan that `how` asks for, corrected as is `asked` for a table of such a friction."""
    from wrod.deployment.optimise import optimise_rivals
    from wrod.deployment.rivals import as_is_or_twisted, own_or_straight
    from wrod.deployment.spread import Spread

    spread = Spread.of(friction)
    base = "auto" if method == DISTILLED else method
    starts = [own_or_straight(one, rod, base, spread.friction, how) for one in led]
    starts = [
        as_is_or_twisted(one, rod, start, spread.friction, how)
        for one, start in zip(led, starts, strict=True)
    ]
    if method == DISTILLED:
        from wrod.deployment.distilled import distilled

        return distilled(led[0], rod, starts[0], float(np.mean(spread.friction)))
    asked = {name: value for name, value in asked.items() if value is not None}
    rivals = list(zip(led, starts, strict=True))
    return optimise_rivals(rivals, rod, spread, device=how["device"], **asked)
