"""Hidden sets that tests look at: drawn by `wrod.bench.hidden_sets`, kept in `tests/data/hidden`.

Drawing one solves some 250 boundary value problems. `python tests/hidden.py` draws them anew, and a
slow test compares.
"""

import json
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.bench.hidden_sets import _poses, _rod, hidden_set
from wrod.identification.clamped.equilibria import ClampedSolver
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.loading import measurements_from_arrays
from wrod.identification.clamped.setup import ClampedSetup
from wrod.identification.effect import Model, effects

FOLDER = Path(__file__).parent / "data" / "hidden"
# Half of the edges that `identify` takes: rods take half the time, and predictions are extrapolated
# to the continuum all the same.
COARSE = 45
# Case, seed, noise of the markers.
SETS = (
    ("none 1", 101, "pose"),
    ("natural_curvature", 101, "pose"),
    ("warming", 101, "white"),
    ("anisotropic_bending", 11, "white"),
    ("softening_by_yield", 11, "white"),
    ("stiffness, quadratic", 501, "correlated-0.7"),
    ("stiffness_gradient", 501, "correlated-0.7"),
    ("natural_curvature + stiffness", 302, "white"),
    ("natural_curvature", 303, "white"),
    ("ribbon", 1, "white"),
    ("ribbon", 3, "white"),
)
# Ribbons in strong bends: how far apart their ends are, over their lengths, and how far these are
# turned [degrees].
_RIBBONS = {1: (0.3, 0.6, 10.0), 2: (0.3, 0.6, 30.0), 3: (0.2, 0.5, 30.0), 11: (0.3, 0.6, 20.0)}


def draw(case: str, seed: int, noise: str) -> tuple[dict, dict]:
    """Measurements, and true values by effect and parameters."""
    if case == "ribbon":
        return _ribbon(seed)
    data, hidden = hidden_set(case, seed, noise)
    return data, hidden.truth


def _ribbon(seed: int) -> tuple[dict, dict]:
    """A ribbon, led to its poses from straight on a fine mesh."""
    (*reach, turn), rng = _RIBBONS[seed], np.random.default_rng([seed, 5])
    effect, rod = effects()["anisotropic_bending"], _rod(rng)
    poses = _poses(rng, rod)
    a, b = poses["clamp_position"], poses["grip_position"]
    apart = np.linalg.norm(b - a, axis=1)
    poses["grip_position"] = (
        a + (b - a) * (rng.uniform(*reach, len(a)) * rod.length / apart)[:, None]
    )
    for end in ("clamp_rotation", "grip_rotation"):
        turns = Rotation.from_euler("xy", rng.uniform(-turn, turn, (len(a), 2)), degrees=True)
        poses[end] = poses[end] @ turns.as_matrix()
    fraction = poses["arc_length"] / rod.length
    line = a[:, None] + fraction[:, None] * (poses["grip_position"] - a)[:, None]
    m = measurements_from_arrays({**poses, "centerline": line})
    values = np.array([np.log(1.35), np.log(0.75), rng.uniform(-1.4, 1.4)])
    setup = Model((effect,)).setup(ClampedSetup.base(m, np.arange(m.trial_count), 150), values)
    seen = np.real(ClampedSolver([setup]).predict([setup]).position[0])
    seen = seen + m.noise * rng.normal(size=seen.shape)
    names = tuple(p.key for p in effect.parameters)
    return poses | {"centerline": seen}, {effect.name: {names: tuple(values.tolist())}}


@cache
def kept(case: str, seed: int, noise: str = "white") -> tuple[dict, dict]:
    """What `draw` returned."""
    with np.load(_place(case, seed, noise)) as found:
        data = {name: value if value.ndim else value.item() for name, value in found.items()}
    truth = {
        effect: {tuple(names): tuple(values) for names, values in parts}
        for effect, parts in json.loads(data.pop("truth")).items()
    }
    return data, truth


def coarse(data, name: str = "measurements", edge_count: int = COARSE) -> Laboratory:
    """Measurements, on a coarse mesh."""
    return Laboratory(measurements_from_arrays(dict(data), name=name), edge_count=edge_count)


def _place(case: str, seed: int, noise: str) -> Path:
    return FOLDER / f"{case.replace(', ', '-').replace(' ', '-')}-{seed}-{noise}.npz"


def write() -> None:
    FOLDER.mkdir(exist_ok=True)
    for one in SETS:
        data, truth = draw(*one)
        flat = {
            effect: [[names, np.asarray(values).tolist()] for names, values in parts.items()]
            for effect, parts in truth.items()
        }
        np.savez_compressed(_place(*one), **data, truth=json.dumps(flat))


if __name__ == "__main__":
    write()
