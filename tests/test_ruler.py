"""Three ways to measure a rod, against the heavy elastica solved by collocation (SciPy)."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_bvp

import wrod
from wrod.commands import main
from wrod.errors import DataError, RodError
from wrod.identification.hanging_loop import measure_hanging_loop
from wrod.identification.ruler import fall_ratio, measure_overhang

L_GB = 0.032


def overhanging(length):
    """Fall over length of a clamped heavy elastica; length in L_gb, w / B = 1 / 2."""

    def rates(s, y):  # z, angle below the level, curvature
        return np.stack([-np.sin(y[1]), y[2], -0.5 * (length - s) * np.cos(y[1])])

    s = np.linspace(0.0, length, 200)
    guess = np.stack([0 * s, np.minimum(s / length, 1.0), 0.5 * (length - s)])
    found = solve_bvp(
        lambda s, y: rates(s, y),
        lambda a, b: np.array([a[0], a[1], b[2]]),
        s, guess, tol=1e-9, max_nodes=20000,
    )  # fmt: skip
    assert found.success
    return -found.y[0, -1] / length


def hanging(lgb, length, apart, lean, count=80):
    """(count, 2) of a rod hung between two clamps that lean inwards [rad], and its lowest point."""

    def rates(s, y):  # x, z, angle, curvature, H, V; over B
        angle, bend, level, lift = y[2:]
        force = lift + s / (2 * lgb**3)
        turn = level * np.sin(angle) - force * np.cos(angle)
        return np.stack([np.cos(angle), np.sin(angle), bend, turn, 0 * s, 0 * s])

    def ends(a, b):
        return np.array(
            [a[0], a[1], a[2] + np.pi / 2 - lean, b[0] - apart, b[1], b[2] - np.pi / 2 + lean]
        )

    s = np.linspace(0.0, length, 400)
    u = s / length
    half = length / 2
    guess = np.stack(
        [
            apart * u, -0.8 * half * np.sin(np.pi * u),
            np.pi * (u - 0.5), np.full(400, np.pi / length),
            np.full(400, 0.2 / lgb**2), np.full(400, -half / (2 * lgb**3)),
        ]
    )  # fmt: skip
    found = solve_bvp(rates, ends, s, guess, tol=1e-8, max_nodes=50000)
    assert found.success
    return found.sol(np.linspace(0.0, length, count))[:2].T


def test_fall_of_an_overhanging_end_is_that_of_the_elastica():
    lengths = np.array([0.8, 1.6, 2.5, 4.0])
    wanted = [overhanging(length) for length in lengths]
    np.testing.assert_allclose(fall_ratio(lengths), wanted, rtol=2e-4)
    # Small falls are those of the beam: w l^4 / 8 B.
    assert fall_ratio(np.array([0.3]))[0] == pytest.approx(0.3**3 / 16, rel=2e-3)


def test_overhang_gives_the_rod_back_and_its_error():
    overhang = 2.2 * L_GB
    fall = overhang * overhanging(2.2)
    found = measure_overhang(overhang, fall, reading=5e-4)
    assert found.gravito_bending_length == pytest.approx(L_GB, rel=2e-4)
    assert found.warning is None
    rng = np.random.default_rng(0)
    few = [
        measure_overhang(*(np.array([overhang, fall]) + rng.normal(0.0, 5e-4, 2))) for _ in range(8)
    ]
    spread = np.std([m.gravito_bending_length for m in few], ddof=1)
    assert 0.5 < spread / found.error < 1.7


@pytest.fixture(scope="module")
def loop():
    return hanging(L_GB, 0.45, 0.10, 0.0)


def test_hanging_loop_gives_the_rod_back_whoever_holds_it(loop):
    rng = np.random.default_rng(1)
    for line in (loop, hanging(L_GB, 0.45, 0.14, 0.5)):
        exact = measure_hanging_loop(line)
        assert exact.gravito_bending_length == pytest.approx(L_GB, rel=4e-3)
    noisy = measure_hanging_loop(line + rng.normal(0.0, 5e-4, line.shape) + [0.3, -0.2])
    assert abs(noisy.gravito_bending_length - L_GB) < 3 * noisy.error
    assert 1e-4 < noisy.error < 0.1 * L_GB


def run(*words):
    return CliRunner().invoke(main, ["measure", *map(str, words), "--json"])


def test_command_measures_both_ways_and_writes_the_rod(loop, tmp_path):
    rod = ("--radius", 0.0016, "--length", 0.885)
    overhang = 2.2 * L_GB
    out = tmp_path / "rod.json"
    result = run(
        "--overhang", overhang, "--fall", overhang * overhanging(2.2), *rod, "--out", out
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert wrod.load_rod(out).gravito_bending_length == pytest.approx(L_GB, rel=1e-3)
    points = tmp_path / "loop.csv"
    np.savetxt(points, loop, delimiter=",")
    result = run(points, *rod)
    figures = json.loads(result.stdout)
    assert figures["way"] == "hanging loop"
    assert figures["gravito_bending_length"] == pytest.approx(L_GB, rel=0.01)
    for words in ((points, "--fall", 0.1), (), ("--fall", 0.1)):
        assert run(*words, *rod).exit_code == 2


@pytest.mark.parametrize(
    "call, says",
    [
        (lambda: measure_overhang(0.1, 0.1), "cannot fall"),
        (lambda: measure_overhang(0.1, -0.01), "fall is -0.01"),
        (lambda: measure_overhang(0.1, 1e-4), "none that a stiffness follows from"),
        (lambda: measure_hanging_loop(np.zeros((3, 2))), "20 or more"),
        (lambda: measure_hanging_loop(np.full((30, 2), np.nan)), "must hold finite numbers"),
        (lambda: measure_hanging_loop(np.zeros((30, 2))), "same point twice"),
    ],
)
def test_readings_that_cannot_be_are_refused(call, says):
    with pytest.raises(DataError, match=says):
        call()


def test_half_a_circle_says_nothing_of_the_stiffness():
    t = np.linspace(0.0, np.pi, 120)
    found = measure_hanging_loop(np.column_stack([0.2 * np.cos(t), -0.2 * np.sin(t)]))
    assert found.error > found.gravito_bending_length and "says little" in found.warning


def test_a_loop_upside_down_is_no_hanging_rod(loop):
    with pytest.raises(DataError, match="is y up"):
        measure_hanging_loop(loop * [1.0, -1.0])


def test_folded_loop_of_the_same_rod():
    """The third way, so that all three are of one rod here."""
    height = wrod.RodMaterial.from_loop_height(0.0366, 0.0016, 0.885)
    assert height.gravito_bending_length == pytest.approx(0.0366 / 1.14224)
    with pytest.raises(RodError, match=r"0.885 m stands no loop of height 0.366 m: 1.87 m are off"):
        wrod.RodMaterial.from_loop_height(0.366, 0.0016, 0.885)
