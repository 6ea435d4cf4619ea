"""Reef and granny knots of two rods: their shapes, their names, and how they take a pull."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import wrod
from wrod.bench.bend_shapes import BENDS, bend
from wrod.bench.bends import pull_bend
from wrod.knots.pull import HOLD, SETTLE, TwoHands, keep_up
from wrod.knots.topology import recognise_pair
from wrod.knots.trials import STILL
from wrod.knots.workbench import Poses, Workbench
from wrod.solvers.friction import Friction

PAIR = [wrod.rod("green-vps"), wrod.rod("pink-vps-thick")]


@cache
def shape(name: str):
    """Centrelines of the bend, and arc lengths; each is found once."""
    return bend(name, PAIR)


@pytest.mark.parametrize("name", BENDS)
def test_shapes_are_what_they_are_called(name):
    lines, arcs = shape(name)
    assert recognise_pair(*lines).name == name
    for line, arc, rod in zip(lines, arcs, PAIR, strict=True):
        assert line[:, 2].min() == pytest.approx(rod.radius, abs=1e-6)
        assert np.diff(arc) == pytest.approx(2 * rod.radius, rel=0.05)
    gap = np.linalg.norm(lines[0][:, None] - lines[1][None], axis=2).min()
    assert gap > 0.95 * sum(rod.radius for rod in PAIR)


@pytest.mark.parametrize("turn", [-180, -90, 90, 180])
def test_turned_ends_do_not_hide_a_knot_and_show_no_other(turn):
    """A knot that is pulled tight turns the legs on one side about each other."""
    shown = {}
    for name in BENDS:
        one, other = (line[::6].copy() for line in shape(name)[0])
        part = np.clip((-one[:, 0] - 0.08) / 0.1, 0.0, 1.0)
        one = Rotation.from_euler("x", np.radians(turn) * part[:, None]).apply(one)
        shown[name] = recognise_pair(one, other)
    for name, found in shown.items():
        assert found.share_of(name) >= STILL
        for wrong in set(BENDS) - {name}:
            assert found.share_of(wrong) == 0.0


def straight(friction=0.5, strength=np.inf):
    """One straight rod on the table, held near both ends, by the second hand with a strength."""
    rod = wrod.RodMaterial(0.003, 0.03, 0.2)
    arc = np.linspace(0.0, 0.2, 34)
    position = np.column_stack([arc, 0 * arc, 0 * arc + rod.radius])
    table = Workbench(
        [[rod]], [arc], position[None], np.array([[0.0, 1.0, 0.0]]),
        (Friction(friction), Friction(0.3)), step=0.02,
    )  # fmt: skip
    starts = np.array([position[:2].mean(axis=0), position[-2:].mean(axis=0)])
    for hand, edge in enumerate((0, 32)):
        poses = Poses(starts[hand][None], Rotation.identity(1))
        table.held.grasp(0, hand, edge, poses, strength if hand else np.inf)
    return table, starts, rod


def pulled(table, starts, load, way=0.05, give=0.002):
    pair = TwoHands(starts, way * np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 0.01)
    return keep_up(table, pair, load, give)


def test_pull_is_reached_and_kept_up():
    table, starts, rod = straight()
    load = 0.06 * rod.stretching_stiffness
    outcome = pulled(table, starts, load)
    assert outcome.held.all() and outcome.crept[0] < 0.001
    assert outcome.load[0] == pytest.approx(load, rel=0.06)
    ended = table.dynamics.time.numpy()[0]
    assert ended - outcome.tight_at[0] == pytest.approx(SETTLE + HOLD, abs=0.05)
    # The rod is stretched by load / EA between the hands, and was when they first felt it.
    for line in (table.positions()[0][0], outcome.tight[0][0]):
        length = np.linalg.norm(np.diff(line[1:-1], axis=0), axis=1).sum()
        assert length / (0.2 * 31 / 33) - 1.0 == pytest.approx(0.06, rel=0.05)


@pytest.fixture
def soon_over(monkeypatch):
    """Pulls that are kept up for less long."""
    monkeypatch.setattr("wrod.knots.pull.SETTLE", 0.4)
    monkeypatch.setattr("wrod.knots.pull.HOLD", 0.6)


@pytest.mark.usefixtures("soon_over")
def test_pull_that_is_over_stays_over_where_it_is_filmed():
    """Filmed at every tick, hands come to a rest at the tick where the pull ends."""
    ends = []
    for filmed in (False, True):
        table, starts, rod = straight()
        pair = TwoHands(starts, 0.05 * np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 0.01)
        frames: list = []
        load = 0.06 * rod.stretching_stiffness
        outcome = keep_up(table, pair, load, 0.002, frames.append if filmed else None)
        ends.append((table.positions()[0], outcome.load, outcome.crept, outcome.tight_at))
        assert outcome.held.all() and not table.diverged.any()
    assert len(frames) > 25
    for plain, seen in zip(*ends, strict=True):
        assert (plain == seen).all()


def test_way_that_ends_before_the_load_is_reached_does_not_count():
    table, starts, rod = straight()
    outcome = pulled(table, starts, 0.06 * rod.stretching_stiffness, way=0.003)
    assert np.isnan(outcome.tight_at).all() and not outcome.held.any()
    assert 0.0 < outcome.strongest[0] < 0.06 * rod.stretching_stiffness


def test_rod_that_slips_out_of_a_hand_is_not_held():
    rod = straight()[2]
    load = 0.06 * rod.stretching_stiffness
    table, starts, _ = straight(strength=0.9 * load)
    outcome = pulled(table, starts, load)
    assert np.isnan(outcome.tight_at).all() and not outcome.held.any()
    assert table.held.edge[0].tolist() == [0, -1]


@pytest.mark.slow
def test_reef_knot_holds_and_without_friction_it_slips():
    held = pull_bend("reef knot", PAIR, 0.4, 0.5)
    assert held["held"] and held["pulled"] == "reef knot"
    slipped = pull_bend("reef knot", PAIR, 0.1, 0.5)
    assert not slipped["held"] and not slipped["tight"] and slipped["pulled"] == "unknot"


def pulled_scenes(scale):
    """Wavy rods of several stiffnesses, by the scale (scene,) of their L_gb, that are pulled
    straight: the outcome, where they end, and how many rounds that took."""
    rods = [[wrod.RodMaterial(0.003, 0.03 * s, 0.2)] for s in scale]
    arc = np.linspace(0.0, 0.2, 34)
    line = np.column_stack([arc, 0.002 * np.sin(30.0 * arc), 0 * arc + 0.003])
    position = np.tile(line, (len(rods), 1, 1))
    table = Workbench(
        rods, [arc], position, np.array([[0.0, 0.0, 1.0]] * len(rods)),
        (Friction(0.5), Friction(0.3)), step=0.02,
    )  # fmt: skip
    table.dynamics.keeps_recording = False  # rounds are launched, and counted, one by one
    rounds, arrive = [], table.held.arrive
    table.held.arrive = lambda *given: (rounds.append(1), arrive(*given))
    starts = np.array([line[:2].mean(axis=0), line[-2:].mean(axis=0)])
    upright = Rotation.identity(len(rods))
    for scene in range(len(rods)):
        for hand, edge in enumerate((0, 32)):
            places = Poses(np.tile(starts[hand], (len(rods), 1)), upright)
            table.held.grasp(scene, hand, edge, places)
    ways = 0.05 * np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    misses = np.zeros((len(rods), 2, 1, 3))
    outcome = keep_up(table, TwoHands(starts, ways, 0.01, upright, misses), 1.5, 0.002)
    return outcome, table.batch.positions(), len(rounds)


@pytest.mark.usefixtures("soon_over")
def test_scenes_are_pulled_each_at_its_own_pace():
    scale = (1.3, 0.8)
    together, ends, rounds = pulled_scenes(scale)
    assert together.held.all()
    assert np.ptp(together.tight_at) > 0.1
    alone = [pulled_scenes([one]) for one in scale]
    assert rounds == max(count for _, _, count in alone)
    for scene, (outcome, end, _) in enumerate(alone):
        assert (end[0] == ends[scene]).all()
        assert (outcome.tight[0][0] == together.tight[0][scene]).all()
        for name in ("load", "strongest", "crept", "held", "tight_at"):
            assert (getattr(outcome, name)[0] == getattr(together, name)[scene]).all()
