"""`wrod plan PATTERN`: the trajectory of the grip as files and as a picture."""

from __future__ import annotations

import json
from pathlib import Path

import click

from wrod.commands.options import (
    DEVICE,
    DRAWING,
    METHOD,
    PICTURE,
    ROD,
    ROLL,
    UNITS,
    options,
    read_pattern,
    read_rod,
    refuse_idle_options,
)
from wrod.commands.plan_pattern import SHAPE, fit, too_long
from wrod.commands.plan_steps import NO_JOINT_PATH, arm_steps, save_plan, solve_grasps_of
from wrod.commands.plan_summary import read_friction, summary
from wrod.commands.robot_options import ROBOT, RobotRequest
from wrod.errors import PatternError


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
@options(UNITS, DRAWING, PICTURE)
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
@options(ROLL, SHAPE, ROBOT)
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
    layer: str | None,
    stroke: int | None,
    markers: Path | None,
    sheet: str | None,
    scale: float | None,
    camera: Path | None,
    start: str | None,
    friction_text: str | None,
    shapes: bool,
    remainder: bool | None,
    roll_text: str | None,
    resize: float | None,
    tolerance: float,
    hold: float | None,
    device: str,
    as_json: bool,
    **arm,
) -> None:
    """Plan how the grip moves to lay a rod along PATTERN.

    PATTERN is a file of points (text, CSV, NPY or NPZ), a picture of a drawn curve (with
    --markers, --sheet or --scale), a vector drawing (SVG, DXF), or a built-in pattern: line,
    circle, sine, letter-U, letter-C, letter-L, letter-A, letter-S.

    Corners are rounded to what the rod can lie in. What is finished is kept: without a joint path
    the trajectory and its picture are written all the same, and the exit code is 3.
    """
    from wrod.controller.controller import Controller
    from wrod.planning.plan import prepare, read_roll

    if method == "intuitive":
        refuse_idle_options("--method intuitive", "closure")
    request = RobotRequest(**arm)
    request.check()
    rod = read_rod(rod_name, radius, lgb, length)
    controller = None if controller_file is None else Controller.load(controller_file)
    reading = {
        "markers": markers, "sheet": sheet, "scale": scale, "camera": camera, "start": start,
    }  # fmt: skip
    drawn = read_pattern(pattern, units, reading, layer, stroke)
    chosen = None if device == "auto" else device

    friction = None if friction_text is None else read_friction(friction_text)

    def planned(resize: float | None, hold: float | None, friction=None):
        """Pattern, rod and trajectory at a size and a hold."""
        fitted = fit(drawn, rod, resize, tolerance, hold)
        try:
            curve = prepare(fitted.pattern, fitted.rod, remainder)
        except PatternError as error:
            remedy = too_long(fitted.pattern, fitted.rod, arm=not request.no_robot)
            raise PatternError(f"{error} ({remedy})" if remedy else str(error)) from None
        trajectory = solve_grasps_of(
            curve, fitted.rod, as_json, method=method, closure=closure, spacing=spacing,
            remainder=remainder, roll=read_roll(roll_text, fitted.rod), controller=controller,
            device=chosen, shapes=shapes, friction=friction,
        )  # fmt: skip
        return fitted, curve, trajectory

    fitted, curve, trajectory = planned(resize, hold, friction)
    written = save_plan(out, curve, trajectory)
    joint_path, reason = None, None
    if not request.no_robot:
        joint_path, reason, more = arm_steps(
            request, out, trajectory, curve, fitted.rod, as_json, planned, (resize, hold)
        )
        written += more
    figures = {
        **trajectory.metadata,
        **fitted.figures,
        "nodes": len(trajectory),
        "laid_length": float(trajectory.arc_length[-1]),
        "highest_grip": float(trajectory.position[:, 2].max()),
        "twist": None if trajectory.twist is None else trajectory.twist[[0, -1]].tolist(),
        "joint_path": None if joint_path is None else joint_path.metadata,
        "no_joint_path": reason,
        "notes": list(fitted.notes),
        "written": [str(path) for path in written],
    }
    if as_json:
        click.echo(json.dumps(figures, indent=2))
    else:
        click.echo(summary(figures))
        for path in written:
            click.echo(f"wrote {path}")
    if reason is not None:
        click.echo(f"wrod: {reason}", err=True)
        click.get_current_context().exit(NO_JOINT_PATH)
    if request.view:
        from wrod.scene.view import view as show

        show(out / "scene.usdc")
