"""The report as one self-contained page."""

import base64
import html
from collections.abc import Iterable
from pathlib import Path

from wrod.files import write_text

_COLORS = {
    "adequate": "#3a8f5c",
    "explained": "#0b5fa5",
    "partly-explained": "#d9822b",
    "unexplained": "#d1495b",
}
_UNDECIDED = "#59616b"
# Parameters of one effect that are shown in rows of their own, and of one that has more of them.
_LISTED, _FEW = 6, 3
_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#22262b;max-width:62rem;margin:2.5rem auto;
padding:0 1.2rem}h1{font-size:1.6rem;margin:0}h2{font-size:1.15rem;margin:2.2rem 0 .4rem}
.badge{color:white;border-radius:.35rem;padding:.1rem .6rem;font-size:1rem;vertical-align:middle}
.numbers{display:flex;flex-wrap:wrap;gap:.6rem 2.2rem;margin:1.2rem 0}
.numbers div{color:#59616b;font-size:.85rem}
.numbers b{display:block;white-space:nowrap;font-size:1.5rem;color:#22262b}
table{border-collapse:collapse;font-size:.9rem}
td,th{text-align:left;padding:.25rem .9rem .25rem 0;border-bottom:1px solid #e6e9ee}
td.n{text-align:right;font-variant-numeric:tabular-nums}.picture{overflow-x:auto}
img{width:100%;min-width:40rem;height:auto}
details{max-width:40rem;color:#59616b;font-size:.85rem}
p.note{color:#59616b;font-size:.9rem;margin:.2rem 0 .6rem}
"""


def write_page(path: Path, report) -> Path:
    """Write an `IdentificationReport` as HTML with its pictures inside."""
    content = _page(report)
    return write_text(path, content)


def _page(report) -> str:
    from wrod.identification.clamped import pictures

    sections = [
        ("Measured and predicted", "Test trials, not fitted; seen in the vertical plane through "
         "both clamps.", pictures.shapes(report)),
        ("Residual maps", "Distance between measured and predicted marker, all trials.",
         pictures.residuals(report)),
        ("What the residual looks like as mechanics", "Of the base model: the force, moment, end "
         "error or camera error, the same in every trial, that would put the base model into the "
         "measured shapes. Left: the likeliest print; right: the evidence for each.",
         pictures.force_print(report)),
        ("Every effect alone", "Error on test trials after fitting one effect to the train trials.",
         pictures.ranking(report)),
    ]  # fmt: skip
    numbers = [
        ("before", report.before),
        ("after", report.after),
        ("noise floor", report.noise_floor),
    ]
    found = [(e.title, e.parameters, e.after) for e in report.effects]
    if report.scatter:
        sizes = {name.replace("_", " "): e for name, e in report.scatter.items()}
        found.append(("off anew in each trial, in each direction", sizes, None))
    return page(
        report,
        [numbers_of(numbers), effects_table(found, report.selection.confounded)],
        sections,
        _steps(report),
    )


def page(report, facts: list[str], sections: list[tuple[str, str, bytes]], steps: str) -> str:
    """The page of a report: its verdict, `facts` (HTML), pictures with title and note, `steps`."""
    name, verdict, color = html.escape(report.measurements.name), report.verdict, _UNDECIDED
    reason = html.escape(report.reason[:1].upper() + report.reason[1:])
    if report.out_of_time:
        verdict += " so far"
    else:
        color = _COLORS[verdict]
    body = [
        f'<h1>{name} <span class="badge" style="background:{color}">{verdict}</span></h1>'
        f"<p>{reason}.</p>",
        *facts,
    ]
    for title, note, picture in sections:
        if picture:
            data = base64.b64encode(picture).decode()
            body.append(
                f'<h2>{title}</h2><p class="note">{note}</p>'
                f'<div class="picture"><img alt="{title}" src="data:image/png;base64,{data}"></div>'
            )
    body.append(steps)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width"><title>{name}</title>'
        f"<style>{_STYLE}</style></head><body>{''.join(body)}</body></html>\n"
    )


def numbers_of(items: list[tuple[str, float]]) -> str:
    """Lengths [m] in a row, in millimetres."""
    cells = "".join(f"<div>{label}<b>{1e3 * v:.2f} mm</b></div>" for label, v in items)
    return f'<div class="numbers">{cells}</div>'


def effects_table(found: list[tuple[str, dict, float | None]], confounded) -> str:
    """Title, parameters and error with it [m] of every effect found, and which are confounded."""
    if not found:
        return ""
    rows = []
    for title, parameters, error in found:
        listed = list(parameters.items())
        # A profile's stations would push everything else off the page.
        listed, folded = (listed, []) if len(listed) <= _LISTED else (listed[:_FEW], listed[_FEW:])
        for i, (key, estimate) in enumerate(listed):
            first = f"<b>{html.escape(title)}</b>" if i == 0 else ""
            after = f"{1e3 * error:.2f} mm" if i == 0 and error is not None else ""
            rows.append(
                f"<tr><td>{first}</td><td>{key.replace('_', ' ')}</td>"
                f'<td class="n">{estimate}</td>'
                f'<td class="n">{after}</td></tr>'
            )
        if folded:
            numbers = "; ".join(
                f"{key.replace('_', ' ')}: {e.value:.3g} ± {e.stderr:.2g} {e.unit}"
                for key, e in folded
            )
            rows.append(
                f'<tr><td></td><td colspan="3"><details><summary>{len(folded)} parameters'
                f"</summary>{html.escape(numbers)}</details></td></tr>"
            )
    head = "<tr><th>effect</th><th>parameter</th><th>found</th><th>error with it</th></tr>"
    notes = "".join(
        f'<p class="note">{" and ".join(c["effects"])} are confounded: '
        f"{html.escape(c['evidence'])}.</p>"
        for c in confounded
    )
    return f"<h2>What was found</h2><table>{head}{''.join(rows)}</table>{notes}"


def _steps(report) -> str:
    rows = [
        (" + ".join(r.current) or "base model", " + ".join(r.accepted or ["stop"]), r.reason)
        for r in report.selection.rounds
    ]
    return steps_table(("model", "next", "because"), rows)


def steps_table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """How a model was chosen, a row a round."""
    lines = [f"<tr>{''.join(f'<th>{cell}</th>' for cell in head)}</tr>"]
    for row in rows:
        lines.append(f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>")
    return f"<h2>How it was chosen</h2><table>{''.join(lines)}</table>"
