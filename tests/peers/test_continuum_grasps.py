"""Grasps of rods that are bent or twisted at rest, or vary, against continuous Kirchhoff rods by
collocation: the order in the mesh, and what the extrapolation leaves."""

from dataclasses import replace

import numpy as np
import pytest
from continuum_rods import ContinuumGrasp, Section, uniform_grasp
from scipy.spatial.transform import Rotation

import wrod
from wrod.grasps.optimal import solve_grasps
from wrod.grasps.rod_grasps import solve_rod_grasps
from wrod.rods.law import Softening
from wrod.rods.profile import Profile

GREEN = wrod.RodModel.of(wrod.rod("green-vps"))
B, L = GREEN.mean_bending_stiffness, GREEN.length


def along(first, last) -> Profile:
    return Profile([first, last], [0.0, L])


RODS = {
    "twisted": replace(GREEN, natural_twist=3.0),
    "anisotropic": replace(GREEN, bending_stiffness=(1.3 * B, 0.75 * B)),
    "tapered": replace(
        GREEN,
        bending_stiffness=(along(1.5 * B, 0.6 * B), along(1.5 * B, 0.6 * B)),
        twisting_stiffness=along(0.9 * B, 0.4 * B),
        line_mass=along(GREEN.line_mass.values[0], 0.7 * GREEN.line_mass.values[0]),
    ),
    "softening": replace(GREEN, law=Softening(20.0, 0.6)),
    "everything": replace(
        GREEN,
        bending_stiffness=(along(1.4 * B, 0.9 * B), along(0.9 * B, 0.7 * B)),
        twisting_stiffness=along(0.5 * B, 0.8 * B),
        principal_angle=0.3,
        law=Softening(25.0, 0.5),
        natural_curvature=(along(6.0, -1.0), -5.0),
        natural_twist=1.5,
    ),
}


def errors(grasps, exact, length=1.0, force=1.0) -> tuple[float, float, float]:
    """Of position [L_gb], orientation [rad] and force."""
    turn = (Rotation.from_rotvec(grasps.rotation[0]).inv() * exact[1]).magnitude()
    return (
        np.abs(grasps.position[0] / length - exact[0]).max(),
        turn,
        np.abs(grasps.force[0] / force - exact[2]).max(),
    )


def order(coarse, fine) -> np.ndarray:
    return np.log2(np.array(coarse) / np.array(fine))


@pytest.mark.parametrize(
    "inputs",
    [
        (1.2, 0.7, 300.0),
        (2.5, 3.3, 8000.0),
        (6.0, 2.2, 150.0),
        (14.0, 0.2, 15000.0),
        (23.0, 1.4, 900.0),
        (49.0, 2.9, 4000.0),
    ],
)
def test_straight_grasp_of_the_continuum(inputs):
    rod, found = uniform_grasp(*inputs, tolerance=1e-8)
    assert max(errors(solve_grasps(*inputs), rod.read(found))) < 2e-3


@pytest.mark.parametrize(
    "ls, kappa, ks, natural, poisson, closure",
    [
        (9.0, 0.0, 900.0, (0.3, 0.5), 0.5, "zero_tension"),
        (6.0, 2.2, 150.0, (-0.2, 0.1), 0.3, "zero_tension"),
        (14.0, -0.6, 15000.0, (0.13, 0.0), 0.5, "zero_tension"),
        (3.0, 0.7, 300.0, (0.3, 0.0), 0.5, "min_friction"),
        (4.0, 1.0, 900.0, (0.2, 0.2), 0.0, "min_force"),
    ],
)
def test_curved_grasp_of_the_continuum(ls, kappa, ks, natural, poisson, closure):
    def solve(edges, extrapolate=False):
        return solve_grasps(
            ls, kappa, ks, natural_curvature=natural, poisson=poisson, closure=closure,
            edge_count=edges, extrapolate=extrapolate,
        )  # fmt: skip

    best = solve(128, True)
    assert best.converged.all()
    near = best.position[0, 0]
    rod, found = uniform_grasp(ls, kappa, ks, natural, poisson, near=near, closure=closure)
    exact = rod.read(found)
    coarse, fine = (errors(solve(edges), exact) for edges in (128, 256))
    assert (order(coarse, fine) > 1.85).all()
    position, turn, force = errors(best, exact)
    assert position < 1e-4
    assert turn < 5e-4
    assert force < 5e-5


@pytest.mark.parametrize("name", RODS)
def test_varying_grasp_of_the_continuum(name):
    model, at, from_up = RODS[name], 0.62, 0.4
    roll = from_up + 0.5 * np.pi - model.rolled(at)

    def solve(edges, extrapolate=False):
        return solve_rod_grasps(
            model, at, 6.0, held_roll=roll, edge_count=edges, extrapolate=extrapolate
        )

    best = solve(128, True)
    assert best.converged.all()
    lgb, unit = best.length_unit, best.force_unit
    ls, kappa = (L - at) / lgb, 6.0 * lgb
    straight = solve_grasps(ls, kappa, 2000.0)
    section = Section.of(model, at, lgb, unit)
    rod = ContinuumGrasp(section, ls, kappa, from_up + model.principal_angle)
    rod.start(straight.arc_length[0], straight.shape[0], straight.force[0])
    rod.continued()
    exact = rod.read(rod.closed("zero_tension", 0.0))
    coarse, fine = (errors(solve(edges), exact, lgb, unit) for edges in (128, 256))
    assert (order(coarse, fine) > 1.85).all()
    assert max(errors(best, exact, lgb, unit)) < 1e-5


@pytest.mark.parametrize("natural", [(0.0, 0.0), (0.3, 0.2)])
def test_force_jacobian_of_the_continuum(natural):
    """The contact held, and the grip of a curved rod so that it does not spin about its tangent."""
    inputs = 6.0, 0.8, 600.0, natural, 0.5
    exact = ContinuumGrasp.force_jacobian(*uniform_grasp(*inputs), rolls=not any(natural))
    ls, kappa, ks, natural, poisson = inputs

    def error(edges, extrapolate=False):
        grasps = solve_grasps(
            ls, kappa, ks, natural_curvature=natural, poisson=poisson,
            edge_count=edges, extrapolate=extrapolate,
        )  # fmt: skip
        return np.abs(grasps.force_jacobian[0] - exact).max() / np.abs(exact).max()

    assert order(error(128), error(256)) > 1.85
    assert error(128, True) < 1e-4
