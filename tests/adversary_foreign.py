"""Files that other programs, broken downloads and other times make of what commands read
(tests/adversary.py): each takes the place of a valid file, of the same name. They may be refused,
or taken where they mean the same."""

from __future__ import annotations

import base64
import gzip
import io
import json
import pickle
import struct
import tarfile
import zipfile
from pathlib import Path

import numpy as np
from adversary_dress import emptied, one_file

_PAGE = b"<!DOCTYPE html><html><head><title>404</title></head><body>Not Found</body></html>\n"
_POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"0" * 64 + b"\nsize 1\n"


def foreign(draw, words, files, folder) -> tuple[str, list[str]] | None:
    """The call with one of its files in another program's dress."""
    read, file = one_file(draw, words, files)
    if file is None:
        return None
    made = emptied(folder / "foreign")
    ways = _OF.get(file.suffix, {})
    kinds = ways(file, made) if callable(ways) else ways
    if not kinds or draw.random() < 0.25:
        kinds = _anything(file.read_bytes())
    kind = draw.choice(list(kinds))
    content = kinds[kind]
    content = content() if callable(content) else content
    (made / file.name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return f"{file.name}: {kind}", [str(made / file.name) if w == read else w for w in words]


def _anything(content: bytes) -> dict:
    """What happens to any file on its way."""
    tar, packed = io.BytesIO(), io.BytesIO()
    with tarfile.open(fileobj=tar, mode="w:gz") as into:
        into.addfile(tarfile.TarInfo("x"))
    with zipfile.ZipFile(packed, "w") as into:
        into.writestr("x", content)
    half = len(content) // 2
    return {
        "gzip": gzip.compress(content),
        "tar": tar.getvalue(),
        "zip": packed.getvalue(),
        "page": _PAGE,
        "pointer": _POINTER,
        "base64": base64.b64encode(content),
        "conflict": b"<<<<<<< HEAD\n" + content + b"=======\n" + content + b">>>>>>> other\n",
        "patch": b"--- a/x\n+++ b/x\n@@ -1 +1 @@\n" + content[:400],
        "pdf": b"%PDF-1.7\n%\xe2\xe3\n",
        "as text": content.replace(b"\n", b"\r\n"),
        "one byte": content[:1],
        "halves": content[half:] + content[:half],
        "UTF-16": content.decode("latin-1").encode("utf-16-le"),
        "no eighth bit": bytes(byte & 127 for byte in content),
        "ELF": b"\x7fELF" + content,
        "wide": b"".join(bytes((byte, 0)) for byte in content[:100_000]),
        "doubly UTF-8": content.decode("latin-1").encode(),
        "pickle": pickle.dumps([content[:9]]),
        "SQLite": b"SQLite format 3\0" + content,
        "Parquet": b"PAR1" + content + b"PAR1",
        "HDF5": b"\x89HDF\r\n\x1a\n" + content,
        "MATLAB": b"MATLAB 5.0 MAT-file".ljust(128) + b"IM",
        "ASCII art": b"\x1b]0;owned\x07" + content,
        "spaces": b" " * 1000,
        "newlines": b"\n" * 1000,
    }


def _json(file: Path, made: Path) -> dict:
    text = file.read_text()
    data = json.loads(text)
    first = json.dumps(next(iter(data))) if isinstance(data, dict) and data else '"a"'

    def every(value, change):
        if isinstance(value, dict):
            return {k: every(v, change) for k, v in value.items()}
        if isinstance(value, list):
            return [every(v, change) for v in value]
        return change(value)

    def numbers(change):
        def one(value):
            real = isinstance(value, (int, float)) and not isinstance(value, bool)
            return change(value) if real else value

        return json.dumps(every(data, one))

    return {
        "key twice": text.replace("{", "{" + f"{first}: null, ", 1),
        "key twice, last": text.rstrip()[:-1] + f", {first}: null" + text.rstrip()[-1:],
        "NaN": numbers(lambda v: float("nan")),
        "Infinity": numbers(lambda v: float("-inf")),
        "1e999": numbers(lambda v: -77777).replace("-77777", "1e999"),
        "minus": numbers(lambda v: -v),
        "text": numbers(str),
        "commas": numbers(lambda v: str(v).replace(".", ",")),
        "tiny": numbers(lambda v: v * 1e-300),
        "large": numbers(lambda v: v * 1e150),
        "zero": numbers(lambda v: 0),
        "millimetres": numbers(lambda v: 1000 * v),
        "wholes": numbers(round),
        "true": numbers(bool),
        "lists": numbers(lambda v: [v]),
        "null": json.dumps(every(data, lambda v: None)),
        "comment": "// words\n" + text,
        "last comma": text.rstrip()[:-1] + "," + text.rstrip()[-1:],
        "quotes": text.replace('"', "'"),
        "lines": "\n".join([json.dumps(data)] * 3),
        "in a list": f"[{text}]",
        "in a map": json.dumps({"data": data}),
        "as text twice": json.dumps(text),
        "function": f"load({text});",
        "newer": text.replace('-1"', '-99"').replace('_1"', '_99"'),
        "YAML": text.replace('"', "").replace("{", "").replace("}", ""),
        "upper keys": json.dumps(data).upper(),
        "$ref": json.dumps({"$ref": "file:///etc/passwd"}),
        "proto": json.dumps({"__proto__": data}),
        "surrogates": text.replace(first, '"\\ud800"', 1),
        "NEL": text.replace("\n", "\x85"),
    }


def _arrays(file: Path, made: Path) -> dict:
    with np.load(file) as content:
        arrays = {name: content[name] for name in content.files}

    def saved(change, name=None):
        def make() -> bytes:
            into, changed = io.BytesIO(), {}
            for key, value in arrays.items():
                number = value.dtype.kind in "fiu" and (name is None or key == name)
                with np.errstate(all="ignore"):
                    changed[key] = change(value) if number else value
            np.savez(into, **changed)
            return into.getvalue()

        return make

    def zipped(entries: dict, **options):
        into = io.BytesIO()
        with zipfile.ZipFile(into, "w", **options) as made:
            for key, value in entries.items():
                made.writestr(key, value)
        return into.getvalue()

    def entry(value) -> bytes:
        into = io.BytesIO()
        np.save(into, value, allow_pickle=True)
        return into.getvalue()

    good = {f"{key}.npy": entry(value) for key, value in arrays.items()}
    lie = b"\x93NUMPY\x01\x00" + struct.pack("<H", 118)
    lie += (
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (9999999999, 3), }".ljust(117) + b"\n"
    )
    most = max(arrays, key=lambda key: arrays[key].size)
    locked = bytearray(zipped(good))
    for mark, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        where = locked.find(mark)
        while where >= 0:
            locked[where + at] |= 1
            where = locked.find(mark, where + 4)
    return {
        "float16": saved(lambda v: v.astype(np.float16)),
        "complex": saved(lambda v: v + 0j),
        "longdouble": saved(lambda v: v.astype(np.longdouble)),
        "int8": saved(lambda v: v.astype(np.int8)),
        "uint64": saved(lambda v: v.astype(np.uint64)),
        "big-endian": saved(lambda v: v.astype(v.dtype.newbyteorder(">"))),
        "Fortran": saved(np.asfortranarray),
        "bytes": saved(lambda v: v.astype("S20")),
        "text": saved(lambda v: v.astype("U20")),
        "objects": saved(lambda v: v.astype(object)),
        "dates": saved(lambda v: v.astype("datetime64[s]")),
        "masked": saved(lambda v: np.ma.array(v, mask=v == v)),
        "axes more": saved(lambda v: v[None]),
        "axes fewer": saved(np.ravel),
        "axes turned": saved(np.transpose),
        "millimetres": saved(lambda v: 1000 * v),
        "doubled": saved(lambda v: np.concatenate([v, v]) if v.ndim else v),
        "back to front": saved(lambda v: v[::-1] if v.ndim else v),
        "one row": saved(lambda v: v[:1] if v.ndim else v),
        "no rows": saved(lambda v: v[:0] if v.ndim else v),
        "shuffled": saved(lambda v: np.random.default_rng(0).permutation(v) if v.ndim else v, most),
        "denormal": saved(lambda v: v * 1e-310),
        "all equal": saved(np.ones_like, most),
        "noise": saved(lambda v: v + np.random.default_rng(1).standard_normal(v.shape), most),
        "records": saved(lambda v: np.zeros(3, [("a", "f8"), ("b", "i4")]), most),
        "paths": zipped({f"../../{key}": value for key, value in good.items()}),
        "folders": zipped({"a/": b"", **{f"a/{key}": value for key, value in good.items()}}),
        "nothing": zipped({}),
        "a note only": zipped({"readme.txt": b"words"}),
        "a lie": zipped(good | {f"{most}.npy": lie}),
        "locked": bytes(locked),
        "zip in zip": zipped({"a.npy": zipped(good)}),
        "a script": zipped(good | {"a.npy": entry(np.array([print], object))}),
        "old": zipped(good | {"format.npy": entry(np.array("wrod-0"))}),
        "newer": zipped(good | {"format.npy": entry(np.array("wrod-trajectory-99"))}),
        "names of many letters": zipped(good | {"n" * 60_000 + ".npy": good[f"{most}.npy"]}),
        "an .npy": entry(arrays[most]),
        "lzma": zipped(good, compression=zipfile.ZIP_LZMA),
        "bzip2": zipped(good, compression=zipfile.ZIP_BZIP2),
    }


