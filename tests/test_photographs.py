"""Photographs of laid rods: read, placed in the picture, and laid in scenarios."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial import cKDTree

import wrod
from wrod.bench.photographs_deployments import believed_scenario, scenarios_of
from wrod.bench.photographs_judge import WAYS
from wrod.deployment.assembly import INTERNAL_DAMPING
from wrod.deployment.discretisation import Discretisation
from wrod.errors import DataError, RodError
from wrod.identification.laid.camera import OverheadCamera, find_camera
from wrod.identification.laid.choice import average, simplest, spread, weigh
from wrod.identification.laid.photographs import load_photograph, load_photographs
from wrod.identification.laid.placement import moved, raw, rigid, seen_from
from wrod.identification.laid.scenario import (
    LaidRod,
    Scenario,
    lay,
    plan_without_lead_in,
)
from wrod.planning.tail import Tail

MEASURED = Path(__file__).parents[2] / "shared" / "measured" / "laid"
PX_PER_M = 700.0


def write(path, turn=0.0, shift=(0.0, 0.0), size=1.05, **changes):
    """A photograph's file of a rod along a sine, turned and shifted; file metres."""
    s = np.linspace(0.0, 0.4, 300)
    line = np.column_stack([s, 0.05 * np.sin(12.0 * s)])
    c, t = np.cos(turn), np.sin(turn)
    rod = line @ np.array([[c, t], [-t, c]]) + shift
    hidden = np.zeros(300)
    hidden[50:60] = 1
    data = dict(
        centerline=np.where(hidden[:, None] == 0, rod, np.nan),
        centerline_filled=rod,
        hidden=hidden,
        sigma=np.full(300, 5e-4),
        pattern=line,
        size_factor=size,
        px_from_pattern=np.array([[PX_PER_M, 0.0, 20.0], [0.0, -PX_PER_M, 60.0]]),
        pixels=rod * [PX_PER_M, -PX_PER_M] + [20.0, 60.0],
        px_per_m=PX_PER_M,
        registration_rms_px=0.2,
    )
    np.savez(path, **(data | changes))
    return path


