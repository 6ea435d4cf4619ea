"""Cables between a fixed end and a robot's gripper, moved and twisted from straight."""

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from wrod.identification.held.equilibria import between_ends, cable_model, held_batch
from wrod.identification.held.measurements import HeldPoses
from wrod.rods.rotation import angle_about, transport
from wrod.rods.state import node_positions
from wrod.solvers.statics import EquilibriumSolver

_EDGES = 40
_WAYPOINTS = 24


def pose_shapes(
    poses: HeldPoses, cases: Sequence[tuple[int, int, float, float, float]], device: str = "cpu"
) -> tuple[np.ndarray, np.ndarray]:
    """Where cables come to rest whose gripper goes from the straight start to its pose.

    Robot's frame, z up, the gripper's start at the origin and the fixed end at (length, 0, 0). The
    gripper shifts, turns, and twists the cable all at once and slowly, the cable following.

    Args:
        poses: lengths, weights and what the gripper did.
        cases: (cable, pose, B [N m^2], twisting over bending stiffness, sense of the end's turn:
            1 or -1) each.

    Returns:
        (case, point, 3) places of `poses.arc_length` from the fixed end [m], and (case,) whether
        every step of the way converged.
    """
    count, length = len(cases), poses.length
    cable, pose = np.array([c[:2] for c in cases], dtype=int).T
    bend, ratio, sense = np.array([c[2:] for c in cases], dtype=float).T
    h, s = length / _EDGES, between_ends(length, _EDGES)
    straight = np.zeros((count, len(s), 3))
    straight[:, :, 0] = length - s
    rods = [
        cable_model(length, *numbers[:2], twist_ratio=numbers[2])
        for numbers in zip(bend, poses.mass_per_length[cable], ratio, strict=True)
    ]
    batch = held_batch(rods, s, straight, both=True, device=device)
    solver = EquilibriumSolver(batch)
    good = np.ones(count, dtype=bool)
    for step in range(_WAYPOINTS + 1):
        part = step / _WAYPOINTS
        frame = Rotation.from_rotvec(part * poses.gripper_turn[pose])
        tangent = frame.apply([-1.0, 0.0, 0.0])
        roll = Rotation.from_rotvec(
            (part * sense * poses.end_turn[pose])[:, None] * tangent
        )  # fmt: skip
        director = roll.apply(frame.apply([0.0, 1.0, 0.0]))
        at = part * poses.gripper_shift[pose]
        target = batch.state.dof.numpy().copy()
        target[:, -7:-4], target[:, -3:] = at - 0.5 * h * tangent, at + 0.5 * h * tangent
        carried = transport(
            batch.state.director.numpy()[:, -1], batch.state.tangent.numpy()[:, -1], tangent
        )
        angle = angle_about(tangent, carried, director)
        before = target[:, -4]
        target[:, -4] = angle + 2.0 * np.pi * np.rint((before - angle) / (2.0 * np.pi))
        good &= solver.solve(
            prescribed=target, ramp_loads=step == 0, tolerance=1e-7, max_iterations=60
        ).converged
    nodes = node_positions(batch.state.dof.numpy())
    return CubicSpline(s, nodes, axis=1)(poses.arc_length), good


def rigid_rms(measured: np.ndarray, predicted: np.ndarray) -> float:
    """RMS distance [m] of (point, 3) from (point, 3) after the rigid motion that makes it least."""
    a, b = measured - measured.mean(axis=0), predicted - predicted.mean(axis=0)
    turn = Rotation.align_vectors(a, b)[0]
    return float(np.sqrt(((a - turn.apply(b)) ** 2).sum(axis=1).mean()))
