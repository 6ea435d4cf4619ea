"""How commands end: in one sentence, with the right code, and alone on their output."""

import errno
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner
from forked import call, full_disk

from wrod import side_by_side
from wrod.commands import LazyGroup, main
from wrod.commands.running import (
    FAULT,
    INTERRUPTED,
    REFUSED,
    holding_output,
    interruptible,
    sentence,
)
from wrod.errors import DataError, RodError
from wrod.files import write_atomically
from wrod.files.ledger import Ledger
from wrod.files.writing import begin, locked
from wrod.machine import usable_cores


def ends(error, *words, write=None):
    """Output and exit code of a command that ends with an error, after it wrote a file."""

    @click.command()
    @click.option("--out", type=click.Path(path_type=Path))
    def command(out):
        if write is not None:
            write_atomically(write, lambda file: file.write("whole"))
        raise error

    group = LazyGroup("wrod", package="wrod.commands", names=("x",))
    group.loaded["x"] = holding_output(command)
    result = CliRunner().invoke(group, ["x", *words])
    return result.output.strip(), result.exit_code


@pytest.mark.parametrize(
    ("error", "says", "code"),
    [
        (RodError("no rod given"), "wrod: no rod given", REFUSED),
        (KeyboardInterrupt(), "wrod: interrupted", INTERRUPTED),
        (MemoryError(), "out of memory", REFUSED),
        (RuntimeError("Failed to allocate 99 bytes on device 'cpu'"), "out of memory", REFUSED),
        (OSError(errno.ENOSPC, "No space left on device", "a.npz"), "a.npz: .*make room", REFUSED),
        (OSError(errno.EMFILE, "Too many open files", "a.py"), "ulimit -n", REFUSED),
        (FileNotFoundError(errno.ENOENT, "No such file", "out/a"), "out/a: .*again", REFUSED),
        (ModuleNotFoundError("no", name="pxr"), r"pip install 'wrod\[scene\]'", REFUSED),
        (ModuleNotFoundError("no", name="torch.nn"), r"pip install 'wrod\[train\]'", REFUSED),
        (KeyboardInterrupt(signal.SIGTERM), "wrod: terminated", 143),
        (KeyboardInterrupt(signal.SIGHUP), "wrod: its terminal was closed", 129),
        (ImportError("a.so: failed to map segment"), "too little memory", REFUSED),
        (ImportError("libGL.so.1: no such file"), "a package cannot be loaded", REFUSED),
        (ModuleNotFoundError("no", name="scipy"), "install it", REFUSED),
        (ImportError("cannot import name", name="wrod.rods"), "a fault of wrod's own", FAULT),
        (UnicodeDecodeError("utf-8", b"a", 0, 1, "x"), "not UTF-8", REFUSED),
        (UserWarning("odd"), "odd .*PYTHONWARNINGS", REFUSED),
        (np.linalg.LinAlgError("Singular matrix"), r"apart .*\(Singular matrix\)", REFUSED),
        (ZeroDivisionError("x"), "a fault of wrod's own", FAULT),
    ],
)
def test_every_end_is_one_sentence(error, says, code, tmp_path):
    import re

    said, found = ends(error, "--out", str(tmp_path / "out"))
    assert found == code and re.search(says, said) and len(said.splitlines()) == 1


@pytest.mark.parametrize(
    "name",
    [
        "TQDM_MININTERVAL",
        "NUMPY_MADVISE_HUGEPAGE",
        "OPENCV_IO_MAX_IMAGE_PIXELS",
        "OPENCV_TRACE",
        "SOURCE_DATE_EPOCH",
    ],
)
def test_variables_that_a_library_cannot_read_are_named(name, tmp_path):
    words = ["scan", "none.png", "--scale", "0.001"]
    call = [sys.executable, "-m", "wrod", *words, "--out", str(tmp_path / "out")]
    run = subprocess.run(call, env=os.environ | {name: "x"}, capture_output=True, text=True)
    assert run.returncode == REFUSED and f"{name}='x'" in run.stderr and len(run.stderr) < 300


