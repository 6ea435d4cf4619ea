"""A Panda that SolverMuJoCo moves picks a cable up between two fingers and lays it down elsewhere.

Nothing ties the cable to the gripper: two fingers close on it, and friction holds it. Fingers, arm
and cable move on in turn; `add_body_forces` gives the first two what the cable did.

Success criteria:
- Half way the cable hangs between the fingers, nowhere near the table, and does not slip: what it
  weighs, and all links, are in the torques of the joints that bear them, within 1 %.
- Each finger is pressed by as much as the other, and by what its joint pushes, within 2 %.
- At the end the fingers are open and away, and the cable lies on the table, 0.1 m further on.

Run: `python examples/newton/gripper_picks_cable.py` (`--viewer null --test` without a display)
"""

from itertools import pairwise
from xml.etree import ElementTree

import newton
import newton.examples
import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation
from wrod.scenes.arms import arm_urdf
from wrod.scenes.urdf_writer import box, joint_element, link_element

import wrod

# Shoulder to elbow and elbow to wrist, as (across, along) [m]; the shoulder's height, and the way
# from the wrist to the flange, across and along the hand.
UPPER, FORE, SHOULDER, ASIDE, FLANGE = (0.0825, 0.316), (-0.0825, 0.384), 0.333, 0.088, 0.107
PALM, FINGER = 0.08, 0.04  # lengths of the hand and its fingers [m]
RADIUS, LENGTH, EDGES = 0.005, 0.25, 25
STIFFNESS, DAMPING = 2e4, 400.0  # of the arm's joints [N m/rad], [N m s/rad]
GRIP, GRIP_DAMPING, MOTOR = 2000.0, 80.0, 0.2  # of a finger [N/m, N s/m, kg]
OPEN, CLOSED = 0.022, 0.006  # where fingers are told to be; they meet the cable at 0.009 [m]
SUBSTEPS = 16
BEAR = [1, 3, 5]  # shoulder, elbow and wrist, which bear weights in this plane
# Times [s], middle of the fingers (x, z) over the table, and where the fingers are told to be.
KEYS = [
    (0.0, 0.46, 0.12, OPEN),
    (0.7, 0.46, 0.021, OPEN),
    (1.0, 0.46, 0.021, CLOSED),
    (1.2, 0.46, 0.021, CLOSED),
    (2.2, 0.46, 0.27, CLOSED),
    (3.2, 0.46, 0.27, CLOSED),
    (4.4, 0.56, 0.023, CLOSED),
    (4.6, 0.56, 0.023, CLOSED),
    (4.9, 0.56, 0.023, OPEN),
    (5.6, 0.56, 0.12, OPEN),
]
FINGERS = f"""
<robot>
  <link name="finger_{{side}}">
    <inertial><mass value="0.05"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5"/></inertial>
    <collision><geometry><box size="0.024 0.008 {FINGER}"/></geometry></collision>
  </link>
  <joint name="grip_{{side}}" type="prismatic">
    <parent link="palm"/><child link="finger_{{side}}"/>
    <origin xyz="0 0 {PALM + 0.5 * FINGER}"/><axis xyz="0 {{side}} 0"/>
    <limit lower="0" upper="0.04" effort="200" velocity="0.2"/>
  </joint>
</robot>
"""
FIRST, HANGING = 0.38, 3.2  # where the cable begins [m], and when it hangs [s]


