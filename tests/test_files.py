"""The reader of everything that users hand over: what it takes, and what it refuses in time."""

import gzip
import json
import os
import re
import runpy
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hostile import arrays_of, write_bomb

from wrod.errors import DataError, SceneError
from wrod.files import (
    check_arrays,
    decode_json,
    decode_labels,
    read_arrays,
    read_json,
    read_tensors,
    read_text,
    schemas,
    write_tensors,
)
from wrod.files.array_schemas import ARRAYS
from wrod.files.ledger import Ledger
from wrod.files.writing import begin, finished, suffixed

SCENE = {
    "format": "wrod-fixtures-1",
    "fixtures": [{"name": "a", "cylinder": {"center": [0, 0, 0], "radius": 0.01, "height": 0.01}}],
}


def refused(text, says):
    with pytest.raises(SceneError, match=says):
        decode_json(text, schemas.Fixtures, "scene.json", "a scene", error=SceneError)


def with_radius(value):
    return json.dumps(SCENE).replace('"radius": 0.01', f'"radius": {value}')


def test_a_good_scene_is_read():
    found = decode_json(json.dumps(SCENE), schemas.Fixtures, "scene.json", "a scene")
    assert found.fixtures[0].cylinder.radius == 0.01


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("9" * 400, r"fixtures\[0\]\.cylinder\.radius is a number out of range"),
        ("1e999", "out of range"),
        ("1e3", r"radius must be a number <= 100"),
        ("0", "radius must be a number > 0"),
        ("NaN", "line 1, column .*NaN and infinity are no numbers"),
        ("-Infinity", "NaN and infinity"),
        ("null", "radius must be a number, but is null"),
        ("true", "radius must be a number, but is true or false"),
        ("[" * 100 + "]" * 100, "nested too deeply"),
        ("[" * 3_000_000, "nested too deeply"),
        ('{"a":' * 100_000, "nested too deeply"),
        ('"\\', "ends in the middle|is no JSON"),
        ('"' + '\\"' * 1_000_000, "must be a number, but is text|is no JSON"),
    ],
)
def test_bad_numbers_are_named(value, says):
    begin = time.process_time()
    refused(with_radius(value), says)
    assert time.process_time() - begin < 2.0


def test_whole_numbers_of_an_open_schema_are_bounded():
    text = json.dumps({"method": "numeric", "more": {"n": [10**400]}})
    with pytest.raises(DataError, match=r"beyond 2\^53|out of range"):
        decode_labels(text, schemas.TrajectoryMetadata, "a", "a plan")


def test_an_entry_that_is_there_twice_is_refused():
    refused(
        json.dumps(SCENE).replace("{", '{"format": "wrod-fixtures-1",', 1), "format twice; keep"
    )
    refused(with_radius('0.01, "radius": 0.02'), "radius twice")


def test_syntax_names_the_line():
    refused('{"format": "wrod-fixtures-1",\n "fixtures": [}', "line 2, column 15: is no JSON")
    refused("", "ends in the middle of its JSON")
    refused("[]", "must be an object, but is a list")


def test_what_is_no_regular_file_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path, says in [
        (tmp_path / "pipe", "pipe or a device"),
        (tmp_path, "is a folder"),
        ("/dev/zero", "pipe or a device"),
        (tmp_path / "none", "no such file"),
        (tmp_path / ("x" * 5000), "cannot be read"),
        ("nul\0byte", "cannot be read"),
        (tmp_path / "a" / ".." / ("y" * 300), "cannot be read|no such file"),
    ]:
        for read in (read_text, read_arrays):
            with pytest.raises(DataError, match=says):
                read(path)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("{}".encode("utf-16"), "UTF-16; save it as UTF-8"),
        (b'{\n"a": "\xff"}', "line 2: is not a readable text file"),
        (b"\0\0\0", "zero bytes"),
        (gzip.compress(b"{}", mtime=0), r"is compressed \(gzip\); unpack it"),
        (b"PK\x03\x04\x14\x00", "save the table as CSV"),
    ],
)
def test_encodings(tmp_path, content, says):
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(DataError, match=says):
        read_json(tmp_path / "a.json", schemas.CameraIntrinsics, "a camera file")


def test_a_file_beyond_the_limit_is_not_read(tmp_path):
    path = tmp_path / "large.json"
    with open(path, "wb") as file:
        file.truncate(10 * 2**30)  # a hole; nothing is written
    with pytest.raises(DataError, match="10240 MiB, and at most"):
        read_json(path, schemas.CameraIntrinsics, "a camera file")
    with pytest.raises(DataError, match="10240 MiB, and at most"):
        read_arrays(path)


