"""How a straight line of INT waves by itself: of one lateral mode, for `wrod bench photographs`.

The grip goes straight above the line. A contact that lies a little aside, points another way or is
rolled gets another curvature from the grip, which is what is laid next (`wrod.grasps.growth`): of
departures, one mode is a wave, whose length and decay depend on how much rod hangs too low.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from wrod.errors import GraspError
from wrod.files import write_figure
from wrod.grasps.growth import departures
from wrod.grasps.mesh import rest_lengths
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.rods.batch import RodBatch
from wrod.rods.catalogue import rod as preset
from wrod.rods.material import RodMaterial
from wrod.solvers.statics import prescribe, solve_equilibria
from wrod.telling import table

# Excess [L_gb] and laid lengths [m] that are looked at.
EXCESS = (-1.0, -0.5, 0.0, 0.5, 1.0, 1.5)
LAID = (0.15, 0.3, 0.45)
_EDGES = 80
# A rod that is lifted off turns upwards over about so much [L_gb].
_BEND = 1.3
_ROUNDS = 30
# A bend that is small [1/m].
_SLIGHT = 1e-3
# What of a line is looked at [m], and the waves tried: growth [1/m] and length [m].
UNTIL = 0.48
RATES, LENGTHS = np.linspace(-15.0, 10.0, 101), np.linspace(0.15, 0.7, 111)
# Waves that leave so much more than the best (root mean square) are allowed.
_ALLOWED = 1.25


@dataclass(frozen=True)
class Mode:
    """What waves by itself: rate [1/m] at which it grows, and its length [m]."""

    rate: float
    wavelength: float


def intuitive(rods: list[RodMaterial], laid: np.ndarray, excess: np.ndarray) -> RodBatch:
    """Rods that hang from a grip straight above where so much is laid, as high as a straight rod is
    long, on the straight line that is laid; the contact is where the rod is straight.

    Args:
        rods: as long as the grip believes; laid, excess: (rod,) [m].

    Raises:
        GraspError: a rod does not hang so.
    """
    lgb = np.array([rod.gravito_bending_length for rod in rods])
    height = np.array([rod.length for rod in rods]) - laid
    longer = [replace(rod, length=rod.length + e) for rod, e in zip(rods, excess, strict=True)]

    def hang(ahead: np.ndarray) -> tuple[RodBatch, np.ndarray]:
        """With the grip so far ahead of the contact; the slope of the first edge."""
        length = height + excess + ahead
        rest = lgb[:, None] * rest_lengths(length / lgb, _EDGES)
        rest = np.concatenate([rest[:, :1], rest, rest[:, -1:]], axis=1)
        s = np.cumsum(rest, axis=1) - rest[:, :1]
        middle = np.clip(s - 0.5 * rest, 0.0, length[:, None])
        angle = 0.5 * np.pi * -np.expm1(-middle / (_BEND * lgb[:, None]))
        angle[:, 0], angle[:, -1] = 0.0, 0.5 * np.pi
        edge = rest[..., None] * np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=2)
        position = np.concatenate([-edge[:, :1], -edge[:, :1] + np.cumsum(edge, axis=1)], axis=1)
        at = (laid - ahead)[:, None] + np.concatenate([-rest[:, :1], s], axis=1)
        batch = RodBatch.of(longer, at, position, clamped=(True, True), director=(0.0, 0.0, 1.0))
        prescribe(batch, clamped_nodes=(0, 1, -2, -1), clamped_angles=(0, -1))
        dof = batch.state.dof.numpy()
        dof[:, [-7, -5, -3, -1]] = np.stack([ahead, height, ahead, height + rest[:, -1]], axis=1)
        if not solve_equilibria(batch, prescribed=dof).converged.all():
            raise GraspError("a rod below the intuitive grip does not come to rest")
        return batch, batch.positions()[:, 2, 2] / rest[:, 0]

    behind, before = -3.0 * lgb, 6.0 * lgb
    for _ in range(_ROUNDS):
        middle = 0.5 * (behind + before)
        batch, slope = hang(middle)
        behind, before = np.where(slope > 0, middle, behind), np.where(slope > 0, before, middle)
    return batch


def mode(matrix: np.ndarray) -> Mode:
    """Of departures' matrix (3, 3)."""
    values = np.linalg.eigvals(matrix)
    wave = values[np.argmax(values.imag)]
    return Mode(float(wave.real), float(2.0 * np.pi / wave.imag) if wave.imag else np.inf)


def gain(matrix: np.ndarray, wavelength: np.ndarray) -> np.ndarray:
    """How much farther aside than the grip the rod is laid, where that goes in waves so long [m].

    Departures are from the line; where the grip lies aside, what counts is the rod's place from it.
    """
    turn = 2j * np.pi / np.asarray(wavelength)
    return np.array([abs(np.linalg.solve(k * np.eye(3) - matrix, matrix[:, 0])[0]) for k in turn])


