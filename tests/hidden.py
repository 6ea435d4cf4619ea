"""Hidden sets that tests look at: drawn by `wrod.bench.hidden_sets`, kept in `tests/data/hidden`.

Drawing one solves some 250 boundary value problems. `python tests/hidden.py` draws them anew, and a
slow test compares.
"""

import json
from functools import cache
from pathlib import Path

import numpy as np

from wrod.bench.hidden_sets import hidden_set
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.loading import measurements_from_arrays

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
)


def draw(case: str, seed: int, noise: str) -> tuple[dict, dict]:
    """Measurements, and true values by effect and parameters."""
    data, hidden = hidden_set(case, seed, noise)
    return data, hidden.truth


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
