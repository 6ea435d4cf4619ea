"""What would help where no joint path was found: computed, and tried before it is said."""

import math
import time
from collections.abc import Callable, Iterator

import numpy as np

from wrod.errors import RobotError
from wrod.files import write_figure
from wrod.robot.kinematics import one_torch_thread
from wrod.robot.model import ROBOTS, load_robot
from wrod.robot.placement import reach
from wrod.robot.solve import FAR, UnreachedError, attempt, headings, low_end, turning
from wrod.robot.tail import FINGERS
from wrod.rods.model import RodModel

_TURN_ROOM = 0.2  # [rad] that a last joint should have left
# Shares of a last joint's turn that a spun hand is left with, and the most that it may twist the
# rod [1/L_gb]: up to there simulated rods lie no worse by it.
_SPUN, _MOST_TWIST = (0.75, 0.6, 0.9), 0.7
# Sizes of a pattern, and rod left over at its end [L_gb].
_SMALLER = ((0.85, 5.9), (0.8, 9.2), (0.93, 5.9))
_CLEARANCE = 0.005  # of the fingers over the table [m]
_STEPS = (0.1, -0.1, 0.2, -0.2, 0.3, -0.3, 0.45, -0.45)  # [m] table heights tried, about the best


def least_suspended(rod) -> float:
    """Length [m] of suspended rod from which on upright fingers clear the table, on a straight
    pattern; a length of which they do not is not laid by an arm.

    Args:
        rod: a `RodMaterial` or `RodModel`.
    """
    from wrod.grasps.optimal import solve_grasps

    lgb = rod.gravito_bending_length
    lengths = np.linspace(1.0, 8.0, 57)
    height = lgb * solve_grasps(lengths, 0.0, rod.stretch_ratio).position[:, 2]
    high = np.flatnonzero(height > FINGERS + _CLEARANCE)
    return float(lengths[high[0] if len(high) else -1] * lgb)


def other_height(
    failed: UnreachedError, candidates: Callable, until: float = math.inf
) -> float | None:
    """A table height [m] at which the same path is found, nearest to what was tried first.

    Args:
        failed: the error that says what was tried.
        candidates: heights -> placements.
        until: when to stop [s of the monotonic clock].
    """
    middle = failed.best.branch.placement.z
    task = failed.task
    with one_torch_thread():
        for step in _STEPS:
            if time.monotonic() > until:
                break
            places = candidates((middle + step,))
            if not places:
                continue
            # Looked at coarsely first: most heights fail at once.
            angle = failed.best.branch.grip.angle
            branches = task.branches(places, angle, 8)
            if task.cost(branches[0]) > 3.0:
                continue
            found = attempt(task, places, (angle,), False)
            if found.report.problem is None:
                return float(found.branch.placement.z)
    return None


def draw_reach(path, failed: UnreachedError):
    """Picture of where the pattern lay in the nearest attempt, and where else it was tried."""
    from matplotlib.figure import Figure

    task, best = failed.task, failed.best
    place = best.branch.placement
    contact, grip = place.to_base(task.trajectory.contact), place.to_base(task.trajectory.position)
    missed = np.interp(task.path.travel, task.travel, best.branch.miss)
    shoulder, far = reach(task.robot)
    figure = Figure(figsize=(11.0, 5.2), layout="constrained")
    angle = np.linspace(0.0, 2 * np.pi, 200)
    for k, (a, b, label) in enumerate(((0, 1, "from above"), (0, 2, "from the side"))):
        axes = figure.add_subplot(1, 2, k + 1)
        for share, style in ((1.0, "-"), (0.4, ":")):
            axes.plot(
                shoulder[a] + share * far * np.cos(angle),
                shoulder[b] + share * far * np.sin(angle),
                style, color="0.6", lw=1.0,
            )  # fmt: skip
        shown = [other for other in failed.places if other != place]
        for elsewhere in shown[:12] if k == 0 else []:
            other = elsewhere.to_base(task.trajectory.contact)
            axes.plot(other[:, a], other[:, b], color="0.85", lw=0.8)
        axes.plot(contact[:, a], contact[:, b], color="tab:blue", lw=2.0, label="pattern")
        marks = axes.scatter(
            grip[:, a], grip[:, b], c=1e3 * missed, cmap="YlOrRd", s=8, vmin=0.0,
            vmax=max(1.0, 1e3 * float(missed.max())), label="grip",
        )  # fmt: skip
        axes.plot(0.0, 0.0, "k^", label="robot's base")
        axes.set_aspect("equal")
        axes.set_title(label, fontsize=10)
        axes.set_xlabel("x from the robot's base [m]")
        axes.set_ylabel(f"{'xyz'[b]} [m]")
        axes.legend(fontsize=8, loc="lower left")
    figure.colorbar(marks, ax=figure.axes, label="miss of the grip [mm]", shrink=0.8)
    figure.suptitle(
        f"{task.robot.name}: {best.report.problem}\nsolid circle: outstretched; grey: other "
        "places tried",
        fontsize=9,
    )
    return write_figure(path, figure, 110)


