"""What a rod is: profiles, laws, models, their files, and rods on meshes."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest

import wrod
from wrod.errors import RodError, WrodWarning
from wrod.rods.discretisation import mesh_arrays
from wrod.rods.law import Softening
from wrod.rods.model import RodModel
from wrod.rods.model_file import with_length
from wrod.rods.profile import Profile

RNG = np.random.default_rng(4)


def varied(**more) -> RodModel:
    """A rod that has everything."""
    knots = [0.0, 0.2, 0.5, 0.7]
    given = dict(
        length=0.7,
        bending_stiffness=(Profile([1e-3, 2e-3, 1.5e-3, 1e-3], knots), Profile((2.5e-3,))),
        twisting_stiffness=Profile([8e-4, 1e-3], [0.1, 0.6]),
        stretching_stiffness=900.0,
        line_mass=Profile([0.01, 0.02, 0.012, 0.011], knots),
        radius=0.002,
        principal_angle=0.4,
        natural_curvature=(Profile([3.0, -1.0], [0.0, 0.7]), 2.0),
        natural_twist=1.5,
        point_masses=((0.3, 0.004), (0.61, 0.001)),
        law=Softening(20.0, 0.4),
        internal_damping=0.01,
        relaxation_time=0.02,
        air_damping=0.5,
        quadratic_drag=0.1,
    )
    return RodModel(**{**given, **more})


def test_profiles_integrate_exactly():
    profile = Profile([1.0, 3.0, 2.0], [0.2, 0.5, 1.0])
    a, b = RNG.uniform(-0.3, 1.4, (2, 200))
    fine = np.linspace(a, b, 20001)
    value = np.interp(fine, profile.knots, profile.values)
    by_sum = 0.5 * np.sum((value[1:] + value[:-1]) * np.diff(fine, axis=0), axis=0)
    np.testing.assert_allclose(profile.integral(a, b), by_sum, atol=1e-7)
    np.testing.assert_allclose(profile.mean(a, b) * (b - a), by_sum, atol=1e-7)
    np.testing.assert_allclose(profile.mean(0.4, 0.4), profile(0.4))
    s = np.linspace(0.0, 0.6, 50)
    np.testing.assert_allclose(profile.piece(0.3, 0.9)(s), profile(0.3 + s), atol=1e-14)
    np.testing.assert_allclose(profile.reversed(1.2)(s), profile(1.2 - s), atol=1e-14)
    np.testing.assert_allclose((profile * profile)(s), profile(s) ** 2, rtol=1e-4)
    np.testing.assert_allclose((profile + profile)(s), 2 * profile(s), rtol=1e-14)


def test_bad_profiles_and_models_are_refused():
    for values, knots in [
        ([1.0, np.nan], [0.0, 1.0]),
        ([1.0, 2.0], [1.0, 1.0]),
        ([1.0], [0.0, 1.0]),
        (["a"], [0.0]),
        ([[1.0]], [0.0]),
    ]:
        with pytest.raises(RodError):
            Profile(values, knots)
    for wrong in [
        dict(length=-1.0),
        dict(bending_stiffness=0.0),
        dict(bending_stiffness=(1.0, 1.0, 1.0)),
        dict(line_mass=Profile([1.0, -1.0], [0.0, 1.0])),
        dict(point_masses=((2.0, 0.1),)),
        dict(point_masses="heavy"),
        dict(law="softening"),
        dict(radius=True),
        dict(air_damping=-1.0),
        dict(relaxation_time=-0.1),
        dict(natural_twist=float("inf")),
    ]:
        with pytest.raises(RodError):
            varied(**wrong)


@pytest.mark.parametrize("name", ["radius", "principal_angle", "internal_damping"])
def test_what_is_one_number_is_no_profile(name):
    for profile in (Profile([0.1, 0.2], [0.0, 0.3]), {"knots": [0.0, 0.3], "values": [0.1, 0.2]}):
        with pytest.raises(RodError, match=f"{name} is a profile and can only be one number"):
            varied(**{name: profile})


def test_a_uniform_rod_comes_back():
    rod = wrod.RodMaterial(0.0016, 0.032, 0.885, 0.4, natural_curvature=(1.0, -2.0))
    model = RodModel.of(rod)
    assert RodModel.of(model) is model
    assert model.not_uniform() == ()
    back = model.material(strict=True)
    for name in ("radius", "gravito_bending_length", "length", "poisson", "density", "gravity"):
        assert getattr(back, name) == pytest.approx(getattr(rod, name), rel=1e-14)
    assert back.natural_curvature == rod.natural_curvature
    for name in ("gravito_bending_length", "stretch_ratio", "weight", "poisson"):
        assert getattr(model, name) == pytest.approx(getattr(rod, name), rel=1e-13)
    rich = varied()
    with pytest.warns(WrodWarning, match="natural_twist, point_masses, law"):
        rich.material()
    with pytest.raises(RodError, match="bending_stiffness"):
        rich.material(strict=True)
    with pytest.raises(RodError, match=r"float; give a wrod\.RodMaterial"):
        RodModel.of(3.0)


def test_files_hold_everything(tmp_path):
    model = varied()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert wrod.load_rod(wrod.save_rod(model, tmp_path / "model.json")) == model
        rope = wrod.rod("rope")
        assert wrod.load_rod(wrod.save_rod(rope, tmp_path / "rod.json")) == rope
    with pytest.warns(WrodWarning, match="principal|law"):
        assert wrod.load_rod(tmp_path / "model.json").material().length == 0.7
    shorter = wrod.load_rod(tmp_path / "model.json", length=0.5)
    assert shorter == with_length(model, 0.5) and len(shorter.point_masses) == 1
    wrod.save_rod(model, tmp_path / "motion.json", assumed=("radius", "line_mass"))
    with pytest.warns(WrodWarning, match=r"radius 0\.002 assumed"):
        wrod.load_rod(tmp_path / "motion.json")


def test_no_damping_is_kept_apart_from_damping_that_nobody_measured(tmp_path):
    undamped = replace(RodModel.of(wrod.rod("rope")), internal_damping=0.0)
    assert wrod.load_rod(wrod.save_rod(undamped, tmp_path / "undamped.json")) == undamped


def test_files_of_before_know_of_no_relaxation(tmp_path):
    path = wrod.save_rod(varied(), tmp_path / "model.json")
    content = json.loads(path.read_text())
    assert content.pop("relaxation_time") == 0.02
    path.write_text(json.dumps(content))
    assert wrod.load_rod(path) == varied(relaxation_time=0.0)


@pytest.mark.parametrize(
    "change",
    [
        {"format": "wrod-rod-model-9"},
        {"radius": None},
        {"bending_stiffness": [1.0]},
        {"law": {"name": "magic"}},
        {"law": {"name": "softening", "kept_stiffness": 0.1}},
        {"natural_twist": {"knots": [0.0, 0.0], "values": [1.0, 1.0]}},
        {"line_mass": {"knots": [0.0], "values": [1e999]}},
        {"point_masses": [[0.1]]},
        {"colour": "red"},
        {"length": [1.0]},
    ],
)
def test_spoiled_files_are_refused_in_one_sentence(tmp_path, change):
    path = wrod.save_rod(varied(), tmp_path / "model.json")
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(RodError, match=r"model\.json") as said:
        wrod.load_rod(path)
    assert len(str(said.value)) < 300


def test_the_same_rod_otherwise():
    model = varied()
    assert model.reversed().reversed().length == model.length
    s = np.linspace(0.0, 0.7, 30)
    twice = model.reversed().reversed()
    for a, b in zip(model.natural_curvature, twice.natural_curvature, strict=True):
        np.testing.assert_allclose(a(s), b(s), atol=1e-12)
    turned = model.turned(0.7).turned(-0.7)
    assert turned.principal_angle == pytest.approx(0.4)
    for a, b in zip(model.natural_curvature, turned.natural_curvature, strict=True):
        np.testing.assert_allclose(a(s), b(s), atol=1e-12)
    piece = model.piece(0.25, 0.65)
    np.testing.assert_allclose(piece.line_mass(s[:10]), model.line_mass(0.25 + s[:10]))
    np.testing.assert_allclose(piece.point_masses, [(0.05, 0.004), (0.36, 0.001)])
    unit = model.scaled(model.gravito_bending_length, 2.0 * model.weight * 0.05)
    assert unit.relaxation_time == pytest.approx(2.0 * unit.internal_damping)
    assert unit.gravity == 1.0 and unit.gravito_bending_length == pytest.approx(1.0)
    for rod in (wrod.rod("cable"), model):
        lgb, force = rod.gravito_bending_length, RodModel.of(rod).mean_bending_stiffness
        unit = RodModel.of(rod).scaled(lgb, force / lgb**2)
        assert unit.weight == pytest.approx(0.5)
        assert unit.mean_bending_stiffness == pytest.approx(1.0)


def test_a_mesh_has_all_of_the_rod():
    model = varied()
    s = np.sort(np.append(RNG.uniform(0.0, 0.7, 30), [0.0, 0.7]))
    arrays = mesh_arrays(model, s)
    mass = model.line_mass.integral(0.0, 0.7) + 0.005
    assert arrays["node_mass"].sum() == pytest.approx(mass)
    first_moment = (arrays["node_mass"][0] * s).sum()
    fine = np.linspace(0.0, 0.7, 20001)
    by_sum = np.trapezoid(model.line_mass(fine) * fine, fine)
    by_sum += sum(m * at for at, m in model.point_masses)
    assert first_moment == pytest.approx(by_sum, rel=2e-3)
    half = mesh_arrays(model, np.concatenate([[-0.02], s, [0.72]]), clamped=(True, True))
    assert half["node_mass"].sum() == pytest.approx(mass)
    # All of the rest state is there: what the clamps' halves lack in length, others do not get.
    around = 0.5 * (half["rest_length"][0, 1:] + half["rest_length"][0, :-1])
    twist = (half["natural_twist"][0, 1:-1] * around).sum()
    assert twist == pytest.approx(1.5 * 0.7)
    compliance = around / half["twisting_stiffness"][0, 1:-1]
    exact = np.trapezoid(1.0 / model.twisting_stiffness(fine), fine)
    assert compliance.sum() == pytest.approx(exact, rel=2e-3)


def test_rods_of_a_batch_are_their_own():
    models = [varied(), RodModel.of(wrod.rod("rope")), varied(radius=0.003)]
    s = np.linspace(0.0, 0.7, 12) * np.array([[1.0], [1.2], [0.9]])
    together = mesh_arrays(models, s)
    for i, model in enumerate(models):
        alone = mesh_arrays(model, s[i])
        for name, value in alone.items():
            np.testing.assert_array_equal(together[name][i], value[0])
    one = mesh_arrays(models[0], s)
    np.testing.assert_array_equal(one["node_mass"][0], together["node_mass"][0])
    with pytest.raises(RodError, match="2 rods and 3 meshes"):
        mesh_arrays(models[:2], s)
    with pytest.raises(RodError, match="does not ascend"):
        mesh_arrays(models[0], [0.0, 0.2, 0.1])


@pytest.mark.parametrize("name", ["reversed", "turned"])
def test_energy_does_not_depend_on_the_description(name):
    """One shape of one rod, described from its other end or in other directors."""
    model = varied(internal_damping=0.0)
    s = np.linspace(0.0, 0.7, 41)
    shape = np.stack([s, 0.05 * np.sin(6.0 * s), 0.3 * s**2], axis=1)
    m1 = np.array([0.0, -0.3, 1.0])
    batch = wrod.RodBatch.of(model, s, shape[None], director=m1)
    directors = batch.material_directors()[0, :, 0]
    angle = -model.principal_angle  # back to the material directors
    tangent = np.diff(shape, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    own = np.cos(angle) * directors + np.sin(angle) * np.cross(tangent, directors)
    if name == "reversed":
        other = wrod.RodBatch.of(
            model.reversed(), 0.7 - s[::-1], shape[None, ::-1], director=own[-1]
        )
    else:
        roll = 0.9
        back = np.cos(roll) * own[0] - np.sin(roll) * np.cross(tangent[0], own[0])
        other = wrod.RodBatch.of(model.turned(roll), s, shape[None], director=back)
    energy = [b.evaluate(order=1).energy.numpy()[0] for b in (batch, other)]
    assert energy[1] == pytest.approx(energy[0], rel=1e-10)


def test_knots_far_beyond_the_rod_are_spoken_of(tmp_path):
    mass = wrod.Profile((0.01, 0.02), (0.0, 885.0))
    path = wrod.save_rod(replace(wrod.RodModel.of(wrod.rod("green-vps")), line_mass=mass),
                         tmp_path / "rod.json")  # fmt: skip
    with pytest.warns(WrodWarning, match="knots in millimetres"):
        wrod.load_rod(path)


def test_a_rod_twisted_more_than_any_is_refused(tmp_path):
    twisted = replace(wrod.RodModel.of(wrod.rod("green-vps")), natural_twist=1e9)
    with pytest.raises(RodError, match="natural_twist is 1e\\+09 rad/m"):
        wrod.load_rod(wrod.save_rod(twisted, tmp_path / "rod.json"))


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ({"bending_stiffness": 6.1, "twisting_stiffness": 4.1}, "bends as a solid of 1.2e"),
        ({"twisting_stiffness": 4.1}, "times as hard as it twists"),
        ({"stretching_stiffness": 1e-5}, "stretches more easily than it bends"),
        ({"internal_damping": 65.0}, "65 s of internal damping"),
    ],
)
def test_a_file_in_other_units_is_asked_after(tmp_path, how, says):
    model = replace(wrod.RodModel.of(wrod.rod("green-vps")), **how)
    with pytest.warns(WrodWarning, match=says):
        wrod.load_rod(wrod.save_rod(model, tmp_path / "model.json"))


def test_a_steel_tape_is_no_file_in_other_units(tmp_path, recwarn):
    wide, thick, young, shear = 12e-3, 0.1e-3, 200e9, 77e9
    tape = wrod.RodModel(
        length=0.5, radius=thick, line_mass=7850.0 * wide * thick,
        bending_stiffness=(young * wide * thick**3 / 12.0, young * thick * wide**3 / 12.0),
        twisting_stiffness=shear * wide * thick**3 / 3.0, stretching_stiffness=young * wide * thick,
    )  # fmt: skip
    wrod.load_rod(wrod.save_rod(tape, tmp_path / "tape.json"))
    assert not recwarn.list
