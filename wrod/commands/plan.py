"""`wrod plan PATTERN`: the trajectory of the grip as files and as a picture."""

import math
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import click

from wrod import cost
from wrod.commands import plan_steps as steps
from wrod.commands.bounds import BOUNDS
from wrod.commands.options import (
    DEVICE,
    DRAWING,
    PICTURE,
    ROLL,
    UNITS,
    PatternOptions,
    RodOptions,
    closure_option,
    method_option,
)
from wrod.commands.plan_pattern import Shaping, fit, shorter, too_long
from wrod.commands.plan_summary import beyond_the_grip, read_friction, read_range, summary
from wrod.commands.robot_options import RobotRequest
from wrod.commands.running import draw_beside
from wrod.errors import PatternError
from wrod.machine import usable_cores
from wrod.options import FOLDER, gathered, option, own_options, refuse_idle_options
from wrod.telling import json_option, tell


@dataclass(frozen=True)
class _GraspRequest:
    """How grasps are found."""

    method: str = method_option()
    closure: str | None = closure_option()
    controller_file: Path | None = option(
        "Controller that `wrod train` made, its file or folder; of a naturally curved rod it has "
        "to be that rod's. Default: those that ship, for straight rods.",
        "--controller",
    )
    spacing: float = option("Distance between nodes [m].", default=0.0025)
    friction_text: str | None = option(
        "Of the table: a coefficient (0.3) or a range (0.2:0.6). The path is corrected until what "
        "stays lies on the pattern, and what is expected there is said; takes a minute or two.",
        "--friction",
    )
    pace: str | None = option(
        "Speed of the contact on that table [m/s], or a range (0.02:0.08), of which the fastest is "
        "taken that does no harm; 0.04."
    )
    minutes: float | None = option(
        "Correct each path for so long at most; the best so far is judged and taken."
    )
    expects: bool = option(
        "Lay the plan in simulation and say how far off it will lie (default); seconds.",
        "--expect/--no-expect",
        default=True,
    )
    shapes: bool = option(
        "Let the rod solver compute the rod's shapes where the method gives none (default).",
        "--shapes/--no-shapes",
        default=True,
    )
    remainder: bool | None = option(
        "Lay a lead-in of growing curvature first; by default where the pattern starts curved.",
        "--remainder/--no-remainder",
        default=None,
    )
    roll_text: str | None = option(ROLL, "--roll")
    spin: float = option(
        "Turn the hand about the rod besides, evenly, by so much in all [degrees]: against the "
        "pattern's turns it spares an arm's last joint, and twists the rod.",
        default=0.0,
        show_default=False,
    )

    def read(self, rod) -> dict:
        """What `solve_grasps_of` takes, but for friction, of this rod.

        Raises:
            RodError, DataError: an option that does nothing, or a controller that is none.
        """
        from wrod.controller.controller import Controller

        if self.method == "intuitive":
            refuse_idle_options("--method intuitive", "closure", "pace", "minutes")
        if self.method in ("intuitive", "numeric"):
            refuse_idle_options(f"--method {self.method}", "controller")
        if self.friction_text is None:
            refuse_idle_options("a plan without --friction", "pace", "minutes")
        from wrod.planning.roll import read_roll
        from wrod.planning.sources import check_method

        table = self.friction_text if self.corrects else None
        check_method(self.method, table, self.pace, self.minutes)
        if self.closure is not None:
            from wrod.grasps.inputs import closure_number

            closure_number(self.closure)
        file = self.controller_file
        return {
            "method": self.method,
            "closure": self.closure,
            "spacing": self.spacing,
            "remainder": self.remainder,
            "shapes": self.shapes,
            "roll": read_roll(self.roll_text, rod),
            "spin": math.radians(self.spin),
            "controller": None if file is None else Controller.load(file),
            "time_limit": self.time_limit,
            "pace": None
            if self.pace is None
            else read_range(self.pace, "pace", "0.04 or 0.02:0.08", BOUNDS["--speed"]),
        }

    @property
    def time_limit(self) -> float | None:
        """Of a path's correction [s]."""
        return None if self.minutes is None else 60.0 * self.minutes

    @property
    def corrects(self) -> bool:
        """Whether a plan is corrected for its table."""
        return self.friction_text is not None and self.method != "intuitive"

    def friction(self):
        """Of the table, if one is known."""
        return None if self.friction_text is None else read_friction(self.friction_text)

    def begin(self, fitted, curve, friction, device: str | None, remainder) -> None:
        """Begin to compile what solver and simulator need, while the rest is planned, and say how
        long it takes to correct the plan for its table: of a range of paces three are tried, and
        rods that may roll take longer, as do long patterns, long rods and remainders."""
        from wrod.grasps.levels import compile_grasps_ahead
        from wrod.rods.device import resolve_device
        from wrod.solvers.compiling import compile_steps_ahead

        if self.shapes:
            compile_grasps_ahead(resolve_device(device))
        if self.expects or self.corrects:
            more = ("tangents",) if self.corrects else ()
            compile_steps_ahead(resolve_device(device), "grip", *more)
        if friction is None or self.method in ("distilled", "intuitive"):  # corrected at once
            return
        from wrod.deployment.effort import corrected
        from wrod.planning.remainder import lead_ins

        rod = fitted.rod
        count = len(lead_ins(fitted.pattern, rod)) if remainder is None else 1
        where, pace = resolve_device(device), self.read(rod)["pace"]
        # Two rods are laid at a time, of which a core has one.
        cores = min(usable_cores(), 2) if where == "cpu" else 1
        most = cores * (self.time_limit or math.inf)
        seconds = corrected(curve, rod, friction, pace=pace, most=most, device=where) / cores
        work = cost.Cost(seconds * count * (2 if self.spin else 1))
        cost.settle(work, "the plan, corrected for its table")

    def expecting(self, curve, rod, trajectory, friction, device: str | None, beside: bool):
        """A context in which what is expected of a trajectory is found out, where it is wanted and
        not known yet; see `wrod.commands.plan_expected.expecting`."""
        wanted = self.expects or (friction is not None and self.method == "intuitive")
        if not wanted or "expected" in trajectory.metadata:
            return nullcontext(lambda: False)
        from wrod.commands.plan_expected import expecting

        return expecting(curve, rod, trajectory, friction, device, beside=beside)


