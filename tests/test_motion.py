"""Motion: recordings in, sensitivities, and what is found in motions made by the dynamics."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from wrod.commands import main
from wrod.errors import DataError, WrodWarning
from wrod.identification.effect import Model, effects
from wrod.identification.motion.checks import inertia_share
from wrod.identification.motion.fit import MotionLaboratory
from wrod.identification.motion.inverse import rates_about
from wrod.identification.motion.loading import load_motion, motion_from_arrays, sorted_grips
from wrod.identification.motion.report import identify_motion
from wrod.identification.motion.setup import START_L_GB
from wrod.identification.motion.solver import MotionRun
from wrod.rods.batch import RodBatch
from wrod.rods.law import Plastic
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.statics import EquilibriumSolver, prescribe

GRAVITY, RATE, MARKERS = 9.81, 100.0, 11
EDGE, HELD = 0.075, 0.03
L_GB, CURVATURE, VISCOUS, AIR = 0.16, 4.0, 0.04, 0.5
YIELD, HARDENING = 5.0, 0.4


class Shaking:
    """Moves both held edges of every rod along smooth paths of its own."""

    def __init__(self, batch, path):
        self.batch, self.path = batch, path

    def prescribe(self, running, time, step, start):
        dof = self.batch.state.dof.numpy().copy()
        going = running.numpy() != 0
        ends = self.path(time.numpy() + step.numpy())
        n = self.batch.node_count
        for k, i in enumerate((0, 1, n - 2, n - 1)):
            dof[going, 4 * i : 4 * i + 3] = ends[going, k]
        self.batch.state.dof.assign(dof)


def paths(rods, seed):
    """Held nodes (rod, 4, 3) as a function of (rod,) times: grips that point down and swing."""
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.02, 0.06, (rods, 2, 3, 2))
    rate = rng.uniform(2.0, 7.0, (rods, 2, 3, 2))
    phase = rng.uniform(0.0, 2 * np.pi, (rods, 2, 3, 2))
    centre = np.array([[-0.18, 0.0, 0.0], [0.18, 0.0, 0.0]])

    def at(time):
        t = np.asarray(time)[:, None, None, None]
        ramp = np.minimum(t / 0.3, 1.0)[..., 0] ** 2
        move = centre + ramp * (size * np.sin(rate * t + phase)).sum(axis=-1)
        tilt = 0.15 * ramp[..., 0, 0]
        out = np.zeros((len(t), 4, 3))
        for end, sign in ((0, -1.0), (1, 1.0)):
            lean = np.stack([sign * tilt[:], 0.3 * tilt, -np.ones(len(t))], axis=1)
            lean /= np.linalg.norm(lean, axis=1, keepdims=True)
            inner, outer = move[:, end], move[:, end] - HELD * lean
            out[:, [0, 1] if end == 0 else [3, 2]] = np.stack([outer, inner], axis=1)
        return out

    return at


@pytest.fixture(scope="module")
def recorded():
    return made_recordings(CURVATURE, np.zeros(4), first=60)


def made_recordings(curvature, inelastic, first):
    """Recordings of a viscous rod with a bend of its own, by implicit dynamics on a finer mesh,
    from the frame `first` on; `inelastic` as of `RodBatch`."""
    rods, fine, frames = 8, 4, 70
    inner = (MARKERS - 3) * fine
    rest = np.r_[HELD, np.full(inner, EDGE / fine), HELD]
    n = len(rest) + 1
    at = paths(rods, seed=4)
    ends = at(np.zeros(rods))
    # From a smooth loop between the grips to equilibrium.
    u = np.linspace(0.0, 1.0, inner + 1)[:, None]
    loop = (1 - u) * ends[0, 1] + u * ends[0, 2] - np.array([0, 0, 0.2]) * np.sin(np.pi * u)
    position = np.concatenate([ends[0, :1], loop, ends[0, 3:]])
    position = np.repeat(position[None], rods, axis=0)
    bending = 2.0 * GRAVITY * L_GB**3
    length = 0.5 * (np.r_[rest, 0.0] + np.r_[0.0, rest])
    stiffness = np.full((rods, n, 2), bending)
    natural = np.zeros((rods, n, 2))
    natural[:, :, 0] = curvature
    law = np.tile(np.asarray(inelastic, dtype=float), (rods, n, 1))
    for i in (1, n - 2):
        share = 0.5 * (EDGE / fine) / length[i]
        stiffness[:, i] /= share
        natural[:, i] *= share
        law[:, i, 2] *= share
    batch = RodBatch(
        position,
        rest_length=rest,
        stretching_stiffness=GRAVITY * rest.sum() / 1e-3,
        bending_stiffness=stiffness,
        twisting_stiffness=stiffness[:, :, 0] / 1.5,
        natural_curvature=natural,
        inelastic=law,
        node_mass=length,
        gravity=[0.0, 0.0, -GRAVITY],
        # The first director, m1, is the inside of the loop: the rod is bent the way it hangs.
        director=np.array([1.0, 0.0, 0.0]),
    )
    prescribe(batch, clamped_nodes=(0, 1, -2, -1), clamped_angles=(0, -1))
    assert EquilibriumSolver(batch).solve(ramp_loads=True).converged.all()
    dynamics = Dynamics(
        batch,
        scheme="bdf2",
        radius=4e-3,
        air_damping=AIR,
        internal_damping=VISCOUS,
        motion=Shaking(batch, at),
    )
    place = [0, *range(1, n - 1, fine), n - 1]
    out = []
    for k in range(first + frames):
        assert not dynamics.advance(k / RATE + 1e-9, 2.5e-3).diverged.any() if k else True
        if k >= first:
            out.append(batch.positions()[:, place].copy())
    positions = np.stack(out, axis=1)
    positions += np.random.default_rng(0).normal(0.0, 2e-5, positions.shape)
    return {
        "positions": positions,
        "rate_hz": np.float64(RATE),
        "held": np.array([0, 1, MARKERS - 2, MARKERS - 1]),
        "gravity": np.float64(GRAVITY),
    }


def test_tangents_are_the_derivatives_of_the_motion(recorded):
    laboratory = MotionLaboratory(motion_from_arrays(recorded))
    # A rod has one law of bending: softening's, of which stiffening is the other sign.
    others = "stiffening", "yielding"
    model = Model(tuple(e for e in effects("motion").values() if e.name not in others))
    rng = np.random.default_rng(1)
    values = np.array([0.1 * min(p.scale, 1.0) * rng.uniform(0.5, 1.0) for p in model.parameters])
    check_tangents(laboratory, model, values, 12)


def test_tangents_know_what_a_rod_that_yields_remembers(recorded):
    """Bent, bent back and bent on, also where both directions differ in stiffness."""
    laboratory, known = MotionLaboratory(motion_from_arrays(recorded)), effects("motion")
    own = {
        "stiffness": [0.1], "internal_damping": [0.03], "natural_curvature": [1.0, 0.5],
        "anisotropic_bending": [0.2, 0.1, 0.3], "clamp_length": [0.01, 0.005],
        "yielding": [np.log(2.0), 0.4],
    }  # fmt: skip
    model, values = Model(tuple(known[name] for name in own)), np.concatenate(list(own.values()))
    run = MotionRun(laboratory.windows([0, 1]), RATE, model.setup(laboratory.base, values))
    run.begin()
    run.finish()
    node = run.batch.inelastic.numpy()[:, 1:-1]
    # Back from where they yielded: what lags is inside the bound, but not all of the bend.
    size = np.linalg.norm(node["lagging"], axis=-1)
    back = (size < 0.9 * node["scale"]) & (np.linalg.norm(node["excess"], axis=-1) > 1.1 * size)
    assert back.mean() > 0.1, back.mean()
    check_tangents(laboratory, model, values, None)


def test_steps_begin_where_the_grips_lead_the_rod(recorded):
    """Newton's method begins nearer where grips change their pace, and ends at the same motion."""
    laboratory = MotionLaboratory(motion_from_arrays(recorded))
    windows = laboratory.windows([0, 1, 2])
    pushes = np.random.default_rng(0).normal(0.0, 5.0, (*windows.held.shape[:2], 2, 3))
    moved = np.cumsum(np.cumsum(pushes, axis=1), axis=1) / RATE**2
    held = windows.held + np.repeat(moved, 2, axis=2)
    found = {}
    for kind in (MotionRun, Unled):
        run = kind(replace(windows, held=held), RATE, laboratory.base)
        run.begin()
        found[kind] = run.finish()[0], run.dynamics.iteration_count.numpy().sum()
    (led, few), (unled, many) = found[MotionRun], found[Unled]
    assert few < 0.9 * many, (few, many)
    assert np.abs(led - unled).max() < 1e-6


