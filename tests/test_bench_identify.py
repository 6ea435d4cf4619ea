"""The confusion table of `wrod bench identify --hidden`: its sets, its marks, its command."""

import numpy as np
import pytest
from cli import refused
from click.testing import CliRunner
from hidden import COARSE, SETS, draw, kept

from wrod.bench.continuous_rod import excess_of
from wrod.bench.hidden_effects import MAGNET_REACH
from wrod.bench.hidden_sets import TRIALS, cases
from wrod.bench.hidden_table import error_of, held, limit_of, lines, located, outcome, summary
from wrod.bench.identify import _called
from wrod.commands import main
from wrod.errors import DataError
from wrod.identification.clamped.described import Attraction
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.loading import measurements_from_arrays
from wrod.identification.clamped.setup import ClampedSetup
from wrod.identification.effect import Model, effects
from wrod.identification.template import write_template


def entry(*names, verdict="explained", rivals=()):
    return {
        "verdict": verdict,
        "effects": [{"name": name, "parameters": {}} for name in names],
        "confounded": [{"effects": list(pair)} for pair in rivals],
    }


@pytest.mark.parametrize(
    ("said", "hidden", "uncovered", "mark"),
    [
        (entry("stiffness"), {"stiffness"}, False, "right"),
        (entry("stiffness", verdict="partly-explained"), {"stiffness"}, False, "incomplete"),
        (entry("stiffness"), {"stiffness", "grip_slip"}, False, "incomplete"),
        (entry("stiffness", "density"), {"stiffness"}, False, "wrong"),
        (entry("density"), {"stiffness"}, False, "wrong"),
        (
            entry("density", rivals=[("density", "stiffness")]),
            {"stiffness"},
            False,
            "confounded",
        ),
        (
            entry("density", "grip_slip", rivals=[("density", "stiffness")]),
            {"stiffness", "grip_slip"},
            False,
            "confounded",
        ),
        (entry(verdict="unexplained"), {"stiffness"}, False, "unexplained"),
        (entry(verdict="adequate"), set(), False, "right"),
        (entry("density"), set(), False, "false alarm"),
        (entry(verdict="unexplained"), set(), True, "right"),
        (entry("density", verdict="partly-explained"), set(), True, "right"),
        (entry("density"), set(), True, "wrong"),
        (entry(verdict="adequate"), set(), True, "wrong"),
    ],
)
def test_marks(said, hidden, uncovered, mark):
    assert outcome(said, hidden, uncovered) == mark


def test_what_has_no_plug_in_may_be_explained_by_its_like():
    akin = ("clamp_rotation",)
    assert outcome(entry("clamp_rotation"), set(), True, akin=akin) == "near"
    assert outcome(entry("clamp_rotation", "density"), set(), True, akin=akin) == "wrong"
    assert outcome(entry(verdict="adequate"), set(), True, akin=akin) == "wrong"
    changing = entry() | {"scatter": [{"name": "clamp_rotation", "value": 2.0, "unit": "deg"}]}
    assert outcome(changing, set(), True, akin=akin) == "near"
    assert outcome(changing, set(), True, akin=("density",)) == "wrong"
    assert outcome(changing, set(), False) == "right"


def test_a_law_of_its_own_is_right_only_for_a_law_outside_the_list():
    said = entry("moment_law")
    assert outcome(said, {"softening"}, False) == "wrong"
    assert outcome(said, {"softening"}, False, other_law=True) == "right"
    more = entry("moment_law", "anisotropic_bending")
    assert outcome(more, {"softening"}, False, other_law=True) == "wrong"


def test_errors_are_those_of_vectors_and_directions_repeat():
    def estimate(value, stderr, unit=""):
        return {"value": value, "stderr": stderr, "unit": unit}

    truth = {"a": {("x", "y"): (3.0, 4.0)}, "b": {("turn",): (89.0,)}, "c": {("z",): (1.0,)}}
    found = {
        "a": {"x": estimate(3.0, 0.1), "y": estimate(4.1, 0.1)},
        "b": {"turn": estimate(-89.0, 1.0, "deg")},
    }
    worst, deviations = error_of(found, truth)
    assert worst == pytest.approx(np.radians(2.0))
    assert deviations == pytest.approx(2.0)
    assert error_of({}, truth) == (None, None)


def test_errors_of_a_profile_that_is_nothing_somewhere_are_those_of_the_largest_value():
    truth = {"profile_of_curvature": {("c_at_0_mm",): (0.0,), ("c_at_9_mm",): (-2.0,)}}
    told = {key: {"value": 0.1, "stderr": 0.2, "unit": "1/m"} for key in ("c_at_0_mm", "c_at_9_mm")}
    told["c_at_9_mm"]["value"] = -2.0
    assert error_of({"profile_of_curvature": told}, truth) == pytest.approx((0.05, 0.5))


