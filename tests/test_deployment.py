"""Deployments in simulation, on short rods that take a second each."""

from dataclasses import replace

import numpy as np
import pytest

import wrod
from wrod.deployment.assembly import assemble
from wrod.deployment.grip_path import smooth_noise
from wrod.deployment.result import Deployment, deployment_error
from wrod.deployment.setup import mesh
from wrod.deployment.simulate import prepare_trials, simulate_deployments
from wrod.deployment.tangents import Directions, lay
from wrod.deployment.trial import Trial
from wrod.errors import DataError, PatternError, RodError
from wrod.planning.pace import from_rest_to_rest
from wrod.planning.tail import tail

# A soft rod of 30 cm along an eased quarter turn: short tails and a coarse mesh keep it quick.
ROD = wrod.RodMaterial(0.0016, 0.018, 0.30)
QUICK = dict(discretisation=wrod.Discretisation(0.006, 0.02), speed=0.03, threads=1)


def quarter_turn():
    from scipy.interpolate import PPoly

    from wrod.patterns.shapes import straight, strokes, turn

    heading, origin = strokes(0.0, straight(0.06), turn(90.0, 0.05, 0.06), straight(0.03))
    assert isinstance(heading, PPoly)
    return wrod.Pattern(heading, origin, name="quarter turn")


@pytest.fixture(scope="module")
def plans():
    pattern = quarter_turn()
    return pattern, {m: wrod.plan(pattern, ROD, m, device="cpu") for m in ("numeric", "intuitive")}


@pytest.fixture(scope="module")
def laid(plans):
    """Both methods on good friction, and the optimal one without any."""
    pattern, by_method = plans
    jobs = [
        Trial(pattern, ROD, by_method["numeric"], wrod.Friction(0.8)),
        Trial(pattern, ROD, by_method["intuitive"], wrod.Friction(0.8)),
        Trial(pattern, ROD, by_method["numeric"], wrod.Friction(0.0)),
    ]
    return pattern, jobs, simulate_deployments(jobs, frame_interval=0.5, **QUICK)


def test_optimal_plan_lays_the_pattern_and_the_intuitive_one_does_not(laid):
    _, _, (optimal, intuitive, slippery) = laid
    assert not any(d.diverged for d in (optimal, intuitive, slippery))
    assert optimal.error_mean < 1e-3
    assert intuitive.error_mean > 5 * optimal.error_mean
    # A bend needs friction: with none, the free end straightens out.
    assert slippery.error_mean > 5 * optimal.error_mean


def test_laid_rod_rests_on_the_table(laid):
    pattern, _, deployments = laid
    for deployment in deployments[:2]:
        on_table = deployment.arc_length < 0.5 * pattern.length
        z = deployment.centerline[on_table, 2]
        assert -0.05 * ROD.radius < z.min()
        assert np.abs(z).max() < 0.05 * ROD.radius
        # Let go, all of it rests; friction keeps a little of the stretch that it hung with, the
        # more as its damping keeps it until it lands.
        assert np.abs(deployment.released_centerline[:, 2]).max() < 0.05 * ROD.radius
        edges = np.linalg.norm(np.diff(deployment.released_centerline, axis=0), axis=1)
        assert ROD.length < edges.sum() < 1.0015 * ROD.length


def test_contact_force_obeys_friction(laid):
    _, jobs, deployments = laid
    for job, deployment in zip(jobs, deployments, strict=True):
        normal = deployment.contact_force[:, 2]
        tangential = np.hypot(*deployment.contact_force[:, :2].T)
        assert normal.min() >= 0.0
        assert (tangential <= job.friction.static * normal + 1e-12).all()
        assert normal.sum() > 0.3 * ROD.weight * ROD.length


