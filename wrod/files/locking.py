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
    name = hashlib.sha256(os.fsencode(f"{os.path.realpath(output)}\0{part}")).hexdigest()[:32]
    folder = Path(tempfile.gettempdir()) / f"wrod-locks-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        file = open(folder / name, "a+", encoding="utf-8")  # noqa: SIM115  # closed below
    except OSError:
        yield  # a machine without room for a lock shall still work
        return
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.seek(0)
            owner = file.read(20).strip()
            raise DataError(
                f"{output}: is being written by another wrod process ({owner or 'unknown'}); wait "
                "for it or choose another --out"
            ) from None
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        yield
