"""Gates for a cable: where posts must stand so that a plan lays the cable between them.

A rod is laid from the side. While it hangs over a place of the pattern it is already low there, but
still off to the outside of the bend, and comes in sideways as the contact draws near. `approach`
says from where; `design_gates` sets posts that are out of its way.
"""

import numpy as np

from wrod.deployment.fixtures import Fixture, Fixtures
from wrod.deployment.setup import DEVIATIONS
from wrod.errors import PatternError
from wrod.grasps.optimal import solve_grasps
from wrod.patterns.pattern import Pattern
from wrod.planning.sources import MIN_SUSPENDED_LENGTH
from wrod.rods.material import RodMaterial
from wrod.solvers.solids import Cylinder

# Spacing of laid lengths at which the hanging rod is looked at, and of possible gates [m].
_STEP = 0.004
# The rod's first piece is laid at once; gates begin and end so far from the pattern's ends [m].
_FIRST, _GATE, _LAST = 0.05, 0.03, 0.01


def approach(
    pattern: Pattern, rod: RodMaterial, height: float, *, closure: str = "min_friction"
) -> tuple[np.ndarray, np.ndarray]:
    """How far to the side a rod is while it comes down to its pattern.

    Args:
        pattern: what is laid.
        rod: with which rod.
        height: of posts [m].
        closure: of the plan.

    Returns:
        places (n,) along the pattern [m], and the largest distance (n,) of the hanging rod's
        centreline from the pattern there while its underside is lower than `height` [m], positive
        to the left.
    """
    lgb = rod.gravito_bending_length
    longest = min(pattern.length, rod.length - MIN_SUSPENDED_LENGTH * lgb)
    laid = np.arange(_FIRST, longest, _STEP)
    contact, tangent, curvature = pattern.sample(laid)
    grasps = solve_grasps(
        (rod.length - laid) / lgb,
        curvature * lgb,
        np.full(len(laid), rod.stretch_ratio),
        closure=closure,
        device="cpu",
    )
    frame = np.stack([tangent, _left(tangent), np.tile([0.0, 0.0, 1.0], (len(laid), 1))], axis=2)
    hanging = contact[:, None] + lgb * np.einsum("kij,knj->kni", frame, grasps.shape)
    hanging[~grasps.converged] = np.nan
    places = np.arange(0.0, pattern.length, _STEP)
    return places, np.array([_sideways(pattern, s, laid, hanging, height) for s in places])


def _left(tangent: np.ndarray) -> np.ndarray:
    return np.cross([0.0, 0.0, 1.0], tangent)


def _sideways(pattern, place, laid, hanging, height) -> float:
    """The largest distance at one place."""
    (point,), (tangent,), _ = pattern.sample(place)
    left, largest = _left(tangent), 0.0
    for k in np.flatnonzero(laid < place)[::-1]:
        ahead = (hanging[k] - point) @ tangent
        through = np.flatnonzero((ahead[:-1] < 0) & (ahead[1:] >= 0))
        if len(through) == 0:
            break
        j = through[0]
        part = ahead[j] / (ahead[j] - ahead[j + 1])
        at = hanging[k, j] + part * (hanging[k, j + 1] - hanging[k, j])
        if at[2] >= height:
            break
        side = float((at - point) @ left)
        largest = side if abs(side) > abs(largest) else largest
    return largest


def sideways_deviation(
    pattern: Pattern, rod: RodMaterial, place: np.ndarray, side: np.ndarray
) -> np.ndarray:
    """Standard deviation of where a rod comes down, across the pattern [m].

    The root sum of squares of `wrod.deployment.setup.DEVIATIONS`: the robot's place, its yaw about
    the pattern's start, the grip's shaking, the natural curvature of the last L_gb before the
    contact, which bends freely, and the error in L_gb, with which the hanging rod's way to the side
    scales.

    Args:
        pattern, rod: what is laid.
        place: (n,) along the pattern [m].
        side: (n,) how far to the side the rod still is (`approach`) [m].
    """
    one = DEVIATIONS
    start = pattern.sample(0.0)[0][0]
    lever = np.linalg.norm(pattern.sample(place)[0] - start, axis=1)
    parts = (
        one["placement"],
        one["jitter"],
        one["yaw"] * lever,
        one["natural_curvature"] * rod.gravito_bending_length**2 / 2.0,
        one["lgb_error"] * side,
    )
    return np.sqrt(sum(np.square(part) for part in parts))


