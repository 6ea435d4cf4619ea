"""Contact of rods with themselves and with each other, with Coulomb friction.

Newton's collision pipeline is not used: it works in float32 on rigid shapes, and its contacts
carry neither exact Hessians nor the history of friction that an implicit step of a rod needs.
"""

from functools import cached_property

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.contact import energies, pair_contact, touching
from wrod.kernels.contact import pairs as contact_pairs
from wrod.kernels.contact import rods as kernels
from wrod.kernels.contact.segments import AT_END, AT_START, EDGE, SPLINE
from wrod.kernels.lanes import lanes
from wrod.rods.batch import RodBatch
from wrod.rods.device import OnDevice
from wrod.solvers.friction import Friction, contact_damping
from wrod.solvers.kept_pairs import KeptPairs
from wrod.solvers.readback import read

# Pairs nearer along the rod than this many radii do not touch: half a turn of the tightest bend.
_SKIP = float(np.pi)
# Default stiffness, in EA / radius: the force EI / R^2 of a tight knot sinks 2.5 % of the radius.
_STIFFNESS = 10.0
# The normal force rises quadratically over this part of the radius.
_SKIN = 0.05
# What hardens does so from this depth on, over this way, both over the radius.
_HARD_DEPTH, _HARD_SKIN = 0.015, 0.01
# Threads of a GPU that share an edge's partners: in a knot it has several.
_SLOTS = 8

_IS_FRICTION = arguments.like("a wrod.Friction", "static", "kinetic")