def npy(array):
    import io

    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def archive(path, **members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for name, content in members.items():
            file.writestr(f"{name}.npy", content)
    return path


def header(shape, dtype="<f8"):
    text = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}"
    text += " " * (-(len(text) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


def test_arrays_are_read(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.arange(3.0), label="word", flag=True)
    found = read_arrays(tmp_path / "a.npz")
    assert found["x"].tolist() == [0.0, 1.0, 2.0] and str(found["label"]) == "word"
    assert set(read_arrays(tmp_path / "a.npz", only=["flag"])) == {"flag"}
    np.save(tmp_path / "b.npy", np.eye(2))
    assert read_arrays(tmp_path / "b.npy")[""].tolist() == [[1.0, 0.0], [0.0, 1.0]]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (header((10**6, 10**6)), "MiB when unpacked"),
        (header((2**40,)), "MiB when unpacked"),
        (header((3,)), "bytes where its header promises"),
        (header((-3,)), "has shape"),
        (header((10**30,)), "MiB when unpacked"),
        (header((1,) * 20) + bytes(8), "has shape"),
        (header((3,), "|O"), "Python objects"),
        (header((3,), "<c16"), "complex128 values"),
        (header((3,), "<M8[s]"), "datetime64.* values"),
        (header("(3,"), "not readable"),
        (header((3,))[:40], "not readable"),
        (b"\x93NUMPY\x09\x00" + bytes(20), "unknown file version"),
        (b"", "not readable"),
    ],
)
def test_headers_are_checked_before_arrays_are_read(tmp_path, content, says):
    with pytest.raises(DataError, match=says):
        read_arrays(archive(tmp_path / "a.npz", x=content))
    if content:
        (tmp_path / "a.npy").write_bytes(content)
        with pytest.raises(DataError, match=says):
            read_arrays(tmp_path / "a.npy")


def test_bombs_are_refused_by_their_headers(tmp_path):
    path = write_bomb(tmp_path / "bomb.npz", np.zeros(2**24), 8)
    assert path.stat().st_size < 2**23  # of a gigabyte
    begin = time.process_time()
    with pytest.raises(DataError, match="MiB when unpacked"):
        read_arrays(path)
    assert time.process_time() - begin < 1.0
    many = archive(tmp_path / "many.npz", **{f"a{k}": npy(np.zeros(1)) for k in range(300)})
    with pytest.raises(DataError, match="holds 300 arrays"):
        read_arrays(many)


@pytest.mark.parametrize("keep", [0, 3, 30, 100, -30, -1])
def test_truncated_archives_are_refused(tmp_path, keep):
    path = tmp_path / "a.npz"
    np.savez_compressed(path, x=np.random.default_rng(0).normal(size=200))
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(DataError, match=r"a\.npz: is not readable"):
        read_arrays(path)


def test_objects_run_no_code(tmp_path):
    class Harm:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "ran"),)

    np.savez(tmp_path / "a.npz", x=np.array([Harm()], dtype=object))
    with pytest.raises(DataError, match="Python objects"):
        read_arrays(tmp_path / "a.npz")
    assert not (tmp_path / "ran").exists()


def test_the_docs_say_what_the_schemas_say():
    docs = Path(__file__).parents[1] / "docs"
    printed = runpy.run_path(str(docs / "formats.py"))["document"]()
    assert (docs / "formats.md").read_text(encoding="utf-8") == printed


@pytest.mark.parametrize("kind", ARRAYS)
def test_arrays_are_as_their_table_says(kind):
    """Every field of every table, each wrong in every way that the table excludes."""
    table, good = ARRAYS[kind], arrays_of(kind)
    found = check_arrays(good | {"beside": np.array([None])}, kind, "a.npz")
    assert found.keys() == good.keys() - {"format"}

    def refused(says, name, value):
        wrong = good | {name: value}
        if value is None:
            del wrong[name]
        with pytest.raises(DataError, match=rf"^a\.npz: .*{says}"):
            check_arrays(wrong, kind, "a.npz")

    if table.format:
        refused("is not of the format", "format", np.array("another"))
    for name, field in table.fields.items():
        name, grouped = name.format(k=0), any(name in group for group in table.together)
        if field.needed:
            refused(f"lacks the array {re.escape(name)}", name, None)
        if grouped:
            refused("only one of", name, None)
        value = np.asarray(good[name])
        refused("must hold|no array", name, np.array(None))
        refused("it must have", name, value[None, None])
        if field.kind in ("text", "names", "truths"):
            continue
        if field.kind != "whole numbers":
            for bad in (np.inf, np.nan)[: 1 if field.gaps else 2]:
                refused("not a number that can be used", name, _with(value, bad))
            if field.gaps:
                check_arrays(good | {name: _with(value, np.nan)}, kind, "a.npz")
        if field.kind == "rotations":
            refused("is not a rotation", name, -value)
            continue
        if np.isfinite(field.high):
            refused("at most", name, _with(value, 2 * field.high + 1))
        if field.above is not None:
            refused("above", name, _with(value, field.above))
        elif np.isfinite(field.low):
            refused("at least", name, _with(value, int(field.low) - 1))
        if field.order:
            refused("does not", name, value[::-1])
    for letter, least in table.least.items():
        short = dict(good)
        for name, field in table.fields.items():
            axes = [str(one).rstrip("?") for one in field.shape]
            if letter in axes:
                short[name] = np.take(good[name], range(least - 1), axis=axes.index(letter))
        with pytest.raises(DataError, match=f"at least {least} are needed"):
            check_arrays(short, kind, "a.npz")


