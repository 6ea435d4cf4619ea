"""A batch of discrete elastic rods: its arrays, and their energies, gradients and Hessians."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.elastic.bending import elasticity
from wrod.kernels.elastic.frames import transport_reference_frames
from wrod.kernels.elastic.loads import dead_loads
from wrod.kernels.elastic.model import ElasticModel
from wrod.kernels.elastic.softened_bending import softened_elasticity
from wrod.kernels.lanes import CROWD, LONG, WARP, lanes
from wrod.kernels.stepping.continuation import copy_configuration
from wrod.rods.arrays import BatchArrays
from wrod.rods.device import resolve_device
from wrod.rods.state import Derivatives, RodState, node_positions

IS_ROD = arguments.like("a wrod.RodModel or wrod.RodMaterial", "radius", "length")


class RodBatch(BatchArrays):
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

    @arguments.checked(RodError, position=arguments.mesh(finite=False))
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
        device: arguments.DeviceLike = "cpu",
    ):
        if not isinstance(position, wp.array):
            position = arguments.floats(position, "position", RodError)
        shape = (*position.shape, 3) if isinstance(position, wp.array) else position.shape
        if len(shape) != 3 or shape[2] != 3 or shape[1] < 3:
            raise RodError(
                f"rod positions have shape {shape}; give (rod, node, 3) with 3 nodes or more"
            )
        self.device = resolve_device(device)
        self.rod_count, self.node_count = rods, nodes = shape[:2]
        self.dof_count = 4 * self.node_count - 1
        if not isinstance(position, wp.array) and not np.isfinite(position).all():
            raise RodError("position holds a value that is not finite")
        if rest_length is None:
            rest_length = np.linalg.norm(np.diff(position, axis=1), axis=2)
        bending_stiffness = arguments.floats(bending_stiffness, "bending_stiffness", RodError)
        if bending_stiffness.ndim < 3:
            bending_stiffness = bending_stiffness[..., None]

        self.rest_length = self._array("rest_length", rest_length, (rods, nodes - 1), positive=True)
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
        self.energies = []
        self.layers = []
        self.inelastic = self._inelastic(inelastic)
        self.node_mass = self._array("node_mass", node_mass, (rods, nodes))
        self.gravity = self._array("gravity", gravity, (rods, 3), wp.vec3d)
        self.point_load = self._array("point_load", point_load, (rods, nodes, 3), wp.vec3d)
        self.load_factor = wp.ones(rods, dtype=wp.float64, device=self.device)
        self.free = wp.ones((rods, self.dof_count), dtype=wp.int32, device=self.device)
        self.every_rod = wp.ones(rods, dtype=wp.int32, device=self.device)
        self.state = RodState.zeros(rods, nodes, self.device)
        self._nothing = wp.zeros(0, dtype=wp.float64, device=self.device)
        self.derivatives = Derivatives.zeros(rods, self.dof_count, self.device)
        self.cut_edges = ()
        self.set_configuration(position, director=director)

    @classmethod
    @arguments.checked(
        RodError,
        rods=arguments.each(IS_ROD),
        arc_length=arguments.array((None,), (None, None)),
        position=arguments.array((None, None, 3)),
        clamped=arguments.several(arguments.flag, least=2),
        held=arguments.optional(arguments.whole(0)),
        director=arguments.optional(arguments.array((3,), (None, 3), (None, None, 3))),
        gravity=arguments.optional(arguments.array((3,), (None, 3))),
    )
    def of(
        cls,
        rods,
        arc_length: np.ndarray,
        position: np.ndarray,
        *,
        clamped: tuple[bool, bool] = (False, False),
        held: int | None = None,
        director=None,
        gravity=None,
        point_load=0.0,
        device: arguments.DeviceLike = "cpu",
    ) -> RodBatch:
        """Put rods on meshes; see `wrod.rods.discretisation`.

        What brakes them, inside and by air, is no energy: `wrod.Dynamics.of` takes it from them.

        Args:
            rods: a `RodModel` or `RodMaterial` for all rows, or one for each.
            arc_length: (rod, node) or (node,) unstretched arc length of the nodes [m].
            position: (rod, node, 3) of the nodes [m].
            clamped: whether the (first, last) edge is the ghost of a clamp: the rod begins at the
                second node, and the edge before has the clamp's direction.
            held: edge between others that a clamp holds: on both sides of it rods bend as if they
                ended there, and so stiffly once it opens.
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
        arrays = mesh_arrays(rods, arc_length, clamped=clamped, held=held)
        if gravity is not None:
            arrays["gravity"] = gravity
        if director is not None:
            edge = np.diff(position, axis=1)
            tangent = edge / np.linalg.norm(edge, axis=2, keepdims=True)
            every = np.ndim(director) == 3
            tangent = tangent if every else tangent[:, 0]
            director = arguments.spread(director, tangent.shape, "director", RodError)
            director = principal_directors(rods, director, tangent)
        return cls(position, director=director, point_load=point_load, device=device, **arrays)

    def transport_frames(self, source: RodState, target: RodState, active: wp.array) -> None:
        """Bring `target`'s frames to its own positions by time-parallel transport from `source`."""
        self.launch_edges(
            transport_reference_frames,
            [active, target.dof, source.tangent, source.director],
            [target.tangent, target.director],
        )
        self._launch_twist(source, target, active)

    def copy_states(self, chosen: wp.array, source: RodState, target: RodState) -> None:
        """The whole configuration of the chosen rods."""
        self.launch_spread(
            copy_configuration,
            self.node_count,
            [chosen, source.dof, source.tangent, source.director, source.reference_twist],
            [target.dof, target.tangent, target.director, target.reference_twist],
        )

    def find_reference_twist(self, active: wp.array) -> None:
        """Reference twist of the active rods out of their frames, nearest to what it was."""
        self._launch_twist(self.state, self.state, active)

    @property
    def launched(self) -> tuple:
        """What launches are made of besides the numbers in the arrays: recorded ones serve as long
        as it stays the same."""
        arrays = [*self.elastic_arrays, self.node_mass, self.gravity, self.point_load, self.free]
        arrays += [layer.bending for layer in self.layers] + [a for _, a in self.energies]
        kernels = [id(kernel) for kernel, _ in self.energies]
        return (self.softens, len(self.layers), *kernels, *(a.ptr for a in arrays))

    def evaluate(
        self,
        *,
        order: int = 2,
        state: RodState | None = None,
        out: Derivatives | None = None,
        active: wp.array | None = None,
        model: ElasticModel | None = None,
        energy: bool = True,
        energies: list | None = None,
    ) -> Derivatives:
        """Energy and gradient (`order` 1) and Hessian (`order` 2) of every active rod.

        The frames of `state` must belong to its positions; `model` stands in for `elastic_model`,
        `energies` for the attribute.
        Without `energy` that is not computed: it stays what it was.
        """
        state = self.state if state is None else state
        out = self.derivatives if out is None else out
        nodes = self.node_count
        active = self.every_rod if active is None else active
        if energy:
            out.energy.zero_()
        # On a GPU lanes of a warp overlap by two, and the first term writes where the others add.
        count, width, owned = nodes - 2, 1, 0
        if lanes(self.device) > 1:
            width, owned = WARP, WARP - 2
            count = -(-(nodes - 1) // owned) * WARP
        else:
            out.clear(order)
        results = [out.energy if energy else self._nothing, out.gradient, out.hessian]

        shape = [state.dof, state.director, state.reference_twist]
        # The linear law has a kernel of its own: the general one costs grasps half as much again.
        terms = [(softened_elasticity if self.softens else elasticity, model or self.elastic_model)]
        terms += [(softened_elasticity, layer) for layer in self.layers]
        for i, (kernel, numbers) in enumerate(terms):
            dim, inputs = (self.rod_count, count), [numbers, active, *shape, order, owned, i == 0]
            self.launch(kernel, dim, inputs, results, width)
        for kernel, number in self.energies if energies is None else energies:
            inputs = [self.elastic_model, number, active, *shape, order]
            self.launch_inner(kernel, inputs, results)
        self.launch_nodes(
            dead_loads,
            [self.node_mass, self.gravity, self.point_load, self.load_factor, active, state.dof],
            results[:2],
        )
        return out

    def launch_lanes(
        self, kernel: wp.Kernel, inputs: list, outputs: Sequence = (), *, rods: int | None = None
    ) -> None:
        """Launch a kernel that walks along the rods, over (rod, lane); see `kernels.lanes`."""
        count = lanes(self.device, CROWD if self.node_count > LONG else WARP)
        rods = self.rod_count if rods is None else rods
        self.launch(kernel, (rods, count), inputs, outputs, count)

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
