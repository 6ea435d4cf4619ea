"""A crane lifts a beam by two cables and carries it aside: free bodies pull back.

The hook is kinematic; the beam is a free body that SolverDER moves with the cables, in one step.

Success criteria:
- The beam has gone up and aside with the hook, and hangs below it.
- What the cables do to the hook is the weight of beam and cables, within 1 %.
- Nothing is stretched by more than its tension explains.

Run: `python examples/newton/crane.py` (`--viewer null --test` without a display)
"""

import newton
import newton.examples
import numpy as np
import warp as wp

import wrod

LIFT, ASIDE = 0.3, 0.4  # way of the hook [m]
MOVING, RESTING = 2.5, 3.5  # [s]
MASS, EDGES, LENGTH = 0.5, 15, 0.4  # of the beam [kg]; of a cable, and its length [m]
SIDES = (0.4, 0.03, 0.03)


def smooth(x: float) -> float:
    x = min(max(x, 0.0), 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


class Example:
    frame_dt = 1.0 / 60.0
    frame_count = round((MOVING + RESTING) / frame_dt)

    def __init__(self, viewer, args):
        self.viewer, self.sim_time = viewer, 0.0
        self.material = wrod.RodMaterial.from_youngs_modulus(2e8, 0.003, LENGTH, density=1150.0)
        builder = newton.ModelBuilder()
        wrod.SolverDER.register_custom_attributes(builder)
        cfg = newton.ModelBuilder.ShapeConfig(density=0.0, has_shape_collision=False)
        self.start = np.array([0.0, 0.0, 0.8])
        self.hook = builder.add_link(
            xform=wp.transform(wp.vec3(*self.start), wp.quat_identity()),
            is_kinematic=True, label="hook",
        )  # fmt: skip
        builder.add_shape_sphere(self.hook, radius=0.02, cfg=cfg)
        square = np.square(SIDES)
        inertia = MASS / 12.0 * np.diag(square.sum() - square)
        self.beam = builder.add_body(
            xform=wp.transform((0.0, 0.0, 0.5), wp.quat_identity()), mass=MASS,
            inertia=wp.mat33(*inertia.ravel()), label="beam",
        )  # fmt: skip
        builder.add_shape_box(self.beam, hx=SIDES[0] / 2, hy=SIDES[1] / 2, hz=SIDES[2] / 2, cfg=cfg)
        for x in (-0.18, 0.18):
            ends = self.start, np.array([x, 0.0, 0.515])
            points = ends[0] + np.linspace(0.0, 1.0, EDGES + 1)[:, None] * (ends[1] - ends[0])
            wrod.SolverDER.add_rod(
                builder, points, self.material, start="pinned", start_body=self.hook,
                end="pinned", end_body=self.beam, internal_damping=0.01, air_damping=0.3,
            )  # fmt: skip
        self.model = builder.finalize(device=args.device)
        self.solver = wrod.SolverDER(self.model)
        self.state = self.model.state()
        self.viewer.set_model(self.model)

    def step(self) -> None:
        self.sim_time += self.frame_dt
        way = smooth(self.sim_time / MOVING)
        poses = self.state.body_q.numpy()
        poses[self.hook, :3] = self.start + [ASIDE * way, 0.0, LIFT * way]
        self.state.body_q.assign(poses)
        self.solver.step(self.state, self.state, None, None, self.frame_dt)

    def render(self) -> None:
        self.viewer.begin_frame(self.sim_time)
        self.viewer.log_state(self.state)
        self.viewer.end_frame()

    def test_final(self) -> None:
        if self.solver.diverged.any():
            raise ValueError("a cable diverged")
        hook, beam = self.state.body_q.numpy()[[self.hook, self.beam], :3]
        if abs(beam[2] - hook[2] + 0.3) > 0.01 or abs(beam[0] - hook[0]) > 0.1:
            raise ValueError(f"the beam is at {beam}, the hook at {hook}")
        cables = self.model.der.node_mass.numpy().sum()
        weight = (float(self.model.body_mass.numpy()[self.beam]) + cables) * 9.81
        load = -self.solver.body_wrenches()[self.hook, 2]
        if abs(load / weight - 1.0) > 0.01:
            raise ValueError(f"the hook carries {load} N of {weight} N")


if __name__ == "__main__":
    parser = newton.examples.create_parser()
    parser.set_defaults(num_frames=Example.frame_count)
    viewer, args = newton.examples.init(parser)
    newton.examples.run(Example(viewer, args), args)
