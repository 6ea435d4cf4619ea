"""What `wrod bench loop` lays: every pattern with the old and the new model behind a controller."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from wrod.bench.campaign import figures_of
from wrod.bench.put_down import put_down
from wrod.deployment.optimise import optimise
from wrod.deployment.plan import plan
from wrod.deployment.result import deployment_error
from wrod.deployment.setup import Disturbance
from wrod.deployment.simulate import Trial, with_remainder_of
from wrod.errors import DataError
from wrod.patterns.pattern import Pattern
from wrod.patterns.shapes import straight, strokes
from wrod.planning.tail import tail
from wrod.rods.discretisation import in_principal
from wrod.rods.law import Softening
from wrod.rods.material import RodMaterial
from wrod.rods.model import Rod, RodModel
from wrod.rods.profile import Profile

# Edges of a rod that is put down exactly, per L_gb.
_PUT_DOWN = 12.0


@dataclass(frozen=True)
class Case:
    """A rod with an effect: as it is, as it is believed to be, as it was identified, the network
    for the latter (None where the one that ships knows it), and the roll that plans hold it at
    (see `wrod.plan`)."""

    true: Rod
    believed: Rod
    report: Any
    model: Rod
    network: Any
    roll: float | str | None


def own_bend(cable: Rod):
    """A pattern that a cable can be laid along which is a few L_gb long: as much as leaves 1.5 L_gb
    hanging, straight for 1.25 L_gb, then bent by up to 0.2 / L_gb, which the friction of so little
    of it holds."""
    lgb = cable.gravito_bending_length
    first, bend = 1.25 * lgb, 0.2 / lgb
    rest = cable.length - 1.5 * lgb - first
    if rest < lgb:
        raise DataError(
            f"the cable is {cable.length / lgb:.1f} L_gb long, too short to be laid in a bend; "
            "give --pattern"
        )
    ease = rest / 3.0
    parts = [(ease, 0.0, bend), (ease, bend, bend), (ease, bend, 0.0)]
    return Pattern(*strokes(0.0, straight(first), parts), name="bend")


def trials_along(
    name: str,
    curve,
    cases: dict[str, Case],
    controllers: tuple[str, ...],
    law,
    hold: float,
    known: bool,
) -> dict:
    """Deployments along one pattern by (effect, controller, pattern, plan): old, new, and of a rod
    without any effect.

    Old and new plan hold the rod at the same roll, so that only the model behind the grasps
    differs. Where the rod that was found cannot hang in all of its grasps, both are laid with it in
    simulation beforehand, rolled four ways; the new plan is the one that is expected to be best.
    `law` is the table's `Friction`, `hold` the length of the free end that is held at first [m].
    Where that friction is `known`, new plans are corrected for it. All cases believe in one rod.
    """

    def trial(rod, model, controller, network=None, roll="plane"):
        method = {"network": "neural", "numeric": "numeric", "default": "auto"}[controller]
        path = plan(
            curve, model, method, roll=roll, device="cpu",
            controller=network if controller == "network" else None,
        )  # fmt: skip
        led = with_remainder_of(curve, path)
        return Trial(led, rod, path, law, tail=tail(led, model, path))

    jobs = {}
    believed = next(iter(cases.values())).believed
    for controller in controllers:
        jobs["none", controller, name, "old"] = trial(believed, believed, controller)
        for effect, case in cases.items():
            new = trial(case.true, case.model, controller, case.network, case.roll)
            roll = new.trajectory.roll
            old = trial(case.true, believed, controller, roll=roll)
            if new.trajectory.natural_share < 1.0:
                rivals = {("own", 0): new, ("old", 0): old}
                for turn in (90, 180, 270):
                    held = roll + np.radians(turn)
                    rivals["own", turn] = trial(case.true, case.model, controller, roll=held)
                    rivals["old", turn] = trial(case.true, believed, controller, roll=held)
                new = _expected_best(rivals, case.model, law, hold)
            if known:
                path = optimise(new.pattern, case.model, new.trajectory, law.static, hold=hold)
                new = replace(new, trajectory=path, tail=tail(new.pattern, case.model, path))
            jobs[effect, controller, name, "old"] = old
            jobs[effect, controller, name, "new"] = new
    return jobs


def _expected_best(rivals: dict, model, law, hold: float):
    """The trial that is expected to lay the rod best; its metadata say what was expected of each,
    and where the rod lies that is put down exactly [cm]."""
    from wrod.deployment.rivals import expected_errors

    pairs = [(one.pattern, one.trajectory) for one in rivals.values()]
    errors = expected_errors(model, pairs, law.static, hold=hold)
    best = list(rivals.values())[int(errors.argmin())]
    said = {
        f"{name} by {turn} degrees": 100.0 * float(error)
        for (name, turn), error in zip(rivals, errors, strict=True)
    }
    down = {turn: one for (name, turn), one in rivals.items() if name == "own"}
    springs, nearest = zip(*_springs(list(down.values())), strict=True)
    springs = dict(zip(map(str, down), springs, strict=True))
    path, more = best.trajectory, {"rivals": said, "put_down": springs, "nearest": min(nearest)}
    return replace(best, trajectory=replace(path, metadata={**path.metadata, **more}))


def _springs(trials: list) -> list[tuple[float, float]]:
    """e_mean [cm] of rods that are put down exactly on their patterns, rolled as they are held, and
    let go, and that where they then lay turned and shifted on the table as fits best; infinite
    where one diverged."""
    jobs = [
        (t.pattern, RodModel.of(t.rod).turned(t.trajectory.roll), t.friction, Disturbance())
        for t in trials
    ]
    longest = max(t.pattern.length + t.pattern.remainder_length for t in trials)
    nodes = int(np.ceil(_PUT_DOWN * longest / trials[0].rod.gravito_bending_length)) + 1
    ends = put_down(jobs, node_count=nodes, step=0.02)
    return [
        (np.inf, np.inf)
        if lost
        else (100.0 * deployment_error(t.pattern, s, at)[0], 100.0 * _nearest(t.pattern, s, at))
        for t, (s, at, lost, _) in zip(trials, ends, strict=True)
    ]


def _nearest(pattern: Pattern, arc_length: np.ndarray, centerline: np.ndarray) -> float:
    """Least e_mean [m] of a centerline (node, 3), however turned and shifted on the table."""
    middle = centerline[:, :2].mean(axis=0)

    def error(how: np.ndarray) -> float:
        turned = in_principal(centerline[:, :2] - middle, how[2])
        return deployment_error(pattern, arc_length, turned + middle + pattern.length * how[:2])[0]

    # By simplices, since a mean of distances has kinks; of shares of the length and an angle.
    corners = np.vstack([np.zeros(3), 0.05 * np.eye(3)])
    how = {"initial_simplex": corners, "xatol": 1e-5, "fatol": 1e-7, "maxiter": 600}
    return float(minimize(error, np.zeros(3), method="Nelder-Mead", options=how).fun)


def row(key: tuple[str, str, str, str], trial, deployment) -> dict:
    """Figures [cm] of a deployment, and the laid curve at 60 points [m]."""
    metadata = trial.trajectory.metadata
    return {
        **dict(zip(("effect", "controller", "pattern", "plan"), key, strict=True)),
        "method": metadata["method"],
        "closure": metadata["closure"],
        **figures_of(deployment, trial.pattern),
        "contact_friction": metadata["contact_friction"],
        "natural_share": trial.trajectory.natural_share,
        "rivals": metadata.get("rivals", {}),
        "put_down": metadata.get("put_down", {}),
        "nearest": metadata.get("nearest"),
        "ended": deployment.duration,
        "let_go": deployment.let_go,
    }


def with_length(found: RodModel, believed: RodMaterial) -> Rod:
    """The identified rod at the length of the one that is laid: the clamps held its first piece."""
    longer = replace(found, length=believed.length)
    return longer if longer.not_uniform() else longer.material()


def varied_rod(believed: RodMaterial) -> RodModel:
    """Half as stiff after 30 cm as at the first, a third softer across than along the section's
    stiffer direction, and softening from 20 /m on."""
    model = RodModel.of(believed)
    stiffness = Profile((1.3, 0.7), (0.0, 0.30)) * model.mean_bending_stiffness
    return replace(
        model,
        bending_stiffness=(stiffness * 1.2, stiffness * 0.8),
        twisting_stiffness=stiffness * (1.0 / (1.0 + believed.poisson)),
        principal_angle=0.4,
        law=Softening(20.0, 0.5),
    )
