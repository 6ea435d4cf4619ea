"""A rod as plain arrays, which effects change: what every identification has of it."""

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from wrod.rods.discretisation import in_principal, of_free_part
from wrod.rods.law import Plastic


@dataclass
class RodSetup:
    """Everything of a rod that an effect may change; n edges. SI units, or, where only motion is
    seen, per mean line mass: in m and s.

    The arrays may be complex: a parameter's exact derivative comes from a small imaginary part
    that effects carry through (complex step), so only analytic functions may touch them.

    Attributes:
        fraction: (n + 1,) position of each node along the free length, 0...1 (real).
        bending: (n + 1, 2) bending stiffness about the principal directions [N m^2].
        principal_angle: angle from m1 to the first principal direction of bending [rad].
        twisting: (n + 1,) [N m^2].
        stretching: (n,) EA of each edge [N].
        natural_curvature: (n + 1, 2) components of dt/ds at rest along (m1, m2) [1/m].
        natural_twist: (n + 1,) [rad/m].
        softening: (n + 1, 2) c [m^2] and r of the moment B e (r + (1 - r) / (1 + c e^2)) at an
            excess curvature e; c = 0 is linear.
        yielding: (2,) share of the stiffness that is lost beyond a yield curvature k_y, and k_y
            [1/m], of `wrod.rods.law.Plastic`; 0: none.
        line_mass: (n + 1,) mass per unstretched length [kg/m].
        node_mass: (n + 1,) masses on top of it [kg].
        gravity: (3,) [m/s^2].
    """

    fraction: np.ndarray
    bending: np.ndarray
    principal_angle: complex
    twisting: np.ndarray
    stretching: np.ndarray
    natural_curvature: np.ndarray
    natural_twist: np.ndarray
    softening: np.ndarray
    yielding: np.ndarray
    line_mass: np.ndarray
    node_mass: np.ndarray
    gravity: np.ndarray

    # Power of a factor of every stiffness that stretching goes with; 1 where the radius is known.
    stretching_power: ClassVar[float] = 1.0

    @classmethod
    def plain(
        cls, fraction: np.ndarray, bending: float, twisting: float, stretching: float,
        line_mass: float, gravity: float, **others: Any,
    ) -> Self:  # fmt: skip
        """Of the straight, uniform, isotropic, linear rod; `others` what else there is."""
        nodes = len(fraction)
        return cls(
            fraction=fraction,
            bending=np.full((nodes, 2), bending),
            principal_angle=0.0,
            twisting=np.full(nodes, twisting),
            stretching=np.full(nodes - 1, stretching),
            natural_curvature=np.zeros((nodes, 2)),
            natural_twist=np.zeros(nodes),
            softening=np.zeros((nodes, 2)),
            yielding=np.array([0.0, 1.0]),
            line_mass=np.full(nodes, line_mass),
            node_mass=np.zeros(nodes),
            gravity=np.array([0.0, 0.0, -gravity]),
            **others,
        )

    def on_mesh(self, rest_length: np.ndarray, share: np.ndarray) -> dict[str, np.ndarray]:
        """As arguments of `RodBatch`, but for mass and loads; complex if the setup is.

        Args:
            rest_length: (n,) of the edges.
            share: (n + 1,) of each node's cell that bends and twists, as in `of_free_part`.
        """
        return {
            "rest_length": rest_length,
            "stretching_stiffness": self.stretching,
            **of_free_part(
                share,
                bending_stiffness=self.bending,
                twisting_stiffness=self.twisting,
                natural_curvature=in_principal(self.natural_curvature, self.principal_angle),
                natural_twist=self.natural_twist,
                softening=self.softening,
            ),
        }

    @property
    def inelastic(self) -> np.ndarray:
        """(n + 1, 4) law that yields, as `RodBatch` takes it; complex if the setup is."""
        share, scale = self.yielding
        number = float(Plastic.number) if share else 0.0
        return np.tile([number, share, scale, 1.0], (len(self.fraction), 1))

    @property
    def edge_fraction(self) -> np.ndarray:
        """(n,) position of each edge's middle."""
        return 0.5 * (self.fraction[1:] + self.fraction[:-1])
