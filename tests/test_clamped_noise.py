"""The noise of clamped measurements: what it is found to be, and what that does to a choice."""

import numpy as np
import pytest

from wrod.identification.clamped.noise import (
    COLUMNS,
    NoiseModel,
    _Restricted,
    outliers_of,
    whiteners,
)

ARC = np.linspace(0.0, 0.5, 31)
TRIALS, READINGS = 16, 99


def columns(rng):
    """Rates of two effects that come back in every trial, and of the scatter of poses."""
    u = ARC / ARC[-1]
    own = np.zeros((TRIALS, READINGS, 2))
    own[:, 2:93:3, 0] = np.sin(np.pi * u)
    own[:, 1:93:3, 1] = (1.0 - u) * u**2
    own *= 4.0 * rng.uniform(0.5, 1.5, (TRIALS, 1, 2))
    scatter = np.zeros((TRIALS, READINGS, 15))
    for axis in range(3):
        scatter[:, axis:93:3, axis] = 2000.0
        scatter[:, axis:93:3, 3 + axis] = 2000.0 * (1.0 - u) ** 2
        scatter[:, axis:93:3, 6 + axis] = 200.0 * u * (1.0 - u) ** 2
        scatter[:, axis:93:3, 9 + axis] = 2000.0 * u**2
        scatter[:, axis:93:3, 12 + axis] = 200.0 * u**2 * (1.0 - u)
    return own, scatter


def drawn(noise: NoiseModel, seed: int) -> NoiseModel:
    """Readings with this noise and two effects, and what is found of the noise."""
    rng = np.random.default_rng(seed)
    own, scatter = columns(rng)
    residual = rng.normal(size=(TRIALS, READINGS))
    root = np.linalg.cholesky(noise.markers(ARC) + 1e-12 * np.eye(31))
    markers = residual[:, :93].reshape(TRIALS, 31, 3)
    residual[:, :93] = np.einsum("ij,tjk->tik", root, markers).reshape(TRIALS, 93)
    sizes = np.repeat(noise.scatter, COLUMNS) * rng.normal(size=(TRIALS, 15))
    residual += np.einsum("trp,tp->tr", scatter, sizes) + own @ [2.0, -1.0]
    read = np.ones((TRIALS, READINGS), dtype=bool)
    read[3, 30:33] = False
    return _Restricted(ARC, read, residual, own, scatter).best()


@pytest.mark.parametrize("seed", range(3))
def test_white_noise_stays_what_was_declared(seed):
    assert drawn(NoiseModel(), seed).white


@pytest.mark.parametrize("rho", (0.7, 0.9))
def test_noise_along_the_rod_is_found(rho):
    length = -(ARC[1] - ARC[0]) / np.log(rho)
    found = drawn(NoiseModel(1.0, 1.0 - 1e-9, length), 5)
    assert found.scatter == (0.0,) * 7
    assert found.share > 0.9
    assert found.size == pytest.approx(1.0, abs=0.15)
    assert np.exp(-(ARC[1] - ARC[0]) / found.length) == pytest.approx(rho, abs=0.05)


def test_poses_that_scatter_are_found():
    found = drawn(NoiseModel(scatter=(0.0, 0.0, 0.02, 0.0, 1e-3, 0.0, 0.0)), 7)
    assert found.share == 0.0
    assert [s > 0.0 for s in found.scatter] == [False, False, True, False, True, False, False]
    assert found.scatter[2] == pytest.approx(0.02, rel=0.35)
    assert found.scatter[4] == pytest.approx(1e-3, rel=0.35)


@pytest.mark.parametrize("width", (0, None))
def test_slopes_of_the_likelihood_are_limits_of_differences(width):
    rng = np.random.default_rng(2)
    own, scatter = columns(rng)
    read, residual = np.ones((TRIALS, READINGS), dtype=bool), rng.normal(size=(TRIALS, READINGS))
    read[3, 30:33] = read[5, 60:66] = read[7, 30:33] = False
    likelihood = _Restricted(ARC, read, residual, own[..., :width], scatter)
    at = np.log([0.9, 1.0, 0.03, *rng.uniform(0.1, 2.0, len(COLUMNS))])
    at[1] = 0.4

    def value(p):
        return likelihood.value(np.exp(p[0]), p[1], np.exp(p[2]), np.exp(p[3:]))

    numeric = [value(at + h) - value(at - h) for h in 1e-5 * np.eye(len(at))]
    given = np.exp(at[0]), at[1], np.exp(at[2]), np.exp(at[3:])
    same, slope = likelihood.with_slope(*given, along=True)
    assert same == value(at)
    np.testing.assert_allclose(np.array(numeric) / 2e-5, slope, atol=1e-7 * np.abs(slope).max())


def test_whitened_readings_are_independent():
    noise = NoiseModel(1.1, 0.8, 0.1, (0.0, 5e-4, 0.0, 0.0, 0.0, 0.01, 0.0))
    _, scatter = columns(np.random.default_rng(0))
    read = np.ones((TRIALS, READINGS), dtype=bool)
    read[0, :3] = False
    maps, effective = whiteners(noise, ARC, read, scatter)
    for t in (0, 1):
        own = read[t]
        c = np.eye(READINGS)
        c[:93, :93] = np.kron(noise.markers(ARC), np.eye(3))
        u = scatter[t] * np.repeat(noise.scatter, COLUMNS)
        c += u @ u.T
        left = maps[t] @ c @ maps[t].T
        assert np.allclose(left[np.ix_(own, own)], np.eye(own.sum()), atol=1e-9)
        assert np.all(left[~own] == 0.0)
    assert np.all(effective < 0.4 * READINGS)
    assert whiteners(NoiseModel(), ARC, read, None)[1][1] == READINGS


def test_a_marker_apart_from_its_neighbours_is_an_outlier_and_a_kink_is_none():
    rng = np.random.default_rng(2)
    noise = 5e-4
    # What a model misses: a bend at one place, up to 40 mm, another size in each trial.
    bend = np.maximum(ARC - 0.25, 0.0)[:, None] * [0.1, -0.16, 0.05]
    residual = rng.uniform(0.5, 1.0, (TRIALS, 1, 1)) * bend
    residual = residual + noise * rng.normal(size=residual.shape)
    assert not outliers_of(residual, noise).any()
    wrong = np.zeros((TRIALS, 31), dtype=bool)
    wrong[[0, 3, 9, 15], [0, 22, 7, 30]] = True
    residual[wrong] += [10e-3, -6e-3, 0.0]
    residual[5, 12] = np.nan
    assert np.array_equal(outliers_of(residual, noise), wrong)
    # A trial that the model misses by far, in waves that no neighbours foretell, has none.
    residual[7] += 0.03 * np.sin(ARC / 0.012)[:, None]
    assert np.array_equal(outliers_of(residual, noise), wrong)
