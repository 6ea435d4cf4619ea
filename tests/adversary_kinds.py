"""Kinds of hostile calls beside one broken word (tests/adversary.py): options in combinations that
nobody means, files whose structure is known with one thing in it broken, odd names and dresses of
valid files, and what happens around a call while it runs.

A call that is only dressed otherwise (`SAME`) has to be refused, or to end in the same bytes.
"""

from __future__ import annotations

import json
import os
import random
import shutil
from pathlib import Path

import click
import numpy as np
from hostile import broken_arrays, broken_json, broken_xml, save_arrays, write_json_file

# Valid calls beside adversary_material.VALID, for files that those do not read.
MORE = {
    "plan": [
        ["{points.svg}", "--rod", "{rod.json}", "--method", "intuitive", "--no-robot",
         "--no-expect", "--spacing", "0.02", "--out", "{out}"],
        ["line", "--rod", "green-vps", "--method", "intuitive", "--spacing", "0.02", "--no-expect",
         "--robot", "{arm.urdf}", "--obstacles", "{obstacles.json}", "--out", "{out}"],
        ["line", "--rod", "green-vps", "--controller", "{controller.safetensors}", "--method",
         "neural", "--no-robot", "--no-expect", "--no-shapes", "--spacing", "0.02", "--out",
         "{out}"],
    ],
    "deploy": [
        ["line", "--rod", "{rod.json}", "--trajectory", "{plan.npz}", "--speed", "0.5",
         "--fixtures", "{fixtures.json}", "--device", "cpu", "--out", "{out}"],
    ],
    "scan": [
        ["{line.png}", "--markers", "{layout.json}", "--camera", "{camera.json}", "--out", "{out}"],
    ],
    "laid": [
        ["{line.npz}", "--pattern", "line", "--trajectory", "{plan.npz}", "--rod", "{rod.json}",
         "--iterations", "1", "--table", "{out}.table.json", "--out", "{out}.json"],
    ],
    "show": [["{points.svg}", "--rod", "{rod.json}", "--out", "{out}.png"]],
    "identify": [["{motion.npz}", "--effect", "quadratic_drag", "--out", "{out}"]],
    "bench table3": [
        ["--trials", "2", "--rod", "green-vps", "--substrate", "steel", "--pattern", "line",
         "--spacing", "0.05", "--step", "0.05", "--speed", "0.1", "--batch", "1", "--workers", "2",
         "--device", "cpu", "--out", "{out}"],
    ],
    "bench slippery": [
        ["--names", "line", "--methods", "intuitive", "--frictions", "0.6", "--trials", "2",
         "--workers", "2", "--out", "{out}"],
    ],
    "bench controller": [["{controller.safetensors}", "--count", "4", "--device", "cpu"]],
}  # fmt: skip
# Texts that options take somewhere.
_TEXTS = (
    "0.3", "0.2:0.6", "0.04", "line", "letter-U", "sine", "line,sine", "letter-A,line", "rope",
    "green-vps", "green-vps,rope", "0.2,0.6", "10,20", "4", "1", "up", "plane", "45", "mm", "m",
    "cpu", "auto", "64x48", "0.1", "0", "none", "wrod", "wrod,mujoco", "blind", "lower-left",
    "0.6,0,0,0", "a4", "210x297", "trefoil", "stiffness", "mcap", "poses", "sawyer", "panda",
    "numeric", "intuitive", "stroke", "steel", "zero_tension", "min_force", "reef knot", "1e-3",
)  # fmt: skip
# Bash around CALL, whose output is at $OUT; what is told after "EXIT" are its exit codes.
_SIGNALS = ("INT", "TERM", "HUP", "INT", "TERM", "USR1", "ALRM", "PIPE", "WINCH", "CONT", "TSTP")
SCRIPTS = {
    "two at once": "CALL > ../log 2>&1 & p=$!\nCALL; a=$?\nwait $p; b=$?\ncat ../log\n"
    "echo EXIT $a $b\n",
    "two, one killed": "CALL > ../log 2>&1 & p=$!\nsleep SECONDS; kill -KILL $p; wait $p\n"
    "CALL; echo EXIT $?\n",
    "stopped": "CALL & p=$!\nsleep SECONDS; kill -STOP $p; sleep 0.3; kill -CONT $p; wait $p\n"
    "echo EXIT $?\n",
    "vanishes": "CALL & p=$!\nsleep SECONDS; rm -rf $OUT* 2> ../log; wait $p\necho EXIT $?\n",
    "becomes a file": "CALL & p=$!\nsleep SECONDS; rm -rf $OUT* 2> ../log; echo mine > $OUT; "
    "wait $p\na=$?; rm -f $OUT; echo EXIT $a\n",
    "full disk": "unshare -rm bash -c 'mkdir -p $OUT.disk; mount -t tmpfs -o size=SIZE,nr_inodes="
    "INODES none $OUT.disk || exit 0\nCALL_THERE; a=$?\nfind $OUT.disk -name \".*\" -type f "
    "-printf \"HALF %p\\n\"\necho EXIT $a'\nrmdir $OUT.disk\n",
    "read-only folder": "mkdir -p $OUT.disk; chmod 555 $OUT.disk\nUNABLE CALL_THERE; a=$?\n"
    "find $OUT.disk -type f -printf \"HALF %p\\n\"; rm -rf $OUT.disk\necho EXIT $a\n",
    "unreadable": "chmod 000 READ\nUNABLE CALL; a=$?\nchmod 644 READ\necho EXIT $a\n",
    "settings here": "printf 'backend: nothing\\nfont.size: \\377\\n' > matplotlibrc\n"
    "echo 'raise SystemExit(77)' | tee click.py random.py sitecustomize.py wrod.py > numpy.py\n"
    "CALL; a=$?\nrm -f matplotlibrc *.py\necho EXIT $a\n",
    "json": "CALL --json 2> ../log | python3 -c 'import json, sys; text = sys.stdin.read()\n"
    "text and [json.loads(text, parse_constant=int)]'; s=\"${PIPESTATUS[*]}\"\n"
    "cat ../log; echo EXIT $s\n",
    "grows": "CALL & p=$!\nsleep SECONDS; echo rubbish >> READ; wait $p\necho EXIT $?\n",
    "shrinks": "CALL & p=$!\nsleep SECONDS; : > READ; wait $p\necho EXIT $?\n",
} | {
    f"SIG{name}": f"set -m; CALL & p=$!\nsleep SECONDS; kill -{name} -- -$p\nwait $p; a=$?\n"
    "find $(dirname $OUT) -name '.*' -type f -printf 'HALF %p\\n'\necho EXIT $a\n"
    for name in ("INT", "TERM", "HUP")
}  # fmt: skip
# A signal goes to the process and to those that it began, as from a terminal.
# Exit codes that the scripts may tell beside success, refusal and "no joint path".
ALLOWED = {"SIGINT": 130, "SIGTERM": 143, "SIGHUP": 129}
UNABLE = "setpriv --bounding-set -dac_override,-dac_read_search,-fowner,-sys_admin"
# Commands whose output is the same in two runs, and quick.
SAME = ("plan", "deploy", "loop", "measure", "manifold", "identify", "laid", "scan", "show",
        "dataset", "markers")  # fmt: skip


