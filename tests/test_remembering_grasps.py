"""Grasps and plans of rods that stay bent, against a continuous rod and their own deployments."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

import wrod
from wrod.errors import GraspError
from wrod.grasps import relaxed
from wrod.grasps.mesh import WEIGHT
from wrod.rods.law import Dahl, Linear, Plastic
from wrod.rods.model_file import rod_as_json

LGB = 0.032
ROD = wrod.RodModel.of(wrod.RodMaterial(0.0016, LGB, 12.0 * LGB))


def of_law(law, rod=ROD):
    return replace(rod, law=law)


def steady_grip(law, length, guess):
    """(x, z) of the grip from the contact [L_gb] where a rod is laid along a straight line, and
    what `fsolve` began with for the next: a point of the rod has been everywhere between grip and
    contact, so that what it remembers is an integral along the shape from the grip on."""
    curvature, kept = (1e9, 1.0) if isinstance(law, Linear) else law._values

    def rates(s, y, lift):
        angle, _, excess, lagging = y[2:]
        rate = np.cos(angle) * (lift + WEIGHT * (length - s))
        by = 1.0
        if isinstance(law, Plastic) and abs(lagging) >= curvature and lagging * rate > 0.0:
            by = 0.0
        if isinstance(law, Dahl):
            by = 1.0 - lagging / curvature * np.sign(rate)
        bend = rate / (kept + (1.0 - kept) * by)
        return [-np.cos(angle), -np.sin(angle), -excess, rate, bend, by * bend]

    def shot(unknown):
        start = [0.0, 0.0, 0.5 * np.pi - np.exp(unknown[0]), 0.0, 0.0, 0.0]
        with_lift = (0.0, length), start, "RK45", None
        return solve_ivp(rates, *with_lift, args=(unknown[1],), max_step=length / 100, rtol=1e-8,
                         atol=1e-11).y[:, -1]  # fmt: skip

    found = fsolve(lambda unknown: shot(unknown)[[2, 4]], guess, xtol=1e-9)
    end = shot(found)
    assert np.abs(end[[2, 4]]).max() < 1e-6
    return -end[:2], found


@pytest.mark.parametrize("law", [Plastic(0.3, 0.5), Dahl(0.3, 0.5)], ids=lambda law: law.name)
def test_a_rod_laid_along_a_line_hangs_as_a_continuous_one_does(law):
    contacts, length = [0.0, 6.0 * LGB], 6.0
    linear, start = steady_grip(Linear(), length, [-4.3, -0.76])
    exact = steady_grip(law, length, start)[0] - linear
    stays = wrod.solve_rod_grasps(of_law(law.scaled(1.0 / LGB, 1.0)), contacts, 0.0, device="cpu")
    straight = wrod.solve_rod_grasps(ROD, contacts, 0.0, device="cpu")
    assert stays.converged.all()
    here = (stays.position - straight.position)[1, [0, 2]] / LGB
    # The continuous rod does not stretch, which the difference hardly feels.
    np.testing.assert_allclose(here, exact, atol=1e-3)
    assert np.abs(exact).min() > 0.05


def test_a_rod_that_never_yields_hangs_as_a_linear_one():
    contacts, curvature = np.linspace(0.0, 0.2, 9), np.linspace(0.0, 20.0, 9)
    linear = wrod.solve_rod_grasps(ROD, contacts, curvature, device="cpu", edge_count=32)
    wire = of_law(Plastic(60.0, 0.2))
    stays = wrod.solve_rod_grasps(wire, contacts, curvature, device="cpu", edge_count=32)
    np.testing.assert_allclose(stays.position, linear.position, atol=1e-10)
    np.testing.assert_allclose(stays.rotation, linear.rotation, atol=1e-8)


def test_grasps_converge_with_the_distance_of_contacts():
    """Twice, and in a mirror."""
    wire, how = of_law(Plastic(10.0, 0.4)), dict(device="cpu", edge_count=32)
    contacts = np.linspace(0.0, 0.8 * LGB, 33)
    curvature = 15.0 * np.sin(contacts / 0.03)
    fine, less, least = (
        wrod.solve_rod_grasps(wire, contacts[::k], curvature[::k], **how) for k in (1, 2, 4)
    )
    far, near = (
        np.abs(one.position[::k] - fine.position[::4]).max()
        for one, k in ((least, 1), (less, 2))
    )  # fmt: skip
    assert near < 0.5 * far < 0.01 * LGB
    mirrored = wrod.solve_rod_grasps(wire, contacts[::4], -curvature[::4], **how)
    np.testing.assert_allclose(mirrored.position, least.position * [1, -1, 1], atol=1e-8)


def test_a_wire_that_yields_early_is_found():
    """Whole sweeps go to and fro."""
    contacts = np.linspace(0.0, 2.4 * LGB, 25)
    wire = of_law(Plastic(8.0, 0.3))
    found = wrod.solve_rod_grasps(wire, contacts, 0.0, device="cpu", edge_count=32)
    assert found.converged.all()


def test_where_a_bent_wire_cannot_hang_a_straighter_one_does(monkeypatch):
    knots = np.arange(0.0, ROD.length, 0.03)
    bends = 45.0 * np.random.default_rng(2).uniform(-1.0, 1.0, (2, len(knots)))
    wire = replace(
        of_law(Plastic(10.0, 0.5)), natural_curvature=tuple(wrod.Profile(b, knots) for b in bends)
    )
    contacts, lines = np.linspace(0.11, 0.16, 8), np.zeros(8)
    how = dict(held_roll=0.5 * np.pi, edge_count=32, device="cpu")
    solved, solve = [], relaxed.solve_rod_grasps

    def kept(*args, **options):
        solved.append((options["natural_share"], solve(*args, **options)))
        return solved[-1][1]

    monkeypatch.setattr(relaxed, "solve_rod_grasps", kept)
    grasps, share = relaxed.solve_relaxed(wire, contacts, lines, **how)
    asked, own = solved[0]
    assert (asked == 1.0).all() and len(own) == len(contacts)
    assert 2 < (~own.converged).sum() < 6
    assert grasps.converged.all()
    assert (share[~own.converged] < 1.0).all() and (share > 0.0).all()
    # They are the same whether asked for with the share beforehand, and twice of it is too much.
    known = wrod.solve_rod_grasps(wire, contacts, lines, natural_share=share, **how)
    np.testing.assert_array_equal(known.position, grasps.position)
    more = np.minimum(2.0 * share, 1.0)
    more = wrod.solve_rod_grasps(wire, contacts, lines, natural_share=more, **how)
    assert not more.converged[~own.converged].all()


def test_contacts_of_a_rod_that_remembers_are_in_order():
    with pytest.raises(GraspError, match="in the order"):
        wrod.solve_rod_grasps(of_law(Plastic(5.0, 0.1)), [0.1, 0.05], 1.0)


@pytest.mark.parametrize("law", [Linear(), Plastic(5.0, 0.1)], ids=lambda law: law.name)
def test_no_contacts_are_named(law):
    none, rod = np.zeros(0), replace(of_law(law), natural_curvature=(1.0, 0.0))
    for solve in (wrod.solve_rod_grasps, relaxed.solve_relaxed):
        with pytest.raises(GraspError, match="at least one"):
            solve(rod, none, none, held_roll=0.0)


@pytest.mark.parametrize("law", [Plastic(9.0, 0.4), Dahl(9.0, 0.5)], ids=lambda law: law.name)
def test_a_plan_that_knows_what_stays_lays_it_better(law):
    s = np.linspace(0.0, 0.15, 150)
    heading = 0.7 * (1.0 + np.tanh((s - 0.09) / 0.03))
    points = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0) * s[1]
    pattern = wrod.Pattern.from_points(points)
    short = replace(ROD, length=8.0 * LGB)
    rod = of_law(law, short)
    how = dict(spacing=0.0075, closure="zero_tension", device="cpu")
    knows, plain = (wrod.plan(pattern, one, **how) for one in (rod, short))
    assert knows.metadata["remembers"] == law.name and knows.metadata["solver"] == "rod solver"
    plain = replace(plain, metadata=plain.metadata | {"rod": rod_as_json(rod)})
    mesh = wrod.Discretisation(0.01, 0.02)
    trials = [wrod.Trial(pattern, rod, one, wrod.Friction(1.0)) for one in (knows, plain)]
    # So slowly that damping hardly bends the rod otherwise.
    better, worse = wrod.simulate_deployments(trials, speed=0.0125, hold=0.02, discretisation=mesh)
    assert not better.diverged
    assert better.error_mean < 0.35 * worse.error_mean
