"""Distances between the arm's links, the table, the pedestal and the laid rod.

Every collision shape becomes a capsule (a segment with a radius) that contains it.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from wrod.errors import RobotError, WrodWarning
from wrod.robot.mesh import read_mesh
from wrod.robot.model import Robot
from wrod.robot.urdf import LinkShape

if TYPE_CHECKING:
    import torch

_NOTHING = 10.0  # [m] gap to a rod of which nothing lies yet; finite for the gradient


def capsule_of(shape: LinkShape) -> tuple[np.ndarray, np.ndarray, float]:
    """Ends (3,), (3,) and radius [m] of a capsule around a shape, in its link's frame."""
    if shape.kind == "sphere":
        half, radius, axis = 0.0, shape.size[0], np.eye(3)[2]
    elif shape.kind == "cylinder":
        radius, half, axis = shape.size[0], shape.size[1] / 2, np.eye(3)[2]
    elif shape.kind == "box":
        size = np.array(shape.size)
        long = int(size.argmax())
        half, axis = size[long] / 2, np.eye(3)[long]
        radius = float(np.linalg.norm(np.delete(size, long)) / 2)
    else:
        vertices = read_mesh(shape.mesh)[0] * np.array(shape.size)
        middle = (vertices.max(0) + vertices.min(0)) / 2
        _, _, axes = np.linalg.svd(vertices - middle, full_matrices=False)
        along = (vertices - middle) @ axes[0]
        across = (vertices - middle) - along[:, None] * axes[0]
        radius = float(np.linalg.norm(across, axis=1).max())
        ends = [middle + axes[0] * along.min(), middle + axes[0] * along.max()]
        start, end = (shape.pose[:3, :3] @ p + shape.pose[:3, 3] for p in ends)
        return start, end, radius
    offset = shape.pose[:3, :3] @ axis * half
    return shape.pose[:3, 3] - offset, shape.pose[:3, 3] + offset, radius


