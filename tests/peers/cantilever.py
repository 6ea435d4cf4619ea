"""A problem with known answers that SolverDER and PyElastica are compared on: a heavy cantilever.

At rest it is the heavy elastica (clamped level, bent by its weight, slightly stretched); without
gravity it swings at a closed-form frequency.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wrod.rods.material import RodMaterial

# First root of cos(x) cosh(x) = -1.
_ROOT = 1.875104068711961
# Kelvin-Voigt time over the period, and drag times the period, that bring it to rest in three.
_INTERNAL, _DRAG = 0.14, 11.0


@dataclass(frozen=True)
class Cantilever:
    """A rod of `length` [m] clamped at the origin along x; gravity acts along -z."""

    rod: RodMaterial
    length: float

    @cached_property
    def tip(self) -> np.ndarray:
        """(3,) tip of the continuous rod at rest [m]: B theta'' = w (L - s) (1 + e) cos(theta),
        stretched by e = -w (L - s) sin(theta) / EA; by collocation."""
        from scipy.integrate import solve_bvp

        scale = self.length**3 * self.rod.weight / self.rod.bending_stiffness
        softness = self.rod.weight * self.length / self.rod.stretching_stiffness

        def rhs(s, y):
            theta, bend = y[:2]
            stretch = 1.0 - softness * (1.0 - s) * np.sin(theta)
            return np.stack(
                [
                    bend,
                    scale * (1.0 - s) * stretch * np.cos(theta),
                    stretch * np.cos(theta),
                    stretch * np.sin(theta),
                ]
            )

        def ends(a, b):
            return np.array([a[0], b[1], a[2], a[3]])

        s = np.linspace(0.0, 1.0, 400)
        guess = np.stack([-1.4 * (1.0 - np.exp(-3.0 * s)), 0 * s, 0.4 * s, -0.8 * s])
        found = solve_bvp(rhs, ends, s, guess, tol=1e-9, max_nodes=10000)
        assert found.success, found.message
        x, z = self.length * found.y[2:, -1]
        return np.array([x, 0.0, z])

    @property
    def omega(self) -> float:
        """First angular frequency without gravity [rad/s]."""
        line = self.rod.weight / self.rod.gravity
        return _ROOT**2 * np.sqrt(self.rod.bending_stiffness / line) / self.length**2

    @property
    def period(self) -> float:
        return 2.0 * np.pi / self.omega

    def mode(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First mode and its slope at x [m], 1 at the tip; zero inside the clamp."""
        u = _ROOT * np.maximum(x, 0.0) / self.length
        ratio = (np.sinh(_ROOT) - np.sin(_ROOT)) / (np.cosh(_ROOT) + np.cos(_ROOT))
        value = np.cosh(u) - np.cos(u) - ratio * (np.sinh(u) - np.sin(u))
        slope = np.sinh(u) + np.sin(u) - ratio * (np.cosh(u) - np.cos(u))
        return value / 2.0, slope * _ROOT / self.length / 2.0


@dataclass(frozen=True)
class Start:
    """How a cantilever begins: straight and level.

    Attributes:
        gravity: whether its weight acts.
        damping: rate at which its motion is damped, near critical, so that it comes to rest.
        swing: amplitude of the first mode that its velocity starts [m].
    """

    gravity: bool = True
    damping: bool = True
    swing: float = 0.0


def come_to_rest(solver, problem: Cantilever, duration: float) -> float:
    """Simulate `duration` [s] from the straight start; how far the tip still moves at the end, over
    the length and per second."""
    first, last = (round(f * duration / solver.dt) for f in (0.95, 0.05))
    solver.advance(first)
    before = solver.tip()
    solver.advance(last)
    return np.linalg.norm(solver.tip() - before) / problem.length / (last * solver.dt)


def frequency_error(solver, problem: Cantilever, periods: float) -> float:
    """Relative, from the zero crossings of the tip that swings."""
    every = max(round(problem.period / 40 / solver.dt), 1)
    heights = [solver.tip()[2]]
    for _ in range(int(np.ceil(periods * problem.period / (every * solver.dt)))):
        solver.advance(every)
        heights.append(solver.tip()[2])
    z = np.array(heights)
    i = np.flatnonzero(z[1:-1] * z[2:] < 0) + 1
    crossings = (i + z[i] / (z[i] - z[i + 1])) * every * solver.dt
    return np.pi / np.diff(crossings).mean() / problem.omega - 1.0


