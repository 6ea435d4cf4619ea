import numpy as np
import pytest

import wrod
from wrod.errors import PatternError


def polyline(kind, count, length_unit=1.0):
    """Points on a curve and its curvature as a function of the normalised arc length."""
    if kind == "circle":
        angle = np.linspace(0.0, 1.9 * np.pi, count)
        points = 0.085 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return points, lambda p: np.full(len(p), 1 / 0.085)
    x = np.linspace(0.0, 0.5, count)
    points = np.stack([x, 0.04 * np.sin(20.0 * x)], axis=1)

    def curvature(p):
        slope, bend = 0.8 * np.cos(20 * p[:, 0]), -16.0 * np.sin(20 * p[:, 0])
        return bend / (1.0 + slope**2) ** 1.5

    return points, curvature


def inner(pattern, count=400, margin=0.04):
    return np.linspace(margin, 1.0 - margin, count) * pattern.length


@pytest.mark.parametrize("kind", ["circle", "sine"])
@pytest.mark.parametrize(
    "noise, inside, at_ends", [(0.0, 0.02, 0.1), (3e-6, 0.12, 0.6), (1e-4, 0.8, 3.5)]
)
def test_curvature_of_noisy_polyline(kind, noise, inside, at_ends):
    points, curvature = polyline(kind, 151)
    points = points + noise * np.random.default_rng(7).normal(size=points.shape)
    pattern = wrod.Pattern.from_points(points)
    s = inner(pattern)
    position, _, measured = pattern.sample(s)
    assert np.max(np.abs(measured - curvature(position))) < inside
    position, _, measured = pattern.sample(np.array([0.0, pattern.length]))
    assert np.max(np.abs(measured - curvature(position))) < at_ends
    assert pattern.noise == pytest.approx(noise, rel=0.35, abs=1e-6)


def test_length_of_circle_is_its_arc():
    points, _ = polyline("circle", 151)
    pattern = wrod.Pattern.from_points(points)
    assert pattern.length == pytest.approx(1.9 * np.pi * 0.085, rel=1e-7)


def test_tight_bend_between_straights_keeps_its_height():
    # A letter's bend: 34 1/m, some 5 cm long, from points rounded to 1e-5 m every 2.25 mm.
    s = np.linspace(0.0, 0.45, 90_001)
    curvature = 34.0 * np.exp(-(((s - 0.22) / 0.02) ** 2))
    heading = np.concatenate([[0.0], np.cumsum((curvature[1:] + curvature[:-1]) / 2 * s[1])])
    points = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1) * s[1], axis=0)
    pattern = wrod.Pattern.from_points(np.round(points[::450], 5))
    places = np.linspace(0.0, pattern.length, 500)
    measured = pattern.sample(places)[2]
    exact = np.interp(places, s, curvature)
    assert measured.max() == pytest.approx(34.0, abs=0.4)
    assert np.max(np.abs(measured - exact)[10:-10]) < 0.5


def test_left_turn_is_positive_and_mirrors():
    points, _ = polyline("circle", 60)
    left = wrod.Pattern.from_points(points).sample(0.1)[2]
    right = wrod.Pattern.from_points(points * [1.0, -1.0]).sample(0.1)[2]
    assert left > 0.0
    np.testing.assert_allclose(left, -right, rtol=1e-6)


