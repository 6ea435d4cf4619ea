"""What `wrod bench photographs` prints and writes: table, predictions, a picture per rod."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from wrod.bench.photographs_deployments import Deployments, scenarios_of
from wrod.bench.photographs_judge import (
    FIRST,
    HELD,
    KINDS,
    Row,
    Verdict,
    scenarios_for_optimal,
)  # fmt: skip
from wrod.deployment.result import deployment_error
from wrod.files import read_fields, write_figure, write_json, write_npz
from wrod.identification.laid.camera import OverheadCamera
from wrod.identification.laid.choice import spread
from wrod.identification.laid.photographs import LaidPhotograph, load_photograph
from wrod.identification.laid.placement import raw, rigid
from wrod.telling import table

TARGET = 2.5e-3
_PRACTICE = ("green-vps", "letterL")
_POINTS = 400


def left_out_table(verdicts: list[Verdict]) -> str:
    """One line a picture [mm], and how many are within the target."""
    lines = [
        "Mean distance of the points seen from the predicted rod [mm]: raw, after a rigid motion",
        "",
    ]
    rows = [row for verdict in verdicts for row in verdict.rows]
    head = ["rod", "pattern", "nothing fitted", "left out by pattern (how)"]
    told = [
        [r.rod, r.pattern, f"{1e3 * r.believed_raw:.1f}, {1e3 * r.believed:.1f}",
         f"{1e3 * r.left_out_raw:.1f}, {1e3 * r.left_out:.1f} ({r.way})",
         *(f"{1e3 * r.means[kind]:.1f}" for kind in KINDS),
         f"{1e3 * r.best:.1f} ({r.best_scenario})"]
        for r in rows
    ]  # fmt: skip
    means = [f"the scenarios' mean, {kind}" for kind in KINDS]
    lines += table([*head, *means, "best scenario"], told)
    ways = {
        "nothing fitted": [r.believed for r in rows],
        "left out by pattern": [r.left_out for r in rows],
        **{name: [r.means[kind] for r in rows] for name, kind in zip(means, KINDS, strict=True)},
        "best of each": [r.best for r in rows],
    }
    lines += [
        "",
        f"within {1e3 * TARGET:g} mm of {len(rows)}, mean and median [mm]: "
        + "; ".join(
            f"{name} {(np.array(off) <= TARGET).sum()}, {1e3 * np.mean(off):.2f}, "
            f"{1e3 * np.median(off):.2f}"
            for name, off in ways.items()
        )
        + f"; the pictures' own uncertainty {1e3 * np.median([r.uncertainty for r in rows]):.1f}",
        f"intervals for {100 * HELD:.0f} % by the rod's other patterns hold of the points seen: "
        + ", ".join(
            f"{v.rod} {100 * np.mean([r.inside for r in v.rows]):.0f} % "
            f"({v.width:.1f} times the scenarios' spread)"
            for v in verdicts
        ),
        _where(rows),
        f"camera: {_said(verdicts[0].camera)}; without the pattern: "
        + "; ".join(
            f"{row.pattern} {_said(camera)}"
            for row, camera in zip(verdicts[0].rows, verdicts[0].cameras, strict=True)
        ),
    ]
    return "\n".join(lines) + "\n"


def _where(rows: list[Row]) -> str:
    """Where the model with nothing fitted misses."""
    mean, share = (np.array([getattr(r.parts, name) for r in rows]) for name in ("mean", "share"))
    names = f"the first {1e2 * FIRST:g} cm", "the rest that lies", "what hangs"
    said = [
        f"{name} {1e3 * np.nanmedian(own):.1f} mm, {100 * np.median(part):.0f} % of the squares, "
        f"within {1e3 * TARGET:g} mm in {(own <= TARGET).sum()} of {np.isfinite(own).sum()}"
        for name, own, part in zip(names, mean.T, share.T, strict=True)
    ]
    return "where nothing fitted misses, medians: " + "; ".join(said)


def _said(camera: OverheadCamera) -> str:
    return f"{camera.right:+.3f}, {camera.up:+.3f} m off the middle, {camera.height:.2f} m high"


def write_predictions(
    out: Path,
    photographs: list[LaidPhotograph],
    verdicts: list[Verdict],
    laid: Deployments,
    data: Path,
) -> tuple[dict, list[Path]]:
    """Predict the optimal path's deployments: `prediction.json` and one NPZ per rod and pattern.

    Arrays: `centerline` (n, 2) [m on the table], `centerline_file` [m of the pattern's file],
    `arc_length` (n,) [m], `sigma` (n,) standard deviation across the rod: the scenarios'
    spread there, times what the intuitive pictures ask for [m], `as_seen` (m, 2) the same with the
    hanging part as the camera shows it [m].
    """
    found, files = {}, []
    for verdict in verdicts:
        own_error = float(np.median([row.uncertainty for row in verdict.rows]))
        wider = verdict.width / norm.ppf(0.5 + 0.5 * HELD)
        # The model with nothing fitted comes first.
        scenarios = scenarios_for_optimal(verdict)
        weights = np.full(len(scenarios), 1.0 / (len(scenarios) - 1))
        weights[0] = 0.0
        if not verdict.fitted:
            weights = np.eye(len(scenarios))[0]
        own = [p for p in photographs if p.rod == verdict.rod]
        laid.prepare([(p, "opt", scenarios) for p in own])
        for photograph in own:
            rods = list(laid.of(photograph, "opt", scenarios).values())
            good = np.array([one.reached for one in rods])
            if not good.any():
                continue
            heard = weights[good] if weights[good].any() else np.ones(good.sum())
            share = heard / heard.sum()
            rods = [one for one in rods if one.reached]
            arrays, figures = _prediction(photograph, rods, share, verdict.camera)
            name = f"{photograph.rod}-{photograph.pattern_name}-opt"
            path = out / f"{name}.npz"
            arrays["sigma"] = wider * np.hypot(arrays["sigma"], own_error)
            files.append(write_npz(path, **arrays))
            found[name] = figures | {
                "scenarios": list(scenarios), "weights": weights.tolist(),
                "expected_distance_mm": 1e3 * float(arrays["sigma"].mean() * np.sqrt(2.0 / np.pi)),
            }  # fmt: skip
    found = {"cases": found, "practice": _practice(out, data)}
    path = out / "prediction.json"
    return found, [*files, write_json(path, found)]


def _prediction(photograph, rods, share, camera: OverheadCamera):
    """Arrays and figures of one case; scenarios are averaged at equal arc length."""
    length = min(one.arc_length[-1] for one in rods)
    s = np.linspace(0.0, length, _POINTS)
    lines = np.stack([one.at(s) for one in rods])
    mean = np.einsum("w,wnc->nc", share, lines)
    # All scenarios that the pictures allow, however little they move the mean.
    alike = np.full(len(lines), 1.0 / len(lines))
    wide = spread(lines[:, :, :2], alike, mean[:, :2])
    errors = [deployment_error(photograph.pattern, one.arc_length, one.nodes) for one in rods]
    on_pattern = photograph.pattern.sample(np.linspace(0.0, photograph.pattern.length, 50))[0]
    nearest = [
        np.linalg.norm(on_pattern[:, None, :2] - line[None, :, :2], axis=2).min(axis=1).mean()
        for line in lines
    ]  # fmt: skip
    e = 100.0 * np.array([error[0] for error in errors])
    arrays = {
        "arc_length": s,
        "centerline": mean[:, :2],
        "centerline_file": mean[:, :2] / photograph.size_factor,
        "height": mean[:, 2],
        "sigma": wide,
        "as_seen": camera.view(photograph, s, mean),
    }
    return arrays, {
        "e_mean_cm": float(share @ e),
        "e_mean_spread_cm": float(np.sqrt(np.mean((e - share @ e) ** 2))),
        "e_nearest_cm": 100.0 * float(share @ nearest),
    }


def practice_of(data: Path) -> Path:
    """Where the one optimal photograph is that is not held back."""
    return data / "-".join([*_PRACTICE, "opt.npz"])


def _practice(out: Path, data: Path) -> str:
    """The one optimal photograph that is not held back, against its prediction."""
    path = practice_of(data)
    prediction = out / "-".join([*_PRACTICE, "opt.npz"])
    if not path.exists() or not prediction.exists():
        return "no practice photograph"
    photograph = load_photograph(path)
    curve = read_fields(prediction, "Prediction")["as_seen"]
    fine = np.linspace(0, len(curve) - 1, 20 * len(curve))
    curve = np.column_stack([np.interp(fine, np.arange(len(curve)), c) for c in curve.T])
    return (
        f"{1e3 * raw(photograph, curve).mean:.1f} mm raw, {1e3 * rigid(photograph, curve).mean:.1f}"
        f" mm after one rigid motion, over {int(photograph.seen.sum())} points seen"
    )


def draw(out: Path, photographs: list[LaidPhotograph], verdicts: list[Verdict]) -> list[Path]:
    """A picture per rod: above the photographs and what the other pictures predict of them, below
    the predicted optimal deployments."""
    written = []
    for verdict in verdicts:
        own = [p for p in photographs if p.rod == verdict.rod]
        figure = Figure(figsize=(3.2 * len(own), 7.0))
        axes = figure.subplots(2, len(own), squeeze=False)
        for (above, below), p, one, camera in zip(
            axes.T, own, verdict.predicted, verdict.cameras, strict=True
        ):
            curve = camera.view(p, one.arc_length, one.nodes)
            place = rigid(p, curve)
            target = p.pattern.sample(np.linspace(0.0, p.pattern.length, 400))[0]
            box = np.concatenate([p.points, target[:, :2]])
            low, high = box.min(axis=0) - 0.02, box.max(axis=0) + 0.02
            for axis in (above, below):
                axis.plot(*target[:, :2].T, color="0.75", lw=1.0)
                axis.set_aspect("equal")
                axis.set_xlim(low[0], high[0])
                axis.set_ylim(low[1], high[1])
                axis.tick_params(labelsize=6)
                # A narrow panel has no room for many numbers.
                for side, share in zip("xy", (high - low) / (high - low).max(), strict=True):
                    axis.locator_params(axis=side, nbins=max(1, int(6 * share)), min_n_ticks=1)
            above.plot(*place.curve.T, color="tab:blue", lw=1.2)
            above.plot(*p.points.T, ".", color="tab:red", ms=1.5)
            above.set_title(f"{p.pattern_name}: {1e3 * place.mean:.1f} mm", fontsize=8)
            prediction = out / f"{p.rod}-{p.pattern_name}-opt.npz"
            if prediction.exists():
                seen = read_fields(prediction, "Prediction")["as_seen"]
                below.plot(*seen.T, color="tab:green", lw=1.2)
            below.set_title("optimal path, predicted", fontsize=8)
        figure.suptitle(
            f"{verdict.rod}: red seen, blue predicted from the rod's other pictures [m]", fontsize=9
        )
        figure.tight_layout()
        written.append(write_figure(out / f"{verdict.rod}.png", figure, 110))
    return written


def draw_lines(
    out: Path, photographs: list[LaidPhotograph], verdicts: list[Verdict], laid: Deployments
) -> list[Path]:
    """The straight lines, stretched across: seen, and in scenarios where the rod was hung over the
    line with little and with more excess."""
    lines = [p for p in photographs if p.pattern_name == "line"]
    if not lines:
        return []
    camera = verdicts[0].camera
    shown = ("held, friction 0.4", "hung, less excess", "hung", "hung, more excess")
    figure = Figure(figsize=(8.0, 2.2 * len(lines)))
    axes = figure.subplots(len(lines), 1, squeeze=False)
    for axis, p in zip(axes[:, 0], lines, strict=True):
        scenarios = scenarios_of(p.rod)
        rods = laid.of(p, "int", {name: scenarios[name] for name in shown})
        for name, shade in zip(shown, ("0.7", "tab:cyan", "tab:blue", "tab:purple"), strict=True):
            curve = camera.view(p, rods[name].arc_length, rods[name].nodes)
            place = rigid(p, curve)
            label = f"{name} ({1e3 * scenarios[name].excess:g} mm): {1e3 * place.mean:.1f} mm"
            axis.plot(-place.curve[:, 1], 1e3 * place.curve[:, 0], color=shade, lw=1.2, label=label)
        axis.plot(-p.points[:, 1], 1e3 * p.points[:, 0], ".", color="tab:red", ms=2)
        low, high = -p.points[:, 1].max() - 0.03, -p.points[:, 1].min() + 0.03
        axis.set_xlim(low, high)
        # What hangs is shown far beside the line.
        across = 1e3 * p.points[:, 0]
        axis.set_ylim(across.min() - 15.0, across.max() + 25.0)
        axis.set_ylabel(f"{p.rod} [mm]", fontsize=8)
        axis.legend(fontsize=6, ncols=2, loc="upper center")
        axis.tick_params(labelsize=7)
    axes[-1, 0].set_xlabel("along the line [m]", fontsize=8)
    figure.tight_layout()
    return [write_figure(out / "lines.png", figure, 110)]
