"""Errors and warnings: one clear sentence each, saying what, where and what to do.

The command line turns every `WrodError` into that sentence and exit code 2; the API raises it.
"""


class WrodError(ValueError):
    """Base of every error that wrod raises for input it cannot use."""


class RodError(WrodError):
    """A rod property that is unknown or not physical."""


class PatternError(WrodError):
    """A pattern that cannot be read, is degenerate, or does not fit the rod."""


class GraspError(WrodError):
    """Grasp inputs outside what can be solved, or grasps that did not converge."""


class PerceptionError(WrodError):
    """A picture from which no trustworthy centreline can be taken."""


class RobotError(WrodError):
    """A robot description, placement or path that the arm cannot follow."""


class SceneError(WrodError):
    """A scene that cannot be written or read."""


class DataError(WrodError):
    """A data file that is truncated, foreign or inconsistent."""


class WrodWarning(UserWarning):
    """Base of every warning: the result stands, with the reservation that is named."""


class OutOfRangeWarning(WrodWarning):
    """The neural controller was asked outside the range that it was trained on."""


class StabilityWarning(WrodWarning):
    """A plan comes close to an elastic instability."""
