"""Cables held in a hand: read, hung, and explained."""

from pathlib import Path

import numpy as np
import pytest

from wrod.errors import DataError
from wrod.identification.held.equilibria import CableModel, markers
from wrod.identification.held.fit import fit_held
from wrod.identification.held.measurements import (
    HeldCable,
    load_hanging,
    load_held,
    load_poses,
    load_swing,
)

MEASURED = Path(__file__).parents[2] / "shared" / "measured"
ANGLES = np.radians([-120.0, -60.0, -20.0, 20.0, 60.0, 120.0])


def cable(tip=0.05, name="made", **markers_of):
    none = np.zeros((len(ANGLES), 2))
    values = {"mid": none, "end": none} | markers_of
    return HeldCable(name, ANGLES, values["mid"], values["end"], 0.4, 0.02, 0.4, tip, 9.81)


def measured(model_at, tip, noise=0.0, seed=0):
    """A cable whose markers a model says, with noise."""
    one = cable(tip)
    places = markers([(one, float(a), model_at(a)) for a in ANGLES])[0]
    places = places + noise * np.random.default_rng(seed).standard_normal(places.shape)
    return cable(tip, mid=places[:, 0], end=places[:, 1])


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


def test_bad_measurements_are_named(tmp_path):
    good = dict(
        base_angle=ANGLES, mid=np.zeros((6, 2)), end=np.zeros((6, 2)), length=0.4,
        cable_mass=0.4, tip_mass=0.03, diameter=0.02, gravity=9.81,
    )  # fmt: skip
    path = tmp_path / "made-static.npz"
    for changes, says in (
        ({"mid": np.zeros((5, 2))}, "mid is"),
        ({"end": np.full((6, 2), np.nan)}, "end is"),
        ({"length": -1.0}, "length"),
        ({"tip_mass": np.inf}, "tip_mass"),
    ):
        np.savez(path, **(good | changes))
        with pytest.raises(DataError, match=rf"made-static\.npz: {says}"):
            load_held(path)
    np.savez(path, mid=np.zeros(3))
    with pytest.raises(DataError, match="has no base_angle"):
        load_held(path)
    path.write_bytes(b"PK\x03\x04torn")
    for load in (load_held, load_swing, load_hanging, load_poses):
        with pytest.raises(DataError, match="not a readable measurement"):
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
