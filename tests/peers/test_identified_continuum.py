"""Identification on rods that a solver of the continuum made, not wrod."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wrod.bench.continuous_rod import Experiment, measured, world_of
from wrod.identification import Effect, Parameter, identify
from wrod.identification.clamped.equilibria import ClampedSolver
from wrod.identification.clamped.loading import measurements_from_arrays
from wrod.identification.clamped.setup import ClampedSetup
from wrod.identification.template import labels
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel
from wrod.rods.profile import Profile

ROD = RodMaterial(0.0018, 0.06, 0.5, density=1500.0)
B = ROD.bending_stiffness
STEPS = 3  # in which a small effect grows: rods follow


def around(s, place, width):
    """(K,) a bump of area 1."""
    return np.exp(-0.5 * ((s - place) / width) ** 2) / (width * np.sqrt(2 * np.pi))


def hanging(rod, *, trials=12, markers=31, seed=0):
    """Fields of a measured file but for what is measured: a rod that hangs in skew arcs."""
    rng = np.random.default_rng(seed)
    level = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])

    def turned(size):
        return Rotation.from_rotvec(rng.uniform(-1, 1, (trials, 3)) * size).as_matrix()

    clamp = level @ turned([0.35, 0.35, np.pi])
    across = rng.uniform(-0.1, 0.1, (trials, 3)) + [0.75, 0.0, 0.0]
    test = trials // 3
    return {
        "arc_length": np.linspace(0.0, rod.length, markers),
        "clamp_position": np.tile([0.3, -0.2, 0.5], (trials, 1)),
        "clamp_rotation": clamp,
        "grip_position": np.array([0.3, -0.2, 0.5]) + rod.length * across,
        "grip_rotation": clamp @ turned([0.5, 0.5, 0.6]),
        "train_idx": np.arange(trials - test),
        "test_idx": np.arange(trials - test, trials),
        **labels(rod),
        "noise_std": 5e-4,
    }


def made(experiment, seed=0, trials=12, steps=STEPS):
    hung = hanging(ROD, seed=seed, trials=trials)
    return measurements_from_arrays(measured(hung, experiment, steps=steps))


class Thread(Effect):
    """Our own invention: a thread tied to the rod pulls at one place, the same way always."""

    name = "thread"
    title = "a thread that pulls sideways"
    reference = "dead force at arc length s"
    parameters = (
        Parameter("pull", "N", 0.05),
        Parameter("arc_length", "m", 1.0, lower=0.0, anywhere=True),
    )

    def starts(self, measurements):
        return [np.array([1e-4, f * measurements.material.length]) for f in (0.2, 0.5, 0.8)]

    def apply(self, setup, values):
        share = setup.weights_at(values[1])
        setup.force = setup.force + values[0] * share[:, None] * np.array([0.0, 1.0, 0.0])


def relative(a, b) -> float:
    return np.abs(a - b).max() / np.abs(b).max()


@pytest.mark.parametrize("bent", [False, True])
def test_predictions_are_of_second_order(bent):
    """Markers, frames and the gripper's wrench of a rod that tapers, straight or bent at rest."""
    tapering, seen = Profile([1.3 * B, 0.7 * B], [0.0, ROD.length]), {}
    rod = replace(RodModel.of(ROD), bending_stiffness=(tapering, tapering))
    if bent:
        rod = replace(rod, natural_curvature=(2.0, 1.0), natural_twist=3.0)

    def see(position, frame):
        seen["frame"] = frame
        return position

    quiet = measured(
        hanging(ROD, trials=3), replace(world_of(rod, ROD), see=see), noise=0.0,
        wrench_noise=False, steps=1,
    )  # fmt: skip
    measurements = measurements_from_arrays(quiet)

    def errors(edges):
        straight = ClampedSetup.base(measurements, np.arange(3), edges)
        solver = ClampedSolver([straight])
        setup = replace(
            straight,
            bending=np.repeat(tapering(straight.arc_length)[:, None], 2, axis=1),
            natural_curvature=np.tile([2.0 * bent, 1.0 * bent], (edges + 1, 1)),
            natural_twist=np.full(edges + 1, 3.0 * bent),
        )
        assert solver.solve([setup]).all()
        found = solver.predict([setup])
        frames = found.frames[0]().real
        clamped = frames[:, 0] - measurements.clamp_rotation
        assert np.abs(clamped).max() < 1e-12
        return np.array([
            np.abs(found.position[0].real - quiet["centerline"]).max() / ROD.length,
            np.abs(frames - seen["frame"]).max(),
            relative(found.force[0].real, quiet["grip_force"]),
            relative(found.torque[0].real, quiet["grip_torque"]),
        ])  # fmt: skip

    coarse, fine = errors(80), errors(160)
    assert (np.log2(coarse / fine) > 1.6).all()
    assert (fine < [1e-4, 4e-3, 1e-3, 4e-3]).all()


