import json
import os
import signal
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cli import done, refused, told
from forked import server
from wrod.training import dataset, store
from wrod.training.dataset import Rank, generate, load
from wrod.training.sampling import RANGE, RodInputs, sample, sample_worst

import wrod
from wrod.commands import main
from wrod.errors import DataError, RodError
from wrod.rods.law import Softening
from wrod.rods.profile import Profile

SIZE, SHARD = 72, 8
OPTIONS = ["--size", str(SIZE), "--shard-size", str(SHARD), "--seed", "3", "--device", "cpu"]


CODE = "from wrod.commands import main; main()"
COMMAND = [sys.executable, "-c", CODE, "dataset", *OPTIONS, "--json"]


def killed(words):
    """`wrod` that is killed while the third shard is written."""
    write, written = store.write_tensors, []

    def kill(*arguments):
        if len(written) == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        written.append(write(*arguments))
        return written[-1]

    store.write_tensors = kill
    main(words)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    generate(folder, SIZE, seed=3, shard_size=SHARD, device="cpu", rank=Rank())
    return folder


@pytest.fixture
def copy(whole, tmp_path):
    for name, content in contents(whole).items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


def test_samples_follow_from_number_and_seed():
    whole = sample(0, 300, seed=5)
    np.testing.assert_array_equal(
        np.concatenate([sample(0, 17, 5), sample(17, 200, 5), sample(217, 83, 5)]), whole
    )
    assert not np.allclose(whole, sample(0, 300, seed=6))
    with pytest.raises(DataError, match="samples -1"):
        sample(-1, 5, 0)


def test_samples_cover_the_range_evenly_and_short_rods_more():
    inputs = sample(0, 4096, seed=0)
    for column, (low, high) in zip(inputs.T, RANGE.values(), strict=True):
        assert column.min() < low + 0.01 * (high - low)
        assert column.max() > high
    assert np.median(inputs[:, 0]) < 12.0
    kappa = np.histogram(inputs[:, 1], 16)[0]
    assert kappa.min() > 0.97 * 4096 / 16  # far more even than chance, which gives 0.9


def test_worst_samples_lie_where_the_error_is():
    inputs = sample(0, 512, seed=1)
    error = np.where(inputs[:, 1] > 2.0, 1.0, 1e-4)
    new = sample_worst(inputs, error, 512, 100, seed=1)
    assert (new[:, 1] > 1.9).mean() > 0.95 and len(np.unique(new, axis=0)) == 100


def test_rows_are_the_solver_s_grasps(whole):
    from wrod.grasps.optimal import solve_grasps

    columns = list(store.shards(whole))[2]
    inputs = sample(2 * SHARD, SHARD, seed=3)
    np.testing.assert_array_equal(columns["inputs"], inputs)
    grasps = solve_grasps(*inputs.T, sensitivities=True, device="cpu")
    for name in ("position", "rotation", "force", "position_sensitivity", "residual"):
        np.testing.assert_allclose(columns[name], getattr(grasps, name), atol=1e-9)
    table = load(whole)
    assert table.outputs.shape == (SIZE, 9) and table.sensitivity.shape == (SIZE, 9, 3)
    assert len(load(whole, most=20)) == 20


def test_killed_and_run_again_gives_the_same_bytes(whole, tmp_path):
    end = server().run(killed, ([*COMMAND[3:], "--out", str(tmp_path)],), tmp_path)
    assert end.code == -signal.SIGKILL
    found = len(list(tmp_path.glob("grasps-*")))
    (tmp_path / ".grasps-00008.safetensors.abc").write_bytes(b"what a kill leaves of a write")
    assert found == 2
    outcome = generate(tmp_path, SIZE, seed=3, shard_size=SHARD, device="cpu", rank=Rank())
    assert outcome.solved == SIZE - found * SHARD and outcome.samples == SIZE
    assert contents(tmp_path) == contents(whole)


SHARES = [(0, 2, 40), (1, 2, 32)]


def test_ranks_give_the_same_bytes(whole, tmp_path, monkeypatch):
    """As torchrun names them; they need no word with each other."""
    reports = []
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.setenv("LOCAL_WORLD_SIZE", "2")
    for rank in "10":
        monkeypatch.setenv("RANK", rank)
        monkeypatch.setenv("LOCAL_RANK", rank)
        reports.append(told("dataset", *OPTIONS, "--json", "--out", tmp_path))
    assert sorted((r["rank"], r["ranks"], r["samples"]) for r in reports) == SHARES
    assert contents(tmp_path) == contents(whole)


