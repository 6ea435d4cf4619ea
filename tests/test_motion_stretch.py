"""How long a rod is that was measured under tension, and how it stretches."""

from dataclasses import replace

import numpy as np
import pytest

from wrod.identification.motion.loading import motion_from_arrays
from wrod.identification.motion.report import identify_motion
from wrod.identification.motion.setup import MotionSetup
from wrod.identification.motion.tension import base_setup
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


@pytest.mark.slow
@pytest.mark.parametrize(("gravito_bending_length", "slenderness"), [(0.03, 0.06), (0.05, 0.04)])
def test_a_clean_cable_lacks_nothing(gravito_bending_length, slenderness):
    """It had ended as hundreds of times as stiff in tension."""
    rod = cable(gravito_bending_length, slenderness)
    content = identify_motion(motion_from_arrays(motion_example(rod, seed=3))).to_dict()
    assert content["verdict"] == "adequate"
    assert content["before_mm"] < 0.15
    assert content["base"]["stiffness"]["L_gb"]["value"] == pytest.approx(
        gravito_bending_length, rel=0.04
    )
