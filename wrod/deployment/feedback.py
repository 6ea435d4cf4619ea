"""Deployments with feedback: what lies is looked at, and the rest of the path is planned anew.

After every so many centimetres a camera sees the laid part, without what the arm hides. What it
sees, against what the believed rod would have laid, updates the beliefs (friction, L_gb, natural
curvature, where the robot stands) through the derivatives of the deployment; then the path that is
left is corrected for the rod that is believed in now. Where that says that what lies already has
gone wrong, and that it can be laid better, the grip goes back, lifts it, and lays it anew.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from wrod import arguments
from wrod.deployment.beliefs import meshed_to_the_end
from wrod.deployment.bounds import refuse_another_rod
from wrod.deployment.discretisation import USUAL
from wrod.deployment.looking_on import FeedbackLoop, Look
from wrod.deployment.remembered import LastDeployments
from wrod.deployment.setup import Disturbance
from wrod.deployment.sight import Seen, Sight
from wrod.deployment.simulate import Trial
from wrod.deployment.tangents import Laid
from wrod.deployment.together import Asked, Course, follow
from wrod.errors import RodError
from wrod.planning.hold import as_held
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory
from wrod.records import checked_fields
from wrod.rods.material import RodMaterial
from wrod.solvers.friction import Friction, FrictionField

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
class Followed:
    """A deployment with feedback: the way that was gone, what lies in the end, and the looks."""

    trajectory: Trajectory
    laid: Laid
    looks: list[Look]


@arguments.checked(
    RodError,
    loop=arguments.like("a wrod.FeedbackLoop", "ahead", "beliefs", "looked"),
    plant=arguments.like("a wrod.deployment.feedback.Plant", "rod", "friction", "disturbance"),
    sight=arguments.optional(
        arguments.like("a wrod.deployment.sight.Sight", "noise", "spacing", "hidden", "hanging")
    ),
)
def lay_with_feedback(
    loop: FeedbackLoop,
    plant: Plant,
    *,
    sight: Sight | None = None,
    known: bool = False,
    device: arguments.DeviceLike = "cpu",
    **options,
) -> Followed:
    """Lay a rod that differs from the one believed in, looking at it on the way.

    The first look comes before the free end is let go: all is then begun anew, the held end put
    down and the path corrected from there on for the rod that is believed in now, so that an offset
    of the robot that is seen then does no harm.

    Args:
        loop: what is believed in and how it is looked at, as with a robot; that has not begun.
        plant: what is really there; only its rod is looked at.
        sight: how the camera sees; default: `Sight()`.
        known: believe the truth from the first look on: what is left then is the share of control,
            and of what cannot be laid any better.
        device: "cpu", "cuda:0" or "auto".
        options: of `wrod.deployment.tangents.lay`, for the plant.

    Raises:
        RodError: an argument is not usable, or the loop has begun.
    """
    plant = replace(plant, rod=as_held(loop.path, plant.rod))
    refuse_another_rod(loop.path, plant.rod, ("length", "radius"))
    course = following(loop, plant, sight=sight, known=known, **options)
    return follow([course], hold=loop.beliefs.hold, device=device)[0]


def following(
    loop: FeedbackLoop,
    plant: Plant,
    *,
    sight: Sight | None = None,
    known: bool = False,
    **options,
) -> Course[Followed]:
    """The deployments of `lay_with_feedback`, and what it returns."""
    if not loop.held:
        raise RodError("the deployment has begun; give a loop that has not looked at anything yet")
    sight = sight or Sight()
    rng = np.random.default_rng(sight.seed)
    beliefs, gone_on = loop.beliefs, LastDeployments()
    pattern, hold = beliefs.pattern, beliefs.hold

    def really(path: Trajectory, **more) -> Course[Laid]:
        how = plant.disturbance
        offset = np.asarray(how.offset) + beliefs.placed[:2]
        yaw = how.yaw + beliefs.placed[2]
        how = replace(how, offset=tuple(offset), yaw=yaw, shaking_time=_SHAKING)
        trial = Trial(pattern, plant.rod, path, plant.friction, how, Tail.none(path))
        how_laid = {"friction_field": plant.friction_field, **options, **more}
        mesh = how_laid.get("discretisation", USUAL)
        how_laid["discretisation"] = meshed_to_the_end(mesh, pattern)
        (laid,) = yield Asked([trial], None, how_laid, [gone_on])
        return laid

    def seen(lies: Laid, at: float) -> list[Seen]:
        return [Seen.of(lies, at, sight, rng) for _ in range(sight.pictures)]

    truth = plant.friction.static, plant.disturbance, plant.friction_field
    tell = (lambda believed: believed.know(*truth)) if known else None
    looks = []
    while True:
        held = {"release": loop.gone + hold} if loop.held else {}
        lies = yield from really(loop.path, **held)
        looks.append((yield from loop.looked(seen(lies, loop.laid), tell)))
        if loop.ended:
            return Followed(loop.way.path, lies, looks)
