"""The motion of rods as a differentiable function of torch tensors, by the adjoint of its steps.

A step solves r(y_n, y_(n-1), ..., v_(n-1), ...; p) = 0. Backwards, with what the loss wants of y_n,

    A_n w = dL/dy_n,    dL/dp -= w . dr/dp,    dL/dy_(n-1) -= w . dr/dy_(n-1), ...,

A_n the matrix of the step: one solution a step, whatever is differentiated by. What turning frames
do to the inertia of an edge's spin is left out: of the square of radius over length.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
import warp as wp
from wrod.training.autograd import tensor

from wrod import arguments
from wrod.errors import RodError
from wrod.rods.batch import RodBatch
from wrod.rods.state import Derivatives, RodState
from wrod.solvers.banded import BandedSystem
from wrod.solvers.dynamics import Dynamics

# Of `RodBatch.elastic_model`: what is scaled for stretching, bending and twisting.
_STRETCHING, _BENDING, _TWISTING = 1, 2, 6
# Of the steps: what is left unbalanced is missing from the gradients.
_TOLERANCE = 1e-11


class Scene(NamedTuple):
    """What tensors do not say of a motion; see `move_differentiable`."""

    batch: RodBatch
    columns: torch.Tensor
    step: float
    steps: int
    options: dict


class _Path:
    """Puts held nodes where they are at the end of a step: a `wrod.solvers.steps.Motion`."""

    def __init__(self, scene: Scene, path: torch.Tensor):
        self.scene, self.path, self.now = scene, path, 0

    def prescribe(self, running, time, step, start) -> None:
        dof = wp.to_torch(self.scene.batch.state.dof)
        dof[:, self.scene.columns] = self.path[:, self.now].reshape(len(dof), -1)


class _Move(torch.autograd.Function):
    @staticmethod
    def forward(ctx, position, velocity, stiffness, gravity, path, scene):
        batch = scene.batch
        now = [*batch.elastic_model, batch.gravity]
        before = [wp.clone(a) for a in now]
        state = RodState.zeros(batch.rod_count, batch.node_count, batch.device)
        state.assign(batch.state)
        try:
            return _forward(ctx, position, velocity, stiffness, gravity, path, scene)
        finally:
            for array, values in zip(now, before, strict=True):
                wp.copy(array, values)
            batch.state.assign(state)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, gradient):
        return *_backward(ctx, gradient), None


def _forward(ctx, position, velocity, stiffness, gravity, path, scene: Scene) -> torch.Tensor:
    batch = scene.batch
    rods, nodes = batch.rod_count, batch.node_count
    wp.to_torch(batch.gravity)[:] = gravity
    for part, place in enumerate((_STRETCHING, _BENDING, _TWISTING)):
        values = wp.to_torch(batch.elastic_model[place])
        values *= stiffness[:, part].reshape(-1, *(1,) * (values.ndim - 1))
    frames = wp.to_torch(batch.state.tangent).clone()
    dof = wp.to_torch(batch.state.dof)
    for c in range(3):
        dof[:, c::4] = position[:, :, c]
    batch.transport_frames(batch.state, batch.state, batch.every_rod)
    motion = _Path(scene, path) if len(scene.columns) else None
    dynamics = Dynamics(batch, motion=motion, **scene.options)
    speed = torch.zeros((rods, nodes, 4), dtype=torch.float64, device=dof.device)
    speed[:, :, :3] = velocity
    wp.to_torch(dynamics.velocity)[:] = speed.reshape(rods, -1)[:, :-1]
    ctx.turned = _holonomy(frames, position)
    mass, air = wp.to_torch(dynamics.mass), wp.to_torch(dynamics.air_damping)[:, None]
    at = Derivatives.zeros(rods, batch.dof_count, batch.device)
    places, ctx.records = [position.clone()], []
    for n in range(scene.steps):
        if motion is not None:
            motion.now = n
        done = dynamics.advance((n + 1) * scene.step, scene.step)
        if done.diverged.any() or (done.steps != n + 1).any():
            raise RodError(
                f"step {n} of rod {int(done.steps.argmin())} had to be cut; take shorter"
            )
        rates = wp.to_torch(dynamics.coefficient).clone() / scene.step
        batch.evaluate(order=2, out=at)
        matrix = wp.clone(at.hessian)
        rate = rates[:, :1]
        wp.to_torch(matrix)[:, :, 0] += mass * rate * (rate + air)
        forces = _parts(batch, at) if ctx.needs_input_grad[2] else ()
        places.append(_positions(wp.to_torch(batch.state.dof)))
        ctx.records.append((rates, matrix, forces, *_turns(places[-2], places[-1])))
    ctx.save_for_backward(stiffness, mass.clone(), air.clone())
    ctx.free = wp.to_torch(batch.free).clone() != 0
    ctx.scene = scene
    ctx.weighing = wp.to_torch(batch.node_mass) * wp.to_torch(batch.load_factor)[:, None]
    return torch.stack(places, dim=1)


def _holonomy(before: torch.Tensor, position: torch.Tensor) -> torch.Tensor:
    """(rod, edge, 3) by how much a frame turns that is carried from the tangents before to an edge,
    by the edge's last node."""
    edge = position[:, 1:] - position[:, :-1]
    length = edge.norm(dim=2, keepdim=True)
    tangent = edge / length
    cosine = (before * tangent).sum(dim=2, keepdim=True)
    return -torch.linalg.cross(before, tangent) / (1.0 + cosine) / length


