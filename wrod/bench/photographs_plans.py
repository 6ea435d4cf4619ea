"""What photographs told of rods and tables: default plans laid in the scenarios found, and table 3
with the friction of every substrate found from its intuitive column."""

import json
import warnings

import numpy as np

from wrod import side_by_side
from wrod.bench.photographs_deployments import HELD_FRICTIONS, Deployments, straight_held
from wrod.bench.photographs_judge import Verdict, scenario_found
from wrod.bench.table3_paper import PATTERNS, RODS, SUBSTRATES, measured
from wrod.deployment.plan import plan
from wrod.deployment.result import deployment_error
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


def table3(photographs: list[LaidPhotograph], laid: Deployments) -> dict:
    """Friction per rod and substrate from INT's e_mean, and OPT's e_mean that it predicts.

    Laid are the patterns at the size of the photographs, the first 5 cm held, by straight rods at
    the frictions of `HELD_FRICTIONS`; between these e_mean is interpolated in log friction. The
    friction is the one with the least squared logarithm of predicted over measured e_mean, over
    the seven patterns.
    """
    paper, methods = measured(), ("int", "opt")
    laid.prepare([(p, method, straight_held()) for p in photographs for method in methods])
    errors = {
        (p.rod, p.pattern_name, method): _errors_of(p, method, laid)
        for p in photographs
        for method in methods
    }
    rows, told = [], []
    grid = np.geomspace(HELD_FRICTIONS[0], HELD_FRICTIONS[-1], 25)
    for rod in (r for r in RODS if any(p.rod == r for p in photographs)):
        for substrate in SUBSTRATES:
            names = [n for n in PATTERNS if (rod, n.replace("-", ""), "int") in errors]
            if (rod, substrate) == ("rope", "steel"):
                # Its line and U columns are identical, INT and OPT: one of them was mistyped.
                names = [n for n in names if n not in ("line", "letter-U")]
            both = {}
            for method, key in (("int", "intuitive"), ("opt", "numeric")):
                seen = np.array([paper[rod, substrate, n, key][0] for n in names])
                laws = [errors[rod, n.replace("-", ""), method] for n in names]
                known = np.log(HELD_FRICTIONS)
                said = np.array([np.interp(np.log(grid), known, law) for law in laws])
                both[method] = (seen, 100.0 * said)
            # The line's error is that of the free end and not of friction where it is held.
            heard = np.array([n != "line" for n in names])
            seen, said = both["int"]
            off = np.log(said[heard] / seen[heard, None])
            k = int(np.argmin((off**2).mean(axis=0)))
            row = {"rod": rod, "substrate": substrate, "friction": float(grid[k])}
            row["at_bound"] = k in (0, len(grid) - 1)
            for method, (seen, said) in both.items():
                row[f"{method}_paper_cm"] = float(seen.mean())
                row[f"{method}_cm"] = float(said[:, k].mean())
                row[f"{method}_log_rms"] = float(
                    np.sqrt((np.log(said[heard, k] / seen[heard]) ** 2).mean())
                )
            rows.append(row)
            bound = " (bound)" if row["at_bound"] else ""
            told.append(
                [rod, substrate, f"{row['friction']:.2f}{bound}"]
                + [f"{row[f'{m}_paper_cm']:.2f}, {row[f'{m}_cm']:.2f}" for m in methods]
                + [f"{row[f'{m}_log_rms']:.2f}" for m in methods]
            )
    head = ["rod", "substrate", "friction found", "INT paper, simulated", "OPT paper, predicted"]
    text = [
        "Table 3: friction of every substrate from the intuitive column, and what of the optimal "
        "column it predicts (e_mean [cm], means over seven patterns)",
        "",
        *table([*head, "INT log error (rms)", "OPT log error (rms)"], told),
        "\nRope on steel: the table's line and U columns are identical, for INT (4.53 ± 2.80) and "
        "OPT (0.47 ± 0.20); one of them cannot be right, and both are left out.\n",
    ]
    return {"rows": rows, "text": "\n".join(text)}


def _errors_of(photograph, method: str, laid: Deployments) -> np.ndarray:
    """(friction,) e_mean [m] of a straight rod; what diverged counts as the largest of the rest."""
    rods = laid.of(photograph, method, straight_held())
    values = np.array(
        [
            deployment_error(photograph.pattern, one.arc_length, one.nodes)[0]
            if one.reached
            else np.nan
            for one in rods.values()
        ]
    )
    return np.where(np.isfinite(values), values, np.nanmax(values))
