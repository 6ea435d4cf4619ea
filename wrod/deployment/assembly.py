"""From trials of deployments to batches of rods, tables and steps."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.deployment.discretisation import USUAL, Discretisation
from wrod.deployment.fixtures import Fixtures
from wrod.deployment.grip_path import GripMotion
from wrod.deployment.setup import Setup
from wrod.deployment.trial import Trial
from wrod.rods.batch import RodBatch
from wrod.rods.discretisation import directors_at_rest
from wrod.rods.model import RodModel
from wrod.solvers.contact import Contact
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.friction import FrictionField
from wrod.solvers.solids import Plane

# The table gives way by this fraction of the radius under the rod's weight; where the rod touches
# down, which loads it with about 2 w L_gb at a point, that makes some 1 % of the radius.
SINKING = 1.0 / 600.0
_SINKING_AT_POSTS = SINKING / 10.0
# Steps with tolerances from the first on are given up once their residual could not come down by
# this factor an iteration: where nodes come to stick, slide or touch in turn half the step is
# sooner there. Tight ones go on, lest rods that differ by next to nothing are laid in other steps.
_LOOSE, _SHRINKS = 1e-4, 4.0
# Kelvin-Voigt time of rods that nobody has shaken: three recorded cables have 53 to 78 ms
# (docs/identification-motion.md). Undamped, what shakes goes on shaking, and where it lies depends
# on the steps down to a millisecond (docs/deployment.md) [s].
INTERNAL_DAMPING = 0.065
# Of rods that say nothing of it, which swing for seconds otherwise [1/s, s].
USUAL_DAMPING: dict[str, Any] = {"air_damping": 1.0, "internal_damping": INTERNAL_DAMPING}


def assemble(
    trials: list[Trial],
    setups: list[Setup],
    discretisation: Discretisation = USUAL,
    *,
    device: str = "cpu",
    keeps_recording: bool = False,
    friction_field: FrictionField | None = None,
) -> tuple[RodBatch, Contact, Dynamics]:
    """The rods of prepared trials, what they touch, and what steps them; see
    `simulate_deployments`.

    Every rod that ends in its grip has one node more than its setup: there it goes on for a ghost
    edge with the grip's direction, massless and touched by nothing, so that what it is bent to at
    the grip is felt to second order in its edges.
    """
    models = {id(rod): RodModel.of(rod) for rod in {id(t.rod): t.rod for t in trials}.values()}
    batch, rods = _batch(trials, models, setups, device)
    ghosts = batch.node_count - len(setups[0].arc_length)
    sided = {key: model.has_sides for key, model in models.items()}
    radius, table = np.array([rod.radius for rod in rods]), [Plane()]
    load = np.array([rod.weight * rod.gravito_bending_length for rod in rods])
    contact = Contact(
        batch,
        radius,
        _stiffness(rods, [t.fixtures for t in trials]),
        [t.friction for t in trials],
        [table if t.fixtures is None else list(t.fixtures.shapes) for t in trials],
        keeps_roll=np.array([sided[id(t.rod)] or t.trajectory.spin != 0.0 for t in trials]),
        friction_field=friction_field,
        passive=np.arange(batch.node_count) >= np.full((len(rods), 1), batch.node_count - ghosts),
    )
    dynamics = Dynamics.of(
        rods,
        batch,
        clamped=(False, ghosts > 0),
        **USUAL_DAMPING,
        scheme=discretisation.scheme,
        contact=contact,
        motion=GripMotion(
            batch, [setup.schedule for setup in setups], [rod.principal_angle for rod in rods]
        ),
        force_scale=load,
        tolerance=discretisation.tolerance,
        keeps_recording=keeps_recording,
    )
    if discretisation.tolerance >= _LOOSE:
        dynamics.shrinks = _SHRINKS
    return batch, contact, dynamics


def _stiffness(rods: list[RodModel], fixtures: list[Fixtures | None]) -> np.ndarray:
    """(rod,) contact stiffness per length [Pa].

    Fixtures carry the rod's bending, not its weight: a post presses with about k_b / L_gb^2, some
    2 w L_gb, on an edge or two.
    """
    sinking = [SINKING if f is None else _SINKING_AT_POSTS for f in fixtures]
    return np.array(
        [rod.weight / (part * rod.radius) for rod, part in zip(rods, sinking, strict=True)]
    )


def _batch(trials, models, setups, device) -> tuple[RodBatch, list[RodModel]]:
    """The rods as they are: with the L_gb that they have, not the one that the plan believed, and
    described in the directors of the laid rod, the first to its left, the second above it."""
    held: list[RodModel] = []
    known: dict[tuple, RodModel] = {}  # plans are compared by the same rods
    for trial, setup in zip(trials, setups, strict=True):
        roll, bent, length = trial.trajectory.roll, trial.disturbance, float(setup.arc_length[-1])
        key = id(trial.rod), roll, bent.lgb_error, bent.natural_curvature, length
        if key not in known:
            rod = models[id(trial.rod)]
            if setup.schedule.held_edge is not None:
                rod = replace(rod, length=length)
            rod = rod.stiffened((1.0 + bent.lgb_error) ** 3)
            known[key] = rod.turned(roll).bent(bent.natural_curvature)
        held.append(known[key])
    arc, position = (np.stack([getattr(s, n) for s in setups]) for n in ("arc_length", "position"))
    inner = edge = setups[0].schedule.held_edge
    if edge is None:
        edge, ghost = arc.shape[1] - 1, arc[:, 1:2] - arc[:, :1]
        turns = Rotation.from_quat([setup.schedule.rotation[0] for setup in setups])
        beyond = position[:, -1:] + (ghost * turns.apply([1, 0, 0]))[:, None]
        arc = np.concatenate([arc, arc[:, -1:] + ghost], axis=1)
        position = np.concatenate([position, beyond], axis=1)
    director = np.stack([setup.director for setup in setups])
    director = directors_at_rest(held, arc, position, director)
    batch = RodBatch.of(
        held, arc, position, clamped=(False, inner is None), held=inner, director=director,
        device=device,
    )  # fmt: skip
    # The grip holds the rods from the first step on.
    dof = np.arange(batch.dof_count)
    batch.set_free((dof < 4 * edge) | (dof >= 4 * edge + 7))
    return batch, held
