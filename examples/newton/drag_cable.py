"""A cable in a Newton scene: it falls onto a table, is lowered and dragged over a fixture.

A kinematic gripper holds one end; the rest falls onto the table (a box), across a cylinder that
lies there. The gripper goes down, pulls the cable a hand's breadth along and stops.

Success criteria:
- The cable lies on the table and over the cylinder and does not sink into them by more than 5 % of
  its radius, and is no more stretched than friction holds it.
- Its held end is where the gripper is; its free end has been dragged along.
- At the end it is at rest.

Run: `python examples/newton/drag_cable.py` (`--viewer null --test` without a display,
`--viewer usd --output-path cable.usd` for a scene)
"""

import newton
import newton.examples
import numpy as np
import warp as wp

import wrod
from wrod.patterns.curve import smoothstep

_SPACING = 0.006
_TABLE = 0.4  # height of its top [m]
_LENGTH, _HEIGHT = 0.48, 0.11
_FALL, _LOWER, _DRAG, _REST = 1.2, 1.0, 1.6, 1.2
_WAY = 0.12
_FIXTURE = 0.006  # radius of the cylinder [m]
_FRICTION = 0.6


class Example:
    """The scene, in the manner of Newton's examples."""

    frame_count = round(60 * (_FALL + _LOWER + _DRAG + _REST))

    def __init__(self, viewer, args):
        self.viewer, self.args = viewer, args
        self.frame_dt = 1.0 / 60.0
        self.sim_time = 0.0
        self.material = wrod.rod("green-vps")

        builder = newton.ModelBuilder()
        wrod.SolverDER.register_custom_attributes(builder)
        builder.add_ground_plane()
        surface = newton.ModelBuilder.ShapeConfig(density=0.0, mu=_FRICTION)
        builder.add_shape_box(
            -1,
            xform=wp.transform((0.1, 0.0, 0.5 * _TABLE), wp.quat_identity()),
            hx=0.4, hy=0.25, hz=0.5 * _TABLE, cfg=surface, color=(0.78, 0.72, 0.62), label="table",
        )  # fmt: skip
        lying = wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), 0.5 * np.pi)
        builder.add_shape_cylinder(
            -1,
            xform=wp.transform((0.2, 0.0, _TABLE + _FIXTURE), lying),
            radius=_FIXTURE, half_height=0.05, cfg=surface, color=(0.45, 0.45, 0.5),
            label="fixture",
        )  # fmt: skip
        self.start = np.array([0.0, 0.0, _TABLE + _HEIGHT])
        self.gripper = builder.add_link(
            xform=wp.transform(wp.vec3(*self.start), wp.quat_identity()),
            is_kinematic=True,
            label="gripper",
        )
        builder.add_shape_box(
            self.gripper,
            xform=wp.transform((-0.02, 0.0, 0.0), wp.quat_identity()),
            hx=0.02, hy=0.012, hz=0.012, label="finger", color=(0.2, 0.22, 0.26),
            cfg=newton.ModelBuilder.ShapeConfig(density=0.0, has_shape_collision=False),
        )  # fmt: skip
        count = round(_LENGTH / _SPACING) + 1
        points = self.start + np.linspace(0.0, _LENGTH, count)[:, None] * [1.0, 0.0, 0.0]
        wrod.SolverDER.add_rod(
            builder,
            points,
            self.material,
            start="clamped",
            start_body=self.gripper,
            internal_damping=0.01,
            air_damping=1.0,
            color=(0.2, 0.55, 0.3),
            label="cable",
        )
        self.model = builder.finalize(device=args.device)
        self.solver = wrod.SolverDER(self.model, max_step=1.0 / 240.0)
        self.state_0, self.state_1 = self.model.state(), self.model.state()
        self.viewer.set_model(self.model)
        self.viewer.set_camera(pos=wp.vec3(0.1, -0.75, 0.75), pitch=-24.0, yaw=90.0)

    def gripper_position(self, time: float) -> np.ndarray:
        """(3,) where the gripper is [m]."""
        down = _HEIGHT - self.material.gravito_bending_length
        return self.start + [
            -_WAY * smoothstep((time - _FALL - _LOWER) / _DRAG),
            0.0,
            -down * smoothstep((time - _FALL) / _LOWER),
        ]

    def step(self) -> None:
        """Advance the example by one frame."""
        self.sim_time += self.frame_dt
        poses = self.state_0.body_q.numpy()
        poses[self.gripper, :3] = self.gripper_position(self.sim_time)
        self.state_0.body_q.assign(poses)
        self.solver.step(self.state_0, self.state_1, None, None, self.frame_dt)
        self.state_0, self.state_1 = self.state_1, self.state_0

    def render(self) -> None:
        """Show the current state: the capsules are where the cable is."""
        self.viewer.begin_frame(self.sim_time)
        self.viewer.log_state(self.state_0)
        self.viewer.end_frame()

    def test_final(self) -> None:
        """Check the success criteria above."""
        if self.solver.diverged.any():
            raise ValueError("the cable diverged")
        der, radius = self.state_0.der, self.material.radius
        q, velocity = der.node_q.numpy(), der.node_qd.numpy()
        length = np.linalg.norm(np.diff(q, axis=0), axis=1).sum()
        # Friction keeps it as stretched as it was dragged: by mu w L in the gripper, 0 at its end.
        pull = 0.5 * _FRICTION * self.material.weight * _LENGTH
        if not 0.0 <= length / _LENGTH - 1.0 < 1.2 * pull / self.material.stretching_stiffness:
            raise ValueError(f"the cable is {length} m long, which friction does not explain")
        if np.abs(q[0] - self.gripper_position(self.sim_time)).max() > 1e-6:
            raise ValueError("the cable's end is not in the gripper")
        height = q[:, 2] - _TABLE
        across = np.hypot(q[:, 0] - 0.2, height - _FIXTURE) - _FIXTURE
        gap = np.minimum(height, across).min()
        if gap < 0.95 * radius:
            raise ValueError(f"the cable sinks into the table or the fixture: {gap} m from it")
        if (height < 1.05 * radius).sum() < len(q) // 3:
            raise ValueError("the cable does not lie on the table")
        dragged = _LENGTH - q[-1, 0]
        if not 0.3 * _WAY < dragged < _LENGTH:
            raise ValueError(f"the cable's free end has moved by {dragged} m")
        if np.abs(velocity).max() > 1e-3:
            raise ValueError(f"the cable still moves at {np.abs(velocity).max()} m/s")


if __name__ == "__main__":
    parser = newton.examples.create_parser()
    parser.set_defaults(num_frames=Example.frame_count)
    viewer, args = newton.examples.init(parser)
    newton.examples.run(Example(viewer, args), args)
