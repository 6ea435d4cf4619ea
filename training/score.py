"""Scores of a controller against the numeric solver, on inputs that no training has seen."""

from __future__ import annotations

import numpy as np

from wrod.bench.grasp import whole_range
from wrod.controller import Controller
from wrod.grasps import Grasps, solve_grasps


def figures(error: np.ndarray) -> dict:
    """Figures of (n, 6) errors: mean absolute, and of the position's and rotation's length."""
    position = np.linalg.norm(error[:, :3], axis=1)
    rotation = np.linalg.norm(error[:, 3:], axis=1)
    return {
        "grasps": len(error),
        "mean_absolute_error": float(np.abs(error).mean()),
        "position_error_mean": float(position.mean()),
        "position_error_p99": float(np.quantile(position, 0.99)),
        "position_error_max": float(position.max()),
        "rotation_error_p99": float(np.quantile(rotation, 0.99)),
        "rotation_error_max": float(rotation.max()),
    }


def held_out(count: int, *, seed: int, device: str = "cpu") -> tuple[np.ndarray, Grasps]:
    """(3, count) random inputs of the whole range and their numeric grasps.

    Half are uniform in l_s and half in its logarithm; kappa takes both signs.
    """
    inputs = np.stack(whole_range(count, seed))
    return inputs, solve_grasps(*inputs, device=device, shapes=False)


def score(controller: Controller, inputs: np.ndarray, grasps: Grasps) -> dict:
    """Figures (see `figures`) on (3, n) inputs; grasps without a numeric result are left out."""
    good = grasps.converged & grasps.stable
    position, rotation = controller.predict(*inputs)
    error = np.concatenate([position - grasps.position, rotation - grasps.rotation], axis=1)
    return {**figures(error[good]), "left_out": int(np.sum(~good))}