def test_built_effects_are_judged_by_place_and_size():
    def estimates(**values):
        return {key: {"value": value} for key, value in values.items()}

    sleeve = {
        "truth": {"stretch": [[["extra_mass"], [0.02]], [["start", "stop"], [0.1, 0.2]]]},
        "effects": [
            {"name": "stretch", "parameters": estimates(extra_mass=0.021, start=0.1, stop=0.197)}
        ],
    }
    magnet = {
        "truth": {"attraction": [[["x", "y", "z"], [0.4, 0.0, 0.2]]]},
        "effects": [{"name": "attraction", "parameters": estimates(x=0.403, y=0.004, z=0.2)}],
    }
    assert located(sleeve) == pytest.approx((0.003, 0.05))
    assert located(magnet) == pytest.approx((0.005, 0.0))


def test_the_bound_of_a_magnet_is_what_linear_estimates_scatter_by():
    """Readings of the true model with noise of its own, fitted to first order."""
    m = measurements_from_arrays(kept("none 1", 101, "pose")[0])
    pull = {("strength",): (0.1,), ("x", "y", "z"): (0.4, 0.0, 0.2)}
    place, size = limit_of(m, {"attraction": pull})
    values = np.array([*pull[("strength",)], *pull[("x", "y", "z")], np.log(MAGNET_REACH)])
    laboratory, rng = Laboratory(m, edge_count=COARSE), np.random.default_rng(3)
    _, rates = laboratory.jacobian(Model((Attraction([values]),)), values)
    deviation = laboratory.deviation[m.train]
    rates = (rates[m.train] / deviation[..., None]).reshape(-1, len(values))
    off = np.linalg.lstsq(rates, rng.normal(size=(len(rates), 4000)))[0]
    assert place == pytest.approx(np.sqrt((off[1:4] ** 2).sum(axis=0).mean()), rel=0.05)
    assert size * values[0] == pytest.approx(off[0].std(), rel=0.05)


def test_curvatures_of_a_softening_law_carry_the_moment():
    def law(e):
        return 0.3 * e + 0.7 * 5.0 * np.tanh(e / 5.0), 0.3 + 0.7 / np.cosh(e / 5.0) ** 2

    moment, stiffness = np.array([[0.0, 2.0, -9.0], [0.0, 1.0, 4.0]]), np.full((2, 3), 0.5)
    bend = excess_of(moment, stiffness, law, 0.4)
    size = np.hypot(*bend)
    carried = 0.5 * (0.6 * size + 0.4 * law(size)[0])
    assert np.allclose(carried, np.hypot(*moment), rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("one", SETS, ids=lambda one: f"{one[0]} {one[2]}")
def test_sets_that_are_kept_are_those_that_are_drawn(one):
    (data, truth), (again, same) = kept(*one), draw(*one)
    assert data.keys() == again.keys() and truth.keys() == same.keys()
    for name, value in data.items():
        # What rounding changes in solutions of boundary value problems, whose tolerance is 1e-6.
        np.testing.assert_allclose(value, again[name], rtol=1e-6, atol=1e-7, err_msg=name)
    for effect, parts in truth.items():
        assert {k: tuple(np.ravel(v)) for k, v in same[effect].items()} == parts


# The size of the true values in the parameters of the plug-in, by case.
TRUE = {
    "stiffness": lambda t: [np.log(t[("stiffness_ratio",)][0])],
    "anisotropic_bending": lambda t: [
        np.log(t[("stiffer_ratio",)][0]),
        np.log(t[("softer_ratio",)][0]),
        np.radians(t[("stiffer_direction",)][0]),
    ],
    "camera_scale": lambda t: [*t[("scale",)], *t[("offset_x", "offset_y", "offset_z")]],
    "grip_rotation": lambda t: t[("rotation_1", "rotation_2", "roll")],
    "softening_by_yield": lambda t: [
        np.log(t[("yield_curvature",)][0]),
        1.0 - t[("hardening",)][0],
    ],
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if (n, 11, "white") in SETS else pytest.mark.slow) for n in TRUE],
)
def test_the_plug_in_at_the_true_values_leaves_noise(name):
    known = (name, 11, "white")
    data, truth = kept(*known) if known in SETS else draw(*known)
    laboratory = Laboratory(measurements_from_arrays(data))
    assert len(data["centerline"]) == TRIALS
    ((effect, true),) = truth.items()
    model = Model((effects()[effect],))
    values = np.array(TRUE[name](true), dtype=float)
    residual = (laboratory.target - laboratory.observe(model, values)) / laboratory.deviation
    # Noise alone: chi squared over its count is 1 within four standard deviations.
    assert abs((residual**2).mean() - 1.0) < 4.0 * np.sqrt(2.0 / residual.size)


@pytest.mark.parametrize("name", ["stiffness", "stiffness_gradient"])
def test_what_is_stiffer_is_so_against_tension_as_well(name):
    """A set's rod is the one that its effect describes: extension moves rods by tenths of a mm."""
    m = measurements_from_arrays(kept("stiffness_gradient", 501, "correlated-0.7")[0])
    hidden = cases()[name](np.random.default_rng(3), m.material)
    ((true,),) = (own.values() for own in hidden.truth.values())
    values = np.log(true) if name == "stiffness" else np.array(true)
    base = ClampedSetup.base(m, m.train[:1], 8)
    setup, rod = Model((effects()[name],)).setup(base, values), hidden.experiment
    nodes, middles = base.arc_length, 0.5 * (base.arc_length[1:] + base.arc_length[:-1])
    assert setup.bending / base.bending == pytest.approx(rod.bending(nodes).T)
    twisting = rod.twisting * rod.twist_profile(nodes)
    assert setup.twisting / base.twisting == pytest.approx(twisting)
    stretching = rod.stretching * rod.stretch_profile(middles)
    assert setup.stretching / base.stretching == pytest.approx(stretching)


