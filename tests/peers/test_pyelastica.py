"""SolverDER against PyElastica: other equations (Cosserat), other code, explicit steps.

Both meshes place the clamp and the loads to second order: their errors at 20 edges against the
continuum are about 0.13 % and 0.07 % of the length at rest, and 0.2 % and 0.1 % in frequency (plus
0.2 % of the implicit time step). The bounds are what these add up to, and half as much again.
"""

import pytest

pytest.importorskip("elastica", reason="PyElastica is not installed (pip install wrod[peers])")
pytest.importorskip("newton", reason="Newton is not installed (pip install wrod[newton])")

import numpy as np
from cantilever import Cantilever, Der, Elastica, Start, come_to_rest, frequency_error

import wrod

EDGES = 20
PROBLEM = Cantilever(wrod.rod("green-vps"), 0.1)


def both(start):
    return (
        Der(PROBLEM, EDGES, PROBLEM.period / 80, start),
        Elastica(PROBLEM, EDGES, Elastica.stable_step(PROBLEM, EDGES), start),
    )


def test_heavy_cantilever_at_rest():
    tips = []
    for solver in both(Start()):
        assert come_to_rest(solver, PROBLEM, 3 * PROBLEM.period) < 1e-3
        tips.append(solver.tip())
    straight = np.array([PROBLEM.length, 0.0, 0.0])
    assert np.linalg.norm(tips[0] - straight) > 0.5 * PROBLEM.length
    assert np.linalg.norm(tips[0] - tips[1]) < 3e-3 * PROBLEM.length
    for tip in tips:
        assert np.linalg.norm(tip - PROBLEM.tip) < 2e-3 * PROBLEM.length


def test_frequency():
    start = Start(gravity=False, damping=False, swing=0.01 * PROBLEM.length)
    implicit, explicit = (frequency_error(solver, PROBLEM, 1.6) for solver in both(start))
    assert abs(implicit - explicit) < 0.0075
    assert abs(explicit) < 0.002


def test_light_rods_sag_like_beams():
    """The continuum's tip for a short rod: w L^4 / (8 k_b), and weight stretches nothing yet."""
    problem = Cantilever(wrod.rod("green-vps"), 0.005)
    sag = problem.rod.weight * problem.length**4 / (8 * problem.rod.bending_stiffness)
    assert problem.tip[2] == pytest.approx(-sag, rel=1e-4)
    assert problem.tip[0] == pytest.approx(problem.length, rel=1e-6)