def test_frames_show_the_deployment(laid):
    _, _, (deployment, *_) = laid
    frames = deployment.frames
    assert len(frames) == int(deployment.duration / 0.5) + 1
    assert frames[0, -1, 2] > 0.8 * (ROD.length - 0.05)
    lengths = np.linalg.norm(np.diff(frames, axis=1), axis=2).sum(axis=1)
    # Hanging, it is stretched by its own weight: 1.6 % at the grip when all of it hangs.
    assert (lengths > 0.999 * ROD.length).all()
    assert (lengths < 1.008 * ROD.length).all()
    assert lengths[-1] == pytest.approx(ROD.length, rel=1e-3)
    # The held stretch stands still until the deployment begins, a second after the start.
    assert np.abs(frames[2, 0] - frames[0, 0]).max() < 1e-12


def test_batch_and_single_rod_agree(laid):
    pattern, jobs, deployments = laid
    job = jobs[0]
    alone = wrod.simulate_deployment(pattern, ROD, job.trajectory, job.friction, **QUICK)
    assert np.abs(alone.centerline - deployments[0].centerline).max() < 1e-6
    assert alone.error_mean == pytest.approx(deployments[0].error_mean, abs=1e-7)


def test_rod_that_diverges_is_cut_out_and_the_others_do_not_notice(plans):
    """A grip that shakes by 1 km: its rod is flagged, with its last good state, and its
    neighbours in the batch are laid as if it was not there, bit for bit."""
    pattern, by_method = plans
    calm = Trial(pattern, ROD, by_method["numeric"], wrod.Friction(0.8))
    shaken = replace(calm, disturbance=wrod.Disturbance(jitter=1e3))
    other = replace(calm, friction=wrod.Friction(0.3), disturbance=wrod.Disturbance.random(3))
    options = {**QUICK, "discretisation": wrod.Discretisation(step=0.02, node_count=47)}
    alone = simulate_deployments([calm, other], **options)
    first, lost, last = simulate_deployments([calm, shaken, other], **options)
    assert lost.diverged and not (first.diverged or last.diverged)
    assert 0.0 < lost.duration < first.duration
    assert np.isfinite(lost.centerline).all() and np.isfinite(lost.error_mean)
    for one, two in zip(alone, (first, last), strict=True):
        assert (one.centerline == two.centerline).all()
        assert (one.contact_force == two.contact_force).all()
        assert one.steps == two.steps


def test_without_friction_the_intuitive_line_fails_and_friction_mends_it():
    """Straight above the contact the grip leaves the rod slack, which pushes what is laid back
    along the line: without friction nothing holds it, and the more friction, the less it slides.
    The optimal grip does not push."""
    line = wrod.Pattern.from_points(np.linspace([0.0, 0.0], [0.15, 0.0], 16), name="line")
    by_method = {m: wrod.plan(line, ROD, m, device="cpu") for m in ("intuitive", "numeric")}
    shaken = wrod.Disturbance(jitter=3e-4, seed=1)
    frictions = (0.0, 0.1, 0.4)
    jobs = [
        Trial(line, ROD, trajectory, wrod.Friction(mu), shaken)
        for trajectory in by_method.values()
        for mu in frictions
    ]
    errors = [d.error_mean for d in simulate_deployments(jobs, **QUICK)]
    intuitive, optimal = errors[:3], errors[3:]
    assert intuitive[0] > 5e-3
    assert intuitive[0] > intuitive[1] > intuitive[2]
    assert all(a > b for a, b in zip(intuitive, optimal, strict=True))
    assert intuitive[0] > 10 * optimal[0]
    assert optimal[2] < 2e-4


def test_free_end_is_let_go_where_it_is_told(plans):
    """Held longer, the free end stands still for longer."""
    pattern, by_method = plans
    jobs = [Trial(pattern, ROD, by_method["numeric"], wrod.Friction(0.1))]
    still = []
    for release in (0.05, 0.10):
        options = {**QUICK, "release": release, "frame_interval": 0.2}
        (laid,) = simulate_deployments(jobs, **options)
        moved = np.linalg.norm(laid.frames[:, 0] - laid.frames[0, 0], axis=1)
        still.append(int(np.argmax(moved > 1e-9)))
    assert still[1] > still[0] + 3