def test_every_effect_of_a_clamped_rod_is_hidden_somewhere():
    """But for those whose like is there at the other end, and the axial stiffness."""
    rng = np.random.default_rng(0)
    from wrod.bench.hidden_sets import _rod

    hidden = {name for make in cases().values() for name in make(rng, _rod(rng)).truth}
    assert set(effects()) - hidden == {
        "axial_stiffness",
        "clamp_offset",
        "clamp_slip",
        "grip_offset",
    }


def test_table_and_its_summary():
    row = {
        "seed": 4,
        "noise": "white",
        "before_mm": 5.0,
        "after_mm": 0.87,
        "noise_floor_mm": 0.87,
        "cpu_seconds": 9.0,
        "worst_error": 0.01,
        "worst_deviations": 0.7,
    }
    found = {"set": "stiffness", "outcome": "right", **entry("stiffness"), **row}
    rows = [
        found,
        {
            "set": "kink",
            "seed": 4,
            "noise": "pose",
            "outcome": "not made",
            "reason": "no equilibrium",
        },
    ]
    for seed, place in ((5, 0.204), (6, 0.215)):
        told = {"bend": (0.35, 0.04), "arc_length": (place, 0.004)}
        bent = {key: {"value": v, "stderr": e} for key, (v, e) in told.items()}
        effect = {"effects": [{"name": "local_bend", "parameters": bent}]}
        truth = {"truth": {"local_bend": [[["bend"], [0.4]], [["arc_length"], [0.2]]]}}
        own = {"set": "kink", "outcome": "right", "seed": seed}
        rows.append(found | own | effect | truth)
    text = "\n".join(lines(rows) + summary(rows))
    said = text.split("kink, 2 right, 1 within 1 cm and 15 %: places within 15.0 mm")[1]
    assert "sizes within 12.5 %; 80 % intervals hold 3 of 4" in said
    assert "no equilibrium" in text
    assert "one effect              1 sets: right 1" in text
    assert "within 5 % in 1 of 1" in text


def test_a_profile_is_judged_by_its_intervals_whatever_it_is_called():
    true = [[[f"stiffness_ratio_at_{k}_mm"], [1.0 + 0.1 * k]] for k in range(21)]
    told = {f"stiffness_ratio_at_{5 * k}_mm": {"value": 1.05, "stderr": 0.4} for k in range(5)}
    row = {"truth": {"profile_of_stiffness": true}}
    assert held(row | {"effects": [{"name": "stiffness", "parameters": told}]}) == (2, 5)
    assert held(row | {"effects": []}) == (0, 0)


@pytest.mark.parametrize(
    "arguments", [[], ["--hidden", "1", "--only", "no such"], ["--hidden", "1", "--workers", "0"]]
)
def test_bad_questions_are_refused(arguments):
    result = CliRunner().invoke(main, ["bench", "identify", *arguments])
    assert result.exit_code == 2


def test_a_case_is_asked_for_by_its_whole_name():
    names = list(cases())
    assert _called("natural_curvature", names) == ["natural_curvature"]
    assert _called("none", names) == ["none 1", "none 2", "none 3"]
    with pytest.raises(
        DataError, match="like 'softening by yeild'; the nearest are softening_by_y"
    ):
        _called("softening by yeild", names)
    listed = CliRunner().invoke(main, ["bench", "identify", "--list"])
    assert listed.exit_code == 0 and listed.output.split("\n")[:-1] == names


def test_a_fault_in_one_set_ends_no_other(monkeypatch, tmp_path):
    asked = []

    def make(case, seed, noise):
        asked.append(case)
        if asked == ["none 1"]:
            raise IndexError("beyond the last trial")
        raise DataError("no equilibrium")

    monkeypatch.setattr("wrod.bench.hidden_sets.hidden_set", make)
    command = ["bench", "identify", "--hidden", "4", "--only", "none", "--out", str(tmp_path)]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 2, result.output
    assert result.output.count("not made     no equilibrium") == 2
    assert "nothing hidden          1 sets: failed 1" in result.output
    said = "1 of 3 sets failed by a fault of wrod, the first of them none 1 of seed 4 (IndexError"
    assert said in result.output
    assert CliRunner().invoke(main, command).exit_code == 0  # it alone is tried again
    assert asked == ["none 1", "none 2", "none 3", "none 1"]


def test_recordings_of_motion_are_no_sets(tmp_path):
    write_template("motion", tmp_path / "a.npz")
    refused("holds recordings of motion", "bench", "identify", "--sets", tmp_path)
