"""Edges of a batch that are carried along a timetable."""

from collections.abc import Sequence

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.stepping.hands import carry
from wrod.rods.batch import RodBatch
from wrod.rods.state import RodState

_AXES = ("x", "y", "z")


class PrescribedMotion:
    """Edges that are held and carried through poses: the `motion` of a `Dynamics`.

    Between the times positions are straight and rotations turn evenly, the shorter way: less than
    half a turn from key to key. Before the first time and after the last an edge stands still. The
    held nodes and angles stop being free.

    A rod that begins or ends in a clamp has a ghost edge beyond it (`RodBatch.of`, `clamped`):
    hold edge 0 at `part` 1, or the last one at `part` 0, and the clamp is exact at the rod's end.

    Args:
        batch: the rods.
        edge: (hand,) index of each held edge; negative ones count from the end.
        times: (key,) ascending [time].
        position: (hand, key, 3) or (rod, hand, key, 3) of the held point.
        rotation: (hand, key, 3) or (rod, hand, key, 3) rotation vectors, or (..., 3, 3) matrices,
            of a frame whose x axis is the edge's tangent and whose y axis is its first material
            director [rad].
        part: (hand,) where on its edge the held point is, from 0 to 1.
        slides: (hand,) "", or the axes along which the edge is not held, like "x" or "xy".

    Raises:
        RodError: a shape does not fit, the times do not ascend, an edge is held twice or is none,
            or a value is not finite.
    """

    def __init__(self, batch: RodBatch, edge, times, position, rotation, *, part=0.5, slides=""):
        said = arguments.wrong(arguments.like("a wrod.RodBatch", "node_count", "device"), batch)
        if said is not None:
            raise RodError(f"PrescribedMotion: batch {said}")
        self.batch = batch
        edges = arguments.floats(edge, "PrescribedMotion: edge", RodError)
        whole = np.isfinite(edges).all() and (np.abs(edges) < 1e9).all() and (edges % 1 == 0).all()
        edges = np.atleast_1d(edges.astype(int) if whole else edges)
        count = batch.node_count - 1
        if edges.ndim != 1 or edges.dtype.kind not in "iu" or not (abs(edges + 0.5) < count).all():
            raise RodError(f"held edges are {edge!r:.80}; give indices of the {count} edges")
        edges = np.where(edges < 0, edges + count, edges)
        if len(np.unique(edges)) < len(edges):
            raise RodError(f"held edges are {edge!r:.80}; hold each once")
        times = arguments.floats(times, "PrescribedMotion: times", RodError)
        good = times.ndim == 1 and len(times) > 1 and np.isfinite(times).all()
        if not good or not (np.diff(times) > 0).all():
            raise RodError("times of a prescribed motion must be two or more, and ascend")
        rods, hands, keys = batch.rod_count, len(edges), len(times)
        position = _keys("position", position, (rods, hands, keys, 3))
        rotation = arguments.floats(rotation, "PrescribedMotion: rotation", RodError)
        matrix = np.shape(rotation)[-2:] == (3, 3) and np.ndim(rotation) in (4, 5)
        size = (3, 3) if matrix else (3,)
        rotation = _keys("rotation", rotation, (rods, hands, keys, *size)).reshape(-1, *size)
        turn = Rotation.from_matrix(rotation) if matrix else Rotation.from_rotvec(rotation)
        part = _keys("part", part, (rods, hands))
        slides = [slides] * hands if isinstance(slides, str) else slides
        texts = isinstance(slides, (list, tuple)) and all(isinstance(s, str) for s in slides)
        if not texts or len(slides) != hands or not all(set(s) <= set(_AXES) for s in slides):
            raise RodError(
                f"slides is {arguments.shown(slides)}; give axes, like 'x', one for each held edge"
            )

        self._edge = batch.array(np.tile(edges, (rods, 1)), dtype=wp.int32)
        self._part, self._times = batch.array(part), batch.array(times)
        self._position = batch.array(position, dtype=wp.vec3d)
        quaternion = turn.as_quat().reshape(rods, hands, keys, 4)
        self._rotation = batch.array(quaternion, dtype=wp.quatd)
        free = batch.free.numpy()
        for e, axes in zip(edges, slides, strict=True):
            free[:, 4 * e : 4 * e + 7] = 0
            for axis in axes:
                free[:, 4 * e + _AXES.index(axis) :: 4][:, :2] = 1
        batch.free.assign(free)

    def prescribe(self, running: wp.array, time: wp.array, step: wp.array, start: RodState) -> None:
        """Put the edges where they are at the end of a step."""
        carry_edges(
            self.batch,
            (self._edge, self._part, self._times, self._position, self._rotation),
            running,
            time,
            step,
            start,
        )


def carry_edges(
    batch: RodBatch, poses: Sequence, running: wp.array, time: wp.array, step: wp.array, start
) -> None:
    """Put held edges where their timetable has them at the end of a step.

    Args:
        poses: Warp arrays as `wrod.kernels.stepping.hands.carry` takes them: edge and part (rod,
            hand), times (key,), position and rotation of each hand's keys.
        running: of the rods; time, step: of each; start: `RodState` at the step's beginning.
    """
    batch.launch(
        carry,
        poses[0].shape,
        [batch.rest_length, *poses, batch.free, running, time, step]
        + [start.dof, start.tangent, start.director],
        [batch.state.dof],
    )


def _keys(name: str, value, shape: tuple[int, ...]) -> np.ndarray:
    value = np.array(arguments.spread(value, shape, f"PrescribedMotion: {name}", RodError))
    if not np.isfinite(value).all():
        raise RodError(f"{name} of a prescribed motion holds a value that is not finite")
    return value
