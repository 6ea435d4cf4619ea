"""Motion of rods against closed forms and conservation laws."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh, expm
from vps import momenta

from wrod.errors import RodError
from wrod.rods.batch import RodBatch
from wrod.rods.model import RodModel
from wrod.rods.state import full_hessian
from wrod.solvers.contact import Contact
from wrod.solvers.dynamics import SCHEMES, Dynamics
from wrod.solvers.friction import Friction
from wrod.solvers.solids import Box
from wrod.solvers.statics import prescribe, solve_equilibria

ROOT = 1.875104068711961  # first root of cos(x) cosh(x) = -1


def masses(nodes, length=1.0):
    mass = np.full(nodes, length / (nodes - 1))
    mass[[0, -1]] /= 2
    return mass


def cantilever(nodes=41, amplitude=0.01, rod_count=1):
    """Unit length, stiffness and mass; in the first mode of vibration, with a ghost edge that
    makes the clamp second order."""
    h = 1.0 / (nodes - 1)
    x = np.maximum(np.arange(-1, nodes) * h, 0.0)
    ratio = (np.sinh(ROOT) - np.sin(ROOT)) / (np.cosh(ROOT) + np.cos(ROOT))
    mid = 0.5 * (x[1:] + x[:-1])
    slope = ROOT * (
        np.sinh(ROOT * mid)
        + np.sin(ROOT * mid)
        - ratio * (np.cosh(ROOT * mid) - np.cos(ROOT * mid))
    )
    slope[0] = 0.0
    angle = np.arctan(0.5 * amplitude * slope)
    steps = h * np.column_stack([np.cos(angle), np.zeros(nodes), np.sin(angle)])
    position = np.concatenate([[[-h, 0, 0]], np.cumsum(steps, axis=0) - [h, 0, 0]])
    batch = RodBatch(
        np.broadcast_to(position, (rod_count, *position.shape)),
        rest_length=h,
        stretching_stiffness=1e5,
        bending_stiffness=np.where(np.arange(nodes + 1) == 1, 2.0, 1.0),
        twisting_stiffness=1.0,
        node_mass=np.concatenate([[h], masses(nodes)]),
    )
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    return batch


def vibrate(dynamics, periods, samples, steps_per_sample=1):
    """Times, tip heights and energies."""
    period = 2 * np.pi / ROOT**2
    t = np.arange(1, int(periods * samples) + 1) * period / samples
    tips, energies = [], []
    for time in t:
        dynamics.advance(time, period / samples / steps_per_sample)
        tips.append(dynamics.batch.positions()[:, -1, 2].copy())
        energies.append(dynamics.energy())
    return t, np.array(tips), np.array(energies)


def test_frequency_of_a_cantilever_and_no_gain_of_energy():
    """omega = 1.8751^2 sqrt(EI / (rho A L^4)) for small vibrations."""
    dynamics = Dynamics(cantilever(), scheme="bdf2", radius=0.01)
    first = dynamics.energy()[0]
    t, tips, energies = vibrate(dynamics, 2.0, 60)
    z = tips[:, 0]
    i = np.flatnonzero(z[:-1] * z[1:] < 0)
    crossings = t[i] + (t[1] - t[0]) * z[i] / (z[i] - z[i + 1])
    period = 2 * np.diff(crossings).mean()
    assert period == pytest.approx(2 * np.pi / ROOT**2, rel=0.01)
    # Its own dissipation is small: nine tenths of the energy are there after two periods.
    assert energies.max() <= first * (1 + 1e-9)
    assert energies[-1, 0] > 0.9 * first


def test_euler_never_gains_energy():
    dynamics = Dynamics(cantilever(21, amplitude=0.3), scheme="euler", radius=0.01)
    first = dynamics.energy()[0]
    _, _, energies = vibrate(dynamics, 1.0, 30)
    assert (np.diff(np.concatenate([[first], energies[:, 0]])) <= 1e-9 * first).all()


def test_midpoint_keeps_period_and_energy_of_a_swing():
    """A cable of 0.25 m that swings in its slowest mode, in steps of 9 ms: omega dt = 0.07."""
    n, length, step = 21, 0.25, 9e-3
    batch = straight_rod(n, gravity=(0.0, 0.0, -9.81), length=length, stiffness=1e-3)
    batch.stretching_stiffness.fill_(1e3)
    prescribe(batch, pinned_nodes=(0,))
    assert solve_equilibria(batch).converged.all()
    dynamics = Dynamics(batch, scheme="midpoint", radius=0.01, tolerance=1e-9)
    matrix = full_hessian(batch.evaluate(order=2).hessian.numpy()[0])
    node = np.arange(4, batch.dof_count)
    node = node[node % 4 != 3]
    mass = dynamics.mass.numpy()[0, node]
    (square,), mode = eigh(matrix[np.ix_(node, node)], np.diag(mass), subset_by_index=[0, 0])
    period = 2 * np.pi / np.sqrt(square)
    speed = np.zeros((1, batch.dof_count))
    speed[0, node] = 0.01 * np.sqrt(square) * length * mode[:, 0] / np.abs(mode).max()
    dynamics.velocity.assign(speed)
    low = dynamics.energy()[0] - 0.5 * (mass * speed[0, node] ** 2).sum()
    time = step * np.arange(1, int(5.1 * period / step))
    place, energy = [], []
    start = batch.state.dof.numpy()[0, node].copy()
    for t in time:
        dynamics.advance(t, step)
        place.append((batch.state.dof.numpy()[0, node] - start) @ (mass * mode[:, 0]))
        energy.append(dynamics.energy()[0] - low)
    place = np.array(place)
    i = np.flatnonzero(place[:-1] * place[1:] < 0)
    crossing = time[i] + step * place[i] / (place[i] - place[i + 1])
    found = 2 * (crossing[-1] - crossing[0]) / (len(crossing) - 1)
    assert found == pytest.approx(period, rel=5e-4)
    assert energy[-1] == pytest.approx(energy[0], rel=5e-6)  # 1e-6 a period


@pytest.mark.parametrize(("inertia", "off"), [("lumped", 1.0 / 200), ("consistent", 0.0)])
def test_swing_of_a_stiff_pendulum(inertia, off):
    """Ten stiff edges that swing about one end as one bar do: I = m L^2 / 3, by 1 / (2 n^2) more if
    its mass is lumped at nodes (half of that in the period)."""
    batch = straight_rod(11, gravity=(0.0, 0.0, -9.81), stiffness=1e4)
    batch.stretching_stiffness.fill_(1e6)
    prescribe(batch, pinned_nodes=(0,))
    dynamics = Dynamics(
        batch,
        scheme="midpoint",
        radius=0.01,
        inertia=inertia,
        tolerance=1e-10,
    )
    length = np.linalg.norm(batch.positions()[0, -1] - batch.positions()[0, 0])
    arm = batch.positions()[0] - batch.positions()[0, 0]
    dynamics.set_velocity(0.02 * np.cross([0.0, 1.0, 0.0], arm)[None])
    mass = batch.node_mass.numpy().sum()
    rest = dynamics.energy()[0] - 0.5 * mass * length**2 / 3 * 0.02**2 * (1 + off)
    dynamics.velocity.zero_()
    assert rest == pytest.approx(dynamics.energy()[0], rel=1e-12)
    dynamics.set_velocity(0.02 * np.cross([0.0, 1.0, 0.0], arm)[None])
    period = 2 * np.pi * np.sqrt(2 * length / (3 * 9.81) * (1 + off))
    times = np.linspace(0.0, 1.2 * period, 601)[1:]
    place = []
    for time in times:
        dynamics.advance(time, times[0])
        place.append(batch.positions()[0, -1, 0])
    place = np.array(place)
    i = np.flatnonzero(place[:-1] * place[1:] < 0)
    crossing = times[i] + times[0] * place[i] / (place[i] - place[i + 1])
    assert crossing[1] == pytest.approx(period, rel=2e-4)


@pytest.mark.parametrize(("scheme", "order"), [("euler", 1), ("bdf2", 2)])
def test_order_in_the_time_step(scheme, order):
    tips = []
    for n in (40, 80, 160, 320):
        dynamics = Dynamics(
            cantilever(11, amplitude=0.2),
            scheme=scheme,
            radius=0.01,
            tolerance=1e-9,
        )
        dynamics.advance(0.3, 0.3 / n)
        tips.append(dynamics.batch.positions()[0, -1].copy())
    gaps = [np.linalg.norm(b - a) for a, b in itertools.pairwise(tips)]
    assert np.log2(gaps[-2] / gaps[-1]) > order - 0.25


def test_frequency_converges_with_the_mesh():
    """The tip after a quarter of a period, against a fine mesh: second order."""
    tips = []
    for nodes in (11, 21, 41):
        dynamics = Dynamics(cantilever(nodes), scheme="bdf2", radius=0.01, tolerance=1e-9)
        dynamics.advance(np.pi / 2 / ROOT**2, 0.005)
        tips.append(dynamics.batch.positions()[0, -1, 2])
    assert np.log2(abs(tips[0] - tips[1]) / abs(tips[1] - tips[2])) > 1.7


def free_rod(seed=0, nodes=9, gravity=(0.0, 0.0, 0.0)):
    """A bent, twisted, tumbling rod that nothing holds."""
    rng = np.random.default_rng(seed)
    edges = rng.normal(size=(1, nodes - 1, 3)) * 0.2 + [1.0, 0.0, 0.0]
    position = np.cumsum(np.concatenate([np.zeros((1, 1, 3)), edges], axis=1), axis=1)
    batch = RodBatch(
        position,
        stretching_stiffness=50.0,
        bending_stiffness=1.0,
        twisting_stiffness=0.7,
        natural_curvature=rng.normal(size=2) * 0.3,
        node_mass=rng.uniform(0.5, 1.5, nodes),
        gravity=gravity,
    )
    return batch, rng.normal(size=(1, nodes, 3)) * 0.3


def test_momentum_of_a_free_rod_is_conserved():
    """Linear momentum to the solver's tolerance; angular momentum with the scheme's order.

    The rod is thin: the gyroscopic forces of its spin, which DER leaves out, are of radius^2.
    """
    drifts = []
    for step in (0.01, 0.005):
        batch, velocity = free_rod()
        dynamics = Dynamics(batch, scheme="bdf2", radius=1e-3, tolerance=1e-9)
        dynamics.set_velocity(velocity)
        linear, angular = momenta(dynamics)
        assert not dynamics.advance(1.0, step).diverged.any()
        linear_now, angular_now = momenta(dynamics)
        assert np.abs(linear_now - linear).max() < 1e-9 * np.abs(linear).max()
        drifts.append(np.abs(angular_now - angular).max() / np.abs(angular).max())
    assert drifts[1] < 1e-3
    assert np.log2(drifts[0] / drifts[1]) > 1.7


def test_free_fall_with_air():
    """v = (g / c) (1 - exp(-c t)) for drag c m v."""
    batch, _ = free_rod(gravity=(0.0, 0.0, -9.81))
    dynamics = Dynamics(batch, scheme="bdf2", radius=0.05, air_damping=2.0)
    dynamics.advance(1.0, 0.005)
    mass = batch.node_mass.numpy()[0]
    mean = (mass[:, None] * dynamics.velocities()[0]).sum(axis=0) / mass.sum()
    assert mean[2] == pytest.approx(-9.81 / 2.0 * (1.0 - np.exp(-2.0)), rel=1e-4)
    assert np.abs(mean[:2]).max() < 1e-6


def test_free_fall_with_quadratic_drag():
    """v = v_t tanh(g t / v_t) with v_t^2 = g / q, of a rod whose model has the drag q."""
    g, q, length = 9.81, 1.5, 0.6
    rod = RodModel(
        length=length, bending_stiffness=1e-3, twisting_stiffness=1e-3, stretching_stiffness=500.0,
        line_mass=0.02, radius=0.002, gravity=g, quadratic_drag=q,
    )  # fmt: skip
    s = np.array([0.0, 0.1, 0.25, 0.4, 0.6])
    line = np.zeros((1, 5, 3))
    line[0, :, 0] = s
    batch = RodBatch.of(rod, s, line)
    dynamics = Dynamics.of(rod, batch, scheme="bdf2")
    assert dynamics.drag.numpy().sum() == pytest.approx(q * 0.02 * length)
    dynamics.advance(0.4, 0.002)
    terminal = np.sqrt(g / q)
    expected = -terminal * np.tanh(g * 0.4 / terminal)
    assert dynamics.velocities()[0, :, 2] == pytest.approx(np.full(5, expected), rel=1e-4)
    assert Dynamics.of(replace(rod, quadratic_drag=0.0), batch).drag is None


@pytest.mark.parametrize("scheme", SCHEMES)
def test_internal_damping_of_a_cantilever(scheme):
    """Kelvin-Voigt: zeta = omega b / 2, so the energy falls by exp(-b omega^2 t) faster."""
    b, omega = 0.01, ROOT**2
    energies = []
    for damping in (b, 0.0):
        dynamics = Dynamics(cantilever(), scheme=scheme, radius=0.01, internal_damping=damping)
        time, _, energy = vibrate(dynamics, 2.0, 30, 4)
        energies.append(energy[:, 0])
    rate = np.polyfit(time, np.log(energies[1] / energies[0]), 1)[0]
    assert rate == pytest.approx(b * omega**2, rel=0.02)


@pytest.mark.parametrize("scheme", ["bdf2", "midpoint"])
def test_viscous_moments_that_relax_are_those_of_zeners_solid(scheme):
    """A cantilever in its first mode: y'' = -omega^2 (y + m), m + theta m' = eta y', from rest
    (Kelvin and Voigt's has theta = 0)."""
    eta, theta, omega = 0.3, 0.3, ROOT**2
    dynamics = Dynamics(cantilever(), scheme=scheme, radius=0.01, internal_damping=eta)
    dynamics.relax(theta)
    first = dynamics.batch.positions()[0, -1, 2]
    time, tip, _ = vibrate(dynamics, 2.0, 100, 2)
    rates = [[0.0, 1.0, 0.0], [-(omega**2), 0.0, -(omega**2)], [0.0, eta / theta, -1.0 / theta]]
    expected = [(expm(np.array(rates) * t) @ [first, 0.0, 0.0])[0] for t in time]
    assert np.abs(tip[:, 0] - expected).max() < 0.01 * first


def straight_rod(nodes=21, gravity=(0.0, 0.0, 0.0), turned=0.0, length=1.0, stiffness=1e3):
    """Unit mass per length, hanging from the origin, turned from the vertical."""
    s = np.linspace(0.0, length, nodes)
    position = np.column_stack([np.sin(turned) * s, 0 * s, -np.cos(turned) * s])
    return RodBatch(
        position[None],
        stretching_stiffness=1e6,
        bending_stiffness=stiffness,
        twisting_stiffness=stiffness,
        node_mass=masses(nodes, length),
        gravity=gravity,
    )


@pytest.mark.parametrize("scheme", SCHEMES)
def test_internal_damping_lets_a_rod_spin(scheme):
    """A rod that spins as a rigid body, and is stretched as its rotation asks for, loses no angular
    momentum to its viscosity: what is lost is the scheme's, with or without it."""
    spin, nodes = 10.0, 7
    kept = []
    for damping in (0.05, 0.0):
        batch = straight_rod(nodes)
        z = batch.positions()[0, :, 2] + 0.5
        # (EA u')' = -rho A omega^2 z, node by node.
        tension = np.cumsum(masses(nodes) * spin**2 * z)[:-1]
        edge = np.diff(z) * (1.0 + tension / batch.stretching_stiffness.numpy()[0])
        z = np.append(0.0, np.cumsum(edge))
        z -= z.mean()
        batch.set_configuration(np.column_stack([0 * z, 0 * z, z])[None])
        dynamics = Dynamics(
            batch,
            scheme=scheme,
            radius=0.01,
            internal_damping=damping,
            tolerance=1e-9,
        )
        velocity = np.zeros((1, nodes, 3))
        velocity[0, :, 0] = spin * z
        dynamics.set_velocity(velocity)
        first = momenta(dynamics)[1]
        # Implicit Euler, also the first step of bdf2, loses (omega dt)^2 a step.
        step = 2.5e-4 if scheme == "euler" else 5e-5
        assert not dynamics.advance(0.2, step).diverged.any()
        kept.append(momenta(dynamics)[1][1] / first[1])
    assert kept[0] == pytest.approx(kept[1], abs=1e-6)
    if scheme != "euler":
        assert kept[0] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_internal_damping_lets_a_stiff_pendulum_swing(scheme):
    """A stiff rod that swings about its end keeps its amplitude however viscous it is."""
    ends = []
    for damping in (0.05, 0.0):
        batch = straight_rod(7, gravity=(0.0, 0.0, -9.81), turned=0.3)
        prescribe(batch, pinned_nodes=(0,))
        dynamics = Dynamics(batch, scheme=scheme, radius=0.01, internal_damping=damping)
        assert not dynamics.advance(2.4, 0.0025).diverged[0]
        # E = m g L / 2 (1 - cos(amplitude)) over the energy at rest.
        ends.append(np.arccos(1.0 - (dynamics.energy()[0] + 9.81 / 2) / (9.81 / 2)) / 0.3)
    assert ends[0] == pytest.approx(ends[1], rel=1e-3)
    if scheme != "euler":
        assert ends[0] == pytest.approx(1.0, abs=1e-3)


def test_strut_leaves_an_unstable_state():
    """A clamped strut under four times Euler's load buckles though every step is long against the
    time in which it would by itself."""
    batch = cantilever(21, amplitude=1e-6)
    load = np.zeros((1, 22, 3))
    load[0, -1, 0] = -4 * np.pi**2 / 4
    batch.point_load.assign(load)
    dynamics = Dynamics(batch, scheme="euler", radius=0.01, air_damping=1.0)
    assert not dynamics.advance(8.0, 1.0).diverged.any()
    assert np.linalg.norm(batch.positions()[0, -1, 1:]) > 0.1


def test_diverging_rod_is_cut_out_and_others_go_on():
    """The first rod's gravity throws it farther in the shortest step than Newton can follow."""
    alone, together = cantilever(11), cantilever(11, rod_count=3)
    gravity = np.zeros((3, 3))
    gravity[0, 2] = -1e14
    together.gravity.assign(gravity)
    dynamics = Dynamics(together, radius=0.01, force_scale=1.0)
    result = dynamics.advance(0.1, 0.01)
    assert result.diverged.tolist() == [True, False, False]
    assert result.time[0] < 0.1
    assert result.time[1:] == pytest.approx(0.1)
    assert np.isfinite(together.positions()).all()
    Dynamics(alone, radius=0.01, force_scale=1.0).advance(0.1, 0.01)
    assert np.abs(together.positions()[1:] - alone.positions()).max() < 1e-12


def test_frames_are_recorded_at_their_times():
    import warp as wp

    batch = cantilever(11)
    dynamics = Dynamics(batch, radius=0.01)
    frames = wp.zeros((1, 6, batch.dof_count), dtype=wp.float64, device=batch.device)
    dynamics.advance(0.1, 0.01, frames=frames, frame_interval=0.02)
    film = frames.numpy().copy()
    again = Dynamics(cantilever(11), radius=0.01)
    again.advance(0.06, 0.01)
    assert np.abs(film[0, 3] - again.batch.state.dof.numpy()[0]).max() < 1e-9
    assert np.abs(film[0, 5] - batch.state.dof.numpy()[0]).max() < 1e-12


def test_bad_options_are_refused():
    batch = cantilever(11)
    with pytest.raises(RodError, match="scheme"):
        Dynamics(batch, scheme="magic", radius=0.01)
    with pytest.raises(RodError, match="radius"):
        Dynamics(batch, radius=0.0)
    with pytest.raises(RodError, match="step"):
        Dynamics(batch, radius=0.01).advance(1.0, 0.0)
    massless = RodBatch(
        batch.positions(), stretching_stiffness=1.0, bending_stiffness=1.0, twisting_stiffness=1.0
    )
    with pytest.raises(RodError, match="mass"):
        Dynamics(massless, radius=0.01)
    box = Box(center=(0.0, 0.0, -1.0), half_size=(0.1, 0.1, 0.1))
    with np.errstate(all="raise"):  # equilibria may touch solids without any
        Contact(massless, 0.01, 1.0, Friction(0.3), (box,))


def test_a_step_is_given_up_once_its_residual_cannot_come_down_in_time():
    """By a factor of 4 in each of the iterations that are left, of twelve."""
    dynamics = Dynamics(cantilever(rod_count=4), radius=0.01, tolerance=1e-3)
    for shrinks, given_up in ((np.inf, [0, 0, 0, 1]), (4.0, [0, 1, 1, 1])):
        dynamics.shrinks = shrinks
        for array, values in (
            (dynamics.running, [1, 1, 1, 1]), (dynamics.active, [1, 1, 1, 1]),
            (dynamics.iteration, [9, 9, 2, 12]), (dynamics.step_tolerance, [1e-3] * 4),
            (dynamics.residual, [0.06, 0.07, 1100.0, 2e-3]),
        ):  # fmt: skip
            array.assign(values)
        dynamics._judge(0.02, 1e-6)
        assert dynamics.rejected.numpy().tolist() == given_up
        assert dynamics.iteration.numpy().tolist() == [9 + 1, 10 - given_up[1], 3 - given_up[2], 12]