def test_a_picture_that_was_cut_off_is_refused(tmp_path):
    path = write(tmp_path / "green-vps-letterX-int.npz")
    path.with_suffix(".png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(13))
    with pytest.raises(DataError, match="ends within its head"):
        load_photograph(path)


def test_a_photograph_is_read_at_the_size_it_was_laid(tmp_path):
    photograph = load_photograph(write(tmp_path / "green-vps-letterX-int.npz"))
    assert (photograph.rod, photograph.pattern_name) == ("green-vps", "letterX")
    assert photograph.method == "int"
    assert photograph.seen.sum() == 290 and len(photograph.points) == 290
    assert photograph.points[-1] == pytest.approx(1.05 * np.array([0.4, 0.05 * np.sin(4.8)]))
    assert photograph.pattern.length == pytest.approx(
        1.05 * np.hypot(*np.diff(photograph.points / 1.05, axis=0).T).sum(), rel=5e-3
    )
    expected = np.hypot(1.05 * 5e-4, 1.05 * 0.2 / PX_PER_M)
    assert photograph.uncertainty == pytest.approx(np.full(290, expected))


def test_bad_photographs_are_named(tmp_path):
    good = write(tmp_path / "rope-line-int.npz")
    assert load_photograph(good)
    for changes, says in (
        ({"size_factor": -1.0}, "size_factor"),
        ({"hidden": np.ones(300)}, "fewer than 3"),
        ({"sigma": np.zeros(300)}, "sigma is not positive"),
        ({"hidden": np.zeros(4)}, "is 300 long there"),
        ({"px_from_pattern": np.zeros((2, 2))}, "it must have"),
    ):
        with pytest.raises(DataError, match=rf"rope-line-int\.npz: .*{says}"):
            load_photograph(write(good, **changes))
    np.savez(tmp_path / "rope-sine-int.npz", pixels=np.zeros(3))
    (tmp_path / "rope-letterU-int.npz").write_bytes(b"PK\x03\x04torn")
    for name in ("rope-sine-int", "rope-letterU-int", "rope-missing-int"):
        with pytest.raises(DataError, match=name):
            load_photograph(tmp_path / f"{name}.npz")
    with pytest.raises(DataError, match="ROD-PATTERN-METHOD"):
        load_photograph(write(tmp_path / "rope.npz"))
    with pytest.raises(DataError, match="holds no file"):
        load_photographs(tmp_path / "elsewhere")


def test_one_rigid_motion_is_taken_out(tmp_path):
    path = write(tmp_path / "rope-sine-int.npz", turn=0.06, shift=(0.004, -0.007), size=1.0)
    photograph = load_photograph(path)
    s = np.linspace(0.0, 0.4, 6000)
    curve = np.column_stack([s, 0.05 * np.sin(12.0 * s)])
    placed = rigid(photograph, curve)
    assert raw(photograph, curve).mean > 5e-3
    assert placed.mean < 5e-5
    assert placed.turn == pytest.approx(0.06, abs=1e-3)
    # What is left after a motion is never more than before it.
    bent = curve + np.column_stack([np.zeros(6000), 0.02 * s])
    assert rigid(photograph, bent).mean <= raw(photograph, bent).mean


def test_points_are_as_far_as_the_curve_is_between_its_points(tmp_path):
    """A circle of 40 places 2 mm apart; beyond its ends these are the nearest."""
    photograph = load_photograph(write(tmp_path / "rope-sine-int.npz"))
    turn, rng = np.linspace(0.0, 1.5, 40), np.random.default_rng(0)
    curve = 0.05 * np.column_stack([np.cos(turn), np.sin(turn)])
    at, off = rng.uniform(0.1, 1.4, 300), rng.normal(0.0, 1e-3, 300)
    points = (0.05 + off)[:, None] * np.column_stack([np.cos(at), np.sin(at)])
    points[0] = 0.05, -0.01
    seen = replace(photograph, centerline=points, seen=np.ones(300, bool))
    assert raw(seen, curve).distance[0] == pytest.approx(0.01)
    assert raw(seen, curve).distance[1:] == pytest.approx(np.abs(off[1:]), abs=1e-5)
    # Of a rod that leaves the picture at once there is one place.
    alone = np.linalg.norm(points - curve[0], axis=1)
    assert raw(seen, curve[:1]).distance == pytest.approx(alone)


def test_no_other_motion_brings_a_curve_nearer_in_the_mean(tmp_path):
    """Searched for without derivatives from many places; points beyond a curve's end pull along it,
    which fits across it do not see."""
    photograph = load_photograph(write(tmp_path / "rope-sine-int.npz", 0.06, (0.004, 0.007)))
    points, rng = photograph.points, np.random.default_rng(0)
    centre = points.mean(axis=0)
    s = np.linspace(0.02, 0.36, 700)
    for height, bend in ((0.05, 0.0), (0.045, 0.05), (0.0, 0.0)):
        curve = np.column_stack([s, height * np.sin(12.0 * s) + bend * s**2])
        placed, tree = rigid(photograph, curve), cKDTree(curve)

        def mean(motion, tree=tree):
            """Of the points moved back, for the curve moved on."""
            turn, *shift = motion
            return tree.query(moved([-turn, 0.0, 0.0], points - shift, centre))[0].mean()

        on = placed.turn, *placed.shift
        assert mean(on) == pytest.approx(
            cKDTree(moved(on, curve, centre)).query(points)[0].mean(), rel=1e-9
        )

        starts = rng.standard_normal((8, 3)) * [0.05, 0.01, 0.01]
        starts[:4] += [placed.turn, *placed.shift]
        best = min(minimize(mean, one, method="Nelder-Mead").fun for one in starts)
        assert mean(on) < best + 0.02e-3


def test_what_hangs_is_seen_farther_out():
    s = np.linspace(0.0, 0.3, 40)
    nodes = np.column_stack([np.full(40, 0.1), np.zeros(40), s])
    seen = seen_from(s, nodes, np.zeros(2), 1.0)
    # Straight above (0.1, 0) at 0.3 of the camera's height: 0.1 / 0.7 from below the camera.
    assert seen[-1] == pytest.approx([0.1 / 0.7, 0.0])
    assert seen_from(s, nodes, np.zeros(2))[-1] == pytest.approx([0.1, 0.0])


def test_a_rod_hung_over_the_pattern_meanders_only_if_there_is_too_much_of_it():
    """Without excess a naturally straight rod comes to lie along the line; an excess is laid as a
    wave about it that goes on, some ten L_gb long."""
    pattern = wrod.Pattern.from_expression("0*x", start=0.0, stop=0.42)
    rod = wrod.RodMaterial(1.6e-3, 0.018, 0.72)
    plan = plan_without_lead_in(pattern, rod, "intuitive")
    scenarios = [
        Scenario(0.5, curvature=2.0, excess=excess, speed=0.03) for excess in (-0.005, 0.02)
    ]
    little, much = lay(pattern, rod, plan, scenarios)
    assert little.reached and much.reached
    # Where it comes to lie does not hang on what is laid together with it.
    (alone,) = lay(pattern, rod, plan, scenarios[1:])
    (by_itself,) = lay(pattern, rod, plan, scenarios[:1])
    assert np.abs(alone.nodes - much.nodes).max() < 1e-9
    assert np.abs(by_itself.nodes - little.nodes).max() < 1e-9

    def swing(laid):
        on = (laid.nodes[:, 2] < 3e-3) & (np.abs(laid.nodes[:, 0] - 0.3) < 0.09)
        return np.ptp(laid.nodes[on, 1])

    assert swing(much) > 3.0 * swing(little)
    assert swing(much) > 4e-3
    with pytest.raises(DataError, match="in two calls"):
        lay(pattern, rod, plan, [Scenario(), Scenario(held=True)])
    with pytest.raises(RodError, match="hold is -1"):
        wrod.simulate_deployment(pattern, rod, plan, hold=-1.0)


def test_a_held_end_is_let_go_where_it_lies():
    """INT pulls at the end that is held: let go sooner it would move by millimetres, by others on
    another mesh."""
    pattern = wrod.Pattern.from_expression("0.05*sin(9*x)", start=0.0, stop=0.25)
    rod = wrod.RodMaterial(1.6e-3, 0.032, 0.7)
    plan = plan_without_lead_in(pattern, rod, "intuitive")
    (first,), _, _ = pattern.sample(0.0)
    for spacing in (0.01, 0.005):
        mesh = Discretisation(spacing, 0.0125)
        (laid,) = lay(pattern, rod, plan, [Scenario(0.3, held=True)], discretisation=mesh)
        assert laid.reached
        assert np.linalg.norm(laid.nodes[0, :2] - first[:2]) < 0.1e-3


def test_a_damped_rod_is_laid_alike_by_shorter_steps():
    """By second order, though its end is snatched (above); undamped what lies hangs on the steps.
    An end that lies when it is let go shakes neither."""
    pattern, rod = wrod.Pattern.from_expression("0*x", start=0.0, stop=0.3), wrod.rod("green-vps")
    plan = plan_without_lead_in(pattern, rod, "intuitive")
    scenarios = [Scenario(0.3, held=True, damping=damping) for damping in (0.0, INTERNAL_DAMPING)]
    trials = [
        wrod.Trial(pattern, one.damped(rod), plan, wrod.Friction(0.3), tail=Tail.none(plan))
        for one in scenarios
    ]
    meshes = [Discretisation(0.01, step) for step in (0.025, 0.0125, 0.00625)]
    snatched = [wrod.simulate_deployments(trials, discretisation=mesh) for mesh in meshes]

    def moved(laid, k):
        return [np.linalg.norm(a[k] - b[k], axis=1).mean() for a, b in pairwise(laid)]

    undamped, damped = (moved([[d.centerline for d in two] for two in snatched], k) for k in (0, 1))
    at_rest = [lay(pattern, rod, plan, scenarios, discretisation=mesh) for mesh in meshes[1:]]
    for k in range(2):
        assert moved([[d.nodes for d in two] for two in at_rest], k)[0] < 0.02e-3
    assert damped[1] < 0.25 * damped[0]
    assert damped[1] < 0.15e-3 < 0.5e-3 < undamped[1]


@pytest.mark.skipif(not MEASURED.exists(), reason="needs ../shared/measured/laid")
def test_reads_all_photographs():
    photographs = load_photographs(MEASURED)
    assert len(photographs) == 21
    for one in photographs:
        off = raw(one, one.pattern.sample(np.linspace(0.0, one.pattern.length, 2000))[0][:, :2])
        assert off.mean < 0.03, one.name


def test_scenarios_are_weighed_by_the_pictures_they_are_near_to():
    near, far = 1e-3, 5e-3
    # Two scenarios, three pictures: the third alone speaks for the second scenario.
    weights = weigh(np.array([[near, near, far], [far, far, near]]))
    assert weights.sum() == pytest.approx(1.0)
    assert weights[0] / weights[1] == pytest.approx(np.exp((far - near) / 3e-3))
    assert weigh(np.array([[near, far], [far, near]])) == pytest.approx([0.5, 0.5])
    # A scenario whose simulation diverged is worse than any that misses by 6 mm, but no more.
    assert weigh(np.array([[6e-3], [np.inf]])) == pytest.approx([0.5, 0.5])
    # Where the place counts as well, a centimetre more is heard.
    assert weigh(np.array([[6e-3], [16e-3]]), 5e-3, placed=True)[0] == pytest.approx(
        1.0 / (1.0 + np.exp(-2.0))
    )
    # Every picture in a scenario of its own: two of three are the first's.
    mixed = weigh(np.array([[near, near, far], [far, far, near]]), 0.5e-3, mixture=True)
    assert mixed == pytest.approx([2 / 3, 1 / 3], abs=1e-3)
    with pytest.raises(DataError, match="two or more"):
        weigh(np.zeros((3, 0)))


def test_what_was_fitted_is_taken_as_far_as_unseen_pictures_gain():
    nothing = np.full(8, 2e-3)
    better = nothing - 0.5e-3 * np.array([1.0, 0.8, 1.2, 1.0, 0.9, 1.1, 1.0, 1.0])
    assert simplest(np.column_stack([nothing, 0.5 * (nothing + better), better])) == 2
    # Half gain and half lose: what is gained on average is luck.
    lucky = nothing + 0.5e-3 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 0.9, -1.0])
    assert simplest(np.column_stack([nothing, lucky])) == 0
    assert simplest(np.column_stack([nothing, nothing + 1e-3])) == 0
    assert simplest(np.zeros((1, 3))) == 0


