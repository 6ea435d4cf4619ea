"""What surrounds the arm: floor, table, the prescribed pattern, the rod, the grip's path."""

from dataclasses import dataclass

import numpy as np

from wrod.robot.joint_path import JointPath
from wrod.scene.primitives import Materials, add_curve, add_shape, set_pose

TABLE_THICKNESS = 0.03  # [m]
BASE_HEIGHT = 0.9  # [m] of the robot's base above the floor, on its pedestal
COLUMN = 0.09  # [m] radius of that
_WOOD, _LEG, _FLOOR = (0.50, 0.38, 0.26), (0.30, 0.31, 0.33), (0.42, 0.44, 0.47)
_INK, _ROD, _PATH = (0.10, 0.22, 0.55), (0.10, 0.50, 0.22), (0.95, 0.62, 0.12)
ROD_COLORS = {
    "pink-vps": (0.85, 0.30, 0.45),
    "green-vps": _ROD,
    "rope": (0.75, 0.60, 0.35),
    "pink-vps-thick": (0.85, 0.30, 0.45),
    "cable": (0.12, 0.12, 0.14),
}


@dataclass(frozen=True)
class TableTop:
    """A rectangular table in a frame of its own.

    Attributes:
        pose: (4, 4) of the robot's base, or of the world where there is no robot [m].
        low, high: (2,) corners in that frame [m].
        top: height of its surface in that frame [m].
        floor: height of the floor in that frame [m].
    """

    pose: np.ndarray
    low: np.ndarray
    high: np.ndarray
    top: float
    floor: float

    def corners(self) -> np.ndarray:
        """(4, 3) corners of the surface in the world [m]."""
        (x0, y0), (x1, y1) = self.low, self.high
        local = np.array([[x, y, self.top] for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))])
        return local @ self.pose[:3, :3].T + self.pose[:3, 3]

    def boxes(self) -> list[tuple]:
        """Names, centres and sizes (3,) [m], colours of top and legs in that frame."""
        middle, size = (self.low + self.high) / 2, self.high - self.low
        under = self.top - TABLE_THICKNESS
        found = [("top", (*middle, under + TABLE_THICKNESS / 2), (*size, TABLE_THICKNESS), _WOOD)]
        if (height := under - self.floor) > 0.01:
            for number, corner in enumerate(((-1, -1), (1, -1), (1, 1), (-1, 1))):
                at = middle + np.array(corner) * (size / 2 - 0.05)
                centre = (*at, self.floor + height / 2)
                found.append((f"leg_{number}", centre, (0.045, 0.045, height), _LEG))
        return found


def table_under(contact: np.ndarray, path: JointPath | None, rod_radius: float) -> TableTop:
    """Table with room around the contact points (T, 3) [m], before the arm of a joint path where
    there is one.

    Its surface lies a rod's radius below the contact points: these are on the rod's centreline.
    """
    margin = 0.14
    if path is None:
        low, high = contact[:, :2].min(0) - margin, contact[:, :2].max(0) + margin
        top = float(contact[:, 2].min()) - rod_radius
        return TableTop(np.eye(4), low, high, top, top - 0.72)
    to_base = path.placement.base_from_world
    local = contact @ to_base[:3, :3].T + to_base[:3, 3]
    low, high = local[:, :2].min(0) - margin, local[:, :2].max(0) + margin
    # Off the pedestal, in front of it if the pattern is; never smaller than a real table.
    foot, z = path.robot.mount[:2, 3], float(path.robot.mount[2, 3])
    beyond, before = local[:, :2].min(0) - foot, foot - local[:, :2].max(0)
    ahead = beyond[0] - 0.02 > COLUMN
    axis = 0 if ahead or max(beyond[0], before[0]) > max(beyond[1], before[1]) else 1
    if ahead or beyond[axis] > before[axis]:
        low[axis] = foot[axis] + min(max(low[axis] - foot[axis], 0.20), beyond[axis] - 0.02)
    else:
        high[axis] = foot[axis] - min(max(foot[axis] - high[axis], 0.20), before[axis] - 0.02)
    low[1 - axis] = min(low[1 - axis], foot[1 - axis] - 0.35)
    high[1 - axis] = max(high[1 - axis], foot[1 - axis] + 0.35)
    top = float(local[:, 2].min()) - rod_radius
    floor = min(z - BASE_HEIGHT, top - TABLE_THICKNESS)
    return TableTop(path.placement.world_from_base, low, high, top, floor)


def add_table(stage, path: str, table: TableTop, materials: Materials) -> None:
    """The table's top and legs."""
    from pxr import UsdGeom

    set_pose(UsdGeom.Xform.Define(stage, path).GetPrim(), table.pose)
    for name, centre, size, color in table.boxes():
        pose = np.eye(4)
        pose[:3, 3] = centre
        add_shape(stage, f"{path}/{name}", "box", size, pose, materials, color)


def add_stand(stage, path: str, base: np.ndarray, height: float, materials: Materials) -> None:
    """A column from the floor up to an arm's base (4, 4) [m]."""
    for name, radius, tall, down in (
        ("column", COLUMN, height, height / 2),
        ("foot", 0.22, 0.03, height - 0.015),
    ):
        pose = np.array(base, dtype=float)
        pose[:3, 3] -= pose[:3, 2] * down
        add_shape(stage, f"{path}_{name}", "cylinder", (radius, tall), pose, materials, _LEG)


def add_holder(stage, path: str, parts, times, there, materials: Materials) -> None:
    """The stand that holds the rod until the hand does, to be seen at the time codes (T,) at which
    it is `there` (T,); parts are `JointPath.stand`."""
    from pxr import UsdGeom

    UsdGeom.Xform.Define(stage, path)
    for name, (start, end, radius) in zip(("post", "clip"), parts, strict=True):
        curve = add_curve(stage, f"{path}/{name}", [start, end], 2 * radius, materials, _LEG)
        visible = curve.CreateVisibilityAttr()
        for k, code in enumerate(times):
            if k == 0 or there[k] != there[k - 1]:
                visible.Set("inherited" if there[k] else "invisible", float(code))


def add_floor(stage, centre, size, height: float, materials: Materials) -> None:
    """A slab whose upper face is at `height` [m]."""
    pose = np.eye(4)
    pose[:3, 3] = *centre, height - 0.01
    add_shape(stage, "/World/floor", "box", (*size, 0.02), pose, materials, _FLOOR)


def add_pattern(stage, path: str, points, rod_radius: float, materials: Materials) -> None:
    """The prescribed pattern as a thin line drawn on the table; points (n, 3) [m]."""
    width = min(0.0024, rod_radius)
    drawn = np.array(points, dtype=float)
    drawn[:, 2] -= rod_radius  # its lower half is in the table: a line, not a second rod
    add_curve(stage, path, drawn, width, materials, _INK)


def add_rod(stage, path: str, shapes, radius, name, times, materials: Materials) -> None:
    """The rod at its true thickness; shapes (T, M, 3) [m]."""
    color = ROD_COLORS.get(name, _ROD)
    add_curve(stage, path, shapes, 2 * radius, materials, color, times)


def add_grip_path(stage, path: str, position, materials: Materials) -> None:
    """The path of the grip as a thin line; position (T, 3) [m]."""
    add_curve(stage, path, position, 0.002, materials, _PATH)
