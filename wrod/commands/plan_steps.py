"""The steps of `wrod plan`, each of which leaves something behind: grasps, files, joint path."""

import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import click

from wrod import cost
from wrod.errors import DataError, RobotError, WrodError

NO_JOINT_PATH = 3  # exit code: the plan stands, the arm cannot follow it
# Of a correction for a table, where an arm cannot follow all of it.
_SHARE = 0.5


def solve_grasps_of(
    fitted, *, method: str, device, shapes: bool, friction=None, pace=None,
    time_limit=None, **options,
):  # fmt: skip
    """The trajectory of what is `Prepared`, with the rod's shapes where they are wanted."""
    from wrod.deployment.plan import plan
    from wrod.deployment.simulate import with_remainder_of
    from wrod.planning.shapes import with_shapes

    how: dict = {"desc": "grasps"}
    if friction is not None:  # grasps are the least of it, and time is all that is known
        how = {"desc": "grasps, corrected", "bar_format": "{desc}: {elapsed}"}
    with cost.progress_bar(unit="grasp", delay=1.0, **how) as bar, cost.ticking(bar):
        progress = cost.counting(bar)
        trajectory = plan(
            fitted.pattern, fitted.rod, method, device=device, progress=progress,
            friction=None if method == "intuitive" else friction,
            pace=None if friction is None else pace,
            time_limit=None if friction is None else time_limit, **options,
        )  # fmt: skip
        if shapes:
            bar.n = 0
            curve = with_remainder_of(fitted.pattern, trajectory)
            trajectory = with_shapes(trajectory, curve, device=device, progress=progress)
    beyond = fitted.figures.get("beyond_grip")
    return trajectory if beyond is None else replace(trajectory, beyond_grip=beyond)


def softened(curve, rod, trajectory, start, how, friction, asked: dict):
    """A trajectory that asks less of the arm than one that is corrected for a table, and what is
    expected of it: with a share of its corrections, or, where `how` is the joint path of `start`,
    corrected anew within what the arm can do beside that, with the options that are `asked` of
    `optimise`."""
    from wrod.deployment.corrections import with_share
    from wrod.deployment.expectation import expect
    from wrod.deployment.optimise import optimise
    from wrod.robot.limits import ArmLimits

    if not isinstance(how, float):
        within = {"limits": ArmLimits(how), "pace": trajectory.optimised["pace"]}
        best = optimise(curve, rod, start, friction, **within, **asked)
        best.optimised["within_limits"] = True
        return best
    less = with_share(start, trajectory, how)
    pace = trajectory.optimised["pace"]
    less.metadata["expected"] = expect(
        curve, rod, less, friction, pace=pace, device=asked["device"]
    )
    return less


def within_speed(request, pace, planned):
    """Of a range of paces [m/s] those that the arm can keep all along the path of what `planned`
    returns, a plan without correction; anything else as it is."""
    if not isinstance(pace, tuple) or request.no_robot:
        return pace
    *_, start = planned()
    low, high = sorted(pace)
    try:
        path = request.solve(start, pace=high, whole_job=False)
    except RobotError:
        return pace  # said when the corrected plan is followed
    return low, max(low, path.steady_pace)


def save_plan(out: Path, curve, trajectory) -> list[Path]:
    """Write the trajectory and its picture.

    Raises:
        DataError: the folder cannot be written.
    """
    from wrod.planning.picture import draw_plan

    with _writing(out):
        picture = draw_plan(out / "preview.png", curve, trajectory)
    return [*save_trajectory(out, trajectory), picture]


def save_trajectory(out: Path, trajectory) -> list[Path]:
    """Write the trajectory alone; see `save_plan`."""
    with _writing(out):
        return trajectory.save(out / "trajectory")


