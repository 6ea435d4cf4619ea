"""`wrod plan PATTERN`: the trajectory of the grip as files and as a picture."""

from __future__ import annotations

import json
from math import degrees, pi
from pathlib import Path

import click

from wrod.commands.options import (
    DEVICE,
    METHOD,
    PICTURE,
    ROD,
    ROLL,
    UNITS,
    options,
    read_pattern,
    read_rod,
    read_roll,
)


@click.command(name="plan")
@click.argument("pattern")
@options(ROD)
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True)
@options(METHOD)
@click.option(
    "--controller",
    "controller_file",
    type=click.Path(path_type=Path),
    help="Controller that `wrod train` made, of this naturally curved rod for one; default: the "
    "one that ships, for straight rods.",
)
@click.option("--spacing", default=0.0025, show_default=True, help="Distance between nodes [m].")
@options(UNITS, PICTURE)
@click.option(
    "--friction",
    "friction_text",
    help="Of the table: a coefficient (0.3) or a range (0.2:0.6). The path is corrected until what "
    "stays lies on the pattern, and what is expected there is said; takes a minute or two.",
)
@click.option(
    "--shapes/--no-shapes",
    default=True,
    help="Let the rod solver compute the rod's shapes where the method gives none (default).",
)
@click.option(
    "--remainder/--no-remainder",
    default=None,
    help="Lay a lead-in of growing curvature first; by default where the pattern starts curved.",
)
@options(ROLL)
@click.option("--robot", default="sawyer", show_default=True, help="sawyer, or a URDF file.")
@click.option("--no-robot", is_flag=True, help="Leave out joint path and scene.")
@click.option(
    "--placement",
    default="auto",
    show_default=True,
    help="auto, or x,y,z,yaw of the pattern from the robot's base [m, degrees]; z is the table.",
)
@click.option("--view", is_flag=True, help="Then play the scene in a browser on this machine.")
@options(DEVICE)
@click.option("--json", "as_json", is_flag=True, help="Print figures for machines.")
def command(
    pattern: str,
    rod_name: str | None,
    radius: float | None,
    lgb: float | None,
    length: float | None,
    out: Path,
    method: str,
    closure: str | None,
    controller_file: Path | None,
    spacing: float,
    units: str | None,
    markers: Path | None,
    sheet: str | None,
    scale: float | None,
    camera: Path | None,
    start: str | None,
    friction_text: str | None,
    shapes: bool,
    remainder: bool | None,
    roll_text: str | None,
    robot: str,
    no_robot: bool,
    placement: str,
    view: bool,
    device: str,
    as_json: bool,
) -> None:
    """Plan how the grip moves to lay a rod along PATTERN.

    PATTERN is a file of points (text, CSV, NPY or NPZ), a picture of a drawn curve (with
    --markers, --sheet or --scale), or a built-in pattern: line, circle, sine,
    letter-U, letter-C, letter-L, letter-A, letter-S.
    """
    from tqdm import tqdm

    from wrod.controller.controller import Controller
    from wrod.errors import DataError
    from wrod.planning.picture import draw_plan
    from wrod.planning.plan import plan, prepare, with_shapes

    rod = read_rod(rod_name, radius, lgb, length)
    controller = None if controller_file is None else Controller.load(controller_file)
    reading = {
        "markers": markers, "sheet": sheet, "scale": scale, "camera": camera, "start": start,
    }  # fmt: skip
    curve = prepare(read_pattern(pattern, units, reading), rod, remainder)
    friction = None if friction_text is None else _friction(friction_text)
    with tqdm(unit="grasp", leave=False, delay=1.0, desc="grasps", disable=as_json) as bar:

        def progress(count: int, total: int) -> None:
            bar.total = total
            bar.update(count)

        chosen = None if device == "auto" else device
        trajectory = plan(
            curve, rod, method, closure=closure, spacing=spacing, remainder=remainder,
            roll=read_roll(roll_text, rod), controller=controller, device=chosen,
            friction=None if method == "intuitive" else friction, progress=progress,
        )  # fmt: skip
        if friction is not None and method == "intuitive":
            from wrod.deployment.optimise import expect

            expected = expect(curve, rod, trajectory, friction, device=chosen or "auto")
            trajectory.metadata["expected"] = expected
        if shapes:
            bar.n = 0
            trajectory = with_shapes(trajectory, curve, device=chosen, progress=progress)
    steps = tqdm(total=4, unit="step", leave=False, delay=1.0, disable=as_json or no_robot)
    with steps:

        def step(what: str) -> None:
            steps.set_description(what)
            steps.update(1)

        step("joint path")
        joint_path = None if no_robot else _joint_path(trajectory, rod, robot, placement)
        try:
            step("plan")
            picture = draw_plan(out / "preview.png", curve, trajectory)
            written = [*trajectory.save(out / "trajectory"), picture]
            if joint_path is not None:
                from wrod.scene.deliver import deliver

                written += deliver(out, trajectory, joint_path, curve, rod, step)
        except OSError as error:
            raise DataError(f"{out}: cannot be written ({error}); choose another --out") from None
    figures = {
        **trajectory.metadata,
        "nodes": len(trajectory),
        "laid_length": float(trajectory.arc_length[-1]),
        "highest_grip": float(trajectory.position[:, 2].max()),
        "twist": None if trajectory.twist is None else trajectory.twist[[0, -1]].tolist(),
        "joint_path": None if joint_path is None else joint_path.metadata,
        "written": [str(path) for path in written],
    }
    if as_json:
        click.echo(json.dumps(figures, indent=2))
        return
    click.echo(_summary(figures))
    for path in written:
        click.echo(f"wrote {path}")
    if view and joint_path is not None:
        from wrod.scene.view import view as show

        show(out / "scene.usdc")


