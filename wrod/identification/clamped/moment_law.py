"""A law of bending of unknown form, for rods that soften or stiffen in a way of their own."""

from collections.abc import Sequence

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter

TERMS = 4


class MomentLaw(Effect):
    """The moment as a function of curvature, free but for being smooth.

    Args:
        curvatures: at which the terms have lost half of what they lose [1/m], the largest one that
            the data show.
    """

    name = "moment_law"
    title = "a moment that follows the curvature by a law of its own"
    reference = (
        "M = B k (1 - sum_j p_j (k / k_j)^2 / (1 + (k / k_j)^2)), p_j of either sign: rational "
        "terms at fixed curvatures, as a Prony series has exponentials at fixed times"
    )

    def __init__(self, curvatures: Sequence[float]):
        self.curvatures = np.asarray(curvatures, dtype=float)
        self.parameters = tuple(
            Parameter(f"lost_about_{k:.3g}_per_m", "", 2.0) for k in self.curvatures
        )

    def apply(self, setup, values):
        setup.law = np.stack([self.curvatures**-2.0 + 0.0 * values, values], axis=1)

    def secant(self, curvature: np.ndarray) -> np.ndarray:
        """(n, TERMS) rates of M / (B k) at (n,) curvatures [1/m] by the terms' shares."""
        x = (np.asarray(curvature)[:, None] / self.curvatures) ** 2
        return -x / (1.0 + x)

    def describe(self, values, covariance, measurements):
        places = np.linspace(0.25, 1.0, 4) * self.curvatures[-1]
        rates = self.secant(places)
        share = 1.0 + rates @ values
        error = np.sqrt(np.einsum("np,pq,nq->n", rates, covariance, rates))
        return {
            f"moment_over_linear_at_{k:.3g}_per_m": Estimate(float(v), float(e), "")
            for k, v, e in zip(places, share, error, strict=True)
        }


def moment_law_of(laboratory) -> MomentLaw:
    """The law for curvatures as the base model has them in the train trials."""
    m = laboratory.measurements
    nodes = laboratory.base_positions()[m.train]
    edge = np.diff(nodes, axis=1)
    length = np.linalg.norm(edge, axis=2)
    t = edge / length[..., None]
    turn = 2.0 * np.tan(0.5 * np.arccos(np.clip((t[:, 1:] * t[:, :-1]).sum(axis=2), -1.0, 1.0)))
    largest = np.quantile(turn / (0.5 * (length[:, 1:] + length[:, :-1])), 0.99)
    return MomentLaw(np.geomspace(0.2, 1.0, TERMS) * largest)
