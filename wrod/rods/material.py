"""Rods: the material and geometry that the plan depends on (paper, Sec. Measurement of Material
Parameters and Table 2)."""

from __future__ import annotations

import json
import math
import os
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path

from wrod.errors import RodError, WrodWarning
from wrod.files import write_atomically

# Height of the loop of a heavy rod over its gravito-bending length, as
# `wrod.identification.folded_loop` derives it from the heavy elastica. The paper's 0.9066 belongs
# to (k_b/(pi h^2 rho g))^(1/3), 2^(1/3) larger.
LOOP_HEIGHT_RATIO = 1.14224
_FORMAT = "wrod-rod-1"
# What `wrod identify` writes: a rod, and the effects found, some of which the rod's numbers carry.
_MODEL_FORMAT = "wrod-rod-model-1"
_CARRIED = ("stiffness", "density", "natural_curvature")


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
        RodError: a value is not finite, not positive, or Poisson's ratio is outside (-1, 0.5].
    """

    radius: float
    gravito_bending_length: float
    length: float
    poisson: float = 0.5
    density: float = 1180.0
    gravity: float = 9.81
    natural_curvature: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("radius", "gravito_bending_length", "length", "density", "gravity"):
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and math.isfinite(value) and value > 0):
                raise RodError(
                    f"rod {name} is {value!r}; give a positive finite number in SI units"
                )
        if not (isinstance(self.poisson, (int, float)) and -1.0 < self.poisson <= 0.5):
            raise RodError(
                f"rod poisson is {self.poisson!r}; an elastic rod needs a value in (-1, 0.5]"
            )
        try:
            first, second = (float(value) for value in self.natural_curvature)
        except (TypeError, ValueError):
            first = second = math.nan
        if not (math.isfinite(first) and math.isfinite(second)):
            raise RodError(
                f"rod natural_curvature is {self.natural_curvature!r}; give two finite numbers, "
                "the components along the material directors in 1/m"
            )
        object.__setattr__(self, "natural_curvature", (first, second))

    @classmethod
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
        if not (math.isfinite(youngs_modulus) and youngs_modulus > 0):
            raise RodError(
                f"rod youngs_modulus is {youngs_modulus!r}; give a positive number of pascals"
            )
        probe = cls(radius, 1.0, length, poisson, density, gravity)  # validates before the division
        lgb = (youngs_modulus * radius**2 / (8.0 * probe.density * probe.gravity)) ** (1.0 / 3.0)
        return cls(radius, lgb, length, poisson, density, gravity)

    @classmethod
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
        1.14224 L_gb (see `wrod.identification.folded_loop`), not the paper's 0.9066 L_gb.
        """
        if not (math.isfinite(loop_height) and loop_height > 0):
            raise RodError(f"loop height is {loop_height!r}; give a positive number of metres")
        lgb = loop_height / LOOP_HEIGHT_RATIO
        return cls(radius, lgb, length, poisson, density, gravity)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the rod as JSON, SI units."""
        content = {"format": _FORMAT, **asdict(self)}
        return write_atomically(path, lambda file: file.write(json.dumps(content, indent=2) + "\n"))

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        radius: float | None = None,
        length: float | None = None,
    ) -> RodMaterial:
        """Read a rod that `save` or `wrod loop` wrote, or the model that `wrod identify` wrote.

        Args:
            radius, length: instead of the file's, which measurements may not tell [m].

        Raises:
            RodError: the file is missing, not a rod file, or holds unphysical values.

        Warns:
            WrodWarning: the model has effects that a uniform, isotropic, linear rod cannot carry,
                or numbers that were not measured.
        """
        instead = {"radius": radius, "length": length}
        instead = {key: value for key, value in instead.items() if value is not None}
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise RodError(f"{path}: not a readable rod file ({error})") from None
        if isinstance(content, dict) and content.get("format") == _MODEL_FORMAT:
            content = {"format": _FORMAT, **_rod_of_model(path, content, instead)}
        if not isinstance(content, dict) or content.pop("format", None) != _FORMAT:
            raise RodError(f"{path}: is not a {_FORMAT} file; write one with `wrod loop --out`")
        try:
            return cls(**{**content, **instead})
        except TypeError as error:
            reason = str(error).replace("RodMaterial.__init__() ", "")
            raise RodError(f"{path}: {reason}") from None
        except RodError as error:
            raise RodError(f"{path}: {error}") from None

    @property
    def is_straight(self) -> bool:
        """Whether the rod is straight at rest."""
        return self.natural_curvature == (0.0, 0.0)

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


def _rod_of_model(path, content: dict, instead: dict) -> dict:
    """The rod's numbers of an identified model; says what they do not carry, and which of them
    were assumed and are not in `instead`."""
    rod, effects = content.get("rod"), content.get("effects")
    named = isinstance(effects, list) and all(
        isinstance(e, dict) and isinstance(e.get("name"), str) for e in effects
    )
    if not isinstance(rod, dict) or not named:
        raise RodError(f"{path}: holds no rod and effects; write it again with `wrod identify`")
    aside = [e["name"] for e in effects if e["name"] not in _CARRIED]
    assumed = content.get("assumed", [])
    assumed = [key for key in rod if key in assumed and key not in instead]
    said = []
    if aside:
        said.append(
            f"{', '.join(aside)} set aside; plans and deployments know a rod's stiffness, density "
            "and natural curvature"
        )
    if assumed:
        values = ", ".join(f"{key} {rod.get(key)}" for key in assumed)
        said.append(f"{values} assumed, for motion tells ratios to the weight only")
    if said:
        warnings.warn(f"{path}: {'; '.join(said)}", WrodWarning, stacklevel=3)
    return rod


# Table 2 of the paper; VPS density 1180 kg/m^3 throughout (it drops out of every plan).
_PRESETS = {
    "pink-vps": RodMaterial(0.0016, 0.0180, 0.875),
    "green-vps": RodMaterial(0.0016, 0.0320, 0.885),
    "rope": RodMaterial(0.0020, 0.0340, 0.89),
    "pink-vps-thick": RodMaterial(0.0032, 0.0286, 0.84),
    "cable": RodMaterial(0.0018, 0.0801, 0.87),
}


def rod_names() -> list[str]:
    """Names of the rods of the paper's Table 2, in its order."""
    return list(_PRESETS)


def rod(name: str) -> RodMaterial:
    """Rod of the paper's Table 2 by name.

    Raises:
        RodError: no rod has that name.
    """
    try:
        return _PRESETS[name]
    except KeyError:
        raise RodError(
            f"unknown rod {name!r}; known rods: {', '.join(rod_names())} "
            "(or build a wrod.RodMaterial of your own)"
        ) from None
