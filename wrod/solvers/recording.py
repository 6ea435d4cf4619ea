"""Recordings of launches on a CPU, which are the process's and not a thread's: what another thread
launches meanwhile would be recorded as well, and replayed when its arrays are gone. Several threads
can replay what they have recorded at a time."""

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext

import warp as wp

# While one thread records, it holds this; the others begin to launch when it is free.
_free = threading.Condition(threading.RLock())
_launch: Counter[int] = Counter()  # calls under way of each thread
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
    """This thread launches nothing within that could be recorded: others may record meanwhile."""
    me = threading.get_ident()
    with _free:
        count = _launch.pop(me, 0)
        _free.notify_all()
    try:
        yield
    finally:
        with _free:
            if count:
                _launch[me] = count


@contextmanager
def alone() -> Iterator[bool]:
    """Whether no other thread launches, for which it waits a moment; none begins to within."""
    with _free:
        with aside():
            may = _free.wait_for(lambda: not _launch, _PATIENCE)
        yield may


def is_only_thread() -> bool:
    """Whether there is no other thread that could launch unasked (daemons are not asked)."""
    me = threading.current_thread()
    return all(other is me or other.daemon for other in threading.enumerate())


def replay(graph: wp.Graph) -> None:
    """Launch what was recorded, while other threads may record and replay theirs."""
    with aside() if graph.device.is_cpu else nullcontext():
        wp.capture_launch(graph)


def record(device: str, launches: Callable[[], None]) -> wp.Graph | None:
    """What `launches` launches, as a graph; None on a CPU where another thread launches."""
    with alone() if wp.get_device(device).is_cpu else nullcontext(True) as may:
        if not may:
            return None
        with wp.ScopedCapture(device) as capture:
            launches()
    return capture.graph
