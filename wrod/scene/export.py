"""`export_usd`: deployments as one self-contained USD stage."""

import json
import math
import os
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from wrod import arguments
from wrod.errors import SceneError, needed_extras
from wrod.robot.grip import Grip, TravelledPath
from wrod.robot.model import load_robot
from wrod.rods.catalogue import catalogue
from wrod.scene.arm import add_arm, add_visuals, reach_of
from wrod.scene.phases import POINTS, covered, falling, film, rods_of
from wrod.scene.primitives import Materials, set_pose
from wrod.scene.stage import (
    add_cameras,
    add_lights,
    add_view,
    new_stage,
    set_in_time,
    stage_path,
    write_stage,
)
from wrod.scene.workplace import (
    BASE_HEIGHT,
    add_floor,
    add_grip_path,
    add_holder,
    add_pattern,
    add_rod,
    add_stand,
    add_table,
    table_under,
)

# Rods at the nodes of one deployment, or of several.
_shapes = arguments.either(
    arguments.array(finite=False),
    arguments.several(arguments.optional(arguments.array(finite=False))),
)
_DEFAULT_RADIUS = 0.002  # [m] where no rod is given
# Whoever has the stage alone would take its speed for the robot's.
_READ_ME = (
    "Metres, Z up. Time codes are nodes of the plan, no seconds: wrod:time of each deployment is "
    "the robot's time [s], wrod:phase what it does, wrod:arcLength what is laid [m]."
)


@needed_extras()
@arguments.checked(
    SceneError,
    trajectory=arguments.each(
        arguments.like("a wrod.Trajectory", "arc_length", "position", "rotation")
    ),
    joint_path=arguments.optional(
        arguments.each(arguments.optional(arguments.like("a wrod.JointPath", "names", "positions")))
    ),
    shapes=arguments.optional(_shapes),
    rod=arguments.optional(
        arguments.each(arguments.like("a wrod.RodMaterial or wrod.RodModel", "radius", "length"))
    ),
    pattern=arguments.optional(arguments.each(arguments.array((None, 2), (None, 3)), "sample")),
    falls=arguments.optional(arguments.each(arguments.callback)),
)
def export_usd(
    path: str | os.PathLike[str],
    *,
    trajectory=None,
    joint_path=None,
    shapes=None,
    pattern=None,
    rod=None,
    falls=None,
) -> Path:
    """Write a stage of one deployment, or of many side by side, for review in any USD viewer.

    Metres, Z up, the trajectory's frame (table at z = 0); time code k is node k of the trajectory.
    A joint path of the whole job goes on around them: codes below 0 are approach and grasp, the
    rod hanging from the stand that holds it until the hand does; codes beyond the last node the
    laying of the tail, release and retreat. What is still suspended then, with the tail laid a few
    centimetres, falls onto the table as a simulation has it.

    Under /World/Deployment_000: `robot` (its links as nested Xforms) or, without a joint path, the
    `gripper` alone; `table`, `pattern`, `rod`, `grip_path`; the plan's figures as custom data and
    the attributes `wrod:arcLength` [m], `wrod:time` [s] and `wrod:phase` over time. Cameras `top`,
    `work` (rod and hand) and `perspective` are under /World/Cameras.

    Each argument may be a sequence, one entry per deployment; they are then laid out in a
    grid, each turned so that its arm faces +x.

    Args:
        path: the file, .usdc, .usda or .usd.
        trajectory: `Trajectory`, required.
        joint_path: `JointPath` of it; shows the robot.
        shapes: (T, M, 3) centreline of the whole rod at each node [m]; by default from the
            trajectory: laid part and, where the planner computed it, suspended part.
        pattern: `Pattern`, or points (n, 3) [m]; by default the contact points.
        rod: `RodMaterial`; its radius is the rod's thickness (2 mm without it).
        falls: how a rod falls that is let go, where that is known already: (M, 3) as it is held
            [m], (K,) times since then [s] -> (K, M, 3).

    Returns:
        The path.

    Raises:
        SceneError: the suffix is another, the trajectory is missing, or arrays do not fit it.
    """
    path = stage_path(path)
    if trajectory is None:
        raise SceneError("a scene needs a trajectory; pass trajectory=...")
    deployments = _deployments(
        trajectory=trajectory, joint_path=joint_path, shapes=shapes, pattern=pattern, rod=rod,
        falls=falls,
    )  # fmt: skip
    codes = [item.film.code for item in deployments]
    stage = new_stage(min(code[0] for code in codes), max(code[-1] for code in codes))
    materials = Materials(stage)
    pitch = _pitch(deployments)
    columns = math.ceil(math.sqrt(len(deployments)))
    floor = min(item.floor for item in deployments)  # all stand on one
    seen = []
    for number, item in enumerate(deployments):
        row, column = divmod(number, columns)
        shift = np.array([pitch[0] * column, -pitch[1] * row, floor - item.floor])
        shift[:2] -= item.centre
        seen.append(_add_deployment(stage, number, item, shift, materials))
    _surround(stage, deployments, np.concatenate(seen), floor, materials)
    stage.GetRootLayer().documentation = _READ_ME
    stage.GetRootLayer().customLayerData = {"creator": "wrod", "deployments": len(deployments)}
    return write_stage(stage, path)


