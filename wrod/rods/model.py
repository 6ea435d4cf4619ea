"""What a rod is, per arc length: the one description that every part of wrod takes."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from wrod import arguments
from wrod.errors import RodError, WrodWarning
from wrod.rods.law import LAWS, BendingLaw, Linear
from wrod.rods.material import RodMaterial, refuse_lumps
from wrod.rods.profile import Profile, as_number, as_pair, as_profile
from wrod.rods.transformations import RodTransformations

if TYPE_CHECKING:
    from collections.abc import Sequence

    AnyProfile = Profile | float | dict[str, list[float]]

_MOST_POINT_MASSES = 1000
_NONE, _LINEAR = Profile((0.0,)), Linear()
# A uniform round section has k_s h^2 = 4 k_b, but for rounding.
_ROUND = 1e-9


@dataclass(frozen=True)
class RodModel(RodTransformations):
    """An elastic rod whose properties may differ along it and across its section.

    Arc length s runs from the end that is laid first. The material frame is (m_1, m_2, t), t = m_1
    x m_2 the tangent. Curvature is dt/ds = c_1 m_1 + c_2 m_2 (positive c_1: the rod turns towards
    m_1), twist is (dm_1/ds) . m_2. Nothing else in wrod has another sign.

    Wherever it says profile: a number, a `Profile`, or {"knots": [...], "values": [...]}.

    Args:
        length: total length [m].
        bending_stiffness: (B_1, B_2), profiles, against curvature towards the two principal
            directions of the section; one profile for both [N m^2].
        twisting_stiffness: profile [N m^2].
        stretching_stiffness: profile [N].
        line_mass: mass per length, profile [kg/m].
        radius: of the section, where it touches [m].
        principal_angle: from m_1 towards m_2 to the first principal direction [rad]. Where it turns
            along the rod, let m_1 turn with it: that is natural twist.
        natural_curvature: (c_1, c_2) at rest, profiles [1/m].
        natural_twist: twist at rest, profile [rad/m].
        point_masses: ((arc length [m], mass [kg]), ...).
        law: of bending; `wrod.rods.law`.
        internal_damping: Kelvin-Voigt time of the material [s]; None: nobody has measured it, and
            deployments take that of recorded cables (`wrod.deployment.assembly.INTERNAL_DAMPING`).
        relaxation_time: time in which the moments of internal damping relax [s]; 0: they do not
            (Kelvin and Voigt).
        air_damping: drag per mass and velocity [1/s].
        quadratic_drag: drag per length of rod, mean line mass and velocity squared [1/m].
        gravity: gravitational acceleration [m/s^2].

    Raises:
        RodError: a number is not finite, not positive where it must be, or not on the rod.
    """

    length: float
    bending_stiffness: tuple[Profile, Profile]
    twisting_stiffness: Profile
    stretching_stiffness: Profile
    line_mass: Profile
    radius: float
    principal_angle: float = 0.0
    natural_curvature: tuple[Profile, Profile] = (_NONE, _NONE)
    natural_twist: Profile = _NONE
    point_masses: tuple[tuple[float, float], ...] = ()
    law: BendingLaw = _LINEAR
    internal_damping: float | None = None
    relaxation_time: float = 0.0
    air_damping: float = 0.0
    quadratic_drag: float = 0.0
    gravity: float = 9.81

    if TYPE_CHECKING:  # what it takes, which becomes profiles

        def __init__(
            self,
            length: float,
            bending_stiffness: AnyProfile | tuple[AnyProfile, AnyProfile],
            twisting_stiffness: AnyProfile,
            stretching_stiffness: AnyProfile,
            line_mass: AnyProfile,
            radius: float,
            principal_angle: float = 0.0,
            natural_curvature: tuple[AnyProfile, AnyProfile] = (_NONE, _NONE),
            natural_twist: AnyProfile = _NONE,
            point_masses: Sequence[tuple[float, float]] = (),
            law: BendingLaw = _LINEAR,
            internal_damping: float | None = None,
            relaxation_time: float = 0.0,
            air_damping: float = 0.0,
            quadratic_drag: float = 0.0,
            gravity: float = 9.81,
        ) -> None: ...

    @arguments.checked(RodError)
    def __post_init__(self) -> None:
        def put(name, value):
            object.__setattr__(self, name, value)

        for name in ("length", "radius", "gravity"):
            put(name, as_number(name, getattr(self, name), positive=True))
        put("principal_angle", as_number("principal_angle", self.principal_angle))
        for name in ("internal_damping", "relaxation_time", "air_damping", "quadratic_drag"):
            if name != "internal_damping" or self.internal_damping is not None:
                put(name, as_number(name, getattr(self, name), least=0.0))
        put("bending_stiffness", as_pair("bending_stiffness", self.bending_stiffness, same=True))
        put("natural_curvature", as_pair("natural_curvature", self.natural_curvature))
        for name in ("twisting_stiffness", "stretching_stiffness", "line_mass", "natural_twist"):
            put(name, as_profile(name, getattr(self, name)))
        for name, profile in (
            *(("bending_stiffness", p) for p in self.bending_stiffness),
            *((n, getattr(self, n)) for n in ("twisting_stiffness", "stretching_stiffness")),
            ("line_mass", self.line_mass),
        ):
            if not profile.smallest > 0.0:
                raise RodError(
                    f"rod {name} falls to {profile.smallest:g}; it must be positive everywhere"
                )
        put("point_masses", self._point_masses())
        if not isinstance(self.law, tuple(LAWS.values())):
            known = ", ".join(law.__name__ for law in LAWS.values())
            raise RodError(
                f"rod law is {arguments.shown(self.law)}; use one of wrod.rods.law: {known}"
            )

    def _point_masses(self) -> tuple[tuple[float, float], ...]:
        try:
            masses = arguments.floats(self.point_masses, "rod point_masses", RodError)
            masses = masses.reshape(-1, 2)
        except ValueError:
            masses = np.full((1, 2), np.nan)
        good = len(masses) <= _MOST_POINT_MASSES and np.isfinite(masses).all()
        on_rod = (masses[:, 0] >= 0.0) & (masses[:, 0] <= self.length * (1.0 + 1e-9))
        if not (good and on_rod.all() and (masses[:, 1] >= 0.0).all()):
            raise RodError(
                f"rod point_masses must be pairs of an arc length from 0 to {self.length:g} m and "
                f"a mass of at least 0 kg, at most {_MOST_POINT_MASSES}"
            )
        return tuple((float(s), float(m)) for s, m in masses)

    # ---- to and from a uniform rod ------------------------------------------------------------

    @classmethod
    def of(cls, rod: RodModel | RodMaterial) -> RodModel:
        """A model as it is, or that of a `RodMaterial`.

        Raises:
            RodError: it is neither.
        """
        if isinstance(rod, RodModel):
            return rod
        if not isinstance(rod, RodMaterial):
            raise RodError(
                f"rod is {type(rod).__name__}; give a wrod.RodMaterial or a wrod.RodModel"
            )
        return cls(
            length=rod.length,
            bending_stiffness=rod.bending_stiffness,
            twisting_stiffness=rod.twisting_stiffness,
            stretching_stiffness=rod.stretching_stiffness,
            line_mass=rod.weight / rod.gravity,
            radius=rod.radius,
            natural_curvature=rod.natural_curvature,
            gravity=rod.gravity,
        )

    def refuse_lump(self) -> None:
        """Refuse what is too thick for its stiffness or length to be a rod.

        Raises:
            RodError: see `RodMaterial`.
        """
        curvature = math.hypot(*(max(map(abs, c.values)) for c in self.natural_curvature))
        refuse_lumps(self.radius, self.gravito_bending_length, self.length, curvature)
        twist = max(map(abs, self.natural_twist.values))
        if twist * self.radius > 2.0 * math.pi:
            raise RodError(
                f"rod natural_twist is {twist:g} rad/m with a radius of {self.radius:g} m, more "
                "than a turn for each; check both numbers and their units"
            )

    def not_uniform(self) -> tuple[str, ...]:
        """What a `RodMaterial` cannot carry of this rod, by the names of the fields."""
        first, second = self.bending_stiffness
        h2 = self.radius**2
        stretching = self.stretching_stiffness
        found = {
            "stretching_stiffness": not stretching.is_constant
            or abs(stretching.values[0] * h2 / (4.0 * self.mean_bending_stiffness) - 1.0) > _ROUND,
            "twisting_stiffness": not -1.0 < self.poisson <= 0.5 * (1.0 + _ROUND),
            "principal_angle": False,
            "natural_twist": self.natural_twist != _NONE,
            "point_masses": bool(self.point_masses),
            "law": not isinstance(self.law, Linear),
            "internal_damping": self.internal_damping is not None,
            "relaxation_time": self.relaxation_time > 0.0,
            "air_damping": self.air_damping > 0.0,
            "quadratic_drag": self.quadratic_drag > 0.0,
            "bending_stiffness": not (first.is_constant and first == second),
            "line_mass": not self.line_mass.is_constant,
            "natural_curvature": not all(c.is_constant for c in self.natural_curvature),
        }
        found["twisting_stiffness"] |= not self.twisting_stiffness.is_constant
        return tuple(name for name, there in found.items() if there)

    def material(self, *, strict: bool = False) -> RodMaterial:
        """The uniform, isotropic, linear rod with this one's means.

        Args:
            strict: raise where the rod is more than that, instead of a warning.

        Raises:
            RodError: see `strict`.

        Warns:
            WrodWarning: names what was set aside.
        """
        aside = self.not_uniform()
        if aside:
            said = f"a uniform, isotropic, linear rod cannot carry this one's {', '.join(aside)}"
            if strict:
                raise RodError(f"{said}; use the wrod.RodModel itself")
            warnings.warn(f"{said}; their means are kept, or nothing", WrodWarning, stacklevel=2)
        area = math.pi * self.radius**2
        first, second = self.natural_curvature
        return RodMaterial(
            self.radius,
            self.gravito_bending_length,
            self.length,
            min(max(self.poisson, -1.0 + 1e-9), 0.5),
            self.weight / self.gravity / area,
            self.gravity,
            (self._mean(first), self._mean(second)),
        )

    # ---- figures ------------------------------------------------------------------------------

    def _mean(self, profile: Profile) -> float:
        return float(profile.mean(0.0, self.length))

    @property
    def mean_bending_stiffness(self) -> float:
        """k_b: mean over the rod and over both directions [N m^2]."""
        first, second = (self._mean(b) for b in self.bending_stiffness)
        return 0.5 * (first + second)

    @property
    def weight(self) -> float:
        """Mean weight per length, without point masses [N/m]."""
        return self._mean(self.line_mass) * self.gravity

    @property
    def gravito_bending_length(self) -> float:
        """L_gb = (k_b / (2 w))^(1/3) of the means [m]."""
        return (self.mean_bending_stiffness / (2.0 * self.weight)) ** (1.0 / 3.0)

    @property
    def stretch_ratio(self) -> float:
        """Dimensionless stretching stiffness k_s L_gb^2 / k_b of the means [-]."""
        mean = self._mean(self.stretching_stiffness)
        return mean * self.gravito_bending_length**2 / self.mean_bending_stiffness

    @property
    def poisson(self) -> float:
        """k_b / k_t - 1 of the means, Poisson's ratio of a round section [-]."""
        ratio = self.mean_bending_stiffness / self._mean(self.twisting_stiffness) - 1.0
        return 0.5 if abs(ratio - 0.5) < _ROUND else ratio  # no more than 0.5 but for rounding

    @property
    def is_straight(self) -> bool:
        """Whether the rod is straight at rest, twisted or not."""
        return all(c == _NONE for c in self.natural_curvature)

    @property
    def varying(self) -> list[Profile]:
        """The properties that change along the rod."""
        profiles = (*self.bending_stiffness, *self.natural_curvature, self.twisting_stiffness,
                    self.stretching_stiffness, self.line_mass, self.natural_twist)  # fmt: skip
        return [p for p in profiles if not p.is_constant]

    @property
    def varies(self) -> bool:
        """Whether any property changes along the rod."""
        return bool(self.varying)

    @property
    def has_sides(self) -> bool:
        """Whether it matters how the rod is rolled about its tangent: also of one that stays bent
        it does, once it was bent."""
        return not (self.is_straight and self.is_isotropic) or self.law.at_rest is None

    @property
    def is_isotropic(self) -> bool:
        """Whether the rod bends as easily in every direction."""
        first, second = self.bending_stiffness
        return first == second

    @arguments.checked(RodError, s=arguments.numbers_of_any_shape)
    def rolled(self, s) -> np.ndarray:
        """Angle by which m_1 has turned at arc lengths `s` [m] where the rod lies with the twist
        that it has at rest [rad]."""
        return self.natural_twist.integral(0.0, s)

    @arguments.checked(RodError, roll=arguments.numbers_of_any_shape)
    def curvature_held(self, roll: float) -> tuple[float, float]:
        """(to the left, upwards) mean curvature at rest [1/m] of the rod laid straight, m_1 at its
        beginning turned by `roll` [rad] from left towards up."""
        s = np.linspace(0.0, self.length, 1 if not self.varies and self._untwisted else 401)
        first, second = (c(s) for c in self.natural_curvature)
        turned = np.asarray(roll) + self.rolled(s)
        mean = np.mean((first + 1j * second) * np.exp(1j * turned))
        return float(mean.real), float(mean.imag)

    @property
    def _untwisted(self) -> bool:
        return self.natural_twist == _NONE

    @property
    def is_uniform(self) -> bool:
        """Whether it is uniform, isotropic, linear and untwisted at rest: what the shipped
        controllers and `solve_grasps` know. Damping, and what it stretches and twists by, are its
        own."""
        plain = isinstance(self.law, Linear) and not self.point_masses and self._untwisted
        return plain and self.is_isotropic and not self.varies


# What is asked for wherever a rod is.
Rod = RodModel | RodMaterial
