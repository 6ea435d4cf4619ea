"""A tied knot, with both arms, as a USD stage."""

from __future__ import annotations

import os
import tempfile
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from wrod.errors import RobotError, SceneError
from wrod.files import write_atomically
from wrod.fixtures import Fixtures
from wrod.robot.joint_path import JointPath, solve_joint_path
from wrod.robot.placement import Placement
from wrod.scene.arm import add_arm
from wrod.scene.primitives import Materials, add_curve, add_shape
from wrod.scene.stage import add_cameras, add_lights, new_stage
from wrod.scene.workplace import (
    BASE_HEIGHT,
    ROD_COLORS,
    add_floor,
    add_pattern,
    add_table,
    table_under,
)
from wrod.substrate import Cylinder
from wrod.trajectory import Trajectory

SUFFIXES = (".usdc", ".usda", ".usd")
_STEEL, _OTHER = (0.62, 0.64, 0.67), (0.10, 0.50, 0.22)
# The gripper's collision shape ends in a ball wider than its fingers, which do reach the table.
_FINGER_ROOM = 0.025  # [m]
# An arm that cannot follow the corners of its hand's way may round them over so many frames
# (standard deviation): splines through sharp corners swing.
_ROUNDED = 1.5
_SIDE = 0.10  # [m] beside the patterns, where rods wait that are laid later