class Unled(MotionRun):
    def prescribe(self, *at):
        self._hold(*at)


def check_tangents(laboratory, model, values, frames):
    windows = laboratory.windows([0, 1], [5], frames=frames)
    _, rates, _ = laboratory.run(
        windows, model.setup(laboratory.base, values), rates_about(laboratory.base, model, values)
    )
    for j, parameter in enumerate(model.parameters):
        if j % 3 and parameter.key.startswith("curvature_"):
            continue
        step = np.zeros(len(values))
        step[j] = 1e-5
        difference = (
            laboratory.predict(windows, model, values + step)
            - laboratory.predict(windows, model, values - step)
        ) / 2e-5
        scale = np.abs(difference).max()
        assert scale > 0, parameter.key
        assert np.abs(rates[:, :, :, j] - difference).max() < 1e-4 * scale, parameter.key


TRUTH = {
    "stiffness": [3.0 * np.log(L_GB / START_L_GB)],
    "air_damping": [AIR],
    "internal_damping": [VISCOUS],
    "natural_curvature": [CURVATURE, 0.0],
}
NAMES = ("internal_damping", "natural_curvature", "mass_gradient")


@pytest.mark.slow
@pytest.mark.parametrize("more", [{}, {"relaxation": [0.03]}], ids=["", "relaxing"])
def test_damping_and_natural_curvature_are_found(recorded, more):
    """In motions of the same rod on a mesh twice as fine with a third of the time step."""
    m = motion_from_arrays(recorded)
    fine = MotionLaboratory(m, subdivisions=4)
    fine.substeps = 3
    known = effects("motion")
    truth = TRUTH | more
    model = Model(tuple(known[name] for name in truth))
    everything = fine.windows(range(m.recording_count))
    moved = fine.predict(everything, model, np.concatenate(list(truth.values())))
    moved[:, 2:] += np.random.default_rng(3).normal(0.0, 2e-5, moved[:, 2:].shape)
    data = _with(recorded, positions=moved)
    report = identify_motion(motion_from_arrays(data), candidates=(*NAMES, "relaxation"))
    content = report.to_dict()
    found = {e["name"]: e["parameters"] for e in content["effects"]}
    assert set(found) == {"internal_damping", "natural_curvature", *more}
    for name, (value,) in more.items():
        assert found[name]["relaxation_time"]["value"] == pytest.approx(value, rel=0.03)
    # Gentle motions: the bend is seen less than the damping, which the base model has already.
    assert content["after_mm"] < 0.3 * content["before_without_internal_damping_mm"]
    assert content["after_mm"] < 0.7 * content["before_mm"]
    # The mesh alone would make the curvature 12 % too large.
    assert found["internal_damping"]["viscous_time"]["value"] == pytest.approx(VISCOUS, rel=0.01)
    assert found["natural_curvature"]["curvature"]["value"] == pytest.approx(CURVATURE, rel=0.01)
    assert content["base"]["stiffness"]["L_gb"]["value"] == pytest.approx(L_GB, rel=0.01)


