"""`wrod bench closures`: which of the optimal grasps lays a rod most accurately? Restartable."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import click

from wrod import cost
from wrod.bench import campaign
from wrod.files.ledger import Ledger
from wrod.options import gathered
from wrod.telling import json_option

# Arcs, in L_gb: constant curvature, and easing in and out of it, without which no table would hold
# their ends. They may lie on themselves, as rods do not touch each other.
_ARC_LENGTH, _ARC_EASE = 6.0, 4.0
_PLAN_SPACING = 0.005
_ALL_PATTERNS = "line,circle,sine,letter-U,letter-C,letter-L,letter-A"
_SMALL = {
    "frictions": "0,0.1,0.3,0.6,1",
    "curvatures": "0,1,2,3",
    "stretch_ratios": "1600",
    "rods": "green-vps",
    "names": "line,letter-U,letter-A",
}
_FULL = {
    "frictions": "0,0.05,0.1,0.2,0.3,0.6,1,1.5",
    "curvatures": "0,0.5,1,1.5,2,2.5,3",
    "stretch_ratios": "150,1600,15000",
    "rods": "pink-vps,green-vps,rope",
    "names": _ALL_PATTERNS,
}


@click.command(name="closures")
@click.option("--full", is_flag=True, help="The whole range instead of what two cores manage.")
@click.option("--frictions", help="Friction coefficients, with commas between them.")
@click.option("--curvatures", help="Curvatures of arcs [1/L_gb].")
@click.option("--stretch-ratios", help="k_s of the rods that lay the arcs (L_gb 3.2 cm).")
@click.option("--rods", help="Rods that lay the patterns.")
@click.option("--names", help="Patterns.")
@click.option("--trials", default=1, show_default=True, help="Disturbed trials a cell.")
@gathered("common", campaign.Common, speed=0.04, step=0.02, spacing=0.01)
@json_option
@cost.force_option
def command(trials: int, common: campaign.Common, **given) -> None:
    """Lay arcs and patterns by every closure and by INT, on tables of all kinds.

    Every method meets the same disturbances: jitter, error in L_gb, natural curvature. Finished
    trials are kept in OUT/trials.jsonl: a run that was stopped goes on from there.
    """
    from wrod.bench.closures_report import KEYS, METHODS, PUT_DOWN
    from wrod.deployment.bounds import refuse_coarse_edges
    from wrod.files import row_schemas
    from wrod.rods.device import resolve_device

    device, out = resolve_device(common.device), common.out
    frictions, curves = _asked_for(common.patterns, **given)
    refuse_coarse_edges([curve.rod for curve in curves], common.spacing)
    nodes = _nodes(curves, common.spacing)
    settings = common.settings | {"nodes": nodes, "patterns": common.source}
    ledger = Ledger(out / "trials.jsonl", settings, KEYS, "closures", row_schemas.CampaignRow)
    wanted = len(curves) * len(frictions) * (trials * len(METHODS) + 1)
    longest = max(curve.rod.length for curve in curves)
    campaign.settle(common, max(wanted - len(ledger.rows), 0), longest)
    start = time.perf_counter()
    plans, lacking = _plans(curves, METHODS, device)
    planned = time.perf_counter() - start
    keys = [
        (curve.rod_name, curve.name, mu, method, trial)
        for trial, curve, mu, method in product(range(trials), curves, frictions, METHODS)
        if (curve.rod_name, curve.name, method) in plans
    ]
    lying = [
        (curve.rod_name, curve.name, mu, PUT_DOWN, 0) for curve, mu in product(curves, frictions)
    ]
    by_name = {(curve.rod_name, curve.name): curve for curve in curves}
    how: dict[str, Any] = common.how(nodes) | {"device": device}

    def lay(part, progress):
        return _laid_rows(part, by_name, plans, how | {"progress": progress})

    def leave(part, progress):
        rows = _put_down_rows(part, by_name, nodes, common.step, device)
        progress(1.0)
        return rows

    spent, _ = (
        campaign.run(ledger, wanted, simulate, device=device, batch=common.batch)
        for wanted, simulate in ((keys, lay), (lying, leave))
    )
    head = (
        f"e_mean [cm] (N = 50) with the grip holding, {trials} disturbed trials a cell; contact "
        f"speed {common.speed:g} m/s, step {common.step:g} s, edges {common.spacing:g} m, free end "
        f"held for the first {common.release:g} m, patterns {settings['patterns']}."
    )
    words, written = _reported(out, ledger.of(lying + keys), head, lacking)
    campaign.say(
        spent, device=device, trials=len(keys), planned=planned, nodes=nodes, summary=words,
        written=[*written, out / "trials.jsonl"],
    )  # fmt: skip


def _asked_for(
    patterns: Path | None, full: bool, **given: str | None
) -> tuple[list[float], list[Curve]]:
    """Friction coefficients, and the curves that are laid."""
    from wrod.options import parse_list

    chosen = dict(_FULL if full else _SMALL)
    chosen |= {name: text for name, text in given.items() if text is not None}
    frictions = parse_list(chosen["frictions"], "--frictions", 0.0, 10.0)
    curvatures = parse_list(chosen["curvatures"], "--curvatures", 0.0, 3.5)
    stretch_ratios = parse_list(chosen["stretch_ratios"], "--stretch-ratios", 50.0, 1e5)
    curves = _drawn(chosen["rods"], chosen["names"], patterns)
    return frictions, curves + _arcs(curvatures, stretch_ratios)


def _laid_rows(part, by_name, plans, how) -> list[dict]:
    """A row for each deployment of these keys."""
    from wrod.bench.closures_report import KEYS
    from wrod.deployment.simulate import simulate_deployments

    deployments = simulate_deployments([_trial(key, by_name, plans) for key in part], **how)
    return [
        dict(zip(KEYS, key, strict=True))
        | _figures(laid, by_name[key[:2]].led)
        | {"contact_friction": plans[*key[:2], key[3]][0].metadata["contact_friction"]}
        for key, laid in zip(part, deployments, strict=True)
    ]


def _reported(out: Path, rows, head: str, lacking) -> tuple[list[str], list[Path]]:
    """What the rows say, and the files written of them."""
    from wrod.bench.closures_picture import draw, draw_friction
    from wrod.bench.closures_report import cells, markdown, summary, write_csv
    from wrod.files import write_text

    table = cells(rows)
    words = [*summary(table), *lacking]
    write_text(out / "closures.md", markdown(table, head, words))
    return words, [
        write_csv(out / "closures.csv", table),
        out / "closures.md",
        draw(out / "closures.png", table),
        draw_friction(out / "friction.png", table),
    ]


@dataclass(frozen=True)
class Curve:
    """What is laid by which rod; `led` is the pattern with the remainder of its plan."""

    rod_name: str
    name: str
    led: Any
    rod: Any


def _arcs(curvatures: list[float], ratios: list[float]) -> list[Curve]:
    """Arcs of constant curvature for rods that differ in thickness alone."""
    from wrod.patterns.pattern import Pattern
    from wrod.patterns.shapes import strokes
    from wrod.planning.remainder import prepare
    from wrod.rods.catalogue import rod

    base = rod("green-vps")
    lgb = base.gravito_bending_length
    curves = []
    for ratio, kappa in product(ratios, curvatures):
        material = replace(base, radius=2.0 * lgb / ratio**0.5)
        bend = kappa / lgb
        ease, length = _ARC_EASE * lgb, _ARC_LENGTH * lgb
        pieces = [(ease, 0.0, bend), (length, bend, bend), (ease, bend, 0.0)]
        arc = Pattern(*strokes(0.0, pieces), name=f"arc {kappa:g}")
        curves.append(Curve(f"k_s {ratio:g}", arc.name, prepare(arc, material, None), material))
    return curves


def _drawn(rods: str, names: str, folder: Path | None) -> list[Curve]:
    from wrod.bench.table3_paper import read_pattern
    from wrod.planning.remainder import prepare
    from wrod.rods.catalogue import rod

    curves = []
    for rod_name, name in product(rods.split(","), names.split(",")):
        material = rod(rod_name)
        drawn = read_pattern(name, folder)
        curves.append(Curve(rod_name, name, prepare(drawn, material, None), material))
    return curves


def _nodes(curves: list[Curve], spacing: float) -> int:
    """The same for all, so that no trial depends on which others are simulated."""
    from wrod.deployment.setup import mesh

    return max(len(mesh(c.rod, c.led.length + c.led.remainder_length, spacing)) for c in curves)


def _plans(curves: list[Curve], methods, device: str) -> tuple[dict, list[str]]:
    """(rod, curve, method) -> trajectory and tail; and sentences on what could not be planned."""
    from wrod.deployment.plan import plan
    from wrod.errors import GraspError
    from wrod.planning.tail import tail

    plans, lacking = {}, []
    jobs = list(product(curves, methods))
    for curve, method in cost.progress_bar(jobs, desc="plans"):
        how: dict[str, Any] = {"method": "intuitive"}
        if method != "intuitive":
            how = {"method": "numeric", "closure": method}
        try:
            path = plan(
                curve.led, curve.rod, **how,
                spacing=_PLAN_SPACING, remainder=False, device=device,
            )  # fmt: skip
        except GraspError as error:
            lacking.append(f"{curve.rod_name}, {curve.name}, {method}: no plan ({error}).")
            continue
        plans[curve.rod_name, curve.name, method] = (path, tail(curve.led, curve.rod, path))
    return plans, lacking


def _trial(key: tuple, curves: dict, plans: dict):
    """A rod's trials of a curve meet the same disturbances by every method on every table."""
    import zlib

    from wrod.deployment.setup import Disturbance
    from wrod.deployment.simulate import Trial
    from wrod.solvers.contact import Friction

    rod_name, name, mu, method, trial = key
    curve = curves[rod_name, name]
    path, rest = plans[rod_name, name, method]
    seed = zlib.crc32(f"{rod_name} {name} {trial}".encode())
    # Misplacement moves whatever is laid, and says nothing about how it was laid.
    disturbance = replace(Disturbance.random(seed), offset=(0.0, 0.0), yaw=0.0)
    return Trial(curve.led, curve.rod, path, Friction(mu), disturbance, rest)


