"""Clamped rods are found on a stable branch, the one that was measured."""

import numpy as np
import pytest
from hidden import COARSE, SETS, coarse, draw, kept

from wrod.identification.clamped import steps
from wrod.identification.clamped.branches import to_measured
from wrod.identification.clamped.equilibria import ClampedSolver
from wrod.identification.clamped.fit import fit_models, solved
from wrod.identification.clamped.held_out import held_out_error
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.loading import measurements_from_arrays
from wrod.identification.clamped.setup import ClampedSetup
from wrod.identification.clamped.steps import base_fit, extensions, leaner
from wrod.identification.clamped.verdict import Round
from wrod.identification.effect import Effect, Model, effects, unknowns
from wrod.rods.material import RodMaterial

# Upright: the tangent of clamp A points up, that of the gripper down; m1 along x.
UP = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]) @ np.diag([1.0, -1.0, 1.0])
DOWN = np.diag([-1.0, 1.0, -1.0])


def arch(length, apart, l_gb, tilt=0.0, trials=2, height=0.36):
    """Measurements of a rod that stands over two clamps in the plane y = 0, without markers yet."""
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    rod = RodMaterial(0.001, l_gb, length)
    s = np.linspace(0.0, length, 21)
    u = np.pi * s / length
    shape = np.stack([0.5 * apart * (1 - np.cos(u)), 0 * s, height * length * np.sin(u)], axis=1)
    return {
        "centerline": np.repeat((shape @ turn.T)[None], trials, axis=0),
        "arc_length": s,
        "clamp_position": np.zeros((trials, 3)),
        "clamp_rotation": np.repeat((turn @ UP)[None], trials, axis=0),
        "grip_position": np.repeat([[apart, 0.0, 0.0]], trials, axis=0),
        "grip_rotation": np.repeat((turn @ DOWN)[None], trials, axis=0),
        "train_idx": np.arange(trials - 1) if trials > 2 else np.arange(2),
        "test_idx": np.array([], dtype=int),
        "length": rod.length,
        "radius": rod.radius,
        "density": rod.density,
        "L_gb": rod.gravito_bending_length,
        "poisson": rod.poisson,
        "gravity": rod.gravity,
        "noise_std": 5e-4,
    }


def measured(data, test=True):
    if test:
        data = {k: np.repeat(v[:1], 3, axis=0) if np.ndim(v) > 1 else v for k, v in data.items()}
        data |= {"train_idx": np.array([0, 1]), "test_idx": np.array([2])}
    return measurements_from_arrays(data)


@pytest.fixture(scope="module")
def fallen():
    """An upright arch seven L_gb long, led to its poses in its own plane; and its markers."""
    setup = ClampedSetup.base(measured(arch(0.5, 0.1, 0.07)), np.arange(3), 24)
    solver = ClampedSolver([setup])
    return solver, np.real(solver.predict([setup]).position[0])


def test_an_upright_arch_falls_to_a_side_and_says_so(fallen):
    """In its plane it is in equilibrium, but a rod this heavy does not keep it."""
    solver, _ = fallen
    assert all(b.negative == 0 and b.start == "saddle" for b in solver.branches)
    assert all(b.found == 2 for b in solver.branches)
    aside = np.abs(solver.batch.positions()[:, :, 1]).max(axis=1)
    assert np.all(aside > 0.05)


@pytest.mark.parametrize("side", (-1.0, 1.0))
def test_the_side_is_the_one_that_was_measured(fallen, side):
    seen = fallen[1].copy()
    seen[..., 1] = side * np.abs(seen[..., 1])
    data = arch(0.5, 0.1, 0.07) | {"centerline": seen}
    laboratory = Laboratory(measured(data), edge_count=24)
    assert laboratory.rms(laboratory.predict(Model(), np.zeros(0)), np.array([2])) < 2e-3
    assert all(b.negative == 0 and b.start == "measured" for b in laboratory.branches)


