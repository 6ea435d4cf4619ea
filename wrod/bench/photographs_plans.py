"""Default plans made with what photographs told of rod and table, laid in the scenarios found."""

import warnings

import numpy as np

from wrod.bench.photographs_deployments import Deployments
from wrod.bench.photographs_judge import Verdict, scenario_found
from wrod.deployment.plan import plan
from wrod.deployment.simulate import Trial, simulate_deployments
from wrod.errors import WrodError
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.identification.laid.scenario import Scenario
from wrod.rods.catalogue import rod as preset
from wrod.solvers.contact import Friction

_PLANS = ("rod believed", "rod found", "rod and table found")


def plans_in_scenarios_found(
    photographs: list[LaidPhotograph], verdicts: list[Verdict], laid: Deployments
) -> dict:
    """e_mean [cm] of `wrod.plan` with the rod believed, the rod found, and the table found as
    well, each laid in the mean scenario that a rod's photographs found, the grip still holding.

    Returns:
        "scenarios" and "rows", and "text" to print.
    """
    scenarios = {verdict.rod: laid.damped(scenario_found(verdict)) for verdict in verdicts}
    jobs = [(p, scenarios[p.rod]) for p in photographs]
    rows = [
        {"rod": p.rod, "pattern": p.pattern_name, **found}
        for (p, _), found in zip(jobs, laid.map(_lay, jobs), strict=True)
    ]
    text = [
        "Plans laid in the mean scenario found (e_mean [cm], the grip still holding)",
        "",
        "| rod | pattern | " + " | ".join(f"plan: {name}" for name in _PLANS) + " |",
        "| --- | --- |" + " --- |" * len(_PLANS),
    ]
    for row in rows:
        said = ["-" if row[n] is None else f"{row[n]:.2f}" for n in _PLANS]
        text.append(f"| {row['rod']} | {row['pattern']} | " + " | ".join(said) + " |")
    for rod, scenario in scenarios.items():
        mean = [_mean(row[n] for row in rows if row["rod"] == rod) for n in _PLANS]
        text.append(
            f"| {rod} | mean (friction {scenario.friction:.2f}, L_gb x {scenario.lgb_ratio:.3f}, "
            f"natural curvature {scenario.curvature:.2f} /m at "
            f"{np.degrees(scenario.roll):+.0f} deg) | "
            + " | ".join(f"{value:.2f}" for value in mean) + " |"
        )  # fmt: skip
    return {
        "scenarios": {rod: scenario.as_dict() for rod, scenario in scenarios.items()},
        "rows": rows,
        "text": "\n".join(text) + "\n",
    }


def _mean(values) -> float:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else float("nan")


def _lay(photograph: LaidPhotograph, scenario: Scenario) -> dict[str, float | None]:
    """{plan: e_mean [cm]}; None where there is no plan or the simulation diverged."""
    believed = preset(photograph.rod)
    true, laid = scenario.rod(believed), scenario.damped(believed)
    out: dict[str, float | None] = {}
    for name, rod, friction in (
        (_PLANS[0], believed, None),
        (_PLANS[1], true, None),
        (_PLANS[2], true, scenario.friction),
    ):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                # The rod is held as it was in the photographs: its own side to the left.
                path = plan(photograph.pattern, rod, roll=0.0, friction=friction)
                law = Friction(scenario.friction)
                trial = Trial(photograph.pattern, laid, path, law, another_rod=True)
                (one,) = simulate_deployments([trial])
            out[name] = None if one.diverged else 100.0 * one.error_mean
        except WrodError:
            out[name] = None
    return out
