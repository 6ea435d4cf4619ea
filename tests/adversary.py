"""A campaign of hostile calls: valid calls of every command, each with one thing broken.

    python tests/adversary.py --count 1000 --workers 16

What is broken is drawn for an option of a command: its word (numbers that nobody means, names of
what is no file, odd letters), how often and how it is given, where it writes, and the process
around it (environment, streams, limits); or it is of the kinds of adversary_kinds.py. A call has
to end in success, or with exit code 2 and one sentence, in time and memory, and leave nothing
half-written, nothing outside of its --out and no device or pipe replaced; one that still works
after the limit was taken; one that is dressed otherwise only ends in the same bytes or is refused.
The same seed draws the same calls.
"""

from __future__ import annotations

import ast
import multiprocessing
import os
import random
import shlex
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import adversary_faults
import click
import numpy as np
from adversary_dress import dressed, emptied
from adversary_foreign import foreign
from adversary_fresh import table
from adversary_kinds import (
    MORE,
    SAME,
    combined,
    doubled,
    happening,
    odd_name,
    structured,
)
from adversary_material import (
    AROUND,
    AROUND_LIMITS,
    AROUND_STREAMS,
    NUMBERS,
    QUICK,
    VALID,
    WORDS,
    material,
    odd_places,
)
from adversary_runs import digests, run, worked, wrong

from wrod.commands import COMMANDS, main
from wrod.commands.bench import BENCHMARKS


def commands() -> dict[str, click.Command]:
    """Every command and benchmark by its words."""
    context, found = click.Context(main), {}
    for name in COMMANDS:
        found[name] = main.get_command(context, name)
    group = found.pop("bench")
    return found | {f"bench {name}": group.get_command(context, name) for name in BENCHMARKS}


def set_option(words: list[str], flag: str, *given: str) -> list[str]:
    """The words with that option given anew."""
    found = list(words)
    while flag in found:
        at = found.index(flag)
        del found[at : at + 2]
    return found + list(given)


