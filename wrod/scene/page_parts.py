"""What moves on a page: the arm, the rod as a tube of its true radius, and the stand."""

from html import escape

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.errors import SceneError
from wrod.patterns.curve import arc_length
from wrod.robot.mesh import read_mesh
from wrod.robot.urdf import LinkShape
from wrod.scene.phases import shape_at
from wrod.scene.workplace import BASE_HEIGHT, COLUMN

_LINE = 3.5  # [px] of the rod's line
_SIDES = 10  # of the rod's tube
_LIES = 1e-3  # [m] above the contact points, what is lower lies
# Viser's page has no name, and cuts off both sides where it is high and narrow, as on a phone.
_HEAD = "<title>Viser</title>"
_STYLE = "<style>#root {height: min(100vh, 160vw) !important}</style>"
# Nor does it begin where the browser's language is none, as "en-US@posix" of a machine without one.
_LANGUAGE = (
    "<script>try{new Intl.Locale(navigator.language)}catch{Object.defineProperty("
    "Navigator.prototype,'language',{get:()=>'en'})}</script>"
)
_GREY, _LEG, _ROD = (115, 115, 122), (77, 79, 84), (20, 150, 60)


def named(page: str, name: str) -> str:
    """Viser's page under a name, fit for a phone and for a browser without a language."""
    return page.replace(_HEAD, f"<title>{escape(name)}</title>{_STYLE}{_LANGUAGE}", 1)


def pose_of(matrix: np.ndarray) -> dict:
    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    return {"wxyz": (w, x, y, z), "position": tuple(map(float, matrix[:3, 3]))}


def add_segments(server, name: str, points: np.ndarray, color, width: float):
    pairs = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
    colors = np.broadcast_to(np.asarray(color, dtype=np.uint8), pairs.shape)
    return server.scene.add_line_segments(
        name, points=pairs, colors=colors, thickness=width, thickness_units="screen"
    )


def _colours(errors: np.ndarray | None, node: float, count: int) -> np.ndarray:
    """(count, 3) green where the rod lies as it should, to red at a centimetre."""
    if errors is None:
        return np.broadcast_to(np.array(_ROD, np.uint8), (count, 3))
    share = np.clip(shape_at(errors, node) / 0.01, 0.0, 1.0)[:, None]
    good, bad = np.array(_ROD, float), np.array([215.0, 30.0, 30.0])
    return ((1 - share) * good + share * bad).astype(np.uint8)


def expected_errors(trajectory, pattern, shapes: np.ndarray) -> np.ndarray | None:
    """(T, M) how far off the points of shapes (T, M, 3) that lie are expected to lie [m]; None of a
    plan that nobody laid in simulation."""
    expected = trajectory.expected
    if expected is None or not hasattr(pattern, "sample"):
        return None
    s = arc_length(shapes) - pattern.remainder_length
    along = expected["error_along"]
    off = np.interp(s, np.linspace(0.0, pattern.length, len(along)), along, left=0.0, right=0.0)
    return np.where(shapes[..., 2] < trajectory.contact[0, 2] + _LIES, off, 0.0)


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


def add_rod(server, shapes, errors, node: float, radius: float) -> dict:
    points = shape_at(shapes, node)
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
        "line": add_segments(server, "/rod/line", over, _ROD, _LINE),
        "body": tube,
        "radius": radius,
    }


def move_rod(rod: dict, shapes, errors, node: float) -> None:
    points = shape_at(shapes, node).astype(np.float32)
    over = points + np.array([0.0, 0.0, rod["radius"]], np.float32)  # before the pattern's line
    rod["line"].points = np.stack([over[:-1], over[1:]], axis=1)
    for name, value in _tube(points, rod["radius"]).items():
        if name != "batched_scales":  # a rod keeps its length
            setattr(rod["body"], name, value)
    if errors is not None:
        colors = _colours(errors, node, len(points))
        rod["line"].colors = np.stack([colors[:-1], colors[1:]], axis=1)
        rod["body"].batched_colors = colors[1:].copy()


def add_holder(server, stand: list) -> list:
    """The stand that holds the rod until the hand does."""
    parts = []
    for name, (start, end, radius) in zip(("post", "clip"), stand, strict=False):
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


class ShownArm:
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
            frame = server.scene.add_frame(f"/arm/{link}", show_axes=False, **pose_of(local[0]))
            for number, shape in enumerate(shapes):
                add_shape(server, f"/arm/{link}/{number}", shape)
            turns = Rotation.from_matrix(local[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
            moves = bool(np.ptp(local, axis=0).max() > 1e-9)
            self._links.append((frame, turns, local[:, :3, 3], moves))
        if robot.name != "sawyer":  # Sawyer brings its pedestal
            below = base @ robot.mount
            below[:3, 3] -= below[:3, 2] * (BASE_HEIGHT / 2)
            server.scene.add_cylinder(
                "/stand", radius=COLUMN, height=BASE_HEIGHT, color=_LEG, **pose_of(below)
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


def add_shape(server, name: str, shape: LinkShape) -> None:
    color = _GREY if shape.color is None else tuple(int(255 * c) for c in shape.color)
    placed = pose_of(shape.pose)
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
