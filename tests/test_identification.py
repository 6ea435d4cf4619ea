"""Identification: exact derivatives, known effects found, bad data named."""

import copy
import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner
from hidden import coarse
from scipy.interpolate import CubicSpline
from threadpoolctl import threadpool_info, threadpool_limits

from wrod.commands import main
from wrod.errors import DataError
from wrod.identification import entry, identify, load_measurements
from wrod.identification.clamped.equilibria import ClampedSolver
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.loading import measurements_from_arrays
from wrod.identification.clamped.measurements import ClampedMeasurements
from wrod.identification.clamped.setup import ClampedSetup, rotation_of
from wrod.identification.clamped.steps import base_fit
from wrod.identification.clamped.trace import trace
from wrod.identification.clamped.verdict import judge
from wrod.identification.effect import Effect, Model, Parameter, effects
from wrod.rods.law import Plastic
from wrod.rods.material import RodMaterial
from wrod.rods.model_file import load_rod

ROD = RodMaterial(0.0018, 0.06, 0.5, density=1500.0)
NOISE = 5e-4


def reported_poses(trials: int, seed: int) -> dict[str, np.ndarray]:
    """Clamps that let the rod hang in shallow, skew arcs."""
    rng = np.random.default_rng(seed)
    level = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])
    # Both clamps roll together: what turns with the material is then seen from every side.
    rolls = rng.uniform(-np.pi, np.pi, trials)
    clamp = np.stack([level @ rotation_of(np.array([0.0, 0.0, roll])) for roll in rolls])
    turns = rng.uniform(-0.35, 0.35, (trials, 3)) * [1, 1, 1.5]
    grip = np.stack([c @ rotation_of(t) for c, t in zip(clamp, turns, strict=True)])
    across = rng.uniform(-0.05, 0.05, (trials, 3)) + [0.40, 0.0, 0.0]
    return {
        "clamp_position": np.tile([0.3, -0.2, 0.5], (trials, 1)),
        "clamp_rotation": clamp,
        "grip_position": np.array([0.3, -0.2, 0.5]) + across,
        "grip_rotation": grip,
    }


def unmeasured(trials: int, seed: int, noise: float = NOISE) -> dict[str, np.ndarray]:
    """Arrays of a set whose markers are on a line between the clamps."""
    data = reported_poses(trials, seed) | {
        "arc_length": np.linspace(0.0, ROD.length, 21),
        "train_idx": np.arange(trials - 4),
        "test_idx": np.arange(trials - 4, trials),
        "length": ROD.length,
        "radius": ROD.radius,
        "density": ROD.density,
        "L_gb": ROD.gravito_bending_length,
        "poisson": ROD.poisson,
        "gravity": ROD.gravity,
        "noise_std": noise,
    }
    start, end = data["clamp_position"][:, None], data["grip_position"][:, None]
    return data | {"centerline": start + data["arc_length"][:, None] / ROD.length * (end - start)}


@cache
def hanging(trials: int, seed: int) -> CubicSpline:
    """(trial, share, 3) where the base model hangs, on a coarse mesh."""
    setup = ClampedSetup.base(
        measurements_from_arrays(unmeasured(trials, seed)), np.arange(trials), 30
    )
    nodes = ClampedSolver([setup]).batch.positions()[:, 1:-1]
    return CubicSpline(np.linspace(0.0, 1.0, 31), nodes, axis=1)


def synthetic(apply=None, *, trials=12, seed=0, edge_count=150, noise=NOISE, measure=None):
    """Arrays of a set whose rod has an effect, made on a finer mesh than any fit uses."""
    data = unmeasured(trials, seed, noise)
    setup = ClampedSetup.base(measurements_from_arrays(data), np.arange(trials), edge_count)
    if apply:
        apply(setup)
    shape = hanging(trials, seed)(np.linspace(0.0, 1.0, edge_count + 1))
    solver = ClampedSolver([setup], shape=shape)
    seen = solver.predict([setup])
    rng = np.random.default_rng(seed + 1)
    position = np.real(seen.position[0])
    if measure:
        position = measure(position)
    force, torque = np.real(seen.force[0]), np.real(seen.torque[0])
    data["centerline"] = position + noise * rng.normal(size=position.shape)
    data["grip_force"] = force + np.hypot(0.02 * force, 2e-3) * rng.normal(size=force.shape)
    data["grip_torque"] = torque + np.hypot(0.02 * torque, 2e-4) * rng.normal(size=torque.shape)
    return data


