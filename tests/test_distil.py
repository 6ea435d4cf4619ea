"""Optimised plans as a dataset, and the network that learns them."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from cli import refused

import wrod
from wrod.controller.corrector import Corrector, CorrectorInputs
from wrod.deployment.simulate import nodes_needed
from wrod.errors import DataError, OutOfRangeWarning

plans = pytest.importorskip("wrod.training.plans")
plan_files = pytest.importorskip("wrod.training.plan_files")
pytest.importorskip("torch")


def synthetic(index, seed=0):
    """A plan whose correction is a simple function of what lies ahead."""
    rng = np.random.default_rng([seed, index])
    laid = np.arange(0.0, 14.0, 0.4)
    curvature = np.sin(laid * rng.uniform(0.3, 0.8) + rng.uniform(0.0, 6.0))
    friction = float(rng.uniform(0.2, 0.6))
    ahead = np.interp(laid + 1.0, laid, curvature, right=0.0)
    slides = 0.1 / friction
    moved = np.column_stack([slides * ahead**2, slides * ahead, -0.1 * ahead**2])
    count = moved.size
    matrix, static = np.eye(count) / len(moved), float(np.mean(moved**2) * 3)
    bowls = (
        plan_files.Bowl(static, -matrix @ moved.ravel(), matrix),
        plan_files.Bowl(0.0, np.zeros(count), matrix),
    )
    anchors = np.stack([np.zeros_like(moved), moved])
    basis = np.eye(len(moved))
    return plan_files.Sample(laid, curvature, basis, anchors, bowls, 26.0, 2000.0, friction)


def test_random_patterns_leave_some_rod_and_bend_within_reason():
    for index in range(40):
        held = wrod.rod(wrod.rod_names()[index % 3])
        one = plans.random_pattern(np.random.default_rng(index), held)
        lgb = held.gravito_bending_length
        s = np.linspace(0.0, one.length, 500)
        assert one.length <= held.length - 3.0 * lgb * (1.0 - 1e-9)
        assert np.abs(one.sample(s)[2]).max() * lgb < 2.2
        place, tangent, _ = one.sample(s)
        steps = np.diff(place, axis=0)
        assert np.einsum("ij,ij->i", steps, tangent[:-1]).min() > 0.0


def test_plans_are_shared_by_ranks_and_kept(tmp_path, monkeypatch):
    asked = []

    def solve(index, seed):
        asked.append(index)
        yield from ()
        return None if index == 3 else synthetic(index, seed)

    monkeypatch.setattr(plans, "solve", solve)
    assert plans.generate(tmp_path, 6, rank=plans.Rank(1, 2, 1, 2)) == (2, 1)
    assert plans.generate(tmp_path, 6) == (5, 1) and sorted(asked) == [0, 1, 2, 3, 4, 5]
    found = plan_files.load(tmp_path)
    assert len(found) == 5
    for one, index in zip(found, (0, 1, 2, 4, 5), strict=True):
        wanted = synthetic(index)
        assert one.correction == pytest.approx(wanted.correction, abs=1e-6)
        assert one.friction == wanted.friction
        for found_bowl, bowl in zip(one.bowls, wanted.bowls, strict=True):
            half = {"rel": 5e-4, "abs": 1e-7}
            assert found_bowl.value == pytest.approx(bowl.value, **half)
            assert found_bowl.slope == pytest.approx(bowl.slope, **half)
            assert found_bowl.matrix == pytest.approx(bowl.matrix, **half)
    with pytest.raises(DataError, match="another seed"):
        plans.generate(tmp_path, 6, seed=1)
    (tmp_path / "plan-000002.npz").write_bytes(b"PK")
    with pytest.raises(DataError, match="is not readable"):
        plan_files.load(tmp_path)


def constant(forward):
    """A corrector that moves the grip forward by so much everywhere [L_gb]."""
    parameters = {
        "scale": np.ones(3),
        "weight.0": np.zeros((3, wrod.controller.corrector.FEATURES)),
    }
    parameters["bias.0"] = np.array([forward, 0.0, 0.0])
    names = ("friction", "curvature", "rod_length", "stretch_ratio")
    limits = {name: [0.0, 1e9] for name in names}
    return Corrector(parameters, {"range": limits})


def test_what_a_network_lays_is_kept_once_a_round(tmp_path, monkeypatch):
    made = {index: synthetic(index) for index in range(6) if index != 3}
    for index in range(6):
        plan_files.store(tmp_path / f"plan-{index:06d}.npz", made.get(index))
    asked = []

    def visit(index, seed, sample, corrector):
        asked.append(index)
        yield from ()
        return sample.laid_by(0.5 * sample.anchors[1], sample.bowls[0])

    monkeypatch.setattr(plans, "visit", visit)
    ours = plans.Rank(1, 2, 1, 2)
    plans.visit_all(tmp_path, 6, constant(0.0), 1, rank=ours)
    assert sorted(asked) == [1, 5]
    plans.visit_all(tmp_path, 6, constant(0.0), 1)
    assert sorted(asked) == [0, 1, 2, 4, 5]
    plans.visit_all(tmp_path, 6, constant(0.0), 2, rank=ours)
    found = plan_files.load(tmp_path)
    assert [len(one.bowls) for one in found] == [3, 4, 3, 3, 4]
    assert found[0].anchors[2] == pytest.approx(0.5 * made[0].anchors[1], abs=1e-6)


def test_meshes_of_plans_do_not_depend_on_their_batch():
    """All that two plans ask for says how many nodes its rods have, and they share a batch."""
    from wrod.deployment.together import _groups

    asked = dict(enumerate(next(plans.solve(index, 1)) for index in range(2)))
    needed = [nodes_needed(one.trials, one.how["discretisation"].spacing) for one in asked.values()]
    counts = {one.how["discretisation"].node_count for one in asked.values()}
    assert len(set(needed)) == 2 and len(counts) == 1 and min(counts) >= max(needed)
    assert len(_groups(asked)) == 1


def test_models_of_the_error_say_what_a_network_lays(monkeypatch):
    """By a grip that is 0.1 mm ahead or behind all the way, more of which the rod answers to with
    sliding; where it is not, what lies is what lay."""
    from wrod.deployment import descent
    from wrod.deployment.together import follow

    monkeypatch.setattr(descent, "_TOLERANCE", 1e-5)
    (one,) = follow([plans.solve(0, 0)], hold=0.05)
    assert one.errors[1] < 0.5 * one.errors[0]
    values, ways = {}, (0.0, 0.001, -0.001)
    visits = follow([plans.visit(0, 0, one, constant(forward)) for forward in ways], hold=0.05)
    for forward, laid in zip(ways, visits, strict=True):
        moved = np.broadcast_to([forward, 0.0, 0.0], laid.anchors[2].shape)
        assert laid.anchors[2] == pytest.approx(moved, abs=1e-12)
        values[forward] = laid.bowls[2].value
    static, moved = one.bowls[0], np.tile([0.001, 0.0, 0.0], len(one.anchors[0]))
    assert values[0.0] == pytest.approx(static.value, rel=1e-9)
    rise = 0.5 * (values[0.001] - values[-0.001])
    assert rise == pytest.approx(2.0 * static.slope @ moved, rel=0.1)


def test_a_network_learns_what_plans_do_and_mirrors_it(tmp_path):
    from wrod.training.distil import course_of, distil

    corrector = distil([synthetic(i) for i in range(32)], steps=150)
    said = corrector.metadata
    assert said["error"] < 0.5 * said["static"] and said["optimised"] == 0.0
    path = corrector.save(tmp_path / "corrections.safetensors")
    fresh = synthetic(1000)
    course = replace(course_of(fresh), friction=0.3)
    found = Corrector.load(path).predict(course)
    assert found == pytest.approx(corrector.predict(course), abs=0.0)
    apart = Corrector.load(path).predict(course_of(fresh)) - fresh.correction
    assert np.sqrt(np.mean(apart**2)) < 0.5 * np.sqrt(np.mean(fresh.correction**2))
    mirrored = corrector.predict(replace(course, curvature=-course.curvature))
    assert mirrored == pytest.approx(found * [1.0, -1.0, 1.0], abs=1e-12)
    with pytest.warns(OutOfRangeWarning, match=r"friction 0\.05"):
        corrector.predict(replace(course, friction=0.05))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        corrector.predict(course)


def test_a_corrector_sees_no_curvature_where_nothing_is_laid():
    course = CorrectorInputs(np.linspace(0.0, 12.0, 60), np.ones(60), 20.0, 1500.0, 0.3)
    seen = course.features()[:, : len(wrod.controller.corrector.WINDOW)]
    assert seen[0, 0] == 0.0 and seen[-1, -1] == 0.0 and seen[28].min() == 1.0


def test_too_few_plans_are_refused(tmp_path):
    arguments = ["distil", "--size", "3", "--out", str(tmp_path / "out")]
    refused("--size", *arguments)
    assert not (tmp_path / "out").exists()


def test_a_distilled_plan_bends_further_where_it_slides_and_refuses_what_it_does_not_know():
    pattern, rod = wrod.pattern("letter-U"), wrod.rod("green-vps")
    base = wrod.plan(pattern, rod, spacing=0.01, left=True)
    one = wrod.plan(pattern, rod, "distilled", spacing=0.01, friction=0.3)
    moved = np.linalg.norm(one.position - base.position, axis=1)
    said = one.metadata["distilled"]
    assert 1e-3 < moved.max() < 2.0 * rod.gravito_bending_length
    assert wrod.pose_times(one) == pytest.approx(wrod.pose_times(one, 0.04))
    assert said["friction"] == pytest.approx(0.3) and one.rotation == pytest.approx(base.rotation)
    with pytest.raises(wrod.errors.GraspError, match="say its friction"):
        wrod.plan(pattern, rod, "distilled")
    curved = replace(rod, natural_curvature=(2.0, 0.0))
    with pytest.raises(wrod.errors.GraspError, match="straight uniform rods only"):
        wrod.plan(pattern, curved, "distilled", spacing=0.02, friction=0.3)


def test_the_network_learns_what_lies_and_not_what_the_corrections_are():
    """Only corrections to the left decide here what lies, and those to the front are noise."""
    from wrod.training.distil import course_of, distil

    rng = np.random.default_rng(1)
    samples = []
    for index in range(32):
        one = synthetic(index)
        wanted = one.anchors[1]
        matters = np.kron(np.eye(len(wanted)), np.diag([0.0, 1.0, 0.0])) / len(wanted)
        values = wanted + rng.standard_normal(wanted.shape) * [1.0, 0.0, 1.0]
        slope = -matters @ values.ravel()
        bowls = (
            plan_files.Bowl(float(-slope @ values.ravel()), slope, matters),
            plan_files.Bowl(0.0, np.zeros(values.size), matters),
        )
        samples.append(replace(one, anchors=np.stack([0.0 * values, values]), bowls=bowls))
    corrector = distil(samples, steps=150)
    assert corrector.metadata["error"] < 0.5 * corrector.metadata["static"]
    fresh = synthetic(1000)
    found = corrector.predict(course_of(fresh))[:, 1]
    wanted = fresh.correction[:, 1]
    assert np.sqrt(np.mean((found - wanted) ** 2)) < 0.5 * np.sqrt(np.mean(wanted**2))
