"""Cables fall onto the ground and onto each other.

Success criteria:
- No cable sinks into another by more than 5 % of its radius, ever.
- The ground carries the weight of all; none has fallen through.
- At the end they are at rest.

Run: `python examples/newton/cable_pile.py` (`--viewer null --test` without a display)
"""

import newton
import newton.examples
import numpy as np

import wrod

RADIUS, LENGTH, EDGES = 0.004, 0.3, 20
COUNT = 8


class Example:
    frame_dt = 1.0 / 60.0
    frame_count = 210

    def __init__(self, viewer, args):
        self.viewer, self.sim_time, self.deepest = viewer, 0.0, 0.0
        builder = newton.ModelBuilder()
        wrod.SolverDER.register_custom_attributes(builder)
        builder.default_shape_cfg.mu = 0.6
        builder.add_ground_plane()
        self.material = wrod.RodMaterial(RADIUS, 0.06, LENGTH)
        arc = np.linspace(-0.5 * LENGTH, 0.5 * LENGTH, EDGES + 1)
        for k in range(COUNT):
            turn = k * np.pi * (3.0 - np.sqrt(5.0))
            points = np.outer(arc, [np.cos(turn), np.sin(turn), 0.0])
            points[:, 2] += (2.0 + 3.0 * k) * RADIUS
            wrod.SolverDER.add_rod(
                builder, points, self.material, air_damping=0.5, internal_damping=0.005,
                color=(0.2 + 0.08 * k, 0.35, 0.75 - 0.06 * k),
            )  # fmt: skip
        self.model = builder.finalize(device=args.device)
        self.solver = wrod.SolverDER(self.model, rod_contact=0.4)
        self.state = self.model.state()
        self.viewer.set_model(self.model)

    def step(self) -> None:
        self.sim_time += self.frame_dt
        self.solver.step(self.state, self.state, None, None, self.frame_dt)
        self.deepest = max(self.deepest, float(self.solver.penetration().max()))

    def render(self) -> None:
        self.viewer.begin_frame(self.sim_time)
        self.viewer.log_state(self.state)
        self.viewer.end_frame()

    def test_final(self) -> None:
        if self.solver.diverged.any():
            raise ValueError("a cable diverged")
        if self.deepest > 0.05 * RADIUS:
            raise ValueError(f"a cable was {self.deepest} m inside another")
        q, velocity = self.state.der.node_q.numpy(), self.state.der.node_qd.numpy()
        if q[:, 2].min() < 0.9 * RADIUS or q[:, 2].max() < 3.0 * RADIUS:
            raise ValueError(f"cables lie from {q[:, 2].min()} to {q[:, 2].max()} m")
        carried = self.state.der.node_contact_f.numpy()[:, 2].sum()
        weight = COUNT * self.material.weight * LENGTH
        if abs(carried / weight - 1.0) > 0.02:
            raise ValueError(f"the ground carries {carried} N of {weight} N")
        if np.abs(velocity).max() > 0.02:
            raise ValueError(f"a cable still moves at {np.abs(velocity).max()} m/s")


if __name__ == "__main__":
    parser = newton.examples.create_parser()
    parser.set_defaults(num_frames=Example.frame_count)
    viewer, args = newton.examples.init(parser)
    newton.examples.run(Example(viewer, args), args)
