"""Recorded rounds of launches do what fresh ones do."""

from concurrent.futures import ThreadPoolExecutor
from threading import Event

import numpy as np
import pytest
import warp as wp
from vps import RADIUS, STIFFNESS, WEIGHT, rods
from wrod.kernels.elastic.bend_twist import bend_twist_energy

from wrod.rods.state import RodState
from wrod.solvers.contact import Contact
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.friction import Friction
from wrod.solvers.recording import launching, workers
from wrod.solvers.rod_contact import RodContact
from wrod.solvers.statics import EquilibriumSolver, prescribe

DEVICES = [
    "cpu",
    pytest.param(
        "cuda:0", marks=pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")
    ),
]


def crossing_rods(device, **options):
    """Scenes in which a rod falls across one that lies on the table, from other heights."""
    x = np.linspace(-0.035, 0.035, 15)
    zero = np.zeros_like(x)
    lying = np.column_stack([x, zero, zero + RADIUS])
    scenes = [
        np.concatenate([lying, np.column_stack([zero + 0.002, x, zero + height])])
        for height in (4.9e-3, 6e-3, 9e-3)
    ]
    batch = rods(np.stack(scenes), cuts=[14], device=device)
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    table = Contact(batch, RADIUS, WEIGHT / (0.01 * RADIUS), Friction(0.3))
    between = RodContact(batch, RADIUS, Friction(0.3))
    return Dynamics(
        batch, scheme="euler", radius=RADIUS, contact=[table, between], tolerance=1e-5, **options
    )


@pytest.mark.parametrize("device", DEVICES)
def test_steps_with_contacts(device):
    """Over many calls, another step length and another tolerance."""
    results = []
    for keeps, where in ((True, device), (False, "cpu")):
        dynamics = crossing_rods(where, keeps_recording=keeps)
        for k in range(24):
            if k == 12:
                dynamics.tolerance = 1e-4
            progress = dynamics.advance(0.01 * (k + 1), 0.004 if k < 18 else 0.01)
        assert (dynamics._recording is not None) == keeps
        assert not progress.diverged.any() and np.allclose(progress.time, 0.24)
        touching = (dynamics.rod_contact.depth.numpy() > 0).any(axis=(1, 2))
        assert touching.all()
        results.append((progress.steps, progress.iterations, dynamics.batch.positions()))
    (steps, iterations, here), (fresh_steps, fresh_iterations, there) = results
    if device == "cpu":
        assert (steps == fresh_steps).all() and (iterations == fresh_iterations).all()
    assert np.abs(here - there).max() < (1e-14 if device == "cpu" else 1e-6)


@pytest.mark.parametrize("device", DEVICES)
def test_long_ways_are_watched(device):
    """More rounds than are taken on end: all steps are taken, and the caller is told of them."""
    seen = []
    dynamics = crossing_rods(device, keeps_recording=True)
    progress = dynamics.advance([0.1, 0.2, 0.3], 5e-4, progress=seen.append)
    assert np.allclose(progress.time, [0.1, 0.2, 0.3]) and progress.steps.max() >= 600
    assert len(seen) > 3 and (np.diff([times.min() for times in seen]) >= 0).all()
    again = dynamics.advance([0.1, 0.2, 0.3], 5e-4)
    assert (again.steps == progress.steps).all()


