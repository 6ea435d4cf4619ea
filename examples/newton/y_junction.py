"""A branched cable, a `newton.Rod` with a junction, swings down from one of its three tips.

Success criteria:
- The hook at the tip carries the weight of all three branches, within 0.5 %.
- The three ends meet at the junction; the two free branches hang alike.
- At the end it is at rest.

Run: `python examples/newton/y_junction.py` (`--viewer null --test` without a display)
"""

import newton
import newton.examples
import numpy as np
import warp as wp

import wrod

EDGES, BRANCH = 12, 0.3  # of a branch; its length [m]
RADIUS, YOUNG, DENSITY = 0.004, 5e6, 1100.0
HEIGHT = 1.0
THIRD = np.deg2rad(120.0)


class Example:
    frame_dt = 1.0 / 60.0
    frame_count = 420

    def __init__(self, viewer, args):
        self.viewer, self.sim_time = viewer, 0.0
        nodes, edges = [np.zeros(3)], []
        for branch in range(3):
            way = np.array([np.cos(branch * THIRD), np.sin(branch * THIRD), 0.0])
            for k in range(1, EDGES + 1):
                edges.append((0 if k == 1 else len(nodes) - 1, len(nodes)))
                nodes.append(way * BRANCH * k / EDGES)
        points = [wp.vec3(*(q + [0.0, 0.0, HEIGHT])) for q in nodes]
        described = newton.Rod(
            points, edges=edges, radius=RADIUS, youngs_modulus=YOUNG, poissons_ratio=0.49
        )
        builder = newton.ModelBuilder()
        wrod.SolverDER.register_custom_attributes(builder)
        self.hook = builder.add_link(xform=wp.transform(points[EDGES]), is_kinematic=True)
        self.rods = wrod.SolverDER.add_newton_rod(
            builder, described, density=DENSITY, air_damping=3.0, internal_damping=0.02
        )
        wrod.SolverDER.attach(builder, self.rods[0], self.hook, node=EDGES, kind="pinned")
        self.model = builder.finalize(device=args.device)
        self.solver = wrod.SolverDER(self.model)
        self.state = self.model.state()
        self.viewer.set_model(self.model)

    def step(self) -> None:
        self.sim_time += self.frame_dt
        self.solver.step(self.state, self.state, None, None, self.frame_dt)

    def render(self) -> None:
        self.viewer.begin_frame(self.sim_time)
        self.viewer.log_state(self.state)
        self.viewer.end_frame()

    def test_final(self) -> None:
        if self.solver.diverged.any():
            raise ValueError("a branch diverged")
        der = self.model.der
        q, first = self.state.der.node_q.numpy(), der.rod_first_node.numpy()[self.rods]
        apart = np.abs(q[first] - q[first[0]]).max()
        if apart > 1e-6:
            raise ValueError(f"the branches are {apart} m apart at the junction")
        joints = np.arange(self.model.body_count) > self.hook
        joints &= self.model.body_flags.numpy() & int(newton.BodyFlags.DYNAMIC) != 0
        mass = der.node_mass.numpy().sum() + self.model.body_mass.numpy()[joints].sum()
        load = -self.solver.body_wrenches()[self.hook, 2]
        if abs(load / (9.81 * mass) - 1.0) > 0.005:
            raise ValueError(f"the hook carries {load} N of {9.81 * mass} N")
        left, right = (q[first[k] : first[k] + EDGES + 1] for k in (1, 2))
        if np.abs(left - right * [1.0, -1.0, 1.0]).max() > 1e-3 * BRANCH:
            raise ValueError("the free branches do not hang alike")
        speed = np.abs(self.state.der.node_qd.numpy()).max()
        if speed > 2e-3:
            raise ValueError(f"a branch still moves at {speed} m/s")


if __name__ == "__main__":
    parser = newton.examples.create_parser()
    parser.set_defaults(num_frames=Example.frame_count)
    viewer, args = newton.examples.init(parser)
    newton.examples.run(Example(viewer, args), args)
