"""Plans that are corrected through simulated deployments."""

import re
import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cli import done

import wrod
from wrod.commands.plan_summary import _expectation
from wrod.deployment import descent, together
from wrod.deployment.corrections import Corrections, between, moved
from wrod.deployment.descent import State, TableTask, Tried, descend
from wrod.deployment.expectation import (
    Unseen,
    _stretches,
    balanced,
    expect,
    independent,
    is_better,
    robot_error,
    rougher,
)
from wrod.deployment.optimise import _chosen, _fastest, best_of, course, optimise
from wrod.deployment.setup import Disturbance
from wrod.deployment.simulate import Trial
from wrod.deployment.spread import Spread
from wrod.deployment.tangents import Directions, Laid, lay
from wrod.deployment.together import Asked, _laid
from wrod.errors import GraspError, PatternError
from wrod.planning.pace import pace_of
from wrod.planning.shapes import led_along
from wrod.solvers.friction import Friction

ROD = wrod.RodMaterial(0.0016, 0.032, 0.36)
MESH = wrod.Discretisation(0.01, 0.02)


@pytest.fixture(scope="module")
def bend():
    """A pattern that turns by 92 degrees at up to 0.64 / L_gb, and its plan."""
    s = np.linspace(0.0, 0.2, 400)
    heading = 0.8 * (1.0 + np.tanh((s - 0.11) / 0.04))
    points = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0) * s[1]
    pattern = wrod.Pattern.from_points(points)
    return pattern, wrod.plan(pattern, ROD, "numeric", closure="min_friction", spacing=0.005)


def test_a_corrected_plan_lays_better_than_the_best_grasps(bend):
    pattern, trajectory = bend
    corrected = optimise(pattern, ROD, trajectory, 0.3)
    before = expect(pattern, ROD, trajectory, 0.3, trials=3)
    after = corrected.metadata["expected"]
    assert after["diverged"] == 0
    assert after["mean"] < 0.5 * before["mean"]
    said = corrected.metadata["optimised"]
    # What the fitted rods keep is less than what unseen ones do, and the least of all iterations.
    assert min(said["errors"]) < after["mean"] < said["errors"][0]
    moved = np.linalg.norm(corrected.position - trajectory.position, axis=1)
    assert 1e-3 < moved.max() < 1.5 * ROD.gravito_bending_length
    # Smooth: no contact node moves the grip by more than a third of a millimetre off its course.
    bent = np.diff(corrected.position - trajectory.position, 2, axis=0)
    assert np.abs(bent).max() < 1e-3
    turned = between(trajectory, corrected)[:, 3:]
    assert said["largest_turn"] == pytest.approx(np.linalg.norm(turned, axis=1).max())
    assert 1e-3 < said["largest_turn"] < 0.5 and np.abs(np.diff(turned, 2, axis=0)).max() < 5e-3


def test_the_command_says_what_is_expected(bend, tmp_path):
    np.savetxt(tmp_path / "bend.txt", bend[0].sample(np.linspace(0.0, 0.19, 200))[0], header="m")
    arguments = [
        "plan",
        str(tmp_path / "bend.txt"),
        "--rod",
        str(wrod.save_rod(ROD, tmp_path / "rod.json")),
    ]
    arguments += ["--method", "intuitive", "--no-robot", "--units", "m", "--spacing", "0.01"]
    result = done(*arguments, "--out", tmp_path / "out")
    assert re.search(
        r"cm off the pattern, .* has it; [\d.]+ at friction 0.2 to .* to 0.6", result.output
    )
    assert "up to the largest friction of 0.6" in result.output
    assert "lies off the pattern by more than 5 mm at s = " in result.output
    saved = wrod.Trajectory.load(tmp_path / "out" / "trajectory.npz")
    expected = saved.metadata["expected"]
    assert expected["mean"] > 0.005 and expected["holds_from"] is None
    again = wrod.plan(bend[0], ROD, "intuitive", spacing=0.01, remainder=False, expect=True)
    assert again.metadata["expected"]["mean"] == pytest.approx(expected["mean"], rel=0.05)


