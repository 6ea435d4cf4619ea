"""When an error is noise and when a part of it is explained."""

import pytest

from wrod.identification.verdict import CLAMPED, LAID, LAID_ONCE, MOTION


@pytest.mark.parametrize("rule", [CLAMPED, MOTION, LAID, LAID_ONCE])
def test_shares_run_from_nothing_to_all(rule):
    assert rule.share(3.0, 3.0, 1.0) == 0.0
    all_of_it = 1.0 if rule.of_excess else 0.0
    assert rule.share(3.0, all_of_it, 1.0) == pytest.approx(1.0)
    assert rule.is_noise(1.05, 1.0) and not rule.is_noise(1.4, 1.0)
    assert 0.0 < rule.takes < 1.0 and rule.at_noise > 1.0 and rule.reason


def test_clamped_shares_are_of_the_mean_square_beyond_the_floor():
    # 10 -> 2 with a floor of 1: 96 of 99.
    assert CLAMPED.share(10.0, 2.0, 1.0) == pytest.approx(96 / 99)
    assert MOTION.share(10.0, 2.0, 1.0) == pytest.approx(0.8)
    assert not LAID.is_noise(1.2, 1.0) and LAID_ONCE.is_noise(1.2, 1.0)
