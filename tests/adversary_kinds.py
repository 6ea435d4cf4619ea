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
from adversary_dress import emptied, one_file, reads
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
        ["{drawing.dxf}", "--rod", "{model.json}", "--method", "numeric", "--no-robot",
         "--no-expect", "--spacing", "0.05", "--out", "{out}"],
    ],
    "deploy": [
        ["line", "--rod", "{model.json}", "--method", "intuitive", "--speed", "0.5", "--device",
         "cpu", "--out", "{out}"],
        ["line", "--rod", "{rod.json}", "--trajectory", "{plan.npz}", "--speed", "0.5",
         "--fixtures", "{fixtures.json}", "--device", "cpu", "--out", "{out}"],
    ],
    "scan": [
        ["{marked.png}", "--markers", "{layout.json}", "--camera", "{camera.json}", "--out",
         "{out}"],
    ],
    "laid": [
        ["{line.npz}", "--pattern", "line", "--trajectory", "{plan.npz}", "--rod", "{rod.json}",
         "--noise", "0.001", "--iterations", "1", "--fit-friction", "--table",
         "{out}.table.json", "--out", "{out}.json"],
        ["{deployment.npz}", "--pattern", "line", "--trajectory", "{plan.npz}", "--rod",
         "{model.json}", "--noise", "0.001", "--iterations", "0", "--holding"],
    ],
    "show": [
        ["{drawing.dxf}", "--rod", "{model.json}", "--out", "{out}.png"],
        ["{points.svg}", "--rod", "{rod.json}", "--out", "{out}.png"],
    ],
    "identify": [["{motion.npz}", "--effect", "quadratic_drag", "--out", "{out}"]],
    "bench table3": [
        ["--trials", "2", "--rod", "green-vps", "--substrate", "steel", "--pattern", "line",
         "--spacing", "0.05", "--step", "0.05", "--speed", "0.1", "--batch", "1",
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
    "on stdin": "CALL_STDIN < READ; echo EXIT $?\n",
    "from a pipe": "cat READ | CALL_STDIN; echo EXIT $?\n",
    "substituted": "exec 9< <(cat READ); CALL_FD; echo EXIT $?\n",
    "small terminal": "script -qec 'stty cols 1 rows 1; exec bash ../call.sh' ../typed "
    "< /dev/null > ../log; a=$?\ncat ../log; echo EXIT $a\n",
    "no temporary room": "unshare -rm bash -c 'mkdir -p $OUT.disk; mount -t tmpfs -o size=SIZE "
    "none $OUT.disk || exit 0\nexport TMPDIR=$OUT.disk; CALL; echo EXIT $?'\nrmdir $OUT.disk\n",
    "no proc": "unshare -rm bash -c 'mount -t tmpfs none /proc || exit 0\nCALL; echo EXIT $?'\n",
    "no shm": "unshare -rm bash -c 'mount -t tmpfs -o ro none /dev/shm || exit 0\nCALL; "
    "echo EXIT $?'\n",
    "no dev": "unshare -rm bash -c 'mount -t tmpfs none /dev || exit 0\nCALL; echo EXIT $?'\n",
    "becomes a link": "CALL & p=$!\nsleep SECONDS; rm -rf $OUT* 2> ../log; ln -s /nonexistent/x "
    "$OUT; wait $p\na=$?; rm -rf $OUT; echo EXIT $a\n",
    "becomes read-only": "mkdir -p $OUT.disk; UNABLE CALL_THERE & p=$!\nsleep SECONDS; "
    "chmod -R a-w $OUT.disk; wait $p\na=$?; find $OUT.disk -name '.*' -type f -printf 'HALF %p\n'\n"
    "chmod -R u+w $OUT.disk; rm -rf $OUT.disk; echo EXIT $a\n",
    "flips": "cp READ ../good; (while :; do cp ../good READ; printf '{\"a\": [' > READ; done) "
    "& f=$!\nCALL; a=$?; kill $f; wait $f 2> ../log; cp ../good READ; echo EXIT $a\n",
    "read-only input": "chmod 444 READ; CALL; a=$?; chmod 644 READ; echo EXIT $a\n",
    "json, traced": "export TF_DEBUG=* OPENCV_LOG_LEVEL=VERBOSE\nCALL --json 2> ../log | "
    "python3 -c 'import json, sys; text = sys.stdin.read()\n"
    "text and [json.loads(text, parse_constant=int)]'; s=\"${PIPESTATUS[*]}\"\n"
    "tail -n 3 ../log; echo EXIT $s\n",
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


def structured(draw, words, files, folder) -> tuple[str, list[str]] | None:
    """One thing in a file broken, by its structure."""
    found = [w for w in reads(words, files) if Path(w.strip("{}")).suffix in _BREAK]
    if not found:
        return None
    read = draw.choice(found)
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
    kind, text = broken_xml(file.read_text().replace("svg", "robot"), draw)
    if made.suffix == ".svg":
        text = text.replace("robot", "svg")
    made.write_text(text, encoding="utf-8", errors="replace")
    return kind


_BREAK = {
    ".json": _break_json, ".npz": _break_arrays, ".urdf": _break_xml, ".svg": _break_xml,
}  # fmt: skip


def odd_name(draw, words, files, folder) -> tuple[str, list[str]] | None:
    """A valid file under a name that nobody gives, or through links."""
    read, file = one_file(draw, words, files)
    if file is None:
        return None
    made = emptied(folder / "named")
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


def happening(draw, words, files, folder) -> tuple[str, list[str], str]:
    """Something happens while the call runs; the bash around it."""
    kind = draw.choice(list(SCRIPTS))
    text = SCRIPTS[kind]
    found = [w for w in reads(words, files) if Path(files[w.strip("{}")]).is_file()]
    if "READ" in text and not found:
        kind = "two at once"
        text = SCRIPTS[kind]
    if "READ" in text:
        read = draw.choice(found)
        made = folder / "happens"
        shutil.rmtree(made, ignore_errors=True)
        made.mkdir(parents=True)
        shutil.copy(files[read.strip("{}")], made)
        path = made / Path(files[read.strip("{}")]).name
        words = [str(path) if word == read else word for word in words]
        text = text.replace("READ", str(path))
        at = [k for k, word in enumerate(words) if word == str(path)]
        for name, place in (("CALL_STDIN", "/dev/stdin"), ("CALL_FD", "/dev/fd/9")):
            if name in text:
                text = text.replace(name, "CALL")
                words = [place if k in at else word for k, word in enumerate(words)]
    text = text.replace("SECONDS", f"{draw.choice([0.5, 1.0, 1.5, 2.0, 3.0]):g}")
    text = text.replace("SIZE", draw.choice(["4k", "8k", "32k", "128k", "512k"]))
    text = text.replace("INODES", draw.choice(["2", "3", "4", "100", "100"]))
    return kind, words, f"# {kind}\n{text.replace('UNABLE', UNABLE)}"