@pytest.mark.usefixtures("on_coarse_meshes")
def test_an_effect_of_our_own_invention_is_found():
    pull = Experiment(force=lambda s: np.array([[0.0], [0.02], [0.0]]) * around(s, 0.31, 0.004))
    report = identify(
        made(pull, trials=6, steps=1), candidates=[Thread(), "natural_curvature", "gravity_tilt"]
    )
    assert report.verdict == "explained"
    assert [e.name for e in report.effects] == ["thread"]
    found = report.effects[0].parameters
    assert found["pull"].value == pytest.approx(0.02, rel=0.05)
    assert found["arc_length"].value == pytest.approx(0.31, rel=0.05)
    assert report.after < 1.1 * report.noise_floor < report.before


@pytest.mark.slow
def test_a_rod_without_an_effect_is_adequate_against_every_candidate():
    report = identify(made(Experiment(), seed=1))
    assert report.verdict == "adequate"
    assert report.effects == ()


@pytest.mark.slow
def test_a_pair_is_found_among_every_candidate():
    """One by one, other effects look better than either of the two."""
    experiment = Experiment(
        gravity_turn=np.radians(2.0) * np.array([0.3, -0.95, 0.0]),
        mass=lambda s: 0.0012 * around(s, 0.2, 0.004)[None],
    )
    report = identify(made(experiment, seed=2))
    assert report.verdict == "explained"
    found = {e.name: e.parameters for e in report.effects}
    assert set(found) == {"gravity_tilt", "point_mass"}
    assert found["point_mass"]["mass"].value == pytest.approx(0.0012, rel=0.05)
    assert found["gravity_tilt"]["tilt"].value == pytest.approx(2.0, rel=0.05)


@pytest.mark.slow
def test_a_kink_is_built_from_its_print():
    bend = Experiment(curvature=lambda s: np.array([[0.6], [0.4]]) * around(s, 0.22, 0.008))
    report = identify(made(bend, seed=3))
    assert report.verdict == "explained" and [e.name for e in report.effects] == ["local_bend"]
    found = report.effects[0].parameters
    assert found["angle_1"].value == pytest.approx(0.6, rel=0.05)
    assert found["angle_2"].value == pytest.approx(0.4, rel=0.05)
    assert found["arc_length"].value == pytest.approx(0.22, abs=0.002)
    assert found["width"].value == pytest.approx(0.008, rel=0.2)


@pytest.mark.slow
def test_a_draught_on_half_the_rod_is_built_from_its_print():
    def force(s):
        return np.array([[0.03], [0.04], [0.0]]) / (1 + np.exp((0.25 - s) / 0.01))

    report = identify(made(Experiment(force=force), seed=3))
    assert report.verdict == "explained" and [e.name for e in report.effects] == ["local_load"]
    found = report.effects[0].parameters
    said = [found[name].value for name in ("force_x", "force_y", "force_z")]
    np.testing.assert_allclose(said, [0.03, 0.04, 0.0], atol=0.0025)
    assert found["start"].value == pytest.approx(0.25, abs=0.005)


@pytest.mark.slow
def test_what_no_effect_covers_is_not_called_explained():
    """A roll that sticks in the gripper, another in each trial."""
    turns = np.outer(np.random.default_rng(3).normal(size=12), [0.0, 0.0, 0.7])
    report = identify(made(Experiment(grip_turn=turns), seed=3))
    assert report.verdict in ("unexplained", "partly-explained")
    assert report.prints[0].evidence > 0.0
