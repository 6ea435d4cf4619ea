import numpy as np
import pytest

import wrod
from wrod.errors import PatternError
from wrod.patterns.rounding import round_corners


def corner(angle):
    turn = np.array([np.cos(angle), np.sin(angle)])
    return wrod.Pattern.from_points([[0, 0], [0.2, 0], 0.2 * turn + [0.2, 0]], name="corner")


def test_gentle_pattern_comes_back():
    pattern = wrod.pattern("letter-U")
    assert round_corners(pattern, 1000.0) == (pattern, None)


@pytest.mark.parametrize("angle", [0.8, np.pi / 2, 2.0])
def test_corner_keeps_bound_ends_and_lines(angle):
    bound = 100.0
    pattern = corner(angle)
    rounded, said = round_corners(pattern, bound)
    s = np.linspace(0.0, rounded.length, 4000)
    assert np.abs(rounded.sample(s)[2]).max() < bound * 1.001
    for place in (0.0, 1.0):
        ends = [p.sample(place * p.length)[0] for p in (pattern, rounded)]
        np.testing.assert_allclose(*ends, atol=3e-4)
    # An arc between the lines stands (sec(angle / 2) - 1) / bound off the corner. The nearest
    # curve swings out on both sides and does better; one that bends evenly begins earlier.
    arc = (1 / np.cos(angle / 2) - 1) / bound
    assert 0.2 * arc < said.largest < 2.5 * arc
    assert len(said.places) >= 1 and abs(said.places[0][0] - 0.2) < 0.02


def test_departure_beyond_the_tolerance_is_refused_with_the_one_that_is_not():
    pattern = corner(2.2)
    with pytest.raises(PatternError, match=r"corner: bends by .* tolerance of 1 mm") as error:
        round_corners(pattern, 60.0, tolerance=0.001)
    wanted = float(str(error.value).split("--tolerance ")[1].split(",")[0])
    assert round_corners(pattern, 60.0, tolerance=wanted)[1].largest <= wanted
