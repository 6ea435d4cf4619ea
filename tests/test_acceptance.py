"""When an effect joins a model, however small it is, and when it stays."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import COARSE, coarse
from hidden import kept as hidden

from wrod.identification.clamped.acceptance import (
    _form_of,
    _unproven,
    evidence_of_law,
    judged,
    kept,
)
from wrod.identification.clamped.equilibria import ClampedSolver
from wrod.identification.clamped.fit import fit_models
from wrod.identification.clamped.held_out import HeldOut, held_out_error
from wrod.identification.clamped.loading import measurements_from_arrays
from wrod.identification.clamped.moment_law import moment_law_of
from wrod.identification.clamped.refinement import evidence_of_form, in_doubt, refined
from wrod.identification.clamped.setup import ClampedSetup
from wrod.identification.clamped.steps import base_fit, extensions, reordered
from wrod.identification.clamped.verdict import Round
from wrod.identification.effect import Model, effects

# A mass of 2 g, 0.2 m out, on a rod 4 % softer than declared.
TRUE = np.array([0.002, 0.2, -0.04])
PAIR = Model((effects()["point_mass"], effects()["stiffness"]))


@pytest.fixture(scope="module")
def small():
    """(laboratory, the mass alone, both): a rod 4 % softer than declared looks like one with a mass
    a tenth heavier than it is."""
    data = dict(hidden("natural_curvature", 303)[0])
    del data["grip_force"], data["grip_torque"]
    m = measurements_from_arrays(data)
    setup = PAIR.setup(ClampedSetup.base(m, np.arange(m.trial_count), 2 * COARSE), TRUE)
    seen = np.real(ClampedSolver([setup]).predict([setup]).position[0])
    data["centerline"] = seen + m.noise * np.random.default_rng(6).normal(size=seen.shape)
    laboratory = coarse(data)
    one = fit_models(laboratory, [Model(PAIR.effects[:1])], [TRUE[:2]])[0]
    both = fit_models(laboratory, [PAIR], [np.r_[one.values, 0.0]], origin=one)[0]
    return laboratory, one, both


def test_what_is_small_and_sure_is_named(small):
    """Of the base model's excess it takes 0.3 %, and it moves the mass by ten standard errors."""
    laboratory, one, both = small
    empty = base_fit(laboratory)
    excess = empty.chi_squared - empty.residual_count
    assert one.chi_squared - both.chi_squared < 0.005 * excess
    before = held_out_error(laboratory, one)
    step, ahead = judged(laboratory, empty, one, both, [both], before)
    assert step.accepted == PAIR.names and not step.stays
    assert ahead.squares.sum() < before.squares.sum()
    error = np.sqrt(np.diag(one.covariance))[0]
    assert one.values[0] - TRUE[0] > 5.0 * error
    rounds = []
    stays = kept(laboratory, both, rounds)
    assert stays is both and not rounds
    away = (stays.values - TRUE) / np.sqrt(np.diag(stays.covariance))
    assert np.abs(away).max() < 2.5


def test_what_is_not_sure_widens_the_errors_of_what_is_named(small):
    laboratory, one, both = small
    m, before = laboratory.measurements, held_out_error(laboratory, one)
    both = reordered(both, [1, 0])
    stays = " + ".join(both.model.names)
    step = Round(one.model.names, both, [both], [one.bic - both.bic], None, "", stays)
    plain = in_doubt(one, 0, {}, m)["mass"]
    found, _, doubts = refined(laboratory, one, [step], before, profiles=False)
    told = in_doubt(found, 0, doubts, m)["mass"]
    assert found is one and told.value == plain.value
    assert abs(told.value - TRUE[0]) < 2.0 * told.stderr < told.value / 3
    step = replace(step, stays="")
    assert not refined(laboratory, one, [step], before, profiles=False)[2]