def _surround(stage, deployments, points: np.ndarray, floor: float, materials) -> None:
    """Floor, lights and cameras around all points (n, 3) that are seen [m]."""
    low, high = points.min(0), points.max(0)
    room = 4.0  # [m] of floor around everything
    add_floor(stage, (low + high)[:2] / 2, (high - low)[:2] + 2 * room, floor, materials)
    add_lights(stage)
    patterns = np.concatenate([item.corners for item in deployments])
    corners = np.stack([patterns.min(0) - 0.10, patterns.max(0) + 0.10])
    back = add_cameras(stage, points, deployments[0].front, corners)
    add_view(stage, "work", np.concatenate([patterns, *(item.way for item in deployments)]), back)


def _deployments(**given) -> list[SimpleNamespace]:
    """One namespace per deployment, checked, with `shapes`, `points`, `radius`, `table`, ..."""
    many = isinstance(given["trajectory"], Sequence)
    count = len(given["trajectory"]) if many else 1
    if count == 0:
        raise SceneError("a scene needs at least one trajectory; the list is empty")
    items = []
    for number in range(count):
        values = {}
        for name, value in given.items():
            is_list = isinstance(value, (list, tuple))
            if many and is_list and len(value) != count:
                raise SceneError(f"{len(value)} of {name} for {count} trajectories; give as many")
            if not many and is_list and name in ("joint_path", "rod"):
                raise SceneError(f"{name} is a list, and the trajectory is one; give one")
            if name == "shapes" and is_list and not many:
                wrong = arguments.array(finite=False)(value)
                if wrong is not None:
                    raise SceneError(f"export_usd: shapes {wrong}")
            values[name] = value[number] if many and is_list else value
        items.append(_complete(SimpleNamespace(**values), number))
    return items


def _complete(item: SimpleNamespace, number: int) -> SimpleNamespace:
    trajectory, joint_path = item.trajectory, item.joint_path
    count = len(trajectory)
    where = f"deployment {number}: "
    if not np.isfinite(trajectory.position).all():
        raise SceneError(f"{where}the trajectory holds numbers that are not finite")
    if joint_path is not None:
        if joint_path.robot is None:
            raise SceneError(
                f"{where}the joint path has no robot; load it with JointPath.load(path, robot)"
            )
        if len(joint_path.node_positions) != count:
            raise SceneError(
                f"{where}the joint path has {len(joint_path.node_positions)} nodes and the "
                f"trajectory {count}; solve it from this trajectory"
            )
    onward = None
    if item.shapes is None:
        item.shapes, onward = rods_of(trajectory, joint_path, item.pattern, POINTS)
    item.shapes = np.asarray(item.shapes)
    shape = item.shapes.shape
    if len(shape) != 3 or shape[0] != count or shape[1] < 2 or shape[2] != 3:
        raise SceneError(f"{where}shapes are {shape}; give ({count}, points, 3), one rod per node")
    if not np.isfinite(item.shapes).all():
        raise SceneError(f"{where}shapes hold numbers that are not finite")
    item.film = film(joint_path, item.shapes, onward, item.falls or falling(trajectory))
    item.points = _pattern_points(item.pattern, trajectory)
    item.radius = _DEFAULT_RADIUS if item.rod is None else float(item.rod.radius)
    rest = None if joint_path is None else item.film.shapes[-1]
    item.table = table_under(covered(trajectory, rest), joint_path, item.radius)
    item.floor = float(item.table.pose[2, 3] + item.table.floor)
    item.ground = item.table.corners()[:, :2]  # what it covers
    if joint_path is not None:
        stands = joint_path.placement.world_from_base @ joint_path.robot.mount
        item.ground = np.vstack([item.ground, stands[:2, 3]])
    return item


def _pattern_points(pattern, trajectory) -> np.ndarray:
    if pattern is None:
        return np.asarray(trajectory.contact, dtype=float)
    if hasattr(pattern, "sample"):
        first = -float(getattr(pattern, "remainder_length", 0.0))
        count = max(50, math.ceil((pattern.length - first) / 0.003))
        return pattern.sample(np.linspace(first, pattern.length, count))[0]
    points = np.asarray(pattern, dtype=float)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or len(points) < 2:
        raise SceneError(f"the pattern's points are {points.shape}; give (n, 3)")
    return points if points.shape[1] == 3 else np.column_stack([points, np.zeros(len(points))])


