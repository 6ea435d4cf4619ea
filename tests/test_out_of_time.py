"""A search that its time ends, and rods that no short way leads to a model."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from test_identification import FEW_NAMES, synthetic

from wrod.commands import main
from wrod.identification import identify
from wrod.identification.clamped import selection
from wrod.identification.clamped.clock import Clock, OutOfTime
from wrod.identification.clamped.equilibria import ClampedSolver
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.loading import measurements_from_arrays
from wrod.identification.clamped.noise import NoiseModel
from wrod.identification.clamped.steps import base_fit
from wrod.identification.clamped.verdict import judge
from wrod.identification.effect import Model, effects


@pytest.fixture(scope="module")
def bent():
    """A set whose rod is bent by nature."""

    def apply(setup):
        setup.natural_curvature = setup.natural_curvature + np.array([2.0, -3.0])

    return synthetic(apply, trials=7)


@pytest.fixture
def without_pictures(monkeypatch):
    """Those of a report are the same whatever ended it."""
    monkeypatch.setattr("wrod.identification.clamped.pictures.as_png", lambda figure: b"PNG")


@pytest.mark.usefixtures("on_coarse_meshes", "without_pictures")
def test_the_best_until_then_is_judged_and_explains_a_part_at_most(bent, monkeypatch, tmp_path):
    ended = []

    def check(clock):
        if clock.fits and not ended:
            ended.append(len(clock.fits))
            raise OutOfTime

    monkeypatch.setattr(Clock, "check", check)
    report = identify(measurements_from_arrays(bent), candidates=FEW_NAMES, seconds=600.0)
    assert ended and report.verdict == "partly-explained"
    assert [e.name for e in report.effects] == ["natural_curvature"]
    assert report.after < 1.1 * report.noise_floor
    assert report.reason.startswith("600 s were not enough")
    report.save(tmp_path)
    assert json.loads((tmp_path / "report.json").read_text())["out_of_time"]
    assert ">partly-explained so far<" in (tmp_path / "report.html").read_text()


@pytest.mark.usefixtures("on_coarse_meshes")
def test_where_there_is_no_time_to_judge_either_the_base_model_is(bent, monkeypatch):
    """As on a busy machine, where what is left for the verdict is over before it is there."""
    monkeypatch.setattr("wrod.identification.clamped.clock._LEAST_GRACE", -1.0)
    monkeypatch.setattr("wrod.identification.clamped.clock._GRACE", 0.0)
    report = identify(measurements_from_arrays(bent), candidates=FEW_NAMES, seconds=1e-3)
    assert report.verdict == "unexplained" and not report.effects
    assert report.reason.startswith("0.001 s were not enough")


def test_what_was_judged_stays_where_another_model_takes_too_long(bent, monkeypatch):
    def another(laboratory, *rest):
        laboratory.set_noise(NoiseModel())
        raise OutOfTime

    laboratory = Laboratory(measurements_from_arrays(bent), edge_count=30)
    only, empty = [effects()["stiffness"]], base_fit(laboratory)
    found = judge(laboratory, empty, empty, [], (0.0, None))
    noise, laboratory.clock = laboratory.noise, Clock(600.0)
    monkeypatch.setattr(selection, "_another", another)
    again = selection._or_another(laboratory, only, found.fit, found)
    assert found.verdict == again.verdict == "unexplained" and again.out_of_time
    assert again.fit is found.fit and again.reason.startswith("600 s were not enough")
    assert laboratory.noise is noise


@pytest.mark.usefixtures("without_pictures")
def test_a_command_whose_time_is_over_at_once_says_so(bent, tmp_path):
    np.savez(tmp_path / "bent.npz", **bent)
    asked = ["identify", str(tmp_path / "bent.npz"), "--minutes", "0.001"]
    result = CliRunner().invoke(main, [*asked, "--out", str(tmp_path)], catch_exceptions=False)
    assert "bent: unexplained so far; 0.06 s" in result.output


def test_rods_that_no_short_way_leads_come_from_their_measured_shapes(bent, monkeypatch):
    laboratory = Laboratory(measurements_from_arrays(bent), edge_count=30)
    model, values = Model((effects()["natural_curvature"],)), np.array([2.0, -3.0])
    led = laboratory.predict(model, values)
    monkeypatch.setattr(ClampedSolver, "solve", lambda self, setups, walk: np.zeros(1, bool))
    assert laboratory.predict(model, values) == pytest.approx(led, abs=1e-7)