def _joint_path(trajectory, rod, robot: str, placement: str):
    """Joint path of the arm, before anything is written."""
    from wrod.errors import RobotError
    from wrod.robot.joint_path import solve_joint_path

    try:
        import newton  # noqa: F401  # the scene's picture needs it: say so before writing
        import pxr  # noqa: F401

        return solve_joint_path(trajectory, robot, placement, rod_radius=rod.radius)
    except ImportError as error:
        raise RobotError(
            f"joint paths and scenes need {error.name}; install wrod[robot,scene,newton], or plan "
            "with --no-robot"
        ) from error
    except RobotError as error:
        raise RobotError(f"{error} (--no-robot plans the trajectory alone)") from error


def _summary(figures: dict) -> str:
    lines = [
        f"{figures['pattern']}: {figures['pattern_length']:.3f} m"
        + (
            f" and a remainder of {figures['remainder_length']:.3f} m"
            if figures["remainder_length"]
            else ""
        )
        + f", {figures['nodes']} nodes, largest curvature {figures['largest_curvature']:.1f} 1/m",
        f"highest grip {figures['highest_grip']:.3f} m, method {figures['method']}"
        + (f", closure {figures['closure']}" if figures["closure"] else ""),
    ]
    if "expected" in figures:
        lines += _expectation(figures["expected"], figures.get("optimised"))
    else:
        lines.append("for no table in particular; --friction 0.3 or 0.2:0.6 corrects it for one")
    if figures["twist"] is not None:
        first, last = (value / (2.0 * pi) for value in figures["twist"])
        lines.append(
            f"naturally curved rod: lay it with its first material director "
            f"{degrees(figures['roll']):.0f} degrees from left towards up, twisted by {first:.2f} "
            f"turns between table and grip at first and by {last:.2f} in the end"
        )
    if "shapes" in figures:
        apart = 1e3 * figures["shapes"]["largest_grip_difference"]
        lines[1] += f"; the rod solver's grips differ by {apart:.2g} mm at most"
    if figures["joint_path"] is not None:
        path = figures["joint_path"]
        place = path["placement"]
        lines.append(
            f"joint path of {path['duration']:.0f} s at {path['rate']:g} Hz, at least "
            f"{path['limit_margin']:.2f} rad from the joint limits and "
            f"{1e3 * min(path['gap'].values()):.0f} mm clear; pattern at x {place['x']:.3f}, "
            f"y {place['y']:.3f}, z {place['z']:.3f} m, yaw {degrees(place['yaw']):.0f} degrees "
            "from the robot's base"
        )
    return "\n".join(lines)


def _expectation(expected: dict, optimised: dict | None) -> list[str]:
    """What simulated deployments say of the plan, in sentences."""
    mus = expected["friction"]
    table = f"friction {mus[0]:.2g} to {mus[-1]:.2g}"
    lines = [
        f"expected on a table of {table}: {100 * expected['mean']:.2f} ± "
        f"{100 * expected['deviation']:.2f} cm, at worst "
        f"{100 * max(expected['error_mean']):.2f} cm "
        f"({len(mus)} disturbed rods, laid in simulation)"
    ]
    if optimised is not None:
        before, after = optimised["errors"][0], min(optimised["errors"])
        lines.append(
            f"grip corrected by up to {1e3 * optimised['largest_correction']:.0f} mm, "
            f"from {100 * before:.2f} to {100 * after:.2f} cm over the rods that it was fitted to"
        )
    if expected["diverged"]:
        lines.append(f"{expected['diverged']} of them could not be simulated to the end")
    if expected["slides"]:
        places = ", ".join(f"{a:.3f} to {b:.3f}" for a, b in expected["slides"])
        lines.append(f"slides by more than 1 mm while it is laid at s = {places} m")
    for start, stop, least in expected["off"]:
        lines.append(
            f"lies off the pattern by more than 5 mm at s = {start:.3f} to {stop:.3f} m"
            + (
                f" below friction {least:.2f}"
                if least is not None
                else ", up to the largest friction asked for"
            )
        )
    return lines


def _friction(text: str) -> float | tuple[float, float]:
    """0.3, or (0.2, 0.6) of "0.2:0.6"."""
    from wrod.errors import PatternError

    try:
        values = [float(word) for word in text.split(":")]
    except ValueError:
        values = []
    if len(values) not in (1, 2):
        raise PatternError(f"--friction is {text!r}; give a coefficient (0.3) or a range (0.2:0.6)")
    return values[0] if len(values) == 1 else (values[0], values[1])
