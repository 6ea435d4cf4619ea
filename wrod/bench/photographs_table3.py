"""Table 3 with the friction of every substrate found from its intuitive column."""

import numpy as np

from wrod.bench.photographs_deployments import HELD_FRICTIONS, Deployments, straight_held
from wrod.bench.table3_paper import PATTERNS, RODS, SUBSTRATES, measured
from wrod.deployment.result import deployment_error
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.telling import table


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
        (p.rod, p.pattern_name, method): _errors(p, method, laid)
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


def _errors(photograph, method: str, laid: Deployments) -> np.ndarray:
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