def export_scene(
    path: str | os.PathLike[str],
    *,
    time: np.ndarray,
    rods: list[np.ndarray],
    names: list[str],
    radii: list[float],
    patterns: list,
    hands: np.ndarray | None = None,
    fixtures: Fixtures | None = None,
    facts: dict | None = None,
) -> tuple[Path, list[str]]:
    """Write a stage of rods, fixtures and two arms over time; time code k is frame k.

    The arms stand opposite each other; each follows its hand through all frames. An arm whose path
    is out of reach is left out, and named. Arms are not checked against each other.

    Args:
        path: the file, .usdc, .usda or .usd.
        time: (T,) [s], written as the attribute `wrod:time`.
        rods: (T, node, 3) of every rod [m]; NaN before it is laid. The table is z = 0.
        names, radii: of the rods; names of presets give their colours.
        patterns: what was to be laid.
        hands: (T, hand, 4, 4) poses of the hands, x along the rod that hangs from it.
        fixtures: posts and clips.
        facts: custom data of the stage.

    Returns:
        The path, and what was left out.

    Raises:
        SceneError: the suffix is another, or the arrays do not fit.
    """
    from pxr import Sdf, UsdGeom

    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise SceneError(f"{path}: a stage needs one of the suffixes {', '.join(SUFFIXES)}")
    time = np.asarray(time, dtype=float)
    for rod in rods:
        if rod.ndim != 3 or len(rod) != len(time):
            raise SceneError(f"a rod's frames are {rod.shape}; give ({len(time)}, nodes, 3)")
    stage = new_stage(len(time))
    materials = Materials(stage)
    codes = np.arange(len(time), dtype=float)
    drawn = [p.sample(np.linspace(-p.remainder_length, p.length, 300))[0] for p in patterns]
    ground = np.concatenate(drawn)
    ground = np.vstack([ground, ground.min(0) - _SIDE * np.array([0, 1, 0])])
    arms, missing = [], []
    if hands is not None:
        arms, missing = _arms(hands, ground)
    placement = arms[0][1].placement if arms else None
    table = table_under(ground, None, 0.0)
    root = "/World/Deployment_000"
    prim = UsdGeom.Xform.Define(stage, root).GetPrim()
    add_table(stage, f"{root}/table", table, materials)
    for k, points in enumerate(drawn):
        add_pattern(stage, f"{root}/pattern_{k}", points + [0, 0, radii[k]], radii[k], materials)
    for k, rod in enumerate(rods):
        color = ROD_COLORS.get(names[k], _OTHER)
        frames = _waiting(rod, ground, radii[k])
        add_curve(stage, f"{root}/rod_{k}", frames, 2 * radii[k], materials, color, codes)
    if fixtures is not None:
        _add_fixtures(stage, f"{root}/fixtures", fixtures, materials)
    seen = [table.corners(), *[np.nan_to_num(rod[::10].reshape(-1, 3)) for rod in rods]]
    floor = table.floor
    front = np.array([0.0, -1.0])
    for number, joint_path in arms:
        base = joint_path.placement.world_from_base
        robot = joint_path.robot
        add_arm(
            stage,
            f"{root}/robot_{number}",
            robot,
            base,
            joint_path.node_positions,
            codes,
            materials,
        )
        floor = min(floor, float(base[2, 3]) - BASE_HEIGHT)
        poses = robot.link_poses(joint_path.node_positions[:: max(1, len(time) // 20)])
        for link in poses.values():
            seen.append(link[:, :3, 3] @ base[:3, :3].T + base[:3, 3])
        feet = [[x, y, -BASE_HEIGHT] for x in (-0.3, 0.3) for y in (-0.3, 0.3)]
        seen.append(base[:3, 3] + feet)
    if placement is not None:
        # From the side, so that neither arm stands before the table.
        front = np.array([-placement.world_from_base[1, 0], placement.world_from_base[0, 0]])
    points = np.concatenate(seen)
    low, high = points.min(0), points.max(0)
    add_floor(stage, "/World/floor", (low + high)[:2] / 2, (high - low)[:2] + 8.0, floor, materials)
    add_lights(stage)
    corners = np.stack([ground.min(0) - 0.08, ground.max(0) + 0.08])
    add_cameras(stage, points, front, corners)
    attribute = prim.CreateAttribute("wrod:time", Sdf.ValueTypeNames.Double, custom=True)
    for code, value in zip(codes, time, strict=True):
        attribute.Set(float(value), float(code))
    prim.SetCustomDataByKey("wrod", {k: v for k, v in (facts or {}).items() if v is not None})
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / f"scene{path.suffix}"
        if not stage.GetRootLayer().Export(str(draft)):
            raise SceneError(f"{path}: the stage could not be written")
        data = draft.read_bytes()
    return write_atomically(path, lambda file: file.write(data), "wb"), missing


def _waiting(rod: np.ndarray, ground: np.ndarray, radius: float) -> np.ndarray:
    """Frames without gaps: until it is laid, a rod waits straight beside the patterns."""
    out = np.array(rod, dtype=float)
    absent = np.isnan(out).any(axis=(1, 2))
    if absent.any():
        first = out[~absent][0]
        arc = np.concatenate([[0.0], np.linalg.norm(np.diff(first, axis=0), axis=1).cumsum()])
        x = arc - arc[-1] / 2 + (ground[:, 0].min() + ground[:, 0].max()) / 2
        line = np.column_stack([x, np.full_like(x, ground[:, 1].min()), np.full_like(x, radius)])
        out[absent] = line
    return out


def hand_trajectory(poses: np.ndarray, ground: np.ndarray) -> Trajectory:
    """A hand's film (T, 4, 4) as a trajectory for `wrod.solve_joint_path`: its 'arc length' only
    orders the frames."""
    count = len(poses)
    way = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    order = np.concatenate([[0.0], np.cumsum(np.maximum(way, 1e-3))])
    contact = ground[np.linspace(0, len(ground) - 1, count).astype(int)] * [1, 1, 0]
    return Trajectory(
        order, contact, poses[:, :3, 3], poses[:, :3, :3], np.full((count, 3), np.nan)
    )


def _arms(hands: np.ndarray, ground: np.ndarray) -> tuple[list[tuple[int, JointPath]], list[str]]:
    """Joint paths of the arms that reach all frames, and those that do not."""
    arms: list[tuple[int, JointPath]] = []
    missing = []
    for hand in range(hands.shape[1]):
        trajectory = hand_trajectory(hands[:, hand], ground * [1, 1, 0])
        choices = ["auto"]
        if arms:
            choices = [_opposite(arms[0][1].placement, ground), "auto"]
        problem = None
        for choice, rounded in product(choices, (0.0, _ROUNDED)):
            try:
                joint_path = _solve(trajectory, choice, rounded)
            except RobotError as error:
                problem = error
                continue
            arms.append((hand, joint_path))
            break
        else:
            missing.append(f"arm {hand}: {problem}")
    return arms, missing


def _solve(trajectory: Trajectory, placement, rounded: float) -> JointPath:
    """The fingers reach the table, which therefore counts as lower."""
    lift = np.array([0.0, 0.0, _FINGER_ROOM])
    way = trajectory.position
    if rounded > 0.0:
        way = gaussian_filter1d(way, rounded, axis=0, mode="nearest")
    raised = replace(trajectory, position=way + lift)
    if isinstance(placement, Placement):
        placement = replace(placement, z=placement.z - _FINGER_ROOM)
    found = solve_joint_path(raised, placement=placement, grip_angle=0.0, rod_radius=0.001)
    return replace(found, placement=replace(found.placement, z=found.placement.z + _FINGER_ROOM))


def _opposite(placement: Placement, ground: np.ndarray) -> Placement:
    """The same place before the table, on its other side."""
    middle = (ground.min(0) + ground.max(0)) / 2
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    turn[:2, 3] = 2 * middle[:2]
    base = np.linalg.inv(turn @ placement.world_from_base)
    return Placement(
        float(base[0, 3]),
        float(base[1, 3]),
        float(base[2, 3]),
        float(np.arctan2(base[1, 0], base[0, 0])),
    )


def _add_fixtures(stage, path: str, fixtures: Fixtures, materials: Materials) -> None:
    from pxr import UsdGeom
    from scipy.spatial.transform import Rotation

    UsdGeom.Xform.Define(stage, path)
    for number, item in enumerate(fixtures.items):
        pose = np.eye(4)
        pose[:3, 3] = item.shape.center
        pose[:3, :3] = Rotation.from_euler("z", item.yaw).as_matrix()
        if isinstance(item.shape, Cylinder):
            kind, size = "cylinder", (item.shape.radius, 2 * item.shape.half_height)
        else:
            kind, size = "box", tuple(2 * v for v in item.shape.half_size)
        add_shape(stage, f"{path}/fixture_{number:02d}", kind, size, pose, materials, _STEEL)