def remedies(
    failed: UnreachedError, rod, curve, candidates, until: float = math.inf
) -> Iterator[dict]:
    """What to try, most likely first: {"resize" | "hold" | "reverse" | "remainder" | "spin" |
    "robot" | "table_height": value, ...}. Where the pattern turns the hand further than its joint,
    less turning comes first and arms whose last joint turns further come last. Heights of the table
    are tried `until` then [s of the monotonic clock].

    Args:
        rod, curve: that were planned, the pattern with its lead-in.
    """
    turned, room = turning(failed.task)
    low = low_end(failed.task.trajectory, failed.task.clearance)
    arms = list(_other_arms(turned, low)) if turned > room else []
    spun = list(_spun(failed.task, rod, curve, low))
    if turned > room + FAR:
        ways = [*_turning_less(rod, curve), *_as_large(curve)]
        yield from [*spun, *ways[:2], *arms[:1], *ways[2:]]
    elif turned > room:
        yield from [*_as_large(curve), *spun]
        yield from _turning_less(rod, curve)
    yield from _others(failed, rod, curve, candidates, until, low)
    yield from arms


def spins(task, rod, lead_in: float = 0.0) -> list[float]:
    """Spins [degrees] against the pattern's turns after which the last joint has room, where it has
    none, two at most; without a lead-in of such a length [m]."""
    trajectory = task.trajectory
    turned, room = turning(task)
    if turned <= room or trajectory.spin != 0.0 or RodModel.of(rod).has_sides:
        return []
    rest = trajectory.arc_length >= lead_in
    heading, laid = headings(trajectory)[rest], trajectory.arc_length[rest]
    share = (laid - laid[0]) / (laid[-1] - laid[0])
    way = -math.copysign(1.0, heading[-1] - heading[0])
    most = _MOST_TWIST * (laid[-1] - laid[0]) / rod.gravito_bending_length
    degrees = np.arange(0.0, math.degrees(most), 10.0)
    left = np.ptp(heading + way * np.radians(degrees)[:, None] * share, axis=1)
    found = [np.flatnonzero(left < part * room) for part in _SPUN]
    return [float(way * degrees[f[0]]) for f in found if len(f)][:2]


def _spun(task, rod, curve, low: float | None) -> Iterator[dict]:
    """Spins without a lead-in, which leaves more rod at the end; with it; and for a smaller
    pattern, whose rod begins lower."""
    smaller = {} if low is None else {"resize": _least(low)}
    short = spins(task, rod, curve.remainder_length)
    if led := _led(curve):
        yield from ({"spin": spin, **led} for spin in short)
    yield from ({"spin": spin, **smaller} for spin in spins(task, rod)[:1])
    yield from ({"spin": spin, **list(_turning_less(rod, curve))[2]} for spin in short[:1])


def _other_arms(turned: float, low: float | None) -> Iterator[dict]:
    """Arms whose last joint turns that far [rad]; with less of a pattern whose end is too `low`."""
    smaller = {} if low is None else {"resize": _least(low)}
    for name in ROBOTS:
        last = load_robot(name)
        if last.upper[-1] - last.lower[-1] > turned + _TURN_ROOM:
            yield {"robot": name, **smaller}


def _least(share: float) -> float:
    """Not as little smaller as possible: the next millimetres are as low."""
    return float(np.floor(100 * share - 1.0) / 100)


def _led(curve) -> dict:
    return {"remainder": False} if curve.remainder_length > 0.0 else {}


def _as_large(curve) -> Iterator[dict]:
    if led := _led(curve):
        yield led
    yield {"reverse": True}


def _turning_less(rod, curve) -> Iterator[dict]:
    """Other ways along a pattern that turns the hand much: from its other end the turns are shared
    out differently, and of a smaller one more rod is left, which keeps the hand off the table."""
    smaller = []
    for size, left in _SMALLER:
        held = {"resize": size, **_led(curve)}
        hold = round(size * curve.length + left * rod.gravito_bending_length, 3)
        if hold < rod.length:
            held["hold"] = hold
        smaller.append(held)
    back = [{**held, "reverse": True} for held in smaller]
    yield from [*back[:2], *smaller[:2], *back[2:], *smaller[2:]]


def _others(
    failed: UnreachedError, rod, curve, candidates, until: float, share: float | None
) -> Iterator[dict]:
    if share is not None:
        least = _least(share)
        yield {"resize": least}
        yield {"resize": round(0.8 * least, 2)}
        yield {"resize": round(0.6 * least, 2)}
        return
    needed = curve.length + curve.remainder_length + 1.5 * rod.gravito_bending_length
    if needed < 0.9 * rod.length:
        yield {"hold": float(np.ceil(100 * needed) / 100)}
    yield {"reverse": True}
    try:
        height = other_height(failed, candidates, until)
    except RobotError:
        height = None
    if height is not None:
        yield {"table_height": round(height, 3)}
    yield {"resize": 0.8}
    yield {"resize": 0.6}
