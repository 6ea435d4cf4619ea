"""Lumped masses of a batch, and what residuals of its steps are measured against."""

import numpy as np

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.stepping import dynamics as kernels
from wrod.kernels.stepping.trace import OneStep
from wrod.rods.batch import RodBatch
from wrod.rods.discretisation import cells
from wrod.rods.state import Derivatives


def lumped_masses(batch: RodBatch, radius) -> np.ndarray:
    """(rod, dof) lumped masses of the nodes, and of the edges m h^2 / 2 about their axis."""
    mass = batch.node_mass.numpy()
    # What is held, like a ghost node beyond a clamp, needs none.
    held = np.pad(batch.free.numpy(), ((0, 0), (0, 1))).reshape(*mass.shape, 4)[:, :, :3] == 0
    if not ((mass > 0) | held.any(axis=2)).all():
        raise RodError("node_mass holds a node without mass, which cannot be moved in time")
    rest = batch.rest_length.numpy()
    radius = np.asarray(radius, dtype=float)
    if radius.ndim < 2:
        radius = arguments.spread(radius, (batch.rod_count,), "Dynamics: radius", RodError)[:, None]
    radius = arguments.spread(radius, rest.shape, "Dynamics: radius", RodError)
    if not (np.isfinite(radius) & (radius > 0)).all():
        raise RodError("radius must be positive and finite")
    out = np.empty((batch.rod_count, batch.node_count, 4))
    out[:, :, :3] = mass[:, :, None]
    out[:, :-1, 3] = 0.5 * radius**2 * line_density(batch) * rest
    return np.ascontiguousarray(out.reshape(batch.rod_count, -1)[:, :-1])


def add_inertia(dynamics, step: OneStep, out: Derivatives) -> None:
    """What inertia and air add to a step's residual and its matrix.

    Args:
        dynamics: what says masses, damping and drag.
        step: `wrod.kernels.stepping.trace.OneStep`.
        out: what is added to.
    """
    batch, into = dynamics.batch, [out.gradient, out.hessian]
    inputs = [dynamics.mass, dynamics.air_damping, step]
    batch.launch_spread(kernels.add_inertia, batch.dof_count, inputs, into)
    if dynamics.edge_mass is not None:
        batch.launch_edges(kernels.add_edge_inertia, [dynamics.edge_mass, step], into)
    if dynamics.drag is not None:
        batch.launch_nodes(kernels.add_drag, [dynamics.drag, step], into)


def edge_masses(batch: RodBatch) -> np.ndarray:
    """(rod, edge) mass that is spread along each edge: the smaller line density of its two nodes,
    so that a weight on a node stays one; none of cut edges and of what goes on in a clamp."""
    mass, rest = batch.node_mass.numpy(), batch.rest_length.numpy()
    real = (mass[:, 1:] > 0) & (mass[:, :-1] > 0)
    real[:, list(batch.cut_edges)] = False
    length = np.where(real, rest, 0.0)
    around = cells(length)
    density = np.divide(mass, around, out=np.zeros_like(mass), where=around > 0)
    return np.minimum(density[:, 1:], density[:, :-1]) * length


def line_density(batch: RodBatch) -> np.ndarray:
    """(rod, edge) mean mass per length of the rods of each row; none of what goes on in a clamp."""
    mass, rest = batch.node_mass.numpy(), batch.rest_length.numpy()
    out = np.zeros_like(rest)
    ends = [*batch.cut_edges, batch.node_count - 1]
    first = 0
    for last in ends:
        nodes = mass[:, first : last + 1]
        real = (nodes[:, 1:] > 0) & (nodes[:, :-1] > 0)
        length = np.where(real, rest[:, first:last], 0.0).sum(axis=1)
        density = (nodes.sum(axis=1) / length)[:, None]
        out[:, first:last] = np.where(real, density, 0.0)
        # A cut has an angle, which must have some inertia.
        out[:, last : last + 1] = density
        first = last + 1
    return out


def usual_force(batch: RodBatch) -> np.ndarray:
    """(rod,) weight, or k_b / L^2 if that is larger."""
    length = batch.rest_length.numpy().sum(axis=1)
    bend = batch.bending_stiffness.numpy()[:, 1:-1].max(axis=(1, 2)) / length**2
    gravity = np.linalg.norm(batch.gravity.numpy(), axis=1)
    return np.maximum(bend, batch.node_mass.numpy().sum(axis=1) * gravity)


def rounding_of(batch: RodBatch, length: np.ndarray, force: np.ndarray) -> np.ndarray:
    """(rod, 2) relative residuals that rounding leaves: of stretching, and of inertia for a step of
    unit rate.

    Args:
        length, force: (rod,) scales.
    """
    edge = (batch.stretching_stiffness.numpy() / batch.rest_length.numpy()).max(axis=1)
    extent = np.abs(batch.positions()).max(axis=(1, 2)) + length
    unit = 4 * np.finfo(float).eps * extent / force
    return np.stack([unit * edge, unit * batch.node_mass.numpy().max(axis=1)], axis=1)
