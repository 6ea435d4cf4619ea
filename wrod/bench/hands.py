"""`wrod bench hands`: real cables clamped in a robot's hand, explained and predicted."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from wrod import cost
from wrod.machine import machine_line
from wrod.options import FOLDER, SOURCE_FOLDER, option, own_options, refuse_idle_options
from wrod.telling import json_option, tell

CABLES = ("black-short", "orange-long")
LOADS = ("unweighted", "weighted")
# What is asked of the same two cables at other lengths: length [m] and mass [kg].
OTHERS = {"black-long": ("black-short", 0.6, 0.6), "orange-short": ("orange-long", 0.45, 0.25)}
ANGLES = np.radians(np.arange(-165.0, 166.0, 15.0))
# An 80 % interval of a normal distribution, in standard deviations.
_EIGHTY = 1.2816


@click.command(name="hands")
@own_options
@json_option
def command(
    data: Path = option(
        "Folder with folders `swing` (SET-static.npz) and `hanging` (CABLE-hanging.npz, poses).",
        required=True,
        type=SOURCE_FOLDER,
    ),
    out: Path = option(None, required=True, type=FOLDER),
    folds: int = option("Folds of angles left out.", default=4),
    quick: bool = option("One cable, no folds, no predictions."),
    device: str = option("cpu, cuda:0 or auto.", default="cpu"),
) -> None:
    """Explain where cables hang at each angle of the hand; predict other angles, other lengths.
    Thin cables hung as loops follow: their stiffness, an arm's poses, the twist at which they
    buckle. And the thick cables' swings: by the statics' model, then with internal damping.

    A straight cable of one stiffness first, then with natural curvature, with what the last turn
    left of it (lag), and with a tilted clamp, each fitted to both loads of a cable together; beside
    it one that yields instead of the lag. Angles are left out in folds, every FOLDS-th of each set;
    intervals come from other folds.
    """
    from wrod.bench import hands_loops, hands_swings
    from wrod.files import write_json
    from wrod.identification.held.measurements import load_held
    from wrod.rods.device import resolve_device

    if quick:
        refuse_idle_options("--quick", "folds")
    device = resolve_device(device)
    seconds = cost.HAND if quick else 2 * cost.HAND + cost.FOLD * folds + cost.LOOPS
    cost.settle(cost.Cost(seconds), "all fits", "ask for fewer --folds")
    held = {
        cable: [load_held(data / "swing" / f"{cable}-{load}-static.npz") for load in LOADS]
        for cable in CABLES[: 1 if quick else None]
    }
    hanging = data / "hanging" if not quick and (data / "hanging").is_dir() else None
    hands_swings.read_all(data / "swing")  # what cannot be read is refused before the work
    if hanging is not None:
        hands_loops.read_all(hanging)
    figures: dict = {"machine": machine_line(device), "cables": {}}
    predictions, statics, yields = {}, {}, {}
    written = [out / "hands.json"]
    for cable, sets in held.items():
        figures["cables"][cable], fit, yields[cable] = _explain(
            sets, None if quick else folds, device
        )
        statics[cable] = fit
        if not quick:
            spread = figures["cables"][cable]["left_out"]["sigma_mm"]
            predictions |= _predict(cable, sets, fit, spread, device)
        write_json(written[0], figures)  # what is known so far, should the rest be cut off
    figures["swings"], predictions["swings"] = hands_swings.explain(
        data / "swing", statics, yields, {name: source for name, (source, *_) in OTHERS.items()},
        quick, device,
    )  # fmt: skip
    write_json(written[0], figures)
    if hanging is not None:
        figures["loops"], predictions["loops"] = hands_loops.explain(hanging, device)
    written += hands_swings.draw(data / "swing", out, statics, predictions["swings"])
    if not quick:
        written.append(out / "hands-prediction.json")
        write_json(written[-1], predictions)
    write_json(written[0], figures)
    lines = [_table(figures["cables"]), hands_swings.table(figures["swings"])]
    if "loops" in figures:
        lines.append(hands_loops.table(figures["loops"], predictions["loops"]))
    tell(figures, *lines, *(f"wrote {path}" for path in written))


_PREDICTS, _RIVAL = ("curvature", "lag", "tilt"), ("curvature", "yielding", "tilt")
_STAGES = ((), ("curvature",), ("curvature", "lag"), _PREDICTS)


def _explain(sets, folds, device):
    """Figures of a cable, and the fits with a lag and of one that yields."""
    from wrod.identification.held.fit import fit_held

    fits = {effects: fit_held(sets, effects, device=device) for effects in (*_STAGES, _RIVAL)}
    stages = [{"effects": list(e), **_errors(f.residual, f.snapped, sets)} for e, f in fits.items()]
    figures = {
        "stages": stages[:-1],
        "parameters": _parameters(fits[_PREDICTS]),
        "yields": stages[-1] | {"parameters": _parameters(fits[_RIVAL])},
    }
    if folds is not None:
        figures["left_out"] = _left_out(sets, _PREDICTS, folds, device)
        figures["yields"]["left_out"] = _left_out(sets, _RIVAL, folds, device)
    return figures, fits[_PREDICTS], fits[_RIVAL]


def _parameters(fit) -> dict:
    errors = np.sqrt(np.diag(fit.covariance))
    scaled = fit.covariance / np.outer(errors, errors)
    # The largest correlation with another: near 1 neither is known by itself.
    beside = np.abs(scaled - np.eye(len(errors))).max(axis=1)
    return {
        name: {"value": float(v), "stderr": float(e), "correlates": float(c)}
        for name, v, e, c in zip(fit.names, fit.values, errors, beside, strict=True)
    }


def _left_out(sets, effects, folds, device) -> dict:
    """Every angle predicted by fits that have not seen it, in the same place of both sets."""
    from wrod.identification.held.fit import fit_held

    fold = np.concatenate([np.arange(len(one.angle)) % folds for one in sets])
    residual = np.zeros((len(fold), 2, 2))
    for k in range(folds):
        fit = fit_held(sets, effects, use=fold != k, device=device)
        residual[fold == k] = fit.residual[fold == k]
    snapped = np.linalg.norm(residual, axis=-1).max(axis=-1) > 0.1
    inside = []
    for k in range(folds):
        others = residual[(fold != k) & ~snapped]
        inside.append(np.abs(residual[fold == k]) <= _EIGHTY * _sigma(others))
    sigma = 1e3 * _sigma(residual[~snapped])
    return {
        **_errors(residual, snapped, sets),
        "inside_80_percent": float(np.concatenate(inside).mean()),
        "sigma_mm": sigma.tolist(),
    }


def _sigma(residual: np.ndarray) -> np.ndarray:
    """(2, 2) standard deviation of every marker's coordinates [m]."""
    return np.sqrt((residual**2).mean(axis=0))