def test_what_cannot_be_laid_is_told_with_the_friction_that_it_takes(bend):
    pattern, trajectory = bend
    expected = expect(pattern, ROD, trajectory, 0.1, trials=2, coarse=True)
    assert expected["off"] and all(least is None for *_, least in expected["off"])
    (needed,) = together.follow([rougher(pattern, ROD, [trajectory], expected)])
    assert len(needed) == len(expected["off"]) and 0.1 < max(needed) <= 0.55
    (held,) = together.follow([rougher(pattern, ROD, [trajectory], expected | {"off": []})])
    assert held == []
    lines = "\n".join(_expectation(expected, None))
    assert "m, up to the largest friction asked for" in lines
    said = dict(errors=[0.1, 0.1], kept=False, pace=0.04, rougher=needed)
    lines = "\n".join(_expectation(expected, said))
    assert f"m, and can be laid from friction {needed[0]:.2g} on" in lines
    none = said | {"rougher": [None] * len(needed)}
    assert "and on rougher tables that were tried" in "\n".join(_expectation(expected, none))


def test_columns_are_what_corrections_do(bend):
    pattern, trajectory = bend
    corrections = Corrections(pattern, trajectory, ROD.gravito_bending_length, 0.05)
    values, way = 0.3 * np.random.default_rng(0).standard_normal((2, corrections.count))
    by_columns = np.einsum("c,ctd->td", values, corrections.columns())
    corrected = corrections.apply(values)
    np.testing.assert_allclose(by_columns, between(trajectory, corrected), atol=1e-12)
    np.testing.assert_allclose(by_columns, corrections.moves(values), atol=1e-12)
    ahead, behind = (corrections.apply(values + sign * 1e-6 * way) for sign in (1.0, -1.0))
    rates = np.einsum("c,ctd->td", way, corrections.columns(values))
    np.testing.assert_allclose(between(behind, ahead) / 2e-6, rates, atol=1e-8)
    # The rod ends at the grip still, and along it as much as before.
    before, after = trajectory.shape, corrected.shape
    np.testing.assert_allclose(after[:, -1] - before[:, -1], by_columns[:, :3], atol=1e-12)
    turn = corrected.rotation @ trajectory.rotation.swapaxes(1, 2)
    last = led_along(before, 0.0 * by_columns[:, :3], turn)
    old, new = (np.diff(one, axis=1)[:, -1] for one in (before, last))
    unit = np.linalg.norm(old, axis=1, keepdims=True)
    np.testing.assert_allclose(new / unit, np.einsum("tij,tj->ti", turn, old) / unit, atol=0.03)


def test_a_turn_about_the_rod_twists_it(bend):
    trajectory = replace(bend[1], twist=np.zeros(len(bend[1].arc_length)))
    about = np.hstack([np.zeros((len(trajectory.twist), 3)), 0.1 * trajectory.rotation[..., 0]])
    np.testing.assert_allclose(moved(trajectory, about).twist, 0.1)
    across = np.hstack([about[:, :3], 0.1 * trajectory.rotation[..., 1]])
    np.testing.assert_allclose(moved(trajectory, across).twist, 0.0, atol=1e-15)
    assert moved(bend[1], about).twist is None


def test_what_lies_answers_to_turns_of_the_grip_as_their_columns_say(bend):
    """Differences of whole deployments; the time law does not depend on turns."""
    pattern, trajectory = bend
    corrections = Corrections(pattern, trajectory, ROD.gravito_bending_length, 0.05)
    values, way = 0.1 * np.random.default_rng(0).standard_normal((2, corrections.count))
    way *= np.tile([0.0, 0.0, 0.0, 1.0, 1.0, 1.0], corrections.knots)

    def laid(x, columns=None):
        told = None if columns is None else [Directions.of_path(columns)]
        trial = Trial(pattern, ROD, corrections.apply(x), Friction(0.4))
        return lay([trial], told, discretisation=MESH)[0]

    ahead, behind = (laid(values + sign * 1e-4 * way).centerline for sign in (1.0, -1.0))
    along = np.tensordot(way, laid(values, corrections.columns(values)).tangent, 1)
    largest = np.abs(along).max()
    assert largest > 1e-3
    np.testing.assert_allclose((ahead - behind) / 2e-4, along, atol=0.01 * largest)


def test_a_plain_deployment_is_that_of_the_simulation(bend):
    pattern, trajectory = bend
    laid = lay([Trial(pattern, ROD, trajectory, Friction(0.4))], discretisation=MESH)[0]
    same = wrod.simulate_deployment(pattern, ROD, trajectory, 0.4, discretisation=MESH)
    np.testing.assert_allclose(laid.centerline, same.centerline, atol=1e-12)
    with_columns = lay(
        [Trial(pattern, ROD, trajectory, Friction(0.4))],
        [Directions.of_rod(len(trajectory))],
        discretisation=MESH,
    )[0]
    np.testing.assert_array_equal(laid.centerline, with_columns.centerline)


