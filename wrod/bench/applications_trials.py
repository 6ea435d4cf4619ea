"""Trials of the applications: what is simulated, and what is kept of it."""

import time
import warnings
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

import wrod.scenes
from wrod.bench.table3_paper import FRICTION
from wrod.deployment.fixtures import Fixtures
from wrod.deployment.gates import design_gates
from wrod.deployment.plan import plan
from wrod.deployment.setup import DEVIATIONS, Disturbance
from wrod.deployment.simulate import Trial, simulate_deployments, with_remainder_of
from wrod.errors import WrodWarning
from wrod.knots.plan import KnotPlan
from wrod.knots.trials import Handling
from wrod.knots.tying import tie
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import tail
from wrod.rods.catalogue import rod
from wrod.rods.material import RodMaterial
from wrod.solvers.friction import Friction
from wrod.telling import table

METHODS = ("intuitive", "neural")
SHORT = {"intuitive": "INT", "neural": "OPT"}
# The cable on steel, the rods of the knots on steel (Table 2 of the paper).
CABLE_FRICTION, KNOT_FRICTION, ROD_FRICTION = FRICTION["low"], FRICTION["medium"], 0.4
# Laid length at which the free end, whose first 5 cm are held, is let go [m].
_RELEASE = 0.10
_FILM = 0.2  # [s]
_POINTS = 160  # of a curve that is kept
# Distance p between gates: 0.56 L_gb. Between two gates only friction holds a bend of curvature
# kappa, which on a slippery table is little; were it to straighten, it would be kappa p^2 / 2 off.
PITCH = 0.045
# Standard deviation of how far the cable slips through the grip in a trial [m].
SLIP = 1e-3
# The plan is made for a cable stiffer than the nominal one by this many standard deviations: one
# that is stiffer than believed comes down beside its gates, a softer one still falls into them.
ALLOWANCE = 1.5
# Of the trials' random numbers. The scenes were designed with seeds 5000 to 6059.
_SEED = {"S cable": 41_000, "U cable": 42_000}


def folder() -> Path:
    """Where the shipped scenes are."""
    return Path(wrod.scenes.__file__).parent


def believed(cable: RodMaterial) -> RodMaterial:
    """The cable that the plan is made for."""
    factor = 1.0 + ALLOWANCE * DEVIATIONS["lgb_error"]
    return replace(cable, gravito_bending_length=factor * cable.gravito_bending_length)


def plan_cable(pattern: Pattern, cable: RodMaterial, method: str):
    """OPT is `wrod.plan`'s default, which in bends asks for the least friction (min_friction), with
    the allowance for L_gb; INT goes by the pattern alone."""
    if method == "intuitive":
        return plan(pattern, cable, "intuitive")
    return plan(pattern, believed(cable), "auto")


def gates(pattern: Pattern) -> Fixtures:
    """The scene along a pattern, as shipped in scenes/cable."""
    scene = design_gates(pattern, believed(rod("cable")), pitch=PITCH)
    note = (
        "Pairs of posts by wrod.deployment.gates.design_gates for rod 'cable', OPT's plan: "
        "where the cable "
        f"comes down with the least sideways motion, {1e3 * PITCH:g} mm apart if possible, each "
        "post 3 standard deviations of the sideways error clear of the cable's middle, and on the "
        "side from which it comes as much farther as it still is to that side when it is as low "
        "as the posts."
    )
    return replace(scene, note=note)


def disturbance(case: str, trial: int) -> Disturbance:
    return Disturbance.random(_SEED[case] + trial, slip=SLIP)


_KNOTS = "knots also: place of each hand 1 mm in every direction, friction of its fingertips 30 %"


def disturbances_text(trials: list[dict]) -> str:
    """A table of what every trial was disturbed by, stated and as drawn in these trials."""
    drawn = [row["disturbance"] for row in trials if row.get("disturbance")]

    def rms(pick, scale: float) -> str:
        values = np.array([pick(d) for d in drawn], dtype=float)
        return "-" if not len(values) else f"{scale * np.sqrt(np.mean(values**2)):.2f}"

    one = DEVIATIONS
    entries = [
        ("L_gb against the nominal [%]", 100 * one["lgb_error"], lambda d: d["lgb_error"], 100),
        ("robot's place, x and y [mm]", 1e3 * one["placement"], lambda d: d["offset"], 1e3),
        ("robot's yaw [degrees]", np.degrees(one["yaw"]), lambda d: d["yaw"], np.degrees(1.0)),
        ("arm jitter, each axis [mm]", 1e3 * one["jitter"], lambda d: d["jitter"], 1e3),
        (
            "natural curvature [1/m]",
            one["natural_curvature"],
            lambda d: d["natural_curvature"],
            1.0,
        ),
        ("cables: slip in the grip [mm]", 1e3 * SLIP, lambda d: d["slip"], 1e3),
    ]
    head = ("disturbance", "standard deviation", "drawn for the cables, rms")
    rows = ((name, f"{size:g}", rms(pick, scale)) for name, size, pick, scale in entries)
    return "\n".join(table(head, rows)) + f"\n\n{_KNOTS}\n"


