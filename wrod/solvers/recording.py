"""Recordings of launches on a CPU, which are the process's and not a thread's: what another thread
launches meanwhile would be recorded as well, and replayed when its arrays are gone."""

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext

import warp as wp

_lock = threading.RLock()
_launch: Counter[int] = Counter()  # calls under way of each thread


@contextmanager
def launching() -> Iterator[None]:
    """What this thread launches within is recorded by no other."""
    me = threading.get_ident()
    with _lock:
        _launch[me] += 1
    try:
        yield
    finally:
        with _lock:
            _launch[me] -= 1
            if not _launch[me]:
                del _launch[me]


@contextmanager
def alone() -> Iterator[bool]:
    """Whether no other thread launches; none begins to within."""
    with _lock:
        yield _launch.keys() <= {threading.get_ident()}


def record(device: str, launches: Callable[[], None]) -> wp.Graph | None:
    """What `launches` launches, as a graph; None on a CPU where another thread launches."""
    with alone() if wp.get_device(device).is_cpu else nullcontext(True) as may:
        if not may:
            return None
        with wp.ScopedCapture(device) as capture:
            launches()
    return capture.graph
