"""How rods come into a Newton builder."""

import os
from pathlib import Path

import newton
import numpy as np

from wrod import arguments
from wrod.errors import RodError
from wrod.newton_solver import attributes
from wrod.newton_solver.curves import add_curves, write_curves
from wrod.newton_solver.described import add_cable, add_described
from wrod.newton_solver.meshed import MeshedRod
from wrod.rods.material import RodMaterial, ask_after_units
from wrod.rods.model import RodModel

_OF_JOINT = arguments.optional(arguments.number(above=0.0))
# What Newton's description of a rod comes with.
_DESCRIBED = {
    "rod": arguments.like("a newton.Rod", "points", "edges", "quaternions"),
    "stretch_stiffness": _OF_JOINT,
    "bend_stiffness": _OF_JOINT,
    "twist_stiffness": _OF_JOINT,
    "bend_damping": arguments.optional(arguments.number(0.0, 1e12)),
}
_COLOR = arguments.several(arguments.number(0.0, 1.0), least=3)


class RodBuilding:
    """What `SolverDER` says to builders."""

    @classmethod
    @arguments.checked(RodError)
    def register_custom_attributes(cls, builder: newton.ModelBuilder) -> None:
        """Tell a builder what rods are: call it before `add_rod`, and on the builder that a
        scene of rods is added to or replicated in.

        Args:
            builder: The model builder.
        """
        attributes.register(builder)

    @classmethod
    @arguments.checked(
        RodError,
        points=arguments.array((None, 3)),
        material=arguments.like("a wrod.RodModel or wrod.RodMaterial", "radius", "length"),
        start_body=arguments.whole(-1),
        end_body=arguments.whole(-1),
        director=arguments.optional(arguments.array((3,), (None, 3))),
        velocity=arguments.array((), (3,), (None, 3)),
        natural_curvature=arguments.optional(arguments.array((2,), (None, 2))),
        natural_twist=arguments.optional(arguments.array((), (None,))),
        rest_length=arguments.optional(arguments.array((), (None,))),
        air_damping=arguments.optional(arguments.number(0.0, 1e9)),
        internal_damping=arguments.optional(arguments.number(0.0, 1e9)),
        color=arguments.optional(_COLOR),
    )
    def add_rod(
        cls,
        builder: newton.ModelBuilder,
        points: np.ndarray,
        material: RodModel | RodMaterial,
        *,
        start: str = "free",
        start_body: int = -1,
        end: str = "free",
        end_body: int = -1,
        director: np.ndarray | None = None,
        velocity: np.ndarray | float = 0.0,
        natural_curvature: np.ndarray | None = None,
        natural_twist: np.ndarray | float | None = None,
        rest_length: np.ndarray | float | None = None,
        touches_rods: bool = True,
        air_damping: float | None = None,
        internal_damping: float | None = None,
        visible: bool = True,
        color: tuple[float, float, float] | None = None,
        label: str | None = None,
    ) -> int:
        """Add a rod to a builder that knows rods (`register_custom_attributes`).

        Its weight acts with the model's gravity.

        Args:
            builder: The model builder.
            points: (node, 3) first shape, 3 nodes or more [m].
            material: What the rod is, from the first node on; its `length` and `gravity` are
                not used.
            start: How the first node is held: "free", "pinned" (place) or "clamped" (place,
                direction and twist, which a bent shape's first two edges have at the node).
            start_body: What holds it: a body, or -1 for the world.
            end: How the last node is held.
            end_body: What holds it.
            director: (3,) first material director of the first edge, carried along the rod without
                twist, or (node - 1, 3) those of all edges. Defaults to any direction across it.
            velocity: (node, 3) first velocities [m/s].
            natural_curvature: (2,) or (node, 2) curvature at rest (c_1, c_2) with
                dt/ds = c_1 m_1 + c_2 m_2 in the material frame [1/m]. Defaults to the rod's;
                the first shape does not count.
            natural_twist: (node,) twist at rest [rad/m]. Defaults to the rod's.
            rest_length: (node - 1,) unstretched lengths of the edges [m]. Defaults to those given.
            touches_rods: Whether it touches itself and others, where the solver's `rod_contact`
                lets rods do so.
            air_damping: Drag per mass and velocity [1/s]. Defaults to the rod's.
            internal_damping: Kelvin-Voigt time of the material [s]. Defaults to the rod's; one that
                says nothing has none here, as swings should not be damped unasked, where a
                deployment takes 65 ms.
            visible: Show the rod by a kinematic capsule on every edge, which the solver moves.
            color: Of the capsules.
            label: Of the rod's bodies and shapes.

        Returns:
            The index of the rod.

        Raises:
            RodError: The builder does not know rods, or an argument is unusable.
        """
        rod = MeshedRod.of(
            RodModel.of(material), points, director, velocity, natural_curvature, natural_twist,
            rest_length,
        )  # fmt: skip
        lgb = rod.model.gravito_bending_length
        ask_after_units(rod.model.radius, float(rod.rest.sum()), lgb, stacklevel=4)
        held = (start, start_body), (end, end_body)
        damping, look = (air_damping, internal_damping), (visible, color, label)
        return attributes.add_rod(builder, rod, held, damping, touches_rods, look)

    @classmethod
    @arguments.checked(RodError, density=arguments.number(0.0, 1e6), **_DESCRIBED)
    def add_newton_rod(
        cls,
        builder: newton.ModelBuilder,
        rod: newton.Rod,
        *,
        density: float = 1000.0,
        stretch_stiffness: float | None = None,
        bend_stiffness: float | None = None,
        twist_stiffness: float | None = None,
        bend_damping: float | None = None,
        **options,
    ) -> list[int]:
        """Add what a `newton.Rod` describes: a chain, a ring (`closed`) or branches (`edges`).

        Rigidities, initial and rest shape and twist are the description's. Shear rigidity is not
        used: edges do not shear. Where a ring closes or branches meet, a body that weighs a
        hundredth of an edge clamps their ends, as they lie first.

        Args:
            builder: The model builder.
            rod: The description.
            density: Mass per volume of the rod [kg/m^3].
            stretch_stiffness: Of each joint, as Newton's `add_rod` takes it [N/m]: times the length
                of an edge (of unequal ones, half of both beside it), EA. Defaults to the
                description's, or to Newton's 1e5.
            bend_stiffness: Of each joint [N m/rad]: times the length of an edge, EI. Defaults to
                the description's.
            twist_stiffness: Of each joint [N m/rad]: times the length of an edge, GJ. Defaults to
                the description's, or to `bend_stiffness`.
            bend_damping: Of each joint [N m s/rad]: over its stiffness, the Kelvin-Voigt time
                `internal_damping`, which all strains have in common.
            options: Of `add_rod`: air_damping, internal_damping, visible, color, label,
                touches_rods; of a chain start, start_body, end, end_body too.

        Returns:
            The indices of the rods, one for each chain between branches.

        Raises:
            RodError: Nothing says how stiff it is, or an option is unusable.
        """
        joints = dict(
            stretch_stiffness=stretch_stiffness, bend_stiffness=bend_stiffness,
            twist_stiffness=twist_stiffness, bend_damping=bend_damping,
        )  # fmt: skip
        added = add_described(builder, rod, density, joints, cls.add_rod, **options)
        return [index for index, _ in added]

    @classmethod
    @arguments.checked(
        RodError, cfg=arguments.optional(arguments.like("a ShapeConfig", "density")), **_DESCRIBED
    )
    def add_cable(
        cls,
        builder: newton.ModelBuilder,
        *,
        rod: newton.Rod,
        cfg: newton.ModelBuilder.ShapeConfig | None = None,
        stretch_stiffness: float | None = None,
        bend_stiffness: float | None = None,
        twist_stiffness: float | None = None,
        bend_damping: float | None = None,
        **options,
    ) -> tuple[list[int], list[int]]:
        """`add_newton_rod` in the place of `ModelBuilder.add_rod`, with its arguments and what it
        returns, so that a scene may go on as with capsules of Newton's.

        A capsule whose mass the scene sets to 0 is no longer moved, but holds its edge: it may be
        put elsewhere by its pose. Forces on the others (`state_in.body_f`) are those on the nodes
        beside them; torques as far as they are across the edge.

        Args:
            builder: The model builder.
            rod: The description.
            cfg: Of the capsules; only its density counts, of the rod. Defaults to the builder's.
            stretch_stiffness, bend_stiffness, twist_stiffness, bend_damping: As of
                `add_newton_rod`.
            options: label, color; and, without effect, stretch_damping, twist_damping,
                shear_stiffness, shear_damping, wrap_in_articulation, junction_collision_filter.

        Returns:
            The capsules, in the order of the description's edges, and the joints that tie each to
            the world; of a branch of a single edge, which is halved, the first half's.

        Raises:
            RodError: Nothing says how stiff it is, or an argument is unusable.
        """
        joints = dict(
            stretch_stiffness=stretch_stiffness, bend_stiffness=bend_stiffness,
            twist_stiffness=twist_stiffness, bend_damping=bend_damping,
        )  # fmt: skip
        return add_cable(builder, rod, cfg, joints, options, cls.add_rod)

    @classmethod
    @arguments.checked(
        RodError,
        source=arguments.either(arguments.path, arguments.like("a Usd.Stage", "Traverse")),
    )
    def add_usd(cls, builder: newton.ModelBuilder, source, **options) -> dict[str, list[int]]:
        """Add the cables of a USD stage: linear `BasisCurves` with PhysicsCurvesDeformableSimAPI,
        each with its own physics material, as Newton's importer reads them.

        Args:
            builder: The model builder.
            source: A `Usd.Stage`, or the path of a file.
            options: Of `add_rod`, for all of them.

        Returns:
            The indices of the rods by the paths of their curves.

        Raises:
            SceneError: the file is not a readable USD stage.
            RodError: There is no such file, a curve is not linear or a ring, or its material lacks
                a stiffness or density.
        """
        return add_curves(builder, source, cls.add_rod, **options)

    @classmethod
    @arguments.checked(RodError)
    def write_usd(cls, model: newton.Model, state: newton.State, path: str | os.PathLike[str]):
        """Write all rods as they are in `state` to a USD file that `add_usd` reads, and Newton's
        own importer; what another body than the world holds is free there.

        Raises:
            RodError: A rod varies along itself, is not straight at rest, or has a past, or the
                path is none of a USD file.
        """
        return write_curves(model, state, Path(path))

    @classmethod
    @arguments.checked(
        RodError,
        rod=arguments.whole(0),
        body=arguments.whole(-1),
        node=arguments.whole(0),
    )
    def attach(
        cls, builder: newton.ModelBuilder, rod: int, body: int, *, node: int, kind: str = "clamped"
    ) -> None:
        """Let a body hold a rod somewhere along it, as the rod lies to the body now.

        Args:
            builder: The model builder.
            rod: Index that `add_rod` returned.
            body: What holds it: a body, or -1 for the world.
            node: Which node, from 0 on.
            kind: "pinned" (the node's place, a ball joint) or "clamped" (place, direction and
                twist of the edge after the node).

        Raises:
            RodError: There is no such rod, body or node, or something holds it already.
        """
        attributes.attach(builder, rod, body, node, kind)