@click.command(name="plan")
@click.argument("pattern")
@gathered("rod_options", RodOptions)
@own_options
@gathered("grasps", _GraspRequest)
@gathered("reading", PatternOptions, UNITS, DRAWING, PICTURE)
@gathered("shaping", Shaping)
@gathered("request", RobotRequest)
@DEVICE
@json_option
def command(
    pattern: str,
    rod_options: RodOptions,
    grasps: _GraspRequest,
    reading: PatternOptions,
    shaping: Shaping,
    request: RobotRequest,
    device: str,
    out: Path = option(None, type=FOLDER, required=True),
) -> None:
    """Plan how the grip moves to lay a rod along PATTERN.

    PATTERN is a file of points (text, CSV, NPY or NPZ), a picture of a drawn curve (with
    --markers, --sheet or --scale), a vector drawing (SVG, DXF), or a built-in pattern: line,
    circle, sine, letter-U, letter-C, letter-L, letter-A, letter-S.

    Corners are rounded to what the rod can lie in. What is finished is kept: without a joint path
    the trajectory and its picture are written all the same, and the exit code is 3.
    """
    friction, chosen = grasps.friction(), None if device == "auto" else device
    request = request.check()
    draw_beside(not request.no_robot)
    rod, drawn = rod_options.read(), reading.read(pattern)
    how = grasps.read(rod)
    # What takes a second to import, once nothing is left to refuse.
    from wrod.deployment.simulate import with_remainder_of
    from wrod.planning.remainder import prepare

    def planned(wanted: Shaping, friction=None, led=None, spin=None, tried=False):
        """Pattern, rod and trajectory of a shaping; `led` is the remainder, `spin` [degrees], where
        they are not as asked for. One that is only `tried` has no remainder by default."""
        fitted = fit(drawn, rod, wanted)
        try:
            remainder = led if led is not None else False if tried else grasps.remainder
            curve = prepare(fitted.pattern, fitted.rod, remainder)
        except PatternError as error:
            remedy = too_long(fitted.pattern, fitted.rod, arm=not request.no_robot)
            if remedy and request.remedy and not (tried or request.no_robot):
                whole = fit(drawn, rod, replace(shaping, resize=None, tolerance=1.0)).pattern
                said = steps.fitting(request, shorter(whole, fitted.rod, shaping), planned, error)
                raise PatternError(f"{error}; {said}") from None
            raise PatternError(f"{error} ({remedy})" if remedy else str(error)) from None
        grasps.begin(fitted, curve, friction, chosen, remainder)
        turned = how["spin"] if spin is None else math.radians(spin)
        asked = {**how, "remainder": remainder, "spin": turned}
        asked["left"] = grasps.corrects and wanted.hold is None
        trajectory = steps.solve_grasps_of(fitted, device=chosen, friction=friction, **asked)
        return fitted.held_by(trajectory), with_remainder_of(fitted.pattern, trajectory), trajectory

    how["pace"] = steps.within_speed(request, how["pace"], lambda: planned(shaping))
    fitted, curve, trajectory = planned(shaping, friction)
    joint_path, reason, beside = None, None, not request.no_robot
    with grasps.expecting(curve, fitted.rod, trajectory, friction, chosen, beside) as wait:
        written = steps.save_plan(out, curve, trajectory)

        def expected():
            if wait():
                steps.save_trajectory(out, trajectory)

        def softer(how):
            held = replace(shaping, hold=fitted.rod.length)
            start = planned(held, led=curve.remainder_length or False)[2]
            asked = {"time_limit": grasps.time_limit, "device": chosen or "auto"}
            return steps.softened(curve, fitted.rod, trajectory, start, how, friction, asked)

        if beside:
            corrected = (trajectory.optimised or {}).get("kept", False)
            joint_path, reason, more, followed = steps.arm_steps(
                request, out, trajectory, curve, fitted.rod, planned, shaping, expected,
                softer if corrected else None,
            )  # fmt: skip
            if followed is not trajectory:
                trajectory = followed
                steps.save_plan(out, curve, trajectory)
            written += more
    _say(_figures(trajectory, fitted, joint_path, reason, written))
    if request.view:
        from wrod.scene.view import view

        view(out / "scene.usdc")


def _figures(trajectory, fitted, joint_path, reason: str | None, written: list[Path]) -> dict:
    from wrod.rods.model import RodModel

    beyond, more = beyond_the_grip(trajectory, joint_path)
    rolled = trajectory.twist is not None and RodModel.of(fitted.rod).has_sides
    return {
        **trajectory.metadata,
        **fitted.figures,
        "beyond_grip": trajectory.beyond_grip,
        "beyond": beyond,
        "nodes": len(trajectory),
        "laid_length": float(trajectory.arc_length[-1]),
        "roll": float(trajectory.roll),
        "highest_grip": float(trajectory.position[:, 2].max()),
        "twist": trajectory.twist[[0, -1]].tolist() if rolled else None,
        "joint_path": None if joint_path is None else joint_path.metadata,
        "no_joint_path": reason,
        "notes": [*fitted.notes, *more],
        "written": [str(path) for path in written],
    }


def _say(figures: dict) -> None:
    """Print them; without a joint path the command ends here."""
    tell(figures, summary(figures))
    if figures["no_joint_path"] is not None:
        click.echo(f"wrod: {figures['no_joint_path']}", err=True)
        click.get_current_context().exit(steps.NO_JOINT_PATH)
