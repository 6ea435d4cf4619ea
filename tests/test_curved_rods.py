"""Naturally curved rods: grasps, plans, deployments and datasets of them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cli import done, refused, run, told
from scipy.spatial.transform import Rotation
from test_deployment import QUICK, ROD, quarter_turn
from wrod.training import store
from wrod.training.dataset import generate, load
from wrod.training.sampling import RodInputs, sample

import wrod
from wrod.deployment.discretisation import Discretisation
from wrod.deployment.simulate import Trial, simulate_deployments
from wrod.errors import DataError, GraspError, RodError, WrodWarning
from wrod.grasps.optimal import solve_grasps
from wrod.planning.roll import roll_angle
from wrod.planning.tail import tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.batch import RodBatch
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel
from wrod.solvers.contact import Contact

CURVED = replace(ROD, natural_curvature=(6.0, 0.0))
LENGTHS = np.array([1.5, 4.0, 9.0, 20.0])
CURVATURES = np.array([0.0, 0.8, -0.5, 1.6])


@pytest.fixture(scope="module")
def straight():
    return solve_grasps(LENGTHS, CURVATURES, 2000.0)


def test_a_hardly_curved_rod_is_a_straight_one(straight):
    """Another mesh and another system of equations, in the limit the same rod."""
    grasps = solve_grasps(LENGTHS, CURVATURES, 2000.0, natural_curvature=(1e-9, 0.0))
    assert grasps.converged.all()
    assert np.abs(grasps.position - straight.position).max() < 1e-4
    assert np.abs(grasps.rotation - straight.rotation).max() < 1e-4
    assert np.abs(grasps.force - straight.force).max() < 2e-5
    assert np.abs(grasps.twist).max() < 1e-6
    assert straight.twist is None


def test_zeros_take_the_straight_rods_path(straight):
    grasps = solve_grasps(LENGTHS, CURVATURES, 2000.0, natural_curvature=np.zeros((4, 2)))
    assert (grasps.position == straight.position).all()
    assert (grasps.rotation == straight.rotation).all()


def test_mirror_image_of_a_curved_rod():
    left = solve_grasps(LENGTHS, CURVATURES, 2000.0, natural_curvature=(0.12, 0.05))
    right = solve_grasps(LENGTHS, -CURVATURES, 2000.0, natural_curvature=(-0.12, 0.05))
    assert left.converged.all() and right.converged.all()
    assert np.abs(left.position - right.position * [1, -1, 1]).max() < 1e-8
    assert np.abs(left.force - right.force * [1, -1, 1]).max() < 1e-8
    assert np.abs(left.rotation - right.rotation * [-1, 1, -1]).max() < 1e-8
    assert np.abs(left.twist + right.twist).max() < 1e-8


def test_curvature_in_the_plane_of_a_straight_pattern_stays_in_it():
    """Bent upwards, the rod of a straight pattern leaves neither its plane nor its roll."""
    grasps = solve_grasps(LENGTHS, 0.0, 2000.0, natural_curvature=(0.0, 0.15))
    assert grasps.converged.all()
    assert np.abs(grasps.position[:, 1]).max() < 1e-9
    assert np.abs(grasps.twist).max() < 1e-9


def test_moment_about_the_vertical_is_carried_to_the_grip():
    """Weight has no moment about z: that of the contact, kappa - c_y, is what the horizontal force
    has about it, and the torque that twists the part which hangs straight, G J times the rate."""
    kappa, natural = 1.6, 0.13
    grasps = solve_grasps([20.0, 24.0], kappa, 2000.0, natural_curvature=(natural, 0.0))
    (x, y, _), (f_x, f_y, _) = grasps.position[0], -grasps.force[0]
    torque = (kappa - natural) - (x * f_y - y * f_x)
    vertical = Rotation.from_rotvec(grasps.rotation[0]).apply([1.0, 0.0, 0.0])[2]
    rate = (grasps.twist[1] - grasps.twist[0]) / 4.0
    assert abs(torque) > 0.1
    assert rate / (1.0 + 0.5) * vertical == pytest.approx(torque, abs=2e-3)


@pytest.mark.parametrize("closure", ["min_force", "min_friction"])
def test_closures_of_a_curved_rod_are_minima(closure):
    natural = (0.12, 0.0)
    best = solve_grasps(LENGTHS, CURVATURES, 2000.0, closure=closure, natural_curvature=natural)
    other = solve_grasps(LENGTHS, CURVATURES, 2000.0, natural_curvature=natural)
    assert best.converged.all()
    axes = slice(None) if closure == "min_force" else slice(2)
    size, before = (np.linalg.norm(g.force[:, axes], axis=1) for g in (best, other))
    assert (size <= before + 1e-9).all()
    assert size[3] < before[3] - 0.05


def test_bad_natural_curvature_is_named():
    with pytest.raises(GraspError, match="outside the -1 to 1"):
        solve_grasps(5.0, 0.0, 2000.0, natural_curvature=(1.5, 0.0))
    with pytest.raises(GraspError, match="outside"):
        solve_grasps(5.0, 0.0, 2000.0, natural_curvature=(np.nan, 0.0))
    with pytest.raises(GraspError, match=r"\(2,\) or \(n, 2\)"):
        solve_grasps(5.0, 0.0, 2000.0, natural_curvature=(0.1, 0.0, 0.0))
    with pytest.raises(GraspError, match="sensitivities"):
        solve_grasps(5.0, 0.0, 2000.0, natural_curvature=(0.1, 0.0), sensitivities=True)
    with pytest.raises(GraspError, match="poisson"):
        solve_grasps(5.0, 0.0, 2000.0, natural_curvature=(0.1, 0.0), poisson=0.7)


def test_rod_file_carries_natural_curvature(tmp_path):
    rod = replace(CURVED, natural_curvature=(3.0, -1.0))
    assert wrod.load_rod(wrod.save_rod(rod, tmp_path / "rod.json")) == rod
    assert not rod.is_straight and ROD.is_straight
    assert rod.curvature_held(0.0) == (3.0, -1.0)
    # A quarter turn takes the first director from left to up, the second from up to right.
    assert rod.curvature_held(np.pi / 2) == pytest.approx((1.0, 3.0))
    for bad in ((1.0,), (1.0, np.nan), "x", None):
        with pytest.raises(RodError, match="natural_curvature"):
            replace(ROD, natural_curvature=bad)


def test_rolls_by_word():
    with pytest.raises(GraspError, match="roll is 45"):  # degrees
        wrod.plan(wrod.pattern("line"), wrod.rod("rope"), roll=45.0)
    pattern = quarter_turn()
    rod = replace(ROD, natural_curvature=(1.0, 2.0))
    held = rod.curvature_held(roll_angle("up", pattern, rod))
    assert held == pytest.approx((0.0, np.sqrt(5.0)))
    # In the plane, to the side to which the pattern turns.
    left, up = rod.curvature_held(roll_angle("plane", pattern, rod))
    assert (left, up) == pytest.approx((np.sqrt(5.0), 0.0))
    right = wrod.Pattern.from_points(pattern.sample(np.linspace(0, 0.15, 80))[0] * [1, -1, 1])
    left, up = rod.curvature_held(roll_angle("plane", right, rod))
    assert (left, up) == pytest.approx((-np.sqrt(5.0), 0.0))
    for word in ("up", "plane"):
        assert roll_angle(word, pattern, ROD) == 0.0
        left, up = rod.curvature_held(roll_angle(word, pattern, rod))
        assert RodInputs.of(rod, word).natural_curvature == pytest.approx(
            (0.018 * left, 0.018 * up)
        )
    with pytest.raises(GraspError, match="roll is 'sideways'"):
        roll_angle("sideways", pattern, rod)


@pytest.fixture(scope="module")
def plans():
    """Of the curved rod: as it is, and as it was believed, held the same way."""
    pattern = quarter_turn()
    new = wrod.plan(pattern, CURVED, "numeric", roll="plane", device="cpu")
    old = wrod.plan(pattern, ROD, "numeric", roll=new.roll, device="cpu")
    return pattern, new, old


def test_plan_of_a_curved_rod(plans, tmp_path):
    pattern, new, old = plans
    assert new.metadata["rod"]["natural_curvature"] == [6.0, 0.0]
    assert old.twist is None and len(new.twist) == len(new)
    # The twist dwindles with the length that hangs.
    assert abs(new.twist[0]) > abs(new.twist[-1])
    assert 1e-3 < np.linalg.norm(new.position - old.position, axis=1).max() < 0.02
    again = Trajectory.load(new.save(tmp_path / "plan")[1])
    assert (again.twist == new.twist).all()
    with pytest.warns(WrodWarning, match="naturally straight rods only"):
        neural = wrod.plan(pattern, CURVED, "neural", roll="plane", device="cpu")
    assert neural.metadata["method"] == "numeric"
    assert np.abs(neural.position - new.position).max() < 1e-12
    with pytest.raises(GraspError, match="roll is nan"):
        wrod.plan(pattern, CURVED, roll=float("nan"))


def test_knowing_the_curvature_lays_the_rod_better(plans):
    pattern, new, old = plans
    upright = wrod.plan(pattern, ROD, "numeric", device="cpu")
    upright = replace(upright, roll=roll_angle("up", pattern, CURVED))
    known, unknown, up = simulate_deployments(
        [
            Trial(pattern, CURVED, path, wrod.Friction(0.8), tail=tail(pattern, rod, path))
            for path, rod in ((new, CURVED), (old, ROD), (upright, ROD))
        ],
        **QUICK,
    )
    assert not known.diverged and not unknown.diverged and not up.diverged
    assert known.error_mean < 1e-3
    assert unknown.error_mean > 2.0 * known.error_mean
    # Held with its curvature up, even the rod that nobody knows is curved is hardly pushed aside.
    assert up.error_mean < 0.5 * unknown.error_mean


def test_a_strongly_bent_rod_is_tilted_and_not_laid_in_waves():
    """In the plane its way on the table departs from the line, and ever faster: 3 mm at 9 /m."""
    line = wrod.pattern("line")
    right = wrod.Pattern.from_points(np.array([[0.0, 0.0], [0.3, 0.0], [0.5, -0.1], [0.6, -0.3]]))
    bent = replace(wrod.rod("green-vps"), natural_curvature=(0.0, 9.0))
    up, across = 9.0 * np.sin(np.radians(30.0)), 9.0 * np.cos(np.radians(30.0))
    assert bent.curvature_held(roll_angle(None, line, bent)) == pytest.approx((across, up))
    assert bent.curvature_held(roll_angle(None, right, bent)) == pytest.approx((-across, up))
    mildly = replace(bent, natural_curvature=(0.0, 5.0))
    for other, known in ((mildly, False), (bent, True)):
        assert roll_angle(None, line, other, known) == roll_angle("plane", line, other)
    mesh = Discretisation(spacing=0.01, step=0.02)
    how = {"device": "cpu", "remainder": False, "spacing": 0.01}
    paths = [wrod.plan(line, bent, roll=roll, **how) for roll in (None, "plane")]
    trials = [Trial(line, bent, path, wrod.Friction(1.0)) for path in paths]
    tilted, plane = simulate_deployments(trials, discretisation=mesh, speed=0.05)
    assert tilted.error_mean < 1e-3
    assert plane.error_mean > 2.5e-3


def test_deployment_bends_the_rod_the_way_that_it_is_held(plans):
    """Held upside down, the same rod drifts to the other side."""
    pattern, _, old = plans
    turned = replace(old, roll=old.roll + np.pi)
    trials = [
        Trial(pattern, CURVED, path, wrod.Friction(0.8), tail=tail(pattern, ROD, path))
        for path in (old, turned)
    ]
    one, other = simulate_deployments(trials, **QUICK)
    ideal = wrod.simulate_deployment(pattern, ROD, old, 0.8, **QUICK)
    s = np.linspace(0.06, pattern.length, 20)
    tangent = pattern.sample(s)[1]
    sides = [
        np.array(
            [np.interp(s, d.arc_length, (d.centerline - ideal.centerline)[:, c]) for c in (0, 1)]
        )
        for d in (one, other)
    ]
    drift = [(-tangent[:, 1] * x + tangent[:, 0] * y).mean() for x, y in sides]
    assert drift[0] * drift[1] < 0.0
    assert min(np.abs(drift)) > 2e-4


def test_roll_of_a_laid_rod_is_kept_unless_it_rolls():
    from wrod.rods.batch import RodBatch

    batch = RodBatch(
        np.stack([np.column_stack([np.linspace(0, 0.1, 5), np.zeros(5), np.full(5, 1.5e-3)])] * 3),
        stretching_stiffness=1.0,
        bending_stiffness=1e-6,
        twisting_stiffness=1e-6,
    )
    friction = [wrod.Friction(0.5), wrod.Friction(0.5, rolling=True), wrod.Friction(0.5)]
    contact = Contact(batch, 1.6e-3, 100.0, friction, keeps_roll=np.array([True, True, False]))
    before = batch.state.dof
    after = batch.state.dof.numpy().copy()
    after[:, 3::4] += 0.1
    import warp as wp

    turned = wp.array(after, dtype=wp.float64, device=batch.device)
    batch.derivatives.gradient.zero_()
    batch.derivatives.hessian.zero_()
    contact.add(batch.every_rod, turned, before)
    torque = batch.derivatives.gradient.numpy()[:, 3::4]
    # Coulomb's bound mu N R at each node, as 0.1 rad are too much for it; angles have half of two
    # nodes, at the ends all of one: 100 N/m^2 over 0.1 mm but half the skin.
    normal = 100.0 * 0.025 * (1e-4 - 0.5 * 0.01 * 1.6e-3)
    bound = 0.5 * normal * 1.6e-3
    assert torque[0] == pytest.approx(bound, rel=1e-9)
    assert torque[2] == pytest.approx(np.zeros(4), abs=1e-15)
    # A rod that turns where it is slides with its surface, which friction holds as much.
    assert torque[1] == pytest.approx(bound, rel=1e-9)


def test_dataset_of_one_rod(tmp_path):
    folder = tmp_path / "grasps"
    generate(folder, 12, shard_size=6, edge_count=32, rod=CURVED, device="cpu")
    manifest = store.read_manifest(folder)
    one = manifest.rod_inputs
    assert one == RodInputs.of(CURVED)
    assert one.natural_curvature == (pytest.approx(6.0 * 0.018), 0.0)
    table = load(folder)
    assert len(table) == 12 and table.sensitivity is None
    assert np.ptp(table.inputs[:, 2]) == 0.0
    assert table.inputs[:, 1].min() < 0.0 < table.inputs[:, 1].max()
    assert table.inputs[:, 0].max() <= 1.06 * one.length
    again = solve_grasps(
        *table.inputs[:3].T, natural_curvature=one.natural_curvature, edge_count=32
    )
    assert np.abs(again.position - table.outputs[:3, :3]).max() < 1e-9
    with pytest.raises(DataError, match="rod"):
        generate(folder, 12, shard_size=6, edge_count=32, device="cpu")
    assert RodInputs.of(CURVED, np.pi / 2).natural_curvature == pytest.approx((0.0, 0.108))
    # One straight rod: left turns only, and its derivatives.
    assert (sample(0, 16, 0, RodInputs.of(ROD))[:, 1] >= 0.0).all()


def test_dataset_command_takes_a_model(tmp_path):
    rod = RodMaterial(0.0016, 0.018, 0.2, natural_curvature=(0.0, 5.0))
    path = wrod.save_rod(rod, tmp_path / "rod.json")
    out = tmp_path / "grasps"
    args = ["dataset", "--size", "4", "--rod", str(path), "--length", "0.3", "--out", str(out)]
    assert told(*args, "--device", "cpu", "--json")["unconverged"] == 0
    assert store.read_manifest(out).rod.length == pytest.approx(0.3 / 0.018)
    assert store.read_manifest(out).rod.natural_curvature == pytest.approx([0.09, 0.0])
    args[-1] += "-turned"
    done(*args, "--roll", "up", "--device", "cpu")
    turned = store.read_manifest(tmp_path / "grasps-turned").rod.natural_curvature
    assert turned == pytest.approx([0.0, 0.09])
    refused("name it with --rod", "dataset", "--size", "4", "--roll", "0", "--out", args[-1])
    for roll in ("nan", "left"):
        refused("use plane, tilted, up or", *args, "--roll", roll)


def test_training_refuses_one_straight_rod(tmp_path):
    generate(tmp_path / "grasps", 4, edge_count=32, rod=ROD, device="cpu")
    args = ["train", "--dataset", str(tmp_path / "grasps"), "--out", str(tmp_path / "c")]
    result = run(*args, "--device", "cpu")
    assert result.exit_code == 2
    assert "one straight rod" in result.stderr


def test_grasps_around_half_a_turn_are_not_torn():
    """The meshes' rotation vectors lie on either side of half a turn here."""
    lengths = [23.17550296018525, 23.18]
    grasps = solve_grasps(lengths, 1.5409942319616674, 1600.0, natural_curvature=(0.128, 0.0))
    here, near = Rotation.from_rotvec(grasps.rotation)
    assert np.linalg.norm(grasps.rotation[0]) == pytest.approx(np.pi, abs=1e-3)
    assert (here.inv() * near).magnitude() < 0.01


