"""What corrected plans take, said before they are made."""

import pytest

import wrod
from wrod.deployment.discretisation import USUAL
from wrod.deployment.effort import corrected, looking_on, way_time
from wrod.deployment.simulate import prepare_trials
from wrod.errors import PatternError
from wrod.planning.tail import Tail

ROD = wrod.rod("green-vps")


@pytest.mark.parametrize("name", ["line", "sine", "letter-U", "letter-A", "letter-L"])
@pytest.mark.parametrize("pace", [0.02, 0.04])
def test_the_way_is_as_long_as_that_of_a_plan(name, pace):
    """Of the grasps, from curvature and its slope alone."""
    pattern = wrod.pattern(name)
    path = wrod.plan(pattern, ROD, spacing=0.005, remainder=False, device="cpu")
    trial = wrod.Trial(pattern, ROD, path, wrod.Friction(0.3), tail=Tail.none(path))
    (setup,) = prepare_trials([trial], 0.05, None, pace, USUAL)
    assert way_time(pattern, ROD, pace) == pytest.approx(setup.measure_time, rel=0.2)


def test_what_takes_longer():
    pattern = wrod.pattern("letter-A")
    usual = corrected(pattern, ROD, 0.3)
    each = [corrected(pattern, ROD, 0.3, pace=v) for v in (0.02, 0.04, 0.08)]
    assert each[1] == usual and each[0] > usual > each[2]
    assert corrected(pattern, ROD, 0.3, pace=(0.08, 0.02)) == pytest.approx(sum(each))
    # Of a wide range four rods are laid at a time, and its least friction asks for more steps.
    assert corrected(pattern, ROD, (0.3, 0.6)) > 1.2 * usual
    assert corrected(pattern, ROD, 0.6) < usual < corrected(pattern, ROD, 0.15)
    assert corrected(pattern, ROD, 0.3, device="cuda:0") < usual
    some, none = (corrected(pattern, ROD, 0.3, most=most) for most in (1.0, 0.0))
    assert none == pytest.approx(some - 1.0) and 0.0 < none < usual
    assert looking_on(pattern) > looking_on(wrod.pattern("letter-L"))
    with pytest.raises(PatternError, match="pace"):
        corrected(pattern, ROD, 0.3, pace=(0.0, 0.1))