def _table(file: Path, made: Path) -> dict:
    rows = [line.split(",") for line in file.read_text().split()[1:]]
    x = [row[0] for row in rows]

    def lines(*parts) -> str:
        return "\n".join(",".join(map(str, part)) for part in parts) + "\n"

    return {
        "one column": "\n".join(x),
        "five columns": lines(*([*row, 1, 2, 3] for row in rows)),
        "head only": "x,y\n",
        "empty cells": lines(*([a, ""] for a in x)),
        "units": lines(*([f"{a} mm", f"{b} mm"] for a, b in rows)),
        "N/A": lines(*rows[:9], ("N/A", "-")),
        "hexadecimal": lines(*([float(a).hex(), float(b).hex()] for a, b in rows)),
        "one point": lines(*[rows[0]] * 50),
        "two points": lines(rows[0], rows[-1]),
        "back and forth": lines(*rows, *rows[::-1]),
        "there again": lines(*rows, *rows),
        "NUL": file.read_text().replace("0", "\0"),
        "huge": lines(*([f"{a}e300", b] for a, b in rows)),
        "tiny": lines(*([f"{a}e-300", f"{b}e-300"] for a, b in rows)),
        "ragged": lines(*(row[: 1 + k % 2] for k, row in enumerate(rows))),
        "named": "X [mm];Y [mm]\n" + lines(*rows),
        "formulas": lines(*([f"={a}", f"@{b}"] for a, b in rows)),
        "a long line": ",".join(x) * 3000,
        "shuffled": lines(*sorted(rows, key=lambda row: row[0][::-1])),
        "jumps": lines(*rows[:30], (1e6, 0), *rows[30:]),
        "quarter turns": lines(*([k % 2, k // 2] for k in range(60))),
        "letters": "A\tB\n" + "a\tb\n" * 20,
        "dates": lines(*(("2026-01-01", b) for _, b in rows)),
    }


def _picture(file: Path, made: Path) -> dict:
    from PIL import Image

    with Image.open(file) as opened:
        picture = opened.convert("RGB")

    def saved(kind: str, image=None, **options):
        def make() -> bytes:
            into = io.BytesIO()
            (picture if image is None else image).save(into, kind, **options)
            return into.getvalue()

        return make

    def plain(colour, size=picture.size, mode="RGB"):
        return Image.new(mode, size, colour)

    noise = np.random.default_rng(0).integers(0, 256, (150, 200, 3), dtype=np.uint8)
    content = file.read_bytes()
    turned = picture.transpose(Image.Transpose.ROTATE_180)
    many = {"save_all": True, "append_images": [turned] * 3}
    deep = Image.fromarray(np.asarray(picture.convert("L")).astype(np.int32) * 256)
    return {
        "CMYK": saved("JPEG", picture.convert("CMYK")),
        "grey JPEG": saved("JPEG", picture.convert("L")),
        "poor JPEG": saved("JPEG", quality=1),
        "progressive": saved("JPEG", progressive=True),
        "GIF": saved("GIF", **many),
        "APNG": saved("PNG", **many),
        "WebP": saved("WEBP", **many),
        "TIFF": saved("TIFF", **many),
        "float TIFF": saved("TIFF", picture.convert("F")),
        "deep TIFF": saved("TIFF", deep),
        "BMP": saved("BMP"),
        "ICO": saved("ICO"),
        "PPM": saved("PPM"),
        "TGA": saved("TGA"),
        "PCX": saved("PCX"),
        "JPEG 2000": saved("JPEG2000"),
        "Lab": saved("TIFF", picture.convert("YCbCr")),
        "white": saved("PNG", plain("white")),
        "black": saved("PNG", plain("black")),
        "clear": saved("PNG", plain((0, 0, 0, 0), mode="RGBA")),
        "a point": saved("PNG", plain("black", (1, 1))),
        "a row": saved("PNG", plain("red", (4000, 1))),
        "a column": saved("PNG", plain("red", (1, 4000))),
        "noise": saved("PNG", Image.fromarray(noise)),
        "turned about": saved("PNG", Image.eval(picture, lambda v: 255 - v)),
        "small": saved("PNG", picture.resize((3, 3))),
        "a profile": saved("PNG", icc_profile=b"x" * 100),
        "no end": content[:-12],
        "wrong sum": content[:40] + b"\1" + content[41:],
        "said huge": content[:16] + struct.pack(">II", 2**31 - 1, 2**31 - 1) + content[24:],
        "SVG": '<svg xmlns="http://www.w3.org/2000/svg"><image href="/etc/passwd"/></svg>',
        "HEIC": b"\0\0\0\x18ftypheic" + content,
        "NumPy": b"\x93NUMPY\1\0" + content,
        "more behind": content + content,
    }


def _texts(name: str):
    def kinds(file: Path, made: Path) -> dict:
        from adversary_texts import KINDS

        return KINDS[name](file.read_text())

    return kinds


def _tensors(file: Path, made: Path) -> dict:
    content = file.read_bytes()
    size = int.from_bytes(content[:8], "little")
    label, body = json.loads(content[8 : 8 + size]), content[8 + size :]
    names = [name for name in label if name != "__metadata__"]

    def written(changed: dict, data: bytes = body) -> bytes:
        text = json.dumps(changed).encode()
        return len(text).to_bytes(8, "little") + text + data

    def each(**fields) -> bytes:
        return written({k: {**v, **fields} if k in names else v for k, v in label.items()})

    first, numbers = names[0], np.frombuffer(body[: len(body) // 8 * 8], np.float64)
    return {
        "longer label": (2**63).to_bytes(8, "little") + content[8:],
        "no label": (0).to_bytes(8, "little") + body,
        "a list": written([1, 2]),
        "another type": each(dtype="BF16"),  # type: ignore[arg-type]
        "no such type": each(dtype="F999"),
        "negative shape": each(shape=[-1, -8]),
        "huge shape": each(shape=[2**62, 2**62]),
        "beyond": each(data_offsets=[0, 2**60]),
        "turned offsets": each(data_offsets=[800, 0]),
        "all in one place": each(data_offsets=[0, 8]),
        "NaN": written(label, np.full_like(numbers, np.nan).tobytes()),
        "zero": written(label, bytes(len(body))),
        "huge": written(label, np.full_like(numbers, 1e300).tobytes()),
        "cut": content[:-100],
        "longer": content + b"x" * 100,
        "one less": written({k: v for k, v in label.items() if k != first}),
        "another more": written(
            label | {"more": {"dtype": "F64", "shape": [0], "data_offsets": [0, 0]}}
        ),
        "no metadata": written({k: v for k, v in label.items() if k in names}),
        "metadata of words": written(label | {"__metadata__": {"wrod": "words"}}),
        "metadata of a list": written(label | {"__metadata__": [1]}),  # type: ignore[dict-item]
        "metadata empty": written(label | {"__metadata__": {"wrod": "{}"}}),
        "newer": content.replace(b"-1", b"-9"),
        "PyTorch": b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19.",
        "GGUF": b"GGUF\3\0\0\0" + content,
        "ONNX": b"\x08\x07\x12\x07pytorch" + body[:1000],
    }


_OF = {
    ".json": _json,
    ".npz": _arrays,
    ".csv": _table,
    ".png": _picture,
    ".safetensors": _tensors,
    ".svg": _texts("svg"),
    ".urdf": _texts("urdf"),
    ".usda": _texts("usda"),
}