def test_plan_command_takes_a_model(tmp_path):
    rod = RodMaterial(0.0016, 0.018, 0.2, natural_curvature=(0.0, 5.0))
    path = wrod.save_rod(
        RodModel.of(rod), tmp_path / "model.json", found={"set_aside": ["air_flow"]}
    )
    args = ["plan", "line", "--rod", str(path), "--length", "0.7", "--out", str(tmp_path / "o")]
    args += ["--no-robot", "--no-expect", "--spacing", "0.05", "--device", "cpu", "--json"]
    result = done(*args)
    assert "air_flow set aside" in result.stderr
    figures = json.loads(result.stdout)
    assert figures["rod"]["natural_curvature"] == pytest.approx([0.0, 5.0])
    assert figures["roll"] == pytest.approx(-np.pi / 2)
    assert len(figures["twist"]) == 2


@pytest.mark.parametrize("bent, said", [(0.0, False), (3.0, True)])
def test_only_of_a_rod_with_sides_is_it_said_how_to_roll_it(tmp_path, bent, said):
    """A rod that is softer towards one end, round and straight, has none."""
    rod = wrod.RodModel(
        length=0.7, bending_stiffness=wrod.Profile((3e-5, 2e-5), (0.0, 0.7)),
        twisting_stiffness=2e-5, stretching_stiffness=50.0, line_mass=0.01, radius=0.002,
        natural_curvature=(bent, 0.0),
    )  # fmt: skip
    wrod.save_rod(rod, tmp_path / "rod.json")
    args = ["plan", "line", "--rod", str(tmp_path / "rod.json"), "--out", str(tmp_path / "o")]
    result = done(*args, "--no-robot", "--no-expect", "--spacing", "0.1", "--device", "cpu")
    assert ("the rod has sides" in result.stdout) == said


