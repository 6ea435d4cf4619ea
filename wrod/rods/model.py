"""What a rod is, per arc length: the one description that every part of wrod takes."""

from __future__ import annotations

import math
import sys
import warnings
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from wrod import arguments
from wrod.errors import RodError, WrodWarning
from wrod.rods.law import LAWS, Law, Linear
from wrod.rods.profile import Profile

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence
    from pathlib import Path

    from wrod.rods.material import RodMaterial

    AnyProfile = Profile | float | dict[str, list[float]]

_MOST_POINT_MASSES = 1000
_NONE, _LINEAR = Profile((0.0,)), Linear()
# A uniform round section has k_s h^2 = 4 k_b, but for rounding.
_ROUND = 1e-9


@dataclass(frozen=True)
class RodModel:
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
        internal_damping: Kelvin-Voigt time of the material [s].
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
    law: Law = _LINEAR
    internal_damping: float = 0.0
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
            law: Law = _LINEAR,
            internal_damping: float = 0.0,
            air_damping: float = 0.0,
            quadratic_drag: float = 0.0,
            gravity: float = 9.81,
        ) -> None: ...

    def __post_init__(self) -> None:
        def put(name, value):
            object.__setattr__(self, name, value)

        for name in ("length", "radius", "gravity"):
            put(name, _number(name, getattr(self, name), positive=True))
        put("principal_angle", _number("principal_angle", self.principal_angle))
        for name in ("internal_damping", "air_damping", "quadratic_drag"):
            put(name, _number(name, getattr(self, name), least=0.0))
        put("bending_stiffness", _pair("bending_stiffness", self.bending_stiffness, same=True))
        put("natural_curvature", _pair("natural_curvature", self.natural_curvature))
        for name in ("twisting_stiffness", "stretching_stiffness", "line_mass", "natural_twist"):
            put(name, _profile(name, getattr(self, name)))
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
            raise RodError(f"rod law is {self.law!r:.80}; use one of wrod.rods.law: {_names(LAWS)}")

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
        if not hasattr(rod, "model"):
            raise RodError(
                f"rod is {type(rod).__name__}; give a wrod.RodMaterial or a wrod.RodModel"
            )
        return rod.model()

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
            "internal_damping": self.internal_damping > 0.0,
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
        from wrod.rods.material import RodMaterial

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
    def varies(self) -> bool:
        """Whether any property changes along the rod."""
        profiles = (*self.bending_stiffness, *self.natural_curvature, self.twisting_stiffness,
                    self.stretching_stiffness, self.line_mass, self.natural_twist)  # fmt: skip
        return not all(p.is_constant for p in profiles)

    @property
    def has_sides(self) -> bool:
        """Whether it matters how the rod is rolled about its tangent."""
        return not (self.is_straight and self.is_isotropic)

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
        mean = np.mean((first + 1j * second) * np.exp(1j * (roll + self.rolled(s))))
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

    # ---- the same rod otherwise ---------------------------------------------------------------

    @arguments.checked(RodError, roll=arguments.number())
    def bent(self, left: float, up: float = 0.0, roll: float = 0.0) -> RodModel:
        """A rod with more natural curvature [1/m]: `left` towards the direction that m_1 is turned
        from by `roll` [rad], `up` a quarter turn from there."""
        held = self.turned(roll)
        first, second = held.natural_curvature
        return replace(held, natural_curvature=(first + left, second + up)).turned(-roll)

    @arguments.checked(RodError, factor=arguments.number(above=0.0))
    def stiffened(self, factor: float) -> RodModel:
        """A rod of which every stiffness is `factor` times as large."""

        def more(profile):
            return profile.scaled(factor)

        return replace(
            self,
            bending_stiffness=tuple(map(more, self.bending_stiffness)),
            twisting_stiffness=more(self.twisting_stiffness),
            stretching_stiffness=more(self.stretching_stiffness),
        )

    @arguments.checked(RodError, start=arguments.number(), stop=arguments.number())
    def piece(self, start: float, stop: float) -> RodModel:
        """What lies between two arc lengths [m], counted from the first.

        Raises:
            RodError: that is not a piece of the rod.
        """
        slack = 1e-9 * self.length
        if not (-slack <= start < stop <= self.length + slack):
            raise RodError(
                f"there is no piece of the rod from {start!r} to {stop!r} m; it is "
                f"{self.length:g} m long"
            )

        def cut(profile):
            return profile.piece(start, stop)

        masses = tuple(
            (min(max(s - start, 0.0), stop - start), m)
            for s, m in self.point_masses
            if start <= s < stop or s >= stop >= self.length - slack
        )
        return replace(self._mapped(cut), length=stop - start, point_masses=masses)

    def reversed(self) -> RodModel:
        """The same rod laid from its other end: m_1 stays, m_2 and the tangent turn round."""
        length = self.length
        other = self._mapped(lambda profile: profile.reversed(length))
        first, second = other.natural_curvature
        masses = tuple((min(max(length - s, 0.0), length), m) for s, m in self.point_masses[::-1])
        return replace(
            other,
            principal_angle=-self.principal_angle,
            natural_curvature=(first, second.scaled(-1.0)),
            point_masses=masses,
        )

    @arguments.checked(RodError, roll=arguments.number())
    def turned(self, roll: float) -> RodModel:
        """The same rod described in other directors: m_1 of this one is turned by `roll` [rad]
        from their first towards their second. A rod held at a roll has it from left towards up."""
        if roll == 0.0 and not (self.principal_angle and self.is_isotropic):
            return self
        cosine, sine = math.cos(roll), math.sin(roll)
        first, second = self.natural_curvature
        return replace(
            self,
            # A section that bends as easily in every direction has no principal ones.
            principal_angle=0.0 if self.is_isotropic else self.principal_angle + roll,
            natural_curvature=(
                first.scaled(cosine) + second.scaled(-sine),
                first.scaled(sine) + second.scaled(cosine),
            ),
        )

    @arguments.checked(
        RodError, length_unit=arguments.number(1e-9, 1e9), force_unit=arguments.number(1e-12, 1e12)
    )
    def scaled(self, length_unit: float, force_unit: float) -> RodModel:
        """The rod in other units: lengths in `length_unit` [m], forces in `force_unit` [N], and
        times such that gravity is 1. With L_gb and k_b / L_gb^2 the means are k_b = 1, weight 1/2.

        Raises:
            RodError: a unit is not positive.
        """
        length = _number("length_unit", length_unit, positive=True)
        force = _number("force_unit", force_unit, positive=True)
        time = math.sqrt(length / self.gravity)
        mass = force / self.gravity

        def by(unit):
            return lambda profile: profile.scaled(1.0 / unit, 1.0 / length)

        stiffness, curvature = by(force * length**2), by(1.0 / length)
        return RodModel(
            length=self.length / length,
            bending_stiffness=tuple(map(stiffness, self.bending_stiffness)),
            twisting_stiffness=stiffness(self.twisting_stiffness),
            stretching_stiffness=by(force)(self.stretching_stiffness),
            line_mass=by(mass / length)(self.line_mass),
            radius=self.radius / length,
            principal_angle=self.principal_angle,
            natural_curvature=tuple(map(curvature, self.natural_curvature)),
            natural_twist=curvature(self.natural_twist),
            point_masses=tuple((s / length, m / mass) for s, m in self.point_masses),
            law=self.law.scaled(length, time),
            internal_damping=self.internal_damping / time,
            air_damping=self.air_damping * time,
            quadratic_drag=self.quadratic_drag * length,
            gravity=1.0,
        )

    def _mapped(self, change) -> RodModel:
        """The rod with every profile changed."""
        return replace(
            self,
            bending_stiffness=tuple(map(change, self.bending_stiffness)),
            natural_curvature=tuple(map(change, self.natural_curvature)),
            **{
                name: change(getattr(self, name))
                for name in (
                    "twisting_stiffness", "stretching_stiffness", "line_mass", "natural_twist"
                )
            },
        )  # fmt: skip

    # ---- files --------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str], *, assumed=()) -> Path:
        """Write the rod as JSON, SI units; `assumed` names numbers that nobody measured."""
        from wrod.rods.model_file import save_model

        return save_model(self, path, assumed=assumed)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        radius: float | None = None,
        length: float | None = None,
    ) -> RodModel:
        """Read a rod that `save`, `RodMaterial.save`, `wrod loop` or `wrod identify` wrote.

        Args:
            radius, length: instead of the file's, which measurements may not tell [m].

        Raises:
            RodError: the file is missing, not a rod file, or holds unphysical values.

        Warns:
            WrodWarning: the file holds numbers that were not measured, or, written by an earlier
                version, effects that it cannot carry.
        """
        from wrod.rods.model_file import load_model

        return load_model(path, radius=radius, length=length)


