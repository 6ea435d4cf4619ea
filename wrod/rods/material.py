"""Rods: the material and geometry that the plan depends on (paper, Sec. Measurement of Material
Parameters and Table 2)."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

from wrod import arguments
from wrod.errors import RodError, WrodWarning

# Height of the loop of a heavy rod over its gravito-bending length: the heavy elastica's and a
# discrete rod's (tests/physics/test_loop.py). The paper's 0.9066 belongs to
# (k_b/(pi h^2 rho g))^(1/3), 2^(1/3) larger.
LOOP_HEIGHT_RATIO = 1.14224
# Rod between where it leaves the table and where it meets it again, over L_gb.
LOOP_LENGTH_RATIO = 5.83
# What rods, on whatever planet, may have: beyond, stiffnesses leave the range of float64.
_BOUNDS = {
    "radius": (1e-7, 10.0),
    "gravito_bending_length": (1e-6, 1e4),
    "length": (1e-6, 1e6),
    "density": (1e-6, 1e7),
    "gravity": (1e-9, 5e3),  # the Earth's in mm/s^2 is more
}
# L_gb and length over the radius [-]: with less, what bends is a lump and no rod. A gel of 50 kPa
# and 1 cm radius has an L_gb of 3.9 radii.
_SLENDER = {"gravito_bending_length": 2.0, "length": 10.0}
# What is thicker or longer was more likely meant in millimetres, which as a whole are refused by no
# bound: they are a rod of a thousand times the modulus, and there are pipes of that [m].
_THICK, _LONG = 0.1, 100.0
# Nothing has a larger Young's modulus [Pa].
_STIFFEST = 2e12


def refuse_lumps(
    radius: float, gravito_bending_length: float, length: float, curvature: float
) -> None:
    """Refuse what no theory of rods describes.

    Args:
        radius, gravito_bending_length, length: [m].
        curvature: largest at rest [1/m].

    Raises:
        RodError: L_gb or length are too short for the radius, or it bends at rest into itself.
    """
    values = {"gravito_bending_length": gravito_bending_length, "length": length}
    for name, least in _SLENDER.items():
        if values[name] < least * radius:
            raise RodError(
                f"rod {name} is {values[name]:g} m with a radius of {radius:g} m; a rod has at "
                f"least {least:g} radii, so check both numbers and their units"
            )
    if curvature * radius >= 1.0:
        raise RodError(
            f"rod natural_curvature is {curvature:g} 1/m with a radius of {radius:g} m; no rod "
            "bends tighter than its own radius, so check both numbers and their units"
        )


def ask_after_units(
    radius: float, length: float, gravito_bending_length: float, stacklevel: int
) -> None:
    """Warn of what was likely meant in millimetres; `stacklevel` as `warnings.warn` counts it from
    here."""
    if radius > _THICK or length > _LONG:
        said = (
            f"a rod of {radius:g} m in radius and {length:g} m in length, with an L_gb of "
            f"{gravito_bending_length:g} m (millimetres?)"
        )
        warnings.warn(WrodWarning(said), stacklevel=stacklevel)


@dataclass(frozen=True)
class RodMaterial:
    """A uniform, isotropic, linearly elastic rod of circular section, straight unless it says not.

    Args:
        radius: radius h of the section [m].
        gravito_bending_length: L_gb = (k_b / (2 pi h^2 rho g))^(1/3) [m]
            (Eq. nondimensionl_mapping).
        length: total length L [m].
        poisson: Poisson's ratio [-].
        density: mass density rho [kg/m^3].
        gravity: gravitational acceleration g [m/s^2].
        natural_curvature: (c_1, c_2), the curvature at rest dt/ds = c_1 m_1 + c_2 m_2 in the
            material frame (m_1, m_2, tangent t = m_1 x m_2), arc length growing from the end that
            is laid first; (0, 0) is a straight rod [1/m].

    Raises:
        RodError: a value is not finite, not positive, or Poisson's ratio is outside (-1, 0.5]; L_gb
            is under 2 or the length under 10 radii; it bends at rest tighter than its radius.

    Warns:
        WrodWarning: it is thicker than 20 cm or longer than 100 m.
    """

    radius: float
    gravito_bending_length: float
    length: float
    poisson: float = 0.5
    density: float = 1180.0
    gravity: float = 9.81
    natural_curvature: tuple[float, float] = (0.0, 0.0)

    @arguments.checked(RodError)
    def __post_init__(self) -> None:
        for name in ("radius", "gravito_bending_length", "length", "density", "gravity"):
            value = getattr(self, name)
            low, high = _BOUNDS[name]
            if arguments.wrong(arguments.number(above=0.0), value) is not None:
                raise RodError(
                    f"rod {name} is {arguments.shown(value)}; give a positive finite number in SI "
                    "units"
                )
            if not low <= value <= high:
                raise RodError(
                    f"rod {name} is {arguments.shown(value)}; no rod has that, give {low:g} to "
                    f"{high:g} in SI units"
                )
        if arguments.wrong(arguments.number(above=-1.0, high=0.5), self.poisson) is not None:
            raise RodError(
                f"rod poisson is {arguments.shown(self.poisson)}; an elastic rod needs a value in "
                "(-1, 0.5]"
            )
        if arguments.wrong(arguments.array((2,)), self.natural_curvature) is not None:
            raise RodError(
                f"rod natural_curvature is {arguments.shown(self.natural_curvature)}; give two "
                "finite numbers, the components along the material directors in 1/m"
            )
        first, second = (float(value) for value in self.natural_curvature)
        object.__setattr__(self, "natural_curvature", (first, second))
        lengths = self.gravito_bending_length, self.length
        refuse_lumps(self.radius, *lengths, math.hypot(first, second))
        if self.youngs_modulus > _STIFFEST:
            raise RodError(
                f"rod gravito_bending_length is {self.gravito_bending_length:g} m with a radius of "
                f"{self.radius:g} m and a density of {self.density:g} kg/m^3: a Young's modulus of "
                f"{self.youngs_modulus:.2g} Pa, stiffer than diamond; check the numbers' units"
            )
        ask_after_units(self.radius, self.length, self.gravito_bending_length, stacklevel=5)

    @classmethod
    @arguments.checked(RodError)
    def from_youngs_modulus(
        cls,
        youngs_modulus: float,
        radius: float,
        length: float,
        *,
        poisson: float = 0.5,
        density: float = 1180.0,
        gravity: float = 9.81,
    ) -> RodMaterial:
        """Rod of a known Young's modulus [Pa]: L_gb = (E h^2 / (8 rho g))^(1/3) (Eq. material)."""
        if arguments.wrong(arguments.number(above=0.0, high=1e15), youngs_modulus) is not None:
            raise RodError(
                f"rod youngs_modulus is {arguments.shown(youngs_modulus)}; give a positive number "
                "of pascals"
            )
        if youngs_modulus > _STIFFEST:
            raise RodError(f"rod youngs_modulus is {youngs_modulus:g} Pa; diamond has 1.2e12 Pa")
        good = arguments.wrong(arguments.number(*_BOUNDS["radius"]), radius) is None
        long = max(1.0, 2.0 * radius) if good else 1.0
        probe = cls(radius, long, length, poisson, density, gravity)  # before the division
        lgb = (youngs_modulus * radius**2 / (8.0 * probe.density * probe.gravity)) ** (1.0 / 3.0)
        return cls(radius, lgb, length, poisson, density, gravity)

    @classmethod
    @arguments.checked(RodError, loop_height=arguments.number())
    def from_loop_height(
        cls,
        loop_height: float,
        radius: float,
        length: float,
        *,
        poisson: float = 0.5,
        density: float = 1180.0,
        gravity: float = 9.81,
    ) -> RodMaterial:
        """Rod whose folded loop stands `loop_height` [m] above the table (Fig. material).

        The height is that of the centreline above the flat part's centreline, and is
        1.14224 L_gb (tests/physics/test_loop.py), not the paper's 0.9066 L_gb.

        Raises:
            RodError: as the constructor, or the rod is too short for such a loop.
        """
        if not (isinstance(loop_height, (int, float)) and 0 < loop_height < math.inf):
            raise RodError(f"loop height is {loop_height!r:.80}; give a positive number of metres")
        rod = cls(radius, loop_height / LOOP_HEIGHT_RATIO, length, poisson, density, gravity)
        needed = LOOP_LENGTH_RATIO * rod.gravito_bending_length
        if length < needed:
            raise RodError(
                f"a rod of length {length:g} m stands no loop of height {loop_height:g} m: "
                f"{needed:.3g} m are off the table in that; check both numbers"
            )
        return rod

    @property
    def is_straight(self) -> bool:
        """Whether the rod is straight at rest."""
        return self.natural_curvature == (0.0, 0.0)

    @arguments.checked(RodError, roll=arguments.number())
    def curvature_held(self, roll: float) -> tuple[float, float]:
        """(to the left, upwards) curvature at rest [1/m] of the rod laid straight, its first
        material director turned by `roll` [rad] from left towards up."""
        first, second = self.natural_curvature
        cosine, sine = math.cos(roll), math.sin(roll)
        return first * cosine - second * sine, first * sine + second * cosine

    @property
    def stretch_ratio(self) -> float:
        """Dimensionless stretching stiffness k_s L_gb^2 / k_b = 4 L_gb^2 / h^2 [-]."""
        return 4.0 * self.gravito_bending_length**2 / self.radius**2

    @property
    def weight(self) -> float:
        """Weight per unit length [N/m]."""
        return math.pi * self.radius**2 * self.density * self.gravity

    @property
    def bending_stiffness(self) -> float:
        """k_b = E pi h^4 / 4 [N m^2]."""
        return 2.0 * self.weight * self.gravito_bending_length**3

    @property
    def stretching_stiffness(self) -> float:
        """k_s = E pi h^2 [N]."""
        return 4.0 * self.bending_stiffness / self.radius**2

    @property
    def twisting_stiffness(self) -> float:
        """k_t = G pi h^4 / 2 = k_b / (1 + nu) [N m^2]."""
        return self.bending_stiffness / (1.0 + self.poisson)

    @property
    def youngs_modulus(self) -> float:
        """E [Pa]."""
        return 4.0 * self.bending_stiffness / (math.pi * self.radius**4)


# Table 2 of the paper; VPS density 1180 kg/m^3 throughout (it drops out of every plan).
TABLE_2 = {
    "pink-vps": RodMaterial(0.0016, 0.0180, 0.875),
    "green-vps": RodMaterial(0.0016, 0.0320, 0.885),
    "rope": RodMaterial(0.0020, 0.0340, 0.89),
    "pink-vps-thick": RodMaterial(0.0032, 0.0286, 0.84),
    "cable": RodMaterial(0.0018, 0.0801, 0.87),
}
