"""Newton's own cable as a solver of `cosseratbench`, for what hangs: no contact, no driven ends."""

from importlib.metadata import version

import newton
import numpy as np
import warp as wp
from cosseratbench import Capability, Trajectory
from cosseratbench.scenario import End, EndCondition, Scenario
from scipy.spatial.transform import Rotation

from wrod.bench.cosserat_solver import Adapter
from wrod.bench.newton_held import Graphed, weigh

# Largest step [s], iterations of a step; damping time of bending in the slowest period.
_STEP, _ITERATIONS, _DAMPING = 1.0 / 600.0, 20, 0.14


class VbdSolver(Adapter):
    """`newton.Rod` under `SolverVBD`, in float32: capsules of the rod's mass, joined by rod joints.

    The middle of a clamped segment is where the clamp is; a pinned end is a ball joint.
    """

    name = "newton-vbd"
    backend_version = version("newton")
    capabilities = frozenset({Capability.STRETCH, Capability.SHEAR})

    def settings(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> dict:
        interval = scenario.duration / (n_frames - 1)
        steps = 2 * int(np.ceil(0.5 * interval / (_STEP * self.time_step_scale)))
        period = 2.0 * np.pi / scenario.slowest_frequency()
        damping = _DAMPING * period if scenario.quasi_static else 0.0
        return {"steps_a_frame": steps, "iterations": _ITERATIONS, "bend_damping_time": damping}

    def run(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> Trajectory:
        if len(scenario.rods) != 1 or scenario.rods[0].motion(End.START) is not None:
            raise NotImplementedError("one rod, held still")
        options = self.settings(scenario, n_elements=n_elements, n_frames=n_frames)
        steps = options["steps_a_frame"]
        dt = scenario.duration / (n_frames - 1) / steps
        scene = _Scene(scenario, n_elements, options["bend_damping_time"], dt)
        return self.play(scene, scenario, n_frames, steps)


class _Scene(Graphed):
    """The model of one rod and its states."""

    piece = "body"

    def __init__(self, scenario: Scenario, count: int, damping: float, dt: float):
        rod = self._rod = scenario.rods[0]
        held = rod.start is EndCondition.CLAMPED
        if rod.end is EndCondition.CLAMPED:
            raise NotImplementedError("a rod that is clamped at its end")
        edge = rod.length / (count - 0.5 * held)
        points = rod.nodes(count)
        if held:
            way = (points[1] - points[0]) / np.linalg.norm(points[1] - points[0])
            points = points[0] + np.outer((np.arange(count + 1) - 0.5) * edge, way)
        builder = newton.ModelBuilder(gravity=scenario.gravity)
        material, area = rod.material, rod.area
        ends = np.outer(np.arange(count + 1) * edge, [0.0, 0.0, 1.0])
        described = newton.Rod(
            points.astype(np.float32), rest_points=ends.astype(np.float32), radius=rod.radius,
            youngs_modulus=material.youngs_modulus, shear_modulus=material.shear_modulus,
        )  # fmt: skip
        bending = material.youngs_modulus * rod.second_moment_of_area / edge
        bodies, _ = builder.add_rod(
            rod=described, bend_damping=damping * bending,
            cfg=newton.ModelBuilder.ShapeConfig(
                density=material.density, has_shape_collision=False
            ),
        )  # fmt: skip
        for condition, body, side in ((rod.start, bodies[0], -1), (rod.end, bodies[-1], 1)):
            if condition is EndCondition.PINNED:
                at = wp.transform(tuple(points[0 if side < 0 else -1]), wp.quat_identity())
                inside = wp.transform((0.0, 0.0, 0.5 * side * edge), wp.quat_identity())
                builder.add_joint_ball(-1, body, parent_xform=at, child_xform=inside)
        builder.color()
        self.model = model = builder.finalize()
        weigh(model, material.density * area * edge)
        if held:
            flags = model.body_flags.numpy()
            flags[bodies[0]] = int(newton.BodyFlags.KINEMATIC)
            model.body_flags.assign(flags)
        self._solver = newton.solvers.SolverVBD(model, iterations=_ITERATIONS)
        self._states, self._control = [model.state(), model.state()], model.control()
        self._half, self._dt, self._origin = 0.5 * edge, dt, points[0] if not held else None
        self._clamp = rod.nodes(1)[0]
        pose = self._states[0].body_q.numpy().astype(float)
        given = rod.directors(count)
        self._director = Rotation.from_quat(pose[:, 3:]).inv().apply(given)

    def advance(self, steps: int) -> None:
        """Under the loads at the ends, as the rod lies now."""
        force = np.zeros((self.model.body_count, 6), dtype=np.float32)
        pose = self._states[0].body_q.numpy()
        for load in self._rod.loads:
            k, side = (-1, 1.0) if load.at is End.END else (0, -1.0)
            arm = Rotation.from_quat(pose[k, 3:]).apply([0.0, 0.0, side * self._half])
            force[k] += [*load.force, *np.cross(arm, load.force)]
        for state in self._states:
            state.body_f.assign(force)
        super().advance(steps)

    def _step(self) -> None:
        self._solver.step(*self._states, self._control, None, self._dt)

    def read(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """(node, 3) positions and (edge, 3) directors; a clamp's node is at the clamp."""
        pose = self._states[0].body_q.numpy().astype(float)
        turn = Rotation.from_quat(pose[:, 3:])
        ahead = turn.apply([0.0, 0.0, self._half])
        first = pose[:1, :3] - ahead[:1] if self._origin is not None else self._clamp[None]
        return [np.concatenate([first, pose[:, :3] + ahead])], [turn.apply(self._director)]
