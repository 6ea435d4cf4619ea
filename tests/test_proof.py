"""When an effect is proven on unseen trials: false alarms and power, by simulation."""

import numpy as np
import pytest

from wrod.identification.clamped.acceptance import _unproven
from wrod.identification.clamped.held_out import HeldOut
from wrod.identification.clamped.verdict import UNSEEN_ERRORS, UNSEEN_GAIN, error_of_gains

TRAIN, TEST, MARKERS, NUMBERS = 16, 8, 31, 3


def proven(gain, moved):
    return gain.sum() >= max(UNSEEN_GAIN, UNSEEN_ERRORS * error_of_gains(gain, moved))


def proven_by_equal_gains(gain):
    """The rule of sums that are compared with their own scatter, whatever the trials weigh."""
    return gain.sum() >= max(UNSEEN_GAIN, 1.5 * gain.std(ddof=1) * np.sqrt(len(gain)))


def effect(rng, uneven, numbers=NUMBERS):
    """(trial, reading, number) smooth responses, in some trials much larger than in others."""
    s = np.linspace(0.0, 1.0, MARKERS)
    waves = np.stack([np.sin(np.pi * k * s) / k for k in range(1, 5)])
    rates = np.einsum("tckp,km->tcmp", rng.normal(size=(TRAIN + TEST, 3, 4, numbers)), waves)
    rates *= np.exp(uneven * rng.normal(size=(TRAIN + TEST, 1, 1, 1)))
    return rates.reshape(TRAIN + TEST, -1, numbers)


def noise(rng, kind):
    e = rng.normal(size=(TRAIN + TEST, 3, MARKERS))
    if kind == "correlated":
        for m in range(1, MARKERS):
            e[..., m] = 0.9 * e[..., m - 1] + np.sqrt(1.0 - 0.81) * e[..., m]
    elif kind == "outliers":
        e = np.where(rng.random((TRAIN + TEST, 1, MARKERS)) < 0.01, 6.0 * e, e)
    e = e.reshape(TRAIN + TEST, -1)
    if kind == "pose":
        pose = effect(rng, 0.0, 6)
        e += np.einsum("trp,tp->tr", pose, rng.normal(size=(TRAIN + TEST, 6))) / 3.0
    return e


def unseen(rng, kind, uneven, size, candidates):
    """(gains, squares moved) on test trials of the candidate that fits the train trials best, as
    if the noise were white; None where not even the train trials ask for it."""
    y, best = noise(rng, kind), None
    for k in range(candidates):
        rates = effect(rng, uneven)
        if k == 0 and size:
            true = rates @ rng.normal(size=NUMBERS)
            y = y + size * true / np.sqrt((true[:TRAIN] ** 2).sum())
        a, b = rates[:TRAIN].reshape(-1, NUMBERS), y[:TRAIN].ravel()
        values = np.linalg.lstsq(a, b, rcond=None)[0]
        taken = b @ b - ((b - a @ values) ** 2).sum()
        if best is None or taken > best[0]:
            best = taken, rates[TRAIN:] @ values
    if best[0] < 10.0 + NUMBERS * np.log(TRAIN * 3 * MARKERS):
        return None
    moved = best[1]
    gain = (y[TRAIN:] ** 2).sum(axis=1) - ((y[TRAIN:] - moved) ** 2).sum(axis=1)
    return gain, (moved**2).sum(axis=1)


@pytest.mark.parametrize("kind", ["correlated", "outliers", "pose"])
def test_noise_that_is_taken_for_white_proves_no_effect(kind):
    rng = np.random.default_rng(5)
    draws = [unseen(rng, kind, (0.0, 1.5)[n % 2], 0.0, 10) for n in range(200)]
    false = sum(proven(*d) for d in draws if d is not None)
    assert false <= 200 / 40


def test_an_effect_that_trials_show_unevenly_is_proven():
    rng = np.random.default_rng(6)
    draws = [unseen(rng, "white", 1.5, 40.0, 1) for _ in range(200)]
    assert sum(proven(*d) for d in draws) >= 0.85 * len(draws)
    assert sum(proven_by_equal_gains(d[0]) for d in draws) <= 0.6 * len(draws)


def test_gains_in_proportion_leave_no_doubt_and_equal_ones_the_usual():
    moved = np.array([2.0, 35_500.0, 40.0, 700.0, 9.0, 60.0, 3_000.0, 5_000.0])
    assert error_of_gains(0.9 * moved, moved) < 1e-6 * moved.sum()
    gain = np.array([3.0, 5.0, -1.0, 8.0])
    usual = gain.std(ddof=1) * 2.0
    assert error_of_gains(gain, np.ones(4)) == pytest.approx(usual, rel=1e-12)
    # A trial that outweighs the rest cannot vouch for itself.
    assert error_of_gains(np.array([100.0, -1.0, 1.0]), np.array([100.0, 1.0, 1.0])) > 50.0


def asked_for(rng, kind, uneven, size, candidates):
    """Whether trials held out and unseen ones ask for the best of some candidates, as they have to
    where it is to join (`acceptance`); None where not even the criterion does."""
    y, best = noise(rng, kind), None
    for k in range(candidates):
        rates = effect(rng, uneven)
        if k == 0 and size:
            true = rates @ rng.normal(size=NUMBERS)
            y = y + np.sqrt(size) * true / np.sqrt((true[:TRAIN] ** 2).sum())
        values, taken = fitted(rates[:TRAIN], y[:TRAIN])
        if best is None or taken > best[0]:
            best = taken, rates, values
    taken, rates, values = best
    if taken < 10.0 + NUMBERS * np.log(TRAIN * 3 * MARKERS):
        return None
    plain, better = HeldOut(0.0, y[:TRAIN]), HeldOut(0.0, np.empty_like(y[:TRAIN]))
    for fold in range(4):
        out = np.arange(TRAIN) % 4 == fold
        own = fitted(rates[:TRAIN][~out], y[:TRAIN][~out])[0]
        better.residual[out] = y[:TRAIN][out] - rates[:TRAIN][out] @ own
    seen = (y[TRAIN:] ** 2).sum() - ((y[TRAIN:] - rates[TRAIN:] @ values) ** 2).sum()
    return not _unproven(plain, better) and seen > 0.0


def fitted(rates, y):
    a, b = rates.reshape(-1, rates.shape[2]), y.ravel()
    values = np.linalg.lstsq(a, b, rcond=None)[0]
    return values, b @ b - ((b - a @ values) ** 2).sum()


def test_small_effects_are_asked_for_by_trials_and_what_noise_looks_like_is_not():
    rng = np.random.default_rng(3)
    kinds = [(kind, uneven) for kind in ("correlated", "pose") for uneven in (0.0, 1.5)]
    false = [asked_for(rng, *kinds[n % 4], 0.0, 10) for n in range(160)]
    false = [f for f in false if f is not None]
    assert len(false) > 140 and sum(false) <= 0.04 * len(false)
    true = [asked_for(rng, "white", 0.0, 45.0, 1) for _ in range(60)]
    true = [t for t in true if t is not None]
    assert len(true) > 45 and sum(true) >= 0.95 * len(true)
