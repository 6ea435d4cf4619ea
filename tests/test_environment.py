"""Laying as an environment: baselines are the plans themselves, rewards sum to their error."""

import numpy as np
import pytest

import wrod
from wrod.errors import RodError

pytest.importorskip("gymnasium")

from wrod.deployment.environment import LayingVectorEnv

ROD = wrod.RodMaterial(0.0016, 0.018, 0.25)


@pytest.fixture(scope="module")
def arc():
    angle = np.linspace(0.0, 0.7, 60)
    return wrod.Pattern.from_points(0.2 * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)]))


@pytest.fixture(scope="module")
def plans(arc):
    return {method: wrod.plan(arc, ROD, method=method) for method in ("numeric", "intuitive")}


def play(env, policy, seed=3):
    observed, info = env.reset(seed=seed)
    assert env.observation_space.contains(observed)
    total, steps = np.zeros(env.num_envs), 0
    while True:
        observed, reward, over, cut, info = env.step(policy(observed))
        total += reward
        steps += 1
        assert not cut.any() and np.isfinite(observed).all()
        if over.all():
            return total, steps, info


def rest(observed):
    return np.zeros((len(observed), 6))


def test_no_action_is_the_plan_and_its_rewards_its_error(arc, plans):
    for method, plan in plans.items():
        env = LayingVectorEnv(1, arc, ROD, plan, friction=(0.4, 0.4), disturbed=False, interval=1.0)
        total, steps, info = play(env, rest)
        laid = wrod.simulate_deployment(arc, ROD, plan, friction=0.4, device="cpu")
        # The same rods, but stopped at every action: steps of time are cut there.
        assert -total[0] == pytest.approx(100 * laid.error_mean, abs=0.02), method
        assert info["error_mean"][0] == pytest.approx(-total[0] / 100)
        assert 5 < steps < 60


def test_optimal_beats_intuitive(arc, plans):
    totals = {
        method: play(LayingVectorEnv(1, arc, ROD, plan, friction=(0.4, 0.4), interval=2.0), rest)[0]
        for method, plan in plans.items()
    }
    assert (totals["numeric"] > totals["intuitive"]).all()


def test_an_action_moves_its_own_grip_and_no_other(arc, plans):
    env = LayingVectorEnv(2, arc, ROD, plans["numeric"], friction=(0.4, 0.4), disturbed=False)
    env.reset(seed=0)
    for _ in range(8):
        free = env.step(rest(range(2)))[0]
    np.testing.assert_allclose(free[0], free[1], atol=1e-9)
    env.reset(seed=0)
    pushed = np.zeros((2, 6))
    pushed[1, 1] = 1.0
    for _ in range(8):
        seen = env.step(pushed)[0]
    np.testing.assert_allclose(seen[0], free[0], atol=1e-7)
    grip = slice(7 + 3 * 23, 7 + 3 * 24)
    np.testing.assert_allclose((seen[1] - free[1])[grip], [0.0, 0.02, 0.0], atol=2e-3)
    assert seen[1, 2] == 1.0  # the offset is observed in units of actions


def test_next_episode_begins_with_the_step_after(arc, plans):
    env = LayingVectorEnv(2, arc, ROD, plans["numeric"], interval=4.0)
    play(env, rest)
    observed, reward, over, _, info = env.step(rest(range(2)))
    assert (reward == 0).all() and not over.any() and (observed[:, 0] < 0.5).all()
    assert info["friction"].shape == (2,) and len(set(info["friction"])) == 2


def test_senseless_requests_are_refused(arc, plans):
    with pytest.raises(RodError, match="num_envs is 0"):
        LayingVectorEnv(0, arc, ROD, plans["numeric"])
    env = LayingVectorEnv(2, arc, ROD, plans["numeric"])
    with pytest.raises(RodError, match="call reset first"):
        env.step(np.zeros((2, 6)))
    env.reset(seed=1)
    with pytest.raises(RodError, match=r"actions have shape \(2, 3\); give \(2, 6\)"):
        env.step(np.zeros((2, 3)))
    with pytest.raises(RodError, match="not finite"):
        env.step(np.full((2, 6), np.nan))
