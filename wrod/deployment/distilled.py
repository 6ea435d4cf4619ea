"""Plans that know the table at once: a network corrects them as optimisation would."""

from dataclasses import replace

import numpy as np

from wrod.controller.corrector import Corrector, CorrectorInputs
from wrod.deployment.corrections import Corrections
from wrod.deployment.expectation import PACE
from wrod.errors import GraspError
from wrod.patterns.pattern import Pattern
from wrod.planning.trajectory import Trajectory
from wrod.rods.model import Rod, RodModel

# Length of the free end that is held at first [m], before which no correction changes.
_HOLD = 0.05


def distilled(pattern: Pattern, rod: Rod, trajectory: Trajectory, friction: float) -> Trajectory:
    """Correct a trajectory's positions for a table as `wrod.deployment.optimise` would.

    Args:
        pattern: with the remainder that the trajectory lays.
        rod: what is laid, straight at rest and uniform.
        trajectory: to start from, as `wrod.plan` returns it by method "auto".
        friction: coefficient of the table [-].

    Returns:
        The corrected trajectory. `metadata["distilled"]` says the friction, the largest correction
        [m], and the pace of the plans that the network learnt from [m/s].

    Raises:
        GraspError: the rod is none that the network knows.

    Warns:
        OutOfRangeWarning: it learnt nothing of the kind.
    """
    model = RodModel.of(rod)
    if not (rod.is_straight and model.is_uniform and model.is_isotropic):
        raise GraspError(
            "the distilled corrections know straight uniform rods only; let friction optimise the "
            "plan (method 'auto')"
        )
    corrections = Corrections(pattern, trajectory, rod.gravito_bending_length, _HOLD, straight=True)
    values = corrections.nearest(
        Corrector.load().predict(asked(pattern, rod, trajectory, friction))
    )
    corrected = corrections.apply(values)
    said = {"friction": friction, **corrections.largest(values), "pace": PACE}
    return replace(corrected, metadata={**corrected.metadata, "distilled": said})


def asked(pattern: Pattern, rod: Rod, trajectory: Trajectory, friction: float) -> CorrectorInputs:
    """What a corrector is asked about a trajectory."""
    lgb = rod.gravito_bending_length
    on = np.clip(trajectory.pattern_arc_length, -pattern.remainder_length, pattern.length)
    curvature = pattern.sample(on)[2]
    return CorrectorInputs(
        trajectory.arc_length / lgb,
        curvature * lgb,
        rod.length / lgb,
        float(rod.stretch_ratio),
        friction,
    )
