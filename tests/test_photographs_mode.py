"""Lateral departures of a rod laid by the intuitive grip: their mode, and what drives it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp, solve_ivp
from scipy.interpolate import CubicSpline

import wrod
from wrod.bench import photographs_irregular
from wrod.bench.photographs_irregular import CORRELATED, bends, irregular, scatter
from wrod.bench.photographs_mode import bend, gain, intuitive, mode, seen_wave
from wrod.deployment.discretisation import Discretisation
from wrod.deployment.simulate import Trial, simulate_deployments
from wrod.grasps.growth import departures
from wrod.identification.laid.camera import OverheadCamera
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.identification.laid.scenario import LaidRod, Scenario, plan_without_lead_in
from wrod.planning.tail import Tail
from wrod.rods.profile import Profile

GREEN = wrod.rod("green-vps")
LGB = GREEN.gravito_bending_length


def heavy_elastica(thrust: float, length: float):
    """Inextensible, k_b = L_gb = 1, from a straight contact to a grip straight down: angle,
    curvature, and place over s / length, with the vertical force at the contact."""

    def rates(s, y, force):
        up = force[0] + 0.5 * s * length
        bending = np.sin(y[0]) * thrust - np.cos(y[0]) * up
        return length * np.stack([y[1], bending, np.cos(y[0]), np.sin(y[0])])

    def ends(a, b, force):
        return np.array([a[0], a[1], b[0] - 0.5 * np.pi, a[2], a[3]])

    s = np.linspace(0.0, 1.0, 400)
    angle = 0.5 * np.pi * -np.expm1(-s * length / 1.5)
    slope = np.gradient(angle, s * length)
    place = np.cumsum([np.cos(angle), np.sin(angle)], axis=1) * length / 400
    guess = np.stack([angle, slope, *place])
    found = solve_bvp(rates, ends, s, guess, [-0.3], tol=1e-7, max_nodes=20_000)
    assert found.success
    return found


def test_the_mode_is_that_of_kirchhoffs_equations():
    """The rod's equations of a small departure to the side, integrated along it."""
    thrust, length, ratio = -0.2, 10.0, 1.0 / (1.0 + GREEN.poisson)
    rod = heavy_elastica(thrust, length)
    ahead, height = rod.y[2:, -1]

    def rates(s, z):
        # Direction to the side and its rate, place, roll; constant twisting moment and force.
        turned, rate, _, _, moment, force = z.reshape(6, 6)
        angle, curvature = rod.sol(s)[:2]
        up = rod.p[0] + 0.5 * s * length
        pull = up * np.sin(angle) + thrust * np.cos(angle)
        bending = turned * pull - curvature * (curvature * turned + moment) - force
        return length * np.concatenate(
            [rate, bending, turned, moment / ratio + curvature * turned, 0 * moment, 0 * force]
        )

    z = solve_ivp(rates, (0.0, 1.0), np.eye(6).ravel(), rtol=1e-10, atol=1e-12).y[:, -1]
    end = z.reshape(6, 6)[[0, 2, 3]]
    answer = np.linalg.solve(end[:, [1, 4, 5]], -end[:, [2, 0, 3]])
    expected = np.array([[0.0, 1.0, 0.0], answer[0], answer[1] / ratio])

    stiff = replace(GREEN, radius=4e-4, length=height * LGB + 0.1)
    excess = LGB * (length - ahead - height)
    batch = intuitive([stiff], np.array([0.1]), np.array([excess]))
    unit = np.array([LGB, 1.0, 1.0])  # of departures
    found = departures(batch)[0] * LGB / unit[:, None] * unit
    assert found == pytest.approx(expected, abs=0.01)
    own, true = mode(departures(batch)[0]), np.linalg.eigvals(expected)
    true = true[np.argmax(true.imag)]
    assert own.rate * LGB == pytest.approx(true.real, rel=0.02)
    assert own.wavelength / LGB == pytest.approx(2.0 * np.pi / true.imag, rel=0.005)


def test_a_grip_that_steps_aside_is_followed_by_the_mode():
    """A simulated deployment, where the grip goes 2 mm aside, against departures' own law."""
    step, at = 2e-3, 0.15
    line = wrod.Pattern.from_expression("0*x", start=0.0, stop=0.6)
    path = plan_without_lead_in(line, GREEN, "intuitive")

    def aside(s):
        return 0.5 * step * (1.0 + np.tanh((s - at) / 0.01))

    off = aside(path.pattern_arc_length)[:, None] * np.array([0.0, 1.0, 0.0])
    stepping = replace(path, position=path.position + off)
    trial = Trial(line, Scenario(held=True).damped(GREEN), stepping, wrod.Friction(1.0),
                  tail=Tail.none(path))  # fmt: skip
    (laid,) = simulate_deployments([trial], discretisation=Discretisation(0.01, 0.025))

    s = np.linspace(0.05, 0.6, 8)
    batch = intuitive([GREEN] * 8, s, np.zeros(8))
    ahead = CubicSpline(s, batch.positions()[:, -2, 0])
    matrix = CubicSpline(s, departures(batch))

    def rates(s, d):  # by the grip's place along the line
        return matrix(s) @ (d - [aside(s), 0.0, 0.0])

    found = solve_ivp(rates, (0.06, 0.6), np.zeros(3), rtol=1e-8, atol=1e-10, dense_output=True)
    grip = np.linspace(0.2, 0.58, 40)
    contact = grip - ahead(grip)
    left = np.interp(contact, laid.centerline[:, 0], laid.centerline[:, 1])
    expected = found.sol(grip)[0]
    assert expected.max() > 1.25 * step
    assert np.abs(left - expected).max() < 0.08 * step


