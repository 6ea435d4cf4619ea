"""Deployments with feedback: what lies is looked at, and the rest of the path is planned anew.

After every so many centimetres a camera sees the laid part, without what the arm hides. What it
sees, against what the believed rod would have laid, updates the beliefs (friction, L_gb, natural
curvature, where the robot stands) through the derivatives of the deployment; then the path that is
left is corrected for the rod that is believed in now. Where that says that what lies already has
gone wrong, and that it can be laid better, the grip goes back, lifts it, and lays it anew.
"""

from dataclasses import dataclass, field, replace
from time import process_time
from typing import Any

import numpy as np

from wrod import arguments
from wrod.deployment.beliefs import Beliefs, Beside, doubted, meshed_to_the_end
from wrod.deployment.discretisation import USUAL
from wrod.deployment.remembered import Remembered
from wrod.deployment.replanning import HORIZON, Moment
from wrod.deployment.setup import Disturbance
from wrod.deployment.sight import Seen, Sight
from wrod.deployment.simulate import Trial, refuse_other_plans
from wrod.deployment.tangents import Laid
from wrod.deployment.together import Asked, Course, follow
from wrod.deployment.way import Way
from wrod.errors import RodError
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory
from wrod.records import checked_fields
from wrod.rods.material import RodMaterial
from wrod.solvers.contact import Friction, FrictionField

# Poses of the grip that a deployment has at least.
_LEAST_POSES = 3
# The grip goes back so many times at most, and if what is seen is likelier where it is believed to
# lie than on the pattern, by twice the logarithm: three deviations of the camera's noise.
_MOST_TIMES, _BEYOND_NOISE = 8, 9.0
# For so long the plant's shaking is drawn [s]: what is past stays, however long it goes on.
_SHAKING = 600.0


@checked_fields(
    RodError,
    rod=arguments.like("a wrod.RodMaterial", "radius", "length", "gravito_bending_length"),
    friction=arguments.like("a wrod.Friction", "static", "kinetic"),
    disturbance=arguments.like("a wrod.Disturbance", "jitter", "offset"),
    friction_field=arguments.optional(arguments.like("a wrod.FrictionField", "factor", "x", "y")),
)
@dataclass(frozen=True)
class Plant:
    """What is really laid, on what.

    Attributes:
        rod: the rod.
        friction: of the table.
        disturbance: what else differs from the plan.
        friction_field: how friction varies over the table; None: it does not.
    """

    rod: RodMaterial
    friction: Friction
    disturbance: Disturbance = field(default_factory=Disturbance)
    friction_field: FrictionField | None = None


@dataclass(frozen=True)
class Look:
    """What was believed after a look.

    Attributes:
        laid: length that was laid then [m].
        friction: coefficient under the contact [-].
        friction_error: standard error of its logarithm [-].
        lgb_error: relative, of L_gb.
        natural_curvature: [1/m].
        offset: (2,) of the robot [m].
        yaw: of the robot [rad].
        misfit: root mean square of what was seen against what had been believed [m].
        varies: least and largest factor by which friction is believed to vary over the table.
        seconds: of a processor to renew the beliefs by the pictures, and the path by these [s].
        kept: whether the path was kept, as others than were believed in, but as likely, are laid no
            better by the corrected one.
        back: laid length to which the grip went back then [m]; None: it went on.
    """

    laid: float
    friction: float
    friction_error: float
    lgb_error: float
    natural_curvature: float
    offset: tuple[float, float]
    yaw: float
    misfit: float
    varies: tuple[float, float]
    seconds: float
    kept: bool
    back: float | None = None


@dataclass(frozen=True)
class Followed:
    """A deployment with feedback: the way that was gone, what lies in the end, and the looks."""

    trajectory: Trajectory
    laid: Laid
    looks: list[Look]


@arguments.checked(
    RodError,
    rod=arguments.like("a wrod.RodMaterial", "radius", "length", "gravito_bending_length"),
    friction=arguments.number(0.0, 100.0),
    plant=arguments.like("a wrod.deployment.feedback.Plant", "rod", "friction", "disturbance"),
    every=arguments.number(5e-3, 100.0),
    sight=arguments.optional(
        arguments.like("a wrod.deployment.sight.Sight", "noise", "spacing", "hidden", "hanging")
    ),
    horizon=arguments.number(2.0, 1e3),
    hold=arguments.number(0.0, 10.0, above=0.0),
)
def lay_with_feedback(
    pattern: Pattern,
    rod: RodMaterial,
    trajectory: Trajectory,
    friction: float,
    plant: Plant,
    *,
    every: float = 0.03,
    sight: Sight | None = None,
    known: bool = False,
    again: bool = True,
    horizon: float = HORIZON,
    hold: float = 0.05,
    device: str | None = "cpu",
    **options,
) -> Followed:
    """Lay a rod that differs from the one believed in, looking at it on the way.

    The first look comes before the free end is let go: all is then begun anew, the held end put
    down and the path corrected from there on for the rod that is believed in now, so that an offset
    of the robot that is seen then does no harm.

    Args:
        pattern: with the remainder that the trajectory lays.
        rod: that is believed in.
        trajectory: planned for it.
        friction: that is believed in.
        plant: what is really there; only its rod is looked at.
        every: length that the grip goes between two looks [m].
        sight: how the camera sees; default: `Sight()`.
        known: believe the truth from the first look on: what is left then is the share of control,
            and of what cannot be laid any better.
        again: whether the grip may go back and lay anew what has gone wrong.
        horizon: how far beyond the contact the path is corrected after a look [L_gb].
        hold: length of the free end that is held at first [m].
        device: "cpu", "cuda:0" or "auto".
        options: of `wrod.deployment.tangents.lay`, for the plant.

    Raises:
        RodError: an argument is not usable.
    """
    course = following(
        pattern, rod, trajectory, friction, plant, every=every, sight=sight, known=known,
        again=again, horizon=horizon, hold=hold, **options,
    )  # fmt: skip
    refuse_other_plans(Trial(pattern, plant.rod, trajectory, plant.friction))
    return follow([course], hold=hold, device=device)[0]


