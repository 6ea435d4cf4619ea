"""A second table of hostile calls (tests/adversary.py --listed): the system or a library fails at
one certain step, limits of every size, all options at an end of theirs at once, and defaults said.

`table(commands)` is as in adversary_fresh.py. A fault strikes in an audit hook of Python,
which a `sitecustomize.py` before all others on PYTHONPATH sets.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import click
from adversary_kinds import SAME
from adversary_material import VALID

Made = tuple[list[str], object]
_HOOK = """
import errno, os, signal, sys

event, left, kind = os.environ["FAULT"].split()
left = int(left)
around = os.path.dirname(os.path.dirname(os.environ["OUT"]))


def strike(name, arguments):
    global left
    if name != event or not left:
        return
    one = arguments[0] if arguments else None
    if event == "import":
        if one != kind.partition(":")[0]:
            return
        how = kind.partition(":")[2]
        if how == "missing":
            raise ModuleNotFoundError(f"No module named {one!r}", name=one)
        if how == "broken":
            raise ImportError("libGL.so.1: cannot open shared object file")
        raise OSError(errno.EIO, os.strerror(errno.EIO), one)
    if isinstance(one, (str, bytes)) and not os.fsdecode(one).startswith(around):
        return
    left -= 1
    if left:
        return
    if kind.startswith("SIG"):
        os.kill(os.getpid(), getattr(signal, kind))
    elif kind == "MemoryError":
        raise MemoryError
    else:
        number = getattr(errno, kind)
        raise OSError(number, os.strerror(number), one if isinstance(one, str) else None)


if left:
    sys.addaudithook(strike)
"""
# Interrupted commands end so; what is half-written is told.
_CALL = (
    "env PYTHONPATH={made}:$PYTHONPATH FAULT='{fault}' CALL; a=$?\n"
    "find $(dirname $OUT) -name '.*' -type f -printf 'HALF %p\\n'\n"
    "case $a in 130|143) a=0;; esac; echo EXIT $a\n"
)
_WRITERS = (
    "plan", "show", "loop", "deploy", "scan", "markers", "laid", "identify", "dataset", "train",
    "manifold", "bench table3",
)  # fmt: skip
_EVENTS = {
    "open": (1, 2, 3, 4, 5, 6, 7, 8, 10, 12), "os.rename": (1, 2, 3), "os.mkdir": (1, 2),
    "tempfile.mkstemp": (1, 2, 3), "fcntl.flock": (1, 2, 3), "os.chmod": (1, 2), "os.scandir": (1,),
}  # fmt: skip
_ERRORS = ("EIO", "ENOSPC", "EACCES", "EMFILE", "ESTALE", "MemoryError", "SIGINT", "SIGTERM")
_MODULES = (
    "lazy_loader", "click", "numpy", "scipy", "scipy.optimize", "scipy.interpolate", "matplotlib",
    "matplotlib.figure", "PIL", "cv2", "skimage", "torch", "warp", "msgspec", "tqdm",
    "safetensors", "fcntl",
    "newton", "pxr", "trimesh", "ezdxf", "svgelements", "networkx", "ruckig", "pytorch_kinematics",
)  # fmt: skip
_IMPORTERS = ("plan", "show", "scan", "deploy", "train")
_LIMITS = {
    "-n": (3, 4, 5, 6, 7, 9, 11, 13, 16, 24), "-s": (16, 64, 128, 512, 1024),
    "-f": (0, 1, 2, 8, 32), "-v": (300_000, 600_000, 900_000, 1_200_000, 2_000_000, 3_000_000),
    "-d": (50_000, 200_000, 400_000, 800_000, 1_600_000),
}  # fmt: skip
_LIMITED = ("show", "plan", "deploy", "scan", "train", "dataset", "identify", "markers")


def table(commands: dict[str, click.Command]) -> dict[str, Callable]:
    """All calls by what they are."""
    return _faults() | _imports() | _limits() | _ends(commands)


def _struck(command: str, fault: str) -> Callable[[Path], Made]:
    def make(folder: Path) -> Made:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "sitecustomize.py").write_text(_HOOK)
        text = _CALL.format(made=folder, fault=fault)
        return [*command.split(), *VALID[command]], f"# fault\n{text}"

    return make


def _faults() -> dict[str, Callable]:
    found, number = {}, 0
    for command in _WRITERS:
        for event, counts in _EVENTS.items():
            for count in counts:
                error = _ERRORS[number % len(_ERRORS)]  # each meets all in the end
                number += 1
                found[f"{command} fault {error} at {event} {count}"] = _struck(
                    command, f"{event} {count} {error}"
                )
        number += 3
    return found


def _imports() -> dict[str, Callable]:
    return {
        f"{command} fault {module} {how}": _struck(command, f"import 1 {module}:{how}")
        for command in _IMPORTERS
        for module in _MODULES
        for how in ("missing", "broken", "unreadable")
    }


def _limits() -> dict[str, Callable]:
    """A limit in which Python itself begins is one in which the command says what it lacks."""
    python = f"{sys.executable} -c pass 2> /dev/null || exit 0"

    def call(command: str, limit: str) -> Callable[[Path], Made]:
        words = [*command.split(), *VALID[command]]
        return lambda folder: (words, f"ulimit {limit}; {python}")

    return {
        f"{command} within {flag} {limit}": call(command, f"{flag} {limit}")
        for command in _LIMITED
        for flag, limits in _LIMITS.items()
        for limit in limits
    }


def _ends(commands: dict[str, click.Command]) -> dict[str, Callable]:
    """All numbers at their least, at their most and between; flags turned; defaults said."""
    found: dict[str, Callable] = {}

    def add(command: str, kind: str, more: list[str], around: object = None) -> None:
        words = [*command.split(), *VALID[command], *more]
        if more:
            found[f"{command} ends {kind}"] = lambda folder: (words, around)

    for name, command in commands.items():
        options = [one for one in command.params if isinstance(one, click.Option)]
        real = [one for one in options if getattr(one.type, "min", None) is not None]
        least = {max(one.opts, key=len): one.type.min for one in real}
        most = {max(one.opts, key=len): one.type.max for one in real if one.type.max is not None}
        add(name, "all least", [w for flag, v in least.items() for w in (flag, repr(v))])
        add(name, "all most", [w for flag, v in most.items() for w in (flag, repr(v))])
        turns = [{**least, **dict(list(most.items())[k::2])} for k in (0, 1)]
        for k, turn in enumerate(turns):
            add(name, f"in turn {k}", [w for flag, v in turn.items() for w in (flag, repr(v))])
        flags = [one for one in options if one.is_flag and one.name not in ("help", "json")]
        add(name, "all flags", [max(one.opts, key=len) for one in flags])
        add(name, "no flags", [one.secondary_opts[0] for one in flags if one.secondary_opts])
        given = set(VALID[name])
        said = [
            word
            for one in options
            if not one.is_flag and not given & set(one.opts) and _plain(one.default)
            for word in (max(one.opts, key=len), str(one.default))
        ]
        add(name, "defaults said", said, tuple(VALID[name]) if name in SAME else None)
    return found


def _plain(value: object) -> bool:
    return isinstance(value, (int, float, str)) and not isinstance(value, bool)
