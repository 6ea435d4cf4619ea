"""Splits, steps and starts of the fits to motions, and the summary of their cross-validation."""

import json
from copy import copy

import numpy as np
import pytest
from click.testing import CliRunner

from wrod.bench.cables import command, lines, summary
from wrod.errors import DataError
from wrod.identification.effect import Effect, Model, Parameter, effects
from wrod.identification.motion import report, selection
from wrod.identification.motion import solver as motion_solver
from wrod.identification.motion.data import folds, noise_in_time, split_evenly, with_test
from wrod.identification.motion.fit import Linearised, MotionLaboratory
from wrod.identification.motion.inverse import rates_about
from wrod.identification.motion.linearised import correlations_of, losses_of, promises_of
from wrod.identification.motion.loading import motion_from_arrays
from wrod.identification.motion.remembered import KnownSteps
from wrod.identification.motion.selection import select_motion, verdict_of
from wrod.identification.motion.solver import MotionRun, Runs
from wrod.identification.motion.tangents import COMPLEX_STEP

RECORDINGS, FRAMES, MARKERS = 12, 16, 9


def swung_arcs() -> np.ndarray:
    """(R, F, M, 3) arcs between two grips that point down, swung along with them."""
    s = np.linspace(0.0, np.pi, MARKERS - 2)
    arc = 0.2 * np.stack([-np.cos(s), 0.0 * s, -np.sin(s)], axis=1)
    up = np.array([0.0, 0.0, 0.03])
    arc = np.concatenate([arc[:1] + up, arc, arc[-1:] + up])
    time = np.arange(FRAMES)[None, :, None] / 100.0
    phase = np.arange(RECORDINGS)[:, None, None]
    swing = 0.05 * np.concatenate([np.sin(6 * time + phase), np.cos(5 * time + phase)], axis=2)
    positions = np.broadcast_to(arc, (RECORDINGS, FRAMES, MARKERS, 3)).copy()
    positions[..., :2] += swing[:, :, None]
    return positions


@pytest.fixture(scope="module")
def measured():
    return motion_from_arrays(recorded(swung_arcs()))


def recorded(positions) -> dict:
    held = np.array([0, 1, MARKERS - 2, MARKERS - 1])
    return {"positions": positions, "rate_hz": 100.0, "held": held, "gravity": 9.81}


@pytest.mark.parametrize("contiguous", [False, True])
def test_every_recording_is_in_one_fold(contiguous):
    parts = folds(56, 7, contiguous=contiguous)
    assert sorted(np.concatenate(parts)) == list(range(56))
    steps = {int(np.diff(p).max()) for p in parts}
    assert steps == ({1} if contiguous else {7})


def test_no_recording_has_two_parts(measured):
    for m in (measured, with_test(measured, np.array([0, 5]))):
        parts = np.concatenate([m.fit, m.validation, m.test])
        assert sorted(parts) == list(range(RECORDINGS))
    assert [len(p) for p in split_evenly(56)] == [32, 16, 8]


def test_a_part_of_a_linearised_problem_is_that_of_the_smaller_model(measured):
    rod, known = MotionLaboratory(measured), effects("motion")
    small = Model((known["stiffness"], known["internal_damping"]))
    large = Model((known["stiffness"], known["natural_curvature"], known["internal_damping"]))
    windows = rod.windows([0, 1])
    part = rod.linearise(windows, large, np.array([0.1, 0.0, 0.0, 0.05])).part(np.array([0, 3]))
    alone = rod.linearise(windows, small, np.array([0.1, 0.05]))
    np.testing.assert_allclose(part.hessian, alone.hessian, rtol=1e-9)
    np.testing.assert_allclose(part.gradient, alone.gradient, rtol=1e-9)
    moved = rod.step(windows, small, np.array([0.1, 0.05]), part)
    assert rod.cost(windows, small, moved) < alone.cost


def test_fewer_recordings_than_parameters_leave_no_estimate_without_error(measured):
    rod, known = MotionLaboratory(measured), effects("motion")
    names = ("stiffness", "air_damping", "internal_damping", "natural_curvature")
    model = Model(tuple(known[name] for name in names))
    at = rod.linearise(rod.windows([0, 1]), model, np.array([0.1, 0.3, 0.05, 0.2, 0.0]))
    error = np.sqrt(np.diag(at.covariance))
    correlation = at.covariance / np.outer(error, error)
    assert np.linalg.eigvalsh(correlation)[0] > 1e-6


