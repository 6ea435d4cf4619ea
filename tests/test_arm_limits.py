"""What displaced grips ask of an arm, against its kinematics."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wrod.commands.plan_steps import within_speed
from wrod.errors import RobotError
from wrod.robot.kinematics import grasp_poses, refine
from wrod.robot.limits import ArmLimits
from wrod.robot.model import load_robot
from wrod.robot.placement import Placement


@pytest.fixture(scope="module")
def path():
    """A path of a UR5e whose elbow comes near the end of a range that is made narrow for it."""
    arm = load_robot("ur5e")
    q = np.array([0.3, -1.4, 1.7, -1.2, -1.5, 0.2]) + np.linspace(0.0, 0.2, 12)[:, None]
    lower, upper = np.array(arm.lower), np.array(arm.upper)
    upper[2] = 1.85
    narrow = SimpleNamespace(chain=arm.chain, lower=lower, upper=upper, velocity=arm.velocity)
    place = Placement(0.4, 0.1, 0.05, 0.7)
    return arm, SimpleNamespace(
        robot=narrow, node_positions=q, node_time=0.1 * np.arange(12), placement=place
    )


def test_excess_is_what_inverse_kinematics_needs_beyond_the_limits(path):
    arm, given = path
    limits = ArmLimits(given)
    rng = np.random.default_rng(0)
    moves = np.hstack([0.004 * rng.standard_normal((12, 3)), 0.01 * rng.standard_normal((12, 3))])
    poses = grasp_poses(arm, given.node_positions)
    base = given.placement.base_from_world[:3, :3]
    poses[:, :3, 3] += moves[:, :3] @ base.T
    poses[:, :3, :3] = Rotation.from_rotvec(moves[:, 3:] @ base.T).as_matrix() @ poses[:, :3, :3]
    q, error = refine(arm, given.node_positions, poses)
    assert np.abs(error).max() < 1e-9
    reach = 0.5 * (1.85 - given.robot.lower[2]) - 0.05
    beyond = np.abs(q[:, 2] - 0.5 * (1.85 + given.robot.lower[2])) / reach - 1.0
    excess, _ = limits.excess(moves)
    wanted = beyond[beyond > 1e-3]
    assert len(wanted) > 3
    np.testing.assert_allclose(np.sort(excess)[-len(wanted) :], np.sort(wanted), atol=1e-3)


def test_nothing_is_asked_of_an_arm_that_is_not_near_its_limits(path):
    _, given = path
    limits = ArmLimits(given)
    limits.reach = np.full(6, 10.0)
    excess, rates = limits.excess(np.zeros((12, 6)))
    assert excess.shape == (0,) and rates.shape == (0, 12, 6)


def test_speeds_count_and_derivatives_are_limits_of_differences(path):
    _, given = path
    limits = ArmLimits(given)
    limits.velocity = np.full(6, 0.1)  # 0.2 rad in 1.1 s is faster
    rng = np.random.default_rng(1)
    at, way = 0.002 * rng.standard_normal((2, 12, 6))
    excess, rates = limits.excess(at)
    assert len(excess) > 30
    ends = [limits.excess(at + sign * 1e-6 * way)[0] for sign in (1.0, -1.0)]
    along = np.einsum("mtd,td->m", rates, way)
    np.testing.assert_allclose((ends[0] - ends[1]) / 2e-6, along, atol=1e-7)


def test_a_range_of_paces_ends_where_the_arm_does():
    def arm(fastest):
        def solve(_, *, pace, whole_job):
            if fastest is None:
                raise RobotError("no joint path")
            return SimpleNamespace(steady_pace=min(pace, fastest))

        return SimpleNamespace(solve=solve, no_robot=False)

    def planned():
        return None, None, None

    said = [within_speed(arm(v), (0.02, 0.08), planned) for v in (1.0, 0.06, 0.001, None)]
    fast = (0.02, 0.08)
    np.testing.assert_allclose(said, [fast, (0.02, 0.06), (0.02, 0.02), fast])
    assert within_speed(arm(0.001), 0.08, planned) == 0.08