@contextmanager
def _writing(out: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise DataError(f"{out}: cannot be written ({error}); choose another --out") from None


def arm_steps(request, out: Path, trajectory, curve, rod, planned, shaping, expected, softer=None):
    """Joint path and scene, or the reason why there is none, with what would help.

    Args:
        planned: a `Shaping` -> what the plan would be with it; `shaping` is what it is now.
        expected: what waits for what is expected of the trajectory, called before kernels are
            launched and files are made of it.
        softer: what asks less of the arm than all corrections for a table, see `softened`; None:
            there are none. Where the arm cannot follow them they are made anew within what it can
            do, and if it cannot follow these either it follows as many as it can.

    Returns:
        The `JointPath` or None, the reason or None, the files written, and the trajectory followed.
    """
    from wrod.robot.remedy import draw_reach
    from wrod.robot.solve import UnreachedError
    from wrod.scene.deliver import deliver

    with cost.progress_bar(total=5, unit="step", delay=1.0) as steps, cost.ticking(steps):

        def step(what: str) -> None:
            steps.set_description(what)
            steps.update(1)

        step("joint path")
        try:
            joint_path, trajectory = _followed(request, trajectory, softer)
            expected()
        except RobotError as error:
            expected()
            if not isinstance(error, UnreachedError):
                return None, str(error), [], trajectory
            step("remedy")
            picture, said = draw_reach(out / "reach.png", error), None
            failure = str(error).rsplit(";", 1)[0]
            if request.remedy:
                click.echo(
                    f"wrod: {failure}; looking for what would help, for {_REMEDY / 60:.0f} minutes "
                    "at most (--no-remedy leaves that out)",
                    err=True,
                )
                said = _remedy(request, error, rod, curve, planned, shaping)
            reason = f"{failure}; {said}" if said else str(error)
            return None, reason, [picture], trajectory
        with _writing(out):
            written = request.export(joint_path, out)
            written += deliver(out, trajectory, joint_path, curve, rod, step)
        return joint_path, None, written, trajectory


def _followed(request, trajectory, softer):
    """A joint path, and what it follows: the given trajectory, or one that is corrected less.

    Raises:
        UnreachedError: none was found.
    """
    from wrod.robot.solve import UnreachedError

    try:
        return request.solve(trajectory), trajectory
    except UnreachedError:
        if softer is None:
            raise
        start = softer(0.0)
        path = request.solve(start)
        click.echo(
            "wrod: the arm cannot follow all of the correction; correcting within what it can do, "
            "which takes as long again",
            err=True,
        )
        for how in (path, _SHARE):
            less = softer(how)
            try:
                return request.solve(less), less
            except UnreachedError:
                continue
        return path, start


def _remedy(request, failed, rod, curve, planned, shaping) -> str | None:
    """Options with which the joint path was found, or None."""
    from wrod.robot.placement import candidates
    from wrod.robot.remedy import remedies

    until, narrow = time.monotonic() + _REMEDY, None

    def places(heights):
        return candidates(failed.task.trajectory, failed.task.robot, heights=heights)

    other_arm = {request.flange, request.tip, request.gripper_length} == {None}
    for change in remedies(failed, rod, curve, places, until):
        left = until - time.monotonic()
        if left < 0.0:
            return narrow or (
                f"nothing that helps was found in {_REMEDY / 60:.0f} minutes; use a smaller "
                "pattern, or another arm"
            )
        if "table_height" in change:
            # Found by solving for it; a placement that was given must be given up.
            lift = 100 * (change["table_height"] - failed.best.branch.placement.z)
            way = "higher" if lift > 0 else "lower"
            command = again(**change, placement="auto")
            elsewhere = "" if request.placement == "auto" else "placed elsewhere and "
            return f"{elsewhere}with the table {abs(lift):.0f} cm {way} it is found: {command}"
        if "robot" in change and not other_arm:
            continue  # they are of the arm that was asked for
        change = _absolute(change, shaping)
        click.echo(f"wrod: trying it {_said(change).rstrip(',')}", err=True)
        room = _room(request, planned, shaping, change, min(_TRY, left))
        if room is None:
            continue
        said = f"{_said(change)} it is found: {again(**change)}"
        if room >= _COMFORT:
            return said
        narrow = narrow or said
    return narrow


def _room(request, planned, shaping, change: dict, seconds: float) -> float | None:
    """How far from its joints' limits an arm stays with such a change [rad]; None where it finds no
    path in so many `seconds`, within which the command that is printed finds it too."""
    shape = {name: change[name] for name in ("resize", "hold", "reverse") if name in change}
    wanted = replace(request, robot=change.get("robot", request.robot))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            *_, trajectory = planned(
                replace(shaping, **shape), led=change.get("remainder"), spin=change.get("spin")
            )
            path = wanted.solve(trajectory, time_limit=seconds)
    except WrodError:
        return None
    return path.limit_margin


def _absolute(change: dict, shaping) -> dict:
    """A change of what is asked for now as options: sizes multiply, ends are swapped."""
    change = dict(change)
    if "resize" in change:
        change["resize"] = round(change["resize"] * (shaping.resize or 1.0), 3)
    if "reverse" in change:
        change["reverse"] = not shaping.reverse
    return change


def _said(change: dict) -> str:
    parts = {
        "robot": "with {}, whose last joint turns far enough",
        "reverse": "laid from its other end",
        "resize": "drawn {:g} times as large",
        "hold": "held {:g} m from its free end",
        "spin": "with a hand that turns about the rod by {:g} degrees besides",
        "remainder": "without a lead-in, which turns the hand,",
    }
    return ", ".join(parts[name].format(change[name]) for name in parts if name in change)


def again(**changes) -> str:
    """The command that runs now with other options, to be copied: names -> values; True of a flag,
    False of its opposite."""
    import shlex

    context = click.get_current_context()
    words, given = ["wrod", str(context.info_name)], []
    for param in context.command.params:
        name = str(param.name)
        # What is not among them is a flag, such as --json, that its command knows otherwise.
        value = changes.get(name, context.params.get(name, True))
        on_line = context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        if isinstance(param, click.Argument):
            given.append(str(value))
        elif name in changes or on_line:
            if isinstance(param, click.Option) and param.is_flag:
                words += [param.opts[0]] if value else param.secondary_opts[:1]
            else:
                for one in value if param.multiple else (value,):
                    words += [param.opts[0], f"{one:g}" if isinstance(one, float) else str(one)]
    return shlex.join([*words[:2], *given, *words[2:]])


# [s] of looking for what would help an arm, in all and by one change, and for a size that it can
# lay.
_REMEDY, _TRY, _SEARCH = 180.0, 60.0, 600.0
_COMFORT = 0.05  # [rad] from a joint's limits, with less of which another remedy is looked for


def fitting(request, tries, planned, reason) -> str:
    """Options with which a pattern that is too long for its rod was laid, or that none were found.

    Args:
        tries: `Shaping`s, most likely first.
        planned: as in `arm_steps`, with `tried`.
        reason: why this is looked for; said at once.
    """
    from wrod.robot.remedy import spins
    from wrod.robot.solve import UnreachedError

    click.echo(
        f"wrod: {reason}; looking for a size that the arm can lay, for {_SEARCH / 60:.0f} minutes "
        "at most (--no-remedy leaves that out)",
        err=True,
    )
    begun, said = time.monotonic(), []

    def found(shaping, spin: float | None = None, **limit):
        """The arm's path as a command, or the spins that may help."""
        asked = {} if spin is None else {"spin": spin}
        rod = None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                fitted, _, trajectory = planned(shaping, tried=True, **asked)
                rod = fitted.rod
                request.solve(trajectory, **limit)
        except UnreachedError as error:
            return None, spins(error.task, rod)
        except WrodError:
            return None, []
        size = {"resize": shaping.resize, "hold": shaping.hold, "reverse": shaping.reverse}
        return again(remainder=False, **size, **asked), []

    for shaping in tries:
        if time.monotonic() - begun > _SEARCH:
            break
        said.append(f"{shaping.resize:g}")
        click.echo(f"wrod: trying {said[-1]} of its size", err=True)
        command, others = found(shaping)
        for spin in others:
            if command is not None:
                break
            click.echo(f"wrod: trying that, and the hand spun by {spin:g} degrees", err=True)
            command, _ = found(shaping, spin, time_limit=_TRY)
        if command is not None:
            return (
                "smaller, and held so that little is left over, a joint path is found: " + command
            )
    return (
        f"no joint path of {request.robot} was found at {', '.join(said)} of its size; another arm "
        "may do, or a rod that is longer or less stiff"
    )
