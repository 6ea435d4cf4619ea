"""Grasps of straight isotropic rods on one mesh of one device, and on a ladder of meshes.

Nothing here asks the device anything: every method launches and returns. Dimensionless.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, cached_property

import numpy as np
import warp as wp

from wrod.kernels.compiling import compile_ahead, compile_together
from wrod.kernels.grasping import iteration, mesh, reading, sensitivity
from wrod.kernels.grasping.closures import CONVERGED
from wrod.kernels.grasping.scratch import Scratch
from wrod.kernels.linear.frontal import row_width, stencil_entries

# Largest change of an edge in one step, as a fraction of its length.
_STEP_LIMIT = 0.4
# Newton steps on one continuation step before it counts as failed.
_PATIENCE = 14
_MAX_ITERATIONS = 400
_FIRST_INCREMENT = 0.5
# Change of the force that a mesh before the last two leaves.
_LEADING_DONE = 1e-5
# A ladder starts on this many edges or more.
_COARSEST = 32
# Threads a block on a GPU: few, so that finished blocks make room; and where they all take as long.
_BLOCK, WIDE_BLOCK = 32, 256


def per_rod(device: str, rods: int, *shape: int) -> wp.array:
    """Uninitialised float64 (rod, *shape), laid out for a rod a thread: on a GPU neighbouring rods
    are neighbours in memory."""
    if wp.get_device(device).is_cpu or not shape:
        return wp.empty((rods, *shape), dtype=wp.float64, device=device)
    array = wp.empty((*shape, rods), dtype=wp.float64, device=device)
    return array.transpose((len(shape), *range(len(shape))))


def put(array: wp.array, value) -> None:
    """Fill an array of `per_rod` from NumPy."""
    value = np.array(np.broadcast_to(value, array.shape), dtype=np.float64)
    wp.copy(array, wp.array(value, device=array.device))


def make_scratch(slots: int, edges: int, device: str, size: int = 3) -> Scratch:
    """Room to iterate `slots` rods at a time on meshes of up to `edges` edges; `size` is 3 for
    straight isotropic rods, 4 for general ones."""
    scratch = Scratch()
    scratch.stiffness = per_rod(device, slots, edges, stencil_entries(size))
    scratch.load = per_rod(device, slots, edges + 1, size)
    scratch.factor = per_rod(device, slots, size * edges, row_width(size))
    scratch.condensed = per_rod(device, slots, 2 * size * (2 * size + 1))
    scratch.motion = per_rod(device, slots, edges + 1, size)
    scratch.saved = per_rod(device, slots, edges + 1, 3 if size == 3 else 7)
    return scratch


def make_task(
    model: list[wp.array],
    tolerance: wp.array,
    increment: wp.array,
    closure: int,
    force_done: float = 0.0,
) -> iteration.IterationTask:
    """`model` are (stretch ratio, target curvature, weight), (rod,) each; `force_done` is what
    change of the force does not matter."""
    task = iteration.IterationTask()
    _, task.target, task.weight = model
    task.tolerance, task.increment, task.closure = tolerance, increment, closure
    task.force_done = force_done
    task.step_limit, task.patience = _STEP_LIMIT, _PATIENCE
    task.most_iterations = _MAX_ITERATIONS
    return task


def _kernels(sensitivities: bool) -> list[tuple[wp.Kernel, int]]:
    """What grasps of straight rods need, and the blocks that it is launched in."""
    launches = [(iteration.solve_straight, _BLOCK), (mesh.refine, _BLOCK)]
    launches += [(reading.judge, WIDE_BLOCK)]
    launches += [(sensitivity.find_sensitivities, _BLOCK)] if sensitivities else []
    return launches


def compile_grasps_ahead(device: str) -> None:
    """Begin to compile what grasps of straight rods need, while something else is done."""
    compile_ahead(device, _kernels(sensitivities=False))


@cache
def compile_kernels(device: str, sensitivities: bool) -> None:
    """Compile it, side by side, and once for all threads."""
    compile_together(device, _kernels(sensitivities))


def launch(device: str, kernel, rods: int, inputs: list, outputs, block: int = _BLOCK) -> None:
    """Launch a kernel over the first rods."""
    wp.launch(kernel, rods, inputs, outputs, device=device, block_dim=block)


class WorkList:
    """Which rods to work on: their indices and how many there are, on the device."""

    def __init__(self, rods: int, device: str):
        self.rods, self.device = rods, device
        self.index = wp.zeros(rods, dtype=wp.int32, device=device)
        self.count = wp.zeros(1, dtype=wp.int32, device=device)

    def launch(self, kernel, inputs: list, outputs: Sequence = ()) -> None:
        launch(self.device, kernel, self.rods, [self.index, self.count, *inputs], outputs)


class MeshLevel:
    """Rods on meshes of one number of edges; see `kernels.grasping`.

    Iterations are added to `iterations` (rod,). Attributes are Warp arrays: shape (rod, node, 3),
    curvature and thrust (rod,) of where each rod's iteration stands, and what `reading.Level` has.
    """

    def __init__(
        self, rods: int, edges: int, device: str, iterations: wp.array, rates: bool = False
    ):
        self.rods, self.edges, self.device = rods, edges, device

        def floats(*shape):
            return per_rod(device, rods, *shape)

        def ints():
            return wp.zeros(rods, dtype=wp.int32, device=device)

        self.rest, self.rest_rate = floats(edges), floats(edges)
        self.tolerance, self.curvature, self.thrust = floats(), floats(), floats()
        self.family, self.increment = floats(6), floats()
        self.increment.fill_(_FIRST_INCREMENT)
        self.read = level = reading.Level()
        level.shape = floats(edges + 1, 3)
        level.rotation, level.force, level.jacobian = floats(3), floats(3), floats(9)
        level.rates = floats(27) if rates else wp.empty((0, 0), dtype=wp.float64, device=device)
        level.lowest, level.turning, level.residual = floats(), floats(), floats()
        level.status, level.iterations, level.negative = ints(), iterations, ints()

    @property
    def shape(self) -> wp.array:
        return self.read.shape

    @property
    def state(self) -> list[wp.array]:
        return [self.shape, self.curvature, self.thrust, self.family]

    def lay(self, length: wp.array, stretch_ratio: wp.array, rods: int) -> None:
        """Lay the meshes of the first rods and forget what was solved on them."""
        inputs, outputs = [length, stretch_ratio, self.edges], [self.rest, self.rest_rate]
        launch(self.device, mesh.lay_mesh, rods, inputs, [*outputs, self.tolerance])
        self.read.status.zero_()

    def hang(self, work: WorkList) -> None:
        """Start from a straight pattern."""
        work.launch(mesh.hang_straight, [self.rest, self.edges], self.state)

    def refine(self, work: WorkList, half: MeshLevel, quarter: MeshLevel | None = None) -> None:
        """Start from the solution on half the edges, and on a quarter where that is known."""
        other = half if quarter is None else quarter
        work.launch(
            mesh.refine,
            [half.edges, self.rest, *half.state, int(quarter is not None)]
            + [other.shape, other.thrust],
            self.state,
        )

    def coarsen(self, work: WorkList, double: MeshLevel) -> None:
        """Start from the solution on twice the edges."""
        work.launch(mesh.coarsen, [double.edges, self.rest, *double.state], self.state)

    def solve(
        self,
        work: WorkList,
        model: list[wp.array],
        closure: int,
        scratch: Scratch,
        force_done: float = 0.0,
    ) -> None:
        """Iterate every rod of the list until it has converged or failed.

        `model` and `force_done` are those of `make_task`.
        """
        rod = iteration.StraightRod()
        rod.rest, rod.stretch_ratio = self.rest, model[0]
        task = make_task(model, self.tolerance, self.increment, closure, force_done)
        work.launch(
            iteration.solve_straight, [self.edges, rod, task, scratch, *self.state], [self.read]
        )

    def read_out(self, rods: int) -> None:
        """Frames and judgements of the first rods."""
        level = self.read
        inputs = [self.edges, self.rest, level.shape]
        outputs = [level.rotation, level.lowest, level.turning]
        launch(self.device, reading.read_straight, rods, inputs, outputs, WIDE_BLOCK)

    def find_sensitivities(self, rods: int, stretch_ratio: wp.array, scratch: Scratch) -> None:
        """Derivatives by the inputs of the first rods, after `read_out`."""
        level = self.read
        inputs = [self.edges, self.rest, self.rest_rate, stretch_ratio, self.curvature]
        inputs += [level.shape, level.rotation, level.status, scratch]
        launch(self.device, sensitivity.find_sensitivities, rods, inputs, [level.rates])


class Ladder:
    """Room to solve up to `rods` grasps at a time, from the coarsest of some meshes to the finest.

    Every mesh has half the edges of the next. The last two are what Richardson's extrapolation
    takes; those before them bring the rod near.
    """

    def __init__(self, rods: int, edges: int, device: str, sensitivities: bool):
        self.rods, self.edges, self.device = rods, edges, device
        self.sensitivities = sensitivities
        self.iterations = wp.zeros(rods, dtype=wp.int32, device=device)
        self.work, self.lost = WorkList(rods, device), WorkList(rods, device)
        self.length, *self.model = (per_rod(device, rods) for _ in range(4))
        # Sorting takes room for as many again.
        self.key = wp.empty(2 * rods, dtype=wp.float32, device=device)
        self.order = wp.empty(2 * rods, dtype=wp.int32, device=device)

    @cached_property
    def scratch(self) -> Scratch:
        slots = 1 if wp.get_device(self.device).is_cpu else self.rods
        return make_scratch(slots, self.edges, self.device)

    @cached_property
    def levels(self) -> list[MeshLevel]:
        """From the coarsest to the finest; who begins on the last alone does without."""
        counts = [self.edges // 2, self.edges]
        while counts[0] % 2 == 0 and counts[0] // 2 >= _COARSEST:
            counts.insert(0, counts[0] // 2)
        last = len(counts) - 2
        rods, device, iterations = self.rods, self.device, self.iterations
        return [
            MeshLevel(rods, count, device, iterations, self.sensitivities and i >= last)
            for i, count in enumerate(counts)
        ]

    def fits(self, rods: int, edges: int, device: str, sensitivities: bool) -> bool:
        """Whether this is the room that a call wants."""
        mine = (self.rods, self.edges, self.device, self.sensitivities)
        return mine == (rods, edges, device, sensitivities)

    @staticmethod
    def bytes_each(edges: int, device: str) -> float:
        """Roughly what a rod takes: scratch memory is most of it, of which a CPU has one."""
        scratch = 0 if device == "cpu" else stencil_entries(3) + 3 * row_width(3)
        return 8.0 * edges * (scratch + 24)

    def expect(self, inputs: list[wp.array], first: int, rods: int, *, sort: bool) -> None:
        """Take rods of `inputs` from row `first` on, sorted by the work that they will be."""
        outputs = [self.key, self.order]
        launch(self.device, mesh.expect_work, rods, [*inputs, first], outputs)
        if sort:
            wp.utils.radix_sort_pairs(self.key, self.order, rods)
        outputs = [self.length, *self.model, self.work.index, self.work.count]
        launch(self.device, mesh.take_inputs, rods, [*inputs, self.order, rods], outputs)

    def climb(self, rods: int, closure: int) -> None:
        """Solve the first rods on every mesh."""
        levels, model, scratch = self.levels, self.model, self.scratch
        work, lost = self.work, self.lost
        self.iterations.zero_()
        for level in levels:
            level.lay(self.length, model[0], rods)
        for i, level in enumerate(levels):
            if i == 0:
                level.hang(work)
            else:
                level.refine(work, levels[i - 1], levels[i - 2] if i > 1 else None)
            done = _LEADING_DONE if i < len(levels) - 2 else 0.0
            level.solve(work, model, closure, scratch, done)
        coarse, fine = levels[-2:]
        # Too coarse a mesh to start from: start on the finest and come back from there.
        lost.count.zero_()
        inputs = [coarse.read.status, fine.read.status, CONVERGED]
        launch(self.device, mesh.list_unsolved, rods, inputs, [lost.index, lost.count])
        fine.hang(lost)
        fine.solve(lost, model, closure, scratch)
        coarse.coarsen(lost, fine)
        coarse.solve(lost, model, closure, scratch)

    def solve(
        self,
        inputs: list[wp.array],
        first: int,
        rods: int,
        *,
        closure: int,
        extrapolate: bool,
        out: reading.Results,
    ) -> None:
        """Solve inputs (l_s, kappa, k_s) from row `first` on into the same rows of `out`."""
        self.expect(inputs, first, rods, sort=wp.get_device(self.device).is_cuda)
        self.climb(rods, closure)
        coarse, fine = self.levels[-2:]
        for level in (coarse, fine):
            level.read_out(rods)
            if self.sensitivities:
                level.find_sensitivities(rods, self.model[0], self.scratch)
        self.judge((coarse, fine), inputs[1], rods, extrapolate=extrapolate, out=out)

    def judge(
        self, levels, curvature: wp.array, rods: int, *, extrapolate: bool, out: reading.Results
    ) -> None:
        """Read grasps off the last two meshes, in the order of `curvature`'s rods."""
        coarse, fine = levels
        inputs = [coarse.read, fine.read, int(extrapolate), fine.edges, fine.rest, curvature]
        launch(self.device, reading.judge, rods, [*inputs, self.order], [out], WIDE_BLOCK)