def test_pictures_are_the_same_whatever_a_user_set_for_his_own(tmp_path):
    (tmp_path / "tex").write_text("text.usetex: True\nfigure.dpi: 20\nsavefig.bbox: tight\n")
    made = [tmp_path / "his.png", tmp_path / "ours.png"]
    his, ours = (["show", "line", "--out", str(path)] for path in made)
    around = os.environ | {"MATPLOTLIBRC": str(tmp_path / "tex")}
    subprocess.run([sys.executable, "-m", "wrod", *his], env=around, check=True)
    assert call(ours, tmp_path).code == 0
    assert made[0].read_bytes() == made[1].read_bytes()


@pytest.mark.parametrize(
    "names", [{}, {"COMP_WORDS": "wrod"}, {"COMP_WORDS": "wrod", "COMP_CWORD": "x"}]
)
def test_completions_that_no_shell_asks_for_are_refused(names, monkeypatch):
    for name, value in {"_WROD_COMPLETE": "bash_complete", **names}.items():
        monkeypatch.setenv(name, value)
    result = CliRunner().invoke(main, ["rods"], prog_name="wrod")
    assert result.exit_code == REFUSED and "WROD_COMPLETE" in result.stderr


@pytest.mark.parametrize("words", ["-x", "rods --none", "bench --none", "bench none", "none"])
def test_wrong_calls_are_one_sentence(words):
    result = CliRunner().invoke(main, words.split(), prog_name="wrod")
    assert result.exit_code == REFUSED and result.stderr.count("\n") == 1, result.stderr
    assert result.stderr.startswith("wrod: No such ") and "--help)" in result.stderr


@pytest.mark.parametrize("words", [[], ["bench"]])
def test_a_call_without_words_says_how_to_call(words):
    result = CliRunner().invoke(main, words, prog_name="wrod")
    assert result.exit_code == REFUSED and result.output.startswith("Usage: wrod")


