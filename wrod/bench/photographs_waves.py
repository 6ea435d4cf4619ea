"""What makes straight lines of INT wave: mechanisms one by one, for `wrod bench photographs`."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from wrod.bench.photographs_deployments import Deployments
from wrod.bench.photographs_irregular import (
    LAID,
    Irregular,
    Scatter,
    bends,
    irregular,
    scatter,
    scatter_table,
)
from wrod.bench.photographs_mode import seen_wave
from wrod.deployment.simulate import Trial
from wrod.files import write_figure
from wrod.identification.laid.camera import OverheadCamera
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.identification.laid.placement import Alignment, rigid
from wrod.identification.laid.scenario import SPEED, LaidRod, Scenario
from wrod.patterns.pattern import Pattern
from wrod.planning.trajectory import Trajectory
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel
from wrod.rods.profile import Profile
from wrod.solvers.friction import Friction
from wrod.telling import table

RODS = ("rope", "pink-vps", "green-vps")
OTHERS = ("circle", "sine", "letterU", "letterC", "letterL", "letterA")
PATTERNS = ("line", *OTHERS)
_STRAIGHT = "straight, its start held"
# Length of the rope's and pink's waves as they are seen, and its phase in the rope [m].
_WAVE, _PHASE = 0.28, 0.045
# Ways round that a rod may be rolled in the grip.
_ROLLS = 8
# By how much a grip may shake [m].
_SHAKE = 5e-3
# What is not laid to its end counts as so far off [m].
_FAR = 0.02
# Where a line's wave is measured [m].
_FROM, _TO = 0.05, 0.42


@dataclass(frozen=True, kw_only=True)
class Mechanism(Scenario):
    """One cause, in one sense of it.

    Attributes:
        cause: that the table is ordered by; sense: which way round.
        kinetic: sliding over static friction [-]; rolling: whether the rod may roll.
        helix: turns per metre of the natural curvature about the rod.
        wave: amplitude of a natural curvature in the plane that alternates, `_WAVE` long [1/m].
        twist: natural twist of a straight rod [rad/m].
        shake: sideways amplitude of the grip, `_WAVE` long on the table [m].
        random: root mean square of natural curvature at random [1/m], of the draw of that number.
    """

    cause: str
    sense: str = ""
    kinetic: float = 1.0
    rolling: bool = False
    helix: float = 0.0
    wave: float = 0.0
    twist: float = 0.0
    shake: float = 0.0
    random: float = 0.0
    draw: int = 0

    @property
    def name(self) -> str:
        return f"{self.cause}{self.sense and ', ' + self.sense}"

    @property
    def alike(self) -> tuple:
        return *super().alike, self.rolling

    def damped(self, believed: RodMaterial) -> RodModel:
        rod = super().damped(believed)
        if self.helix or self.twist:
            rod = replace(rod, natural_twist=Profile((2.0 * np.pi * self.helix + self.twist,)))
        if self.wave:
            s = np.linspace(0.0, rod.length, 120)
            bend = self.wave * np.cos(2.0 * np.pi * (s - _PHASE) / _WAVE)
            rod = replace(rod, natural_curvature=(Profile(tuple(bend), tuple(s)), Profile((0.0,))))
        if self.random:
            rod = replace(rod, natural_curvature=bends(self.random, self.draw, rod.length))
        # Slow laying does not swing; what swings is damped as a rope in air is.
        return replace(rod, air_damping=0.3) if self.speed > SPEED else rod

    def trial(self, pattern: Pattern, believed: RodMaterial, trajectory: Trajectory) -> Trial:
        along = trajectory.pattern_arc_length
        tangent = pattern.sample(np.clip(along, 0.0, pattern.length))[1]
        left = np.cross([0.0, 0.0, 1.0], tangent)
        off = self.shake * np.sin(2.0 * np.pi * along / _WAVE)
        path = replace(trajectory, position=trajectory.position + off[:, None] * left)
        law = Friction(self.friction, self.kinetic * self.friction, rolling=self.rolling)
        return replace(super().trial(pattern, believed, path), friction=law)


# How much of a rod hangs too low [m] and stretches, and what bends it by itself [1/m].
_OF_ROD: dict[str, tuple[tuple[float, ...], float, float]] = {
    "rope": ((0.01, 0.03), 0.5, 7.0),
    "pink-vps": ((0.004, 0.012, 0.022), 1.0, 2.0),
    "green-vps": ((0.012, 0.022, 0.032), 1.0, 2.0),
}


def mechanisms(rod: str, size: float) -> list[Mechanism]:
    """All that were looked at, each as many ways round as there are; `size` of bends at random
    [1/m]."""

    def of(cause: str, sense: str, scenario: Scenario, **more) -> Mechanism:
        return Mechanism(cause=cause, sense=sense, **scenario.as_dict() | more)

    excesses, thin, bend = _OF_ROD[rod]
    straight = Scenario(0.4, radius_ratio=thin)
    held = replace(straight, held=True)
    found = [of(_STRAIGHT, "", held)]
    for sense, roll in (("left", 0.0), ("right", np.pi)):
        bent = replace(straight, curvature=2.0, roll=float(roll))
        little, much = (replace(bent, excess=e) for e in (excesses[0], excesses[-1]))
        sign = float(np.cos(roll))
        found += [
            of(f"hung, {1e3 * e:.0f} mm too long", sense, replace(bent, excess=e)) for e in excesses
        ]
        found += [
            of("stick and slip (0.6, 0.2)", sense, replace(little, friction=0.6),
               kinetic=1.0 / 3.0),
            of("rolls on the table", sense, little, rolling=True),
            of("bends set in, in the plane", sense, held, wave=bend * sign),
            of("twisted in, 1 turn a metre", sense, held, twist=2.0 * np.pi * sign),
            of(f"the grip shakes by {1e3 * _SHAKE:.0f} mm", sense, held, shake=_SHAKE * sign),
            of("laid at 0.22 m/s: it sways", sense, replace(much, curvature=1.5), speed=0.22),
        ]  # fmt: skip
    for k in range(_ROLLS):
        roll = 2.0 * np.pi * k / _ROLLS
        for start, scenario in (("held", held), ("hung", replace(straight, excess=excesses[0]))):
            bent = replace(scenario, curvature=bend, roll=roll)
            found += [
                of(f"bent by {bend:g} /m, {start}", _rolled(k), bent),
                *(
                    of(f"{hand} helix of {bend:g} /m, {start}", _rolled(k), bent,
                       helix=turns / _WAVE)
                    for hand, turns in (("left-handed", -1.0), ("right-handed", 1.0))
                ),
            ]  # fmt: skip
    found += [
        of(f"bent at random by {size:.1f} /m", f"draw {k}", held, random=size, draw=k)
        for k in range(LAID)
    ]
    return found


def _rolled(k: int) -> str:
    return f"rolled by {360 * k // _ROLLS}"


# A photograph and how its mechanisms are laid.
_Wanted = tuple[LaidPhotograph, str, dict[str, Mechanism]]


def looked_at(photographs: list[LaidPhotograph]) -> dict[str, tuple[Irregular, list[_Wanted]]]:
    """Of those of `RODS` that were photographed along all of `PATTERNS`: bends at random that would
    lay the line, and all mechanisms, to be laid along each pattern."""
    found = {}
    for rod in RODS:
        own = {p.pattern_name: p for p in photographs if p.rod == rod}
        if all(name in own for name in PATTERNS):
            bent = irregular(rod, own["line"].points, seen_wave(own["line"].points))
            every = {one.name: one for one in mechanisms(rod, bent.size)}
            found[rod] = bent, [(own[name], "int", every) for name in PATTERNS]
    return found


def waves(
    looked: dict[str, tuple[Irregular, list[_Wanted]]],
    camera: OverheadCamera,
    laid: Deployments,
    out: Path,
) -> tuple[dict, list[Path]]:
    """Lay all that `looked_at` found; tables, and pictures of the lines."""
    found: dict[str, Any] = {"rods": {}, "text": ""}
    files, scattered = [], {}
    wanted = [one for _, own in looked.values() for one in own]
    laid.prepare(wanted)
    jobs = [(*one, laid.of(*one), camera) for one in wanted]
    seen = iter(laid.map(_placed_and_scattered, jobs))
    for rod, (bent, own) in looked.items():
        of_rod = {name: next(seen) for name in PATTERNS}
        figures, path, scattered[rod] = _waves_of(rod, bent, own[0], of_rod, out)
        found["rods"][rod] = figures
        found["text"] += figures.pop("text")
        files.append(path)
    if scattered:
        found["text"] += scatter_table(
            {rod: row["irregular"] for rod, row in found["rods"].items()}, scattered
        )
    return found, files


def _waves_of(rod: str, bent: Irregular, line: _Wanted, found: dict, out: Path):
    photograph, _, every = line
    rows: list[dict[str, Any]] = []
    lines: dict[str, Alignment | None] = {}
    for cause in dict.fromkeys(one.cause for one in every.values()):
        senses = [one for one in every.values() if one.cause == cause]
        best = min(senses, key=lambda one: _mean(found["line"][0][one.name]))
        laid = lines[cause] = found["line"][0][best.name]
        rows.append(
            {
                "cause": cause,
                "sense": best.sense,
                "senses": len(senses),
                "line_mm": 1e3 * _mean(laid),
                "height_mm": 0.0 if laid is None else 1e3 * _height(laid.curve),
                # How a rod is rolled in the grip may differ from picture to picture.
                **{
                    f"{name}_mm": [1e3 * _mean(found[name][0][one.name]) for one in senses]
                    for name in OTHERS
                },
            }
        )
    seen = 1e3 * _height(photograph.points)
    head = ("mechanism (the line's best sense)", "senses", "line", "its height", "others, best")
    told = [
        [f"{r['cause']}{r['sense'] and ', ' + r['sense']}", f"{r['senses']}",
         f"{r['line_mm']:.1f}", f"{r['height_mm']:.0f}",
         f"{_others(r, min):.1f}", f"{_others(r, np.mean):.1f}"]
        for r in rows
    ]  # fmt: skip
    text = [
        f"The {rod}'s waves ({seen:.1f} mm from crest to trough), one mechanism at a time, each "
        "picture in the best of its senses [mm]",
        "",
        *table((*head, "all"), told),
    ]
    path = _draw(photograph, lines, out / f"waves-{rod}.png")
    far = {name: scattered for name, (_, scattered) in found.items()}
    figures = {"rows": rows, "seen_mm": seen, "irregular": asdict(bent)}
    figures["scatter"] = {name: asdict(one) for name, one in far.items()}
    return {**figures, "text": "\n".join(text) + "\n\n"}, path, far


def _placed_and_scattered(
    photograph: LaidPhotograph,
    method: str,
    every: dict[str, Mechanism],
    rods: dict[str, LaidRod],
    camera: OverheadCamera,
) -> tuple[dict[str, Alignment | None], Scatter]:
    """Every mechanism's rod where it is nearest to what is seen, and how far rods bent at random
    scatter."""
    drawn = [rods[name] for name, one in every.items() if one.random]
    far = scatter(photograph, rods[_STRAIGHT], drawn, camera)
    return {name: _placed(photograph, rod, camera) for name, rod in rods.items()}, far


def _others(row: dict, over: Callable) -> float:
    """Mean over the other patterns of what `over` says of the senses [mm]."""
    return float(np.mean([over(np.minimum(row[f"{name}_mm"], 1e3 * _FAR)) for name in OTHERS]))


def _placed(photograph: LaidPhotograph, rod: LaidRod, camera: OverheadCamera) -> Alignment | None:
    if not rod.reached:
        return None
    return rigid(photograph, camera.view(photograph, rod.arc_length, rod.nodes))


def _mean(placed: Alignment | None) -> float:
    return np.inf if placed is None else placed.mean


def _height(curve: np.ndarray) -> float:
    """Crest to trough across a line laid towards -y, without its slope [m]."""
    along, across = -curve[:, 1], curve[:, 0]
    on = (along > _FROM) & (along < _TO)
    if on.sum() < 3:
        return 0.0
    straight = np.polyval(np.polyfit(along[on], across[on], 1), along[on])
    return float(np.ptp(across[on] - straight))


def _draw(photograph: LaidPhotograph, lines: dict[str, Alignment | None], path: Path) -> Path:
    rows = -(-len(lines) // 3)
    figure = Figure(figsize=(11.0, 1.9 * rows))
    axes = figure.subplots(rows, 3, sharex=True, sharey=True)
    seen = photograph.points
    for axis, (cause, placed) in zip(axes.flat, lines.items(), strict=False):
        axis.plot(-seen[:, 1], 1e3 * seen[:, 0], ".", color="tab:red", ms=1.5)
        if placed is not None:
            axis.plot(-placed.curve[:, 1], 1e3 * placed.curve[:, 0], color="tab:blue", lw=1.2)
        axis.set_title(f"{cause}: {1e3 * _mean(placed):.1f} mm", fontsize=8)
        axis.tick_params(labelsize=7)
    low, high = -seen[:, 1].max() - 0.03, -seen[:, 1].min() + 0.03
    reach = max(20.0, 1e3 * 2.5 * np.abs(seen[:, 0] - seen[:, 0].mean()).max())
    for empty, above in zip(axes.flat[len(lines) :], axes.flat[len(lines) - 3 :], strict=False):
        empty.set_axis_off()
        above.tick_params(labelbottom=True)
    axes.flat[0].set_xlim(low, high)
    axes.flat[0].set_ylim(1e3 * seen[:, 0].mean() - reach, 1e3 * seen[:, 0].mean() + reach)
    figure.supxlabel("along the line [m]", fontsize=8)
    figure.supylabel("across [mm]", fontsize=8)
    figure.tight_layout()
    return write_figure(path, figure, 110)