def test_a_rod_described_in_directors_that_wind_is_laid_as_before():
    """An isotropic rod's directors are its user's choice: those that turn by 6 rad/m along it, in
    which it is twisted at rest and its natural curvature turns back."""
    length, winds = 0.3, 6.0
    plain = replace(wrod.RodModel.of(wrod.RodMaterial(0.0016, 0.032, length)),
                    natural_curvature=(4.0, 1.0))  # fmt: skip
    s = np.linspace(0.0, length, 601)
    towards = (4.0 + 1.0j) * np.exp(-1j * winds * s)
    parts = [wrod.Profile(tuple(part), tuple(s)) for part in (towards.real, towards.imag)]
    wound = replace(plain, natural_curvature=tuple(parts), natural_twist=winds)
    heading = 0.6 * np.sin(np.linspace(0.0, 2 * np.pi, 101))
    points = 1.2e-3 * np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    pattern = wrod.Pattern.from_points(points)
    trials = [
        wrod.Trial(pattern, rod, wrod.plan(pattern, rod, "numeric", spacing=0.02), friction)
        for rod in (plain, wound)
        for friction in [wrod.Friction(0.6)]
    ]
    one, other = (trial.trajectory for trial in trials)
    assert np.abs(one.position - other.position).max() < 5e-6
    assert other.twist - one.twist == pytest.approx(winds * length, abs=1e-4)
    mesh = wrod.Discretisation(0.01, 0.02, tolerance=1e-8)
    one, other = wrod.simulate_deployments(trials, discretisation=mesh, speed=0.05)
    assert np.abs(one.centerline - other.centerline).max() < 2e-5


