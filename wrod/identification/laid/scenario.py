"""Scenarios in which a photographed rod may have been laid, and where the rod comes to lie there.

A scenario says what the plan does not know: the table's friction, the rod's true L_gb and natural
curvature, how it is rolled in the grip, and how much more of it hangs below the grip than the plan
believes. The rod hangs from the grip with its free end on the pattern's first point, as a robot
begins that goes straight above the contact; or its first centimetres are held along the pattern
until the rod lies beyond them.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from wrod.deployment.discretisation import Discretisation
from wrod.deployment.plan import plan
from wrod.deployment.simulate import Trial, nodes_needed, simulate_deployments
from wrod.errors import DataError
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel
from wrod.solvers.friction import Friction

# Length of the free end that is held along the pattern, where it is held [m].
HELD = 0.05
# Of the contact [m/s]; what is laid faster sways, and is followed by shorter steps [s].
SPEED = 0.02
_SWAYS, _SWAYING_STEP = 0.05, 0.0125
_MESH = Discretisation(spacing=0.01, step=0.025)
# The grip rests for so long before it would let go, in the deployment's schedule [s].
_RESTING = 0.45


@dataclass(frozen=True)
class Scenario:
    """What a plan does not know of a table and a rod.

    Attributes:
        friction: Coulomb coefficient of the table [-].
        lgb_ratio: true over believed L_gb [-].
        curvature: natural curvature [1/m], and roll: from left towards up, as the rod is held
            [rad].
        excess: how much more rod hangs below the grip than the plan believes [m].
        radius_ratio: true over believed radius at the same weight and bending stiffness; below 1
            the rod stretches less, by its square [-].
        held: whether the first 5 cm are held along the pattern until 1 L_gb more is laid; otherwise
            the rod hangs straight above the pattern's first point and its free end is let go.
        damping: Kelvin-Voigt time of the rod's material [s]; None: as deployments take it.
        speed: of laying [m/s].
    """

    friction: float = 0.4
    lgb_ratio: float = 1.0
    curvature: float = 0.0
    roll: float = 0.0
    excess: float = 0.0
    radius_ratio: float = 1.0
    held: bool = False
    damping: float | None = None
    speed: float = SPEED

    @property
    def alike(self) -> tuple:
        """Only scenarios that agree in this are laid together."""
        return self.held, self.speed

    def rod(self, believed: RodMaterial) -> RodMaterial:
        """The rod as it is in this scenario."""
        return replace(
            believed,
            gravito_bending_length=believed.gravito_bending_length * self.lgb_ratio,
            natural_curvature=(
                self.curvature * float(np.cos(self.roll)),
                self.curvature * float(np.sin(self.roll)),
            ),
            length=believed.length + self.excess,
            radius=believed.radius * self.radius_ratio,
        )

    def damped(self, believed: RodMaterial) -> RodModel:
        """The same rod with its internal damping."""
        return replace(RodModel.of(self.rod(believed)), internal_damping=self.damping)

    def trial(self, pattern: Pattern, believed: RodMaterial, trajectory: Trajectory) -> Trial:
        """Of a plan that knows none of this. Nothing is laid after the pattern: what photographs
        show was laid before."""
        return Trial(
            pattern, self.damped(believed), trajectory, Friction(self.friction),
            tail=Tail.none(trajectory), another_rod=True,
        )  # fmt: skip

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class LaidRod:
    """Where a rod lies and hangs while the grip still holds; the table at z = 0.

    Attributes:
        arc_length: (node,) [m]; nodes: (node, 3) [m].
        reached: whether the simulation came so far.
    """

    arc_length: np.ndarray
    nodes: np.ndarray
    reached: bool

    def at(self, arc_length: np.ndarray) -> np.ndarray:
        """(n, 3) places [m] at arc lengths (n,) [m], by a cubic spline: chords of edges of 1 cm cut
        a bend of 20 /m by 0.25 mm. Beyond an end there is none but the end."""
        s = self.arc_length
        return CubicSpline(s, self.nodes)(np.clip(arc_length, s[0], s[-1]))


def plan_without_lead_in(pattern: Pattern, rod: RodMaterial, method: str, **options) -> Trajectory:
    """The paper's plan: nothing is laid before the pattern's first point."""
    return plan(pattern, rod, method=method, remainder=False, **options)


def own_mesh(
    mesh: Discretisation, pattern: Pattern, believed: RodMaterial, trajectory: Trajectory
) -> Discretisation:
    """With as many nodes as the believed rod needs, whatever it is laid together with: where a rod
    comes to lie hangs on its mesh."""
    if mesh.node_count is not None:
        return mesh
    trial = Trial(pattern, believed, trajectory, Friction(0.0))
    return replace(mesh, node_count=nodes_needed([trial], mesh.spacing, mesh.laid))


def begun(held: bool, believed: RodMaterial) -> dict[str, Any]:
    """How the free end begins, as `wrod.simulate_deployments` takes it.

    A grip straight above the contact keeps the rod taut, and the table is touched some L_gb later
    than planned: let go at once the held end would be snatched, by more or less as its mesh has it.
    """
    if not held:
        return {"hold": 0.0}
    return {"hold": HELD, "release": HELD + believed.gravito_bending_length}


def lay(
    pattern: Pattern,
    believed: RodMaterial,
    trajectory: Trajectory,
    scenarios: Sequence[Scenario],
    *,
    discretisation: Discretisation = _MESH,
    device: str = "cpu",
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[LaidRod]:
    """Lay one rod along one pattern in many scenarios at once, up to where the pattern ends.

    Args:
        pattern, believed, trajectory: what was planned.
        scenarios: what is true.
        discretisation, device, threads, progress: as `wrod.simulate_deployments` takes them.

    Raises:
        DataError: scenarios are mixed in how the free end begins, or in speed.
    """
    if len({scenario.alike for scenario in scenarios}) > 1:
        raise DataError(
            "scenarios differ in whether the free end is held, in speed, or in what else rods of "
            "one call have alike; lay them in two calls"
        )
    if not scenarios:
        return []
    first, mesh = scenarios[0], own_mesh(discretisation, pattern, believed, trajectory)
    if first.speed > _SWAYS:
        mesh = replace(mesh, step=min(_SWAYING_STEP, mesh.step))
    laid = simulate_deployments(
        [scenario.trial(pattern, believed, trajectory) for scenario in scenarios],
        **begun(first.held, believed),
        discretisation=mesh,
        speed=first.speed,
        device=device,
        threads=threads,
        progress=progress,
    )
    return [
        LaidRod(
            one.arc_length, one.centerline, not one.diverged or one.duration > one.let_go - _RESTING
        )
        for one in laid
    ]
