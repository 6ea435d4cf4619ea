"""One arm at its place, and what it may not touch."""

import numpy as np

from wrod.robot.collision import CollisionModel, between
from wrod.robot.kinematics import grasp_poses
from wrod.robot.model import Robot
from wrod.robot.placement import Placement
from wrod.robot.transfers import Hand

LINK_ROOM = 0.005  # [m] between links of one arm, and above the table
ARM_ROOM = 0.02  # [m] between the arms
TIP_ROOM = -0.0015  # [m] fingers press on the table by no more than a rod gives way
_WANTED = {"links": LINK_ROOM, "table": LINK_ROOM, "tips": TIP_ROOM, "arm": ARM_ROOM}


class Arm:
    """An arm with its capsules, standing before the table z = 0.

    Attributes:
        robot, model, hand: its description.
        placement: of the table's frame in its base.
    """

    def __init__(self, robot: Robot, model: CollisionModel, hand: Hand, placement: Placement):
        self.robot, self.model, self.hand, self.placement = robot, model, hand, placement
        self._lifted = np.setdiff1d(model.low, hand.fingers)

    @property
    def base(self) -> np.ndarray:
        """(4, 4) pose of the base in the table's frame [m]."""
        return self.placement.world_from_base

    def capsules(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Starts, ends (K, C, 3) and radii (C,) in the table's frame [m] at (K, n) [rad]."""
        return self._in_table(*self.model.points(self._frames(positions)))

    def _in_table(self, start, end) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        start, end = (self.placement.to_world(p.numpy()) for p in (start, end))
        return start, end, self.model.radius

    def _frames(self, positions: np.ndarray):
        """(K, n, 4, 4) of the joints in the base."""
        import torch

        with torch.no_grad():
            return self.robot.jacobian.frames(torch.tensor(positions))

    def grasps(self, positions: np.ndarray) -> np.ndarray:
        """(K, 4, 4) poses of the grasp in the table's frame [m]."""
        return self.base @ grasp_poses(self.robot, positions)

    def rooms(self, positions: np.ndarray, other=None) -> dict[str, np.ndarray]:
        """Gaps (K,) [m] between "links", to the "table", of the fingers' "tips" to it, and to the
        other "arm" where its capsules are given."""
        frames = self._frames(positions)
        start, end = self.model.points(frames)
        links = self.model.self_distances(start, end).numpy()
        if self.model.exact is not None and links.size and links.min() < LINK_ROOM:
            poses = self.robot.link_poses(positions)
            links = self.model.settled_links(links, poses, LINK_ROOM)
        links = links.min(-1, initial=np.inf)
        low = self._lifted
        heights = np.minimum(start[:, low, 2].numpy(), end[:, low, 2].numpy())
        table = (heights - self.model.radius[low]).min(1) - self.placement.z
        poses = self.base @ self.robot.jacobian.pose(frames).numpy()
        tips = (poses[:, 2, :3] @ self.hand.tips.T).min(1) + poses[:, 2, 3]
        rooms = {"links": links, "table": table, "tips": tips}
        if other is not None:
            rooms["arm"] = gap_between(self._in_table(start, end), other)
        return rooms

    def clear(self, positions: np.ndarray, other=None) -> np.ndarray:
        """(K,) whether an arm at (K, n) has all the room that it must have."""
        rooms = self.rooms(positions, other)
        return np.all([room >= _WANTED[kind] for kind, room in rooms.items()], axis=0)

    def shortfalls(self, paths: np.ndarray, other=None) -> np.ndarray:
        """(B,) by how much each of several paths (B, K, n) fails, 0 if it does not."""
        if other is not None:
            start, end, radius = other
            other = *(np.tile(p, (len(paths), 1, 1)) for p in (start, end)), radius
        rooms = self.rooms(paths.reshape(-1, paths.shape[2]), other)
        least = {kind: room.reshape(paths.shape[:2]).min(1) for kind, room in rooms.items()}
        short = [_WANTED[kind] - room for kind, room in least.items()]
        return np.max(short, axis=0).clip(0.0)

    def problem(self, positions: np.ndarray, other=None) -> tuple[float, str | None]:
        """By how much a path (K, n) fails, 0 if it does not, and how; `other` are capsules."""
        worst, what = 0.0, None
        names = {"links": "two of its links come", "tips": "its fingers come"}
        for kind, room in self.rooms(positions, other).items():
            short = _WANTED[kind] - float(room.min())
            if short > worst:
                to = {"links": "", "arm": " to the other arm"}.get(kind, " to the table")
                worst = short
                what = f"{names.get(kind, 'it comes')} within {1e3 * room.min():.1f} mm{to}"
        return worst, what

    def in_base(self, capsules):
        """Another arm's capsules, given in the table's frame, in this arm's base."""
        start, end, radius = capsules
        return self.placement.to_base(start), self.placement.to_base(end), radius


def gap_between(one, other) -> np.ndarray:
    """(K,) least gap [m] between two arms' capsules in one frame; see `Arm.capsules`."""
    import torch

    start, end = (torch.from_numpy(p) for p in one[:2])
    return between(start, end, one[2], *other).flatten(1).amin(-1).numpy()


def with_middles(positions: np.ndarray, other=None):
    """A path (2 K - 1, n) with the points half way between its frames, and the same of `other`."""

    def dense(values):
        out = np.repeat(values, 2, axis=0)[:-1]
        out[1::2] = (values[1:] + values[:-1]) / 2
        return out

    if other is None:
        return dense(positions), None
    return dense(positions), (dense(other[0]), dense(other[1]), other[2])