# How far beside a gate, and how high above it, the cable's way there is kept [m].
_NEAR, _LOW = 0.04, 0.03


def ways_to_gates(frames: np.ndarray, fixtures: Fixtures) -> list[list]:
    """How the cable comes to each gate: (y, z) of its middle in the gate's plane over time [mm], y
    from the middle of the gate to the left, z from where it lies on the table.

    Args:
        frames: (frame, node, 3) [m].
        fixtures: whose gates.
    """
    by_name = {item.name: np.array(item.shape.center[:2]) for item in fixtures.items}
    out = []
    for left, right in fixtures.gates:
        a, b = by_name[left], by_name[right]
        across = (a - b) / np.linalg.norm(a - b)
        flat = frames[:, :, :2] - (a + b) / 2
        y = flat @ across
        ahead = flat @ np.array([across[1], -across[0]])
        frame, node = np.nonzero((ahead[:, :-1] < 0) & (ahead[:, 1:] >= 0))
        part = ahead[frame, node] / (ahead[frame, node] - ahead[frame, node + 1])

        def there(values, frame=frame, node=node, part=part):
            first = values[frame, node]
            return first + part * (values[frame, node + 1] - first)

        side, height = there(y), there(frames[:, :, 2])
        near = (np.abs(side) < _NEAR) & (height < _LOW)
        way = 1e3 * np.column_stack([side, height])[near]
        out.append(np.round(way, 1).tolist())
    return out


def run_trials(
    case: str, method: str, trials: list[int], *, device: str, folder: Path | None
) -> tuple[list[dict], list[Path]]:
    """Rows of the ledger, and the scenes that were written to `folder`."""
    run = _cable if case.endswith("cable") else _knot
    return run(case, method, trials, device, folder)


def cable_scene(case: str):
    """Pattern and fixtures of "S cable" or "U cable"."""
    name = case.split()[0]
    place = folder() / "cable"
    return (
        Pattern.load(place / f"{name}.csv", name=name, smoothing=0.0),
        Fixtures.load(place / f"{name}.json"),
    )


def knot_plan(case: str):
    """Plan of "trefoil" or "reef"."""
    return KnotPlan.load_plan(folder() / "knots" / f"{case}.json")


def _cable(case, method, trials, device, folder):
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
    lift = [0.0, 0.0, material.radius]

    def film(d) -> dict:
        filmed = _FILM * np.arange(len(d.frames))
        hands = d.hand[:, None].copy()
        hands[..., :3, 3] += lift
        return {
            "time": filmed,
            "rods": [d.frames + lift],
            "names": ["cable"],
            "radii": [material.radius],
            "patterns": [pattern],
            "hands": hands,
            "closed": filmed[:, None] < d.let_go,
            "fixtures": fixtures,
        }

    return rows, _stage(folder, rows, map(film, deployments))


def cable_rows(case, method, trials, jobs, deployments, seconds) -> list[dict]:
    """What the ledger keeps of each deployment of a cable."""
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


def _stage(folder: Path | None, rows: list[dict], films: Iterable[dict]) -> list[Path]:
    """Write the trials' scenes, if into a folder, and note their arms' distances in the rows."""
    if folder is None:
        return []
    from wrod.scene.tying import export_scene

    scenes, places = [], None
    for row, film in zip(rows, films, strict=True):
        if film["time"] is None:
            continue
        name = f"{row['case'].replace(' ', '-')}-{SHORT[row['method']]}-{row['trial']}.usdc"
        facts = {key: row[key] for key in ("case", "method", "trial", "success", "why")}
        scene = export_scene(folder / name, facts=facts, placements=places, **film)
        for what in scene.missing:
            warnings.warn(f"{scene.path}: left out {what}", WrodWarning, stacklevel=3)
        scenes.append(scene.path)
        row["arms"] = scene.missing[0] if scene.arms is None else scene.arms.facts
        places = places if scene.arms is None else scene.arms.placements
    return scenes


def _knot(case, method, trials, device, folder):
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
    rows = [
        {
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
        for trial, r in zip(trials, results, strict=True)
    ]
    own = {
        "names": list(knot.rod_names),
        "radii": [material.radius for _, material in knot.rods],
        "patterns": [pattern for pattern, _ in knot.rods],
    }
    films = (
        own | {"time": r.time, "rods": r.frames, "hands": r.hands, "closed": r.closed}
        for r in results
    )
    return rows, _stage(folder, rows, films)


def _kept(rod: np.ndarray) -> list:
    pick = np.unique(np.linspace(0, len(rod) - 1, _POINTS).astype(int))
    return np.round(rod[pick], 4).tolist()
