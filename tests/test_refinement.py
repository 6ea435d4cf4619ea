"""An effect whose law along the rod is not the rod's gives way to a profile; one whose is stays."""

from copy import copy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hidden import kept

from wrod.identification.clamped.fit import fit_models
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.loading import measurements_from_arrays
from wrod.identification.clamped.profiles import KNOTS, ProfileEffect, root_of
from wrod.identification.clamped.refinement import (
    _SHARE,
    _SIZES,
    _beside,
    _expected,
    _likenesses,
    in_doubt,
    refined,
)
from wrod.identification.clamped.report import _found_rod
from wrod.identification.effect import Model, effects


def by_a_line(case: str):
    """(laboratory, the straight line that is fitted to the stiffness, truth) of a hidden set."""
    laboratory, line, truth = _fitted(case)
    return copy(laboratory), line, truth  # of which some take noise and correction anew


@cache
def _fitted(case: str):
    data, truth = kept(case, 501, "correlated-0.7")
    laboratory = Laboratory(measurements_from_arrays(data), edge_count=60)
    model = Model((effects()["stiffness_gradient"],))
    line = fit_models(laboratory, [model], [np.zeros(2)])[0]
    laboratory.refine(model, line.values)
    return laboratory, fit_models(laboratory, [model], [line.values])[0], truth


def at_quarters(told, length_mm: int):
    """(values, errors) of the stiffness that a report tells."""
    keys = [f"stiffness_ratio_at_{length_mm * k // 4}_mm" for k in range(5)]
    return np.array([(told[key].value, told[key].stderr) for key in keys]).T


def test_a_stiffness_that_falls_quadratically_is_no_straight_line(tmp_path):
    laboratory, line, truth = by_a_line("stiffness, quadratic")
    m, rounds = laboratory.measurements, []
    found, held_out, doubts = refined(laboratory, line, rounds, (1.0, 1.0))
    (step,) = rounds
    assert step.accepted == found.model.names == ("profile_of_stiffness",) and not doubts
    assert held_out[0] == 1.0 and held_out[1] < 1.1 * m.noise_floor
    (own,), (expected,) = found.model.effects, truth.values()
    value, error = at_quarters(own.describe(found.values, found.covariance, m), 500)
    true = np.array([expected[(f"stiffness_ratio_at_{125 * k}_mm",)][0] for k in range(5)])
    assert (np.abs(value - true) < 2.5 * error).all() and error.max() < 0.08
    # The line is off by more than the profile at every place, by far more than its error.
    a, b = line.values
    by_line = 1.0 + a + (b - a) * np.linspace(0.0, 1.0, 5)
    assert np.abs(by_line - true).max() > 2.0 * np.abs(value - true).max()
    # What commands take of it, through the file, is the profile.
    rod = _found_rod(m, laboratory, found)
    assert not rod.set_aside
    rod.save(tmp_path / "model.json")
    from wrod.rods.model_file import load_rod

    first, _ = load_rod(tmp_path / "model.json").bending_stiffness
    places = np.linspace(0.0, m.material.length, 5)
    assert first(places) / m.material.bending_stiffness == pytest.approx(value, rel=2e-3)


def test_a_straight_line_stays_one_with_errors_that_do_not_take_it_for_granted():
    laboratory, line, truth = by_a_line("stiffness_gradient")
    m, noise, rounds = laboratory.measurements, laboratory.noise, []
    found, held_out, doubts = refined(laboratory, line, rounds, (1.0, 0.5))
    assert found is line and held_out == (1.0, 0.5) and laboratory.noise is noise
    assert all(step.accepted is None for step in rounds)
    ((true,),) = (own.values() for own in truth.values())
    assert np.abs(line.values - true).max() < 0.02
    (effect,) = line.model.effects
    told = in_doubt(line, 0, doubts, m)
    assert [told[p.key].value for p in effect.parameters] == pytest.approx(line.values)
    value, error = at_quarters(told, 480)
    true = 1.0 + true[0] + (true[1] - true[0]) * np.linspace(0.0, 1.0, 5)
    assert (np.abs(value - true) < 2.5 * error).all()
    # In the middle the line alone would know it to a third of that, or better.
    of_middle = 0.5 * np.sqrt(line.covariance.sum())
    assert 2.0 * of_middle < error[2] < 0.03


def test_errors_hold_what_profiles_are_drawn_from():
    """80 % intervals hold 80 % of what the prior draws, whatever its size and smoothness are."""
    laboratory, line, _ = by_a_line("stiffness_gradient")
    own, rng, inside = _beside(laboratory, line, 0, "stiffness"), np.random.default_rng(5), []
    like, sizes = _likenesses(), _SIZES[6:-3]
    chances = sizes / (1.0 + (sizes / _SHARE) ** 2)
    noise = np.linalg.cholesky(own.grams[0] + 1e-9 * np.trace(own.grams[0]) * np.eye(KNOTS))
    for _ in range(200):
        size = own.size * rng.choice(sizes, p=chances / chances.sum())
        drawn = root_of(size**2 * like[rng.integers(len(like))], 1)
        true = drawn @ rng.normal(size=drawn.shape[1])
        towards = own.grams[0] @ true + noise @ rng.normal(size=KNOTS)
        seen = replace(own, projected=[towards, towards], grams=[own.grams[0]] * 2)
        root = root_of(_expected(seen)[0], 1)
        inner = root.T @ own.grams[0] @ root + np.eye(root.shape[1])
        away = root @ np.linalg.solve(inner, root.T @ towards) - true
        error = np.sqrt(np.diag(root @ np.linalg.solve(inner, root.T)))
        inside.append(np.mean(np.abs(away) < 1.2816 * error))
    assert 0.75 < np.mean(inside) < 0.85


def test_a_profile_about_an_effect_without_components_is_the_effect():
    laboratory, line, _ = by_a_line("stiffness_gradient")
    (effect,) = line.model.effects
    about = Model((ProfileEffect("stiffness", np.zeros((KNOTS, 1, 2)), effect),))
    values = np.append(line.values, [0.3, -0.2])
    by_line, by_profile = (
        m.setup(laboratory.base, v) for m, v in ((line.model, line.values), (about, values))
    )
    for name in ("bending", "twisting", "stretching"):
        assert np.array_equal(getattr(by_line, name), getattr(by_profile, name))


@pytest.mark.parametrize(
    ("kind", "law", "constant"),
    [
        ("curvature", "natural_curvature", None),
        ("stiffness", "stiffness_gradient", "stiffness"),
        ("weight", "density_profile", "density"),
    ],
)
def test_a_profile_knows_the_law_that_it_comes_near_to(kind, law, constant):
    """What it tells of a law is the law in its own components, and so is its special case."""
    m = by_a_line("stiffness_gradient")[0].measurements
    values, known = np.array([0.3, -0.2]), effects()
    width = 2 if kind == "curvature" else 1
    effect = ProfileEffect(kind, np.zeros((KNOTS, width, 1)), known[law])
    values = np.append(values, 0.7)
    cases = effect.special_cases(values, m)
    assert cases[law] == pytest.approx(values[:2]) and set(cases) == {law, constant} - {None}
    told = [e.value for e in effect.describe(values, np.eye(3), m).values()]
    if constant is None:
        assert told[:2] == pytest.approx(values[:2])
    else:
        assert np.exp(cases[constant]) == pytest.approx(1.05)
        assert told[:3] == pytest.approx([1.3, 1.05, 0.8])
