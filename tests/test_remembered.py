"""Deployments that go on from others which began like them."""

from dataclasses import replace

import numpy as np
import pytest

import wrod
from wrod.deployment.expectation import COARSE, PACE
from wrod.deployment.remembered import LastDeployments
from wrod.deployment.setup import Disturbance
from wrod.deployment.tangents import Directions, lay
from wrod.deployment.trial import Trial
from wrod.deployment.way import GripWay
from wrod.planning.tail import Tail
from wrod.rods.law import Plastic

ROD = wrod.RodMaterial(0.0016, 0.032, 0.4)
WIRE = replace(wrod.RodModel.of(ROD), law=Plastic(10.0, 0.4))
SHAKEN = Disturbance(jitter=2e-4, shaking_time=60.0, natural_curvature=1.0)
LGB = ROD.gravito_bending_length


@pytest.fixture(scope="module")
def way():
    s = np.linspace(0.0, 0.3, 400)
    heading = 0.5 * (1.0 + np.tanh((s - 0.15) / 0.04))
    points = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0) * s[1]
    pattern = wrod.Pattern.from_points(points)
    return pattern, GripWay(wrod.plan(pattern, ROD, spacing=0.005))


def laid(pattern, path, columns, remembered=None, friction=0.3, rod=ROD):
    """By a path, with derivatives by the rod and its table and then along columns of the path."""
    trial = Trial(pattern, rod, path, wrod.Friction(friction), SHAKEN, Tail.none(path))
    directions = Directions.of_rod(len(path))
    if columns is not None:
        directions += Directions.of_path(columns[:, : len(path)])
    mesh = replace(COARSE, step=0.02, tolerance=1e-6, laid=pattern.length)
    known = None if remembered is None else [remembered]
    how = {"discretisation": mesh, "speed": PACE, "remembered": known}
    (lies,) = lay([trial], [directions], **how)
    return lies


def begins(remembered):
    """Times [s] at which the deployments that are remembered went on from others, as the number of
    moments that they share with the first of them says."""
    first = {id(one) for one in remembered.runs[0].moments}
    return [max((m.time for m in run.moments if id(m) in first), default=0.0)
            for run in remembered.runs[1:]]  # fmt: skip


@pytest.mark.parametrize("rod", [ROD, WIRE], ids=["linear", "plastic"])
def test_what_goes_on_lies_as_if_it_had_been_laid_whole(way, rod):
    """After a correction from 18 cm on, with derivatives by it and by what had begun before."""
    pattern, way = way
    remembered = LastDeployments()
    laid(pattern, way.until(0.18).path, None, remembered, rod=rod)
    corrections = way.corrections(pattern, LGB, 0.18, 0.28, 0.01)
    values = np.zeros(corrections.count)
    values[4] = 0.05
    path, columns = GripWay(corrections.apply(values)).until(0.28).path, corrections.columns()
    on, whole = (laid(pattern, path, columns, one, rod=rod) for one in (remembered, None))
    (since,) = begins(remembered)
    assert since > 2.5  # of some 4 s until 18 cm are laid
    assert abs(on.steps - whole.steps) <= 5
    assert np.abs(on.centerline - whole.centerline).max() < 2e-6
    assert np.abs(on.slip - whole.slip).max() < 1e-5
    largest = np.abs(whole.tangent).max(axis=(1, 2))
    apart = np.abs(on.tangent - whole.tangent).max(axis=(1, 2))
    assert (apart < 1e-4 * largest).all() and len(apart) == 3 + len(columns)


def test_another_table_is_laid_from_the_start(way):
    pattern, way = way
    remembered = LastDeployments()
    for friction in (0.3, 0.31):
        lies = laid(pattern, way.until(0.15).path, None, remembered, friction)
    assert begins(remembered) == [0.0]
    alone = laid(pattern, way.until(0.15).path, None, None, 0.31)
    assert np.abs(lies.centerline - alone.centerline).max() < 1e-9
