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
        one = torch.eye(4, dtype=torch.float64)
        poses = torch.cat([one[None], *ends])
        # (n + 1, 4, 4): from the base or a joint to the next joint or the grasp.
        between = torch.linalg.solve(poses[:-1], poses[1:])
        # (n, 4, 4): [axis] of every joint, whose square is the other term of Rodrigues' formula.
        across = torch.zeros((len(self._axis), 4, 4), dtype=torch.float64)
        for k in range(3):
            other, third = (k + 1) % 3, (k + 2) % 3
            across[:, third, other] = self._axis[:, k]
            across[:, other, third] = -self._axis[:, k]
        square = across @ across
        # A joint's step is the first, with its sine the second, with its cosine the third.
        self._parts = between[:-1] @ (one + square), between[:-1] @ across, -between[:-1] @ square
        self._last = between[-1]

    def frames(self, positions):
        """(B, n, 4, 4) frames of the joints, turned, in the base frame [m], at joint positions
        (B, n) [rad], a tensor, which may want gradients."""
        import torch

        still, sine, cosine = self._parts
        angle = positions[..., None, None]
        steps = torch.addcmul(torch.addcmul(still, angle.sin(), sine), angle.cos(), cosine)
        first, *others = steps.unbind(1)
        frames = [first]
        for step in others:
            frames.append(frames[-1] @ step)
        return torch.stack(frames, 1)

    def pose(self, frames):
        """(B, 4, 4) pose of the grasp in the base frame [m] of `frames`."""
        return frames[:, -1] @ self._last

    def axes(self, frames):
        """(B, n, 3) axes of the joints in the base frame, of `frames`."""
        return (frames[..., :3, :3] @ self._axis[..., None]).squeeze(-1)

    def of(self, frames):
        """Jacobian (B, 6, n) [m/rad], [-], and pose of the grasp (B, 4, 4) [m], in the base frame,
        of `frames`."""
        import torch

        pose, axis = self.pose(frames), self.axes(frames)
        arm = pose[:, None, :3, 3] - frames[..., :3, 3]
        return torch.cat([torch.linalg.cross(axis, arm), axis], -1).mT, pose

    def __call__(self, positions):
        """As `of`, at joint positions (B, n) [rad], a tensor, which may want gradients."""
        return self.of(self.frames(positions))