class RodContact(OnDevice):
    """Contact between all edges of the rods that share a row of a batch (a scene).

    Edges are capsules around the centreline; `smooth` ones are tubes around a quadratic B-spline of
    the nodes, which has no corners that hold what should slide along it, and lies h^2 / (8 R) to
    the inside of a bend of radius R with edges of h. Pairs whose nearer ends are closer than pi
    radii along the rod are left out: a rod cannot touch itself within half a turn of its tightest
    bend. Friction acts between the surfaces, which roll on each other where the rods are free to
    spin. A step of `Dynamics` in which a node goes farther than `way` is refused and halved, so
    that nothing tunnels, and so is one in which edges meet that come nearer by more than half of
    that, so that they bounce. Posts and boxes are touched through
    `wrod.solvers.contact.Contact`.

    Args:
        batch: the rods, already cut (`RodBatch.cut`) where several share a row.
        radius: (rod,) or (rod, node - 1) radius of the section, or of every edge [length].
        friction: one for all rows, or one per row; `rolling` is without effect here.
        stiffness: (rod,) normal stiffness of a pair [force/length]; default: 10 EA / radius.
        tangential: tangential stiffness of a pair that sticks, over the normal one.
        restitution: (rod,) speed after an impact over that before; see `Contact`.
        skin: part of the radius over which the normal force rises quadratically. Newton halves the
            depth of what is pressed in that at best, so that loads should reach beyond it.
        hardening: stiffness of a pair that is deeper than 0.015 radii, over `stiffness` and on top
            of it: what is soft to what lies on it may stop what falls on it.
        partners: most edges that one edge can be near to and that come after it.
        passive: (rod, node - 1) edges that touch nothing; default: none.
        smooth: without corners along the rods, for rods that cross. Rods that wind around each
            other want edges: pieces of splines may touch in two places, and know one.
        way: how far a node may go in a step over the radius. Pairs are half a radius deep at most
            where steps end, so that they cannot have crossed on less than three radii between them.

    Attributes:
        settles_loads: whether steps iterate until the loads that bound friction are those of their
            end within 1e-10, as gradients want it, instead of a twentieth.
        time_step, iteration: (rod,) as of `Contact`.
        balance: (rod,) residual of the present iteration and the step's tolerance.
        velocity: (rod, dof) at the start of the present step.
        force: (rod, node) contact force on each node at the end of the last step.
        slip: (rod, edge) distance that each edge has slid on others in all [length].
        penetration: (rod,) deepest penetration at the end of the last step [length].
        mean_share: (rod, edge) part of each edge's radius in the mean one.

    Raises:
        RodError: radius or stiffness is not positive and finite, or does not broadcast; or the
            batch stands where its rods are inside each other.
    """

    settles_loads = False
    iteration: wp.array

    @arguments.checked(
        RodError,
        radius=arguments.numbers_of_any_shape,
        friction=arguments.either(_IS_FRICTION, arguments.several(_IS_FRICTION)),
        stiffness=arguments.optional(arguments.array((), (None,))),
        tangential=arguments.number(1e-4, 1.0),
        restitution=arguments.array((), (None,)),
        skin=arguments.number(1e-6, 1.0),
        hardening=arguments.number(0.0, 1e3),
        partners=arguments.whole(1, 4096),
        passive=arguments.optional(arguments.truths),
        way=arguments.number(1e-3, 1.25),
    )
    def __init__(
        self,
        batch: RodBatch,
        radius: np.ndarray | float,
        friction: Friction | list[Friction],
        *,
        stiffness: np.ndarray | float | None = None,
        tangential: float = 1.0,
        restitution: np.ndarray | float = 0.0,
        skin: float = _SKIN,
        hardening: float = 0.0,
        partners: int = 32,
        passive: np.ndarray | None = None,
        smooth: bool = False,
        way: float = 0.5,
    ):
        self.batch, device = batch, batch.device
        rods, nodes, edges = batch.rod_count, batch.node_count, batch.node_count - 1
        cut = np.zeros((rods, edges), dtype=bool)
        cut[:, list(batch.cut_edges)] = True
        radius = _per_edge(radius, rods, edges)
        idle = cut if passive is None else cut | _passive(passive, cut.shape)
        real = np.where(cut, 0.0, radius)
        mean_radius = real.sum(axis=1) / (~cut).sum(axis=1)
        self.mean_share = real / real.sum(axis=1, keepdims=True)
        if stiffness is None:
            stretching = np.where(cut, 0.0, batch.stretching_stiffness.numpy()).max(axis=1)
            stiffness = _STIFFNESS * stretching / mean_radius
        stiffness = arguments.spread(stiffness, (rods,), "RodContact: stiffness", RodError)
        if not (np.isfinite(stiffness) & (stiffness > 0)).all():
            raise RodError("contact stiffness must be positive and finite")
        rest = batch.rest_length.numpy()

        def floats(values):
            return wp.array(np.ascontiguousarray(values), dtype=wp.float64, device=device)

        def zeros(dtype, *shape):
            return wp.zeros((rods, *shape), dtype=dtype, device=device)

        restitution = arguments.spread(restitution, (rods,), "RodContact: restitution", RodError)
        # Two edges that meet move as one of half their mass.
        time = np.sqrt(0.5 * batch.node_mass.numpy().mean(axis=1) / stiffness)
        law = _laws(friction, mean_radius, stiffness, skin, hardening)
        law["tangential"] = tangential * stiffness
        law["relaxation"] = contact_damping(restitution) * time
        self.pieces = pieces = pair_contact.Pieces()
        pieces.law = wp.array(law, dtype=pair_contact.PairLaw, device=device)
        pieces.rest_length = batch.rest_length
        touching_radius, piece = np.where(idle, 0.0, radius), np.zeros(cut.shape, dtype=np.int32)
        if smooth:
            touching_radius, piece = _splines(cut, touching_radius)
        self.edge_radius = floats(touching_radius)
        pieces.radius = self.edge_radius
        pieces.kind = wp.array(piece, dtype=wp.int32, device=device)
        self._splines = int(smooth)
        self.reach = floats(way * np.where(cut, np.inf, radius).min(axis=1))
        self._largest_radius = floats(np.where(cut, 0.0, radius).max(axis=1))
        self._arc = floats(_arcs(rest, radius, cut))
        groups = -(-edges // int(contact_pairs.GROUP))
        self._lower, self._upper = zeros(wp.vec3d, groups), zeros(wp.vec3d, groups)
        self.partner_count = zeros(wp.int32, edges)
        self._slots = (rods, edges, lanes(device, _SLOTS))
        self.partner, self._new_partner, self.sliding, self._new_sliding = (
            zeros(wp.int32, edges, partners) for _ in range(4)
        )
        self.bristle, self._new_bristle = (zeros(wp.vec2d, edges, partners) for _ in range(2))
        # Normal forces at the last end, those that bound friction now, what these are off by.
        self.depth, self.load, self.held_load, self._new_load = (
            zeros(wp.float64, edges, partners) for _ in range(4)
        )
        self.overflow, self._renewed, self._renewals = (zeros(wp.int32) for _ in range(3))
        self.slip, self.penetration = zeros(wp.float64, edges), zeros(wp.float64)
        self.rubbing = pair_contact.Rubbing()
        self._share_friction(zeros(wp.int32), zeros(wp.vec2d, edges, partners))
        self.force = zeros(wp.vec3d, nodes)
        self.time_step = floats(np.full(rods, np.inf))
        self.balance = (floats(np.full(rods, np.inf)), floats(np.zeros(rods)))
        self.velocity = zeros(wp.float64, batch.dof_count)
        self.configuration: tuple[wp.array, ...] = ()
        self._check_start()

    def _share_friction(self, iteration: wp.array, dual: wp.array) -> None:
        """What kernels know of friction."""
        rubbing = self.rubbing
        rubbing.bristle, rubbing.load = self.bristle, self.held_load
        rubbing.sliding, rubbing.iteration = self.sliding, iteration
        rubbing.stretch, rubbing.dual = wp.zeros_like(dual), dual

    def bound_steps(self, starting: wp.array, wanted: wp.array) -> None:
        """Shorten the `wanted` steps (rod,) that start now to what may stand."""
        self.batch.launch_lanes(
            touching.bound_steps, [self.reach, starting, self.velocity], [wanted]
        )

    def prepare(self, starting: wp.array, dof: wp.array) -> None:
        """List the pairs that may touch in a step that starts at `dof`."""
        batch = self.batch
        batch.launch(
            contact_pairs.bound_groups,
            self._lower.shape,
            [self._splines, starting, dof],
            [self._lower, self._upper],
        )
        batch.launch(
            contact_pairs.list_partners,
            self.partner_count.shape,
            [self.pieces, self._arc, wp.float64(_SKIP), self.reach, self._largest_radius, starting]
            + [dof, self._lower, self._upper, self.partner_count, self.partner, self.bristle]
            + [self.load, self.sliding, self._new_partner, self._new_bristle, self._new_load]
            + [self._new_sliding],
            [self.overflow],
        )
        batch.launch(
            kernels.hold_loads,
            self.load.shape,
            [starting, self.load],
            [self.rubbing, self._renewals],
        )

    def add(self, active: wp.array, dof: wp.array, dof_before: wp.array) -> None:
        """Add forces at `dof` to the batch's gradient; their stiffness is for `CoupledSystem`."""
        self.configuration = (dof, dof_before)
        self.batch.launch(
            kernels.rod_contact,
            self._slots,
            [self.pieces, self.reach, self.time_step, active, dof, dof_before]
            + [self.partner_count, self.partner, self.rubbing, self.velocity, self._slots[2]],
            [self.batch.derivatives.gradient, self.depth, self._new_load, self._renewed],
        )

    def restart(self, chosen: wp.array) -> None:
        """Let the rows that are not 0 in `chosen` (rod,) touch everything for the first time."""
        self.batch.launch(
            contact_pairs.forget_partners, self.partner_count.shape, [chosen], [self.partner_count]
        )

    def refuse(
        self, converged: wp.array, active: wp.array, dof: wp.array, dof_before: wp.array
    ) -> None:
        """Take back the convergence of steps that are too large for nothing to tunnel, and of those
        whose friction belongs to loads that are not there any more."""
        self.batch.launch(
            kernels.renew_loads,
            self._slots,
            [self.pieces, self.reach, int(self.settles_loads)]
            + [self.time_step, converged, active, *self.balance]
            + [self._renewals, dof, dof_before, self.velocity]
            + [self.partner_count, self.partner, self.depth, self._new_load, self._slots[2]],
            [self.rubbing, self.batch.derivatives.gradient, self._renewed],
        )
        self.batch.launch_lanes(
            touching.refuse_large_steps,
            [self.edge_radius, self.reach, dof, dof_before, self.partner_count, self.partner]
            + [self.depth, self.overflow, self._renewed, self._renewals],
            [converged, active],
        )

    def find_touching(
        self, chosen: wp.array, dof: wp.array, dof_before: wp.array, touching: wp.array
    ) -> None:
        """Raise `touching` (rod,) of the chosen rods to 1 where they touch, to 2 in an impact."""
        self.batch.launch(
            kernels.find_touching,
            self.partner_count.shape,
            [self.pieces, self.reach, chosen, dof, dof_before] + [self.partner_count, self.partner],
            [touching],
        )

    def find_unknown(
        self, chosen: wp.array, dof: wp.array, dof_before: wp.array, touching: wp.array
    ) -> None:
        """Keep the pairs of the chosen rods for the adjoint; raise `touching` (rod,) to 1 where
        there are too many."""
        self.kept.keep(chosen, touching)

    @cached_property
    def kept(self) -> KeptPairs:
        """What the adjoint keeps."""
        return KeptPairs(self)

    def settle(self, accepted: wp.array, dof: wp.array, dof_before: wp.array) -> None:
        """Carry the friction of accepted steps over to the next."""
        self.batch.launch(
            kernels.clear_forces, self.force.shape, [accepted], [self.force, self.penetration]
        )
        self.batch.launch(
            kernels.settle_friction,
            self._slots,
            [self.pieces, self.time_step, accepted, dof, dof_before]
            + [self.partner_count, self.partner, self._new_load, self._slots[2]],
            [self.rubbing, self.load, self.slip, self.force, self.penetration],
        )

    def _check_start(self) -> None:
        batch = self.batch
        self.prepare(batch.every_rod, batch.state.dof)
        self.add(batch.every_rod, batch.state.dof, batch.state.dof)
        self.check_capacity()
        r, i, k = np.unravel_index(self.depth.numpy().argmax(), self.depth.shape)
        j, radius = self.partner.numpy()[r, i, k], self.edge_radius.numpy()[r]
        depth = self.depth.numpy()[r, i, k]
        if depth > 0.25 * (radius[i] + radius[j]):
            raise RodError(
                f"edges {i} and {j} of row {r} start {depth:.3g} inside each other; set their "
                "centrelines apart by the sum of their radii"
            )

    def forces(self) -> np.ndarray:
        """(rod, node, 3) contact force on each node at the end of the last step."""
        return self.force.numpy().copy()

    def energy(self) -> np.ndarray:
        """(rod,) elastic energy of what touches now, with that of its friction."""
        batch = self.batch
        energy = wp.zeros(batch.rod_count, dtype=wp.float64, device=batch.device)
        inputs = [self.pieces, batch.state.dof, self.partner_count, self.partner, self.rubbing]
        batch.launch(energies.add_pair_energy, self.partner_count.shape, inputs, [energy])
        return energy.numpy()

    def check_capacity(self) -> None:
        """Raise RodError if some edge was near to more edges than there is room for."""
        full = np.flatnonzero(read(self.overflow))
        if full.size:
            raise RodError(
                f"the rods of row {full[0]} touch in more places than there is room for; "
                f"use longer edges, or give RodContact more than {self.partner.shape[2]} partners"
            )


def _arcs(rest: np.ndarray, radius: np.ndarray, cut: np.ndarray) -> np.ndarray:
    """(rod, node) way along the row. Rods are strangers to each other: as far apart as can be."""
    far = 1e3 * (rest.sum(axis=1) + radius.sum(axis=1))[:, None]
    return np.pad(np.cumsum(np.where(cut, far, rest), axis=1), ((0, 0), (1, 0)))


def _splines(cut: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(rod, edge) radii and kinds of pieces of splines, of which piece i lies on edges i and i + 1;
    a rod of one edge keeps it."""
    after = np.pad(cut, ((0, 0), (0, 2)), constant_values=True)
    before = np.pad(cut, ((0, 0), (1, 0)), constant_values=True)[:, :-1]
    last = after[:, 1:-1]
    kind = np.int32(SPLINE) + AT_START * before + AT_END * after[:, 2:]
    alone = before & last
    following = np.pad(radius, ((0, 0), (0, 1)))[:, 1:]
    both = np.where((radius > 0) & (following > 0) & ~last, 0.5 * (radius + following), 0.0)
    return np.where(alone, radius, both), np.where(last, EDGE, kind).astype(np.int32)


def _laws(friction, radius, stiffness, skin: float, hardening: float) -> np.ndarray:
    """(rod,) laws of pairs, all but their bristles and damping."""
    law = np.zeros(len(radius), dtype=pair_contact.PairLaw.numpy_dtype())
    law["stiffness"], law["skin"], law["hardening"] = stiffness, skin * radius, hardening
    law["hard_depth"], law["hard_skin"] = _HARD_DEPTH * radius, _HARD_SKIN * radius
    rows = [friction] * len(radius) if isinstance(friction, Friction) else friction
    law["static_friction"] = [f.static for f in rows]
    law["kinetic_friction"] = [f.static if f.kinetic is None else f.kinetic for f in rows]
    return law


def _passive(value, shape: tuple[int, int]) -> np.ndarray:
    found = np.asarray(value)
    if found.shape not in (shape[1:], shape):
        raise RodError(f"RodContact: passive has shape {found.shape} and must have {shape}")
    return found


def _per_edge(radius, rods: int, edges: int) -> np.ndarray:
    """(rod, edge) radii."""
    radius = np.asarray(radius, dtype=float)
    if radius.ndim == 1:
        radius = radius[:, None]
    try:
        radius = np.broadcast_to(radius, (rods, edges))
    except ValueError:
        raise RodError(
            f"contact radius has shape {radius.shape}; give one per row or per edge, ({edges},)"
        ) from None
    if not (np.isfinite(radius) & (radius > 0)).all():
        raise RodError("contact radius must be positive and finite")
    return radius
