"""The motion of rods as a differentiable function of torch tensors, by the adjoint of its steps
(`wrod.solvers.adjoint`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import warp as wp
from wrod.training.autograd import tensor

from wrod import arguments
from wrod.errors import RodError, needed_extras
from wrod.rods.batch import RodBatch
from wrod.rods.state import RodState
from wrod.solvers.adjoint import StepAdjoint
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.trace import Trace, require_differentiable

with needed_extras():
    import torch

# Of `RodBatch.elastic_model`: what is scaled for stretching, bending and twisting.
_SCALED = ("stretching", "bending", "twisting")
# Of the steps: what is left unbalanced is missing from the gradients.
_TOLERANCE = 1e-11


class Setting(NamedTuple):
    """What tensors do not say of a motion; see `move_differentiable`."""

    batch: RodBatch
    columns: torch.Tensor
    step: float
    steps: int
    options: dict


class _Path:
    """Puts held nodes where they are at the end of a step: a `wrod.solvers.steps.Motion`."""

    def __init__(self, setting: Setting, path: torch.Tensor):
        self.setting, self.path, self.now = setting, path, 0

    def prescribe(self, running, time, step, start) -> None:
        dof = wp.to_torch(self.setting.batch.state.dof)
        dof[:, self.setting.columns] = self.path[:, self.now].reshape(len(dof), -1)


@contextmanager
def _changed(batch: RodBatch, stiffness: torch.Tensor, gravity: torch.Tensor) -> Iterator[None]:
    """The rods with their stiffnesses scaled, under that gravity; then as they were."""
    scaled = [getattr(batch.elastic_model, name) for name in _SCALED]
    now = [*scaled, batch.gravity]
    before = [wp.clone(a) for a in now]
    state = RodState.zeros(batch.rod_count, batch.node_count, batch.device)
    state.assign(batch.state)
    wp.to_torch(batch.gravity)[:] = gravity
    for part, array in enumerate(scaled):
        values = wp.to_torch(array)
        values *= stiffness[:, part].reshape(-1, *(1,) * (values.ndim - 1))
    try:
        yield
    finally:
        for array, values in zip(now, before, strict=True):
            wp.copy(array, values)
        batch.state.assign(state)


class _Move(torch.autograd.Function):
    @staticmethod
    def forward(ctx, position, velocity, stiffness, gravity, path, setting):
        ctx.setting = setting
        ctx.save_for_backward(position, stiffness, gravity)
        with _changed(setting.batch, stiffness, gravity):
            return _forward(ctx, position, velocity, path, setting)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, gradient):
        _, stiffness, gravity = ctx.saved_tensors
        with _changed(ctx.setting.batch, stiffness, gravity):
            return *_backward(ctx, gradient), None


def _forward(ctx, position, velocity, path, setting: Setting) -> torch.Tensor:
    batch = setting.batch
    ctx.frames = wp.to_torch(batch.state.tangent).clone()
    _positions(wp.to_torch(batch.state.dof))[:] = position
    batch.transport_frames(batch.state, batch.state, batch.every_rod)
    motion = _Path(setting, path) if len(setting.columns) else None
    dynamics = ctx.dynamics = Dynamics(batch, motion=motion, **setting.options)
    require_differentiable(dynamics)
    dynamics.refuses_saddles = False
    dynamics.follower = trace = Trace(dynamics, room=1)
    _positions(wp.to_torch(dynamics.velocity))[:] = velocity
    places, ctx.records = [position.clone()], []
    for n in range(setting.steps):
        if motion is not None:
            motion.now = n
        done = dynamics.advance((n + 1) * setting.step, setting.step)
        if done.diverged.any() or (done.steps != n + 1).any():
            raise RodError(
                f"step {n} of rod {int(done.steps.argmin())} had to be cut; take shorter"
            )
        ctx.records.append(trace.take())
        places.append(_positions(wp.to_torch(batch.state.dof)).clone())
    return torch.stack(places, dim=1)


def _positions(dof: torch.Tensor) -> torch.Tensor:
    """(rod, node, 3) view of the nodes' part of (rod, dof)."""
    rods, nodes = len(dof), (dof.shape[1] + 1) // 4
    return dof.as_strided((rods, nodes, 3), (dof.stride(0), 4, 1))


def _backward(ctx, gradient: torch.Tensor) -> tuple:
    setting: Setting = ctx.setting
    batch, columns = setting.batch, setting.columns
    position, stiffness, _ = ctx.saved_tensors
    moved = torch.zeros((batch.rod_count, batch.dof_count), dtype=torch.int32)
    moved[:, columns] = 1
    adjoint = StepAdjoint(ctx.dynamics, moved.numpy())
    wanted = wp.to_torch(adjoint.now.dof)
    held = wp.to_torch(adjoint.held)
    by_path = gradient.new_zeros((batch.rod_count, setting.steps, len(columns)))
    for n in reversed(range(setting.steps)):
        _positions(wanted)[:] += gradient[:, n + 1]
        adjoint.go_back(ctx.records[n])
        by_path[:, n] = held[:, columns]
    adjoint.settle(batch.every_rod)
    by_position = _positions(wanted) + gradient[:, 0]
    # The frames, too, come from where they were before.
    turned = _holonomy(ctx.frames, position)
    turned *= (wanted[:, 3::4] + wp.to_torch(adjoint.now.turn))[:, :, None]
    by_position[:, 1:] += turned
    by_position[:, :-1] -= turned
    by_velocity = _positions(wp.to_torch(adjoint.now.velocity)).clone()
    model = adjoint.model
    parts = []
    for name in _SCALED:
        wants, scaled = (wp.to_torch(getattr(m, name)) for m in (model, batch.elastic_model))
        parts.append((wants * scaled).flatten(1).sum(dim=1))
    by_stiffness = torch.stack(parts, dim=1) / stiffness
    by_gravity = wp.to_torch(model.gravity).clone()
    return by_position, by_velocity, by_stiffness, by_gravity, by_path


def _holonomy(before: torch.Tensor, position: torch.Tensor) -> torch.Tensor:
    """(rod, edge, 3) by how much a frame turns that is carried from the tangents before to an edge,
    by the edge's last node."""
    edge = position[:, 1:] - position[:, :-1]
    length = edge.norm(dim=2, keepdim=True)
    tangent = edge / length
    cosine = (before * tangent).sum(dim=2, keepdim=True)
    return -torch.linalg.cross(before, tangent) / (1.0 + cosine) / length


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
    if scheme == "midpoint":  # which wants the path in the middle of each step, too
        raise RodError("gradients of motion along a path know no scheme 'midpoint'; use bdf2")
    options = dict(scheme=scheme, radius=radius, air_damping=air_damping, tolerance=_TOLERANCE)
    setting = Setting(batch, columns, step, steps, options)
    return _Move.apply(position, velocity, stiffness, gravity, path.flatten(2), setting)
