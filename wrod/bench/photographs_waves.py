"""What makes the rope's straight line wave: mechanisms one by one, for `wrod bench photographs`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wrod.bench.photographs_deployments import Deployments
from wrod.bench.photographs_judge import Verdict
from wrod.deployment.simulate import Trial, simulate_deployments
from wrod.files import write_atomically
from wrod.identification.laid.camera import Camera
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.identification.laid.placement import Alignment, rigid
from wrod.identification.laid.world import HELD, LaidRod, World, plan_without_lead_in
from wrod.planning.tail import Tail
from wrod.rods.catalogue import rod as preset
from wrod.rods.model import RodModel
from wrod.rods.profile import Profile
from wrod.solvers.contact import Friction

ROD, PATTERNS = "rope", ("line", "letterU")
# Length of the rope's wave as it is seen [m].
_WAVE = 0.28
_STEP, _FAST_STEP, _SPACING = 0.025, 0.0125, 0.01
# Where a line's wave is measured [m].
_FROM, _TO = 0.05, 0.42


@dataclass(frozen=True)
class Mechanism:
    """One cause, in one sense of it.

    Attributes:
        cause: that the table is ordered by; sense: which way round.
        world: rod and table but for what follows.
        kinetic: sliding over static friction [-]; rolling: whether the rod may roll.
        helix: turns per metre of the natural curvature about the rod.
        wave: amplitude of a natural curvature in the plane that alternates, `_WAVE` long [1/m].
        twist: natural twist of a straight rod [rad/m].
        speed: of laying [m/s].
    """

    cause: str
    sense: str
    world: World
    kinetic: float = 1.0
    rolling: bool = False
    helix: float = 0.0
    wave: float = 0.0
    twist: float = 0.0
    speed: float = 0.02

    def rod(self) -> RodModel:
        rod = RodModel.of(self.world.rod(preset(ROD)))
        if self.helix or self.twist:
            rod = replace(rod, natural_twist=Profile((2.0 * np.pi * self.helix + self.twist,)))
        if self.wave:
            s = np.linspace(0.0, rod.length, 120)
            bend = self.wave * np.cos(2.0 * np.pi * (s - 0.045) / _WAVE)
            rod = replace(rod, natural_curvature=(Profile(tuple(bend), tuple(s)), Profile((0.0,))))
        return rod


def mechanisms() -> list[Mechanism]:
    """All that were looked at, each both ways round."""
    straight = World(0.4, radius_ratio=0.5)
    found = [Mechanism("straight, its start held", "", replace(straight, held=True))]
    for sense, roll in (("left", 0.0), ("right", np.pi)):
        bent = replace(straight, curvature=2.0, roll=float(roll))
        little, much = replace(bent, excess=0.01), replace(bent, excess=0.03)
        sign = float(np.cos(roll))
        found += [
            Mechanism("hung, 10 mm too long", sense, little),
            Mechanism("hung, 30 mm too long", sense, much),
            Mechanism("stick and slip (0.6, 0.2)", sense, replace(little, friction=0.6), 1.0 / 3.0),
            Mechanism("rolls on the table", sense, little, rolling=True),
            Mechanism("helix of the strands' set", sense, replace(little, curvature=7.0),
                      helix=1.0 / _WAVE),
            Mechanism("bends set in, in the plane", sense, replace(straight, held=True),
                      wave=7.0 * sign),
            Mechanism("twisted in, 1 turn a metre", sense, replace(straight, held=True),
                      twist=2.0 * np.pi * sign),
            Mechanism("laid at 0.22 m/s: it sways", sense, replace(much, curvature=1.5),
                      speed=0.22),
        ]  # fmt: skip
    return found


def waves(
    photographs: list[LaidPhotograph], verdicts: list[Verdict], laid: Deployments, out: Path
) -> tuple[dict, list[Path]]:
    """Lay every mechanism along the rope's line and U; table, and a picture of the line."""
    own = {p.pattern_name: p for p in photographs if p.rod == ROD}
    if not all(name in own for name in PATTERNS):
        return {"rows": [], "text": ""}, []
    camera = verdicts[0].camera
    jobs = [(own[name], one) for one in mechanisms() for name in PATTERNS]
    rods = laid.map(_lay, jobs)
    placed = {
        (one.cause, one.sense, p.pattern_name): _placed(p, rod, camera)
        for (p, one), rod in zip(jobs, rods, strict=True)
    }
    rows: list[dict[str, Any]] = []
    for cause in dict.fromkeys(one.cause for one in mechanisms()):
        senses = [one.sense for one in mechanisms() if one.cause == cause]
        best = min(senses, key=lambda s: _mean(placed[cause, s, "line"]))
        line, other = placed[cause, best, "line"], placed[cause, best, "letterU"]
        rows.append(
            {
                "cause": cause,
                "sense": best,
                "line_mm": 1e3 * _mean(line),
                "height_mm": 0.0 if line is None else 1e3 * _height(line.curve),
                "letterU_mm": 1e3 * _mean(other),
            }
        )
    seen = 1e3 * _height(own["line"].points)
    text = [
        f"The rope's waves ({seen:.0f} mm from crest to trough), one mechanism at a time [mm]",
        "",
        "| mechanism (better sense) | line | its height | U in the same world |",
        "| --- | --- | --- | --- |",
        *(
            f"| {r['cause']}{r['sense'] and ', ' + r['sense']} | {r['line_mm']:.1f} | "
            f"{r['height_mm']:.0f} | {r['letterU_mm']:.1f} |"
            for r in rows
        ),
    ]
    lines = {row["cause"]: placed[row["cause"], row["sense"], "line"] for row in rows}
    written = [_draw(own["line"], lines, out / "waves.png")]
    return {"rows": rows, "seen_mm": seen, "text": "\n".join(text) + "\n"}, written