@pytest.mark.parametrize("name", wrod.pattern_names())
def test_built_in_samples_are_consistent(name):
    pattern = wrod.pattern(name)
    s = np.linspace(0.0, pattern.length, 2001)
    position, tangent, curvature = pattern.sample(s)
    step = 1e-6
    middle = s[1:-1]
    ahead, behind = pattern.sample(middle + step), pattern.sample(middle - step)
    np.testing.assert_allclose(np.linalg.norm(tangent, axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose((ahead[0] - behind[0]) / (2 * step), tangent[1:-1], atol=1e-8)
    turning = np.cross(tangent[1:-1], (ahead[1] - behind[1]) / (2 * step))[:, 2]
    np.testing.assert_allclose(turning, curvature[1:-1], atol=1e-5)
    slope = (ahead[2] - behind[2]) / (2 * step)
    np.testing.assert_allclose(slope, pattern.curvature_derivative(middle, 1), atol=0.05)
    assert 0.4 < pattern.length < 0.78
    assert np.max(np.abs(curvature)) < 35.0
    assert np.all(position[:, 2] == 0.0)


def test_remainder_starts_straight_and_joins_smoothly():
    pattern = wrod.pattern("circle")
    led = pattern.with_remainder(0.14)
    assert led.length == pattern.length
    first = -led.remainder_length
    assert led.sample(first)[2] == pytest.approx(0.0, abs=1e-9)
    for order in (1, 2):
        assert led.curvature_derivative(first, order) == pytest.approx(0.0, abs=1e-5)
    s = np.linspace(0.0, pattern.length, 50)
    for before, after in zip(pattern.sample(s), led.sample(s), strict=True):
        np.testing.assert_allclose(before, after, atol=1e-10)
    tiny = 1e-7
    for left, right in zip(led.sample(-tiny), led.sample(tiny), strict=True):
        np.testing.assert_allclose(left, right, atol=1e-5)
    assert np.all(np.diff(led.sample(np.linspace(first, 0.0, 100))[2]) > -1e-9)


def test_right_turning_remainder_grows_to_a_negative_curvature():
    led = wrod.pattern("sine").with_remainder(0.08)
    assert led.remainder_length == pytest.approx(0.08)
    assert led.sample(-0.04)[2] < 0.0


@pytest.mark.parametrize("length", [0.0, -0.1, np.nan])
def test_remainder_needs_a_length(length):
    with pytest.raises(PatternError, match="remainder length"):
        wrod.pattern("circle").with_remainder(length)


def test_remainder_is_laid_once():
    with pytest.raises(PatternError, match="already"):
        wrod.pattern("circle").with_remainder(0.1).with_remainder(0.1)


def test_sample_refuses_places_outside():
    with pytest.raises(PatternError, match="outside the pattern"):
        wrod.pattern("line").sample([0.1, 0.6])
    with pytest.raises(PatternError):
        wrod.pattern("line").sample([np.nan])


def test_expression_agrees_with_points_and_closed_form():
    text = wrod.Pattern.from_expression("0.04*sin(20*x)", start=0.0, stop=0.5)
    called = wrod.Pattern.from_expression(
        lambda t: t, lambda t: 0.04 * np.sin(20 * t), start=0.0, stop=0.5
    )
    s = np.linspace(0.0, text.length, 200)
    position, _, curvature = text.sample(s)
    np.testing.assert_allclose(position, called.sample(s)[0], atol=1e-12)
    np.testing.assert_allclose(curvature, polyline("sine", 3)[1](position), atol=1e-5)


def test_parametric_expression_of_a_circle_in_cm():
    pattern = wrod.Pattern.from_expression(
        "8*cos(t)", "8*sin(t)", start=0.0, stop=2 * np.pi, units="cm"
    )
    assert pattern.length == pytest.approx(0.16 * np.pi, rel=1e-9)
    np.testing.assert_allclose(pattern.sample([0.0, 0.1, 0.4])[2], 12.5, rtol=1e-6)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').getcwd()",
        "().__class__",
        "sin",
        "x if x else 1",
        "[x]",
        "sin(x, x)",
        "y",
        "'a'*10",
        "x +",
        "9**9**9**9**x",
        "log(-1 - x)",
    ],
)
def test_expression_refuses_what_is_not_arithmetic(text):
    with pytest.raises(PatternError):
        wrod.Pattern.from_expression(text, start=0.0, stop=0.5)


def test_unknown_pattern_lists_the_known_ones():
    with pytest.raises(PatternError, match="letter-A"):
        wrod.pattern("letter-Z")


def test_saved_pattern_reads_back(tmp_path):
    pattern = wrod.pattern("letter-S")
    again = wrod.Pattern.load(pattern.save(tmp_path / "s.csv"))
    assert again.length == pytest.approx(pattern.length, rel=1e-6)
    s = inner(again)
    np.testing.assert_allclose(again.sample(s)[2], pattern.sample(s)[2], atol=0.1)


def test_published_patterns_have_published_lengths_and_rounding_noise(shared):
    lengths = {
        "line": 0.500, "circle": 0.775, "sine": 0.685, "letterU": 0.541,
        "letterC": 0.495, "letterL": 0.408, "letterA": 0.645,
    }  # fmt: skip
    largest = {"circle": 11.7, "sine": 18.4, "letterU": 21.0, "letterL": 19.9, "letterA": 34.2}
    for name, length in lengths.items():
        pattern = wrod.Pattern.load(shared / "patterns" / f"{name}.txt")
        assert pattern.length == pytest.approx(length, abs=6e-4)
        # Coordinates are rounded to 1e-5 m: uniform noise of standard deviation 2.9e-6 m.
        assert pattern.noise < 5e-6
        curvature = pattern.sample(np.linspace(0.0, pattern.length, 2000))[2]
        if name in largest:
            assert np.max(np.abs(curvature)) == pytest.approx(largest[name], rel=0.1)


@pytest.mark.parametrize("name", ["letter-A", "circle"])
def test_reversed_pattern_is_the_same_curve_from_its_other_end(name):
    there = wrod.pattern(name)
    back = there.reversed()
    s = np.linspace(0.0, there.length, 500)
    (p, t, k), (q, u, m) = there.sample(s), back.sample(there.length - s)
    assert np.abs(p - q).max() < 1e-12
    assert np.abs(t + u).max() < 1e-12
    assert np.abs(k + m).max() < 1e-9
    with pytest.raises(PatternError, match="has a remainder"):
        there.with_remainder(0.05).reversed()


@pytest.mark.parametrize("text", ["0.01*sin(1e6*x)", "abs(x-0.1)", "0.1*sqrt(x)"])
def test_ripples_and_kinks_that_no_sample_sees_are_refused(text):
    with pytest.raises(PatternError, match="finer"):
        wrod.Pattern.from_expression(text, start=0.0, stop=0.3)


def test_functions_that_somebody_gives_are_judged():
    for function in (lambda x: 1 / 0, lambda x: x[:3], lambda x: "words", lambda x: 1j * x):
        with pytest.raises(PatternError):
            wrod.Pattern.from_expression(function, start=0.0, stop=0.3)


def test_a_pattern_too_small_for_any_rod_is_refused():
    with pytest.raises(PatternError, match="no rod follows"):
        wrod.pattern("circle").scaled(1e-6)