class Der:
    """`wrod.SolverDER`."""

    def __init__(self, problem: Cantilever, edges: int, dt: float, start: Start):
        import newton

        from wrod.newton_solver import SolverDER

        x = np.linspace(0.0, problem.length, edges + 1)
        points = np.column_stack([x, 0 * x, 0 * x])
        velocity = np.zeros_like(points)
        velocity[:, 2] = start.swing * problem.omega * problem.mode(x)[0]
        world = newton.ModelBuilder(gravity=_gravity(problem, start))
        SolverDER.register_custom_attributes(world)
        SolverDER.add_rod(
            world, points, problem.rod, start="clamped", velocity=velocity, visible=False,
            air_damping=_DRAG / problem.period * start.damping,
            internal_damping=0.2 * _INTERNAL * problem.period * start.damping,
        )  # fmt: skip
        model = world.finalize(device="cpu")
        self.dt = dt
        self._solver = SolverDER(model)
        self._state, self._other = model.state(), model.state()

    def advance(self, steps: int) -> None:
        for _ in range(steps):
            self._solver.step(self._state, self._other, None, None, self.dt)
            self._state, self._other = self._other, self._state

    def tip(self) -> np.ndarray:
        return self._state.der.node_q.numpy()[-1]


class Elastica:
    """PyElastica's Cosserat rod, explicit position Verlet in float64."""

    def __init__(self, problem: Cantilever, edges: int, dt: float, start: Start):
        import elastica

        rod, step = problem.rod, problem.length / (edges - 0.5)

        class Simulator(
            elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping
        ):
            pass

        simulator = Simulator()
        item = elastica.CosseratRod.straight_rod(
            edges,
            np.array([-0.5 * step, 0.0, 0.0]),
            np.array([1.0, 0.0, 0.0]),
            np.array([0.0, 1.0, 0.0]),
            edges * step,
            rod.radius,
            rod.density,
            youngs_modulus=rod.youngs_modulus,
            shear_modulus=rod.youngs_modulus / (2.0 * (1.0 + rod.poisson)),
        )
        nodes = (np.arange(edges + 1) - 0.5) * step
        value = problem.mode(nodes)[0]
        slope = problem.mode(0.5 * (nodes[1:] + nodes[:-1]))[1]
        item.velocity_collection[2] = start.swing * problem.omega * value
        spin = np.zeros((edges, 3))
        spin[1:, 1] = -start.swing * problem.omega * slope[1:]
        item.omega_collection[:] = np.einsum("ijk,kj->ik", item.director_collection, spin)
        simulator.append(item)
        simulator.constrain(item).using(
            elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
        )
        if start.gravity:
            simulator.add_forcing_to(item).using(
                elastica.GravityForces, acc_gravity=np.array(_gravity(problem, start))
            )
        if start.damping:
            simulator.dampen(item).using(
                elastica.AnalyticalLinearDamper,
                uniform_damping_constant=_DRAG / problem.period,
                time_step=dt,
            )
        simulator.finalize()
        self._simulator, self._stepper = simulator, elastica.PositionVerlet()
        self._time = np.float64(0.0)
        self.dt, self._rod = dt, item

    @staticmethod
    def stable_step(problem: Cantilever, edges: int) -> float:
        """What explicit steps stay stable at [s]: a fraction of the time in which sound crosses an
        edge, or shear turns a section."""
        rod = problem.rod
        sound = np.sqrt(rod.youngs_modulus / rod.density)
        shear = sound / np.sqrt(2.0 * (1.0 + rod.poisson))
        return 0.5 * min(problem.length / edges / sound, rod.radius / shear)

    def advance(self, steps: int) -> None:
        for _ in range(steps):
            self._time = self._stepper.step(self._simulator, self._time, self.dt)

    def tip(self) -> np.ndarray:
        return self._rod.position_collection[:, -1]


def _gravity(problem: Cantilever, start: Start) -> tuple[float, float, float]:
    return (0.0, 0.0, -problem.rod.gravity * start.gravity)