@pytest.mark.slow
def test_independent_dynamics_show_the_same_effects(recorded, tmp_path):
    """`wrod.Dynamics` damps the rate of forces instead of strains, which turns with the rod."""
    report = identify_motion(motion_from_arrays(recorded), candidates=NAMES)
    content = report.to_dict()
    found = {e["name"]: e["parameters"] for e in content["effects"]}
    assert set(found) >= {"internal_damping", "natural_curvature"}
    # What is left is the mesh's: coarser than the one that made the motions, and another law.
    assert content["after_mm"] < 0.7 * content["before_without_internal_damping_mm"]
    assert content["after_mm"] < 0.2
    assert found["internal_damping"]["viscous_time"]["value"] == pytest.approx(VISCOUS, rel=0.15)
    assert content["base"]["stiffness"]["L_gb"]["value"] == pytest.approx(L_GB, rel=0.05)
    written = {path.name for path in report.save(tmp_path)}
    assert written == {"report.json", "report.html", "model.json"}
    assert "data:image/png;base64," in (tmp_path / "report.html").read_text()


@pytest.mark.slow
def test_a_rod_that_yields_is_told_from_one_that_softens():
    """By `Dynamics` with four edges where two are fitted, and its own damping; unloading tells."""
    law = Plastic(YIELD, HARDENING)
    made = made_recordings(0.0, law.inelastic, first=1)
    names = ("yielding", "softening", "stiffening", "relaxation", "natural_curvature")
    report = identify_motion(motion_from_arrays(made), candidates=names)
    parts = {e.name: e.parameters for e in report.effects}
    assert set(parts) == {"internal_damping", "yielding"}
    found = parts["yielding"]
    assert found["yield_curvature"].value == pytest.approx(YIELD, rel=0.05)
    assert 1.0 - found["hardening"].value == pytest.approx(1.0 - HARDENING, rel=0.05)
    assert report.base["stiffness"]["L_gb"].value == pytest.approx(L_GB, rel=0.02)
    first = report.selection.rounds[1].candidates
    left = {c.name: c.validation for c in first}
    assert left["yielding"] < 0.5 * left["softening"]
    # What is found is a rod that remembers, as simulations and plans take it.
    assert isinstance(report.model.law, Plastic)


