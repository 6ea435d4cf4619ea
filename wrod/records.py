"""What objects are made of: checked where they are made, and their own from then on."""

import json
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from wrod.arguments import Check, checked, shown
from wrod.errors import DataError, WrodError

T = TypeVar("T", bound=type)


def checked_fields(error: type[WrodError], **checks: Check) -> Callable[[T], T]:
    """Decorator of a dataclass: its fields are checked as `checked` does arguments, before they
    are set."""

    def decorate(kind: T) -> T:
        kind.__init__ = checked(error, **checks)(kind.__init__)  # type: ignore[misc]
        return kind

    return decorate


def brief(kind: T) -> T:
    """Decorator of a dataclass: shown in a line or few, with only the ends of long arrays."""
    whole = vars(kind)["__repr__"]

    def shown_briefly(record: Any) -> str:
        with np.printoptions(threshold=6, edgeitems=1, precision=5):
            return " ".join(whole(record).split())

    kind.__repr__ = shown_briefly  # type: ignore[assignment]
    return kind


def frozen(array: np.ndarray) -> np.ndarray:
    """The array, or a copy that nobody else holds, which refuses to be changed."""
    if array.base is not None or array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array


def freeze(record: Any, values: dict[str, Any]) -> None:
    """Set fields of a frozen dataclass to these values, its arrays as `frozen` has them."""
    for name, value in values.items():
        kept = frozen(value) if isinstance(value, np.ndarray) else value
        object.__setattr__(record, name, kept)


def plain(value: Any, where: str) -> dict[str, Any]:
    """A copy of a dict of plain JSON values, in which tuples are lists.

    Raises:
        DataError: it is none; `where` begins the sentence.
    """
    try:
        if isinstance(value, dict):
            return json.loads(json.dumps(value))
    except (TypeError, ValueError, RecursionError):
        pass
    raise DataError(f"{where} is {shown(value)}; it must be a dict of plain JSON values")
