"""Where a plan's grasps come from: one function per method, from inputs to poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from wrod import arguments
from wrod.errors import GraspError
from wrod.grasps.mesh import MIRROR, MIRROR_ROTATION
from wrod.grasps.results import Grasps
from wrod.rods.model import Rod, RodModel

if TYPE_CHECKING:
    from wrod.controller.controller import Controller

# The suspended part must stay this long, in L_gb, at the last contact: grasps of a shorter rod
# put the gripper's fingers on the table, and the studied range begins here.
MIN_SUSPENDED_LENGTH = 1.0


@dataclass(frozen=True)
class GraspInputs:
    """What a grasp source is given: (T,) dimensionless lengths and curvatures of all nodes, the
    natural curvature (left, up) of the rod as it is held [1/L_gb], and the controller to ask; None
    is the one that ships, which knows straight rods. A rod that is more than uniform, isotropic and
    linear comes along with its roll [rad]; one that what lies holds twisted, with its twist (T,)
    [1/L_gb]. Eigenvalues, which say how near solved grasps are to instability, are left out where
    `eigenvalues` is false."""

    suspended_length: np.ndarray
    curvature: np.ndarray
    stretch_ratio: float
    closure: str
    device: arguments.DeviceLike = None
    progress: Callable[[int, int], object] | None = None
    natural_curvature: tuple[float, float] = (0.0, 0.0)
    poisson: float = 0.5
    controller: Controller | None = None
    rod: RodModel | None = None
    roll: float = 0.0
    eigenvalues: bool = True
    twist: np.ndarray | None = None

    @classmethod
    def of(
        cls,
        rod: Rod,
        suspended: np.ndarray,
        curvature: np.ndarray,
        *,
        roll: float = 0.0,
        closure: str = "zero_tension",
        **others,
    ) -> GraspInputs:
        """Inputs of a rod: suspended length (T,) [m] and curvature (T,) [1/m] at the contacts, and
        the roll that it is held at [rad] (see `RodMaterial.curvature_held`); `others` are fields
        as they are."""
        lgb = rod.gravito_bending_length
        left, up = rod.curvature_held(roll)
        model = RodModel.of(rod)
        return cls(
            # The maximum removes the rounding of a pattern that fills the rod.
            np.maximum(suspended / lgb, MIN_SUSPENDED_LENGTH),
            curvature * lgb,
            rod.stretch_ratio,
            closure,
            natural_curvature=(left * lgb, up * lgb),
            poisson=rod.poisson,
            rod=None if model.is_uniform and -1.0 < rod.poisson <= 0.5 + 1e-9 else model,
            roll=roll,
            **others,
        )

    @property
    def is_straight(self) -> bool:
        """Whether the rod is straight at rest."""
        return self.natural_curvature == (0.0, 0.0) and self.rod is None

    def at(self, nodes: np.ndarray) -> GraspInputs:
        """The inputs of some nodes."""
        length, curvature = self.suspended_length[nodes], self.curvature[nodes]
        return replace(self, suspended_length=length, curvature=curvature)


def _intuitive(inputs: GraspInputs) -> Grasps:
    """Grip straight above the contact, the rod hanging from it (Takizawa et al. 2015)."""
    length = inputs.suspended_length
    count = len(length)
    position = np.column_stack([np.zeros((count, 2)), length])
    upright = Rotation.from_rotvec([0.0, -np.pi / 2.0, 0.0])
    # With the twist that it has at rest.
    rolled = 0.0 if inputs.rod is None else float(inputs.rod.rolled(inputs.rod.length))
    rotation = (upright * Rotation.from_rotvec([rolled, 0.0, 0.0])).as_rotvec()
    return Grasps(
        position,
        np.tile(rotation, (count, 1)),
        np.full((count, 3), np.nan),
        twist=np.full(count, rolled) if rolled else None,
    )


def _of_varying_rod(inputs: GraspInputs) -> Grasps:
    """Optimal grasps of a rod whose properties depend on where it touches the table; where it has
    none, of a rod closer to straight."""
    from wrod.grasps.relaxed import solve_relaxed

    model, watch, count = inputs.rod, inputs.progress, len(inputs.suspended_length)
    lgb = model.gravito_bending_length
    force = model.mean_bending_stiffness / lgb**2
    at = np.maximum(model.length - inputs.suspended_length * lgb, 0.0)
    grasps, share = solve_relaxed(
        model,
        at,
        inputs.curvature / lgb,
        closure=inputs.closure,
        held_roll=inputs.roll,
        device=inputs.device,
    )
    if watch is not None:
        watch(count, count)
    # The grip holds the rod at one roll: its y axis is what was to the left where the rod begins.
    rolled = model.rolled(at)
    turn = Rotation.from_rotvec(rolled[:, None] * [1.0, 0.0, 0.0])
    return Grasps(
        grasps.position / lgb,
        (Rotation.from_rotvec(grasps.rotation) * turn).as_rotvec(),
        grasps.force / force,
        converged=grasps.converged,
        stable=grasps.stable,
        shape=grasps.shape / lgb,
        eigenvalue=grasps.eigenvalue * lgb**2 / force,
        twist=grasps.twist + rolled,
        natural_share=None if (share == 1.0).all() else share,
    )


def _numeric(inputs: GraspInputs) -> Grasps:
    """Optimal grasps from the rod solver."""
    from wrod.grasps import optimal

    if inputs.rod is not None:
        return _of_varying_rod(inputs)
    asked = inputs.suspended_length, inputs.curvature, inputs.stretch_ratio
    if inputs.twist is not None:
        return optimal.solve_twisted(
            *asked,
            inputs.twist,
            closure=inputs.closure,
            poisson=inputs.poisson,
            device=inputs.device,
        )

    count = len(inputs.suspended_length)
    watch = inputs.progress
    own: dict[str, Any] = {}
    if not inputs.is_straight:
        own = {"natural_curvature": inputs.natural_curvature, "poisson": inputs.poisson}
    return optimal.solve_grasps(
        *asked,
        closure=inputs.closure,
        device=inputs.device,
        eigenvalues=inputs.eigenvalues,
        progress=None if watch is None else lambda done: watch(done, count),
        **own,
    )


@cache
def _shipped(closure: str) -> Controller:
    """The controller of a closure that ships, or that of zero tension; read once."""
    from wrod.controller.controller import SHIPPED, Controller

    return Controller.load(closure=closure if closure in SHIPPED else "zero_tension")


def _neural(inputs: GraspInputs) -> Grasps:
    """Optimal grasps from the trained controller; out of its range it warns."""
    _refuse_varying(inputs)
    if inputs.controller is None and not inputs.is_straight:
        raise GraspError(
            "the controller that ships knows naturally straight rods only, and this one is curved "
            "at rest; train one for it with `wrod dataset --rod` and `wrod train`, or use method "
            "'numeric' or 'auto'"
        )
    controller = inputs.controller or _shipped(inputs.closure)
    if inputs.closure != controller.closure:
        raise GraspError(
            f"the controller knows closure {controller.closure!r} only, not {inputs.closure!r}; "
            "use method 'numeric' or 'auto'"
        )
    return _predicted(controller, inputs)


def _refuse_varying(inputs: GraspInputs) -> None:
    if inputs.rod is not None and inputs.controller is not None:
        raise GraspError(
            "controllers know uniform, isotropic, linear rods only, and this one has "
            f"{', '.join(inputs.rod.not_uniform())} of its own; use method 'numeric' or 'auto' "
            "without a controller"
        )


def _auto(inputs: GraspInputs) -> Grasps:
    """The controller where it was trained for closure and inputs, elsewhere the rod solver."""
    if inputs.rod is not None:
        _refuse_varying(inputs)
        return _numeric(inputs)
    controller = inputs.controller or _shipped(inputs.closure)
    known = ~controller.out_of_range(
        inputs.suspended_length, inputs.curvature, inputs.stretch_ratio
    )
    known &= inputs.closure == controller.closure
    if inputs.controller is None:
        known &= inputs.is_straight
    else:
        # One that was named for this plan and does not fit is a mistake.
        controller.side_of(inputs.natural_curvature, inputs.poisson)
    if known.all():
        return _predicted(controller, inputs)
    solved = _numeric(inputs.at(~known))
    if not known.any():
        return solved
    predicted = _predicted(controller, inputs.at(known))
    whole = {}
    for name in ("position", "rotation", "force", "converged", "stable", "twist"):
        value = getattr(solved, name)
        if value is None:
            continue
        whole[name] = np.empty((len(known), *value.shape[1:]), dtype=value.dtype)
        whole[name][~known] = value
        # The controller learnt from grasps that converged and are stable.
        given = getattr(predicted, name)
        whole[name][known] = True if given is None else given
    # Nobody has looked how close the predicted ones are to instability.
    if solved.eigenvalue is not None:
        whole["eigenvalue"] = np.full(len(known), np.inf)
        whole["eigenvalue"][~known] = solved.eigenvalue
    return Grasps(**whole)


def _predicted(controller: Controller, inputs: GraspInputs) -> Grasps:
    side = controller.side_of(inputs.natural_curvature, inputs.poisson)
    controller.warn_of_errors()
    position, rotation, force, twist = controller.predict_with_twist(
        inputs.suspended_length, side * inputs.curvature, inputs.stretch_ratio
    )
    if force is None:
        force = np.full_like(position, np.nan)
    if side < 0.0:
        position, rotation, force = MIRROR * position, MIRROR_ROTATION * rotation, MIRROR * force
        twist = None if twist is None else -twist
    return Grasps(position, rotation, force, twist=twist)


# A source takes the dimensionless inputs of every node and returns poses in the contact frame.
SOURCES: dict[str, Callable[[GraspInputs], Grasps]] = {
    "neural": _neural,
    "auto": _auto,
    "numeric": _numeric,
    "intuitive": _intuitive,
}
# The method that asks a network for what `friction` of `wrod.plan` otherwise optimises.
DISTILLED = "distilled"


def check_method(method: str, friction, pace, time_limit=None) -> None:
    """Refuse what is no method of a plan for a table of that friction, if any.

    Raises:
        GraspError: it is unknown, or what else is asked for does not go with it.
    """
    if method not in (*SOURCES, DISTILLED):
        names = ", ".join((*SOURCES, DISTILLED))
        raise GraspError(f"unknown method {method!r}; use one of {names}")
    if method == DISTILLED and friction is None:
        raise GraspError(f"method {DISTILLED!r} corrects a plan for a table; say its friction")
    for name, value in (("pace", pace), ("time_limit", time_limit)):
        if value is not None and (friction is None or method == DISTILLED):
            raise GraspError(
                f"{name} is of a plan that is optimised for a table; leave it out, or optimise"
            )
    if method == "intuitive" and friction is not None:
        raise GraspError(
            "friction corrects optimal grasps, and method 'intuitive' has none; leave one out"
        )