def test_the_best_of_all_ways_is_rarely_taken_by_luck():
    """Ways that hang together, gaining in some of seven patterns what they lose in others."""
    random = np.random.default_rng(0)
    count = len(WAYS) - 1  # and nothing fitted
    common, loads = random.normal(size=(2000, 7, 2)), random.normal(1.0, 1.0, (2000, 2, count))
    ways = common @ loads + 0.3 * random.normal(size=(2000, 7, count))
    error = ways.std(axis=1, ddof=1) / np.sqrt(7)
    ahead = np.take_along_axis(-ways.mean(axis=1) / error, ways.mean(axis=1).argmin(1)[:, None], 1)
    assert 0.25 < (ahead > 1.0).mean() < 0.5
    costs = np.concatenate([np.zeros((2000, 7, 1)), 1e-4 * ways], axis=2)
    assert np.mean([simplest(one) > 0 for one in costs]) < 0.125


def test_drawn_scenarios_are_the_same_for_every_count():
    assert len(scenarios_of("rope")) == 11 and believed_scenario("rope") in scenarios_of("rope")
    some, more = scenarios_of("rope", 8), scenarios_of("rope", 16)
    assert some.items() <= more.items() and len(more) == 27
    drawn = [scenario for name, scenario in more.items() if name.startswith("drawn")]
    assert all(0.2 <= one.friction <= 0.7 and one.curvature <= 3.0 for one in drawn)
    assert sum(one.held for one in drawn) == 8
    assert all(one.excess == 0.0 for one in drawn if one.held)


