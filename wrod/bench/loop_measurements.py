"""Synthetic measurements of a clamped rod: what cameras and wrist would see of a true rod."""

from dataclasses import replace
from typing import Any

import numpy as np

from wrod.bench.continuous_rod import measured, world_of
from wrod.errors import DataError
from wrod.identification.clamped.setup import rotation_of
from wrod.identification.template import labels
from wrod.rods.material import RodMaterial
from wrod.rods.model import Rod, RodModel

# Length between the clamps [m], and markers along it, ends included.
_FREE_LENGTH, _MARKERS = 0.30, 21


def clamped_experiment(
    rod: Rod,
    believed: RodMaterial,
    *,
    trials: int = 16,
    test_trials: int = 4,
    noise: float = 3e-4,
    seed: int = 0,
) -> dict[str, np.ndarray]:
    """Measurements of a piece of `rod` between clamp and gripper, labelled as of `believed`.

    They are those of a continuous Kirchhoff rod solved by collocation, which shares neither mesh
    nor equations with what explains them.

    The gripper stands 70 % of the length between the clamps away, in random poses; both clamps roll
    together, so that what turns with the material is seen from every side.

    Args:
        rod: the rod that is measured: its first 30 cm.
        believed: the rod that its user takes it for: the numbers that the data come with.
        trials, test_trials: shapes in all, and how many of them are kept for scoring.
        noise: standard deviation of a marker coordinate [m].
        seed: of poses and noise.

    Returns:
        Arrays as `wrod.load_measurements` reads them from a file.

    Raises:
        DataError: too few trials, or the rod finds no equilibrium in a pose.
    """
    if not 0 < test_trials < trials:
        raise DataError(
            f"{trials} trials with {test_trials} to score on; give at least one trial of each kind"
        )
    rng = np.random.default_rng(seed)
    level = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])
    rolls = rng.uniform(-np.pi, np.pi, trials)
    clamp = np.stack([level @ rotation_of(np.array([0.0, 0.0, roll])) for roll in rolls])
    turns = rng.uniform(-0.35, 0.35, (trials, 3)) * [1.0, 1.0, 1.5]
    grip = np.stack([c @ rotation_of(turn) for c, turn in zip(clamp, turns, strict=True)])
    reach = _FREE_LENGTH * (rng.uniform(-0.1, 0.1, (trials, 3)) + [0.7, 0.0, 0.0])
    arc_length = np.linspace(0.0, _FREE_LENGTH, _MARKERS)
    foot = np.tile([0.3, -0.2, 0.5], (trials, 1))
    data: dict[str, Any] = {
        "clamp_position": foot,
        "clamp_rotation": clamp,
        "grip_position": foot + reach,
        "grip_rotation": grip,
        "arc_length": arc_length,
        "train_idx": np.arange(trials - test_trials),
        "test_idx": np.arange(trials - test_trials, trials),
        "noise_std": noise,
        **labels(replace(believed, length=_FREE_LENGTH)),
    }
    experiment = world_of(RodModel.of(rod), replace(believed, length=_FREE_LENGTH))
    seen = measured(data, experiment, seed=1_000_000 + seed, noise=noise)
    return {**seen, **labels(replace(believed, length=_FREE_LENGTH))}