def words_of(draw: random.Random, option: click.Option, files: dict[str, str]) -> list[str]:
    """The option with a value that is possible, if not sensible."""
    flag, kind = max(option.opts, key=len), option.type
    if option.is_flag:
        return [draw.choice([flag, *option.secondary_opts])]
    if isinstance(kind, click.Choice):
        return [flag, str(draw.choice(list(kind.choices)))]
    if hasattr(kind, "min"):
        low, high = kind.min, kind.max
        how = draw.random()
        value = low if how < 0.1 else high if how < 0.2 else draw.uniform(low, high)
        if how > 0.4 and high > 0:
            least = max(low, high * 1e-9, 1e-12)
            value = float(np.exp(draw.uniform(np.log(least), np.log(high))))
        return [flag, repr(round(value) if isinstance(kind, click.IntRange) else value)]
    if isinstance(kind, click.Path):
        return [flag, draw.choice(list(files.values()))]
    return [flag, draw.choice(_TEXTS)]


def combined(draw, words, command, files) -> tuple[str, list[str]]:
    """Several options at once."""
    options = [o for o in command.params if isinstance(o, click.Option)]
    options = [o for o in options if o.name not in ("out", "usd", "view", "force")]
    chosen = draw.sample(options, min(len(options), draw.choice([1, 2, 2, 3, 3, 4, 6])))
    given = [word for option in chosen for word in words_of(draw, option, files)]
    return " ".join(given)[:120], [*words, *given]


