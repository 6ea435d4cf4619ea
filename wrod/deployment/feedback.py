"""Deployments with feedback: what lies is looked at, and the rest of the path is planned anew.

After every so many centimetres a camera sees the laid part, without what the arm hides. What it
sees, against what the believed rod would have laid, updates the beliefs (friction, L_gb, natural
curvature, where the robot stands) through the derivatives of the deployment; then the path that is
left is corrected for the rod that is believed in now. What is laid already stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from wrod.deployment.optimise import COARSE, Corrections, misplacement
from wrod.deployment.result import METRIC_POINTS
from wrod.deployment.setup import Disturbance, Tail, tail
from wrod.deployment.simulate import Trial
from wrod.deployment.tangents import Directions, Laid, lay
from wrod.errors import RodError
from wrod.patterns.pattern import Pattern
from wrod.planning.trajectory import Trajectory
from wrod.rods.material import RodMaterial
from wrod.solvers.contact import Friction, FrictionField

# Standard deviations of what may be wrong and nobody declared: of the logarithms of friction and
# stiffness [-], natural curvature [1/m], and the robot's place [m].
_DOUBT = np.array([0.5, 0.5, 3.0, 2e-3, 2e-3])
# Largest change of a belief at a look, in these deviations.
_MOST_CHANGE = 2.5
# What a laid point differs by though the beliefs are right: mesh, shaking, whatever else [m].
_MODEL_ERROR = 1e-3
# Costs of the corrections, a tenth of those in `optimise`: one rod is laid, not a sample of them;
# and the largest change of a correction in an iteration [L_gb].
_SIZE, _ROUGHNESS, _STEP = 2e-4, 2e-4, 0.35
_ITERATIONS = 2
# Of a spline that begins at the contact, so many first coefficients are its value and slope there.
_FIXED = 2


@dataclass(frozen=True)
class World:
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
class Sight:
    """How a camera sees what lies.

    Attributes:
        noise: standard deviation of each coordinate of a point [m].
        spacing: between points along the rod [m].
        hidden: length of laid rod before the contact that the arm hides [m].
        seed: of the noise.
    """

    noise: float = 0.5e-3
    spacing: float = 0.01
    hidden: float = 0.03
    seed: int = 0


@dataclass(frozen=True)
class Look:
    """What was believed after a look.

    Attributes:
        laid: length that was laid then [m].
        friction: coefficient [-].
        lgb_error: relative, of L_gb.
        natural_curvature: [1/m].
        offset: (2,) of the robot [m].
        misfit: root mean square of what was seen against what had been believed [m].
    """

    laid: float
    friction: float
    lgb_error: float
    natural_curvature: float
    offset: tuple[float, float]
    misfit: float


@dataclass(frozen=True)
class Followed:
    """A deployment with feedback: the path that was gone, what lies in the end, and the looks."""

    trajectory: Trajectory
    laid: Laid
    looks: list[Look]


def lay_with_feedback(
    pattern: Pattern,
    rod: RodMaterial,
    trajectory: Trajectory,
    friction: float,
    world: World,
    *,
    every: float = 0.1,
    sight: Sight | None = None,
    hold: float = 0.05,
    device: str | None = "cpu",
    **options,
) -> Followed:
    """Lay a rod that differs from the one believed in, looking at it on the way.

    Args:
        pattern: with the remainder that the trajectory lays.
        rod: that is believed in.
        trajectory: planned for it.
        friction: that is believed in.
        world: what is really there; only its laid rod is looked at.
        every: length that is laid between two looks [m].
        sight: how the camera sees; default: `Sight()`.
        hold: length of the free end that is held at first [m].
        device: "cpu", "cuda:0" or "auto".
        options: of `wrod.deployment.tangents.lay`, for the world.

    Raises:
        RodError: `every` is not positive.
    """
    if not every > 0.0:
        raise RodError(f"every is {every!r} m; give the positive length between two looks")
    sight = sight or Sight()
    rng = np.random.default_rng(sight.seed)
    one = _Replanner(pattern, rod, trajectory, friction, hold, device)

    def really(path: Trajectory) -> Laid:
        trial = Trial(pattern, world.rod, path, world.friction, world.disturbance, one.rest)
        return lay(
            [trial], hold=hold, device=device, friction_field=world.friction_field, **options
        )[0]

    end, looks = float(trajectory.arc_length[-1]), []
    for s in np.arange(hold + every, end - 0.5 * every, every):
        laid = really(_until(one.path, s))
        at = np.arange(0.0, s - sight.hidden, sight.spacing)
        seen = np.stack([np.interp(at, laid.arc_length, c) for c in laid.centerline[:, :2].T])
        seen += sight.noise * rng.standard_normal(seen.shape)
        misfit = one.believe(s, at, seen, sight.noise)
        one.replan(s)
        looks.append(one.look(s, misfit))
    return Followed(one.path, really(one.path), looks)


class _Replanner:
    """Beliefs and the path that goes with them."""

    def __init__(self, pattern, rod, trajectory, friction, hold, device):
        self.pattern, self.rod, self.hold, self.device = pattern, rod, hold, device
        self.friction = friction
        # In deviations: logarithms of friction and stiffness, natural curvature, offset.
        self.belief = np.zeros(5)
        self.path = trajectory
        self.rest: Tail = tail(pattern, rod, trajectory)

    def _trial(self, path: Trajectory) -> Trial:
        mu, stiffness, natural, x, y = self.belief * _DOUBT
        how = Disturbance(
            lgb_error=float(np.exp(stiffness / 3.0) - 1.0),
            natural_curvature=float(natural),
            offset=(float(x), float(y)),
        )
        law = Friction(float(self.friction * np.exp(mu)))
        return Trial(self.pattern, self.rod, path, law, how, self.rest)

    def _lay(self, path: Trajectory, columns: Directions) -> Laid:
        return lay([self._trial(path)], [columns], hold=self.hold, device=self.device, **COARSE)[0]

    def believe(self, s: float, at: np.ndarray, seen: np.ndarray, noise: float) -> float:
        """Update the beliefs by points (2, n) seen at arc lengths (n,); their misfit before."""
        path = _until(self.path, s)
        laid = self._lay(path, Directions.of_rod(len(path)))
        guess = np.stack([np.interp(at, laid.arc_length, c) for c in laid.centerline[:, :2].T])
        rates = np.array(
            [
                [np.interp(at, laid.arc_length, c) for c in column[:, :2].T]
                for column in laid.tangent
            ]
        )
        rates[0] *= self._trial(path).friction.static  # by its logarithm
        shifts = np.zeros((2, *guess.shape))
        shifts[0, 0] = shifts[1, 1] = 1.0
        matrix = np.concatenate([rates, shifts]).reshape(5, -1).T * _DOUBT
        residual = (seen - guess).ravel()
        weight = 1.0 / (noise**2 + _MODEL_ERROR**2)
        step = np.linalg.solve(
            weight * matrix.T @ matrix + np.eye(5), weight * matrix.T @ residual - self.belief
        )
        self.belief = self.belief + step * min(1.0, _MOST_CHANGE / np.abs(step).max())
        return float(np.sqrt(np.mean(residual**2)))

    def replan(self, s: float) -> None:
        """Correct what is left of the path beyond `s`, at first without a step or a kink."""
        c = Corrections(self.pattern, self.path, self.rod.gravito_bending_length, s)
        free = np.arange(3 * c.count) >= 3 * _FIXED
        columns = Directions.of_path(c.columns()[free])
        cost = c.cost(_SIZE, _ROUGHNESS)[np.ix_(free, free)]
        scale = 1.0 / (METRIC_POINTS * c.lgb**2)
        values, best = np.zeros(3 * c.count), None
        for _ in range(_ITERATIONS + 1):
            laid = self._lay(c.apply(values), columns)
            error, rates = misplacement(self.pattern, laid)
            value = np.inf if laid.diverged else float(error @ error)
            if best is not None and value >= best[0]:
                break
            best = value, values
            matrix = cost + scale * rates.T @ rates
            slope = cost @ values[free] + scale * rates.T @ error
            step = -np.linalg.solve(matrix, slope)
            values = values.copy()
            values[free] += step * min(1.0, _STEP / np.abs(step).max())
        self.path = c.apply(best[1])

    def look(self, s: float, misfit: float) -> Look:
        trial = self._trial(self.path)
        how = trial.disturbance
        return Look(
            float(s),
            trial.friction.static,
            how.lgb_error,
            how.natural_curvature,
            how.offset,
            misfit,
        )


def _until(trajectory: Trajectory, s: float) -> Trajectory:
    """Its beginning, up to that laid length [m]."""
    n = int(np.searchsorted(trajectory.arc_length, s, side="right"))
    names = ("arc_length", "contact", "position", "rotation", "force", "shape", "twist")
    cut = {
        name: getattr(trajectory, name)[:n]
        for name in names
        if getattr(trajectory, name) is not None
    }
    return replace(trajectory, **cut)
