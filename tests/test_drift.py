"""What comes or goes while a rod is measured: a stiffness, a weight, a bend, what is remembered."""

import numpy as np
import pytest
from hidden import coarse, kept
from test_scatter import laboratory

from wrod.identification.clamped.drift import Drift, by_another_law, with_drift
from wrod.identification.clamped.fit import fit_models
from wrod.identification.clamped.memory import Memory, bent_before
from wrod.identification.clamped.refinement import in_doubt, refined
from wrod.identification.clamped.scatter import what_is_left
from wrod.identification.clamped.steps import base_fit
from wrod.identification.clamped.trace import memory_of
from wrod.identification.effect import Model, effects

# Values at the first trial and at the last, and how it settles.
DRIFTS = {
    "stiffness": [-0.1, 0.15, 2.0],
    "density": [0.1, -0.1, 0.0],
    "natural_curvature": [0.5, -0.4, 1.0, 0.3, -1.0],
    "gravity_tilt": [0.01, 0.02, -0.02, 0.01, 3.0],
    "camera_offset": [1e-3, 0.0, -1e-3, 2e-3, 1e-3, 0.0, 1.0],
    "clamp_rotation": [0.02, -0.01, 0.05, 0.0, 0.03, -0.05, 0.5],
}


@pytest.fixture(scope="module")
def few():
    """Five trials of the 24 of a set."""
    data, trials = kept("warming", 101)[0], np.array([0, 6, 12, 18, 23])
    own = {k: v[trials] if np.ndim(v) > 1 else v for k, v in data.items()}
    return coarse(own | {"train_idx": np.arange(4), "test_idx": np.array([4])})


# Laws of time are the same for every effect: those of one, and each for some others.
@pytest.mark.parametrize(
    ("name", "by_logarithm"), [("stiffness", True), *((n, k % 2) for k, n in enumerate(DRIFTS))]
)
def test_each_trial_has_its_own_numbers(few, name, by_logarithm):
    """As if each trial were asked with the numbers that the effect has then; derivatives by all of
    them as differences."""
    lab, values = few, np.array(DRIFTS[name])
    of = effects()[name]
    drift = Drift(of, by_logarithm)
    model = Model((drift,))
    seen, rates = lab.jacobian(model, values)
    when = np.linspace(0.0, 1.0, len(lab.trials))
    some = np.array([0, 2, 4])
    for trial in some:
        own = drift.each(values, when)[trial]
        alone = lab.observe(Model((of,)), own, trials=np.array([trial]))
        np.testing.assert_allclose(seen[trial], alone[0], atol=1e-9)
    here = lab.solver_at(model, values, some)[0].saved()
    for k in range(len(values)):
        step = 1e-4 * np.eye(len(values))[k]
        for moved in (ways := [values + step, values - step]):
            lab.remember(model, moved, some, here)  # from where they are solved
        up, down = (lab.observe(model, moved, trials=some) for moved in ways)
        atol = 2e-5 * np.abs(rates).max()
        np.testing.assert_allclose(rates[some, :, k], (up - down) / 2e-4, atol=atol)


@pytest.mark.parametrize("by_logarithm", (False, True))
def test_what_settles_goes_from_first_to_last_and_may_be_a_straight_line(by_logarithm):
    drift, when = Drift(effects()["camera_offset"], by_logarithm), np.linspace(0.0, 1.0, 5)
    ends = [0.0, 1.0, 2.0, 4.0, 1.0, 0.0]
    for settling in (-3.0, -1e-3, 0.0, 9e-4, 2.0, 15.0):
        own = drift.each([*ends, settling], when)
        np.testing.assert_allclose(own[[0, -1]], np.reshape(ends, (2, 3)), atol=1e-12)
    np.testing.assert_allclose(drift.each([*ends, 0.0], when)[:, 0], 4.0 * when, atol=1e-12)
    near, far = (drift.each([*ends, g], when) for g in (0.999e-3, 1.001e-3))
    np.testing.assert_allclose(near, far, atol=1e-5)
    half = Drift(effects()["stiffness"]).each([0.0, np.log(0.5), 0.0], np.array([0.5]))
    assert np.exp(half[0, 0]) == pytest.approx(0.75)  # the factor is in the middle


