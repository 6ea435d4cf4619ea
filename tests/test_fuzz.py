"""Hostile input over every loader and every option of every command.

A loader takes what it is given or refuses it in a `WrodError` of one sentence; a command refuses
with exit code 2 before it works, and leaves nothing behind. WROD_FUZZ=50 tries fifty times as much
as the tests do (`make fuzz`).
"""

import json
import os
import random
import resource
import signal
import time
import warnings
from contextlib import contextmanager
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner
from hostile import (
    NUMBERS,
    WORDS,
    arrays_of,
    broken_arrays,
    broken_json,
    broken_xml,
    foreign_files,
    save_arrays,
    write_json_file,
)
from wrod.scenes import sawyer

import wrod
from wrod.commands import COMMANDS, main
from wrod.commands.bench import BENCHMARKS
from wrod.commands.bounds import BOUNDS
from wrod.deployment.fixtures import Fixtures
from wrod.deployment.result import Deployment
from wrod.errors import WrodError
from wrod.identification import is_motion, load_measurements, load_motion
from wrod.identification.held.measurements import (
    load_hanging,
    load_held,
    load_poses,
    load_swing,
)
from wrod.identification.laid.photographs import load_photograph
from wrod.knots.plan import KnotPlan
from wrod.perception.image import read_image
from wrod.perception.metric import CameraIntrinsics, MarkerLayout
from wrod.planning.trajectory import Trajectory
from wrod.robot.joint_path import JointPath
from wrod.robot.urdf import read_urdf

FUZZ = int(os.environ.get("WROD_FUZZ", "1"))
SECONDS, BYTES = 10, 2 * 2**30
SCENES = Path(sawyer.__file__).parent
# Of a test of many files, so that `make fuzz` ends [s of a processor]; what was tried is told.
LONGEST = 10


def tries(count):
    """Calls it with so many seeds, FUZZ times as often where there is time for that: the same in
    every run of the tests, others in each `make fuzz`."""

    def decorate(attempt):
        def each():
            draw, end = random.Random(count if FUZZ == 1 else None), time.process_time() + LONGEST
            for _ in range(count * FUZZ):
                if time.process_time() > end:
                    return
                attempt(draw.getrandbits(32))

        return each

    return decorate


@contextmanager
def bounded(what):
    """Fail if it takes more than 10 s of a processor, or waits, or 2 GiB more than there were."""
    seen = [0.0]

    def late(number, _):
        if number == signal.SIGALRM and time.process_time() > seen[0] + 0.1:  # a busy machine
            seen[0] = time.process_time()
            return
        raise AssertionError(f"{what}: no end after {SECONDS} s")

    clocks = ((signal.ITIMER_PROF, signal.SIGPROF), (signal.ITIMER_REAL, signal.SIGALRM))
    before = [signal.signal(one, late) for _, one in clocks]
    for (clock, _), seconds in zip(clocks, (SECONDS, 6 * SECONDS), strict=True):
        signal.setitimer(clock, seconds, seconds)
    start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        yield
    finally:
        for (clock, number), handler in zip(clocks, before, strict=True):
            signal.setitimer(clock, 0)
            signal.signal(number, handler)
    grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - start)
    assert grown < BYTES, f"{what}: took {grown / 2**30:.1f} GiB"


def taken_or_refused(load, path, what) -> bool:
    """Whether it was refused; fails on every other error."""
    with bounded(what), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            load(path)
        except WrodError as error:
            said = str(error)
            assert said and len(said) < 2000 and "Traceback" not in said, what
            return True
        except AssertionError:
            raise
        except BaseException as error:
            raise AssertionError(f"{what}: {type(error).__name__}: {error}") from error
    return False


def corner(x, y):
    return [[x, y], [x + 0.02, y], [x + 0.02, y - 0.02], [x, y - 0.02]]


