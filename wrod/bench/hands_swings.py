"""`wrod bench hands`: swings of the thick cables, by the model that explains how they hang."""

from pathlib import Path

import numpy as np

from wrod.files import write_figure
from wrod.files.pictures import AFTER, FAINT, INK, MEASURED, dress, new_figure
from wrod.identification.held.fit import HeldFit
from wrod.identification.held.measurements import HeldSwing, load_swing
from wrod.identification.held.swings import SwingFit, SwingModel, fit_swings, predict_swings

LOADS = ("unweighted", "weighted")
_STAGES = ((), ("damping",), ("damping", "bend"), ("damping", "friction"))
# The law that predicts what is not seen; the other one is left out beside it.
_PREDICTS, _RIVAL = ("damping",), ("damping", "friction")
# An 80 % interval of a normal distribution, in standard deviations.
_EIGHTY = 1.2816


def read_all(folder: Path) -> dict[str, HeldSwing]:
    """Every swing of a folder, by its file's name."""
    return {path.name: load_swing(path) for path in sorted(folder.glob("*-swing.npz"))}


def explain(
    folder: Path,
    statics: dict[str, HeldFit],
    yields: dict[str, HeldFit],
    others: dict[str, str],
    quick: bool,
    device: str,
) -> tuple[dict, dict]:
    """Figures by cable, and predictions by set: of every swing in the folder, given its first two
    frames, by a fit that has not seen it.

    Args:
        folder: with SET-swing.npz.
        statics: what each cable told where it hangs, its sets in the order of `LOADS`.
        yields: the same of one that yields.
        others: name of another piece of cable and the cable that it is a piece of.
        quick: one stage, nothing left out.
    """
    figures, predictions = {}, {}
    for cable, fit in statics.items():
        paths = [folder / f"{cable}-{load}-swing.npz" for load in LOADS]
        if not all(path.exists() for path in paths):
            continue
        swings = [load_swing(path) for path in paths]
        stages = _STAGES[:2] if quick else _STAGES
        fits = [fit_swings(swings, fit, effects, device=device) for effects in stages]
        alike = fit_swings(swings, yields[cable], _PREDICTS, device=device)
        figures[cable] = {
            "stages": [_row(swings, one) for one in fits],
            "as_it_hangs": _row(swings, alike),
        }
        if quick:
            continue
        found, out = _left_out(swings, fit, yields[cable], device)
        figures[cable] |= found
        predictions |= out
        pieces = [name for name, source in others.items() if source == cable]
        predictions |= _others(folder, pieces, swings, fits[_STAGES.index(_PREDICTS)], device)
    return figures, predictions


