"""Recordings of launches on a CPU, which are the process's and not a thread's: what another thread
launches meanwhile would be recorded as well, and replayed when its arrays are gone. Several threads
can replay what they have recorded at a time.

So a thread records only while every other one launches nothing: it is known that it does not, from
`aside` and `workers`, and waited for where it does so within `launching`. Of any other thread, one
of a caller's, nothing is known, so that nothing is recorded beside it."""

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from weakref import WeakSet

import warp as wp

from wrod.kernels.compiling import COMPILERS

# While one thread records, it holds this; the others begin to launch when it is free.
_free = threading.Condition(threading.RLock())
_launch: Counter[int] = Counter()  # calls under way of each thread
_aside: Counter[int] = Counter()  # promises of each thread to launch nothing
_workers: WeakSet[threading.Thread] = WeakSet()  # that launch within `launching` alone
# So long a thread that wants to record waits for others that launch [s].
_PATIENCE = 0.05


@contextmanager
def launching() -> Iterator[None]:
    """What this thread launches within is recorded by no other."""
    me = threading.get_ident()
    with _free:
        _launch[me] += 1
    try:
        yield
    finally:
        with _free:
            _launch[me] -= 1
            if not _launch[me]:
                del _launch[me]
                _free.notify_all()


@contextmanager
def aside() -> Iterator[None]:
    """This thread launches nothing within, but in `launching`: others may record meanwhile."""
    me = threading.get_ident()
    with _free:
        count = _launch.pop(me, 0)
        _aside[me] += 1
        _free.notify_all()
    try:
        yield
    finally:
        with _free:
            _aside[me] -= 1
            if not _aside[me]:
                del _aside[me]
            if count:
                _launch[me] += count


@contextmanager
def workers(count: int) -> Iterator[ThreadPoolExecutor]:
    """Threads that launch nothing but in `launching`, while the caller is `aside`."""

    def promise() -> None:
        with _free:
            _workers.add(threading.current_thread())
            _free.notify_all()

    with aside(), ThreadPoolExecutor(count, initializer=promise) as pool:
        yield pool


@contextmanager
def alone() -> Iterator[bool]:
    """Whether no other thread launches, for which it waits a moment; none begins to within."""
    with _free:
        with aside():
            may = not _strangers() and _free.wait_for(lambda: not _launch, _PATIENCE)
        yield may and not _strangers()


def _strangers() -> bool:
    """Whether there are threads that could launch unasked (daemons are not asked)."""
    return not all(
        t.daemon or t in _workers or t.ident in _aside or t.name.startswith(COMPILERS)
        for t in threading.enumerate()
        if t is not threading.current_thread()
    )


def replay(graph: wp.Graph) -> None:
    """Launch what was recorded, while other threads may record and replay theirs."""
    with aside() if graph.device.is_cpu else nullcontext():
        wp.capture_launch(graph)


def record(device: str, launches: Callable[[], None]) -> wp.Graph | None:
    """What `launches` launches, as a graph; None on a CPU where another thread may launch."""
    with alone() if wp.get_device(device).is_cpu else nullcontext(True) as may:
        if not may:
            return None
        with wp.ScopedCapture(device) as capture:
            launches()
    return capture.graph
