"""Ends that give as the rod pulls at them."""

from dataclasses import replace

import numpy as np
import pytest

from tests.hidden import kept
from wrod.identification import identify
from wrod.identification.clamped.fit import Fit, fit_models
from wrod.identification.clamped.giving import giving_for, giving_of, settled, sole_ends
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.loading import measurements_from_arrays
from wrod.identification.clamped.profiles import KNOTS, ProfileEffect
from wrod.identification.clamped.steps import base_fit
from wrod.identification.effect import Model, effects

PLAY = 0.06  # [rad]
SOFT = 100.0  # [rad/(N m)]


@pytest.fixture(scope="module")
def laboratory():
    return Laboratory(measurements_from_arrays(kept("none 1", 101, "pose")[0]))


def _turned(laboratory, name: str) -> Fit:
    """The base model as one in which an end is turned, by nothing."""
    return replace(base_fit(laboratory), model=Model((effects()[name],)), values=np.zeros(3))


def test_moments_at_the_gripper_are_those_that_the_wrist_reads(laboratory):
    (play, _), (soft, _) = giving_for(laboratory, _turned(laboratory, "grip_rotation"), 0)
    solver, setup = laboratory.solver_at(Model(), np.zeros(0))
    torque = solver.predict([setup]).torque[0].real
    rotation = laboratory.measurements.grip_rotation
    expected = -np.einsum("tij,ti->tj", rotation, torque) * [1.0, 1.0, 0.0]
    size = np.linalg.norm(expected, axis=1, keepdims=True)
    assert np.abs(soft.turn - expected).max() < 5e-3 * size.max()
    assert (soft.turn * expected).sum() == pytest.approx((expected**2).sum(), rel=1e-4)
    assert np.linalg.norm(play.turn, axis=1) == pytest.approx(1.0)
    assert play.turn == pytest.approx(expected / size, abs=0.02)


def _measured(laboratory, giving):
    """What is measured of rods at an end that gives so, with noise."""
    fit = replace(base_fit(laboratory), model=Model((giving,)))
    for _ in range(4):  # until the end lies where its own rods pull it to
        own = replace(fit, values=np.array([PLAY if giving.has_play else SOFT]))
        fit = replace(own, model=Model((giving_of(laboratory, own, giving.end, giving.has_play),)))
    seen, rng = laboratory.observe(fit.model, own.values), np.random.default_rng(5)
    seen = seen + laboratory.deviation * rng.normal(size=seen.shape)
    data, markers = dict(kept("none 1", 101, "pose")[0]), seen[:, :-6]
    data["centerline"] = markers.reshape(data["centerline"].shape)
    data["grip_force"], data["grip_torque"] = seen[:, -6:-3], seen[:, -3:]
    return measurements_from_arrays(data)


def test_fingers_of_rubber_stand_for_slip_and_an_offset_together(laboratory):
    soft = giving_of(laboratory, base_fit(laboratory), "grip", False)
    rubber = Laboratory(_measured(laboratory, soft))
    base = base_fit(rubber)
    pair = Model((effects()["grip_slip"], effects()["grip_offset"]))
    (two,) = fit_models(rubber, [pair], [np.zeros(4)], origin=base, race=False)
    ends = sole_ends(rubber, two, base)
    assert [f.model.names for f in ends] == [("grip_play",), ("grip_compliance",)]
    one = settled(rubber, ends[1])
    assert one.bic < two.bic - 10.0  # both leave noise
    error = one.covariance[0, 0] ** 0.5
    assert error < 0.1 * SOFT and abs(one.values[0] - SOFT) < 3.0 * error
    assert not sole_ends(rubber, one, base)  # of one effect there is nothing to stand for


def test_ends_that_stand_for_a_profile_of_three_components_start_from_nothing(laboratory):
    effect = ProfileEffect("stiffness", np.ones((KNOTS, 1, 3)))
    fit = replace(base_fit(laboratory), model=Model((effect,)), values=np.full(3, 0.01))
    ways = giving_for(laboratory, fit, 0)
    assert [way.name for way, _ in ways] == ["clamp_compliance", "grip_compliance"]
    assert all(start == [0.0] for _, start in ways)


@pytest.mark.usefixtures("on_coarse_meshes")
def test_a_loose_clamp_is_not_called_a_turned_one(laboratory):
    fit = _turned(laboratory, "clamp_rotation")
    loose = giving_for(laboratory, fit, 0)[0][0]
    report = identify(
        _measured(laboratory, loose), candidates=["clamp_rotation", "grip_rotation", "stiffness"]
    )
    (effect,) = report.effects
    assert report.verdict == "explained" and effect.name == "clamp_play"
    told = effect.parameters["play"]
    assert told.stderr < 0.1 * PLAY and abs(told.value - PLAY) < 3.0 * told.stderr
