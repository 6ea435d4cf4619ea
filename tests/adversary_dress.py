"""Valid calls and files written otherwise (tests/adversary.py): other words for the same numbers,
tables, pictures and archives as other programs write them. Such a call has to end in the same bytes
as the plain one, or to be refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
from hostile import save_arrays


def reads(words, files) -> list[str]:
    """The words that name files."""
    return [word for word in words if word.strip("{}") in files]


def one_file(draw, words, files) -> tuple[str, Path] | tuple[None, None]:
    """One of the words that name a file, and that file; none where there is none."""
    found = [w for w in reads(words, files) if Path(files[w.strip("{}")]).is_file()]
    read = draw.choice(found) if found else None
    return (read, Path(files[read.strip("{}")])) if read else (None, None)


def emptied(folder: Path) -> Path:
    """The folder, made anew."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def dressed(draw, words, files, folder) -> tuple[str, list[str]]:
    """The same call with its words or files written otherwise."""
    mine = [w for w in reads(words, files) if Path(w.strip("{}")).suffix in _DRESS]
    if mine and draw.random() < 0.7:
        read = draw.choice(mine)
        file, made = Path(files[read.strip("{}")]), emptied(folder / "dressed")
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
        "mixed ends": text.replace("\n", "\r\n", 7).encode(),
        "CRLF": text.replace("\n", "\r\n").encode(), "BOM": text.encode("utf-8-sig"),
        "UTF-16": text.encode("utf-16"), "no last line end": text.rstrip("\n").encode(),
        "blank lines": (text + "\n" * 500).encode(), "CR": text.replace("\n", "\r").encode(),
        "spaces": text.replace("\n", " \t\n").encode(), "ends in ^Z": text.encode() + b"\x1a",
    }  # fmt: skip
    kind, content = draw.choice(list(ways.items()))
    made.write_bytes(content)
    return kind


def _dress_rows(file: Path, made: Path, draw) -> str:
    """A table as other programs write it."""
    rows = [row.split(",") for row in file.read_text().split()]
    if draw.random() < 0.4:
        return _dress_text(file, made, draw)
    ways = {
        "quoted": [",".join(f'"{cell}"' for cell in row) for row in rows],
        "tabs": ["\t".join(row) for row in rows], "semicolons": [";".join(row) for row in rows],
        "decimal commas": [";".join(row).replace(".", ",") for row in rows],
        "sep=": ["sep=,", *(",".join(row) for row in rows)],
        "last commas": [",".join(row) + "," for row in rows],
        "spaces": [" , ".join(row) for row in rows], "comments": ["# words", *map(",".join, rows)],
        "exponents": [
            "x,y", *(",".join(f"{float(cell):.17E}" for cell in row) for row in rows[1:])
        ],
        "plus": ["x,y", *(",".join(f"{float(cell):+.5f}" for cell in row) for row in rows[1:])],
        "no head": [",".join(row) for row in rows[1:]],
        "turned": [",".join(row[::-1]) for row in rows],
        "numbered": [",".join([str(k) if k else "index", *row]) for k, row in enumerate(rows)],
    }  # fmt: skip
    kind, lines = draw.choice(list(ways.items()))
    made.write_text("\n".join(lines) + "\n")
    return kind


def _dress_picture(file: Path, made: Path, draw) -> str:
    """The same picture as other programs write it."""
    from PIL import Image

    with Image.open(file) as opened:
        picture = opened.convert("RGB")
    kind = draw.choice(
        ["1", "L", "P", "LA", "RGBA", "clear", "I;16", "turned", "packed", "text", "several"]
    )
    options: dict = {}
    if kind == "clear":  # what is not drawn is transparent, and black
        ink = picture.convert("L").point(lambda grey: 255 if grey < 128 else 0)
        picture = Image.merge("RGBA", [Image.new("L", picture.size)] * 3 + [ink])
    elif kind == "I;16":
        picture = Image.fromarray(np.asarray(picture.convert("L")).astype(np.uint16) * 257)
    elif kind == "turned":  # the camera says which way is up
        options["exif"] = picture.getexif()
        options["exif"][0x0112] = 8
        picture = picture.transpose(Image.Transpose.ROTATE_270)
    elif kind == "packed":
        options["compress_level"] = 0
    elif kind == "several":
        turned = picture.transpose(Image.Transpose.ROTATE_180)
        options |= {"save_all": True, "append_images": [turned]}
    elif kind == "text":
        from PIL.PngImagePlugin import PngInfo

        options["pnginfo"] = PngInfo()
        options["pnginfo"].add_text("words", "x" * 100_000, zip=True)
    else:
        picture = picture.convert(kind)
    picture.save(made, **options)
    return kind


def _dress_json(file: Path, made: Path, draw) -> str:
    value = json.loads(file.read_text())
    if isinstance(value, dict):
        value = dict(reversed(value.items()))
    text = json.dumps(value, indent=draw.choice([None, 1, "\t"]))
    ways = {"keys": text.encode(), "BOM": text.encode("utf-8-sig"), "UTF-16": text.encode("utf-16"),
            "CRLF": text.replace("\n", "\r\n").encode(),
            "escapes": text.replace('"r', '"\\u0072').encode(),
            "spaces": b" \n" * 5000 + text.encode() + b"\n" * 5000}  # fmt: skip
    kind, content = draw.choice(list(ways.items()))
    made.write_bytes(content)
    return kind


def _dress_arrays(file: Path, made: Path, draw) -> str:
    with np.load(file) as content:
        arrays = {name: content[name] for name in content.files}
    kind = draw.choice(
        ["packed", "big-endian", "Fortran", "turned names", "a comment", "header", "junk before",
         "another file", "twice", "no suffixes", "large"]
    )  # fmt: skip
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
    if kind == "junk before":
        made.write_bytes(b"#!/bin/sh\n" * 50 + made.read_bytes())
    if kind not in ("a comment", "header", "another file", "twice", "no suffixes", "large"):
        return kind
    import io
    import warnings
    import zipfile

    with zipfile.ZipFile(made, "w" if kind in ("header", "no suffixes", "large") else "a") as into:
        if kind == "a comment":
            into.comment = b"words" * 1000
        elif kind == "another file":
            into.writestr("notes/readme.txt", "words")
        else:
            for name, value in list(arrays.items())[: 1 if kind == "twice" else None]:
                buffer = io.BytesIO()
                version = draw.choice([(2, 0), (3, 0)]) if kind == "header" else None
                np.lib.format.write_array(buffer, value, version)
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    with into.open(
                        name if kind == "no suffixes" else f"{name}.npy", "w",
                        force_zip64=kind == "large",
                    ) as entry:  # fmt: skip
                        entry.write(buffer.getvalue())
    return kind


_DRESS = {
    ".csv": _dress_rows, ".png": _dress_picture, ".svg": _dress_text, ".urdf": _dress_text,
    ".usda": _dress_text,
    ".json": _dress_json, ".npz": _dress_arrays,
}  # fmt: skip
