"""Setups of clamped rods laid out for a batch: one row for each candidate and trial.

Beyond each clamp stands a ghost edge that carries the clamp's frame, as in
`wrod.rods.discretisation`.
"""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
import warp as wp

from wrod.identification.clamped.setup import ClampedSetup
from wrod.rods.discretisation import in_principal, of_free_part

COMPLEX_STEP = 1e-30
# Share of the stiffness in a layer that is not there: the mean of its two stiffnesses divides.
_NO_LAYER = 1e-9


def batch_arrays(setups: Sequence[ClampedSetup]) -> dict[str, np.ndarray]:
    """Setups laid out for the batch, as its arguments: candidate x trial in the leading axis,
    ghosts included; complex if they are."""
    rows: defaultdict[str, list] = defaultdict(list)
    for setup in setups:
        own: defaultdict[str, list] = defaultdict(list)
        for s in setup.rods():
            n = len(s.fraction) - 1
            h = s.length / n
            share = _free_share(s)
            here = s.on_mesh(np.full(n, h), share)
            here["bending_stiffness"] = (1.0 - s.law[:, 1].sum()) * here["bending_stiffness"]
            for name, value in here.items():
                own[name].append(_with_ghosts(value))
            mass = s.line_mass * h * share + s.node_mass
            own["node_mass"].append(np.concatenate([[0.0], mass, [0.0]]))
            own["gravity"].append(s.gravity)
        for name, values in own.items():
            rows[name].append(_of_every_trial(setup, values))
    return {name: np.concatenate(v) for name, v in rows.items()}


def _of_every_trial(setup: ClampedSetup, values: list[np.ndarray]) -> np.ndarray:
    """(T, ...) values of each trial's rod, of the same one where they are one."""
    return np.repeat(np.stack(values), len(setup.trials) // len(values), axis=0)


def law_layers(setups: Sequence[ClampedSetup]) -> list[tuple[np.ndarray, np.ndarray]]:
    """(stiffness, softening), each (rod, node, 2), of every term of the setups' laws of bending;
    complex if they are. A setup of fewer terms than another has terms of next to no stiffness."""
    layers = []
    for j in range(max(len(s.law) for s in setups)):
        terms = []
        for setup in setups:
            c, p = setup.law[j] if j < len(setup.law) else (0.0, 0.0)
            softening = np.full((len(setup.fraction), 2), [c, 0.0])
            own = []
            for s in setup.rods():
                bending = (p + _NO_LAYER) * s.bending
                here = of_free_part(_free_share(s), bending_stiffness=bending, softening=softening)
                own.append([_with_ghosts(value) for value in here.values()])
            terms.append([_of_every_trial(setup, list(v)) for v in zip(*own, strict=True)])
        stiffness, softening = map(np.concatenate, zip(*terms, strict=True))
        layers.append((stiffness, softening))
    return layers


def coupling_of(setups: Sequence[ClampedSetup]) -> np.ndarray:
    """(rod, node, 2) coupling of bending with twist in principal directions; complex if it is."""
    rows = []
    for s in setups:
        coupling = np.tile(in_principal(s.coupling, s.principal_angle), (len(s.fraction), 1))
        rows.append(_with_ghosts(of_free_part(_free_share(s), coupling=coupling)["coupling"]))
    return np.repeat(np.stack(rows), len(setups[0].clamp_position), axis=0)


def inelastic_of(setups: Sequence[ClampedSetup]) -> np.ndarray:
    """(rod, node, 4) laws that yield, as `RodBatch` takes them; complex if they are."""
    rows = []
    for s in setups:
        law = of_free_part(_free_share(s), inelastic=s.inelastic)
        rows.append(_with_ghosts(law["inelastic"]))
    return np.repeat(np.stack(rows), len(setups[0].clamp_position), axis=0)


def _free_share(setup: ClampedSetup) -> np.ndarray:
    """(node,) of each node's cell: half at the clamps."""
    share = np.ones(len(setup.fraction))
    share[[0, -1]] = 0.5
    return share


def _with_ghosts(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values[:1], values, values[-1:]])


def end_poses(setups: Sequence[ClampedSetup], keep=np.real):
    """((a, R_A), (b, R_B)) of every rod."""
    return tuple(
        tuple(keep(np.concatenate([getattr(s, f"{end}_{part}") for s in setups])) for part in parts)
        for end, parts in (("clamp", ("position", "rotation")), ("grip", ("position", "rotation")))
    )


def dead_force(setups: Sequence[ClampedSetup]) -> np.ndarray:
    """(rod, node, 3) forces of the setups, none on the ghosts."""
    first = setups[0]
    trials, nodes = len(first.clamp_position), len(first.fraction)
    dtype = np.result_type(*(s.force for s in setups))
    out = np.zeros((len(setups), trials, nodes + 2, 3), dtype=dtype)
    for own, setup in zip(out, setups, strict=True):
        own[:, 1:-1] = setup.force
    return out.reshape(-1, nodes + 2, 3)


def full_shape(array: wp.array) -> tuple[int, ...]:
    """Shape of a Warp array with the components of its vectors."""
    extra = array.dtype._shape_ if hasattr(array.dtype, "_shape_") else ()
    return tuple(array.shape) + tuple(extra)


def wind_load(position: np.ndarray, wind: np.ndarray) -> np.ndarray:
    """(rod, node, 3) forces of a cross-flow on the edges between the clamps."""
    edge = position[:, 2:-1] - position[:, 1:-2]
    length = np.sqrt(np.sum(edge * edge, axis=2, keepdims=True))
    t = edge / length
    w = wind[:, None] * np.ones_like(t)
    across = w - np.sum(w * t, axis=2, keepdims=True) * t
    # The tiny floor keeps the square root analytic in still air.
    speed = np.sqrt(np.sum(across * across, axis=2, keepdims=True) + 1e-60)
    half = 0.5 * length * speed * across
    load = np.zeros_like(position)
    load[:, 1:-2] += half
    load[:, 2:-1] += half
    return load


def wind_rates(position: np.ndarray, wind: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(rod, edge, 3, 3) derivatives of half of `wind_load` on each edge by the edge and by the
    wind."""
    edge = position[:, 2:-1] - position[:, 1:-2]
    length = np.sqrt(np.sum(edge * edge, axis=2))[..., None, None]
    t = edge[..., None] / length
    w = wind[:, None, :, None]
    along = np.sum(w * t, axis=2, keepdims=True)
    across = w - along * t
    speed = np.sqrt(np.sum(across * across, axis=2, keepdims=True) + 1e-60)
    normal = np.eye(3) - t * t.mT
    by_across = 0.5 * length * (speed * np.eye(3) + across * across.mT / speed)
    by_edge = 0.5 * speed * across * t.mT - by_across @ (t * across.mT + along * normal) / length
    return by_edge, by_across @ normal
