"""Swings of cables held in a hand, against a beam with a mass at its tip."""

from dataclasses import replace

import numpy as np
import pytest

import wrod
from wrod import load_rod
from wrod.errors import DataError, WrodWarning
from wrod.identification.held.equilibria import CableModel, held_batch, marked, markers, mesh
from wrod.identification.held.fit import HeldFit
from wrod.identification.held.measurements import HeldCable, HeldSwing, load_swing
from wrod.identification.held.swings import SwingModel, fit_swings, predict_swings
from wrod.rods.law import Linear, Plastic
from wrod.solvers.statics import EquilibriumSolver

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
            (longer, SwingModel(replace(rest, friction=0.3, kept=0.5), 0.5)),
        ]
    )
    assert abs(free[-1, 1, 0]) < 1e-3 * 0.05
    held = abs(rubbed[-1, 1, 0])
    # The whole friction, 0.3 /m everywhere, would hold the tip 0.3 L^2 / 2 off.
    assert 0.02 * 0.05 < held < 0.5 * 0.3 * LENGTH**2
    assert np.ptp(rubbed[-20:, 1, 0]) < 1e-4


def swung(friction=0.3, damping=0.1):
    cable = replace(
        beam_swing().cable, length=0.75, cable_mass=0.25, tip_mass=0.05, diameter=0.015,
        gravity=9.81,
    )  # fmt: skip
    return cable, SwingModel(CableModel(0.06, -0.3, 0.1, friction, kept=0.4), damping)


def test_a_swung_cable_is_a_rod(tmp_path):
    cable, model = swung()
    found = model.rod(cable, twist_ratio=0.5)
    rod = found.rod
    # Slipped it is as stiff as it hangs, and its friction carries B (1 - r) k_y more.
    first, law = rod.bending_stiffness[0].values[0], rod.law
    assert isinstance(law, Plastic)
    assert law.hardening * first == pytest.approx(0.06)
    assert first * (1.0 - law.hardening) * law.yield_curvature == pytest.approx(0.3 * 0.06)
    assert first * rod.internal_damping == pytest.approx(0.1 * 0.06)
    assert rod.twisting_stiffness.values[0] == pytest.approx(0.5 * 0.06)
    assert rod.weight == pytest.approx(0.25 * 9.81 / 0.75)
    assert rod.radius == 0.0075 and rod.point_masses == ()
    assert model.rod(cable, weighted=True).rod.point_masses == ((0.75, 0.05),)
    assert found.set_aside == ("clamp_tilt",)
    assert found.effects["swinging"] == {"damping": 0.1, "friction": 0.3, "kept": 0.4}
    found.save(tmp_path / "model.json")
    with pytest.warns(WrodWarning, match="clamp_tilt set aside.*twisting_stiffness 0.03"):
        assert load_rod(tmp_path / "model.json") == rod
    smooth = swung(friction=0.0)[1]
    assert isinstance(smooth.rod(cable).rod.law, Linear)


def test_the_rod_hangs_by_its_friction_and_else_as_the_cable():
    """Level from its clamp; every moment is that of the weight beyond, bent for the first time."""
    cable, model = swung()
    rubs = model.rod(cable, weighted=True).rod
    own = replace(model.cable, tilt=0.0)
    straight = replace(own, curvature=0.0)
    models = replace(own, friction=0.0), straight
    wanted, good = markers([(cable, 0.5 * np.pi, one) for one in models])
    s = mesh(cable.length)
    place = np.tile(s[:, None] * [0.0, 0.0, -1.0], (3, 1, 1))
    like = dict(bending_stiffness=0.06, stretching_stiffness=3e4 * 0.06 / cable.length**2)
    smooth = replace(rubs, law=Linear(), **like)
    rods = [rubs, smooth, SwingModel(straight).rod(cable, weighted=True).rod]
    batch = held_batch(
        rods, s, place, both=False, gravity=np.array([cable.gravity, 0, 0]), device="cpu"
    )
    found = EquilibriumSolver(batch).solve(ramp_loads=True, tolerance=1e-7)
    assert good.all() and found.converged.all()
    rubbed, hung, bent_once = marked(batch.positions())
    assert np.allclose(hung, wanted[0], atol=1e-6)
    # A straight one is bent more and more while the hand turns, so the way does not matter.
    assert np.allclose(bent_once, wanted[1], atol=1e-5)
    assert rubbed[1, 0] < hung[1, 0] - 1e-3
    nodes, mass = batch.positions()[0], batch.node_mass.numpy()[0]
    edge = np.diff(nodes, axis=0)
    half = np.tan(0.5 * np.diff(np.arctan2(edge[:, 0], -edge[:, 2])))
    lever = nodes[:, 2] - nodes[1:-1, None, 2]
    couple = -cable.gravity * np.triu(mass * lever, 2).sum(axis=1)
    excess = 2.0 * half / np.diff(0.5 * (s[1:] + s[:-1])) + 0.3
    yields, first = rubs.law.yield_curvature, 0.06 / 0.4
    moment = 0.06 * excess + 0.6 * first * np.minimum(excess, yields)
    # A couple turns by the angle, of which a curvature is twice the half's tangent.
    assert np.allclose(moment * (1.0 + half**2), couple, atol=1e-4 * couple.max())


def test_a_swung_cable_is_planned():
    cable, model = swung()
    line = wrod.Pattern.from_points(np.linspace([0.0, 0.0], [0.1, 0.0], 20))
    plan = wrod.plan(line, model.rod(cable).rod, spacing=0.02, device="cpu")
    smooth = swung(friction=0.0)[1]
    stiff = wrod.plan(line, smooth.rod(cable).rod, spacing=0.02, device="cpu")
    assert plan.metadata["remembers"] == "plastic" and "remembers" not in stiff.metadata
    assert np.abs(plan.position - stiff.position).max() > 1e-3


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