def test_lost_frames_are_counted_and_survived(recorded):
    data = dict(recorded)
    x = recorded["positions"]
    kept = np.r_[0:20, 24:60]
    data["positions"] = x[:, kept]
    m = motion_from_arrays(data)
    assert m.gap[:, 19].tolist() == [5] * len(x)
    assert (m.gap == 1).sum() == m.gap.size - len(x)
    laboratory = MotionLaboratory(m)
    whole = MotionLaboratory(motion_from_arrays(recorded))
    model, values = Model(), np.zeros(0)
    cut = laboratory.predict(laboratory.windows([0]), model, values)
    full = whole.predict(whole.windows([0], frames=60), model, values)[:, kept]
    # The same motion but for the grips' path through the gap; ten times less than ignoring it.
    assert np.abs(cut - full).max() < 4e-3


def test_exchanged_grip_markers_are_put_back(recorded):
    data = dict(recorded)
    data["positions"] = recorded["positions"].copy()
    data["positions"][3, 10:, [-2, -1]] = data["positions"][3, 10:, [-1, -2]]
    m = motion_from_arrays(data)
    assert m.repaired.tolist() == [0, 0, 0, len(recorded["positions"][0]) - 10, 0, 0, 0, 0]
    np.testing.assert_array_equal(m.positions, recorded["positions"])


def test_a_rod_that_swings_past_its_grip_is_no_exchange_of_markers(recorded):
    x = recorded["positions"].copy()
    x[3, 20:26, 2] = x[3, 20:26, 0] + [0.01, 0.0, 0.0]
    sorted_x, repaired = sorted_grips(x)
    assert repaired.sum() == 0
    np.testing.assert_array_equal(sorted_x, x)
    x[3, 10:23, [0, 1]] = x[3, 10:23, [1, 0]]
    assert sorted_grips(x)[1].tolist() == [0, 0, 0, 13, 0, 0, 0, 0]


def test_other_recordings_are_scored_and_never_fitted(recorded):
    m = motion_from_arrays(recorded)
    both = m.scored_on(motion_from_arrays(recorded, name="others"))
    assert both.test.tolist() == list(range(8, 16))
    assert np.intersect1d(both.fit, both.validation).size == 0
    assert max(*both.fit, *both.validation) < 8
    slower = motion_from_arrays(_with(recorded, rate_hz=np.float64(50.0)), name="slower")
    with pytest.raises(DataError, match=r"slower has rate 50.0, but recordings has 100.0"):
        m.scored_on(slower)


def _with(recorded, **change):
    return {**recorded, **change}


HELD_MARKERS = np.array([0, 1, MARKERS - 2, MARKERS - 1])


def mixed(data, recording, markers, order):
    """Positions with the markers of a recording in another order."""
    x = data["positions"].copy()
    x[recording][..., markers, :] = data["positions"][recording][..., order, :]
    return x


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda d: {"positions": 1e3 * d["positions"]}, "must be in metres"),
        (lambda d: {"positions": d["positions"][:1]}, "has 1 recording; at least 2 are needed"),
        (
            lambda d: {"positions": d["positions"][..., :2]},
            "it must have \\(recording, frame, marker, 3\\)",
        ),
        (lambda d: {"held": np.array([0, 1, 2, 3])}, "held is"),
        (lambda d: {"rate_hz": np.float64(0.0)}, "rate_hz is 0 Hz; it must be at least 2"),
        (lambda d: {"rate_hz": np.float64(1e5)}, "check rate_hz"),
        (lambda d: {"gravity": np.array("g")}, "gravity holds .* values; it must hold numbers"),
        (lambda d: {"gravity": np.float64(981.0)}, "gravity is 981 m/s.2; .*at most 30 .mm/s.2"),
        (lambda d: {"gravity": np.float64(-9.81)}, "gravity is -9.81 m/s.2; it must be above 0"),
        (
            lambda d: {"positions": d["positions"][0]},
            "it must have \\(recording, frame, marker, 3\\)",
        ),
        (
            lambda d: {"positions": mixed(d, slice(None), HELD_MARKERS, HELD_MARKERS[::-1])},
            "are the markers of the two grips exchanged",
        ),
        (
            lambda d: {"positions": mixed(d, 5, HELD_MARKERS, HELD_MARKERS[::-1])},
            "of recording 5 are .* apart",
        ),
        (
            lambda d: {"positions": mixed(d, 5, np.arange(MARKERS), np.arange(MARKERS)[::-1])},
            "in recording 5 each grip is where the others have the other one",
        ),
        (lambda d: {"file_ids": np.array(["a"])}, "file_ids has shape"),
    ],
)
def test_bad_data_are_named_in_a_sentence(recorded, change, sentence):
    with pytest.raises(DataError, match=sentence):
        motion_from_arrays(_with(recorded, **change(recorded)))


