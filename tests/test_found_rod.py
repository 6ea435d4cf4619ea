"""What is found in measurements is the rod that is planned with, and all of it."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import wrod
from wrod.bench.loop_trials import own_bend
from wrod.commands import main
from wrod.errors import DataError, RodError, WrodWarning
from wrod.identification.effect import Model, effects
from wrod.identification.found_rod import FoundRod, found_rod, rod_of
from wrod.identification.motion.setup import MotionSetup
from wrod.identification.report import Report
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel

CABLES = Path(__file__).parents[2] / "shared" / "measured" / "mocap"
# What belongs to how a cable is held and seen.
OF_THE_MEASUREMENT = {
    "clamp_length",
    "gravity_tilt",
    "grip_direction",
    "grip_roll",
    "marker_offset",
}


def found(name: str, size: float = 0.05) -> tuple:
    """Of a cable of 20 edges with one effect, every parameter off by a part of its scale."""
    base = MotionSetup.base(np.full(20, 0.05), 2, 9.81)
    effect = effects("motion")[name]
    like = RodModel.of(RodMaterial(0.0035, 0.2, 1.0))
    line_mass = like.line_mass.values[0]

    def read(setup: MotionSetup) -> RodModel:
        length = float(np.real(setup.rest_length).sum())
        s = np.concatenate([[0.0], np.cumsum(np.real(setup.rest_length))])
        return rod_of(setup, s, like=replace(like, length=length), line_mass=line_mass)

    values = np.array([min(max(size * p.scale, p.lower), p.upper) for p in effect.parameters])
    return found_rod(base, Model((effect,)), values, read), read(base)


@pytest.mark.parametrize("name", sorted(effects("motion")))
def test_nothing_of_the_rod_is_set_aside(name):
    what, plain = found(name)
    if name in OF_THE_MEASUREMENT:
        assert what.set_aside == (name,) and what.rod == plain
        return
    assert what.set_aside == () and what.rod != plain


def test_what_came_out_as_nothing_is_not_said_to_be_set_aside():
    assert found("air_damping", 0.0)[0].set_aside == ()


def test_what_is_no_rod_costs_the_model_and_not_the_report(tmp_path):
    """Its evidence is written all the same, and says why there is no model.json."""
    what, _ = found("twist_stiffness", -1e4)

    @dataclass(frozen=True, kw_only=True)
    class Bare(Report):
        found: FoundRod

        def to_dict(self):
            return self.head("bare", "cable", "none")

    numbers = {"before": 2.0, "after": 1.0, "noise_floor": 0.1}
    told = {"verdict": "unexplained", "reason": "", "measurements": None, "effects": ()}
    report = Bare(found=what, candidates=(), **told, **numbers)
    with pytest.warns(WrodWarning, match=r"model\.json: not written; what was fitted is no rod:"):
        written = report.written(tmp_path, lambda path, report: path)
    assert [path.name for path in written] == ["report.json", "report.html"]
    said = json.loads((tmp_path / "report.json").read_text())["no_model"]
    assert "twisting_stiffness falls to 0; it must be positive" in said
    with pytest.raises(RodError, match="it must be positive"):
        report.model.material()


def test_a_cable_is_planned_with_what_was_found(tmp_path):
    what, _ = found("natural_curvature_profile")
    rod = replace(what.rod, internal_damping=0.05, quadratic_drag=0.3)
    (saved,) = replace(what, fitted=rod).save(tmp_path / "model.json")
    pattern = own_bend(rod)
    path = wrod.plan(pattern, wrod.load_rod(saved), spacing=0.05)
    assert path.rod == rod
    with pytest.raises(DataError, match="too short to be laid"):
        own_bend(replace(rod, length=3.0 * rod.gravito_bending_length))


@pytest.mark.slow
@pytest.mark.skipif(not CABLES.is_dir(), reason="no recordings of cables")
def test_a_recorded_cable_goes_from_recording_to_plan(tmp_path):
    with np.load(CABLES / "cable-2-train.npz") as file:
        data = dict(file)
    part = {"positions": data["positions"][::14, :40], "file_ids": data["file_ids"][::14]}
    np.savez(tmp_path / "cable.npz", **{**data, **part})

    def run(*args) -> dict:
        result = CliRunner().invoke(main, [*map(str, args), "--json"])
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)

    out = tmp_path / "found"
    run("identify", tmp_path / "cable.npz", "--out", out, "--effect", "natural_curvature")
    rod = wrod.load_rod(out / "model.json")
    assert rod.internal_damping > 0.0
    assert set(json.loads((out / "report.json").read_text())["set_aside"]) <= OF_THE_MEASUREMENT
    curve = own_bend(rod)
    points = curve.sample(np.linspace(0.0, curve.length, 200))[0]
    np.savetxt(tmp_path / "bend.csv", points[:, :2], delimiter=",")
    named = [tmp_path / "bend.csv", "--units", "m", "--rod", out / "model.json"]
    run("plan", *named, "--out", tmp_path / "plan", "--no-robot", "--no-expect")
    path = wrod.Trajectory.load(tmp_path / "plan" / "trajectory.npz")
    assert path.rod == rod
    hold = ["--release", 1.5 * rod.gravito_bending_length]
    laid = run(
        "deploy", *named, "--trajectory", tmp_path / "plan" / "trajectory.npz", *hold,
        "--out", tmp_path / "laid",
    )  # fmt: skip
    assert not laid["trials"][0]["diverged"]
