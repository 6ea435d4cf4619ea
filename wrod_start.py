"""The command `wrod`: an interruption while it is loaded ends it in one line.

It is beside the package, for the package takes longer to import than this file. What strikes before
its first line, while Python itself starts, Python tells in its own words.
"""

import _signal as signal  # signal itself takes its time to load
import os


def _end(number, frame) -> None:
    os.write(2, b"wrod: interrupted\n")
    os._exit(130)


# In the background of a shell interruptions are ignored, and stay so.
_HEARD = signal.getsignal(signal.SIGINT) is signal.default_int_handler
if _HEARD:
    signal.signal(signal.SIGINT, _end)


def main() -> None:
    """Load the package and run it, which hears interruptions itself."""
    try:
        from wrod.__main__ import main as run
    except Exception as error:
        if os.environ.get("WROD_TRACEBACK"):
            raise
        os.write(2, f"wrod: cannot be loaded ({error}); install it anew\n".encode())
        os._exit(2)
    try:
        if _HEARD:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        run()
    except KeyboardInterrupt:
        _end(signal.SIGINT, None)
