"""Rods, cables and ropes that were measured, with where their stiffness comes from and its spread.

Stiffness of ready-made cables is hardly published: what is here was identified from recordings that
others made public, by commands of this repository, is the paper's, was measured in bending by
others (guide wires), or is computed from a published modulus and the section (suture, nitinol,
tubing: the notes say so). A cable of the same name from another maker may differ by a factor of
two; measure your own (`wrod loop`, `wrod measure`).
"""

import math
from dataclasses import dataclass

from wrod import arguments
from wrod.errors import RodError
from wrod.rods.material import TABLE_2, RodMaterial

_PAPER = "Tong et al., Sim2Real neural controllers for physics-based robotic deployment, Table 2"
_LOOPS = "hanging loops published with Chen, Bretl, Pham, arXiv 2310.00911, by `wrod bench hands`"
_HELD = "held poses published with arXiv 2402.16114 (dlo_parameter_id), by `wrod bench hands`"


@dataclass(frozen=True)
class CatalogueRod:
    """One entry.

    Attributes:
        name: that `rod` and `--rod` take.
        what: it is.
        rod: `RodMaterial`; its density gives the weight per length that was measured.
        spread: relative standard error of the bending stiffness within the measured pieces, or,
            where it is computed, half of the range that modulus and diameter leave; None where the
            source gives none.
        note: what is assumed or odd.
        source: who measured, and what computed the stiffness.
    """

    name: str
    what: str
    rod: RodMaterial
    spread: float | None
    note: str
    source: str


def _weighed(radius: float, mass_per_length: float, stiffness: float, length: float) -> RodMaterial:
    """A rod of its mass per length [kg/m] and bending stiffness [N m^2]."""
    density = mass_per_length / (math.pi * radius**2)
    lgb = (stiffness / (2.0 * mass_per_length * 9.81)) ** (1 / 3)
    return RodMaterial(radius, lgb, length, density=density)


def _section(
    modulus: float, outer: float, inner: float, density: float, length: float
) -> tuple[float, float, float, float]:
    """Radius, mass per length, stiffness and length of a round section of a modulus [Pa], outer and
    inner diameter [m]."""
    area = math.pi * (outer**2 - inner**2) / 4.0
    second = math.pi * (outer**4 - inner**4) / 64.0
    return outer / 2.0, density * area, modulus * second, length


def _wire(modulus: float) -> tuple[float, float, float, float]:
    """Of a guide wire, 0.035 in by 2.6 m, of a flexural modulus [Pa]."""
    return _section(modulus, 0.035 * 0.0254, 0.0, 7900.0, 2.6)


