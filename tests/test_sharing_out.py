"""Deployments that are shared out to batches and threads."""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Event, get_ident

import numpy as np
import pytest
import warp as wp

import wrod
from wrod import machine
from wrod.deployment import sharing_out, simulate
from wrod.deployment.simulate import simulate_deployments
from wrod.deployment.tangents import Directions, lay
from wrod.solvers import dynamics, recording

needs_gpu = pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")
DEVICES = ["cpu", pytest.param("cuda:0", marks=needs_gpu)]


@pytest.mark.parametrize("device", DEVICES)
def test_deployments_shared_out_are_those_of_one_batch(device, letter, monkeypatch):
    pattern, rod = wrod.pattern("letter-C"), wrod.rod("green-vps")
    trials = [
        wrod.Trial(pattern, rod, letter, wrod.Friction(0.6), wrod.Disturbance.random(seed))
        for seed in range(3)
    ]
    how = dict(discretisation=wrod.Discretisation(0.05, 0.04), device=device)
    together = simulate_deployments(trials, **how)
    monkeypatch.setattr(simulate, "chunks", lambda count, device, threads: ([[0, 2], [1]], 1))
    shared_out = simulate_deployments(trials, **how)
    for one, other in zip(together, shared_out, strict=True):
        assert one.steps == other.steps
        np.testing.assert_allclose(one.centerline, other.centerline, rtol=0, atol=1e-12)


@pytest.fixture
def short():
    pattern = wrod.Pattern.from_points(np.linspace([0, 0, 0], [0.15, 0, 0], 20))
    rod = replace(wrod.rod("green-vps"), length=0.4)
    return pattern, rod, wrod.plan(pattern, rod, "intuitive", spacing=0.05)


COARSE = dict(discretisation=wrod.Discretisation(0.05, 0.05), speed=0.4)


def test_what_a_thread_prepares_is_recorded_by_no_other(short, monkeypatch):
    launching, assemble = [], simulate.assemble

    def noted(*arguments, **options):
        launching.append(get_ident() in recording._launch)
        return assemble(*arguments, **options)

    monkeypatch.setattr(simulate, "assemble", noted)
    simulate_deployments(
        [wrod.Trial(*short, wrod.Friction(0.6))] * 2, threads=2, device="cpu", **COARSE
    )
    assert launching == [True, True]


def test_threads_of_the_caller_get_what_one_gets_alone(short):
    def lay(_) -> float:
        return wrod.simulate_deployment(*short, 0.6, **COARSE).error_mean

    def grasp(_) -> list:
        return wrod.solve_grasps([2.0, 9.0], 0.1, 2e3, device="cpu").position.tolist()

    alone = [lay(0), grasp(0)]
    with ThreadPoolExecutor(4) as pool:  # one that records would record what the others launch
        found = [(pool.submit(lay, k), pool.submit(grasp, k)) for k in range(2)]
        assert [[one.result() for one in pair] for pair in found] == [alone] * 2


@pytest.mark.parametrize("derived", [False, True])
def test_threads_record_and_replay_what_one_thread_does(letter, monkeypatch, derived):
    """To the last bit, each its own recording, while the other replays."""
    pattern, rod = wrod.pattern("letter-C"), wrod.rod("green-vps")
    trials = [
        wrod.Trial(pattern, rod, letter, wrod.Friction(0.6), wrod.Disturbance.random(seed))
        for seed in range(3)
    ]
    directions = [Directions.of_rod(len(letter))] * 3 if derived else None
    recorded = []
    record = dynamics.record

    def noted(*arguments):
        graph = record(*arguments)
        recorded.append(graph is not None)
        return graph

    monkeypatch.setattr(dynamics, "record", noted)
    found = []
    for threads in ("1", "2"):
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        monkeypatch.setattr(machine, "usable_cores", lambda: 2)
        found.append(lay(trials, directions, discretisation=wrod.Discretisation(0.05, 0.04)))
        assert sum(recorded) == int(threads)
        recorded.clear()
    for one, other in zip(*found, strict=True):
        assert one.steps == other.steps
        assert (one.centerline == other.centerline).all()
        assert (one.tangent == other.tangent).all()


def test_a_thread_that_fails_ends_the_others():
    begun, ended = Event(), Event()

    def run(part, still_wanted):
        if part == [0]:
            begun.wait(10.0)
            raise ValueError("the first")
        begun.set()
        try:
            while True:
                still_wanted()
                time.sleep(1e-3)
        finally:
            ended.set()

    with pytest.raises(ValueError, match="the first"):
        sharing_out.shared_out(run, [[0], [1]], 2)
    assert ended.is_set()