# A handful of effects for tests in which the others only cost time.
FEW_NAMES = (
    "natural_curvature",
    "stiffness",
    "gravity_tilt",
    "density_profile",
    "grip_rotation",
    "camera_offset",
)
FEW = [part for name in FEW_NAMES[:3] for part in ("--effect", name)]


@pytest.fixture(scope="module")
def plain():
    return synthetic(trials=8)


@pytest.fixture(scope="module")
def laboratory(plain):
    return Laboratory(measurements_from_arrays(plain), edge_count=30)


def probe(effect: Effect) -> np.ndarray:
    """Values away from the base model at which to differentiate."""
    special = {
        "point_mass": [8e-4, 0.21],
        "softening": [np.log(6.0), 0.4],
        "yielding": [np.log(4.0), 0.4],
        "natural_helix": [1.0, -1.5, 7.0],
        "anisotropic_bending": [0.2, -0.1, 0.4],
        "air_flow": [0.004, -0.006, 0.002],
    }
    if effect.name in special:
        return np.array(special[effect.name])
    signs = np.resize([1.0, -0.7, 0.4], len(effect.parameters))
    return 0.1 * signs * [min(p.scale, 2.0) for p in effect.parameters]


COUPLED = ("bend_twist", "natural_curvature", "natural_twist", "grip_slip", "anisotropic_bending")
# Wherever the others move a rod to, the wind is another one.
WINDY = ("grip_slip", "natural_twist", "air_flow")


def agrees(found, numeric):
    """Positions, forces and torques, each within a share of the largest."""
    return all(
        np.abs(numeric[:, part] - found[:, part]).max() <= 5e-5 * np.abs(numeric[:, part]).max()
        for part in (slice(0, 63), slice(63, 66), slice(66, 69))
    )


@pytest.mark.parametrize(
    "names", [*((n,) for n in sorted(effects())), COUPLED, WINDY], ids="+".join
)
def test_derivatives_are_exact(laboratory, names):
    """Implicit differentiation against central differences of whole solutions."""
    model = Model(tuple(effects()[name] for name in names))
    values = np.concatenate([probe(effect) for effect in model.effects])
    _, rates = laboratory.jacobian(model, values)
    here, trials = laboratory.solver_at(model, values)[0].saved(), laboratory.trials
    for j, parameter in enumerate(model.parameters):
        # A mass must not pass from one spline piece to the next while it is differenced, nor a
        # node its yield curvature.
        least = 1e-5 if "yielding" in names else 3e-3
        step = np.zeros(len(values))
        step[j] = h = 2e-4 if parameter.key == "arc_length" else least * min(parameter.scale, 10.0)

        def second(k, step=step, h=h):
            for moved in (ways := [values + k * step, values - k * step]):
                laboratory.remember(model, moved, trials, here)  # from where they are solved
            ahead, behind = (laboratory.observe(model, moved) for moved in ways)
            return (ahead - behind) / (2 * k * h)

        numeric = second(1)
        if not agrees(rates[..., j], numeric):  # of fourth order
            numeric = (4 * numeric - second(2)) / 3
        assert agrees(rates[..., j], numeric)
        assert np.abs(numeric).max() > 0.0


def test_candidates_side_by_side_have_the_rates_that_each_has_alone(laboratory):
    """Laws that only some of the rods of a batch have are differenced there alone."""
    models = [
        Model((effects()[name],))
        for name in ("stiffness", "bend_twist", "natural_curvature", "yielding", "clamp_rotation")
    ]
    values = [probe(model.effects[0]) for model in models]
    solver = ClampedSolver([laboratory.base] * len(models), start=laboratory.base_state)
    setups = [m.setup(laboratory.base, v) for m, v in zip(models, values, strict=True)]
    assert solver.solve(setups).all()
    together = laboratory.rates(solver, models, values, laboratory.base)
    for model, own, found in zip(models, values, together, strict=True):
        alone = laboratory.jacobian(model, own)[1]
        assert np.abs(found - alone).max() < 1e-6 * np.abs(alone).max()


