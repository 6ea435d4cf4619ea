"""When what is left of an error is noise, and when a part of it is explained: for all data.

Every kind of data ends in the same four words: *adequate* (the base model's error is noise),
*explained* (the better model's is), *partly-explained* (enough of the error is gone) and
*unexplained*. What counts as noise and as enough differs with what the data are.
"""

from dataclasses import dataclass

# Two estimates with a correlation beyond this cannot be told apart, whatever the data.
CORRELATED = 0.95


@dataclass(frozen=True)
class Thresholds:
    """What counts for data of one kind.

    Attributes:
        at_noise: an error of so many times the noise floor may well be noise alone.
        takes: the least share that a model takes which explains a part of it.
        of_excess: whether that share is of the mean square error beyond the floor's, or of the
            error itself.
        reason: why these.
    """

    at_noise: float
    takes: float
    of_excess: bool
    reason: str

    def share(self, before: float, after: float, floor: float) -> float:
        """What a model takes of the base model's error; errors in any one unit."""
        if self.of_excess:
            return (before**2 - after**2) / max(before**2 - floor**2, 1e-300)
        return 1.0 - after / before

    def is_noise(self, error: float, floor: float) -> bool:
        """Whether an error may well be noise alone."""
        return error <= self.at_noise * floor


CLAMPED = Thresholds(
    1.1, 0.9, True,
    "Some hundred independent readings scatter by a few per cent about their floor, which is "
    "known. Equilibria between clamps have hardly any other source of error, so what stays of the "
    "excess is another effect: the one named may stand for it.",
)  # fmt: skip
MOTION = Thresholds(
    1.15, 0.2, False,
    "The floor adds what the noise of grips and first frames leaves, which is estimated; what mesh "
    "and time step lack is added to predictions. It lies far below what any model leaves of "
    "seconds of motion, so the excess is the error itself, and many effects share it: all that are "
    "found take a third to two thirds of a recorded cable's.",
)  # fmt: skip
LAID = Thresholds(
    1.15, 0.2, False,
    "Neighbouring points of a laid rod err together, and how it was laid (friction, the grip) "
    "leaves errors that no rod explains.",
)  # fmt: skip
# A single laid rod has no scatter that its noise could be estimated by; it was declared.
LAID_ONCE = Thresholds(1.3, LAID.takes, LAID.of_excess, LAID.reason)