def test_motions_that_do_not_converge_cost_what_they_miss(measured, monkeypatch):
    rod, known = MotionLaboratory(measured), effects("motion")
    model = Model((known["stiffness"],))
    windows = rod.windows([0, 1])
    whole = rod.cost(windows, model, np.array([0.0]))
    monkeypatch.setattr(motion_solver, "_MAX_ITERATIONS", 0)
    stopped = rod.linearise(windows, model, np.array([0.0]))
    assert stopped.failed == 2
    # They stay where they were: centimetres off after a sixth of a second, not without bounds.
    assert whole < stopped.cost < 0.1
    assert stopped.gradient == 0.0


def test_twist_starts_where_newton_fails(measured, monkeypatch):
    """Bends of its own across the arc, and a roll: the even twist is far from equilibrium."""
    rod, known = MotionLaboratory(measured), effects("motion")
    model = Model((known["natural_curvature_profile"], known["grip_roll"]))
    values = np.r_[np.random.default_rng(6).normal(0.0, 25.0, 20), 2.0]
    setup = model.setup(rod.base, values)
    run = MotionRun(rod.windows([0], frames=3), measured.rate, setup)
    run.begin()
    assert not run.finish()[2].any()


@pytest.mark.parametrize("names", [("natural_curvature", "relaxation"), ("yielding",)])
@pytest.mark.parametrize("substeps", [1, 2])
def test_a_run_in_the_arrays_of_another_is_as_one_in_its_own(measured, names, substeps):
    """Bit for bit, of other recordings and with other values; one of another kind has its own."""
    rod, known = MotionLaboratory(measured), effects("motion")
    model = Model(tuple(known[n] for n in ("stiffness", "internal_damping", *names)))
    size = np.array([min(p.scale, 1.0) for p in model.parameters])
    runs, alone = Runs(), []
    for first, share in ((0, 0.1), (2, 0.05), (1, 0.2)):
        values = share * size
        given = rod.windows([first, first + 1]), measured.rate, model.setup(rod.base, values)
        given = (*given, rates_about(rod.base, model, values))
        run = runs.begun(*given, substeps=substeps)
        found = run.finish()
        runs.keep([run])
        alone.append(MotionRun(*given, substeps=substeps))
        assert run is not alone[-1] and run.kind == alone[0].kind
        alone[-1].begin()
        for own, apart in zip(found, alone[-1].finish(), strict=True):
            np.testing.assert_array_equal(own, apart)
        assert run.dynamics.is_recorded and len(runs._kept) == 1
    other = runs.begun(*given[:3], substeps=substeps)
    assert other is not run and other.kind != run.kind


class _Linear(MotionLaboratory):
    """Motions that are linear in effects that move every marker alike; truth is a + b, and a mesh
    of this edge lacks a shift upwards and moves markers as no rod does."""

    edge = 1.0

    def __init__(self, measurements, lacking=0.0):
        super().__init__(measurements)
        self.base.shift, self.lacking = np.zeros(3), np.array([0.0, 0.0, lacking])
        self.base.by_edges = np.zeros(3)
        self.noise = np.random.default_rng(0).normal(0.0, 1e-4, measurements.positions.shape)

    def run(self, windows, setup, rates=()):
        frames = np.minimum(windows.start[:, None] + np.arange(windows.seen.shape[1]), FRAMES - 1)
        noise = self.noise[windows.recording[:, None], frames]

        def moved(setup):
            return setup.shift + self.edge**2 * (setup.by_edges - self.lacking)

        x = windows.markers + noise + np.real(moved(setup)) - [2e-3, 2e-3, 0.0]
        columns = [np.imag(moved(r)) / COMPLEX_STEP for r in rates]
        rate = np.zeros((*x.shape[:3], len(rates), 3))
        rate[:] = np.array(columns).reshape(-1, 3)
        return x, rate, np.zeros(len(x), dtype=bool)

    @property
    def _halved(self):
        half = copy(self)
        half.edge = self.edge / 2.0
        return half