def joints(x: float, z: float) -> np.ndarray:
    """(7,) angles of a Panda that stays in a plane, its fingers at x, z, pointing down."""
    wrist = np.array([x - ASIDE, z + FLANGE + PALM + 0.5 * FINGER - SHOULDER])
    upper, fore, far = np.hypot(*UPPER), np.hypot(*FORE), np.hypot(*wrist)
    # The triangle of shoulder, elbow and wrist; pitches are from upright forwards.
    inside = np.arccos((upper**2 + far**2 - fore**2) / (2.0 * upper * far))
    first = np.arctan2(*wrist) - inside
    elbow = upper * np.array([np.sin(first), np.cos(first)])
    second = np.arctan2(*(wrist - elbow))
    q2 = first - np.arctan2(*UPPER)
    pitch = second - np.arctan2(*FORE)
    return np.array([0.0, q2, 0.0, q2 - pitch, 0.0, pitch, 0.0])


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
            -1, xform=wp.transform((0.6, 0.0, -0.02), wp.quat_identity()), hx=0.4, hy=0.2, hz=0.02,
            label="table",
        )  # fmt: skip
        self._add_arm(builder)
        points = np.zeros((EDGES + 1, 3))
        points[:, 0] = FIRST + np.linspace(0.0, LENGTH, EDGES + 1)
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
        """wrod's Panda, with a hand of two fingers on its last link."""
        panda = arm_urdf("panda")
        palm = box((0.04, 0.1, PALM), (0.0, 0.0, 0.5 * PALM))
        panda.append(link_element("palm", 0.3, [palm]))
        panda.append(joint_element("hand", "panda_link8", "palm", (0.0, 0.0, 0.0)))
        for side in (1, -1):
            panda.extend(ElementTree.fromstring(FINGERS.format(side=side)))
        urdf = ElementTree.tostring(panda, encoding="unicode")
        builder.add_urdf(urdf, floating=False, collapse_fixed_joints=True)
        self.links = [k for k, label in enumerate(builder.body_label) if label != "table"]
        for dof in range(9):
            finger = dof > 6
            builder.joint_target_ke[dof] = GRIP if finger else STIFFNESS
            builder.joint_target_kd[dof] = GRIP_DAMPING if finger else DAMPING
            builder.joint_armature[dof] = MOTOR if finger else 0.0
            builder.joint_target_mode[dof] = int(newton.JointTargetMode.POSITION)
        for shape, body in enumerate(builder.shape_body):
            builder.shape_material_mu[shape] = 1.0 if body in self.links[-2:] else 0.5
            if body in self.links[:-2]:
                builder.shape_flags[shape] &= ~int(newton.ShapeFlags.COLLIDE_SHAPES)

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
        """(9,) what the joints' springs do [N m, N]."""
        stiffness, damping = np.repeat([[STIFFNESS, GRIP], [DAMPING, GRIP_DAMPING]], [7, 2], axis=1)
        error = self.target(self.sim_time) - self.state.joint_q.numpy()
        return stiffness * error - damping * self.state.joint_qd.numpy()

    def moments(self) -> np.ndarray:
        """(7,) what the joints need for the weights of links and cable [N m]."""
        pose = self.state.body_q.numpy()[self.links].astype(float)
        turn = Rotation.from_quat(pose[:, 3:])
        mass = self.model.body_mass.numpy()[self.links]
        center = pose[:, :3] + turn.apply(self.model.body_com.numpy()[self.links])
        cable, out = self.model.der.node_mass.numpy(), []
        for k, axis in enumerate(turn.apply([0.0, 0.0, 1.0])[:7]):
            arms = mass[k:] @ (center[k:] - pose[k, :3]) + cable @ (self.nodes() - pose[k, :3])
            out.append(9.81 * axis @ np.cross(arms, [0.0, 0.0, 1.0]))
        return np.array(out)

    def pressures(self) -> np.ndarray:
        """(2,) how hard the cable presses on the fingers [N]."""
        return self.cable.body_wrenches()[self.links[-2:], 1] * [-1.0, 1.0]

    def render(self) -> None:
        self.viewer.begin_frame(self.sim_time)
        self.viewer.log_state(self.state)
        self.viewer.end_frame()

    def test_final(self) -> None:
        if self.cable.diverged.any():
            raise ValueError("the cable diverged")
        efforts, moments, pressures, hung = self.hanging
        if np.abs(efforts[BEAR] / moments[BEAR] - 1.0).max() > 0.01:
            raise ValueError(f"the joints do {efforts[:7]} N m, the weights need {moments} N m")
        if np.abs(pressures / -efforts[7:] - 1.0).max() > 0.02 or pressures.min() < 1.0:
            raise ValueError(f"the cable presses by {pressures} N, the fingers by {-efforts[7:]} N")
        if hung[:, 2].min() < 0.05:
            raise ValueError(f"the cable did not leave the table: {hung[:, 2].min()} m over it")
        q = self.nodes()
        if np.abs(q[:, 2] - RADIUS).max() > 0.2 * RADIUS:
            raise ValueError(f"the cable does not lie on the table: {q[:, 2]} m over it")
        if abs(q[:, 0].mean() - (FIRST + 0.5 * LENGTH) - 0.1) > 0.02:
            raise ValueError(f"the cable lies around {q[:, 0].mean()} m")


if __name__ == "__main__":
    parser = newton.examples.create_parser()
    parser.set_defaults(num_frames=Example.frame_count)
    viewer, args = newton.examples.init(parser)
    newton.examples.run(Example(viewer, args), args)
