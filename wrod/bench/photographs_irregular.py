"""Rods that are bent at rest at random, laid by INT beside photographs; `wrod bench photographs`.

A rod that is bent a little everywhere, this way and that, is laid in waves: which of them are
large, the mode of INT says (`wrod.bench.photographs_mode`).
"""

from dataclasses import dataclass, replace

import numpy as np

from wrod.bench import photographs_mode as mode
from wrod.grasps.growth import departures
from wrod.identification.laid.camera import OverheadCamera
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.identification.laid.placement import foot, rigid, shown_at
from wrod.identification.laid.scenario import LaidRod
from wrod.rods.catalogue import rod as preset
from wrod.rods.profile import Profile
from wrod.telling import table

# Bends keep over so much rod: exp(-s^2 / (4 l^2)) is their correlation [m].
CORRELATED = 0.03
# Deployments of other bends that are laid, and lines that are drawn to first order.
LAID, _LINES = 16, 100
# Bends are sums of so many waves, the longest [m]; a profile's points.
_WAVES, _LONGEST, _POINTS = 80, 2.0, 240
# Where on the line the mode is taken [m].
_AT = 0.3
_SHARES = (10, 50, 90)


def _spectrum() -> tuple[np.ndarray, np.ndarray]:
    """(n,) wave numbers [1/m], and amplitudes of bends that are 1 in root mean square."""
    k = 2.0 * np.pi * np.arange(1, _WAVES + 1) / _LONGEST
    power = np.exp(-((k * CORRELATED) ** 2))
    return k, np.sqrt(power / power.sum())


def bends(size: float, draw: int, length: float) -> tuple[Profile, Profile]:
    """Natural curvature at random: root mean square [1/m] of either component, number of the
    draw, and the rod's length [m]."""
    k, amplitude = _spectrum()
    s = np.linspace(0.0, length, _POINTS)
    waves = np.concatenate([np.cos(np.outer(k, s)), np.sin(np.outer(k, s))])
    many = size * np.random.default_rng(draw).normal(size=(2, len(waves))) * np.tile(amplitude, 2)
    first, second = many @ waves
    return Profile(tuple(first), tuple(s)), Profile(tuple(second), tuple(s))


@dataclass(frozen=True)
class Irregular:
    """What a rod bent at random would be laid in along a line, to first order, where its grip
    hangs as it believes.

    Attributes:
        size: root mean square of the bends [1/m] by which lines miss a straight one as far as the
            photographed line does, in the median; aside: of a grip's way aside [m] that does the
            same to a straight rod.
        wavelength, rate, left: (3,) quantiles of 10, 50 and 90 % of the wave that such lines are
            nearest to [m, 1/m], and of what it leaves over what a slope leaves [-].
    """

    size: float
    aside: float
    wavelength: tuple[float, ...]
    rate: tuple[float, ...]
    left: tuple[float, ...]


def irregular(name: str, points: np.ndarray, seen: mode.SeenWave) -> Irregular:
    """Of a rod and the (n, 2) points of its photographed line [m]."""
    k, amplitude = _spectrum()
    batch = mode.intuitive([preset(name)], np.array([_AT]), np.zeros(1))
    matrix = departures(batch)
    along = -points[:, 1][-points[:, 1] < mode.UNTIL]
    phase, slope = np.outer(along, k), np.column_stack([np.ones_like(along), along])
    both = amplitude[:, None] * np.random.default_rng(0).normal(size=(2, len(k), _LINES))

    def lines(high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, line) of causes that are 1, laid so high (wave,), and what a slope leaves (line,)."""
        laid = np.cos(phase) @ (high[:, None] * both[0])
        laid += np.sin(phase) @ (high[:, None] * both[1])
        off = slope @ np.linalg.lstsq(slope, laid, rcond=None)[0] - laid
        return laid, np.sqrt(np.mean(off**2, axis=0))

    _, aside = lines(mode.gain(matrix[0], 2.0 * np.pi / k))
    bent, missed = lines(np.array([mode.bend(batch, matrix, 2.0 * np.pi / one)[0] for one in k]))
    left = mode.left_by_waves(along, bent).reshape(-1, _LINES)
    best = left.argmin(axis=0)
    rate, length = mode.RATES[best // len(mode.LENGTHS)], mode.LENGTHS[best % len(mode.LENGTHS)]
    quantiles = [
        tuple(np.percentile(v, _SHARES).tolist()) for v in (length, rate, left.min(axis=0) / missed)
    ]
    size, other = (seen.slope_left / float(np.median(v)) for v in (missed, aside))
    return Irregular(size, other, *quantiles)


@dataclass(frozen=True)
class Scatter:
    """How far rods bent at random lie from a straight one where a photograph shows the rod.

    Attributes:
        seen: mean distance [m] of the photographed rod from the straight one; drawn: (draw,) of
            those laid, each after one rigid motion.
    """

    seen: float
    drawn: tuple[float, ...]

    @property
    def rank(self) -> int:
        """0 where the photographed rod lies as far off as the middle 80 % of those drawn, -1 where
        nearer, 1 where farther."""
        low, _, high = np.percentile(self.drawn, _SHARES)
        return int(self.seen > high) - int(self.seen < low)


def scatter(
    photograph: LaidPhotograph, straight: LaidRod, drawn: list[LaidRod], camera: OverheadCamera
) -> Scatter:
    """Of rods laid along a photograph's pattern and seen by a camera."""
    line = camera.view(photograph, straight.arc_length, straight.nodes)
    placed = rigid(photograph, line)
    at = foot(photograph, placed, straight.arc_length)
    off = []
    for one in drawn:
        if not one.reached:
            continue
        curve = camera.view(photograph, one.arc_length, one.nodes)
        points = shown_at(curve, one.arc_length, at)
        other = replace(
            photograph, centerline=points, seen=np.ones(len(points), bool),
            sigma=np.full(len(points), np.median(photograph.uncertainty)),
        )  # fmt: skip
        off.append(rigid(other, line).mean)
    return Scatter(placed.mean, tuple(off))


def scatter_table(sizes: dict[str, dict], scatters: dict[str, dict[str, Scatter]]) -> str:
    """Tables by rod of `irregular`'s figures and of {pattern: `Scatter`}."""
    told = []
    for rod, one in sizes.items():
        of = [", ".join(f"{v:.2f}" for v in one[key]) for key in ("wavelength", "rate", "left")]
        told.append([rod, f"{one['size']:.1f} ({1e3 * one['aside']:.1f})", *of])
    head = ("rod", "bends [1/m] (or grip aside [mm])", "length [m]", "growth [1/m]", "left")
    cells = []
    for rod, far in scatters.items():
        cells.append([rod])
        for one in far.values():
            low, _, high = 1e3 * np.percentile(one.drawn, _SHARES)
            cells[-1].append(f"{1e3 * one.seen:.1f} ({low:.1f} to {high:.1f})")
    others = [one.rank for far in scatters.values() for name, one in far.items() if name != "line"]
    lines = [
        "Rods bent at random: what a line would be laid in (10, 50, 90 %)",
        "",
        *table(head, told),
        "",
        "How far a rod lies from a straight one, seen (16 of those drawn, 10 to 90 %) [mm]",
        "",
        *table(["rod", *next(iter(scatters.values()))], cells),
        "",
        f"{others.count(0)} of {len(others)} pictures that are no lines lie as far off as the "
        f"middle 80 % of those drawn, {others.count(-1)} nearer, {others.count(1)} farther.",
    ]
    return "\n".join(lines) + "\n"