def test_motion_of_a_rod_that_changes():
    """Of a rod that touches nothing rounds are kept from call to call, and what a caller sets in
    between takes part, to the last bit."""

    def swinging(keeps):
        x = np.linspace(0.0, 0.07, 15)
        batch = rods(np.column_stack([x, 0.02 * np.sin(20.0 * x), 0.0 * x])[None])
        prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
        return Dynamics(batch, radius=RADIUS, keeps_recording=keeps)

    def gravity(one):
        one.batch.gravity = wp.array([wp.vec3d(0.0, 9.0, 0.0)], dtype=wp.vec3d, device="cpu")

    changes = [
        lambda one: None,
        lambda one: one.batch.bending_stiffness.assign(0.5 * one.batch.bending_stiffness.numpy()),
        gravity,
        lambda one: one.batch.set_softening([1e-4, 0.2]),
        lambda one: one.set_drag([0.001, 0.0]),
        lambda one: setattr(one, "tolerance", 1e-11),
        lambda one: setattr(one, "max_iterations", 3),
    ]
    chosen, kept, ends = [swinging(None), swinging(False)], [], []
    for k, change in enumerate(changes):
        before = chosen[0]._recording
        for one in chosen:
            change(one)
            progress = one.advance(0.04 * (k + 1), 0.01)
        kept.append(before is not None and chosen[0]._recording is before)
        ends.append((progress.steps[0], *(one.batch.positions() for one in chosen)))
        assert np.array_equal(*ends[-1][1:])
    assert kept == [False, True, False, False, False, False, False]
    assert ends[-1][0] - ends[-2][0] > 4 and chosen[1]._recording is None


def test_equilibria_of_a_rod_that_changes(monkeypatch):
    """A solver that goes on with what it recorded finds what a new one does, to the last bit: of
    other stiffness and load, another law, and another energy."""
    monkeypatch.setattr("wrod.solvers.statics._LAUNCHED", 1)  # so few rounds are not recorded else
    x = np.linspace(0.0, 0.07, 15)
    batch = rods(np.column_stack([x, 0.02 * np.sin(20.0 * x), 0.0 * x])[None])
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    solver, start = EquilibriumSolver(batch), RodState.zeros(1, 15, batch.device)
    start.assign(batch.state)
    changes = [
        lambda: None,
        lambda: batch.bending_stiffness.assign(0.5 * batch.bending_stiffness.numpy()),
        lambda: batch.point_load.assign(np.full((1, 15, 3), WEIGHT / 15)),
        lambda: batch.set_softening([1e-4, 0.2]),
        lambda: batch.set_softening([2e-4, 0.1]),
        lambda: batch.add_energy(bend_twist_energy, [0.1 * STIFFNESS, 0.0]),
    ]
    found, kept = [], []
    for change in changes:
        change()
        before, ends = list(solver._recorded.values()), []
        for one in (solver, EquilibriumSolver(batch)):
            batch.state.assign(start)
            assert one.solve().converged.all()
            ends.append(batch.positions())
        assert np.array_equal(*ends)
        found.append(ends[0])
        kept.append(before != [] and before[0] is next(iter(solver._recorded.values())))
    assert kept == [False, True, True, False, True, False]
    assert all(np.abs(np.diff(found, axis=0)).max(axis=(1, 2, 3)) > 1e-6)


def test_nothing_is_recorded_beside_a_thread_that_may_launch():
    """What a caller's thread launches of its own, outside the library's calls, is done at once, and
    is no part of what another thread replays."""
    ran, ends = Event(), Event()

    def launch_on():
        sums = []
        while not ends.is_set():
            sums.append(float(wp.full(3, 2.0, dtype=wp.float64, device="cpu").numpy().sum()))
            ran.set()
        return sums

    def fall():
        dynamics = crossing_rods("cpu", keeps_recording=True)
        dynamics.advance(0.05, 0.004)
        return dynamics.batch.positions(), dynamics.is_recorded

    expected, recorded = fall()
    with ThreadPoolExecutor(1) as pool:
        sums = pool.submit(launch_on)
        ran.wait()
        found, beside = fall()
        ends.set()
    assert set(sums.result()) == {6.0}
    assert np.array_equal(found, expected) and recorded and not beside


def test_threads_of_the_library_record_beside_each_other():
    def fall(_):
        with launching():
            dynamics = crossing_rods("cpu", keeps_recording=True)
        for k in range(6):
            dynamics.advance(0.01 * (k + 1), 0.004)
        with launching():
            return dynamics.batch.positions(), dynamics.is_recorded

    expected = fall(0)
    with workers(2) as pool:
        found = list(pool.map(fall, range(2)))
    assert all(np.array_equal(one, expected[0]) and recorded for one, recorded in found)
