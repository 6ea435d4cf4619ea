"""An effect whose law along the rod is not the rod's gives way to a profile; one whose is stays."""

import numpy as np
import pytest
from hidden import kept

from wrod.identification.clamped.fit import fit_models
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.loading import measurements_from_arrays
from wrod.identification.clamped.profiles import KNOTS, ProfileEffect
from wrod.identification.clamped.refinement import refined
from wrod.identification.clamped.report import _found_rod
from wrod.identification.effect import Model, effects

# Quarter points among the knots.
_QUARTERS = range(0, KNOTS, (KNOTS - 1) // 4)


def by_a_line(case: str):
    """(laboratory, the straight line that is fitted to the stiffness, truth) of a hidden set."""
    data, truth = kept(case, 501, "correlated-0.7")
    laboratory = Laboratory(measurements_from_arrays(data))
    line = Model((effects()["stiffness_gradient"],))
    return laboratory, fit_models(laboratory, [line], [np.zeros(2)])[0], truth


def test_a_stiffness_that_falls_quadratically_is_no_straight_line(tmp_path):
    laboratory, line, truth = by_a_line("stiffness, quadratic")
    m, rounds = laboratory.measurements, []
    found, held_out = refined(laboratory, line, rounds, (1.0, 1.0))
    (step,) = rounds
    assert step.accepted == found.model.names == ("profile_of_stiffness",)
    assert held_out[0] == 1.0 and held_out[1] < 1.1 * m.noise_floor
    (own,), (expected,) = found.model.effects, truth.values()
    told = own.describe(found.values, found.covariance, m)
    keys = [f"stiffness_ratio_at_{25 * k}_mm" for k in _QUARTERS]
    true = np.array([expected[(key,)][0] for key in keys])
    value, error = np.array([(told[key].value, told[key].stderr) for key in keys]).T
    assert np.abs(value - true).max() < 3.0 * error.max() and error.max() < 0.06
    # The line is off by more than the profile at every place, by far more than its error.
    a, b = line.values
    by_line = 1.0 + a + (b - a) * np.linspace(0.0, 1.0, len(keys))
    assert np.abs(by_line - true).max() > 2.0 * np.abs(value - true).max()
    # What commands take of it, through the file, is the profile.
    rod = _found_rod(m, laboratory, found)
    assert not rod.set_aside
    rod.save(tmp_path / "model.json")
    from wrod.rods.model_file import load_rod

    first, _ = load_rod(tmp_path / "model.json").bending_stiffness
    places = np.linspace(0.0, m.material.length, len(keys))
    assert first(places) / m.material.bending_stiffness == pytest.approx(value, rel=2e-3)


def test_a_straight_line_stays_one():
    laboratory, line, truth = by_a_line("stiffness_gradient")
    noise, rounds = laboratory.noise, []
    found, held_out = refined(laboratory, line, rounds, (1.0, 0.5))
    assert found is line and held_out == (1.0, 0.5) and laboratory.noise is noise
    assert all(step.accepted is None for step in rounds)
    ((true,),) = (own.values() for own in truth.values())
    assert np.abs(line.values - true).max() < 0.05


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
