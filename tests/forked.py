"""One call of `wrod` in a forked process of bounded time and memory: hangs and crashes are seen.

Calls are forked from a process that has imported what commands need and done nothing else
(`server`): a process that has worked may hold threads and locks, which a fork inherits broken.
"""

import atexit
import contextlib
import gc
import importlib
import os
import pickle
import resource
import select
import signal
import subprocess
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

# Seconds of a processor; seconds without using any; bytes of memory.
SECONDS, IDLE, BYTES = 10.0, 60.0, 2 * 2**30


@dataclass
class End:
    """How a call ended.

    Attributes:
        code: exit code; negative, the signal that ended it.
        said: what it printed.
        seconds: of a processor.
        memory: bytes that were resident at most, of the libraries too.
    """

    code: int
    said: str
    seconds: float
    memory: int

    def wrong(self, *, refused: bool = False) -> str | None:
        """What no call may do; None if it did nothing of that."""
        if self.seconds > SECONDS or self.code in (-signal.SIGXCPU, -signal.SIGKILL):
            return f"no end after {self.seconds:.0f} s"
        if self.memory > BYTES:
            return f"took {self.memory / 2**30:.1f} GiB"
        if "Traceback" in self.said or self.code not in (0, 2, 3):
            return f"exit {self.code}: {self.said[-600:]}"
        if self.code == 2 and (not self.said.strip() or len(self.said) > 4000):
            return f"says {self.said[:300]!r}, {len(self.said)} letters"
        return f"was taken: {self.said[-200:]}" if refused and self.code != 2 else None


@contextlib.contextmanager
def full_disk(free: int) -> Iterator[None]:
    """No file of this process grows beyond so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (free, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def call(words: list[str], folder: Path) -> End:
    """Run `wrod` with these words in a folder."""
    return server().run(_invoked, (words,), folder)


def _invoked(words: list[str]) -> int:
    from click.testing import CliRunner

    from wrod.commands import main

    warnings.simplefilter("ignore")
    result = CliRunner().invoke(main, words)
    os.write(1, result.output.encode(errors="replace")[-20_000:])
    error = result.exception
    if error is not None and not isinstance(error, SystemExit):
        os.write(1, "".join(traceback.format_exception(error)).encode(errors="replace"))
    return result.exit_code


class Server:
    """The process that forks, and ends with this one."""

    def __init__(self):
        here = str(Path(__file__).parent)
        code = f"import sys; sys.path.insert(0, {here!r}); import forked; forked.serve()"
        # Threads of BLAS that wait for each other on a busy machine count as processor time.
        single = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
        self.process = subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env={**os.environ, **single},
        )  # fmt: skip
        atexit.register(self.close)

    def run(self, function: Callable, arguments: tuple, folder: Path, *, limited=True) -> End:
        """How a call of a module's function ends in a folder; what it returns is the exit code.
        `limited`: in memory."""
        pickle.dump((function, arguments, folder, limited), self.process.stdin)
        self.process.stdin.flush()
        return pickle.load(self.process.stdout)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        self.process.wait()


@cache
def server() -> Server:
    """The one of this process."""
    return Server()


def serve() -> None:
    """Fork what is asked for on the standard input, until that is closed."""
    asked, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    with open(os.devnull, "r+b") as nothing:
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    preload()
    while True:
        try:
            function, arguments, folder, limited = pickle.load(asked)
        except EOFError:
            return
        pickle.dump(_forked(function, arguments, folder, limited), answers)
        answers.flush()


def preload() -> None:
    """What the commands import, once for all calls, and is left out of searches for garbage."""
    gc.disable()
    import click
    import warp

    from wrod.commands import COMMANDS, main
    from wrod.commands.bench import BENCHMARKS

    context = click.Context(main)
    for name in COMMANDS:
        main.get_command(context, name)
    for name in BENCHMARKS:
        main.get_command(context, "bench").get_command(context, name)
    for name in (
        "cv2", "torch", "torch._dynamo", "pytorch_kinematics", "pxr.UsdGeom", "newton", "trimesh",
        "ezdxf", "svgelements", "xacro",
        "matplotlib.figure", "scipy.optimize", "click.testing", "wrod.deployment.simulate",
        "wrod.robot.model", "wrod.perception.scan", "wrod.scene.render", "wrod.training.loop",
        "wrod.identification", "wrod.patterns.drawings",
    ):  # fmt: skip
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    warp.init()
    gc.freeze()
    gc.enable()


def _forked(function: Callable, arguments: tuple, folder: Path, limited: bool) -> End:
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        code = 99
        try:
            os.close(reader)
            os.dup2(writer, 1)
            os.dup2(writer, 2)
            os.chdir(folder)
            resource.setrlimit(resource.RLIMIT_CPU, (int(SECONDS) + 1, int(SECONDS) + 3))
            if limited:
                most = _data() + 3 * 2**30
                resource.setrlimit(resource.RLIMIT_DATA, (most, most))
            code = function(*arguments)
        except BaseException:
            os.write(1, traceback.format_exc().encode(errors="replace"))
        finally:
            os._exit(code)
    os.close(writer)
    said, idle, used = b"", 0.0, -1
    while idle < IDLE:  # a busy machine is slow, and what hangs uses no processor
        ready, _, _ = select.select([reader], [], [], 1.0)
        part = os.read(reader, 65536) if ready else None
        if part == b"":
            break
        said += part or b""
        now = _processor(child)
        idle, used = (idle + 1.0 if now == used and not part else 0.0), now
    else:
        os.kill(child, signal.SIGKILL)
    os.close(reader)
    _, status, spent = os.wait4(child, 0)
    return End(
        os.waitstatus_to_exitcode(status),
        said.decode(errors="replace"),
        spent.ru_utime + spent.ru_stime,
        1024 * spent.ru_maxrss,
    )


def _processor(process: int) -> int:
    """Ticks of a processor that it and the processes below it have used."""
    above, used = {}, {}
    for place in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it ended meanwhile
            fields = place.read_text().rpartition(")")[2].split()
            one = int(place.parent.name)
            above[one], used[one] = int(fields[1]), sum(map(int, fields[11:15]))
    of = {process}
    while more := {one for one, parent in above.items() if parent in of} - of:
        of |= more
    return sum(used.get(one, 0) for one in of)


def _data() -> int:
    """Bytes that are its own; CUDA's libraries reserve addresses by the terabyte besides."""
    return int(Path("/proc/self/statm").read_text().split()[5]) * os.sysconf("SC_PAGE_SIZE")
