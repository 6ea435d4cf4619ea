"""Deployments that are shared out to batches and threads."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

import wrod
from wrod.deployment import simulate
from wrod.deployment.simulate import simulate_deployments

needs_gpu = pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")
DEVICES = ["cpu", pytest.param("cuda:0", marks=needs_gpu)]


@pytest.mark.parametrize("device", DEVICES)
def test_deployments_shared_out_are_those_of_one_batch(device, letter, monkeypatch):
    pattern, rod = wrod.pattern("letter-C"), wrod.rod("green-vps")
    trials = [
        wrod.Trial(pattern, rod, letter, wrod.Friction(0.6), wrod.Disturbance.random(seed))
        for seed in range(3)
    ]
    how = dict(discretisation=wrod.Discretisation(0.03, 0.02), device=device)
    together = simulate_deployments(trials, **how)
    monkeypatch.setattr(simulate, "_chunks", lambda count, device, threads: ([[0, 2], [1]], 1))
    shared_out = simulate_deployments(trials, **how)
    for one, other in zip(together, shared_out, strict=True):
        assert one.steps == other.steps
        np.testing.assert_allclose(one.centerline, other.centerline, rtol=0, atol=1e-12)


def test_threads_of_the_caller_get_what_one_gets_alone():
    pattern = wrod.Pattern.from_points(np.linspace([0, 0, 0], [0.15, 0, 0], 20))
    rod = replace(wrod.rod("green-vps"), length=0.4)
    path = wrod.plan(pattern, rod, "intuitive", spacing=0.05)

    def lay(_) -> float:
        coarse = dict(discretisation=wrod.Discretisation(0.05, 0.05), speed=0.2)
        return wrod.simulate_deployment(pattern, rod, path, 0.6, **coarse).error_mean

    def grasp(_) -> list:
        return wrod.solve_grasps([2.0, 9.0], 0.1, 2e3, device="cpu").position.tolist()

    alone = [lay(0), grasp(0)]
    with ThreadPoolExecutor(4) as pool:  # one that records would record what the others launch
        found = [(pool.submit(lay, k), pool.submit(grasp, k)) for k in range(2)]
        assert [[one.result() for one in pair] for pair in found] == [alone] * 2
