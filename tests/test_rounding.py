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


@pytest.mark.parametrize("bound", [30.0, 100.0])
def test_a_leg_that_runs_back_over_itself_is_rounded(bound):
    """Two turns by half a circle each, of which neither has a fillet."""
    points = [
        [0.03497439378033650, -0.02491945416244792], [0.08073842136718304, -0.02327033421024279],
        [0.07924101381590958, -0.02328159970807729], [0.07517701055728650, 0.07928644186607107],
        [0.00874900545795857, 0.08659168244029356],
    ]  # fmt: skip
    pattern = wrod.Pattern.from_points(points, name="back")
    rounded, said = round_corners(pattern, bound, tolerance=0.05)
    curvature = rounded.sample(np.linspace(0.0, rounded.length, 4000))[2]
    assert np.abs(curvature).max() < 1.001 * bound and said.largest < 0.02


def test_departure_beyond_the_tolerance_is_refused_with_the_one_that_is_not():
    pattern = corner(2.2)
    with pytest.raises(PatternError, match=r"corner: bends by .* tolerance of 1 mm") as error:
        round_corners(pattern, 60.0, tolerance=0.001)
    wanted = float(str(error.value).split("--tolerance ")[1].split(",")[0])
    assert round_corners(pattern, 60.0, tolerance=wanted)[1].largest <= wanted


def star(tips, inner):
    angle = np.pi / 2 + np.arange(2 * tips + 1) * np.pi / tips
    radius = np.where(np.arange(2 * tips + 1) % 2 == 0, 0.15, 0.15 * inner)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def zigzag(half):
    k = np.arange(7)
    return np.column_stack([0.1 * k * np.sin(half), (k % 2) * 0.1 * np.cos(half)])


@pytest.mark.parametrize(
    ("points", "turn", "radius"),
    [
        (star(5, 0.382), np.radians(144), 0.011),
        (
            star(8, 0.6),
            np.pi - 2 * np.arctan2(0.09 * np.sin(np.pi / 8), 0.15 - 0.09 * np.cos(np.pi / 8)),
            0.011,
        ),
        (zigzag(0.45), np.pi - 0.9, 0.011),
        (np.array([[0, 0], [0.2, 0], [0.2, 0.2], [0, 0.2], [0, 0.0]]), np.pi / 2, 0.02),
    ],
)
def test_many_sharp_tips_depart_about_as_little_as_fillets(points, turn, radius):
    """An arc between the lines stands radius (sec(turn / 2) - 1) off its tip."""
    pattern = wrod.Pattern.from_points(points)
    arc = radius * (1 / np.cos(turn / 2) - 1)
    rounded, said = round_corners(pattern, 1 / radius, tolerance=1.3 * arc)
    assert 0.2 * arc < said.largest <= 1.3 * arc
    s = np.linspace(0.0, rounded.length, 4000)
    assert np.abs(rounded.sample(s)[2]).max() * radius < 1.001
    ends = rounded.sample([0.0, s[-1]])[0] - pattern.sample([0.0, pattern.length])[0]
    assert np.linalg.norm(ends, axis=1).max() < 2e-4


def test_refusal_never_advises_a_tolerance_that_loses_the_drawing():
    with pytest.raises(PatternError, match="give a larger drawing or a softer rod"):
        round_corners(wrod.Pattern.from_points(zigzag(0.25)), 1 / 0.011)
