"""What PyElastica's rods hide is named from their motion: other equations, other code."""

import pytest

pytest.importorskip("elastica", reason="PyElastica is not installed (pip install wrod[peers])")

import numpy as np
from moving_clamps import L_GB, recordings

from wrod.identification import identify_motion
from wrod.identification.motion.loading import motion_from_arrays

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
    named = [e.name for e in report.effects]
    assert "natural_curvature_profile" in named
    assert not {"gravity_tilt", "mass_gradient"} & set(named)
    (profile,) = (e for e in report.effects if e.name == "natural_curvature_profile")
    assert profile.after < 0.35 * report.before
    assert report.after < 0.25 * report.before
    lgb = report.base["stiffness"]["L_gb"].value
    assert lgb == pytest.approx(L_GB, rel=0.04)
    # The force print, before any fit: a moment fixed in the material, where the bend is.
    best = report.trace.prints[0]
    assert best.name == "moment_in_material" and best.share > 0.95
    # A moment that is uniform, or grows evenly, leaves no force between clamps: its steps do, where
    # the bend begins (before the fourth marker from the grip) and ends (before the seventh).
    step = np.linalg.norm(np.diff(best.value, axis=0), axis=1)
    assert step[[2, 5]] == pytest.approx(BEND, rel=0.2)
