"""Several rods in one row of a batch, where they can touch each other."""

from collections.abc import Sequence

import numpy as np

from wrod import arguments
from wrod.errors import RodError
from wrod.rods.batch import RodBatch


@arguments.checked(
    RodError,
    batches=arguments.several(
        arguments.like("a wrod.RodBatch", "rod_count", "node_count", "state")
    ),
)
def join_rods(batches: Sequence[RodBatch]) -> tuple[RodBatch, list[slice]]:
    """One batch whose rows hold a rod of each of the given ones, end to end.

    Their contact is a `RodContact` of the result. What is free in the given batches stays free.

    Args:
        batches: as many rows each, of the same gravity.

    Returns:
        The batch, and the nodes of each rod in it.

    Raises:
        RodError: there is nothing to join, rows or gravity differ, or a batch is cut already or has
            energies that were added to it.
    """
    first = batches[0]
    for k, batch in enumerate(batches):
        if batch.rod_count != first.rod_count:
            raise RodError(f"batch {k} has {batch.rod_count} rows and the first {first.rod_count}")
        if not np.array_equal(batch.gravity.numpy(), first.gravity.numpy()):
            raise RodError(f"batch {k} has another gravity than the first")
        if batch.cut_edges or len(batch.energies) > (batch.inelastic is not None):
            raise RodError(f"batch {k} is cut, or has an energy of its own; join rods before")

    def nodes(values):
        return np.concatenate([values(batch) for batch in batches], axis=1)

    def edges(values):
        """With the last value of a rod once more, for the edge that is cut."""
        parts = [np.concatenate([v := values(b), v[:, -1:]], axis=1) for b in batches]
        return np.concatenate(parts, axis=1)[:, :-1]

    names = ("bending_stiffness", "twisting_stiffness", "natural_curvature", "natural_twist")
    position = nodes(lambda b: b.positions())
    joined = RodBatch(
        position,
        rest_length=edges(lambda b: b.rest_length.numpy()),
        stretching_stiffness=edges(lambda b: b.stretching_stiffness.numpy()),
        **{n: nodes(lambda b, n=n: getattr(b, n).numpy()) for n in names},
        softening=nodes(lambda b: b.softening.numpy()),
        inelastic=nodes(_inelastic),
        node_mass=nodes(lambda b: b.node_mass.numpy()),
        point_load=nodes(lambda b: b.point_load.numpy()),
        gravity=first.gravity.numpy(),
        director=_across(edges(lambda b: b.material_directors()[:, :, 0]), position),
        device=first.device,
    )
    ends = np.cumsum([batch.node_count for batch in batches])
    if len(batches) > 1:
        joined.cut(ends[:-1] - 1)
    # Of a cut edge, the angle is free.
    joined.set_free(
        nodes(lambda b: np.pad(b.free.numpy(), ((0, 0), (0, 1)), constant_values=1))[:, :-1]
    )
    return joined, [
        slice(int(e) - b.node_count, int(e)) for e, b in zip(ends, batches, strict=True)
    ]


def _inelastic(batch: RodBatch) -> np.ndarray:
    if batch.inelastic is None:
        return np.zeros((batch.rod_count, batch.node_count, 4))
    node = batch.inelastic.numpy()
    return np.stack([node[n].astype(float) for n in ("law", "share", "scale", "time")], axis=2)


def _across(director: np.ndarray, position: np.ndarray) -> np.ndarray:
    """(row, edge, 3), with any direction across the edges that have none of their own."""
    tangent = np.diff(position, axis=1)
    tangent /= np.linalg.norm(tangent, axis=2, keepdims=True)
    other = np.eye(3)[np.argmin(np.abs(tangent), axis=2)]
    along = np.abs(np.sum(director * tangent, axis=2, keepdims=True)) > 0.9
    return np.where(along, other, director)