def test_a_short_planar_arch_has_its_equilibrium():
    """The walk from straight does not get there; the measured shape does."""
    m = measured(arch(0.12, 0.06, 0.034, height=0.33))
    laboratory = Laboratory(m, edge_count=24)
    top = laboratory.predict(Model(), np.zeros(0))[0, :, 2].max()
    assert top == pytest.approx(0.0442, abs=5e-4)
    assert all(b.negative == 0 for b in laboratory.branches)


@pytest.fixture(scope="module")
def coiled():
    """A rod with a bend of its own, fitted as a coil; with its truth."""
    data, hidden = kept("natural_curvature", 303)
    lab = coarse(data)
    model = Model((effects()["natural_helix"],))
    (coil,) = fit_models(lab, [model], [np.array([0.0, 0.0, -6.0])])
    return lab, coil, hidden


def test_a_coil_that_does_not_turn_is_a_curvature_even_past_a_fold(coiled):
    """By itself the curvature's fit ends before a fold, at (-3.80, -0.83) and 1.21 times as many
    squares, that the coil's comes past with a turn of 0.03 ± 0.03 rad/m."""
    (lab, coil, truths), known = coiled, effects()
    first = base_fit(lab)
    (alone,) = fit_models(lab, [Model((known["natural_curvature"],))], [np.zeros(2)])
    assert alone.bic > coil.bic
    gains = [first.bic - fit.bic for fit in (coil, alone)]
    rounds = [Round((), coil, [coil, alone], gains, coil.model.names, "")]
    found = leaner(lab, coil, [known["natural_curvature"], known["camera_rotation"]], rounds)
    assert found.model.names == ("natural_curvature",)
    assert found.bic < coil.bic
    (truth,) = truths["natural_curvature"].values()
    assert np.abs(found.values - truth).max() < 3.0 * np.sqrt(np.diag(found.covariance)).max()
    # The ranking has it in the place of the fit that did not come past.
    assert rounds[0].fits[0] is found and rounds[0].fits[1] is coil
    assert rounds[0].gains == pytest.approx([first.bic - f.bic for f in (found, coil)])


def test_what_a_fit_leaves_is_asked_where_it_is(coiled, monkeypatch):
    """At its own shapes, to which nothing is led; led from the base model's it leaves the same."""
    lab, fit, _ = coiled
    asked = fit.model, fit.values, lab.measurements.train
    led, led_there = [], lab._lead
    monkeypatch.setattr(lab, "_lead", lambda *to: led.append(to) or led_there(*to))
    assert lab.misfit(*asked).sum() == pytest.approx(fit.chi_squared, rel=1e-9)
    assert not led
    lab._known.clear()
    assert lab.misfit(*asked).sum() == pytest.approx(fit.chi_squared, rel=1e-7)
    assert len(led) == 1
    lab.misfit(*asked)
    assert len(led) == 1


def test_trials_that_stand_before_a_fold_do_not_hold_a_fit_back(monkeypatch):
    """Two of sixteen do, at 59 000 squares; without them the others lead past it. A softening
    leaves 55 000, but more in the others, so that the stiffness is tried first."""
    monkeypatch.setattr(steps, "_AGAIN", 1)
    data, truth = kept("natural_curvature + stiffness", 302)
    lab, known = coarse(data), effects()
    curved = extensions(lab, base_fit(lab), [known["natural_curvature"]])[0]
    both = curved.model.extended(known["stiffness"])
    alone = Model((known["natural_curvature"],))
    (before,) = fit_models(lab, [alone], [np.zeros(2)])
    (held,) = fit_models(lab, [both], [np.append(before.values, 0.0)], origin=before)
    found = extensions(lab, curved, [known["softening"], known["stiffness"]])[0]
    assert found.model.names[-1] == "stiffness"
    noise = np.sqrt(2.0 * found.residual_count)
    assert abs(found.chi_squared - found.residual_count) < 4.0 * noise < held.chi_squared / 20.0
    (curvature,), (stiffness,) = (own.values() for own in truth.values())
    true = np.append(curvature, np.log(stiffness))
    assert np.abs(found.values - true).max() < 3.0 * np.sqrt(np.diag(found.covariance)).max()


