"""What a print says of the order of trials, and what a built effect may stand for."""

from types import SimpleNamespace

import numpy as np
import pytest

from wrod.identification.clamped.described import Stretch
from wrod.identification.clamped.trace import Print, _drift
from wrod.rods.material import RodMaterial


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


def test_a_stretch_that_reaches_an_end_may_be_what_holds_it():
    """Rubber fingers pass for a soft stretch of rod beside the gripper."""
    held = SimpleNamespace(material=RodMaterial(2e-3, 0.05, 0.5))
    stretch, error = Stretch([]), np.diag([0.1, 0.1, 2e-3, 0.1, 0.1]) ** 2

    def doubt(start, length):
        return stretch.doubt(np.array([-1.0, 0.0, start, np.log(length), 0.0]), error, held)

    assert not doubt(0.2, 0.08)
    assert "gripper" in doubt(0.44, 0.06)
    assert "clamp A" in doubt(0.003, 0.05)
