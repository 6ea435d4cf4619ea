"""The same rod otherwise: bent, stiffened, cut, turned round, in other directors or units."""

import math
from dataclasses import dataclass, replace
from typing import Any, Self

from wrod import arguments
from wrod.errors import RodError
from wrod.rods.profile import as_number


@dataclass(frozen=True)
class RodTransformations:
    """What `wrod.RodModel` makes of itself."""

    length: Any
    bending_stiffness: Any
    twisting_stiffness: Any
    stretching_stiffness: Any
    line_mass: Any
    radius: Any
    principal_angle: Any
    natural_curvature: Any
    natural_twist: Any
    point_masses: Any
    law: Any
    internal_damping: Any
    relaxation_time: Any
    air_damping: Any
    quadratic_drag: Any
    gravity: Any

    @property
    def is_isotropic(self) -> bool:
        raise NotImplementedError

    @arguments.checked(RodError, roll=arguments.number())
    def bent(self, left: float, up: float = 0.0, roll: float = 0.0) -> Self:
        """A rod with more natural curvature [1/m]: `left` towards the direction that m_1 is turned
        from by `roll` [rad], `up` a quarter turn from there."""
        held = self.turned(roll)
        first, second = held.natural_curvature
        return replace(held, natural_curvature=(first + left, second + up)).turned(-roll)

    @arguments.checked(RodError, factor=arguments.number(above=0.0))
    def stiffened(self, factor: float) -> Self:
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
    def piece(self, start: float, stop: float) -> Self:
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

    def reversed(self) -> Self:
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
    def turned(self, roll: float) -> Self:
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
    def scaled(self, length_unit: float, force_unit: float) -> Self:
        """The rod in other units: lengths in `length_unit` [m], forces in `force_unit` [N], and
        times such that gravity is 1. With L_gb and k_b / L_gb^2 the means are k_b = 1, weight 1/2.

        Raises:
            RodError: a unit is not positive.
        """
        length = as_number("length_unit", length_unit, positive=True)
        force = as_number("force_unit", force_unit, positive=True)
        time = math.sqrt(length / self.gravity)
        mass = force / self.gravity

        def by(unit):
            return lambda profile: profile.scaled(1.0 / unit, 1.0 / length)

        stiffness, curvature = by(force * length**2), by(1.0 / length)
        own = self.internal_damping
        return replace(
            self,
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
            internal_damping=None if own is None else own / time,
            relaxation_time=self.relaxation_time / time,
            air_damping=self.air_damping * time,
            quadratic_drag=self.quadratic_drag * length,
            gravity=1.0,
        )

    def _mapped(self, change) -> Self:
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
