"""Trials of the applications: what is simulated, and what is kept of it."""

import time
from pathlib import Path

import numpy as np

from wrod.bench.table3_paper import FRICTION
from wrod.patterns.pattern import Pattern

METHODS = ("intuitive", "neural")
SHORT = {"intuitive": "INT", "neural": "OPT"}
# The cable on steel, the rods of the knots on steel (Table 2 of the paper).
CABLE_FRICTION, KNOT_FRICTION, ROD_FRICTION = FRICTION["low"], FRICTION["medium"], 0.4
# Laid length at which the free end, whose first 5 cm are held, is let go [m].
_RELEASE = 0.10
_FILM = 0.2  # [s]
_POINTS = 160  # of a curve that is kept


def folder() -> Path:
    """Where the shipped scenes are."""
    import wrod.scenes

    return Path(wrod.scenes.__file__).parent


def run_trials(
    case: str, method: str, trials: list[int], *, device: str, folder: Path | None
) -> tuple[list[dict], list[Path]]:
    """Rows of the ledger, and the scenes that were written to `folder`."""
    run = _cable if case.endswith("cable") else _knot
    return run(case, method, trials, device, folder)


def cable_scene(case: str):
    """Pattern and fixtures of "S cable" or "U cable"."""
    from wrod.deployment.fixtures import Fixtures

    name = case.split()[0]
    place = folder() / "cable"
    return (
        Pattern.load(place / f"{name}.csv", name=name, smoothing=0.0),
        Fixtures.load(place / f"{name}.json"),
    )


def knot_plan(case: str):
    """Plan of "trefoil" or "reef"."""
    from wrod.knots.plan import KnotPlan

    return KnotPlan.load_plan(folder() / "knots" / f"{case}.json")


def _cable(case, method, trials, device, folder):
    from wrod.bench.applications_cables import disturbance, plan_cable
    from wrod.deployment.simulate import Trial, simulate_deployments, with_remainder_of
    from wrod.planning.tail import tail
    from wrod.rods.catalogue import rod
    from wrod.solvers.friction import Friction

    pattern, fixtures = cable_scene(case)
    material = rod("cable")
    trajectory = plan_cable(pattern, material, method)
    pattern = with_remainder_of(pattern, trajectory)
    rest = tail(pattern, material, trajectory)
    jobs = [
        Trial(
            pattern,
            material,
            trajectory,
            Friction(CABLE_FRICTION),
            disturbance(case, trial),
            rest,
            fixtures,
        )
        for trial in trials
    ]
    clock = time.process_time()
    deployments = simulate_deployments(jobs, release=_RELEASE, device=device, frame_interval=_FILM)
    seconds = (time.process_time() - clock) / len(trials)
    rows = cable_rows(case, method, trials, jobs, deployments, seconds)
    if folder is None:
        return rows, []
    scenes, places, lift = [], None, [0.0, 0.0, material.radius]
    for row, d in zip(rows, deployments, strict=True):
        filmed = _FILM * np.arange(len(d.frames))
        hands = d.hand[:, None].copy()
        hands[..., :3, 3] += lift
        places = _stage(
            folder, row, scenes, places,
            time=filmed,
            rods=[d.frames + lift],
            names=["cable"],
            radii=[material.radius],
            patterns=[pattern],
            hands=hands,
            closed=filmed[:, None] < d.let_go,
            fixtures=fixtures,
        )  # fmt: skip
    return rows, scenes


def cable_rows(case, method, trials, jobs, deployments, seconds) -> list[dict]:
    """What the ledger keeps of each deployment of a cable."""
    from dataclasses import asdict

    from wrod.bench.applications_cables import ways_to_gates

    rows = []
    for trial, job, d in zip(trials, jobs, deployments, strict=True):
        material, fixtures = job.rod, job.fixtures
        found = fixtures.judge(d.released_centerline, material.radius, d.released_speed)
        rows.append(
            {
                "case": case,
                "method": method,
                "trial": trial,
                "success": bool(found.placed and not d.diverged),
                "why": "diverged" if d.diverged else str(found),
                "error": [100 * d.error_mean],
                "cpu_seconds": seconds,
                "steps": d.steps,
                "closure": job.trajectory.closure,
                "speed": d.released_speed,
                "penetration": d.penetration / material.radius,
                "disturbance": asdict(job.disturbance),
                "ways": ways_to_gates(d.frames, fixtures),
                "curves": {
                    "film": [_kept(d.frames[k]) for k in _stages(len(d.frames))],
                    "end": [_kept(d.released_centerline)],
                },
            }
        )
    return rows


def _stages(frames: int) -> list[int]:
    """A few moments while the rod is laid."""
    return (np.linspace(0.1, 0.9, 7) * (frames - 1)).astype(int).tolist()


def _stage(folder: Path, row: dict, scenes: list[Path], places, **film):
    """Write a trial's scene, note its arms' distances in the row, and return where they stand."""
    import warnings

    from wrod.errors import WrodWarning
    from wrod.scene.tying import export_scene

    name = f"{row['case'].replace(' ', '-')}-{SHORT[row['method']]}-{row['trial']}.usdc"
    facts = {key: row[key] for key in ("case", "method", "trial", "success", "why")}
    scene = export_scene(folder / name, facts=facts, placements=places, **film)
    for what in scene.missing:
        warnings.warn(f"{scene.path}: left out {what}", WrodWarning, stacklevel=3)
    scenes.append(scene.path)
    row["arms"] = scene.missing[0] if scene.arms is None else scene.arms.facts
    return places if scene.arms is None else scene.arms.placements


def _knot(case, method, trials, device, folder):
    from wrod.knots.trials import Handling
    from wrod.knots.tying import tie

    knot = knot_plan(case)
    clock = time.process_time()
    results = tie(
        knot,
        [Handling.random(1000 * (case == "reef") + trial) for trial in trials],
        method,
        friction=KNOT_FRICTION,
        rod_friction=ROD_FRICTION,
        film_interval=_FILM if folder else None,
        device=device,
    )
    seconds = (time.process_time() - clock) / len(trials)
    rows, scenes, places = [], [], None
    for trial, r in zip(trials, results, strict=True):
        row = {
            "case": case,
            "method": method,
            "trial": trial,
            "success": bool(r.success),
            "why": r.why,
            "error": [100 * e for e in r.error],
            "cpu_seconds": seconds,
            "steps": r.steps,
            "knots": {
                stage: [found.name, found.share, found.share_of(knot.knot)]
                for stage in ("laid", "tied", "tight", "pulled")
                if (found := getattr(r, stage)) is not None
            },
            "load": [round(float(v), 4) for v in r.load],
            "strongest": round(r.strongest, 4),
            "crept": round(r.crept, 5),
            "missed": r.missed,
            "slipped": r.slipped,
            "curves": {stage: [_kept(rod) for rod in rods] for stage, rods in r.stages.items()},
        }
        rows.append(row)
        if folder is None or r.time is None:
            continue
        places = _stage(
            folder, row, scenes, places,
            time=r.time,
            rods=r.frames,
            names=list(knot.rod_names),
            radii=[material.radius for _, material in knot.rods],
            patterns=[pattern for pattern, _ in knot.rods],
            hands=r.hands,
            closed=r.closed,
        )  # fmt: skip
    return rows, scenes


def _kept(rod: np.ndarray) -> list:
    pick = np.unique(np.linspace(0, len(rod) - 1, _POINTS).astype(int))
    return np.round(rod[pick], 4).tolist()