def test_gain_and_bends():
    batch = intuitive([GREEN], np.array([0.3]), np.zeros(1))
    (matrix,) = departures(batch)
    # A grip that stands aside lays aside, one that shakes by curvature alone; a rod bent in short
    # waves is laid as it is bent.
    slow, fast = gain(matrix, np.array([50.0, 0.05]))
    assert slow == pytest.approx(1.0, abs=0.01)
    assert fast == pytest.approx(abs(matrix[1, 0]) * (0.05 / (2.0 * np.pi)) ** 2, rel=0.1)
    assert bend(batch, departures(batch), 0.04)[0] == pytest.approx(
        (0.04 / (2.0 * np.pi)) ** 2, rel=0.1
    )


def test_a_seen_wave_is_found():
    s = np.linspace(0.0, 0.5, 300)
    wave = 4e-3 * np.exp(-3.0 * (s - 0.24)) * np.cos(2.0 * np.pi * s / 0.3)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(300)
    seen = seen_wave(np.column_stack([wave + 0.02 * s + noise, -s]))
    assert seen.wavelength == pytest.approx(0.3, abs=0.006)
    assert seen.rate == pytest.approx(-3.0, abs=0.3)
    assert seen.amplitude == pytest.approx(4e-3, rel=0.03)
    assert seen.left == pytest.approx(1e-4, rel=0.2) and seen.slope_left > 1e-3


def test_bends_at_random_have_their_size_and_keep_as_long_as_said():
    s = np.linspace(0.0, 0.8, 81)
    many = np.array([[one(s) for one in bends(3.0, draw, 0.8)] for draw in range(60)]).reshape(
        -1, 81
    )
    assert np.sqrt(np.mean(many**2)) == pytest.approx(3.0, rel=0.05)
    later = np.mean(many[:, 3:] * many[:, :-3]) / np.mean(many**2)  # 3 cm
    assert later == pytest.approx(np.exp(-0.25 * (0.03 / CORRELATED) ** 2), abs=0.02)


def test_a_rod_bent_in_waves_is_laid_as_high_as_to_first_order():
    """A simulated deployment, against what sizes of random bends are found by."""
    length, stop = 0.2, 0.7
    line = wrod.Pattern.from_expression("0*x", start=0.0, stop=stop)
    path = plan_without_lead_in(line, GREEN, "intuitive")
    straight = Scenario(held=True).damped(GREEN)
    s = np.linspace(0.0, straight.length, 240)
    bent = Profile(tuple(np.cos(2.0 * np.pi * s / length)), tuple(s))
    rod = replace(straight, natural_curvature=(bent, Profile((0.0,))))
    trial = Trial(line, rod, path, wrod.Friction(1.0), tail=Tail.none(path), another_rod=True)
    (laid,) = simulate_deployments([trial], discretisation=Discretisation(0.01, 0.025))
    at = np.linspace(0.35, 0.62, 200)  # where the start is forgotten
    turn = 2.0 * np.pi * at / length
    wave = np.column_stack([np.ones(200), at, np.cos(turn), np.sin(turn)])
    found = np.linalg.lstsq(wave, np.interp(at, *laid.centerline.T[:2]), rcond=None)[0]
    batch = intuitive([GREEN], np.array([0.45]), np.zeros(1))
    expected = bend(batch, departures(batch), length)[0]
    assert np.hypot(*found[2:]) == pytest.approx(expected, rel=0.05)


def test_sizes_of_random_bends_go_with_the_line_seen(monkeypatch):
    monkeypatch.setattr(photographs_irregular, "_WAVES", 8)
    s = np.linspace(0.0, 0.47, 100)
    one, two = (
        irregular("green-vps", points, seen_wave(points))
        for points in (np.column_stack([h * np.sin(20.0 * s), -s]) for h in (3e-3, 6e-3))
    )
    assert two.size == pytest.approx(2.0 * one.size) and two.wavelength == one.wavelength
    assert two.aside == pytest.approx(2.0 * one.aside)


def test_scatter_is_the_distance_after_a_rigid_motion():
    line = wrod.Pattern.from_expression("0*x", start=0.0, stop=0.5)
    s = np.linspace(0.0, 0.5, 51)
    lying = np.column_stack([s, 0.0 * s, 0.0 * s])
    shown = LaidPhotograph("a-line-int", "a", "line", "int", line, lying[:, :2], np.ones(51, bool),
                           np.full(51, 3e-4), 0.0, 1.0, np.zeros(2))  # fmt: skip
    straight = LaidRod(s, lying, True)
    moved = lying @ np.array([[1.0, 0.02, 0.0], [-0.02, 1.0, 0.0], [0, 0, 1]]) + [0.0, 5e-3, 0.0]
    bow = lying + np.column_stack([0.0 * s, 0.1 * (s - 0.25) ** 2, 0.0 * s])
    lost = LaidRod(s, np.full((51, 3), 9.0), False)
    rods = [LaidRod(s, moved, True), LaidRod(s, bow, True), lost]
    found = scatter(shown, straight, rods, OverheadCamera())
    # Curves are compared at points 0.5 mm apart.
    assert found.seen < 2e-4 and found.drawn[0] < 2e-4 and len(found.drawn) == 2
    # Half of a bow of 6.25 mm lies on either side of a line at 1.56 mm.
    height = 0.1 * (s - 0.25) ** 2
    assert found.drawn[1] == pytest.approx(np.abs(height - np.median(height)).mean(), rel=0.05)
    assert found.rank == -1