def test_courses_that_are_laid_together_lie_as_they_do_alone(bend):
    """With other numbers of directions, releases and edges, and one without directions."""
    pattern, trajectory = bend

    def course(mu, count, spacing, release):
        trial = Trial(pattern, ROD, trajectory, Friction(mu))
        bump = np.exp(-0.5 * ((trajectory.arc_length - 0.1) / 0.03) ** 2)[:, None] * np.eye(6)[1]
        columns = [Directions.of_path(np.tile(bump, (count, 1, 1)))] if count else None
        how = {"discretisation": replace(MESH, spacing=spacing), "speed": 0.05, "release": release}
        return Asked([trial], columns, how)

    asked = [
        course(*one) for one in ((0.3, 2, 0.02, 0.06), (0.6, 1, 0.01, None), (0.6, 0, 0.02, 0.1))
    ]
    together = _laid(dict(enumerate(asked)), {"device": "cpu"})
    nodes = len(together[0][0].arc_length)
    for one, (laid,) in zip(asked, (together[k] for k in range(3)), strict=True):
        count = None if one.directions is None else nodes
        mesh = replace(one.how["discretisation"], node_count=count)
        (alone,) = lay(one.trials, one.directions, **{**one.how, "discretisation": mesh})
        np.testing.assert_allclose(laid.centerline, alone.centerline, atol=1e-12)
        assert laid.tangent.shape == alone.tangent.shape
        np.testing.assert_allclose(laid.tangent, alone.tangent, atol=1e-9)


def test_a_plan_has_its_own_mesh_in_any_company(bend, monkeypatch):
    pattern, trajectory = bend
    counts = []

    def laid(trials, directions, *, discretisation, **_):
        node_count = discretisation.node_count
        counts.append((len(trials), node_count))
        nothing = np.zeros((node_count, 3))
        s, n = np.linspace(0.0, 0.4, node_count), len(directions[0])
        return [Laid(s, nothing, np.zeros((n, *nothing.shape)), nothing[:, 0], False, 1)] * len(
            trials
        )

    monkeypatch.setattr(together, "lay", laid)
    longer = replace(ROD, length=3.0 * ROD.length)

    def asked(rod, judge):
        return next(course(TableTask(pattern, rod, trajectory, 0.3), judge=judge))

    for judge in (True, False):
        _laid({k: asked(rod, judge) for k, rod in enumerate((ROD, ROD, longer))}, {})
    (one, larger), (few, own), (every, most) = sorted(counts)
    assert (one, few, every) == (2, 4, 6) and own < larger <= most
    assert own % 16 == larger % 16 == most % 16 == 0


def test_courses_out_of_step_wait_for_each_other(bend, monkeypatch):
    """One that lays a rod more than the others does not make them be laid apart ever after."""
    pattern, trajectory = bend
    trial, sizes = Trial(pattern, ROD, trajectory, Friction(0.4)), []

    def laid(trials, *_, **__):
        sizes.append(len(trials))
        nothing = np.zeros((2, 3))
        return [Laid(np.arange(2.0), nothing, nothing[None], np.zeros(2), False, 1)] * len(trials)

    monkeypatch.setattr(together, "lay", laid)
    kinds = [{"speed": v} for v in (0.02, 0.04)]

    def course(extra):
        for how in [kinds[0]] * extra + kinds * 3:
            yield Asked([trial], None, {"discretisation": MESH, **how})
        return extra

    monkeypatch.setattr(together, "resolve_device", lambda device: device)
    assert together.follow([course(k) for k in (0, 0, 1)], device="cuda:0") == [0, 0, 1]
    assert sizes.count(3) == 5 and sum(sizes) == 19