def doubled(draw, words, command, files) -> tuple[str, list[str]]:
    """One file for every thing that is read."""
    one = draw.choice(list(files.values()))
    reads = {f"{{{name}}}" for name in files}
    changed = [one if word in reads else word for word in words]
    paths = [o for o in command.params if isinstance(o.type, click.Path) and o.name != "out"]
    paths = [o for o in paths if isinstance(o, click.Option)]
    for option in draw.sample(paths, min(len(paths), 2)):
        changed += [max(option.opts, key=len), one]
    return f"all of {Path(one).name}", changed


def _reads(words, files) -> list[str]:
    return [word for word in words if word.strip("{}") in files]


def structured(draw, words, files, folder) -> tuple[str, list[str]] | None:
    """One thing in a file broken, by its structure."""
    reads = [w for w in _reads(words, files) if Path(w.strip("{}")).suffix in _BREAK]
    if not reads:
        return None
    read = draw.choice(reads)
    file, made = Path(files[read.strip("{}")]), folder / "broken"
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir(parents=True)
    kind = _BREAK[file.suffix](file, made / file.name, draw)
    return f"{file.name}: {kind}", [str(made / file.name) if w == read else w for w in words]


def _break_json(file: Path, made: Path, draw) -> str:
    kind, text = broken_json(json.loads(file.read_text()), draw)
    write_json_file(made, text, draw)
    return kind


def _break_arrays(file: Path, made: Path, draw) -> str:
    with np.load(file) as content:
        kind, arrays = broken_arrays({name: content[name] for name in content.files}, draw)
    save_arrays(made, arrays)
    return kind


def _break_xml(file: Path, made: Path, draw) -> str:
    kind, text = broken_xml(file.read_text().replace("</svg>", "</robot>"), draw)
    made.write_text(text.replace("</robot>", "</svg>") if made.suffix == ".svg" else text,
                    encoding="utf-8", errors="replace")  # fmt: skip
    return kind


_BREAK = {
    ".json": _break_json, ".npz": _break_arrays, ".urdf": _break_xml,
}  # fmt: skip


def odd_name(draw, words, files, folder) -> tuple[str, list[str]] | None:
    """A valid file under a name that nobody gives, or through links."""
    reads = [w for w in _reads(words, files) if Path(files[w.strip("{}")]).is_file()]
    if not reads:
        return None
    read = draw.choice(reads)
    file, made = Path(files[read.strip("{}")]), folder / "named"
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir(parents=True)
    stem = draw.choice(
        ["a\nb", "-rf", "%d%s{}", "a b", " ", "e\u0301\u202e", "\U0001f40d", "\udcff\udcfe",
         "$HOME", "`id`", "a'b\"c", "x" * 240, "\x1b[2J", "..a", "*", "a\\b", "~", "CON", "a:b",
         "1e5", "nan", "letter-A", "sawyer", "green-vps"]
    )  # fmt: skip
    path = made / f"{stem}{file.suffix}"
    how = draw.choice(["copy", "link", "links", "hard"])
    if how == "copy":
        shutil.copy(file, path)
    elif how == "hard":
        os.link(file, path)
    else:
        goal = file
        for k in range(30 if how == "links" else 0):
            (made / f"l{k}").symlink_to(goal)
            goal = made / f"l{k}"
        path.symlink_to(goal)
    return f"{file.name} as {stem!r}, {how}", [str(path) if w == read else w for w in words]


