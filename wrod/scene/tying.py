"""A rod laid between fixtures, or a tied knot, with both arms, as a USD stage."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from wrod.deployment.fixtures import Fixtures
from wrod.errors import RobotError, SceneError, needed_extras
from wrod.patterns.curve import arc_length
from wrod.robot.placement import Placement
from wrod.robot.transfers import HandFilm, Transfer, find_transfers
from wrod.robot.two_arms import ArmFilm, solve_two_arms
from wrod.scene.arm import add_arm, reach_of
from wrod.scene.brought import waiting_line, with_waiting
from wrod.scene.primitives import Materials, add_curve, add_shape
from wrod.scene.stage import (
    add_cameras,
    add_lights,
    add_view,
    new_stage,
    set_in_time,
    stage_path,
    write_stage,
)
from wrod.scene.workplace import ROD_COLORS, add_floor, add_pattern, add_table, table_under
from wrod.solvers.solids import Cylinder

_ROOT = "/World/Deployment_000"
_STEEL, _OTHER = (0.62, 0.64, 0.67), (0.10, 0.50, 0.22)
_SIDE = 0.08  # [m] beside what is laid, where rods wait that are laid later
_HIGH = 0.6  # [m]
_LOW = 0.03  # [m] what is lower lies on the table
_TOUCH = 1.3  # rods nearer than so many times their thickness touch
_APART = 8.0  # of one rod, what is so many radii farther along
_ROOM = 0.03  # [m] about what touches


@dataclass(frozen=True)
class Scene:
    """A written stage.

    Attributes:
        path: the file.
        missing: what was left out, and why.
        arms: of the stage; None where they were left out.
    """

    path: Path
    missing: list[str]
    arms: ArmFilm | None


@needed_extras()
def export_scene(
    path: str | os.PathLike[str],
    *,
    time: np.ndarray,
    rods: list[np.ndarray],
    names: list[str],
    radii: list[float],
    patterns: list,
    hands: np.ndarray | None = None,
    closed: np.ndarray | None = None,
    fixtures: Fixtures | None = None,
    facts: dict | None = None,
    placements: tuple[Placement, Placement] | None = None,
) -> Scene:
    """Write a stage of rods, fixtures and two arms over time; see `wrod.robot.two_arms`.

    The attribute `wrod:time` is the scene's clock [s], `wrod:simulatedTime` that of the film, which
    stands still where the arms need longer than the hands. If the arms cannot do it, the stage is
    written without them. The stage's custom data tells how near the arms come to each other and to
    the table.

    Args:
        path: the file, .usdc, .usda or .usd.
        time: (T,) [s].
        rods: (T, node, 3) of every rod [m]; NaN before it is laid. The table is z = 0.
        names, radii: of the rods; names of presets give their colours.
        patterns: what was to be laid.
        hands: (T, hand, 4, 4) poses of one or two hands, x along the rod that hangs from it.
        closed: (T, hand) whether a hand is at work; default: always.
        fixtures: posts and clips.
        facts: custom data of the stage.
        placements: of the arms, tried first.

    Raises:
        SceneError: the suffix is another, or the arrays do not fit.
    """
    path = stage_path(path)
    time = np.asarray(time, dtype=float)
    for rod in rods:
        if rod.ndim != 3 or len(rod) != len(time):
            raise SceneError(f"a rod's frames are {rod.shape}; give ({len(time)}, nodes, 3)")
    drawn = [p.sample(np.linspace(-p.remainder_length, p.length, 300))[0] for p in patterns]
    if hands is not None and closed is None:
        closed = np.ones(hands.shape[:2], dtype=bool)
    ground = _ground(drawn, rods, radii, hands, closed)
    arms, missing = None, []
    if hands is not None:
        try:
            film = HandFilm(time, hands, closed, tuple(rods))
            arms = solve_two_arms(film, ground, placements=placements)
        except RobotError as error:
            missing.append(f"both arms: {error}")
    frame = np.arange(len(time)) if arms is None else arms.frame
    clock = time if arms is None else arms.time
    shown = [
        with_waiting(rod[frame], clock, ground, radius)
        for rod, radius in zip(rods, radii, strict=True)
    ]
    stage = new_stage(0.0, max(len(frame) - 1.0, 0.0))
    across = _fill(stage, clock, time[frame], shown, names, radii, drawn, ground, arms, fixtures)
    moments = {} if arms is None else _moments(find_transfers(film), arms)
    _add_close(stage, np.concatenate(drawn), across, shown, radii, moments)
    prim = stage.GetPrimAtPath(_ROOT)
    told = {k: v for k, v in (facts or {}).items() if v is not None}
    if arms is not None:
        told |= {"arms": arms.facts, "moments": moments}
    prim.SetCustomDataByKey("wrod", told)
    return Scene(write_stage(stage, path), missing, arms)


def _moments(transfers: list[Transfer], arms: ArmFilm) -> dict[str, float]:
    """Time codes worth a picture: laying, and what follows it."""

    def code(frame: float) -> float:
        return float(np.searchsorted(arms.frame, round(frame)))

    laying = [t for t in transfers if t.end]
    moves = [t for t in transfers if not t.end]
    end = float(len(arms.frame) - 1)
    if not moves:
        if not laying:
            return {"end": end}
        first, last = laying[0].first, laying[-1].last
        thirds = {f"laying_{k}": code(first + k * (last - first) / 3) for k in (1, 2)}
        return {**thirds, "laid": code(last), "end": end}
    # The last of them pull.
    tied = [t for t in moves if t.first < moves[-1].first] or moves
    return {
        "laying": code((laying[-1].first + laying[-1].last) / 2 if laying else 0),
        "move": code((tied[-1].first + tied[-1].last) / 2),
        "tied": code(moves[-1].first),
        "end": end,
    }


def _add_close(stage, drawn: np.ndarray, across, shown, radii, moments: dict) -> None:
    """Camera on the patterns, and on the knot once it is tied: pulling takes it along."""
    centre = (drawn.min(0) + drawn.max(0)) / 2
    patterns, later = centre + 1.25 * (drawn - centre), None
    if "tied" in moments:
        first, last = moments["tied"], moments["end"]
        later = {0.0: patterns, first: patterns}
        for code in np.unique(np.round(np.linspace(first, last, 20)))[1:]:
            corners = knot_corners([rod[int(code)] for rod in shown], radii)
            later[float(code)] = patterns if corners is None else corners
    add_view(stage, "close", patterns, [*across, 1.1], later=later)


def knot_corners(rods: list[np.ndarray], radii: list[float]) -> np.ndarray | None:
    """(2, 3) corners of a box about what touches itself or another rod [m]; None if nothing does.

    Args:
        rods: (node, 3) of each [m].
        radii: [m].
    """
    radius = np.concatenate([np.full(len(rod), r) for rod, r in zip(rods, radii, strict=True)])
    which = np.concatenate([np.full(len(rod), k) for k, rod in enumerate(rods)])
    along = np.concatenate([arc_length(rod) for rod in rods])
    nodes = np.concatenate(rods)
    i, j = cKDTree(nodes).query_pairs(2.0 * _TOUCH * max(radii), output_type="ndarray").T
    thick = radius[i] + radius[j]
    near = np.linalg.norm(nodes[i] - nodes[j], axis=1) < _TOUCH * thick
    other = (which[i] != which[j]) | (np.abs(along[i] - along[j]) > _APART * radius[i])
    found = nodes[np.concatenate([i[near & other], j[near & other]])]
    if len(found) == 0:
        return None
    return np.stack([found.min(0) - _ROOM, found.max(0) + _ROOM])


def _ground(drawn, rods, radii, hands, closed) -> np.ndarray:
    """(n, 3) points of the table that are drawn on, lain on or worked at [m]."""
    found = list(drawn)
    for rod in rods:
        points = rod[:: max(1, len(rod) // 30)].reshape(-1, 3)
        found.append(points[points[:, 2] < _LOW])  # NaN is not lower
    if hands is not None:
        places = hands[closed][:, :3, 3]
        found.append(places[places[:, 2] < _LOW])
    ground = np.concatenate(found) * [1.0, 1.0, 0.0]
    for rod, radius in zip(rods, radii, strict=True):
        if np.isnan(rod).any():
            laid = rod[~np.isnan(rod).any(axis=(1, 2))][0]
            length = np.linalg.norm(np.diff(laid, axis=0), axis=1).sum()
            beside = np.vstack([ground, ground.min(0) - [0.0, _SIDE, 0.0]])
            ground = np.vstack([ground, waiting_line(length, beside, radius) * [1.0, 1.0, 0.0]])
    return ground


def _fill(stage, clock, simulated, shown, names, radii, drawn, ground, arms, fixtures):
    """Add everything; returns the horizontal direction (2,) from which both arms are seen best."""
    from pxr import UsdGeom

    materials = Materials(stage)
    codes = np.arange(len(clock), dtype=float)
    table = table_under(ground, None, 0.0)
    prim = UsdGeom.Xform.Define(stage, _ROOT).GetPrim()
    add_table(stage, f"{_ROOT}/table", table, materials)
    radius = min(radii)
    for k, points in enumerate(drawn):
        add_pattern(stage, f"{_ROOT}/pattern_{k}", points + [0, 0, radius], radius, materials)
    for k, frames in enumerate(shown):
        color = ROD_COLORS.get(names[k], _OTHER)
        add_curve(stage, f"{_ROOT}/rod_{k}", frames, 2 * radii[k], materials, color, codes)
    if fixtures is not None:
        _add_fixtures(stage, f"{_ROOT}/fixtures", fixtures, materials)
    seen = [table.corners(), *[rod[:: max(1, len(rod) // 20)].reshape(-1, 3) for rod in shown]]
    floor, across = table.floor, np.array([0.0, -1.0])
    work = [ground, ground + [0.0, 0.0, 0.45], table.corners()]
    if arms is not None:
        bases = [placement.world_from_base for placement in arms.placements]
        for number, (base, positions) in enumerate(zip(bases, arms.positions, strict=True)):
            name = f"{_ROOT}/robot_{number}"
            add_arm(stage, name, arms.robot, base, positions, codes, materials)
            links, feet = reach_of(arms.robot, base, positions)
            seen += [*links, feet]
            floor = min(floor, float(feet[0, 2]))
            # How high a hand begins to lay would leave little of the picture to the table.
            work += [
                np.clip(part, [-np.inf, -np.inf, 0.0], [np.inf, np.inf, _HIGH]) for part in links
            ]
        # From the side, so that neither arm stands before the table.
        apart = (bases[1] - bases[0])[:2, 3]
        across = np.array([apart[1], -apart[0]]) / np.linalg.norm(apart)
    points = np.concatenate(seen)
    low, high = points.min(0), points.max(0)
    add_floor(stage, (low + high)[:2] / 2, (high - low)[:2] + 8.0, floor, materials)
    add_lights(stage)
    corners = np.stack([ground.min(0) - 0.08, ground.max(0) + 0.08])
    add_cameras(stage, points, across, corners)
    add_view(stage, "side", np.vstack(work), [*across, 0.55])
    for name, values in (("time", clock), ("simulatedTime", simulated)):
        set_in_time(prim, f"wrod:{name}", values, codes)
    return across


def _add_fixtures(stage, path: str, fixtures: Fixtures, materials: Materials) -> None:
    from pxr import UsdGeom

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