def test_the_camera_is_found_from_what_hangs(tmp_path):
    """Three rods that rise from the table each way, as a camera off the middle shows them."""
    camera = OverheadCamera(0.06, -0.05, 0.7)
    s = np.linspace(0.0, 0.5, 60)
    photographs, rods = [], []
    photograph = load_photograph(write(tmp_path / "rope-p-int.npz", size=1.0))
    for turn in (0.3, 2.2, 4.4):
        up = np.maximum(s - 0.35, 0.0)
        along = np.minimum(s, 0.35) + 0.02 * np.tanh(up / 0.02)
        line = np.column_stack([along, 0.03 * np.sin(14.0 * along)])
        c, t = np.cos(turn), np.sin(turn)
        nodes = np.column_stack([line @ np.array([[c, t], [-t, c]]) + photograph.middle, up])
        rod = LaidRod(s, nodes, True)
        shown = camera.view(photograph, s, nodes)[::6]
        shown = shown[: int(0.8 * len(shown))]
        count = len(shown)
        photographs.append(
            replace(
                photograph,
                centerline=shown,
                seen=np.ones(count, dtype=bool),
                sigma=np.full(count, 5e-4),
            )
        )
        rods.append(rod)
    found = find_camera(photographs, rods)
    assert found.height == pytest.approx(0.7, rel=0.05)
    assert [found.right, found.up] == pytest.approx([0.06, -0.05], abs=5e-3)
    for photograph, rod in zip(photographs, rods, strict=True):
        before = rigid(photograph, OverheadCamera().view(photograph, s, rod.nodes)).mean
        after = rigid(photograph, found.view(photograph, s, rod.nodes)).mean
        assert after < 0.3e-3 and before > 3.0 * after
    flat = [LaidRod(s, one.nodes * [1.0, 1.0, 0.0], True) for one in rods]
    with pytest.raises(DataError, match="nothing hangs"):
        find_camera(photographs, flat)
    with pytest.raises(DataError, match="one rod each"):
        find_camera(photographs, rods[:2])