def test_a_rod_that_is_wound_by_a_whole_turn_more_is_found_by_its_shape():
    """Poses say nothing of whole turns: a rod that is led to them and twisted by 2.5 rad there may
    be wound the other way, and then stands elsewhere."""
    data, _ = kept("natural_curvature", 101, "pose")
    setup = ClampedSetup.base(measurements_from_arrays(data), np.arange(24), 40)
    solver = ClampedSolver([setup])
    led, shape, trial = solver.saved(), solver.batch.positions()[:, 1:-1], 7
    twist = solver.total_twist()
    assert twist[trial] < -2.4
    solver.shape_to([setup], shape, turns=-1)
    assert solver.relax([setup])[trial] and solver.negative[trial] == 0
    turned, shape = solver.total_twist()[trial], shape.copy()
    shape[trial] = solver.batch.positions()[trial, 1:-1]
    solver.restore(led)
    to_measured(solver, [setup], shape)
    there = solver.total_twist()
    assert there[trial] == pytest.approx(turned, abs=1e-8) and turned > 3.0
    assert np.delete(there, trial) == pytest.approx(np.delete(twist, trial), abs=1e-12)
    assert solver.batch.positions()[trial, 1:-1] == pytest.approx(shape[trial], abs=1e-7)
    solver.restore(led)
    to_measured(solver, [setup], solver.batch.positions()[:, 1:-1])
    assert (solver.saved()[0] == led[0]).all()


@pytest.mark.parametrize("turns", (1, -2, 2))
def test_a_gripper_that_was_turned_by_whole_turns_is_found(turns):
    """By the base model already, of which every other rod stays where it is."""
    data, _ = kept("none 1", 101, "pose")
    m = measurements_from_arrays(dict(data))
    setup = ClampedSetup.base(m, np.arange(24), COARSE)
    solver, trial = ClampedSolver([setup], shape=setup.measured), 11
    twist = solver.total_twist()
    solver.shape_to([setup], setup.measured, turns=turns)
    assert solver.relax([setup])[trial] and solver.negative[trial] == 0
    wound = solver.total_twist()[trial]
    assert abs(wound - twist[trial]) == pytest.approx(2.0 * np.pi * abs(turns), rel=0.15)
    seen = np.array(data["centerline"])
    seen[trial] = np.real(solver.predict([setup]).position[0])[trial]
    lab = coarse(data | {"centerline": seen})
    there = lab.solver_at(Model(), np.zeros(0))[0].total_twist()
    assert there[trial] == pytest.approx(wound, abs=0.1)
    assert np.delete(there, trial) == pytest.approx(np.delete(twist, trial), abs=0.1)
    assert lab.rms(lab.predict(Model(), np.zeros(0)), np.array([trial])) < m.noise_floor


def test_a_camera_that_is_off_keeps_no_rod_on_a_turn_more():
    """Where all rods seem to be as far away, one that is wound stands apart by what cameras see."""
    data, off = dict(kept("none 1", 101, "pose")[0]), np.array([8e-3, -4e-3, 6e-3])
    lab = coarse(data | {"centerline": data["centerline"] + off})
    found, trial = (Model((effects()["camera_offset"],)), off), 11
    right = lab.predict(*found)
    lab._known.clear()
    solver, setup = lab.solver_at(Model(), np.zeros(0))
    twist = solver.total_twist()
    solver.shape_to([setup], lab.base.measured - off, turns=1)
    assert solver.relax([setup])[trial] and solver.negative[trial] == 0
    wound = np.abs(solver.total_twist() - twist) > np.pi
    lab.base_state = tuple(
        np.where((wound & (lab.trials == trial)).reshape(-1, *[1] * (own.ndim - 1)), there, own)
        for own, there in zip(lab.base_state, solver.saved(), strict=True)
    )
    assert wound[trial]
    assert lab.predict(*found) == pytest.approx(right, abs=1e-6)


