"""One process at a time on one output."""

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from wrod.errors import DataError

try:
    import fcntl
except ImportError:  # no such locks on this system: two processes are not kept apart
    fcntl = None  # type: ignore[assignment]

_REFUSAL = "{}: is being written by another wrod process ({}); wait for it or choose another --out"


@contextlib.contextmanager
def locked(output: str | os.PathLike[str], part: str = "") -> Iterator[None]:
    """Hold an output folder or file while it is written; the lock ends with the process, however
    it ends, and leaves nothing beside the output.

    Args:
        output: the folder or file, which need not exist.
        part: of processes that share an output: which share of it this one writes.

    Raises:
        DataError: another process writes there.
    """
    if fcntl is None:
        yield
        return
    with contextlib.ExitStack() as held:
        _hold_name(held, output, part)
        _hold_folder(held, output, shared=bool(part))
        yield


def _hold_name(held: contextlib.ExitStack, output: str | os.PathLike[str], part: str) -> None:
    """Lock a file of that output's name, which knows who holds it."""
    name = hashlib.sha256(os.fsencode(f"{os.path.realpath(output)}\0{part}")).hexdigest()[:32]
    folder = Path(tempfile.gettempdir()) / f"wrod-locks-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        file = open(folder / name, "a+", encoding="utf-8")  # noqa: SIM115  # closed with the rest
    except OSError:
        return  # a machine without room for a lock shall still work
    held.callback(file.close)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.seek(0)
        owner = file.read(20).strip()
        raise DataError(_REFUSAL.format(output, owner or "unknown")) from None
    except OSError:
        return  # a file system without locks
    with contextlib.suppress(OSError):  # or without room
        os.ftruncate(file.fileno(), 0)
        os.pwrite(file.fileno(), str(os.getpid()).encode(), 0)


def _hold_folder(
    held: contextlib.ExitStack, output: str | os.PathLike[str], *, shared: bool
) -> None:
    """Lock the output folder itself, if it exists: other users, and processes with another folder
    for temporary files, see that."""
    try:
        folder = os.open(output, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:
        return
    held.callback(os.close, folder)
    try:
        fcntl.flock(folder, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        raise DataError(_REFUSAL.format(output, "elsewhere")) from None
    except OSError:
        pass  # a file system without locks
