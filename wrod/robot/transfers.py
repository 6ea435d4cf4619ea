"""What a film of hands asks of the arms: transfers, over which a hand is at work, and the ways in
which a gripper can hold the rod meanwhile.

What an arm does between them is its transit (Alami, Simeon and Laumond, A geometrical approach to
planning manipulation tasks, 1989)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from wrod.errors import RobotError
from wrod.robot.collision import CollisionModel
from wrod.robot.grip import Grip
from wrod.robot.kinematics import grasp_poses

# The hand that is at work finds its rod this near [m].
_NEAR = 0.02
# A rod's end hangs from the hand: tilts of the fingers against it, turns about it [degrees].
_END_ANGLES, _END_ROLLS = (20, 30, 40, 50, 60), tuple(range(0, 360, 15))
# A rod lies on the table: slants of the upright fingers along it [degrees].
_SLANTS = (0, 15, -15, 30, -30, 45, -45)
# The rod need not be in the middle of the pads: nearer their ends [m], or aside.
_DOWN, _ASIDE = (0.0, 0.004, 0.008, 0.010, 0.0125), (0.0, 0.003, -0.003, 0.006, -0.006)
# Room between a table and the fingers, and the hand [m].
_TIP_ROOM, _HAND_ROOM = 0.0003, 0.005


@dataclass(frozen=True)
class HandFilm:
    """Hands and rods over time, on a table at z = 0.

    Attributes:
        time: (T,) [s], growing.
        hands: (T, hand, 4, 4) poses [m]; what a hand holds is fixed to it.
        closed: (T, hand) whether a hand is at work; while it is not, it may go elsewhere.
        rods: (T, node, 3) of every rod [m], NaN before it is there.
    """

    time: np.ndarray
    hands: np.ndarray
    closed: np.ndarray
    rods: tuple[np.ndarray, ...]

    def __post_init__(self) -> None:
        count = len(self.time)
        shapes = self.hands.shape[:1] + self.hands.shape[2:], self.closed.shape
        if shapes != ((count, 4, 4), (count, self.hands.shape[1])):
            raise RobotError(
                f"the film's hands are {self.hands.shape} and closed {self.closed.shape}; give "
                f"({count}, hands, 4, 4) and ({count}, hands)"
            )
        if not (np.isfinite(self.hands).all() and (np.diff(self.time) > 0.0).all()):
            raise RobotError("the film's times must grow and its hands' poses be finite")


@dataclass(frozen=True)
class Transfer:
    """A stretch of frames over which one hand is at work.

    Attributes:
        hand: which.
        first, last: frames.
        poses: (frame, 4, 4) of the hand [m].
        rod: (3, 3) frame of the held rod in the hand's: its tangent, a horizontal axis across it
            where it lies on the table, and their product.
        end: the rod's end hangs from the hand; else the rod lies on the table.
    """

    hand: int
    first: int
    last: int
    poses: np.ndarray
    rod: np.ndarray
    end: bool


@dataclass(frozen=True)
class Hand:
    """The parts of an arm that move with the grasp, in its frame (+z along the fingers).

    Attributes:
        start, end, radius: (capsule, 3), (capsule, 3), (capsule,) [m].
        lifted: (capsule,) whether it is no finger, and must stay above the table.
        tips: (n, 3) corners of the fingers [m].
        fingers: numbers of the fingers' capsules in the collision model.
    """

    start: np.ndarray
    end: np.ndarray
    radius: np.ndarray
    lifted: np.ndarray
    tips: np.ndarray
    fingers: np.ndarray

    @classmethod
    def of(cls, model: CollisionModel) -> Hand:
        import torch

        robot = model.robot
        rest = np.zeros((1, len(robot.joint_names)))
        with torch.no_grad():
            frames = robot.jacobian.frames(torch.from_numpy(rest))
            points = [p[0].numpy() for p in model.points(frames)]
        grasp = np.linalg.inv(grasp_poses(robot, rest)[0])
        start, end = (p @ grasp[:3, :3].T + grasp[:3, 3] for p in points)
        mine = model.depth == model.depth.max()
        at_tip = np.minimum(np.linalg.norm(start, axis=1), np.linalg.norm(end, axis=1)) < 1e-3
        fingers = np.flatnonzero(mine & at_tip)
        lifted = ~np.isin(np.flatnonzero(mine), fingers)
        poses = robot.link_poses(rest)
        tips = [np.zeros((1, 3))]
        for shape in robot.shapes("visual"):
            if shape.link not in {model.links[k] for k in fingers} or shape.kind != "box":
                continue
            corners = np.array(list(product((-0.5, 0.5), repeat=3))) * shape.size
            world = grasp @ poses[shape.link][0] @ shape.pose
            tips.append(corners @ world[:3, :3].T + world[:3, 3])
        return cls(
            start[mine], end[mine], model.radius[mine], lifted, np.concatenate(tips), fingers
        )

    def lowest(self, poses: np.ndarray) -> tuple[float, float]:
        """Least heights [m] of the hand and of the fingers' tips over grasp poses (n, 4, 4)."""
        up, height = poses[:, 2, :3], poses[:, 2, 3][:, None]
        ends = np.minimum(up @ self.start.T, up @ self.end.T) + height - self.radius
        hand = ends[:, self.lifted].min(initial=math.inf)
        return float(hand), float((up @ self.tips.T + height).min())