def test_a_sample_covers_what_is_declared():
    spread = Spread.of((0.2, 0.6))
    _, laws, disturbances = zip(*spread.sample(4, ROD), strict=True)
    mus = np.array([law.static for law in laws])
    np.testing.assert_allclose(mus, [0.25, 0.35, 0.45, 0.55])
    told = np.array([(d.lgb_error, d.natural_curvature) for d in disturbances])
    # Opposite in pairs, of 0.8 standard deviations, every corner once.
    np.testing.assert_allclose(told[::2] + told[1::2], 0.0, atol=1e-15)
    np.testing.assert_allclose(np.abs(told), np.broadcast_to([0.825 * 0.03, 0.825 * 0.2], (4, 2)))
    assert len({tuple(np.sign(row)) for row in told}) == 4
    # The one that is left over is in the middle.
    assert [d.lgb_error for _, _, d in spread.sample(3, ROD)][2] == 0.0
    np.testing.assert_allclose(Spread.of(0.5).friction, (0.45, 0.55))


@pytest.mark.parametrize("kind", [lambda rod: rod, wrod.RodModel.of])
def test_a_sample_stretches_less_than_is_believed(kind):
    """Shorter by 0.075 L_gb where it hangs, or by nine tenths of what it stretches."""

    def longer(rod):  # strain is the weight below over the stretching stiffness, along the rod
        return rod.length**2 / (4.0 * rod.stretch_ratio * rod.gravito_bending_length**2)

    soft, stiff = kind(wrod.rod("pink-vps")), kind(wrod.rod("cable"))
    doubles = [Spread.of(0.5).sample(2, rod)[1][0] for rod in (soft, stiff)]
    assert longer(soft) > 1.0
    assert longer(soft) - longer(doubles[0]) == pytest.approx(0.075)
    assert longer(doubles[1]) == pytest.approx(0.1 * longer(stiff))
    assert doubles[0].gravito_bending_length == pytest.approx(0.018)
    assert replace(Spread.of(0.5), stretch=False).sample(2, soft)[0][0] is soft


def test_a_correction_is_kept_for_what_it_saves_every_rod():
    """Not for a mean that one of them makes, nor if one of them can no longer be laid."""
    middle = [[0.0] * 4] * 4

    def told(*errors, diverged=0):
        return {"error_robot": errors, "diverged": diverged, "beside": middle}

    before = told(1.0, 2.0, 3.0, 1.5)
    assert is_better(told(0.9, 1.8, 2.9, 1.4), before)
    assert not is_better(told(1.1, 2.1, 2.0, 1.6), before)
    assert not is_better(told(1.1, 2.1, 3.1, 1.6), before)
    assert not is_better(told(0.9, 1.8, 2.9, 1.4, diverged=1), before)
    assert not is_better(before, before)
    # 1.5 standard errors; as rare as 1 of one are 1.41 of the best of two and 1.62 of three.
    lucky = told(0.9, 1.8, 2.8, 1.59)
    assert [is_better(lucky, before, among) for among in (1, 2, 3)] == [True, True, False]
    # Two steps of one direction are one chance, and only what has to do with neither is another.
    few = np.random.default_rng(7).standard_normal((200, 4, 10))
    nothing = {"error_robot": np.zeros(10), "diverged": 0, "beside": np.eye(10)[:, :4]}
    counts = [independent([nothing | {"error_robot": e} for e in four], nothing) for four in few]
    assert 3.4 < np.mean(counts) <= 4.0  # of ten rods they differ by chance
    far = nothing | {"error_robot": np.full(10, np.inf)}
    assert independent([far], nothing) == 1.0
    noise = np.random.default_rng(3).standard_normal((4, 60))
    start, *others = (
        {"error_robot": x, "diverged": 0, "beside": np.zeros((60, 4))}
        for x in (np.zeros(60), -noise[0], -0.4 * noise[0], *noise[1:])
    )
    assert independent(others[:1], start) == pytest.approx(1.0)
    assert independent(others[:2] + [start], start) == pytest.approx(1.0)
    assert independent(others[1:3], start) == pytest.approx(2.0, abs=0.1)
    assert independent(others[:3], start) == pytest.approx(9.0 / 5.0, abs=0.1)
    assert independent(others[1:], start) == pytest.approx(4.0, abs=0.2)
    # So the lucky one, of three of one direction, is taken.
    way = np.subtract(lucky["error_robot"], before["error_robot"])
    shorter = [told(*(before["error_robot"] + part * way)) for part in (0.4, 0.16)]
    three = [Tried(np.ones(2), 0.0, (0, 0.0), one) for one in (lucky, *shorter)]
    none = Tried(np.zeros(2), 0.0, (0, 1.0), before)
    assert _chosen([none, *three]) is three[0]
    # Where no step promises anything there is nothing to doubt.
    none = Tried(np.zeros(2), 0.0, (0, 0.0), before)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert _chosen([none]) is none


