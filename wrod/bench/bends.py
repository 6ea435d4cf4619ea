"""`wrod bench bends`: does a pull tell a reef knot from a granny, and what does friction do?"""

import time

import click

from wrod import cost
from wrod.errors import RodError
from wrod.machine import machine_line
from wrod.options import option, own_options, parse_list
from wrod.telling import json_option, table, tell


@click.command(name="bends")
@own_options
@json_option
def command(
    frictions: str = option("Of rod on rod.", "--friction", default="0.1,0.4,0.8"),
    load: float = option("Pull of both hands [N].", default=0.5),
    rods: str = option("Two presets.", default="green-vps,pink-vps-thick"),
    only: tuple[str, ...] = option("Only this bend; may be given again."),
    out: str | None = option("Write a picture to this PNG file.", type=click.Path(dir_okay=False)),
) -> None:
    """Pull ready-made reef and granny knots of two rods, and rods that are not tied, as `wrod bench
    applications` pulls its knots: up to a load that is kept up.
    A minute or two of CPU each."""
    from wrod.bench.bend_shapes import BENDS
    from wrod.rods.catalogue import rod

    friction = parse_list(frictions, "--friction", 0.0, 100.0)
    names = only or tuple(BENDS)
    for name in names:
        if name not in BENDS:
            raise RodError(f"no bend is called {name!r}; there are {', '.join(BENDS)}")
    pair = [rod(name) for name in rods.split(",")]
    if len(pair) != 2:
        raise RodError(f"rods is {rods!r}; give two names with a comma between")
    rows = []
    jobs = [(name, f) for name in names for f in (friction if name != "unknot" else friction[:1])]
    cost.settle(cost.Cost(cost.BEND * len(jobs)), f"{len(jobs)} bends")
    for name, f in cost.progress_bar(jobs):
        clock = time.process_time()
        rows.append({**pull_bend(name, pair, f, load), "cpu_seconds": time.process_time() - clock})
    figures = {"machine": machine_line(), "load": load, "rods": rods, "rows": rows}
    if out:
        draw(out, rows, [one.radius for one in pair])
        figures["picture"] = out
    tell(
        figures,
        f"{rods}, both hands pull with {load:g} N\n",
        *table(
            ("laid as", "friction", "pull reached [N]", "gave [mm]", "held", "at the end"),
            map(_told, rows),
        ),
        *[f"wrote {out}"] * bool(out),
    )


def _told(row: dict) -> tuple[str, ...]:
    gave, held = f"{1e3 * row['crept']:.1f}" if row["tight"] else "", "yes" if row["held"] else "no"
    numbers = f"{row['friction']:g}", f"{row['strongest']:.2f}"
    return row["laid"], *numbers, gave, held, row["pulled"]


def pull_bend(name: str, rods: list, friction: float, load: float, **shape) -> dict:
    """Lay a bend (`bend_shapes.bend`, which takes `shape`), let it come to rest, and pull the
    first ends of both rods."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    from wrod.bench.bend_shapes import bend
    from wrod.knots.pull import CREEP, TwoHands, keep_up
    from wrod.knots.topology import recognise_pair
    from wrod.knots.trials import STILL
    from wrod.knots.workbench import Poses, Workbench
    from wrod.solvers.friction import Friction

    lines, arcs = bend(name, rods, **shape)
    position = np.concatenate(lines)[None]
    bench = Workbench(
        [rods],
        arcs,
        position,
        np.cross(np.diff(position, axis=1), [0.1, 0.2, 1.0]),
        (Friction(0.6), Friction(friction)),
    )
    away = Poses(np.array([[0.0, 0.0, 1.0]]), Rotation.identity(1))
    bench.run(0.6, lambda t: [away, away])
    laid = [one[0] for one in bench.positions()]
    starts = np.array([(one[0] + one[1]) / 2 for one in laid])
    seen: dict[str, list] = {"laid": laid}

    for h, nodes in enumerate(bench.slices):
        bench.held.grasp(0, h, nodes.start, Poses(starts[h][None], Rotation.identity(1)))
    pair = TwoHands(starts, 0.6 * np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 0.03)
    outcome = keep_up(bench, pair, load, 2.0 * CREEP * min(one.radius for one in rods))
    tight = bool(np.isfinite(outcome.tight_at[0]))
    if tight:
        seen["tight"] = [one[0] for one in outcome.tight]
    seen["pulled"] = [one[0] for one in bench.positions()]
    first, last = recognise_pair(*laid).name, recognise_pair(*seen["pulled"])
    return {
        "laid": first,
        "friction": friction,
        "tight": tight,
        "pulled": first if last.share_of(first) >= STILL else last.name,
        "strongest": float(outcome.strongest[0]),
        "crept": float(outcome.crept[0]),
        "held": bool(outcome.held[0]),
        "curves": {stage: [one.round(4).tolist() for one in now] for stage, now in seen.items()},
    }


def draw(path: str, rows: list[dict], radii: list[float]) -> None:
    """Write a PNG: every bend as laid, when the pull was reached, and at the end."""
    import numpy as np
    from matplotlib.figure import Figure

    from wrod.bench.applications_report import RODS, close_up, tightest, woven
    from wrod.files import write_figure

    figure = Figure(figsize=(11.0, 2.1 * len(rows)), facecolor="white")
    grid = figure.subplots(len(rows), 3, squeeze=False)
    figure.subplots_adjust(0.01, 0.01, 0.99, 1.0 - 0.12 / len(rows), 0.04, 0.2)
    for row, line in zip(rows, grid, strict=True):
        for axes, stage in zip(line, ("laid", "tight", "pulled"), strict=True):
            axes.set_axis_off()
            if stage not in row["curves"]:
                continue
            curves = [np.array(one) for one in row["curves"][stage]]
            gap = np.linalg.norm(curves[0][:, None] - curves[1][None], axis=2).min()
            near = stage != "laid" and gap < 0.02
            woven(axes, curves, radii, RODS["reef"], width=2600 if near else 900)
            close_up(axes, tightest(curves) if near else np.zeros(2), 0.06 if near else 0.2)
            said = {
                "laid": f"{row['laid']}, friction {row['friction']:g}",
                "tight": "when the pull was reached",
                "pulled": "held" if row["held"] else f"did not hold: {row['pulled']}",
            }
            axes.set_title(said[stage], fontsize=9, loc="left", color="#22262b")
    write_figure(path, figure, 80)