def test_what_a_finer_mesh_or_unseen_trials_do_not_ask_for_goes(small):
    laboratory, _, both = small
    wide = Model((*PAIR.effects, effects()["camera_offset"]))
    three = fit_models(laboratory, [wide], [np.r_[both.values, np.zeros(3)]], origin=both)[0]
    rounds = []
    assert kept(laboratory, three, rounds).model.names == PAIR.names
    assert len(rounds) == 1 and "on the last mesh" in rounds[0].reason and not rounds[0].stays
    # The train trials ask for it by far, the others by nothing.
    before = laboratory.target.copy()
    try:
        laboratory.target[laboratory.measurements.train, :93:3] += 5e-4
        shifted = fit_models(laboratory, [wide], [three.values], origin=both)[0]
        rounds = []
        assert "camera_offset" not in kept(laboratory, shifted, rounds).model.names
        assert "squares worse" in rounds[0].reason and "camera_offset" in rounds[0].stays
    finally:
        laboratory.target = before


def test_one_trial_that_outweighs_the_others_proves_nothing():
    rng = np.random.default_rng(2)
    residual, shape = rng.normal(size=(16, 96)), rng.normal(size=(16, 96))
    all_of_them = HeldOut(1e-3, residual + 0.3 * shape)
    assert not _unproven(all_of_them, HeldOut(1e-3, residual))
    one_of_them = residual.copy()
    one_of_them[3] += 3.0 * shape[3]
    said = _unproven(HeldOut(1e-3, one_of_them), HeldOut(1e-3, residual - 0.03 * shape))
    assert "proves nothing" in said
    assert _unproven(HeldOut(1e-3, residual), all_of_them) == "trials held out get worse"


def test_what_mends_the_form_of_a_named_effect_is_not_named():
    """A stiffness that changes along the rod by a parabola leaves beside a constant what seems to
    be an effect of its own, and is seen as its own form."""
    data, _ = hidden("stiffness, quadratic", 501, "correlated-0.7")
    laboratory = coarse(data)
    empty, known = base_fit(laboratory), effects()
    alone = extensions(laboratory, empty, [known["stiffness"]])[0]
    others = ("point_mass", "grip_slip", "clamp_rotation", "natural_curvature", "camera_scale")
    best = extensions(laboratory, alone, [known[name] for name in others])[0]
    form = evidence_of_form(laboratory, alone, 0)
    assert alone.bic - best.bic > 10.0 and form > 0.5 * (alone.bic - best.bic)
    excess = replace(empty, chi_squared=empty.residual_count + 100.0 * alone.chi_squared)
    step, _ = judged(laboratory, excess, alone, best, [best], held_out_error(laboratory, alone))
    assert step.accepted is None and "another law along the rod" in step.reason
    assert step.stays == " + ".join(best.model.names)


def test_what_mends_a_law_of_bending_is_not_named():
    """A rod that keeps its stiffness to a curvature and loses it beyond (a yield) leaves beside the
    nearest softening what seems to be a stiffness of its own."""
    data, _ = hidden("none 1", 101, "pose")
    laboratory, known = coarse(data), effects()
    law = moment_law_of(laboratory)
    curvature = np.linspace(0.05, 1.0, 80) * law.curvatures[-1]
    kept_share = np.minimum(1.0, 0.3 + 0.7 * 0.35 * law.curvatures[-1] / curvature)
    values = np.linalg.lstsq(law.secant(curvature), kept_share - 1.0)[0]
    seen = laboratory.observe(Model((law,)), values)
    rng = np.random.default_rng(4)
    laboratory.target = seen + laboratory.deviation * rng.normal(size=seen.shape)
    empty = base_fit(laboratory)
    alone = extensions(laboratory, empty, [known["softening"]])[0]
    best = extensions(laboratory, alone, [known["stiffness"], known["natural_curvature"]])[0]
    form = evidence_of_law(laboratory, alone, 0)
    assert form > 0.5 * (alone.bic - best.bic)
    assert evidence_of_law(laboratory, best, 1) == -np.inf
    said = _form_of(laboratory, replace(empty, chi_squared=1e9), alone, best)
    assert "another law of bending than that of softening" in said