class _Shift(Effect):
    kinds = ()

    def __init__(self, name, direction):
        self.name, self.direction = name, np.array(direction)
        self.parameters = (Parameter("size", "m", 1.0),)

    def apply(self, setup, values):
        setup.shift = setup.shift + values[0] * self.direction


class _OfEdges(_Shift):
    def apply(self, setup, values):
        setup.by_edges = setup.by_edges + values[0] * self.direction


def test_an_effect_that_later_ones_make_idle_leaves_again(measured):
    """The first explains most of a + b at once, and something that is not there."""
    shifts = [("most", (1, 1, 0.5)), ("a", (1, 0, 0)), ("b", (0, 1, 0))]
    selection = select_motion(_Linear(measured), [_Shift(*shift) for shift in shifts])
    steps = [r.accepted or r.removed for r in selection.rounds]
    assert steps[1] == "most"
    assert selection.rounds[-1].removed == "most"
    assert sorted(selection.model.names[3:]) == ["a", "b"]
    np.testing.assert_allclose(selection.values[3:], 2e-3, rtol=0.05)
    # Where nothing is damped no fit can say that something is.
    assert selection.rounds[0].accepted is None
    assert selection.after < 0.1 * selection.before


def test_an_effect_that_makes_up_for_the_mesh_is_refused(measured):
    """One would stand for what the mesh lacks, the other is nothing where edges are short."""
    shifts = [_Shift("up", (0, 0, 1)), _Shift("a", (1, 0, 0)), _OfEdges("b", (0, 1, 0))]
    selection = select_motion(_Linear(measured, lacking=1e-3), shifts)
    assert selection.model.names[3:] == ("a",)
    np.testing.assert_allclose(selection.values[3:], 2e-3, rtol=0.05)
    assert selection.rounds[-1].reason.startswith("b lowers the validation error by")
    assert selection.rounds[-1].reason.endswith("it makes up for them")
    promise = {c.name: c.promise for c in selection.rounds[-1].candidates}
    assert promise["up"] < 1e-3 < promise["b"]


def test_a_parameter_at_its_bound_is_no_explanation(measured):
    """What the shift is bounded by stands for more; the rest is noise."""

    class Bounded(_Shift):
        parameters = (Parameter("size", "m", 1.0, upper=1.95e-3),)

        def __init__(self, name, direction):
            self.name, self.direction = name, np.array(direction)

    selection = select_motion(_Linear(measured), [Bounded("a", (1, 1, 0))])
    assert selection.at_bound == ("size",)
    verdict, reason = verdict_of(selection, 2e-4)
    assert verdict == "partly-explained" and "size ended at a bound" in reason
    free = select_motion(_Linear(measured), [_Shift("a", (1, 1, 0))])
    assert free.at_bound == () and verdict_of(free, 2e-4)[0] == "explained"


@pytest.mark.parametrize("correlation", [0.0, 0.7, 0.95])
def test_noise_in_time_is_told_by_what_is_rigid(correlation):
    """Two grips that fly about; white noise of 20 um and AR(1) noise of 50 um."""
    rng = np.random.default_rng(3)
    frames = np.zeros((30, 300, 4, 3))
    frames[:, :, [1, 3], 2] = 0.03
    path = 0.2 * np.sin(np.linspace(0.0, 20.0, 300))[None, :, None, None] * rng.normal(size=3)
    noise = rng.normal(size=frames.shape)
    for k in range(1, 300):
        kept = np.sqrt(1.0 - correlation**2)
        noise[:, k] = correlation * noise[:, k - 1] + kept * noise[:, k]
    white = 2e-5 * rng.normal(size=frames.shape)
    found = noise_in_time(frames + path + 5e-5 * noise + white)
    assert found.std == pytest.approx(np.hypot(5e-5, 2e-5), rel=0.08)
    if correlation:
        assert found.correlation == pytest.approx(correlation, abs=0.03)
        assert found.slow == pytest.approx(5e-5, rel=0.08)
    assert noise_in_time(frames[:, :10]) is None