def test_a_marker_lost_for_a_few_frames_costs_no_recording(recorded):
    x = recorded["positions"].copy()
    x[2, 7:10, 4] = np.nan
    m = motion_from_arrays(_with(recorded, positions=x))
    assert m.filled == 3
    assert np.abs(m.positions[2, 7:10, 4] - recorded["positions"][2, 7:10, 4]).max() < 2e-4


def test_a_lost_marker_is_named(recorded):
    x = recorded["positions"].copy()
    x[2, 7:20, 4, 1] = np.nan
    with pytest.raises(DataError, match="marker 4 of recording 2 is not finite in frame 7"):
        motion_from_arrays(_with(recorded, positions=x))


def test_markers_in_another_order_are_named(recorded):
    x = recorded["positions"].copy()
    x[5, :, [2, 4]] = x[5, :, [4, 2]]
    with pytest.raises(DataError, match=r"of recording 5 are .* apart"):
        motion_from_arrays(_with(recorded, positions=x))


@pytest.mark.parametrize("share", [1.0, 0.05])
@pytest.mark.parametrize("markers", ["inner", "two"])
def test_markers_shuffled_anew_in_every_frame_are_named(recorded, markers, share):
    rng = np.random.default_rng(0)
    x = recorded["positions"].copy()
    part = np.arange(2, MARKERS - 2) if markers == "inner" else np.array([3, 4])
    for frames in x:
        for frame in frames:
            if rng.random() < share:
                frame[part] = frame[rng.permutation(part)]
    with pytest.raises(DataError, match=r"apart in frame .* sort the markers"):
        motion_from_arrays(_with(recorded, positions=x))


def test_bad_data_end_a_command_with_one_sentence(recorded, tmp_path):
    path = tmp_path / "motion.npz"
    np.savez(path, **_with(recorded, positions=1e3 * recorded["positions"]))
    result = CliRunner().invoke(main, ["identify", str(path), "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1 and "must be in metres" in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_file_without_a_field_is_named(recorded, tmp_path):
    path = tmp_path / "motion.npz"
    np.savez(path, **{k: v for k, v in recorded.items() if k != "gravity"})
    with pytest.raises(DataError, match="lacks the array gravity"):
        load_motion(path)


def test_inertia_balances_gravity_about_the_line_of_the_grips():
    """A rigid frame that swings about two points at its own period has a share of 1."""
    along = np.linspace(0.0, 0.6, 12)[1:-1]
    along = np.r_[-0.02, 0.0, along[1:-1], 0.6, 0.62]
    depth = 0.2 * np.sin(np.pi * np.clip(along, 0.0, 0.6) / 0.6)
    frame = np.column_stack([along, depth])
    inner = frame[1:-1]
    edge = np.hypot(*np.diff(inner, axis=0).T)
    weight = 0.5 * (np.r_[edge, 0.0] + np.r_[0.0, edge])
    pull = np.sqrt(GRAVITY * (weight @ inner[:, 1]) / (weight @ inner[:, 1] ** 2))
    angle = 0.02 * np.sin(pull * np.arange(400) / 200.0)[None, :, None]
    x, z = np.broadcast_arrays(along, 0.0 * angle)[0], -depth * np.cos(angle)
    positions = np.stack([x, depth * np.sin(angle), z], axis=-1)
    for times in (1.0, 0.2):
        share, together = inertia_share(positions, times * 200.0, GRAVITY)
        assert share == pytest.approx(times**2, rel=3e-3) and together > 0.999


def test_a_slow_motion_is_doubted(recorded):
    """A fifth of the rate is too slow for this stiff rod, whose share is 4.8, and for cables."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", WrodWarning)
        motion_from_arrays(recorded)
    for share in (5.0, 10.0):
        with pytest.warns(WrodWarning, match=r"times faster than rate_hz"):
            motion_from_arrays(_with(recorded, rate_hz=np.float64(recorded["rate_hz"] / share)))
