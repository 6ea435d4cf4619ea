"""The tape that Warp records on."""

from collections.abc import Iterator
from contextlib import contextmanager

import warp as wp
from warp._src import context  # the only way there


def recorded() -> wp.Tape | None:
    """The tape that is being recorded, if any."""
    return context.runtime.tape


@contextmanager
def off_tape() -> Iterator[wp.Tape | None]:
    """The tape that is being recorded, if any, on which nothing is recorded meanwhile."""
    tape, context.runtime.tape = context.runtime.tape, None
    try:
        yield tape
    finally:
        context.runtime.tape = tape
