"""Optimal grasps of a rod whose properties vary along it, in SI units.

Where a rod is not the same everywhere, its grasp depends on which part of it hangs: on the arc
length of the contact, not on the suspended length alone.
"""

from dataclasses import dataclass, replace

import numpy as np

from wrod import arguments
from wrod.errors import GraspError
from wrod.grasps.general import RodArrays, solve_general
from wrod.grasps.inputs import GraspOptions, check_inputs, closure_number
from wrod.grasps.mesh import WEIGHT, two_sided_rest_lengths
from wrod.grasps.optimal import EDGE_COUNT
from wrod.grasps.remembering import History, in_order, solve_in_order
from wrod.grasps.results import Grasps, rows, same_rows
from wrod.records import brief, checked_fields
from wrod.rods.device import resolve_device
from wrod.rods.discretisation import mesh_arrays, models_of
from wrod.rods.law import Linear
from wrod.rods.model import Rod, RodModel
from wrod.solvers.recording import launching


@checked_fields(
    GraspError,
    **dict.fromkeys(
        ("arc_length", "curvature", "twist", "converged", "stable", "iterations", "residual",
         "eigenvalue", "growth"),
        rows(),
    ),
    **dict.fromkeys(("position", "rotation", "force"), rows(3)),
    force_jacobian=rows(3, 3), shape=rows(None, 3), node_arc_length=rows(None),
    length_unit=arguments.number(above=0.0), force_unit=arguments.number(above=0.0),
)  # fmt: skip
@brief
@dataclass(frozen=True, eq=False)
class RodGrasps:
    """Optimal grasps of one rod, one per contact; SI units, contact frame (x along the pattern, z
    up), float64 NumPy.

    Attributes:
        arc_length: (n,) of the contacts on the rod [m].
        curvature: (n,) of the pattern there [1/m].
        position: (n, 3) grip position [m].
        rotation: (n, 3) rotation vector of the rod's frame at the grip, which is that of the
            contact frame at the contact [rad].
        force: (n, 3) force on the suspended rod at the contact [N].
        force_jacobian: (n, 3, 3) derivative of `force` by the grip position [N/m]; see `Grasps`.
        twist: (n,) angle by which the rod is twisted between contact and grip [rad].
        shape: (n, node, 3) the rod from contact to grip [m].
        node_arc_length: (n, node) arc length of its nodes on the rod [m].
        converged, stable, iterations: see `Grasps`.
        residual: (n,) largest unbalanced force [N].
        eigenvalue: (n,) smallest eigenvalue of the held rod's Hessian, per length [N/m^2].
        growth: (n,) rate at which small departures of what is laid grow with its length, negative
            where they die out; see `wrod.grasps.growth` [1/m].
        length_unit, force_unit: in which the solver works: L_gb [m] and k_b / L_gb^2 [N] of the
            uniform rod of mean properties.
    """

    arc_length: np.ndarray
    curvature: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    force: np.ndarray
    force_jacobian: np.ndarray
    twist: np.ndarray
    shape: np.ndarray
    node_arc_length: np.ndarray
    converged: np.ndarray
    stable: np.ndarray
    iterations: np.ndarray
    residual: np.ndarray
    eigenvalue: np.ndarray
    growth: np.ndarray
    length_unit: float
    force_unit: float

    def __post_init__(self) -> None:
        same_rows(self)

    def __len__(self) -> int:
        return len(self.position)