_WHAT = {
    "pink-vps": "vinyl polysiloxane, pink", "green-vps": "vinyl polysiloxane, green",
    "rope": "rope", "pink-vps-thick": "vinyl polysiloxane, pink, 6.4 mm", "cable": "USB cable",
}  # fmt: skip
_THIN = "radius of 3 mm assumed, as the source's own simulation does"
_BENT = "bent at rest; another piece may differ by more than the error"
_WIRES = (
    "flexural modulus, 3 wires at 10 places: Harrison et al., J. Endovasc. Ther. 18 (2011) 797, "
    "doi 10.1583/11-3592.1; diameter, length and spread (of force, between wires): Chaudhuri et "
    "al., doi 10.1016/j.ejvsvf.2021.06.006"
)
_STEEL = "weight of solid steel and 0.035 in assumed"
_TWO = f"{_STEEL}; forces of the second source rank the two the other way"
_SUTURE = (
    "tensile modulus of 4.03 GPa: doi 10.22159/ijap.2021.v13s1.Y1025; diameter of USP 3-0, 0.200 "
    "to 0.249 mm"
)
_NITINOL = (
    "modulus of 48 GPa measured on a core wire: Advanced Materials and Processes, October 2019, "
    "p. 49, to 83 GPa of austenite, and density: maker's table of technical properties (Memry)"
)
_TUBING = "modulus of Silastic tubing, 2.1 to 4 MPa: PMC11019708, table 2"
_COMPUTED = "computed from modulus and section, not measured in bending"
_MEASURED = (
    ("thin-cable-white", "thin cable", (3e-3, 0.0174, 0.097e-3, 1.5), 0.12, _THIN, _LOOPS),
    ("thin-cable-black", "thin cable", (3e-3, 0.02718, 0.92e-3, 1.5), 0.30, _THIN, _LOOPS),
    ("thin-cable-red", "thin cable", (3e-3, 0.0215, 1.19e-3, 1.5), 0.33, _THIN, _LOOPS),
    ("power-cable-15mm", "electric cable", (7.5e-3, 0.40 / 0.75, 0.059, 0.75), 0.014, _BENT, _HELD),
    ("power-cable-20mm", "electric cable", (10e-3, 0.42 / 0.40, 0.107, 0.40), 0.014, _BENT, _HELD),
    ("guidewire-amplatz-plain", "Amplatz, plain", _wire(9.5e9), None, _STEEL, _WIRES),
    ("guidewire-amplatz-stiff", "Amplatz Stiff", _wire(17e9), None, _STEEL, _WIRES),
    ("guidewire-amplatz-extra", "Amplatz Extra Stiff", _wire(29.2e9), None, _STEEL, _WIRES),
    ("guidewire-amplatz", "Amplatz Super Stiff", _wire(60.3e9), 0.09, _TWO, _WIRES),
    ("guidewire-amplatz-ultra", "Amplatz Ultra Stiff", _wire(65.4e9), None, _STEEL, _WIRES),
    ("guidewire-meier", "Backup Meier", _wire(139.6e9), None, _STEEL, _WIRES),
    ("guidewire-lunderquist", "Lunderquist Extra Stiff", _wire(158.4e9), 0.03, _TWO, _WIRES),
    ("suture-polypropylene-3-0", "polypropylene monofilament suture",
     _section(4.03e9, 0.2245e-3, 0.0, 905.0, 0.75), 0.44, f"{_COMPUTED}; 905 kg/m^3", _SUTURE),
    ("nitinol-wire-0.5mm", "superelastic nitinol wire",
     _section(65.5e9, 0.5e-3, 0.0, 6450.0, 1.0), 0.27, f"{_COMPUTED}, small strains", _NITINOL),
    ("silicone-tube-3mm", "silicone tube, 1/8 in by 1/16 in",
     _section(3.05e6, 3.175e-3, 1.5875e-3, 1150.0, 1.0), 0.31, f"{_COMPUTED}; 1150 kg/m^3",
     _TUBING),
)  # fmt: skip


def catalogue() -> list[CatalogueRod]:
    """Every entry: the paper's rods, then cables, guide wires, and what is computed."""
    table = [
        CatalogueRod(name, _WHAT[name], preset, None, "density of 1180 kg/m^3 assumed", _PAPER)
        for name, preset in TABLE_2.items()
    ]
    return table + [
        CatalogueRod(name, what, _weighed(*numbers), spread, note, source)
        for name, what, numbers, spread, note, source in _MEASURED
    ]


def rod_names() -> list[str]:
    """Names that `rod` and `--rod` know: the paper's Table 2 in its order, then cables."""
    return [entry.name for entry in catalogue()]


@arguments.checked(RodError)
def rod(name: str) -> RodMaterial:
    """A rod, cable or rope of the catalogue by name; `wrod rods` lists stiffness and sources.

    Raises:
        RodError: no rod has that name.
    """
    entries = {entry.name: entry.rod for entry in catalogue()}
    try:
        return entries[name]
    except (KeyError, TypeError):
        raise RodError(
            f"unknown rod {name!r:.80}; known rods: {', '.join(entries)} (or a wrod.RodMaterial of "
            "your own: measure it with `wrod loop`)"
        ) from None
