"""Poses and cameras that are off anew in each trial: whether they are all that a model leaves.

Poses that are reported half a millimetre off, another way in every trial, leave more than the
markers' noise, and no effect of a rod takes that away, for an effect is the same in every trial.
`noise` tells how much each end and the cameras scatter. That alone would excuse too much: given six
numbers for each end and trial, whatever a rod misses seems to be less. So scatter counts as what is
left only where the readings of unseen trials are then as far off as noise lets them be, and where
no print, which is the same in every trial, has any evidence beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.noise import SCATTER, NoiseModel, estimate, scatter_errors
from wrod.identification.clamped.trace import MEMORY, Print, trace
from wrod.identification.effect import Estimate, Model
from wrod.identification.verdict import CLAMPED

# Farther off than this from trial to trial is no play of a fixture and no camera that was set up
# again [m, rad]: five numbers an end may turn a clamp by 17 degrees in place of a twisted rod. How
# far a rod rolls in a grip that it slips in has no such bound.
_PLAY = {"m": 3e-3, "rad": np.deg2rad(3.0)}
_ROLLS = {"clamp_roll", "grip_roll"}
# A trial outweighs the others with so many times the squares of their median.
OUTWEIGHS = 5.0
# It stands apart where it is missed by so many times the median of all, and the noise floor.
_APART, _APART_FLOORS = 5.0, 3.0


@dataclass(frozen=True)
class TrialScatter:
    """What changes from trial to trial, where a model leaves nothing else.

    Attributes:
        noise: the readings' noise with it.
        sizes: by `SCATTER`, of each coordinate.
        ratio: root of the squares of the trials asked for over what such noise leaves.
    """

    noise: NoiseModel
    sizes: dict[str, Estimate]
    ratio: float

    def __str__(self) -> str:
        return "; ".join(
            f"{name.replace('_', ' ')} changes by {size} from trial to trial"
            for name, size in self.sizes.items()
        )

    def to_dict(self) -> list[dict]:
        """As `report.json` has it."""
        return [
            {"name": name, "value": e.value, "stderr": e.stderr, "unit": e.unit}
            for name, e in self.sizes.items()
        ]


def what_is_left(
    laboratory: Laboratory, model: Model, values: np.ndarray, trials: np.ndarray
) -> tuple[TrialScatter | None, str, Print | None]:
    """(the scatter that is all that a model leaves in `trials`, None where it is not; what changes
    while it is measured, a phrase, empty where nothing does; the likeliest print beside the model,
    None where more than noise is left anyway).

    Noise is estimated from the train trials, prints from them and `trials`. What changes is asked
    where no more than noise and scatter seem to be left: given six numbers for each end and trial
    a rod that changes passes for clamps that turn, but its numbers follow one another.
    """
    before = laboratory.noise, laboratory.scatter_rates
    noise, rates = estimate(laboratory, model, values)
    try:
        laboratory.set_noise(noise, rates)
        squares = laboratory.misfit(model, values, trials).sum() / laboratory.read[trials].sum()
        if not CLAMPED.is_noise(np.sqrt(squares), 1.0):
            return None, "", None
        asked = np.union1d(laboratory.measurements.train, trials)
        each = laboratory.misfit(model, values, asked) / laboratory.read[asked].sum(axis=1)
        # One trial that outweighs the others vouches for nothing.
        asked = asked[each <= OUTWEIGHS * np.median(each)]
        prints = trace(laboratory, model, values, asked)
    finally:
        laboratory.set_noise(*before)
    changing = sorted((p for p in prints if p.seen_to_change), key=lambda p: -max(p.change, p.anew))
    if changing:
        kept = [p for p in changing[1:] if p.name == MEMORY]
        return None, "; ".join(p.seen_to_change for p in changing[:1] + kept), prints[0]
    # What is not said by poses and cameras alone, large noise along the rod say, is a misfit.
    if not any(noise.scatter) or not CLAMPED.is_noise(noise.size, 1.0) or prints[0].seen:
        return None, "", prints[0]
    found, sizes = dict(zip(SCATTER, noise.scatter, strict=True)), {}
    if any(s > _PLAY[SCATTER[name]] for name, s in found.items() if name not in _ROLLS):
        return None, "", prints[0]
    errors = scatter_errors(laboratory, model, values, noise)
    for (name, unit), size, error in zip(SCATTER.items(), noise.scatter, errors, strict=True):
        if size > 0.0:
            shown = 1e3 if unit == "m" else 180.0 / np.pi
            of = "mm" if unit == "m" else "deg"
            sizes[name] = Estimate(float(shown * size), float(shown * error), of)
    return TrialScatter(noise, sizes, float(np.sqrt(squares))), "", prints[0]


def standing_apart(laboratory: Laboratory, model: Model, values: np.ndarray) -> dict[int, float]:
    """By trial, the RMS distance from its markers [m] where a model misses it by far more than the
    others, farthest first: one of another pose, of a rod that touched something or was wound."""
    m = laboratory.measurements
    seen = laboratory.predict(model, values)
    off = np.array([laboratory.rms(seen, np.array([t])) for t in laboratory.trials])
    far = off > max(_APART * np.nanmedian(off), _APART_FLOORS * m.noise_floor)
    return {int(t): float(off[t]) for t in np.argsort(-off) if far[t]}


def said_of(apart: dict[int, float]) -> str:
    """A sentence about trials that stand apart, or nothing."""
    if not apart:
        return ""
    each = ", ".join(f"{trial} ({1e3 * off:.1f} mm)" for trial, off in apart.items())
    which = f"trial {each} is" if len(apart) == 1 else f"trials {each} are"
    return f"{which} missed by far more than the others: look at the poses and markers there"