def following(
    pattern: Pattern,
    rod: RodMaterial,
    trajectory: Trajectory,
    friction: float,
    plant: Plant,
    *,
    every: float = 0.03,
    sight: Sight | None = None,
    known: bool = False,
    again: bool = True,
    horizon: float = HORIZON,
    hold: float = 0.05,
    **options,
) -> Course[Followed]:
    """The deployments of `lay_with_feedback`, and what it returns."""
    sight = sight or Sight()
    rng = np.random.default_rng(sight.seed)
    beliefs, beside = Beliefs(pattern, rod, friction, hold), Beside()
    way = Way(trajectory).followed_by_tail(pattern, sight.hidden)
    gone_on = Remembered()

    def really(path: Trajectory, **more) -> Course[Laid]:
        how = plant.disturbance
        offset = np.asarray(how.offset) + beliefs.placed[:2]
        yaw = how.yaw + beliefs.placed[2]
        how = replace(how, offset=tuple(offset), yaw=yaw, shaking_time=_SHAKING)
        trial = Trial(pattern, plant.rod, path, plant.friction, how, Tail.none(path))
        given = {"friction_field": plant.friction_field, **options, **more}
        given["discretisation"] = meshed_to_the_end(given.get("discretisation", USUAL), pattern)
        (laid,) = yield Asked([trial], None, given, gone_on)
        return laid

    def seen(lies: Laid, at: float) -> list[Seen]:
        return [Seen.of(lies, at, sight, rng) for _ in range(sight.pictures)]

    s = trajectory.arc_length
    gone = float(s[min(int(np.searchsorted(s, hold)) + _LEAST_POSES, len(s) - 1)])
    path, looks, returns = way.until(gone).path, [], []
    held: dict[str, Any] = {"release": gone + hold}
    lies = yield from really(path, **held)
    began = process_time()
    misfit, _ = yield from beliefs.update(gone, path, seen(lies, gone), still=True, **held)
    if known:
        beliefs.know(plant.friction.static, plant.disturbance, plant.friction_field)
    now = Moment(beliefs, way, gone, np.zeros(2), horizon)
    way, beliefs.placed, kept = yield from now.begun()
    looks.append(_look(beliefs, path, gone, misfit, process_time() - began, kept, None))
    while gone < way.end:
        # The last look comes at the end of the way, which goes on for as much of the tail as the
        # arm hides: what nobody sees, nobody lays anew.
        gone = gone + every if gone + 1.5 * every < way.end else way.end
        path, at = way.until(gone).path, way.laid_at(gone)
        lies = yield from really(path)
        pictures = seen(lies, at)
        began = process_time()
        misfit, laid = yield from beliefs.update(at, path, pictures)
        if known:
            beliefs.know(plant.friction.static, plant.disturbance, plant.friction_field)
            laid = yield from beliefs.felt(path)
        for one in pictures:
            aside = beside.told(laid, at, one, gone)
        told = sum(doubted(laid, pattern, at, one, aside) for one in pictures)
        now = Moment(beliefs, way, gone, aside, horizon, returns)
        way, gone, back, kept = yield from now.replanned(
            again and told > _BEYOND_NOISE and len(returns) < _MOST_TIMES
        )
        looks.append(_look(beliefs, path, at, misfit, process_time() - began, kept, back))
    return Followed(way.path, lies, looks)


def _look(
    beliefs: Beliefs,
    path: Trajectory,
    s: float,
    misfit: float,
    seconds: float,
    kept: bool,
    back: float | None,
) -> Look:
    trial = beliefs.trial(path)
    x, y = beliefs.offset
    (mu,), (error,) = beliefs.under(np.array([s]))
    factor = np.ones(1) if beliefs.field is None else np.asarray(beliefs.field.factor)
    return Look(
        s,
        float(mu),
        float(error),
        trial.disturbance.lgb_error,
        trial.disturbance.natural_curvature,
        (float(x), float(y)),
        beliefs.yaw,
        misfit,
        (float(factor.min()), float(factor.max())),
        seconds,
        kept,
        back,
    )
