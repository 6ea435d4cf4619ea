"""Held grips, the manifold's boundary, its optima and their stability."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_bvp

from wrod.commands import main
from wrod.errors import GraspError
from wrod.grasps.manifold.boundary import DIPS, TOUCHES, boundary
from wrod.grasps.manifold.grips import equilibrium
from wrod.grasps.manifold.map import force_map
from wrod.grasps.nudge import nudge
from wrod.grasps.optimal import solve_grasps

RATIO = 2087.0


@pytest.fixture(scope="module")
def manifold():
    return force_map(17.68, RATIO, rays=21, threads=1)


def elastica_force(x, z, length, start):
    """Force at the contact of the planar rod: n = (-F_x, s/2 - F_z), theta'' = -(q' x n)."""

    def rhs(s, y, p):
        theta, bend = y[:2]
        c, d = np.cos(theta), np.sin(theta)
        along = 1.0 + (-p[0] * c + (0.5 * s - p[1]) * d) / RATIO
        moment = -along * (p[0] * d + (0.5 * s - p[1]) * c)
        return np.vstack([bend, moment, along * c, along * d])

    def ends(a, b, p):
        return np.array([a[0], a[2], a[3], b[1], b[2] - x, b[3] - z])

    edge = np.diff(start.shape[0], axis=0)
    size = np.linalg.norm(edge, axis=1)
    s = np.concatenate([[0.0], np.cumsum(size)])
    s *= length / s[-1]
    theta = np.interp(s, (s[1:] + s[:-1]) / 2, np.unwrap(np.arctan2(edge[:, 2], edge[:, 0])))
    guess = [theta, np.gradient(theta, s), start.shape[0, :, 0], start.shape[0, :, 2]]
    solution = solve_bvp(rhs, ends, s, guess, p=start.force[0, [0, 2]], tol=1e-8, max_nodes=20000)
    assert solution.success
    return solution.p


@pytest.mark.parametrize("grip", [(3.0, 6.7), (-2.0, 6.8), (-5.0, 4.5)])
def test_held_grip_against_the_continuum(grip):
    position = (grip[0], 0.0, grip[1])
    errors = []
    for edges in (48, 96):
        held = equilibrium(position, 8.0, RATIO, edge_count=edges)
        assert held.converged.all()
        errors.append(np.abs(held.force[0, [0, 2]] - elastica_force(*grip, 8.0, held)).max())
    assert errors[1] < 4e-3
    # Second order: halving the edges leaves a quarter.
    assert errors[1] < 0.35 * errors[0]


@pytest.mark.parametrize("curvature", [0.0, 1.2, -1.2])
def test_held_at_its_optimal_grip_a_rod_is_the_optimal_grasp(curvature):
    grasp = solve_grasps([6.0], [curvature], [RATIO])
    held = equilibrium(grasp.position, 6.0, RATIO, curvature=curvature, edge_count=96)
    assert held.converged.all() and held.stable.all()
    np.testing.assert_allclose(held.force, grasp.force, atol=0.02)
    np.testing.assert_allclose(held.moment[0], [0.0, 0.0, -curvature], atol=0.02)


def test_stiffness_is_the_derivative_of_the_force():
    step = 1e-4
    centre = np.array([3.0, 0.3, 3.6])
    positions = np.concatenate([[centre], centre + step * np.eye(3), centre - step * np.eye(3)])
    held = equilibrium(positions, 5.0, RATIO)
    # The force at the contact and that on the grip balance the weight.
    differences = -(held.force[1:4] - held.force[4:7]).T / (2 * step)
    np.testing.assert_allclose(held.stiffness[0], differences, rtol=1e-4, atol=1e-4)


def test_impossible_positions_are_flagged_and_finite():
    positions = np.array(
        [[100.0, 0, 0], [0, 0, -3.0], [0, 0, 0], [-30.0, 5, 2], [3, 0, -1.0], [2.58, 0, 3.48]]
    )
    held = equilibrium(positions, 5.0, RATIO)
    assert held.admissible.tolist()[:5] == [False] * 5
    assert held.converged[5]
    for name in ("position", "force", "moment", "tangent", "stiffness", "clearance", "shape"):
        assert np.isfinite(getattr(held, name)).all(), name


def test_rods_of_a_batch_do_not_see_each_other():
    positions = np.array([[3.0, 0.0, 3.5], [0.0, 1.0, 4.2], [-2.0, 0.0, 3.5]])
    lengths = np.array([5.0, 5.5, 4.8])
    together = equilibrium(positions, lengths, RATIO)
    for r in range(3):
        alone = equilibrium(positions[r], lengths[r], RATIO)
        np.testing.assert_allclose(alone.force[0], together.force[r], atol=1e-7)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([np.nan, 0, 1], 5.0, RATIO), "not finite"),
        (([[1, 2]], 5.0, RATIO), r"\(n, 3\)"),
        (([1, 0, 1], -5.0, RATIO), r"suspended_length\[0\] is -5"),
        ((np.ones((3, 3)), [5.0, 6.0], RATIO), "broadcast"),
    ],
)
def test_bad_inputs_are_named(arguments, message):
    with pytest.raises(GraspError, match=message):
        equilibrium(*arguments)


