"""What makes straight lines of INT wave: mechanisms one by one, for `wrod bench photographs`."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from wrod.bench.photographs_deployments import Deployments
from wrod.bench.photographs_irregular import LAID, bends, irregular, scatter, scatter_table
from wrod.bench.photographs_judge import Verdict
from wrod.bench.photographs_mode import seen_wave
from wrod.deployment.discretisation import Discretisation
from wrod.deployment.simulate import Trial, simulate_deployments
from wrod.files import write_figure
from wrod.identification.laid.camera import OverheadCamera
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.identification.laid.placement import Alignment, rigid
from wrod.identification.laid.scenario import (
    LaidRod,
    Scenario,
    begun,
    own_mesh,
    plan_without_lead_in,
)
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.catalogue import rod as preset
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
# Mechanisms laid in one batch.
_TOGETHER = 16
# Of those that sway, at most [s].
_FAST_STEP = 0.0125
# What is not laid to its end counts as so far off [m].
_FAR = 0.02
# Where a line's wave is measured [m].
_FROM, _TO = 0.05, 0.42


@dataclass(frozen=True)
class Mechanism:
    """One cause, in one sense of it.

    Attributes:
        cause: that the table is ordered by; sense: which way round.
        scenario: rod and table but for what follows.
        kinetic: sliding over static friction [-]; rolling: whether the rod may roll.
        helix: turns per metre of the natural curvature about the rod.
        wave: amplitude of a natural curvature in the plane that alternates, `_WAVE` long [1/m].
        twist: natural twist of a straight rod [rad/m].
        speed: of laying [m/s].
        shake: sideways amplitude of the grip, `_WAVE` long on the table [m].
        random: root mean square of natural curvature at random [1/m], of the draw of that number.
    """

    cause: str
    sense: str
    scenario: Scenario
    kinetic: float = 1.0
    rolling: bool = False
    helix: float = 0.0
    wave: float = 0.0
    twist: float = 0.0
    speed: float = 0.02
    shake: float = 0.0
    random: float = 0.0
    draw: int = 0

    def rod(self, name: str) -> RodModel:
        rod = self.scenario.damped(preset(name))
        if self.helix or self.twist:
            rod = replace(rod, natural_twist=Profile((2.0 * np.pi * self.helix + self.twist,)))
        if self.wave:
            s = np.linspace(0.0, rod.length, 120)
            bend = self.wave * np.cos(2.0 * np.pi * (s - _PHASE) / _WAVE)
            rod = replace(rod, natural_curvature=(Profile(tuple(bend), tuple(s)), Profile((0.0,))))
        if self.random:
            rod = replace(rod, natural_curvature=bends(self.random, self.draw, rod.length))
        # Slow laying does not swing; what swings is damped as a rope in air is.
        return replace(rod, air_damping=0.3) if self.fast else rod

    @property
    def fast(self) -> bool:
        return self.speed > 0.05

    def path(self, photograph: LaidPhotograph, rod: RodMaterial) -> Trajectory:
        path = plan_without_lead_in(photograph.pattern, rod, "intuitive")
        if not self.shake:
            return path
        along = path.pattern_arc_length
        tangent = photograph.pattern.sample(np.clip(along, 0.0, photograph.pattern.length))[1]
        left = np.cross([0.0, 0.0, 1.0], tangent)
        off = self.shake * np.sin(2.0 * np.pi * along / _WAVE)
        return replace(path, position=path.position + off[:, None] * left)


# How much of a rod hangs too low [m] and stretches, and what bends it by itself [1/m].
_OF_ROD: dict[str, tuple[tuple[float, ...], float, float]] = {
    "rope": ((0.01, 0.03), 0.5, 7.0),
    "pink-vps": ((0.004, 0.012, 0.022), 1.0, 2.0),
    "green-vps": ((0.012, 0.022, 0.032), 1.0, 2.0),
}


def mechanisms(rod: str, size: float) -> list[Mechanism]:
    """All that were looked at, each as many ways round as there are; `size` of bends at random
    [1/m]."""
    excesses, thin, bend = _OF_ROD[rod]
    straight = Scenario(0.4, radius_ratio=thin)
    held = replace(straight, held=True)
    found = [Mechanism(_STRAIGHT, "", held)]
    for sense, roll in (("left", 0.0), ("right", np.pi)):
        bent = replace(straight, curvature=2.0, roll=float(roll))
        little, much = (replace(bent, excess=e) for e in (excesses[0], excesses[-1]))
        sign = float(np.cos(roll))
        found += [
            Mechanism(f"hung, {1e3 * e:.0f} mm too long", sense, replace(bent, excess=e))
            for e in excesses
        ]
        found += [
            Mechanism("stick and slip (0.6, 0.2)", sense, replace(little, friction=0.6), 1.0 / 3.0),
            Mechanism("rolls on the table", sense, little, rolling=True),
            Mechanism("bends set in, in the plane", sense, held, wave=bend * sign),
            Mechanism("twisted in, 1 turn a metre", sense, held, twist=2.0 * np.pi * sign),
            Mechanism(f"the grip shakes by {1e3 * _SHAKE:.0f} mm", sense, held,
                      shake=_SHAKE * sign),
            Mechanism("laid at 0.22 m/s: it sways", sense, replace(much, curvature=1.5),
                      speed=0.22),
        ]  # fmt: skip
    for k in range(_ROLLS):
        roll = 2.0 * np.pi * k / _ROLLS
        for start, scenario in (("held", held), ("hung", replace(straight, excess=excesses[0]))):
            bent = replace(scenario, curvature=bend, roll=roll)
            found += [
                Mechanism(f"bent by {bend:g} /m, {start}", _rolled(k), bent),
                *(
                    Mechanism(f"{hand} helix of {bend:g} /m, {start}", _rolled(k), bent,
                              helix=turns / _WAVE)
                    for hand, turns in (("left-handed", -1.0), ("right-handed", 1.0))
                ),
            ]  # fmt: skip
    found += [
        Mechanism(f"bent at random by {size:.1f} /m", f"draw {k}", held, random=size, draw=k)
        for k in range(LAID)
    ]
    return found


def _rolled(k: int) -> str:
    return f"rolled by {360 * k // _ROLLS}"


def waves(
    photographs: list[LaidPhotograph], verdicts: list[Verdict], laid: Deployments, out: Path
) -> tuple[dict, list[Path]]:
    """Lay every mechanism along the patterns of `RODS`; tables, and pictures of the lines."""
    found: dict[str, Any] = {"rods": {}, "text": ""}
    files, scattered = [], {}
    for rod in RODS:
        own = {p.pattern_name: p for p in photographs if p.rod == rod}
        if all(name in own for name in PATTERNS):
            figures, path, scattered[rod] = _waves_of(rod, own, verdicts[0].camera, laid, out)
            found["rods"][rod] = figures
            found["text"] += figures.pop("text")
            files.append(path)
    if scattered:
        found["text"] += scatter_table(
            {rod: row["irregular"] for rod, row in found["rods"].items()}, scattered
        )
    return found, files


def _waves_of(rod: str, own: dict[str, LaidPhotograph], camera: OverheadCamera, laid, out: Path):
    bent = irregular(rod, own["line"].points, seen_wave(own["line"].points))
    every = [replace(one, scenario=laid.damped(one.scenario)) for one in mechanisms(rod, bent.size)]
    groups, how = _laid_together(every), (laid.mesh, laid.device)
    jobs = [(own[name], group, *how) for name in PATTERNS for group in groups]
    where = {
        (one.cause, one.sense, p.pattern_name): rod
        for (p, group, *_), rods in zip(jobs, laid.map(_lay, jobs), strict=True)
        for one, rod in zip(group, rods, strict=True)
    }
    placed = {key: _placed(own[key[2]], rod, camera) for key, rod in where.items()}
    rows: list[dict[str, Any]] = []
    for cause in dict.fromkeys(one.cause for one in every):
        senses = [one.sense for one in every if one.cause == cause]
        best = min(senses, key=lambda s: _mean(placed[cause, s, "line"]))
        line = placed[cause, best, "line"]
        rows.append(
            {
                "cause": cause,
                "sense": best,
                "senses": len(senses),
                "line_mm": 1e3 * _mean(line),
                "height_mm": 0.0 if line is None else 1e3 * _height(line.curve),
                # How a rod is rolled in the grip may differ from picture to picture.
                **{
                    f"{name}_mm": [1e3 * _mean(placed[cause, s, name]) for s in senses]
                    for name in OTHERS
                },
            }
        )
    seen = 1e3 * _height(own["line"].points)
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
    lines = {row["cause"]: placed[row["cause"], row["sense"], "line"] for row in rows}
    path = _draw(own["line"], lines, out / f"waves-{rod}.png")
    drawn = [one for one in every if one.random]
    far = {
        name: scatter(
            own[name], where[_STRAIGHT, "", name],
            [where[one.cause, one.sense, name] for one in drawn], camera,
        )
        for name in PATTERNS
    }  # fmt: skip
    figures = {"rows": rows, "seen_mm": seen, "irregular": asdict(bent)}
    figures["scatter"] = {name: asdict(one) for name, one in far.items()}
    return {**figures, "text": "\n".join(text) + "\n\n"}, path, far


def _others(row: dict, over: Callable) -> float:
    """Mean over the other patterns of what `over` says of the senses [mm]."""
    return float(np.mean([over(np.minimum(row[f"{name}_mm"], 1e3 * _FAR)) for name in OTHERS]))


def _laid_together(every: list[Mechanism]) -> list[list[Mechanism]]:
    """Groups that begin alike, at one speed, and roll or do not."""
    groups: dict[tuple, list[Mechanism]] = {}
    for one in every:
        groups.setdefault((one.scenario.held, one.speed, one.rolling), []).append(one)
    return [g[k : k + _TOGETHER] for g in groups.values() for k in range(0, len(g), _TOGETHER)]


def _lay(photograph, group: list[Mechanism], mesh: Discretisation, device: str) -> list[LaidRod]:
    fast, trials = min(_FAST_STEP, mesh.step), []
    believed = preset(photograph.rod)
    for one in group:
        path = one.path(photograph, believed)
        mu = one.scenario.friction
        law = Friction(mu, one.kinetic * mu, rolling=one.rolling)
        rod = one.rod(photograph.rod)
        trial = Trial(photograph.pattern, rod, path, law, tail=Tail.none(path), another_rod=True)
        trials.append(trial)
    mesh = own_mesh(mesh, photograph.pattern, believed, path)
    laid = simulate_deployments(
        trials,
        **begun(group[0].scenario.held, believed),
        discretisation=replace(mesh, step=fast) if group[0].fast else mesh,
        speed=group[0].speed,
        device=device,
        threads=1,
    )
    return [LaidRod(one.arc_length, one.centerline, not one.diverged) for one in laid]


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
