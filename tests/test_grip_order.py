"""What a grip holds, rods that hang from it and their stability, is of second order."""

from types import SimpleNamespace

import numpy as np
import pytest
from continuum_rods import ContinuumGrasp, Section
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import wrod
from wrod.deployment.assembly import assemble
from wrod.deployment.carried_tangents import LaidTangents
from wrod.deployment.grip_path import GripSchedule
from wrod.deployment.setup import Setup

ROD = wrod.RodModel(
    length=0.24, bending_stiffness=3e-6, twisting_stiffness=2e-6, stretching_stiffness=6.0,
    line_mass=0.0093, radius=0.0016, natural_curvature=(10.0, -4.0), air_damping=8.0,
)  # fmt: skip
# Of the grip, a metre above the table; far from how the rod would hang without a moment there.
PLACE = np.array([0.09, 0.03, 1.15])
TURN = Rotation.from_euler("yz", [-1.3, 0.4]) * Rotation.from_euler("x", 0.5)
KEYS, COLUMNS = 400, 8


def hung(edges: int):
    """The rod at rest, by arc length; its middle (3,), and the derivatives of that by the grip's
    position and rotation, the logarithm of the stiffness and the natural curvature (8, 3). The
    first edge is clamped, its middle at the origin of the arc length."""
    h = ROD.length / (edges - 0.5)
    arc = h * (np.arange(edges + 1) - 0.5)
    ends = np.array([[0.0, 0.0, 1.0], PLACE])
    slopes = ROD.length * np.array([[1.0, 0.0, 0.0], TURN.apply([1.0, 0.0, 0.0])])
    way = CubicSpline([0.0, 1.0], ends, bc_type=((1, slopes[0]), (1, slopes[1])))
    position = way(arc / ROD.length)
    position[:2] = [[-h / 2, 0.0, 1.0], [h / 2, 0.0, 1.0]]
    schedule = GripSchedule(
        np.tile(PLACE, (KEYS, 1)), np.tile(TURN.as_quat(), (KEYS, 1)), 2, np.inf, np.inf
    )
    left = np.array([0.0, 1.0, 0.0])
    setup = Setup(arc, position, left, np.zeros(3), schedule, 0.0, 1.0, 1.0)
    trial = SimpleNamespace(
        rod=ROD, trajectory=SimpleNamespace(roll=0.0, spin=0.0), friction=wrod.Friction(0.5),
        disturbance=wrod.Disturbance(), fixtures=None,
    )  # fmt: skip
    batch, contact, dynamics = assemble(
        [trial], [setup], wrod.Discretisation(tolerance=1e-11), keeps_recording=True
    )
    unit = np.eye(COLUMNS)[None]
    path = np.repeat(unit[:, :, None, :6], KEYS, axis=2)
    friction = np.zeros((1, COLUMNS, batch.node_count))
    dynamics.follower = tangents = LaidTangents(
        batch,
        contact,
        path,
        friction,
        unit[..., 6],
        np.stack([unit[..., 7], 0 * unit[..., 7]], axis=2),
        np.full((1, COLUMNS), -1.0),
    )
    assert not dynamics.advance(20.0, 0.1).diverged.any()
    middle = 0.5 * ROD.length
    shape = CubicSpline(arc, batch.positions()[0, :-1])
    rates = CubicSpline(arc, tangents.values()[0, :, :-1], axis=1)
    return shape, shape(middle), rates(middle)


class Held(ContinuumGrasp):
    """The continuous rod between two clamps."""

    def ends(self, section, given, a, b, p):
        start = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
        frame = np.stack([b[3:6], b[6:9], np.cross(b[3:6], b[6:9])])
        off = np.cross(frame, TURN.as_matrix().T).sum(axis=0)
        return np.concatenate([np.append(a[:9], a[12]) - start, b[:3] - PLACE, off])


def continuous(rod: wrod.RodModel, near: CubicSpline) -> np.ndarray:
    """(3,) middle of the continuous rod that is shaped nearly so."""
    held = Held(Section.of(rod, 0.0, 1.0, 1.0), rod.length, 0.0, -np.pi / 2)
    s = np.linspace(0.0, rod.length, 81)
    weight = rod.weight * s
    held.start(s, near(s), [0.0, 0.0, 0.5 * weight[-1]])
    y = held.guess[1]
    y[9:12], y[12] = rod.mean_bending_stiffness * y[9:12], weight
    return held.solve(("held",), tolerance=1e-7).sol(0.5 * rod.length)[:3]


def test_what_hangs_from_a_grip_is_of_second_order_with_its_derivatives():
    coarse, middle, fine = (hung(edges) for edges in (40, 80, 160))
    for what in (1, 2):
        one, two = np.atleast_2d(middle[what] - coarse[what], fine[what] - middle[what])
        order = np.log2(np.abs(one).max(axis=-1) / np.abs(two).max(axis=-1))
        assert (np.abs(order - 2.0) < 0.25).all(), order
    limit, rates = (fine[what] + (fine[what] - middle[what]) / 3.0 for what in (1, 2))
    assert np.abs(limit - continuous(ROD, fine[0])).max() < 5e-7
    bent = [continuous(ROD.bent(by), fine[0]) for by in (0.1, -0.1)]
    assert np.abs(rates[7] - (bent[0] - bent[1]) / 0.2).max() < 1e-3 * np.abs(rates[7]).max()


@pytest.mark.parametrize(
    "natural",
    [(0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.6, -0.3)],
    ids=["straight", "up", "left", "both"],
)
def test_how_far_grasps_are_from_instability_is_of_second_order(natural):
    """Untwisted and twisted by one and two radians."""
    values = [
        wrod.solve_grasps(
            [4.0], [0.0], [1600.0], natural_curvature=natural, edge_count=n, eigenvalues=True
        ).eigenvalue
        for n in (64, 128, 256)
    ]
    first, second = np.diff(values, axis=0)
    assert np.log2(first / second) == pytest.approx(2.0, abs=0.05)
