"""What every command has around it: one sentence for what goes wrong, and a lock on its output."""

import contextlib
import errno
import functools
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from itertools import takewhile
from pathlib import Path

import click

from wrod.commands.surroundings import refuse_few_addresses, refuse_little_data
from wrod.errors import DataError, MissingExtraError, WrodError, blamed_variables, unsolved

# Exit codes: of input that cannot be used, of interruptions, and of a fault of ours.
REFUSED, INTERRUPTED, FAULT = 2, 130, 70
# Signals that ask a command to end: how that is told, and the exit code.
_ENDINGS = {
    signal.SIGINT: ("interrupted", INTERRUPTED),
    signal.SIGTERM: ("terminated", 143),
    signal.SIGHUP: ("its terminal was closed", 129),
}
_MOST_SAID = 2000  # letters
# How Python and Warp say that a limit of the process was met.
_LIMITED = ("can't start new thread", "Failed to load the shared library", "failed to map segment")
# The signals that asked the running command to end.
_STRUCK: list[int] = []
# Options that name what is written.
_WRITTEN = ("out", "table", "usd")
# Set it to see where a fault of ours is.
TRACEBACK = "WROD_TRACEBACK"
# Modules of extras that a command cannot do without: it says so before it works.
_NEEDS = {
    "scan": ("cv2", "skimage"),
    "markers": ("cv2",),
    "train": ("torch",),
    "distil": ("torch",),
    "render": ("newton", "pxr", "PIL"),
    "bench robot": ("pytorch_kinematics", "torch", "ruckig", "trimesh"),
    "bench perception": ("cv2", "skimage"),
    "bench newton": ("newton",),
    "bench cosserat": ("cosseratbench",),
}


def sentence(error: BaseException) -> tuple[str, int] | None:
    """What to say of an error, and the exit code; None if it is a fault of ours."""
    from wrod.files.writing import goes_on

    if isinstance(error, WrodError):
        return str(error), REFUSED
    if isinstance(error, KeyboardInterrupt):
        word, code = _ENDINGS.get(error.args[0] if error.args else None, _ENDINGS[signal.SIGINT])
        kept = "what was finished is kept, and the same command goes on"
        return f"{word}; {kept if goes_on() else 'the same command begins anew'}", code
    if isinstance(error, ModuleNotFoundError) and (missing := MissingExtraError.of(error)):
        return str(missing), REFUSED
    if isinstance(error, MemoryError) or ("allocat" in str(error) and "bytes" in str(error)):
        return "out of memory; ask for less at once (fewer trials, a smaller batch)", REFUSED
    if isinstance(error, (RuntimeError, ImportError)) and any(
        one in str(error) for one in _LIMITED
    ):
        return f"{error}; this process may have too few threads or too little memory (ulimit -a)", 2
    if isinstance(error, ImportError) and (error.name or "").partition(".")[0] != "wrod":
        said = " ".join(str(error).split())
        return f"a package cannot be loaded ({said}); install it, or what it needs, anew", REFUSED
    if isinstance(error, OSError):
        where = error.filename if error.filename is not None else "the system says"
        said = error.strerror or str(error)
        if error.errno in (errno.EMFILE, errno.ENFILE):
            return f"{where}: {said}; let this process open more (ulimit -n)", REFUSED
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        remedy = "make room" if full else "check the path"
        return f"{where}: {said}; {remedy} or choose another, then run the same command again", 2
    if isinstance(error, RecursionError):
        return "the input is nested too deeply", REFUSED
    if isinstance(error, UnicodeError):
        return f"an input holds text that is not UTF-8 ({error}); save it as UTF-8", REFUSED
    if isinstance(error, Warning):
        return f"{error} (a warning, which PYTHONWARNINGS makes an error)", REFUSED
    blamed = unsolved(error) or blamed_variables(error)
    return None if blamed is None else (blamed, REFUSED)