def test_what_rods_happen_to_be_decides_nothing():
    """Softer rods by chance: one plan suits them, and is worse for those in the middle."""
    unseen = Unseen.of(wrod.pattern("line"), ROD, 0.3)
    assert unseen.beside.shape == (10, 4)
    np.testing.assert_allclose(unseen.beside[:, 2], np.linspace(-0.03, 0.03, 10), atol=1e-15)
    assert abs(unseen.beside[:, 3].mean()) < 0.02 and np.ptp(unseen.beside[:, 3]) > 0.7
    noise = 1e-3 * np.random.default_rng(0).standard_normal(10)
    chance = unseen.beside + [0.02, 0.0, 0.0, 0.1]
    saved = -0.003 + chance @ [0.3, 0.01, 0.0, 0.05] + noise
    assert saved.mean() > 0.005
    mean, doubt = balanced(saved, chance)
    assert abs(mean + 0.003) < 3 * doubt < 0.003
    # Too few to tell one from the other.
    assert balanced(saved[:4], chance[:4])[0] == saved[:4].mean()


def test_no_step_is_made_by_derivatives_that_ran_away(bend):
    pattern, trajectory = bend
    run = course(TableTask(pattern, ROD, trajectory, 0.3), samples=1, judge=False)
    asked, count = next(run), 0
    with np.errstate(over="ignore"), pytest.raises(StopIteration) as ended:
        while True:
            count += 1
            s = np.linspace(0.0, pattern.length, 60)
            place = np.pad(pattern.sample(s)[0][:, :2] + 0.002, ((0, 0), (0, 1)))
            rates = np.full((len(asked.directions[0]), 60, 3), 1e200)
            asked = run.send([Laid(s, place, rates, np.zeros(60), False, 1)])
    assert count == 1
    np.testing.assert_array_equal(ended.value.value.position, trajectory.position)


def test_a_grip_that_no_rod_reaches_counts_as_diverged(bend):
    pattern, trajectory = bend
    lgb = ROD.gravito_bending_length
    corrections = Corrections(pattern, trajectory, lgb, 0.05, straight=True)
    spread = Spread.of(0.3)
    problem = descent.Problem(
        TableTask(pattern, ROD, trajectory, 0.3), corrections, spread, 1, True
    )
    s = np.linspace(0.0, pattern.length, 60)
    place = np.pad(pattern.sample(s)[0][:, :2], ((0, 0), (0, 1)))
    rates = np.zeros((corrections.count, 60, 3))
    laid = [Laid(s, place, rates, np.zeros(60), False, 1)]
    values = np.zeros((corrections.knots, 3))
    assert np.isfinite(problem._state(values.ravel(), laid, np.inf).measure)
    values[-1] = 2.0 * ROD.length / lgb  # to the side of where the pattern ends
    assert problem._state(values.ravel(), laid, np.inf).measure == np.inf


def _descended(
    share: float,
    lgb: float,
    ahead: bool = True,
    floor: float = 0.0,
    beside: int = 1,
    goal: float = 2.0,
):
    far = 1.5 * goal**2

    class Far:
        """Three numbers that had better be `goal`; of what that promises a share comes true, and a
        floor is left."""

        alone, is_over = True, False
        corrections = SimpleNamespace(count=3, lgb=lgb)

        def at(self, x):
            value = floor + far - share * (far - 0.5 * float(np.sum((x - goal) ** 2)))
            return State(x, np.array([value]), value, value, np.eye(3), x - goal)
            yield

    with pytest.MonkeyPatch.context() as patch, pytest.raises(StopIteration) as ended:
        patch.setattr(descent, "_FAR", np.inf)
        next(descend(Far(), ahead))
    states, last = ended.value.value
    return [float(x[0]) for x in (*(one.values for one in states), *last[:beside])]


@pytest.mark.parametrize("share, reached", [(1.0, 1.05), (0.6, 1.05), (0.3, 0.525)])
def test_a_step_that_kept_its_promise_is_followed_by_a_longer_one(share, reached):
    np.testing.assert_allclose(_descended(share, 1.0)[:3], [0.0, 0.35, reached])


