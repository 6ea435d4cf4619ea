"""Hands that pick rods up and put them down, plans of knots, and the table of successes."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import wrod
from wrod.bench.applications_report import markdown, table
from wrod.errors import DataError, PatternError
from wrod.knots.fingers import GRIP_FORCE, PAD_FRICTION, holding_force
from wrod.knots.laying import _over, _refined
from wrod.knots.moves import hand_path
from wrod.knots.plan import KnotPlan, Move
from wrod.knots.topology import diagram, recognise_knot
from wrod.knots.trials import Handling, TyingResult
from wrod.knots.tying import tie
from wrod.knots.tying_run import TyingRun
from wrod.knots.workbench import Poses, Workbench
from wrod.solvers.friction import Friction

KNOTS = Path(wrod.__file__).parents[1] / "scenes" / "knots"
ROD = wrod.RodMaterial(0.003, 0.03, 0.15)
ARC = np.linspace(0.0, 0.15, 26)


def bench(*lines):
    """Straight rods on the table, from a point along a direction."""
    position = np.concatenate(
        [
            np.array([x, y, ROD.radius]) + ARC[:, None] * np.array([np.cos(a), np.sin(a), 0.0])
            for x, y, a in lines
        ]
    )
    edges = np.diff(position, axis=0)
    director = np.cross(edges, [0.1, 0.2, 1.0])
    return Workbench(
        [[ROD] * len(lines)],
        [ARC] * len(lines),
        position[None],
        director[None],
        (Friction(0.5), Friction(0.3)),
    )


def pose(point, turn=0.0):
    return Poses(np.array([point], dtype=float), Rotation.from_euler("z", [[turn]]))


@pytest.fixture(scope="module")
def carried():
    """The end of one rod is carried over another and let go; turned a little on its way."""
    table = bench((0.0, 0.0, 0.0), (0.02, 0.05, 0.0))
    first, far = np.array([0.147, 0.0, ROD.radius]), np.array([0.10, 0.10, ROD.radius])
    path = hand_path(first, far, 0.04)
    away = pose([0.0, 0.0, 0.2])

    def poses(t):
        x = min(t / 1.5, 1.0)
        return [pose(path(x), 0.5 * x), away]

    before = table.positions()
    table.held.grasp(0, 0, 24, poses(0.0)[0])
    table.run(0.75, poses)
    middle, load = table.positions(), table.load()
    table.run(1.5, poses)
    held = table.positions()
    table.held.open(0, 0)
    table.run(2.3, poses)
    return table, before, middle, held, load


def test_hand_carries_the_edge_that_it_holds(carried):
    table, before, middle, held, load = carried
    assert not table.diverged.any()
    grasped = before[0][0, 24:].mean(axis=0)
    moved = held[0][0, 24:].mean(axis=0)
    offset = Rotation.from_euler("z", 0.5).apply(grasped - [0.147, 0.0, ROD.radius])
    assert moved == pytest.approx(np.array([0.10, 0.10, ROD.radius]) + offset, abs=1e-6)
    along = held[0][0, 25] - held[0][0, 24]
    assert np.arctan2(along[1], along[0]) == pytest.approx(0.5, abs=1e-6)
    assert middle[0][0, 24:, 2].min() > 0.03
    # It bears a part of the rod's weight, and the bending.
    assert 0.02 * ROD.weight * ROD.length < load[0, 0] < 10 * ROD.weight * ROD.length
    assert load[0, 1] == 0.0


def test_put_down_it_lies_over_the_other_rod(carried):
    table, *_ = carried
    one, other = (rod[0] for rod in table.positions())
    gap = np.linalg.norm(one[:, None, :2] - other[None, :, :2], axis=2)
    i, j = np.unravel_index(gap.argmin(), gap.shape)
    assert gap[i, j] < 0.006
    assert one[i, 2] - other[j, 2] > 1.5 * ROD.radius
    assert one[-1, 2] < 2.0 * ROD.radius  # its end is down again
    # Closed far below the table: two crossings less none, over first.
    found = diagram([np.vstack([rod, rod.mean(0) - [0, 0, 5.0]]) for rod in (one, other)])
    assert found.linking_number() == 0
    assert recognise_knot(one).name == "unknot"


def test_rods_of_two_thicknesses_lie_at_rest_each_on_its_own_radius():
    thick = wrod.RodMaterial(0.004, 0.03, 0.15)
    thin = wrod.RodMaterial(0.001, 0.03, 0.15)
    lines = [
        np.column_stack([ARC, 0 * ARC + 0.05 * k, 0 * ARC + rod.radius])
        for k, rod in enumerate((thin, thick))
    ]
    start = np.concatenate(lines)[None]
    table = Workbench(
        [[thin, thick]], [ARC, ARC], start, np.array([[0.0, 1.0, 0.3]]),
        (Friction(0.5), Friction(0.3)),
    )  # fmt: skip
    away = pose([0.0, 0.0, 0.2])
    table.run(0.4, lambda t: [away, away])
    for rod, before, after in zip((thin, thick), lines, table.positions(), strict=True):
        assert np.abs(after[0] - before).max() < 0.01 * rod.radius


def test_way_of_a_hand_passes_over():
    first, last = np.array([0.0, 0.0, 0.003]), np.array([0.1, 0.05, 0.003])
    path = hand_path(first, last, 0.05)
    points = np.array([path(u) for u in np.linspace(0, 1, 200)])
    assert points[0] == pytest.approx(first)
    assert points[-1] == pytest.approx(last)
    across = np.linalg.norm(points[:, :2] - first[:2], axis=1) / np.linalg.norm((last - first)[:2])
    assert points[(across > 0.1) & (across < 0.9), 2].min() > 0.035
    assert np.abs(np.diff(points, n=2, axis=0)).max() < 2e-4


def test_handling_is_random_and_repeatable():
    assert Handling.random(3) == Handling.random(3)
    assert Handling.random(3) != Handling.random(4)
    trials = [Handling.random(k) for k in range(60)]
    assert np.std([trial.offset for trial in trials]) == pytest.approx(1e-3, rel=0.15)
    friction = np.log([trial.pad_friction for trial in trials])
    assert np.exp(friction.mean()) == pytest.approx(PAD_FRICTION, rel=0.1)
    assert friction.std() == pytest.approx(0.3, rel=0.1)


def test_fingers_hold_by_friction_until_they_end_over_the_rod():
    radius, friction = 0.0016, 0.5
    firm = 2.0 * GRIP_FORCE * friction
    tips = np.array([0.0, radius, 1.3 * radius, 1.6 * radius, 2.5 * radius])
    held = holding_force(radius, radius, tips, friction)
    assert held[:2] == pytest.approx([firm, firm])
    assert 0.0 < held[2] < 0.5 * firm
    assert (held[3:] == 0.0).all()  # beyond sin(atan(0.5)) = 0.45 radii over the axis
    # The limit is where the lean is the angle of friction.
    edge = radius * (1.0 + np.sin(np.arctan(friction)))
    assert holding_force(radius, radius, edge - 1e-7, friction) > 0.0
    assert holding_force(radius, radius, edge + 1e-7, friction) == 0.0
    # A rod that lies on another is deeper between the same fingers.
    assert holding_force(radius, 3.0 * radius, tips[3], friction) == pytest.approx(firm)


@pytest.mark.parametrize(
    ("over", "ends"),
    [(-0.5, "held"), (0.3, "held"), (0.6, "slipped"), (1.1, "missed")],
)
def test_rod_slips_out_of_fingers_that_end_too_high(over, ends):
    """`over`: height of the fingertips over the rod's axis, in radii."""
    run = SimpleNamespace(
        bench=bench((0.0, 0.0, 0.0)),
        knot=SimpleNamespace(rods=((None, ROD),)),
        trials=[Handling(pad_friction=(0.5,))],
        true_rods=[[ROD]],
        results=[TyingResult()],
        grasps=0,
    )
    table, height = run.bench, (2.0 + over) * ROD.radius
    away = pose([0.0, 0.0, 0.2])

    def poses(t):
        return [pose([0.147, 0.0, height + 0.02 * t]), away]

    TyingRun.grasp(run, 0, 0, "move 1", poses(0.0)[0])
    held = table.held.edge
    table.run(0.2, poses)
    TyingRun.note_slips(run, "move 1", held)
    result = run.results[0]
    assert result.missed == (["move 1"] if ends == "missed" else [])
    assert result.slipped == (["move 1"] if ends == "slipped" else [])
    assert (table.held.edge[0, 0] >= 0) == (ends == "held")