def cut(text: str) -> str:
    """The sentence without its middle, where names or values in it are very long."""
    half = _MOST_SAID // 2
    return text if len(text) <= _MOST_SAID else f"{text[:half]} … {text[-half:]}"


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Let an interruption come through wherever it strikes.

    Python drops a KeyboardInterrupt that strikes in a callback or a finaliser ("Exception
    ignored", with a traceback), and the command would go on. It is raised again every half second
    until the command has ended, and what is dropped is not told. Outside the main thread, or
    without timers, interruptions stay as they are. SIGTERM and SIGHUP interrupt as SIGINT does, so
    that no temporary file stays.
    """
    _STRUCK.clear()
    usual = dict.fromkeys(_ENDINGS, signal.SIG_DFL) | {signal.SIGINT: signal.default_int_handler}
    heard = [number for number, one in usual.items() if signal.getsignal(number) is one]
    if not heard or not hasattr(signal, "setitimer"):
        yield
        return

    def strike(number, frame):
        if number != signal.SIGALRM:
            _STRUCK.append(number)
        signal.setitimer(signal.ITIMER_REAL, 0.5)
        raise KeyboardInterrupt(*_STRUCK[:1])

    told = sys.unraisablehook

    def tell(dropped):
        if dropped.exc_type is not KeyboardInterrupt:
            told(dropped)

    try:
        before = {number: signal.signal(number, strike) for number in [*heard, signal.SIGALRM]}
    except ValueError:  # not the main thread
        yield
        return
    shown = sys.excepthook

    def show(kind, error, trace):  # Cython prints what it drops in this way first
        if kind is not KeyboardInterrupt:
            shown(kind, error, trace)

    sys.unraisablehook, sys.excepthook = tell, show
    try:
        yield
    finally:
        sys.unraisablehook, sys.excepthook = told, shown
        if _STRUCK:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)


def hush() -> None:
    """Let nothing interrupt what is left of a process that ends: to say why."""
    with contextlib.suppress(ValueError):  # not the main thread
        for number in (*_ENDINGS, signal.SIGALRM):
            signal.signal(number, signal.SIG_IGN)


def stop(ctx: click.Context, error: BaseException) -> None:
    """Say in one sentence why the command ends, and which of its outputs are whole; then exit."""
    from wrod.files.writing import finished

    if _STRUCK:  # a library may have made another error of it
        if ctx.find_root().obj is not None:  # this process is the command's
            hush()
        error = KeyboardInterrupt(*_STRUCK[:1])
    if isinstance(error, BrokenPipeError):
        os._exit(1)  # nobody reads any more what would be said
    said = sentence(error)
    if said is None:
        if os.environ.get(TRACEBACK):
            raise error
        kind = type(error).__name__
        said = (
            f"a fault of wrod's own ({kind}: {error}); please report it with what {TRACEBACK}=1 "
            "shows",
            FAULT,
        )
    text, code = said
    text = cut(text)
    whole = [str(path) for path in finished() if path.exists()]
    if whole:
        more = f" and {len(whole) - 3} more" if len(whole) > 3 else ""
        text += f" (complete: {', '.join(whole[-3:])}{more}; the rest was not written)"
    with contextlib.suppress(OSError):  # a terminal that was closed
        click.echo(f"wrod: {text}", err=True)
    ctx.exit(code)


def refuse_unwritable(folder: Path) -> None:
    """Refuse a folder that cannot be made or written to, before any work.

    Raises:
        DataError: names what stands in its way.
    """
    whole = Path(os.path.abspath(folder))
    place = next(one for one in (whole, *whole.parents) if os.path.lexists(one))
    if not place.is_dir():
        raise DataError(f"{folder}: cannot be written ({place} is no folder); choose another --out")
    if not os.access(place, os.W_OK | os.X_OK):
        raise DataError(
            f"{folder}: cannot be written (no permission for {place}); choose another --out"
        )


def _is_file(out: Path, kind: click.ParamType) -> bool:
    """Whether an --out is a file's; of commands that write either, a folder has no suffix."""
    if not getattr(kind, "dir_okay", True):
        return True
    return getattr(kind, "file_okay", True) and (out.is_file() or bool(out.suffix))


def _read_files(command: click.Command, given: dict) -> list[str]:
    """The files among a command's arguments that it does not write."""
    context = click.get_current_context(silent=True)
    values = given if context is None else context.params
    found = []
    for option in command.params:
        value = values.get(option.name)
        for one in value if isinstance(value, tuple) else (value,):
            if option.name not in _WRITTEN and isinstance(one, (str, Path)) and os.path.isfile(one):
                found.append(os.fspath(one))
    return found


def _missing_from(out: Path) -> Path | None:
    """The outermost folder of a path that is not there; None if all are."""
    missing = list(takewhile(lambda one: not os.path.lexists(one), (out, *out.parents)))
    return missing[-1] if missing else None


def _remove_empty(folder: Path) -> None:
    """Remove a folder and those in it that hold no file."""
    for place, _, _ in os.walk(folder, topdown=False):
        with contextlib.suppress(OSError):  # it holds something
            os.rmdir(place)


def _prepare(places: dict[str, Path], option: click.Parameter, held: contextlib.ExitStack) -> None:
    """Make the folder of what an option has written, or refuse it before any work; what is empty of
    it when all is `held` no more is removed."""
    from wrod.files.writing import refuse_no_file

    place = places[str(option.name)]
    is_file, real = _is_file(place, option.type), os.path.realpath(place)
    same = [name for name, one in places.items() if os.path.realpath(one) == real]
    if is_file and len(same) > 1:
        both = " and ".join(f"--{name}" for name in same)
        raise DataError(f"{place}: {both} would both be written there; give each a path of its own")
    folder = Path(os.path.realpath(place)).parent if is_file else place
    refuse_unwritable(folder)
    made = _missing_from(folder)
    if made is not None:
        held.callback(_remove_empty, made)  # where nothing was finished nothing is left
    folder.mkdir(parents=True, exist_ok=True)
    if is_file:
        refuse_no_file(place)
    try:  # some file systems take no file whatever their permissions say
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        error.filename = str(folder)
        raise


def holding_output(command: click.Command, path: str = "") -> click.Command:
    """The command, which refuses before it works where a package is missing, and holds its --out
    against other processes while it runs.

    Args:
        path: its name with its group's, such as "bench robot".
    """
    run: Callable | None = command.callback
    needed, holds = _NEEDS.get(path, ()), any(one.name == "out" for one in command.params)
    if run is None or not (needed or holds):
        return command

    @functools.wraps(run)
    def guarded(*args, **kwargs):
        for module in needed:
            if find_spec(module) is None:
                raise MissingExtraError(module)
        if {"newton", "pxr"} & set(needed):
            refuse_few_addresses()
        if "torch" in needed:
            refuse_little_data()
        if not holds:
            return run(*args, **kwargs)
        from wrod.files.writing import locked, protect

        protect(_read_files(command, kwargs))
        places = {
            one.name: Path(kwargs[one.name])
            for one in command.params
            if one.name in _WRITTEN and kwargs.get(one.name) is not None
        }
        with contextlib.ExitStack() as held:
            for one in command.params:
                if one.name in places:
                    _prepare(places, one, held)
            if "out" in places:
                held.enter_context(locked(places["out"], os.environ.get("RANK", "")))
            return run(*args, **kwargs)

    command.callback = guarded
    return command


def draw_beside(draws: bool) -> None:
    """Until the running command ends, have a process that draws its scene (`wrod.scene.beside`) if
    it `draws` one, unless others share this process: for them Newton is loaded once."""
    context = click.get_current_context()
    if draws and context.find_root().obj is not None:
        from wrod.scene.beside import painting

        context.with_resource(painting())