def test_disturbances_move_what_they_name(plans):
    """A robot that is placed wrongly lays the same shape elsewhere; seeds give different trials."""
    pattern, by_method = plans
    shifted = wrod.Disturbance(offset=(3e-3, -2e-3))
    jobs = [
        Trial(pattern, ROD, by_method["numeric"], wrod.Friction(0.8), disturbance)
        for disturbance in (
            wrod.Disturbance(),
            shifted,
            wrod.Disturbance.random(1),
            wrod.Disturbance.random(2),
        )
    ]
    ideal, moved, one, two = simulate_deployments(jobs, **QUICK)
    gap = moved.centerline - ideal.centerline
    assert np.abs(gap - [3e-3, -2e-3, 0.0]).max() < 1e-6
    assert moved.error_mean == pytest.approx(np.hypot(3e-3, 2e-3), rel=0.1)
    assert np.abs(one.centerline - two.centerline).max() > 1e-4
    assert wrod.Disturbance.random(1) == wrod.Disturbance.random(1)


def test_error_metric():
    """Eq. metric of a rod beside the pattern: its distance, without scatter."""
    pattern = wrod.pattern("line")
    s = np.linspace(0.0, 0.6, 61)
    beside = np.column_stack([s, np.full(61, 0.004), np.full(61, 0.1)])
    mean, std = deployment_error(pattern, s, beside)
    assert mean == pytest.approx(0.004)
    assert std == pytest.approx(0.0, abs=1e-12)
    skew = np.column_stack([s, 0.01 * s, 0 * s])
    mean, std = deployment_error(pattern, s, skew)
    assert mean == pytest.approx(0.01 * 0.25, rel=1e-6)
    assert std == pytest.approx(0.01 * np.linspace(0, 0.5, 50).std(), rel=1e-6)


def test_deployment_is_saved_and_read(laid, tmp_path):
    _, _, (deployment, *_) = laid
    path = deployment.save(tmp_path / "laid")
    again = Deployment.load(path)
    assert (again.centerline == deployment.centerline).all()
    assert again.error_mean == deployment.error_mean
    assert again.frames.shape == deployment.frames.shape
    (tmp_path / "broken.npz").write_bytes(path.read_bytes()[:200])
    for name in ("broken.npz", "missing.npz"):
        with pytest.raises(DataError, match=name):
            Deployment.load(tmp_path / name)


def test_mesh_is_fine_where_the_rod_is_laid():
    s = mesh(ROD, 0.15, 0.005)
    edges = np.diff(s)
    assert s[-1] == pytest.approx(ROD.length)
    assert edges[s[1:] < 0.15].max() <= 0.005 + 1e-12
    assert edges[-1] == pytest.approx(3 * edges[0])
    assert len(mesh(ROD, 0.10, 0.005, 60)) == 60


def test_tail_goes_on_from_the_last_pose(plans):
    pattern, by_method = plans
    for trajectory in by_method.values():
        after = tail(pattern, ROD, trajectory)
        assert (after.position[0] == trajectory.position[-1]).all()
        steps = np.linalg.norm(np.diff(after.position, axis=0), axis=1)
        assert steps.max() < 0.03
        assert after.position[-1, 2] < 2.0 * ROD.gravito_bending_length


def test_tail_is_laid_as_planned_whatever_rod_is_laid(plans):
    pattern, by_method = plans
    path = by_method["numeric"]
    planned = tail(pattern, ROD, path)
    softer = tail(
        pattern, replace(ROD, gravito_bending_length=1.2 * ROD.gravito_bending_length), path
    )
    assert np.array_equal(softer.laid, planned.laid)
    assert np.array_equal(softer.position, planned.position)
    longer = tail(pattern, replace(ROD, length=ROD.length + 0.05), path)
    assert longer.laid[-1] == pytest.approx(planned.laid[-1] + 0.05)


