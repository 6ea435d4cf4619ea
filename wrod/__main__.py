"""`python -m wrod` is the command `wrod`; an interruption while it is loaded is said as later."""

import contextlib
import signal
import sys


def main() -> None:
    """Load the command line and run it."""
    try:
        from wrod.commands import main as run

        run()
    except KeyboardInterrupt:
        print("wrod: interrupted", file=sys.stderr)
        sys.exit(130)
    finally:
        # All is said and written: what strikes while Python winds up changes nothing.
        with contextlib.suppress(ValueError):  # not the main thread
            signal.signal(signal.SIGINT, signal.SIG_IGN)


if __name__ == "__main__":
    main()
