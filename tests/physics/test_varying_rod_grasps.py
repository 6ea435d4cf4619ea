"""Grasps of rods whose properties vary: clamped at contact and grip, such a rod has the pattern's
curvature at the contact, and nothing twists it there."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import wrod
from wrod.planning.sources import SOURCES, GraspInputs
from wrod.rods.law import Softening
from wrod.rods.model import RodModel
from wrod.rods.profile import Profile
from wrod.solvers.statics import EquilibriumSolver

GREEN = wrod.RodModel.of(wrod.rod("green-vps"))
B, L, LGB = GREEN.mean_bending_stiffness, GREEN.length, GREEN.gravito_bending_length
AT = 0.62


def along(first, last) -> Profile:
    return Profile([first, last], [0.0, L])


RICH = replace(
    GREEN,
    bending_stiffness=(along(1.4 * B, 0.9 * B), along(0.9 * B, 0.7 * B)),
    twisting_stiffness=along(0.5 * B, 0.8 * B),
    line_mass=along(GREEN.line_mass.values[0], 1.3 * GREEN.line_mass.values[0]),
    principal_angle=0.3,
    law=Softening(25.0, 0.5),
    natural_curvature=(along(3.0, -1.0), -1.0),
    natural_twist=1.5,
    point_masses=((0.75, 2e-4),),
)
RODS = {
    "anisotropic": replace(GREEN, bending_stiffness=(1.3 * B, 0.75 * B)),
    "softening": replace(GREEN, law=Softening(20.0, 0.6)),
    "twisted": replace(GREEN, natural_twist=3.0, natural_curvature=(2.0, 1.0)),
    "everything": RICH,
}


def clamped(model: RodModel, at: float, roll: float, grasps, k: int, edges: int):
    """Curvature (left, up) and twisting moment at the contact of the rod held at the grasp."""
    h = (model.length - at) / edges
    s = at + h * np.arange(-1, edges + 2)
    edge = np.linalg.norm(np.diff(grasps.shape[k], axis=0), axis=1)
    own = np.concatenate([[0.0], np.cumsum(edge)])
    inner = CubicSpline(own / own[-1], grasps.shape[k])(np.linspace(0.0, 1.0, edges + 1))
    frame = Rotation.from_rotvec(grasps.rotation[k]).as_matrix()
    position = np.concatenate([[[-h, 0.0, 0.0]], inner, inner[-1:] + h * frame[:, 0]])
    position[1] = 0.0
    angle = roll + model.rolled(at)
    m1 = np.array([0.0, np.cos(angle), np.sin(angle)])
    batch = wrod.RodBatch.of(model, s, position[None], clamped=(True, True), director=m1)
    wrod.prescribe(batch, clamped_nodes=(0, 1, -2, -1), clamped_angles=(0, -1))
    # The grip's frame: y where what was left has been carried to; the section's own from there.
    turn = roll + model.principal_angle
    target = np.cos(turn) * frame[:, 1] + np.sin(turn) * frame[:, 2]
    d, t = batch.state.director.numpy()[0, -1], frame[:, 0]
    wanted = np.arctan2(np.cross(t, d) @ target, d @ target)
    twist = batch.state.reference_twist.numpy()[0, 1:-1].sum()
    # Of all turns the one that has the grasp's twist.
    untold = grasps.twist[k] - model.rolled(at) - (wanted + twist)
    wanted += 2.0 * np.pi * np.rint(untold / (2.0 * np.pi))
    dof = batch.state.dof.numpy().copy()
    dof[0, 3::4] = np.linspace(0.0, wanted, edges + 2)
    batch.state.dof.assign(dof)
    result = EquilibriumSolver(batch).solve(max_iterations=400)
    assert result.converged.all()
    q = batch.positions()[0, 1:]
    out = batch.evaluate(order=1)
    bend = 2.0 * q[1, 1:] / h**2  # node 2 of a rod that starts along x
    return bend, -out.gradient.numpy()[0, 3]


@pytest.mark.parametrize("name", RODS)
@pytest.mark.parametrize("curvature", [0.0, 12.0, -12.0])
def test_a_clamped_rod_has_the_curvature_of_the_pattern(name, curvature):
    model, roll = RODS[name], 0.4
    inputs = GraspInputs.of(
        model, np.array([L - AT]), np.array([curvature]), roll=roll, device="cpu"
    )
    grasps = SOURCES["numeric"](inputs)
    grasps = replace(grasps, shape=model.gravito_bending_length * grasps.shape)
    assert grasps.converged.all()
    coarse, fine = (clamped(model, AT, roll, grasps, 0, n) for n in (150, 300))
    bend = (2.0 * fine[0] - coarse[0]) * LGB  # first order: over the first edge it changes
    assert bend == pytest.approx((curvature * LGB, 0.0), abs=8e-3)
    moment = (2.0 * fine[1] - coarse[1]) * LGB / B
    assert moment == pytest.approx(0.0, abs=5e-3)