def _with(array, value):
    """A copy whose last value is that one."""
    array = np.array(array, dtype=float if array.dtype.kind == "f" else array.dtype)
    array.reshape(-1)[-1] = value
    return array


def test_lengths_agree_between_arrays():
    good = arrays_of("MotionMeasurements")
    for name, value, says in (
        ("positions", np.zeros((2, 30, 8)), r"it must have \(recording, frame, marker, 3\)"),
        ("file_ids", np.zeros(3, int), "positions is 4 long there"),
    ):
        with pytest.raises(DataError, match=says):
            check_arrays(good | {name: value}, "MotionMeasurements", "a.npz")
    one = check_arrays(arrays_of("HangingLoops") | {"shape": np.zeros((4, 2))}, "HangingLoops", "")
    assert one["shape"].shape == (1, 4, 2)
    layers = {"weight.0": np.ones((5, 2)), "bias.0": np.ones(5), "weight.1": np.ones((3, 4)),
              "bias.1": np.ones(3), "scale": np.ones(3)}  # fmt: skip
    with pytest.raises(DataError, match=r"weight\.1 has shape \(3, 4\).*weight\.0 is 5 long there"):
        check_arrays(layers, "Corrector", "c")


def test_tensors_have_a_checksum(tmp_path):
    path = write_tensors(tmp_path / "a.safetensors", {"format": "x"}, {"a": np.arange(9.0)})
    label, arrays = read_tensors(path, "a file")
    assert json.loads(label)["format"] == "x" and np.array_equal(arrays["a"], np.arange(9.0))
    content = bytearray(path.read_bytes())
    content[-3] ^= 1
    path.write_bytes(content)
    with pytest.raises(DataError, match="damaged"):
        read_tensors(path, "a file")


@pytest.mark.parametrize(
    ("given", "written"),
    [
        ("friction-0.3", "friction-0.3.npz"),
        ("a.csv", "a.npz"),
        ("a", "a.npz"),
        ("a.v2", "a.v2.npz"),
    ],
)
def test_numbers_at_the_end_of_a_name_are_no_suffix(tmp_path, given, written):
    assert suffixed(tmp_path / given, ".npz") == tmp_path / written


def test_a_folder_is_no_name_for_a_file(tmp_path):
    with pytest.raises(DataError, match="is a folder; give the name of a file"):
        suffixed(tmp_path, ".npz")


def test_a_refusal_says_that_a_campaign_that_went_on_is_complete(tmp_path):
    path = tmp_path / "trials.jsonl"
    Ledger(path, {}, ("k",)).add([{"k": 1}])
    begin()
    Ledger(path, {}, ("k",)).add([{"k": 2}])
    assert finished() == [path]


@pytest.mark.parametrize(
    "row",
    [{"metrics": {"tip_deflection_error": "x"}}, {"simulated": 0.0}, {"solver": "x"}, {"said": 1}],
)
def test_rows_of_other_runs_are_those_of_the_bench(tmp_path, row):
    from wrod.bench.cosserat import _rows_of

    good = {"experiment": "cantilever", "solver": "wrod", "elements": 8, "seconds": 0.1, "said": ""}
    path = tmp_path / "rows.json"
    path.write_text(json.dumps({"rows": [good | {"metrics": {"tip_deflection_error": 1e-3}}]}))
    assert _rows_of(path)[0]["metrics"] == {"tip_deflection_error": 1e-3}
    path.write_text(json.dumps({"rows": [good | row]}))
    with pytest.raises(DataError, match="run that again"):
        _rows_of(path)
