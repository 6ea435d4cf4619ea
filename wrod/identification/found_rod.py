"""The rod that a fitted model describes, read off its set-up: one description, nothing twice.

Whatever effects did to stiffnesses, masses, rest shape, law or damping is in the set-up's arrays,
and so in the rod. Effects that leave the rod as it is (cameras, clamps, grips, gravity's direction,
a draught) belong to the set-up of the measurement and are set aside, by name.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import find_objects, label
from scipy.optimize import least_squares

from wrod.errors import RodError, WrodWarning
from wrod.identification.effect import Model
from wrod.identification.setup import RodSetup
from wrod.rods.law import BendingLaw, Linear, Plastic, Softening
from wrod.rods.model import RodModel
from wrod.rods.model_file import save_rod
from wrod.rods.profile import Profile

# Values that agree to this, relative to the largest, are one number.
_SAME = 1e-12


@dataclass(frozen=True)
class FoundRod:
    """A rod, and what it took to find it.

    Attributes:
        fitted: the rod with everything that belongs to it; None where no rod can be so.
        set_aside: names of the effects that belong to the set-up of the measurement.
        assumed: names of the rod's numbers that nobody measured.
        effects: every effect's raw parameters, by name.
        refused: why no rod can be so.
    """

    fitted: RodModel | None
    set_aside: tuple[str, ...]
    assumed: tuple[str, ...]
    effects: dict[str, dict[str, float]]
    refused: str = ""

    @property
    def rod(self) -> RodModel:
        """The rod with everything that belongs to it.

        Raises:
            RodError: what was fitted is none.
        """
        if self.fitted is None:
            raise RodError(self.refused)
        return self.fitted

    def save(self, path: Path) -> list[Path]:
        """Write `model.json`, which `wrod.load_rod` reads; nothing, with a `WrodWarning`, where no
        rod can be as fitted."""
        if self.fitted is None:
            warnings.warn(f"{path}: not written; {self.refused}", WrodWarning, stacklevel=4)
            return []
        effects = [{"name": n, "parameters": p} for n, p in self.effects.items()]
        found = {"effects": effects, "set_aside": list(self.set_aside)}
        return [save_rod(self.fitted, path, assumed=self.assumed, found=found)]


def found_rod(
    base, model: Model, values: np.ndarray, read: Callable, assumed: tuple[str, ...] = ()
) -> FoundRod:
    """The rod of a model with fitted values.

    Args:
        base: the set-up without effects.
        model: the effects.
        values: their parameters.
        read: from a set-up to its `RodModel`.
        assumed: names of the rod's numbers that `read` had to assume.
    """
    plain = read(base)
    parts = list(zip(model.effects, model.split(values), strict=True))
    effects = {
        e.name: dict(zip((p.key for p in e.parameters), v.tolist(), strict=True)) for e, v in parts
    }
    try:
        rod = read(model.setup(base, values))
        # Of what came out as nothing there is nothing to set aside.
        aside = tuple(
            e.name for e, v in parts if np.any(v) and read(Model((e,)).setup(base, v)) == plain
        )
    except RodError as error:  # the evidence stands all the same
        return FoundRod(None, (), assumed, effects, f"what was fitted is no rod: {error}")
    return FoundRod(rod, aside, assumed, effects)


def rod_of(
    setup: RodSetup, arc_length: np.ndarray, *, like: RodModel, line_mass: float = 1.0
) -> RodModel:
    """The rod in a set-up of either kind.

    Args:
        setup: its arrays hold one value per node, of the stretching stiffness one per edge.
        arc_length: (node,) unstretched, from the end that is laid first [m].
        like: what the set-up does not know: length, radius, gravity.
        line_mass: of set-ups per line mass [kg/m].
    """
    s = np.real(arc_length)
    middle = 0.5 * (s[1:] + s[:-1])

    def along(values, factor=1.0, at=s) -> Profile:
        values = factor * np.real(values)
        if np.ptp(values) <= _SAME * np.abs(values).max():
            return Profile((float(values[0]),))
        return Profile(values, at)

    def mean(values) -> float:
        return float(np.mean(np.real(values)))

    first, second = np.real(setup.bending).T
    left, up = setup.natural_curvature.T
    law, stiffer = _law(np.real(setup.softening), *np.real(setup.yielding)), 1.0
    if len(terms := np.real(getattr(setup, "law", ()))):
        stiffer, law = _nearest_softening(*terms.T)
    return replace(
        like,
        bending_stiffness=(along(stiffer * first, line_mass), along(stiffer * second, line_mass)),
        twisting_stiffness=along(setup.twisting, line_mass),
        stretching_stiffness=along(setup.stretching, line_mass, middle),
        line_mass=along(setup.line_mass, line_mass),
        principal_angle=float(np.real(setup.principal_angle)),
        natural_curvature=(along(left), along(up)),
        natural_twist=along(setup.natural_twist),
        point_masses=_lumps(s, line_mass * np.real(setup.node_mass), like.length),
        law=law,
        # What only rests says nothing of it.
        internal_damping=mean(setup.viscous_time) if hasattr(setup, "viscous_time") else None,
        relaxation_time=mean(getattr(setup, "relaxation_time", 0.0)),
        air_damping=mean(getattr(setup, "linear_drag", 0.0)),
        quadratic_drag=mean(getattr(setup, "quadratic_drag", 0.0)),
    )


def _law(softening: np.ndarray, lost: float, yields_at: float) -> BendingLaw:
    if lost > 0.0:
        return Plastic(float(yields_at), float(1.0 - lost))
    c, r = softening.mean(axis=0)
    return Softening(float(c**-0.5), float(r)) if c > 0.0 else Linear()


def _nearest_softening(c: np.ndarray, p: np.ndarray) -> tuple[float, BendingLaw]:
    """(factor of the stiffness, softening) whose moments are nearest to those of a law of (J,)
    terms, up to the largest curvature of its terms: what a rod's description can carry of it."""
    top = c.min() ** -0.5
    k = np.linspace(0.0, top, 200)
    x = c * k[:, None] ** 2
    moment = k * (1.0 - (p * x / (1.0 + x)).sum(axis=1))

    def away(v):
        kept = np.exp(v[1])
        return np.exp(v[2]) * k * (kept + (1 - kept) / (1 + (k / np.exp(v[0])) ** 2)) - moment

    tried = [least_squares(away, [np.log(0.3 * top), np.log(r), 0.0]) for r in (0.4, 1.5)]
    critical, kept, factor = np.exp(min(tried, key=lambda f: f.cost).x)
    return float(factor), Softening(float(critical), float(kept))


def _lumps(s: np.ndarray, mass: np.ndarray, length: float) -> tuple[tuple[float, float], ...]:
    """Masses spread over neighbouring nodes, each run of nodes as one at its centre."""
    runs = find_objects(label(mass > 0.0)[0])
    lumps = [(float(mass[r] @ s[r] / mass[r].sum()), float(mass[r].sum())) for (r,) in runs]
    return tuple((min(max(at, 0.0), length), m) for at, m in lumps)
