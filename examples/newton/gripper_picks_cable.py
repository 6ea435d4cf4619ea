"""An arm that SolverMuJoCo moves picks a cable up between two fingers and lays it down elsewhere.

Nothing ties the cable to the gripper: two fingers close on it, and friction holds it. Fingers, arm
and cable move on in turn; `add_body_forces` gives the first two what the cable did.

Success criteria:
- Half way the cable hangs between the fingers, nowhere near the table, and does not slip: what it
  weighs, and all links, are in the torques of shoulder, elbow and wrist, within 1 %.
- Each finger is pressed by as much as the other, and by what its joint pushes, within 2 %.
- At the end the fingers are open and away, and the cable lies on the table, 0.1 m further on.

Run: `python examples/newton/gripper_picks_cable.py` (`--viewer null --test` without a display)
"""

from itertools import pairwise

import newton
import newton.examples
import numpy as np
import warp as wp

import wrod

REACH, HAND, FINGER = 0.3, 0.1, 0.04  # lengths of the links, the hand, and its fingers [m]
SHOULDER = 0.4  # height over the table [m]
RADIUS, LENGTH, EDGES = 0.005, 0.25, 25
STIFFNESS, DAMPING = (600.0, 300.0, 100.0), (25.0, 12.0, 4.0)  # of shoulder, elbow, wrist
GRIP, GRIP_DAMPING, MOTOR = 2000.0, 80.0, 0.2  # of a finger [N/m, N s/m, kg]
OPEN, CLOSED = 0.022, 0.006  # where fingers are told to be; they meet the cable at 0.009 [m]
SUBSTEPS = 16
# Times [s], middle of the fingers (x, z) over the table, and where the fingers are told to be.
KEYS = [
    (0.0, 0.36, 0.12, OPEN),
    (0.7, 0.36, 0.021, OPEN),
    (1.0, 0.36, 0.021, CLOSED),
    (1.2, 0.36, 0.021, CLOSED),
    (2.2, 0.36, 0.27, CLOSED),
    (3.2, 0.36, 0.27, CLOSED),
    (4.4, 0.46, 0.023, CLOSED),
    (4.6, 0.46, 0.023, CLOSED),
    (4.9, 0.46, 0.023, OPEN),
    (5.6, 0.46, 0.12, OPEN),
]
HANGING = 3.2