def dressed(draw, words, files, folder) -> tuple[str, list[str]]:
    """The same call with its words or files written otherwise."""
    reads = [w for w in _reads(words, files) if Path(w.strip("{}")).suffix in _DRESS]
    if reads and draw.random() < 0.7:
        read = draw.choice(reads)
        file, made = Path(files[read.strip("{}")]), folder / "dressed"
        shutil.rmtree(made, ignore_errors=True)
        made.mkdir(parents=True)
        kind = _DRESS[file.suffix](file, made / file.name, draw)
        return f"{file.name} {kind}", [str(made / file.name) if w == read else w for w in words]
    found, kinds = list(words), []
    for k, word in enumerate(words):
        try:
            float(word)
        except ValueError:
            continue
        if draw.random() < 0.7 and k and words[k - 1].startswith("--"):
            ways = [f"+{word}", f" {word}", f"0{word}", f"{word}\t"]
            if "." in word:
                ways += [f"{word}000", f"{float(word):.17e}", f"{word}e0", f"{word}E+00"]
            found[k] = draw.choice(ways)
            kinds.append(found[k])
    return f"numbers as {kinds}", found


def _dress_text(file: Path, made: Path, draw) -> str:
    text = file.read_text()
    ways = {
        "CRLF": text.replace("\n", "\r\n").encode(), "BOM": text.encode("utf-8-sig"),
        "UTF-16": text.encode("utf-16"), "no last line end": text.rstrip("\n").encode(),
        "blank lines": (text + "\n" * 500).encode(), "CR": text.replace("\n", "\r").encode(),
        "spaces": text.replace("\n", " \t\n").encode(), "ends in ^Z": text.encode() + b"\x1a",
    }  # fmt: skip
    kind, content = draw.choice(list(ways.items()))
    made.write_bytes(content)
    return kind


def _dress_json(file: Path, made: Path, draw) -> str:
    value = json.loads(file.read_text())
    if isinstance(value, dict):
        value = dict(reversed(value.items()))
    text = json.dumps(value, indent=draw.choice([None, 1, "\t"]))
    ways = {"keys": text.encode(), "BOM": text.encode("utf-8-sig"), "UTF-16": text.encode("utf-16"),
            "CRLF": text.replace("\n", "\r\n").encode(),
            "spaces": b" \n" * 5000 + text.encode() + b"\n" * 5000}  # fmt: skip
    kind, content = draw.choice(list(ways.items()))
    made.write_bytes(content)
    return kind


def _dress_arrays(file: Path, made: Path, draw) -> str:
    with np.load(file) as content:
        arrays = {name: content[name] for name in content.files}
    kind = draw.choice(["packed", "big-endian", "Fortran", "turned names", "a comment"])
    if kind == "packed":
        np.savez_compressed(made, **arrays)
        return kind
    if kind == "big-endian":
        arrays = {k: v.astype(v.dtype.newbyteorder(">")) for k, v in arrays.items()}
    elif kind == "Fortran":
        arrays = {k: np.asfortranarray(v) for k, v in arrays.items()}
    elif kind == "turned names":
        arrays = dict(reversed(arrays.items()))
    save_arrays(made, arrays)
    if kind == "a comment":
        import zipfile

        with zipfile.ZipFile(made, "a") as archive:
            archive.comment = b"words" * 1000
    return kind


_DRESS = {
    ".csv": _dress_text, ".svg": _dress_text, ".urdf": _dress_text, ".usda": _dress_text,
    ".json": _dress_json, ".npz": _dress_arrays,
}  # fmt: skip


def happening(draw, words, files, folder) -> tuple[str, list[str], str]:
    """Something happens while the call runs; the bash around it."""
    kind = draw.choice(list(SCRIPTS))
    text = SCRIPTS[kind]
    reads = [w for w in _reads(words, files) if Path(files[w.strip("{}")]).is_file()]
    if "READ" in text and not reads:
        kind = "two at once"
        text = SCRIPTS[kind]
    if "READ" in text:
        read = draw.choice(reads)
        made = folder / "happens"
        shutil.rmtree(made, ignore_errors=True)
        made.mkdir(parents=True)
        shutil.copy(files[read.strip("{}")], made)
        path = made / Path(files[read.strip("{}")]).name
        words = [str(path) if word == read else word for word in words]
        text = text.replace("READ", str(path))
    text = text.replace("SECONDS", f"{draw.choice([0.5, 1.0, 1.5, 2.0, 3.0]):g}")
    text = text.replace("SIZE", draw.choice(["4k", "8k", "32k", "128k", "512k"]))
    text = text.replace("INODES", draw.choice(["2", "3", "4", "100", "100"]))
    return kind, words, f"# {kind}\n{text.replace('UNABLE', UNABLE)}"
