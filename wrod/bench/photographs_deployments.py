"""Deployments of `wrod bench photographs`: each simulated once, kept in a file, over processes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy.stats import norm, qmc

from wrod import cost, side_by_side
from wrod.bench.table3_paper import friction
from wrod.deployment.discretisation import Discretisation
from wrod.files import row_schemas
from wrod.files.ledger import Ledger
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.identification.laid.scenario import SPEED, LaidRod, Scenario, lay, plan_without_lead_in
from wrod.rods.catalogue import rod as preset

HELD_FRICTIONS = (0.3, 0.4, 0.6)
# Excess below the grip that the free end's places and the waves of the lines ask for [m].
_EXCESS = {"rope": (0.03, 0.01, 0.05)}
_EXCESS_VPS = (0.012, 0.004, 0.022)
# A rope hardly stretches: its radius for stretching is half, its stretch a quarter of a solid's.
_RADIUS_RATIO = {"rope": 0.5}


# Of the drawn scenarios: range of friction, standard deviation of the logarithm of L_gb's ratio,
# largest natural curvature [1/m], and excess [m] of the rods that stretch and of the rope.
_FRICTION, _LOG_LGB, _CURVATURE = (0.2, 0.7), 0.08, 3.0
_DRAWN_EXCESS = {"rope": (-0.005, 0.05)}
_DRAWN_EXCESS_VPS = (-0.005, 0.03)
_SEED = 0


def scenarios_of(rod: str, drawn: int | None = 0) -> dict[str, Scenario]:
    """The scenarios by name: the free end held as in all simulations before, or hung and let go;
    and as many drawn as asked for, half of them held. With None the believed one only."""
    if drawn is None:
        return {believed_scenario(rod): straight_held()[believed_scenario(rod)]}
    much = _EXCESS.get(rod, _EXCESS_VPS)
    thin = _RADIUS_RATIO.get(rod, 1.0)

    def hung(mu=0.3, lgb=1.0, curvature=2.0, roll=0.0, excess=much[0]):
        return Scenario(mu, lgb, curvature, roll, excess, thin)

    return (
        straight_held()
        | {
            "hung": hung(),
            "hung, friction 0.5": hung(mu=0.5),
            "hung, L_gb x 1.12": hung(lgb=1.12),
            "hung, curved to the right": hung(roll=float(np.pi)),
            "hung, less excess": hung(excess=much[1]),
            "hung, more excess": hung(excess=much[2]),
            "hung, hardly curved": hung(curvature=0.5),
            "hung, friction 0.2": hung(mu=0.2),
        }
        | _drawn(rod, drawn)
    )


def _drawn(rod: str, count: int) -> dict[str, Scenario]:
    """Scenarios spread evenly (a scrambled Sobol sequence, the same for every rod and pattern) over
    what may differ: friction, L_gb, natural curvature and how it is rolled, excess."""
    if count == 0:
        return {}
    unit = qmc.Sobol(5, seed=_SEED).random(count)
    low, high = np.log(_FRICTION)
    shortest, longest = _DRAWN_EXCESS.get(rod, _DRAWN_EXCESS_VPS)
    scenarios = {}
    for k, (mu, lgb, curvature, roll, excess) in enumerate(unit):
        held = k % 2 == 0
        scenarios[f"drawn {k}, {'held' if held else 'hung'}"] = Scenario(
            float(np.exp(low + (high - low) * mu)),
            float(np.exp(_LOG_LGB * norm.ppf(lgb))),
            float(_CURVATURE * curvature),
            float(2.0 * np.pi * (roll - 0.5)),
            # Where the free end is held, what hangs too low is no excess behind the start.
            0.0 if held else float(shortest + (longest - shortest) * excess),
            _RADIUS_RATIO.get(rod, 1.0),
            held,
        )
    return scenarios


def straight_held() -> dict[str, Scenario]:
    """The straight rod on tables of several frictions, the free end held: as table 3 is laid."""
    return {f"held, friction {mu:g}": Scenario(mu, held=True) for mu in HELD_FRICTIONS}


def believed_scenario(rod: str) -> str:
    """Name of the scenario of the model with nothing fitted: the fabric's friction in the table's
    words, the free end held."""
    return f"held, friction {friction(rod, 'fabric'):g}"


KEYS = ("method", "rod", "pattern", "scenario")
# A photograph, "int" or "opt", and scenarios by name.
Wanted = tuple[LaidPhotograph, str, Mapping[str, Scenario]]
_Scenario = TypeVar("_Scenario", bound=Scenario)
_PLANS = {"int": "intuitive", "opt": "numeric"}
# Scenarios laid together by one process.
_TOGETHER = 16


class Deployments:
    """Simulated deployments, each computed once and kept in a file."""

    def __init__(self, path: Path, settings: dict, *, device, threads, workers=1):
        self.path, self.workers, self.device = path, workers, device
        self._ledger = Ledger(path, settings, KEYS, "photographs", row_schemas.LaidRow)
        self.mesh = Discretisation(settings["spacing"], settings["step"], settings["scheme"])
        self.damping = settings["damping"]
        threads = threads if workers == 1 else 1
        self._options = {"discretisation": self.mesh, "device": device, "threads": threads}

    def of(
        self, photograph: LaidPhotograph, method: str, scenarios: Mapping[str, Scenario]
    ) -> dict[str, LaidRod]:
        """{scenario's name: LaidRod} along a photograph's pattern."""
        self.prepare([(photograph, method, scenarios)])
        head = (method, photograph.rod, photograph.pattern_name)
        return {
            row["scenario"]: LaidRod(
                np.array(row["arc_length"]), np.array(row["nodes"]), row["reached"]
            )
            for row in self._ledger.of([(*head, name) for name in scenarios])
        }

    def prepare(self, wanted: Sequence[Wanted]) -> None:
        """Lay what is not in the file yet of (photograph, method, scenarios), over the processes;
        scenarios that begin alike are laid together."""
        jobs = []
        for photograph, method, scenarios in wanted:
            head = (method, photograph.rod, photograph.pattern_name)
            batches: dict[tuple, list] = {}
            for *_, name in self._ledger.lacking((*head, n) for n in scenarios):
                batches.setdefault(scenarios[name].alike, []).append(
                    (name, self.damped(scenarios[name]))
                )
            jobs += [
                (photograph, method, dict(batch[k : k + _TOGETHER]), self._options)
                for batch in batches.values()
                for k in range(0, len(batch), _TOGETHER)
            ]
        if not jobs:
            return
        count = sum(len(scenarios) for _, _, scenarios, _ in jobs)
        work = cost.deployments(
            count, max(preset(photograph.rod).length for photograph, *_ in jobs), speed=SPEED,
            step=self.mesh.step, spacing=self.mesh.spacing, device=self.device,
        )  # fmt: skip
        # At most a thousand scenarios a picture, a few dozen at once: no more than a machine has.
        cost.settle(cost.Cost(work.seconds), f"{count} deployments", force=True)
        ended = side_by_side.run(_lay, jobs, self.workers)
        for _, rows in cost.progress_bar(ended, total=len(jobs), desc="deployments"):
            self._ledger.add(rows)

    def damped(self, scenario: _Scenario) -> _Scenario:
        """As rods are damped here."""
        return replace(scenario, damping=self.damping)

    def map(self, function, jobs: list[tuple]) -> list:
        """`function(*job)` of every job in order, over the processes."""
        asked = [(function, number, job) for number, job in enumerate(jobs)]
        workers = 1 if len(jobs) < 2 else self.workers
        found = dict(result for _, result in side_by_side.run(_numbered, asked, workers))
        return [found[number] for number in range(len(jobs))]


def _numbered(function, number: int, job: tuple) -> tuple:
    return number, function(*job)


def _lay(
    photograph: LaidPhotograph, method: str, scenarios: dict[str, Scenario], options
) -> list[dict]:
    """Rows of the file."""
    believed = preset(photograph.rod)
    plan = plan_without_lead_in(photograph.pattern, believed, _PLANS[method])
    laid = lay(photograph.pattern, believed, plan, list(scenarios.values()), **options)
    return [
        {
            "method": method,
            "rod": photograph.rod,
            "pattern": photograph.pattern_name,
            "scenario": name,
            "parameters": scenario.as_dict(),
            "arc_length": np.round(one.arc_length, 7).tolist(),
            "nodes": np.round(one.nodes, 7).tolist(),
            "reached": bool(one.reached),
        }
        for (name, scenario), one in zip(scenarios.items(), laid, strict=True)
    ]
