"""Trials that are shared out to the threads of a CPU."""

from collections.abc import Callable, Sequence
from itertools import chain
from threading import Event
from typing import Any

from wrod.machine import worker_threads
from wrod.solvers import recording

# Rods stepped at once on a CPU: more would leave its caches.
_CPU_CHUNK = 16


class _NotWantedError(Exception):
    """Another thread failed, or the caller was interrupted."""


def chunks(count: int, device: str, threads: int | None = None) -> tuple[list[list[int]], int]:
    """Trials that are simulated at once, and the threads that do."""
    size, workers = count, 1
    if device == "cpu":
        workers = worker_threads(threads)
        parts = workers * -(-count // (workers * _CPU_CHUNK))
        size = max(1, -(-count // max(parts, 1)))
    every = list(range(count))
    return [every[first : first + size] for first in range(0, count, size)], workers


def shared_out(
    run: Callable[[list[int], Callable[[], None]], Sequence[Any]],
    parts: list[list[int]],
    workers: int,
) -> list:
    """What `run(part, still_wanted)` makes of the trials of every part, in their own order.

    `still_wanted` is to be called now and then: it ends a part that nobody waits for any more.
    """
    unwanted = Event()

    def still_wanted() -> None:
        if unwanted.is_set():
            raise _NotWantedError

    if workers > 1 and len(parts) > 1:
        with recording.workers(workers) as pool:
            try:
                done = list(pool.map(lambda part: run(part, still_wanted), parts))
            finally:
                unwanted.set()
    else:
        done = [run(part, still_wanted) for part in parts]
    of = dict(zip(chain.from_iterable(parts), chain.from_iterable(done), strict=True))
    return [of[i] for i in sorted(of)]