def bend(batch: RodBatch, matrix: np.ndarray, wavelength: float) -> np.ndarray:
    """(rod,) how far aside [m] rods are laid that are bent at rest in waves so long [m], for each
    1/m of it; `batch` as `intuitive` hangs it, `matrix` its departures."""
    k = 2.0 * np.pi / wavelength
    rest = batch.rest_length.numpy()
    s = np.concatenate([-rest[:, :1], np.cumsum(rest, axis=1) - rest[:, :1]], axis=1)
    begin, before = batch.state.dof.numpy().copy(), batch.natural_curvature.numpy().copy()
    forced = np.zeros((batch.rod_count, 3), complex)
    for part, wave in ((1.0, np.cos), (1j, np.sin)):
        bent = before.copy()
        # The first director points up; of the cells at the clamps half bends.
        slight = _SLIGHT * wave(k * s)
        slight[:, [1, -2]] *= 0.5
        bent[..., 1] -= slight
        batch.natural_curvature.assign(bent)
        if not solve_equilibria(batch).converged.all():
            raise GraspError("a bent rod below the intuitive grip does not come to rest")
        change = (batch.state.dof.numpy() - begin)[:, [9, 7]] / _SLIGHT
        change[:, 0] /= rest[:, 1]
        forced[:, 1:] += part * change / (0.5 * rest[:, 1:2])
        batch.state.dof.assign(begin)
    batch.natural_curvature.assign(before)
    laid = np.linalg.solve(1j * k * np.eye(3) - matrix, forced[..., None])
    return np.abs(laid[:, 0, 0])


@dataclass(frozen=True)
class SeenWave:
    """The wave on a straight slope that a photographed line is nearest to.

    Attributes:
        rate, wavelength, amplitude: [1/m, m, m], the last in the middle; left: by it, and
            slope_left: by the slope alone, root mean square [m].
        allowed: (n, 2) rates and lengths of waves that leave little more.
        along, across: (n,) the wave [m].
    """

    rate: float
    wavelength: float
    amplitude: float
    left: float
    slope_left: float
    allowed: np.ndarray
    along: np.ndarray
    across: np.ndarray


def seen_wave(points: np.ndarray) -> SeenWave:
    """Of a line laid towards -y, (n, 2) [m]."""
    along, across = -points[:, 1], points[:, 0]
    along, across = along[along < UNTIL], across[along < UNTIL]
    middle = 0.5 * UNTIL
    left = left_by_waves(along, across[:, None])[..., 0]
    i, j = np.unravel_index(left.argmin(), left.shape)
    rate, length, least = float(RATES[i]), float(LENGTHS[j]), float(left[i, j])
    best = np.linalg.lstsq(_wave(along - middle, rate, length), across, rcond=None)[0]
    at = np.linspace(along.min(), UNTIL, 200)
    slope = np.polyval(np.polyfit(along, across, 1), along)
    near = np.nonzero(left <= _ALLOWED * least)
    return SeenWave(
        rate, length, float(np.hypot(*best[2:])), least,
        float(np.sqrt(np.mean((across - slope) ** 2))),
        np.column_stack([RATES[near[0]], LENGTHS[near[1]]]),
        at, _wave(at - middle, rate, length) @ best,
    )  # fmt: skip


