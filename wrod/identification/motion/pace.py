"""Whether recordings move at the pace that their rod's own weight sets."""

import numpy as np
from scipy.special import stdtrit

from wrod.errors import DataError
from wrod.identification.effect import Model, effects
from wrod.identification.motion.data import MotionMeasurements
from wrod.identification.motion.inverse import inverse_motion, rates_about
from wrod.identification.motion.tension import base_setup

# Recordings and frames of each that are looked at, and edges between neighbouring markers.
_RECORDINGS, _FRAMES, _SUBDIVISIONS = 12, 8, 2
# Frames follow one another so many times faster than told, surely so: wrong. What else the base
# model lacks has been seen to make it 0.5 for real cables.
_TOO_FAST, _SURE = 2.0, 0.999
# What is not motion may look like a share of the inertia where grips swing slowly.
_STILL = ("stiffness", "natural_curvature", "natural_twist")


def check_pace(measurements: MotionMeasurements, *, device: str = "cpu") -> None:
    """Refuse recordings whose rod would have to be many times as heavy to move as they say.

    Raises:
        DataError: what weight and bending leave unbalanced is, for certain, over four times the
            rod's mass times the acceleration that `rate_hz` gives.
    """
    found = pace(measurements, device=device)
    if found is None:
        return
    square, bound = found
    if square - bound > _TOO_FAST**2:
        m = measurements
        raise DataError(
            f"{m.name}: weight and stiffness accelerate the rod {square:.0f} times as much as its "
            f"markers are at rate_hz {m.rate:g}, as if its frames followed one another more than "
            f"{np.sqrt(square - bound):.1f} times as fast; check rate_hz, gravity and the unit of "
            "positions"
        )


def pace(measurements: MotionMeasurements, *, device: str = "cpu") -> tuple[float, float] | None:
    """Square of how much faster the frames follow one another than `rate_hz` says, and how far
    below it may be (one in a thousand, by the scatter between recordings); None where no
    acceleration can be told.

    Reactions of the markers that a straight, uniform rod lacks (`inverse_motion`) are taken apart,
    by least squares, into shares of its inertia and of what a rod at rest may show. A motion so
    slow that its inertia is lost in the noise has a wide bound.
    """
    m = measurements
    setup = base_setup(m, _SUBDIVISIONS)
    last = m.recording_count - 1
    chosen = np.unique(np.linspace(0, last, _RECORDINGS).round().astype(int))
    seen = inverse_motion(m, setup, chosen, max(1, m.frame_count // _FRAMES), device=device)
    names = [] if seen is None else np.unique(seen.recording)
    if len(names) < 2:
        return None
    still = Model(tuple(effects("motion")[name] for name in _STILL))
    mass = np.real(setup.arrays()["mass"])
    inertia = seen.force(mass[:, None] * seen.acceleration)
    columns = np.concatenate([inertia[..., None], seen.rates(rates_about(setup, still))], axis=2)
    size = np.sqrt(np.sum(columns**2, axis=(0, 1)))
    if not (size > 0).all():
        return None
    columns = columns / size
    inverse = np.linalg.pinv(np.einsum("sqi,sqj->ij", columns, columns), rcond=1e-10)
    shares = inverse @ np.einsum("sqi,sq->i", columns, seen.missing)
    left = np.einsum("sqi,sq->si", columns, seen.missing - columns @ shares)
    own = np.stack([left[seen.recording == r].sum(axis=0) for r in names])
    scatter = own.T @ own * len(names) / (len(names) - 1)
    error = np.sqrt((inverse @ scatter @ inverse)[0, 0])
    sure = stdtrit(len(names) - 1, _SURE)
    return float(1.0 - shares[0] / size[0]), float(sure * error / size[0])
