"""How long a rod is that was measured under tension, and how it stretches."""

from dataclasses import replace

import numpy as np
import pytest

from wrod.identification.effect import Model, effects
from wrod.identification.motion.fit import MotionLaboratory
from wrod.identification.motion.loading import motion_from_arrays
from wrod.identification.motion.report import identify_motion
from wrod.identification.motion.selection import BASE
from wrod.identification.motion.setup import MotionSetup
from wrod.identification.motion.tension import base_setup
from wrod.identification.motion.windows import _smoothed
from wrod.identification.template import motion_example
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel
from wrod.rods.profile import Profile

PIECES = 4


def cable(gravito_bending_length, slenderness, softer=1.0, curvature=0.0) -> RodModel:
    """One that stretches by so many times as much as a round one; radius over L_gb."""
    radius = slenderness * gravito_bending_length
    rod = RodModel.of(RodMaterial(radius, gravito_bending_length, length=0.36))
    soft = Profile((rod.stretching_stiffness.values[0] / softer,))
    bent = (Profile((curvature,)), Profile((0.0,)))
    return replace(rod, stretching_stiffness=soft, natural_curvature=bent)


@pytest.mark.parametrize("gravito_bending_length", [0.03, 0.05, 0.1])
def test_measured_lengths_are_those_of_the_rod_and_what_its_tension_adds(gravito_bending_length):
    """In motions by the dynamics: what 0.3 m between the grips are longer, to a twentieth."""
    rod = cable(gravito_bending_length, 0.04, softer=20.0 * (gravito_bending_length / 0.05))
    setup = base_setup(motion_from_arrays(motion_example(rod)), PIECES)
    longer = setup.mean_length[1:-1].sum() - 0.3
    setup.stretching = np.full(
        len(setup.mean_length), rod.stretching_stiffness.values[0] / rod.line_mass.values[0]
    )
    setup.bending = setup.bending * (gravito_bending_length / 0.2) ** 3
    assert 5e-4 < longer < 2e-2
    assert setup.mean_length.sum() - setup.rest_length.sum() == pytest.approx(longer, rel=0.05)
    np.testing.assert_array_equal(setup.mean_tension[:, [0, -1]], 0.0)


def test_a_soft_cable_stretches_as_much_as_it_does():
    """100 times as soft in tension as a round one it stretches by 4 % and is damped in that, too:
    without that damping it had seemed twice as stiff."""
    rod = cable(0.05, 0.04, softer=100.0)
    known = effects("motion")
    model = Model(tuple(known[n] for n in (*BASE, "axial_stiffness")))
    laboratory = MotionLaboratory(motion_from_arrays(motion_example(rod, seed=1)), subdivisions=4)
    laboratory.substeps = 2
    true = rod.stretching_stiffness.values[0] / rod.line_mass.values[0]
    values = np.array([np.log(0.25**3), 0.0, 0.02, 0.0])
    # It starts from a cable that stretches as a round one does.
    found, _ = laboratory.fit(laboratory.windows(range(4)), model, values)
    stretching = model.setup(laboratory.base, found).stretching.mean()
    assert stretching == pytest.approx(true, rel=0.06)
    assert found[2] == pytest.approx(0.02, rel=0.05)


@pytest.mark.parametrize("pieces", [1, 4])
@pytest.mark.parametrize("inside", [(0.0, 0.0), (0.008, 0.002), (-0.012, -0.015)])
def test_as_much_bends_at_the_grips_on_every_mesh(inside, pieces):
    """Where a grip reaches out over more than half an edge, edges beyond are rigid, too: half an
    edge less the reach had been a negative stiffness."""
    setup = MotionSetup.base(np.full(6 * pieces + 2, 0.04 / pieces), pieces, 9.81)
    setup.clamp_length = np.array(inside) + 1e-20j
    compliance = setup.bending[0, 0] / setup.arrays()["stiffness"][1:-1, 0]
    bends = compliance @ setup.node_length[1:-1]
    assert (compliance.real > 0.0).all()
    assert bends.real == pytest.approx(0.24 + sum(inside), abs=1e-3)
    assert bends.imag == pytest.approx(2e-20)


@pytest.mark.parametrize(("pace", "left"), [(0.5, 0.4), (60.0, 1.0)])
def test_grips_are_smoothed_by_as_much_as_noise_goes(pace, left):
    """Of a slow grip most noise goes; the path of a fast one stays as it was seen."""
    noise = np.random.default_rng(1).normal(0.0, 5e-5, (300, 4, 3))
    path = 0.1 * np.sin(pace * np.arange(300) / 100.0)[:, None, None] * np.ones((4, 3))
    smooth = _smoothed(path + noise, 5e-5)
    off = np.std(smooth - path) / np.std(noise)
    assert off < left + 1e-9 if left < 1.0 else np.array_equal(smooth, path + noise)
    np.testing.assert_array_equal(_smoothed(path, 0.0), path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gravito_bending_length", "slenderness", "near"),
    [(0.03, 0.06, 0.01), (0.05, 0.04, 0.01), (0.1, 0.02, 0.02)],
)
def test_a_clean_cable_lacks_nothing(gravito_bending_length, slenderness, near):
    """It had ended as hundreds of times as stiff in tension, or, where it is stiff and the noise of
    its grips shakes it, with a drag of 10 1/s, and 4 % stiffer by steps of 10 ms."""
    rod = cable(gravito_bending_length, slenderness)
    content = identify_motion(motion_from_arrays(motion_example(rod, seed=3))).to_dict()
    assert content["verdict"] == "adequate"
    assert content["before_mm"] < 0.15
    base = content["base"]
    assert base["air_damping"]["drag_per_mass"]["value"] < 5.0
    assert base["stiffness"]["L_gb"]["value"] == pytest.approx(gravito_bending_length, rel=near)
