"""The friction that a laid pattern needs to stay where it is (paper, Eq. bendingFriction)."""

from dataclasses import dataclass

import numpy as np

from wrod import arguments
from wrod.errors import PatternError, RodError
from wrod.patterns.pattern import Pattern
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel


@dataclass(frozen=True)
class FrictionBound:
    """Static friction that each point of a pattern asks for.

    Attributes:
        arc_length: (n,) [m]; negative on the remainder.
        required: (n,) least static friction coefficient [-].
        friction: the coefficient that there is, or None.
    """

    arc_length: np.ndarray
    required: np.ndarray
    friction: float | None = None

    @property
    def insufficient(self) -> list[tuple[float, float]]:
        """Stretches (from, to) of arc length [m] where the friction that there is does not do."""
        if self.friction is None:
            return []
        lacking = np.concatenate([[False], self.required > self.friction, [False]])
        edges = np.flatnonzero(np.diff(lacking.astype(int)))
        starts, stops = edges[::2], edges[1::2] - 1
        return [
            (float(self.arc_length[i]), float(self.arc_length[j]))
            for i, j in zip(starts, stops, strict=True)
        ]


@arguments.checked(
    RodError,
    friction=arguments.optional(arguments.number(0.0, 1e3)),
    spacing=arguments.number(1e-5, 10.0),
)
def friction_bound(
    pattern: Pattern,
    rod: RodModel | RodMaterial,
    friction: float | None = None,
    spacing: float = 0.001,
) -> FrictionBound:
    """Static friction that holds the pattern: mu_s >= k_b ``|kappa''|`` / (rho A g).

    In the paper's L_gb this is 2 L_gb^3 ``|kappa''|``, whatever the density. Of a rod that varies,
    k_b (the mean of both directions) and weight are those of the place.

    Args:
        pattern: with its remainder, if it has one.
        rod: the `RodMaterial` or `RodModel` that is laid.
        friction: static friction coefficient mu_s of the substrate [-].
        spacing: distance between the points looked at [m].

    Raises:
        PatternError: friction or spacing is not a positive finite number.
    """
    for name, value in (("friction", friction), ("spacing", spacing)):
        if value is not None and arguments.wrong(arguments.number(above=0.0), value):
            raise PatternError(f"{name} is {arguments.shown(value)}; give a positive number")
    first = -pattern.remainder_length
    count = max(int(np.ceil((pattern.length - first) / spacing)), 2) + 1
    s = np.linspace(first, pattern.length, count)
    acceleration = pattern.curvature_derivative(s, 2)
    model, laid = RodModel.of(rod), s - first
    stiffness = 0.5 * sum(b(laid) for b in model.bending_stiffness)
    required = stiffness * np.abs(acceleration) / (model.line_mass(laid) * model.gravity)
    return FrictionBound(s, required, friction)
