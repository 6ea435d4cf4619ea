"""Loops of thin cables for `wrod bench hands`: how they hang, are held by an arm, and buckle."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from wrod.identification.held.loops import LoopModel, critical_twist, fit_loops
from wrod.identification.held.measurements import HangingLoops, HeldPoses, load_hanging, load_poses
from wrod.identification.held.poses import pose_shapes, rigid_rms

CABLES = ("black", "red", "white")
_STAGES = ((), ("right", "left"))
RATIOS = (0.3, 0.45, 0.667, 0.85, 1.0, 1.3, 1.7, 2.2)
# What is believed of twisting over bending stiffness before the poses: median, and standard
# deviation of its logarithm (a solid rubber has 2/3, wound strands less, a braid up to 2).
_RATIO, _LOG_RATIO = 0.8, 0.45
# A pose's shape is known to 1 cm, from about five points.
_POSE_SIGMA, _POSE_POINTS = 1e-2, 5
# An 80 % interval in standard deviations: normal, and of Student's distribution where four other
# mountings say how much mountings differ.
_EIGHTY, _EIGHTY_OF_FOUR = 1.2816, 1.5332
# Stretches of a loop whose residuals are pooled.
_STRETCHES = 5
_SOLID = "twist of a solid"


def read_all(folder: Path) -> tuple[HeldPoses, dict[str, HangingLoops]]:
    """The poses, and each cable's loops, of CABLE-hanging.npz and poses-3d.npz."""
    poses = load_poses(folder / "poses-3d.npz")
    return poses, {cable: load_hanging(folder / f"{cable}-hanging.npz") for cable in CABLES}


def explain(folder: Path, device: str) -> tuple[dict, dict]:
    """{cable: figures} and {cable: predictions} of a folder; see `read_all`."""
    poses, hung = read_all(folder)
    figures, predictions = {}, {}
    for cable, loops in hung.items():
        fits = [fit_loops(loops, effects, device=device) for effects in _STAGES]
        before, after = fits[0].rms, fits[-1].rms
        left, inside, sigma = _left_out(loops, device)
        posed = _poses(poses, cable, [fit.model for fit in fits], device)
        figures[cable] = {
            "rms_mm": {"level exits": 1e3 * before, "turned exits": 1e3 * after},
            "share": 1.0 - (after / before) ** 2,
            "left_out_mm": 1e3 * left,
            "inside_80_percent": inside,
            "between_mountings_mm": 1e3 * float(
                np.sqrt(((loops.shape - loops.shape.mean(axis=0)) ** 2).sum(axis=-1).mean())
            ),
            "stiffness": float(fits[-1].model.stiffness),
            "stiffness_stderr_percent": 100.0 * float(fits[-1].stderr[0]),
            "exits_deg": np.degrees(fits[-1].values[1:]).tolist(),
            **posed,
        }  # fmt: skip
        predictions[cable] = _predict(loops, fits[-1], posed, sigma, device)
    return figures, predictions


def _left_out(loops: HangingLoops, device: str) -> tuple[float, float, np.ndarray]:
    """RMS distance [m] of mountings from fits that have not seen them, share of coordinates in
    their 80 % intervals, sized on the other mountings, and (stretch, 2) standard deviations [m]."""
    count = len(loops.shape)
    residual = np.zeros_like(loops.shape)
    for k in range(count):
        use = np.arange(count) != k
        residual[k] = fit_loops(loops, _STAGES[-1], use=use, device=device).residual[k]
    parts = np.array_split(np.arange(residual.shape[1]), _STRETCHES)

    def sizes(some):
        return np.array([np.sqrt((some[:, part] ** 2).mean(axis=(0, 1))) for part in parts])

    inside = []
    for k in range(count):
        limits = _EIGHTY_OF_FOUR * sizes(residual[np.arange(count) != k])
        inside += [np.abs(residual[k, p]) <= limit for p, limit in zip(parts, limits, strict=True)]
    rms = float(np.sqrt((residual**2).sum(axis=-1).mean()))
    return rms, float(np.concatenate(inside).mean()), sizes(residual)


