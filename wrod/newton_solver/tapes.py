"""The tape that Warp records on."""

from collections.abc import Iterator
from contextlib import contextmanager

import warp as wp
from newton import Model
from warp._src import context  # the only way there

from wrod.errors import RodError


def refuse(model: Model, what: str) -> None:
    """Refuse what has no gradients while a tape is recorded that wants them.

    Raises:
        RodError: one is.
    """
    if model.requires_grad and context.runtime.tape is not None:
        raise RodError(f"{what} have no gradients on a wp.Tape; call it outside the tape")


@contextmanager
def off_tape() -> Iterator[wp.Tape | None]:
    """The tape that is being recorded, if any, on which nothing is recorded meanwhile."""
    tape, context.runtime.tape = context.runtime.tape, None
    try:
        yield tape
    finally:
        context.runtime.tape = tape
