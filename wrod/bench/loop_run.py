"""What `wrod bench loop` does, step by step: measure, identify, train, plan, lay, report."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from wrod import cost
from wrod.bench.continuous_rod import measured, world_of
from wrod.bench.loop_options import EFFECTS, Loop
from wrod.bench.loop_report import draw, markdown, summary, write_csv
from wrod.bench.loop_trials import Case, own_bend, row, trials_along, varied_rod, with_length
from wrod.bench.table3_paper import PATTERNS, read_pattern
from wrod.deployment.bounds import refuse_coarse_edges, refuse_long_moves
from wrod.deployment.discretisation import Discretisation
from wrod.deployment.simulate import simulate_deployments
from wrod.errors import DataError
from wrod.files import write_text
from wrod.identification import identify
from wrod.identification.clamped.loading import measurements_from_arrays
from wrod.identification.clamped.setup import rotation_of
from wrod.identification.effect import effects_asked
from wrod.identification.entry import identification_cost
from wrod.identification.motion.loading import load_motion
from wrod.identification.motion.remembered import KnownSteps
from wrod.identification.template import labels
from wrod.machine import machine_line
from wrod.options import refuse_idle_options
from wrod.planning.roll import read_roll
from wrod.rods.catalogue import rod
from wrod.rods.material import RodMaterial
from wrod.rods.model import Rod, RodModel
from wrod.solvers.friction import Friction

# The free end of a cable is held for so much of its L_gb; a green VPS rod's 5 cm are 1.6 of them.
_HELD, _VPS_HELD = 1.5, 0.05
# Where a run that was stopped, while a recorded cable was identified or planned with, goes on from.
_STEPS = "steps.jsonl"
# Length between the clamps [m], and markers along it, ends included.
_FREE_LENGTH, _MARKERS = 0.30, 21


def _refuse_idle(loop: Loop) -> None:
    if loop.recording is not None:
        idle = ("effect", "rod", "trials", "noise", "seed", "controller", "grasps", "steps")
        refuse_idle_options("--recording", *idle, "curvature", "lgb-error")
    elif "natural_curvature" not in (loop.effects or EFFECTS):
        refuse_idle_options("effects without natural_curvature", "curvature")
    elif "stiffness" not in (loop.effects or EFFECTS):
        refuse_idle_options("effects without stiffness", "lgb-error")
    if "network" not in loop.controllers:
        refuse_idle_options("controllers without network", "grasps", "steps")


def run(loop: Loop) -> dict[str, Any]:
    """All of it; plain figures, the laid curves in files only."""
    _refuse_idle(loop)
    curves = {name: read_pattern(name, loop.patterns) for name in loop.names or PATTERNS}
    _settle(loop, curves)
    cases, written = (_recorded if loop.recording else _hidden)(loop)
    if loop.recording and not loop.names:
        (case,) = cases.values()
        curves = {"bend": own_bend(case.model)}
    rows = _laid(loop, cases, curves)
    for name in cases:
        (loop.out / name / _STEPS).unlink(missing_ok=True)
    found = {effect: _found(case) for effect, case in cases.items()}
    text = markdown(rows, found, loop.head)
    write_text(loop.out / "loop.md", text)
    written += [
        write_csv(loop.out / "loop.csv", rows),
        loop.out / "loop.md",
        draw(loop.out / "loop.png", rows, curves),
    ]
    return {
        "machine": machine_line(loop.device),
        "device": loop.device,
        "found": found,
        "summary": summary(rows),
        "seconds": loop.seconds,
        "rows": [{k: v for k, v in one.items() if k != "curve"} for one in rows],
        "written": [str(path) for path in written],
    }


def _settle(loop: Loop, curves: dict) -> None:
    """Say what identification, training and deployments cost, or refuse it."""
    refuse_long_moves(loop.speed, loop.step)
    controllers, believed = len(loop.controllers), rod(loop.rod_name)
    read_roll(loop.roll_text, believed)
    effects_asked("clamped" if loop.recording is None else "motion", loop.candidates)
    if loop.recording is not None:
        known, cases, learning = identification_cost(loop.recording), 1, 0.0
        count, length = 2 * max(len(loop.names), 1), 2.0
    else:
        softest = min(1.0, 1.0 + loop.lgb_error) * believed.gravito_bending_length
        refuse_coarse_edges([replace(believed, gravito_bending_length=softest)], loop.spacing)
        cases = len(loop.effects or EFFECTS)
        known = cost.Cost(cost.IDENTIFIED_SET * cases)
        count, length = len(curves) * controllers * (1 + 2 * cases), believed.length
        learning = _learning(loop) * cases if "network" in loop.controllers else 0.0
    work = cost.deployments(
        count, length, speed=loop.speed, step=loop.step, spacing=loop.spacing, device=loop.device
    )
    what = f"{cases} identified, {count} deployments"
    remedy = "ask for fewer effects, patterns or --grasps, or a larger --spacing or --step"
    work = replace(work, seconds=work.seconds + known.seconds + learning)
    cost.settle(work, what, remedy)


def _learning(loop: Loop) -> float:
    """Seconds of a naturally curved rod's grasps and of a network that learns them."""
    from wrod.training.recipes import recipe

    how = recipe("curved")
    training = cost.training(
        loop.steps or how.steps, how.batch, how.width, how.depth, loop.grasps, device=loop.device
    )
    solving = cost.grasps(
        loop.grasps, 0, loop.grasps, sensitivities=True, device=loop.device, ranks=1
    )
    return training.seconds + solving.seconds


