"""Into how many pieces a deployment is cut, in space and in time."""

from __future__ import annotations

from dataclasses import dataclass

from wrod import arguments
from wrod.errors import RodError
from wrod.solvers.steps import SCHEMES


@dataclass(frozen=True)
class Discretisation:
    """How finely a deployment is computed; `dataclasses.replace` makes another out of one.

    Attributes:
        spacing: length of the edges where the rod is laid [m].
        step: largest time step [s].
        scheme: of time stepping: "bdf2", or "euler", which damps what shakes a rod along; see
            `wrod.Dynamics`.
        tolerance: of a step's residual forces, over the weight of one L_gb of rod.
        node_count: nodes of every rod instead of `spacing`, so that results do not depend on which
            trials are simulated together; None: what the longest needs.
        laid: length of rod that is meshed as what is laid is [m]; None: what the trajectory lays.

    Raises:
        RodError: a number is not usable, or the scheme is none of the three.
    """

    spacing: float = 0.005
    step: float = 0.01
    scheme: str = "bdf2"
    tolerance: float = 1e-5
    node_count: int | None = None
    laid: float | None = None

    def __post_init__(self) -> None:
        arguments.check_fields(
            self,
            RodError,
            spacing=arguments.number(1e-5, 1.0),
            step=arguments.number(1e-6, 1.0),
            scheme=arguments.text,
            tolerance=arguments.number(1e-15, 1.0),
            node_count=arguments.optional(arguments.whole(4, 100_000)),
            laid=arguments.optional(arguments.number(0.0, 1e3)),
        )
        if self.scheme not in SCHEMES:
            raise RodError(f"unknown scheme {self.scheme!r}; use one of {', '.join(SCHEMES)}")


USUAL = Discretisation()
