"""`wrod bench robot`: joint paths for the seven patterns and rods 1 to 3, of one arm or of all."""

import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

import wrod
from wrod import cost
from wrod.bench.table3_paper import PATTERNS, RODS, patterns_option, read_pattern
from wrod.errors import RobotError, WrodError, WrodWarning
from wrod.machine import machine_line
from wrod.options import FOLDER, option, own_options
from wrod.telling import json_option, tell


@click.command(name="robot")
@own_options
@patterns_option
@json_option
def command(
    patterns: Path | None,
    method: str = option("Planner of the trajectories.", default="numeric"),
    robots: str = option("Arms, separated by commas, or all.", default="sawyer"),
    rods: str = option("Separated by commas.", default=",".join(RODS)),
    out: Path | None = option(
        "Folder of finished cases, with a valid scene asked of each; a stopped run goes on.",
        type=FOLDER,
    ),
    finer: bool = option("Compare with plans at a tenth of the node distance."),
) -> None:
    """Solve 21 joint paths an arm with automatic placement and print what they keep.

    Cases of one run may be shared out by --robots and --rods to processes with folders of their
    own; lines of their arms.jsonl below the first may be put into one file.
    """
    from wrod.files.ledger import Ledger
    from wrod.planning.sources import SOURCES
    from wrod.robot.model import ROBOTS
    from wrod.rods.catalogue import rod_names

    names = list(ROBOTS) if robots == "all" else list(dict.fromkeys(robots.split(",")))
    unknown = [name for name in names if name not in ROBOTS]
    if unknown:
        raise RobotError(f"unknown robot {unknown[0]!r}; known robots: {', '.join(ROBOTS)}, all")
    unknown = [name for name in rods.split(",") if name not in rod_names()]
    if unknown:
        raise RobotError(f"unknown rod {unknown[0]!r}; known rods: {', '.join(rod_names())}")
    if method not in SOURCES:
        raise RobotError(f"unknown method {method!r}; use one of {', '.join(SOURCES)}")
    for pattern in PATTERNS:  # one that cannot be read is refused before the others are planned
        read_pattern(pattern, patterns)
    cases = [
        (name, p, r) for name in names for r in dict.fromkeys(rods.split(",")) for p in PATTERNS
    ]
    kept = None if out is None else out / "arms.jsonl"
    folder = None if patterns is None else str(patterns)
    settings = {"method": method, "patterns": folder, "finer": finer}
    ledger = Ledger(kept, settings, ("robot", "pattern", "rod"), "arms", _fields)
    left = ledger.lacking(cases)
    cost.settle(cost.Cost(cost.JOINT_PATH * len(left)), f"{len(left)} joint paths")
    for name, pattern, rod in cost.progress_bar(left):
        scene = out is not None
        ledger.add([run_case(pattern, rod, method, patterns, finer, robot=name, scene=scene)])
    rows = ledger.of(cases)
    solved = sum("error" not in row for row in rows)
    tell({"machine": machine_line(), "paths": rows, "solved": solved}, *_lines(rows, finer))


def _fields(row: dict) -> type:
    from wrod.files import row_schemas

    return row_schemas.ArmsRefused if "error" in row else row_schemas.ArmsRow


def _lines(rows: list[dict], finer: bool) -> Iterator[str]:
    yield (
        f"{'robot':7s} {'pattern':10s} {'rod':10s} {'CPU s':>6s} {'error mm':>9s} {'degrees':>9s}"
        f" {'limit':>6s} {'gap mm':>7s} {'turn':>6s} {'step':>6s} {'beyond':>6s} {'minutes':>8s}"
        + (f" {'finer mm':>9s} {'degrees':>9s}" if finer else "")
    )
    for row in rows:
        if "error" in row:
            yield (
                f"{row['robot']:7s} {row['pattern']:10s} {row['rod']:10s} "
                f"{row.get('cpu', 0.0):6.2f} {row['error']}"
            )
            continue
        yield (
            f"{row['robot']:7s} {row['pattern']:10s} {row['rod']:10s} {row['cpu']:6.2f}"
            f" {row['position_mm']:9.1e} {row['rotation_deg']:9.1e} {row['limit_margin']:6.2f}"
            f" {row['gap_mm']:7.1f} {row['turn']:6.3f} {row['step']:6.3f} {row['beyond']:6.3f}"
            f" {row['duration'] / 60:8.2f}"
            + (f" {row['finer_mm']:9.3f} {row['finer_deg']:9.4f}" if finer else "")
            + (" without approach" if row["no_approach"] else "")
            + (" scene: " + "; ".join(row["scene_faults"]) if row.get("scene_faults") else "")
        )
    solved = [row for row in rows if "error" not in row]
    whole = sum(not row["no_approach"] for row in solved)
    yield (
        f"{len(solved)} of {len(rows)} solved, {whole} of them from and to a neutral pose; limit: "
        "least distance from a joint limit [rad]; turn and step: most that the rod's frame and a "
        "joint turn between nodes [rad]; beyond: most that a joint turns more than the rod's frame "
        "[rad per 5 mm of the grip's way]"
    )
    stays = [row.get("stand_stays") for row in solved]
    yield (
        f"the rod's stand stays out of the way in {stays.count(True)}, has to be taken away in "
        f"{stays.count(False)}, is not there in {stays.count(None)}"
    )
    hangs = [100.0 * row["hangs"] for row in solved]
    if hangs:
        yield f"rod that is not laid when the hand opens: {min(hangs):.1f} to {max(hangs):.1f} cm"