def test_turned_principal_directions_do_no_work_on_a_round_rod(laboratory):
    """They turn all along the rod: it stays in equilibrium, and a state put back knows its own."""
    base = laboratory.base
    turned = copy.copy(base)
    turned.principal_angle = 2.5
    solver = ClampedSolver([base], start=laboratory.base_state)
    free = solver.batch.free.numpy() != 0
    before = solver.batch.state.dof.numpy().copy()

    def largest_force():
        solver.batch.evaluate(order=1)
        return np.abs(solver.batch.derivatives.gradient.numpy()[free]).max()

    at_rest = largest_force()
    solver._turn_principal([turned])
    assert largest_force() < 10.0 * at_rest + 1e-12
    assert np.allclose(solver.batch.state.dof.numpy()[:, 3::4] - before[:, 3::4], 2.5)
    solver.restore(laboratory.base_state)
    assert solver.solve([base]).all()
    assert np.abs(solver.batch.state.dof.numpy() - before).max() < 1e-6


def test_effects_grow_in_place():
    model = Model((effects()["point_mass"], effects()["gravity_tilt"]))
    grown = model.grown(np.array([2e-3, 0.3, 0.1, -0.2]), 0.25)
    assert np.allclose(grown, [5e-4, 0.3, 0.025, -0.05])


def test_another_equilibrium_on_the_coarse_mesh_is_no_correction(plain, monkeypatch):
    laboratory = Laboratory(measurements_from_arrays(plain), edge_count=30)
    kept = laboratory.mesh_correction.copy()
    predict = ClampedSolver.predict

    def elsewhere(self, setups):
        seen = predict(self, setups)
        if self.edge_count == 15:
            seen.position[0, 2] += 0.05
        return seen

    monkeypatch.setattr(ClampedSolver, "predict", elsewhere)
    laboratory.refine(Model(), np.zeros(0))
    assert np.all(laboratory.mesh_correction[2] == 0.0)
    assert np.allclose(np.delete(laboratory.mesh_correction, 2, 0), np.delete(kept, 2, 0))


def test_wrench_balances_the_weight_of_a_hanging_rod():
    """Force of gripper and clamp together carry the rod: that of the gripper is near half."""
    m = measurements_from_arrays(synthetic(trials=8))
    setup = ClampedSetup.base(m, np.arange(m.trial_count), 60)
    solver = ClampedSolver([setup])
    force = np.real(solver.predict([setup]).force[0])
    gradient = solver.batch.derivatives.gradient.numpy()
    clamp = gradient[:, 0:3] + gradient[:, 4:7]
    weight = ROD.weight * ROD.length
    assert np.abs((force + clamp)[:, 2] - weight).max() < 1e-6 * weight
    assert np.abs((force + clamp)[:, :2]).max() < 1e-6 * weight


@pytest.mark.usefixtures("on_coarse_meshes")
def test_no_effect_is_adequate(plain):
    report = identify(measurements_from_arrays(plain))
    assert report.verdict == "adequate"
    assert report.effects == ()
    assert report.after < 1.1 * report.noise_floor