class Campaign:
    """Draws calls; files lie in `folder`."""

    def __init__(self, folder: Path, files: dict[str, str]):
        self.folder, self.files, self.commands = folder, files, commands()
        self.plain: dict[tuple, dict | None] = {}  # digests of what plain calls leave
        self.slots = [
            (name, option)
            for name, command in self.commands.items()
            for option in [*command.params, None]
        ]
        random.Random(0).shuffle(self.slots)  # a short campaign has some of every command
        self.table = table(files) | adversary_faults.table(self.commands)

    def kinds(self, only: str) -> list[str]:
        """Of the table, of commands that begin so."""
        return [kind for kind in self.table if kind.startswith(only)]

    def listed(self, number: int, only: str = "") -> tuple[str, list[str], dict | str | None]:
        """The same of a call of the tables (adversary_fresh.py, adversary_faults.py)."""
        kinds = self.kinds(only)
        kind = kinds[number % len(kinds)]
        return f"{kind} (listed)", *self.table[kind](emptied(self.folder / "listed"))

    def drawn(self, seed: int, number: int, only: str = "") -> tuple[str, list[str], dict | str]:
        """What is broken, the words of the call, and what is around it."""
        draw = random.Random(f"{seed} {number}")
        if draw.random() < 0.3:
            return self._of_kinds(draw, number, only)
        slots = [slot for slot in self.slots if slot[0].startswith(only)]
        # Every option in turn, so that none is left to luck.
        name, option = slots[number % len(slots)]
        words = list(VALID[name])
        reads = [word for word in words if word.strip("{}") in self.files]
        if reads and draw.random() < 0.2:
            read = draw.choice(reads)
            kind, path = self._mutated(draw, Path(self.files[read.strip("{}")]))
            words = [path if word == read else word for word in words]
            return f"{name} {read} {kind}", [*name.split(), *words], None
        if option is None:
            kind, words, around = self._around(draw, words)
        elif option.name in ("out", "usd"):
            kind, words, around = self._output(draw, words, option)
        elif isinstance(option, click.Argument):
            kind, words, around = self._argument(draw, words)
        else:
            kind, words, around = self._option(draw, words, option)
        return f"{name} {kind}", [*name.split(), *words], around

    def _of_kinds(self, draw, number, only):
        names = [name for name in self.commands if name.startswith(only)]
        name = names[number % len(names)]
        words, command = list(draw.choice([VALID[name], *MORE.get(name, [])])), self.commands[name]
        how = draw.choice(["combined", "combined", "doubled", "structured", "odd name", "dressed",
                           "foreign", "foreign", "foreign", "happening", "happening", "listed",
                           "listed", "two", "two"])  # fmt: skip
        given, around = (draw, words, self.files, self.folder), None
        found = structured(*given) if how == "structured" else None
        found = odd_name(*given) if how == "odd name" else found
        found = foreign(*given) if how == "foreign" else found
        if how == "listed" and any(kind.startswith(f"{name} ") for kind in self.table):
            return self.listed(draw.randrange(len(self.table)), f"{name} ")
        if how == "two":
            found, around = self._two(*given)
        elif how == "doubled":
            found = doubled(draw, words, command, self.files)
        elif how == "happening":
            kind, changed, around = happening(*given)
            found = kind, changed
        elif how == "dressed" and name in SAME:
            found, around = dressed(*given), tuple(words)
        if found is None:
            how, found = "combined", combined(draw, words, command, self.files)
        return f"{name} {how} {found[0]}", [*name.split(), *found[1]], around

    def _two(self, draw, words, files, folder):
        """Two things broken at once: files, or a file and what is around the call."""
        kinds, around = [], None
        for how in draw.sample([foreign, structured, odd_name], 2):
            made = how(draw, words, files, folder)
            if made is not None:
                kinds.append(made[0])
                words = made[1]
        if len(kinds) < 2:
            around = draw.choice([*AROUND, *AROUND_STREAMS, *AROUND_LIMITS])
            kinds.append(str(around))
        return (" and ".join(kinds), words), around

    def alike(self, words: list[str], plain: tuple, place: Path) -> str | None:
        """What differs between what was left there and what the plain call leaves."""
        left = digests(place)
        if plain not in self.plain:
            end, _ = run([*words[:1], *plain], None, place, self.files)
            self.plain[plain] = digests(place) if end.code == 0 else None
        expected = self.plain[plain]
        if expected is None:
            return None  # it has no plain end
        differ = sorted(k for k in expected.keys() | left.keys() if expected.get(k) != left.get(k))
        return f"another answer than {shlex.join(plain)[:200]}: {differ}" if differ else None

    def _around(self, draw, words):
        which = draw.choice(["environment", "streams", "limits"])
        around = draw.choice(
            {"environment": AROUND, "streams": AROUND_STREAMS, "limits": AROUND_LIMITS}[which]
        )
        return f"{around}", words, around

    def _output(self, draw, words, option):
        flag = max(option.opts, key=len)
        folder = getattr(option.type, "file_okay", True) is False
        suffix = "" if folder else ".png" if words[-1].endswith(".png") else ".json"
        places = odd_places(self.folder / "odd", suffix)
        for all_of_it in ("root", "to_root"):
            del places[all_of_it]
        place, path = draw.choice(list(places.items()))
        if draw.random() < 0.1:  # what is read is written
            reads = [word for word in words if word.startswith("{") and word[:4] != "{out"]
            place, path = ("input", draw.choice(reads)) if reads else (place, path)
        return f"{flag} to {place}", set_option(words, flag, flag, path), None

    def _argument(self, draw, words):
        if not words or words[0].startswith("--"):
            words.insert(0, "")
        kind, path = self._path(draw, Path(words[0]).suffix.rstrip("}"))
        changed = [path, *words[1:]]
        if draw.random() < 0.15:
            kind, changed = "argument twice", [words[0], *words]
        return f"argument {kind}", changed, None

    def _option(self, draw, words, option):
        flag = max(option.opts, key=len)
        if option.is_flag:
            how = draw.choice(["twice", "valued", "both", "short"])
            given = {
                "twice": [flag, flag], "valued": [f"{flag}=yes"], "short": [flag[:-1]],
                "both": [flag, *(option.secondary_opts[:1] or [flag])],
            }[how]  # fmt: skip
            return f"{flag} {how}", words + given, None
        if draw.random() < 0.12:
            return self._shape(draw, words, option, flag)
        if isinstance(option.type, click.Path):
            kind, value = self._path(draw, ".json")
        elif hasattr(option.type, "min"):
            value = draw.choice(NUMBERS)
            low, high = option.type.min, option.type.max
            whole = isinstance(option.type, click.IntRange)
            kind = repr(value[:30])
            value = {
                "min": repr(low), "max": repr(high),
                "just below": repr(low - 1 if whole else np.nextafter(low, -np.inf).item()),
                "just above": repr(high + 1 if whole else np.nextafter(high, np.inf).item()),
            }.get(value, value)  # fmt: skip
        else:
            value = draw.choice(WORDS)
            kind = repr(value[:30])
        return f"{flag} {kind}", set_option(words, flag, flag, value), None

    def _shape(self, draw, words, option, flag):
        """An option given in an odd way."""
        value = "1" if hasattr(option.type, "min") else "x"
        ways = {
            "twice": [flag, value, flag, value], "no value": [flag], "equals": [f"{flag}={value}"],
            "equals empty": [f"{flag}="], "many": [flag, value] * 2000,
            "misspelt": [flag + "s", value], "flag": [flag, "--json"],
        }  # fmt: skip
        how, given = draw.choice(list(ways.items()))
        return f"{flag} {how}", set_option(words, flag, *given), None

    def _mutated(self, draw, path: Path) -> tuple[str, str]:
        """A copy of a valid file, or of a folder with one such file, with bytes that are others."""
        place = self.folder / "mutated" / path.name
        shutil.rmtree(place.parent, ignore_errors=True)
        place.parent.mkdir()
        (shutil.copytree if path.is_dir() else shutil.copy)(path, place)
        files = sorted(f for f in place.rglob("*") if f.is_file()) if path.is_dir() else [place]
        file = draw.choice(files)
        content = bytearray(file.read_bytes() or b" ")
        at = draw.randrange(max(len(content), 1))
        kind = draw.choice(["cut", "flip", "zeros", "twice", "swap", "digit", "insert", "gone"])
        if kind == "cut":
            del content[at:]
        elif kind == "flip":
            for _ in range(draw.choice([1, 3, 30])):
                content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
        elif kind == "zeros":
            content[at : at + 64] = bytes(len(content[at : at + 64]))
        elif kind == "twice":
            content = content + content
        elif kind == "swap":
            content[at : at + 200], content[:200] = content[:200], content[at : at + 200]
        elif kind == "digit":
            digits = [k for k, byte in enumerate(content) if 48 <= byte <= 57] or [at]
            one = draw.choice(digits)
            content[one : one + 1] = draw.choice([b"9e99", b"-", b"", b"1e-99", b"nan", b"9" * 400])
        elif kind == "insert":
            content[at:at] = draw.choice(
                [b"\0", b"\xff\xfe", b'"', b"{" * 5000, b"\n" * 5000, b"<!--"]
            )
        file.unlink() if kind == "gone" else file.write_bytes(content)
        return f"{file.name} {kind} at {at}", str(place)

    def _path(self, draw, suffix: str):
        """What is read: a valid file of another kind, a place that is no file, an odd name."""
        if draw.random() < 0.2:
            kind = draw.choice(list(self.files))
            return f"the {kind}", self.files[kind]
        if draw.random() < 0.2:
            word = draw.choice(WORDS)
            return repr(word[:30]), word
        return draw.choice(list(odd_places(self.folder / "odd", suffix).items()))