def test_boundary_is_where_admissible_grips_end():
    angle = np.radians([50.0, 80.0, 150.0])
    lengths = np.array([4.0, 8.0])
    edge = boundary(lengths, RATIO, angle)
    assert (edge.low < edge.tight).all()
    assert np.isin(edge.kind, (DIPS, TOUCHES)).all()
    assert edge.kind[1, 2] == TOUCHES and (edge.kind[:, :2] == DIPS).all()
    direction = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    room = 3e-4 * lengths[:, None]
    for radius, admissible in (
        (edge.tight - room, True),
        (edge.tight + room, False),
        (edge.low + room, True),
        (edge.low - room, False),
    ):
        position = (radius[..., None] * direction).reshape(-1, 3)
        held = equilibrium(position, np.repeat(lengths, 3), RATIO)
        assert (held.admissible == admissible).all()


def test_rays_must_be_above_the_table():
    with pytest.raises(GraspError, match="rays"):
        boundary(5.0, RATIO, [0.5, 3.5])
    with pytest.raises(GraspError, match="no grip on 5 rays"):
        force_map(100.0, 50.0, rays=5, device="cpu")


def test_both_optima_and_their_stability(manifold):
    """The gentle optimum is stable; the one that leans over backwards is not, by both tests."""
    first, second = manifold.optima
    # The inextensible elastica has (2.5663, 16.165) with F_z = 0.75766; the rod stretches upwards.
    assert first.position[[0, 2]] == pytest.approx((2.5663, 16.196), abs=2e-3)
    assert first.force == pytest.approx((0.0, 0.0, 0.75766), abs=1e-3)
    assert first.stable and first.eigenvalue > 0.0 and first.snaps_at == np.inf
    assert second.position[0] < -3.0 and second.force[2] > 2.0
    assert not second.stable and second.eigenvalue < 0.0 and second.snaps_at <= 1e-3


def test_the_two_tests_of_stability_agree_over_the_map(manifold):
    tests = manifold.tests()
    assert 0 < tests["stable"] < tests["tested"]
    # They may differ only where the rod is about to become unstable.
    assert tests["disagreeing"] <= 0.01 * tests["tested"] and tests["eigenvalue"] < 0.05


def test_snapping_shows_in_force_and_deflection(manifold):
    nudges = manifold.nudges
    steady, snapped = nudges.force[:, :, 1]
    # The stable rod follows in proportion, the other jumps at the first nudge and stays there.
    np.testing.assert_allclose(steady[1:] / nudges.offset[1:], steady[1] / 1e-3, rtol=0.05)
    assert abs(snapped[1]) > 50.0 * abs(steady[1])
    assert nudges.deflection[1, 1] > 1.0 and nudges.deflection[0, 1] < 2e-3
    assert nudges.shape[..., 2].min() > -0.01


def test_softness_is_greatest_around_the_unstable_optimum(manifold):
    first, second = manifold.optima
    position = np.concatenate([p.position.reshape(-1, 2) for p in manifold.patches])
    soft = np.concatenate([p.deflection.ravel() for p in manifold.patches])

    def around(optimum):
        near = np.linalg.norm(position - optimum.position[[0, 2]], axis=1) < 1.0
        assert near.sum() > 3
        return np.median(soft[near])

    assert around(second) > 10.0 * around(first)
    assert soft.max() < 1.3 * around(second)


def test_a_soft_rod_is_not_taken_for_one_that_snaps():
    """Near instability a rod swings out many times as far as its grip, and still follows it."""
    held = equilibrium((-0.65, 0.0, 0.65), 3.0, RATIO)
    assert held.admissible[0] and held.stable[0]
    result = nudge(held.shape, 3.0, RATIO, offset=np.array([0.0, 1e-3, 3e-3, 0.01]))
    assert (result.deflection[0, 1:] > 10.0 * result.offset[1:]).all()
    assert result.snaps_at[0] == np.inf


def test_command_writes_pictures_and_numbers(tmp_path):
    arguments = ["manifold", "--length", "4", "--rays", "5", "--out", str(tmp_path), "--json"]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    figures = json.loads(result.output)
    assert [p.rsplit("/", 1)[1] for p in figures["written"]] == [
        "manifold.png",
        "nudges.png",
        "manifold.npz",
    ]
    with np.load(tmp_path / "manifold.npz", allow_pickle=False) as data:
        assert data["patch_0_force"].shape[0] == 5
        assert np.isfinite(data["patch_0_force"]).all()
    assert figures["optima"][0]["stable"]


@pytest.mark.parametrize("bad", [["--nudge", "-1"], ["--rays", "1"], ["--closure", "none"]])
def test_command_refuses_bad_options(tmp_path, bad):
    out = tmp_path / "out"
    result = CliRunner().invoke(main, ["manifold", "--length", "4", "--out", str(out), *bad])
    assert result.exit_code == 2
    assert not out.exists()