def against_finer(path, curve, rod, method: str, trajectory) -> dict:
    """Largest distance of the sent path from a plan with ten times the nodes, between them too."""
    import numpy as np
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, RotationSpline

    from wrod.robot.kinematics import grasp_poses

    fine = wrod.plan(curve, rod, method=method, spacing=trajectory.arc_length[1] / 10)
    (lay,) = [phase for phase in path.phases if phase["name"] == "lay"]
    laying = (path.time > lay["start"] - 1e-9) & (path.time < lay["end"] + 1e-9)
    some = np.flatnonzero(laying)[::10]
    arc = path.arc_length[some]
    poses = path.placement.world_from_base @ grasp_poses(path.robot, path.positions[some])
    position = CubicSpline(fine.arc_length, fine.position)(arc)
    frames = RotationSpline(fine.arc_length, Rotation.from_matrix(fine.rotation))(arc)
    held = Rotation.from_matrix(poses[:, :3, :3] @ path.grip.rotation.T)
    return {
        "finer_mm": float(1e3 * np.linalg.norm(poses[:, :3, 3] - position, axis=1).max()),
        "finer_deg": float(np.degrees((held.inv() * frames).magnitude().max())),
    }


def run_case(
    pattern: str,
    rod_name: str,
    method: str = "numeric",
    folder=None,
    finer: bool = False,
    robot: str = "sawyer",
    scene: bool = False,
) -> dict:
    """Plan and solve one case; figures of its joint path, or the error.

    The rod's shapes are computed, as `wrod plan` does: what hangs is in the arm's way.
    With `scene`, its USD scene is written and asked of OpenUSD's validators too.
    """
    import numpy as np

    from wrod.planning.shapes import with_shapes

    row: dict[str, Any] = {"robot": robot, "pattern": pattern, "rod": rod_name}
    started = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", WrodWarning)
            curve = read_pattern(pattern, folder)
            trajectory = with_shapes(wrod.plan(curve, wrod.rod(rod_name), method=method))
        started = time.process_time()
        path = wrod.solve_joint_path(trajectory, robot, whole_job=True)
        row |= {"cpu": time.process_time() - started}
        if scene:
            row |= {"scene_faults": _scene_faults(trajectory, path, curve, wrod.rod(rod_name))}
        if finer:
            row |= against_finer(path, curve, wrod.rod(rod_name), method, trajectory)
    except WrodError as error:
        return row | {"cpu": time.process_time() - started, "error": str(error)}
    figures = path.metadata
    if figures["robot"] != robot:
        raise RuntimeError(f"asked for a path of {robot} and solved one of {figures['robot']}")
    return row | {
        "position_mm": 1e3 * figures["position_error"],
        "rotation_deg": float(np.degrees(figures["rotation_error"])),
        "limit_margin": figures["limit_margin"],
        "gap_mm": 1e3 * min(figures["gap"].values()),
        "manipulability": figures["manipulability"],
        "turn": figures["largest_turn"],
        "step": figures["largest_step"],
        "beyond": figures["step_beyond_turn"],
        "grip_angle": figures["grip_angle"],
        "duration": figures["duration"],
        "no_approach": figures.get("no_approach"),
        "stand_stays": figures.get("stand_stays"),
        "hangs": wrod.rod(rod_name).length - float(path.arc_length[-1]),
    }


def _scene_faults(trajectory, path, curve, rod) -> list[str]:
    """What OpenUSD's validators say of the scene, nothing where it is in order."""
    from wrod.scene.validate import validation_errors

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.usdc"
        wrod.export_usd(file, trajectory=trajectory, joint_path=path, pattern=curve, rod=rod)
        return validation_errors(file)
