"""The grip's motion in time, as the stepper takes it."""

from dataclasses import dataclass

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from wrod.kernels.stepping import grip as kernels
from wrod.rods.batch import RodBatch
from wrod.rods.state import RodState

# Spacing of the keys between which the grip moves smoothly [s].
KEY_INTERVAL = 0.02


def smooth_noise(rng: np.random.Generator, count: int, size: float, width: float) -> np.ndarray:
    """(count, 3) noise of standard deviation `size`, smooth over `width` samples."""
    reach = int(np.ceil(4 * width))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    kernel /= np.linalg.norm(kernel)
    white = rng.standard_normal((3, count + 2 * reach))
    return size * np.stack([np.convolve(w, kernel, mode="valid") for w in white], axis=1)


@dataclass(frozen=True)
class GripSchedule:
    """One rod's grip over time, sampled every `KEY_INTERVAL` seconds.

    Attributes:
        position: (key, 3) [m].
        rotation: (key, 4) quaternions xyzw, neighbours in one hemisphere.
        held_nodes: how many first nodes stand still until `release_time` [s].
        let_go_time: when the grip opens [s].
        held_edge: that the grip carries; None: the ghost beyond the rod's end.
    """

    position: np.ndarray
    rotation: np.ndarray
    held_nodes: int
    release_time: float
    let_go_time: float
    held_edge: int | None = None

    def poses(self, time: np.ndarray) -> np.ndarray:
        """(n, 4, 4) poses at times (n,) [s], at rest after the last key [m]."""
        keys = np.minimum(np.rint(time / KEY_INTERVAL).astype(int), len(self.position) - 1)
        out = np.tile(np.eye(4), (len(keys), 1, 1))
        out[:, :3, 3] = self.position[keys]
        out[:, :3, :3] = Rotation.from_quat(self.rotation[keys]).as_matrix()
        return out


class GripMotion:
    """Carries a batch's rods by an edge each, of all the same or the ghosts beyond their ends (a
    `wrod.solvers.steps.Motion`).

    Args:
        batch: the rods.
        schedules: one for each.
        angle: for each rod, from the grip's y axis to the rod's first director in the batch [rad].
    """

    def __init__(self, batch: RodBatch, schedules: list[GripSchedule], angle=None):
        self.batch, device = batch, batch.device
        keys = max(len(s.position) for s in schedules)

        def padded(name):
            tables = [getattr(s, name) for s in schedules]
            out = np.empty((len(tables), keys, tables[0].shape[1]))
            for row, table in zip(out, tables, strict=True):
                row[: len(table)], row[len(table) :] = table, table[-1]
            return out

        def floats(name):
            values = [getattr(s, name) for s in schedules]
            return wp.array(values, dtype=wp.float64, device=device)

        self.position = wp.array(padded("position"), dtype=wp.vec3d, device=device)
        rotation = padded("rotation")
        if np.any(angle):
            turns = Rotation.from_euler("x", np.repeat(angle, keys)[:, None])
            whole = (Rotation.from_quat(rotation.reshape(-1, 4)) * turns).as_quat(canonical=False)
            rotation = whole.reshape(rotation.shape)
        self.rotation = wp.array(rotation, dtype=wp.quatd, device=device)
        held = [s.held_nodes for s in schedules]
        self.held_nodes = wp.array(held, dtype=wp.int32, device=device)
        self.release_time, self.let_go_time = floats("release_time"), floats("let_go_time")
        edge = schedules[0].held_edge
        self.edge = batch.node_count - 2 if edge is None else edge

    def prescribe(self, running: wp.array, time: wp.array, step: wp.array, start: RodState):
        batch = self.batch
        batch.launch(
            kernels.prescribe,
            batch.rod_count,
            [wp.float64(KEY_INTERVAL), self.edge, self.position, self.rotation, batch.rest_length]
            + [self.held_nodes, self.release_time, self.let_go_time, running, time, step]
            + [start.dof, start.tangent, start.director],
            [batch.free, batch.state.dof],
        )