def test_steps_go_on_only_where_they_save_much_and_much_is_left():
    near = 5.4 / descent._NEAR
    # Each saves what it promises, all from far away; from near the second is not laid by itself.
    np.testing.assert_allclose(_descended(1.0, 1.0), [0.0, 0.35, 1.05, 2.0])
    np.testing.assert_allclose(_descended(1.0, near), [0.0, 0.35, 1.05])
    # It comes in three lengths, and so does the third from far away, the last.
    np.testing.assert_allclose(_descended(1.0, near, beside=3), [0.0, 0.35, 1.05, 0.63, 0.462])
    far = _descended(1.0, 1.0, beside=3, goal=4.0)
    np.testing.assert_allclose(far, [0.0, 0.35, 1.05, 2.45, 1.61, 1.274])
    # Each saves less than a fifth: the second is laid, and one more is the last.
    np.testing.assert_allclose(_descended(1.0, 1.0, floor=12.0), [0.0, 0.35, 1.05, 2.0])
    np.testing.assert_allclose(_descended(1.0, 1.0, False, 12.0), [0.0, 0.35, 1.05])
    # Each saves little of what it promised, and the next is half as long: that ends where no more
    # is promised than a twentieth.
    np.testing.assert_allclose(_descended(0.3, 1.0), [0.0, 0.35, 0.525])
    # From near, too, one that comes after such a step is laid before it is taken for the last.
    np.testing.assert_allclose(_descended(1.0, near, beside=0), [0.0, 0.35])
    np.testing.assert_allclose(_descended(0.3, near, beside=0), [0.0, 0.35, 0.525])


def test_from_far_off_bends_are_corrected_one_after_the_other():
    """An arm of three links of 3 L_gb, each of which is to turn by 1.5 rad: what one does wrong
    moves all that follow."""
    asked = []

    class Arm:
        alone, is_over = True, False
        cost, task = 1e-9 * np.eye(3), SimpleNamespace(pattern=SimpleNamespace(length=9.0))
        corrections = SimpleNamespace(count=3, lgb=1.0)

        def fixed(self, before):
            return int(np.sum(3.0 * np.arange(3) < before))

        def at(self, x, end=np.inf, fixed=0):
            asked.append(end)
            counts = (3.0 * np.arange(1, 4) <= end + 1e-9).repeat(2)

            def joints(turns):
                angle = np.cumsum(turns)
                return np.cumsum(np.column_stack([np.cos(angle), np.sin(angle)]), axis=0).ravel()

            error = counts * (joints(x) - joints(np.full(3, 1.5)))
            nudges = 1e-6 * np.eye(3)
            rates = counts[:, None] * np.array([joints(x + d) - joints(x - d) for d in nudges]).T
            rates /= 2e-6
            size = np.hypot(*error.reshape(-1, 2).T).sum() / counts[::2].sum()
            rates[:, :fixed] = 0.0
            matrix, slope = rates.T @ rates + self.cost, rates.T @ error
            value = 0.5 * float(error @ error)
            return State(x, np.array([size]), size, value, matrix, slope)
            yield

    with pytest.raises(StopIteration) as ended:
        next(descend(Arm(), False))
    states, _ = ended.value.value
    assert states[0].measure > 1.0 and states[-1].measure < 0.05 * states[0].measure
    finite = [end for end in asked if np.isfinite(end)]
    assert finite == sorted(finite) and set(finite) == {3.0, 6.0, 9.0}
    assert np.isinf(asked[0]) and np.isinf(asked[-1])
    # Where the time is over between two bends, what was found by then is laid in whole.
    asked.clear()
    Arm.is_over = property(lambda _: 6.0 in asked)
    with pytest.raises(StopIteration) as ended:
        next(descend(Arm(), False))
    hurried, _ = ended.value.value
    assert 9.0 not in asked and np.isinf(asked[-1])
    assert states[-1].measure < hurried[-1].measure < states[0].measure
    Arm.is_over = False
    # Of many plans that are made together what is far is left.
    Arm.alone = False
    asked.clear()
    with pytest.raises(StopIteration):
        next(descend(Arm(), False))
    assert np.isinf(asked).all()