def _turns(before: torch.Tensor, after: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """`_holonomy` of the edges of a step, by their last node at its end and at its start."""
    old, new = (torch.nn.functional.normalize(torch.diff(q, dim=1), dim=2) for q in (before, after))
    return _holonomy(old, after), -_holonomy(new, before)


def _add_turned(dof: torch.Tensor, turns: torch.Tensor, by_angle: torch.Tensor) -> None:
    """Add what the loss wants of nodes (rod, dof) because of how frames turn with their edges."""
    by_node = by_angle[:, :, None] * turns
    for c in range(3):
        dof[:, c + 4 :: 4] += by_node[:, :, c]
        dof[:, c:-3:4] -= by_node[:, :, c]


def _parts(batch: RodBatch, at: Derivatives) -> list[torch.Tensor]:
    """(rod, dof) forces of stretching, bending and twisting."""

    def without(*places: int) -> list:
        model = batch.elastic_model
        return [wp.zeros_like(a) if k in places else a for k, a in enumerate(model)]

    whole = _elastic(batch, batch.elastic_model, at)
    stretching = whole - _elastic(batch, without(_STRETCHING), at)
    twisting = whole - _elastic(batch, without(_TWISTING), at)
    return [stretching, whole - stretching - twisting, twisting]


def _elastic(batch: RodBatch, model: list, at: Derivatives) -> torch.Tensor:
    """(rod, dof) elastic forces of a model, without loads."""
    batch.evaluate(order=1, out=at, model=model)
    out = wp.to_torch(at.gradient).clone()
    load = wp.to_torch(batch.node_mass)[:, :, None] * wp.to_torch(batch.gravity)[:, None]
    load = wp.to_torch(batch.load_factor)[:, None, None] * (load + wp.to_torch(batch.point_load))
    for c in range(3):
        out[:, c::4] += load[:, :, c]
    return out


def _positions(dof: torch.Tensor) -> torch.Tensor:
    return torch.stack([dof[:, c::4] for c in range(3)], dim=2)


def _backward(ctx, gradient: torch.Tensor) -> tuple:
    scene: Scene = ctx.scene
    batch, columns = scene.batch, scene.columns
    stiffness, mass, air = ctx.saved_tensors
    rods, count = gradient.shape[:2]
    wanted = torch.zeros((count, rods, batch.dof_count), dtype=torch.float64, device=mass.device)
    for c in range(3):
        wanted[:, :, c::4] = gradient[..., c].transpose(0, 1)
    speeds = torch.zeros_like(wanted)
    system = BandedSystem(batch)
    by_stiffness, by_gravity = torch.zeros_like(stiffness), mass.new_zeros((rods, 3))
    by_path = mass.new_zeros((rods, count - 1, len(columns)))
    for n in range(count - 1, 0, -1):
        rates, matrix, forces, *turns = ctx.records[n - 1]
        ago = [rates[:, k : k + 1] for k in range(3)]
        for k in range(min(3, n + 1)):
            wanted[n - k] += ago[k] * speeds[n]
        wp.to_torch(system.x)[:, 0] = wanted[n] * ctx.free
        system.factorise(matrix, batch.every_rod)
        system.solve(batch.every_rod)
        w = wp.to_torch(system.x)[:, 0] * ctx.free
        # What is not free stays where it was, but for what goes along the path; its frames turn.
        rest = (wanted[n] - _multiply(wp.to_torch(matrix), w)) * ~ctx.free
        by_angle = rest[:, 3::4].clone()
        _add_turned(rest, turns[0], by_angle)
        by_path[:, n - 1] = rest[:, columns]
        rest[:, columns] = 0.0
        wanted[n - 1] += rest
        _add_turned(wanted[n - 1], turns[1], by_angle)
        pushed = mass * w
        for k in range(1, min(3, n + 1)):
            wanted[n - k] -= ago[k] * (ago[0] + air) * pushed
            speeds[n - k] -= ago[k] * pushed
        for part, force in enumerate(forces):
            by_stiffness[:, part] -= (w * force).sum(dim=1) / stiffness[:, part]
        by_gravity += (ctx.weighing[:, :, None] * _positions(w)).sum(dim=1)
    _add_turned(wanted[0], ctx.turned, wanted[0, :, 3::4].clone())
    at_start = _positions(wanted[0]), _positions(speeds[0])
    return *at_start, by_stiffness, by_gravity, by_path


def _multiply(band: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """Matrix of which `band` (rod, dof, 11) is the lower part, times x (rod, dof)."""
    out = band[:, :, 0] * x
    for k in range(1, band.shape[2]):
        out[:, k:] += band[:, k:, k] * x[:, :-k]
        out[:, :-k] += band[:, k:, k] * x[:, k:]
    return out


@arguments.checked(
    RodError,
    **dict.fromkeys(("position", "velocity", "stiffness", "gravity", "path"), tensor),
    step=arguments.number(above=0.0),
    steps=arguments.whole(1, 10**6),
    radius=arguments.number(above=0.0),
    held=arguments.indices,
    air_damping=arguments.number(0.0),
)
def move_differentiable(
    batch: RodBatch,
    position: torch.Tensor,
    velocity: torch.Tensor,
    *,
    step: float,
    steps: int,
    radius: float,
    stiffness: torch.Tensor | None = None,
    gravity: torch.Tensor | None = None,
    held: Sequence[int] = (),
    path: torch.Tensor | None = None,
    scheme: str = "bdf2",
    air_damping: float = 0.0,
) -> torch.Tensor:
    """Where the nodes of rods that touch nothing are after each of so many steps of `Dynamics`,
    with gradients by all tensors: one solution a step, however many they are.

    Args:
        batch: the rods, with node masses, and what is not free; it stays as it is. Material frames
            begin as those of its state, carried along from there to `position`.
        position, velocity: (rod, node, 3) at the beginning.
        step, steps: length of the time steps, and how many.
        radius: of the rods, for the inertia of their spin.
        stiffness: (rod, 3) factors of stretching, bending and twisting stiffness; default: 1.
        gravity: (rod, 3); default: the batch's.
        held: nodes that are moved along `path`; they are not free in the batch.
        path: (rod, steps, held, 3) where they are at the end of each step.
        scheme: "bdf2" or "euler".
        air_damping: as of `Dynamics`.

    Returns:
        (rod, steps + 1, node, 3) positions, the first those at the beginning.

    Raises:
        RodError: a rod has laws of its own or a past, a held node is free, an angle is held
            between free nodes, shapes do not fit, or a step did not converge.
    """
    rods, nodes = batch.rod_count, batch.node_count
    if scheme not in ("euler", "bdf2"):
        raise RodError(f"gradients of scheme {scheme!r} are not there; use euler or bdf2")
    if batch.energies or batch.layers or batch.inelastic is not None:
        raise RodError("gradients of motion know the linear and the softening law only")
    dof = wp.to_torch(batch.state.dof)
    if stiffness is None:
        stiffness = torch.ones((rods, 3), dtype=torch.float64, device=dof.device)
    gravity = wp.to_torch(batch.gravity).clone() if gravity is None else gravity
    if not all(0 <= i < nodes for i in held):
        raise RodError(f"held is {arguments.shown(held)}; give nodes from 0 to {nodes - 1}")
    columns = torch.tensor([4 * i + c for i in held for c in range(3)], dtype=torch.long)
    if len(columns) and (wp.to_torch(batch.free)[:, columns] != 0).any():
        raise RodError("held nodes must not be free in the batch; take them out by set_free")
    free = torch.nn.functional.pad(wp.to_torch(batch.free), (0, 1)).reshape(rods, nodes, 4)
    moves = free[:, :, :3].any(dim=2)
    if ((free[:, :-1, 3] == 0) & (moves[:, 1:] | moves[:, :-1])).any():
        raise RodError("gradients of motion know angles that are held between held nodes only")
    if path is None:
        path = torch.zeros((rods, steps, len(held), 3), dtype=torch.float64, device=dof.device)
    shapes = ((position, (rods, nodes, 3)), (velocity, (rods, nodes, 3)), (stiffness, (rods, 3)),
              (gravity, (rods, 3)), (path, (rods, steps, len(held), 3)))  # fmt: skip
    for value, shape in shapes:
        if tuple(value.shape) != shape or value.dtype != torch.float64:
            raise RodError(f"a tensor is {tuple(value.shape)}; give {shape} in float64")
    options = dict(scheme=scheme, radius=radius, air_damping=air_damping, tolerance=_TOLERANCE,
                   refuses_saddles=False)  # fmt: skip
    scene = Scene(batch, columns, step, steps, options)
    return _Move.apply(position, velocity, stiffness, gravity, path.flatten(2), scene)
