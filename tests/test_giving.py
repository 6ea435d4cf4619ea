"""Ends that give as the rod pulls at them."""

from dataclasses import replace

import numpy as np
import pytest

from tests.hidden import kept
from wrod.identification import identify
from wrod.identification.clamped.fit import Fit
from wrod.identification.clamped.giving import giving_for, giving_of
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.loading import measurements_from_arrays
from wrod.identification.clamped.steps import base_fit
from wrod.identification.effect import Model, effects

PLAY = 0.06  # [rad]


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


@pytest.mark.usefixtures("on_coarse_meshes")
def test_a_loose_clamp_is_not_called_a_turned_one(laboratory):
    fit = _turned(laboratory, "clamp_rotation")
    model = Model((giving_for(laboratory, fit, 0)[0][0],))
    for _ in range(4):  # until the clamp lies where its own rods pull it to
        own = replace(fit, model=model, values=np.array([PLAY]))
        model = Model((giving_of(laboratory, own, "clamp", True),))
    seen, rng = laboratory.observe(model, own.values), np.random.default_rng(5)
    seen = seen + laboratory.deviation * rng.normal(size=seen.shape)
    data, markers = dict(kept("none 1", 101, "pose")[0]), seen[:, :-6]
    data["centerline"] = markers.reshape(data["centerline"].shape)
    data["grip_force"], data["grip_torque"] = seen[:, -6:-3], seen[:, -3:]
    report = identify(
        measurements_from_arrays(data), candidates=["clamp_rotation", "grip_rotation", "stiffness"]
    )
    (effect,) = report.effects
    assert report.verdict == "explained" and effect.name == "clamp_play"
    told = effect.parameters["play"]
    assert told.stderr < 0.1 * PLAY and abs(told.value - PLAY) < 3.0 * told.stderr
