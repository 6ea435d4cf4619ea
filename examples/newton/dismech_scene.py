"""Cables under dismech-newton, for `beside_vbd.py`: `pip install --no-deps dismech-newton`."""

import newton
import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation
from vbd_scene import FRAME, SUBSTEPS, Vbd

# Its annotations are of a struct or None, which Python evaluates before 3.14.
type(wp.struct(type("_Any", (), {"__annotations__": {"x": float}}))).__or__ = lambda struct, _: (
    struct
)
from dismech_newton import DiSMechSolver  # noqa: E402


@wp.kernel
def drag(
    rate: float,
    mass: wp.array[float],
    speed: wp.array[wp.vec3],
    force: wp.array[wp.vec3],
):
    i = wp.tid()
    force[i] = -rate * mass[i] * speed[i]


class Dismech(Vbd):
    """As `Vbd`: chains that are straight at rest, of which held bodies are segments."""

    def __init__(self, args, air: float, gravity: float = 9.81):
        super().__init__(args, air, gravity)
        DiSMechSolver.register_custom_attributes(self.builder)
        self._places: list[np.ndarray] = []

    def add(self, points, young, radius, line_mass, *, damping=0.0, mu=None) -> list:
        points, area = np.asarray(points, dtype=float), np.pi * radius**2
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        along = np.append(0.0, lengths.cumsum())[:, None] * (points[1] - points[0]) / lengths[0]
        bending = young * area * radius**2 / 4.0 / lengths.mean()
        config = newton.ModelBuilder.ShapeConfig(density=line_mass / area, mu=mu or 0.0)
        bodies = DiSMechSolver.add_rod(
            self.builder, newton.Rod((points[0] + along).astype(np.float32), radius=radius),
            cfg=config, stretch_stiffness=young * area / lengths.mean(), bend_stiffness=bending,
            twist_stiffness=2.0 / 3.0 * bending, bend_damping=damping * bending,
            collide=mu is not None,
        )  # fmt: skip
        self._places.append(points)
        self.bodies.append(list(bodies))
        return self.bodies[-1]

    def guide(self, body: int) -> None:
        own = self.builder.custom_attributes
        edge = own["dismech:edge_body"].values.index(body)
        for name in ("edge_node0", "edge_node1"):
            node = own[f"dismech:{name}"].values[edge]
            self.builder.particle_flags[node] &= ~newton.ParticleFlags.ACTIVE

    def begin(self, held=()) -> None:
        segments = {body for cable in self.bodies for body in cable}
        for body in segments.intersection(held):
            DiSMechSolver.fix_segment(self.builder, body)
        for body in set(held) - segments:
            self.builder.body_flags[body] = int(newton.BodyFlags.KINEMATIC)
        self.model = model = self.builder.finalize(device=self._device)
        self._solver = DiSMechSolver(model, iterations=self._iterations)
        self.state, self._other = model.state(), model.state()
        self.state.particle_q.assign(np.concatenate(self._places).astype(np.float32))
        self._solver.restart(self.state, model.state())
        self._solver.update_proxies(self.state)
        self._edges = {int(b): e for e, b in enumerate(model.dismech.edge_body.numpy())}
        self._held = {b: self.state.body_q.numpy()[b].astype(float) for b in held}

    def step(self, poses=None) -> None:
        self._there = wp.clone(self.state.body_q)
        for k in range(SUBSTEPS):
            for body, pose in (poses or {}).items():
                if body not in self._edges:
                    self._push(body, np.asarray(pose, dtype=float), (k + 1) / SUBSTEPS)
                elif k == 0:
                    self._carry(body, np.asarray(pose, dtype=float))
            model, state = self.model, self.state
            inputs = [self._air, model.particle_mass, state.particle_qd]
            wp.launch(drag, model.particle_count, inputs, [state.particle_f], device=self._device)
            self._solver.step(state, self._other, None, None, FRAME / SUBSTEPS)
            self.state, self._other = self._other, state

    def _push(self, body: int, pose: np.ndarray, part: float) -> None:
        """Put an obstacle to its place after a part of the frame, at its speed."""
        before, q, speed = (x.numpy() for x in (self._there, self.state.body_q, self.state.body_qd))
        way = pose[:3] - before[body, :3]
        q[body, :3] = before[body, :3] + part * way
        speed[body, :3] = way / FRAME
        self.state.body_q.assign(q)
        self.state.body_qd.assign(speed)

    def _carry(self, body: int, pose: np.ndarray) -> None:
        """Put the nodes and the turn of a held segment to where its body is."""
        der, e, before = self.model.dismech, self._edges[body], self._held[body]
        nodes = [int(getattr(der, name).numpy()[e]) for name in ("edge_node0", "edge_node1")]
        turn = Rotation.from_quat(pose[3:])
        axis = turn.apply([0.0, 0.0, 1.0])
        half = 0.5 * float(der.edge_length.numpy()[e]) * axis
        q, angle = self.state.particle_q.numpy(), self.state.dismech.edge_q.numpy()
        q[nodes] = pose[:3] - half, pose[:3] + half
        angle[e] += axis @ (turn * Rotation.from_quat(before[3:]).inv()).as_rotvec()
        self.state.particle_q.assign(q)
        self.state.dismech.edge_q.assign(angle)
        self._held[body] = pose
