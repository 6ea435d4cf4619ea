"""An arm that Newton's Featherstone solver moves picks a cable up by one end and lays it down.

The cable lies on a table, its end in the gripper. The arm lifts it, carries it aside and puts it
down. Arm and cable move on in turn; `add_body_forces` gives the arm what the cable did.

Success criteria:
- Half way, the cable hangs from the gripper: the shoulder carries links and cable, within 2 % of
  the moment of their weights.
- At the end the cable lies on the table again, further on, and does not sink in.

Run: `python examples/newton/arm_carries_cable.py` (`--viewer null --test` without a display)
"""

from itertools import pairwise

import newton
import newton.examples
import numpy as np
import warp as wp

import wrod

REACH = 0.3  # of each link [m]
SHOULDER = 0.35  # height over the table [m]
RADIUS, LENGTH = 0.005, 0.25
# Of the joints: Featherstone steps explicitly, so light links take little.
STIFFNESS, DAMPING = (300.0, 75.0, 5.0), (2.0, 0.4, 0.015)
SUBSTEPS = 16
# Times [s] and gripper positions (x, z) over the table: lift, carry, put down, rest.
KEYS = [
    (0.0, 0.30, 0.02),
    (1.2, 0.30, 0.30),
    (2.2, 0.30, 0.30),
    (3.4, 0.42, 0.02),
    (4.4, 0.42, 0.02),
]
HANGING = 2.2


def joints(x: float, z: float) -> np.ndarray:
    """Shoulder, elbow and wrist angles with the gripper at x, z, pointing along x."""
    r2 = x**2 + (z - SHOULDER) ** 2
    elbow = np.arccos(np.clip((r2 - 2 * REACH**2) / (2 * REACH**2), -1.0, 1.0))
    down = np.arctan2(SHOULDER - z, x)
    shoulder = down - np.arctan2(np.sin(elbow), 1.0 + np.cos(elbow))
    return np.array([shoulder, elbow, -shoulder - elbow])


