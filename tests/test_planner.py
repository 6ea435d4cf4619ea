import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import wrod
from wrod.errors import (
    DataError,
    GraspError,
    OutOfRangeWarning,
    PatternError,
    RodError,
    StabilityWarning,
    WrodWarning,
)
from wrod.planning.remainder import free_end, lead_ins, prepare
from wrod.planning.roll import held_twist
from wrod.planning.trajectory import Trajectory

ROD = wrod.rod("green-vps")


def fake_grasps(length, curvature, ratio, *, closure, device, eigenvalues, progress):
    """Smooth stand-ins for grasps: the solver is tested elsewhere."""
    assert closure == "zero_tension" and ratio == 1600.0 and eigenvalues
    if progress is not None:
        progress(len(length))
    position = np.column_stack([2.5 + 0 * length, 0.4 * curvature, length - 1.5])
    rotation = np.column_stack([0.1 * curvature, -1.4 + 0 * length, 0.2 * curvature])
    force = np.column_stack([0 * length, -curvature, 0.75 + 0 * length])
    good = np.ones(len(length), dtype=bool)
    return wrod.Grasps(
        position=position,
        rotation=rotation,
        force=force,
        converged=good,
        stable=good,
        shape=None,
        eigenvalue=1.0 / length,
    )


@pytest.fixture
def grasps(monkeypatch):
    """Put `solve` in the place of the rod solver."""

    def put(solve):
        monkeypatch.setattr("wrod.grasps.optimal.solve_grasps", solve)

    put(fake_grasps)
    return put


def test_intuitive_grip_hangs_straight_above_the_contact():
    pattern = wrod.pattern("letter-U")
    plan = wrod.plan(pattern, ROD, "intuitive")
    s = plan.arc_length
    assert s[0] == 0.0 and s[-1] == pattern.length
    assert np.max(np.diff(s)) <= 0.005 + 1e-12
    position, tangent, _ = pattern.sample(s)
    expected = position + (ROD.length - s)[:, None] * [0.0, 0.0, 1.0]
    np.testing.assert_allclose(plan.position, expected, atol=1e-12)
    up = np.tile([0.0, 0.0, 1.0], (len(s), 1))
    np.testing.assert_allclose(plan.rotation[:, :, 0], up, atol=1e-12)
    # The frame turns with the tangent: what was ahead of the contact is now below.
    np.testing.assert_allclose(plan.rotation[:, :, 2], -tangent, atol=1e-12)
    assert np.all(np.isnan(plan.force))


