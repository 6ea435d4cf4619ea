"""Hostile input: valid files with one thing broken, and numbers, words and files that nobody means.

Every generator takes a `random.Random`, so that what was tried can be tried again.
"""

import copy
import io
import json
import os
import random
import zipfile
import zlib

import numpy as np

from wrod.files.array_schemas import ARRAYS

# Values for an entry of JSON whose own value is of another kind or size.
VALUES = (
    None, True, False, 0, -1, 1, 2.5, -1e-300, 1e300, -1e300, 1e12, 10**400, -(10**400), 2**63,
    "", "x", "NaN", "1", "x" * 4000, "\0", "\ud800", "../../etc/passwd", [], {}, [[]], [None],
    [1], [1, 2, 3, 4, 5], ["a", "b"], {"a": 1}, {"": None}, float("nan"), float("inf"),
    -float("inf"), [0] * 5000,
)  # fmt: skip
NUMBERS = (
    "nan", "inf", "-inf", "1e999", "-1e999", "1e12", "-1e12", "-1", "9" * 400, "-" + "9" * 40,
    "1e-300", "x", "", " ", "0x10", "1,0", "1_000_000_000_000", "½", "NaN0", "--", "None", "true",
    "1e", "+-1",
)  # fmt: skip
WORDS = (
    "", " ", "x", "nan", "-1", "0", "x" * 5000, "1,2", "a,b,c,d", "nan,nan,nan,nan", "1e999,0,0,0",
    "inf,inf,inf,inf", "1x", "x1", "-1x-1", "0x0", "1e9x1e9", "99999999999x99999999999", "\u202e",
    "../..", "/", "/dev/null", "cuda:99", "cuda:-1", "cpu:7", "gpu", "None", "{}", "[1,2,3]",
    ",,,,", "1;2", "\t", "é", "%s%n", "$(touch x)", "--out",
)  # fmt: skip


def places(value, path=()):
    """Paths of every entry of nested lists and dicts."""
    yield path
    if isinstance(value, (dict, list)):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in items:
            yield from places(item, (*path, key))


def broken_json(valid, draw: random.Random) -> tuple[str, str]:
    """(what was done, text) of a JSON document with one thing broken."""
    kind = draw.choice(["value", "value", "value", "drop", "add", "twice", "text", "deep", "root"])
    data = copy.deepcopy(valid)
    path = draw.choice([p for p in places(data) if p])
    parent = data
    for key in path[:-1]:
        parent = parent[key]
    if kind == "value":
        parent[path[-1]] = draw.choice(VALUES)
    elif kind == "drop":
        del parent[path[-1]]
    elif kind == "add":
        if isinstance(parent, dict):
            parent[draw.choice(["x", "", "__class__", "y" * 3000])] = draw.choice(VALUES)
        else:
            parent.insert(0, draw.choice(VALUES))
    elif kind == "twice" and isinstance(parent, list):
        parent.extend(copy.deepcopy(parent) * draw.choice([1, 2000]))
    text = json.dumps(draw.choice(VALUES) if kind == "root" else data)
    if kind == "deep":
        depth = draw.choice([40, 1000, 100_000])
        left, right = draw.choice([("[", "]"), ('{"a":', "}")])
        parent[path[-1]] = "@"
        text = json.dumps(data).replace('"@"', left * depth + "1" + right * depth)
    elif kind == "text":
        cut = draw.randrange(len(text))
        rubbish = draw.choice(["", "\0", "}", ",", '"', "[[[[", "NaN", "\\u", "//", "'"])
        text = text[:cut] + rubbish + text[cut + draw.choice([0, 1, len(text)]) :]
    return f"{kind} at {'.'.join(map(str, path))}", text


def write_json_file(path, text: str, draw: random.Random) -> None:
    """The text in an encoding, mostly UTF-8."""
    encoding = draw.choice(["utf-8"] * 8 + ["utf-8-sig", "utf-16", "utf-32", "cp037"])
    path.write_bytes(text.encode(encoding, "surrogatepass" if "utf" in encoding else "replace"))