@launching()
@arguments.checked(
    GraspError,
    arc_length=arguments.array((), (None,)),
    curvature=arguments.array((), (None,)),
    held_roll=arguments.optional(arguments.array((), (None,), finite=False)),
    natural_share=arguments.array((), (None,)),
    edge_count=arguments.whole(4, 4096),
    threads=arguments.optional(arguments.whole(0, 4096)),
)
def solve_rod_grasps(
    rod: Rod,
    arc_length,
    curvature,
    *,
    closure: str = "zero_tension",
    held_roll: np.ndarray | float | None = None,
    natural_share: np.ndarray | float = 1.0,
    device: str | None = None,
    edge_count: int = EDGE_COUNT,
    extrapolate: bool = True,
    threads: int | None = None,
) -> RodGrasps:
    """Optimal grasps of a rod held at its end, while it is laid from its beginning.

    One that stays bent (`wrod.rods.law.Plastic`, `Dahl`) is laid through these contacts, in their
    order: to the first it is bent from its natural shape, slowly and at once, and at each other one
    it is what those before have left of it (`wrod.grasps.remembering`).

    Args:
        rod: a `RodModel` or a `RodMaterial`.
        arc_length: (n,) arc length of the contacts, from the end that is laid first [m].
        curvature: signed curvature of the pattern there [1/m], (n,) or one for all.
        closure: "zero_tension", "min_force" or "min_friction".
        held_roll: the roll that the rod is held at, as `Trajectory.roll` and `wrod.plan` count it:
            of its first material director, where the rod begins, from left towards up, (n,) or one
            for all [rad]. A rod that is curved at rest or bends more easily to one side needs it.
        natural_share: of the rod's natural curvature, (n,) or one for all: with less than 1 the
            grasps are those of a rod that is closer to straight (see `wrod.grasps.relaxed`).
        device, edge_count, extrapolate, threads: see `wrod.solve_grasps`.

    Raises:
        GraspError: no contact or one that is not on the rod, a value that is not finite or, in
            L_gb, outside what can be solved, an unknown closure, no `held_roll` of a rod that has
            sides, or contacts that do not increase of a rod that remembers.
    """
    number = closure_number(closure)
    if edge_count < 16 or edge_count % 4:
        raise GraspError(f"edge_count is {edge_count}; use a multiple of four from 16")
    model = models_of(rod)[0]
    law = model.law
    model = replace(model, law=law.at_rest or Linear())
    asked = _contacts(model, arc_length, curvature)
    contact, given = asked, np.arange(len(asked))
    if law.at_rest is None:
        contact, given = in_order(asked, model.gravito_bending_length)
        curvature, held_roll, natural_share = (
            value if np.size(value) <= 1 else np.interp(contact, asked, value)
            for value in (curvature, held_roll, natural_share)
        )
    roll = _from_up(model, contact, held_roll)
    lgb, bending = _units(model)
    stretch = mesh_arrays(model, np.linspace(0.0, model.length, 257))["stretching_stiffness"].mean()
    scaled = np.asarray(curvature, dtype=np.float64) * lgb
    length, kappa, ratio = check_inputs(
        (model.length - contact) / lgb, scaled, stretch * lgb**2 / bending
    )

    share = arguments.spread(
        natural_share, contact.shape, "solve_rod_grasps: natural_share", GraspError
    )

    def rods(edges: int) -> RodArrays:
        arrays = _on_meshes(model, contact, length, edges, lgb, bending)
        return arrays | {"natural_curvature": arrays["natural_curvature"] * share[:, None, None]}

    options = GraspOptions(
        number, resolve_device(device), edge_count, extrapolate, True, True, threads, None
    )
    inputs = length, kappa, ratio
    roll = roll + model.principal_angle
    if law.at_rest is None:
        meshes = {edges: rods(edges) for edges in (edge_count // 2, edge_count)}
        history = History(law.scaled(lgb, 1.0), contact / lgb, length, meshes)
        found = solve_in_order(history, inputs, roll, options)
    else:
        found = solve_general(*inputs, rods, roll, options)
    grasps = Grasps(**{name: value[given] for name, value in found.items()})
    return _in_si(grasps, contact[given], kappa[given], lgb, bending / lgb**2)


def _contacts(model: RodModel, arc_length, curvature) -> np.ndarray:
    """(n,) arc lengths of the contacts [m], checked."""
    contact = np.atleast_1d(np.asarray(arc_length, dtype=np.float64))
    if np.shape(curvature) not in ((), (1,), contact.shape):
        raise GraspError(
            f"curvature has shape {np.shape(curvature)} for {len(contact)} contacts; give one for "
            "each, or one for all"
        )
    if contact.size == 0:
        raise GraspError("arc_length holds no contact; give at least one")
    if contact.ndim != 1 or not ((contact >= 0.0) & (contact < model.length)).all():
        raise GraspError(f"arc_length must be (n,) from 0 to below the rod's {model.length:g} m")
    return contact


def _from_up(model: RodModel, contact: np.ndarray, held_roll) -> np.ndarray:
    """(n,) angle from up to the first material director at the contacts [rad]."""
    if held_roll is None:
        if model.has_sides:
            raise GraspError(
                "this rod is curved at rest or bends more easily to one side, so that it matters "
                "how it is held; give held_roll, the angle from left towards up, as Trajectory.roll"
            )
        return np.zeros(contact.shape)
    held = np.asarray(held_roll, dtype=np.float64)
    if not np.isfinite(held).all() or held.shape not in ((), (1,), contact.shape):
        raise GraspError(
            f"held_roll is {held!r:.80}; give an angle in radians, or one for each contact"
        )
    # Where the rod is twisted at rest its first director turns along the laid part.
    return held + model.rolled(contact) - 0.5 * np.pi


def _in_si(grasps: Grasps, contact, curvature, lgb: float, force: float) -> RodGrasps:
    """Dimensionless grasps in SI, by the units of length [m] and force [N]."""
    return RodGrasps(
        arc_length=contact,
        curvature=curvature / lgb,
        position=lgb * grasps.position,
        rotation=grasps.rotation,
        force=force * grasps.force,
        force_jacobian=force / lgb * grasps.force_jacobian,
        twist=grasps.twist,
        shape=lgb * grasps.shape,
        node_arc_length=contact[:, None] + lgb * grasps.arc_length,
        converged=grasps.converged,
        stable=grasps.stable,
        iterations=grasps.iterations,
        residual=force * grasps.residual,
        eigenvalue=force / lgb**2 * grasps.eigenvalue,
        growth=grasps.growth / lgb,
        length_unit=lgb,
        force_unit=force,
    )


def _units(model: RodModel) -> tuple[float, float]:
    """L_gb [m] and k_b [N m^2] of the uniform straight rod that the solver starts from."""
    arrays = mesh_arrays(model, np.linspace(0.0, model.length, 257))
    bending = float(arrays["bending_stiffness"].mean())
    weight = float(arrays["node_mass"].sum()) * model.gravity / model.length
    # The weight per length is WEIGHT k_b / L_gb^3.
    return (WEIGHT * bending / weight) ** (1.0 / 3.0), bending


def _on_meshes(
    model: RodModel, contact: np.ndarray, length: np.ndarray, edges: int, lgb: float, bending: float
) -> RodArrays:
    """The part from contact to grip, dimensionless."""
    rest = two_sided_rest_lengths(length, edges)
    nodes = np.concatenate([-rest[:, :1], np.zeros_like(rest[:, :1]), np.cumsum(rest, axis=1)], 1)
    arrays = mesh_arrays(model, contact[:, None] + lgb * nodes)
    force = bending / lgb**2
    twist = arrays["natural_twist"][:, 1:] * lgb
    # The laid rod lies with the twist that it has at rest: nothing twists it at the contact. What
    # half of the first edge has of it is the next node's.
    twist[:, 1] += twist[:, 0] * rest[:, 0] / (rest[:, 0] + rest[:, 1])
    twist[:, 0] = 0.0
    softening = arrays["softening"][:, 1:].copy()
    softening[..., 0] /= lgb**2
    # What lies before the contact rests on the table.
    weight = arrays["node_mass"][:, 1:] * (model.gravity / force)
    weight[:, 0] *= 0.5
    return RodArrays(
        rest_length=rest,
        stretching_stiffness=arrays["stretching_stiffness"][:, 1:] / force,
        bending_stiffness=arrays["bending_stiffness"][:, 1:] / bending,
        twisting_stiffness=arrays["twisting_stiffness"][:, 1:] / bending,
        natural_curvature=arrays["natural_curvature"][:, 1:] * lgb,
        natural_twist=twist,
        softening=softening,
        weight=weight,
    )
