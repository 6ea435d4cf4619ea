"""Batches on one GPU at the same time, each in a thread and on a stream of its own.

A round of time steps is a row of launches that wait for each other, and most of them are too small
to fill a GPU: those of another batch fill it up. Threads take turns with all that they do
themselves, launches and recordings too, and give their turn away only while they wait for the GPU.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import numpy as np
import warp as wp

_Result = TypeVar("_Result")
_mine = threading.local()
# How long a thread whose GPU still works waits until it asks again [s].
_PATIENCE = 3e-4


class _Stopped(Exception):
    """Another thread has failed, or the caller does not want the results any more."""


class _Turns:
    """Which thread's turn it is, on which device."""

    def __init__(self, device: str):
        self.device, self.common = device, wp.get_stream(device)
        self.stopped, self._lock = False, threading.Lock()

    def take(self, stream: wp.Stream) -> None:
        self._lock.acquire()
        wp.set_stream(stream, self.device)

    def give(self) -> None:
        wp.set_stream(self.common, self.device)
        self._lock.release()


def run_at_once(jobs: Sequence[Callable[[], _Result]], device: str) -> list[_Result]:
    """What the jobs return; on a GPU they run at the same time."""
    if len(jobs) < 2 or wp.get_device(device).is_cpu:
        return [job() for job in jobs]
    turns = _Turns(device)

    def run(job: Callable[[], _Result]) -> _Result:
        stream = wp.Stream(device)
        _mine.turn = turns, stream
        turns.take(stream)
        try:
            return job()
        except BaseException:
            turns.stopped = True
            raise
        finally:
            turns.give()

    wp.synchronize_device(device)
    with ThreadPoolExecutor(len(jobs)) as pool:
        futures = [pool.submit(run, job) for job in jobs]
        try:
            return _results(futures)
        finally:
            turns.stopped = True


def _results(futures: Sequence[Future]) -> list:
    """Of all; the first failure that is one, not one of those that follow from it."""
    failures = [future.exception() for future in futures]
    for failure in failures:
        if failure is not None and not isinstance(failure, _Stopped):
            raise failure
    return [future.result() for future in futures]


def wait(device: str) -> None:
    """Let others have their turn while a GPU does what this thread has asked it for."""
    turn = getattr(_mine, "turn", None)
    if turn is None:
        return
    turns, stream = turn
    asked, began = stream.record_event(), time.perf_counter()
    nap = 0.5 * getattr(_mine, "wait", 0.0)  # it takes about as long as last time
    while not asked.is_complete:
        turns.give()
        time.sleep(max(nap, _PATIENCE))
        nap = 0.0
        turns.take(stream)
        if turns.stopped:
            raise _Stopped
    _mine.wait = time.perf_counter() - began


def read(array: wp.array) -> np.ndarray:
    """What an array holds; waits for the present stream alone, where `array.numpy()` would wait for
    all."""
    if array.device.is_cpu:
        return array.numpy().copy()
    here = array.to("cpu")
    wp.synchronize_stream(wp.get_stream(array.device))
    return here.numpy()
