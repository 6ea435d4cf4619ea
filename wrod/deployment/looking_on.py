"""The loop of a deployment with feedback: go on, look, believe, plan the rest anew, go on.

A robot of your own goes where `FeedbackLoop.ahead` says, its camera tells what lies
(`FeedbackLoop.observe`), and so on until nothing is ahead.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import process_time
from typing import Any

import numpy as np

from wrod import arguments
from wrod.deployment.beliefs import Beliefs, told_by
from wrod.deployment.beside import Beside, doubted
from wrod.deployment.replanning import HORIZON, Moment
from wrod.deployment.setup import Disturbance
from wrod.deployment.sight import Seen
from wrod.deployment.simulate import Trial, refuse_other_plans, with_remainder_of
from wrod.deployment.together import Course, follow
from wrod.deployment.way import GripWay
from wrod.errors import DataError, RodError
from wrod.patterns.pattern import Pattern
from wrod.planning.hold import as_held
from wrod.planning.trajectory import Trajectory
from wrod.rods.material import RodMaterial
from wrod.solvers.friction import Friction

# Poses of the grip that a deployment has at least.
_LEAST_POSES = 3
# The grip goes back so many times at most, and if what is seen is likelier where it is believed to
# lie than on the pattern, by twice the logarithm: three deviations of the camera's noise.
_MOST_TIMES, _BEYOND_NOISE = 8, 9.0
# Processor time that a look takes at most [s].
PATIENCE = 4.0
# What lies on average so far from where it is believed to [L_gb] is not this rod in this frame.
_STRAY = 3.0


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
        left_out: how many points lay apart from their neighbours, as no rod does.
        hurried: whether more time might have told or planned better, see `patience`.
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
    left_out: int
    hurried: bool
    back: float | None


class FeedbackLoop:
    """A deployment that is looked at on the way: where the grip goes next, and what is believed.

    The grip goes through `ahead`, at each pose when `wrod.pose_times(ahead, 0.04)` has it, and
    stands; `observe` is told what a camera sees then, in the pattern's frame. The free end is held
    down during the first stretch; after the first look all is begun anew, so that `ahead` begins
    where the held end is to be put down, and it is let go once `hold` is laid. Where `ahead` leads
    back, the grip lifts what it has laid.

    Args:
        pattern: that is laid.
        rod: that is believed in.
        trajectory: planned for both, as by `wrod.plan`.
        friction: that is believed in.
        every: length that the grip goes between two looks [m].
        hidden: length of rod before the contact that the arm hides [m]: so much of the tail is laid
            after the pattern's end, to see that.
        again: whether the grip may go back and lay anew what has gone wrong.
        horizon: how far beyond the contact the path is corrected after a look [L_gb].
        hold: length of the free end that is held at first [m].
        patience: processor time that a look takes at most [s], as it is reckoned of a core of an
            EPYC, so that no result depends on the machine; a GPU takes what it takes. What is
            believed and planned by then is the best so far.

    Attributes:
        beliefs: of the rod, the table and where the robot stands.
        looks: what was believed after each look.

    Raises:
        RodError, PatternError: an argument is not usable, or the plan is another's.
    """

    @arguments.checked(
        RodError,
        pattern=arguments.like("a wrod.Pattern", "length", "sample"),
        rod=arguments.like("a wrod.RodMaterial", "radius", "length", "gravito_bending_length"),
        trajectory=arguments.like("a wrod.Trajectory", "arc_length", "position", "rotation"),
        friction=arguments.number(0.0, 100.0, above=0.0),
        every=arguments.number(5e-3, 100.0),
        hidden=arguments.number(0.0, 100.0),
        horizon=arguments.number(2.0, 1e3),
        hold=arguments.number(0.0, 10.0, above=0.0),
        patience=arguments.number(0.0, 1e9, above=0.0),
    )
    def __init__(
        self,
        pattern: Pattern,
        rod: RodMaterial,
        trajectory: Trajectory,
        friction: float,
        *,
        every: float = 0.03,
        hidden: float = 0.03,
        again: bool = True,
        horizon: float = HORIZON,
        hold: float = 0.05,
        patience: float = PATIENCE,
    ):
        refuse_other_plans(Trial(pattern, rod, trajectory, Friction(friction)))
        pattern = with_remainder_of(pattern, trajectory)
        rod = as_held(trajectory, rod)
        self.beliefs, self.looks = Beliefs(pattern, rod, friction, hold), list[Look]()
        self.way = GripWay(trajectory).followed_by_tail(pattern, hidden)
        s = trajectory.arc_length
        # Up to where the grip goes before the next look, and where it stands [m of the way].
        self.gone = float(s[min(int(np.searchsorted(s, hold)) + _LEAST_POSES, len(s) - 1)])
        self.ended, self._stood = False, -1.0
        self._every, self._again, self._horizon = every, again, horizon
        self._patience = patience
        self._beside, self._returns = Beside(), list[tuple[float, float]]()
        self._known: set[bytes] = set()

    @property
    def held(self) -> bool:
        """Whether the free end is held down all the time until the next look."""
        return not self.looks

    @property
    def path(self) -> Trajectory:
        """From the beginning to where the next look is, as the plan has it."""
        return self.way.until(self.gone).path

    @property
    def laid(self) -> float:
        """Length of rod that lies there [m]."""
        return self.way.laid_at(self.gone)

    @property
    def _first(self) -> int:
        """Which pose of `path` is the first that is ahead."""
        s = self.path.arc_length
        return min(int(np.searchsorted(s, self._stood, side="right")), len(s) - 2)

    @property
    def ahead(self) -> Trajectory | None:
        """Poses that the grip goes through until the next look, where the robot stands as it does;
        None: the deployment has ended."""
        if self.ended:
            return None
        path, pattern, first = self.path, self.beliefs.pattern, self._first
        x, y, yaw = self.beliefs.placed
        moved = Disturbance(offset=(float(x), float(y)), yaw=float(yaw))
        origin = pattern.sample(-pattern.remainder_length)[0][0]
        fields: dict[str, Any] = {
            name: value[first:]
            for name in ("arc_length", "force", "shape", "twist")
            if (value := getattr(path, name)) is not None
        }
        return replace(
            path,
            contact=moved.displaced(path.contact[first:], origin),
            position=moved.displaced(path.position[first:], origin),
            rotation=moved.turned(path.rotation[first:].swapaxes(1, 2)).swapaxes(1, 2),
            **fields,
        )

    def observe(
        self,
        pictures: Sequence[tuple[np.ndarray, np.ndarray]],
        *,
        noise: float = 0.5e-3,
        hanging: float = 1e-3,
        pose: int | None = None,
    ) -> Look:
        """What is believed since a look, and `ahead` is for it.

        Args:
            pictures: taken while the grip stands, each with noise of its own: arc lengths (n,) from
                the free end and places (n, 3) [m] of points of the rod in the pattern's frame, in
                any order. Heights of what lies are not used; places (n, 2) are of what lies, and
                those beyond the contact are left out, and so are those that lie apart from their
                neighbours as no rod does. None at all: nothing could be seen.
            noise: standard deviation of each coordinate of what lies [m].
            hanging: of what hangs [m].
            pose: of `ahead`, counted from 0, at which the grip was when they were taken, if they
                come late and it has gone on since; None: it stands at the last one.

        Raises:
            DataError: a picture is not of this rod, not finite, in other units, or was told before;
                or there is no such pose ahead.
            RodError: the deployment has ended.
        """
        if self.ended:
            raise RodError("the deployment has ended; there is nothing to look at any more")
        length, seen, told = self.beliefs.rod.length, [], set(self._known)
        taken = self.gone if pose is None else self._taken(pose)
        pairs = isinstance(pictures, list | tuple) and all(
            isinstance(one, list | tuple) and len(one) == 2 for one in pictures
        )
        if not pairs:
            raise DataError(
                f"pictures are {arguments.shown(pictures)}; give a list of (arc lengths, places)"
            )
        for k, (arc_length, place) in enumerate(pictures):
            one = Seen.told(
                arc_length, place, self.way.laid_at(taken), length, (noise, hanging), f"picture {k}"
            )
            digest = one.place.tobytes()
            if digest in told:
                raise DataError(
                    f"picture {k} was told before; each picture must have noise of its own"
                )
            told.add(digest)
            seen.append(one)
        looked = self.looked(seen, stray=_STRAY, taken=taken)
        (look,) = follow([looked], hold=self.beliefs.hold)
        self._known = told
        return look

    def _taken(self, pose: int) -> float:
        """Length [m of the way] that was gone at such a pose of `ahead`."""
        s, first = self.path.arc_length, self._first
        # Deployments of less have hardly begun.
        held = int(np.argmin(np.abs(s - self.beliefs.hold)))
        ahead, least = s[first:], max(held + _LEAST_POSES - 1 - first, 0)
        wrong = arguments.whole(least, len(ahead) - 1)(pose)
        if wrong is not None:
            raise DataError(
                f"pose is {arguments.shown(pose)}; it {wrong}, of those ahead, where the grip was"
            )
        return float(ahead[pose])

    def looked(
        self,
        pictures: list[Seen],
        tell: Callable[[Beliefs], None] | None = None,
        stray: float = np.inf,
        taken: float | None = None,
    ) -> Course[Look]:
        """As `observe`; the beliefs may be told more by `tell`, and refuse what lies further than
        `stray` [L_gb] from where they have it; pictures were `taken` where so much of the way was
        gone [m]."""
        beliefs, gone, first = self.beliefs, self.gone, self.held
        taken = gone if taken is None else taken
        at, path = self.way.laid_at(taken), self.way.until(taken).path
        held: dict[str, Any] = {"release": gone + beliefs.hold} if first else {}
        began, misfit = process_time(), float("nan")
        beliefs.looking(self._patience)
        left_out = 0
        if np.isfinite(stray):
            before = yield from beliefs.felt(path, **held)
            for k, seen in enumerate(pictures):
                residual = told_by(before, at, seen)[2][: seen.laid, :2]
                off = float(np.median(np.linalg.norm(residual, axis=1)))
                pictures[k] = seen.smooth(residual, f"picture {k}")
                left_out += seen.laid - pictures[k].laid
                if off > stray * beliefs.rod.gravito_bending_length:
                    raise DataError(
                        f"picture {k} has the rod {off:.3g} m from where it is believed to "
                        "lie, on average; give points in metres, in the pattern's frame"
                    )
        if pictures:
            misfit, laid = yield from beliefs.update(at, path, pictures, still=first, **held)
        if tell is not None:
            tell(beliefs)
        if tell is not None or not pictures:
            laid = yield from beliefs.felt(path, **held)
        back = None
        if first:
            now = Moment(beliefs, self.way, gone, np.zeros(2), self._horizon)
            self.way, beliefs.placed, kept = yield from now.begun()
        else:
            aside = np.zeros(2)
            for one in pictures:
                aside = self._beside.told(laid, at, one, taken)
            doubt = sum(doubted(laid, beliefs.pattern, at, one, aside) for one in pictures)
            again = self._again and doubt > _BEYOND_NOISE and len(self._returns) < _MOST_TIMES
            now = Moment(beliefs, self.way, gone, aside, self._horizon, self._returns)
            self.way, gone, back, kept = yield from now.replanned(again)
        self._stood, end = -1.0 if first else self.gone, self.way.end
        self.ended = not first and gone >= end
        # The last look comes at the end of the way, which goes on for as much of the tail as the
        # arm hides: what nobody sees, nobody lays anew.
        self.gone = gone + self._every if gone + 1.5 * self._every < end else end
        seconds = process_time() - began
        self.looks.append(_look(beliefs, path, at, misfit, seconds, kept, left_out, back))
        return self.looks[-1]


def _look(
    beliefs: Beliefs,
    path: Trajectory,
    s: float,
    misfit: float,
    seconds: float,
    kept: bool,
    left_out: int,
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
        left_out,
        beliefs.cut,
        back,
    )
