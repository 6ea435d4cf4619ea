"""The report on a motion as one self-contained page."""

from __future__ import annotations

import base64
import html
from pathlib import Path

from wrod.files import write_atomically
from wrod.identification.page import _COLORS, _STYLE


def write_motion_page(path: Path, report) -> Path:
    """Write a `MotionReport` as HTML with its pictures inside."""
    content = _page(report)
    return write_atomically(path, lambda file: file.write(content))


def _page(report) -> str:
    from wrod.identification import motion_pictures as pictures

    m = report.measurements
    name = html.escape(m.name)
    sections = [
        ("Measured and predicted", "The middling test recording, not fitted: each prediction knows "
         "its first two frames and, from then on, the grips alone.", pictures.shapes(report)),
        ("Error over time and recording", "Test recordings.", pictures.errors(report)),
        ("What the residual looks like", "Before any effect: a force fixed in space leaves a mean "
         "in the laboratory frame, a bend of the rod's own one in the frame that moves with it.",
         pictures.residual(report)),
        ("What each effect takes away", "Effects in the order found; the validation recordings "
         "chose them, the test recordings were only scored.", pictures.ladder(report)),
        ("Which effects trade against each other", "Largest correlation between combinations of "
         "two effects' estimates; right of the line, effects that were left out.",
         pictures.correlation(report)),
    ]  # fmt: skip
    facts = (
        f"{m.recording_count} recordings of {m.frame_count} frames at {m.rate:g} Hz, "
        f"{m.marker_count} markers; {len(m.fit)} to fit, {len(m.validation)} to choose, "
        f"{len(m.test)} to score. {m.lost_frames} frames were lost in {int((m.gap > 1).sum())} "
        f"gaps; a grip's two markers were exchanged in {int(m.repaired.sum())} frames."
    )
    body = [
        f'<h1>{name} <span class="badge" style="background:{_COLORS[report.verdict]}">'
        f"{report.verdict}</span></h1><p>{html.escape(report.reason)}.</p>",
        _numbers(report),
        f'<p class="note">{facts}</p>',
        _effects_table(report),
    ]
    for title, note, picture in sections:
        if picture:
            data = base64.b64encode(picture).decode()
            body.append(
                f'<h2>{title}</h2><p class="note">{note}</p>'
                f'<img alt="{title}" src="data:image/png;base64,{data}">'
            )
    body.append(_steps(report))
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{name}</title>'
        f"<style>{_STYLE}</style></head><body>{''.join(body)}</body></html>\n"
    )


def _numbers(report) -> str:
    items = [
        ("before", report.before),
        ("after", report.after),
        ("numerical error", report.numerical_error),
        ("noise floor", report.noise_floor),
    ]
    cells = "".join(f"<div>{label}<b>{1e3 * v:.2f} mm</b></div>" for label, v in items)
    return f'<div class="numbers">{cells}</div>'


def _effects_table(report) -> str:
    rows = []
    base = [(name.replace("_", " "), found, None) for name, found in report.base.items()]
    added = [(e.title, e.parameters, e.after) for e in report.effects]
    for title, parameters, after in [*base, *added]:
        for i, (key, estimate) in enumerate(parameters.items()):
            first = f"<b>{html.escape(title)}</b>" if i == 0 else ""
            error = f"{1e3 * after:.2f} mm" if i == 0 and after is not None else ""
            rows.append(
                f"<tr><td>{first}</td><td>{key.replace('_', ' ')}</td>"
                f'<td class="n">{estimate.value:.4g} ± {estimate.stderr:.2g} {estimate.unit}</td>'
                f'<td class="n">{error}</td></tr>'
            )
    head = "<tr><th>effect</th><th>parameter</th><th>found</th><th>error with it</th></tr>"
    notes = "".join(
        f'<p class="note">{" and ".join(c["effects"])} are confounded: '
        f"{html.escape(c['evidence'])}.</p>"
        for c in report.selection.confounded
    )
    return f"<h2>What was found</h2><table>{head}{''.join(rows)}</table>{notes}"


def _steps(report) -> str:
    rows = []
    for r in report.selection.rounds:
        tried = ", ".join(
            f"{c.name} {1e3 * c.validation:.2f} mm"
            for c in r.candidates
            if c.validation == c.validation
        )
        rows.append(
            f"<tr><td>{html.escape(r.current[-1])}</td><td>{r.accepted or 'stop'}</td>"
            f"<td>{html.escape(tried)}</td><td>{html.escape(r.reason)}</td></tr>"
        )
    head = "<tr><th>after</th><th>next</th><th>fitted, validation error</th><th>because</th></tr>"
    return f"<h2>How it was chosen</h2><table>{head}{''.join(rows)}</table>"