def _errors(residual, snapped, sets) -> dict:
    """RMS distances [mm] by set, of the cases that the model has not snapped in."""
    which = np.repeat(np.arange(len(sets)), [len(one.angle) for one in sets])
    square = (residual**2).sum(axis=-1).mean(axis=-1)
    return {
        "rms_mm": {
            one.name: 1e3 * float(np.sqrt(square[(which == k) & ~snapped].mean()))
            for k, one in enumerate(sets)
        },
        "snapped": int(snapped.sum()),
        "cases": len(snapped),
    }


def _predict(cable, sets, fit, sigma_mm, device) -> dict:
    """Markers [m] with standard deviations at all angles of the sets, and of other lengths."""
    from wrod.identification.held.equilibria import markers

    wanted: list[tuple[str, Any, tuple[int, ...]]] = [
        (one.name, one, (which,)) for which, one in enumerate(sets)
    ]
    for name, (source, length, mass) in OTHERS.items():
        if source == cable:
            # Which bend another piece of the cable has is not known: both that were found.
            wanted += [
                (f"{name}-{load}", replace(one, length=length, cable_mass=mass), (0, 1))
                for load, one in zip(LOADS, sets, strict=True)
            ]
    out = {}
    for name, one, bends in wanted:
        cases = [(one, a, fit.model(which, a)) for which in bends for a in ANGLES]
        places, good = markers(cases, device)
        places = places.reshape(len(bends), len(ANGLES), 2, 2)
        # Errors of curvature grow with the square of the length, those of the clamp with it.
        grown = (one.length / sets[0].length) ** 2
        sigma = np.hypot(grown * 1e-3 * np.array(sigma_mm), places.std(axis=0, ddof=0))
        out[name] = {
            "base_angle_deg": np.degrees(ANGLES).round(1).tolist(),
            "mid": places.mean(axis=0)[:, 0].round(5).tolist(),
            "end": places.mean(axis=0)[:, 1].round(5).tolist(),
            "mid_sigma": sigma[:, 0].round(5).tolist(),
            "end_sigma": sigma[:, 1].round(5).tolist(),
            "converged": good.reshape(len(bends), -1).all(axis=0).tolist(),
        }
    return out


def _table(cables: dict) -> str:
    lines = [
        "RMS distance of middle and end [mm] (angles where the model snapped are left out)",
        "",
    ]
    for cable, figures in cables.items():
        rows = [(", ".join(s["effects"]) or "straight", s) for s in figures["stages"]]
        if "left_out" in figures:
            rows.append(("left out", figures["left_out"]))
        first, before = rows[0][1]["rms_mm"], None
        for label, row in rows:
            share = ""
            if before is not None and label != "left out":
                # Of the squares that the straight cable leaves, what this effect takes more.
                share = "; takes " + ", ".join(
                    f"{100.0 * (before[name] ** 2 - value**2) / first[name] ** 2:.0f} %"
                    for name, value in row["rms_mm"].items()
                )
            before = row["rms_mm"]
            lines.append(f"{cable}: {label}: {_distances(row, share)}")
        lines += _said(figures["parameters"])
        own = figures["yields"]
        rows = [("yielding for the lag", own)]
        rows += [("  left out", own["left_out"])] if "left_out" in own else []
        lines += [f"{cable}: {label}: {_distances(row)}" for label, row in rows]
        lines += _said(own["parameters"])
        if "left_out" in figures:
            share = figures["left_out"]["inside_80_percent"]
            lines.append(f"  80 % intervals hold {100.0 * share:.0f} % of what is left out")
    return "\n".join(lines) + "\n"


def _distances(row: dict, share: str = "") -> str:
    said = ", ".join(f"{name} {value:.1f}" for name, value in row["rms_mm"].items())
    return f"{said}{share}; snapped {row['snapped']} of {row['cases']}"


def _said(parameters: dict) -> list[str]:
    return [
        f"  {name}: {e['value']:.3f} ± {e['stderr']:.3f}, correlates by {e['correlates']:.2f}"
        for name, e in parameters.items()
    ]
