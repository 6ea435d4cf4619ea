"""Writing files that are either whole or not there, one process at a time on one output."""

import contextlib
import csv
import hashlib
import json
import os
import stat
import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from wrod.errors import DataError, needed_extras
from wrod.files.pictures import as_png

try:
    import fcntl
except ImportError:  # no such locks on this system: what killed processes left stays
    fcntl = None  # type: ignore[assignment]

_ENDING = ".wrod-part"
_REFUSAL = "{}: is being written by another wrod process ({}); wait for it or choose another --out"
# Folders that were searched for what killed processes left half-written.
_SWEPT: set[Path] = set()
# The last of what was written whole, for the message of a command that ends early.
_FINISHED: deque[Path] = deque(maxlen=1000)
# What the running command goes on from when it is called again.
_KEPT: set[Path] = set()
# What the running command reads, which it may not replace.
_READ: set[str] = set()


def write_atomically(
    path: str | os.PathLike[str], write: Callable[[Any], object], mode: str = "w"
) -> Path:
    """Call `write(file)` on a temporary file beside `path`, then move it there.

    A reader, or a process killed half-way, never sees a half-written file. `finished` knows of it.
    What a link points to is written, the link stays; ~ is the home folder. What a killed process
    left beside it goes.

    Raises:
        DataError: a folder, device, pipe or socket stands there, or a file that the command reads.
        OSError: it cannot be written.
    """
    path = Path(os.path.realpath(os.path.expanduser(path)))
    refuse_no_file(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    _sweep(path.parent)
    try:
        handle, held, temporary = _begin_part(path)
    except OSError as error:
        error.filename = str(path)
        raise
    try:
        with os.fdopen(handle, mode, newline="" if mode == "w" else None) as file:
            write(file)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException as error:
        if isinstance(error, OSError) and error.filename is None:
            error.filename = str(path)
        with contextlib.suppress(OSError):  # the folder may be gone, and the reason is elsewhere
            os.unlink(temporary)
        raise
    finally:
        os.close(held)
    _FINISHED.append(path)
    return path


def _begin_part(path: Path) -> tuple[int, int, str]:
    """An open file that nobody else has, beside `path`, twice: locked until the second is closed,
    when it has its name."""
    while True:
        handle, temporary = tempfile.mkstemp(_ENDING, f".{path.name[:40]}.", path.parent)
        try:
            if fcntl is not None:
                with contextlib.suppress(OSError):  # a file system without locks
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if fcntl is None or os.path.exists(temporary):
                return handle, os.dup(handle), temporary
        except BaseException:  # interrupted, or no file more may be open
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            os.close(handle)
            raise
        os.close(handle)  # swept before it was locked


def _sweep(folder: Path) -> None:
    """Remove what killed processes left in a folder: parts that nobody holds, once a process."""
    if fcntl is None or folder in _SWEPT:
        return
    _SWEPT.add(folder)
    with contextlib.suppress(OSError):  # whoever may not look or remove here may yet write
        for part in folder.glob(f".*{_ENDING}"):
            handle = os.open(part, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
            try:
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    part.unlink()
            finally:
                os.close(handle)


def suffixed(path: str | os.PathLike[str], suffix: str) -> Path:
    """The path with that suffix in place of .csv or .npz; "plan-0.3" has neither.

    Raises:
        DataError: it names no file, or a folder.
    """
    given = Path(path)
    if given.is_dir():
        raise DataError(f"{given}: is a folder; give the name of a file to write in it")
    if given.suffix.lower() in (".csv", ".npz"):
        return given.with_suffix(suffix)
    return given.with_name(given.name + suffix)


def write_text(path: str | os.PathLike[str], text: str) -> Path:
    """A file of text, whole or not there; raises as `write_atomically`."""
    return write_atomically(path, lambda file: file.write(text))


def write_json(path: str | os.PathLike[str], content: Any, *, allow_nan: bool = True) -> Path:
    """A file of JSON, as `write_text`."""
    return write_text(path, json.dumps(content, indent=2, allow_nan=allow_nan) + "\n")


def write_csv(
    path: str | os.PathLike[str], head: Iterable, rows: Iterable[Iterable], comment: str = ""
) -> Path:
    """A file of comma-separated values, its head first but for a comment, as `write_text`."""

    def write(file):
        file.write(f"# {comment}\n" if comment else "")
        csv.writer(file).writerows([head, *rows])

    return write_atomically(path, write)


def write_npz(path: str | os.PathLike[str], **arrays: Any) -> Path:
    """A compressed file of NumPy's arrays, as `write_text`."""
    from numpy import savez_compressed

    return write_atomically(path, lambda file: savez_compressed(file, **arrays), "wb")


def write_figure(path: str | os.PathLike[str], figure: Any, dpi: int = 120, **how: Any) -> Path:
    """A figure of matplotlib as PNG, as `write_text`; `how` as `as_png` takes it."""
    return write_atomically(path, lambda file: file.write(as_png(figure, dpi, **how)), "wb")


@needed_extras()
def write_picture(path: str | os.PathLike[str], pixels: Any) -> Path:
    """Pixels (height, width, 3) or (height, width), uint8, as PNG, as `write_text`."""
    from PIL import Image

    return write_atomically(path, lambda file: Image.fromarray(pixels).save(file, "PNG"), "wb")


def refuse_no_file(path: str | os.PathLike[str]) -> None:
    """Raise a DataError if what stands there is no regular file, which a move would replace, or one
    that the command reads."""
    if os.path.realpath(path) in _READ:
        raise DataError(f"{path}: is read by this command, and would be replaced; choose another")
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        return
    except NotADirectoryError:
        raise DataError(
            f"{path}: cannot be written, as a file stands where it has a folder; choose another"
        ) from None
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a device, pipe or socket"
        raise DataError(f"{path}: is {kind}, and a file is to be written there; choose another")


def grown(path: Path) -> None:
    """Count a file that was whole, and now has more, among what is `finished`."""
    _FINISHED.append(path)


def finished() -> list[Path]:
    """The last files that were written whole since `begin`, in order."""
    return list(dict.fromkeys(_FINISHED))


def begin() -> None:
    """Forget what `finished` and `protect` know: a new command begins."""
    _FINISHED.clear()
    _READ.clear()
    _KEPT.clear()


def keeps(path: Path) -> None:
    """Note that the command that writes this goes on from there when it is called again."""
    _KEPT.add(path)


def goes_on() -> bool:
    """Whether the running command has written something from which it goes on."""
    return any(path.exists() for path in _KEPT)


def protect(paths: Iterable[str]) -> None:
    """Let nothing that the command writes replace these files, which it reads."""
    _READ.update(os.path.realpath(path) for path in paths)


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