def _hidden(loop: Loop) -> tuple[dict[str, Case], list[Path]]:
    """A case for each effect that is hidden in synthetic measurements, and the files written."""
    believed = rod(loop.rod_name)
    true: dict[str, Rod] = {
        "natural_curvature": replace(believed, natural_curvature=(loop.curvature, 0.0)),
        "stiffness": replace(
            believed,
            gravito_bending_length=(1.0 + loop.lgb_error) * believed.gravito_bending_length,
        ),
        "varied": varied_rod(believed),
    }
    cases, written = {}, []
    for effect in cost.progress_bar(loop.effects or EFFECTS, desc="identify"):
        with loop.timed("identification"):
            data = clamped_experiment(
                true[effect], believed, trials=loop.trials, noise=loop.noise, seed=loop.seed
            )
            seen = measurements_from_arrays(data, name="synthetic")
            report = identify(seen, candidates=loop.candidates or None, device=loop.device)
        written += report.save(loop.out / effect)
        model = with_length(report.model, believed)
        roll, network = read_roll(loop.roll_text, model), None
        if "network" in loop.controllers:
            network = _trained(loop, model, loop.out / effect, roll)
        if network is not None:
            written.append(loop.out / effect / "controller.safetensors")
        cases[effect] = Case(true[effect], believed, report, model, network, roll)
    return cases, written


def clamped_experiment(
    rod: Rod,
    believed: RodMaterial,
    *,
    trials: int = 16,
    test_trials: int = 4,
    noise: float = 3e-4,
    seed: int = 0,
) -> dict[str, np.ndarray]:
    """Measurements of a piece of `rod` between clamp and gripper, labelled as of `believed`.

    They are those of a continuous Kirchhoff rod solved by collocation, which shares neither mesh
    nor equations with what explains them.

    The gripper stands 70 % of the length between the clamps away, in random poses; both clamps roll
    together, so that what turns with the material is seen from every side.

    Args:
        rod: the rod that is measured: its first 30 cm.
        believed: the rod that its user takes it for: the numbers that the data come with.
        trials, test_trials: shapes in all, and how many of them are kept for scoring.
        noise: standard deviation of a marker coordinate [m].
        seed: of poses and noise.

    Returns:
        Arrays as `wrod.load_measurements` reads them from a file.

    Raises:
        DataError: too few trials, or the rod finds no equilibrium in a pose.
    """
    if not 0 < test_trials < trials:
        raise DataError(
            f"{trials} trials with {test_trials} to score on; give at least one trial of each kind"
        )
    rng = np.random.default_rng(seed)
    level = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])
    rolls = rng.uniform(-np.pi, np.pi, trials)
    clamp = np.stack([level @ rotation_of(np.array([0.0, 0.0, roll])) for roll in rolls])
    turns = rng.uniform(-0.35, 0.35, (trials, 3)) * [1.0, 1.0, 1.5]
    grip = np.stack([c @ rotation_of(turn) for c, turn in zip(clamp, turns, strict=True)])
    reach = _FREE_LENGTH * (rng.uniform(-0.1, 0.1, (trials, 3)) + [0.7, 0.0, 0.0])
    arc_length = np.linspace(0.0, _FREE_LENGTH, _MARKERS)
    foot = np.tile([0.3, -0.2, 0.5], (trials, 1))
    data: dict[str, Any] = {
        "clamp_position": foot,
        "clamp_rotation": clamp,
        "grip_position": foot + reach,
        "grip_rotation": grip,
        "arc_length": arc_length,
        "train_idx": np.arange(trials - test_trials),
        "test_idx": np.arange(trials - test_trials, trials),
        "noise_std": noise,
        **labels(replace(believed, length=_FREE_LENGTH)),
    }
    experiment = world_of(RodModel.of(rod), replace(believed, length=_FREE_LENGTH))
    seen = measured(data, experiment, seed=1_000_000 + seed, noise=noise)
    return {**seen, **labels(replace(believed, length=_FREE_LENGTH))}