class Example:
    frame_dt = 1.0 / 60.0
    frame_count = round(KEYS[-1][0] / frame_dt)

    def __init__(self, viewer, args):
        self.viewer, self.sim_time = viewer, 0.0
        self.material = wrod.RodMaterial.from_youngs_modulus(2e6, RADIUS, LENGTH, density=1150.0)
        builder = newton.ModelBuilder()
        wrod.SolverDER.register_custom_attributes(builder)
        builder.default_shape_cfg.mu = 0.5
        builder.add_shape_box(
            -1, xform=wp.transform((0.4, 0.0, -0.02), wp.quat_identity()), hx=0.5, hy=0.2, hz=0.02,
            label="table",
        )  # fmt: skip
        q = joints(*KEYS[0][1:])
        self._add_arm(builder, q)
        arc = np.linspace(0.0, LENGTH, 26)
        points = np.zeros((26, 3))
        points[:, 0] = KEYS[0][1] + arc
        fall = np.clip(arc / 0.12, 0.0, 1.0)
        points[:, 2] = KEYS[0][2] + (RADIUS - KEYS[0][2]) * fall**2 * (3.0 - 2.0 * fall)
        wrod.SolverDER.add_rod(
            builder, points, self.material, start="clamped", start_body=self.links[2],
            internal_damping=0.02, air_damping=1.0, color=(0.2, 0.55, 0.3),
        )  # fmt: skip
        self.model = builder.finalize(device=args.device)
        self.model.joint_q.assign(q)
        self.arm = newton.solvers.SolverFeatherstone(self.model)
        self.cable = wrod.SolverDER(self.model)
        self.control = self.model.control()
        self.state, self.other = self.model.state(), self.model.state()
        newton.eval_fk(self.model, self.model.joint_q, self.model.joint_qd, self.state)
        self.hanging = None
        self.viewer.set_model(self.model)

    def _add_arm(self, builder, q) -> None:
        cfg = newton.ModelBuilder.ShapeConfig(density=600.0, has_shape_collision=False)
        self.links, added = [], []
        place, pitch = np.array([0.0, 0.0, SHOULDER]), 0.0
        lengths = (REACH, REACH, 0.06)
        for k, length in enumerate(lengths):
            pitch += q[k]
            # The wrist's link is the gripper: the cable begins where it is jointed.
            way = length * np.array([np.cos(pitch), 0.0, -np.sin(pitch)])
            sign = 1.0 if k < 2 else -1.0
            turn = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), float(pitch))
            link = builder.add_link(xform=wp.transform(tuple(place + 0.5 * sign * way), turn))
            builder.add_shape_box(link, hx=0.5 * length, hy=0.02, hz=0.02, cfg=cfg)
            before = (0.0, 0.0, SHOULDER) if k == 0 else (0.5 * REACH, 0.0, 0.0)
            added.append(
                builder.add_joint_revolute(
                    -1 if k == 0 else self.links[-1], link,
                    parent_xform=wp.transform(before, wp.quat_identity()),
                    child_xform=wp.transform((-0.5 * sign * length, 0.0, 0.0), wp.quat_identity()),
                    axis=wp.vec3(0.0, 1.0, 0.0), target_ke=STIFFNESS[k],
                    target_kd=DAMPING[k], actuator_mode=newton.JointTargetMode.POSITION,
                )
            )  # fmt: skip
            self.links.append(link)
            place = place + way
        builder.add_articulation(added)

    def target(self, time: float) -> np.ndarray:
        """Joint angles at a time, smooth between the keys."""
        for (a, *here), (b, *there) in pairwise(KEYS):
            if time <= b:
                x = max(0.0, (time - a) / (b - a))
                x = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
                return joints(*(np.array(here) + x * (np.array(there) - here)))
        return joints(*KEYS[-1][1:])

    def step(self) -> None:
        self.sim_time += self.frame_dt
        self.control.joint_target_q.assign(self.target(self.sim_time))
        dt = self.frame_dt / SUBSTEPS
        for _ in range(SUBSTEPS):
            self.state.clear_forces()
            self.cable.add_body_forces(self.state)
            self.arm.step(self.state, self.other, self.control, None, dt)
            self.cable.step(self.state, self.other, None, None, dt, moved=self.other)
            self.state, self.other = self.other, self.state
        if self.hanging is None and self.sim_time >= HANGING - 1e-9:
            self.hanging = self.shoulder_torques()

    def shoulder_torques(self) -> tuple[float, float]:
        """What the shoulder's spring does, and the moment of all weights about it [N m]."""
        error = self.target(self.sim_time)[0] - self.state.joint_q.numpy()[0]
        torque = STIFFNESS[0] * error - DAMPING[0] * self.state.joint_qd.numpy()[0]
        masses = self.model.body_mass.numpy()[self.links]
        arms = self.state.body_q.numpy()[self.links, 0]
        cable = self.model.der.node_mass.numpy() @ self.state.der.node_q.numpy()[:, 0]
        return float(torque), float(-9.81 * (masses @ arms + cable))

    def render(self) -> None:
        self.viewer.begin_frame(self.sim_time)
        self.viewer.log_state(self.state)
        self.viewer.end_frame()

    def test_final(self) -> None:
        if self.cable.diverged.any():
            raise ValueError("the cable diverged")
        torque, moment = self.hanging
        if abs(torque / moment - 1.0) > 0.02:
            raise ValueError(f"the shoulder does {torque} N m, the weights need {moment} N m")
        q = self.state.der.node_q.numpy()
        if q[:, 2].min() < 0.9 * RADIUS:
            raise ValueError(f"the cable sinks into the table: {q[:, 2].min()} m over it")
        if (q[:, 2] < 1.2 * RADIUS).sum() < 10 or q[-1, 0] < KEYS[-1][1]:
            raise ValueError("the cable does not lie on the table, further on")


if __name__ == "__main__":
    parser = newton.examples.create_parser()
    parser.set_defaults(num_frames=Example.frame_count)
    viewer, args = newton.examples.init(parser)
    newton.examples.run(Example(viewer, args), args)
