"""The report on a motion as one self-contained page."""

from pathlib import Path

from wrod.files import write_text
from wrod.identification.clamped.page import effects_table, numbers_of, page, steps_table
from wrod.identification.motion import pictures


def write_motion_page(path: Path, report) -> Path:
    """Write a `MotionReport` as HTML with its pictures inside."""
    return write_text(path, _page(report))


def _page(report) -> str:
    m = report.measurements
    sections = [
        ("Measured and predicted", "The middling test recording, not fitted: each prediction knows "
         "its first two frames and, from then on, the grips alone.", pictures.shapes(report)),
        ("Error over time and recording", "Test recordings.", pictures.errors(report)),
        ("What the residual looks like", "Before any effect: a force fixed in space leaves a mean "
         "in the laboratory frame, a bend of the rod's own one in the frame that moves with it "
         "(shares of the mean square).",
         pictures.residual(report)),
        *_evidence(report),
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
    if noise := m.time_noise:
        facts += (
            " By the distance of a grip's two markers, a coordinate errs by "
            f"{1e3 * noise.slow:.2g} mm that hang together ({noise.correlation:.2f} from frame to "
            f"frame) and by {1e3 * noise.white:.2g} mm that do not."
        )
    facts += "".join(f" {c[0].upper()}{c[1:]}." for c in report.cautions)
    numbers = [
        ("before", report.before),
        ("after", report.after),
        ("numerical error", report.numerical_error),
        ("noise floor", report.noise_floor),
    ]
    base = [(name.replace("_", " "), found, None) for name, found in report.base.items()]
    added = [(e.title, e.parameters, e.after) for e in report.effects if e.name not in report.base]
    return page(
        report,
        [
            numbers_of(numbers),
            f'<p class="note">{facts}</p>',
            effects_table([*base, *added], report.selection.confounded),
        ],
        sections,
        _steps(report),
    )


def _steps(report) -> str:
    rows = []
    for r in report.selection.rounds:
        tried = ", ".join(
            f"{c.name} {1e3 * c.validation:.2f} mm"
            for c in r.candidates
            if c.validation == c.validation
        )
        left = f"without {r.removed}" if r.removed else "stop"
        rows.append((r.current[-1], r.accepted or left, tried, r.reason))
    return steps_table(("after", "next", "fitted, validation error", "because"), rows)


def _evidence(report) -> list[tuple[str, str, bytes]]:
    if report.trace is None:
        return []
    m = report.measurements
    shown = m.names[int(report.trace.shown.recording[0])]
    return [
        ("What the base model lacks, as mechanics", "Before any effect: the force per length, over "
         "the rod's weight, that would make the base model follow the markers, frame by frame, "
         "without integrating anything. What stays the same in the material is a bend of the "
         "rod's own, what stays the same in the laboratory a wind or a tilt.",
         pictures.missing_force(report.trace, m.rate, shown)),
        ("What that force is like", "Left: the print that takes away most of it. Right: each "
         "print's share, in recordings that were left out when it was fitted.",
         pictures.prints(report.trace)),
    ]  # fmt: skip
