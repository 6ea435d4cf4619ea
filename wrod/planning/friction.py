"""The friction that a laid pattern needs to stay where it is (paper, Eq. bendingFriction)."""

from dataclasses import dataclass

import numpy as np

from wrod import arguments
from wrod.errors import RodError
from wrod.patterns.pattern import Pattern
from wrod.rods.model import Rod, RodModel


@dataclass(frozen=True)
class FrictionBound:
    """Static friction that each point of a pattern asks for.

    Attributes:
        arc_length: (n,) [m]; negative on the remainder.
        required: (n,) least static friction coefficient [-].
    """

    arc_length: np.ndarray
    required: np.ndarray


@arguments.checked(RodError, spacing=arguments.number(1e-5, 10.0))
def friction_bound(pattern: Pattern, rod: Rod, spacing: float = 0.001) -> FrictionBound:
    """Static friction that holds the pattern: mu_s >= k_b ``|kappa''|`` / (rho A g).

    In the paper's L_gb this is 2 L_gb^3 ``|kappa''|``, whatever the density. Of a rod that varies,
    k_b (the mean of both directions) and weight are those of the place.

    Args:
        pattern: with its remainder, if it has one.
        rod: the `RodMaterial` or `RodModel` that is laid.
        spacing: distance between the points looked at [m].

    Raises:
        RodError: spacing is not within 1e-5 to 10.
    """
    first = -pattern.remainder_length
    count = max(int(np.ceil((pattern.length - first) / spacing)), 2) + 1
    s = np.linspace(first, pattern.length, count)
    acceleration = pattern.curvature_derivative(s, 2)
    model, laid = RodModel.of(rod), s - first
    stiffness = 0.5 * sum(b(laid) for b in model.bending_stiffness)
    required = stiffness * np.abs(acceleration) / (model.line_mass(laid) * model.gravity)
    return FrictionBound(s, required)
