"""A motion's report and its model, from recordings to a plan, a deployment and a dataset."""

import json
import warnings

import numpy as np
import pytest
from cli import done
from test_motion_trace import MARKERS, STIFFNESS, VISCOUS, moved

import wrod
from wrod.errors import WrodWarning
from wrod.identification.effect import effects
from wrod.identification.motion.setup import START_L_GB

CURVATURE = np.array([-1.0, -1.5])
L_GB = START_L_GB * np.exp(STIFFNESS / 3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files that are written for recordings of a viscous rod with a bend of its own."""
    m = moved((effects("motion")["natural_curvature"], tuple(CURVATURE)), rods=4)
    out = tmp_path_factory.mktemp("identified")
    path, held = out.with_suffix(".npz"), [0, 1, MARKERS - 2, MARKERS - 1]
    np.savez(path, positions=m.positions, rate_hz=m.rate, held=held, gravity=m.gravity)
    said = done("identify", str(path), "--effect", "natural_curvature", "--out", str(out)).output
    assert "natural_curvature: " in said and "report.html" in said
    assert {path.name for path in out.iterdir()} == {"report.json", "report.html", "model.json"}
    return out


def test_the_report_has_the_evidence(folder):
    content = json.loads((folder / "report.json").read_text())
    assert {e["name"] for e in content["effects"]} >= {"natural_curvature"}
    viscous = content["base"]["internal_damping"]["viscous_time"]["value"]
    assert viscous == pytest.approx(VISCOUS, rel=0.2)
    shares = [p["share_of_excess"] for p in content["trace"]["prints"]]
    assert len(shares) == 11 and shares == sorted(shares, reverse=True) and shares[0] > 0.3
    assert content["trace"]["missing_force"]["size"]["median"] > 0.0
    page = (folder / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 7
    assert "the base model lacks, as mechanics" in page
    assert content["cautions"][0].startswith("length and axial stiffness are confounded")
    assert "Length and axial stiffness are confounded" in page


def test_the_model_is_a_rod_with_what_motion_tells(folder):
    path = folder / "model.json"
    with pytest.warns(WrodWarning) as said:
        model = wrod.load_rod(path)
    (sentence,) = (str(w.message) for w in said)
    assert "set aside" not in sentence
    assert "radius" in sentence and "line_mass" in sentence and "assumed" in sentence
    assert model.air_damping > 0.0
    assert model.internal_damping == pytest.approx(VISCOUS, rel=0.2)
    with pytest.warns(WrodWarning, match="cannot carry this one's internal_damping, air_damping"):
        rod = wrod.load_rod(path).material()
    # The mesh of fits is half as fine.
    assert rod.gravito_bending_length == pytest.approx(L_GB, rel=0.1)
    # Its size hardly shows: between two clamps a uniform bend leaves no force while the rod stays
    # in its plane.
    direction = np.array(rod.natural_curvature) / np.linalg.norm(rod.natural_curvature)
    assert direction @ CURVATURE / np.linalg.norm(CURVATURE) > 0.95
    assert rod.gravity == 9.81
    raw = json.loads(path.read_text())["found"]["effects"]
    found = {e["name"]: e["parameters"] for e in raw}
    natural = found["natural_curvature"]
    assert rod.natural_curvature == (natural["curvature_1"], natural["curvature_2"])
    report = json.loads((folder / "report.json").read_text())
    lgb = report["base"]["stiffness"]["L_gb"]["value"]
    assert rod.gravito_bending_length == pytest.approx(lgb, rel=1e-12)
    assert set(found) == {"stiffness", "air_damping", "internal_damping", "natural_curvature"}
    with pytest.warns(WrodWarning, match=r"line_mass .* assumed") as said:
        measured = wrod.load_rod(path, radius=0.004)
    assert measured.radius == 0.004 and "radius" not in str(said[0].message)


def test_commands_take_the_model(folder, tmp_path):
    rod = ["--rod", str(folder / "model.json"), "--radius", "0.003", "--length", "1.5"]
    args = ["plan", "line", *rod, "--out", str(tmp_path / "plan"), "--no-robot"]
    args += ["--no-expect", "--spacing", "0.1", "--device", "cpu", "--json"]
    result = done(*args)
    assert "line_mass" in result.stderr and "set aside" not in result.stderr
    figures = json.loads(result.stdout)
    assert figures["rod"]["radius"] == 0.003
    model = json.loads((folder / "model.json").read_text())
    assert figures["rod"]["natural_curvature"] == model["natural_curvature"] != [0.0, 0.0]
    assert figures["rod"]["internal_damping"] == model["internal_damping"] > 0.0
    args = ["dataset", "--size", "2", *rod, "--out", str(tmp_path / "grasps"), "--device", "cpu"]
    done(*args)


def test_the_model_is_deployed(folder):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WrodWarning)
        rod = wrod.load_rod(folder / "model.json", radius=0.003, length=1.0).material()
    pattern = wrod.Pattern.from_points(np.linspace([0, 0, 0], [0.15, 0, 0], 20))
    trajectory = wrod.plan(pattern, rod, "numeric", device="cpu", spacing=0.05)
    deployment = wrod.simulate_deployment(pattern, rod, trajectory, device="cpu")
    assert deployment.error_mean < 0.02