def draw(folder: Path, out: Path, statics: dict[str, HeldFit], predictions: dict) -> list[Path]:
    """OUT/swings.png: sideways places of the ends, seen, by the hanging cable's model, and as the
    other swing's damping predicts them."""
    shown = [(cable, k, f"{cable}-{load}") for cable in statics for k, load in enumerate(LOADS)]
    shown = [one for one in shown if one[2] in predictions]
    if not shown:
        return []
    figure = new_figure(9.0, 5.0)
    axes = figure.subplots(2, -(-len(shown) // 2), squeeze=False)
    for axis, (cable, which, name) in zip(axes.T.ravel(), shown, strict=False):
        swing, said = load_swing(folder / f"{name}-swing.npz"), predictions[name]
        rest = SwingModel(statics[cable].model(which, 0.0))
        (alone,) = predict_swings([(swing, rest)])
        time, end = np.array(said["time"]), 100.0 * np.array(said["end"])[:, 0]
        reach = 100.0 * _EIGHTY * np.array(said["end_sigma"])[:, 0]
        axis.plot(time, 100.0 * alone[:, 1, 0], color=FAINT, lw=0.8, label="hanging cable's model")
        axis.fill_between(time, end - reach, end + reach, color=AFTER, alpha=0.15, lw=0)
        axis.plot(time, end, color=AFTER, lw=1.2, label="the other swing's damping, 80 %")
        axis.plot(swing.time, 100.0 * swing.cable.end[:, 0], ".", color=MEASURED, ms=2.5,
                  label="seen")  # fmt: skip
        axis.set_title(name, fontsize=9, color=INK)
        axis.set_ylabel("end, sideways [cm]", fontsize=8)
        dress(axis)
    axes[0, 0].legend(fontsize=7, frameon=False)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]", fontsize=8)
    path = out / "swings.png"
    return [write_figure(path, figure)]


def _left_out(swings, statics, yields, device) -> tuple[dict, dict]:
    """Every swing by what the other one told, with intervals of the other one's residual."""
    figures: dict = {"left_out": {}, "left_out_friction": {}, "left_out_as_it_hangs": {}}
    out, inside = {}, []
    for k, swing in enumerate(swings):
        seen = [j for j in range(len(swings)) if j != k]
        fit = fit_swings(swings, statics, _PREDICTS, use=seen, device=device)
        rival = fit_swings(swings, statics, _RIVAL, use=seen, device=device)
        alike = fit_swings(swings, yields, _PREDICTS, use=seen, device=device)
        figures["left_out"][swing.cable.name] = _rms(fit.residual[k])
        figures["left_out_friction"][swing.cable.name] = _rms(rival.residual[k])
        figures["left_out_as_it_hangs"][swing.cable.name] = _rms(alike.residual[k])
        sigma = _sigma([fit.residual[j] for j in seen])
        inside.append((np.abs(fit.residual[k]) <= _EIGHTY * sigma).ravel())
        out[swing.cable.name] = _said(swing, swing.cable.markers[2:] - fit.residual[k], sigma)
    figures["inside_80_percent"] = float(np.concatenate(inside).mean())
    return figures, out


def _others(folder, pieces, swings, fit: SwingFit, device) -> dict:
    """Swings of other pieces of the cable, where the folder holds their first frames."""
    out = {}
    for name in pieces:
        for which, load in enumerate(LOADS):
            path = folder / f"{name}-{load}-swing.npz"
            if not path.exists():
                continue
            swing = load_swing(path)
            # Which bend another piece of the cable has is not known: both that were found.
            models: list[SwingModel] = [fit.model(which, set_of=k) for k in range(len(swings))]
            places = np.stack(predict_swings([(swing, m) for m in models], device=device))
            grown = (swing.cable.length / swings[0].cable.length) ** 2
            sigma = np.hypot(grown * _sigma(fit.residual), places.std(axis=0))
            out[swing.cable.name] = _said(swing, places.mean(axis=0), sigma) | {
                "rms_mm": _rms(swing.cable.markers[2:] - places.mean(axis=0))
            }
    return out


def _said(swing: HeldSwing, places: np.ndarray, sigma: np.ndarray) -> dict:
    sigma = np.broadcast_to(sigma, places.shape)
    return {
        "time": swing.time[2:].round(4).tolist(),
        "mid": places[:, 0].round(4).tolist(),
        "end": places[:, 1].round(4).tolist(),
        "mid_sigma": sigma[:, 0].round(4).tolist(),
        "end_sigma": sigma[:, 1].round(4).tolist(),
    }


def _sigma(residual) -> np.ndarray:
    """(2, 2) standard deviation of every marker's coordinates [m], every swing counting alike."""
    return np.sqrt(np.mean([(one**2).mean(axis=0) for one in residual], axis=0))


def _rms(residual: np.ndarray) -> float:
    return 1e3 * float(np.sqrt((residual**2).sum(axis=-1).mean()))


def _row(swings, fit: SwingFit) -> dict:
    effects = [name for name in ("damping", "bend", "friction")
               if any(own.split()[0] == name for own in fit.names)]  # fmt: skip
    return {
        "effects": effects,
        "rms_mm": {s.cable.name: _rms(r) for s, r in zip(swings, fit.residual, strict=True)},
        "parameters": {
            name: {"value": float(v), "stderr": float(e)}
            for name, v, e in zip(fit.names, fit.values, fit.errors, strict=True)
        },
    }


def table(figures: dict) -> str:
    """What the terminal shows."""
    lines = ["Swings from the third frame on: RMS distance of middle and end [mm]", ""]

    def said(rms: dict) -> str:
        return ", ".join(f"{name} {value:.1f}" for name, value in rms.items())

    for cable, own in figures.items():
        before = own["stages"][0]["rms_mm"]
        for stage in own["stages"]:
            found = ", ".join(
                f"{name} {e['value']:.2f} ± {e['stderr']:.2f}"
                for name, e in stage["parameters"].items()
            )
            label = ", ".join(stage["effects"]) or "the hanging cable's model"
            takes = ""
            if stage["effects"]:
                # Of the squares that the hanging cable's model leaves.
                shares = (1.0 - (v / before[name]) ** 2 for name, v in stage["rms_mm"].items())
                takes = "; takes " + ", ".join(f"{100.0 * share:.1f} %" for share in shares)
            lines.append(f"{cable}: {label}: {said(stage['rms_mm'])}{takes}; {found}".rstrip("; "))
        alike = own["as_it_hangs"]
        lines.append(f"{cable}: damping, yielding as it hangs: {said(alike['rms_mm'])}")
        if "left_out" in own:
            lines.append(f"{cable}: left out so: {said(own['left_out_as_it_hangs'])}")
            lines.append(f"{cable}: by the other's damping: {said(own['left_out'])}")
            lines.append(f"{cable}: and friction: {said(own['left_out_friction'])}")
            share = 100.0 * own["inside_80_percent"]
            lines.append(f"  80 % intervals hold {share:.0f} % of what is left out")
    return "\n".join(lines) + "\n"
