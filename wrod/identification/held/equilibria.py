"""Cables that are held at their ends, as rods on meshes whose first and last edges are halfway in;
and equilibria of those that are clamped in a hand, in its plane.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from wrod.identification.held.measurements import HeldCable
from wrod.rods.batch import RodBatch
from wrod.rods.law import BendingLaw, Linear, Plastic
from wrod.rods.model import RodModel
from wrod.rods.state import node_positions
from wrod.solvers.inelastic import InternalVariables
from wrod.solvers.statics import EquilibriumSolver, prescribe

# A cable hardly stretches: EA over B / L^2.
_STRETCH = 3e4
_LINEAR = Linear()
_EDGES = 30
# Increments in which the loads are put on, so that a cable stays on gravity's side.
_TURNS = 12


def cable_model(
    length: float,
    stiffness: float,
    line_mass: float,
    *,
    twist_ratio: float = 1.0,
    stretching: float = 0.0,
    curvature: float = 0.0,
    law: BendingLaw = _LINEAR,
    tip_mass: float = 0.0,
    gravity: float = 9.81,
) -> RodModel:
    """A uniform cable that touches nothing.

    Args:
        length: [m].
        stiffness: bending stiffness B [N m^2]; line_mass: [kg/m].
        twist_ratio: twisting over bending stiffness [-].
        stretching: stretching stiffness [N], where it is more than a usual share of B / L^2.
        curvature: natural one towards m_2 [1/m].
        law: of bending.
        tip_mass: at the end [kg].
        gravity: [m/s^2].
    """
    return RodModel(
        length=length,
        bending_stiffness=stiffness,
        twisting_stiffness=twist_ratio * stiffness,
        stretching_stiffness=max(stretching, _STRETCH * stiffness / length**2),
        line_mass=line_mass,
        radius=1e-3 * length,
        natural_curvature=(0.0, curvature),
        point_masses=((length, tip_mass),) if tip_mass else (),
        law=law,
        gravity=gravity,
    )


def between_ends(length: float, edges: int) -> np.ndarray:
    """(edges + 2,) arc lengths of the nodes of a cable held at both ends [m]: the first and the
    last of them are half an edge beyond it."""
    return length / edges * (np.arange(edges + 2) - 0.5)


def held_batch(
    cables: Sequence[RodModel],
    arc_length: np.ndarray,
    position: np.ndarray,
    *,
    both: bool,
    gravity: np.ndarray | None = None,
    device: str,
) -> RodBatch:
    """Cables on meshes, their first edge held, or the edges at both ends, m_1 along +y there.

    Args:
        cables: one a row; arc_length: (row, node) or (node,) of its nodes [m].
        position: (row, node, 3) [m].
        gravity: (3,) acceleration; default: the cables', along -z.
    """
    batch = RodBatch.of(
        cables, arc_length, position, director=(0.0, 1.0, 0.0), gravity=gravity, device=device
    )
    ends = ((0, 1, -2, -1), (0, -1)) if both else ((0, 1), (0,))
    prescribe(batch, clamped_nodes=ends[0], clamped_angles=ends[1])
    return batch


@dataclass(frozen=True)
class CableModel:
    """What a cable clamped in a hand is.

    Attributes:
        stiffness: bending stiffness B [N m^2]; of a cable that yields what is left then.
        curvature: natural curvature in the plane, positive towards +x of the hand [1/m].
        tilt: turn of the clamp from the hand's axis, towards +x [rad].
        friction: how much more moment than B times its excess curvature a cable has once it has
            yielded (its strands have slipped), over B [1/m]; 0: none.
        kept: B over the stiffness before it yields [-].
    """

    stiffness: float
    curvature: float = 0.0
    tilt: float = 0.0
    friction: float = 0.0
    kept: float = 1.0

    @property
    def law(self) -> BendingLaw:
        """Of bending, of a rod with the stiffness `first`."""
        if not (self.friction > 0.0 and self.kept < 1.0):
            return _LINEAR
        # Beyond k_y the moment is B / r (k_y + r (e - k_y)).
        return Plastic(self.friction * self.kept / (1.0 - self.kept), self.kept)

    @property
    def first(self) -> float:
        """Bending stiffness before it yields [N m^2]."""
        return self.stiffness / (self.kept if self.law.remembers else 1.0)


def markers(
    cases: Sequence[tuple[HeldCable, float, CableModel]], device: str = "cpu"
) -> tuple[np.ndarray, np.ndarray]:
    """(case, 2, 2) middle and end in the hand's frame [m], and (case,) whether it converged.

    Args:
        cases: a cable, the hand's angle [rad] and a model each; all are solved at once. The hand
            is thought to turn from hanging straight down to its angle, the cable following.
    """
    count = len(cases)
    batch = batch_of(cases, device=device)
    solver, memory = EquilibriumSolver(batch), InternalVariables(batch)
    forever = wp.full(count, np.inf, dtype=wp.float64, device=device)
    good = np.ones(count, dtype=bool)
    angle = np.array([angle for _, angle, _ in cases])
    gravity = np.array([cable.gravity for cable, _, _ in cases])
    for k in range(1, _TURNS + 1):
        turned = angle * k / _TURNS
        pull = gravity[:, None] * np.column_stack(
            [np.sin(turned), np.zeros(count), -np.cos(turned)]
        )
        batch.gravity.assign(pull)
        good &= solver.solve(ramp_loads=k == 1, tolerance=1e-7).converged
        memory.finish(batch.every_rod, forever)
    return marked(node_positions(batch.state.dof.numpy())), good


def marked(nodes: np.ndarray) -> np.ndarray:
    """(..., 2, 2) middle and end, in the plane, of (..., node, 3)."""
    half = _EDGES // 2
    # The first node is half an edge behind the clamp, so markers are between two nodes.
    mid = 0.5 * (nodes[..., half, :] + nodes[..., half + 1, :])
    return np.stack([mid, nodes[..., -1, :]], axis=-2)[..., [0, 2]]


def mesh(length: float) -> np.ndarray:
    """(node,) distance of the nodes from the clamp along a cable [m]; the first is behind it."""
    edge = length / _EDGES
    return np.concatenate([[-0.5 * edge, 0.5 * edge], edge * np.arange(1.5, _EDGES), [length]])


def batch_of(
    cases: Sequence[tuple[HeldCable, float, CableModel]],
    *,
    position: np.ndarray | None = None,
    device: str = "cpu",
) -> RodBatch:
    """The cables as rods clamped at their first edge, without gravity.

    Args:
        cases: see `markers`; the angle does not matter.
        position: (case, node, 3) first shapes [m]; default: straight.
    """
    known: dict[tuple, RodModel] = {}
    rods = []
    for cable, _, model in cases:
        key = (id(cable), model)
        if key not in known:
            known[key] = cable_model(
                cable.length,
                model.first,
                cable.cable_mass / cable.length,
                curvature=model.curvature,
                law=model.law,
                tip_mass=cable.tip_mass,
                gravity=cable.gravity,
            )
        rods.append(known[key])
    s = np.array([mesh(cable.length) for cable, *_ in cases])
    if position is None:
        tilt = np.array([model.tilt for *_, model in cases])
        down = np.column_stack([np.sin(tilt), np.zeros(len(tilt)), -np.cos(tilt)])
        position = s[:, :, None] * down[:, None]
    return held_batch(rods, s, position, both=False, gravity=np.zeros(3), device=device)
