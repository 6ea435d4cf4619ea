"""A slack cable whose end is turned winds around itself: a plectoneme.

Two hands hold the ends; one comes nearer, then turns. The link that it puts in is kept: twist of
the material plus writhe of the centreline equals the turns (Calugareanu), unless strands pass
through each other, which changes it by two.

Success criteria:
- Twist plus writhe is the number of turns, within 1e-6; a third of it or more is writhe.
- Strands are wound around each other, and sink in by at most 5 % of their radius.

Run: `python examples/newton/plectoneme.py` (`--viewer null --test` without a display)
"""

import newton
import newton.examples
import numpy as np
import warp as wp

import wrod

LENGTH, EDGES, RADIUS = 0.5, 60, 0.002
SLACK, TURNS = 0.2, 6.0  # [m], of the hand
NEARING, TURNING, RESTING = 1.0, 6.0, 2.0  # [s]


def smooth(x: float) -> float:
    x = min(max(x, 0.0), 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-300)


def writhe(q: np.ndarray) -> float:
    """Writhe of a polygon: signed solid angles of pairs of edges (Klenin and Langowski 2000)."""
    i, j = np.triu_indices(len(q) - 1, 2)
    a, b, c, d = q[i], q[i + 1], q[j], q[j + 1]
    corners = c - a, d - a, d - b, c - b
    n = [unit(np.cross(corners[k], corners[(k + 1) % 4])) for k in range(4)]
    angles = sum(
        np.arcsin(np.clip(np.sum(n[k] * n[(k + 1) % 4], axis=1), -1.0, 1.0)) for k in range(4)
    )
    sign = np.sign(np.sum(np.cross(d - c, b - a) * (c - a), axis=1))
    return float(np.sum(sign * angles) / (2.0 * np.pi))


def twist(q: np.ndarray, director: np.ndarray) -> float:
    """Turns of directors (edge, 3) about the edges, against carrying them from edge to edge."""
    t = unit(np.diff(q, axis=0))
    axis = np.cross(t[:-1], t[1:])
    cosine = np.sum(t[:-1] * t[1:], axis=1)[:, None]
    d = director[:-1]
    along = np.sum(axis * d, axis=1)[:, None] / (1.0 + cosine)
    carried = cosine * d + np.cross(axis, d) + along * axis
    across = np.sum(np.cross(carried, director[1:]) * t[1:], axis=1)
    return float(np.sum(np.arctan2(across, np.sum(carried * director[1:], axis=1))) / (2 * np.pi))


class Example:
    frame_dt = 1.0 / 60.0
    frame_count = round((NEARING + TURNING + RESTING) / frame_dt)

    def __init__(self, viewer, args):
        self.viewer, self.sim_time, self.deepest = viewer, 0.0, 0.0
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
        wrod.SolverDER.register_custom_attributes(builder)
        t = np.linspace(0.0, 1.0, EDGES + 1)
        points = np.column_stack([LENGTH * t, 0 * t, 1e-3 * np.sin(np.pi * t) ** 2])
        material = wrod.RodMaterial.from_youngs_modulus(2e7, RADIUS, LENGTH, density=1150.0)
        ends = [
            builder.add_link(xform=wp.transform(wp.vec3(*points[k])), is_kinematic=True)
            for k in (0, -1)
        ]
        self.hand = ends[1]
        wrod.SolverDER.add_rod(
            builder, points, material, start="clamped", start_body=ends[0], end="clamped",
            end_body=ends[1], air_damping=4.0, internal_damping=0.01, color=(0.2, 0.5, 0.7),
            rest_length=LENGTH / EDGES, natural_curvature=np.zeros(2),
        )  # fmt: skip
        self.model = builder.finalize(device=args.device)
        self.solver = wrod.SolverDER(self.model, self_contact=0.1)
        self.state = self.model.state()
        self.held = self.state.der.edge_director.numpy()[[0, -1]].astype(float)
        self.viewer.set_model(self.model)

    def step(self) -> None:
        self.sim_time += self.frame_dt
        half = np.pi * TURNS * smooth((self.sim_time - NEARING) / TURNING)
        poses = self.state.body_q.numpy()
        poses[self.hand, 0] = LENGTH - SLACK * smooth(self.sim_time / NEARING)
        poses[self.hand, 3:] = [np.sin(half), 0.0, 0.0, np.cos(half)]
        self.state.body_q.assign(poses)
        self.solver.step(self.state, self.state, None, None, self.frame_dt)
        self.deepest = max(self.deepest, float(self.solver.penetration().max()))

    def render(self) -> None:
        self.viewer.begin_frame(self.sim_time)
        self.viewer.log_state(self.state)
        self.viewer.end_frame()

    def test_final(self) -> None:
        if self.solver.diverged.any():
            raise ValueError("the cable diverged")
        # The hands go on straight for ever; turns of the second are whole.
        q = self.state.der.node_q.numpy().astype(float)
        far = np.array([1e4 * LENGTH, 0.0, 0.0])
        q = np.concatenate([q[:1] - far, q, q[-1:] + far])
        directors = self.state.der.edge_director.numpy().astype(float)
        turned = twist(q, np.concatenate([self.held[:1], directors, self.held[1:]]))
        wound = writhe(q)
        if abs(abs(turned + wound) - TURNS) > 1e-6:
            raise ValueError(f"twist {turned} and writhe {wound} are not {TURNS} turns")
        if abs(wound) < TURNS / 3.0:
            raise ValueError(f"only {wound} of {TURNS} turns are writhe")
        if not 0.0 < self.deepest < 0.05 * RADIUS:
            raise ValueError(f"the cable was {self.deepest} m inside itself")


if __name__ == "__main__":
    parser = newton.examples.create_parser()
    parser.set_defaults(num_frames=Example.frame_count)
    viewer, args = newton.examples.init(parser)
    newton.examples.run(Example(viewer, args), args)