def test_a_rod_brings_its_drag(plans):
    pattern, by_method = plans
    path, drag = by_method["numeric"], 3.0
    airy = replace(wrod.RodModel.of(ROD), quadratic_drag=drag)
    trials = [Trial(pattern, rod, path, wrod.Friction(0.8)) for rod in (airy, ROD)]
    setups = prepare_trials(trials, 0.05, 0.05, 0.03, wrod.Discretisation(0.02))
    dynamics = assemble(trials, setups)[2]
    mass = ROD.weight / ROD.gravity * ROD.length
    assert dynamics.drag.numpy().sum(axis=1) == pytest.approx(np.array([[0, drag * mass], [0, 0]]))
    with pytest.raises(RodError, match="quadratic_drag"):
        lay(trials[:1], [Directions.of_path(np.zeros((1, len(path), 6)))])


def test_time_law_is_smooth_and_exact():
    covered = from_rest_to_rest(0.5, 0.05)
    t = np.linspace(0.0, covered.x[-1], 2001)
    s = covered(t)
    assert s[0] == 0.0
    assert s[-1] == pytest.approx(0.5, rel=1e-12)
    speed = np.diff(s) / np.diff(t)
    assert speed.min() > -1e-12
    assert speed.max() == pytest.approx(0.05, rel=1e-6)
    assert np.abs(np.diff(speed)).max() < 0.05 * 0.03
    noise = smooth_noise(np.random.default_rng(0), 20000, 1e-3, 2.5)
    assert noise.std() == pytest.approx(1e-3, rel=0.05)


def test_bad_input_is_refused(plans):
    pattern, by_method = plans
    trajectory = by_method["numeric"]
    with pytest.raises(PatternError, match="held"):
        wrod.simulate_deployment(pattern, ROD, trajectory, hold=0.5)
    with pytest.raises(RodError, match="speed"):
        wrod.simulate_deployment(pattern, ROD, trajectory, speed=-1.0)
    with pytest.raises(RodError, match=r"moves 0\.1 m in a step"):
        wrod.simulate_deployment(pattern, ROD, trajectory, speed=10.0)
    with pytest.raises(RodError, match=r"spacing is 0\.06 m"):
        wrod.simulate_deployment(pattern, ROD, trajectory, discretisation=wrod.Discretisation(0.06))
    with pytest.raises(RodError, match="friction"):
        wrod.simulate_deployment(pattern, ROD, trajectory, friction=-0.1)
    for mistaken in ({"lgb_error": 15.0}, {"yaw": 20.0}):  # per cent, degrees
        with pytest.raises(RodError, match=f"Disturbance: {next(iter(mistaken))} is "):
            wrod.Disturbance(**mistaken)
    with pytest.raises(RodError, match="scheme"):
        wrod.simulate_deployment(
            pattern, ROD, trajectory, discretisation=wrod.Discretisation(scheme="magic")
        )
    assert simulate_deployments([]) == []