def test_a_bend_is_not_given_up_for_a_step_that_was_damped():
    """From far off the first saves a fifteenth of the value, and the next is twice as long."""

    class Remote:
        alone, is_over = True, False
        cost, task = np.zeros((3, 3)), SimpleNamespace(pattern=SimpleNamespace(length=3.0))
        corrections = SimpleNamespace(count=3, lgb=1.0)

        def fixed(self, before):
            return 0

        def at(self, x, end=np.inf, fixed=0):
            value = 0.5 * float(np.sum((x - 10.0) ** 2))
            off = float(np.abs(x - 10.0).max())
            return State(x, np.array([off]), off, value, np.eye(3), x - 10.0)
            yield

    with pytest.raises(StopIteration) as ended:
        next(descend(Remote(), False))
    states, _ = ended.value.value
    assert states[1].values == pytest.approx(0.35 * (1 + 2 + 4 + 8))


def test_what_is_fixed_is_not_laid_again(bend):
    """What follows lies as if all had been laid anew, with the derivatives by what is not fixed."""
    pattern, trajectory = bend
    corrections = Corrections(pattern, trajectory, ROD.gravito_bending_length, 0.05)
    task, spread = TableTask(pattern, ROD, trajectory, 0.3), Spread.of(0.3)
    on, whole = (descent.Problem(task, corrections, spread, 2, True) for _ in range(2))
    values = 0.1 * np.sin(np.arange(corrections.count))
    fixed = on.fixed(0.1)
    assert 0 < fixed < len(values)
    together.follow([on.at(values, pattern.length, fixed)])
    values[fixed:] += 0.1
    (now,) = together.follow([on.at(values, pattern.length, fixed)])
    (same,) = together.follow([whole.at(values)])
    for before, after in (one.runs for one in on.remembered):
        assert after.moments[3] is before.moments[3]
    # Steps end at other moments, and are solved to what changes what lies by 0.02 mm.
    assert now.errors == pytest.approx(same.errors, abs=2e-5)
    largest = np.abs(same.slope).max()
    assert now.slope[fixed:] == pytest.approx(same.slope[fixed:], abs=2e-2 * largest)
    assert not now.step(1.0)[0][:fixed].any()


def test_of_plans_with_several_remainders_that_is_taken_by_which_unseen_rods_lie_best(bend):
    def at(error, diverged=0):
        expected = {"error_robot": [error] * 3, "beside": [[0.0] * 4] * 3, "diverged": diverged}
        return replace(bend[1], metadata={**bend[1].metadata, "expected": expected})

    good, worse, lost = at(1.0), at(2.0), at(0.5, diverged=1)
    assert best_of([worse, good, lost]) is good and best_of([lost]) is lost


def test_the_fastest_pace_is_taken_that_does_no_harm(bend):
    def at(pace, *errors):
        expected = {"error_robot": errors, "mean": np.mean(errors), "diverged": 0}
        expected["beside"] = [[0.0] * 4] * 4
        said = {"optimised": {"pace": pace}, "expected": expected}
        return replace(bend[1], metadata={**bend[1].metadata, **said})

    slow, middle = at(0.02, 1.0, 2.0, 3.0, 1.5), at(0.04, 1.1, 1.9, 3.0, 1.6)
    fast = at(0.08, 2.1, 3.0, 4.1, 2.5)
    chosen = _fastest([slow, middle, fast]).metadata["optimised"]
    assert chosen["pace"] == 0.04
    assert [pace for pace, _ in chosen["paces"]] == [0.02, 0.04, 0.08]
    assert _fastest([slow, at(0.08, 1.0, 2.2, 2.9, 1.4)]).metadata["optimised"]["pace"] == 0.08
    paces = [pace_of(at(v, 0.0)) for v in (0.04, "fast", float("nan"), -1.0, None)]
    assert paces == [0.04, None, None, None, None] and pace_of(bend[1]) is None
    with pytest.raises(PatternError, match=r"pace is 0\.0"):
        optimise(bend[0], ROD, bend[1], 0.3, pace=0.0)


def test_misplacement_is_no_error_of_the_plan(bend):
    pattern = bend[0]
    told = Disturbance.random(3)
    s = np.linspace(0.0, pattern.length, 200)
    exact = pattern.sample(s)[0]
    there = told.displaced(exact, exact[0])
    assert robot_error(pattern, s, there, told) < 2e-6  # what chords of 1 mm cut off
    assert robot_error(pattern, s, exact, told) == pytest.approx(
        np.hypot(*(there - exact)[:, :2].T).mean(), rel=0.02
    )