class CollisionModel:
    """Capsules of an arm on a pedestal, and the pairs that could meet.

    Pairs that are never checked: links joined by one joint, and links two joints apart that
    overlap in most poses (their shapes are built into each other).
    """

    def __init__(self, robot: Robot):
        self.robot = robot
        shapes = []
        for shape in robot.shapes("collision"):
            try:
                shapes.append((shape, capsule_of(shape)))
            except RobotError as error:
                warnings.warn(
                    WrodWarning(f"link {shape.link!r} is not checked for collision: {error}"),
                    stacklevel=2,
                )
        self.links = [shape.link for shape, _ in shapes]
        self.radius = np.array([c[2] for _, c in shapes])
        anchors = [self._anchor(link) for link in self.links]
        starts = [self._in_anchor(shape.link, capsule[0]) for shape, capsule in shapes]
        ends = [self._in_anchor(shape.link, capsule[1]) for shape, capsule in shapes]
        self._frame = [robot.chain.frame_to_idx[a] for a in anchors]
        self._start, self._end = np.array(starts), np.array(ends)
        depth = self._depths()
        self.depth = np.array([depth[a] for a in anchors])
        self.pairs = self._pairs()
        # The first two moving links stay over the pedestal; whatever comes after may reach down.
        self.low = np.flatnonzero(self.depth >= 2)

    def _parents(self) -> dict[str, tuple[str, object]]:
        return {
            j.find("child").get("link"): (j.find("parent").get("link"), j)
            for j in self.robot.urdf.joints
        }

    def _anchor(self, link: str) -> str:
        """The link itself, or the nearest one above it on the chain that is planned."""
        parents = self._parents()
        while link not in self.robot.chain.frame_to_idx:
            link = parents[link][0]
        return link

    def _in_anchor(self, link: str, point: np.ndarray) -> np.ndarray:
        anchor = self._anchor(link)
        if anchor == link:
            return point
        poses = self.robot.link_poses(np.zeros((1, len(self.robot.joint_names))))
        relative = np.linalg.inv(poses[anchor][0]) @ poses[link][0]
        return relative[:3, :3] @ point + relative[:3, 3]

    def _depths(self) -> dict[str, int]:
        """Moving joints between the base and each link of the chain."""
        parents, depths = self._parents(), {}
        for link in self.robot.chain.frame_to_idx:
            above, count = link, 0
            while above in parents:
                above, joint = parents[above]
                count += joint.find("child").get("link") in self.robot.chain.frame_to_idx and (
                    joint.get("name") in self.robot.joint_names
                )
            depths[link] = count
        return depths

    def _pairs(self) -> np.ndarray:
        apart = np.abs(self.depth[:, None] - self.depth[None, :])
        far = np.argwhere(np.triu(apart > 2))
        near = np.argwhere(np.triu(apart == 2))
        if len(near):
            import torch

            robot = self.robot
            lower = np.maximum(robot.lower, -np.pi)
            upper = np.minimum(robot.upper, np.pi)
            q = np.random.default_rng(0).uniform(lower, upper, (200, len(lower)))
            with torch.no_grad():
                frames = robot.chain.forward_kinematics_tensor(torch.from_numpy(q))
                start, end = self.points(frames)
            self.pairs = near
            overlap = (self.self_distances(start, end) < 0).double().mean(0).numpy()
            near = near[overlap < 0.3]
        return np.concatenate([far, near])

    def points(self, frames: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Ends of the capsules in the base frame, (B, C, 3) each, from the chain's frames."""
        import torch

        picked = frames[self._frame]  # (C, B, 4, 4)
        rotation, origin = picked[..., :3, :3], picked[..., :3, 3]
        out = []
        for local in (self._start, self._end):
            local = torch.from_numpy(local)[:, None, :, None]
            out.append(((rotation @ local).squeeze(-1) + origin).transpose(0, 1))
        return out[0], out[1]

    def self_distances(self, start: torch.Tensor, end: torch.Tensor) -> torch.Tensor:
        """(B, pairs) gap between the capsules of each pair [m], negative where they overlap."""
        import torch

        i, j = self.pairs.T
        gap = segment_distance(start[:, i], end[:, i], start[:, j], end[:, j])
        return gap - torch.from_numpy(self.radius[i] + self.radius[j])

    def table_distances(self, start, end, table_height: float) -> torch.Tensor:
        """(B, low) height of the capsules of `low` above the plane of the table [m]."""
        import torch

        lowest = torch.minimum(start[:, self.low, 2], end[:, self.low, 2])
        return lowest - torch.from_numpy(self.radius[self.low]) - table_height

    def laid_distances(self, start, end, contacts, laid, rod_radius: float) -> torch.Tensor:
        """(B, low) gap between capsules and the laid rod, which are points of it [m].

        Args:
            contacts: (N, 3) points of the laid rod in the base frame, in laying order.
            laid: (B,) how many of them lie on the table at each pose.
            rod_radius: [m].
        """
        import torch

        low = self.low
        axis = end[:, low] - start[:, low]
        offset = contacts[None, None] - start[:, low, None]
        share = (offset * axis[:, :, None]).sum(-1) / axis.square().sum(-1).clamp_min(1e-12)[
            ..., None
        ]
        near = offset - share.clamp(0, 1)[..., None] * axis[:, :, None]
        gap = near.norm(dim=-1)
        later = torch.arange(len(contacts))[None] >= laid[:, None]
        gap = gap.masked_fill(later[:, None], _NOTHING).amin(-1)
        return gap - torch.from_numpy(self.radius[low]) - rod_radius


def between(start, end, radius, other_start, other_end, other_radius) -> torch.Tensor:
    """(K, C, D) gaps between the capsules of two arms [m], in one frame.

    Args:
        start, end: (K, C, 3) of one [m], tensors.
        radius: (C,) [m].
        other_start, other_end, other_radius: the same of the other, arrays.
    """
    import torch

    first, last = (torch.from_numpy(p)[:, None] for p in (other_start, other_end))
    gap = segment_distance(start[:, :, None], end[:, :, None], first, last)
    return gap - torch.from_numpy(radius[:, None] + other_radius[None])


def segment_distance(p1, q1, p2, q2):
    """Distance (...) between segments p1-q1 and p2-q2, each end (..., 3), differentiable.

    Ericson, Real-Time Collision Detection, sec. 5.1.9.
    """
    d1, d2, r = q1 - p1, q2 - p2, p1 - p2
    a = d1.square().sum(-1).clamp_min(1e-12)
    e = d2.square().sum(-1).clamp_min(1e-12)
    b, c, f = (d1 * d2).sum(-1), (d1 * r).sum(-1), (d2 * r).sum(-1)
    s = ((b * f - c * e) / (a * e - b * b).clamp_min(1e-12)).clamp(0, 1)
    t = ((b * s + f) / e).clamp(0, 1)
    s = ((b * t - c) / a).clamp(0, 1)
    gap = p1 + d1 * s[..., None] - p2 - d2 * t[..., None]
    return (gap.square().sum(-1) + 1e-18).sqrt()
