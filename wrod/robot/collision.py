"""Distances between the arm's links, the table, the pedestal and the laid rod.

Every collision shape becomes capsules (segments with a radius) that contain it: distances with
gradients, and never too large. What they refuse is looked at with the true shapes (`exact`).
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from wrod.errors import RobotError, WrodWarning
from wrod.robot.capsules import capsules_of
from wrod.robot.exact import ExactShapes
from wrod.robot.model import Robot
from wrod.scenes.gripper import LINKS as GRIPPER

if TYPE_CHECKING:
    import torch

_MOST_EXACT = 4000  # distances between true shapes in one report
_NOTHING = 10.0  # [m] gap to a rod of which nothing lies yet; finite for the gradient


class CollisionModel:
    """Capsules of an arm on a pedestal, and the pairs that could meet.

    Pairs that are never checked: links joined by one joint, links two or three joints apart that
    overlap in most poses (their shapes are built into each other), and those that the robot's
    SRDF file, where there is one, says to leave out.

    Attributes:
        shapes: collision shapes; `shape_of` (C,) is that of each capsule.
        links: (C,) link of each capsule; `radius` (C,) [m]; `depth` (C,) joints below it.
        pairs: (P, 2) capsules that could meet.
        low: capsules that may reach down to the table; `moving` all that a joint moves, and
            `before_hand` those of `low` that do not move with the grasp.
        exact: the true shapes, or None where capsules are all there is.
    """

    def __init__(self, robot: Robot):
        self.robot = robot
        self.shapes, capsules, shape_of = [], [], []
        for shape in robot.shapes("collision"):
            try:
                around = capsules_of(shape)
            except RobotError as error:
                warnings.warn(
                    WrodWarning(f"link {shape.link!r} is not checked for collision: {error}"),
                    stacklevel=2,
                )
                continue
            shape_of += [len(self.shapes)] * len(around)
            self.shapes.append(shape)
            capsules += around
        if not capsules:
            raise RobotError(
                f"{robot.urdf.path}: no link has a collision shape that can be read, so nothing "
                "would keep the arm off the table; give the links <collision> elements"
            )
        if all(shape.link in GRIPPER for shape in self.shapes):
            warnings.warn(
                WrodWarning(
                    f"{robot.urdf.path}: no link of the arm has a collision shape, so that its "
                    "gripper alone is kept off table and rod; give the links <collision> elements"
                ),
                stacklevel=2,
            )
        self.shape_of = np.array(shape_of)
        self.exact = ExactShapes.of(self.shapes)
        self.links = [self.shapes[k].link for k in shape_of]
        self.radius = np.array([c[2] for c in capsules])
        depth = self._depths()
        self.depth = np.array([depth[self._anchor(link)] for link in self.links])
        self._ends = self._carried(np.array([c[:2] for c in capsules]))
        self.pairs = self._pairs()
        # The first two moving links stay over the pedestal; whatever comes after may reach down.
        self.low = np.flatnonzero(self.depth >= 2)
        self.moving = np.flatnonzero(self.depth >= 1)
        self.before_hand = np.flatnonzero((self.depth >= 2) & (self.depth < len(robot.joint_names)))

    def _anchor(self, link: str) -> str:
        """The link itself, or the nearest one above it on the chain that is planned."""
        above = self.robot.urdf.above
        while link not in self.robot.chain.frame_to_idx:
            link = above[link][0]
        return link

    def _carried(self, ends: np.ndarray) -> torch.Tensor:
        """(C, 3, 2) ends of the capsules (C, 2, 3) in frames of the joints that carry them."""
        import torch

        rest = np.zeros((1, len(self.robot.joint_names)))
        poses = self.robot.link_poses(rest)
        with torch.no_grad():
            carriers = self._carriers(self.robot.jacobian.frames(torch.from_numpy(rest)))
        relative = np.linalg.solve(carriers[0].numpy(), np.stack([poses[k][0] for k in self.links]))
        return torch.from_numpy(relative[:, :3, :3] @ ends.mT + relative[:, :3, 3:])

    def _carriers(self, frames: torch.Tensor) -> torch.Tensor:
        """(B, C, 4, 4) frames in which the capsules stand still, of joints' frames."""
        import torch

        base = torch.eye(4, dtype=torch.float64).expand(len(frames), 1, 4, 4)
        return torch.cat([base, frames], 1)[:, self.depth]

    def _depths(self) -> dict[str, int]:
        """Moving joints between the base and each link of the chain."""
        above, depths, chain = self.robot.urdf.above, {}, self.robot.chain.frame_to_idx
        for link in chain:
            at, count = link, 0
            while at in above:
                below, (at, joint) = at, above[at]
                count += below in chain and joint.get("name") in self.robot.joint_names
            depths[link] = count
        return depths

    def _pairs(self) -> np.ndarray:
        apart = np.abs(self.depth[:, None] - self.depth[None, :])
        every = np.argwhere(np.triu(apart >= 2))
        disabled = self.robot.urdf.never_in_contact()
        if disabled:
            named = [frozenset((self.links[i], self.links[j])) for i, j in every]
            every = every[[pair not in disabled for pair in named]]
        if len(every) == 0:
            return every.reshape(0, 2)
        near = apart[every[:, 0], every[:, 1]]
        overlap = self._overlap(every)
        # Built into each other; farther apart only what never comes free is left out.
        return every[np.where(near == 2, overlap < 0.3, np.where(near == 3, overlap < 0.9, True))]

    def _overlap(self, pairs: np.ndarray) -> np.ndarray:
        """Share (P,) of random poses in which the shapes of each pair of capsules overlap."""
        import torch

        robot = self.robot
        lower = np.maximum(robot.lower, -np.pi)
        upper = np.minimum(robot.upper, np.pi)
        q = np.random.default_rng(0).uniform(lower, upper, (200, len(lower)))
        with torch.no_grad():
            start, end = self.points(robot.jacobian.frames(torch.from_numpy(q)))
        self.pairs = pairs
        hit = (self.self_distances(start, end) < 0).numpy()
        # Shapes, not capsules: a mesh is built into its neighbour with any of its capsules.
        names = self.shape_of[pairs]
        share = np.zeros(len(pairs))
        for shapes in np.unique(names, axis=0):
            mine = (names == shapes).all(1)
            share[mine] = hit[:, mine].any(1).mean()
        return share

    def points(self, frames: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Ends of the capsules in the base frame, (B, C, 3) each [m], from the joints' frames
        (`GraspJacobian.frames`)."""
        carriers = self._carriers(frames)
        start, end = (carriers[..., :3, :3] @ self._ends + carriers[..., :3, 3:]).unbind(-1)
        return start, end

    def by_joints(self, frames, points, slopes) -> torch.Tensor:
        """(B, n) derivatives by the joints' positions of what has derivatives `slopes`, two of
        (B, C, 3), by the capsules' ends, two of (B, C, 3): forces, whose torques these are."""
        import torch

        below = torch.from_numpy(self.depth > np.arange(frames.shape[1])[:, None]).double()
        force = below @ (slopes[0] + slopes[1])
        cross = torch.linalg.cross
        moment = below @ sum(cross(p, f) for p, f in zip(points, slopes, strict=True))
        about = moment - cross(frames[..., :3, 3], force)
        return _dot(about.unbind(-1), self.robot.jacobian.axes(frames).unbind(-1))

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
        axis = (end[:, low] - start[:, low])[:, :, None].unbind(-1)
        begin = start[:, low, None].unbind(-1)
        offset = [x - y for x, y in zip(contacts.unbind(-1), begin, strict=True)]
        share = (_dot(offset, axis) / _dot(axis, axis).clamp_min(1e-12)).clamp(0, 1)
        near = [x - share * y for x, y in zip(offset, axis, strict=True)]
        gap = (_dot(near, near) + 1e-18).sqrt()
        later = torch.arange(len(contacts))[None] >= laid[:, None]
        gap = gap.masked_fill(later[:, None], _NOTHING).amin(-1)
        return gap - torch.from_numpy(self.radius[low]) - rod_radius

    def columns(self, kind: str) -> np.ndarray:
        """Which capsule each column of a kind of `gaps` is of; not of "links"."""
        if kind in ("table", "laid rod"):
            return self.low
        return self.before_hand if kind == "hanging rod" else self.moving

    def settle(self, gaps: dict, positions: np.ndarray, around, clearance: float) -> dict:
        """The gaps with those of the true shapes where capsules come nearer than `clearance`.

        Args:
            gaps: "links" (K, pairs), "table" and "laid rod" (K, low) [m], of capsules.
            positions: (K, n) joint positions [rad].
            around: `Surroundings` at the same samples.
        """
        if self.exact is None or min(g.min(initial=np.inf) for g in gaps.values()) >= clearance:
            return gaps
        poses = self.robot.link_poses(positions)
        gaps = {**gaps, "links": self.settled_links(gaps["links"], poses, clearance)}
        for kind, top in (("table", 0.0), ("laid rod", 2.0 * around.rod_radius)):
            gap = gaps[kind].copy()
            for column in np.flatnonzero((gap < clearance).any(0)):
                rows = np.flatnonzero(gap[:, column] < clearance)
                shape = int(self.shape_of[self.low[column]])
                lowest = self.exact.lowest(shape, poses[self.shapes[shape].link][rows])
                room = lowest - around.table_height - top
                gap[rows, column] = np.maximum(gap[rows, column], room)
            gaps[kind] = gap
        return gaps

    def settled_links(self, gap: np.ndarray, poses: dict, clearance: float) -> np.ndarray:
        """Gaps (K, pairs) of capsules [m] with those of true shapes where below `clearance`.

        Args:
            poses: of every link, (K, 4, 4) in the base frame [m].
        """
        gap = gap.copy()
        names = self.shape_of[self.pairs] if len(self.pairs) else np.zeros((0, 2), int)
        left = _MOST_EXACT
        for first, second in np.unique(names, axis=0):
            mine = np.flatnonzero((names == (first, second)).all(1))
            rows = np.flatnonzero((gap[:, mine] < clearance).any(1))
            # The worst first: where there are too many, the rest keep what their capsules say.
            rows = rows[np.argsort(gap[np.ix_(rows, mine)].min(1))][:left]
            left -= len(rows)
            for row in rows:
                true = self.exact.gap(
                    int(first),
                    int(second),
                    poses[self.shapes[first].link][row],
                    poses[self.shapes[second].link][row],
                )
                gap[row, mine] = np.maximum(gap[row, mine], true)
        return gap


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
    d1, d2 = (q1 - p1).unbind(-1), (q2 - p2).unbind(-1)
    r = [x - y for x, y in zip(p1.unbind(-1), p2.unbind(-1), strict=True)]
    a = _dot(d1, d1).clamp_min(1e-12)
    e = _dot(d2, d2).clamp_min(1e-12)
    b, c, f = _dot(d1, d2), _dot(d1, r), _dot(d2, r)
    s = ((b * f - c * e) / (a * e - b * b).clamp_min(1e-12)).clamp(0, 1)
    t = ((b * s + f) / e).clamp(0, 1)
    s = ((b * t - c) / a).clamp(0, 1)
    gap = [z + x * s - y * t for x, y, z in zip(d1, d2, r, strict=True)]
    return (_dot(gap, gap) + 1e-18).sqrt()


def _dot(a, b):
    """Of vectors by their three components: operations along so short an axis take torch several
    times as long."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
