"""dismech-newton as a solver of `cosseratbench`: rods whose ends are held or moved, without a turn.

It asks for an older Newton than wrod does, and gives the same digits with ours: install it without
what it depends on.
"""

from importlib.metadata import version

import newton
import numpy as np
import warp as wp
from cosseratbench import Trajectory
from cosseratbench.scenario import Cylinder, End, EndCondition, Rod, Scenario

from wrod.bench.cosserat_solver import Adapter, ghosts_of, with_ghosts


@wp.struct
class _Any:
    value: float


# Its annotations are of a struct or None, which Python evaluates before 3.14.
type(_Any).__or__ = lambda struct, other: struct  # type: ignore[method-assign]
from dismech_newton import DiSMechSolver  # noqa: E402

# Largest step [s], of what moves and of what comes to rest; iterations of a step; damping time of
# bending in the slowest period.
_STEP, _QUIET_STEP, _ITERATIONS, _DAMPING = 2e-3, 5e-3, 10, 0.2


class DismechNewtonSolver(Adapter):
    """`DiSMechSolver`, in float32; with Gauss-Newton steps of the midpoint rule where motion is
    asked for. A clamped end has the segment beyond it that the clamp holds, and bends over half a
    segment."""

    name = "dismech-newton"
    backend_version = version("dismech-newton")

    def settings(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> dict:
        interval = scenario.duration / (n_frames - 1)
        quiet = scenario.quasi_static
        largest = (_QUIET_STEP if quiet else _STEP) * self.time_step_scale
        period = 2.0 * np.pi / scenario.slowest_frequency()
        return {
            "steps_a_frame": int(np.ceil(interval / largest)),
            "iterations": _ITERATIONS,
            "exact": not quiet,
            "theta": 1.0 if quiet else 0.5,
            "bend_damping_time": _DAMPING * period if quiet else 0.0,
        }

    def run(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> Trajectory:
        motions = [rod.motion(end) for rod in scenario.rods for end in End]
        if any(m and (m.slides_along or np.any(m.rotation)) for m in motions):
            raise NotImplementedError("ends that do not turn or slide")
        options = self.settings(scenario, n_elements=n_elements, n_frames=n_frames)
        steps = options["steps_a_frame"]
        dt = scenario.duration / (n_frames - 1) / steps
        return self.play(_Scene(scenario, n_elements, options, dt), scenario, n_frames, steps)


class _Scene:
    """The model of the rods and its states."""

    piece = "node"

    def __init__(self, scenario: Scenario, count: int, options: dict, dt: float):
        self._builder = builder = newton.ModelBuilder(gravity=(0.0, 0.0, -1.0))
        DiSMechSolver.register_custom_attributes(builder)
        self._parts, self._given, places, rest = [], [], [], []
        self._load: list[tuple[int, tuple]] = []
        self._clamped: list[int] = []
        self._driven: list[tuple] = []  # nodes, where they begin, and how they move
        self._time, self._dt = 0.0, dt
        for rod in scenario.rods:
            place, length = self._add(scenario, rod, count, options["bend_damping_time"])
            places.append(place)
            rest.append(length)
        for obstacle in scenario.obstacles:
            _add_obstacle(builder, obstacle)
        self.model = model = builder.finalize()
        model.gravity.fill_(wp.vec3(*scenario.gravity))
        params = model.dismech.triplet_params.numpy()
        params[self._clamped, 1:4] *= 2.0
        params[self._clamped, 6:9] *= 2.0
        model.dismech.triplet_params.assign(params)
        self._solver = DiSMechSolver(
            model, **{name: options[name] for name in ("exact", "iterations", "theta")},
            self_contact=len(scenario.rods) > 1 or scenario.self_contact,
        )  # fmt: skip
        self._states = [model.state(), model.state()]
        # The rods are straight at rest; where they begin is told afterwards.
        self._states[0].particle_q.assign(np.concatenate(places).astype(np.float32))
        self._solver.restart(self._states[0], model.state())
        self._turn = np.zeros(len(np.concatenate(rest)))
        self._turn = _angles(self._axes()[0], self._axes()[1], np.concatenate(self._given))
        force = np.zeros((model.particle_count, 3), dtype=np.float32)
        for node, load in self._load:
            force[node] += load
        for state in self._states:
            state.particle_f.assign(force)

    def _add(self, scenario: Scenario, rod: Rod, count: int, damping: float):
        """Add a rod; (node, 3) where it begins, and (edge,) lengths."""
        builder, material, step = self._builder, rod.material, rod.length / count
        ghosts, (place, director) = ghosts_of(rod), with_ghosts(rod, count)
        edges = len(place) - 1
        way = (place[1] - place[0]) / np.linalg.norm(place[1] - place[0])
        straight = place[0] + np.outer(np.arange(edges + 1) * step, way)
        described = newton.Rod(
            straight.astype(np.float32), radius=rod.radius,
            youngs_modulus=material.youngs_modulus, shear_modulus=material.shear_modulus,
        )  # fmt: skip
        first = builder.particle_count
        bending = material.youngs_modulus * rod.second_moment_of_area / step
        friction = max([rod.friction, *(o.friction for o in scenario.obstacles)])
        bodies = DiSMechSolver.add_rod(
            builder, described, bend_damping=damping * bending,
            cfg=newton.ModelBuilder.ShapeConfig(density=material.density, mu=friction),
        )  # fmt: skip
        bend = first - 2 * len(self._parts)  # a rod has two fewer of them than nodes
        for there, body, where in zip(
            ghosts, (bodies[0], bodies[-1]), (bend, bend + edges - 2), strict=True
        ):
            if there:
                DiSMechSolver.fix_segment(builder, body)
                self._clamped.append(where)
        for end, node in ((End.START, first), (End.END, first + edges)):
            if rod.condition(end) is EndCondition.PINNED:
                builder.particle_flags[node] &= ~newton.ParticleFlags.ACTIVE
        for end, begin in ((End.START, 0), (End.END, edges - 1)):
            if (motion := rod.motion(end)) is not None:
                nodes = np.arange(begin, begin + 2)
                self._driven.append((first + nodes, place[nodes], motion))
        inner = slice(first + ghosts[0], first + edges + 1 - ghosts[1])
        for load in rod.loads:
            self._load.append((inner.start if load.at is End.START else inner.stop - 1, load.force))
        self._parts.append(inner)
        self._given.append(director)
        return place, np.full(edges, step)

    def _axes(self) -> tuple[np.ndarray, np.ndarray]:
        """(edge, 3) tangents, and directors as the solver carries them, turned by its angles."""
        state, model = self._states[0], self.model
        q = state.particle_q.numpy().astype(float)
        ends = [getattr(model.dismech, name).numpy() for name in ("edge_node0", "edge_node1")]
        along = q[ends[1]] - q[ends[0]]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        director = state.dismech.edge_d1_q.numpy().astype(float)
        return along, _turned(along, director, state.dismech.edge_q.numpy() + self._turn)

    def advance(self, count: int) -> None:
        for _ in range(count):
            self._time += self._dt
            if self._driven:
                q = self._states[0].particle_q.numpy()
                for nodes, start, motion in self._driven:
                    q[nodes] = start + motion.pose(self._time)[0]
                self._states[0].particle_q.assign(q)
            self._solver.step(*self._states, None, None, self._dt)
            self._states.reverse()

    def read(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """(node, 3) positions and (edge, 3) directors of every rod, but for what clamps hold."""
        q, director = self._states[0].particle_q.numpy().astype(float), self._axes()[1]
        positions, directors = [], []
        for k, part in enumerate(self._parts):
            positions.append(q[part])
            directors.append(director[part.start - k : part.stop - 1 - k])
        return positions, directors


def _turned(axis: np.ndarray, vector: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(k, 3) vectors across their axes, turned about them."""
    return vector * np.cos(angle)[:, None] + np.cross(axis, vector) * np.sin(angle)[:, None]


def _angles(axis: np.ndarray, vector: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(k,) angles about the axes from vectors to others."""
    return np.arctan2((np.cross(vector, wanted) * axis).sum(axis=1), (vector * wanted).sum(axis=1))


def _add_obstacle(builder: newton.ModelBuilder, obstacle) -> None:
    """A cylinder or a plane that stands."""
    cfg = newton.ModelBuilder.ShapeConfig(mu=obstacle.friction)
    round_one = isinstance(obstacle, Cylinder)
    axis = obstacle.unit_axis if round_one else obstacle.unit_normal
    turn = wp.quat_between_vectors(wp.vec3(0.0, 0.0, 1.0), wp.vec3(*axis))
    if round_one:
        builder.add_shape_cylinder(
            -1, xform=wp.transform(obstacle.center, turn), radius=obstacle.radius,
            half_height=0.5 * obstacle.length, cfg=cfg,
        )  # fmt: skip
    else:
        place = wp.transform(obstacle.point, turn)
        builder.add_shape_plane(None, xform=place, width=0.0, length=0.0, cfg=cfg)
