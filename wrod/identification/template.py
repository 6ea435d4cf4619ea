"""Example files of measurements: what `wrod identify` reads, filled in for a simulated cable."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from wrod.errors import DataError
from wrod.files import write_npz
from wrod.rods.batch import RodBatch
from wrod.rods.material import RodMaterial
from wrod.rods.model import Rod
from wrod.rods.rotation import unit
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.statics import EquilibriumSolver, prescribe

KINDS = ("clamped", "motion")
# A cable for the hand: 4 mm thick.
_CABLE = RodMaterial(radius=0.002, gravito_bending_length=0.05, length=0.3)
_NOISE = 3e-4  # [m] of a marker's coordinate between clamps
_EDGES, _TRIALS, _SCORED = 60, 12, 4
_RATE, _FRAMES, _RECORDINGS = 100.0, 60, 4
_DAMPING = 0.02  # [s] of the cable's material


def write_template(kind: str, path: str | os.PathLike[str]) -> Path:
    """Write an example of measurements (.npz), which `wrod identify` reads as it is.

    Args:
        kind: "clamped" (shapes between two clamps) or "motion" (recordings of a rod that two grips
            hold). The fields are told by `wrod.load_measurements` and
            `wrod.identification.load_motion`.
        path: the file.

    Raises:
        DataError: there is no such kind.
    """
    if kind not in KINDS:
        raise DataError(f"no template {kind!r}; there are {', '.join(KINDS)}")
    data = clamped_example() if kind == "clamped" else motion_example()
    return write_npz(path, **data)


def clamped_example() -> dict[str, Any]:
    """Arrays of twelve shapes of a cable between a clamp and a gripper, four of them to score on.

    The clamp holds it level, the gripper stands 70 % of its length away, turned at random.
    """
    rng = np.random.default_rng(0)
    length = _CABLE.length
    edge = length / _EDGES
    # The clamps hold the middles of the first and the last edge, as of a rod that goes on.
    s = edge * (np.arange(_EDGES + 2) - 0.5)
    reach = length * (rng.uniform(-0.1, 0.1, (_TRIALS, 3)) + [0.7, 0.0, 0.0])
    lean = rng.uniform(-0.35, 0.35, (_TRIALS, 2))
    inward = unit(np.column_stack([np.ones(_TRIALS), lean]))
    u = np.clip(s / length, 0.0, 1.0)[:, None]
    sag = np.array([0.0, 0.0, -0.3 * length]) * np.sin(np.pi * u) ** 2
    position = u * reach[:, None] + sag
    level = 0.5 * edge * np.array([1.0, 0.0, 0.0])
    position[:, 0], position[:, 1] = -level, level
    position[:, -2], position[:, -1] = reach - 0.5 * edge * inward, reach + 0.5 * edge * inward
    batch = RodBatch.of(_CABLE, s - s[0], position, director=(0.0, 1.0, 0.0))
    prescribe(batch, clamped_nodes=(0, 1, -2, -1), clamped_angles=(0, -1))
    if not EquilibriumSolver(batch).solve(ramp_loads=True).converged.all():
        raise DataError("the example's cable found no equilibrium; use another seed")
    nodes, directors = batch.positions(), batch.material_directors()
    tangent = unit(np.diff(nodes, axis=1))

    def frames(edge: int) -> np.ndarray:
        return np.stack([*directors[:, edge].swapaxes(0, 1), tangent[:, edge]], axis=2)

    middles = 0.5 * (nodes[:, 1:] + nodes[:, :-1])
    seen = middles[:, ::3]
    return {
        "centerline": seen + rng.normal(0.0, _NOISE, seen.shape),
        "arc_length": np.linspace(0.0, length, seen.shape[1]),
        "clamp_position": middles[:, 0],
        "clamp_rotation": frames(0),
        "grip_position": middles[:, -1],
        "grip_rotation": frames(-1),
        "train_idx": np.arange(_TRIALS - _SCORED),
        "test_idx": np.arange(_TRIALS - _SCORED, _TRIALS),
        "noise_std": np.float64(_NOISE),
        **{name: np.float64(value) for name, value in labels(_CABLE).items()},
    }


def labels(rod: RodMaterial) -> dict[str, float]:
    """What a measured file says of its rod [m, kg/m^3, -, m/s^2]."""
    return {
        "length": rod.length,
        "radius": rod.radius,
        "density": rod.density,
        "L_gb": rod.gravito_bending_length,
        "poisson": rod.poisson,
        "gravity": rod.gravity,
    }


def motion_example(rod: Rod = _CABLE, seed: int = 0) -> dict[str, Any]:
    """Arrays of four recordings of a cable that swings between two grips, let go of aside.

    Args:
        rod: the cable, as long or longer than the 0.36 m from the first marker to the last.
        seed: of how it is let go of and of the noise.
    """
    rng = np.random.default_rng(seed)
    held, inner, fine, count = 0.03, 0.015, 4, 20
    spans = np.concatenate([[held], np.full(count * fine, inner / fine), [held]])
    s = np.concatenate([[0.0], np.cumsum(spans)])
    apart = 0.2
    u = np.clip((s - held) / (count * inner), 0.0, 1.0)[:, None]
    line = np.array([apart, 0.0, 0.0]) * u - np.array([0.0, 0.0, 0.1]) * np.sin(np.pi * u)
    line[0], line[-1] = [0.0, 0.0, held], [apart, 0.0, held]
    # What is inside the grips does not bend.
    lines = np.repeat(line[None], _RECORDINGS, axis=0)
    batch = RodBatch.of(rod, s, lines, clamped=(True, True))
    prescribe(batch, clamped_nodes=(0, 1, -2, -1), clamped_angles=(0, -1))
    aside = np.radians(rng.uniform(20.0, 60.0, _RECORDINGS) * rng.choice([-1, 1], _RECORDINGS))
    pull = np.column_stack([0.3 * rng.normal(size=_RECORDINGS), np.sin(aside), -np.cos(aside)])
    down = batch.gravity.numpy().copy()
    batch.gravity.assign(rod.gravity * pull / np.linalg.norm(pull, axis=1, keepdims=True))
    if not EquilibriumSolver(batch).solve(ramp_loads=True).converged.all():
        raise DataError("the example's cable found no equilibrium; use another seed")
    batch.gravity.assign(down)
    moving = Dynamics.of(rod, batch, scheme="bdf2", internal_damping=_DAMPING)
    shown = [0, *range(1, len(s) - 1, fine), len(s) - 1]
    positions = []
    for frame in range(_FRAMES):
        if frame:
            moving.advance(frame / _RATE, 2.5e-3)
        positions.append(batch.positions()[:, shown].copy())
    x = np.stack(positions, axis=1)
    return {
        "positions": x + rng.normal(0.0, 5e-5, x.shape),
        "rate_hz": np.float64(_RATE),
        "held": np.array([0, 1, len(shown) - 2, len(shown) - 1]),
        "gravity": np.float64(rod.gravity),
        "file_ids": np.array([f"swing-{k + 1}" for k in range(_RECORDINGS)]),
    }
