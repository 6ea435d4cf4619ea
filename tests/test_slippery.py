"""The comparison of plans on slippery tables."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import minimize

import wrod
from wrod.bench.held import held
from wrod.bench.slippery_report import means, summary, told
from wrod.commands import main
from wrod.deployment.left_alone import left_alone
from wrod.deployment.result import errors_along
from wrod.errors import RodError
from wrod.solvers.friction import Friction


def test_summary_is_the_mean_over_trials_and_then_over_cells():
    rows = [
        {"rod": "rope", "pattern": name, "friction": 0.3, "engine": "wrod", "method": method}
        | {"error_mean": error, "error_robot": 0.5 * error, "curve": [[0.0, 0.01 * error]] * 3}
        for name, method, error in (
            ("line", "a", 1.0), ("line", "b", 2.0), ("line", "a", 3.0), ("sine", "a", 6.0),
            ("sine", "b", 4.0), ("circle", "a", 5.0), ("circle", "put_down", 6.0),
        )
    ]  # fmt: skip
    table = summary(rows)
    assert [cell["error_mean"] for cell in table] == [
        {"a": 2.0, "b": 2.0}, {"a": 6.0, "b": 4.0}, {"a": 5.0, "put_down": 6.0},
    ]  # fmt: skip
    assert table[0]["error_robot"] == {"a": 1.0, "b": 1.0}
    # Of two trials 2 cm apart, each 1 cm beside their mean, which is itself uncertain.
    assert table[0]["apart"] == {"a": pytest.approx(2.0**0.5)} and not table[1]["apart"]
    bent, others = means(table, lambda rod, pattern: pattern == "circle")
    assert (bent["cells"], bent["error_mean"]) == (1, {"a": 5.0, "put_down": 6.0})
    assert bent["better"] == {"error_mean": {"a": 1}, "error_robot": {"a": 1}}
    assert "better" not in others
    assert (others["cells"], others["error_mean"]) == (2, {"a": 4.0, "b": 3.0})
    lines = told(table, [bent, others])
    assert lines[0] == "rope, line, friction 0.3: a 2.000 (1.000, 1.414), b 2.000 (1.000) cm, wrod"
    assert lines[-4].startswith(
        "cells of these in which rods lie nearer than those put down: a 1 (1)"
    )
    assert lines[-3] == "and where those move by over 0.1 cm once put down: a 1 of 1"
    assert lines[-2].startswith("mean of 2 that bend by up to 0.4 / L_gb, friction 0.3: a 4.000 (2")


@pytest.mark.parametrize(
    "options, says",
    [
        (("--methods", "guess"), "unknown method 'guess'"),
        (("--engines", "wrod,bullet"), "unknown engine 'bullet'"),
        (("--trials", "0"), "--trials"),
        (("--frictions", "slippery"), "--frictions is 'slippery'"),
        (("--disturbed", "wind"), "unknown disturbance 'wind'"),
        (("--disturbed", "yaw", "--undisturbed"), "leave one out"),
        (("--spacing", "1.0", "--names", "line"), "longest that bends"),
    ],
)
def test_bad_options_are_refused(tmp_path, options, says):
    out = tmp_path / "out"
    result = CliRunner().invoke(main, ["bench", "slippery", "--out", str(out), *options])
    assert result.exit_code == 2
    assert says in result.output
    assert not out.exists()


def test_rods_put_down_exactly_are_compared_and_kept(tmp_path):
    arguments = ["bench", "slippery", "--methods", "put_down", "--frictions", "0.6", "--device"]
    arguments += ["cpu", "--spacing", "0.02", "--step", "0.02", "--trials", "1", "--undisturbed"]
    arguments += ["--rods", "green-vps", "--names", "letter-U", "--out"]
    none = CliRunner().invoke(main, [*arguments, str(tmp_path), "--finished"])
    assert none.exit_code == 2 and "none of these is finished" in none.output
    for _ in range(2):  # the second time nothing is simulated
        result = CliRunner().invoke(main, [*arguments, str(tmp_path)])
        assert result.exit_code == 0, result.output
        assert "green-vps, letter-U, friction 0.6: put_down 0.0" in result.output
    assert len((tmp_path / "trials.jsonl").read_text().splitlines()) == 2
    assert (tmp_path / "slippery.png").stat().st_size > 10_000
    more = [*arguments, str(tmp_path), "--frictions", "0.3,0.6", "--finished"]
    told = CliRunner().invoke(main, more)
    assert told.exit_code == 0 and "friction 0.6: put_down 0.0" in told.output, told.output
    assert "friction 0.3" not in told.output


def test_what_is_put_down_goes_with_the_robot_and_is_the_rod_of_the_trial():
    from wrod.bench.put_down import put_down
    from wrod.deployment.setup import Disturbance
    from wrod.solvers.friction import Friction

    arc = wrod.Pattern.from_points(
        [(0.05 * np.sin(a), 0.05 * (1.0 - np.cos(a))) for a in np.linspace(0.0, np.pi, 60)]
    )
    aside = Disturbance(offset=(0.002, -0.001), yaw=0.03)
    hows = [Disturbance(), aside, Disturbance(natural_curvature=20.0), Disturbance(lgb_error=0.2)]
    courses = [(arc, wrod.rod("green-vps"), Friction(0.4), how) for how in hows]
    still, moved, bent, stiff = (
        place for _, place, *_ in put_down(courses, node_count=17, step=0.02)
    )
    start = arc.sample(0.0)[0][0]
    assert np.abs(aside.displaced(still, start) - moved)[:, :2].max() < 1e-6
    # One that is bent at rest as it is put down hardly springs, a stiffer one springs further.
    off = [
        np.linalg.norm((x - arc.sample(s)[0])[:, :2], axis=1).mean()
        for x in (still, bent, stiff)
        for s in [np.linspace(0.0, arc.length, 17)]
    ]
    assert off[1] < 0.3 * off[0] and off[2] > 1.1 * off[0]


@pytest.mark.parametrize("kinds", [None, "placement", "jitter,lgb_error"])
def test_where_the_robot_stands_bounds_what_a_plan_can_do(tmp_path, kinds):
    from wrod.deployment.setup import Disturbance

    arguments = ["bench", "slippery", "--methods", "misplaced", "--frictions", "0.6", "--device"]
    arguments += ["cpu", "--rods", "green-vps", "--names", "line", "--trials", "1", "--json"]
    arguments += ["--out", str(tmp_path)]
    result = CliRunner().invoke(main, arguments + (["--disturbed", kinds] if kinds else []))
    assert result.exit_code == 0, result.output
    (cell,) = json.loads(result.output)["cells"]
    # A line turned by a small angle about its first point, which is shifted.
    s = np.linspace(0.0, wrod.pattern("line").length, 50)
    how = Disturbance.random(9_000)
    along, aside = how.offset if kinds in (None, "placement") else (0.0, 0.0)
    yaw = how.yaw if kinds is None else 0.0
    expected = np.hypot(along - 0.5 * s * yaw**2, aside + s * yaw).mean()
    assert cell["error_mean"]["misplaced"] == pytest.approx(100.0 * expected, rel=1e-3, abs=1e-9)
    assert cell["error_robot"]["misplaced"] < 1e-6


@pytest.mark.parametrize(
    "height, friction, edges, apart",
    [(0.2, 0.6, 4, 1e-3), (0.5, 0.4, 4, 1e-3), (0.2, 0.6, 6, 0.02)],
)
def test_the_nearest_curve_that_friction_holds_is_found_by_what_holds_it(
    height, friction, edges, apart
):
    """Friction on every node instead of angles and tensions: a curve follows from its beginning,
    and its bounds are no longer the curve's. On the same mesh, and on another."""
    rod = wrod.rod("green-vps")
    lgb = rod.gravito_bending_length
    stiff = rod.bending_stiffness / (rod.weight * lgb**3)
    x = np.linspace(0.0, 4.0, 300)
    pattern = wrod.Pattern.from_points(lgb * np.column_stack([x, height * np.sin(1.5 * x)]))
    n = int(np.ceil(edges * pattern.length / lgb))
    s = np.linspace(0.0, pattern.length / lgb, n + 1)
    h, lengths = s[1], np.r_[0.5, np.ones(n - 1)] * s[1]
    at = np.linspace(0.0, s[-1], 50)
    edge = np.minimum((at / h).astype(int), n - 1)
    part, target = (at / h - edge)[:, None], pattern.sample(lgb * at)[0][:, :2] / lgb

    def laid(many):
        """(m, n + 1, 2) curves under friction (n, 2), a first angle and place, in (m, 2 n + 3)."""
        force = -np.cumsum(many[:, : 2 * n].reshape(-1, n, 2) * lengths[:, None], axis=1)
        angle, moment, place = many[:, -3], np.zeros(len(many)), np.zeros((n + 1, 2, len(many)))
        place[0] = many[:, -2:].T
        for k, (x, y) in enumerate(force.transpose(1, 2, 0)):
            along = np.cos(angle, out=place[k + 1, 0]), np.sin(angle, out=place[k + 1, 1])
            moment -= h * (along[0] * y - along[1] * x)
            angle = angle + h / stiff * moment
        place[1:] *= h
        return np.cumsum(place, axis=0).transpose(2, 0, 1)

    def far(many):
        place = laid(many)
        off = place[:, edge] * (1.0 - part) + place[:, edge + 1] * part - target
        return np.sqrt((off**2).sum(axis=-1) + 1e-6).mean(axis=-1)

    def slope(one):
        by = 1e-6 * np.eye(len(one))
        up, down = np.split(far(np.vstack([one + by, one - by])), 2)
        return (up - down) / 2e-6

    def room(one, bound):
        return 1.0 - (one[: 2 * n].reshape(n, 2) ** 2).sum(axis=1) / bound**2

    def room_slope(one, bound):
        rates = np.zeros((n, len(one)))
        for k in range(n):
            rates[k, 2 * k : 2 * k + 2] = -2.0 * one[2 * k : 2 * k + 2] / bound**2
        return rates

    # What holds the pattern itself, without tension.
    way = pattern.sample(0.5 * lgb * (s[1:] + s[:-1]))[1]
    angle = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
    shear = -stiff * np.diff(np.r_[0.0, np.diff(angle), angle[-1] - angle[-2]]) / h**2
    force = shear[:, None] * np.column_stack([-np.sin(angle), np.cos(angle)])
    holds = -np.diff(force, axis=0, prepend=0.0) / lengths[:, None]
    one, bound = np.r_[holds.ravel(), angle[0], 0.0, 0.0], np.linalg.norm(holds, axis=1).max()
    while bound > friction:
        bound = max(friction, 0.7 * bound)
        found = minimize(
            lambda v: far(v[None])[0], one, jac=slope, method="SLSQP",
            constraints={"type": "ineq", "fun": room, "jac": room_slope, "args": (bound,)},
            options={"ftol": 1e-7, "maxiter": 1000},
        )  # fmt: skip
        assert found.success
        one = found.x
    place = lgb * laid(one[None])[0]
    other = errors_along(pattern, lgb * s, np.column_stack([place, np.zeros(n + 1)]))[1].mean()
    mine = errors_along(pattern, *held(pattern, rod, friction))[1].mean()
    assert mine == pytest.approx(other, rel=apart)