def design_gates(
    pattern: Pattern,
    rod: RodMaterial,
    *,
    pitch: float,
    radius: float = 0.004,
    height: float = 0.004,
    closure: str = "min_friction",
    name: str | None = None,
) -> Fixtures:
    """Pairs of posts between which a plan lays a rod, about `pitch` apart.

    The rod slips in if its middle comes down between the posts, so each stands three times
    `sideways_deviation` from where the middle is meant to be: from the pattern on the one side, and
    on the side from which the rod comes as much farther out as it still is when it is as low as the
    posts. Among all places, gates stand where that is least. The tight side is the inner one of a
    bend, which the rod presses on once it is laid.

    Args:
        pattern: the rod's way; gates begin 3 cm from its start.
        rod: with its radius.
        pitch: wanted distance between gates; none are less than half or more than one and a half
            of it apart [m].
        radius, height: of the posts [m].
        closure: of the plan.
        name: of the scene.

    Raises:
        PatternError: the pattern is too short, or the posts would stand in each other's or the
            pattern's way.
    """
    if not (np.isfinite(pitch) and pitch > 0):
        raise PatternError(f"the pitch of gates is {pitch!r}; give a positive length [m]")
    if pattern.length < _FIRST + _LAST + pitch:
        raise PatternError(
            f"{pattern.source}: is {pattern.length:.3g} m long, too short for gates {pitch:g} m "
            "apart; give a smaller pitch"
        )
    places, side = approach(pattern, rod, height, closure=closure)
    chosen = _choose(places, np.abs(side), pitch, pattern.length)
    position, tangent, _ = pattern.sample(places[chosen])
    clear = 3.0 * sideways_deviation(pattern, rod, places[chosen], side[chosen])
    clear = np.maximum(clear, 1.5 * rod.radius)
    items, gates = [], []
    for k, (point, left, off, margin) in enumerate(
        zip(position, _left(tangent), side[chosen], clear, strict=True), start=1
    ):
        for label, sign in (("left", 1.0), ("right", -1.0)):
            away = sign * (margin + max(sign * off, 0.0) + radius)
            x, y = (float(v) for v in np.round((point + away * left)[:2], 5))
            post = Cylinder((x, y, height / 2), radius, height / 2)
            items.append(Fixture(f"{k}-{label}", post))
        gates.append((f"{k}-left", f"{k}-right"))
    scene = Fixtures(tuple(items), tuple(gates), name or pattern.name)
    _check(scene, pattern, rod)
    return scene


def _choose(places: np.ndarray, side: np.ndarray, pitch: float, length: float) -> np.ndarray:
    """Indices of the places that cost least: the mean square of `side` in steps, and of how far
    distances are from the pitch in quarters of it (dynamic programming)."""
    usable = (places >= _GATE) & (places <= length - _LAST)
    index = np.flatnonzero(usable)
    s, cost = places[index], (side[index] / _STEP) ** 2
    total, before = np.full(len(s), np.inf), np.full(len(s), -1)
    total[0] = 0.0
    for j in range(1, len(s)):
        gap = s[j] - s[:j]
        fits = (gap >= 0.5 * pitch) & (gap <= 1.5 * pitch)
        way = np.where(fits, total[:j] + ((gap - pitch) / (0.25 * pitch)) ** 2, np.inf)
        before[j] = int(way.argmin())
        total[j] = way[before[j]] + cost[j]
    late = np.where(s > s[-1] - 0.5 * pitch, total, np.inf)
    j = int(late.argmin())
    out = []
    while j >= 0:
        out.append(index[j])
        j = before[j] if j > 0 else -1
    return np.array(out[::-1])


def _check(scene: Fixtures, pattern: Pattern, rod: RodMaterial) -> None:
    line = pattern.sample(np.linspace(0.0, pattern.length, 600))[0][:, :2]
    posts = [item.shape for item in scene.items if isinstance(item.shape, Cylinder)]
    centers = np.array([post.center[:2] for post in posts])
    radius = np.array([post.radius for post in posts])
    free = np.linalg.norm(line[:, None] - centers, axis=2).min(axis=0) - radius - rod.radius
    apart = np.linalg.norm(centers[:, None] - centers, axis=2) - radius[:, None] - radius
    np.fill_diagonal(apart, np.inf)
    if free.min() < 0.0 or apart.min() < 0.0:
        worst = scene.items[int(free.argmin())].name
        raise PatternError(
            f"{pattern.source}: posts of {scene.name} stand in the way (at {worst}); give thinner "
            "posts, a larger pitch or a wider pattern"
        )