def work(task: tuple) -> list[tuple]:
    """The calls of one process: (number, kind, code, seconds, wrong, last words, memory)."""
    folder, seed, numbers, only, listed, end, log = task
    folder.mkdir(parents=True, exist_ok=True)
    files = material(folder / "files")
    campaign, found = Campaign(folder, files), []
    for number in numbers:
        if time.monotonic() > end or (listed and number >= len(campaign.kinds(only))):
            break
        call = campaign.listed(number, only) if listed else campaign.drawn(seed, number, only)
        kind, words, around = call
        ended, left = run(words, around, folder / "run", files, folder / "listed")
        said = wrong(ended, left, around, words[:1] in [[name] for name in QUICK])
        if isinstance(around, tuple) and ended.code == 0 and not said:
            said = campaign.alike(words, around, folder / "run")
        code = -signal.SIGXCPU if worked(ended) else ended.code
        spent = round(ended.seconds, 1)
        row = (number, kind, code, spent, said, ended.said[-160:], ended.memory)
        found.append(row)
        if log is not None:  # line by line: what was tried is known whatever ends the campaign
            with open(log, "a", encoding="utf-8", errors="replace") as file:
                file.write(f"{row!r}\n")
        if said:
            click.echo(f"{number} {kind}: {said}\n   {shlex.join(words)[:400]}\n")
    return found


