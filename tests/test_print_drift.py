"""What a print says of the order in which trials were taken."""

import numpy as np
import pytest

from wrod.identification.clamped.trace import Print, _drift


def said(size) -> tuple[Print, tuple]:
    rng = np.random.default_rng(2)
    predicted = 3.0 * rng.normal(size=(12, 40))
    residual = size[:, None] * predicted + rng.normal(size=predicted.shape)
    found = _drift(np.arange(12), predicted, residual)
    return Print("", "a load", "N", (), 1.0, 1.0, None, (), size, size, found), found


def test_what_grows_from_trial_to_trial_is_said_to_change():
    one, found = said(np.linspace(0.5, 1.5, 12))
    assert found[:2] == pytest.approx((0.5, 1.5), abs=3 * found[2])
    assert "a load goes from 0.5" in one.changes


def test_what_stays_and_what_only_scatters_does_not():
    assert not said(np.ones(12))[0].changes
    assert not said(np.array([0.4, 1.6] * 6))[0].changes
