"""A rod on the nodes that it is added to a Newton builder with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrod import arguments
from wrod.errors import RodError
from wrod.rods.discretisation import in_principal, mesh_arrays, principal_directors
from wrod.rods.model import RodModel
from wrod.rods.rotation import carried, unit


@dataclass(frozen=True)
class MeshedRod:
    """A rod on the nodes that it is added with.

    Attributes:
        model: what it is.
        points, velocity: (node, 3).
        rest: (node - 1,) unstretched lengths of the edges.
        directors: (node - 1, 3) first principal directions.
        nodes: arrays of `wrod.rods.discretisation.mesh_arrays`.
    """

    model: RodModel
    points: np.ndarray
    velocity: np.ndarray
    rest: np.ndarray
    directors: np.ndarray
    nodes: dict[str, np.ndarray]

    @classmethod
    def of(
        cls, model: RodModel, points, director, velocity, natural_curvature, natural_twist,
        rest_length,
    ) -> MeshedRod:  # fmt: skip
        """Arguments as of `SolverDER.add_rod`."""
        points = _points(points)
        count = len(points)
        rest = np.linalg.norm(np.diff(points, axis=0), axis=1)
        directors = _directors(points, director)
        directors = principal_directors(model, directors, np.diff(points, axis=0) / rest[:, None])
        velocity = _spread("velocity", velocity, (count, 3))
        if natural_curvature is not None:
            natural_curvature = _spread("natural_curvature", natural_curvature, (count, 2))
        if natural_twist is not None:
            natural_twist = _spread("natural_twist", natural_twist, (count,))
        if rest_length is not None:
            rest = _rest_length(rest_length, count)
        nodes = _per_node(model, rest, natural_curvature, natural_twist)
        return cls(model, points, velocity, rest, directors, nodes)


# Points farther from the origin, in edges, lose the digits that bending is computed of; edges whose
# tangents have a smaller product bend without bound.
_FARTHEST, _FOLDED = 1e8, -1.0 + 1e-6


def _spread(name: str, value, shape: tuple[int, ...]) -> np.ndarray:
    value = arguments.spread(value, shape, name, RodError)
    if not np.isfinite(value).all():
        raise RodError(f"{name} holds a value that is not finite")
    return value


def _rest_length(rest_length, count: int) -> np.ndarray:
    try:
        out = np.array(np.broadcast_to(np.asarray(rest_length, dtype=float), (count - 1,)))
    except ValueError:
        raise RodError(
            f"rest_length has shape {np.shape(rest_length)}; give one or ({count - 1},)"
        ) from None
    if not (np.isfinite(out) & (out > 0)).all():
        raise RodError("rest_length must be positive and finite")
    return out


def _per_node(model: RodModel, rest, natural_curvature, natural_twist) -> dict[str, np.ndarray]:
    """The rod on its mesh, with what is given instead of its own curvature and twist at rest."""
    arrays = mesh_arrays(model, np.concatenate([[0.0], np.cumsum(rest)]))
    nodes = {name: value[0] for name, value in arrays.items()}
    if natural_curvature is not None:
        nodes["natural_curvature"] = in_principal(natural_curvature, model.principal_angle)
    if natural_twist is not None:
        nodes["natural_twist"] = natural_twist
    return nodes


def _points(points) -> np.ndarray:
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 3:
        raise RodError(f"rod points have shape {points.shape}; give (node, 3) with 3 or more")
    if not np.isfinite(points).all():
        raise RodError("rod points hold a value that is not finite")
    edges = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if not (edges > 0).all():
        i = int(np.argmin(edges))
        raise RodError(f"rod points {i} and {i + 1} coincide; give neighbours some distance")
    if np.abs(points).max() > _FARTHEST * edges.min():
        raise RodError(
            f"rod points lie up to {np.abs(points).max():.3g} m from the origin, {edges.min():.3g} "
            "m from each other; move them to where numbers tell them apart"
        )
    tangents = np.diff(points, axis=0) / edges[:, None]
    ahead = (tangents[:-1] * tangents[1:]).sum(axis=1)
    if ahead.min() < _FOLDED:
        i = int(np.argmin(ahead)) + 1
        raise RodError(f"the rod folds back upon itself at point {i}; give points of a curve")
    return points


def _directors(points: np.ndarray, director) -> np.ndarray:
    """(node - 1, 3) first material directors: those given, or one carried along without twist."""
    tangents = unit(np.diff(points, axis=0))
    if np.shape(director) == tangents.shape:
        across = director - np.sum(director * tangents, axis=1)[:, None] * tangents
        size = np.linalg.norm(across, axis=1)
        if not (size > 1e-9).all():
            raise RodError("a director is along its edge; give one across it")
        return across / size[:, None]
    if director is None:
        director = np.eye(3)[np.argmin(np.abs(tangents[0]))]
    before = np.asarray(director, dtype=float)
    if before.shape != (3,) or not np.isfinite(before).all():
        raise RodError(
            "director must be three finite numbers: a direction across the first edge; or one "
            "across every edge"
        )
    across = before - (before @ tangents[0]) * tangents[0]
    if not np.linalg.norm(across) > 1e-9:
        raise RodError("director is along the rod's first edge; give one across it")
    return carried(unit(across), tangents)