def test_rod_that_begins_where_another_lies_begins_over_it():
    radius = ROD.radius
    lying = bench((0.05, -0.07, np.pi / 2))
    run = SimpleNamespace(bench=lying, plans=[(None, ROD, None)])
    start = np.column_stack([ARC, 0 * ARC, 0 * ARC + radius])
    below = lying.batch.positions()[0]
    raised = _over(run, below, start, ARC, radius)
    fine, other = _refined(raised), _refined(below)
    gap = np.linalg.norm(fine[:, None] - other[None], axis=2).min()
    assert gap > 0.95 * 2 * radius
    assert raised[:, 2].max() == pytest.approx(radius + 1.12 * 2 * radius, rel=0.02)
    # Its edges keep their lengths, but for the corners, and its hanging end its place.
    assert np.linalg.norm(np.diff(raised, axis=0), axis=1) == pytest.approx(np.diff(ARC), rel=0.03)
    assert raised[-1] == pytest.approx(start[-1])
    beside = start + [0.0, 0.2, 0.0]
    assert _over(run, below, beside, ARC, radius) is beside


@pytest.mark.parametrize("name", ["trefoil", "reef"])
def test_shipped_plans(name):
    plan = KnotPlan.load_plan(KNOTS / f"{name}.json")
    assert 1 <= len(plan.steps) <= 3
    assert sum(len(step) for step in plan.steps) <= 6  # a few: two hands at once
    assert len(plan.pull) == 2
    for pattern, rod in plan.rods:
        assert pattern.length < rod.length
        curvature = pattern.sample(np.linspace(0.0, pattern.length, 300))[2]
        assert np.abs(curvature).max() * rod.gravito_bending_length < 1.6


