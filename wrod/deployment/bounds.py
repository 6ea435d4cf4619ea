"""What of a deployment is refused before anything is laid."""

import numpy as np

from wrod.errors import PatternError, RodError
from wrod.machine import require_memory

# Beyond these a deployment takes weeks; what a node holds in states and factors.
_MOST_STEPS, _MOST_NODES, _NODE_BYTES = 2e7, 2e5, 4096.0
# How far the grip may move in a step [m], and how long an edge may be [L_gb].
_LONGEST_MOVE, _LONGEST_EDGE = 0.05, 3.0
# How far a trajectory's contacts may be from the pattern [m], and its rod from the one laid.
_SAME_PATTERN, _SAME_ROD = 2e-3, 0.01


def check_release(hold: float, release: float) -> None:
    if not release >= hold:
        raise RodError(f"release is {release!r} m; give at least the {hold:g} m that are held")


def refuse_endless(trials, speed, discretisation, frame_interval) -> None:
    """Refuse what no machine ends, or this one has no memory for, or steps and edges that miss
    what happens, before anything is laid."""
    spacing, step = discretisation.spacing, discretisation.step
    refuse_coarse_edges([trial.rod for trial in trials], spacing)
    refuse_long_moves(speed, step)
    longest = max(float(trial.rod.length) for trial in trials)
    nodes, duration = longest / spacing + 100.0, 2.0 * longest / speed
    if duration / step > _MOST_STEPS or nodes > _MOST_NODES:
        raise RodError(
            f"{longest:g} m of rod at {speed:g} m/s in steps of {step:g} s and edges of "
            f"{spacing:g} m take {duration / step:.2g} steps of {nodes:.2g} nodes; give a larger "
            "speed, step or spacing"
        )
    frames = 0.0 if frame_interval is None else duration / frame_interval
    require_memory(
        len(trials) * nodes * (_NODE_BYTES + 24.0 * frames),
        f"{len(trials)} trials of {nodes:.0f} nodes"
        + (f" and {frames:.0f} frames" if frames else ""),
        "ask for fewer trials or frames, or a larger spacing",
    )


def refuse_long_moves(speed: float, step: float) -> None:
    if speed * step > _LONGEST_MOVE:
        raise RodError(
            f"the grip moves {speed * step:g} m in a step of {step:g} s at {speed:g} m/s, too far "
            f"for what happens between; give a step or a speed that makes it {_LONGEST_MOVE:g} m"
        )


def refuse_coarse_edges(rods, spacing: float) -> None:
    longest = _LONGEST_EDGE * min(float(rod.gravito_bending_length) for rod in rods)
    if spacing > longest:
        raise RodError(
            f"spacing is {spacing:g} m, and an edge of {longest:.2g} m is the longest that bends "
            "as this rod does; give less"
        )


def refuse_another_pattern(trajectory, pattern) -> None:
    """Refuse a trajectory that was planned for another pattern than this one with its remainder.

    Raises:
        PatternError: contacts are off it, or end elsewhere.
    """
    s = np.clip(trajectory.pattern_arc_length, -pattern.remainder_length, pattern.length)
    apart = np.linalg.norm(pattern.sample(s)[0] - trajectory.contact, axis=1).max()
    apart = max(apart, abs(trajectory.pattern_arc_length[-1] - pattern.length))
    if apart > _SAME_PATTERN:
        raise PatternError(
            f"the trajectory is of {trajectory.metadata.get('pattern', 'another pattern')}, up to "
            f"{apart:.3f} m from {pattern.name}; give the pattern that it was planned for"
        )


def refuse_another_rod(trajectory, rod, names: tuple[str, ...], remedy: str = "") -> None:
    """Refuse a trajectory of a rod that differs in what `names` says.

    Raises:
        RodError: names what differs.
    """
    for name in names if trajectory.rod is not None else ():
        before, now = getattr(trajectory.rod, name), getattr(rod, name)
        if abs(now - before) > _SAME_ROD * before:
            raise RodError(
                f"the trajectory is of a rod whose {name} is {before:g} m, and this one's is "
                f"{now:g} m; give that rod{remedy}"
            )