def _recorded(loop: Loop) -> tuple[dict[str, Case], list[Path]]:
    """The one case of a recorded cable: what was found in it is the best that is known of it."""
    name = loop.recording.stem
    with loop.timed("identification"):
        recordings = load_motion(loop.recording)
        steps = KnownSteps(loop.out / name / _STEPS, recordings)
        report: Any = identify(
            recordings, candidates=loop.candidates or None, device=loop.device, steps=steps,
            evidence=False,
        )  # fmt: skip
    written, model = report.save(loop.out / name), report.model
    roll = read_roll(loop.roll_text, model)
    return {name: Case(model, report.base_rod, report, model, None, roll)}, written


def _trained(loop: Loop, model, folder: Path, roll):
    """A controller trained for a naturally curved rod, written to `folder`; None for a straight
    rod, which the one that ships knows, and for one that varies, which none does."""
    if model.is_straight or isinstance(model, RodModel):
        return None
    from wrod.training.finish import controller_for

    roll = "plane" if roll is None else roll
    bar = cost.progress_bar(total=100, desc="train", bar_format=cost.SHARE)
    with loop.timed("training"), bar:
        made = controller_for(
            model, folder, roll=roll, grasps=loop.grasps, steps=loop.steps, seed=loop.seed,
            device=loop.device, progress=lambda share: bar.update(100 * share - bar.n),
        )  # fmt: skip
    made.save(folder / "controller.safetensors")
    return made


def _laid(loop: Loop, cases: dict[str, Case], curves: dict) -> list[dict]:
    """A row for each deployment."""
    jobs, law, hold = {}, Friction(loop.friction, rolling=loop.rolling), _VPS_HELD
    if loop.recording:
        rods = [rod for case in cases.values() for rod in (case.true, case.believed)]
        hold = _HELD * max(rod.gravito_bending_length for rod in rods)
    with loop.timed("plans"):
        for name, curve in cost.progress_bar(curves.items(), desc="plans"):
            jobs |= trials_along(name, curve, cases, loop.controllers, law, hold, loop.known_table)
    with loop.timed("deployments"), cost.share_bar("laid") as progress:
        laid = simulate_deployments(
            list(jobs.values()), speed=loop.speed, device=loop.device, hold=hold,
            discretisation=Discretisation(loop.spacing, loop.step), progress=progress,
        )  # fmt: skip
    return [row(key, jobs[key], d) for key, d in zip(jobs, laid, strict=True)]


def _found(case: Case) -> dict:
    """What the identification said, beside the truth, and how well its network learnt."""
    true, report = case.true, case.report
    learnt = None
    if case.network is not None:
        metadata = case.network.metadata
        learnt = {key: metadata[key] for key in ("samples", "steps", "seconds", "held_out")}
    return {
        "network": learnt,
        "verdict": report.verdict,
        "before_mm": 1e3 * report.before,
        "after_mm": 1e3 * report.after,
        "noise_floor_mm": 1e3 * report.noise_floor,
        "effects": {
            e.name: {key: asdict(value) for key, value in e.parameters.items()}
            for e in report.effects
        },
        "set_aside": list(report.found.set_aside),
        "rod_has": list(report.model.not_uniform()),
        "true": None
        if case.true is case.model
        else {
            "natural_curvature": list(true.curvature_held(0.0)),
            "gravito_bending_length": true.gravito_bending_length,
        },
        "model": {
            "natural_curvature": list(report.material.natural_curvature),
            # Of the length that is laid, as the true one is.
            "gravito_bending_length": case.model.gravito_bending_length,
        },
    }
