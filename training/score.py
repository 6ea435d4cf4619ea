"""Scores of a controller against the numeric solver, on inputs that no training has seen."""

import numpy as np
from scipy.spatial.transform import Rotation
from wrod.training.sampling import RodInputs

from wrod.controller.controller import Controller
from wrod.grasps.inputs import whole_range
from wrod.grasps.optimal import solve_grasps
from wrod.grasps.results import Grasps


def figures(error: np.ndarray) -> dict:
    """Figures of (n, 6) errors: mean absolute, and of the position's and rotation's length; the
    rotation's may have a fourth component, the twist."""
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


def held_out(
    count: int,
    *,
    seed: int,
    device: str = "cpu",
    rod: RodInputs | None = None,
    closure: str = "zero_tension",
) -> tuple[np.ndarray, Grasps]:
    """(3, count) random inputs of the whole range, or of one rod's, and their numeric grasps.

    Half are uniform in l_s and half in its logarithm; kappa takes both signs.
    """
    if rod is None:
        inputs = np.stack(whole_range(count, seed))
        return inputs, solve_grasps(*inputs, device=device, shapes=False, closure=closure)
    rng = np.random.default_rng(seed)
    low, high = rod.range["suspended_length"]
    ls = np.where(
        np.arange(count) % 2 == 0,
        rng.uniform(low, high, count),
        low * (high / low) ** rng.uniform(size=count),
    )
    most = rod.range["curvature"][1]
    inputs = np.stack([ls, rng.uniform(-most, most, count), np.full(count, rod.stretch_ratio)])
    own = {"natural_curvature": rod.natural_curvature, "poisson": rod.poisson}
    return inputs, solve_grasps(*inputs, device=device, shapes=False, closure=closure, **own)


def score(controller: Controller, inputs: np.ndarray, grasps: Grasps) -> dict:
    """Figures (see `figures`) on (3, n) inputs; grasps that have no numeric result, or are outside
    the controller's range, are left out.

    Rotations of a naturally curved rod, which may be half a turn and more, are compared by the
    rotation vector from one to the other.
    """
    good = grasps.converged & grasps.stable & ~controller.out_of_range(*inputs)
    position, rotation, _, twist = controller.predict_with_twist(*inputs[:, good])
    turn = rotation - grasps.rotation[good]
    if twist is not None:
        solved = Rotation.from_rotvec(grasps.rotation[good])
        turn = (solved.inv() * Rotation.from_rotvec(rotation)).as_rotvec()
    error = np.concatenate([position - grasps.position[good], turn], axis=1)
    return {**figures(error), "left_out": int(np.sum(~good))}
