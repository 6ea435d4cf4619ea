"""Cables held in a hand: read, hung, and explained."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wrod.errors import DataError
from wrod.identification.held.equilibria import CableModel, markers
from wrod.identification.held.fit import fit_held
from wrod.identification.held.loops import LoopModel, TwistedLoops, critical_twist, fit_loops
from wrod.identification.held.measurements import (
    HangingLoops,
    HeldCable,
    HeldPoses,
    load_hanging,
    load_held,
    load_poses,
    load_swing,
)
from wrod.identification.held.poses import pose_shapes, rigid_rms

MEASURED = Path(__file__).parents[2] / "shared" / "measured"
ANGLES = np.radians([-120.0, -60.0, -20.0, 20.0, 60.0, 120.0])


def cable(tip=0.05, name="made", angles=ANGLES, **markers_of):
    none = np.zeros((len(angles), 2))
    values = {"mid": none, "end": none} | markers_of
    return HeldCable(name, angles, values["mid"], values["end"], 0.4, 0.02, 0.4, tip, 9.81)


def measured(model_at, tip, noise=0.0, seed=0, angles=ANGLES):
    """A cable whose markers a model says, with noise."""
    one = cable(tip)
    places = markers([(one, float(a), model_at(a)) for a in angles])[0]
    places = places + noise * np.random.default_rng(seed).standard_normal(places.shape)
    return cable(tip, angles=angles, mid=places[:, 0], end=places[:, 1])


def test_a_stiff_cable_droops_as_a_beam():
    # Clamped level (Gamma = 90 degrees): w L^4 / 8 B + P L^3 / 3 B at the end,
    # w x^2 (6 L^2 - 4 L x + x^2) / 24 B + P x^2 (3 L - x) / 6 B in the middle.
    one, stiffness = cable(tip=0.05), 400.0
    (found,), good = markers([(one, np.pi / 2.0, CableModel(stiffness))])
    load, tip, length = 9.81, 0.05 * 9.81, 0.4
    end = load * length**4 / 8.0 + tip * length**3 / 3.0
    x = 0.5 * length
    mid = load * x**2 * (6 * length**2 - 4 * length * x + x**2) / 24.0
    mid += tip * x**2 * (3 * length - x) / 6.0
    assert good.all()
    # Second order in the edge of L / 30.
    assert found[:, 0] == pytest.approx(np.array([mid, end]) / stiffness, rel=4e-3)


def test_a_cable_bent_at_rest_is_an_arc_without_weight():
    weightless = HeldCable("arc", ANGLES[:1], *[np.zeros((1, 2))] * 2, 0.4, 0.02, 1e-9, 0.0, 9.81)
    ((mid, end),), _ = markers([(weightless, 0.0, CableModel(1.0, curvature=2.0))])
    for place, s in ((mid, 0.2), (end, 0.4)):
        arc = [(1.0 - np.cos(2.0 * s)) / 2.0, -np.sin(2.0 * s) / 2.0]
        assert place == pytest.approx(arc, abs=3e-4)


def test_stiffness_bend_and_lag_are_found():
    def model(angle):
        return CableModel(0.11, -1.5 - 0.5 * np.sign(angle))

    sets = [measured(model, tip, 5e-4, seed) for seed, tip in enumerate((0.03, 0.23))]
    fit = fit_held(sets, ("curvature", "lag"))
    said = dict(zip(fit.names, fit.values, strict=True))
    assert np.exp(said["stiffness"]) == pytest.approx(0.11, rel=0.02)
    for k in range(2):
        assert said[f"curvature {k}"] == pytest.approx(-1.5, abs=0.05)
        assert said[f"lag {k}"] == pytest.approx(0.5, abs=0.05)
    assert not fit.snapped.any()
    assert fit.noise == pytest.approx(5e-4, rel=0.35)
    straight = fit_held(sets, ())
    assert straight.noise > 10.0 * fit.noise


def test_a_cable_that_yields_is_found_and_the_lag_is_its_print():
    """A constant lag is all that friction leaves of it once it has slipped."""
    truth = CableModel(0.11, -1.5, friction=0.6, kept=0.3)
    few = ANGLES[[0, 2, 3, 5]]
    sets = [
        measured(lambda _: truth, tip, 5e-4, seed, few) for seed, tip in enumerate((0.03, 0.23))
    ]
    fit = fit_held(sets, ("curvature", "yielding"))
    said = dict(zip(fit.names, fit.values, strict=True))
    error = dict(zip(fit.names, np.sqrt(np.diag(fit.covariance)), strict=True))
    wanted = {"stiffness": np.log(0.11), "curvature 0": -1.5, "curvature 1": -1.5}
    for name, value in (wanted | {"friction": 0.6, "kept": np.log(0.3)}).items():
        assert abs(said[name] - value) < 3.0 * error[name], name
    assert error["friction"] < 0.1 and error["curvature 0"] < 0.1
    assert fit.noise == pytest.approx(5e-4, rel=0.35)
    lags = fit_held(sets, ("curvature", "lag"))
    assert lags.noise > 2.0 * fit.noise
    assert dict(zip(lags.names, lags.values, strict=True))["lag 0"] > 0.2


def test_bad_measurements_are_named(tmp_path):
    good = dict(
        base_angle=ANGLES, mid=np.zeros((6, 2)), end=np.zeros((6, 2)), length=0.4,
        cable_mass=0.4, tip_mass=0.03, diameter=0.02, gravity=9.81,
    )  # fmt: skip
    path = tmp_path / "made-static.npz"
    for changes, says in (
        ({"mid": np.zeros((5, 2))}, r"mid has shape \(5, 2\)"),
        ({"end": np.full((6, 2), np.nan)}, "end of angle 0 is nan"),
        ({"length": -1.0}, "length"),
        ({"tip_mass": np.inf}, "tip_mass"),
    ):
        np.savez(path, **(good | changes))
        with pytest.raises(DataError, match=rf"made-static\.npz: {says}"):
            load_held(path)
    np.savez(path, mid=np.zeros(3))
    with pytest.raises(DataError, match="lacks the array base_angle"):
        load_held(path)
    path.write_bytes(b"PK\x03\x04torn")
    for load in (load_held, load_swing, load_hanging, load_poses):
        with pytest.raises(DataError, match="is not readable"):
            load(path)
    with pytest.raises(DataError, match="unknown effect 'wind'"):
        fit_held([cable()], ("wind",))
    with pytest.raises(DataError, match="no set"):
        fit_held([])


@pytest.mark.skipif(not MEASURED.exists(), reason="needs ../shared/measured")
def test_reads_all_cables():
    for path in sorted((MEASURED / "hanging").glob("*-hanging*.npz")):
        loops = load_hanging(path)
        assert loops.shape.shape[1:] == (len(loops.arc_length), 2)
        assert loops.length == 1.5
    poses = load_poses(MEASURED / "hanging" / "poses-3d.npz")
    assert poses.shape.shape == (3, 2, 11, 3) and poses.cables == ("black", "red", "white")
    for path in sorted((MEASURED / "swing").glob("*-static.npz")):
        assert load_held(path).markers.shape == (12, 2, 2)
    for path in sorted((MEASURED / "swing").glob("*-swing.npz")):
        assert len(load_swing(path).time) == len(load_swing(path).cable.angle)


def ring(length=1.0, gravity=1e-6):
    s = np.linspace(0.0, length, 60)
    turn = 2.0 * np.pi * s / length
    radius = length / (2.0 * np.pi)
    shape = radius * np.column_stack([np.sin(turn), np.cos(turn) - 1.0])
    return HangingLoops("ring", shape[None], s, length, 0.02, gravity)


def test_a_twisted_ring_buckles_at_michells_angle():
    """A closed ring without weight leaves its plane at a twist of 2 pi sqrt(3) B / C."""
    ratios = np.array([1.0, 1.5])
    models = [LoopModel(1e-3, twist_ratio=r) for r in ratios]
    angle, shape = critical_twist(ring(), models, step=np.radians(5.0), most=4.0 * np.pi)
    assert angle == pytest.approx(2.0 * np.pi * np.sqrt(3.0) / ratios, rel=0.02)
    assert np.abs(shape[:, :, 1]).max() < 5e-3


def test_a_loops_stiffness_is_found_from_its_shape():
    true = LoopModel(4e-4, right=-0.2, left=-0.3)
    loops = ring(1.5, 9.81)
    # Straight sides: any shape to begin with, of the right length.
    hung = TwistedLoops(loops, [true] * 3, [[-0.12, 0.0], [-0.125, 0.002], [-0.118, 0.0]])
    assert hung.solve().converged.all()
    seen = hung.at(loops.arc_length)[..., [0, 2]]
    rng = np.random.default_rng(1)
    seen = seen + 3e-4 * rng.standard_normal(seen.shape) * (np.arange(60) % 59 != 0)[:, None]
    found = fit_loops(replace(loops, shape=seen))
    assert found.model.stiffness == pytest.approx(4e-4, rel=0.05)
    assert [found.model.right, found.model.left] == pytest.approx([-0.2, -0.3], abs=0.03)
    assert found.rms == pytest.approx(np.sqrt(2.0) * 3e-4, rel=0.3)
    level = fit_loops(replace(loops, shape=seen), ())
    assert level.rms > 2.0 * found.rms
    with pytest.raises(DataError, match="unknown effect 'bend'"):
        fit_loops(loops, ("bend",))
    with pytest.raises(DataError, match="no mounting"):
        fit_loops(loops, use=np.zeros(1, dtype=bool))


def test_a_cable_between_hand_and_table_ends_where_the_arm_went():
    """The gripper's pose, and the twist of a straight cable that is only turned about itself."""
    still = HeldPoses(
        ("one",), np.zeros((1, 2, 3, 3)), np.array([0.0, 0.2, 0.4]), 0.4, np.array([1e-6]),
        np.array([[0.0, 0.0, 0.0], [0.1, -0.05, 0.05]]),
        np.array([[0.0, 0.0, 0.0], [0.0, 0.3, 0.2]]), np.array([1.0, 0.5]),
    )  # fmt: skip
    places, good = pose_shapes(still, [(0, 0, 1e-3, 0.7, 1.0), (0, 1, 1e-3, 0.7, -1.0)])
    assert good.all()
    # Far below the twist at which it would buckle a straight cable stays straight.
    assert places[0, :, 1:] == pytest.approx(np.zeros((3, 2)), abs=1e-6)
    assert places[1, -1] == pytest.approx([0.1, -0.05, 0.05], abs=2e-4)
    assert places[1, 0] == pytest.approx([0.4, 0.0, 0.0], abs=2e-4)
    turned = places[1] @ Rotation.from_rotvec([0.3, 0.2, -0.1]).as_matrix().T + 0.3
    assert rigid_rms(turned, places[1]) < 1e-9
