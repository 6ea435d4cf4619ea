"""Jobs of a bench in processes side by side."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any


def run(
    function: Callable[..., Any], jobs: Sequence[tuple], workers: int
) -> Iterator[tuple[tuple, Any]]:
    """(job, result of `function(*job)`) of every job, as they end.

    Args:
        function: of a module, so that other processes can import it.
        jobs: its arguments.
        workers: processes; with 1 everything runs in this one.
    """
    if workers == 1:
        for job in jobs:
            yield job, function(*job)
        return
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # A fresh interpreter for each worker: Warp's threads do not survive a fork.
    with ProcessPoolExecutor(
        min(workers, max(len(jobs), 1)), mp_context=get_context("spawn")
    ) as pool:
        futures = {pool.submit(function, *job): job for job in jobs}
        for future in as_completed(futures):
            yield futures[future], future.result()