def test_an_arm_follows_as_much_of_a_correction_as_it_can(bend):
    from wrod.commands.plan_steps import _followed
    from wrod.deployment.corrections import with_share
    from wrod.robot.solve import UnreachedError

    pattern, start = bend
    corrections = Corrections(pattern, start, ROD.gravito_bending_length, 0.05)
    corrected = corrections.apply(np.full(corrections.count, 0.5))
    told = corrections.largest(np.full(corrections.count, 0.5))
    corrected.metadata["optimised"] = {**told, "kept": True}
    tried = []

    class Arm:
        """Reaches so far beside what was planned at first [m]."""

        def __init__(self, reach):
            self.reach = reach

        def solve(self, trajectory):
            tried.append(np.linalg.norm(trajectory.position - start.position, axis=1).max())
            if tried[-1] > self.reach:
                raise UnreachedError.__new__(UnreachedError)
            return "joint path"

    within = {}

    def softer(how):
        return with_share(start, corrected, within["share"] if how == "joint path" else how)

    most = 0.016 * np.sqrt(3.0)
    # What was made within the arm's limits is a quarter, or more than it can do all the same.
    for limited, reach, share in (
        (0.9, 0.1, None), (0.25, 0.6 * most, 0.25), (0.9, 0.6 * most, 0.5), (0.9, 1e-9, 0.0),
    ):  # fmt: skip
        within["share"] = limited
        tried.clear()
        path, followed = _followed(Arm(reach), corrected, softer)
        assert path == "joint path"
        assert followed.metadata["optimised"].get("share") == share
        moved = np.linalg.norm(followed.position - start.position, axis=1).max()
        assert moved == pytest.approx(most * (1.0 if share is None else share), abs=1e-12)
        turned = np.linalg.norm(between(start, followed)[:, 3:], axis=1).max()
        assert turned == pytest.approx(followed.metadata["optimised"]["largest_turn"], abs=1e-9)
    assert followed.metadata["optimised"]["largest_correction"] == 0.0
    with pytest.raises(UnreachedError):
        _followed(Arm(-1.0), corrected, softer)
    with pytest.raises(UnreachedError):  # nothing to take back
        _followed(Arm(0.001), corrected, None)


class _Wall:
    """An arm that cannot move its grip by more than bounds (6,) [m, rad]."""

    def __init__(self, bounds):
        self.bounds = bounds

    def excess(self, moves):
        beyond = np.abs(moves) / self.bounds - 1.0
        over = np.nonzero(beyond > 0.0)
        rates = np.zeros((len(over[0]), *moves.shape))
        rates[np.arange(len(over[0])), *over] = (np.sign(moves) / self.bounds)[over]
        return beyond[over], rates


def test_corrections_stay_within_what_an_arm_can_do(bend):
    pattern, trajectory = bend

    def found(limits):
        best = optimise(pattern, ROD, trajectory, 0.3, limits=limits, samples=1, judge=False)
        return between(trajectory, best), best.metadata["optimised"]["errors"]

    free, errors = found(None)
    most = np.abs(free).max(axis=0)
    bound, less = found(_Wall(0.3 * most))
    assert (most > 1e-3).all() and (np.abs(bound).max(axis=0) < 0.35 * most).all()
    assert min(errors) < min(less) < less[0]


@pytest.mark.parametrize("friction", [0.0, -1.0, np.nan, (0.6, 0.2), (0.1, 0.2, 0.3)])
def test_friction_that_is_none_is_refused(friction):
    with pytest.raises((PatternError, GraspError), match="friction is"):
        wrod.plan(wrod.pattern("line"), replace(ROD, length=0.9), friction=friction)


@pytest.mark.parametrize("options", [{}, {"method": "distilled", "friction": 0.3}])
def test_a_time_limit_is_of_what_is_optimised(options):
    with pytest.raises(GraspError, match="time_limit is of a plan"):
        wrod.plan(wrod.pattern("line"), replace(ROD, length=0.9), time_limit=1.0, **options)


def test_the_intuitive_method_is_not_corrected():
    with pytest.raises(GraspError, match="intuitive"):
        wrod.plan(wrod.pattern("line"), replace(ROD, length=0.9), "intuitive", friction=0.3)


def test_a_stretch_of_one_point_is_as_long_as_what_the_point_stands_for():
    ends = np.array([True, False, False, True])
    assert _stretches(np.arange(4.0), ends) == [[0.0, 0.5], [2.5, 3.0]]
    assert _stretches(np.arange(4.0), ~ends) == [[0.5, 2.5]]
