"""The solvers that the cantilever is compared on: `SolverDER`, Newton's cable, PyElastica.

A body-based cable clamps its first segment; the continuum's clamp then stands at that segment's
middle, so the segment begins half its length before the origin. All three place the clamp with an
error of second order.
"""

import numpy as np

from wrod.bench.cantilever import Cantilever, Start

# Kelvin-Voigt time over the period, and drag times the period, that bring it to rest in three.
_INTERNAL, _DRAG = 0.14, 11.0


class Der:
    """`wrod.SolverDER`."""

    name = "SolverDER"

    def __init__(self, problem: Cantilever, edges: int, dt: float, start: Start, device="cpu"):
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
        builder = newton.ModelBuilder()
        SolverDER.register_custom_attributes(builder)
        builder.replicate(world, start.rods)
        model = builder.finalize(device=device)
        self.dt, self.effort, self.device = dt, "to convergence", device
        self._solver = SolverDER(model)
        self._state, self._other = model.state(), model.state()
        self._last = (edges + 1) * (np.arange(start.rods) + 1) - 1

    def advance(self, steps: int) -> None:
        for _ in range(steps):
            self._solver.step(self._state, self._other, None, None, self.dt)
            self._state, self._other = self._other, self._state

    def tips(self) -> np.ndarray:
        return self._state.der.node_q.numpy()[self._last]


class Vbd:
    """Newton's cable under `SolverVBD`, in float32; its steps replayed as a graph.

    Capsules weigh more than the rod's cylinders by their caps: masses and inertias are set to the
    rod's.
    """

    name = "newton SolverVBD"

    def __init__(
        self,
        problem: Cantilever,
        edges: int,
        dt: float,
        start: Start,
        device="cpu",
        iterations: int = 10,
    ):
        import newton
        import warp as wp

        rod, step = problem.rod, problem.length / (edges - 0.5)
        x = (np.arange(edges + 1) - 0.5) * step
        points = np.column_stack([x, 0 * x, 0 * x])
        config = newton.ModelBuilder.ShapeConfig(density=rod.density, has_shape_collision=False)
        world = newton.ModelBuilder(gravity=_gravity(problem, start))
        world.add_rod(
            rod=newton.Rod(
                points,
                radius=rod.radius,
                youngs_modulus=rod.youngs_modulus,
                shear_modulus=rod.youngs_modulus / (2.0 * (1.0 + rod.poisson)),
            ),
            cfg=config,
            bend_damping=_INTERNAL * problem.period * start.damping * rod.bending_stiffness / step,
        )
        world.color()
        builder = newton.ModelBuilder()
        builder.replicate(world, start.rods)
        model = builder.finalize(device=device)
        flags = model.body_flags.numpy()
        flags[::edges] = int(newton.BodyFlags.KINEMATIC)
        model.body_flags.assign(flags)
        ratio = rod.weight / rod.gravity * step / model.body_mass.numpy()
        for name, power in (("mass", 1), ("inertia", 1), ("inv_mass", -1), ("inv_inertia", -1)):
            array = getattr(model, f"body_{name}")
            values = array.numpy()
            array.assign(values * ratio.reshape(-1, *[1] * (values.ndim - 1)) ** power)
        value, slope = problem.mode(0.5 * (x[1:] + x[:-1]))
        speed = np.zeros((edges, 6), dtype=np.float32)
        speed[:, 2] = start.swing * problem.omega * value
        speed[:, 4] = -start.swing * problem.omega * slope
        speed[0] = 0.0
        self.dt, self.effort, self.device = dt, f"{iterations} iterations", device
        self._half = 0.5 * step
        self._rows = edges * (np.arange(start.rods) + 1) - 1
        self._wp = wp
        self._solver = newton.solvers.SolverVBD(model, iterations=iterations)
        self._control = model.control()
        self._states = [model.state(), model.state()]
        self._states[0].body_qd.assign(np.tile(speed, (start.rods, 1)))
        self._graphs, self._compiled = [], False

    def _step(self) -> None:
        self._states[0].clear_forces()
        self._solver.step(*self._states, self._control, None, self.dt)

    def advance(self, steps: int) -> None:
        """Graphs are bound to their arrays: one for the steps there, one for those back."""
        for _ in range(steps):
            if len(self._graphs) == 2:
                self._wp.capture_launch(self._graphs[0])
                self._graphs.reverse()
            elif not self._compiled:
                self._step()
                self._compiled = True
            else:
                with self._wp.ScopedCapture(device=self.device) as capture:
                    self._step()
                self._wp.capture_launch(capture.graph)
                self._graphs.append(capture.graph)
            self._states.reverse()

    def tips(self) -> np.ndarray:
        from scipy.spatial.transform import Rotation

        pose = self._states[0].body_q.numpy()[self._rows].astype(float)
        return pose[:, :3] + Rotation.from_quat(pose[:, 3:]).apply([0.0, 0.0, self._half])


class Elastica:
    """PyElastica's Cosserat rod, explicit position Verlet in float64."""

    name = "PyElastica"

    def __init__(self, problem: Cantilever, edges: int, dt: float, start: Start):
        import elastica

        rod, step = problem.rod, problem.length / (edges - 0.5)

        class Simulator(
            elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping
        ):
            pass

        simulator = Simulator()
        self._rods = []
        for _ in range(start.rods):
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
            self._rods.append(item)
        simulator.finalize()
        self._simulator, self._stepper = simulator, elastica.PositionVerlet()
        self._time = np.float64(0.0)
        self.dt, self.effort, self.device = dt, "explicit", "cpu"

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

    def tips(self) -> np.ndarray:
        return np.array([rod.position_collection[:, -1] for rod in self._rods])


def _gravity(problem: Cantilever, start: Start) -> tuple[float, float, float]:
    return (0.0, 0.0, -problem.rod.gravity * start.gravity)