def test_turns_stand_for_no_effect_that_the_base_model_lacks():
    """Of several turns one comes nearer by chance: of 24 ribbons six by up to a tenth."""
    for case, seed in (("anisotropic_bending", 11), ("natural_curvature + stiffness", 302)):
        lab = coarse(kept(case, seed)[0])
        twist = lab.solver_at(Model(), np.zeros(0))[0].total_twist()
        assert np.abs(twist).max() < 1.1 * np.pi


@pytest.mark.parametrize(
    ("seed", "edges"),
    (
        (1, 60),
        pytest.param(2, 90, marks=pytest.mark.slow),
        (3, 90),
        pytest.param(11, 90, marks=pytest.mark.slow),
    ),
)
def test_a_ribbon_in_strong_bends_is_found_though_it_may_roll_to_either_side(seed, edges):
    """From the round rod's shapes some do not follow the first step, and some come to an
    equilibrium millimetres beside the one that was measured, rolled to the other side."""
    known = ("ribbon", seed, "white")
    data, truth = kept(*known) if known in SETS else draw(*known)
    (values,), known = truth["anisotropic_bending"].values(), effects()["anisotropic_bending"]
    m, values = measurements_from_arrays(dict(data)), np.array(values)
    lab = Laboratory(m, edge_count=edges)
    assert lab.rms(lab.predict(Model(), np.zeros(0)), m.test) > 5.0 * m.noise_floor
    model = Model((known,))
    assert lab.rms(lab.predict(model, values), lab.trials) < 1.2 * m.noise_floor
    (found,) = extensions(lab, base_fit(lab), [known])
    assert found.chi_squared < 1.15 * found.residual_count
    told = known.describe(found.values, found.covariance, m)
    assert told["stiffer_ratio"].value == pytest.approx(1.35, abs=0.03)
    assert told["softer_ratio"].value == pytest.approx(0.75, abs=0.03)
    assert lab.rms(lab.predict(found.model, found.values), m.test) < 1.1 * m.noise_floor
    # Of few trials as well.
    assert held_out_error(lab, found).rms < 1.1 * m.noise_floor


class Edge(Effect):
    """Numbers of which readings tell the sum alone, so well that double precision loses their
    priors beside it: as two that move a rod beside a fold."""

    name = title = reference = "edge"
    parameters = unknowns("", 1.0, "one", "other")

    def measure(self, position, frame, values, setup):
        return position + 1e8 * (values[0] + values[1])


def test_what_rods_beside_a_fold_tell_is_fitted():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(5, 5))
    matrix = root @ root.T + np.eye(5)
    assert np.allclose(solved(matrix, np.eye(5)), np.linalg.inv(matrix), rtol=1e-10)
    assert np.allclose(solved(np.diag([1e18, 100.0]), np.array([0.0, 100.0])), [0.0, 1.0])
    assert solved(np.zeros((0, 0)), np.zeros(0)).shape == (0,)  # all are at their bounds
    assert np.isnan(solved(np.full((2, 2), np.nan), np.ones(2))).all()
    lab = Laboratory(measured(arch(0.12, 0.06, 0.034, height=0.33)), edge_count=24)
    (fit,) = fit_models(lab, [Model((Edge(),))], [np.zeros(2)])
    assert fit.converged and fit.chi_squared <= base_fit(lab).chi_squared
    # Of the difference their priors are all that is known.
    assert np.diag(fit.covariance) == pytest.approx([0.5, 0.5])
    assert fit.covariance[0, 1] == pytest.approx(-0.5)
