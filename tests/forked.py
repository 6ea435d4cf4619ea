"""One call of `wrod` in a forked process of bounded time and memory: hangs and crashes are seen."""

import os
import resource
import select
import signal
import time
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path

SECONDS, WALL, BYTES = 10.0, 90.0, 2 * 2**30


@dataclass
class End:
    """How a call ended.

    Attributes:
        code: exit code; negative, the signal that ended it.
        said: what it printed.
        seconds: of a processor.
        grown: bytes of memory more than before.
    """

    code: int
    said: str
    seconds: float
    grown: int

    def wrong(self, *, refused: bool = False) -> str | None:
        """What no call may do; None if it did nothing of that."""
        if self.seconds > SECONDS or self.code in (-signal.SIGXCPU, -signal.SIGKILL):
            return f"no end after {self.seconds:.0f} s"
        if self.grown > BYTES:
            return f"took {self.grown / 2**30:.1f} GiB"
        if "Traceback" in self.said or self.code not in (0, 2, 3):
            return f"exit {self.code}: {self.said[-600:]}"
        if self.code == 2 and (not self.said.strip() or len(self.said) > 4000):
            return f"says {self.said[:300]!r}, {len(self.said)} letters"
        return f"was taken: {self.said[-200:]}" if refused and self.code != 2 else None


def call(words: list[str], folder: Path) -> End:
    """Run `wrod` with these words in a folder."""

    def run() -> int:
        from click.testing import CliRunner

        from wrod.commands import main

        warnings.simplefilter("ignore")
        result = CliRunner().invoke(main, words)
        os.write(1, result.output.encode(errors="replace")[-20_000:])
        error = result.exception
        if error is not None and not isinstance(error, SystemExit):
            text = traceback.format_exception(error)
            os.write(1, "".join(text).encode(errors="replace"))
        return result.exit_code

    return forked(run, folder)


def forked(run, folder: Path, *, limited: bool = True) -> End:
    """Run a function there; what it returns is the exit code. `limited`: in address space, which
    torch's threads in a new process reserve more of than they use."""
    before, (reader, writer) = _resident(), os.pipe()
    child = os.fork()
    if child == 0:
        code = 99
        try:
            os.close(reader)
            os.dup2(writer, 1)
            os.dup2(writer, 2)
            os.chdir(folder)
            resource.setrlimit(resource.RLIMIT_CPU, (int(SECONDS) + 2, int(SECONDS) + 4))
            if limited:
                most = _virtual() + 3 * 2**30
                resource.setrlimit(resource.RLIMIT_AS, (most, most))
            code = run()
        except BaseException:
            os.write(1, traceback.format_exc().encode(errors="replace"))
        finally:
            os._exit(code)
    os.close(writer)
    said, end = b"", time.monotonic() + WALL
    while time.monotonic() < end:
        ready, _, _ = select.select([reader], [], [], 1.0)
        part = os.read(reader, 65536) if ready else None
        if part == b"":
            break
        said += part or b""
    else:
        os.kill(child, signal.SIGKILL)
    os.close(reader)
    _, status, used = os.wait4(child, 0)
    return End(
        os.waitstatus_to_exitcode(status),
        said.decode(errors="replace"),
        used.ru_utime + used.ru_stime,
        1024 * used.ru_maxrss - before,
    )


def _resident() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def _virtual() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
