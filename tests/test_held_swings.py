"""Swings of cables held in a hand, against a beam with a mass at its tip."""

from dataclasses import replace

import numpy as np
import pytest

from wrod.errors import DataError
from wrod.identification.held.equilibria import CableModel
from wrod.identification.held.fit import HeldFit
from wrod.identification.held.measurements import HeldCable, HeldSwing, load_swing
from wrod.identification.held.swings import SwingModel, fit_swings, predict_swings

STIFFNESS, LENGTH, TIP, DAMPING = 0.05, 0.4, 0.3, 0.04
TIME = np.arange(60) / 30.0


def beam_swing(start=0.05):
    """A beam without weight and of hardly any mass, let swing by its tip's: Kelvin and Voigt's
    time T makes its tip's place exp(-w^2 T t / 2) cos(w sqrt(1 - (w T / 2)^2) t)."""
    mass = 1e-3
    # 33/140 of the beam's mass moves with the tip.
    square = 3.0 * STIFFNESS / (LENGTH**3 * (TIP + 33.0 / 140.0 * mass))
    decay = 0.5 * square * DAMPING
    shape = np.exp(-decay * TIME) * np.cos(np.sqrt(square - decay**2) * TIME)
    # Deflections are small: a moment that falls to zero at the tip, b L / 3 there.
    bend = 3.0 * start / LENGTH * shape[:, None] * [1.0, -1.0]
    end = np.column_stack([-start * shape, np.full(len(TIME), -LENGTH)])
    mid = np.column_stack([-5.0 / 16.0 * start * shape, np.full(len(TIME), -0.5 * LENGTH)])
    none = np.zeros(len(TIME))
    cable = HeldCable("beam", none, mid, end, LENGTH, 1e-3, mass, TIP, 1e-9)
    return HeldSwing(cable, TIME, bend)


def statics(*values, names=("stiffness",)):
    none = np.zeros((0, 2, 2))
    return HeldFit(names, np.array(values), np.eye(len(values)), none, np.zeros(0, bool), 1e-3)


def test_a_beam_swings_as_its_closed_form_says():
    swing = beam_swing()
    (found,) = predict_swings(
        [(swing, SwingModel(CableModel(STIFFNESS), damping=DAMPING))], substeps=4
    )
    wanted = swing.cable.markers[2:]
    assert found.shape == wanted.shape
    # Time steps of 8 ms and deflections that are not quite small.
    assert np.abs(found - wanted)[..., 0].max() < 0.02 * 0.05
    assert np.ptp(wanted[20:, 1, 0]) > 0.3 * 0.05  # it still swings


def test_damping_is_found_in_a_closed_form():
    fit = fit_swings([beam_swing()], statics(np.log(STIFFNESS)))
    assert np.exp(fit.values[0]) == pytest.approx(DAMPING, rel=0.05)
    assert fit.model(0).damping == pytest.approx(np.exp(fit.values[0]))
    before = fit_swings([beam_swing()], statics(np.log(STIFFNESS)), ())
    # Sideways: the closed form is of first order, without how the tip rises.
    after, undamped = (np.abs(one.residual[0])[..., 0].max() for one in (fit, before))
    assert after < 0.1 * undamped


def test_friction_stops_a_cable_away_from_its_shape():
    """Damping alone lets it come back; strands that rub hold it by up to their friction."""
    swing = beam_swing()
    longer = replace(swing, time=np.arange(200) / 30.0, bend=np.repeat(swing.bend[:1], 200, 0))
    cable = replace(longer.cable, **{
        name: np.zeros((200, 2)) if name != "angle" else np.zeros(200)
        for name in ("angle", "mid", "end")
    })  # fmt: skip
    longer = replace(longer, cable=cable)
    rest = CableModel(STIFFNESS)
    free, rubbed = predict_swings(
        [
            (longer, SwingModel(rest, damping=0.5)),
            (longer, SwingModel(rest, 0.5, friction=0.3, kept=0.5)),
        ]
    )
    assert abs(free[-1, 1, 0]) < 1e-3 * 0.05
    held = abs(rubbed[-1, 1, 0])
    # The whole friction, 0.3 /m everywhere, would hold the tip 0.3 L^2 / 2 off.
    assert 0.02 * 0.05 < held < 0.5 * 0.3 * LENGTH**2
    assert np.ptp(rubbed[-20:, 1, 0]) < 1e-4


def test_refuses_what_it_cannot_take(tmp_path):
    swing, rest = beam_swing(), statics(0.0)
    with pytest.raises(DataError, match="unknown effect 'wind'"):
        fit_swings([swing], rest, ("wind",))
    with pytest.raises(DataError, match="no swing"):
        fit_swings([], rest)
    uneven = replace(swing, time=TIME**1.5)
    with pytest.raises(DataError, match="equally far apart"):
        predict_swings([(uneven, SwingModel(CableModel(1.0)))])
    path = tmp_path / "made-swing.npz"
    good = dict(
        time=TIME, base_angle=0 * TIME, mid_fitted=swing.cable.mid, end_fitted=swing.cable.end,
        curvature_fit=swing.bend, length=0.4, cable_mass=0.4, tip_mass=0.03, diameter=0.02,
        gravity=9.81,
    )  # fmt: skip
    np.savez(path, **good)
    assert load_swing(path).bend.shape == (60, 2)
    np.savez(path, **(good | {"curvature_fit": swing.bend[:-1]}))
    with pytest.raises(DataError, match=r"made-swing\.npz: curvature_fit has shape"):
        load_swing(path)
