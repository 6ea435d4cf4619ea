"""What PyElastica's rods hide is named from their motion: other equations, other code."""

import pytest

pytest.importorskip("elastica", reason="PyElastica is not installed (pip install wrod[peers])")

import numpy as np
from moving_clamps import L_GB, recordings

from wrod.identification import identify_motion
from wrod.identification.motion_loading import motion_from_arrays

BEND = 6.0
CANDIDATES = ("natural_curvature_profile", "gravity_tilt", "mass_gradient")


def bent(rod):
    """Bent at rest in the middle third."""
    third = rod.rest_kappa.shape[1] // 3
    rod.rest_kappa[0, third : 2 * third] = BEND


@pytest.mark.slow
def test_a_bend_in_the_middle_is_named():
    m = motion_from_arrays(recordings(bent, range(8)))
    report = identify_motion(m, candidates=CANDIDATES)
    assert report.effects[0].name == "natural_curvature_profile"
    assert report.after < 0.3 * report.before
    lgb = report.base["stiffness"]["L_gb"].value
    assert lgb == pytest.approx(L_GB, rel=0.04)
    # The force print, before any fit: a moment fixed in the material, where the bend is.
    best = report.trace.prints[0]
    assert best.name == "moment_in_material" and best.share > 0.95
    place = best.arc_length / best.arc_length[-1]
    inside, outside = np.abs(place - 0.5) < 0.15, np.abs(place - 0.5) > 0.2
    step = best.value[inside].mean(axis=0) - best.value[outside].mean(axis=0)
    assert np.linalg.norm(step) == pytest.approx(BEND, rel=0.3)