def test_rotations_are_proper_and_continuous(grasps):
    plan = wrod.plan(wrod.pattern("letter-A"), ROD, "numeric")
    identity = np.einsum("tji,tjk->tik", plan.rotation, plan.rotation)
    np.testing.assert_allclose(identity, np.broadcast_to(np.eye(3), identity.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(plan.rotation), 1.0, atol=1e-12)
    steps = Rotation.from_matrix(plan.rotation[:-1]).inv() * Rotation.from_matrix(plan.rotation[1:])
    assert np.max(steps.magnitude()) < 0.35
    assert np.max(np.linalg.norm(np.diff(plan.position, axis=0), axis=1)) < 0.02


def test_plan_follows_algorithm_opt(grasps):
    plan = wrod.plan(wrod.pattern("line"), ROD, "numeric", spacing=0.01)
    lgb = ROD.gravito_bending_length
    s = plan.arc_length
    expected = np.column_stack([s + 2.5 * lgb, 0 * s, ROD.length - s - 1.5 * lgb])
    np.testing.assert_allclose(plan.position, expected, atol=1e-12)
    frame = Rotation.from_rotvec([0.0, -1.4, 0.0]).as_matrix()
    np.testing.assert_allclose(plan.rotation, np.broadcast_to(frame, plan.rotation.shape))
    unit = ROD.bending_stiffness / lgb**2
    np.testing.assert_allclose(plan.force[:, 2], 0.75 * unit)


def test_mirrored_pattern_gives_the_mirrored_plan(grasps):
    angle = np.linspace(0.0, 4.0, 120)
    points = 0.09 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    left = wrod.plan(wrod.Pattern.from_points(points), ROD, "numeric", remainder=True)
    right = wrod.plan(
        wrod.Pattern.from_points(points * [1.0, -1.0]), ROD, "numeric", remainder=True
    )
    mirror = np.diag([1.0, -1.0, 1.0])
    np.testing.assert_allclose(right.position, left.position @ mirror, atol=1e-9)
    # A reflected frame is left-handed; turning its y axis round makes it the mirrored plan's.
    np.testing.assert_allclose(right.rotation, mirror @ left.rotation @ mirror, atol=1e-7)
    np.testing.assert_allclose(right.force, left.force @ mirror, atol=1e-9)


def test_remainder_counts_as_laid_length():
    plan = wrod.plan(wrod.pattern("circle"), ROD, "intuitive")
    remainder = plan.metadata["remainder_length"]
    assert remainder > 0.05
    assert plan.pattern_arc_length[0] == pytest.approx(-remainder)
    assert plan.arc_length[-1] == pytest.approx(wrod.pattern("circle").length + remainder)
    height = plan.position[:, 2] - plan.contact[:, 2]
    np.testing.assert_allclose(height, ROD.length - plan.arc_length, atol=1e-12)


def test_remainder_is_left_out_where_not_asked_for_or_not_needed():
    for name, choice in (("circle", False), ("letter-L", None), ("line", True)):
        plan = wrod.plan(wrod.pattern(name), ROD, "intuitive", remainder=choice)
        assert plan.metadata["remainder_length"] == 0.0
    plan = wrod.plan(wrod.pattern("circle"), ROD, "intuitive", remainder=0.2)
    assert plan.metadata["remainder_length"] == pytest.approx(0.2)


def test_a_beginning_that_bends_soon_gets_a_remainder_too():
    """As the paper's letter C does: nearly straight where it begins, bent within 2 L_gb."""
    lgb = ROD.gravito_bending_length

    def bends_after(start):
        s = np.linspace(0.0, 12.0 * lgb, 400)
        curvature = 0.4 / lgb * np.clip(s / (start * lgb), 0.0, 1.0) ** 2
        heading = np.concatenate([[0.0], np.cumsum(0.5 * (curvature[1:] + curvature[:-1]))])
        heading *= s[1]
        steps = s[1] * np.column_stack([np.cos(heading), np.sin(heading)])
        return wrod.Pattern.from_points(np.cumsum(steps, axis=0), smoothing=0.0)

    soon, late = bends_after(1.5), bends_after(6.0)
    off, curvature = free_end(soon, ROD)
    # Friction 0.3 holds 0.4 / L_gb from a length of sqrt(4 0.4 / 0.3) = 2.31 L_gb on.
    assert off == pytest.approx(0.4 * (1.5**2 / 4 + (2.31**2 - 1.5**2) / 2), rel=0.03)
    assert curvature == pytest.approx(0.4 / lgb, rel=0.01)
    assert prepare(soon, ROD, None).remainder_length > 0.05
    assert free_end(late, ROD)[0] < 0.05
    assert prepare(late, ROD, None).remainder_length == 0.0


def test_where_a_shorter_remainder_may_do_too_both_are_known():
    small = wrod.pattern("circle").scaled(0.53)
    held, gentle = lead_ins(small, ROD)
    assert held.remainder_length == prepare(small, ROD, None).remainder_length
    assert 0.05 < gentle.remainder_length < 0.9 * held.remainder_length
    assert lead_ins(held, ROD) == [held]
    (straight,) = lead_ins(wrod.pattern("letter-U"), ROD)
    assert straight.remainder_length == 0.0


def test_default_remainder_asks_for_little_friction_or_is_held_or_turns_little():
    plan = wrod.plan(wrod.pattern("circle"), ROD, "intuitive")
    assert plan.metadata["required_friction"] == pytest.approx(0.25, rel=0.05)
    cable, bend = replace(wrod.rod("cable"), length=2.0), 1.0 / 0.085
    laid = wrod.plan(wrod.pattern("circle"), cable, "intuitive").metadata["remainder_length"]
    moment = 0.5 * 0.3 * cable.weight * laid**2  # of friction 0.3 about the circle's beginning
    assert moment == pytest.approx(cable.bending_stiffness * bend)
    # Curvature grows antisymmetrically about its half: the turn is half of length times curvature.
    stiff = replace(cable, gravito_bending_length=1.2 * cable.gravito_bending_length)
    laid = prepare(wrod.pattern("circle"), stiff, None).remainder_length
    assert 0.5 * laid * bend == pytest.approx(0.8)


def test_default_remainder_shrinks_to_a_short_rod():
    rod = wrod.RodMaterial(0.0016, 0.032, 0.66)  # too short for the 13 cm it would get
    plan = wrod.plan(wrod.pattern("circle"), rod, "intuitive")
    assert plan.arc_length[-1] == pytest.approx(0.66 - 0.032)


def test_no_remainder_where_there_is_hardly_room():
    with pytest.warns(WrodWarning, match="no room for a lead-in"):
        plan = wrod.plan(wrod.pattern("circle"), wrod.RodMaterial(0.0016, 0.032, 0.6), "intuitive")
    assert plan.metadata["remainder_length"] == 0.0


def test_pattern_too_long_says_by_how_much():
    rod = wrod.RodMaterial(0.0016, 0.032, 0.5)
    with pytest.raises(PatternError, match=r"0\.5 m.*0\.468 m.*by 0\.032 m"):
        wrod.plan(wrod.pattern("line"), rod, "intuitive")
    huge = wrod.Pattern.from_points(wrod.pattern("sine").sample(np.linspace(0, 0.5, 90))[0] * 1e2)
    with pytest.raises(PatternError, match="another unit"):
        wrod.plan(huge, ROD, "intuitive")


def test_contacts_that_miss_a_bend_are_refused_or_told_of():
    with pytest.raises(PatternError, match=r"by up to 15 mm; give a shorter spacing"):
        wrod.plan(wrod.pattern("circle"), ROD, "intuitive", spacing=0.1)
    with pytest.warns(WrodWarning, match=r"by up to 3\.7 mm"):
        wrod.plan(wrod.pattern("circle"), ROD, "intuitive", spacing=0.05)


def test_bend_tighter_than_the_rod_is_refused():
    angle = np.linspace(0.0, 3.0, 60)
    small = wrod.Pattern.from_points(0.0012 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    with pytest.raises(PatternError, match="tighter than the rod's own radius"):
        wrod.plan(small, ROD, "intuitive", remainder=False)


def test_rod_longer_than_is_solved_is_refused_in_metres():
    rod = replace(wrod.rod("green-vps"), length=3.3)
    for method in ("auto", "numeric"):
        with pytest.raises(PatternError, match=r"rod of 3.3 m .* up to the 3.2 m \(100 L_gb\)"):
            wrod.plan(wrod.pattern("line"), rod, method)


def test_rod_too_thick_for_its_stiffness_is_refused_by_its_own_numbers():
    thick = replace(wrod.rod("green-vps"), radius=0.01)
    with pytest.raises(RodError, match=r"too thick .* radius of 0\.01 m .*from 50 to 1e\+07"):
        wrod.plan(wrod.pattern("line"), thick)


def test_bend_beyond_what_is_solved_is_refused_in_units_of_the_pattern():
    stiff = wrod.RodMaterial(0.001, 0.3, 1.5)
    with pytest.raises(PatternError, match=r"20 1/m at s = .*the 16\.7 1/m \(5 / L_gb\).*round it"):
        wrod.plan(wrod.pattern("letter-U"), stiff, closure="zero_tension")


@pytest.mark.parametrize("spacing", [0.0, -0.1, np.nan, 1e-9])
def test_spacing_is_checked(spacing):
    with pytest.raises(PatternError, match="spacing"):
        wrod.plan(wrod.pattern("line"), ROD, "intuitive", spacing=spacing)


def test_spin_turns_the_hand_evenly_about_the_rod_and_stays_in_the_tail():
    from wrod.planning.tail import tail

    pattern, rod = wrod.pattern("letter-C"), wrod.rod("green-vps")
    plain, spun = (wrod.plan(pattern, rod, "neural", spin=spin) for spin in (0.0, 5.0))
    np.testing.assert_array_equal(spun.position, plain.position)
    np.testing.assert_allclose(spun.rotation[..., 0], plain.rotation[..., 0], atol=1e-12)
    turned = plain.rotation.transpose(0, 2, 1) @ spun.rotation
    angle = np.unwrap(np.arctan2(turned[:, 2, 1], turned[:, 1, 1]))
    np.testing.assert_allclose(angle, 5.0 * plain.arc_length / plain.arc_length[-1], atol=1e-9)
    ends = [tail(pattern, rod, t).rotation[-1] for t in (plain, spun)]
    left = Rotation.from_matrix(ends[0].T @ ends[1]).as_rotvec()
    np.testing.assert_allclose(left, [5.0 - 2.0 * np.pi, 0.0, 0.0], atol=1e-3)
    assert spun.spin == 5.0 and plain.spin == 0.0
    with pytest.raises(GraspError, match="leave spin out"):
        wrod.plan(pattern, replace(rod, natural_curvature=(0.0, 4.0)), "intuitive", spin=1.0)


def test_a_tail_ends_before_its_grip_would_go_under_the_table():
    from wrod.planning.tail import tail

    pattern, rod = wrod.pattern("line"), replace(wrod.rod("green-vps"), length=0.6)
    plain = wrod.plan(pattern, rod, "neural")
    lower = replace(plain, position=plain.position - [0.0, 0.0, 0.008])
    whole, cut = (tail(pattern, rod, path) for path in (plain, lower))
    assert whole.position[:, 2].min() > 0.0
    assert cut.position[:, 2].min() >= 0.0
    assert 2 < len(cut.laid) < len(whole.laid)


def test_a_plan_for_a_table_holds_the_rod_nearer_whoever_lays_it(tmp_path):
    """The whole rod and one that ends at the grip are laid alike, from a file, too."""
    rod = wrod.RodMaterial(0.0016, 0.018, 0.3)
    points = np.column_stack([np.linspace(0.0, 0.12, 20), np.zeros(20)])
    pattern, how = (
        wrod.Pattern.from_points(points),
        dict(method="distilled", friction=0.3, spacing=0.01),
    )
    path = wrod.plan(pattern, rod, **how)
    held = 0.12 + 4.0 * 0.018
    assert path.rod.length == pytest.approx(held) and path.beyond_grip == pytest.approx(0.3 - held)
    path = Trajectory.load(path.save(tmp_path / "plan")[1])
    laid = [
        wrod.simulate_deployment(pattern, replace(rod, length=length), path, 0.3, speed=0.04)
        for length in (0.3, path.rod.length)
    ]
    np.testing.assert_array_equal(laid[0].released_centerline, laid[1].released_centerline)
    with pytest.raises(RodError, match="whose length is"):
        wrod.simulate_deployment(pattern, replace(rod, length=0.29), path)
    far, near = wrod.plan(pattern, rod, left=False, **how), wrod.plan(pattern, rod, left=6)
    assert far.beyond_grip == 0.0 and far.rod.length == 0.3
    assert near.beyond_grip == pytest.approx(0.3 - 0.12 - 6.0 * 0.018)
    assert wrod.plan(pattern, rod).beyond_grip == 0.0
    with pytest.raises(GraspError, match="left"):
        wrod.plan(pattern, rod, left=0.5)


def test_what_hangs_of_a_spun_rod_is_twisted_as_much_as_the_hand_has_turned():
    laid = np.linspace(0.0, 0.6, 2001)
    twist = held_twist(0.8, laid, 5.0)
    on_the_table = np.concatenate([[0.0], np.cumsum(0.5 * (twist[1:] + twist[:-1]) * laid[1])])
    np.testing.assert_allclose(on_the_table + (0.8 - laid) * twist, 5.0 * laid / 0.6, atol=1e-6)


def test_grasps_that_know_the_twist_lay_a_spun_rod_where_the_table_holds_its_roll():
    from wrod.deployment.expectation import COARSE, PACE
    from wrod.deployment.setup import Disturbance
    from wrod.deployment.simulate import Trial
    from wrod.deployment.tangents import lay
    from wrod.planning.plan import plan_grasps
    from wrod.planning.tail import Tail
    from wrod.rods.model import RodModel
    from wrod.solvers.friction import Friction

    pattern, rod = wrod.pattern("line"), wrod.rod("green-vps")
    how = dict(closure="zero_tension", spacing=0.01, roll="plane", controller=None, device="cpu")
    how |= dict(remainder=False, progress=None, spin=8.0)
    plans = [plan_grasps(pattern, rod, "numeric", twisted=knows, **how) for knows in (False, True)]
    law = Friction(0.6, roll=3.0)
    # Grasps are of rods at rest: damping inside lays the rod aside by as much as it is laid fast.
    still = replace(RodModel.of(rod), internal_damping=0.0)
    trials = [Trial(pattern, still, t, law, Disturbance(), Tail.none(t)) for t in plans]
    off = [
        np.abs(one.centerline[one.arc_length < pattern.length, 1]).mean()
        for one in lay(trials, None, hold=0.05, discretisation=COARSE, speed=PACE)
    ]
    assert off[0] > 2e-3 and off[1] < 3e-4


def test_unknown_method():
    with pytest.raises(GraspError, match="numeric, intuitive"):
        wrod.plan(wrod.pattern("line"), ROD, "guess")


@pytest.mark.parametrize("field", ["converged", "position"])
def test_unconverged_grasp_is_named(grasps, field):
    def solve(*args, **options):
        result = fake_grasps(*args, **options)
        getattr(result, field)[7:9] = False if field == "converged" else np.nan
        return result

    grasps(solve)
    with pytest.raises(GraspError, match=r"node 7 of 51 \(s = 0\.0700 m.*2 nodes"):
        wrod.plan(wrod.pattern("line"), ROD, "numeric", spacing=0.01)


def test_unstable_grasps_warn(grasps):
    def solve(*args, **options):
        result = fake_grasps(*args, **options)
        return replace(result, stable=np.arange(len(result)) != 3)

    grasps(solve)
    with pytest.warns(StabilityWarning, match=r"1 of 101 .*0\.015"):
        wrod.plan(wrod.pattern("line"), ROD, "numeric", spacing=0.005)


def test_grasps_close_to_instability_warn(grasps):
    def solve(*args, **options):
        result = fake_grasps(*args, **options)
        result.eigenvalue[5] *= 0.1
        return result

    grasps(solve)
    with pytest.warns(StabilityWarning, match=r"1 of 101 .*close.*0\.025.*14%"):
        wrod.plan(wrod.pattern("line"), ROD, "numeric", spacing=0.005)


def test_progress_counts_every_node_once(grasps):
    seen = []
    plan = wrod.plan(
        wrod.pattern("letter-A"),
        ROD,
        "numeric",
        progress=lambda count, total: seen.append((count, total)),
    )
    whole = wrod.plan(wrod.pattern("letter-A"), ROD, "numeric")
    assert sum(count for count, _ in seen) == len(plan) == seen[0][1]
    np.testing.assert_allclose(plan.position, whole.position, atol=1e-12)


def test_a_trajectory_below_a_file_is_refused(tmp_path):
    plan = wrod.plan(wrod.pattern("line"), ROD, "neural", spacing=0.1)
    (tmp_path / "file").write_text("x")
    with pytest.raises(DataError, match="a file stands where it has a folder"):
        plan.save(tmp_path / "file" / "plan")
    assert (tmp_path / "file").read_text() == "x"


def test_trajectory_files_carry_units_and_read_back(tmp_path):
    plan = wrod.plan(wrod.pattern("sine"), ROD, "intuitive")
    csv_path, npz_path = plan.save(tmp_path / "t")
    header = csv_path.read_text().splitlines()[1]
    assert "position_x [m]" in header and "force_z [N]" in header
    table = np.genfromtxt(csv_path, delimiter=",", skip_header=2)
    np.testing.assert_allclose(table[:, 4:7], plan.position, atol=1e-10)
    again = Trajectory.load(npz_path)
    np.testing.assert_array_equal(again.rotation, plan.rotation)
    assert again.metadata == plan.metadata and again.shape is None


@pytest.mark.parametrize("by", [[0.0, 0.0, -0.5], [0.0, 0.0, 5.0], [0.0, 0.9, 0.0]])
def test_a_file_whose_grip_is_where_no_rod_reaches_is_refused(tmp_path, by):
    plan = wrod.plan(wrod.pattern("letter-U"), ROD, "neural", spacing=0.005)
    _, path = plan.save(tmp_path / "t")
    assert len(Trajectory.load(path)) == len(plan)
    wrong = dict(np.load(path))
    wrong["position"] += by
    np.savez(path, **wrong)
    with pytest.raises(DataError, match="where no such rod hangs"):
        Trajectory.load(path)


@pytest.mark.parametrize("rows", [[0], [40], [-1], range(40, 60), range(50, 109)])
@pytest.mark.parametrize("by", [[0.5, 0.0, 0.0], [0.0, 0.0, -0.2]])
def test_a_file_whose_grip_jumps_is_refused(tmp_path, rows, by):
    plan = wrod.plan(wrod.pattern("letter-U"), ROD, "neural", spacing=0.005)
    _, path = plan.save(tmp_path / "t")
    wrong = dict(np.load(path))
    wrong["position"][list(rows)] += by
    np.savez(path, **wrong)
    first = max(rows[0] % len(plan), 1)
    with pytest.raises(DataError, match=rf"position: contact node {first}: the grip jumps there"):
        Trajectory.load(path)


def test_the_sharpest_of_our_plans_do_not_jump(tmp_path):
    """The cable is so stiff that it lays the A with its grip swinging by 0.36 m in 2 cm of rod."""
    letter = wrod.pattern("letter-A")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plan = wrod.plan(letter, wrod.rod("cable"), "neural", spacing=0.02)
    way = np.linalg.norm(np.diff(plan.position, axis=0), axis=1)
    assert way.max() > 0.1
    assert len(Trajectory.load(plan.save(tmp_path / "t")[1])) == len(plan)


def test_neural_plans_get_the_shapes_of_the_solver(recwarn):
    from wrod.planning.shapes import with_shapes

    circle, rod = wrod.pattern("circle"), wrod.rod("green-vps")
    plain = wrod.plan(circle, rod, "neural", spacing=0.025)
    assert plain.shape is None and plain.metadata["remainder_length"] > 0.0
    shown = with_shapes(plain, circle, device="cpu")
    numeric = wrod.plan(circle, rod, "numeric", spacing=0.025, device="cpu")
    np.testing.assert_allclose(shown.shape, numeric.shape, atol=5e-5)
    np.testing.assert_allclose(shown.shape[:, -1], plain.position, atol=1e-12)
    np.testing.assert_array_equal(shown.position, plain.position)
    apart = np.linalg.norm(numeric.position - plain.position, axis=1).max()
    assert shown.metadata["shapes"] == {
        "method": "numeric",
        "largest_grip_difference": pytest.approx(apart, abs=1e-12),
    }
    assert with_shapes(numeric, circle) is numeric
    intuitive = wrod.plan(circle, rod, "intuitive", spacing=0.025)
    assert with_shapes(intuitive, circle) is intuitive
    assert not recwarn.list


def test_shapes_of_a_trajectory_from_a_file_follow_its_contacts(tmp_path):
    from wrod.planning.shapes import with_shapes

    letter = wrod.pattern("letter-U")
    plan = wrod.plan(letter, ROD, "neural", spacing=0.005)
    read = wrod.Trajectory.load(plan.save(tmp_path / "t")[1])
    ours, known = with_shapes(read, device="cpu"), with_shapes(plan, letter, device="cpu")
    assert np.linalg.norm(ours.shape - known.shape, axis=2).max() < 1e-3
    assert ours.metadata["shapes"]["largest_grip_difference"] < 1e-3


def test_shapes_of_other_grips_are_left_out():
    from dataclasses import replace

    from wrod.planning.shapes import with_shapes

    line = wrod.pattern("line")
    plan = wrod.plan(line, ROD, "neural", spacing=0.25)
    moved = replace(plan, position=plan.position + 0.01)
    with pytest.warns(WrodWarning, match="from the planned ones"):
        assert with_shapes(moved, line, device="cpu").shape is None


def test_shapes_of_corrected_grips_end_at_them():
    from dataclasses import replace

    from wrod.planning.shapes import with_shapes

    circle = wrod.pattern("circle")
    start = wrod.plan(circle, ROD, "numeric", spacing=0.025, device="cpu")
    up = np.linspace(0.0, 0.03, len(start))[:, None] * [0.0, 0.0, 1.0]
    turn = Rotation.from_rotvec(10.0 * up).as_matrix()
    said = {**start.metadata, "optimised": {"largest_correction": 0.03}}
    plan = replace(
        start,
        position=start.position + up,
        rotation=turn @ start.rotation,
        shape=None,
        metadata=said,
    )
    shown = with_shapes(plan, circle, device="cpu")
    np.testing.assert_allclose(shown.shape[:, -1], plan.position, atol=1e-12)
    np.testing.assert_allclose(shown.shape[:, 0], start.shape[:, 0], atol=1e-9)
    ends = np.diff(shown.shape, axis=1)[:, -1]
    ends /= np.linalg.norm(ends, axis=1, keepdims=True)
    np.testing.assert_allclose(ends, plan.rotation[..., 0], atol=0.05)
    assert "shapes" not in shown.metadata  # corrections are no error of a controller


def test_shapes_that_cannot_be_solved_are_left_out():
    from wrod.planning.shapes import with_shapes

    soft = wrod.RodMaterial(0.0016, 0.008, 1.2)  # 150 L_gb
    with pytest.warns(OutOfRangeWarning):
        plan = wrod.plan(wrod.pattern("line"), soft, "neural", spacing=0.2)
    with pytest.warns(WrodWarning, match="shapes are left out: suspended_length"):
        assert with_shapes(plan, device="cpu").shape is None


def test_default_plan_takes_the_closure_that_lays_best():
    """Least friction in bends of more than 0.4 / L_gb; elsewhere, and where a method is named, the
    paper's closure."""
    from wrod.planning.plan import favoured_closure

    bent, straight = wrod.pattern("letter-U"), wrod.pattern("line")
    assert favoured_closure(bent, ROD) == "min_friction"
    assert favoured_closure(straight, ROD) == "zero_tension"
    assert favoured_closure(bent, wrod.RodMaterial(0.0016, 0.015, 0.885)) == "zero_tension"
    off_a_spool = replace(ROD, natural_curvature=(4.0, 0.0))
    assert favoured_closure(bent, off_a_spool) == "min_friction"
    assert favoured_closure(bent, replace(ROD, natural_curvature=(0.0, 20.0))) == "zero_tension"
    plan = wrod.plan(bent, ROD, spacing=0.05, device="cpu")
    assert (plan.metadata["method"], plan.metadata["closure"]) == ("auto", "min_friction")
    assert plan.metadata["solver"] == "trained controller"
    numeric = wrod.plan(bent, ROD, "numeric", closure="min_friction", spacing=0.05, device="cpu")
    # A network answers, within what it errs by, and tells the force at the contact as well.
    np.testing.assert_allclose(plan.position, numeric.position, atol=2e-5)
    assert not np.array_equal(plan.position, numeric.position)
    asked = numeric.metadata["contact_friction"]
    assert plan.metadata["contact_friction"] == pytest.approx(asked, rel=2e-3)
    paper = wrod.plan(bent, ROD, "numeric", spacing=0.05, device="cpu")
    assert paper.metadata["closure"] == "zero_tension"
    line = wrod.plan(straight, ROD, spacing=0.1, device="cpu")
    assert line.metadata["closure"] == "zero_tension"
    # What it is for: the table has to give less friction where the rod touches down.
    asked, spared = (p.metadata["contact_friction"] for p in (paper, plan))
    assert 0.3 < spared < 0.85 * asked
    assert line.metadata["contact_friction"] < 0.01
    assert wrod.plan(straight, ROD, "intuitive").metadata["contact_friction"] is None
