"""A deployment as one HTML page: arm, rod and table in true time, drawn by Viser without Newton.

The page holds everything (no outside links) and plays in any browser with WebGL: drag to turn,
slider and pause below. The rod is a tube of its true radius, and a line of a few pixels along it
wherever that would be thinner.
"""

import contextlib
import io
import os
import socket
from dataclasses import replace
from pathlib import Path

import numpy as np

from wrod.errors import SceneError, needed_extras
from wrod.files import write_text
from wrod.planning.pace import pose_times
from wrod.scene.page_parts import (
    ShownArm,
    add_holder,
    add_rod,
    add_segments,
    add_shape,
    expected_errors,
    move_rod,
    named,
    pose_of,
)
from wrod.scene.phases import Falls, covered, falling, rods_of, with_release
from wrod.scene.stage import standing
from wrod.scene.workplace import table_under

_FRAMES = 400  # at most: a page of a few MB whatever the path's duration
_DRAWN = 2.5  # [px] of the pattern's line
_ROD_POINTS = 121
_VIEW, _WIDE = 0.75, 1.2  # [rad] of the camera up and down; width over height that is filled
_FLOOR = (0.647, 0.667, 0.69)
_INK = (26, 56, 140)
_COLOURS = "green: on the pattern; red: a centimetre off"
_LINE = 0.045  # of what is seen, between the captions' lines


@needed_extras()
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
    falls: Falls | None = None,
) -> Path:
    """Write a deployment as one page.

    Args:
        trajectory: `Trajectory`.
        joint_path: of it, for the arm and for true time; without it the grip alone.
        pattern: `Pattern` drawn on the table; by default the contact points.
        rod: `RodMaterial`, for its radius.
        shapes: (T, M, 3) centrelines of the rod [m]; by default from the trajectory.
        errors: (T, M) how far off its points lie [m], as colours; by default what is expected.
        time: (T,) when each shape is reached [s]; by default the joint path's, or the plan's.
        captions: lines above the table.
        falls: as in `wrod.export_usd`.

    Raises:
        SceneError: Viser is missing.
    """
    import viser

    radius, onward = 0.002 if rod is None else float(rod.radius), None
    if shapes is None:
        shapes, onward = rods_of(trajectory, joint_path, pattern, _ROD_POINTS)
    if time is None:
        time = pose_times(trajectory) if joint_path is None else joint_path.node_time
    at_nodes = len(time) == len(trajectory)
    if joint_path is not None and at_nodes and errors is None:
        falls = falls or falling(trajectory)
        shapes, time = with_release(joint_path, shapes, time, onward, falls)
    if errors is None and (errors := expected_errors(trajectory, pattern, shapes)) is not None:
        captions = [*(captions or []), *_expectation(trajectory)]
    duration = float(time[-1]) if joint_path is None else float(joint_path.time[-1])
    count = int(np.clip(np.ceil(duration * 10.0) + 1, 2, _FRAMES))
    at = np.linspace(0.0, duration, count)
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host="127.0.0.1", port=_free_port(), verbose=False)
    try:
        placement = None if joint_path is None else joint_path.placement
        lies = covered(trajectory, None if joint_path is None and at_nodes else shapes[-1])
        _workplace(server, trajectory, lies, joint_path, pattern, radius)
        arm = None if joint_path is None else ShownArm(server, joint_path, at)
        nodes = np.interp(at, time, np.arange(len(time)))
        laid = _length_laid(trajectory, joint_path, onward, at, nodes)
        line = add_rod(server, shapes, errors, nodes[0], radius)
        holder = [] if joint_path is None else add_holder(server, joint_path.stand)
        seen = _seen(trajectory, shapes, arm)
        label = _captions(server, trajectory, joint_path, captions, placement, seen)
        recording = server.get_scene_serializer()
        for k, node in enumerate(nodes):
            if arm is not None:
                arm.pose(k)
            move_rod(line, shapes, errors, node)
            if holder and not joint_path.holds_stand(at[k]):
                for part in holder:
                    part.visible = False
                holder = []
            if k % 5 == 0 or k == count - 1:
                label.text = _clock(at[k], duration, joint_path)
                if at_nodes:
                    label.text += f", {100 * laid[k]:.1f} cm laid"
            recording.insert_sleep(duration / max(count - 1, 1))
        page = named(recording.as_html(dark_mode=False), _name(trajectory))
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
    return write_text(out, page)


def _name(trajectory) -> str:
    return str(trajectory.metadata.get("pattern", "pattern"))


def _length_laid(trajectory, joint_path, onward, at: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(n,) that lies at times or nodes (n,), of the tail too where it is laid [m]."""
    if onward is not None:
        return np.interp(at, joint_path.time, joint_path.arc_length)
    return np.interp(nodes, np.arange(len(trajectory)), trajectory.arc_length)


def _expectation(trajectory) -> list[str]:
    expected = trajectory.expected
    low, high = expected["friction"][0], expected["friction"][-1]
    return [
        f"expected {100 * expected['mean']:.2f} cm off, friction {low:.2g} to {high:.2g}",
        _COLOURS,
    ]


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
            _COLOURS,
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
    eye, middle = standing(seen, back, _WIDE, np.tan(0.45 * _VIEW))
    camera.fov = _VIEW
    camera.up = (0.0, 0.0, 1.0)
    camera.look_at, camera.position = tuple(middle), tuple(eye)


def _workplace(server, trajectory, lies, joint_path, pattern, radius: float) -> None:
    table = table_under(lies, joint_path, radius)
    frame, room = np.array(table.pose), table.high - table.low + 2.0
    ground = (*(table.low + table.high) / 2, table.floor - 0.01), (*room, 0.02), _FLOOR
    for name, centre, size, color in (*table.boxes(), ("floor", *ground)):
        pose = frame.copy()
        pose[:3, 3] += frame[:3, :3] @ np.asarray(centre)
        rgb = tuple(int(255 * c + 0.5) for c in color)
        server.scene.add_box(f"/table/{name}", color=rgb, dimensions=size, **pose_of(pose))
    for number, shape in enumerate(() if joint_path is None else joint_path.obstacles):
        add_shape(server, f"/obstacle_{number}", replace(shape, pose=frame @ shape.pose))
    points = trajectory.contact
    if hasattr(pattern, "sample"):
        points = pattern.sample(np.linspace(-pattern.remainder_length, pattern.length, 300))[0]
    points = points * [1, 1, 0] + [0, 0, trajectory.contact[0, 2] - radius + 5e-4]
    add_segments(server, "/pattern", points, _INK, _DRAWN)


def _captions(server, trajectory, joint_path, captions, placement, seen: np.ndarray):
    """Write lines above all that is seen (n, 3) [m], the clock first, and look at both."""
    said = [
        "0.0 s",
        f"{_name(trajectory)}: {trajectory.arc_length[-1]:.3f} m of rod laid"
        + ("" if joint_path is None else f" by {joint_path.robot.name}"),
        *(captions or []),
    ]
    step = _LINE * float(np.ptp(seen, axis=0).max())
    over = np.append((seen.min(0) + seen.max(0))[:2] / 2, seen[:, 2].max())
    places = over + step * np.arange(len(said), 0, -1)[:, None] * [0.0, 0.0, 1.0]
    labels = [
        server.scene.add_label(
            f"/captions/{number}", text, position=tuple(place), anchor="top-center"
        )
        for number, (text, place) in enumerate(zip(said, places, strict=True))
    ]
    _aim(server.initial_camera, placement, np.vstack([seen, places[0] + [0.0, 0.0, step]]))
    return labels[0]