def _poses(poses: HeldPoses, cable: str, models: list[LoopModel], device: str) -> dict:
    """What the loop's stiffness says of the poses, and these of the twisting stiffness."""
    k = poses.cables.index(cable)
    numbers = range(len(poses.shape[k]))
    model = models[-1]
    cases = [(k, p, model.stiffness, r, 1.0) for p in numbers for r in RATIOS]
    shapes, good = pose_shapes(poses, cases, device)
    rms = np.array(
        [rigid_rms(poses.shape[k, c[1]], x) for c, x in zip(cases, shapes, strict=True)]
    ).reshape(len(numbers), -1)
    rms[~good.reshape(rms.shape)] = np.inf
    log = np.log(np.array(RATIOS) / _RATIO) / _LOG_RATIO
    cost = 0.5 * log**2 + 0.5 * _POSE_POINTS * ((rms / _POSE_SIGMA) ** 2).sum(axis=0)
    # The ratios are not evenly spaced in their logarithm.
    weight = np.exp(cost.min() - cost) * np.gradient(np.log(RATIOS))
    weight /= weight.sum()
    mean = float(weight @ np.log(RATIOS))
    spread = float(np.sqrt(weight @ (np.log(RATIOS) - mean) ** 2))
    believed = RATIOS.index(0.667)
    return {
        "poses_mm": {
            _SOLID: (1e3 * rms[:, believed]).tolist(),
            "best twist": (1e3 * rms[:, int(np.argmin((rms**2).sum(axis=0)))]).tolist(),
        },
        "twist_ratio": float(np.exp(mean)),
        "twist_ratio_log_sd": spread,
    }


def _predict(loops: HangingLoops, fit, posed: dict, sigma: np.ndarray, device: str) -> dict:
    """The next mounting, and the critical twist by the ratio of the stiffnesses."""
    models = [replace(fit.model, twist_ratio=r) for r in RATIOS]
    # The same with the stiffness a standard error up and down, for the spread.
    middle = replace(fit.model, twist_ratio=posed["twist_ratio"])
    error = float(fit.stderr[0])
    models += [
        replace(middle, stiffness=middle.stiffness * f)
        for f in (1.0, np.exp(error), np.exp(-error))
    ]
    angle, shape = critical_twist(loops, models, device=device)
    here, up, down = angle[len(RATIOS) :]
    finite = np.isfinite(angle[: len(RATIOS)])
    log_angle, log_ratio = np.log(angle[: len(RATIOS)][finite]), np.log(np.array(RATIOS)[finite])
    slope = np.polyfit(log_ratio, log_angle, 1)[0] if finite.sum() > 1 else -1.0
    of_stiffness = 0.5 * np.log(up / down) if np.isfinite([up, down]).all() else 0.0
    spread = float(np.hypot(slope * posed["twist_ratio_log_sd"], of_stiffness))
    part = np.minimum(np.arange(loops.shape.shape[1]) * _STRETCHES // loops.shape.shape[1],
                      _STRETCHES - 1)  # fmt: skip
    return {
        "shape": (loops.shape - fit.residual).mean(axis=0).round(5).tolist(),
        "shape_sigma": sigma[part].round(5).tolist(),
        "critical_twist_deg": {
            "by_twist_ratio": {f"{r:g}": _degrees(a) for r, a in zip(RATIOS, angle, strict=False)},
            "twist_ratio": posed["twist_ratio"],
            "expected": _degrees(here),
            "interval_80_percent": None
            if not np.isfinite(here)
            else [_degrees(here * np.exp(q * _EIGHTY * spread)) for q in (-1, 1)],
        },
        "shape_at_threshold": shape[len(RATIOS)].round(5).tolist(),
    }


def _degrees(angle: float) -> float | None:
    return float(np.degrees(angle).round(1)) if np.isfinite(angle) else None


def table(figures: dict, predictions: dict) -> str:
    lines = [
        "Loops of 1.5 m, five mountings: RMS distance in the plane [mm]; poses of 0.4 m by an arm, "
        "twisted by 360 degrees, predicted with the loop's stiffness, after one rigid motion [mm]",
        "",
    ]
    for cable, one in figures.items():
        rms, pose = one["rms_mm"], one["poses_mm"]
        lines += [
            f"{cable}: level exits {rms['level exits']:.1f}, exits turned by "
            f"{one['exits_deg'][0]:.0f} and {one['exits_deg'][1]:.0f} deg "
            f"{rms['turned exits']:.1f} ({100 * one['share']:.0f} % of the squares); left out "
            f"{one['left_out_mm']:.1f}, 80 % intervals hold {100 * one['inside_80_percent']:.0f} "
            f"%; mountings differ by {one['between_mountings_mm']:.1f}",
            f"  B {1e3 * one['stiffness']:.3f} mN m^2 ± {one['stiffness_stderr_percent']:.0f} %; "
            f"poses {_said(pose[_SOLID])} with a twisting over bending "
            f"stiffness of 2/3, {_said(pose['best twist'])} with the best; found "
            f"{one['twist_ratio']:.2f}, times or over {np.exp(one['twist_ratio_log_sd']):.2f}",
        ]
        twist = predictions[cable]["critical_twist_deg"]
        by = ", ".join(f"{r}: {a}" for r, a in twist["by_twist_ratio"].items())
        lines.append(
            f"  critical twist [deg] by ratio {by}; expected {twist['expected']}, 80 % interval "
            f"{twist['interval_80_percent']}"
        )
    return "\n".join(lines) + "\n"


def _said(values) -> str:
    return " and ".join(f"{value:.1f}" for value in values)