def test_a_disturbance_moves_the_robot_as_a_whole(plans):
    """Trials of one plan share a setup; yaw and offset are one motion of rod and grip."""
    from scipy.spatial.transform import Rotation

    from wrod.deployment.setup import Disturbance
    from wrod.deployment.simulate import prepare_trials

    pattern, by_method = plans
    disturbance = Disturbance(offset=(0.002, -0.003), yaw=0.05)
    shaken = Disturbance(jitter=0.001, offset=(0.002, -0.003), yaw=0.05, seed=3)
    plan = pattern, ROD, by_method["numeric"], wrod.Friction(0.5)
    rest = tail(pattern, ROD, by_method["numeric"])
    setups = prepare_trials(
        [Trial(*plan, d, rest) for d in (Disturbance(), disturbance, shaken)],
        *(0.05, 0.1, 0.03, wrod.Discretisation(0.006)),
    )
    still, moved, shaking = setups
    turn = Rotation.from_euler("z", 0.05)
    corner = pattern.sample(0.0)[0][0] * [1.0, 1.0, 0.0]
    for before, after in (
        (still.position, moved.position),
        (still.schedule.position, moved.schedule.position),
    ):
        expected = turn.apply(before - corner) + corner + [0.002, -0.003, 0.0]
        assert np.abs(after - expected).max() < 1e-12
    turned = turn * Rotation.from_quat(still.schedule.rotation)
    assert (turned.inv() * Rotation.from_quat(moved.schedule.rotation)).magnitude().max() < 1e-9
    assert np.abs(moved.director - turn.apply(still.director)).max() < 1e-12
    jitter = shaking.schedule.position - moved.schedule.position
    assert (jitter[0] == 0).all() and 0.0005 < jitter[len(jitter) // 4 :].std() < 0.002
    assert (shaking.position == moved.position).all()
    assert still.measure_time == moved.measure_time == shaking.measure_time


def test_rods_that_remember_are_laid(plans):
    """A wire that never yields is laid like an elastic rod; one that yields on the way is not, and
    what relaxes faster than it is laid nearly is."""
    from wrod.rods.law import Plastic, StandardLinearSolid

    pattern, by_method = plans
    laws = [Plastic(1e4, 0.1), Plastic(10.0, 0.0), StandardLinearSolid(0.5, 0.3)]
    # What stays bent has sides, and friction holds its roll. So it does of this elastic rod.
    rod = replace(wrod.RodModel.of(ROD), natural_curvature=(1e-9, 0.0))
    rods = [rod, *(replace(rod, law=law) for law in laws)]
    jobs = [Trial(pattern, rod, by_method["numeric"], wrod.Friction(0.8)) for rod in rods]
    elastic, stiff, soft, relaxing = simulate_deployments(jobs, **QUICK)
    assert not any(d.diverged for d in (elastic, stiff, soft, relaxing))
    assert stiff.error_mean == pytest.approx(elastic.error_mean, rel=1e-3)
    assert np.linalg.norm(soft.centerline - elastic.centerline, axis=1).mean() > 1e-3
    assert relaxing.error_mean < 3 * elastic.error_mean


def test_a_table_whose_friction_varies_is_laid_on(plans):
    """Half of the friction everywhere is half the coefficient; half of the table is in between."""
    pattern, by_method = plans
    table = (-0.1, 0.3), (-0.2, 0.2)
    half = wrod.FrictionField(np.full((2, 2), 0.5), *table)
    ahead = wrod.FrictionField.of(lambda x, y: np.where(x > 0.09, 0.5, 1.0), *table)

    def lay(mu, field):
        trial = Trial(pattern, ROD, by_method["numeric"], wrod.Friction(mu))
        (laid,) = simulate_deployments([trial], friction_field=field, **QUICK)
        return laid

    believed, weak, halved, mixed = lay(0.4, None), lay(0.2, None), lay(0.4, half), lay(0.4, ahead)
    np.testing.assert_allclose(halved.centerline, weak.centerline, atol=1e-9)
    assert believed.slip.sum() < mixed.slip.sum() < weak.slip.sum()


def test_trajectories_of_another_pattern_or_rod_are_refused():
    line, rod = wrod.pattern("line"), wrod.rod("green-vps")
    path = wrod.plan(line, rod, "intuitive", spacing=0.02)
    longer = replace(rod, length=0.95)
    coarse = dict(speed=0.5, discretisation=wrod.Discretisation(0.05, 0.05))
    with pytest.raises(PatternError, match="is of line"):
        wrod.simulate_deployment(wrod.pattern("letter-U"), rod, path, **coarse)
    with pytest.raises(RodError, match="whose length is"):
        wrod.simulate_deployment(line, longer, path, **coarse)
    meant = wrod.Trial(line, longer, path, wrod.Friction(0.6), another_rod=True)
    (laid,) = wrod.simulate_deployments([meant], **coarse)
    assert laid.arc_length[-1] == pytest.approx(0.95)