def test_a_loss_is_that_of_the_other_parameters_fitted_anew():
    class Quadratic:
        def linearise(self, windows, model, values):
            return Linearised(2.0, np.array([[2.0, 1.0], [1.0, 3.0]]), None, 0.0, 0, None)

    model = Model((_Shift("a", (1, 0, 0)), _Shift("b", (0, 1, 0))))
    loss = losses_of(Quadratic(), None, model, np.array([0.5, 2.0]))
    assert loss == pytest.approx(
        {"a": 0.5 * 0.25 * (2 - 1 / 3) / 2, "b": 0.5 * 4 * (3 - 1 / 2) / 2}
    )


@pytest.mark.parametrize("rank", [1, 9])
def test_effects_correlate_as_their_covariance_says(rank):
    """Also where recordings tell one combination alone: an identification ended there."""
    jacobian = np.random.default_rng(2).normal(size=(rank, 4))
    hessian = jacobian.T @ jacobian * [[1e6], [1.0], [1.0], [1e-6]] * [1e6, 1.0, 1.0, 1e-6]

    class Fitted:
        def linearise(self, windows, model, values):
            return Linearised(2.0, hessian, np.zeros(4), 0.0, 0, hessian)

    two = tuple(_Shift(name, (1, 0, 0)) for name in "ab")
    for effect in two:
        effect.parameters *= 2
    _, found = correlations_of(Fitted(), None, Model(two), np.zeros(4), [])
    expected = 1.0
    if rank > 1:
        c = np.linalg.inv(hessian)
        squares = np.linalg.solve(c[:2, :2], c[:2, 2:]) @ np.linalg.solve(c[2:, 2:], c[2:, :2])
        expected = np.sqrt(np.linalg.eigvals(squares).real.max())
    assert found[0, 1] == pytest.approx(expected, rel=1e-6)


def test_candidates_are_linearised_about_the_present_model():
    """A softening that starts at once with a stiffening doubled the rod's stiffness for all."""

    class Recorder:
        misfit, calls = None, []

        def linearise(self, windows, model, values):
            self.calls.append((model, values))
            n = len(values)
            return Linearised(2.0, np.eye(n), np.arange(n) + 1.0, 0.0, 0, np.eye(n))

    known = effects("motion")
    left = [known[n] for n in ("natural_twist", "softening", "stiffening", "gravity_tilt")]
    rod, base = Recorder(), Model((known["stiffness"],))
    found = promises_of(rod, None, base, np.array([0.3]), left)
    assert [values[0] for _, values in rod.calls] == [0.3] * 3
    moved = [{e.name for e, v in zip(m.effects[1:], m.split(x)[1:], strict=True) if v.any()}
             for m, x in rod.calls]  # fmt: skip
    assert moved == [set(), {"softening"}, {"stiffening"}]
    sizes = {effect.name: len(at.gradient) for _, effect, _, at in found}
    assert sizes == {"natural_twist": 2, "softening": 3, "stiffening": 3, "gravity_tilt": 3}
    assert found[0][1].name == "gravity_tilt"


def _row(fold, base, after, rounds):
    return {
        "rod": "cable",
        "fold": fold,
        "undamped_mm": 1.2 * np.mean(base),
        "base_mm": {f"{fold}-{k}": v for k, v in enumerate(base)},
        "after_mm": {f"{fold}-{k}": v for k, v in enumerate(after)},
        "rounds": [
            {"accepted": a, "removed": r, "test_mm": t, "validation_mm": t} for a, r, t in rounds
        ],
        "effects": [a for a, _, _ in rounds[1:] if a],
        "cpu_seconds": 10.0,
    }


def test_shares_add_up_to_the_drop():
    rows = [
        _row(0, [8.0, 10.0, 9.0], [3.0, 4.0, 5.0],
             [("damping", None, 9.5), ("bend", None, 6.0), ("tilt", None, 5.0), (None, None, 5.0)]),
        _row(1, [6.0], [2.0], [("damping", None, 6.5), ("bend", None, 3.0), (None, "bend", 3.5)]),
    ]  # fmt: skip
    found = summary(rows)
    # Recordings count alike, whatever their fold.
    assert found["base_mm"] == pytest.approx((8 + 10 + 9 + 6) / 4)
    assert found["after_mm"] == pytest.approx((3 + 4 + 5 + 2) / 4)
    assert found["share_mm"] == pytest.approx(
        {"bend": 0.75 * 3.5 + 0.25 * (3.5 - 0.5), "tilt": 0.75 * 1.0}
    )
    total = sum(found["share_mm"].values()) + found["last_fit_mm"]
    assert total == pytest.approx(found["base_mm"] - found["after_mm"])
    assert "1 of 2 folds" in "\n".join(lines(found))


