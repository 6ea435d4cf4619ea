"""Jobs in processes side by side."""

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from wrod.errors import DataError
from wrod.machine import share_cores, usable_cores


def run(
    function: Callable[..., Any], jobs: Sequence[tuple], workers: int
) -> Iterator[tuple[tuple, Any]]:
    """(job, result of `function(*job)`) of every job, as they end.

    Args:
        function: of a module, so that other processes can import it.
        jobs: its arguments.
        workers: processes, at most two a core, which share the cores; with 1 everything runs in
            this one. They end with this process, and with the caller's loop, however it ends.

    Raises:
        DataError: a worker was killed, or none can be begun.
    """
    if workers == 1:
        for job in jobs:
            yield job, function(*job)
        return
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # A fresh interpreter for each worker: Warp's threads do not survive a fork.
    context = get_context("spawn")
    watched, kept = context.Pipe(duplex=False)
    count = min(workers, max(len(jobs), 1), 2 * usable_cores())  # more would only take memory
    try:
        begun = ProcessPoolExecutor(
            count, mp_context=context, initializer=_begin, initargs=(watched, count)
        )
    except OSError as reason:  # no room for what they share
        raise DataError(
            f"processes side by side cannot be begun here ({reason}); give --workers 1"
        ) from None
    with begun as pool:
        try:
            with _unheard():
                futures: dict[Future, tuple] = {pool.submit(function, *job): job for job in jobs}
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenProcessPool:
            kept.close()
            raise DataError(
                "a worker was ended from outside, as a machine without memory does; give fewer "
                "--workers (what was complete is kept)"
            ) from None
        except BaseException:
            kept.close()  # and with it the workers, whatever they are at
            raise
    kept.close()


def _begin(pipe: Connection, processes: int) -> None:
    """End this process when the other end of the pipe is closed, as the death of its owner does;
    until then it takes its part of the cores."""
    share_cores(processes)

    def wait() -> None:
        with contextlib.suppress(EOFError, OSError):
            pipe.recv_bytes()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


@contextlib.contextmanager
def _unheard() -> Iterator[None]:
    """Begin processes that do not hear interruptions, which the terminal sends to all: theirs are
    this one's to tell. One that strikes meanwhile is heard after."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
