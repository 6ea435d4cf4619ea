"""The table that laid rods have told of: its friction, in a small file that plans can read."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from wrod.errors import DataError, PatternError
from wrod.files import read_json, schemas, write_json

_FORMAT = "wrod-table-1"
# A single friction coefficient is taken to be known to this part; no table has a larger one.
_UNCERTAIN, _MOST = 0.1, 100.0


def friction_range(friction: float | tuple[float, float]) -> tuple[float, float]:
    """Least and largest coefficient [-] of one that is known to a tenth, or of a range.

    Raises:
        PatternError: not positive, over 100, or the first is larger than the second.
    """
    values = np.atleast_1d(np.asarray(friction, dtype=float))
    if len(values) == 1:
        values = values[0] * np.array([1.0 - _UNCERTAIN, 1.0 + _UNCERTAIN])
    if len(values) != 2 or not (np.isfinite(values).all() and 0 < values[0] <= values[1] <= _MOST):
        raise PatternError(
            f"friction is {friction!r}; give a positive coefficient or a range such as (0.2, 0.6)"
        )
    return float(values[0]), float(values[1])


@dataclass(frozen=True)
class TableFriction:
    """What is known of a table.

    Attributes:
        friction: Coulomb coefficient [-].
        log_error: standard error of its logarithm [-].
        correlation: largest correlation with what was found beside it; near 1 in size, rods told
            only a combination.
    """

    friction: float
    log_error: float
    correlation: float = 0.0

    def __post_init__(self) -> None:
        values = (self.friction, self.log_error, self.correlation)
        if not (np.isfinite(values).all() and self.friction > 0.0 <= self.log_error):
            raise DataError(
                f"table has friction {self.friction!r} with log error {self.log_error!r}; give a "
                "positive number and an error of 0 or more"
            )

    @property
    def interval(self) -> tuple[float, float]:
        """Friction one standard error down and up [-]."""
        grow = float(np.exp(self.log_error))
        return self.friction / grow, self.friction * grow

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the table as JSON."""
        content = {"format": _FORMAT, **asdict(self)}
        return write_json(path, content)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> TableFriction:
        """Read what `save` or `wrod laid --table` wrote.

        Raises:
            DataError: the file is missing, not a table, or holds unusable values.
        """
        found = read_json(path, schemas.TableFriction, "a table that `wrod laid --table` wrote")
        return cls(found.friction, found.log_error, found.correlation)