def test_help_waits_for_no_library_of_the_work():
    code = (
        "import sys\nfrom wrod.commands import main\nmain(['--help'], standalone_mode=False)\n"
        "print([m for m in ('numpy', 'scipy', 'matplotlib', 'warp', 'torch')"
        " if m in sys.modules])"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "bench" in said.stdout and said.stdout.endswith("[]\n"), said.stdout + said.stderr


def test_what_is_complete_is_said(tmp_path):
    said, code = ends(RodError("bad robot"), write=tmp_path / "plan.npz")
    assert code == REFUSED and f"(complete: {tmp_path / 'plan.npz'}" in said


def test_nothing_is_left_where_nothing_was_finished(tmp_path):
    out = tmp_path / "above" / "out"

    @click.command()
    @click.option("--out", type=click.Path(path_type=Path))
    def command(out):
        (out / "part").mkdir()
        raise RodError("no")

    with pytest.raises(RodError):
        holding_output(command).callback(out=out)
    assert not out.parent.exists()


def test_a_second_process_is_told_so(tmp_path):
    code = (
        "import sys; from wrod.files.writing import locked\n"
        "with locked(sys.argv[1]): print('held', flush=True); sys.stdin.read()"
    )
    call = [sys.executable, "-c", code, str(tmp_path / "out")]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(call, text=True, **pipes) as first:
        assert first.stdout.readline() == "held\n"
        says = rf"another wrod process \({first.pid}\)"
        with pytest.raises(DataError, match=says), locked(tmp_path / "x" / ".." / "out"):
            pass
        with locked(tmp_path / "other"), locked(tmp_path / "out", "1"):
            pass
        first.send_signal(signal.SIGKILL)
        first.wait()
    with locked(tmp_path / "out"):
        pass  # the lock ended with its process


def test_a_process_with_other_temporary_files_is_told_so(tmp_path, monkeypatch):
    """A container, or another user."""
    out, other = tmp_path / "out", tmp_path / "other"
    out.mkdir()
    other.mkdir()
    with locked(out):
        monkeypatch.setattr(tempfile, "tempdir", str(other))
        with pytest.raises(DataError, match="another wrod process"), locked(out):
            pass
    with locked(out, "0"), locked(out, "1"), pytest.raises(DataError, match="another"), locked(out):
        pass
    with locked(out):
        pass


@pytest.mark.parametrize("trials", [0, 1])
def test_only_what_is_kept_goes_on(trials, tmp_path):
    begin()
    ledger = Ledger(tmp_path / "trials.jsonl", {}, ("trial",))
    if trials:
        ledger.add([{"trial": 1}])
    said, _ = sentence(KeyboardInterrupt())
    begin()
    assert ("goes on" in said, "begins anew" in said) == (trials == 1, trials == 0)


def hear_interruptions():
    """What runs in the background of a shell inherits that SIGINT is ignored, and keeps to it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.slow
def test_an_interrupted_command_says_so(tmp_path):
    words = "dataset --size 100000 --no-sensitivities --device cpu --out"
    call = [sys.executable, "-m", "wrod", *words.split(), str(tmp_path / "out")]
    with subprocess.Popen(
        call, stderr=subprocess.PIPE, text=True, preexec_fn=hear_interruptions
    ) as run:
        deadline = time.monotonic() + 120
        while not (tmp_path / "out" / "manifest.json").exists():
            assert time.monotonic() < deadline and run.poll() is None
            time.sleep(0.1)
        run.send_signal(signal.SIGINT)
        try:
            _, said = run.communicate(timeout=120)
        finally:
            run.kill()  # or the test would wait for one that hangs
    assert run.returncode == INTERRUPTED and "Traceback" not in said
    assert "wrod: interrupted" in said and (tmp_path / "out" / "manifest.json").exists()


# An interruption that strikes where Python lets none be mended: a thread's future stays locked.
_STRUCK_IN_A_LOCK = """
import os, signal, sys, threading, time
enter, struck = threading.Condition.__enter__, []
def locked(self):
    enter(self)
    mine = threading.get_ident() == threading.main_thread().ident
    if mine and not struck and sys._getframe(1).f_code.co_name == "result":
        struck.append(os.kill(os.getpid(), signal.SIGINT))
        time.sleep(0)
threading.Condition.__enter__ = locked
import wrod.grasps.optimal
wrod.grasps.optimal.worker_threads = lambda asked: 2
from wrod.__main__ import main
main()
"""


def test_a_thread_that_never_ends_does_not_hold_an_interrupted_command(tmp_path):
    words = "dataset --size 64 --no-sensitivities --device cpu --out"
    run = subprocess.run(
        [sys.executable, "-c", _STRUCK_IN_A_LOCK, *words.split(), str(tmp_path / "out")],
        capture_output=True, text=True, timeout=60, preexec_fn=hear_interruptions,
    )  # fmt: skip
    assert run.returncode == INTERRUPTED and "wrod: interrupted" in run.stderr


def test_an_output_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("x")
    for out in ("/proc/none/out", tmp_path / "file" / "out", tmp_path / ("n" * 300)):
        words = ["dataset", "--size", "10", "--device", "cpu", "--out", str(out)]
        result = CliRunner().invoke(main, words)
        assert result.exit_code == REFUSED and "Traceback" not in result.output, result.output


def test_a_full_disk_is_said_and_leaves_no_half_file(tmp_path):
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def write(file):
        file.write("half")
        raise full

    with pytest.raises(OSError, match="No space"):
        write_atomically(tmp_path / "a.txt", write)
    assert list(tmp_path.iterdir()) == []


# ---- a disk that is full, a folder that goes ---------------------------------------------------

WORDS = "dataset --size 300 --shard-size 100 --no-sensitivities --device cpu"


def test_a_disk_that_fills_up_loses_nothing(tmp_path):
    words = [*WORDS.split(), "--out", str(tmp_path / "out")]
    # The manifest has less, a shard of 100 grasps has more.
    with full_disk(4096):
        result = CliRunner().invoke(main, words)
    assert result.exit_code == REFUSED and result.stderr.count("\n") == 1, result.output
    assert "make room or choose another, then run the same command again" in result.stderr
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["manifest.json"]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0 and "300 solved now" in result.output


def test_a_folder_that_vanishes_is_said(tmp_path):
    import shutil

    from wrod.training.dataset import generate

    out = tmp_path / "out"

    def vanish(count, total):
        shutil.rmtree(out)

    with pytest.raises(DataError, match="was removed while grasps were written"):
        generate(out, 300, shard_size=100, sensitivities=False, device="cpu", progress=vanish)
    assert not list(tmp_path.rglob("*.safetensors"))


def test_a_ledger_that_vanishes_is_written_anew(tmp_path):
    from wrod.files.ledger import Ledger

    path = tmp_path / "out" / "trials.jsonl"
    ledger = Ledger(path, {"step": 1}, ("trial",))
    ledger.add([{"trial": 1}])
    path.unlink()
    ledger.add([{"trial": 2}])
    assert not Ledger(path, {"step": 1}, ("trial",)).lacking([(1,), (2,)])


@pytest.mark.parametrize("kind", ["loop", "dangling", "pipe", "below_a_file"])
def test_an_output_that_cannot_be_made_is_refused_before_the_work(kind, tmp_path):
    out = tmp_path / "out"
    if kind == "pipe":
        os.mkfifo(out)
    elif kind == "below_a_file":
        out.write_text("x")
        out = out / "inside"
    else:
        out.symlink_to(out if kind == "loop" else tmp_path / "nowhere")
    began = []
    command = click.Command(
        "x",
        params=[click.Option(["--out"], type=click.Path(file_okay=False, path_type=Path))],
        callback=lambda out: began.append(out),
    )
    with pytest.raises(DataError, match="is no folder"):
        holding_output(command).callback(out=out)
    assert not began


def test_a_name_in_no_encoding_is_locked(tmp_path):
    with locked(tmp_path / os.fsdecode(b"o\xff")):
        pass


def test_an_interruption_in_a_finaliser_is_not_told(capfd):
    class Loud:
        def __del__(self):
            raise KeyboardInterrupt

    with interruptible():
        Loud()
    assert "Traceback" not in capfd.readouterr().err


def test_what_is_no_file_is_not_replaced(tmp_path):
    """A pipe, device or folder stays what it is, and a link stays a link."""
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "kept.json").write_text("old")
    (tmp_path / "link.json").symlink_to("kept.json")
    (tmp_path / "to_pipe.json").symlink_to("pipe")
    words = ["loop", "--height", "0.04", "--radius", "0.0016", "--length", "0.8", "--out"]
    for place in ("folder", "pipe", "to_pipe.json", ""):
        path = str(tmp_path / place) if place else ""
        result = CliRunner().invoke(main, [*words, path])
        assert result.exit_code == 2 and result.stderr.count("\n") == 1, result.output
    assert (tmp_path / "pipe").is_fifo() and (tmp_path / "folder").is_dir()
    assert CliRunner().invoke(main, [*words, str(tmp_path / "link.json")]).exit_code == 0
    assert (tmp_path / "link.json").is_symlink()
    assert "wrod-rod-1" in (tmp_path / "kept.json").read_text()
    with pytest.raises(DataError, match="is a device, pipe or socket"):
        write_atomically("/dev/full", lambda file: file.write("x"))


def test_streams_that_are_closed_take_nothing_away(tmp_path):
    """Without stdout and stderr a command works, and no file gets what libraries print."""
    out = tmp_path / "rod.json"
    words = f"-m wrod loop --height 0.04 --radius 0.0016 --length 0.8 --out {out}"
    for closed in (">&-", "2>&-", "<&- >&- 2>&-"):
        code = subprocess.run(f"{sys.executable} {words} {closed}", shell=True).returncode
        assert code == 0 and "wrod-rod-1" in out.read_text()
        out.unlink()
    script = "import os, sys; from wrod.commands.surroundings import open_streams; open_streams(); "
    script += "sys.stderr.write('x'); sys.exit(os.open('/dev/null', os.O_RDONLY) < 3)"
    call = f'{sys.executable} -c "{script}" <&- >&- 2>&-'
    assert subprocess.run(call, shell=True).returncode == 0


def test_rods_are_longer_than_what_is_measured_of_them():
    for words in (
        "loop --height 0.04 --radius 0.0016 --length 0.07",
        "measure --overhang 0.9 --fall 0.1 --radius 0.0016 --length 0.8",
    ):
        result = CliRunner().invoke(main, words.split())
        assert result.exit_code == 2 and "length 0." in result.stderr


def test_a_forked_process_compiles_with_threads_of_its_own():
    """Its parent's threads are not in it: it would wait for them for ever."""
    code = """
import os, signal
from wrod.kernels.compiling import compile_ahead, compile_together
from wrod.kernels.grasping import mesh, reading
for begun in compile_ahead("cpu", [(mesh.refine, 1)]):
    begun.result()
if os.fork() == 0:
    signal.setitimer(signal.ITIMER_REAL, 300.0)
    compile_together("cpu", [(mesh.refine, 1), (reading.judge, 1)])
    os._exit(0)
os._exit(os.waitstatus_to_exitcode(os.wait()[1]))
"""
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


LAID = "laid laid.npz --pattern line --trajectory plan.npz --rod rope --fit-friction"
LONG = "n" * 300


@pytest.mark.parametrize(
    "words, says",
    [
        (f"bench applications --trials 1 --case trefoil --out out --usd {LONG}", "too long"),
        (f"bench slippery --out out/{LONG}", "too long"),
        (f"bench bends --out out/{LONG}.png", "too long"),
        ("bench bends --out /proc/none/x.png", "/proc"),
        (f"{LAID} --out a/rod.json --table a/rod.json", "path of its own"),
        (f"{LAID} --out a/rod.json --table b/{LONG}", "too long"),
        ("bench grasp --counts many", "--against"),
        ("bench identify --sets . --only nothing", "--hidden"),
        ("bench loop --effect stiffness --candidate x --out out", "unknown effect"),
        ("bench robot --method guess --out out", "unknown method"),
        ("bench robot --patterns . --out out", "no such file"),
    ],
)
def test_what_cannot_be_done_or_written_is_refused_before_the_work(
    words, says, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for module, work in (
        ("wrod.bench.applications", "_run"), ("wrod.bench.loop_run", "_hidden"),
        ("wrod.bench.robot", "run_case"), ("wrod.bench.identify", "_measured"),
    ):  # fmt: skip
        monkeypatch.setattr(f"{module}.{work}", lambda *args: pytest.fail("worked first"))
    result = CliRunner().invoke(main, words.split())
    assert result.exit_code == REFUSED and says in result.output.lower(), result.output
    assert list(tmp_path.iterdir()) == []


def test_what_fails_before_it_is_written_leaves_nothing(tmp_path, monkeypatch):
    import fcntl

    for place, name, error in (
        (fcntl, "flock", KeyboardInterrupt()), (os, "dup", OSError(errno.EMFILE, "Too many files")),
    ):  # fmt: skip
        with monkeypatch.context() as patch, pytest.raises(type(error)):
            patch.setattr(place, name, lambda *_, error=error: (_ for _ in ()).throw(error))
            write_atomically(tmp_path / "a", lambda file: file.write("whole"))
        assert list(tmp_path.iterdir()) == []


def test_a_file_system_without_locks_takes_outputs(tmp_path, monkeypatch):
    import fcntl

    from wrod.files.writing import locked

    def none(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", none)
    with locked(tmp_path):
        write_atomically(tmp_path / "a", lambda file: file.write("whole"))


@pytest.mark.parametrize("how", [["-c", "import wrod_start; wrod_start.main()"], ["-m", "wrod"]])
@pytest.mark.parametrize("package", ["lazy_loader", "click"])
def test_a_package_that_cannot_be_loaded_is_said(package, how, tmp_path):
    (tmp_path / f"{package}.py").write_text("raise ImportError('libx.so: no such file')")
    call = [sys.executable, *how, "show", "letter-A", "--out", str(tmp_path / "a.png")]
    around = os.environ | {
        "PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    }
    run = subprocess.run(call, env=around, capture_output=True, text=True)
    assert run.returncode == REFUSED and "libx.so" in run.stderr
    assert len(run.stderr.splitlines()) == 1


def test_what_a_killed_process_left_half_written_goes(tmp_path):
    code = (
        "import sys, time; from wrod.files import write_atomically\n"
        "def write(file):\n"
        "    print('writing', flush=True); time.sleep(60)\n"
        "write_atomically(sys.argv[1], write)"
    )
    killed, alive = (
        subprocess.Popen(
            [sys.executable, "-c", code, str(tmp_path / name)], stdout=subprocess.PIPE, text=True
        )
        for name in ("killed.txt", "alive.txt")
    )
    try:
        assert [p.stdout.readline() for p in (killed, alive)] == ["writing\n"] * 2
        killed.kill()
        killed.wait()
        assert len(list(tmp_path.iterdir())) == 2
        write_atomically(tmp_path / "killed.txt", lambda file: file.write("whole"))
        left = sorted(p.name for p in tmp_path.iterdir())
        assert left[0].startswith(".alive.txt.") and left[1:] == ["killed.txt"]
    finally:
        for process in (killed, alive):
            process.kill()
            process.stdout.close()
            process.wait()


@pytest.mark.parametrize("place", [{"WARP_CACHE_PATH": ""}, {"XDG_CACHE_HOME": "x"}], ids=str)
def test_an_empty_or_relative_place_of_kernels_is_none(tmp_path, place):
    """Warp would take it for the working folder, or one in it."""
    code = "import wrod.kernels, warp; print(warp.config.kernel_cache_dir)"
    around = os.environ | place
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=around, check=True)
    assert list(tmp_path.iterdir()) == []


def test_what_openusd_draws_of_itself_stays_out_of_the_working_folder(tmp_path):
    pytest.importorskip("pxr")
    code = "from pxr import Usd; Usd.Stage.CreateInMemory().DefinePrim('/a')"
    settled = "from wrod.commands.surroundings import settle_variables as s; s(); " + code
    for one, files in ((code, True), (settled, False)):
        call = [sys.executable, "-c", one]
        around = os.environ | {"TF_DEBUG": "*"}
        subprocess.run(call, cwd=tmp_path, env=around, check=True, capture_output=True)
        assert any(tmp_path.iterdir()) == files
        for file in tmp_path.iterdir():
            file.unlink()


def test_what_opencv_tells_of_itself_stays_out_of_json(tmp_path):
    pytest.importorskip("cv2")
    from PIL import Image, ImageDraw

    picture = Image.new("RGB", (200, 150), "white")
    ImageDraw.Draw(picture).line([(30, 70), (170, 75)], fill="black", width=5)
    picture.save(tmp_path / "line.png")
    call = [sys.executable, "-m", "wrod", "scan", "line.png", "--scale", "0.0005", "--json"]
    loud = os.environ | {"OPENCV_LOG_LEVEL": "VERBOSE"}
    run = subprocess.run(
        [*call, "--out", "out"], env=loud, cwd=tmp_path, capture_output=True, text=True
    )
    assert json.loads(run.stdout)[0]["curves"] == 1


def test_processes_side_by_side_share_the_cores():
    """Each would start as many threads as there are cores."""
    found = {cores for _, cores in side_by_side.run(usable_cores, [(), ()], 2)}
    assert found == {max(1, usable_cores() // 2)}
