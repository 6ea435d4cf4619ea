"""`wrod bench knot-force`: the force to pull an overhand knot tight, against theory."""

import time
from collections.abc import Iterator

import click

from wrod import cost
from wrod.telling import json_option, tell


@click.command(name="knot-force")
@click.option(
    "--friction", "frictions", default="0,0.1,0.3", show_default=True, help="Coefficients, commas."
)
@click.option("--loosest", default=60.0, show_default=True, help="First loop radius, in h.")
@click.option("--tightest", default=10.0, show_default=True, help="Last loop radius, in h.")
@click.option(
    "--out", default=None, type=click.Path(dir_okay=False), help="Write a picture to this PNG file."
)
@json_option
def command(frictions: str, loosest: float, tightest: float, out: str | None) -> None:
    """Pull overhand knots with different friction tight, and compare tension and contact force
    with the law of Audoly et al. 2007 and Jawed et al. 2015 for thin rods."""
    import numpy as np

    from wrod.bench.overhand import knot_force, pull, solve_braid
    from wrod.errors import RodError
    from wrod.machine import machine_line
    from wrod.options import parse_list

    friction = parse_list(frictions, "--friction", 0.0, 100.0)
    if not tightest < loosest:
        raise RodError(f"loop radii {loosest:g} to {tightest:g} h: give a --tightest below")
    work = cost.overhand_knots(len(friction), loosest, tightest)
    cost.settle(work, f"{len(friction)} knots", "ask for a smaller --loosest")
    contact, energy = solve_braid()
    clock, cpu = time.perf_counter(), time.process_time()
    with cost.progress_bar(total=100, unit="%") as bar:
        knots = pull(
            friction,
            loosest=loosest,
            tightest=tightest,
            progress=lambda part, *_: bar.update(int(100 * part) - bar.n),
        )
    wall, cpu = time.perf_counter() - clock, time.process_time() - cpu
    law, next_order = (
        np.stack([knot_force(knots.radius[:, k], f, contact, e) for k, f in enumerate(friction)], 1)
        for e in (0.0, energy)
    )
    rows = [
        {
            "friction": f,
            "radius": knots.radius[:, k].tolist(),
            "tension": knots.force[:, k].tolist(),
            "law": law[:, k].tolist(),
            "law_next_order": next_order[:, k].tolist(),
            "contact_force": knots.contact[:, k].tolist(),
            "penetration": float(knots.penetration[:, k].max()),
            "iterations": int(knots.iterations[k]),
        }
        for k, f in enumerate(friction)
    ]
    figures = {
        "machine": machine_line(),
        "nodes": int(knots.position.shape[2]),
        "seconds": wall,
        "cpu_seconds": cpu,
        "braid_contact": contact,
        "braid_energy": energy,
        "rows": rows,
    }
    if out:
        draw(out, friction, knots, contact, energy)
        figures["picture"] = out
    tell(
        figures,
        f"{len(friction)} overhand knots of {figures['nodes']} nodes, loop radius {loosest:g} to "
        f"{tightest:g} h: {wall:.0f} s (cpu {cpu:.0f} s); contact force of the braid {contact:.3f} "
        "(Clauvelin et al. 2009: 0.492)",
        *(line for row in rows for line in _told(row, contact)),
        *[f"wrote {out}"] * bool(out),
    )


def _told(row: dict, contact: float) -> Iterator[str]:
    yield (
        f"mu = {row['friction']:g}: deepest penetration {row['penetration']:.3f} h, "
        f"{row['iterations']} iterations\n"
        "  R/h      T h^2/B    over law  over next order  contact force over c"
    )
    names = ("radius", "tension", "law", "law_next_order", "contact_force")
    table = zip(*(row[name] for name in names), strict=True)
    for radius, tension, expected, better, normal in table:
        yield (
            f"  {radius:<8.2f} {tension:<10.3g} {tension / expected:<9.2f} "
            f"{tension / better:<16.2f} {normal * radius**1.5 / contact:.2f}"
        )


def draw(path: str, friction: list[float], knots, contact: float, energy: float) -> None:
    """Write a PNG: tension over loop size with the law, and the knots without friction."""
    import numpy as np
    from matplotlib.figure import Figure
    from matplotlib.ticker import ScalarFormatter

    from wrod.bench.overhand import knot_force
    from wrod.files import write_figure

    colors = ("#0b5fa5", "#3a8f5c", "#d9822b", "#d1495b", "#7a5195")
    figure = Figure(figsize=(11.5, 5.0), facecolor="white")
    axes, shapes = figure.subplots(1, 2, width_ratios=(1, 1))
    slender = np.geomspace(knots.radius.min(), knots.radius[1:].max(), 100)
    for k, f in enumerate(friction):
        color = colors[k % len(colors)]
        pulled = knots.force[:, k] > 0
        axes.plot(
            knots.radius[pulled, k],
            knots.force[pulled, k],
            "o",
            color=color,
            ms=4,
            label=f"simulated, \N{GREEK SMALL LETTER MU} = {f:g}",
        )
        axes.plot(slender, knot_force(slender, f, contact), color=color, lw=1.2)
        better = knot_force(slender, f, contact, energy)
        axes.plot(slender, better, color=color, lw=1.0, ls=":")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="loop radius R / h (end shortening over 2\N{GREEK SMALL LETTER PI})",
        ylabel="tension T h\N{SUPERSCRIPT TWO} / B",
        title="lines: law of thin rods; dotted: its next order",
    )
    axes.set_xticks([10, 15, 20, 30, 40, 60], minor=False)
    axes.set_xticks([], minor=True)
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.set_xlim(0.95 * slender.min(), 1.05 * slender.max())
    axes.legend(frameon=False)
    axes.grid(alpha=0.25, which="both")
    for k, frame in enumerate(np.linspace(len(knots.radius) // 3, len(knots.radius) - 1, 4)):
        q = knots.position[int(frame), 0]
        along = (q[-1] - q[0]) / np.linalg.norm(q[-1] - q[0])
        rest = q - q.mean(axis=0)
        across = np.linalg.svd(rest - np.outer(rest @ along, along), full_matrices=False)[2][0]
        y = rest @ across
        y = y * np.sign(y[len(y) // 2] - y[0])
        shapes.plot(rest @ along, y - 2.6 * knots.radius[0, 0] * k, color="#22262b", lw=2)
        shapes.text(
            (rest @ along).min(),
            y[0] - 2.6 * knots.radius[0, 0] * k + 6,
            f"R = {knots.radius[int(frame), 0]:.0f} h",
            fontsize=9,
            color="#59616b",
        )
    shapes.set_aspect("equal")
    shapes.axis("off")
    figure.tight_layout()
    write_figure(path, figure, 90)
