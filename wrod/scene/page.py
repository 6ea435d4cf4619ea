"""A deployment as one HTML page: arm, rod and table in true time, drawn by Viser without Newton.

The page holds everything (no outside links) and plays in any browser with WebGL: drag to turn,
slider and pause below. The rod is a tube of its true radius, and a line of a few pixels along it
wherever that would be thinner.
"""

from __future__ import annotations

import contextlib
import io
import os
import socket
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.errors import SceneError
from wrod.files import write_atomically
from wrod.robot.mesh import read_mesh
from wrod.robot.urdf import LinkShape
from wrod.scene.phases import covered, rods_of, with_release
from wrod.scene.workplace import BASE_HEIGHT, TABLE_THICKNESS, table_under

_FRAMES = 400  # at most: a page of a few MB whatever the path's duration
_LINE, _DRAWN = 3.5, 2.5  # [px] of the rod's line and the pattern's
_ROD_POINTS = 121
_SIDES = 10  # of the rod's tube
_VIEW, _WIDE = 0.75, 1.2  # [rad] of the camera up and down; width over height that is filled
_GREY = (115, 115, 122)
_WOOD, _LEG, _FLOOR = (128, 97, 66), (77, 79, 84), (165, 170, 176)
_INK, _ROD = (26, 56, 140), (20, 150, 60)


def write_deployment_page(
    out: str | os.PathLike[str],
    trajectory,
    joint_path=None,
    *,
    pattern=None,
    rod=None,
    shapes: np.ndarray | None = None,
    errors: np.ndarray | None = None,
    time: np.ndarray | None = None,
    captions: list[str] | None = None,
) -> Path:
    """Write a deployment as one page.

    Args:
        trajectory: `Trajectory`.
        joint_path: `JointPath` of it, for the arm and for true time; without it the grip alone.
        pattern: `Pattern` drawn on the table; by default the contact points.
        rod: `RodMaterial`, for its radius.
        shapes: (T, M, 3) centrelines of the rod [m]; by default from the trajectory.
        errors: (T, M) distance of its points from where they should lie [m], shown as colours.
        time: (T,) when each shape is reached [s]; by default the joint path's, else 2 cm/s.
        captions: lines above the table.

    Raises:
        SceneError: Viser is missing.
    """
    try:
        import viser
    except ImportError as error:
        raise SceneError("pages need Viser; install wrod[view]") from error
    radius = 0.002 if rod is None else float(rod.radius)
    onward = None
    if shapes is None:
        shapes, onward = rods_of(trajectory, joint_path, pattern, _ROD_POINTS)
    if time is None:
        laid = trajectory.arc_length - trajectory.arc_length[0]
        time = laid / 0.02 if joint_path is None else joint_path.node_time
    at_nodes = len(time) == len(trajectory)
    if joint_path is not None and at_nodes and errors is None:
        shapes, time = with_release(joint_path, shapes, time, onward)
    duration = float(time[-1]) if joint_path is None else float(joint_path.time[-1])
    count = int(np.clip(np.ceil(duration * 10.0) + 1, 2, _FRAMES))
    at = np.linspace(0.0, duration, count)
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host="127.0.0.1", port=_free_port(), verbose=False)
    try:
        placement = None if joint_path is None else joint_path.placement
        lies = covered(trajectory, joint_path, onward)
        _workplace(server, trajectory, lies, placement, pattern, radius)
        arm = None if joint_path is None else _Arm(server, joint_path, at)
        nodes = np.interp(at, time, np.arange(len(time)))
        line = _rod_line(server, shapes, errors, nodes[0], radius)
        holder = [] if joint_path is None else _holder(server, joint_path.metadata)
        contact = trajectory.contact.mean(0)
        label = _captions(server, trajectory, joint_path, captions, contact)
        _aim(server.initial_camera, placement, _seen(trajectory, shapes, arm))
        recording = server.get_scene_serializer()
        for k, node in enumerate(nodes):
            if arm is not None:
                arm.pose(k)
            _move_rod(line, shapes, errors, node)
            if holder and joint_path.phase_at(at[k]) not in ("approach", "grasp"):
                for part in holder:
                    part.visible = False
                holder = []
            if k % 5 == 0 or k == count - 1:
                label.text = _clock(at[k], duration, joint_path)
                if at_nodes:
                    laid = np.interp(node, np.arange(len(trajectory)), trajectory.arc_length)
                    if onward is not None:
                        laid = np.interp(at[k], joint_path.time, joint_path.arc_length)
                    label.text += f", {100 * laid:.1f} cm laid"
            recording.insert_sleep(duration / max(count - 1, 1))
        page = recording.as_html(dark_mode=False)
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
    return write_atomically(out, lambda file: file.write(page))