@pytest.mark.slow
def test_reef_knot_is_laid_flat_and_holds():
    """A loop that is folded over itself lies with both its ears beyond its middle, and has to turn
    over before it is a reef knot: the pull may draw the other rod out of it first."""
    plan = KnotPlan.load_plan(KNOTS / "reef.json")
    (result,) = tie(plan, [Handling()])
    assert result.success and result.tied.share >= 0.9
    green, pink = result.stages["tied"]
    loop = np.argmax(pink[:, 0])
    assert loop / len(pink) == pytest.approx(0.40 / plan.rods[1][1].length, abs=0.04)
    ends = green[[0, -1], 0]
    assert (ends > pink[loop, 0] + 0.02).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(format="x"), "format"),
        (lambda d: d.pop("rods"), "lacks the entry 'rods'"),
        (lambda d: d["steps"][0][0].update(at="0.1"), "must be a number"),
        (lambda d: d["steps"][0][0].update(at=9.0), "beyond"),
        (lambda d: d["steps"][0][0].update(rod=4), "must be a whole number <= 1"),
        (lambda d: d["steps"][0][0].update(hand=2), "must be a whole number <= 1"),
        (lambda d: d["steps"][0].append(d["steps"][0][0]), "list of length <= 2"),
        (lambda d: d.update(pull=d["pull"][:1]), "give two"),
        (lambda d: d["pull"][0].update(where=[1]), "list of length 2"),
    ],
)
def test_bad_plans_are_refused(tmp_path, change, message):
    data = json.loads((KNOTS / "trefoil.json").read_text())
    for entry in data["rods"]:
        entry["pattern"] = str(KNOTS / entry["pattern"])
    change(data)
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(data))
    with pytest.raises(DataError, match=message):
        KnotPlan.load_plan(path)


def test_missing_pattern_is_named(tmp_path):
    data = json.loads((KNOTS / "trefoil.json").read_text())
    (tmp_path / "plan.json").write_text(json.dumps(data))
    with pytest.raises(PatternError, match="no such file"):
        KnotPlan.load_plan(tmp_path / "plan.json")


def test_moves_have_defaults():
    move = Move(rod=0, at=0.1, to=(0.0, 0.1), hand=0)
    assert (move.turn, move.where) == (0.0, None)
    assert TyingResult(wanted="right trefoil").success is False
    assert TyingResult(diverged=True).why == "diverged"


def test_table_of_successes():
    rows = [
        dict(case="trefoil", method="neural", trial=k, success=k > 0, why="tied", cpu_seconds=2.0)
        for k in range(3)
    ]
    rows[0]["why"] = "slipped out of the grip: pull"
    cells = table(rows)
    assert cells["trefoil", "neural"]["success"] == 2
    assert cells["trefoil", "neural"]["paper"] == 9
    text = markdown(cells)
    assert (
        "| trefoil | OPT | 9/10 | 2/3 | 21 to 94 % | 2 | 1 x slipped out of the grip: pull |"
        in text
    )


def test_why_a_trial_failed():
    from wrod.knots.topology import Recognition

    def result(tied, pulled, tight="right trefoil", share=1.0, **more):
        found = {
            name: Recognition(what, share, {what: 15})
            for name, what in (("tied", tied), ("tight", tight), ("pulled", pulled))
            if what
        }
        return TyingResult(wanted="right trefoil", **{"held": True, **found, **more})

    assert result("right trefoil", "right trefoil").success
    inside = result("right trefoil", "right trefoil", share=0.6, missed=["move 2"])
    assert inside.why == "tied nothing clear, grasped nothing: move 2"
    gave = result("right trefoil", "right trefoil", held=False, crept=0.02)
    assert gave.why == "gave too far under the pull"
    loose = result("right trefoil", "right trefoil", tight=None, held=False, strongest=0.31)
    assert loose.why == "gave way before the full pull"
    assert result("right trefoil", "unknot").why == "came loose: unknot"
    assert result("unknot", "unknot", missed=["move 2"]).why == (
        "tied unknot, grasped nothing: move 2"
    )
    assert result("left trefoil", "left trefoil").why == "tied left trefoil"
    assert "slipped" in result("right trefoil", "unknot", slipped=["pull"]).why
    assert not result("right trefoil", "right trefoil", missed=["pull"]).success
    assert result("right trefoil", None).why == "not pulled"
