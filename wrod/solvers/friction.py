"""What a contact is like: Coulomb friction, how it varies over a table, and impacts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from wrod import arguments
from wrod.errors import RodError
from wrod.records import brief

# Damping ratio of contacts without restitution: 1 / (4 zeta^2) of the speed is left.
_MOST_DAMPING = 5.0


@brief
@dataclass(frozen=True, eq=False)
class FrictionField:
    """How much friction there is at a place of the table, over the coefficients of `Friction`.

    Attributes:
        factor: (ny, nx) at the points of a grid, linear in between and constant beyond [-].
        x, y: (2,) coordinates of its first and last column, and row [length].

    Raises:
        RodError: a factor is negative or not finite, or the grid has no extent.
    """

    factor: np.ndarray
    x: tuple[float, float]
    y: tuple[float, float]

    @arguments.checked(RodError)
    def __post_init__(self) -> None:
        factor = arguments.floats(self.factor, "FrictionField: factor", RodError)
        for name in ("x", "y"):
            ends = arguments.floats(getattr(self, name), f"FrictionField: {name}", RodError)
            if ends.shape != (2,) or not np.isfinite(ends).all():
                raise RodError(f"FrictionField: {name} is {ends!r:.80}; give two coordinates")
        extent = self.x[1] > self.x[0] and self.y[1] > self.y[0]
        if factor.ndim != 2 or min(factor.shape) < 2 or not extent:
            raise RodError(
                f"a field of friction of shape {factor.shape} over x {self.x} and y {self.y}; give "
                "(ny, nx) factors, two or more each way, over rising coordinates"
            )
        if not (np.isfinite(factor) & (factor >= 0)).all():
            raise RodError("a field of friction has factors that are negative or not finite")

    @classmethod
    def of(
        cls,
        function: Callable,
        x: tuple[float, float],
        y: tuple[float, float],
        shape: tuple[int, int] = (65, 65),
    ) -> FrictionField:
        """`function` of x and y arrays [length], sampled at (ny, nx) points."""
        grid = np.meshgrid(np.linspace(x[0], x[1], shape[1]), np.linspace(y[0], y[1], shape[0]))
        return cls(np.broadcast_to(function(*grid), shape), (x[0], x[1]), (y[0], y[1]))

    def _place(self) -> tuple[float, float, float, float]:
        ny, nx = np.shape(self.factor)
        dx, dy = (self.x[1] - self.x[0]) / (nx - 1), (self.y[1] - self.y[0]) / (ny - 1)
        return self.x[0], self.y[0], dx, dy


@dataclass(frozen=True)
class Friction:
    """Coulomb friction.

    Attributes:
        static: coefficient mu_s up to which a node sticks [-].
        kinetic: coefficient while it slides [-]; default: the static one.
        rolling: where friction takes hold. False: of the centreline, as if the rod could not roll
            (soft, rough or not quite round rods); True: of the rod's surface, which rolls freely.
        roll: where it is of the centreline and the contact keeps the roll of rods: largest torque
            about the rod's axis over normal force and radius [-]; default: the static coefficient.
    """

    static: float
    kinetic: float | None = None
    rolling: bool = False
    roll: float | None = None

    @arguments.checked(RodError)
    def __post_init__(self) -> None:
        values = [self.static, self.static if self.kinetic is None else self.kinetic]
        real = all(arguments.number()(v) is None for v in values)
        if not real or not all(0 <= v < np.inf for v in values) or values[1] > values[0]:
            raise RodError(
                f"friction is static {arguments.shown(self.static)}, kinetic "
                f"{arguments.shown(self.kinetic)}; give finite numbers with 0 <= kinetic <= static"
            )
        if arguments.optional(arguments.number(0.0))(self.roll) is not None:
            raise RodError(
                f"roll friction is {arguments.shown(self.roll)}; give a finite number, 0 or more"
            )


def contact_damping(restitution: np.ndarray) -> np.ndarray:
    """2 zeta of a viscous contact that pushes only, by its coefficient of restitution

        e = exp(-2 zeta phi / sin phi),  cos phi = zeta

    (Schwager and Poeschel 2007), for zeta > 1 with hyperbolic functions.

    Raises:
        RodError: a coefficient is not in [0, 1).
    """
    restitution = np.asarray(restitution, dtype=float)
    if not ((restitution >= 0) & (restitution < 1)).all():
        raise RodError("restitution must be at least 0 and below 1")

    def speed_kept(zeta):
        if zeta < 1.0:
            phi = np.arccos(zeta)
            return np.exp(-2.0 * zeta * phi / np.sin(phi))
        phi = np.arccosh(max(zeta, 1.0 + 1e-12))
        return np.exp(-2.0 * zeta * phi / np.sinh(phi))

    values = {
        e: brentq(lambda z, e=e: speed_kept(z) - e, 0.0, _MOST_DAMPING)
        if e > speed_kept(_MOST_DAMPING)
        else _MOST_DAMPING
        for e in np.unique(restitution)
    }
    return np.array([2.0 * values[e] for e in restitution.ravel()]).reshape(restitution.shape)
