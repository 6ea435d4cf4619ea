"""`python -m wrod` is the command `wrod`; an interruption while it is loaded is said as later."""

import sys

# What tells commands that this process is theirs alone.
OWN_PROCESS = "own process"


def main() -> None:
    """Load the command line and run it."""
    try:
        import gc
        import os

        # Modules and kernels are millions of objects that stay: to look through them for garbage as
        # often as Python does takes a quarter of the time that loading them takes.
        gc.set_threshold(100_000, 20, 20)
        # Threads of BLAS wait by spinning: `wrod show` took 16 CPU s on 16 cores, and 2 with one.
        if "OMP_NUM_THREADS" not in os.environ:
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        from wrod.commands import main as run

        run(obj=OWN_PROCESS)
    except KeyboardInterrupt:
        print("wrod: interrupted", file=sys.stderr)
        sys.exit(130)
    except Exception as error:  # while it was loaded
        from wrod.errors import blamed_variables

        said = blamed_variables(error)
        if said is None and isinstance(error, (ImportError, MemoryError, OSError)):
            said = (
                f"cannot be loaded ({' '.join(f'{type(error).__name__}: {error}'.split())[:300]}); "
                "this process may have too little memory or too few open files (ulimit -a), or the "
                "installation may not be whole"
            )
        if said is None or os.environ.get("WROD_TRACEBACK"):
            raise
        print(f"wrod: {said}", file=sys.stderr)
        sys.exit(2)
    finally:
        _wind_up()


def _wind_up() -> None:
    """All is said and written: what strikes while Python winds up changes nothing."""
    import contextlib
    import gc
    import signal

    gc.freeze()  # what goes with the process is not looked through: that took a second
    with contextlib.suppress(ValueError):  # not the main thread
        for name in ("SIGALRM", "SIGINT", "SIGTERM", "SIGHUP"):
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), signal.SIG_IGN)
    # Where an interruption struck a string that was executed (a dataclass does that), Python has
    # noted it, and would end by 130 whatever the command said; one that ends well clears the note.
    with contextlib.suppress(MemoryError):
        exec("0")
    end = sys.exc_info()[1]
    if isinstance(end, SystemExit) and end.code:
        _leave(end.code if isinstance(end.code, int) else 1)


def _leave(code: int) -> None:
    """End now if a thread is still at work a second after a command gave up: Python would wait for
    it, and one never ends whose lock the interruption left held (it can strike between
    `threading.Condition` taking its lock and the body of the `with`)."""
    import contextlib
    import os
    import threading
    import time

    def at_work() -> bool:
        others = (one for one in threading.enumerate() if one is not threading.main_thread())
        return any(not one.daemon for one in others)

    late = time.monotonic() + 1.0
    while at_work() and time.monotonic() < late:
        time.sleep(0.01)
    if at_work():
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError, AttributeError):
                stream.flush()
        os._exit(code)


if __name__ == "__main__":
    main()
