"""What is another one in each trial: named where it is all that is left, and for nothing else."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner
from hidden import COARSE, coarse, kept
from test_clamped_noise import ARC, READINGS, TRIALS, columns

from wrod.commands import main
from wrod.identification.clamped.acceptance import too_little
from wrod.identification.clamped.fit import fit_models
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.noise import (
    COLUMNS,
    NoiseModel,
    _Restricted,
    estimate,
    gain_of_scatter,
    scatter_rates,
)
from wrod.identification.clamped.scatter import standing_apart, what_is_left
from wrod.identification.clamped.selection import _weighed_anew
from wrod.identification.clamped.steps import (
    base_fit,
    extensions,
    instead_of_scatter,
)
from wrod.identification.clamped.trace import KNOTS, ProbedProfile, trace
from wrod.identification.clamped.verdict import LEFT_OVER, _looks_like, judge, only_so_far
from wrod.identification.effect import Model, effects


@cache
def laboratory(case: str, seed: int, noise: str = "white", edges: int = COARSE) -> Laboratory:
    data, _ = kept(case, seed, noise)
    return coarse(data, case, edges)


def scatter_of(lab: Laboratory, model=None, values=()):
    return what_is_left(lab, model or Model(), np.array(values), lab.measurements.test)[0]


def test_poses_that_are_off_in_each_trial_are_named_with_their_size():
    """Half a millimetre at either end (`wrod.bench.hidden_noise`)."""
    lab = laboratory("none 1", 101, "pose")
    found = scatter_of(lab)
    for end in ("clamp_offset", "grip_offset"):
        size = found.sizes[end]
        assert size.unit == "mm"
        assert abs(size.value - 0.5) < 3.0 * size.stderr < 0.5
    assert 0.8 < found.ratio < 1.1
    assert lab.noise.white  # it asks, and changes nothing
    assert "clamp offset changes by" in str(found)


@pytest.mark.slow
def test_an_identification_ends_with_it(tmp_path):
    """No effect of a rod is named, and what is wrong is."""
    data, _ = kept("none 1", 101, "pose")
    path = tmp_path / "poses.npz"
    np.savez(path, **data)
    result = CliRunner().invoke(main, ["identify", str(path), "--out", str(tmp_path / "out")])
    assert "poses: explained" in result.output
    assert "grip_offset scatters from trial to trial by 0.5" in result.output
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["effects"] == []
    assert {one["name"] for one in report["scatter"]} >= {"clamp_offset", "grip_offset"}
    assert report["noise"]["scatter"]["grip_offset"] == pytest.approx(5e-4, rel=0.3)
    assert "off anew in each trial" in (tmp_path / "out" / "report.html").read_text()


def test_a_rod_that_changes_does_not_pass_for_it():
    """A stiffness that falls from trial to trial comes nearest: given its poses, what such a rod
    leaves beside its mean stiffness is near the noise, but its numbers follow one another."""
    lab = laboratory("warming", 101)
    assert scatter_of(lab) is None
    effect = effects()["stiffness"]
    fit = fit_models(lab, [Model((effect,))], [np.zeros(1)])[0]
    scatter, changing, _ = what_is_left(lab, fit.model, fit.values, lab.measurements.test)
    assert scatter is None
    assert (
        "bending stiffness is another one in the last trials than in the first, by -0" in changing
    )


def test_what_each_trial_has_of_its_own_in_no_order_is_a_print():
    """Readings of rods whose stiffness is another one in each trial, to first order."""
    lab = laboratory("natural_curvature", 101, "pose")
    rng, before = np.random.default_rng(1), lab.target
    probe = Model((ProbedProfile("bending", 0.1, relative=True),))
    seen, rates = lab.jacobian(probe, np.zeros(KNOTS))
    sizes = 0.3 * rng.normal(size=len(seen))
    noise = lab.deviation * rng.normal(size=seen.shape)
    try:
        lab.target = seen + noise
        assert not any(p.seen_to_change for p in trace(lab))
        lab.target = seen + noise + rates.sum(axis=2) * sizes[:, None]
        most = max(trace(lab), key=lambda p: p.anew)
        assert most.name == "moment_with_curvature" and "in each trial" in most.seen_to_change
    finally:
        lab.target = before


def test_it_is_seen_beside_an_effect_and_is_no_excuse_for_a_wrong_one():
    lab = laboratory("natural_curvature", 101, "pose")
    (truth,) = kept("natural_curvature", 101, "pose")[1]["natural_curvature"].values()
    model = Model((effects()["natural_curvature"],))
    assert scatter_of(lab, model, truth) is not None
    assert scatter_of(lab, model, np.multiply(0.7, truth)) is None
    assert scatter_of(lab) is None
    before, after = trace(lab)[0], trace(lab, model, np.array(truth))[0]
    assert before.name == "moment_in_material"
    assert after.evidence < 0.02 * before.evidence


def test_standard_errors_are_what_estimates_scatter_by():
    truth = NoiseModel(scatter=(0.0, 0.0, 0.02, 0.0, 1e-3, 0.0, 0.0))
    rng, found, said = np.random.default_rng(5), [], []
    own, scatter = columns(rng)
    read = np.ones((TRIALS, READINGS), dtype=bool)
    for _ in range(8):
        sizes = np.repeat(truth.scatter, COLUMNS) * rng.normal(size=(TRIALS, 15))
        residual = rng.normal(size=(TRIALS, READINGS)) + np.einsum("trp,tp->tr", scatter, sizes)
        likelihood = _Restricted(ARC, read, residual, own, scatter)
        noise = likelihood.best()
        found.append(noise.scatter)
        said.append(likelihood.scatter_errors(noise))
    for k in (2, 4):
        spread = np.std(np.array(found)[:, k], ddof=1)
        # Of 8 draws a standard deviation is known to 25 %.
        assert np.median(np.array(said)[:, k]) == pytest.approx(spread, rel=0.6)
    assert (np.array(said)[np.array(found) == 0.0] == 0.0).all()


def test_where_nothing_was_chosen_other_weights_leave_nothing():
    lab = laboratory("natural_curvature", 101, "pose")
    again = _weighed_anew(lab, base_fit(lab))
    assert again.model.effects == () and again.chi_squared == base_fit(lab).chi_squared


def test_a_small_effect_beside_scatter_is_asked_for_its_likelihood():
    """Scatter that was estimated without it has taken the excess of squares away."""
    lab = laboratory("none 1", 101, "pose")
    empty = base_fit(lab)
    empty = replace(empty, chi_squared=empty.residual_count + 40.0)
    twist = Model((effects()["twist_stiffness"],))
    better = replace(empty, model=twist, values=np.ones(1), chi_squared=empty.chi_squared - 32.0)
    assert "noise alone varies by" in too_little(lab, empty, empty, better)
    before = lab.noise, lab.scatter_rates
    try:
        lab.set_noise(*estimate(lab, Model(), np.zeros(0)))
        assert too_little(lab, empty, empty, better) == ""
        worse = replace(better, chi_squared=empty.chi_squared - 12.0)
        assert "less than 10" in too_little(lab, empty, empty, worse)
    finally:
        lab.set_noise(*before)


def test_one_number_in_all_trials_goes_before_scatter_where_it_is_likelier():
    """A twisting stiffness that is hardly seen leaves what rolls of a grip would, too."""
    lab, rng = laboratory("none 1", 101, "pose"), np.random.default_rng(4)
    before, twist = lab.target, effects()["twist_stiffness"]
    try:
        for model, values, rolls in (
            (Model((twist,)), np.array([-1.2]), 0.0),
            (Model(), np.zeros(0), 1.5 * rng.normal(size=len(lab.trials))),
        ):
            roll = scatter_rates(lab, Model(), np.zeros(0))[1][:, :, -1]
            noise = lab.deviation * rng.normal(size=before.shape)
            lab.target = lab.observe(model, values) + roll * np.reshape(rolls, (-1, 1)) + noise
            empty, rounds = base_fit(lab), []
            singles = extensions(lab, empty, [twist, effects()["natural_twist"]])
            assert gain_of_scatter(lab) > 0.0
            found, _ = instead_of_scatter(lab, empty, singles, rounds, (0.0, 0.0))
            assert found.model.names == model.names
            assert len(rounds) == len(found.model.effects)
    finally:
        lab.target = before


def test_what_is_seen_beside_effects_makes_them_look_like_it_only():
    lab = laboratory("natural_curvature", 101, "pose")
    told = replace(base_fit(lab), model=Model((effects()["gravity_tilt"],)))
    seen = replace(trace(lab)[0], evidence=LEFT_OVER + 1.0)
    assert "looks like gravity_tilt, but beside that is seen" in _looks_like(told, seen)
    assert not _looks_like(told, replace(seen, evidence=LEFT_OVER - 1.0))
    assert not _looks_like(told, None) and not _looks_like(base_fit(lab), seen)


def test_a_trial_that_is_missed_by_far_is_named():
    """A rod that something pushes aside by 20 mm, in one of the trials that are fitted: what is
    left on the others says nothing of it, and where an effect is lacking no trial is blamed."""
    data, _ = kept("none 1", 101, "pose")
    seen = np.array(data["centerline"])
    seen[3, :, 1] += 0.02 * np.sin(np.pi * np.array(data["arc_length"]) / data["length"])
    lab = coarse(data | {"centerline": seen})
    empty = base_fit(lab)
    found = judge(lab, empty, empty, [], (0.0, None))
    assert list(found.apart) == [3] and found.apart[3] == pytest.approx(0.014, rel=0.2)
    assert f"trial 3 ({1e3 * found.apart[3]:.1f} mm) is missed by far more" in found.reason
    for case, seed, noise in (("none 1", 101, "pose"), ("anisotropic_bending", 11, "white")):
        assert not standing_apart(laboratory(case, seed, noise), Model(), np.zeros(0))


def test_what_seems_to_change_before_all_was_tried_may_be_an_effect():
    """Base models of rods that a tilted gravity bends look so: a pull is another one in each."""
    lab = laboratory("warming", 101)
    empty = base_fit(lab)
    found = judge(lab, empty, empty, [], (0.0, None))
    said = "what seems to change may be an effect that was not tried"
    assert said in only_so_far(replace(found, changing="a moment"), 90.0).reason
    assert said not in only_so_far(replace(found, changing=""), 90.0).reason
