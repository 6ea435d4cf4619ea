"""Cables under Newton's own solver, SolverVBD, for `beside_vbd.py`."""

import newton
import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from wrod.bench.newton_piles import deepest_of

SUBSTEPS, FRAME = 10, 1.0 / 60.0


@wp.kernel
def drag(
    rate: float,
    mass: wp.array[float],
    speed: wp.array[wp.spatial_vector],
    force: wp.array[wp.spatial_vector],
):
    b = wp.tid()
    v = -rate * mass[b] * wp.spatial_top(speed[b])
    force[b] = wp.spatial_vector(v[0], v[1], v[2], 0.0, 0.0, 0.0)


class Vbd:
    """Cables under SolverVBD; add them, `begin`, and step.

    Attributes:
        bodies: those of each cable; state: at the end of the last frame.
    """

    def __init__(self, args, air: float, gravity: float = 9.81):
        self.builder = newton.ModelBuilder(gravity=(0.0, 0.0, -gravity))
        self.builder.rigid_gap = 0.002
        self.bodies: list[list[int]] = []
        self._iterations, self._air, self._mass = args.iterations, air, {}
        self._device = args.device

    def add(self, points, young, radius, line_mass, *, damping=0.0, mu=None, edges=None) -> list:
        """A cable that is straight at rest; damping is Kelvin-Voigt's time [s]."""
        points = np.asarray(points, dtype=float)
        rod = newton.Rod(
            [wp.vec3(*p) for p in points], edges=edges, radius=radius, rest_straight=edges is None
        )
        lengths = [np.linalg.norm(points[b] - points[a]) for a, b in rod.edges]
        edge, area = np.mean(lengths), np.pi * radius**2
        bending = young * area * radius**2 / 4.0 / edge
        config = newton.ModelBuilder.ShapeConfig(
            ke=1e5, kd=0.0, mu=mu or 0.0, has_shape_collision=mu is not None
        )
        bodies, _ = self.builder.add_rod(
            rod=rod, cfg=config, stretch_stiffness=young * area / edge, bend_stiffness=bending,
            twist_stiffness=2.0 / 3.0 * bending, bend_damping=damping * bending,
            twist_damping=damping * bending,
        )  # fmt: skip
        self._mass |= dict(zip(bodies, line_mass * np.array(lengths), strict=True))
        self.bodies.append(list(bodies))
        return self.bodies[-1]

    def guide(self, body: int) -> None:
        """Let an edge turn about its axis alone."""
        at = wp.transform(*self.builder.body_q[body][:])
        self.builder.add_joint_revolute(-1, body, parent_xform=at, axis=wp.vec3(0.0, 0.0, 1.0))

    def begin(self, held=()) -> None:
        self.builder.color()
        self.model = model = self.builder.finalize(device=self._device)
        # Capsules weigh more than a cable's cylinders, by their caps.
        ratio, cable = np.ones(model.body_count), np.zeros(model.body_count)
        bodies = list(self._mass)
        cable[bodies] = list(self._mass.values())
        ratio[bodies] = cable[bodies] / model.body_mass.numpy()[bodies]
        self._cable = wp.array(cable, dtype=float, device=self._device)
        for name, power in (("mass", 1), ("inertia", 1), ("inv_mass", -1), ("inv_inertia", -1)):
            array = getattr(model, f"body_{name}")
            values = array.numpy()
            array.assign(values * ratio.reshape(-1, *[1] * (values.ndim - 1)) ** power)
        flags = model.body_flags.numpy()
        flags[list(held)] = int(newton.BodyFlags.KINEMATIC)
        model.body_flags.assign(flags)
        self._solver = newton.solvers.SolverVBD(
            model, iterations=self._iterations, rigid_contact_history=True,
            rigid_body_contact_buffer_size=256,
        )  # fmt: skip
        self.state, self._other, self._control = model.state(), model.state(), model.control()
        self._detection = newton.CollisionPipeline(model, contact_matching="latest")
        self._contacts, self._graph = self._detection.contacts(), None

    def step(self, poses=None) -> None:
        """A frame; `poses` {body: pose} of kinematic ones, carried there in its first step."""
        for state in (self.state, self._other):
            q = state.body_q.numpy().copy()
            for body, pose in (poses or {}).items():
                q[body] = pose
            state.body_q.assign(q)
        if self._graph is not None:
            wp.capture_launch(self._graph)
            return
        self._take_steps()  # compiles
        with wp.ScopedCapture(self._device) as capture:
            self._take_steps()
        self._graph = capture.graph

    def _take_steps(self) -> None:
        """An even number, so that the graph ends in the state that it began with."""
        for _ in range(SUBSTEPS):
            self._detection.collide(self.state, self._contacts)
            wp.launch(
                drag, self.model.body_count,
                [self._air, self._cable, self.state.body_qd], [self.state.body_f],
                device=self._device,
            )  # fmt: skip
            self._solver.step(
                self.state, self._other, self._control, self._contacts, FRAME / SUBSTEPS
            )
            self.state, self._other = self._other, self.state

    def deepest(self, radius: float) -> float:
        """Overlap of the cables over their radius."""
        return deepest_of([self.line(c) for c in range(len(self.bodies))], radius)

    def ends(self, cable: int) -> np.ndarray:
        """(edge, 2, 3) where the edges of a cable begin and end."""
        pose = self.state.body_q.numpy()[self.bodies[cable]].astype(float)
        shapes = [self.model.body_shapes[b][0] for b in self.bodies[cable]]
        half = self.model.shape_scale.numpy()[shapes, 1]
        ahead = Rotation.from_quat(pose[:, 3:]).apply([0.0, 0.0, 1.0]) * half[:, None]
        return np.stack([pose[:, :3] - ahead, pose[:, :3] + ahead], axis=1)

    def line(self, cable: int) -> np.ndarray:
        """(node, 3) of a cable without branches."""
        ends = self.ends(cable)
        return np.concatenate([ends[:1, 0], ends[:, 1]])
