"""Rods whose bending remembers: loops, relaxation, springback, and energy that is only lost."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from wrod.rods.batch import RodBatch
from wrod.rods.law import Dahl, Linear, Plastic, StandardLinearSolid
from wrod.rods.model import RodModel
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.prescribed import PrescribedMotion
from wrod.solvers.statics import prescribe

B, LENGTH, EDGES = 2e-3, 0.2, 8


def rod(law) -> RodModel:
    return RodModel(
        length=LENGTH,
        bending_stiffness=B,
        twisting_stiffness=1.5e-3,
        stretching_stiffness=2e3,
        line_mass=0.02,
        radius=0.002,
        law=law,
    )


def bent_at_both_ends(laws, times, curvature, **options) -> Dynamics:
    """Rods without weight, held between clamps of which each is turned by `curvature` (key,) LENGTH
    / 2 one way and the other; one slides, so that nothing but a moment loads the rods."""
    spacing = LENGTH / EDGES
    s = np.linspace(-spacing, LENGTH + spacing, EDGES + 3)
    position = np.zeros((len(laws), len(s), 3))
    position[:, :, 0] = s
    batch = RodBatch.of(
        [rod(law) for law in laws],
        s,
        position,
        clamped=(True, True),
        director=[0, 0, 1],
        gravity=[0, 0, 0],
    )
    angle = 0.5 * LENGTH * np.asarray(curvature)
    ends = np.zeros((2, len(times), 3))
    ends[1, :, 0] = LENGTH
    upright = Rotation.from_matrix([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    turns = [
        (Rotation.from_euler("y", sign * angle[:, None]) * upright).as_matrix() for sign in (1, -1)
    ]
    motion = PrescribedMotion(
        batch, [0, -1], times, ends, np.array(turns), part=[1.0, 0.0], slides=["", "x"]
    )
    return Dynamics(batch, radius=0.002, motion=motion, **options, keeps_recording=True)


def moment(dynamics) -> np.ndarray:
    """(rod,) with which the first clamp bends the rod, by its two reactions; the strain 2 tan(phi /
    2) / l of the mesh grows faster than the angle phi, by 1 + (l e / 2)^2."""
    x = dynamics.batch.positions()
    grown = 1.0 + (0.5 * LENGTH / EDGES * excess(dynamics)) ** 2
    return np.cross(x[:, 0] - x[:, 1], dynamics.reaction.numpy()[:, :3])[:, 1] / grown


def excess(dynamics) -> np.ndarray:
    """(rod,) curvature in the middle."""
    return dynamics.batch.inelastic.numpy()["excess"][:, EDGES // 2 + 1, 0].copy()


def test_loops_in_a_cycle():
    """Moment against curvature in one and a half cycles: bilinear, and by Dahl's equation."""
    yields, hardening, slips, kept = 3.0, 0.2, 2.0, 0.3
    times = np.linspace(0.0, 30.0, 301)
    curvature = 9.0 * np.sin(2 * np.pi * times / 20.0)
    dynamics = bent_at_both_ends(
        [Plastic(yields, hardening), Dahl(slips, kept)], times, curvature, internal_damping=5e-4
    )
    bent, loop = [np.zeros(2)], [np.zeros(2)]
    for t in np.arange(0.2, 30.01, 0.2):
        assert not dynamics.advance(t, 0.1).diverged.any()
        bent.append(excess(dynamics))
        loop.append(moment(dynamics))
    bent, loop = np.array(bent), np.array(loop)
    # The slider of the parallel model, e - p, by its definition, over the same curvatures.
    slider, expected = 0.0, [0.0]
    for before, now in zip(bent[:-1, 0], bent[1:, 0], strict=True):
        slider = np.clip(slider + now - before, -yields, yields)
        expected.append(B * (hardening * now + (1 - hardening) * slider))
    assert np.abs(loop[:, 0] - expected).max() < 0.002 * np.abs(loop[:, 0]).max()
    # Closed: what is lost in a cycle is 4 M_y (1 - r) times the plastic excursion over it.
    turn = bent[:, 0].max()
    cycle = slice(50, 151)
    area = np.trapezoid(loop[cycle, 0], bent[cycle, 0])
    assert area == pytest.approx(4 * B * (1 - hardening) * yields * (turn - yields), rel=0.01)

    z = [0.0]
    for change in np.diff(bent[:, 1]):
        way, sign = (0.0, abs(change)), np.sign(change)
        path = solve_ivp(lambda s, z, g=sign: g - z / slips, way, z[-1:], rtol=1e-9)
        z.append(path.y[0, -1])
    expected = B * (kept * bent[:, 1] + (1 - kept) * np.array(z))
    assert np.abs(loop[:, 1] - expected).max() < 0.002 * np.abs(loop[:, 1]).max()
    assert np.abs(z[-1]) > 0.9 * slips