def joints(x: float, z: float) -> np.ndarray:
    """Shoulder, elbow and wrist angles with the fingers at x, z, pointing down."""
    up = z + HAND + 0.5 * FINGER - SHOULDER
    r2 = x**2 + up**2
    elbow = np.arccos(np.clip((r2 - 2 * REACH**2) / (2 * REACH**2), -1.0, 1.0))
    shoulder = np.arctan2(-up, x) - np.arctan2(np.sin(elbow), 1.0 + np.cos(elbow))
    return np.array([shoulder, elbow, 0.5 * np.pi - shoulder - elbow])


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
        self._add_arm(builder)
        points = np.zeros((EDGES + 1, 3))
        points[:, 0] = 0.28 + np.linspace(0.0, LENGTH, EDGES + 1)
        points[:, 2] = RADIUS
        wrod.SolverDER.add_rod(
            builder, points, self.material, internal_damping=0.02, air_damping=1.0,
            color=(0.2, 0.55, 0.3), visible=False,
        )  # fmt: skip
        self.model = builder.finalize(device=args.device)
        q = self.target(0.0)
        self.model.joint_q.assign(q)
        self.arm = newton.solvers.SolverMuJoCo(
            self.model, use_mujoco_cpu=True, disable_contacts=True, integrator="implicitfast"
        )
        self.cable = wrod.SolverDER(self.model, contact_stiffness=1e6)
        self.control = self.model.control()
        self.state, self.other = self.model.state(), self.model.state()
        newton.eval_fk(self.model, self.model.joint_q, self.model.joint_qd, self.state)
        self.hanging = None
        self.viewer.set_model(self.model)

    def _add_arm(self, builder) -> None:
        bare = newton.ModelBuilder.ShapeConfig(density=600.0, has_shape_collision=False)
        rough = newton.ModelBuilder.ShapeConfig(density=600.0, mu=1.0)
        self.links, added = [], []
        parent, before = -1, (0.0, 0.0, SHOULDER)
        for k, length in enumerate((REACH, REACH, HAND)):
            link = builder.add_link()
            builder.add_shape_box(link, hx=0.5 * length, hy=0.02, hz=0.02, cfg=bare)
            added.append(
                builder.add_joint_revolute(
                    parent, link, axis=wp.vec3(0.0, 1.0, 0.0),
                    parent_xform=wp.transform(before, wp.quat_identity()),
                    child_xform=wp.transform((-0.5 * length, 0.0, 0.0), wp.quat_identity()),
                    target_ke=STIFFNESS[k], target_kd=DAMPING[k],
                    actuator_mode=newton.JointTargetMode.POSITION,
                )
            )  # fmt: skip
            self.links.append(link)
            parent, before = link, (0.5 * length, 0.0, 0.0)
        for side in (1.0, -1.0):
            finger = builder.add_link()
            builder.add_shape_box(finger, hx=0.5 * FINGER, hy=0.004, hz=0.012, cfg=rough)
            place = (0.5 * (HAND + FINGER), 0.0, 0.0)
            added.append(
                builder.add_joint_prismatic(
                    parent, finger, axis=wp.vec3(0.0, side, 0.0),
                    parent_xform=wp.transform(place, wp.quat_identity()),
                    target_ke=GRIP, target_kd=GRIP_DAMPING, armature=MOTOR,
                    actuator_mode=newton.JointTargetMode.POSITION,
                )
            )  # fmt: skip
            self.links.append(finger)
        builder.add_articulation(added)

    def target(self, time: float) -> np.ndarray:
        """Joint angles and places of the fingers at a time, smooth between the keys."""
        for (a, *here), (b, *there) in pairwise(KEYS):
            if time <= b:
                x = max(0.0, (time - a) / (b - a))
                x = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
                here = np.array(here) + x * (np.array(there) - here)
                break
        else:
            here = np.array(KEYS[-1][1:])
        return np.append(joints(*here[:2]), [here[2]] * 2)

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
            self.hanging = self.efforts(), self.moments(), self.pressures(), self.nodes().copy()

    def nodes(self) -> np.ndarray:
        """(node, 3) of the cable."""
        return self.state.der.node_q.numpy()

    def efforts(self) -> np.ndarray:
        """What the joints' springs do [N m, N]."""
        stiffness, damping = (*STIFFNESS, GRIP, GRIP), (*DAMPING, GRIP_DAMPING, GRIP_DAMPING)
        error = self.target(self.sim_time) - self.state.joint_q.numpy()
        return stiffness * error - damping * self.state.joint_qd.numpy()

    def moments(self) -> np.ndarray:
        """(3,) what shoulder, elbow and wrist need for the weights of links and cable [N m]."""
        mass, place = self.model.body_mass.numpy()[self.links], self.state.body_q.numpy()
        q, at, pitch = self.state.joint_q.numpy()[:3], 0.0, 0.0
        cable, out = self.model.der.node_mass.numpy(), []
        for k in range(3):
            links = self.links[k:]
            turning = mass[k:] @ (place[links, 0] - at) + cable @ (self.nodes()[:, 0] - at)
            out.append(-9.81 * turning)
            pitch += q[k]
            at += REACH * np.cos(pitch)
        return np.array(out)

    def pressures(self) -> np.ndarray:
        """(2,) how hard the cable presses on the fingers [N]."""
        return self.cable.body_wrenches()[self.links[3:], 1] * [1.0, -1.0]

    def render(self) -> None:
        self.viewer.begin_frame(self.sim_time)
        self.viewer.log_state(self.state)
        self.viewer.end_frame()

    def test_final(self) -> None:
        if self.cable.diverged.any():
            raise ValueError("the cable diverged")
        efforts, moments, pressures, hung = self.hanging
        if np.abs(efforts[:3] / moments - 1.0).max() > 0.01:
            raise ValueError(f"the joints do {efforts[:3]} N m, the weights need {moments} N m")
        if np.abs(pressures / -efforts[3:] - 1.0).max() > 0.02 or pressures.min() < 1.0:
            raise ValueError(f"the cable presses by {pressures} N, the fingers by {-efforts[3:]} N")
        if hung[:, 2].min() < 0.05:
            raise ValueError(f"the cable did not leave the table: {hung[:, 2].min()} m over it")
        q = self.nodes()
        if np.abs(q[:, 2] - RADIUS).max() > 0.2 * RADIUS:
            raise ValueError(f"the cable does not lie on the table: {q[:, 2]} m over it")
        if abs(q[:, 0].mean() - (0.28 + 0.5 * LENGTH) - 0.1) > 0.02:
            raise ValueError(f"the cable lies around {q[:, 0].mean()} m")


if __name__ == "__main__":
    parser = newton.examples.create_parser()
    parser.set_defaults(num_frames=Example.frame_count)
    viewer, args = newton.examples.init(parser)
    newton.examples.run(Example(viewer, args), args)
