"""One call of the campaign (tests/adversary.py): how it is run, and what about its end is wrong."""

from __future__ import annotations

import multiprocessing
import os
import shlex
import shutil
import signal
import stat
import subprocess
import sys
from functools import cache
from itertools import pairwise
from pathlib import Path

from adversary_kinds import ALLOWED
from adversary_material import AROUND_STREAMS
from forked import End, server
from killing import same

from wrod.commands import main

# Options whose word is written to.
_WRITES = ("--out", "--usd", "--table")
DEVICES = ("/dev/null", "/dev/zero", "/dev/full")
# The most that a call may take before it has said something [s].
LONGEST = 10.0


def run(
    words: list[str], around, place: Path, files: dict[str, str], made: Path | None = None
) -> tuple[End, list[str]]:
    """How a call ends, and what it left beside its output. `made`: a folder of other files of it,
    which it leaves alone where it is refused."""
    shutil.rmtree(place, ignore_errors=True)
    (place / "here").mkdir(parents=True)
    names = {f"{{{name}}}": path for name, path in files.items()}
    out = place / "out"
    words = [names.get(word, word.replace("{out}", str(out))) for word in words]
    before = {path: _stamp(path) for path in files.values()}
    others = {} if made is None or around is not None else _stamp(str(made))
    if isinstance(around, tuple):
        around = None
    if around is None:
        end = server().run(_call, (words,), place / "here")
        if end.code == -signal.SIGSEGV:  # not every library bears a fork; users have none
            shutil.rmtree(place)
            (place / "here").mkdir(parents=True)
            end = server().run(_shell, (words, {}, out), place / "here", limited=False)
    else:
        end = server().run(_shell, (words, around, out), place / "here", limited=False)
    left = [str(path) for path in (place / "here").rglob("*")]
    if isinstance(around, dict) and around.get("WARP_CACHE_PATH"):
        left = []  # kernels are kept there
    if isinstance(around, dict) and around.get("HOME") == "relative":
        left = [path for path in left if "/relative" not in path]  # and here
    if end.code != 2 and not set(words) & {str(out), f"{out}.json", f"{out}.png"}:
        left = []  # it was to write there
    asked = {one for flag, one in pairwise(words) if flag in _WRITES}
    if end.code != 2:  # or with another option
        asked = {os.path.normpath(place / "here" / one) for one in asked}
        left = [path for path in left if not any(path.startswith(one) for one in asked)]
    written = set(words[words.index("--out") + 1 :][:1]) if "--out" in words else set()
    left += [
        path for path, stamp in before.items()
        if _stamp(path) != stamp and (end.code == 2 or path not in written)
    ]  # fmt: skip
    if end.code == 2 and others and "complete" not in end.said and _stamp(str(made)) != others:
        left.append(str(made))
    deaf = isinstance(around, str) and "2>" in around and "2>&1" not in around
    if end.code == 2 and "complete" not in end.said and not deaf:  # what stays could not be said
        left += [str(path) for path in place.glob("out*") for path in [path, *path.rglob("*")]]
    return end, left


def digests(place: Path) -> dict[str, str]:
    """Of all that a call left at its output, but for pages and what holds how long it took."""
    times = (".html", "joint_path.npz", "scene.usdc")
    return {k: v for k, v in same(place).items() if k[:3] == "out" and not k.endswith(times)}


def _stamp(path: str) -> dict[str, int]:
    """When the file, or each file of a folder, was written."""
    place = Path(path)
    files = place.rglob("*") if place.is_dir() else [place]
    return {str(file): file.stat().st_mtime_ns for file in files if file.is_file()}


def _call(words: list[str]) -> int:
    sys.stdout, sys.stderr = (os.fdopen(os.dup(k), "w", errors="backslashreplace") for k in (1, 2))
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    multiprocessing.current_process()._config["daemon"] = False  # calls may have processes
    try:
        main(words)
    except SystemExit as reason:
        return reason.code if isinstance(reason.code, int) else bool(reason.code)
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
    return 0