@pytest.mark.slow
def test_torchrun_gives_the_same_bytes(whole, tmp_path):
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone"]
    result = subprocess.run(
        [*torchrun, "--nproc-per-node", "2", "--no-python", *COMMAND, "--out", str(tmp_path)],
        capture_output=True, text=True, timeout=900,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    reports = [json.loads(line) for line in result.stdout.splitlines() if line.startswith("{")]
    assert sorted((r["rank"], r["ranks"], r["samples"]) for r in reports) == SHARES
    assert contents(tmp_path) == contents(whole)


def test_ranks_that_contradict_each_other(monkeypatch):
    monkeypatch.setenv("RANK", "2")
    with pytest.raises(DataError, match="RANK 2 of WORLD_SIZE 1"):
        Rank.from_environment()
    monkeypatch.setenv("RANK", "first")
    with pytest.raises(DataError, match="whole numbers"):
        Rank.from_environment()


@pytest.mark.parametrize("keep", [0, 5, 300, -1])
def test_truncated_shard_is_refused(copy, keep):
    path = store.shard_path(copy, 1)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(DataError, match=r"grasps-00001.*truncated or not a shard"):
        load(copy)


def test_damaged_foreign_and_missing_shards_are_refused(copy, tmp_path_factory):
    path = store.shard_path(copy, 1)
    good = path.read_bytes()
    path.write_bytes(good[:-20] + bytes([good[-20] ^ 1]) + good[-19:])
    with pytest.raises(DataError, match="damaged"):
        load(copy)
    with pytest.raises(DataError, match="damaged"):
        generate(copy, SIZE, seed=3, shard_size=SHARD, device="cpu", rank=Rank())
    path.write_bytes(store.shard_path(copy, 2).read_bytes())
    with pytest.raises(DataError, match="another dataset or place"):
        load(copy)
    path.write_text("x,y\n1,2\n")
    with pytest.raises(DataError, match="truncated or not a shard"):
        load(copy)
    path.unlink()
    with pytest.raises(DataError, match=r"grasps-00001.*is missing"):
        load(copy)
    (copy / "manifest.json").write_text('{"format": "other"}')
    with pytest.raises(DataError, match="manifest"):
        load(copy)
    with pytest.raises(DataError, match=r"no such file.*`wrod dataset`"):
        load(tmp_path_factory.mktemp("empty"))


def test_folder_of_another_dataset_is_refused(copy):
    with pytest.raises(DataError, match=r"seed 3 \(now 4\)"):
        generate(copy, SIZE, seed=4, shard_size=SHARD, device="cpu", rank=Rank())
    with pytest.raises(DataError, match="at least as many"):
        generate(copy, SIZE - 1, seed=3, shard_size=SHARD, device="cpu", rank=Rank())


def fake_grasps(*inputs, **options):
    n = len(inputs[0])
    good = np.arange(n) % 4 > 0
    vectors = np.stack(inputs, axis=1)
    return SimpleNamespace(
        position=vectors, rotation=vectors, force=vectors, residual=inputs[0], converged=good,
        stable=np.arange(n) % 4 > 1, **{k: np.zeros((n, 3, 3)) for k in store.SENSITIVITIES},
    )  # fmt: skip


def test_a_dataset_grows(tmp_path, monkeypatch):
    monkeypatch.setattr(dataset, "solve_grasps", fake_grasps)
    grown, whole = tmp_path / "grown", tmp_path / "whole"
    for folder, sizes in ((grown, (20, 50)), (whole, (50,))):
        for size in sizes:
            outcome = generate(folder, size, shard_size=16, device="cpu", rank=Rank())
    assert contents(grown) == contents(whole)
    # Row 0 of every four has not converged, row 1 is unstable: 16 + 16 + 16 + 2 rows.
    assert (outcome.unconverged, outcome.unstable, len(load(whole))) == (13, 13, 24)


def test_memory_stays_flat(tmp_path, monkeypatch):
    monkeypatch.setattr(dataset, "solve_grasps", fake_grasps)
    generate(tmp_path / "first", 512, shard_size=512, device="cpu", rank=Rank())
    peaks = []
    for shards in (8, 200):
        tracemalloc.start()
        generate(tmp_path / str(shards), 512 * shards, shard_size=512, device="cpu", rank=Rank())
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # A shard that is done leaves its entry in a list, not its rows (which take 100 kB); a few are
    # in hand at a time, by chance up to four more or less.
    assert peaks[1] - peaks[0] < 192 * 2_000 + 4 * 100_000


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--closure", "none"], "unknown closure"),
        (["--device", "cuda:99"], "not on this machine"),
        (["--size", str(2**31)], "is not in the range 1<=x<=1073741824"),
    ],
)
def test_bad_options_are_one_sentence(tmp_path, arguments, says):
    out = tmp_path / "out"
    refused(says, "dataset", "--size", "5", "--out", out, *arguments)
    assert not out.exists()


def test_a_rod_that_varies_is_refused_and_one_that_is_damped_is_not():
    one = wrod.RodModel.of(wrod.rod("green-vps"))
    damped = replace(one, internal_damping=0.1, stretching_stiffness=50.0)
    asked = RodInputs.of(damped)
    assert asked.stretch_ratio == damped.stretch_ratio != RodInputs.of(one).stretch_ratio
    first = one.bending_stiffness[0]
    tapering = replace(
        one, bending_stiffness=(Profile([1.0, 0.5], [0.0, 0.8]) * first.values[0],) * 2
    )
    with pytest.raises(RodError, match="has its own bending_stiffness; `wrod plan` solves"):
        RodInputs.of(tapering)
    with pytest.raises(RodError, match="its own law"):
        RodInputs.of(replace(one, law=Softening(20.0, 0.4)))


def test_manifest_names_solver_and_command(whole, tmp_path):
    """The version is the code's own, whether or not the package is installed."""
    import wrod

    manifest = store.read_manifest(whole)
    assert manifest.solver == wrod.__version__
    words = manifest.command(tmp_path / "again").split()
    assert words[0] == "wrod"
    done(*words[1:], "--device", "cpu")
    assert contents(tmp_path / "again") == contents(whole)