def test_scenarios_are_averaged_at_equal_distance_from_the_grip():
    s = np.linspace(0.0, 0.5, 26)
    straight = LaidRod(s, np.column_stack([s, 0.0 * s, 0.0 * s]), True)
    # The same place laid by a rod of 2 cm more, which begins 2 cm behind.
    longer = np.linspace(0.0, 0.52, 27)
    behind = LaidRod(
        longer, np.column_stack([longer - 0.02, 0.01 + 0.0 * longer, 0.0 * longer]), True
    )
    lost = LaidRod(s, np.full((26, 3), 9.0), False)
    scenarios = [Scenario(), Scenario(excess=0.02), Scenario()]
    mean = average([straight, behind, lost], scenarios, np.array([0.25, 0.25, 0.5]))
    assert mean.nodes[:, 0] == pytest.approx(mean.arc_length, abs=1e-12)
    assert mean.nodes[:, 1] == pytest.approx(np.full(len(mean.nodes), 0.005))
    with pytest.raises(DataError, match="no scenario"):
        average([lost], scenarios[:1], np.ones(1))
    # Chords of 2 cm would cut a circle of 5 cm by a millimetre.
    round_ = 0.05 * np.column_stack([np.cos(s / 0.05), np.sin(s / 0.05), 0.0 * s])
    mean = average([LaidRod(s, round_, True)], scenarios[:1], np.ones(1))
    assert np.linalg.norm(mean.nodes, axis=1) == pytest.approx(np.full(600, 0.05), abs=5e-5)


def test_spread_is_what_a_rigid_motion_leaves():
    s = np.linspace(-0.25, 0.25, 101)
    line = np.column_stack([s, 0.1 * s])
    turned = line @ np.array([[1.0, 1e-3], [-1e-3, 1.0]]) + [3e-3, -2e-3]
    assert spread(turned[None], np.ones(1), line).max() < 1e-8
    # Of a bow, quadratic in s, the mean and the slope go; both ways count alike.
    across = np.array([-0.1, 1.0]) / np.hypot(0.1, 1.0)
    bow = 0.1 * s**2
    lines = np.stack([line + sign * bow[:, None] * across for sign in (1.0, -1.0)])
    found = spread(lines, np.array([0.3, 0.7]), line)
    assert found == pytest.approx(np.abs(bow - bow.mean()), abs=1e-9)


def test_mechanisms_of_waves_are_in_the_rod_both_ways_round():
    from wrod.bench.photographs_waves import _height, mechanisms

    every = {(one.cause, one.sense): one for one in mechanisms("rope", 9.0)}
    assert {sense for cause, sense in every if cause.startswith("hung")} == {"left", "right"}
    rods = {key: one.damped(wrod.rod("rope")) for key, one in every.items()}
    left, right = (rods["bends set in, in the plane", sense] for sense in ("left", "right"))
    s = np.linspace(0.0, left.length, 50)
    bends = left.natural_curvature[0](s)
    assert np.ptp(bends) > 10.0
    assert bends == pytest.approx(-right.natural_curvature[0](s))
    helix = rods["right-handed helix of 7 /m, held", "rolled by 90"]
    assert helix.natural_twist(0.1) == pytest.approx(2.0 * np.pi / 0.28)
    # A line towards -y with a slope, and a wave of 6 mm from crest to trough on it.
    y = -np.linspace(0.0, 0.47, 2000)
    x = 0.01 * y + 3e-3 * np.sin(2.0 * np.pi * y / 0.037)
    assert _height(np.column_stack([x, y])) == pytest.approx(6e-3, rel=0.05)