ROD = {
    "format": "wrod-rod-1", "radius": 0.0016, "gravito_bending_length": 0.032, "length": 0.885,
    "poisson": 0.5, "density": 1180.0, "gravity": 9.81, "natural_curvature": [0.5, 0.0],
}  # fmt: skip
JSON_FILES = {
    "fixtures": (Fixtures.load, json.loads((SCENES / "cable/U.json").read_text())),
    "knot": (KnotPlan.load_plan, json.loads((SCENES / "knots/trefoil.json").read_text())),
    "rod": (wrod.load_rod, ROD),
    "markers": (
        MarkerLayout.load,
        {
            "marker_corners_m": {
                "0": corner(0, 0), "1": corner(0.3, 0), "2": corner(0.3, 0.2), "3": corner(0, 0.2),
            },
            "paper_size_m": [0.4, 0.3],
        },
    ),
    "camera": (
        CameraIntrinsics.load,
        {"camera_matrix": [[900, 0, 320], [0, 900, 240], [0, 0, 1]], "distortion": [0.1] * 5},
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    """Files that nothing reads, by kind."""
    return foreign_files(tmp_path_factory.mktemp("foreign") / "files")


def note(tried, kind, refused):
    count, before = tried.get(kind, (0, 0))
    tried[kind] = (count + 1, before + bool(refused))


@pytest.mark.parametrize("kind", JSON_FILES)
def test_json_files(kind, tmp_path, tried):
    load, valid = JSON_FILES[kind]
    path = tmp_path / "file.json"
    if kind == "knot":
        for entry in valid["rods"]:
            entry["pattern"] = str(SCENES / "knots" / Path(entry["pattern"]).name)
    path.write_text(json.dumps(valid))
    assert not taken_or_refused(load, path, f"a valid {kind}")

    @tries(60)
    def attempt(seed):
        draw = random.Random(seed)
        what, text = broken_json(valid, draw)
        write_json_file(path, text, draw)
        note(tried, kind, taken_or_refused(load, path, f"{kind}, seed {seed}: {what}"))

    attempt()


def plan_arrays(tmp_path):
    curve = wrod.pattern("line")
    path = wrod.plan(curve, wrod.rod("green-vps"), "intuitive", spacing=0.05).save(tmp_path / "t")
    with np.load(path[1]) as file:
        return {name: file[name] for name in file.files}


def clamped_arrays():
    rng = np.random.default_rng(0)
    eye = np.tile(np.eye(3), (4, 1, 1))
    s = np.linspace(0, 0.3, 9)
    line = np.stack([s, 0 * s, -0.2 * s * (0.3 - s)], 1) + 1e-4 * rng.normal(size=(4, 9, 3))
    return {
        "centerline": line, "arc_length": s, "clamp_position": line[:, 0], "clamp_rotation": eye,
        "grip_position": line[:, -1], "grip_rotation": eye, "train_idx": np.array([0, 1, 2]),
        "test_idx": np.array([3]), "length": 0.3, "radius": 0.002, "density": 1180.0,
        "L_gb": 0.03, "poisson": 0.5, "gravity": 9.81, "noise_std": 1e-4,
    }  # fmt: skip


def motion_arrays():
    rng = np.random.default_rng(0)
    s = np.linspace(0, 0.5, 8)
    still = np.stack([s, 0 * s, 0 * s], 1)
    sway = 0.01 * np.sin(np.linspace(0, 6, 30))[None, :, None, None] * np.array([0, 0, 1.0])
    return {
        "positions": still + sway + 1e-4 * rng.normal(size=(3, 30, 8, 3)), "rate_hz": 100.0,
        "held": np.array([0, 1, 6, 7]), "gravity": 9.81,
    }  # fmt: skip


def photograph_arrays(_):
    curve = np.column_stack([np.linspace(0, 0.3, 40), np.zeros(40)])
    return {
        "centerline_filled": curve, "hidden": np.zeros(40), "sigma": np.full(40, 5e-4),
        "pattern": curve, "size_factor": 1.0, "px_from_pattern": np.eye(2, 3), "pixels": curve,
    }  # fmt: skip


def sine_points(_):
    curve = wrod.pattern("sine")
    return {"points": curve.sample(np.linspace(0, curve.length, 60))[0]}


ARRAY_FILES = {
    "trajectory": (Trajectory.load, plan_arrays),
    "deployment": (Deployment.load, lambda _: arrays_of("Deployment")),
    "joint path": (JointPath.load, lambda _: arrays_of("JointPath") | {"metadata": np.array("{}")}),
    "clamped": (load_measurements, lambda _: clamped_arrays()),
    "motion": (load_motion, lambda _: motion_arrays()),
    "points": (wrod.Pattern.load, sine_points),
    "hanging": (load_hanging, lambda _: arrays_of("HangingLoops")),
    "held": (load_held, lambda _: arrays_of("HeldCable")),
    "swing": (load_swing, lambda _: arrays_of("HeldSwing")),
    "poses": (load_poses, lambda _: arrays_of("HeldPoses")),
    "photograph": (load_photograph, photograph_arrays),
}


@pytest.mark.parametrize("kind", ARRAY_FILES)
def test_array_files(kind, tmp_path, tried):
    load, make = ARRAY_FILES[kind]
    valid, path = make(tmp_path), tmp_path / "rope-line-int.npz"
    save_arrays(path, valid)
    assert not taken_or_refused(load, path, f"a valid {kind}")

    @tries(60)
    def attempt(seed):
        what, arrays = broken_arrays(valid, random.Random(seed))
        save_arrays(path, arrays)
        where = f"{kind}, seed {seed}: {what}"
        note(tried, kind, taken_or_refused(load, path, where))
        taken_or_refused(is_motion, path, where)

    attempt()


def test_urdf_files(tmp_path, tried):
    valid, path = sawyer.PATH.read_text(), tmp_path / "arm.urdf"
    path.write_text(valid)
    assert not taken_or_refused(read_urdf, path, "the Sawyer")

    def load(file):
        urdf = read_urdf(file)
        urdf.shapes("visual")
        urdf.shapes("collision")

    @tries(60)
    def attempt(seed):
        what, text = broken_xml(valid, random.Random(seed))
        path.write_text(text, encoding="utf-8", errors="replace")
        note(tried, "urdf", taken_or_refused(load, path, f"URDF, seed {seed}: {what}"))

    attempt()


def test_point_files(tmp_path, tried):
    s = np.linspace(0.0, 0.4, 40)
    rows = [f"{x:.6f} {0.05 * np.sin(9 * x):.6f}" for x in s]
    path = tmp_path / "points.txt"

    @tries(60)
    def attempt(seed):
        draw = random.Random(seed)
        lines, k = list(rows), draw.randrange(len(rows))
        lines[k] = draw.choice(
            ["nan 0", "inf inf", "1e300 1e300", "-1e300 1e300", "1", "1 2 3 4", "x y", "", "0 0",
             "1e-320 1e-320", "1;2", "x" * 10_000, "# units: parsec", "units: mm", "9" * 400 + " 1",
             "0.1 0.2 7", "\0", "1 2\r3 4", "½ ¾", "x [mm], y [cm]", lines[k - 1]]
        )  # fmt: skip
        if draw.random() < 0.2:
            lines = lines[: draw.choice([0, 1, 2, 3])]
        path.write_text("\n".join(lines), encoding=draw.choice(["utf-8"] * 5 + ["utf-16"]))
        what = f"points, seed {seed}: {lines[k][:30] if k < len(lines) else 'short'!r}"
        note(tried, "points", taken_or_refused(wrod.Pattern.load, path, what))

    attempt()


def test_foreign_files_are_refused_by_every_loader(tried, foreign):
    loaders = [load for load, _ in JSON_FILES.values()]
    loaders += [Trajectory.load, Deployment.load, load_measurements, load_motion, read_urdf]
    loaders += [wrod.Pattern.load, wrod.Controller.load, read_image]
    for kind, path in foreign.items():
        for load in loaders:
            name = getattr(load, "__qualname__", str(load))
            refused = taken_or_refused(load, path, f"{name} of {kind}")
            assert refused or (kind == "csv" and load == wrod.Pattern.load), (name, kind)
            note(tried, "foreign", refused)


# ---- the command line ---------------------------------------------------------------------------

# What a command needs beside the option that is broken.
NEEDS = {
    "plan": ["letter-U", "--rod", "green-vps", "--no-robot", "--no-expect"],
    "deploy": ["letter-U", "--rod", "green-vps"],
    "loop": ["--height", "0.04", "--radius", "0.0016", "--length", "0.8"],
    "measure": ["--overhang", "0.07", "--fall", "0.03", "--radius", "0.0016", "--length", "0.8"],
    "manifold": ["--length", "17"],
    "dataset": ["--size", "100"],
    "train": ["--generate", "100"],
    "laid": ["{missing}", "--pattern", "line", "--trajectory", "{missing}"],
    "identify": ["{missing}"],
    "scan": ["{missing}"],
    "render": ["{missing}"],
}
# Options whose every word is good somewhere: names of what is shown or looked for.
FREE = {"--hide", "--only", "--json", "--test"}


def commands():
    """(name, command) of every command and benchmark."""
    context = click.Context(main)
    for name in COMMANDS:
        if name != "bench":
            yield name, main.get_command(context, name)
    group = main.get_command(context, "bench")
    for name in BENCHMARKS:
        yield f"bench {name}", group.get_command(context, name)


def numeric(option):
    return isinstance(option.type, (click.FloatRange, click.IntRange))


def refused_by_command(words, folder, what, tried, kind):
    """The command refuses: exit code 2, one sentence, in time, and leaves nothing."""
    out = folder / "out"
    with bounded(what), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = CliRunner().invoke(main, words)
    left = [str(p) for p in out.rglob("*")] if out.exists() else []
    assert result.exit_code == 2, f"{what}: exit {result.exit_code}: {result.output[-400:]}"
    assert "Traceback" not in result.output and result.output.strip(), what
    assert not left, f"{what}: left {left}"
    note(tried, kind, True)


def call(name, command, folder, changes):
    """Words of a call with some options set; the others as valid as they need to be."""
    words = name.split()
    needed = [w.format(missing=folder / "none") for w in NEEDS.get(name, [])]
    for option in changes:
        while option in needed:
            at = needed.index(option)
            del needed[at : at + 2]
    opts = {max(p.opts, key=len) for p in command.params if isinstance(p, click.Option)}
    if "--out" in opts and "--out" not in changes:
        out = folder / ("out/rod.json" if name in ("loop", "laid", "measure") else "out")
        needed += ["--out", str(out)]
    return words + needed + [w for pair in changes.items() for w in pair]


@pytest.mark.parametrize("name, command", list(commands()))
def test_numbers_out_of_bounds_are_refused(name, command, tmp_path, tried):
    for option in command.params:
        if not isinstance(option, click.Option) or not numeric(option):
            continue
        flag = max(option.opts, key=len)
        assert f"{name} {flag}" in BOUNDS or flag in BOUNDS, f"{name} {flag} has no bounds"
        low, high = option.type.min, option.type.max
        beyond = [str(low - 1), str(high + 1), repr(high * 2.0 + 1.0)]
        for value in [*NUMBERS, *beyond]:
            try:
                if low <= float(value) <= high:
                    continue
            except ValueError:
                pass
            words = call(name, command, tmp_path, {flag: value})
            refused_by_command(words, tmp_path, f"{name} {flag} {value!r}", tried, "numbers")


@pytest.mark.parametrize("name, command", list(commands()))
def test_words_that_nobody_means_are_refused(name, command, tmp_path, tried):
    for option in command.params:
        if not isinstance(option, click.Option) or option.is_flag or numeric(option):
            continue
        flag = max(option.opts, key=len)
        if flag in FREE or isinstance(option.type, click.Path) or flag not in DOORS.get(name, ()):
            continue
        for value in WORDS:
            if value in DOORS[name][flag]:
                continue
            words = call(name, command, tmp_path, {flag: value})
            refused_by_command(words, tmp_path, f"{name} {flag} {value!r}", tried, "words")


# Options of text that are judged before the work, and which of WORDS are good for them.
DOORS = {
    "plan": {
        "--rod": (), "--method": (), "--closure": (), "--units": (), "--device": (),
        "--roll": ("nan", "-1", "0"), "--sheet": (), "--start": (),
    },
    "deploy": {"--rod": (), "--method": (), "--closure": (), "--units": (), "--device": ()},
    "manifold": {"--closure": (), "--device": ()},
    "dataset": {"--closure": (), "--device": (), "--rod": ()},
    "train": {"--recipe": (), "--device": ()},
    "render": {"--size": ()},
    "bench table3": {"--closure": (), "--device": ()},
    "bench closures": {"--device": (), "--rods": (), "--names": ()},
    "bench newton": {"--edges": (), "--rod": ()},
    "bench bends": {"--rods": ()},
    "bench deploy": {"--rod": (), "--pattern": (), "--device": ()},
    "bench applications": {"--case": (), "--device": ()},
    "bench identify": {"--device": ()},
}  # fmt: skip


@pytest.mark.parametrize("name, command", list(commands()))
def test_foreign_files_are_refused_by_every_command(name, command, tmp_path, tried, foreign):
    files = foreign
    for option in command.params:
        if not isinstance(option.type, click.Path) or option.name in ("out", "usd"):
            continue
        for kind, path in files.items():
            if kind == "folder" and option.type.dir_okay and not option.type.file_okay:
                continue
            if kind == "missing" and name.startswith("bench") and option.nargs == -1:
                continue
            if isinstance(option, click.Option):
                words = call(name, command, tmp_path, {max(option.opts, key=len): path})
            else:
                words = call(name, command, tmp_path, {})
                none = str(tmp_path / "none")
                words = [path if word == none else word for word in words]
                if path not in words:
                    words.append(path)
            if option.type.dir_okay and not option.type.file_okay and kind == "folder":
                continue
            refused_by_command(words, tmp_path, f"{name} {option.name} {kind}", tried, "files")