def left_by_waves(along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """(rate, length, m) root mean square that every wave of `RATES` and `LENGTHS` on a slope leaves
    of lines (n, m) at (n,) [m]."""
    square, left = np.sum(across**2, axis=0), []
    for rate in RATES:
        fits = np.stack([_wave(along - 0.5 * UNTIL, rate, length) for length in LENGTHS])
        taken = np.linalg.qr(fits)[0].transpose(0, 2, 1) @ across
        left.append(square - np.sum(taken**2, axis=1))
    return np.sqrt(np.maximum(left, 0.0) / len(along))


def _wave(s: np.ndarray, rate: float, length: float) -> np.ndarray:
    """(n, 4) a straight slope, and both phases of a wave that grows."""
    turn, grown = 2.0 * np.pi * s / length, np.exp(rate * s)
    return np.column_stack([np.ones_like(s), s, grown * np.cos(turn), grown * np.sin(turn)])


def modes(photographs: list[LaidPhotograph], out: Path) -> tuple[dict, list[Path]]:
    """The mode of every rod with a photographed line, beside the wave seen there."""
    lines = {p.rod: p.points for p in photographs if p.pattern_name == "line"}
    if not lines:
        return {"rods": {}, "text": ""}, []
    seen = {name: seen_wave(points) for name, points in lines.items()}
    rows = {name: _row(name, wave) for name, wave in seen.items()}
    text = [
        "The lateral mode of INT on a straight line, by how much rod hangs too low [L_gb], in the "
        "middle of the line: length [m] and growth [1/m]; seen; what it takes to lay that",
        "",
    ]
    head = ["rod", *(f"{e:g}" for e in EXCESS), "seen (allowed)", "left, of [mm]"]
    told = []
    for name, row in rows.items():
        wave, (low, high) = seen[name], row["allowed"]
        middle = [
            f"{length:.3f}, {rate:+.1f}"
            for length, rate, s in zip(row["wavelength"], row["rate"], row["laid"], strict=True)
            if s == LAID[1]
        ]
        of_wave = (
            f"{wave.wavelength:.3f} ({low[1]:.3f} to {high[1]:.3f}), {wave.rate:+.1f} "
            f"({low[0]:+.1f} to {high[0]:+.1f})"
        )
        left = f"{1e3 * wave.left:.1f}, {1e3 * wave.slope_left:.1f}"
        takes = f"{1e3 * row['aside']:.1f}", f"{row['bent']:.1f}", f"{row['friction']:.2f}"
        told.append([name, *middle, of_wave, left, *takes])
    text += table([*head, "grip aside [mm]", "bent by [1/m]", "friction"], told)
    path = _draw(lines, seen, rows, out / "mode.png")
    return {"rods": rows, "text": "\n".join(text) + "\n"}, [path]


def _row(name: str, seen: SeenWave) -> dict:
    """A rod's mode by laid length [m] and excess [L_gb], and what the wave that is seen takes
    without excess in the middle of the line: a grip that goes aside [m], a rod that is bent at rest
    [1/m], and friction that keeps it there."""
    rod = preset(name)
    lgb = rod.gravito_bending_length
    laid, excess = (a.ravel() for a in np.meshgrid(LAID, EXCESS, indexing="ij"))
    batch = intuitive([rod] * len(laid), laid, lgb * excess)
    found = departures(batch)
    own = [mode(matrix) for matrix in found]
    usual = int(np.flatnonzero((laid == LAID[1]) & (excess == 0.0))[0])
    return {
        "excess": excess.tolist(), "laid": laid.tolist(), "lgb": lgb,
        "rate": [one.rate for one in own], "wavelength": [one.wavelength for one in own],
        "seen": [seen.rate, seen.wavelength, seen.amplitude],
        "allowed": [seen.allowed.min(axis=0).tolist(), seen.allowed.max(axis=0).tolist()],
        "left": [seen.left, seen.slope_left],
        "aside": seen.amplitude / float(gain(found[usual], np.array([seen.wavelength]))[0]),
        "bent": seen.amplitude / float(bend(batch, found, seen.wavelength)[usual]),
        # Bending stiffness times the fourth derivative, over the weight per length.
        "friction": 2.0 * lgb**3 * seen.amplitude * (2.0 * np.pi / seen.wavelength) ** 4,
    }  # fmt: skip


def _draw(lines: dict, seen: dict[str, SeenWave], rows: dict[str, dict], path: Path) -> Path:
    """The lines with the wave each is nearest to; and that wave beside the rod's own mode."""
    figure = Figure(figsize=(11.0, 1.9 * len(lines) + 0.4))
    grid = figure.add_gridspec(len(lines), 2, width_ratios=(1.25, 1.0))
    plane = figure.add_subplot(grid[:, 1])
    for k, (name, wave) in enumerate(seen.items()):
        row, shade = rows[name], f"C{k}"
        axis = figure.add_subplot(grid[k, 0])
        axis.plot(-lines[name][:, 1], 1e3 * lines[name][:, 0], ".", color="tab:red", ms=2)
        axis.plot(wave.along, 1e3 * wave.across, color=shade, lw=1.2)
        axis.set_ylabel(f"{name} [mm]", fontsize=8)
        axis.tick_params(labelsize=7)
        lgb = row["lgb"]
        length, rate = np.array(row["wavelength"]) / lgb, np.array(row["rate"]) * lgb
        for laid in LAID:
            of = np.array(row["laid"]) == laid
            label = f"{name}, its mode" if laid == LAID[0] else None
            plane.plot(length[of], rate[of], ".-", color=shade, lw=0.8, ms=4, label=label)
        rates, lengths = wave.allowed.T
        plane.plot(lengths / lgb, rates * lgb, ".", color=shade, ms=2, alpha=0.25)
        plane.plot(wave.wavelength / lgb, wave.rate * lgb, "*", color=shade, ms=12, mec="k",
                   label=f"{name}, seen")  # fmt: skip
    axis.set_xlabel("along the line [m]", fontsize=8)
    plane.axhline(0.0, color="0.7", lw=0.8, zorder=0)
    plane.set_xlabel("wave's length [L_gb]", fontsize=8)
    plane.set_ylabel("growth [1/L_gb]", fontsize=8)
    plane.tick_params(labelsize=7)
    plane.legend(fontsize=7)
    figure.tight_layout()
    return write_figure(path, figure, 110)
