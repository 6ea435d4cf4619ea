"""Hostile input over every loader and every option of every command.

A loader takes what it is given or refuses it in a `WrodError` of one sentence; a command refuses
with exit code 2 before it works, and leaves nothing behind. What is broken is drawn by hypothesis
(tests/drawn.py), or stands in tables of which all is tried. WROD_FUZZ=50 tries fifty times as much
as the tests do (`make fuzz`).
"""

import json
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
    broken_rows,
    broken_xml,
    foreign_files,
    save_arrays,
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

SECONDS, BYTES = 10, 2 * 2**30
SCENES = Path(sawyer.__file__).parent


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
    from drawn import broken, encoded, try_all

    load, valid = JSON_FILES[kind]
    path = tmp_path / "file.json"
    if kind == "knot":
        for entry in valid["rods"]:
            entry["pattern"] = str(SCENES / "knots" / Path(entry["pattern"]).name)
    path.write_text(json.dumps(valid))
    assert not taken_or_refused(load, path, f"a valid {kind}")

    def attempt(drawn):
        what, content = drawn
        path.write_bytes(content)
        note(tried, kind, taken_or_refused(load, path, f"{kind}: {what}"))

    try_all(encoded(broken(broken_json, valid)), 60, attempt)


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
    from drawn import broken, try_all

    load, make = ARRAY_FILES[kind]
    valid, path = make(tmp_path), tmp_path / "rope-line-int.npz"
    save_arrays(path, valid)
    assert not taken_or_refused(load, path, f"a valid {kind}")

    def attempt(drawn):
        what, arrays = drawn
        save_arrays(path, arrays)
        note(tried, kind, taken_or_refused(load, path, f"{kind}: {what}"))
        taken_or_refused(is_motion, path, f"{kind}: {what}")

    try_all(broken(broken_arrays, valid), 60, attempt)


def test_urdf_files(tmp_path, tried):
    from drawn import broken, try_all

    valid, path = sawyer.PATH.read_text(), tmp_path / "arm.urdf"
    path.write_text(valid)
    assert not taken_or_refused(read_urdf, path, "the Sawyer")

    def load(file):
        urdf = read_urdf(file)
        urdf.shapes("visual")
        urdf.shapes("collision")

    def attempt(drawn):
        what, text = drawn
        path.write_text(text, encoding="utf-8", errors="replace")
        note(tried, "urdf", taken_or_refused(load, path, f"URDF: {what}"))

    try_all(broken(broken_xml, valid), 60, attempt)


def test_point_files(tmp_path, tried):
    from drawn import broken, encoded, try_all

    rows = [f"{x:.6f} {0.05 * np.sin(9 * x):.6f}" for x in np.linspace(0.0, 0.4, 40)]
    path = tmp_path / "points.txt"

    def attempt(drawn):
        what, content = drawn
        path.write_bytes(content)
        note(tried, "points", taken_or_refused(wrod.Pattern.load, path, f"points: {what}"))

    try_all(encoded(broken(broken_rows, rows)), 60, attempt)


def contents(folder) -> dict:
    """A loader and the bytes of a valid file for it, by the file's name."""
    from PIL import Image, ImageDraw

    from wrod.deployment.table import TableFriction
    from wrod.robot.mesh import read_mesh
    from wrod.robot.obstacles import Obstacles

    picture = Image.new("RGB", (60, 40), "white")
    ImageDraw.Draw(picture).line([(9, 20), (50, 25)], fill="black", width=3)
    for suffix in (".png", ".jpg", ".bmp", ".tif"):
        picture.save(folder / f"line{suffix}")
    found = {f"line{suffix}": read_image for suffix in (".png", ".jpg", ".bmp", ".tif")}
    texts = {
        "drawing.svg": (
            wrod.Pattern.load,
            '<svg xmlns="http://www.w3.org/2000/svg" width="200mm" height="100mm" viewBox="0 0 200 '
            '100"><path fill="none" stroke="black" d="M 10 50 C 60 10 120 90 190 50"/></svg>',
        ),
        "drawing.dxf": (
            wrod.Pattern.load,
            "0\nSECTION\n2\nENTITIES\n0\nLINE\n10\n0\n20\n0\n11\n300\n21\n0\n0\nENDSEC\n0\nEOF\n",
        ),
        "mesh.obj": (read_mesh, "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"),
        "mesh.stl": (
            read_mesh,
            "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
            "endloop\nendfacet\nendsolid a\n",
        ),
        "obstacles.json": (Obstacles.load, '[{"kind": "sphere", "size": 0.05, "xyz": [0, 0, 2]}]'),
        "table.json": (
            TableFriction.load,
            '{"format": "wrod-table-1", "friction": 0.4, "log_error": 0.1}',
        ),
        "arm.urdf": (read_urdf, sawyer.PATH.read_text()),
    }
    for name, (load, text) in texts.items():
        (folder / name).write_text(text)
        found[name] = load
    for name, (load, valid) in JSON_FILES.items():
        (folder / f"{name}.json").write_text(json.dumps(valid))
        found[f"{name}.json"] = load
    for name, (load, make) in ARRAY_FILES.items():
        save_arrays(folder / f"{name}.npz", make(folder))
        found[f"{name}.npz"] = load
    (folder / "controller.safetensors").write_bytes(
        (SCENES / "controller" / "default.safetensors").read_bytes()
    )
    found["controller.safetensors"] = wrod.Controller.load
    return {name: (load, (folder / name).read_bytes()) for name, load in found.items()}


def test_bytes_of_every_file(tmp_path, tried):
    from drawn import edited, st, try_all

    for extra in ("PIL", "ezdxf", "svgelements", "trimesh", "cv2"):
        pytest.importorskip(extra)
    whole = contents(tmp_path)
    broken = tmp_path / "broken"
    broken.mkdir()

    def attempt(drawn):
        name, content = drawn
        (broken / name).write_bytes(content)
        note(tried, "bytes", taken_or_refused(whole[name][0], broken / name, name))

    names = st.sampled_from(sorted(whole))
    try_all(
        names.flatmap(lambda name: st.tuples(st.just(name), edited(whole[name][1]))), 300, attempt
    )


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


def test_drawn_numbers_out_of_bounds_are_refused(tmp_path, tried):
    from drawn import numbers, st, try_all

    options = [
        (name, command, option)
        for name, command in commands()
        for option in command.params
        if isinstance(option, click.Option) and numeric(option)
    ]

    def attempt(drawn):
        number, value = drawn
        name, command, option = options[number]
        try:
            one = (int if isinstance(option.type, click.IntRange) else float)(value)
            if option.type.min <= one <= option.type.max:
                return
        except (ValueError, OverflowError):
            pass
        flag = max(option.opts, key=len)
        words = call(name, command, tmp_path, {flag: value})
        refused_by_command(words, tmp_path, f"{name} {flag} {value!r}", tried, "drawn numbers")

    try_all(st.tuples(st.integers(0, len(options) - 1), numbers()), 200, attempt)


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