def _lay(photograph: LaidPhotograph, one: Mechanism) -> LaidRod:
    believed = preset(ROD)
    path = plan_without_lead_in(photograph.pattern, believed, "intuitive")
    end = Tail.none(path)
    mu = one.world.friction
    law = Friction(mu, one.kinetic * mu, rolling=one.rolling)
    fast = one.speed > 0.05
    (laid,) = simulate_deployments(
        [Trial(photograph.pattern, one.rod(), path, law, tail=end)],
        hold=HELD if one.world.held else 0.0,
        spacing=_SPACING,
        step=_FAST_STEP if fast else _STEP,
        speed=one.speed,
        # Slow laying does not swing; what swings is damped as a rope in air is.
        air_damping=0.3 if fast else None,
        threads=1,
    )
    return LaidRod(laid.arc_length, laid.centerline, not laid.diverged)


def _placed(photograph: LaidPhotograph, rod: LaidRod, camera: Camera) -> Alignment | None:
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
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = -(-len(lines) // 3)
    figure, axes = plt.subplots(rows, 3, figsize=(11.0, 1.9 * rows), sharex=True, sharey=True)
    seen = photograph.points
    for axis, (cause, placed) in zip(axes.flat, lines.items(), strict=False):
        axis.plot(-seen[:, 1], 1e3 * seen[:, 0], ".", color="tab:red", ms=1.5)
        if placed is not None:
            axis.plot(-placed.curve[:, 1], 1e3 * placed.curve[:, 0], color="tab:blue", lw=1.2)
        axis.set_title(f"{cause}: {1e3 * _mean(placed):.1f} mm", fontsize=8)
        axis.tick_params(labelsize=7)
    low, high = -seen[:, 1].max() - 0.03, -seen[:, 1].min() + 0.03
    axes.flat[0].set_xlim(low, high)
    axes.flat[0].set_ylim(-40.0, 40.0)
    figure.supxlabel("along the line [m]", fontsize=8)
    figure.supylabel("across [mm]", fontsize=8)
    figure.tight_layout()
    write_atomically(path, lambda file: figure.savefig(file, dpi=110), "wb")
    plt.close(figure)
    return path
