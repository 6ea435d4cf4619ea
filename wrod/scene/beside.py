"""A picture of a scene drawn by a process of its own, which loads Newton while the scene is still
being made.

It is a process since packages that two threads load at a time can wait for each other. It writes no
file: the scene's path goes in, the bytes of a PNG come out, and it ends when its input does.
"""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from collections.abc import Iterator
from contextvars import ContextVar
from importlib.util import find_spec
from pathlib import Path

from wrod.machine import usable_cores

_PNG = b"\x89PNG"
_RUN = [sys.executable, "-P", "-m", "wrod.scene.beside"]


class Painter:
    """The process; one picture each."""

    def __init__(self) -> None:
        # What it has to say is said again by whoever draws in its place.
        self._process = subprocess.Popen(
            _RUN,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def begin(self, scene: Path) -> None:
        """Let it draw a scene, which is written."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):  # it has ended
            self._process.stdin.write(os.fsencode(scene.absolute()))
            self._process.stdin.close()

    def finish(self) -> bytes | None:
        """Wait for the picture, a PNG; None: it could not draw it."""
        assert self._process.stdout is not None
        picture = self._process.stdout.read()
        return picture if self._process.wait() == 0 and picture.startswith(_PNG) else None

    def end(self) -> None:
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):
                if stream is not None:
                    stream.close()


_PAINTER: ContextVar[Painter | None] = ContextVar("painter", default=None)


def painter() -> Painter | None:
    """The process that waits for a scene, if any."""
    return _PAINTER.get()


@contextlib.contextmanager
def painting() -> Iterator[None]:
    """Have a `painter` within, where it saves time: there is Newton and a second core."""
    saves = find_spec("newton") is not None and "newton" not in sys.modules and usable_cores() > 1
    started = None
    if saves:
        with contextlib.suppress(OSError):  # no process to be had
            started = Painter()
    token = _PAINTER.set(started)
    try:
        yield
    finally:
        _PAINTER.reset(token)
        if started is not None:
            started.end()


def _paint() -> None:
    """Be the process."""
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what else is printed is no picture
    import newton.sensors  # noqa: F401  # takes seconds, in which the scene is made
    from PIL import Image

    from wrod.scene.render import compile_pictures, four_moments

    compile_pictures()
    scene = os.fsdecode(sys.stdin.buffer.read())
    if scene:
        file = io.BytesIO()
        Image.fromarray(four_moments(Path(scene))).save(file, "PNG")
        answer.write(file.getvalue())
        answer.close()


if __name__ == "__main__":
    _paint()