@pytest.mark.usefixtures("on_coarse_meshes")
def test_two_effects_are_found_together(tmp_path):
    def apply(setup):
        setup.natural_curvature = setup.natural_curvature + np.array([2.0, -3.0])
        setup.bending, setup.twisting = 1.3 * setup.bending, 1.3 * setup.twisting
        setup.stretching = 1.3 * setup.stretching

    np.savez(tmp_path / "two.npz", **synthetic(apply, seed=3, trials=10))
    result = CliRunner().invoke(
        main,
        ["identify", str(tmp_path / "two.npz"), "--out", str(tmp_path / "out"), *FEW],
        catch_exceptions=False,
    )
    assert result.exit_code == 0, result.output
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["verdict"] == "explained"
    found = {e["name"]: e["parameters"] for e in report["effects"]}
    assert set(found) == {"natural_curvature", "stiffness"}
    assert found["natural_curvature"]["curvature_1"]["value"] == pytest.approx(2.0, rel=0.05)
    assert found["natural_curvature"]["curvature_2"]["value"] == pytest.approx(-3.0, rel=0.05)
    assert found["stiffness"]["stiffness_ratio"]["value"] == pytest.approx(1.3, rel=0.05)
    assert report["after_mm"] < 1.1 * report["noise_floor_mm"] < report["before_mm"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 4
    assert "http" not in page
    rod = load_rod(tmp_path / "out" / "rod.json")
    assert rod.bending_stiffness == pytest.approx(1.3 * ROD.bending_stiffness, rel=0.05)


@pytest.mark.usefixtures("on_coarse_meshes")
def test_a_wire_that_yields_is_found_as_a_rod_that_does(tmp_path):
    def law(setup):
        setup.yielding = np.array([0.7, 6.0])

    names = ["yielding", "softening", "stiffness"]
    report = identify(measurements_from_arrays(synthetic(law, trials=8)), candidates=names)
    assert report.verdict == "explained"
    (effect,) = report.effects
    assert effect.name == "yielding"
    for key, true in (("yield_curvature", 6.0), ("hardening", 0.3)):
        found = effect.parameters[key]
        assert abs(found.value - true) < min(4.0 * found.stderr, 0.05 * true)
    report.found.save(tmp_path / "model.json")
    law = load_rod(tmp_path / "model.json").law
    assert isinstance(law, Plastic)
    assert law.yield_curvature == effect.parameters["yield_curvature"].value
    assert law.hardening == pytest.approx(effect.parameters["hardening"].value)


def test_of_two_laws_the_one_that_yields_counts(laboratory):
    """Whichever was found first: a rod has one law of bending."""
    known, own = effects(), {"softening": [np.log(5.0), 0.6], "yielding": [np.log(5.0), 0.4]}

    def seen(*names):
        values = np.concatenate([own[name] for name in names])
        return laboratory.predict(Model(tuple(known[name] for name in names)), values)

    alone = seen("yielding")
    for names in (("softening", "yielding"), ("yielding", "softening")):
        assert np.abs(seen(*names) - alone).max() < 1e-9
    assert np.abs(seen("softening") - alone).max() > 1e-3


@pytest.mark.usefixtures("on_coarse_meshes")
def test_a_part_of_another_effect_that_does_the_same_is_a_rival():
    """A twist at rest is a gripper that rolls: its two other angles do not set it apart."""

    def apply(setup):
        setup.natural_twist = setup.natural_twist + 2.0

    names = ["natural_twist", "grip_rotation", "stiffness"]
    report = identify(measurements_from_arrays(synthetic(apply, trials=8)), candidates=names)
    assert [e.name for e in report.effects] == ["natural_twist"]
    assert [c["effects"] for c in report.selection.confounded] == [
        ["natural_twist", "grip_rotation"]
    ]


@pytest.mark.usefixtures("on_coarse_meshes")
def test_what_contains_the_chosen_effect_is_no_rival():
    def apply(setup):
        setup.bending, setup.twisting = 1.3 * setup.bending, 1.3 * setup.twisting

    names = ["stiffness", "stiffness_gradient", "gravity_tilt"]
    report = identify(measurements_from_arrays(synthetic(apply, trials=8)), candidates=names)
    assert [e.name for e in report.effects] == ["stiffness"]
    assert report.selection.confounded == []


def test_a_model_with_which_an_unseen_trial_has_no_equilibrium_is_refuted(laboratory, monkeypatch):
    """Seen with a coil and a profile of force after six minutes, which ended in an error."""
    empty, lead = base_fit(laboratory), Laboratory._lead

    def folds(self, solver, base, model, values):
        if any(getattr(e, "name", "") == "natural_curvature" for e in model.effects):
            raise DataError("no equilibrium")
        return lead(self, solver, base, model, values)

    monkeypatch.setattr(Laboratory, "_lead", folds)
    model = Model((effects()["natural_curvature"],))
    found = judge(laboratory, replace(empty, model=model, values=np.ones(2)), empty, [], (0.0, 0.0))
    assert not found.fit.model.effects
    assert found.reason.startswith("an unseen trial has no equilibrium with natural_curvature; ")


@pytest.mark.slow
def test_an_effect_that_no_plug_in_covers_is_not_named_explained():
    """A knock against the rod, another one in every trial: not one of the candidates."""

    def apply(setup):
        force = np.zeros((12, len(setup.fraction), 3))
        force[:, 70] = np.random.default_rng(5).normal(size=(12, 3)) * 0.01
        setup.force = force

    data = measurements_from_arrays(synthetic(apply, seed=4))
    report = identify(data, candidates=FEW_NAMES[:4])
    assert report.verdict in ("unexplained", "partly-explained")
    if report.verdict == "unexplained":
        assert report.effects == ()
    assert report.prints[0].evidence > 0


def test_prints_tell_load_material_end_and_camera_apart():
    def tilt(setup):
        setup.gravity = rotation_of(np.array([0.06, 0.03, 0.0])) @ setup.gravity

    def bend(setup):
        setup.natural_curvature = setup.natural_curvature + np.array([1.0, 0.5])

    def turn(setup):
        setup.grip_rotation = setup.grip_rotation @ rotation_of(np.array([0.06, -0.04, 0.0]))

    cases = {
        "force_in_laboratory": synthetic(tilt, trials=8),
        "moment_in_material": synthetic(bend, trials=8),
        "grip_end": synthetic(turn, trials=8),
        "camera": synthetic(measure=lambda x: 1.02 * x, trials=8),
    }
    for name, data in cases.items():
        prints = trace(coarse(data))
        assert prints[0].name == name
        assert prints[0].share > 0.9


class Magnet(Effect):
    """A user's own effect: a sideways pull on the middle."""

    name = "magnet"
    title = "pull on the middle of the rod"
    reference = "test"
    parameters = (Parameter("pull", "N", 0.1),)

    def apply(self, setup, values):
        share = setup.weights_at(0.5 * setup.length)
        setup.force = setup.force + values[0] * share[:, None] * np.array([0.0, 1.0, 0.0])


@pytest.mark.usefixtures("on_coarse_meshes")
def test_a_users_own_effect_takes_part():
    def apply(setup):
        Magnet().apply(setup, np.array([0.02]))

    report = identify(
        measurements_from_arrays(synthetic(apply, trials=8)),
        candidates=[Magnet(), "natural_curvature"],
    )
    assert report.verdict == "explained"
    assert [e.name for e in report.effects] == ["magnet"]
    assert report.effects[0].parameters["pull"].value == pytest.approx(0.02, rel=0.05)


class Weighted(Magnet):
    """One whose parameter counts from elsewhere."""

    def apply(self, setup, values):
        super().apply(setup, [0.05 + values[0]])


def test_an_effect_that_is_something_at_zero_is_refused(plain):
    asked = ["natural_curvature", Weighted()]
    with pytest.raises(DataError, match=r"'magnet' still changes .* all its parameters are zero"):
        identify(measurements_from_arrays(plain), candidates=asked)


class Lost(Magnet):
    """One that is a number at zero only."""

    def apply(self, setup, values):
        super().apply(setup, values * np.where(np.real(values) == 0.0, 1.0, np.nan))


class Unseen(Magnet):
    """One that no camera sees anything of, beyond its rate."""

    def apply(self, setup, values):
        pass

    def measure(self, position, frame, values, setup):
        return position + np.where(np.imag(values[0]) == 0.0, 0.0, np.nan)


class Rooted(Magnet):
    """One whose rate is infinite at zero."""

    def apply(self, setup, values):
        super().apply(setup, np.sqrt(values))


class Folded(Magnet):
    """One that drops the imaginary parts."""

    def apply(self, setup, values):
        super().apply(setup, np.abs(values))


class Empty(Magnet):
    """One that has nothing to fit."""

    parameters = ()


def test_an_effect_of_nothing_is_refused(plain):
    with pytest.raises(DataError, match="'magnet' has no parameters to fit"):
        identify(measurements_from_arrays(plain), candidates=[Empty()])


@pytest.mark.parametrize(
    ("effect", "said"),
    [
        (Lost(), "makes force no number"),
        (Unseen(), "makes measure no number"),
        (Rooted(), "makes force no number, or its rate"),
        (Folded(), r"changes force at \[0.0001\] otherwise"),
    ],
)
def test_an_effect_whose_rates_are_none_is_refused(plain, effect, said):
    with pytest.raises(DataError, match=f"'magnet' {said}"):
        identify(measurements_from_arrays(plain), candidates=["natural_curvature", effect])


def swap(data, *fields, trial=1):
    """Exchange what belongs to the two clamps in one trial."""
    for field in fields:
        ends = [data[f"{end}_{field}"] for end in ("clamp", "grip")]
        ends[0][trial], ends[1][trial] = ends[1][trial].copy(), ends[0][trial].copy()


def only_first_trial(data):
    for key, value in data.items():
        if np.ndim(value) > 1:
            data[key] = value[:1]
    data["train_idx"] = data["test_idx"] = np.array([0])


LENGTHS = (
    "centerline",
    "arc_length",
    "clamp_position",
    "grip_position",
    "length",
    "radius",
    "L_gb",
)
BAD = {
    "centerline of trial 3 has 10 of 21 markers": lambda d: d["centerline"].__setitem__(
        (3, slice(0, 11)), np.nan
    ),
    "grip_force of trial 2": lambda d: d["grip_force"].__setitem__((2, 0), np.inf),
    "trial 2 markers 4 and 15 are swapped": lambda d: d["centerline"].__setitem__(
        (2, [4, 15]), d["centerline"][2, [15, 4]]
    ),
    "trial 0 markers 19 and 20 are swapped": lambda d: d["centerline"].__setitem__(
        (0, [19, 20]), d["centerline"][0, [20, 19]]
    ),
    "marker 7; it is mistaken": lambda d: d["centerline"].__setitem__(
        (3, [7, 16]), d["centerline"][3, [7, 16]] + [[0.0, 0.2, 0.0], [0.0, 0.0, 0.15]]
    ),
    "trial 1 the first marker is at the gripper": lambda d: d["centerline"].__setitem__(
        1, d["centerline"][1, ::-1]
    ),
    "trial 1 the first marker is at the gripper and the last": lambda d: swap(
        d, "position", "rotation"
    ),
    "against the tangent of grip_rotation": lambda d: d["grip_rotation"].__imul__([-1, 1, -1]),
    "centerline measures .*millimetres": lambda d: d["centerline"].__imul__(1e3),
    "length is 500 m; .*millimetres": lambda d: d.update({k: 1e3 * d[k] for k in LENGTHS}),
    "the clamps are .* apart": lambda d: d["grip_position"].__imul__(1e3),
    "radius is 1.8 m; .*millimetres": lambda d: d["radius"].__imul__(1e3),
    "L_gb is 60 m": lambda d: d["L_gb"].__imul__(1e3),
    "noise_std 0.5 is over a tenth": lambda d: d["noise_std"].__imul__(1e3),
    "noise_std 5e-10 is under a ten-millionth": lambda d: d["noise_std"].__imul__(1e-6),
    "not a rotation": lambda d: d["grip_rotation"].__setitem__((2, 0, 0), 2.0),
    "arc_length has shape": lambda d: d.__setitem__("arc_length", d["arc_length"][:-1]),
    "outside the free length": lambda d: d["arc_length"].__imul__(1e3),
    "arc_length spans": lambda d: d["arc_length"].__imul__(1e-3),
    "different trials": lambda d: d.__setitem__("train_idx", np.array([0, 99])),
    "is in train_idx": lambda d: d.__setitem__("test_idx", np.array([0])),
    "only one of": lambda d: d.pop("grip_force"),
    "lacks the array noise_std": lambda d: d.pop("noise_std"),
    "radius is -1 m; it must be above 0": lambda d: d.__setitem__("radius", -1.0),
    "centerline has 1 trial; at least 2": only_first_trial,
    "train_idx has 1 trial; at least 2": lambda d: d.__setitem__("train_idx", np.array([0])),
}


def test_one_mistaken_marker_of_a_trial_is_not_seen(plain):
    data = {key: np.array(value) for key, value in plain.items()}
    data["centerline"][3, 7, 1] += 0.2
    data["centerline"][0, 2] = np.nan
    seen = np.isfinite(measurements_from_arrays(data).centerline).all(axis=2)
    assert sorted(map(tuple, np.argwhere(~seen))) == [(0, 2), (3, 7)]


@pytest.mark.parametrize("sentence", BAD)
def test_bad_data_are_named(plain, sentence, tmp_path):
    data = {key: np.array(value) for key, value in plain.items()}
    BAD[sentence](data)
    with pytest.raises(DataError, match=sentence):
        measurements_from_arrays(data)
    np.savez(tmp_path / "bad.npz", **data)
    result = CliRunner().invoke(
        main, ["identify", str(tmp_path / "bad.npz"), "--out", str(tmp_path / "out")]
    )
    assert result.exit_code == 2
    assert re.search(sentence, result.output)
    assert len(result.output.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_matrices_that_are_singular_are_told(plain, monkeypatch):
    def singular(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr("wrod.identification.clamped.report.as_asked", singular)
    with pytest.raises(DataError, match=r"too far apart for double precision \(Singular matrix\)"):
        identify(measurements_from_arrays(plain))


def test_files_that_are_not_measurements(tmp_path):
    (tmp_path / "text.npz").write_text("no zip")
    np.savez(tmp_path / "object.npz", centerline=np.array([{}], dtype=object))
    for name in ("text.npz", "object.npz", "missing.npz"):
        with pytest.raises(DataError, match=r"not readable|no such file|Python objects"):
            load_measurements(tmp_path / name)
    result = CliRunner().invoke(
        main, ["identify", str(tmp_path / "text.npz"), "--out", str(tmp_path / "out")]
    )
    assert result.exit_code == 2
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "effect", "expected"),
    [
        # Given as the axis that the tangent turns about, at -60 degrees.
        ("natural-curvature", "natural_curvature", {"curvature": 5.0, "direction": -150.0}),
        ("gravity-tilt", "gravity_tilt", {"tilt": 2.2, "axis_azimuth": 35.0}),
        ("point-mass", "point_mass", {"mass": 0.9e-3, "arc_length": 0.36}),
    ],
)
def test_practice_sets(shared, name, effect, expected):
    report = identify(shared / "measured" / "clamped" / f"practice-{name}.npz")
    assert report.verdict == "explained"
    assert [e.name for e in report.effects] == [effect]
    for key, value in expected.items():
        assert report.effects[0].parameters[key].value == pytest.approx(value, rel=0.05)
    assert report.after < 1.1 * report.noise_floor


@pytest.mark.slow
@pytest.mark.parametrize("letter", "abcdef")
def test_blind_sets_end_at_the_noise(shared, letter):
    """What the blind sets hold is not known; where it is explained it must be down to the noise."""
    report = identify(shared / "measured" / "clamped" / f"set-{letter}.npz")
    assert report.verdict in ("adequate", "explained")
    assert report.after < 1.15 * report.noise_floor


def test_blas_has_one_thread_while_a_rod_is_identified(monkeypatch):
    def threads():
        return {lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas"}

    monkeypatch.setattr(entry, "identify_clamped", lambda *_: threads())
    with threadpool_limits(2, "blas"):
        assert threads() == {2}
        assert entry.identify(object.__new__(ClampedMeasurements)) == {1}
        assert threads() == {2}