@pytest.mark.parametrize("scheme", ["euler", "bdf2"])
def test_moment_of_a_rod_that_is_held_bent_relaxes(scheme):
    """M = B k (1 + g (T / t_0) (1 - exp(-t_0 / T)) exp(-(t - t_0) / T)) after bending for t_0."""
    added, time, ramp = 0.8, 0.5, 0.1
    law = StandardLinearSolid(added, time)
    dynamics = bent_at_both_ends(
        [law], [0.0, ramp, 10.0], [0.0, 6.0, 6.0], scheme=scheme, internal_damping=0.002
    )
    for t in (0.3, 0.6, 1.1, 3.1):
        dynamics.advance(t, 0.01)
        left = added * time / ramp * (1 - np.exp(-ramp / time)) * np.exp(-(t - ramp) / time)
        assert moment(dynamics)[0] == pytest.approx(B * excess(dynamics)[0] * (1 + left), rel=0.002)


@pytest.mark.parametrize(("scheme", "near"), [("euler", 0.005), ("bdf2", 0.001)])
def test_zeners_solid_as_a_law_and_as_damping_that_relaxes(scheme, near):
    """Both are M = B (e + g z): what is between them goes with the step."""
    added, time = 0.8, 0.5
    apart = []
    for step in (0.02, 0.01):
        dynamics = bent_at_both_ends(
            [StandardLinearSolid(added, time), Linear()], [0.0, 0.2, 10.0], [0.0, 6.0, 6.0],
            scheme=scheme, internal_damping=[0.0, added * time],
        )  # fmt: skip
        dynamics.relax([0.0, time])
        moments = []
        for t in (0.2, 0.4, 0.8, 1.6):
            dynamics.advance(t, step)
            x = dynamics.batch.positions()
            moments.append(np.cross(x[:, 0] - x[:, 1], dynamics.reaction.numpy()[:, :3])[:, 1])
        law, damping = np.array(moments).T
        apart.append(np.abs(damping / law - 1.0).max())
    assert apart[1] < near and apart[1] < 0.6 * apart[0]


@pytest.mark.parametrize("hardening", [0.0, 0.25])
def test_a_wire_springs_back_to_the_radius_that_it_keeps(hardening):
    """Bent to k and let go it keeps the curvature (1 - r) (k - k_y)."""
    bent, yields = 12.0, 4.0
    s = np.linspace(0.0, LENGTH, 2 * EDGES + 1)
    angle = bent * s
    position = np.column_stack([np.sin(angle), 0 * s, 1 - np.cos(angle)])[None] / bent
    batch = RodBatch.of(
        rod(Plastic(yields, hardening)), s, position, director=[0, 0, 1], gravity=[0, 0, 0]
    )
    dynamics = Dynamics(batch, radius=0.002, air_damping=1e3)
    dynamics.advance(5.0, 0.05)
    x = batch.positions()[0]
    chord, sagitta = x[-1] - x[0], x[EDGES] - 0.5 * (x[0] + x[-1])
    half, height = 0.5 * np.linalg.norm(chord), np.linalg.norm(sagitta)
    radius = (half**2 + height**2) / (2 * height)
    assert radius * (1 - hardening) * (bent - yields) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("law", [Plastic(1.0, 0.1), StandardLinearSolid(0.5, 0.2), Dahl(1.0, 0.3)])
def test_energy_is_only_lost(law):
    """Of a cantilever that is let go under its weight; a linear one swings on."""
    spacing = LENGTH / EDGES
    s = np.linspace(-spacing, LENGTH, EDGES + 2)
    position = np.zeros((2, len(s), 3))
    position[:, :, 0] = s
    batch = RodBatch.of([rod(law), rod(Linear())], s, position, clamped=(True, False))
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    dynamics = Dynamics(batch, radius=0.002, scheme="midpoint")
    energy = [dynamics.energy()]
    for t in np.arange(0.02, 0.61, 0.02):
        dynamics.advance(t, 0.004)
        energy.append(dynamics.energy())
    energy = np.array(energy)
    largest = np.ptp(energy[:, 0]) + 1e-9
    assert np.diff(energy[:, 0]).max() < 0.002 * largest
    assert energy[0, 0] - energy[-1, 0] > 20 * np.ptp(energy[:, 1])
