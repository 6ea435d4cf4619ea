"""A batch of discrete elastic rods: its arrays, and their energies, gradients and Hessians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.elastic.bending import elasticity
from wrod.kernels.elastic.frames import (
    ANY_DIRECTOR,
    EVERY_DIRECTOR,
    FIRST_DIRECTOR,
    reference_twist,
    set_configuration,
    set_reference_frames,
    transport_reference_frames,
)
from wrod.kernels.elastic.inelastic import Inelastic, inelastic_energy, set_inelastic_laws
from wrod.kernels.elastic.loads import dead_loads
from wrod.kernels.elastic.softened_bending import softened_elasticity
from wrod.kernels.lanes import lanes


def resolve_device(device: str | None) -> str:
    """`None` and "auto" mean the first CUDA device if there is one, else the CPU.

    Raises:
        RodError: the device does not exist on this machine, or has no memory left to begin with.
    """
    if device in (None, "auto"):
        device = "cuda:0" if wp.is_cuda_available() else "cpu"
    try:
        found = wp.get_device(device)
    except Exception as error:
        raise RodError(
            f"device {device!r} is not on this machine; use cpu, auto or one of "
            f"{', '.join(str(d) for d in wp.get_devices())}"
        ) from error
    if found.is_cuda:
        try:
            _ = found.context
        except RuntimeError as error:
            raise RodError(
                f"device {found} cannot be used ({error}); see whether others fill its memory, "
                "wait, or use cpu"
            ) from error
    return str(found)


def _floats(name: str, value) -> np.ndarray:
    return arguments.floats(value, name, RodError)


@dataclass
class RodState:
    """Configuration of every rod of a batch (Warp arrays).

    Attributes:
        dof: (rod, 4 node - 1) degrees of freedom [q_0, theta^0, q_1, ...].
        tangent: (rod, node - 1) unit tangents that the reference frames belong to.
        director: (rod, node - 1) first reference directors.
        reference_twist: (rod, node) angle of the reference frames across each inner node [rad].
    """

    dof: wp.array
    tangent: wp.array
    director: wp.array
    reference_twist: wp.array

    @classmethod
    def zeros(cls, rod_count: int, node_count: int, device: str) -> RodState:
        edges = (rod_count, node_count - 1)
        return cls(
            wp.zeros((rod_count, 4 * node_count - 1), dtype=wp.float64, device=device),
            wp.zeros(edges, dtype=wp.vec3d, device=device),
            wp.zeros(edges, dtype=wp.vec3d, device=device),
            wp.zeros((rod_count, node_count), dtype=wp.float64, device=device),
        )

    def assign(self, other: RodState) -> None:
        wp.copy(self.dof, other.dof)
        wp.copy(self.tangent, other.tangent)
        wp.copy(self.director, other.director)
        wp.copy(self.reference_twist, other.reference_twist)


@dataclass
class Derivatives:
    """Energy (rod,), gradient (rod, dof) and lower band of the Hessian (rod, dof, 11)."""

    energy: wp.array
    gradient: wp.array
    hessian: wp.array

    @classmethod
    def zeros(cls, rod_count: int, dof_count: int, device: str) -> Derivatives:
        return cls(
            wp.zeros(rod_count, dtype=wp.float64, device=device),
            wp.zeros((rod_count, dof_count), dtype=wp.float64, device=device),
            wp.zeros((rod_count, dof_count, HALF_BANDWIDTH + 1), dtype=wp.float64, device=device),
        )


class RodBatch:
    """Many rods of one node count; everything else may differ from rod to rod.

    The quantities carry any consistent units: SI, or the dimensionless ones of a plan. Every array
    argument is broadcast to the shape given here.

    Args:
        position: (rod, node, 3) initial node positions, or a Warp array (rod, node) of vec3d.
        rest_length: (rod, node - 1) rest length of every edge; default: that of `position`.
            Like `position` it may be a Warp array on the device, which is taken as it is.
        stretching_stiffness: (rod, node - 1) EA of every edge [force].
        bending_stiffness: (rod, node) or (rod, node, 2): EI about the two material directors
            [force length^2]; the values at the end nodes are not used.
        twisting_stiffness: (rod, node) GJ [force length^2].
        natural_curvature: (rod, node, 2) curvature at rest in the material frame [1/length].
        natural_twist: (rod, node) twist at rest [rad/length].
        softening: (rod, node, 2) c >= 0 [length^2] and r of the moment
            B e (r + (1 - r) / (1 + c e^2)) that belongs to a curvature e; c = 0 is linear.
        inelastic: (rod, node, 4) law of bending that remembers: its number in
            `wrod.kernels.elastic.inelastic` (0: none), share, scale [1/length] and time [time].
        node_mass: (rod, node) lumped masses.
        gravity: (rod, 3) acceleration.
        point_load: (rod, node, 3) dead force at each node [force].
        director: (rod, 3) or (rod, node - 1, 3) first material director of the first edge (carried
            along the rod without twist) or of every edge; default: any direction across the rod.
        device: "cpu", "cuda:0", "auto".

    Raises:
        RodError: a shape does not broadcast, a rest length or stiffness is not positive, or a
            value is not finite.
    """

    @arguments.checked(
        RodError,
        position=arguments.mesh(finite=False),
        device=arguments.optional(arguments.text),
    )
    def __init__(
        self,
        position: np.ndarray,
        *,
        rest_length=None,
        stretching_stiffness,
        bending_stiffness,
        twisting_stiffness,
        natural_curvature=0.0,
        natural_twist=0.0,
        softening=0.0,
        inelastic=0.0,
        node_mass=0.0,
        gravity=0.0,
        point_load=0.0,
        director=None,
        device: str | None = "cpu",
    ):
        shape = np.shape(position) if not isinstance(position, wp.array) else (*position.shape, 3)
        if len(shape) != 3 or shape[2] != 3 or shape[1] < 3:
            raise RodError(
                f"rod positions have shape {shape}; give (rod, node, 3) with 3 nodes or more"
            )
        self.device = resolve_device(device)
        self.rod_count, self.node_count = rods, nodes = shape[:2]
        self.dof_count = 4 * self.node_count - 1
        if not isinstance(position, wp.array):
            position = np.asarray(position, dtype=np.float64)
            if not np.isfinite(position).all():
                raise RodError("position holds a value that is not finite")
        if rest_length is None:
            rest_length = np.linalg.norm(np.diff(position, axis=1), axis=2)
        bending_stiffness = _floats("bending_stiffness", bending_stiffness)
        if bending_stiffness.ndim < 3:
            bending_stiffness = bending_stiffness[..., None]

        self.rest_length = self._array(
            "rest_length",
            rest_length,
            (rods, nodes - 1),
            positive=True,
        )
        self.stretching_stiffness = self._array(
            "stretching_stiffness", stretching_stiffness, (rods, nodes - 1), positive=True
        )
        self.bending_stiffness = self._array(
            "bending_stiffness", bending_stiffness, (rods, nodes, 2), wp.vec2d, positive=True
        )
        self.twisting_stiffness = self._array(
            "twisting_stiffness", twisting_stiffness, (rods, nodes), positive=True
        )
        self.natural_curvature = self._array(
            "natural_curvature", natural_curvature, (rods, nodes, 2), wp.vec2d
        )
        self.natural_twist = self._array("natural_twist", natural_twist, (rods, nodes))
        self.set_softening(softening)
        self.energies: list[tuple[wp.Kernel, wp.array]] = []
        self.layers: list[tuple[wp.array, wp.array]] = []
        self.inelastic = self._inelastic(inelastic)
        self.node_mass = self._array("node_mass", node_mass, (rods, nodes))
        self.gravity = self._array("gravity", gravity, (rods, 3), wp.vec3d)
        self.point_load = self._array("point_load", point_load, (rods, nodes, 3), wp.vec3d)
        self.load_factor = wp.ones(rods, dtype=wp.float64, device=self.device)
        self.free = wp.ones((rods, self.dof_count), dtype=wp.int32, device=self.device)
        self.every_rod = wp.ones(rods, dtype=wp.int32, device=self.device)
        self.state = RodState.zeros(rods, nodes, self.device)
        self.derivatives = Derivatives.zeros(rods, self.dof_count, self.device)
        self.cut_edges = ()
        self.set_configuration(position, director=director)

    @classmethod
    @arguments.checked(
        RodError,
        rods=arguments.each(
            arguments.like("a wrod.RodModel or wrod.RodMaterial", "radius", "length")
        ),
        arc_length=arguments.array((None,), (None, None)),
        position=arguments.array((None, None, 3)),
        clamped=arguments.several(arguments.flag, least=2),
        director=arguments.optional(arguments.array((3,), (None, 3), (None, None, 3))),
        gravity=arguments.optional(arguments.array((3,), (None, 3))),
        device=arguments.optional(arguments.text),
    )
    def of(
        cls,
        rods,
        arc_length: np.ndarray,
        position: np.ndarray,
        *,
        clamped: tuple[bool, bool] = (False, False),
        director=None,
        gravity=None,
        point_load=0.0,
        device: str | None = "cpu",
    ) -> RodBatch:
        """Put rods on meshes; see `wrod.rods.discretisation`.

        Args:
            rods: a `RodModel` or `RodMaterial` for all rows, or one for each.
            arc_length: (rod, node) or (node,) unstretched arc length of the nodes [m].
            position: (rod, node, 3) of the nodes [m].
            clamped: whether the (first, last) edge is the ghost of a clamp: the rod begins at the
                second node, and the edge before has the clamp's direction.
            director: (3,), (rod, 3) or (rod, node - 1, 3) first material director m_1 of the first
                edge or of every edge. The batch's directors are the principal directions of the
                sections, turned from m_1 by the rods' principal angle.
            gravity: (3,) or (rod, 3) acceleration; default: the rods', along -z.
            point_load, device: as in the constructor.

        Raises:
            RodError: a shape does not fit, or the constructor refuses a value.
        """
        from wrod.rods.discretisation import mesh_arrays, principal_directors

        position = np.asarray(position, dtype=np.float64)
        if position.ndim != 3 or position.shape[2] != 3:
            raise RodError(f"rod positions have shape {position.shape}; give (rod, node, 3)")
        arrays = mesh_arrays(rods, arc_length, clamped=clamped)
        if gravity is not None:
            arrays["gravity"] = gravity
        if director is not None:
            edge = np.diff(position, axis=1)
            tangent = edge / np.linalg.norm(edge, axis=2, keepdims=True)
            every = np.ndim(director) == 3
            director = principal_directors(rods, director, tangent if every else tangent[:, 0])
        return cls(position, director=director, point_load=point_load, device=device, **arrays)

    def _array(self, name, value, shape, dtype=wp.float64, positive=False) -> wp.array:
        if isinstance(value, wp.array):
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

    def set_layers(self, layers: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        """Parallel layers beside `bending_stiffness`, each with a softening of its own, whose
        moments add up to a law of another form: (rod, node, 2) stiffness, of either sign but not 0,
        and (rod, node, 2) softening of each. They share the natural curvature."""
        shape = (self.rod_count, self.node_count, 2)
        self.layers = [
            (
                self._array("layer", stiffness, shape, wp.vec2d),
                self._array("softening", softening, shape, wp.vec2d),
            )
            for stiffness, softening in layers
        ]

    def layer_model(self, layer: tuple[wp.array, wp.array]) -> list[wp.array]:
        """`elastic_model` of one of the `layers`: it bends, it neither stretches nor twists."""
        stiffness, softening = layer
        nothing = wp.zeros_like(self.twisting_stiffness)
        return [
            self.rest_length,
            wp.zeros_like(self.stretching_stiffness),
            stiffness,
            stiffness,
            self.natural_curvature,
            softening,
            nothing,
            nothing,
        ]

    def set_softening(self, softening) -> None:
        """Give every rod its law: (rod, node, 2) as in the constructor, broadcast.

        Raises:
            RodError: the shape does not broadcast, or a c is negative or not finite.
        """
        shape = (self.rod_count, self.node_count, 2)
        array = self._array("softening", softening, shape, wp.vec2d)
        value = np.atleast_1d(softening)
        if value[..., 0].min() < 0.0:
            raise RodError("softening is negative; a rod that stiffens as it bends is not modelled")
        self.softening = array
        self.softens = bool(value[..., 0].any())

    def _inelastic(self, number) -> wp.array | None:
        """The rods' laws that remember, and what they remember; None where there are none."""
        number = np.asarray(number, dtype=np.float64)
        if not number.any():
            return None
        shape = (self.rod_count, self.node_count)
        number = self._array("inelastic", number, (*shape, 4), wp.vec4d)
        node = wp.zeros(shape, dtype=Inelastic, device=self.device)
        wp.launch(set_inelastic_laws, shape, [number], [node], device=self.device)
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
        if not isinstance(position, wp.array):
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
        wp.launch(
            set_configuration,
            dim=(rods, nodes),
            inputs=[position, angle],
            outputs=[state.dof],
            device=device,
        )
        problem = wp.zeros(rods, dtype=wp.int32, device=device)
        wp.launch(
            set_reference_frames,
            dim=rods,
            inputs=[state.dof, director, source],
            outputs=[state.tangent, state.director, problem],
            device=device,
        )
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

    def transport_frames(self, source: RodState, target: RodState, active: wp.array) -> None:
        """Bring `target`'s frames to its own positions by time-parallel transport from `source`."""
        wp.launch(
            transport_reference_frames,
            dim=(self.rod_count, self.node_count - 1),
            inputs=[active, target.dof, source.tangent, source.director],
            outputs=[target.tangent, target.director],
            device=self.device,
        )
        self._launch_twist(source, target, active)

    def find_reference_twist(self, active: wp.array) -> None:
        """Reference twist of the active rods out of their frames, nearest to what it was."""
        self._launch_twist(self.state, self.state, active)

    def _launch_twist(self, source: RodState, target: RodState, active: wp.array) -> None:
        wp.launch(
            reference_twist,
            dim=(self.rod_count, self.node_count - 2),
            inputs=[active, target.tangent, target.director, source.reference_twist],
            outputs=[target.reference_twist],
            device=self.device,
        )

    @property
    def elastic_model(self) -> list[wp.array]:
        """What the elastic energy depends on besides the state: rest lengths, stretching and
        bending stiffness, that of bending's invariant (`wrod.kernels.elastic.bending`), natural
        curvature, softening, twisting stiffness, natural twist."""
        return [
            self.rest_length,
            self.stretching_stiffness,
            self.bending_stiffness,
            self.bending_stiffness,
            self.natural_curvature,
            self.softening,
            self.twisting_stiffness,
            self.natural_twist,
        ]

    def evaluate(
        self,
        *,
        order: int = 2,
        state: RodState | None = None,
        out: Derivatives | None = None,
        active: wp.array | None = None,
        model: list[wp.array] | None = None,
    ) -> Derivatives:
        """Energy and gradient (`order` 1) and Hessian (`order` 2) of every active rod.

        The frames of `state` must belong to its positions; `model` stands in for `elastic_model`.
        """
        state = self.state if state is None else state
        out = self.derivatives if out is None else out
        active = self.every_rod if active is None else active
        out.energy.zero_()
        out.gradient.zero_()
        if order == 2:
            out.hessian.zero_()
        results = [out.energy, out.gradient, out.hessian]

        def launch(kernel, count, inputs, outputs=results):
            wp.launch(
                kernel,
                dim=(self.rod_count, count),
                inputs=inputs,
                outputs=outputs,
                device=self.device,
            )

        nodes = self.node_count
        # The linear law has a kernel of its own: the general one costs grasps half as much again.
        terms = [(softened_elasticity if self.softens else elasticity, model or self.elastic_model)]
        terms += [(softened_elasticity, self.layer_model(layer)) for layer in self.layers]
        for kernel, numbers in terms:
            launch(
                kernel,
                nodes - 2,
                [
                    *numbers,
                    active,
                    state.dof,
                    state.director,
                    state.reference_twist,
                    order,
                ],
            )
        for kernel, number in self.energies:
            launch(
                kernel,
                nodes - 2,
                [
                    self.rest_length,
                    self.bending_stiffness,
                    self.natural_curvature,
                    self.twisting_stiffness,
                    self.natural_twist,
                    number,
                    active,
                    state.dof,
                    state.director,
                    state.reference_twist,
                    order,
                ],
            )
        launch(
            dead_loads,
            nodes,
            [self.node_mass, self.gravity, self.point_load, self.load_factor, active, state.dof],
            results[:2],
        )
        return out

    def walk(
        self, kernel: wp.Kernel, inputs: list, outputs: Sequence = (), *, rods: int | None = None
    ) -> None:
        """Launch a kernel that walks along the rods, over (rod, lane); see `kernels.lanes`."""
        count = lanes(self.device)
        wp.launch(
            kernel,
            dim=(self.rod_count if rods is None else rods, count),
            inputs=inputs,
            outputs=outputs,
            device=self.device,
            block_dim=count,
        )

    def positions(self) -> np.ndarray:
        """(rod, node, 3) node positions."""
        return node_positions(self.state.dof.numpy())

    def material_directors(self) -> np.ndarray:
        """(rod, node - 1, 2, 3) material directors m_1, m_2 of every edge."""
        angle = self.state.dof.numpy()[:, 3::4, None]
        d1, t = self.state.director.numpy(), self.state.tangent.numpy()
        d2 = np.cross(t, d1)
        m1 = np.cos(angle) * d1 + np.sin(angle) * d2
        return np.stack([m1, np.cross(t, m1)], axis=2)


def node_positions(dof: np.ndarray) -> np.ndarray:
    """(rod, node, 3) positions out of (rod, 4 node - 1) degrees of freedom."""
    padded = np.pad(dof, ((0, 0), (0, 1)))
    return padded.reshape(dof.shape[0], -1, 4)[:, :, :3]


def full_hessian(band: np.ndarray) -> np.ndarray:
    """Dense symmetric (dof, dof) matrix out of one rod's lower band (dof, 11)."""
    n = band.shape[0]
    dense = np.zeros((n, n))
    for k in range(min(band.shape[1], n)):
        rows = np.arange(k, n)
        dense[rows, rows - k] = dense[rows - k, rows] = band[k:, k]
    return dense
