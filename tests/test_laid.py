"""Laid centrelines as measurements: read, checked, and explained."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cli import refused, told
from test_deployment import QUICK, ROD, quarter_turn

import wrod
from wrod.commands.laid import _said
from wrod.commands.plan_summary import read_friction
from wrod.deployment.table import TableFriction
from wrod.errors import DataError
from wrod.identification.effect import Estimate
from wrod.identification.laid.fit import fit_laid, with_parameters
from wrod.identification.laid.measurements import load_laid

NOISE = 2e-4


@pytest.fixture(scope="module")
def plan():
    pattern = quarter_turn()
    return pattern, wrod.plan(pattern, ROD, "numeric", device="cpu")


def noisy(line, seed):
    line = np.asarray(line)[:, :2]
    return line + NOISE * np.random.default_rng(seed).standard_normal(line.shape)


def offset(pattern, left=0.0, along=0.0):
    """A rod of 30 cm beside the pattern."""
    s = np.linspace(0.0, pattern.length, 200)
    place, tangent, _ = pattern.sample(s)
    side = np.cross([0.0, 0.0, 1.0], tangent)
    line = place + left * side + along * tangent
    tail = line[-1] + np.linspace(0.005, 0.1, 20)[:, None] * tangent[-1]
    return np.concatenate([line, tail])


def test_residual_is_told_along_and_to_the_left():
    pattern = wrod.pattern("line")
    laid = load_laid([offset(pattern, left=0.003)], pattern, noise=NOISE)
    along, left = laid.residual()[0].T
    assert np.abs(along).max() < 1e-9
    assert np.abs(left - 0.003).max() < 1e-9
    assert laid.rms() == pytest.approx(0.003)
    shifted = load_laid([offset(pattern, along=-0.002)], pattern, noise=NOISE)
    assert shifted.residual()[0, 5:, 0] == pytest.approx(np.full(45, -0.002))
    # From the far end, as a picture may give it, it is the same rod.
    back = load_laid([offset(pattern, left=0.003)[::-1]], pattern, noise=NOISE)
    assert np.abs(back.residual() - laid.residual()).max() < 1e-9


def test_where_a_rod_is_hidden_its_points_are_in_order():
    pattern = wrod.pattern("letter-U")
    line = offset(pattern)
    seen = np.delete(line, [*range(20, 36), *range(130, 150)], axis=0)
    laid = load_laid([seen], pattern, noise=NOISE)
    assert np.abs(laid.curves[0][[0, -1]] - line[[0, -1], :2]).max() < 1e-6


def test_noise_is_seen_in_the_scatter_of_rods():
    pattern = wrod.pattern("line")
    rods = [noisy(offset(pattern, left=0.003), seed) for seed in range(8)]
    laid = load_laid(rods, pattern)
    # Smoothing takes most of the noise out, across and along.
    assert 0.2 * NOISE < laid.noise < 0.9 * NOISE
    assert np.abs(laid.residual().mean(axis=0) - [0.0, 0.003]).max() < NOISE


def test_reads_scans_deployments_and_points(tmp_path, plan):
    pattern, _ = plan
    line = offset(pattern, left=0.001)
    np.savez(tmp_path / "scan.npz", path_m=line[:, :2])
    np.savetxt(tmp_path / "points.csv", 100 * line[:, :2], delimiter=",")
    held = offset(pattern, left=0.003)
    np.savez(tmp_path / "deployment.npz", centerline=held, released_centerline=line)
    names = [tmp_path / "scan.npz", tmp_path / "deployment.npz"]
    laid = load_laid(names, pattern, noise=NOISE)
    points = load_laid([tmp_path / "points.csv"], pattern, units="cm", noise=NOISE)
    holding = load_laid(names[1:], pattern, noise=NOISE, released=False)
    assert np.abs(holding.curves[0][0] - held[0, :2]).max() < 1e-6
    for trial in (2, 10):
        np.savez(tmp_path / f"deployment-{trial}.npz", centerline=line)
    trials = load_laid([tmp_path], pattern, noise=NOISE).names
    assert trials == tuple(str(tmp_path / f"deployment{of}.npz") for of in ("", "-2", "-10"))
    for curve in (*laid.curves, *points.curves):
        assert np.abs(curve[[0, -1]] - line[[0, -1], :2]).max() < 1e-6


@pytest.mark.parametrize(
    ("name", "frame", "says"),
    [
        ("letter-A", [[1.0, 0.0], [0.0, -1.0]], "mirrored"),
        ("letter-A", [[0.0, 1.0], [1.0, 0.0]], "x and y exchanged"),
        ("letter-A", [[0.0, 1.0], [-1.0, 0.0]], "turned"),
        ("line", [[0.0, 1.0], [1.0, 0.0]], "turned"),
        ("letter-A", [[0.99, 0.14], [-0.14, 0.99]], None),  # a rod that lies badly
    ],
)
def test_centrelines_of_another_frame_are_named(name, frame, says):
    pattern = wrod.pattern(name)
    lies = pattern.sample(np.linspace(0.0, pattern.length, 200))[0][:, :2] @ np.array(frame)
    if says is None:
        assert len(load_laid([lies], pattern, noise=NOISE).curves) == 1
        return
    with pytest.raises(DataError, match=f"on average, and .* m where it is .*{says}"):
        load_laid([lies], pattern, noise=NOISE)


def test_bad_centrelines_are_named(tmp_path, plan):
    pattern, _ = plan
    line = offset(pattern)
    broken = line.copy()
    broken[7, 1] = np.nan
    for source, says in (
        (line[:40], "give the whole laid rod"),
        (1000 * line, "millimetres"),
        (line + [5.0, 0.0, 0.0], "from the pattern on average"),
        (broken, "point 7 is not a number"),
        (np.random.default_rng(0).permutation(line), "not in order along the rod"),
        (np.concatenate([line[100:], line[:100]]), "not in order along the rod"),
    ):
        with pytest.raises(DataError, match=f"centreline 0: .*{says}"):
            load_laid([source], pattern, noise=NOISE)
    with pytest.raises(
        DataError, match=r"load_laid: sources is .* shape \(n, 2\) or \(n, 3\), not"
    ):
        load_laid([line[:, 0]], pattern, noise=NOISE)
    with pytest.raises(DataError, match="does not show its noise"):
        load_laid([line], pattern)
    with pytest.raises(DataError, match=r"sources is .*it must be a list of 1 or more"):
        load_laid([], pattern)
    with pytest.raises(DataError, match="noise is -1"):
        load_laid([line], pattern, noise=-1)
    np.savez(tmp_path / "pixels.npz", paths=line[None])
    (tmp_path / "torn.npz").write_bytes(b"PK\x03\x04torn")
    with pytest.raises(DataError, match=r"pixels\.npz: is a scan without"):
        load_laid([tmp_path / "pixels.npz"], pattern, noise=NOISE)
    with pytest.raises(
        DataError, match=r"is a folder without a deployment \(deployment.npz\); give"
    ):
        load_laid([tmp_path], pattern, noise=NOISE)
    for name in ("torn.npz", "missing.npz", "missing.txt"):
        with pytest.raises(DataError, match=name):
            load_laid([tmp_path / name], pattern, noise=NOISE)


@pytest.mark.parametrize(
    "true, name, value",
    [
        (replace(ROD, natural_curvature=(3.0, 0.0)), "natural_curvature", 3.0),
        (
            replace(ROD, gravito_bending_length=1.12 * ROD.gravito_bending_length),
            "log_L_gb",
            np.log(1.12),
        ),
    ],
)
def test_laid_rods_tell_curvature_and_stiffness_apart(plan, true, name, value):
    pattern, path = plan
    laid = wrod.simulate_deployment(pattern, true, path, 0.8, **QUICK)
    rods = [noisy(laid.released_centerline, seed) for seed in range(3)]
    fit = fit_laid(load_laid(rods, pattern), ROD, path, 0.8, **QUICK)
    assert list(fit.estimates) == [name]
    assert fit.estimates[name].value == pytest.approx(value, rel=0.08)
    assert fit.after < 0.5 * fit.before
    assert fit.after < 1.2 * fit.noise_floor
    assert fit.verdict in ("explained", "partly-explained")


def test_a_rod_as_believed_is_adequate(plan):
    pattern, path = plan
    laid = wrod.simulate_deployment(pattern, ROD, path, 0.8, **QUICK)
    rods = [noisy(laid.released_centerline, seed) for seed in range(3)]
    fit = fit_laid(load_laid(rods, pattern), ROD, path, 0.8, iterations=1, **QUICK)
    assert fit.verdict == "adequate"
    assert fit.rod == ROD and not fit.estimates
    with pytest.raises(DataError, match="iterations"):
        fit_laid(load_laid(rods, pattern), ROD, path, iterations=0)


def test_a_step_that_goes_too_far_is_taken_back(plan, monkeypatch):
    """What lies answers to little more than the cube of the curvature."""
    pattern, path = plan
    measured = load_laid([noisy(offset(pattern), seed) for seed in range(3)], pattern)
    middle = measured.positions.mean(axis=0)

    def predict(_, many):
        beside = [(0.1 * v[0]) ** 3 + 0.005 * v[0] - 1.05 + v[1] for v in many]
        return np.stack([middle + [0.0, 5e-3 * off] for off in beside])

    monkeypatch.setattr("wrod.identification.laid.fit._Laying.predict", predict)
    monkeypatch.setattr("wrod.identification.laid.fit._chosen", lambda *_: [0])
    few = fit_laid(measured, ROD, path, 0.8, iterations=2)
    assert few.after <= few.before and "give more iterations" in few.reason
    many = fit_laid(measured, ROD, path, 0.8, iterations=14)
    assert many.estimates["natural_curvature"].value == pytest.approx(10.0, abs=0.2)
    assert many.reason.endswith(")")


def test_curvature_is_added_where_the_rod_is_held():
    rod = with_parameters(ROD, np.array([2.0, 0.0]), roll=0.7)
    assert rod.curvature_held(0.7) == pytest.approx((2.0, 0.0))


def test_laid_command(plan, tmp_path):
    pattern, path = plan
    np.savetxt(tmp_path / "pattern.csv", pattern.sample(np.linspace(0, pattern.length, 120))[0])
    np.savetxt(tmp_path / "rod.csv", offset(pattern, left=0.002)[:, :2], delimiter=",")
    saved = path.save(tmp_path / "plan")[1]
    args = ["laid", str(tmp_path / "rod.csv"), "--pattern", str(tmp_path / "pattern.csv")]
    args += ["--trajectory", str(saved), "--noise", "0.0002", "--iterations", "0"]
    figures = told(*args, "--json")
    assert np.mean(figures["left_mm"]) == pytest.approx(2.0, abs=0.1)
    refused("no rod given", *args[:-1], "1")
    rod = ("--radius", ROD.radius, "--lgb", ROD.gravito_bending_length, "--length", ROD.length)
    args[1] = str(tmp_path / "none")
    found = refused("none: no such file", *args[:-2], *rod)
    assert found.stderr.count("\n") == 1  # nothing is said of work that is not begun


def test_what_was_fitted_is_said_as_a_quantity():
    lgb = SimpleNamespace(rod=replace(ROD, gravito_bending_length=0.03676), friction=0.4)
    assert _said("log_L_gb", Estimate(0.1374, 6.4e-4, ""), lgb) == (
        "  L_gb: 3.676 cm, +14.73 ± 0.073 % beside the given one"
    )
    assert _said("natural_curvature", Estimate(2.0, 0.1, "1/m"), lgb) == (
        "  natural_curvature: 2 ± 0.1 1/m more than the given rod's to the left"
    )
    assert _said("log_L_gb", Estimate(0.1, 1e5, ""), lgb).endswith("of which the rods tell nothing")


def test_friction_of_the_table_is_found(plan):
    pattern, path = plan
    laid = load_laid([offset(pattern)], pattern, noise=NOISE)
    with pytest.raises(DataError, match="friction is 0, and another is found as so many times"):
        fit_laid(laid, ROD, path, 0.0, fit_friction=True, **QUICK)
    # Straight above the contact, so that the table has something to hold.
    path = wrod.plan(pattern, ROD, "intuitive", remainder=False)
    laid = wrod.simulate_deployment(pattern, ROD, path, 0.3, **QUICK)
    rods = [noisy(laid.released_centerline, seed) for seed in range(3)]
    measured = load_laid(rods, pattern)
    fit = fit_laid(measured, ROD, path, 0.4, fit_friction=True, iterations=3, **QUICK)
    error = fit.estimates["log_friction"].stderr
    assert 0.0 < error < 0.3
    assert abs(np.log(fit.friction / 0.3)) < max(3.0 * error, 0.1)
    assert fit.after < fit.before


def test_table_file(tmp_path):
    table = TableFriction(0.4, 0.1, -0.3)
    assert TableFriction.load(table.save(tmp_path / "table.json")) == table
    assert read_friction(str(tmp_path / "table.json")) == table.interval
    assert table.interval == pytest.approx((0.4 * np.exp(-0.1), 0.4 * np.exp(0.1)))
    for text, says in (
        ("{}", "is not a table"),
        ('{"format": "wrod-table-1", "friction": -1, "log_error": 0.1}', "friction must be"),
        ('{"format": "wrod-table-1", "friction": 0.3}', "lacks the entry 'log_error'"),
        ("[", "must be an object"),
        ("[]", "must be an object"),
    ):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(DataError, match=rf"bad\.json: .*{says}"):
            TableFriction.load(tmp_path / "bad.json")
    with pytest.raises(DataError, match="missing"):
        TableFriction.load(tmp_path / "missing.json")
