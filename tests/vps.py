"""Silicone rods (VPS) and ropes as batches, for the tests of contact and motion."""

import numpy as np
import warp as wp

from wrod.rods.batch import RodBatch
from wrod.rods.discretisation import cells
from wrod.rods.material import RodMaterial
from wrod.solvers.statics import prescribe

G, RADIUS, LGB, DENSITY = 9.81, 1.6e-3, 0.032, 1180.0
WEIGHT = np.pi * RADIUS**2 * DENSITY * G
STIFFNESS = 2 * WEIGHT * LGB**3
CONTACT = 600 * WEIGHT / RADIUS
SHORT = RodMaterial(RADIUS, LGB, 0.36)


def rods(position, gravity=(0.0, 0.0, -G), *, stiffer=1.0, cuts=(), **more):
    """Rods (rod, node, 3), their mass lumped, stiffer in bending and twisting by a factor; rods
    of one row end at `cuts`."""
    position = np.asarray(position, dtype=float)
    edge = np.linalg.norm(np.diff(position, axis=1), axis=2)
    edge[:, list(cuts)] = 0.0
    batch = RodBatch(
        position,
        stretching_stiffness=more.pop("stretching", 4 * STIFFNESS / RADIUS**2),
        bending_stiffness=stiffer * STIFFNESS,
        twisting_stiffness=stiffer * STIFFNESS / 1.5,
        node_mass=WEIGHT / G * cells(edge),
        gravity=gravity,
        **more,
    )
    if len(cuts):
        batch.cut(cuts)
    return batch


def straight(count=1, nodes=15, axis=0, height=RADIUS, length=0.07):
    position = np.zeros((count, nodes, 3))
    position[:, :, axis] = np.linspace(0, length, nodes)
    position[:, :, 2] = height
    return position


def momenta(dynamics):
    """Linear and angular momentum of the nodes, and the spin of the edges about their axes."""
    batch = dynamics.batch
    q, v = batch.positions()[0], dynamics.velocities()[0]
    mass = batch.node_mass.numpy()[0][:, None]
    inertia = dynamics.mass.numpy()[0, 3::4, None]
    spin = inertia * dynamics.velocity.numpy()[0, 3::4, None] * batch.state.tangent.numpy()[0]
    return (mass * v).sum(axis=0), np.cross(q, mass * v).sum(axis=0) + spin.sum(axis=0)


def half_turn(reach, edge):
    """(node, 3) half a turn around the y axis at a distance, between hanging ends of 8 edges."""
    angle = np.linspace(np.pi, 0, round(np.pi * reach / edge) + 1)
    arc = reach * np.column_stack([np.cos(angle), 0 * angle, np.sin(angle)])
    down = edge * np.arange(1, 9)
    side = np.column_stack([0 * down + reach, 0 * down, -down])
    return np.concatenate([(side * [-1, 1, 1])[::-1], arc, side])


def rope(position, load, edge, *, post=False, bending=1e-8):
    """A rope (node, 3) that hardly resists bending, a load on its first node, its last one held;
    after a `post`, a rod of two nodes that stands still in the same row."""
    point_load = np.zeros((1, *np.shape(position)))
    point_load[0, 2 if post else 0] = load
    batch = RodBatch(
        np.asarray(position)[None], stretching_stiffness=100.0, bending_stiffness=bending,
        twisting_stiffness=bending, node_mass=1e-2 * edge, point_load=point_load,
    )  # fmt: skip
    if post:
        batch.cut([1])
    there = (0, 1) if post else ()
    prescribe(batch, clamped_nodes=there, clamped_angles=there, pinned_nodes=(-1,))
    return batch


def tensions(batch):
    """(edge,) of a rope."""
    length = np.linalg.norm(np.diff(batch.positions()[0], axis=0), axis=1)
    return 100.0 * (length / batch.rest_length.numpy()[0] - 1)


@wp.kernel
def pull_on(
    start: wp.vec3d,
    velocity: wp.vec3d,
    time: wp.array(dtype=wp.float64),
    step: wp.array(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
):
    r, k = wp.tid()
    dof[r, dof.shape[1] - 3 + k] = start[k] + (time[r] + step[r]) * velocity[k]


class Pull:
    """Moves the last node along a direction at 1 cm/s."""

    def __init__(self, batch, direction):
        self.batch, self.velocity = batch, wp.vec3d(*(0.01 * np.asarray(direction)))
        self.start = wp.vec3d(*batch.positions()[0, -1])

    def prescribe(self, running, time, step, start):
        inputs = [self.start, self.velocity, time, step]
        self.batch.launch(pull_on, (self.batch.rod_count, 3), inputs, [self.batch.state.dof])
