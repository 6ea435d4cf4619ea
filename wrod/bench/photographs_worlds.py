"""The worlds that `wrod bench photographs` tries, their deployments, and what pictures say."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from wrod.bench.ledger import Ledger
from wrod.bench.table3_paper import friction
from wrod.identification.laid.choice import Choice, average, choose
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.identification.laid.placement import raw, rigid, seen_from
from wrod.identification.laid.world import LaidRod, World, lay, plan_without_lead_in
from wrod.rods.material import rod as preset

KEYS = ("method", "rod", "pattern", "world")
_PLANS = {"int": "intuitive", "opt": "numeric"}
HELD_FRICTIONS = (0.3, 0.4, 0.6)
# Excess below the grip that the free end's places and the waves of the lines ask for [m].
_EXCESS = {"rope": (0.03, 0.01, 0.05)}
_EXCESS_VPS = (0.012, 0.004, 0.022)
# A rope hardly stretches: its radius for stretching is half, its stretch a quarter of a solid's.
_RADIUS_RATIO = {"rope": 0.5}


def worlds_of(rod: str) -> dict[str, World]:
    """The worlds by name: the free end held as in all simulations before, or hung and let go."""
    much = _EXCESS.get(rod, _EXCESS_VPS)
    thin = _RADIUS_RATIO.get(rod, 1.0)

    def hung(mu=0.3, lgb=1.0, curvature=2.0, roll=0.0, excess=much[0]):
        return World(mu, lgb, curvature, roll, excess, thin)

    return straight_held() | {
        "hung": hung(),
        "hung, friction 0.5": hung(mu=0.5),
        "hung, L_gb x 1.12": hung(lgb=1.12),
        "hung, curved to the right": hung(roll=float(np.pi)),
        "hung, less excess": hung(excess=much[1]),
        "hung, more excess": hung(excess=much[2]),
        "hung, hardly curved": hung(curvature=0.5),
        "hung, friction 0.2": hung(mu=0.2),
    }


def straight_held() -> dict[str, World]:
    """The straight rod on tables of several frictions, the free end held: as table 3 is laid."""
    return {f"held, friction {mu:g}": World(mu, held=True) for mu in HELD_FRICTIONS}


def believed_world(rod: str) -> str:
    """Name of the world of the model with nothing fitted: the fabric's friction in the table's
    words, the free end held."""
    return f"held, friction {friction(rod, 'fabric'):g}"


def worlds_for_optimal(verdict: Verdict, count: int = 3) -> dict[str, tuple[World, float]]:
    """{name: (world, weight)} in which the optimal path is laid: the likeliest worlds of a rod,
    the first 5 cm held as the paper's controller wants them."""
    worlds = worlds_of(verdict.rod)
    order = np.argsort(-verdict.choice.weights)[:count]
    weights = verdict.choice.weights[order] / verdict.choice.weights[order].sum()
    names = [verdict.worlds[k] for k in order]
    return {
        name if worlds[name].held else f"{name}, then held": (
            replace(worlds[name], held=True),
            float(weight),
        )
        for name, weight in zip(names, weights, strict=True)
    }


class Deployments:
    """Simulated deployments, each computed once and kept in a file."""

    def __init__(self, path: Path, settings: dict, *, device, threads, quiet):
        self.path = path
        self._ledger = Ledger(path, settings, KEYS, "photographs")
        self._options = {k: settings[k] for k in ("spacing", "step")}
        self._options |= {"device": device, "threads": threads}
        self._quiet = quiet

    def of(self, photograph: LaidPhotograph, method: str, worlds: dict[str, World]):
        """{world's name: LaidRod} along a photograph's pattern; worlds that begin alike are laid
        together."""
        done = self._ledger.done()
        head = (method, photograph.rod, photograph.pattern_name)
        for held in (True, False):
            batch = {name: w for name, w in worlds.items() if w.held is held}
            if any((*head, name) not in done for name in batch):
                self._lay(photograph, method, batch, done)
        rows = self._ledger.of([(*head, name) for name in worlds])
        return {
            row["world"]: LaidRod(
                np.array(row["arc_length"]),
                np.array(row["nodes"]),
                row["reached"],
            )
            for row in rows
        }

    def _lay(self, photograph, method, batch, done):
        from tqdm import tqdm

        believed = preset(photograph.rod)
        head = dict(method=method, rod=photograph.rod, pattern=photograph.pattern_name)
        plan = plan_without_lead_in(photograph.pattern, believed, _PLANS[method])
        name = " ".join(head.values())
        with tqdm(total=1.0, leave=False, desc=name, disable=self._quiet) as bar:
            laid = lay(
                photograph.pattern, believed, plan, list(batch.values()),
                progress=lambda share: bar.update(min(share, bar.total - bar.n)), **self._options,
            )  # fmt: skip
        self._ledger.add(
            [
                head
                | {
                    "world": name,
                    "parameters": asdict(batch[name]),
                    "arc_length": np.round(one.arc_length, 7).tolist(),
                    "nodes": np.round(one.nodes, 7).tolist(),
                    "reached": bool(one.reached),
                }
                for name, one in zip(batch, laid, strict=True)
                if (*head.values(), name) not in done
            ]
        )


@dataclass(frozen=True)
class Row:
    """One picture: mean distance [m] of the model with nothing fitted, raw and after one rigid
    motion, of the worlds weighted by the rod's other pictures, and of the best world of all."""

    rod: str
    pattern: str
    believed_raw: float
    believed: float
    left_out_raw: float
    left_out: float
    best: float
    best_world: str
    uncertainty: float

    def as_dict(self) -> dict:
        return asdict(self)


@dataclass(frozen=True)
class Verdict:
    """What the pictures of one rod say: names of the worlds, distances (world, picture) [m], the
    choice, a row per picture, and what the other pictures predict of each."""

    rod: str
    worlds: tuple[str, ...]
    distances: np.ndarray
    choice: Choice
    rows: tuple[Row, ...]
    predicted: tuple[LaidRod, ...]


def judge(photographs: list[LaidPhotograph], laid: Deployments, camera: float) -> list[Verdict]:
    """Lay every rod in every world and compare with its pictures."""
    verdicts = []
    for rod in sorted({p.rod for p in photographs}):
        own = [p for p in photographs if p.rod == rod]
        worlds = worlds_of(rod)
        names = tuple(worlds)
        rods = [laid.of(p, "int", worlds) for p in own]
        placed = [
            {name: distances(p, one[name], camera) for name in names}
            for p, one in zip(own, rods, strict=True)
        ]
        table = np.array([[one[name][1] for one in placed] for name in names])
        choice = choose(table)
        predicted = tuple(
            average([one[name] for name in names], list(worlds.values()), weights)
            for one, weights in zip(rods, choice.left_out, strict=True)
        )
        rows = tuple(
            Row(
                rod,
                p.pattern_name,
                *placed[k][believed_world(rod)],
                *distances(p, predicted[k], camera),
                float(table[:, k].min()),
                names[int(table[:, k].argmin())],
                float(np.median(p.uncertainty)),
            )
            for k, p in enumerate(own)
        )
        verdicts.append(Verdict(rod, names, table, choice, rows, predicted))
    return verdicts


def distances(photograph: LaidPhotograph, one: LaidRod, camera: float) -> tuple[float, float]:
    """Mean distance [m] raw and after one rigid motion; infinite where the simulation did not get
    there."""
    if not one.reached:
        return np.inf, np.inf
    curve = seen_from(one.arc_length, one.nodes, photograph.middle, camera)
    return raw(photograph, curve).mean, rigid(photograph, curve).mean