def broken_arrays(valid: dict, draw: random.Random) -> tuple[str, dict]:
    """(what was done, arrays) of an .npz file with one array broken."""
    data = {name: np.array(value) for name, value in valid.items()}
    name = draw.choice(sorted(data))
    kind = draw.choice(
        ["nan", "inf", "huge", "zero", "short", "turned", "flat", "text", "drop", "empty", "scalar",
         "int", "complex", "equal", "falling", "tiny", "object", "bool"]
    )  # fmt: skip
    array = data[name]
    numeric = array.dtype.kind in "fiu" and array.size > 0
    if kind == "drop":
        del data[name]
    elif kind == "text":
        data[name] = np.array("words" if array.ndim == 0 else ["words"] * 3)
    elif kind == "object":
        data[name] = np.array([{}], dtype=object)
    elif kind == "empty":
        data[name] = array[..., :0] if array.ndim else np.zeros(0)
    elif kind == "scalar":
        data[name] = np.array(3.0)
    elif kind == "complex":
        data[name] = np.array(array, dtype=complex) if numeric else np.array(1j)
    elif kind == "bool":
        data[name] = np.ones(array.shape, bool)
    elif not numeric:
        data[name] = np.array(draw.choice(['{"rod": []}', "[1]", "", "null", '{"roll": "x"}', "{"]))
    elif kind in ("nan", "inf", "huge", "tiny"):
        array = array.astype(float)
        value = {"nan": np.nan, "inf": np.inf, "huge": 1e200, "tiny": 1e-320}[kind]
        array.flat[draw.randrange(array.size)] = value
        data[name] = array
    elif kind == "zero":
        data[name] = np.zeros_like(array)
    elif kind == "int":
        data[name] = array.astype(np.int8)
    elif kind == "short":
        data[name] = array[: max(len(array) // 2, 1)] if array.ndim else array[None]
    elif kind == "turned":
        data[name] = array.T if array.ndim > 1 else array[::-1] if array.ndim else array
    elif kind == "flat":
        data[name] = array.ravel()
    elif kind == "equal":
        data[name] = np.full_like(array, array.flat[0])
    elif kind == "falling":
        data[name] = array[::-1] if array.ndim else -array
    return f"{kind} of {name}", data


def arrays_of(kind):
    """Arrays that are as the table of that kind says."""
    table, made = ARRAYS[kind], {}
    sizes = {letter: max(table.least.get(letter, 0), 4) for letter in "ABCFHIJKMNOPQRT"}
    for name, field in table.fields.items():
        shape = [2 if one == "2 or 3" else one for one in field.shape]
        shape = [one if isinstance(one, int) else sizes[one[0]] for one in shape]
        if field.kind in ("text", "names"):
            made[name.format(k=0)] = np.full(shape, "x")
        elif field.kind == "rotations":
            made[name] = np.tile(np.eye(3), (shape[0], 1, 1))
        elif field.kind == "truths":
            made[name] = np.ones(shape, bool)
        else:
            low = field.low if field.above is None else field.above + 1e-3
            value = np.full(shape, max(low, min(0.0, field.high)))
            if field.order:
                value += np.linspace(0.0, 0.3, shape[0]).reshape(-1, *[1] * (len(shape) - 1))
            whole = field.kind == "whole numbers"
            made[name.format(k=0) if "+1" not in name else name] = (
                value.astype(int) if whole else value
            )
    return made | ({"format": np.array(table.format)} if table.format else {})


def save_arrays(path, arrays: dict) -> None:
    """As .npz, objects and all."""
    with open(path, "wb") as file:
        np.savez(file, **arrays)


def broken_xml(valid: str, draw: random.Random) -> tuple[str, str]:
    """(what was done, text) of a URDF with one thing broken."""
    import re

    kind = draw.choice(["attribute"] * 6 + ["drop", "text", "twice", "deep", "cycle", "entity"])
    found = list(re.finditer(r'(\w+)="([^"]*)"', valid))
    one = draw.choice(found)
    if kind == "attribute":
        value = draw.choice(
            ["", "nan", "inf 0 0", "0 0 0", "1 2", "a b c", "1e999", "-1", "0", "1e-300", "1e300",
             "1 2 3 4 5", "x" * 5000, "&#0;", "&lt;", "None", "prismatic", "floating", "../x.stl"]
        )  # fmt: skip
        return f"{one[0][:40]} to {value[:20]}", (
            f'{valid[: one.start()]}{one[1]}="{value}"{valid[one.end() :]}'
        )
    if kind == "drop":
        return f"without {one[0][:40]}", valid[: one.start()] + valid[one.end() :]
    if kind == "text":
        cut = draw.randrange(len(valid))
        return f"cut at {cut}", valid[:cut] + draw.choice(["", "<", "&", "\0", "</robot>"])
    if kind == "twice":
        return "links twice", valid.replace("</robot>", "<link name='a'/><link name='a'/></robot>")
    if kind == "deep":
        depth = draw.choice([30, 5000])
        return f"{depth} deep", valid.replace(
            "</robot>", "<a>" * depth + "</a>" * depth + "</robot>"
        )
    if kind == "cycle":
        number = draw.choice([2, 3000])
        links = "".join(f'<link name="c{k}"/>' for k in range(number))
        joints = "".join(
            f'<joint name="d{k}" type="fixed"><parent link="c{k}"/>'
            f'<child link="c{(k + 1) % number}"/></joint>'
            for k in range(number)
        )
        return f"a cycle of {number}", valid.replace("</robot>", links + joints + "</robot>")
    bomb = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10 if k else "lol"}">' for k in range(9))
    start = valid.index("<robot")
    text = valid[:start] + f"<!DOCTYPE r [{bomb}]>" + valid[start:]
    return "an entity bomb", text.replace("</robot>", "&l8;</robot>")


def broken_rows(valid: list[str], draw: random.Random) -> tuple[str, str]:
    """(what was done, text) of a table of points with one row broken."""
    lines, k = list(valid), draw.randrange(len(valid))
    lines[k] = draw.choice(
        ["nan 0", "inf inf", "1e300 1e300", "-1e300 1e300", "1", "1 2 3 4", "x y", "", "0 0",
         "1e-320 1e-320", "1;2", "x" * 10_000, "# units: parsec", "units: mm", "9" * 400 + " 1",
         "0.1 0.2 7", "\0", "1 2\r3 4", "½ ¾", "x [mm], y [cm]", lines[k - 1]]
    )  # fmt: skip
    what = f"row {k} is {lines[k][:30]!r}"
    if draw.random() > 0.8:
        lines = lines[: draw.choice([0, 1, 2, 3])]
        what = f"{len(lines)} rows"
    return what, "\n".join(lines)


def write_bomb(path, array, count: int):
    """An .npz of so many arrays alike, packed once."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    data, packing = buffer.getvalue(), zlib.compressobj(1, zlib.DEFLATED, -15)
    packed, crc = packing.compress(data) + packing.flush(), zlib.crc32(data)
    with zipfile.ZipFile(path, "w") as file:
        for k in range(count):
            one = zipfile.ZipInfo(f"a{k}.npy")
            one.compress_type, one.CRC = zipfile.ZIP_DEFLATED, crc
            one.compress_size, one.file_size = len(packed), len(data)
            one.header_offset = file.fp.tell()
            file.fp.write(one.FileHeader() + packed)
            file.filelist.append(one)
            file.NameToInfo[one.filename] = one
            file.start_dir = file.fp.tell()
        file._didModify = True
    return path


def foreign_files(folder) -> dict:
    """Files that are nothing that any command reads, by kind."""
    folder.mkdir(exist_ok=True)
    found = {"missing": folder / "missing", "folder": folder, "null": "/dev/null"}
    found |= {"endless": "/dev/zero", "long": folder / ("n" * 400), "deep": folder / ("d/" * 3000)}
    pipe = folder / "pipe"
    if not pipe.exists():
        os.mkfifo(pipe)
    found["pipe"] = pipe
    contents = {
        "empty": b"",
        "binary": bytes(range(256)) * 64,
        "zeros": bytes(100_000),
        "utf16": "{}".encode("utf-16"),
        "nested": b"[" * 500_000,
        "list": b"[1, 2, 3]",
        "null_json": b"null",
        "number": b"9" * 5000,
        "zip": b"PK\x03\x04" + bytes(64),
        "png": b"\x89PNG\r\n\x1a\n" + bytes(64),
        "words": b"words and more words\n" * 100,
        "xml": b"<?xml version='1.0'?><robot/>",
        "pickle": b"\x80\x04cos\nsystem\n",
        "csv": b"x,y\n1,2\nnan,inf\n3,4\n",
        "header": b"\x93NUMPY\x01\x00\x10\x00{'descr': '|O'}\n",
    }
    for name, content in contents.items():
        found[name] = folder / name
        found[name].write_bytes(content)
    bomb = folder / "bomb.npz"
    if not bomb.exists():
        write_bomb(bomb, np.zeros(2**23), 12)
    found["bomb"] = bomb
    hole = folder / "hole"
    with open(hole, "wb") as file:
        file.truncate(40 * 2**30)
    found["hole"] = hole
    return {name: str(path) for name, path in found.items()}
