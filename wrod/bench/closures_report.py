"""Results of the comparison of closures, told as CSV and Markdown."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wrod import files
from wrod.bench import campaign

KEYS = ("rod", "course", "friction", "method", "trial")
CLOSURES = ("zero_tension", "min_force", "min_friction")
METHODS = ("intuitive", *CLOSURES)
PUT_DOWN = "put down"
# Errors closer than this [cm] are no difference: it is what the steps and meshes leave.
_TIE = 0.02
LABELS = {"intuitive": "INT", PUT_DOWN: "put down exactly"} | {
    name: name.replace("_", " ") for name in CLOSURES
}


@dataclass(frozen=True)
class Cell(campaign.Cell):
    """Also the mean error of each fifth of the pattern [cm], and the friction that the plan asks
    for where the rod touches down, or None."""

    fifths: tuple[float, ...]
    contact_friction: float | None


def cells(rows: list[dict]) -> dict[tuple[str, str, float, str], Cell]:
    """(rod, course, friction, method) -> cell, in the order of the rows."""
    out = {}
    for key, group in campaign.grouped(rows, KEYS[:4]).items():
        (fifths,) = campaign.mean_of(group, "error_fifths")
        out[key] = Cell(
            **vars(campaign.cell_of(group)),
            fifths=tuple(np.broadcast_to(fifths, 5).tolist()),
            contact_friction=group[0].get("contact_friction"),
        )
    return out


def write_csv(path: Path, table: dict) -> Path:
    head = ["rod", "course", "friction", "method", "e_mean [cm]", "sigma [cm]"]
    head += ["released e_mean [cm]", "released sigma [cm]"]
    head += [*(f"error of fifth {k} [cm]" for k in range(1, 6)), "trials", "diverged"]
    lines = []
    for key, cell in table.items():
        values = (*cell.held, *cell.released, *cell.fifths)
        asked = "" if cell.contact_friction is None else f"{cell.contact_friction:.4f}"
        lines.append([*key, *(f"{x:.4f}" for x in values), cell.trials, cell.diverged, asked])
    return files.write_csv(path, [*head, "contact friction"], lines)


def places(table: dict) -> list[tuple[str, str, float]]:
    """(rod, course, friction) of every cell that all closures could plan and none diverged in."""

    def complete(place):
        laid = [table.get((*place, name)) for name in CLOSURES]
        return all(cell is not None and np.isfinite(cell.error) for cell in laid)

    return [place for place in {key[:3]: None for key in table} if complete(place)]


def best(table: dict, place: tuple) -> list[str]:
    """The closures that lay best there: the best one, and those that are no worse by a tie."""
    errors = {name: table[*place, name].error for name in CLOSURES}
    least = min(errors.values())
    return [name for name in CLOSURES if errors[name] <= least + _TIE]


def summary(table: dict) -> list[str]:
    """What the comparison comes to."""
    where = places(table)
    if not where:
        return ["No place was laid by all closures."]
    lines = []
    wins = {name: [p for p in where if best(table, p) == [name]] for name in CLOSURES}
    among = {name: sum(name in best(table, p) for p in where) for name in CLOSURES}
    for name in CLOSURES:
        lines.append(
            f"{LABELS[name]}: alone the best of the closures in {len(wins[name])} of {len(where)} "
            f"places, within {_TIE:g} cm of the best in {among[name]}."
        )
    for low, high in ((0.0, 0.0), (0.01, 0.2), (0.21, 0.45), (0.46, 0.8), (0.81, 10.0)):
        band = [p for p in where if low <= p[2] <= high]
        if not band:
            continue
        used = sorted({p[2] for p in band})
        means = [
            f"{LABELS[name]} {np.mean([table[*p, name].error for p in band]):.3f}"
            for name in CLOSURES
        ]
        lines.append(
            f"Mean error [cm] at friction {', '.join(f'{mu:g}' for mu in used)}: "
            + ", ".join(means)
            + "."
        )
    rivals = [p for p in where if (*p, "intuitive") in table]
    for name in CLOSURES:
        worse = [p for p in rivals if table[*p, name].error > table[*p, "intuitive"].error]
        text = f"{LABELS[name]} lays better than INT in {len(rivals) - len(worse)} of {len(rivals)}"
        if worse:
            text += ", not in " + ", ".join(f"{p[0]} {p[1]} at {p[2]:g}" for p in worse[:12])
            text += ", ..." if len(worse) > 12 else ""
        lines.append(text + ".")
    return [*lines, campaign.diverged(table)]


def markdown(table: dict, head: str, words: list[str]) -> str:
    """One table a rod: courses and methods down, friction across; the best closures in bold."""
    lines = [head, "", *(f"- {line}" for line in words), ""]
    for rod in dict.fromkeys(key[0] for key in table):
        frictions = sorted({key[2] for key in table if key[0] == rod})
        lines += [f"## {rod}", "", "| | | " + " | ".join(f"mu {m:g}" for m in frictions) + " |"]
        lines.append("|" + " --- |" * (2 + len(frictions)))
        for course in dict.fromkeys(key[1] for key in table if key[0] == rod):
            for method in (*METHODS, PUT_DOWN):
                row = [course, LABELS[method]]
                for mu in frictions:
                    place = (rod, course, mu)
                    cell = table.get((*place, method))
                    if cell is None:
                        row.append("")
                        continue
                    complete = all((*place, name) in table for name in CLOSURES)
                    bold = "**" if complete and method in best(table, place) else ""
                    row.append(f"{bold}{cell.error:.2f}{bold}{cell.lost}")
                lines.append("| " + " | ".join(row) + " |")
        lines.append("")
    return "\n".join(lines)