def arc(angle, name="arc"):
    """Of a circle of radius 85 mm."""
    turns = np.linspace(0.0, angle, 90)
    points = 0.085 * np.column_stack([np.sin(turns), 1.0 - np.cos(turns)])
    return wrod.Pattern.from_points(points, name=name)


def test_little_friction_is_come_to_or_refused(monkeypatch):
    """The way down ends where a curve asks for all that it is given, and where there is no way,
    after one search for the next curve, of which ten are made."""
    pattern, rod = wrod.pattern("letter-C"), wrod.rod("rope")
    s, place = held(pattern, rod, 0.1)
    assert errors_along(pattern, s, place)[1].mean() < 0.01
    monkeypatch.setattr("wrod.bench.held._TIMES", 1)
    with pytest.raises(RodError, match="near half that friction 0"):
        held(arc(2.0, "half"), rod, 0.002)


def test_a_beginning_is_held_by_what_lies_before_it():
    """Friction over a length s from the free end bears a moment of mu w s^2 / 2 at most."""
    pattern, rod, friction = arc(4.0), wrod.rod("green-vps"), 0.2
    s, place = held(pattern, rod, friction)
    edges = np.diff(place[:, :2], axis=0)
    curvature = np.abs(np.diff(np.unwrap(np.arctan2(edges[:, 1], edges[:, 0])))) / np.diff(s)[1:]
    most = 0.5 * friction * rod.weight * s[1:-1] ** 2 / rod.bending_stiffness
    asked = np.abs(pattern.sample(s[1:-1])[2])
    early = most < 0.5 * asked
    assert early.sum() > 3 and np.all(curvature <= most * (1.0 + 1e-9))
    assert curvature[early] == pytest.approx(most[early], rel=0.05)


def test_what_friction_holds_stays_on_the_table():
    """Put down in the simulator, which shares nothing with the statics, and held at its end: by a
    little more friction it stays, by half of that it springs off."""
    pattern, rod, friction = wrod.pattern("letter-U"), wrod.rod("green-vps"), 0.4
    s, place = held(pattern, rod, friction)
    place[:, 2] = rod.radius
    across = np.cross([0.0, 0.0, 1.0], place[1] - place[0])
    tables = [Friction(part * friction) for part in (1.1, 0.5)]
    nodes, places, sides = (np.stack([one, one]) for one in (s, place, across))
    batch, dynamics = left_alone([rod, rod], nodes, places, sides, tables)
    batch.set_free(np.arange(batch.dof_count) < 4 * (len(s) - 2))
    assert not dynamics.advance(2.0, 0.01).diverged.any()
    moved = np.linalg.norm((batch.positions() - place)[..., :2], axis=2).max(axis=1)
    assert moved[0] < 1e-4 and moved[1] > 1e-3


def test_much_friction_holds_the_pattern():
    pattern = wrod.pattern("letter-A")
    s, place = held(pattern, wrod.rod("green-vps"), 3.0)
    assert errors_along(pattern, s, place)[1].mean() < 3e-5
