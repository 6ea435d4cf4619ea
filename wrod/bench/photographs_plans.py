"""Default plans made with what photographs told of rod and table, laid in the scenarios found."""

import json
import warnings

import numpy as np

from wrod import side_by_side
from wrod.bench.photographs_deployments import Deployments
from wrod.bench.photographs_judge import Verdict, scenario_found
from wrod.deployment.plan import plan
from wrod.deployment.simulate import Trial, simulate_deployments
from wrod.errors import WrodError
from wrod.files import row_schemas
from wrod.files.ledger import Ledger
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.identification.laid.scenario import Scenario
from wrod.rods.catalogue import rod as preset
from wrod.solvers.friction import Friction
from wrod.telling import table

_PLANS = ("rod believed", "rod found", "rod and table found")
_KEYS = ("rod", "pattern", "plan", "scenario")


def plans_in_scenarios_found(
    photographs: list[LaidPhotograph], verdicts: list[Verdict], laid: Deployments
) -> dict:
    """e_mean [cm] of `wrod.plan` with the rod believed, the rod found, and the table found as
    well, each laid in the mean scenario that a rod's photographs found, the grip still holding.

    Returns:
        "scenarios" and "rows", and "text" to print.
    """
    scenarios = {verdict.rod: laid.damped(scenario_found(verdict)) for verdict in verdicts}
    errors = _errors(photographs, scenarios, laid)
    rows = [
        {"rod": p.rod, "pattern": p.pattern_name}
        | {name: errors[p.rod, p.pattern_name, name] for name in _PLANS}
        for p in photographs
    ]
    told = []
    for row in rows:
        said = ["-" if row[n] is None else f"{row[n]:.2f}" for n in _PLANS]
        told.append([row["rod"], row["pattern"], *said])
    for rod, scenario in scenarios.items():
        mean = [_mean(row[n] for row in rows if row["rod"] == rod) for n in _PLANS]
        found = (
            f"mean (friction {scenario.friction:.2f}, L_gb x {scenario.lgb_ratio:.3f}, natural "
            f"curvature {scenario.curvature:.2f} /m at {np.degrees(scenario.roll):+.0f} deg)"
        )
        told.append([rod, found, *(f"{value:.2f}" for value in mean)])
    text = ["Plans laid in the mean scenario found (e_mean [cm], the grip still holding)", ""]
    text += table(["rod", "pattern", *(f"plan: {name}" for name in _PLANS)], told)
    return {
        "scenarios": {rod: scenario.as_dict() for rod, scenario in scenarios.items()},
        "rows": rows,
        "text": "\n".join(text) + "\n",
    }


def _mean(values) -> float:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else float("nan")


def _errors(photographs, scenarios: dict[str, Scenario], laid: Deployments) -> dict:
    """{(rod, pattern, plan): e_mean [cm] or None}; finished ones are kept beside the deployments,
    for a plan that knows the table takes minutes."""
    said = {rod: json.dumps(one.as_dict()) for rod, one in scenarios.items()}
    ledger = Ledger(
        laid.path.with_name("plans.jsonl"), {}, _KEYS, "photographs-plans", row_schemas.LaidPlanRow
    )
    wanted = {
        (p.rod, p.pattern_name, name, said[p.rod]): (p, scenarios[p.rod], name)
        for name in reversed(_PLANS)  # the dearest first
        for p in photographs
    }
    lacking = ledger.lacking(wanted)
    jobs = [(key, *wanted[key]) for key in lacking]
    for _, row in side_by_side.run(_lay, jobs, laid.workers):
        ledger.add([row])
    return {(r["rod"], r["pattern"], r["plan"]): r["error_cm"] for r in ledger.of(wanted)}


def _lay(key: tuple, photograph: LaidPhotograph, scenario: Scenario, name: str) -> dict:
    """A row of the file; no error where there is no plan or the simulation diverged."""
    believed, laid = preset(photograph.rod), scenario.damped(preset(photograph.rod))
    rod = believed if name == _PLANS[0] else scenario.rod(believed)
    friction = scenario.friction if name == _PLANS[2] else None
    error = None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # The rod is held as it was in the photographs: its own side to the left.
            path = plan(photograph.pattern, rod, roll=0.0, friction=friction, left=False)
            law = Friction(scenario.friction)
            trial = Trial(photograph.pattern, laid, path, law, another_rod=True)
            (one,) = simulate_deployments([trial])
        error = None if one.diverged else 100.0 * one.error_mean
    except WrodError:
        pass
    return dict(zip(_KEYS, key, strict=True)) | {"error_cm": error}
