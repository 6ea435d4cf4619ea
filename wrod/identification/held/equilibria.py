"""Equilibria of cables clamped in a hand, in its plane."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wrod.identification.held.measurements import HeldCable
from wrod.rods.batch import RodBatch
from wrod.rods.state import node_positions
from wrod.solvers.statics import EquilibriumSolver, prescribe

_EDGES = 30
# A cable in the hand hardly stretches: EA over B / L^2.
_STRETCH = 3e4
# Increments in which the loads are put on, so that a cable stays on gravity's side.
_TURNS = 12


@dataclass(frozen=True)
class CableModel:
    """What a cable clamped in a hand is.

    Attributes:
        stiffness: bending stiffness B of the straight cable [N m^2].
        curvature: natural curvature in the plane, positive towards +x of the hand [1/m].
        softening: c [m^2] and kept share r of the moment B e (r + (1 - r) / (1 + c e^2)) that
            belongs to a curvature e beyond the natural one; c = 0 is linear.
        kept: r.
        tilt: turn of the clamp from the hand's axis, towards +x [rad].
        scale: of the markers' distances, seen over true [-].
        mass_ratio: weight of the cable and what hangs on it, true over told [-].
    """

    stiffness: float
    curvature: float = 0.0
    softening: float = 0.0
    kept: float = 0.3
    tilt: float = 0.0
    scale: float = 1.0
    mass_ratio: float = 1.0


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
    solver = EquilibriumSolver(batch)
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
    scale = np.array([model.scale for *_, model in cases])[:, None, None]
    return scale * marked(node_positions(batch.state.dof.numpy())), good


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
    inelastic: np.ndarray | float = 0.0,
    device: str = "cpu",
) -> RodBatch:
    """The cables as rods clamped at their first edge, without gravity.

    Args:
        cases: see `markers`; the angle does not matter.
        position: (case, node, 3) first shapes [m], edges of the mesh's lengths; default: straight.
        inelastic: (case, 1, 4) law of bending that remembers, see `RodBatch`.
    """
    rods = len(cases)
    mass, straight, stretching = [], [], []
    for cable, _, model in cases:
        s = mesh(cable.length)
        straight.append(s[:, None] * [np.sin(model.tilt), 0.0, -np.cos(model.tilt)])
        half = 0.5 * cable.cable_mass * model.mass_ratio / cable.length * np.diff(s)
        mass.append(np.append(half, cable.tip_mass) + np.append(0.0, half))
        stretching.append(_STRETCH * model.stiffness / cable.length**2)
    bend = np.array([model.stiffness for *_, model in cases])[:, None]
    curvature = np.zeros((rods, 1, 2))
    # First director across the plane (+y), second in it towards +x.
    curvature[:, 0, 1] = [model.curvature for *_, model in cases]
    softening = np.array([(model.softening, model.kept) for *_, model in cases])
    batch = RodBatch(
        np.array(straight) if position is None else position,
        stretching_stiffness=np.array(stretching)[:, None],
        bending_stiffness=bend,
        twisting_stiffness=bend,
        natural_curvature=curvature,
        softening=softening[:, None, :],
        inelastic=inelastic,
        node_mass=np.array(mass),
        gravity=np.zeros((rods, 3)),
        director=np.array([0.0, 1.0, 0.0]),
        device=device,
    )
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    return batch