def test_too_many_folds_are_named(measured, tmp_path):
    np.savez(tmp_path / "rod.npz", **recorded(measured.positions[:4]))
    result = CliRunner().invoke(command, ["--data", str(tmp_path), "--folds", "4"])
    assert "4 recordings in 4 folds leave less than 4" in str(result.exception)


def test_an_identification_that_was_stopped_goes_on(measured, tmp_path, monkeypatch):
    steps, worked = tmp_path / "steps.jsonl", []
    for size in ("_SHORT", "_MEDIUM", "_WHOLE"):
        monkeypatch.setattr(selection, size, (None, 2))

    def select(say=None, **kept):
        return select_motion(MotionLaboratory(measured, subdivisions=1, **kept), [], progress=say)

    def stop(text):
        if text == "whole recordings":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        select(stop, remembered=KnownSteps(steps, measured))
    lines = steps.read_text().splitlines()
    row = json.loads(lines[-1])
    for name, value in {"cost": 0.0, "more": [1], "misfit": "x"}.items():
        row["found"][name] = value
        steps.write_text("\n".join([*lines[:-1], json.dumps(row), ""]))
        with pytest.raises(DataError, match=f"line {len(lines)}: is damaged; delete that line"):
            KnownSteps(steps, measured)
    for damaged in ("{}", "[]", '{"step": 1}', "\0", '{"step": "a", "found": {"a": ' + 40 * "["):
        steps.write_text("\n".join([*lines[:-1], damaged, ""]))
        with pytest.raises(DataError, match=r"steps\.jsonl"):
            KnownSteps(steps, measured)
    steps.write_text("\n".join([*lines, '{"step": "half a li']))
    linearised = MotionLaboratory._linearised

    def _linearised(self, windows, model, values):
        worked.append(len(windows.recording))
        return linearised(self, windows, model, values)

    monkeypatch.setattr(MotionLaboratory, "_linearised", _linearised)
    remembered = KnownSteps(steps, measured)
    ran = []

    def run(self, *asked):
        ran.append(asked)
        return moved(self, *asked)

    moved = MotionLaboratory.run
    monkeypatch.setattr(MotionLaboratory, "run", run)

    def nothing_ran(text):
        if text == "whole recordings":
            assert not ran

    resumed, after = select(nothing_ran, remembered=remembered), len(worked)
    assert ran
    whole = select()
    assert 0 < after < (len(worked) - after) / 2
    assert np.array_equal(resumed.values, whole.values)
    assert (resumed.before, resumed.after) == (whole.before, whole.after)
    with pytest.raises(DataError, match="other settings"):
        KnownSteps(steps, with_test(measured, np.array([0, 5])))
    remembered.forget()
    assert not steps.exists()


def test_steps_of_more_work_than_an_identification_stay(measured, tmp_path, monkeypatch):
    """A loop that is stopped while it plans does not identify the cable anew."""

    def select(laboratory, *_, **__):
        laboratory.cost(laboratory.windows([0], frames=4), Model(()), np.zeros(0))

    monkeypatch.setattr(report, "select_motion", select)
    monkeypatch.setattr(report, "_report", lambda *_: None)
    path = tmp_path / "steps.jsonl"
    report.identify_motion(measured, steps=path, evidence=False)
    assert not path.exists()
    report.identify_motion(measured, steps=KnownSteps(path, measured), evidence=False)
    assert len(path.read_text().splitlines()) == 2


def test_of_what_is_as_good_the_one_with_fewest_parameters_goes_ahead():
    """5.998 and 6.005 mm decided whether the hard block of a cable was predicted to 12 or 13 mm."""

    def one(name, parameters, validation):
        values = np.zeros(parameters)
        return selection._Fitted(name, values, None, None, validation)

    profile, law = one("profile", 3, 5.998), one("law", 2, 6.005)
    worse, worst = one("one", 1, 6.2), one("drag", 1, 9.9)
    found = selection._in_order([worst, worse, profile, law])
    assert [f.model for f in found] == ["law", "profile", "one", "drag"]