def _figures(deployment, pattern) -> dict:
    from wrod.deployment.result import errors_along

    error = errors_along(pattern, deployment.arc_length, deployment.centerline)[1]
    return campaign.figures_of(deployment, pattern) | {"error_fifths": _fifths(error)}


def _fifths(error) -> list[float]:
    """Mean error [cm] of each fifth of the pattern, from its start to its end."""
    return [round(100.0 * float(part.mean()), 5) for part in error.reshape(5, -1)]


def _put_down_rows(part: list[tuple], curves: dict, nodes: int, step: float, device: str):
    from wrod.bench.closures_report import KEYS
    from wrod.bench.put_down import put_down
    from wrod.deployment.result import errors_along
    from wrod.solvers.contact import Friction

    jobs = [(curves[k[:2]].led, curves[k[:2]].rod, Friction(k[2])) for k in part]
    rows = []
    for key, (pattern, *_), (s, place, diverged, steps) in zip(
        part, jobs, put_down(jobs, node_count=nodes, step=step, device=device), strict=True
    ):
        error = errors_along(pattern, s, place)[1]
        mean, std = 100.0 * float(error.mean()), 100.0 * float(error.std())
        rows.append(
            dict(zip(KEYS, key, strict=True))
            | {"error_mean": mean, "error_std": std}
            | {"released_error_mean": mean, "released_error_std": std}
            | {"diverged": diverged, "steps": steps, "error_fifths": _fifths(error)}
        )
    return rows