@dataclass(frozen=True)
class Grasp:
    """One way to hold a rod: the grasp's constant pose in the hand's frame.

    Attributes:
        pose: (4, 4) [m].
        grip: angle between fingers and rod, roll about the rod.
        slant: of the fingers off what is simplest [rad].
    """

    pose: np.ndarray
    grip: Grip
    slant: float

    def targets(self, transfer: Transfer, frames=slice(None)) -> np.ndarray:
        """(n, 4, 4) grasp poses in the table's frame [m]."""
        return transfer.poses[frames] @ self.pose


def find_transfers(film: HandFilm) -> list[Transfer]:
    """Stretches over which a hand is at work, in the order in which they begin."""
    transfers = []
    for hand in range(film.hands.shape[1]):
        edges = np.flatnonzero(np.diff(np.r_[False, film.closed[:, hand], False].astype(int)))
        for first, stop in edges.reshape(-1, 2):
            poses = film.hands[first:stop, hand]
            rod, end = _held_rod(film, int(first), poses[0])
            transfers.append(Transfer(hand, int(first), int(stop) - 1, poses, rod, end))
    return sorted(transfers, key=lambda t: (t.first, t.hand))


def _held_rod(film: HandFilm, frame: int, pose: np.ndarray) -> tuple[np.ndarray, bool]:
    """Frame of the nearest rod in the hand's frame, and whether its end hangs from the hand."""
    tangent, nearest = np.array([1.0, 0.0, 0.0]), _NEAR
    for rod in film.rods:
        distance = np.linalg.norm(rod[frame] - pose[:3, 3], axis=1)
        if np.isnan(distance).any() or distance.min() > nearest:
            continue
        k, nearest = int(distance.argmin()), float(distance.min())
        along = rod[frame, min(k + 1, len(distance) - 1)] - rod[frame, max(k - 1, 0)]
        tangent = along / np.linalg.norm(along)
    if pose[:3, 0] @ tangent > 0.9:
        return np.eye(3), True
    flat = tangent * [1.0, 1.0, 0.0]
    flat = flat / np.linalg.norm(flat) if np.linalg.norm(flat) > 1e-6 else np.array([1.0, 0, 0])
    frame_of_rod = np.column_stack([flat, np.cross([0.0, 0.0, 1.0], flat), [0.0, 0.0, 1.0]])
    return pose[:3, :3].T @ frame_of_rod, False


def find_grasps(transfer: Transfer, hand: Hand) -> list[Grasp]:
    """Ways to hold the rod that keep hand and fingers above the table, the simplest first.

    Raises:
        RobotError: there is none.
    """
    found: list[tuple[float, float, Grasp]] = []
    if transfer.end:
        for angle, roll in product(_END_ANGLES, _END_ROLLS):
            grasp, low = _lowered(
                transfer, hand, Grip(math.radians(angle), math.radians(roll)), 0.0
            )
            found.append((low, angle, grasp))
        # Of each angle the roll that stays highest.
        of_angle = [[one for one in found if one[1] == angle] for angle in _END_ANGLES]
        found = [max(ones, key=lambda one: one[0]) for ones in of_angle]
    else:
        # Half a turn about the fingers is the same grasp for the rod, and another for the arm.
        for slant, back in product(_SLANTS, (False, True)):
            angle = math.pi / 2 + math.radians(slant) * (-1 if back else 1)
            turned = replace(transfer, rod=transfer.rod * [-1.0, -1.0, 1.0]) if back else transfer
            grasp, low = _lowered(turned, hand, Grip(angle, math.pi), math.radians(slant))
            found.append((low, abs(slant), grasp))
    good = [item for item in found if item[0] >= 0.0]
    if not good:
        low = max(item[0] for item in found) + _HAND_ROOM
        raise RobotError(
            f"hand {transfer.hand} cannot hold the rod at frames {transfer.first} to "
            f"{transfer.last}: the gripper would be {-1e3 * low:.1f} mm inside the table however "
            "it is turned; grasp higher or use a slimmer gripper"
        )
    return [grasp for _, _, grasp in sorted(good, key=lambda item: item[1])]


def _lowered(transfer: Transfer, hand: Hand, grip: Grip, slant: float) -> tuple[Grasp, float]:
    """A grasp with the rod as near the fingers' ends as the table asks, and the hand's room."""
    pose = np.eye(4)
    pose[:3, :3] = transfer.rod @ grip.rotation
    options = sorted(product(_DOWN, _ASIDE), key=lambda o: math.hypot(*o))
    best, best_tip = None, -math.inf
    for down, aside in options:
        pose[:3, 3] = -pose[:3, :3] @ [aside, 0.0, down]
        tip = hand.lowest(transfer.poses @ pose)[1]
        if tip > best_tip:
            best, best_tip = pose.copy(), tip
        if tip >= _TIP_ROOM:
            break
    room, _ = hand.lowest(transfer.poses @ best)
    return Grasp(best, grip, slant), room - _HAND_ROOM
