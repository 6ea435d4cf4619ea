"""Deployments that look at what lies and plan the rest anew."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cli import refused, run
from vps import SHORT as ROD

import wrod
from wrod.deployment.beliefs import Beliefs, meshed_to_the_end, told_by
from wrod.deployment.beside import Beside, doubted
from wrod.deployment.expectation import COARSE, FINE, PACE
from wrod.deployment.feedback import Plant, Sight, lay_with_feedback
from wrod.deployment.remembered import LastDeployments
from wrod.deployment.replanning import Moment, _Candidate
from wrod.deployment.result import errors_along
from wrod.deployment.setup import Disturbance
from wrod.deployment.sight import Seen
from wrod.deployment.simulate import Trial, prepare_trials
from wrod.deployment.tangents import lay
from wrod.deployment.together import follow
from wrod.deployment.way import GripWay
from wrod.errors import RodError
from wrod.planning.tail import Tail
from wrod.solvers.friction import Friction

ROUGH = {"discretisation": replace(COARSE, tolerance=1e-5), "speed": PACE}


def test_a_robot_beside_its_place_is_seen_and_made_up_for(bend, monkeypatch):
    """Where rods are believed in and laid on the same coarse mesh."""
    monkeypatch.setattr("wrod.deployment.beliefs._MESH", replace(COARSE, tolerance=1e-4))
    pattern, trajectory = bend
    off = Disturbance(offset=(0.0, 0.004), yaw=0.01)
    plant = Plant(ROD, Friction(0.6), off)
    loop = wrod.FeedbackLoop(pattern, ROD, trajectory, 0.6, every=0.06)
    followed = lay_with_feedback(loop, plant, sight=Sight(noise=2e-4), **ROUGH)
    (blind,) = lay([Trial(pattern, ROD, trajectory, Friction(0.6), off)], **ROUGH)
    left, before = (
        errors_along(pattern, x.arc_length, x.centerline)[1] for x in (followed.laid, blind)
    )
    # What is seen and what is believed rest in the same way where a look ends the path: once the
    # offset is known they differ by less than a millimetre.
    assert max(look.misfit for look in followed.looks[1:]) < 1e-3
    # Seen before the free end is let go: what was held is put down again where it belongs.
    assert followed.looks[0].offset == pytest.approx((0.0, 0.004), abs=1e-3)
    assert followed.looks[-1].offset == pytest.approx((0.0, 0.004), abs=1e-3)
    assert followed.looks[-1].yaw == pytest.approx(0.01, abs=0.003)
    assert left.mean() < 0.3 * before.mean() and left[:10].mean() < 0.3 * before[:10].mean()


@pytest.fixture(scope="module")
def two_bends():
    """Two bends to the left, 20 cm of way and 14 cm of table apart, and their plan."""
    s = np.linspace(0.0, 0.36, 600)
    heading = 0.7 * (2.0 + np.tanh((s - 0.1) / 0.02) + np.tanh((s - 0.27) / 0.02))
    points = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0) * s[1]
    pattern, rod = wrod.Pattern.from_points(points), wrod.RodMaterial(0.0016, 0.032, 0.5)
    return pattern, rod, wrod.plan(pattern, rod, spacing=0.005)


def test_a_table_of_two_frictions_is_told_by_what_slid_on_it(two_bends):
    """Coefficients under both bends are within two of their stated errors, and these are small
    where the rod slid; by looks of half a second."""
    pattern, rod, trajectory = two_bends
    at = np.array([0.1, 0.27])
    x = pattern.sample(at)[0][:, 1]
    middle = float(x.mean())
    reach = (middle - 0.5, middle + 0.5)
    field = wrod.FrictionField.of(
        lambda x, y: np.where(y > middle, 0.4, 1.0), reach, reach, (201, 201)
    )
    same = ROUGH | {"discretisation": meshed_to_the_end(ROUGH["discretisation"], pattern)}
    beliefs, rng, went_on = (
        Beliefs(pattern, rod, 0.4, 0.05), np.random.default_rng(0), [LastDeployments()]
    )  # fmt: skip
    for to in np.arange(0.12, 0.36, 0.04):
        path = GripWay(trajectory).until(to).path
        trial = Trial(pattern, rod, path, Friction(0.4), Disturbance(), Tail.none(path))
        (lies,) = lay([trial], friction_field=field, remembered=went_on, **same)
        beliefs.looking(0.5)
        follow([beliefs.update(to, path, [Seen.of(lies, to, Sight(), rng)], **same)])
    mu, error = beliefs.under(at)
    assert beliefs.field is not None and error.max() < 0.3
    assert (np.abs(np.log(mu / [0.4, 0.16])) < 2.0 * error).all()


def test_no_table_is_invented_from_noise(two_bends):
    """Of a hundred cameras that look at a rod on a table of one friction, which is not the one that
    is believed at first, hardly one says that it varies."""
    pattern, rod, trajectory = two_bends
    believed = Beliefs(pattern, rod, 0.4, 0.05)
    rngs = [np.random.default_rng(seed) for seed in range(100)]
    every = [believed.accounts] * len(rngs)
    here = believed.account.mean
    for at in np.arange(0.12, 0.36, 0.03):
        path = GripWay(trajectory).until(at).path
        laid = follow([believed.felt(path, **ROUGH)])[0]
        truth = replace(laid, centerline=laid.centerline - 0.5 * laid.tangent[0])
        for k, rng in enumerate(rngs):
            information, pull, *_ = told_by(laid, at, Seen.of(truth, at, Sight(), rng))
            every[k] = [one.after(here, information, pull, False) for one in every[k]]
    sure = [same.evidence - varied.evidence for same, varied in every]
    assert np.sum(np.array(sure) < 0.0) <= 2 and np.mean(sure) > 3.0
    found = np.array([same.mean[0] for same, _ in every])
    assert found.mean() == pytest.approx(-0.5, abs=0.1) and found.std() < 0.3


def test_friction_far_from_what_was_believed_is_not_taken_for_a_table_that_varies(two_bends):
    """A rod that slides little at the friction that is believed says by its derivatives that this
    has to be far lower than it is: they are taken anew until they are those of what is believed."""
    pattern, rod, trajectory = two_bends
    same = ROUGH | {"discretisation": meshed_to_the_end(ROUGH["discretisation"], pattern)}
    beliefs, rng = Beliefs(pattern, rod, 0.4, 0.05), np.random.default_rng(0)
    for to in (0.12, 0.15):
        path = GripWay(trajectory).until(to).path
        trial = Trial(pattern, rod, path, Friction(0.15), Disturbance(), Tail.none(path))
        (lies,) = lay([trial], **same)
        pictures = [Seen.of(lies, to, Sight(), rng) for _ in range(3)]
        follow([beliefs.update(to, path, pictures, **same)])
        same_everywhere, varies = beliefs.accounts
    (mu,), (error,) = beliefs.under(np.array([0.1]))
    assert abs(np.log(mu / 0.15)) < 2.0 * error < 0.5
    assert same_everywhere.evidence > varies.evidence + 1.0


def test_noise_in_a_bend_is_not_taken_for_a_rod_that_lies_beside(bend):
    """A picture tells what is across the rod; what it tells of the rest must not be noise."""
    s = np.linspace(0.0, bend[0].length, 400)
    laid = SimpleNamespace(arc_length=s, centerline=bend[0].sample(s)[0])
    at, rng = np.arange(0.0, 0.19, 0.01), np.random.default_rng(0)
    place, normal = bend[0].sample(at)[0], np.array([-np.sin(0.5), np.cos(0.5)])
    found = {}
    for true, begins in (("never", 200), ("always", 0), ("late", 100)):
        beside, found[true], deviation = Beside(), [], np.full((19, 3), 5e-4)
        for k in range(200):
            noise = 5e-4 * rng.standard_normal((19, 3))
            noise[:, :2] += (1e-3 if k >= begins else 0.0) * normal
            seen = Seen(at, place + noise, deviation, 19)
            found[true].append(beside.told(laid, 0.22, seen, 0.03 * k))
    # A look's own noise would be 0.2 mm; where nothing else is seen, hardly any of it is left.
    # What is there is followed from the first looks on, but for what is forgotten on the way, and
    # what comes up late, after all that went well before.
    aside = {true: np.array(told) for true, told in found.items()}
    assert np.sqrt((aside["never"] ** 2).mean(axis=0)).max() < 3e-5
    assert np.abs(aside["never"]).max() < 1.5e-4
    assert (aside["always"] @ normal)[3:].mean() == pytest.approx(0.9e-3, abs=0.05e-3)
    assert (aside["late"] @ normal)[102:].mean() == pytest.approx(0.9e-3, abs=0.05e-3)


def test_what_is_believed_to_lie_wrong_is_doubted_where_only_noise_is_seen(bend):
    """The grip goes back for what is seen, and not for what is believed."""
    pattern = bend[0]
    s = np.linspace(0.0, pattern.length, 400)
    wrong = np.array([0.0, 1e-3, 0.0])
    believed = SimpleNamespace(arc_length=s, centerline=pattern.sample(s)[0] + wrong)
    at, rng = np.arange(0.0, 0.19, 0.01), np.random.default_rng(0)
    told, none = {}, np.zeros(2)
    for true in (0.0, 1.0):
        place = pattern.sample(at)[0] + true * wrong
        told[true] = [
            doubted(
                believed, pattern, 0.22, Seen(at, place + noise, np.full((19, 3), 5e-4), 19), none
            )
            for noise in 5e-4 * rng.standard_normal((200, 19, 3))
        ]
    # Six points near the contact, a millimetre off by two deviations each.
    assert np.mean(told[1.0]) == pytest.approx(24.0, abs=3.0) and np.mean(told[0.0]) < -21.0
    assert np.mean(np.array(told[1.0]) > 9.0) > 0.9 and max(told[0.0]) < 9.0


def test_a_beginning_that_springs_is_laid_for_it(bend):
    """What is held is put down where the rod lies best once its free end is let go."""
    pattern, trajectory = bend
    beliefs = Beliefs(pattern, ROD, 0.4, 0.05)
    beliefs.know(0.4, Disturbance(natural_curvature=6.0), None)
    now = Moment(beliefs, GripWay(trajectory), 0.07, np.zeros(2), horizon=10.0)
    way, placed, kept = follow([now.begun()], hold=0.05)[0]
    assert not kept
    left = []
    for path, where in ((trajectory, np.zeros(3)), (way.path, placed)):
        (laid,) = lay([beliefs.trial(path, where)], discretisation=FINE, speed=PACE)
        left.append(errors_along(pattern, laid.arc_length, laid.centerline)[1][:20].mean())
    assert left[1] < 0.75 * left[0]


def test_a_plant_is_shaken_as_it_was_however_long_it_goes_on(bend):
    """Pictures are of plants that are laid again each time: what is past must not change."""
    pattern, trajectory = bend
    paths = [GripWay(trajectory).until(to).path for to in (0.15, 0.2)]
    moved = []
    for shaken in (Disturbance(jitter=3e-4, shaking_time=60.0), Disturbance(jitter=3e-4)):
        short, long = (
            setup.schedule.position
            for setup in prepare_trials(
                [Trial(pattern, ROD, p, Friction(0.4), shaken, Tail.none(p)) for p in paths],
                0.05, None, 0.04, COARSE,
            )
        )  # fmt: skip
        # Until the shorter one nears its end, where its spline is another by some micrometres.
        common = len(short) - 100
        moved.append(np.abs(short[:common] - long[:common]).max())
    assert moved[0] < 2e-5 and moved[1] > 3e-4


def test_looks_that_never_come_are_refused(bend):
    pattern, trajectory = bend
    with pytest.raises(RodError, match=r"every is 0\.0; it must be"):
        wrod.FeedbackLoop(pattern, ROD, trajectory, 0.6, every=0.0)


def test_an_unknown_effect_is_refused(tmp_path):
    arguments = ["bench", "feedback", "--effects", "ghost", "--out", str(tmp_path / "out")]
    refused("unknown effect 'ghost'", *arguments)
    assert not (tmp_path / "out").exists()


def test_finished_rows_are_kept_and_ratios_stand_beside_them(tmp_path, monkeypatch):
    from wrod.bench import feedback, slippery

    asked = []

    def course(shelf, key, how):
        asked.append((key[2], key[3]))
        yield from ()
        size = {"none": 0.02, "friction": 0.03}[key[2]] * {"blind": 10.0, "followed": 1.0}[key[3]]
        return dict(zip(feedback.KEYS, key, strict=True)) | {"error_mean": size, "looks": []}

    monkeypatch.setattr(feedback, "_course", course)
    monkeypatch.setattr(slippery.Shelf, "stock", lambda *args: None)
    arguments = ["bench", "feedback", "--device", "cpu", "--names", "letter-U"]
    arguments += ["--out", str(tmp_path), "--effects"]
    first = run(*arguments, "none", "--ways", "blind")
    assert first.exit_code == 0 and asked == [("none", "blind")], first.output
    both = run(*arguments, "none,friction")
    assert len(asked) == len(set(asked)) == 4
    assert "| friction halved | 0.300 (1.50) | 0.300 (1.50) |" in both.output
    assert "| friction halved | 0.030 (1.50) | 0.030 (1.50) |" in both.output
    # What is finished is told, and nothing else is laid.
    told = run(*arguments, "none,friction,half", "--finished")
    assert len(asked) == 4 and "| friction halved | 0.030 (1.50) |" in told.output
    refused("other settings", *arguments, "none", "--every", "0.1")


def test_the_last_column_is_of_trials_that_are_there_with_and_without_an_effect():
    from wrod.bench.feedback import summary, table_told

    errors = {
        ("none", "sine"): {0: 0.01, 1: 0.03},
        ("friction", "sine"): {0: 0.02, 1: 0.02, 2: 0.9},  # of the third there is none without
        ("none", "line"): {0: 0.01},
        ("friction", "line"): {0: 0.06},
        ("friction", "circle"): {0: 0.9},
    }
    rows = [
        dict(rod="rope", pattern=name, effect=effect, way="followed", seed=seed, error_mean=error)
        for (effect, name), cell in errors.items()
        for seed, error in cell.items()
    ]
    *_, none, friction = table_told(summary(rows), ["followed"])
    assert none.endswith("| 0.017 |") and friction.endswith("| 0.033 (2.00) |")


def test_a_grip_goes_back_and_on_as_it_would_have_gone(bend):
    _, trajectory = bend
    way, turn = GripWay(trajectory).back(0.2, 0.12)
    # 8 cm back, and the same forth; its poses are those of the laid length, turned or not.
    assert way.end == pytest.approx(trajectory.arc_length[-1] + 0.16, abs=0.02)
    assert way.laid_at(turn) == pytest.approx(0.12, abs=1e-3)
    assert way.laid.min() >= 0.0 and way.laid[-1] == trajectory.arc_length[-1]
    along = np.stack(
        [np.interp(way.laid, trajectory.arc_length, c) for c in trajectory.position.T], axis=1
    )
    assert np.abs(way.path.position - along).max() < 5e-4
    again, turn = way.back(turn + 0.05, 0.0)
    # Not beyond where it came forwards for the last time.
    assert again.laid_at(turn) == pytest.approx(0.12, abs=2e-3)


def test_what_lies_beside_is_made_up_for_by_several_steps(bend):
    """One step is not enough: what lies answers linearly to a millimetre of the grip alone."""
    pattern, trajectory = bend
    way, beliefs = GripWay(trajectory), Beliefs(pattern, ROD, 0.3, 0.05)
    now = Moment(beliefs, way, 0.12, np.array([0.0, 2e-3]), horizon=10.0)
    before, after, _, corrected = follow([now._corrected(way, 0.12)], hold=0.05)[0]
    assert before[-15:].mean() > 2e-3 and after[-15:].mean() < 0.5 * before[-15:].mean()
    # What is too small for another deployment is made up for as derivatives say.
    now = Moment(beliefs, corrected.way, 0.12, np.array([0.0, 2.2e-3]), horizon=10.0)
    before, after, _, finer = follow([now._corrected(corrected.way, 0.12)], hold=0.05)[0]
    assert 0.0 < np.abs(finer.way.path.position - corrected.way.path.position).max() < 1e-3
    assert after.mean() < before.mean()
    moved = corrected.way.path.position - trajectory.position
    # Nothing of what is gone is changed, and the grip goes on without a step: 2.5 mm on it has gone
    # a ninth of the way that it has gone after a centimetre.
    ahead = way.laid > 0.12
    size = np.abs(moved[ahead]).max(axis=1)
    assert not moved[~ahead].any() and 0.0 < size[0] < 0.15 * size[2]
    # A centimetre on, it is where a path that may begin anywhere is: nothing of that is held back.
    c = way.corrections(pattern, ROD.gravito_bending_length, 0.12, 0.3, 0.01)
    assert c.basis[way.laid > 0.13].sum(axis=1) == pytest.approx(1.0, abs=1e-12)
    assert not c.basis[way.laid <= 0.12].any()


def test_a_path_is_kept_that_others_as_likely_are_laid_better_by(bend):
    """What is best for what is believed is worse where that is doubted."""
    pattern, trajectory = bend
    beliefs, way = Beliefs(pattern, ROD, 0.4, 0.05), GripWay(trajectory)
    now = Moment(beliefs, way, 0.12, np.zeros(2), horizon=10.0)
    one = np.zeros((100, len(beliefs.account.mean)))
    one[:, 3] = 1e-3  # all of it goes along with the robot's place
    reach = float(way.laid[-1])
    sure = _Candidate(way, np.zeros(3), reach, np.full(100, 6e-4), 0.1 * one)
    doubtful = _Candidate(way, np.zeros(3), reach, np.full(100, 1e-4), one)
    assert not now._better(doubtful, sure)
    # The mean size of a two-dimensional error whose components are one normal variable.
    apart = beliefs.drawn(20_000) @ one.T
    assert np.abs(apart).mean() == pytest.approx(1e-3 * np.sqrt(2.0 / np.pi), rel=0.02)
    # Known by then, the same path is taken.
    account = replace(beliefs.account, covariance=0.01 * beliefs.account.covariance)
    beliefs.accounts = [account]
    assert now._better(doubtful, sure)
