"""The time that a search for effects has, and the models that it has fitted meanwhile."""

import math
import time
from typing import Any

# To judge what is there when the time is over, at least [s] and of the time.
_LEAST_GRACE, _GRACE = 10.0, 0.1


class OutOfTime(Exception):
    """The time of a search is over."""


class Clock:
    """What a search has of time, from now on.

    Attributes:
        seconds: the whole; None: as long as it takes.
        fits: `Fit`s of models that were fitted to all that may be fitted, with the present noise.
    """

    def __init__(self, seconds: float | None = None):
        self.seconds = seconds
        self.fits: list[Any] = []
        self._end = math.inf if seconds is None else time.monotonic() + seconds

    @property
    def over(self) -> bool:
        return time.monotonic() > self._end

    def check(self) -> None:
        if self.over:
            raise OutOfTime

    def extend(self) -> None:
        """Give the judge of what was found some time of its own."""
        if self.seconds is not None:
            self._end = time.monotonic() + max(_LEAST_GRACE, _GRACE * self.seconds)
