"""The arrays of a batch of rods, and how they are set."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.elastic.frames import (
    ANY_DIRECTOR,
    EVERY_DIRECTOR,
    FIRST_DIRECTOR,
    reference_twist,
    set_configuration,
    set_reference_frames,
)
from wrod.kernels.elastic.inelastic import Inelastic, inelastic_energy, set_inelastic_laws
from wrod.kernels.elastic.model import ElasticModel
from wrod.kernels.lanes import lanes
from wrod.rods.device import OnDevice
from wrod.rods.state import RodState

# What the elastic energy depends on besides the state, by the names of `ElasticModel`.
_ELASTIC = {
    "rest_length": "rest_length", "stretching": "stretching_stiffness",
    "bending": "bending_stiffness", "invariant": "bending_stiffness",
    "natural_curvature": "natural_curvature", "softening": "softening",
    "twisting": "twisting_stiffness", "natural_twist": "natural_twist",
}  # fmt: skip


def _floats(name: str, value) -> np.ndarray:
    return arguments.floats(value, name, RodError)


def filled(struct: Any, arrays: dict[str, wp.array]) -> Any:
    """A Warp struct of these arrays."""
    for name, array in arrays.items():
        setattr(struct, name, array)
    return struct


def with_arrays(model: ElasticModel, **others: wp.array) -> ElasticModel:
    """The same with other arrays in some places."""
    known = {name: getattr(model, name) for name in ElasticModel.vars}
    return filled(ElasticModel(), known | others)


class BatchArrays(OnDevice):
    """What changes a batch's arrays; see `wrod.rods.batch.RodBatch`."""

    device: str
    rod_count: int
    node_count: int
    dof_count: int
    state: RodState
    every_rod: wp.array
    free: wp.array
    rest_length: wp.array
    stretching_stiffness: wp.array
    bending_stiffness: wp.array
    twisting_stiffness: wp.array
    natural_curvature: wp.array
    softening: wp.array
    natural_twist: wp.array
    energies: list[tuple[wp.Kernel, wp.array]]
    layers: list[ElasticModel]
    cut_edges: tuple[int, ...]
    _elastic: ElasticModel
    _of: Sequence[wp.array] = ()

    def _array(self, name, value, shape, dtype=wp.float64, positive=False) -> wp.array:
        if isinstance(value, wp.array):
            size = shape if dtype == wp.float64 else shape[:-1]
            if value.dtype != dtype or tuple(value.shape) != tuple(size):
                said = f"{value.dtype.__name__} of shape {value.shape}"
                raise RodError(
                    f"{name} is an array of Warp of {said}; it must be "
                    f"{dtype.__name__} of shape {size}"
                )
            return value
        value = _floats(name, value)
        if value.size == 0 or not np.isfinite(value).all():
            raise RodError(f"{name} is empty or holds a value that is not finite")
        if positive and not (value > 0).all():
            raise RodError(f"{name} holds {value.min():g}; every value must be positive")
        if value.size == 1 and value.ndim <= len(shape):
            # One value for all does not have to travel to the device.
            size = shape if dtype == wp.float64 else shape[:-1]
            fill = dtype(*[value.item()] * (1 if dtype == wp.float64 else shape[-1]))
            return wp.full(size, fill, dtype=dtype, device=self.device)
        try:
            value = np.broadcast_to(value, shape)
        except ValueError:
            raise RodError(
                f"{name} has shape {value.shape}, which does not broadcast to {shape}"
            ) from None
        return wp.array(np.ascontiguousarray(value), dtype=dtype, device=self.device)

    def zeros(self, *shape: int, dtype: Any = wp.float64) -> wp.array:
        """Zeros (rod, ...) of the `shape` beyond the rods."""
        return wp.zeros((self.rod_count, *shape), dtype=dtype, device=self.device)

    def array(self, values: np.ndarray | Sequence, dtype: Any = wp.float64) -> wp.array:
        """Values beside the batch's own."""
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

    @property
    def elastic_arrays(self) -> list[wp.array]:
        """What the elastic energy depends on besides the state, as the batch has it now."""
        return [getattr(self, name) for name in _ELASTIC.values()]

    @property
    def elastic_model(self) -> ElasticModel:
        """The same as one record: another one where a batch was given other arrays since."""
        arrays = self.elastic_arrays
        if not self._of or any(a is not b for a, b in zip(arrays, self._of, strict=True)):
            self._of = arrays
            self._elastic = filled(ElasticModel(), dict(zip(_ELASTIC, arrays, strict=True)))
            for layer in self.layers:  # which share these
                layer.rest_length = self.rest_length
                layer.natural_curvature = self.natural_curvature
        return self._elastic

    def set_layers(self, layers: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        """Parallel layers beside `bending_stiffness`, each with a softening of its own, whose
        moments add up to a law of another form: (rod, node, 2) stiffness, of either sign but not 0,
        and (rod, node, 2) softening of each. They share the natural curvature."""
        shape = (self.rod_count, self.node_count, 2)
        if len(layers) != len(self.layers):
            self.layers = [self._layer() for _ in layers]
        for layer, (stiffness, softening) in zip(self.layers, layers, strict=True):
            layer.bending.assign(self._array("layer", stiffness, shape, wp.vec2d))
            layer.softening.assign(self._array("softening", softening, shape, wp.vec2d))

    def _layer(self) -> ElasticModel:
        """One of the `layers`: it bends, it neither stretches nor twists."""
        stiffness, nothing = map(wp.zeros_like, (self.bending_stiffness, self.twisting_stiffness))
        return with_arrays(
            self.elastic_model, stretching=wp.zeros_like(self.stretching_stiffness),
            bending=stiffness, invariant=stiffness, softening=wp.zeros_like(self.softening),
            twisting=nothing, natural_twist=nothing,
        )  # fmt: skip

    def set_softening(self, softening) -> None:
        """Give every rod its law: (rod, node, 2) as in the constructor, broadcast.

        Raises:
            RodError: the shape does not broadcast, or a c is negative or not finite.
        """
        shape = (self.rod_count, self.node_count, 2)
        array = self._array("softening", softening, shape, wp.vec2d)
        value = np.atleast_1d(_floats("softening", softening))
        if value[..., 0].min() < 0.0:
            raise RodError("softening is negative; a rod that stiffens as it bends is not modelled")
        if hasattr(self, "softening"):  # what is recorded goes on with it
            self.softening.assign(array)
        else:
            self.softening = array
        self.softens = bool(value[..., 0].any())

    def _inelastic(self, number) -> wp.array | None:
        """The rods' laws that remember, and what they remember; None where there are none."""
        number = np.atleast_1d(arguments.floats(number, "RodBatch: inelastic", RodError))
        if number.size and not number[..., 0].any():
            return None
        node = never_bent(self, number)
        self.add_energy(inelastic_energy, node)
        return node

    def add_energy(self, kernel: wp.Kernel, number) -> None:
        """Let the rods have another energy of bending and twisting, in all that they do.

        Args:
            kernel: of `wrod.kernels.elastic.section.make_section_energy`.
            number: what the energy has at each node: a Warp array (rod, node) of the energy's
                type, or numbers that broadcast to (rod, node) and the type's length.

        Raises:
            RodError: the numbers do not broadcast, or are not finite.
        """
        if not isinstance(number, wp.array):
            kind = next(a.type.dtype for a in kernel.adj.args if a.label == "number")
            size = () if kind is wp.float64 else (kind._length_,)
            shape = (self.rod_count, self.node_count, *size)
            number = self._array("energy", number, shape, kind)
        self.energies.append((kernel, number))

    def set_configuration(self, position, *, angle=0.0, director=None) -> None:
        """Put the rods into a configuration.

        Args:
            position: (rod, node, 3), or a Warp array (rod, node) of vec3d on the batch's device.
            angle: (rod, node - 1) angles theta from reference to material directors [rad].
            director: as in the constructor; those of every edge set the reference frames.

        Raises:
            RodError: two neighbouring nodes coincide, or a director is along its edge.
        """
        rods, nodes, device = self.rod_count, self.node_count, self.device
        state = self.state
        position = self._array("position", position, (rods, nodes, 3), wp.vec3d)
        angle = self._array("angle", angle, (rods, nodes - 1))
        source, shape = ANY_DIRECTOR, (0, 0)
        if director is not None:
            every = _floats("director", director).ndim == 3
            source, shape = (EVERY_DIRECTOR, nodes - 1) if every else (FIRST_DIRECTOR, 1)
            director = _floats("director", director)
            if not every:
                if director.shape not in ((3,), (1, 3), (rods, 3)):
                    raise RodError(
                        f"director has shape {director.shape}; give (3,), (rod, 3) or "
                        "(rod, node - 1, 3)"
                    )
                director = np.broadcast_to(director, (rods, 3))[:, None]
            director = self._array("director", director, (rods, shape, 3), wp.vec3d)
        else:
            director = wp.empty(shape, dtype=wp.vec3d, device=device)
        self.launch_nodes(set_configuration, [position, angle], [state.dof])
        problem = wp.zeros(rods, dtype=wp.int32, device=device)
        outputs = [state.tangent, state.director, problem]
        self.launch(set_reference_frames, rods, [state.dof, director, source], outputs)
        problem = problem.numpy()
        if problem.any():
            r = int(np.flatnonzero(problem)[0])
            raise RodError(
                f"two neighbouring nodes of rod {r} coincide, or are not numbers"
                if problem[r] == 1
                else f"a director of rod {r} is along its edge; give one across it"
            )
        state.reference_twist.zero_()
        self._launch_twist(state, state, self.every_rod)

    def cut(self, edges) -> None:
        """Take edges out of every row, so that several rods share it, end to end.

        Args:
            edges: their indices; edge i runs from the last node of one rod, i, to the first of the
                next. Their rest length becomes negligible; every node keeps its mass.

        Raises:
            RodError: an index is not that of an edge, or a rod would be left with one node.
        """
        wrong = arguments.indices(edges)
        if wrong is not None:
            raise RodError(f"RodBatch.cut: edges {wrong}")
        count = self.node_count - 1
        edges = sorted({int(e) % count if -count <= e < count else count for e in edges})
        if np.any(np.diff([-1, *edges, count]) < 2) or (edges and edges[-1] >= count):
            raise RodError(
                f"cannot cut edges {edges}: give indices below {count} that leave every rod "
                "two nodes or more"
            )
        around = sorted({i for e in edges for i in (e, e + 1)})
        rest = self.rest_length.numpy().copy()
        rest[:, edges] = 1e-6 * rest.mean()
        self.rest_length.assign(rest)
        for array, columns in (
            (self.stretching_stiffness, edges),
            (self.bending_stiffness, around),
            (self.twisting_stiffness, around),
        ):
            values = array.numpy().copy()
            values[:, columns] = 0.0
            array.assign(values)
        self.cut_edges = tuple(edges)

    @arguments.checked(RodError, free=arguments.picture)
    def set_free(self, free: np.ndarray) -> None:
        """Say which degrees of freedom may move: (rod, dof) of bool, broadcast.

        Raises:
            RodError: the shape does not broadcast.
        """
        shape = (self.rod_count, self.dof_count)
        try:
            free = np.broadcast_to(np.asarray(free, dtype=bool), shape)
        except ValueError:
            raise RodError(f"free has shape {np.shape(free)}; give {shape}") from None
        self.free.assign(free.astype(np.int32))

    def launch(
        self, kernel: wp.Kernel, dim, inputs: list, outputs: Sequence = (), block: int = 256
    ) -> None:
        """Launch a kernel on the batch's device, there so many threads a block."""
        wp.launch(kernel, dim, inputs, outputs, device=self.device, block_dim=block)

    def launch_spread(
        self, kernel: wp.Kernel, items: int, inputs: list, outputs: Sequence = ()
    ) -> None:
        """Launch a kernel over (rod, thread), of which each takes every so manieth of a rod's items
        as its first input says: all on a CPU, where to begin another takes longer than its work."""
        count = lanes(self.device, items)
        self.launch(kernel, (self.rod_count, count), [count, *inputs], outputs)

    def launch_nodes(self, kernel: wp.Kernel, inputs: list, outputs: Sequence = ()) -> None:
        """Launch a kernel over (rod, node)."""
        self.launch(kernel, (self.rod_count, self.node_count), inputs, outputs)

    def launch_inner(self, kernel: wp.Kernel, inputs: list, outputs: Sequence = ()) -> None:
        """Launch a kernel over (rod, inner node)."""
        self.launch(kernel, (self.rod_count, self.node_count - 2), inputs, outputs)

    def launch_edges(self, kernel: wp.Kernel, inputs: list, outputs: Sequence = ()) -> None:
        """Launch a kernel over (rod, edge)."""
        self.launch(kernel, (self.rod_count, self.node_count - 1), inputs, outputs)

    def launch_dofs(self, kernel: wp.Kernel, inputs: list, outputs: Sequence = ()) -> None:
        """Launch a kernel over (rod, dof)."""
        self.launch(kernel, (self.rod_count, self.dof_count), inputs, outputs)

    def _launch_twist(self, source: RodState, target: RodState, active: wp.array) -> None:
        inputs = [active, target.tangent, target.director, source.reference_twist]
        self.launch_inner(reference_twist, inputs, [target.reference_twist])


def never_bent(batch: BatchArrays, number: np.ndarray) -> wp.array:
    """(rod, node) `Inelastic` of rods that have never been bent; `number` as the constructor of
    `RodBatch` takes it."""
    shape = (batch.rod_count, batch.node_count)
    numbers = batch._array("inelastic", number, (*shape, 4), wp.vec4d)
    node = wp.zeros(shape, dtype=Inelastic, device=batch.device)
    batch.launch_nodes(set_inelastic_laws, [numbers], [node])
    return node