def _clock(now: float, duration: float, joint_path) -> str:
    doing = "" if joint_path is None else f"{joint_path.phase_at(now)}: "
    return f"{doing}{now:.1f} s of {duration:.0f} s"


def write_laying_page(
    out: str | os.PathLike[str], deployment, trajectory, pattern, rod, interval: float
) -> Path:
    """Write a simulated deployment as one page, the rod coloured by how far what lies is from where
    it should: green on the pattern, red from a centimetre on.

    Args:
        deployment: `wrod.Deployment` with its frames.
        trajectory: that was followed.
        pattern: `Pattern` with its remainder; `rod`: for its radius.
        interval: of the frames [s].

    Raises:
        SceneError: the deployment has no frames, or Viser is missing.
    """
    frames = deployment.frames
    if frames is None or len(frames) < 2:
        raise SceneError("the deployment has no frames; simulate it with a frame interval")
    on_pattern = np.clip(
        deployment.arc_length - pattern.remainder_length, -pattern.remainder_length, pattern.length
    )
    target = pattern.sample(on_pattern)[0]
    apart = np.linalg.norm((frames - target)[..., :2], axis=2)
    beyond = deployment.arc_length > pattern.remainder_length + pattern.length
    lies = (frames[..., 2] - target[:, 2] < 2.0 * rod.radius) & ~beyond
    return write_deployment_page(
        out,
        trajectory,
        pattern=pattern,
        rod=rod,
        shapes=frames,
        errors=np.where(lies, apart, 0.0),
        time=interval * np.arange(len(frames)),
        captions=[
            f"{100 * deployment.error_mean:.2f} cm from the pattern with the grip holding, "
            f"{100 * deployment.released_error_mean:.2f} cm let go",
            "green: on the pattern; red: a centimetre off",
        ],
    )


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _seen(trajectory, shapes: np.ndarray, arm) -> np.ndarray:
    """(n, 3) points that the camera is to show [m]: table, rod, and the arm's links."""
    points = [trajectory.contact, shapes[:: max(1, len(shapes) // 20)].reshape(-1, 3)]
    return np.concatenate(points if arm is None else [*points, arm.places()])


def _aim(camera, placement, seen: np.ndarray) -> None:
    """Look at points (n, 3) [m] from opposite the arm, from one side and from above, near enough
    to fill the view."""
    away = np.array([1.0, -1.0])
    if placement is not None:
        away = -placement.world_from_base[:2, 3]
        away = away / max(np.linalg.norm(away), 1e-9)
        away = away + 0.8 * np.array([-away[1], away[0]])
    back = np.append(away / np.linalg.norm(away), 0.55)
    back /= np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(back, right), back])
    local = seen @ axes.T
    middle = (local.min(0) + local.max(0)) / 2
    across = np.abs(local - middle) / [_WIDE, 1.0, 1.0]
    distance = (across[:, :2].max(1) / np.tan(0.45 * _VIEW) + (local - middle)[:, 2]).max()
    camera.fov = _VIEW
    camera.up = (0.0, 0.0, 1.0)
    camera.look_at = tuple(middle @ axes)
    camera.position = tuple((middle + [0.0, 0.0, distance]) @ axes)


def _pose(matrix: np.ndarray) -> dict:
    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    return {"wxyz": (w, x, y, z), "position": tuple(map(float, matrix[:3, 3]))}


def _workplace(server, trajectory, lies, placement, pattern, radius: float) -> None:
    table = table_under(lies, placement, radius)
    middle, size = (table.low + table.high) / 2, table.high - table.low
    frame = np.array(table.pose)

    def box(name: str, at, dimensions, color) -> None:
        matrix = frame.copy()
        matrix[:3, 3] = frame[:3, :3] @ np.asarray(at, float) + frame[:3, 3]
        server.scene.add_box(name, color=color, dimensions=tuple(dimensions), **_pose(matrix))

    top = table.top - TABLE_THICKNESS / 2
    box("/table/top", (*middle, top), (*size, TABLE_THICKNESS), _WOOD)
    height = table.top - TABLE_THICKNESS - table.floor
    if height > 0.01:
        for number, (x, y) in enumerate(((-1, -1), (1, -1), (1, 1), (-1, 1))):
            at = middle + np.array([x, y]) * (size / 2 - 0.05)
            box(
                f"/table/leg_{number}",
                (*at, table.floor + height / 2),
                (0.045, 0.045, height),
                _LEG,
            )
    box("/floor", (*middle, table.floor - 0.01), (*(size + 2.0), 0.02), _FLOOR)
    points = trajectory.contact
    if hasattr(pattern, "sample"):
        points = pattern.sample(np.linspace(-pattern.remainder_length, pattern.length, 300))[0]
    points = points * [1, 1, 0] + [0, 0, trajectory.contact[0, 2] - radius + 5e-4]
    _segments(server, "/pattern", points, _INK, _DRAWN)


def _segments(server, name: str, points: np.ndarray, color, width: float):
    pairs = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
    colors = np.broadcast_to(np.asarray(color, dtype=np.uint8), pairs.shape)
    return server.scene.add_line_segments(
        name, points=pairs, colors=colors, thickness=width, thickness_units="screen"
    )


def _rod_at(shapes: np.ndarray, node: float) -> np.ndarray:
    low = min(int(node), len(shapes) - 2)
    share = node - low
    return (1 - share) * shapes[low] + share * shapes[low + 1]


def _colours(errors: np.ndarray | None, node: float, count: int) -> np.ndarray:
    """(count, 3) green where the rod lies as it should, to red at a centimetre."""
    if errors is None:
        return np.broadcast_to(np.array(_ROD, np.uint8), (count, 3))
    share = np.clip(_rod_at(errors, node) / 0.01, 0.0, 1.0)[:, None]
    good, bad = np.array(_ROD, float), np.array([215.0, 30.0, 30.0])
    return ((1 - share) * good + share * bad).astype(np.uint8)


def _tube(points: np.ndarray, radius: float) -> dict:
    """What a batch of unit tubes needs to lie along points (n, 3) [m]: one between neighbours."""
    steps = np.diff(points, axis=0)
    length = np.maximum(np.linalg.norm(steps, axis=1), 1e-9)
    # The shortest turn of z onto the step.
    turn = np.column_stack([length + steps[:, 2], -steps[:, 1], steps[:, 0], 0.0 * length])
    turn[turn[:, 0] < 1e-9 * length] = [0.0, 1.0, 0.0, 0.0]
    scale = np.column_stack([np.full((len(steps), 2), radius), length + 0.3 * radius])
    return {
        "batched_positions": ((points[:-1] + points[1:]) / 2).astype(np.float32),
        "batched_wxyzs": (turn / np.linalg.norm(turn, axis=1, keepdims=True)).astype(np.float32),
        "batched_scales": scale.astype(np.float32),
    }


def _unit_tube() -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a tube about z, of radius and length 1, open at its ends."""
    angle = np.linspace(0.0, 2 * np.pi, _SIDES, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    low, high = (np.column_stack([ring, np.full(_SIDES, z)]) for z in (-0.5, 0.5))
    k = np.arange(_SIDES)
    after = (k + 1) % _SIDES
    faces = np.concatenate(
        [
            np.column_stack([k, after, k + _SIDES]),
            np.column_stack([after, after + _SIDES, k + _SIDES]),
        ]
    )
    return np.concatenate([low, high]).astype(np.float32), faces.astype(np.uint32)


def _rod_line(server, shapes, errors, node: float, radius: float) -> dict:
    points = _rod_at(shapes, node)
    over = points + [0.0, 0.0, radius]
    tube = server.scene.add_batched_meshes_simple(
        "/rod/body",
        *_unit_tube(),
        batched_colors=_colours(errors, node, len(points))[1:].copy(),
        lod="off",
        side="double",
        **_tube(points, radius),
    )
    return {
        "line": _segments(server, "/rod/line", over, _ROD, _LINE),
        "body": tube,
        "radius": radius,
    }


def _move_rod(rod: dict, shapes, errors, node: float) -> None:
    points = _rod_at(shapes, node).astype(np.float32)
    over = points + np.array([0.0, 0.0, rod["radius"]], np.float32)  # before the pattern's line
    rod["line"].points = np.stack([over[:-1], over[1:]], axis=1)
    for name, value in _tube(points, rod["radius"]).items():
        if name != "batched_scales":  # a rod keeps its length
            setattr(rod["body"], name, value)
    if errors is not None:
        colors = _colours(errors, node, len(points))
        rod["line"].colors = np.stack([colors[:-1], colors[1:]], axis=1)
        rod["body"].batched_colors = colors[1:].copy()


def _holder(server, metadata: dict) -> list:
    """The stand that holds the rod until the hand does."""
    parts = []
    for name, (start, end, radius) in zip(
        ("post", "clip"), metadata.get("stand", ()), strict=False
    ):
        points = np.array([start, end], dtype=float)
        tube = _tube(points, radius)
        parts.append(
            server.scene.add_cylinder(
                f"/holder/{name}",
                radius=radius,
                height=float(np.linalg.norm(points[1] - points[0])),
                color=_LEG,
                wxyz=tube["batched_wxyzs"][0],
                position=tube["batched_positions"][0],
            )
        )
    return parts


class _Arm:
    """The arm's links as meshes that move, on a stand."""

    def __init__(self, server, joint_path, at: np.ndarray):
        robot = joint_path.robot
        if robot is None:
            raise SceneError(
                "the joint path has no robot; load it with JointPath.load(path, robot)"
            )
        positions = np.column_stack(
            [np.interp(at, joint_path.time, q) for q in joint_path.positions.T]
        )
        base = joint_path.placement.world_from_base
        poses = robot.link_poses(positions)
        self._links = []
        shown: dict[str, list[LinkShape]] = {}
        for shape in robot.shapes("visual") or robot.shapes("collision"):
            shown.setdefault(shape.link, []).append(shape)
        for link, shapes in shown.items():
            local = base @ poses[link]
            frame = server.scene.add_frame(f"/arm/{link}", show_axes=False, **_pose(local[0]))
            for number, shape in enumerate(shapes):
                _add_shape(server, f"/arm/{link}/{number}", shape)
            turns = Rotation.from_matrix(local[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
            moves = bool(np.ptp(local, axis=0).max() > 1e-9)
            self._links.append((frame, turns, local[:, :3, 3], moves))
        if robot.name != "sawyer":  # Sawyer brings its pedestal
            below = base.copy()
            below[:3, 3] = base[:3, 3] - base[:3, 2] * (BASE_HEIGHT / 2)
            server.scene.add_cylinder(
                "/stand", radius=0.09, height=BASE_HEIGHT, color=_LEG, **_pose(below)
            )

    def places(self) -> np.ndarray:
        """(n, 3) where the links are in the course of the path, with some room about them [m]."""
        some = np.concatenate(
            [places[:: max(1, len(places) // 40)] for _, _, places, _ in self._links]
        )
        room = 0.06 * np.array(
            [[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1.5]]
        )
        return (some[:, None] + room).reshape(-1, 3)

    def pose(self, k: int) -> None:
        for frame, turns, places, moves in self._links:
            if moves or k == 0:
                frame.wxyz, frame.position = turns[k], places[k]


def _add_shape(server, name: str, shape: LinkShape) -> None:
    color = _GREY if shape.color is None else tuple(int(255 * c) for c in shape.color)
    placed = _pose(shape.pose)
    scene = server.scene
    if shape.kind == "sphere":
        scene.add_icosphere(name, radius=shape.size[0], color=color, subdivisions=3, **placed)
    elif shape.kind == "cylinder":
        scene.add_cylinder(
            name, radius=shape.size[0], height=max(shape.size[1], 1e-4), color=color, **placed
        )
    elif shape.kind == "box":
        scene.add_box(name, color=color, dimensions=tuple(shape.size), **placed)
    else:
        vertices, faces = read_mesh(shape.mesh)
        scene.add_mesh_simple(
            name,
            vertices=(vertices * np.array(shape.size)).astype(np.float32),
            faces=faces.astype(np.uint32),
            color=color,
            **placed,
        )


def _captions(server, trajectory, joint_path, captions, contact: np.ndarray):
    said = [
        f"{trajectory.metadata.get('pattern', 'pattern')}: "
        f"{trajectory.arc_length[-1]:.3f} m of rod laid"
        + ("" if joint_path is None else f" by {joint_path.robot.name}"),
        *(captions or []),
    ]
    far = float(np.ptp(trajectory.contact[:, 1])) / 2 + 0.1
    for number, text in enumerate(said):
        place = tuple(contact + [0.0, far, 0.30 - 0.06 * number])
        server.scene.add_label(f"/captions/{number}", text, position=place)
    return server.scene.add_label(
        "/captions/time", "0.0 s", position=tuple(contact + [0.0, far, 0.36])
    )
