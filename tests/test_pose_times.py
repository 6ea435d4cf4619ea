"""Times at which a grip is to be at the poses of a plan, as deployments keep them."""

import numpy as np
import pytest

import wrod
from wrod.deployment.grip_path import KEY_INTERVAL
from wrod.deployment.simulate import prepare_trials
from wrod.errors import DataError

SPEED = 0.03


@pytest.fixture(scope="module")
def bent():
    return wrod.plan(wrod.pattern("letter-U"), wrod.rod("green-vps"))


def test_a_deployment_is_at_each_pose_when_that_is_due(bent):
    times = wrod.pose_times(bent, SPEED)
    assert times[0] == 0.0 and np.all(np.diff(times) > 0.0)
    trial = wrod.Trial(wrod.pattern("letter-U"), wrod.rod("green-vps"), bent, wrod.Friction(0.3))
    (setup,) = prepare_trials([trial], 0.0, None, SPEED, wrod.Discretisation())
    due = KEY_INTERVAL * np.arange(len(setup.covered)) - setup.approach
    laid = np.interp(times, due, setup.covered)
    assert laid == pytest.approx(bent.arc_length, abs=2e-5)


def test_no_grip_goes_much_faster_than_on_a_line(bent):
    times = wrod.pose_times(bent, SPEED)
    way = np.linalg.norm(np.diff(bent.position, axis=0), axis=1)
    constant = way / (np.diff(bent.arc_length) / SPEED)
    assert constant.max() > 1.7 * SPEED
    assert (way / np.diff(times)).max() < 1.1 * np.sqrt(2.0) * SPEED


def test_a_corrected_plan_has_a_pace_of_its_own(bent):
    asked = {
        name: getattr(bent, name) for name in ("arc_length", "contact", "position", "rotation")
    }
    asked |= {"force": bent.force}
    own = wrod.Trajectory(**asked, metadata={"optimised": {"pace": SPEED}})
    assert np.array_equal(wrod.pose_times(own), wrod.pose_times(bent, SPEED))
    assert wrod.pose_times(bent)[-1] > 1.4 * wrod.pose_times(own)[-1]
    wrong = wrod.Trajectory(**asked, metadata={"optimised": {"pace": "fast"}})
    with pytest.raises(DataError, match="optimised: pace is 'fast'"):
        wrod.pose_times(wrong)
