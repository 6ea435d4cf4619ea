"""Gates that fit a plan, what cables are disturbed by, and who is judged to lie between posts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import wrod
from wrod.bench import applications_trials as cables
from wrod.bench.applications_report import success_interval
from wrod.bench.applications_trials import CABLE_FRICTION, cable_scene
from wrod.deployment.assembly import _batch
from wrod.deployment.fixtures import Fixture, Fixtures
from wrod.deployment.gates import approach, design_gates, sideways_deviation
from wrod.deployment.grip_path import KEY_INTERVAL, GripSchedule
from wrod.deployment.setup import DEVIATIONS, Disturbance, Setup, disturb
from wrod.deployment.trial import Trial
from wrod.errors import PatternError
from wrod.patterns.shapes import straight, strokes, turn
from wrod.rods.batch import RodBatch
from wrod.solvers.contact import Contact
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.friction import Friction
from wrod.solvers.solids import Cylinder

CABLE = wrod.rod("cable")


@pytest.mark.parametrize("case", ["S cable", "U cable"])
def test_shipped_scenes_are_the_designed_ones(case):
    pattern, shipped = cable_scene(case)
    designed = cables.gates(pattern)
    assert designed.gates == shipped.gates
    assert designed.note == shipped.note
    for one, other in zip(designed.items, shipped.items, strict=True):
        assert one.name == other.name
        assert np.allclose(one.shape.center, other.shape.center, atol=2e-5)
        assert (one.shape.radius, one.top) == pytest.approx((other.shape.radius, other.top))


def bend(left: bool):
    angle = 60.0 if left else -60.0
    parts = straight(0.15), turn(angle, 0.08, 0.05), straight(0.15)
    return wrod.Pattern(*strokes(0.0, *parts))


def test_a_rod_comes_down_from_the_outside_of_a_bend():
    """Left bends from the right and mirrored; straight pieces, far from a bend, from above."""
    place, left = approach(bend(True), CABLE, 0.004)
    other, right = approach(bend(False), CABLE, 0.004)
    assert np.array_equal(place, other)
    assert left == pytest.approx(-right, abs=1e-5)
    assert left[(place > 0.18) & (place < 0.22)].max() < -1e-3
    assert np.abs(left[place < 0.09]).max() < 1e-4
    # Lower posts are in its way for a shorter time.
    low = approach(bend(True), CABLE, 0.002)[1]
    assert np.abs(low).sum() < np.abs(left).sum()


def test_posts_stand_three_deviations_clear():
    pattern, scene = cable_scene("S cable")
    line = pattern.sample(np.linspace(0.0, pattern.length, 4000))[0]
    s = np.linspace(0.0, pattern.length, 4000)
    place, side = approach(pattern, cables.believed(CABLE), 0.004)
    by_name = {item.name: item.shape for item in scene.items}
    for left, right in scene.gates:
        for name, sign in ((left, 1.0), (right, -1.0)):
            shape = by_name[name]
            away = np.linalg.norm(line[:, :2] - shape.center[:2], axis=1)
            at = s[away.argmin()]
            off = float(np.interp(at, place, side))
            sigma = sideways_deviation(pattern, CABLE, np.array([at]), np.array([off]))[0]
            clear = away.min() - shape.radius
            # The rod's middle has 3 sigma, and the way that it comes sideways, if from this side.
            assert clear > 2.9 * sigma
            assert clear > 2.7 * sigma + max(sign * off, 0.0)
            assert clear < 3.4 * sigma + max(sign * off, 0.0) + 1e-3


def test_posts_in_the_way_are_refused():
    pattern, _ = cable_scene("S cable")
    with pytest.raises(PatternError, match="stand in the way"):
        design_gates(pattern, CABLE, pitch=0.045, radius=0.04)
    with pytest.raises(PatternError, match="too short"):
        design_gates(pattern, CABLE, pitch=0.9)
    with pytest.raises(PatternError, match="pitch"):
        design_gates(pattern, CABLE, pitch=0.0)


def setup(seconds=4.0):
    """A grip that moves along x at 2 cm/s, its fingers turned to the side and down."""
    t = np.arange(0.0, seconds, KEY_INTERVAL)
    turned = Rotation.from_euler("zy", [30.0, 40.0], degrees=True)
    position = np.column_stack([0.02 * t, 0 * t, 0.1 + 0 * t])
    schedule = GripSchedule(position, np.tile(turned.as_quat(), (len(t), 1)), 5, 2.0, seconds)
    nodes = np.column_stack([np.linspace(0, 0.5, 11), np.zeros(11), np.zeros(11)])
    return Setup(
        np.linspace(0, 0.5, 11), nodes, np.array([0.0, 1, 0]), np.zeros(3), schedule, 0.5, 3.5, 4.0
    ), turned


def test_grip_slips_along_the_rod():
    still, turned = setup()
    slipped = disturb(still, Disturbance(slip=0.002, seed=3))
    moved = slipped.schedule.position - still.schedule.position
    along = turned.apply([1.0, 0.0, 0.0])
    way = moved @ along
    assert moved == pytest.approx(way[:, None] * along, abs=1e-12)
    begun = int(still.approach / KEY_INTERVAL)
    assert np.abs(way[:begun]).max() == 0.0
    assert way[-1] == pytest.approx(0.002, abs=1e-12)
    assert (np.diff(way) >= -1e-15).all()


def test_every_disturbance_reaches_a_cable_trial():
    """Jitter, place, yaw, slip move the grip but no fixture; L_gb and curvature change the rod."""
    case = "S cable"
    pattern, scene = cable_scene(case)
    drawn = cables.disturbance(case, 0)
    others = [cables.disturbance(case, k) for k in range(1, 400)]
    for name, size in (
        ("lgb_error", DEVIATIONS["lgb_error"]),
        ("yaw", DEVIATIONS["yaw"]),
        ("natural_curvature", DEVIATIONS["natural_curvature"]),
        ("slip", cables.SLIP),
    ):
        values = [getattr(d, name) for d in others]
        assert getattr(drawn, name) != 0.0
        assert np.std(values) == pytest.approx(size, rel=0.12)
    assert np.std([d.offset for d in others]) == pytest.approx(DEVIATIONS["placement"], rel=0.12)
    assert drawn.jitter == DEVIATIONS["jitter"]
    still, _ = setup()
    for name in ("jitter", "offset", "yaw", "slip"):
        one = replace(Disturbance(seed=drawn.seed), **{name: getattr(drawn, name)})
        moved = disturb(still, one).schedule.position - still.schedule.position
        assert np.abs(moved).max() > 1e-5, name
    trajectory = wrod.Trajectory(
        np.array([0.0, 0.1]),
        np.zeros((2, 3)),
        np.zeros((2, 3)),
        np.tile(np.eye(3), (2, 1, 1)),
        np.zeros((2, 3)),
    )
    jobs = [
        Trial(pattern, CABLE, trajectory, Friction(CABLE_FRICTION), d, fixtures=scene)
        for d in (Disturbance(), drawn)
    ]
    batch, rods = _batch(
        jobs, {id(CABLE): wrod.RodModel.of(CABLE)}, [still, disturb(still, drawn)], "cpu"
    )
    ratio = rods[1].gravito_bending_length / rods[0].gravito_bending_length
    assert ratio == pytest.approx(1.0 + drawn.lgb_error)
    stiffness = batch.bending_stiffness.numpy()[:, 2, 0]
    assert stiffness[1] / stiffness[0] == pytest.approx(ratio**3)
    bent = batch.natural_curvature.numpy()[:, 2, 0]
    assert bent[0] == 0.0
    assert bent[1] != 0.0


def test_disturbances_are_printed():
    from dataclasses import asdict

    rows = [{"disturbance": asdict(cables.disturbance("U cable", k))} for k in range(200)]
    text = cables.disturbances_text([*rows, {"case": "reef"}])
    for what in ("L_gb", "place", "yaw", "jitter", "curvature", "slip in the grip", "fingertips"):
        assert what in text
    stated, drawn = ([float(line.split("|")[k]) for line in text.splitlines()[2:8]] for k in (2, 3))
    assert drawn == pytest.approx(stated, rel=0.2)


def test_interval_is_wilsons():
    """Brown, Cai, DasGupta 2001: 10 of 10 leaves rates down to 72 %."""
    assert success_interval(10, 10) == pytest.approx((0.7225, 1.0), abs=1e-4)
    assert success_interval(9, 10) == pytest.approx((0.5958, 0.9821), abs=1e-4)


def test_a_cable_on_top_of_a_post_or_outside_is_not_placed():
    """Dropped between two posts, across one of them, and beside them; and while it still moves."""
    posts = [
        Fixture(name, Cylinder((0.15, y, 0.002), 0.004, 0.002))
        for name, y in (("left", 0.0075), ("right", -0.0075))
    ]
    scene = Fixtures(tuple(posts), (("left", "right"),))
    nodes = np.zeros((3, 61, 3))
    nodes[:, :, 0] = np.linspace(0.0, 0.3, 61)
    nodes[:, :, 1] = np.array([0.0, 0.0065, 0.02])[:, None]
    nodes[:, :, 2] = 0.006 + CABLE.radius
    batch = RodBatch(
        nodes,
        stretching_stiffness=CABLE.stretching_stiffness,
        bending_stiffness=CABLE.bending_stiffness,
        twisting_stiffness=CABLE.twisting_stiffness,
        node_mass=CABLE.weight / CABLE.gravity * 0.005,
        gravity=(0.0, 0.0, -CABLE.gravity),
    )
    stiffness = 6000 * CABLE.weight / CABLE.radius
    contact = Contact(batch, CABLE.radius, stiffness, Friction(0.3), shapes=scene.shapes)
    dynamics = Dynamics(
        batch,
        scheme="euler",
        radius=CABLE.radius,
        contact=contact,
        air_damping=5.0,
        keeps_recording=True,
    )

    def judged():
        lines = batch.positions() - [0.0, 0.0, CABLE.radius]
        speeds = np.linalg.norm(dynamics.velocities(), axis=2).max(axis=1)
        return [scene.judge(q, CABLE.radius, v) for q, v in zip(lines, speeds, strict=True)], speeds

    dynamics.advance(0.035, 5e-3)
    found, speeds = judged()
    assert speeds.min() > 0.1
    assert not any(f.placed for f in found)
    dynamics.advance(2.5, 1e-2)
    found, speeds = judged()
    assert speeds.max() < 1e-3
    assert [f.placed for f in found] == [True, False, False]
    middle = batch.positions()[:, 30]
    assert middle[1, 2] > 0.004 + 0.9 * CABLE.radius  # on the post
    assert middle[2, 2] < 1.01 * CABLE.radius  # on the table, outside


def test_shipped_scenes_say_where_they_come_from():
    folder = Path(wrod.__file__).parents[1] / "scenes" / "cable"
    for name in ("S", "U"):
        assert "design_gates" in Fixtures.load(folder / f"{name}.json").note