def test_departures_of_the_roll_grow_as_the_tangents_of_grasps_say(monkeypatch):
    """A grip that turns for a moment by 4 mrad, and how the roll of what is laid after departs."""
    line = wrod.pattern("line")
    rod = replace(wrod.rod("green-vps"), length=0.65, natural_curvature=(4.0, 0.0))
    rolls, paths = np.radians([-90.0, 30.0]), []
    for roll in rolls:
        path = wrod.plan(
            line, rod, "numeric", roll=roll, device="cpu", remainder=False, spacing=0.005
        )
        turn = 4e-3 * np.exp(-0.5 * ((path.arc_length - 0.1) / 0.02) ** 2)
        turned = Rotation.from_rotvec(turn[:, None] * [1.0, 0.0, 0.0]).as_matrix()
        paths += [path, replace(path, rotation=path.rotation @ turned)]
    batches, of = [], RodBatch.of

    def kept(*args, **options):
        batches.append(of(*args, **options))
        return batches[-1]

    monkeypatch.setattr(RodBatch, "of", kept)
    laid = simulate_deployments(
        [Trial(line, rod, path, wrod.Friction(1.0)) for path in paths],
        discretisation=Discretisation(spacing=0.01, step=0.025),
        speed=0.025,
    )
    # The line is laid along x; the batch goes on beyond the grip.
    director = batches[-1].material_directors()[:, :, 0]
    angle = np.unwrap(np.arctan2(director[..., 2], director[..., 1]), axis=1)
    middle = 0.5 * (laid[0].arc_length[1:] + laid[0].arc_length[:-1])
    at = np.array([0.2, 0.3, 0.4])
    for roll, departure, sign in zip(rolls, angle[1::2] - angle[::2], (1.0, -1.0), strict=True):
        left = np.interp(at, middle, departure[: len(middle)])
        growth = wrod.solve_rod_grasps(rod, at, 0.0, held_roll=roll).growth
        expected = 0.5 * (growth[1:] + growth[:-1])
        assert (sign * expected > 2.0).all()
        assert np.diff(np.log(left)) / 0.1 == pytest.approx(expected, rel=0.15)
