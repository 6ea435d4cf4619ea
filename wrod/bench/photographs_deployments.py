"""Deployments of `wrod bench photographs`: each simulated once, kept in a file, over processes."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from wrod import cost, side_by_side
from wrod.deployment.discretisation import Discretisation
from wrod.files import row_schemas
from wrod.files.ledger import Ledger
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.identification.laid.scenario import SPEED, LaidRod, Scenario, lay, plan_without_lead_in
from wrod.rods.catalogue import rod as preset

KEYS = ("method", "rod", "pattern", "scenario")
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
        self, photograph: LaidPhotograph, method: str, scenarios: dict[str, Scenario]
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

    def prepare(self, wanted: list[tuple[LaidPhotograph, str, dict[str, Scenario]]]) -> None:
        """Lay what is not in the file yet of (photograph, method, scenarios), over the processes;
        scenarios that begin alike are laid together."""
        jobs = []
        for photograph, method, scenarios in wanted:
            head = (method, photograph.rod, photograph.pattern_name)
            lacking = [key[-1] for key in self._ledger.lacking((*head, n) for n in scenarios)]
            for held in (True, False):
                own = [(n, self.damped(scenarios[n])) for n in lacking]
                batch = [(name, one) for name, one in own if one.held is held]
                jobs += [
                    (photograph, method, dict(batch[k : k + _TOGETHER]), self._options)
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

    def damped(self, scenario: Scenario) -> Scenario:
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
            "parameters": asdict(scenario),
            "arc_length": np.round(one.arc_length, 7).tolist(),
            "nodes": np.round(one.nodes, 7).tolist(),
            "reached": bool(one.reached),
        }
        for (name, scenario), one in zip(scenarios.items(), laid, strict=True)
    ]
