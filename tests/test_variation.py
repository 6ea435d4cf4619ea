"""Joint paths varied together with place and hold."""

import numpy as np
import pytest

from wrod.robot.attempt import ArmTask
from wrod.robot.collision import CollisionModel
from wrod.robot.grip import TravelledPath
from wrod.robot.kinematics import grasp_poses
from wrod.robot.model import load_robot
from wrod.robot.placement import candidates
from wrod.robot.redundancy import PathCost
from wrod.robot.variation import vary


@pytest.fixture(scope="module")
def task(letter):
    arm = load_robot("panda")
    path = TravelledPath(letter)
    made = ArmTask(arm, CollisionModel(arm), letter, path, 0.02, 0.005, 0.002, None, True)
    made.travel = np.linspace(0.0, path.travel[-1], 24)
    return made


@pytest.fixture(scope="module")
def beyond(task):
    """A branch whose joints leave their limits."""
    places = candidates(task.trajectory, task.robot, 2)
    found = task.branches(places, 0.5, 4)
    bad = [b for b in found if b.miss.max() < 0.02 and 0.05 < b.excess.max() < 1.5]
    return min(bad, key=lambda branch: branch.excess.max())


def test_limits_are_kept_where_place_and_hold_may_change(task, beyond):
    found = vary(task, beyond, fixed=False)
    assert found.excess.max() < min(-0.02, beyond.excess.max())
    goals = task.targets(found.placement, found.grip, task.travel)
    np.testing.assert_allclose(grasp_poses(task.robot, found.positions), goals, atol=1e-6)
    assert np.abs(np.diff(found.positions, axis=0)).max() < 0.8  # one branch throughout


def test_a_place_that_is_given_stays(task, beyond):
    found = vary(task, beyond, fixed=True)
    assert found.placement == beyond.placement
    assert found.excess.max() < beyond.excess.max()


def test_gradient_of_the_cost_agrees_with_differences(task, beyond):
    around = task.surroundings(beyond.placement, task.travel)
    cost = PathCost(task.robot, task.model, len(task.travel), 3e3, 0.05, 2e4)
    rng = np.random.default_rng(0)
    way = rng.normal(size=beyond.positions.shape)
    slope = cost.gradient(beyond.positions, around) @ way.reshape(-1)
    step = 1e-6
    ahead, behind = (cost.total(beyond.positions + s * way, around) for s in (step, -step))
    assert slope == pytest.approx((ahead - behind) / (2 * step), rel=1e-4)
