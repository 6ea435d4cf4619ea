"""How an arm's joints move its grasp, in few operations."""

from typing import Any


class GraspJacobian:
    """Pose and geometric Jacobian of the grasp, from revolute joints alone, batched in float64.

    pytorch-kinematics' own go through every link that is fixed to another besides, several
    operations for each: most of the time of a path is in them. What lies between two joints is
    read off its chain once, as the joints stand at zero.

    Args:
        chain: `pytorch_kinematics.SerialChain` from the base to the grasp.
    """

    def __init__(self, chain: Any):
        import torch

        self._axis = chain._serial_dof_axes.to(torch.float64)
        zero = torch.zeros((1, len(self._axis)), dtype=torch.float64)
        rest = chain.forward_kinematics_tensor(zero)[:, 0]
        ends = rest[chain._serial_dof_frame_indices], rest[chain._serial_eef_frame_idx][None]
        self._one = torch.eye(4, dtype=torch.float64)
        poses = torch.cat([self._one[None], *ends])
        # (n + 1, 4, 4): from the base or a joint to the next joint or the grasp.
        self._between = torch.linalg.solve(poses[:-1], poses[1:])
        # (n, 4, 4): [axis] of every joint, and its square.
        self._across = torch.zeros((len(self._axis), 4, 4), dtype=torch.float64)
        for k in range(3):
            one, other = (k + 1) % 3, (k + 2) % 3
            self._across[:, other, one] = self._axis[:, k]
            self._across[:, one, other] = -self._axis[:, k]
        self._square = self._across @ self._across

    def __call__(self, positions):
        """Of joint positions (B, n) [rad], a tensor, which may want gradients.

        Returns:
            Jacobian (B, 6, n) [m/rad], [-], and pose of the grasp (B, 4, 4) [m], in the base frame.
        """
        import torch

        angle = positions[..., None, None]
        # Rodrigues' formula.
        turn = self._one + angle.sin() * self._across + (1.0 - angle.cos()) * self._square
        steps = (self._between[:-1] @ turn).unbind(1)
        frames = [steps[0]]
        for step in steps[1:]:
            frames.append(frames[-1] @ step)
        pose = frames[-1] @ self._between[-1]
        joints = torch.stack(frames, 1)
        axis = (joints[..., :3, :3] @ self._axis[..., None]).squeeze(-1)
        arm = pose[:, None, :3, 3] - joints[..., :3, 3]
        return torch.cat([torch.linalg.cross(axis, arm), axis], -1).mT, pose
