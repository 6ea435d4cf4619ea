"""What the campaign of hostile calls draws from (tests/adversary.py): valid calls and the files
that they read, numbers, words, surroundings and places that nobody means."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import socket
from pathlib import Path

import numpy as np
from hostile import arrays_of, save_arrays
from wrod.scenes import sawyer

import wrod
from wrod.bench.robot import PATTERNS
from wrod.commands import main

SCENES = Path(sawyer.__file__).parent
ROD = ["--rod", "green-vps"]
# A valid call of each command; words in braces are files of `material`, and {out} is written.
VALID = {
    "plan": ["line", *ROD, "--method", "intuitive", "--no-robot", "--no-expect",
             "--spacing", "0.02", "--out", "{out}"],
    "show": ["{points.csv}", *ROD, "--out", "{out}.png"],
    "deploy": ["line", *ROD, "--trajectory", "{plan.npz}", "--speed", "0.5", "--device", "cpu",
               "--out", "{out}"],
    "loop": ["--height", "0.04", "--radius", "0.0016", "--length", "0.8", "--out", "{out}.json"],
    "measure": ["--overhang", "0.07", "--fall", "0.03", "--radius", "0.0016", "--length", "0.8",
                "--out", "{out}.json"],
    "rods": [],
    "compile": ["--device", "cpu", "--jobs", "1"],
    "scan": ["{line.png}", "--scale", "0.0005", "--out", "{out}"],
    "markers": ["--out", "{out}"],
    "manifold": ["--length", "5", "--rays", "5", "--device", "cpu", "--out", "{out}"],
    "identify": ["{clamped.npz}", "--effect", "natural_curvature", "--out", "{out}"],
    "laid": ["{line.npz}", "--pattern", "line", "--trajectory", "{plan.npz}", *ROD, "--noise",
             "0.001", "--iterations", "1", "--out", "{out}.json"],
    "dataset": ["--size", "32", "--no-sensitivities", "--device", "cpu", "--out", "{out}"],
    "train": ["--dataset", "{dataset}", "--steps", "2", "--width", "8", "--batch", "8", "--test",
              "4", "--device", "cpu", "--out", "{out}"],
    "distil": ["--size", "16", "--steps", "2", "--out", "{out}"],
    "render": ["{stage.usda}", "--size", "32x32", "--out", "{out}"],
    "bench controller": ["--count", "4", "--device", "cpu"],
    "bench grasp": ["--count", "4", "--device", "cpu"],
    "bench manifold": ["--count", "2", "--lengths", "2", "--device", "cpu"],
    "bench perception": ["--images", "{images}", "--repeats", "1"],
    "bench plan": ["--patterns", "{patterns}", "--device", "cpu"],
    "bench robot": ["--method", "intuitive", "--patterns", "{seven}", "--rods", "rope", "--out",
                    "{out}"],
    "bench table4": ["--patterns", "{seven}", "--device", "cpu"],
    "bench table3": ["--trials", "1", "--rod", "green-vps", "--substrate", "steel", "--pattern",
                     "line", "--spacing", "0.05", "--step", "0.05", "--speed", "0.5", "--device",
                     "cpu", "--out", "{out}"],
    "bench optimised": ["--names", "line", "--device", "cpu"],
    "bench deploy": ["--pattern", "line", "--batch", "1", "--levels", "1", "--device", "cpu"],
    "bench rounds": ["--rods", "2", "--knots", "0", "--rounds", "2", "--device", "cpu"],
    "bench bends": ["--friction", "0.4", "--only", "reef knot", "--out", "{out}"],
    "bench newton": ["--many", "--edges", "4", "--worlds", "2", "--cables", "2"],
    "bench cosserat": ["--experiment", "cantilever", "--solver", "wrod", "--elements", "8"],
    "bench identify": ["--sets", "{sets}"],
    "bench cables": ["--data", "{cables}", "--folds", "2", "--out", "{out}"],
    "bench loop": ["--effect", "stiffness", "--pattern", "line", "--trials", "8",
                   "--controller", "numeric", "--out", "{out}"],
    "bench slippery": ["--names", "line", "--methods", "intuitive", "--frictions", "0.6",
                       "--trials", "1", "--out", "{out}"],
    "bench feedback": ["--names", "line", "--effects", "none", "--ways", "blind", "--out", "{out}"],
    "bench applications": ["--case", "trefoil", "--trials", "1", "--device", "cpu", "--out",
                           "{out}"],
    "bench photographs": ["--data", "{photographs}", "--quick",
                          "--out", "{out}"],
    "bench hands": ["--data", "{hands}", "--quick", "--out", "{out}"],
}  # fmt: skip
# Of those, what ends in a second or two.
QUICK = ("loop", "measure", "rods", "show", "markers")
NUMBERS = (
    "0", "-0", "-0.0", "1", "2", "1e-320", "5e-324", "2.2250738585072014e-308", "1.8e308", "1e308",
    "-1e308", "nan", "-nan", "NAN", "inf", "Infinity", "-Infinity", "0x1p4", "0x10", "0b1", "0o7",
    "1_0", "1__0", "_1", "1,5", "1.5.5", "1e5e5", "1e", "e5", ".", "+", "-", "1+1j", "1j", "１２",
    "٣", "Ⅷ", "²", "1\n", " 1", "1 ", "\t1", "1\0"[:1] + "\u200b", "3.0", "1e0", "1/2", "50%",
    "1m", "9007199254740993", "9223372036854775808", "18446744073709551616",
    "340282366920938463463",
    "-9223372036854775809", "9" * 5000, "0." + "0" * 5000 + "1", "1" + "0" * 4400, "True", "",
    "min", "max", "just below", "just above", "−1", "–1", "1\u202f000", "1 000", "5e−3", "1d-3",
    "1f", "1L", "0.1mm", "10cm", "1\u00a0", "٠.٥", "0,5", "1e+", "“1”", "1..2", "1;", "~1", "<1",
    "1±0.1", "\u200e1", "1\ufeff", "0x1.8p1", "1e0x", "pi", "2*3", "1e-400", "-1e-400",
)  # fmt: skip
WORDS = (
    "", " ", "\n", "\t\r\n", ".", "..", "-", "--", "---", "-h", "--help", "=", ",", ", ,", ";", "|",
    "*", "?", "[a-z]", "~", "~root", "$HOME", "`id`", "%n%s", "{0}", "{}", "{out}x", "\\", "\\0",
    "\x1b[31mred", "\x07", "\u202egnp", "e\u0301", "\ufeffx", "\U0001f40d", "\udcff", "null",
    "None", "nan", "NaN", "inf", "0", "-1", "1e999", "__class__", "__import__('os')", "a" * 100_000,
    "a," * 20_000, "1," * 20_000, "1x" * 20_000, "0x0", "-1x-1", "1e-320x1", "nanxnan", "infx1",
    "1x1x1", "1×1", "0,0", "nan,nan", "1e308,1e308", "0,0,0,0", "nan,0,0,0", "1e308,0,0,0",
    "1,1", "1:2", "true", "GREEN-VPS", "green-vps ", "green-vps\n", "green_vps", "sawyer ", "line.",
    "./line", "line/", "LINE", "auto", "AUTO", "cpu", "CPU", "cuda", "cuda:", "cuda:0", "cuda:-1",
    "cuda:999999999999999999999", "meta", "mps", "xla", "cpu:0", "cpu,cpu", "http://127.0.0.1:9/x",
    "file:///etc/passwd", "/etc/passwd", "con", "nul", "CON.json", ".json", "x.json", "x.urdf",
    "x.xacro", "x.npz", "x.svg", "x.dxf", "x.png", "x.step", ".npz", "🦄.npz",
    "“line”", "line\u00a0", "–rod", "//127.0.0.1/share/x.npz", "\\\\server\\x.npz", "C:\\x.npz",
    "s3://x/y.npz", "smb://x/y", "x.npz:stream", "x.csv.gz", "x.tar", "x.zip", "@x", "@{out}",
    "line,,sine", ",line", "line,", "line line", "line\nsine", "1,2,3,4,5,6,7", "1;2;3;4",
    "0.1,0.2,0.3,", "(0,0,0,0)", "[0.6,0,0,0]", "0.6 0 0 0", "0.6,0,0,0°", "64X48", "64x48x3",
    "64 x 48", "64*48", "cpu;cuda", "cuda:0,1", "0", "all", "ALL", "any", "default", "-0", "π",
)  # fmt: skip
# Environments and limits around a call.
AROUND = (
    {"HOME": None}, {"HOME": "/nonexistent"}, {"HOME": "/proc"}, {"HOME": ""}, {"PATH": ""},
    {"TMPDIR": "/nonexistent"}, {"TMPDIR": "/proc"}, {"TMPDIR": ""},
    {"CUDA_VISIBLE_DEVICES": "x"}, {"CUDA_VISIBLE_DEVICES": "99"}, {"CUDA_VISIBLE_DEVICES": "-1"},
    {"WARP_CACHE_PATH": "/proc/x"}, {"WARP_CACHE_PATH": "/dev/null"}, {"WARP_CACHE_PATH": ""},
    {"XDG_CACHE_HOME": "/proc/x", "HOME": "/proc"},
    {"MPLCONFIGDIR": "/proc/x"}, {"MPLBACKEND": "nothing"}, {"MPLBACKEND": "TkAgg"}, {"LANG": "C"},
    {"LC_ALL": "de_DE.UTF-8"}, {"LC_ALL": "tr_TR.UTF-8"}, {"LC_ALL": "C", "PYTHONUTF8": "0"},
    {"LC_ALL": "nothing"}, {"PYTHONIOENCODING": "ascii"}, {"PYTHONIOENCODING": "utf-16"},
    {"PYTHONIOENCODING": "latin-1:strict"}, {"PYTHONOPTIMIZE": "2"}, {"PYTHONHASHSEED": "7"},
    {"PYTHONWARNINGS": "error::UserWarning"}, {"PYTHONDONTWRITEBYTECODE": "1"},
    {"PYTHONUNBUFFERED": "1"}, {"PYTHONDEVMODE": "1"}, {"PYTHONINTMAXSTRDIGITS": "640"},
    {"COLUMNS": "0"}, {"COLUMNS": "-5"}, {"COLUMNS": "x"}, {"COLUMNS": "1"}, {"COLUMNS": "9" * 12},
    {"TERM": "dumb"}, {"TERM": None}, {"TERM": "x" * 5000}, {"NO_COLOR": "1"}, {"DISPLAY": ":99"},
    {"OMP_NUM_THREADS": "0"}, {"OMP_NUM_THREADS": "x"}, {"OMP_NUM_THREADS": "-1"},
    {"OMP_NUM_THREADS": "4,2"}, {"OPENBLAS_NUM_THREADS": "x"}, {"RANK": "x", "WORLD_SIZE": "2"},
    {"RANK": "5", "WORLD_SIZE": "2"}, {"RANK": "-1", "WORLD_SIZE": "2"}, {"WORLD_SIZE": "0"},
    {"RANK": "0", "WORLD_SIZE": "1000000000000"}, {"RANK": "1", "WORLD_SIZE": ""}, {"RANK": "0"},
    {"LOCAL_RANK": "x", "RANK": "0", "WORLD_SIZE": "1"}, {"RANK": "0", "WORLD_SIZE": "nan"},
    {"TZ": "nothing/at/all"}, {"TQDM_DISABLE": "1"}, {"TQDM_MININTERVAL": "x"},
    {"TQDM_NCOLS": "-1"}, {"TQDM_POSITION": "x"}, {"TQDM_ASCII": ""}, {"TQDM_UNIT_SCALE": "x"},
    {"NUMPY_MADVISE_HUGEPAGE": "x"}, {"NPY_DISABLE_CPU_FEATURES": "x"},
    {"NPY_PROMOTION_STATE": "x"}, {"NUMBA_NUM_THREADS": "x"}, {"TORCH_LOGS": "x"},
    {"PYTORCH_CUDA_ALLOC_CONF": "x"},
    {"WARP_CACHE_PATH": "a\nb"}, {"PYTHONSAFEPATH": "1", "PYTHONNOUSERSITE": "1"},
    {"HOME": None, "PATH": None, "LANG": None, "TMPDIR": None, "USER": None, "LOGNAME": None},
    {"WROD_TRACEBACK": ""}, {"PXR_PLUGINPATH_NAME": "/dev/zero"},
    {"HOME": "relative"}, {"HOME": "/tmp/\udcff"}, {"TMPDIR": "relative"}, {"TMPDIR": "\udcff"},
    {"TMPDIR": "/dev/null"}, {"PWD": "/nonexistent"}, {"X": "y" * 100_000}, {"X": "\udcff"},
    {"_WROD_COMPLETE": "bash_complete"}, {"_WROD_COMPLETE": "x"}, {"_WROD_COMPLETE": "zsh_source"},
    {"_PYTHON__M_WROD_COMPLETE": "bash_complete"}, {"_PYTHON__M_WROD_COMPLETE": "fish_complete"},
    {"_PYTHON__M_WROD_COMPLETE": "bash_complete", "COMP_WORDS": "wrod '", "COMP_CWORD": "x"},
    {"SOURCE_DATE_EPOCH": "x"}, {"SOURCE_DATE_EPOCH": "-1"}, {"SOURCE_DATE_EPOCH": "9" * 30},
    {"MPLBACKEND": "module://nothing"}, {"MPLCONFIGDIR": "/dev/null"},
    {"MATPLOTLIBRC": "/dev/zero"},
    {"MATPLOTLIBRC": "/nonexistent"}, {"XDG_CONFIG_HOME": "/dev/null"}, {"XDG_CACHE_HOME": "x"},
    {"LANG": "ja_JP.SJIS"}, {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    {"LC_NUMERIC": "de_DE.UTF-8"}, {"PYTHONUTF8": "1"}, {"PYTHONMALLOC": "debug"},
    {"PYTHONFAULTHANDLER": "1"}, {"PYTHONPATH": "/dev/null:/proc:/nonexistent:"},
    {"PYTHONNODEBUGRANGES": "1"}, {"PYTHONPYCACHEPREFIX": "/proc/x"}, {"PYTHONASYNCIODEBUG": "1"},
    {"LD_PRELOAD": "/nonexistent.so"}, {"LD_LIBRARY_PATH": "/dev/null:/proc"}, {"LD_BIND_NOW": "1"},
    {"FORCE_COLOR": "1"}, {"LINES": "1", "COLUMNS": "3"}, {"LINES": "x"}, {"PAGER": "/bin/false"},
    {"COLUMNS": "1e9"}, {"MKL_NUM_THREADS": "x"}, {"MALLOC_ARENA_MAX": "x"},
    {"CUDA_PATH": "/proc"},
    {"TORCHINDUCTOR_CACHE_DIR": "/proc"}, {"PXR_WORK_THREAD_LIMIT": "x"},
    {"TF_DEBUG": "*"}, {"TF_DEBUG": "SDF_LAYER", "TF_DEBUG_OUTPUT_FILE": "stdout"},
    {"SCIPY_ARRAY_API": "1"}, {"NETWORKX_AUTOMATIC_BACKENDS": "x"}, {"LD_DEBUG": "statistics"},
    {"EZDXF_CONFIG_FILE": "/dev/zero"}, {"ATEN_CPU_CAPABILITY": "default"}, {"PYTHONVERBOSE": "1"},
    {"PYTHONPROFILEIMPORTTIME": "1"}, {"PYTHONMALLOCSTATS": "1"}, {"MALLOC_PERTURB_": "165"},
    {"OPENCV_FOR_THREADS_NUM": "x"}, {"OPENCV_CPU_DISABLE": "x"}, {"OPENCV_DUMP_CONFIG": "1"},
    {"OPENCV_TRACE_DEPTH_OPENCV": "x"}, {"OPENCV_LOG_LEVEL": "VERBOSE"}, {"OPENCV_TRACE": "x"},
    {"OMP_DISPLAY_ENV": "VERBOSE"}, {"GLIBC_TUNABLES": "x=y"}, {"CUDA_LAUNCH_BLOCKING": "x"},
    {"WARP_ENABLE_MEMPOOLS_AT_INIT": "x"}, {"NEWTON_CACHE_PATH": "/proc"}, {"PYTHONCASEOK": "1"},
    {"ROS_PACKAGE_PATH": "/dev/zero:\udcff:/proc"}, {"AMENT_PREFIX_PATH": ":::"},
    {"TORCH_HOME": "x"},
    {"OPENCV_LOG_LEVEL": "x"}, {"QT_QPA_PLATFORM": "x"}, {"CUDA_CACHE_PATH": "/proc"},
    {"OPENCV_IO_MAX_IMAGE_PIXELS": "x"}, {"NUMEXPR_MAX_THREADS": "x"}, {"KMP_AFFINITY": "x"},
)  # fmt: skip
AROUND_STREAMS = (
    ">&-", "2>&-", ">&- 2>&-", "<&-", "<&- >&- 2>&-", "> /dev/full", "2> /dev/full", "| head -c 1",
    "| true", "< /dev/zero", "< /dev/full", "2>&1 | head -n 1", "> /dev/null", "<> /dev/null",
)  # fmt: skip
AROUND_LIMITS = (
    "ulimit -n 20", "ulimit -n 8", "ulimit -f 0", "ulimit -f 4", "ulimit -v 400000",
    "ulimit -v 1500000", "ulimit -s 256", "ulimit -u 1", "umask 777", "umask 000", "ulimit -c 0",
    "trap '' PIPE", "trap '' INT", "trap '' TERM HUP", "rmdir_cwd", "cd /proc", "cd /",
    "ulimit -t 3", "ulimit -d 100000", "ulimit -l 0", "ulimit -x 0", "ulimit -i 0",
    "umask 077", "cd /dev", "cd /proc/self/fd", "exec 3</dev/zero 4>/dev/null 5>&2", "ulimit -q 0",
    "ulimit -s unlimited", "exec 1000</dev/null", "set -f; cd /sys",
)  # fmt: skip


def material(folder: Path) -> dict[str, str]:
    """Valid files that the calls read, by name."""
    folder.mkdir(parents=True, exist_ok=True)
    made = {}

    def at(name: str) -> Path:
        made[name] = str(folder / name)
        return folder / name

    s = np.linspace(0.0, 0.3, 60)
    points = np.column_stack([s, 0.03 * np.sin(15 * s)])
    at("points.csv").write_text("x,y\n" + "\n".join(f"{x:.5f},{y:.5f}" for x, y in points))
    np.savez(at("line.npz"), points=np.column_stack([np.linspace(0, 0.5, 80), np.zeros(80)]))
    np.save(at("points.npy"), points)
    at("points.svg").write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="200mm" height="100mm" '
        'viewBox="0 0 200 100">'
        '<path fill="none" stroke="black" d="M 10 50 C 60 10 120 90 190 50"/></svg>'
    )
    path = wrod.plan(wrod.pattern("line"), wrod.rod("green-vps"), "intuitive", spacing=0.02)
    files = path.save(folder / "plan")
    made["plan.npz"] = str(next(file for file in map(Path, files) if file.suffix == ".npz"))
    made["trajectory.csv"] = str(next(file for file in map(Path, files) if file.suffix == ".csv"))
    made["rod.json"] = str(wrod.save_rod(wrod.rod("green-vps"), folder / "rod.json"))
    at("sheet")
    main(["markers", "--json", "--out", made["sheet"]], standalone_mode=False)
    shutil.copy(folder / "sheet" / "layout.json", at("layout.json"))
    at("camera.json").write_text(
        json.dumps({"camera_matrix": [[900, 0, 594], [0, 900, 420], [0, 0, 1]], "distortion": []})
    )
    at("obstacles.json").write_text('[{"kind": "sphere", "size": 0.05, "xyz": [0, 0, 2]}]')
    at("table.json").write_text('{"format": "wrod-table-1", "friction": 0.4, "log_error": 0.1}')
    shutil.copy(SCENES / "cable" / "U.json", at("fixtures.json"))
    shutil.copy(SCENES / "robots" / "sawyer.urdf", at("arm.urdf"))
    shutil.copy(SCENES / "controller" / "default.safetensors", at("controller.safetensors"))
    shutil.copy(SCENES / "controller" / "corrections.safetensors", at("corrections.safetensors"))
    shutil.copy(SCENES / "knots" / "trefoil.json", at("knot.json"))
    model = wrod.RodModel.of(wrod.rod("green-vps")).bent(0.5)
    tapered = wrod.Profile((1e-3, 8e-4), (0.0, model.length))
    model = dataclasses.replace(model, bending_stiffness=(tapered, tapered))
    made["model.json"] = str(wrod.save_rod(model, folder / "model.json"))
    s = np.linspace(0.0, 0.5, 80)
    laid = arrays_of("Deployment") | {
        "arc_length": s, "centerline": np.column_stack([s, 0 * s, 0 * s]), "diverged": False,
        "contact_force": np.zeros((80, 3)), "slip": 0 * s, "frames": np.zeros((2, 80, 3)),
        "hand": np.zeros((2, 4, 4)),
    }  # fmt: skip
    save_arrays(at("deployment.npz"), laid | {"released_centerline": laid["centerline"]})
    lines = [f"0\nVERTEX\n8\n0\n10\n{1e3 * x:.4f}\n20\n{1e3 * y:.4f}\n30\n0" for x, y in points]
    at("drawing.dxf").write_text(
        "0\nSECTION\n2\nHEADER\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n0\n"
        "POLYLINE\n8\n0\n66\n1\n70\n0\n" + "\n".join(lines)
        + "\n0\nSEQEND\n0\nENDSEC\n0\nEOF\n"
    )  # fmt: skip
    from wrod.identification.template import write_template

    for kind in ("clamped", "motion"):
        write_template(kind, at(f"{kind}.npz"))
    at("stage.usda").write_text(
        '#usda 1.0\n(\n upAxis = "Z"\n metersPerUnit = 1\n)\ndef Xform "World"\n{\n'
        ' def Sphere "s"\n {\n  double radius = 0.1\n }\n def Camera "perspective"\n {\n }\n}\n'
    )
    from PIL import Image, ImageDraw

    picture = Image.new("RGB", (200, 150), "white")
    ImageDraw.Draw(picture).line([(30, 70), (170, 75)], fill="black", width=5)
    picture.save(at("line.png"))
    with Image.open(folder / "sheet" / "markers.png") as sheet:
        marked = sheet.convert("RGB").resize((1188, 840))
    ImageDraw.Draw(marked).line([(300, 400), (600, 500), (900, 420)], "black", 12, joint="curve")
    marked.save(at("marked.png"))
    for name, file in {"patterns": "points.csv", "sets": "clamped.npz"}.items():
        at(name).mkdir(exist_ok=True)
        shutil.copy(made[file], folder / name / file)
    _data(at)
    at("seven").mkdir(exist_ok=True)
    for name in PATTERNS:
        curve = wrod.pattern(name)
        points = curve.sample(np.linspace(0.0, curve.length, 200))[0]
        np.savetxt(folder / "seven" / f"{name.replace('-', '')}.txt", points)
    at("dataset")
    main(
        ["dataset", "--size", "128", "--device", "cpu", "--json", "--out", made["dataset"]],
        standalone_mode=False,
    )
    return made


def _data(at) -> None:
    """Folders of data of the benchmarks, each with the least that they take."""
    pictures, cables, photographs = at("images"), at("cables"), at("photographs")
    swing = at("hands") / "swing"
    for folder in (pictures / "set" / "gt", cables, photographs, swing):
        folder.mkdir(parents=True, exist_ok=True)
    from PIL import Image

    with Image.open(at("line.png")) as picture:
        picture.convert("L").point(lambda grey: 0 if grey > 128 else 1).save(
            pictures / "set" / "gt" / "line.png"
        )
    with np.load(at("motion.npz")) as content:
        moved = {name: content[name] for name in content.files}
    moved["positions"] = np.concatenate([moved["positions"]] * 3)
    moved["file_ids"] = np.array([str(k) for k in range(len(moved["positions"]))])
    save_arrays(cables / "motion.npz", moved)
    curve = np.column_stack([np.linspace(0, 0.3, 40), np.zeros(40)])
    save_arrays(
        photographs / "rope-line-int.npz",
        {"centerline_filled": curve, "hidden": np.zeros(40), "sigma": np.full(40, 5e-4),
         "pattern": curve, "size_factor": 1.0, "px_from_pattern": np.eye(2, 3), "pixels": curve},
    )  # fmt: skip
    shutil.copy(at("line.png"), photographs / "rope-line-int.png")
    for load in ("unweighted", "weighted"):
        for kind, arrays in (("static", "HeldCable"), ("swing", "HeldSwing")):
            save_arrays(swing / f"black-short-{load}-{kind}.npz", arrays_of(arrays))


def odd_places(folder: Path, suffix: str = "") -> dict[str, str]:
    """Paths that are no plain file, or no folder, or nobody's to write, by kind; all are made
    anew."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    file, full = folder / f"file{suffix}", folder / f"full{suffix}"
    file.write_bytes(b"before")
    full.mkdir(exist_ok=True)
    (full / "mine.txt").write_text("mine")
    made = {
        "empty": "", "here": ".", "above": "..", "root": "/", "dash": "-", "tilde": "~",
        "null": "/dev/null", "full_disk": "/dev/full", "zero": "/dev/zero", "tty": "/dev/tty",
        "stdin": "/dev/stdin", "stdout": "/dev/stdout", "proc": f"/proc/x{suffix}",
        "self": "/proc/self/mem", "sys": f"/sys/x{suffix}", "file": str(file),
        "folder": str(full), "below_file": f"{file}/x{suffix}", "slash": f"{file}/",
        "below_missing": f"{folder}/a/b/c/x{suffix}", "dots": f"{folder}/a/../dots{suffix}",
        "dots_missing": f"{folder}/missing/../../dots{suffix}", "double": f"{folder}//x{suffix}",
        "newline": f"{folder}/a\nb{suffix}", "bytes": f"{folder}/\udcff\udcfe{suffix}",
        "long": f"{folder}/{'n' * 251}{suffix}", "too_long": f"{folder}/{'n' * 300}{suffix}",
        "very_long": f"{folder}/{'d/' * 2500}x{suffix}", "spaces": f"{folder}/  {suffix}",
        "hidden": f"{folder}/.{suffix or 'x'}", "colon": f"{folder}/a:b*?{suffix}",
        "unicode": f"{folder}/e\u0301\u202e\U0001f40d{suffix}", "minus": f"{folder}/-rf{suffix}",
        "percent": f"{folder}/%d%s{{}}{suffix}", "escape": f"{folder}/\x1b[2J{suffix}",
        "relative": f"../x{suffix}", "other_suffix": f"{folder}/x.exe", "no_suffix": f"{folder}/x",
        "upper": f"{folder}/X{suffix.upper()}", "braces": f"{folder}/$HOME`id`{suffix}",
    }  # fmt: skip
    for kind, goal in {
        "loop": folder / f"loop{suffix}", "dangling": folder / "nowhere" / "x", "to_file": file,
        "to_folder": full, "to_null": "/dev/null", "to_zero": "/dev/zero", "to_root": "/",
    }.items():  # fmt: skip
        link = folder / f"{kind}{suffix}"
        link.symlink_to(goal)
        made[kind] = str(link)
    made["pipe"], made["socket"] = f"{folder}/pipe{suffix}", f"{folder}/socket{suffix}"
    os.mkfifo(made["pipe"])
    here = os.getcwd()
    os.chdir(folder)  # the name of a socket is short
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(f"socket{suffix}")
    os.chdir(here)
    return made
