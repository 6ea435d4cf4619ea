"""What is to be expected of a plan, found out in a thread while its joint path is sought."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event

from wrod import cost
from wrod.errors import WrodError, WrodWarning
from wrod.machine import usable_cores


class _NotWantedError(Exception):
    """Nobody waits for it any more."""


@contextmanager
def expecting(
    curve, rod, trajectory, friction, device: str | None, *, beside: bool
) -> Iterator[Callable[[], bool]]:
    """Lay a plan in simulation and put what is to be expected of it into its metadata: a warning
    and None where it cannot be laid.

    Args:
        friction: of the table; None: of one that nobody measured.
        beside: while what is within is done, where there is a core for it, which must not launch
            kernels before it has waited; else before.

    Yields:
        What waits until it is there; True where that was not before.
    """
    from wrod.deployment.expectation import foresee  # two threads must not load it at a time
    from wrod.rods.device import resolve_device

    def lay(watch) -> dict:
        return foresee(curve, rod, trajectory, friction, device=device, watch=watch)

    if not (beside and usable_cores() > 1 and resolve_device(device) == "cpu"):
        shown = "laying it in simulation: {n:.1f} s of the robot's time, {elapsed}"
        with cost.progress_bar(delay=1.0, bar_format=shown) as bar:

            def watch(times) -> None:
                bar.update(max(float(times.min()) - bar.n, 0.0))

            _put(trajectory, lambda: lay(watch))
        yield lambda: False
        return
    from wrod.solvers.recording import workers

    # SciPy asks a torch that another thread is loading for what it does not have yet.
    with suppress(ImportError):
        import torch  # noqa: F401

    unwanted = Event()

    def look(times) -> None:
        if unwanted.is_set():
            raise _NotWantedError

    with workers(1) as thread:
        laid = thread.submit(lay, look)

        def wait() -> bool:
            if "expected" in trajectory.metadata:
                return False
            _put(trajectory, laid.result)
            return True

        try:
            yield wait
        finally:
            unwanted.set()


def _put(trajectory, expected: Callable[[], dict]) -> None:
    try:
        trajectory.metadata["expected"] = expected()
    except WrodError as error:
        trajectory.metadata["expected"] = None
        warnings.warn(WrodWarning(f"not laid in simulation: {error}"), stacklevel=3)
