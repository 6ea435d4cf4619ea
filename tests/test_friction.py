import numpy as np
import pytest

import wrod
from wrod.planning.friction import friction_bound

ROD = wrod.rod("green-vps")


def test_required_friction_of_a_known_curvature():
    # kappa = 12 sin(s / 0.05): kappa'' = -12 / 0.05^2 sin, and mu_s = 2 L_gb^3 |kappa''|.
    s = np.linspace(0.0, 0.5, 40_001)
    heading = 12.0 * 0.05 * (1.0 - np.cos(s / 0.05))
    step = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    points = np.concatenate([[[0.0, 0.0]], np.cumsum((step[1:] + step[:-1]) / 2 * s[1], axis=0)])
    bound = friction_bound(wrod.Pattern.from_points(points[::200]), ROD)
    exact = 2 * 0.032**3 * 12 / 0.05**2 * np.abs(np.sin(bound.arc_length / 0.05))
    np.testing.assert_allclose(bound.required[30:-30], exact[30:-30], atol=2e-3)
    np.testing.assert_allclose(bound.required[8:-8], exact[8:-8], atol=0.06)


def test_density_drops_out():
    heavy = wrod.RodMaterial(ROD.radius, ROD.gravito_bending_length, ROD.length, density=5000.0)
    pattern = wrod.pattern("letter-S")
    np.testing.assert_allclose(
        friction_bound(pattern, heavy).required, friction_bound(pattern, ROD).required
    )


def test_long_remainder_needs_less_friction_than_a_short_one():
    circle = wrod.pattern("circle")
    short, long = (
        friction_bound(circle.with_remainder(length), ROD).required.max() for length in (0.07, 0.14)
    )
    assert short == pytest.approx(4.0 * long, rel=1e-2)