def _shell(words: list[str], around, out: Path) -> int:
    """The call as a process of its own with that around it."""
    call = shlex.join([sys.executable, "-P", "-m", "wrod", *words])
    changed = dict(around) if isinstance(around, dict) else {}
    if "PYTHONPATH" in changed:  # the package itself may be found by it
        changed["PYTHONPATH"] += os.pathsep + os.environ.get("PYTHONPATH", "")
    environment = {**os.environ, **changed, "OUT": str(out)}
    environment = {name: value for name, value in environment.items() if value is not None}
    before, after = "", ""
    if isinstance(around, str):
        before, after = ("", around) if around in AROUND_STREAMS else (around, "")
        if before == "rmdir_cwd":
            before = 'mkdir gone; cd gone; rmdir "$PWD"'
    line = f"{before}\nset -o pipefail\n{call} {after}"
    if before.startswith("# "):
        there = shlex.join([sys.executable, "-P", "-m", "wrod"])
        there += " " + shlex.join(words).replace(str(out), f"{out}.disk/out")
        line = before.replace("CALL_THERE", there).replace("CALL", call)
        (out.parent / "call.sh").write_text(f"{call}\n", errors="surrogateescape")
    os.execve("/bin/bash", ["bash", "-c", line], environment)


# Variables that ask Python, or a library, to tell at length what it does.
_LOUD = {"PYTHONVERBOSE", "PYTHONPROFILEIMPORTTIME", "PYTHONMALLOCSTATS"}
# Ends that the surroundings bring and no program can mend.
_BY_FORCE = ("| head", "| true", "ulimit", ">&-", "/dev/full", "2>&1 | head")


def worked(end: End) -> bool:
    """Whether it, or a worker of it, was at work when the limit of processor time ended it."""
    late = end.code == -signal.SIGKILL
    late |= end.code == 2 and "a worker was ended from outside" in end.said
    return end.code in (-signal.SIGXCPU, 128 + signal.SIGXCPU) or (late and end.seconds > LONGEST)


def wrong(end: End, left: list[str], around, quick: bool = False) -> str | None:
    """What is wrong with the end of a call; None if nothing. `quick`: it ends in a second or two
    where nothing is broken."""
    if left:
        return f"left {left[:4]}: exit {end.code}: {end.said[-200:]}"
    devices = {path for path in DEVICES if not stat.S_ISCHR(os.stat(path).st_mode)}
    if devices:
        return f"replaced {devices}"
    timed = isinstance(around, str) and "ulimit -t" in around  # it is Linux that kills then
    if end.code == -signal.SIGKILL and not worked(end) and not timed:
        return f"hangs, or took all memory: {end.said[-300:]}"
    if worked(end):
        # It was taken, and works; but no variable makes work of what is quick.
        return "no end" if quick and isinstance(around, dict) else None
    if isinstance(around, str) and around.startswith("# "):
        return _wrong_around(end, around)
    if isinstance(around, dict) and end.code < 0 and end.code == _python_alone(**around):
        return None  # CPython issue 111499: 3.12 before 3.12.4 with PYTHONMALLOCSTATS
    if isinstance(around, str):  # there may be nobody to tell, and no room to tell it in
        if "Traceback" in end.said:
            return f"exit {end.code}: {end.said[-500:]}"
        fine = end.code in (0, 1, 2, 3, 137, 141) or timed
        return None if fine else f"exit {end.code}: {end.said[-500:]}"
    if end.code == 0:
        return f"says {end.said[-300:]}" if "Traceback" in end.said else None
    if end.code == 2 and end.seconds > LONGEST:
        return f"refused after {end.seconds:.0f} s: {end.said[-300:]}"
    loud = isinstance(around, dict) and not _LOUD.isdisjoint(around)
    return end.wrong() if not loud or "Traceback" in end.said or end.code != 2 else None


@cache
def _python_alone(**around) -> int:
    """Exit code of a Python that does nothing, in that environment."""
    environment = {name: value for name, value in {**os.environ, **around}.items() if value}
    nothing = [sys.executable, "-c", "pass"]
    return subprocess.run(nothing, env=environment, capture_output=True).returncode


def _wrong_around(end: End, around: str) -> str | None:
    """The same of calls around which something happened; their script tells their exit codes."""
    kind, told = around.partition("\n")[0][2:], end.said.rpartition("EXIT ")
    if "Fatal Python error: init_import_site" in end.said:
        return None  # it struck while Python itself began
    codes = {int(code) for code in told[2].split() if code.isdecimal()}
    fine = {0, 2, 3, 137, 152, ALLOWED.get(kind, 0)}  # 137, 152: its processor's time was up
    if "Traceback" in end.said or "HALF" in end.said or not codes <= fine:
        return f"{kind}: {sorted(codes)}: {end.said[-700:]}"
    return None