def _names(laws: dict) -> str:
    return ", ".join(law.__name__ for law in laws.values())


# What stands in for a profile of what is one number for the whole rod.
_INSTEAD = {
    "radius": "the largest one, which touches",
    "principal_angle": "that at the beginning, and how it turns from there as natural_twist",
}


def _number(name: str, value, *, positive: bool = False, least: float = -math.inf) -> float:
    if isinstance(value, (Profile, dict)):
        raise RodError(
            f"rod {name} is a profile and can only be one number for the whole rod; give "
            f"{_INSTEAD.get(name, 'its mean')}"
        )
    is_number = isinstance(value, (int, float, np.floating, np.integer))
    if (
        not is_number
        or isinstance(value, bool)
        or not abs(value) <= sys.float_info.max
        or value < least
        or (positive and value <= 0.0)
    ):
        wanted = (
            "a positive" if positive else "a" if least == -math.inf else f"at least {least:g}, a"
        )
        raise RodError(f"rod {name} is {value!r:.80}; give {wanted} finite number in SI units")
    return float(value)


def _profile(name: str, value) -> Profile:
    try:
        return Profile.of(value)
    except RodError as error:
        raise RodError(f"rod {name}: {error}") from None


def _pair(name: str, value, *, same: bool = False) -> tuple[Profile, Profile]:
    if same and not isinstance(value, (tuple, list)):
        value = (value, value)
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise RodError(f"rod {name} is {value!r:.80}; give two profiles, one per direction")
    return _profile(name, value[0]), _profile(name, value[1])