@click.command()
@click.option("--count", default=400, show_default=True, help="Calls.")
@click.option("--first", default=0, show_default=True, help="Number of the first.")
@click.option("--seed", default=0, show_default=True)
@click.option("--workers", default=1, show_default=True)
@click.option("--minutes", default=60.0, show_default=True, help="Begin none after that.")
@click.option("--only", default="", help="Commands that begin so.")
@click.option("--listed", is_flag=True, help="Of the tables, all where --count is above.")
@click.option(
    "--log",
    type=click.Path(path_type=Path),
    help="A line for every call. What it has, of an earlier run with that seed, is not made again.",
)
def cli(count, first, seed, workers, minutes, only, listed, log) -> None:
    """Make hostile calls, and say which ended as none may."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ["PYTHONPATH"] = os.pathsep.join(p for p in sys.path if p)
    end = time.monotonic() + 60 * minutes
    earlier = log.read_text("utf-8", "replace").splitlines() if log and log.exists() else []
    rows = {row[0]: row for row in map(ast.literal_eval, earlier)}
    with tempfile.TemporaryDirectory() as place:
        numbers = [n for n in range(first, first + count) if n not in rows]
        tasks = [
            (Path(place) / str(k), seed, numbers[k::workers], only, listed, end, log)
            for k in range(workers)
        ]
        context = multiprocessing.get_context("spawn")
        with context.Pool(workers) as pool:
            rows |= {row[0]: row for made in pool.imap_unordered(work, tasks) for row in made}
    sys.exit(bool(_told(sorted(rows.values()))))


def _told(rows: list[tuple]) -> int:
    """Print what the calls came to; how many ended as none may."""
    ends = {0: "done", 2: "refused", 3: "without a path", -signal.SIGXCPU: "at work"}
    names = sorted(commands(), key=len, reverse=True)  # the longest that fits is the command
    for title, of in (("command", lambda row: _begins(row[1], names)), ("what is broken", _broken)):
        click.echo(f"{title:18} calls  done  refused  wrong")
        for name in sorted({of(row) for row in rows}):
            mine = [row for row in rows if of(row) == name]
            codes, bad = Counter(row[2] for row in mine), sum(bool(row[4]) for row in mine)
            click.echo(f"{name:18} {len(mine):5} {codes[0]:5} {codes[2]:8} {bad:6}")
    bad = sum(bool(row[4]) for row in rows)
    said = Counter(ends.get(row[2], f"exit {row[2]}") for row in rows)
    refused = [row for row in rows if row[2] == 2]
    longest, largest = (max((row[k] for row in refused), default=0) for k in (3, 6))
    click.echo(
        f"{len(rows)} calls ({', '.join(f'{n} {k}' for k, n in sorted(said.items()))}): {bad} "
        f"wrong; the longest refusal took {longest:.1f} s of a processor, the largest "
        f"{largest / 2**20:.0f} MiB"
    )
    return bad


def _begins(kind: str, names: list[str]) -> str:
    return next(name for name in names if kind.startswith(f"{name} "))


def _broken(row: tuple) -> str:
    """What is broken, of a few words."""
    kind = row[1].removeprefix(f"{_begins(row[1], sorted(commands(), key=len, reverse=True))} ")
    if kind.endswith("(listed)"):
        return f"listed: {kind.split()[0]}"
    for how in ("combined", "doubled", "structured", "odd name", "dressed", "foreign", "happening",
                "two"):  # fmt: skip
        if kind.startswith(how):
            return how
    beginnings = {"--out": "output", "--usd": "output", "--": "option", "argument": "argument"}
    beginnings |= {"{'": "environment", "ulimit": "limits", "{": "bytes of a file"}
    return next((what for start, what in beginnings.items() if kind.startswith(start)), "around")


if __name__ == "__main__":
    cli()