def _pitch(deployments) -> np.ndarray:
    """Distance of neighbours in the grid [m]: the largest extent of any, and a passage.

    Sets `centre` and `turn` of each: what is taken off and how it is turned in its cell.
    """
    spans = [np.zeros(2)]
    for item in deployments:
        item.centre, item.turn = np.zeros(2), np.eye(3)
        if len(deployments) == 1:
            continue
        if item.joint_path is not None:  # all arms of a grid face the same way
            item.turn = item.joint_path.placement.base_from_world[:3, :3]
        ground = item.ground @ item.turn[:2, :2].T
        item.centre = (ground.min(0) + ground.max(0)) / 2
        spans.append(np.ptp(ground, axis=0))
    return np.max(spans, axis=0) + 0.9


def _add_deployment(stage, number: int, item, shift, materials) -> np.ndarray:
    """Add one deployment; returns points (n, 3) of what there is to see of it [m]."""
    from pxr import Sdf, UsdGeom

    trajectory, joint_path, table = item.trajectory, item.joint_path, item.table
    shown, times = item.film, item.film.code
    root = f"/World/Deployment_{number:03d}"
    prim = UsdGeom.Xform.Define(stage, root).GetPrim()
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = item.turn, shift
    set_pose(prim, pose)
    add_table(stage, f"{root}/table", table, materials)
    add_pattern(stage, f"{root}/pattern", item.points, item.radius, materials)
    name = _rod_name(trajectory, item.rod)
    add_rod(stage, f"{root}/rod", shown.shapes, item.radius, name, times, materials)
    smooth = TravelledPath(trajectory)
    way = smooth.poses(smooth.samples(0.005))[:, :3, 3]
    add_grip_path(stage, f"{root}/grip_path", way, materials)
    below = np.array([0.0, 0.0, table.floor - table.top])
    seen = [
        table.corners(),
        table.corners() + below,
        trajectory.position,
        shown.shapes.reshape(-1, 3),
    ]
    base = np.eye(4)
    if joint_path is None:
        _add_gripper(stage, f"{root}/gripper", trajectory, times, materials)
        front = np.array([0.0, -1.0])
    else:
        robot = joint_path.robot
        base = joint_path.placement.world_from_base
        add_arm(stage, f"{root}/robot", robot, base, shown.positions, times, materials)
        if joint_path.obstacles:
            set_pose(UsdGeom.Xform.Define(stage, f"{root}/obstacles").GetPrim(), base)
            add_visuals(stage, f"{root}/obstacles", joint_path.obstacles, materials)
            seen += [(base @ shape.pose)[None, :3, 3] for shape in joint_path.obstacles]
        if robot.name != "sawyer":  # Sawyer brings its pedestal
            add_stand(stage, f"{root}/stand", base @ robot.mount, BASE_HEIGHT, materials)
        if joint_path.stand:
            there = [joint_path.holds_stand(time) for time in shown.time]
            add_holder(stage, f"{root}/holder", joint_path.stand, times, there, materials)
        front = base[:2, 0]
        links, feet = reach_of(robot, base, shown.positions)
        seen += [*links, feet]
    item.front = item.turn[:2, :2] @ front
    item.corners, item.way = item.points @ item.turn.T + shift, way @ item.turn.T + shift
    figures = {**trajectory.metadata}
    if joint_path is not None:
        figures["joint_path"] = joint_path.metadata
    prim.SetCustomDataByKey("wrod", _plain(figures))
    set_in_time(prim, "wrod:arcLength", trajectory.arc_length[shown.node], times)
    if joint_path is not None:
        set_in_time(prim, "wrod:time", shown.time, times)
        phase = prim.CreateAttribute("wrod:phase", Sdf.ValueTypeNames.Token, custom=True)
        for k, name in enumerate(shown.phase):
            if k == 0 or name != shown.phase[k - 1]:
                phase.Set(name, float(times[k]))
    return np.concatenate(seen) @ item.turn.T + shift


def _add_gripper(stage, path: str, trajectory, times, materials) -> None:
    """The gripper alone at every grip pose, held along the rod."""
    from pxr import UsdGeom

    robot = load_robot("sawyer")
    poses = np.tile(np.eye(4), (len(trajectory), 1, 1))
    poses[:, :3, :3] = trajectory.rotation @ Grip().rotation
    poses[:, :3, 3] = trajectory.position - robot.gripper_length * poses[:, :3, 2]
    set_pose(UsdGeom.Xform.Define(stage, path).GetPrim(), poses, times)
    shapes = [shape for shape in robot.shapes("visual") if shape.link == "gripper"]
    add_visuals(stage, path, shapes, materials)


def _rod_name(trajectory, rod) -> str | None:
    named = trajectory.metadata.get("rod")
    if isinstance(named, str):
        return named
    return next((entry.name for entry in catalogue() if entry.rod == rod), None)


def _plain(value):
    """Metadata as USD takes it: nested dictionaries of numbers, strings and booleans."""
    if isinstance(value, dict):
        return {
            "".join(c if c.isalnum() else "_" for c in str(key)): _plain(entry)
            for key, entry in value.items()
            if entry is not None
        }
    if isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, (float, np.floating)):
        return float(value)
    return json.dumps(value, default=str)