def test_a_rod_that_warms_loses_stiffness_and_not_weight():
    """By a set of a solver that shares nothing with this one, as large as it is, in the trials
    that no fit has seen as well; nothing else is found to change beside it."""
    lab = laboratory("warming", 101, edges=60)
    ((change,),) = kept("warming", 101)[1]["drift_of_stiffness"].values()
    fits = with_drift(lab, list(effects().values()), base_fit(lab))
    best, m = fits[0], lab.measurements
    assert best.model.names == ("drift_of_stiffness",)
    assert best.bic < fits[1].bic - 100.0
    told = best.model.effects[0].describe(best.values, best.covariance, m)
    found = told["change_of_stiffness_ratio"]
    assert abs(found.value - change) < 2.5 * found.stderr < 0.1
    assert lab.rms(lab.predict(best.model, best.values), m.test) < 1.05 * m.noise_floor
    scatter, changing, left_over = what_is_left(lab, best.model, best.values, m.test)
    assert scatter is None and not changing and not left_over.seen
    again = with_drift(lab, [*effects().values(), *best.model.effects], base_fit(lab))
    assert again == []  # of one kind of change there is one
    likely = with_drift(lab, list(effects().values()), base_fit(lab), to_noise=True)
    assert likely[0].chi_squared == pytest.approx(best.chi_squared, rel=1e-3)
    assert {f.model.names for f in likely} < {f.model.names for f in fits}


def test_what_goes_by_the_logarithm_of_time_is_not_told_as_what_settles():
    """Of trials taken one after another ln(1 + n) is over; what settles tells three errors less of
    it. Where readings hardly tell the laws apart errors are those by either."""
    lab, rng = laboratory("warming", 101), np.random.default_rng(8)
    known, before = effects()["natural_curvature"], lab.target
    drift = Drift(known, by_logarithm=True)
    values = np.array([9.0, 6.0, 0.9, 0.6, np.log(len(lab.trials))])
    over = drift.each(values, np.linspace(0.0, 1.0, len(lab.trials)))[:, 0]
    gone = np.log1p(lab.trials) / np.log(len(lab.trials))
    np.testing.assert_allclose(over, 9.0 - 8.1 * gone, atol=1e-12)
    try:
        seen = lab.observe(Model((drift,)), values)
        lab.target = seen + lab.deviation * rng.normal(size=seen.shape)
        fit = with_drift(lab, [known], base_fit(lab))[0]
        assert fit.model.effects[0].by_logarithm
        (other,) = by_another_law(lab, fit)
        assert other.chi_squared > fit.chi_squared
        away = [np.abs(f.values - values) / np.sqrt(np.diag(f.covariance)) for f in (fit, other)]
        assert away[0][:4].max() < 2.0 and away[1][:4].max() > 3.0
        assert by_another_law(lab, base_fit(lab)) == []
        doubts = refined(lab, fit, [], (0.0, 0.0), profiles=False)[2]
        told, plain = (in_doubt(fit, 0, d, lab.measurements) for d in (doubts, {}))
        key = "change_of_curvature_1"
        assert told[key].value == plain[key].value and told[key].stderr > plain[key].stderr
    finally:
        lab.target = before


def test_a_rod_without_it_has_none():
    lab = laboratory("none 1", 101, "pose")
    fits = with_drift(lab, [effects()["stiffness"]], base_fit(lab))
    assert all(f.model.names != ("drift_of_stiffness",) or f.bic > base_fit(lab).bic for f in fits)


def test_a_bent_rod_remembers_the_curvature_of_its_arc():
    """Of an arc of radius 0.2 m, at its ends as well."""
    edges, radius, length = 40, 0.2, 0.3
    angle = np.concatenate([[0.0], np.arange(0.5, edges) / edges, [1.0]]) * length / radius
    nodes = np.linspace(0.0, length / radius, edges + 1)

    def along(a):
        return np.stack([np.cos(a), np.sin(a), 0.0 * a], axis=-1)

    def across(a):
        return np.stack([-np.sin(a), np.cos(a), 0.0 * a], axis=-1)

    up = np.broadcast_to([0.0, 0.0, 1.0], (edges + 1, 3))
    frames = np.stack([across(nodes), np.cross(along(nodes), across(nodes)), along(nodes)], axis=-1)
    assert np.allclose(frames[..., 1], up)
    bent = bent_before(np.stack([frames] * 2), np.stack([along(angle)] * 2), length)
    assert not bent[0].any()
    np.testing.assert_allclose(bent[1], np.tile([1.0 / radius, 0.0], (edges + 1, 1)), atol=2e-3)


def test_what_a_rod_keeps_is_found(monkeypatch):
    """Readings of rods that keep an eighth of the bend of the trial before."""
    # The markers of the set, which are another rod's, choose no equilibrium.
    place = "wrod.identification.clamped.laboratory.to_measured"
    monkeypatch.setattr(place, lambda *rods, **how: False)
    lab = laboratory("none 1", 101, "pose")
    memory, before = memory_of(lab, Model(), np.zeros(0)), lab.target
    rng, model = np.random.default_rng(3), Model((memory,))
    try:
        seen = lab.observe(model, np.array([0.125]))
        lab.target = seen + lab.deviation * rng.normal(size=seen.shape)
        fits = with_drift(lab, list(effects().values()), base_fit(lab))
        assert fits[0].model.names == (Memory.name,)
        fit = fit_models(lab, [model], [np.zeros(1)])[0]
        assert abs(fit.values[0] - 0.125) < 3.0 * np.sqrt(fit.covariance[0, 0]) < 0.02
    finally:
        lab.target = before
