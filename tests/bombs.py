# ruff: noqa: E501  # contents of files, which no line break helps
"""Files that an adversary hands over: bombs, loops, lies in headers, and what would run code.

`bombs(family)` gives contents by kind; `specials(folder, suffix)` what is no plain file at all.
Contents are small: what they unpack, expand or promise is not.
"""

import io
import json
import os
import socket
import struct
import zipfile
import zlib
from functools import cache
from pathlib import Path

import numpy as np

DIGITS = "9" * 5000


def specials(folder: Path, suffix: str) -> dict[str, str]:
    """Paths with that suffix at which no readable file of a sane size is."""
    folder.mkdir(parents=True, exist_ok=True)
    made: dict[str, str] = {}

    def at(kind):
        path = folder / f"{kind}{suffix}"
        made[kind] = str(path)
        path.unlink(missing_ok=True) if not path.is_dir() else None
        return path

    at("loop").symlink_to(folder / f"loop{suffix}")
    at("dangling").symlink_to(folder / "nowhere")
    at("to_zero").symlink_to("/dev/zero")
    at("to_random").symlink_to("/dev/urandom")
    at("to_full").symlink_to("/dev/full")
    at("to_memory").symlink_to("/proc/self/mem")
    at("to_environ").symlink_to("/proc/self/environ")
    at("to_folder").symlink_to(folder)
    at("folder_called_so").mkdir(exist_ok=True)
    os.mkfifo(at("fifo"))
    with open(at("terabyte"), "wb") as file:
        file.truncate(2**40)
    here = os.getcwd()
    try:  # the name of a socket is short
        os.chdir(folder)
        with socket.socket(socket.AF_UNIX) as one:
            at("socket")
            one.bind(f"socket{suffix}")
    finally:
        os.chdir(here)
    made["surrogate_name"] = f"{folder}/\udcff{suffix}"
    made["long_name"] = f"{folder}/{'n' * 300}{suffix}"
    made["empty_name"] = ""
    at("\u202eecafé ☃").write_bytes(b"")
    return made


@cache
def bombs(family: str) -> dict[str, bytes]:
    """Contents by kind of a family: texts, json, arrays, tensors, pictures, xml, urdf, xacro, svg,
    dxf, usd, meshes."""
    return _FAMILIES[family]()


def _texts() -> dict[str, bytes]:
    rows = "".join(f"{0.005 * k:.3f} {0.02 * np.sin(0.1 * k):.5f}\n" for k in range(60))
    found = {
        f"in_{encoding}": rows.encode(encoding)
        for encoding in ("utf-7", "utf-16-le", "utf-32", "cp037")
    }
    found |= {
        "latin": "x [µm], y [µm]\n".encode("latin-1") + rows.encode(),
        "shift_jis": "座標\n".encode("shift_jis") + rows.encode(),
        "overlong": b"\xc0\xb1 \xc0\xb2\n" + rows.encode(),
        "bom_inside": rows.encode() + b"\xef\xbb\xbf1 2\n",
        "returns": rows.replace("\n", "\r").encode(),
        "one_line": b"1 " * 500_000,
        "one_word": b"1" * 5_000_000,
        "commas": b"," * 1_000_000,
        "newlines": b"\n" * 2_000_000,
        "comments": b"#\n" * 500_000,
        "digits": f"{DIGITS} 1\n2 3\n".encode(),
        "hex": b"0x10 0x20\n0x11 0x30\n" * 30,
        "underscores": b"1_0 2_0\n1_1 3_0\n" * 30,
        "fullwidth": "１ ２\n３ ４\n".encode() * 30,
        "negative_zero": b"-0 -0\n" * 60,
        "subnormal": b"".join(b"%de-320 0\n" % k for k in range(60)),
        "exponent": b"".join(b"1e%d 0\n" % k for k in range(60)),
        "many_columns": (" ".join("1" * 5000) + "\n").encode() * 10,
        "units_twice": b"# units: mm\n# units: m\n" + rows.encode(),
        "million": b"".join(b"%d 0\n" % k for k in range(1_000_000)),
        "zigzag": b"".join(b"0.%d 0.%d\n" % (k % 2, k % 3) for k in range(5000)),
        "same": b"0.1 0.1\n" * 5000,
        "far_away": b"".join(b"%d 99\n" % (1e15 + k) for k in range(60)),
        "microscopic": b"".join(b"%de-9 0\n" % k for k in range(60)),
        "spiral": b"".join(
            b"%f %f\n" % (1e-4 * k * np.cos(k), 1e-4 * k * np.sin(k)) for k in range(3000)
        ),
    }
    return found


def _json() -> dict[str, bytes]:
    rod = '"format":"wrod-rod-1","radius":0.0016,"gravito_bending_length":0.032,"length":0.885'
    found = {
        "twice": f'{{{rod},"length":5,"length":"x"}}',
        "nan": f'{{{rod},"density":NaN}}',
        "infinity": f'{{{rod},"density":-Infinity}}',
        "exponent": f'{{{rod},"density":1e400}}',
        "vanishing": f'{{{rod},"density":1e-400}}',
        "negative_zero": f'{{{rod},"density":-0.0}}',
        "minus_zero_length": '{"format":"wrod-rod-1","radius":-0,"length":-0}',
        "digits": f'{{{rod},"density":{DIGITS}}}',
        "digits_after": f'{{{rod},"density":1.{DIGITS}}}',
        "long_exponent": f'{{{rod},"density":1e{DIGITS}}}',
        "comment": f'/* */{{{rod}}}',
        "trailing": f'{{{rod},}}',
        "two": f'{{{rod}}}{{{rod}}}',
        "unclosed": "{" + rod,
        "open_text": '{"' + "x" * 100_000,
        "escapes": '"' + "\\" * 99_999,
        "surrogate": '{"format":"\\ud800"}',
        "zero_byte": '{"format":"wrod-rod-1\\u0000"}',
        "brackets_in_text": f'{{{rod},"note":"{"[" * 100_000}"}}',
        "deep_unclosed": '{"a":[' * 200_000,
        "long_key": '{"' + "k" * 3_000_000 + '":1}',
        "many_keys": "{" + ",".join(f'"{k}":1' for k in range(200_000)) + "}",
        "million": "[" + ",".join("1" for _ in range(1_000_000)) + "]",
        "empty_key": f'{{{rod},"":""}}',
        "dunder": f'{{{rod},"__class__":{{"__init__":1}}}}',
        "direction": f'{{{rod},"\u202e":1}}',
        "text": '"wrod-rod-1"', "empty_text": '""', "empty_list": "[]", "empty": "{}",
        "true": "true", "zero": "-0", "null_in_list": "[null]", "lines": "{}\n{}\n{}",
        "wrong_kind": '{"format":["wrod-rod-1"]}',
        "pattern_of_itself": '{"format":"wrod-knot-1","rods":[{"pattern":"../../../etc/passwd"}]}',
    }  # fmt: skip
    contents = {kind: text.encode("utf-8", "surrogatepass") for kind, text in found.items()}
    return contents | {
        "byte_order": b"\xef\xbb\xbf" + found["twice"].encode(),
        "utf16": found["empty"].encode("utf-16"),
        "no_utf8": b'{"a":"\xff\xfe\xfa"}',
    }


def _npy(header: str, body: bytes = b"", version: int = 1) -> bytes:
    text = header.encode("latin-1")
    size = struct.pack("<H" if version == 1 else "<I", len(text))
    return b"\x93NUMPY" + bytes([version, 0]) + size + text + body


_QUICKLY = {"compression": zipfile.ZIP_DEFLATED, "compresslevel": 1}


def _zip(members: dict[str, bytes], **options) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", **options) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return buffer.getvalue()


class _Runs:
    """What a pickle runs when it is read."""

    def __reduce__(self):
        return os.mkdir, ("ran-by-a-pickle",)


def _arrays() -> dict[str, bytes]:
    line = np.column_stack([np.linspace(0, 0.3, 60), np.zeros(60)])
    buffer = io.BytesIO()
    np.savez(buffer, points=line)
    valid = buffer.getvalue()
    buffer = io.BytesIO()
    np.savez(buffer, points=np.array([_Runs()], dtype=object))
    pickled = buffer.getvalue()
    shape = "{'descr': '<f8', 'fortran_order': False, 'shape': %s, }\n"
    found = {f"cut_{k}": valid[: len(valid) * k // 9] for k in range(1, 9)}
    found |= {
        "pickled": pickled,
        "pickled_npy": _npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }\n", b"\x80"),
        "wrong_sum": valid.replace(line.tobytes()[8:16], b"\0" * 8, 1),
        "encrypted": valid.replace(b"PK\x03\x04\x14\0\0\0", b"PK\x03\x04\x14\0\1\0"),
        "members": _zip({f"{k}.npy": b"" for k in range(5000)}),
        "outside": _zip({"../../../points.npy": _npy(shape % "(2,)", bytes(16))}),
        "nested": _zip({"points.npy": valid}),
        "zip_bomb": _zip({"points.npy": bytes(2**27)}, **_QUICKLY),
        "lzma": _zip({"points.npy": bytes(2**20)}, compression=zipfile.ZIP_LZMA),
        "no_arrays": _zip({}), "other_members": _zip({"readme.txt": b"hello"}),
        "empty_member": _zip({"points.npy": b""}),
    }  # fmt: skip
    for kind, said in {
        "huge": "(10000000000, 2)", "endless": "(" + "9" * 4000 + ",)", "negative": "(-5, 2)",
        "words": "('a', 2)", "truths": "(True, True)", "floats": "(3.0, 2)", "none": "None",
        "call": "__import__('os').mkdir('ran-by-a-header')", "parentheses": "(" * 3000,
        "many_axes": "(1,) * 60", "axes": f"({'1,' * 60})", "empty": "(0, 2)", "scalar": "()",
    }.items():  # fmt: skip
        found[f"shape_{kind}"] = _npy(shape % said, bytes(960))
    for kind, said in {
        "void": "|V100000000", "unicode": "<U1000000000", "long": "<f16", "half": "<f2",
        "big": ">f8", "complex": "<c16", "date": "<M8[ns]", "none": "", "record": "f8,f8",
        "word": "x" * 4000, "sub": "(1000,1000)f8",
    }.items():  # fmt: skip
        text = f"{{'descr': '{said}', 'fortran_order': False, 'shape': (60, 2), }}\n"
        found[f"type_{kind}"] = _npy(text, bytes(960))
    found["header_of_4_GiB"] = b"\x93NUMPY\x02\x00\xff\xff\xff\xff{"
    found["long_header"] = _npy("{" + " " * 2_000_000, version=2)
    found["version_9"] = b"\x93NUMPY\x09\x00" + bytes(100)
    found["fortran"] = _npy(
        "{'descr': '<f8', 'fortran_order': True, 'shape': (60, 2), }\n", bytes(960)
    )
    return found


def _tensors() -> dict[str, bytes]:
    def file(header: object, body: bytes = b"", size: int | None = None) -> bytes:
        text = header if isinstance(header, bytes) else json.dumps(header).encode()
        return struct.pack("<Q", len(text) if size is None else size) + text + body

    one = {"dtype": "F64", "shape": [2], "data_offsets": [0, 16]}
    deep = "[" * 100_000
    return {
        "exa": file({}, size=10**18), "zero": file({}, size=0), "most": file({}, size=2**64 - 1),
        "list": file([]), "words": file(b"words"), "nothing": b"", "short": b"\1\0",
        "offsets": file({"a": {**one, "data_offsets": [0, 10**15]}}, bytes(16)),
        "backwards": file({"a": {**one, "data_offsets": [16, 0]}}, bytes(16)),
        "negative": file({"a": {**one, "shape": [-2]}}, bytes(16)),
        "huge_shape": file({"a": {**one, "shape": [2**40, 2**40]}}, bytes(16)),
        "type": file({"a": {**one, "dtype": "PICKLE"}}, bytes(16)),
        "overlap": file({"a": one, "b": one}, bytes(16)),
        "twice": file(b'{"a":%s,"a":%s}' % ((json.dumps(one).encode(),) * 2), bytes(16)),
        "label_list": file({"__metadata__": [], "a": one}, bytes(16)),
        "label_number": file({"__metadata__": {"wrod": 5}, "a": one}, bytes(16)),
        "label_deep": file({"__metadata__": {"wrod": deep}, "a": one}, bytes(16)),
        "label_words": file({"__metadata__": {"wrod": "words"}, "a": one}, bytes(16)),
        "label_empty": file({"__metadata__": {"wrod": "{}"}, "a": one}, bytes(16)),
        "label_nan": file({"__metadata__": {"wrod": '{"format":NaN}'}, "a": one}, bytes(16)),
        "label_half": file(
            {
                "__metadata__": {
                    "wrod": json.dumps(
                        {
                            "format": "wrod-controller-1",
                            "architecture": "chain",
                            "closure": "zero_tension",
                            "range": {
                                "suspended_length": [1, 2],
                                "curvature": [0, 1],
                                "stretch_ratio": [5, 1],
                            },
                        }
                    )
                },
                "a": one,
            },
            bytes(16),
        ),
        "no_label": file({"a": one}, bytes(16)),
        "deep": file(b'{"a":' * 100_000), "unicode": file({"é\u202e": one}, bytes(16)),
        "longer": file({"a": one}, bytes(1600)), "half": file({"a": one}, bytes(8)),
        "bool": file({"a": {"dtype": "BOOL", "shape": [16], "data_offsets": [0, 16]}}, b"\7" * 16),
        "no_tensors": file({}),
    }  # fmt: skip


def _chunk(kind: bytes, content: bytes) -> bytes:
    code = struct.pack(">I", zlib.crc32(kind + content))
    return struct.pack(">I", len(content)) + kind + content + code


def _png(width: int, height: int, *chunks: bytes, depth: int = 8, color: int = 0) -> bytes:
    head = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", head) + b"".join(chunks)


def _pictures() -> dict[str, bytes]:
    from PIL import Image

    picture = Image.new("RGB", (200, 150), "white")
    for x in range(30, 170):
        for y in range(70, 76):
            picture.putpixel((x, y), (0, 0, 0))

    def saved(kind: str, one=picture, **options) -> bytes:
        buffer = io.BytesIO()
        one.save(buffer, kind, **options)
        return buffer.getvalue()

    png, jpg, end = saved("PNG"), saved("JPEG"), _chunk(b"IEND", b"")
    rows = zlib.compress(bytes(201 * 150))
    body = _chunk(b"IDAT", rows)
    bomb = zlib.compress(bytes(2**28))
    exif = Image.Exif()
    exif[0x0112] = 99
    found = {f"png_cut_{k}": png[: len(png) * k // 6] for k in range(1, 6)}
    found |= {f"jpg_cut_{k}": jpg[: len(jpg) * k // 6] for k in range(1, 6)}
    return found | {
        "png_size": _png(2**31 - 1, 2**31 - 1, body, end), "png_zero": _png(0, 0, body, end),
        "png_tall": _png(1, 2**31 - 1, body, end), "png_30k": _png(30_000, 30_000, body, end),
        "png_bomb": _png(200, 150, _chunk(b"IDAT", bomb), end),
        "png_text_bomb": _png(200, 150, _chunk(b"zTXt", b"a\0\0" + bomb), body, end),
        "png_profile_bomb": _png(200, 150, _chunk(b"iCCP", b"a\0\0" + bomb), body, end),
        "png_texts": _png(200, 150, *[_chunk(b"tEXt", b"a\0" + bytes(9))] * 20_000, body, end),
        "png_sum": png[:60] + bytes([png[60] ^ 1]) + png[61:],
        "png_depth": _png(200, 150, body, end, depth=3),
        "png_no_data": _png(200, 150, end),
        "png_chunk": _png(200, 150, struct.pack(">I", 2**31 - 1) + b"tEXt"),
        "png_black": saved("PNG", Image.new("RGB", (200, 150))),
        "png_noise": saved("PNG", Image.effect_noise((400, 300), 200)),
        "png_stripes": saved("PNG", Image.fromarray(
            np.tile(np.array([[0] * 3 + [255] * 3], np.uint8), (300, 66)))),
        "png_clear": saved("PNG", Image.new("RGBA", (200, 150), (0, 0, 0, 0))),
        "png_thin": saved("PNG", Image.new("L", (4000, 16), 255)),
        "jpg_size": jpg.replace(struct.pack(">HH", 150, 200), struct.pack(">HH", 65535, 65535), 1),
        "jpg_exif": saved("JPEG", exif=exif), "cmyk": saved("JPEG", picture.convert("CMYK")),
        "gif": saved("GIF"), "webp_cut": saved("WEBP")[:60], "bmp": saved("BMP")[:200],
        "ppm": b"P6 1000000 1000000 255\n" + bytes(100), "pfm": b"Pf 100 100 -1.0\n" + b"\xff" * 99,
        "tiff_loop": b"II*\0\x08\0\0\0" + b"\1\0" + struct.pack("<HHII", 256, 4, 1, 99) + b"\x08\0\0\0",
        "tiff_float": saved("TIFF", Image.new("F", (200, 150), float("nan"))),
        "tiff_int": saved("TIFF", Image.new("I", (200, 150), -5)),
        "eps": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 200 150\n"
        b"%%EndComments\n(ran-by-a-picture) (w) file closefile showpage\n%%EOF\n",
        "svg": b"<svg xmlns='http://www.w3.org/2000/svg'/>",
        "icon": b"\0\0\1\0\1\0" + struct.pack("<BBBBHHII", 0, 0, 0, 0, 1, 32, 2**31, 22),
        "pdf": b"%PDF-1.4\n", "fits": b"SIMPLE  =                    T" + b" " * 2851,
    }  # fmt: skip


def _entities(depth: int, last: str) -> str:
    return "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10 if k else last}">' for k in range(depth))


def _xml(start: str, inside: str, end: str) -> dict[str, bytes]:
    """Of any XML document, whose root's first tag is `start`."""
    root = start[1:].split()[0].strip(">")
    whole = f"{start}{inside}{end}"
    laughs = f"<!DOCTYPE {root} [{_entities(9, 'lol')}]>{start}&e8;{inside}{end}"
    outer = (
        f'<!DOCTYPE {root} [<!ENTITY x SYSTEM "file:///etc/passwd">]>{start}<a>&x;</a>{inside}{end}'
    )
    found = {
        "laughs": laughs, "outer": outer,
        "outer_device": outer.replace("/etc/passwd", "/dev/zero"),
        "outer_net": outer.replace("file:///etc/passwd", "http://127.0.0.1:9/x"),
        "parameter": f'<!DOCTYPE {root} [<!ENTITY % p SYSTEM "file:///etc/passwd"> %p;]>{whole}',
        "doctype_net": f'<!DOCTYPE {root} SYSTEM "http://127.0.0.1:9/x.dtd">{whole}',
        "quadratic": f'<!DOCTYPE {root} [<!ENTITY x "{"x" * 100_000}">]>{start}{"&x;" * 20_000}{end}',
        "include": f'{start}<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" '
        f'href="/etc/passwd" parse="text"/>{inside}{end}',
        "deep": f"{start}{'<g>' * 100_000}{'</g>' * 100_000}{end}",
        "deep_open": start + "<g>" * 500_000,
        "attributes": f"{start}<g {' '.join(f'a{k}=' + chr(34) * 2 for k in range(100_000))}/>{end}",
        "text": f"{start}{'x' * 5_000_000}{end}", "cut": whole[: len(whole) // 2],
        "cdata": f"{start}<![CDATA[{']' * 100_000}", "stylesheet": f'<?xml-stylesheet href="/etc/passwd"?>{whole}',
        "namespace": f'{start}<a:b/>{end}', "two_roots": whole + whole, "nothing": "", "root": f"<x>{inside}</x>",
        "encoding": f"<?xml version='1.0' encoding='ebcdic-cp-xx'?>{whole}",
        "version": f"<?xml version='9.0'?>{whole}",
    }  # fmt: skip
    contents = {kind: text.encode() for kind, text in found.items()}
    for kind, text in (("laughs", laughs), ("outer", outer)):
        head = "<?xml version='1.0' encoding='utf-16'?>"
        contents[f"{kind}_utf16"] = (head + text).encode("utf-16")
        contents[f"{kind}_utf16be"] = (head.replace("-16", "-16be") + text).encode("utf-16-be")
    return contents


def _urdf() -> dict[str, bytes]:
    arm = "".join(f'<link name="l{k}"/>' for k in range(8)) + "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="0 0 0.2" rpy="{k} 0 0"/><axis xyz="0 0 1"/>'
        '<limit lower="-2" upper="2" velocity="1" effort="1"/></joint>'
        for k in range(7)
    )
    start, end = '<robot name="r">', "</robot>"
    found = _xml(start, arm, end)

    def mesh(name):
        visual = f'<link name="m"><visual><geometry><mesh filename="{name}"/></geometry></visual>'
        joint = '<joint name="f" type="fixed"><parent link="l7"/><child link="m"/></joint>'
        return f"{start}{arm}{visual}</link>{joint}{end}".encode()

    changes = {
        "mimic": ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><mimic joint="j0" multiplier="1e300"/>'),
        "mimic_itself": ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><mimic joint="j0"/>'),
        "axis_tiny": ('xyz="0 0 1"', 'xyz="0 0 1e-200"'), "axis_huge": ('xyz="0 0 1"', 'xyz="0 0 1e99"'),
        "equal": ('rpy="0 0 0"', 'rpy="0 0 0" rpy="1 0 0"'),
        "newline": ('name="l7"', 'name="l7\n\n"'), "name_direction": ('"l7"', '"\u202el7"'),
        "lower_is_upper": ('lower="-2" upper="2"', 'lower="2" upper="2"'),
        "no_effort": (' effort="1"', ""), "no_limit": ('lower="-2" upper="2"', ""),
        "continuous": ('type="revolute"', 'type="continuous"'),
        "all_fixed": ('type="revolute"', 'type="fixed"'),
        "all_prismatic": ('type="revolute"', 'type="prismatic"'),
        "in_one_place": ('xyz="0 0 0.2"', 'xyz="0 0 0"'),
        "narrow": ('lower="-2" upper="2"', 'lower="0" upper="1e-9"'),
        "far": ('xyz="0 0 0.2"', 'xyz="0 0 99"'), "minute": ('xyz="0 0 0.2"', 'xyz="0 0 1e-9"'),
        "fast": ('velocity="1"', 'velocity="0.0011"'), "comma": ('xyz="0 0 0.2"', 'xyz="0,0,0.2"'),
    }  # fmt: skip
    for kind, (old, new) in changes.items():
        found[kind] = f"{start}{arm}{end}".replace(old, new).encode()
    for kind, name in {
        "passwd": "file:///etc/passwd", "zero": "/dev/zero", "up": "../" * 50 + "dev/zero",
        "package": "package://" + "a/" * 3000, "net": "http://127.0.0.1:9/a.stl", "empty": "",
        "null": "&#48;", "ftp": "ftp://127.0.0.1/a.stl", "folder": ".",
    }.items():  # fmt: skip
        found[f"mesh_{kind}"] = mesh(name)
    return found


def _xacro() -> dict[str, bytes]:
    start = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    found = {}
    for kind, expression in {
        "hang": "9**9**9", "memory": "'x' * 10**11", "list": "[0] * 10**11",
        "imports": "__import__('os').mkdir('ran-by-a-xacro')",
        "subclasses": "[c for c in [().__class__.__base__.__subclasses__()]]",
        "nested": "[[x for x in [1]] and [().__class__.__base__.__subclasses__() for y in [1]]]",
        "frame": "[(g := (g.gi_frame.f_back.f_back.f_globals for z in [1])), list(g)]",
        "function": "(lambda f: f(f))(lambda f: f(f))", "format": "'{0.__class__}'.format(1)",
        "yaml": "xacro.load_yaml('/etc/passwd')", "yaml_device": "xacro.load_yaml('/dev/zero')",
        "vars": "python.vars()", "type": "python.type('a', (), {})", "range": "list(python.range(10**10))",
        "nothing": "", "words": "a b c", "zero": "1/0", "deep": "(" * 300 + ")" * 300,
    }.items():  # fmt: skip
        found[kind] = f'{start}<link name="${{{expression}}}"/></robot>'.encode()
    for kind, inside in {
        "include_itself": '<xacro:include filename="include_itself.xacro"/>',
        "include_device": '<xacro:include filename="/dev/zero"/>',
        "include_passwd": '<xacro:include filename="/etc/passwd"/>',
        "include_find": '<xacro:include filename="$(find nothing)/a.xacro"/>',
        "eval": '<link name="$(eval 9**9**9)"/>', "env": '<link name="$(env HOME)"/>',
        "eval_class": '<link name="$(eval [().__class__ for x in [1]])"/>',
        "command": '<link name="$(command touch ran-by-a-xacro)"/>',
        "macro_itself": '<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>',
        "macro_twice": '<xacro:macro name="m"><xacro:m/><xacro:m/></xacro:macro><xacro:m/>',
        "property_itself": '<xacro:property name="a" value="${a}"/><link name="${a}"/>',
        "property_doubles": "".join(
            f'<xacro:property name="p{k + 1}" value="${{p{k} + p{k}}}"/>' for k in range(40)
        ).replace("${p0 + p0}", "xxxxxxxx") + '<link name="${p40}"/>',
        "no_such_macro": "<xacro:nothing/>", "empty_if": '<xacro:if value="words"><a/></xacro:if>',
    }.items():  # fmt: skip
        found[kind] = f"{start}{inside}</robot>".encode()
    return found


def _svg() -> dict[str, bytes]:
    start = (
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        'width="200mm" height="100mm" viewBox="0 0 200 100">'
    )
    line = '<path d="M 10 10 L 90 10 C 95 10 120 40 150 50" fill="none" stroke="black"/>'
    found = _xml(start, line, "</svg>")
    uses = '<path id="u0" d="M 0 0 L 1 1"/>' + "".join(
        f'<g id="u{k + 1}">' + f'<use xlink:href="#u{k}"/>' * 10 + "</g>" for k in range(9)
    )
    for kind, inside in {
        "use_itself": '<g id="a"><use xlink:href="#a"/></g>',
        "use_circle": '<g id="a"><use xlink:href="#b"/></g><g id="b"><use xlink:href="#a"/></g>',
        "uses": uses, "image": '<image xlink:href="file:///etc/passwd" width="5" height="5"/>',
        "image_net": '<image xlink:href="http://127.0.0.1:9/a.png" width="5" height="5"/>',
        "image_device": '<image xlink:href="/dev/zero" width="5" height="5"/>' + line,
        "segments": f'<path d="M 0 0 {"L 1 1 L 0 2 " * 50_000}"/>',
        "curves": f'<path d="M 0 0 {"C 1 1 2 2 3 1 " * 5_000}"/>',
        "arcs": f'<path d="M 0 0 {"A 5 5 0 1 1 3 3 " * 2_000}"/>',
        "arc_nan": '<path d="M 0 0 A nan nan 0 1 1 3 3"/>', "arc_zero": '<path d="M 0 0 A 0 0 0 1 1 3 3"/>',
        "arc_huge": '<path d="M 0 0 A 1e300 1e300 0 1 1 3 3"/>',
        "far": '<path d="M 0 0 C 1e300 0 0 1e300 5 5"/>', "long_line": '<path d="M 0 0 L 1e9 0"/>',
        "long_curve": '<path d="M 0 0 C 1e7 0 1e7 1e7 5 5"/>',
        "shift_nan": f'<g transform="translate(nan,inf)">{line}</g>', "flat": f'<g transform="scale(0)">{line}</g>',
        "turns": f'<g transform="{"rotate(1) " * 20_000}">{line}</g>', "matrix": f'<g transform="matrix(1)">{line}</g>',
        "strokes": '<path d="M 0 0 L 1 0"/>' * 5_000,
        "strokes_apart": "".join(f'<path d="M {k} 0 L {k} 1"/>' for k in range(3_000)),
        "chain": "".join(f'<path d="M {k} 0 L {k + 1} {k % 2}"/>' for k in range(3_000)),
        "circle": '<circle r="1e300"/>', "circle_minus": '<circle r="-5"/>', "circle_word": '<circle r="x"/>',
        "ellipse": '<ellipse rx="nan" ry="1"/>', "polyline": '<polyline points="1,2,3"/>',
        "polyline_words": '<polyline points="a,b c,d"/>', "rect": '<rect width="1e30" height="1e-30"/>',
        "text": "<text>words</text>", "script": "<script>while(1);</script>" + line,
        "style": "<style>@import url(file:///etc/passwd);" + "a{" * 20_000 + "</style>" + line,
        "path_words": '<path d="words"/>', "path_empty": '<path d=""/>', "moves": f'<path d="{"M 0 0 " * 50_000}"/>',
        "dashes": f'<g style="{"display:none;" * 50_000}">{line}</g>',
    }.items():  # fmt: skip
        found[kind] = f"{start}{inside}</svg>".encode()
    for kind, box in {
        "box_zero": "0 0 0 0", "box_nan": "nan nan nan nan", "box_huge": "0 0 1e-300 1e-300",
        "box_words": "a b c d", "box_short": "0 0", "box_minus": "0 0 -5 -5",
    }.items():  # fmt: skip
        found[kind] = f"{start}{line}</svg>".replace("0 0 200 100", box).encode()
    for kind, width in {
        "wide": "1e300mm",
        "width_nan": "nan",
        "parts": "100%",
        "parsec": "5pc",
    }.items():
        found[kind] = f"{start}{line}</svg>".replace("200mm", width).encode()
    return found


def _dxf() -> dict[str, bytes]:
    def file(entities: str, blocks: str = "", units: str = "4") -> bytes:
        parts = [
            f"0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1015\n9\n$INSUNITS\n70\n{units}\n0\nENDSEC\n"
        ]
        if blocks:
            parts.append(f"0\nSECTION\n2\nBLOCKS\n{blocks}0\nENDSEC\n")
        parts.append(f"0\nSECTION\n2\nENTITIES\n{entities}0\nENDSEC\n0\nEOF\n")
        return "".join(parts).encode()

    def line(*values):
        return "0\nLINE\n8\n0\n10\n{}\n20\n{}\n11\n{}\n21\n{}\n".format(*values)

    def insert(name, rows=1, more=""):
        return f"0\nINSERT\n8\n0\n2\n{name}\n10\n0\n20\n0\n{more}70\n{rows}\n71\n{rows}\n44\n1\n45\n1\n"

    def block(name, inside):
        return (
            f"0\nBLOCK\n8\n0\n2\n{name}\n70\n0\n10\n0\n20\n0\n3\n{name}\n{inside}0\nENDBLK\n8\n0\n"
        )

    valid = file(line(0, 0, 200, 0))
    nested = block("b0", line(0, 0, 1, 1)) + "".join(
        block(f"b{k + 1}", insert(f"b{k}") * 10) for k in range(9)
    )
    return {
        "million_inserts": file(insert("a", 10_000), block("a", line(0, 0, 1, 1))),
        "block_itself": file(insert("a"), block("a", insert("a"))),
        "blocks": file(insert("b9"), nested),
        "block_scale": file(insert("a", 1, "41\n0\n42\n0\n43\n0\n"), block("a", line(0, 0, 1, 1))),
        "no_block": file(insert("nothing")),
        "units_word": file(line(0, 0, 1, 0), units="words"), "units_99": file(line(0, 0, 1, 0), units="99"),
        "nan": file(line("nan", 0, "inf", 0)), "huge": file(line(0, 0, "1e300", 0)), "word": file(line("x", 0, 1, 0)),
        "long": file(line(0, 0, 10**9, 0)), "point": file(line(0, 0, 0, 0)),
        "lines": file("".join(line(k, 0, k, 1) for k in range(3_000))),
        "chain": file("".join(line(k, 0, k + 1, k % 2) for k in range(3_000))),
        "circle": file("0\nCIRCLE\n8\n0\n10\n0\n20\n0\n40\n1e300\n"),
        "circle_zero": file("0\nCIRCLE\n8\n0\n10\n0\n20\n0\n40\n0\n"),
        "circle_minus": file("0\nCIRCLE\n8\n0\n10\n0\n20\n0\n40\n-5\n"),
        "arc": file("0\nARC\n8\n0\n10\n0\n20\n0\n40\n5\n50\nnan\n51\n1e300\n"),
        "spline": file("0\nSPLINE\n8\n0\n70\n8\n71\n1000\n72\n2\n73\n2\n40\n0\n40\n1\n10\n0\n20\n0\n10\n1\n20\n1\n"),
        "spline_knots": file("0\nSPLINE\n8\n0\n70\n8\n71\n3\n72\n1000000000\n73\n1000000000\n10\n0\n20\n0\n"),
        "polyline": file("0\nLWPOLYLINE\n8\n0\n90\n1000000000\n70\n1\n10\n0\n20\n0\n"),
        "bulge": file("0\nLWPOLYLINE\n8\n0\n90\n2\n10\n0\n20\n0\n42\n1e300\n10\n5\n20\n0\n42\nnan\n"),
        "ellipse": file("0\nELLIPSE\n8\n0\n10\n0\n20\n0\n11\n0\n21\n0\n40\n0\n41\n0\n42\n1e9\n"),
        "outer": file("0\nINSERT\n8\n0\n2\nx\n10\n0\n20\n0\n", "0\nBLOCK\n8\n0\n2\nx\n70\n4\n1\n/etc/passwd\n0\nENDBLK\n"),
        "cut": valid[: len(valid) // 2], "binary": b"AutoCAD Binary DXF\r\n\x1a\0" + bytes(200),
        "dwg": b"AC1015" + bytes(500), "no_end": valid[:-8], "empty": b"", "codes": b"9999999999\nx\n" * 100,
        "group": b"0\nSECTION\n2\nENTITIES\n0\n" + b"X" * 1_000_000, "utf16": valid.decode().encode("utf-16"),
        "text": file("0\nTEXT\n8\n0\n10\n0\n20\n0\n40\n1\n1\nwords\n"), "image": file("0\nIMAGE\n8\n0\n10\n0\n20\n0\n340\nFFF\n"),
        "python": file("0\nLINE\n8\n__import__('os')\n10\n0\n20\n0\n11\n5\n21\n0\n"),
        "negative_codes": b"-5\nx\n0\nSECTION\n",
    }  # fmt: skip


def _usd() -> dict[str, bytes]:
    head = '#usda 1.0\n(\n upAxis = "Z"\n metersPerUnit = 1\n startTimeCode = 0\n endTimeCode = 2\n%s)\n'
    camera = 'def Camera "perspective" {}\n'
    sphere = 'def Sphere "s" { double radius = 1 }\n'

    def file(inside: str, more: str = "", camera: str = camera) -> bytes:
        text = head % more + 'def Xform "World" {\n' + inside + camera + "}\n"
        # A statement ends with its line.
        return text.replace("{ ", "{\n").replace(" }", "\n}").encode()

    def curve(points, counts="[3]", widths="[0.01]"):
        return (
            f'def BasisCurves "rod" {{ point3f[] points = {points}\n uniform token type = "linear"\n'
            f"int[] curveVertexCounts = {counts}\n float[] widths = {widths} }}\n"
        )

    def mesh(points, faces, counts="[3]"):
        return (
            f'def Mesh "m" {{ point3f[] points = {points}\n int[] faceVertexIndices = {faces}\n'
            f"int[] faceVertexCounts = {counts} }}\n"
        )

    three = "[(0,0,0),(1,0,0),(1,1,0)]"
    moved = 'def Sphere "s" { double radius = 1\n matrix4d xformOp:transform = %s\n'
    moved += 'uniform token[] xformOpOrder = ["xformOp:transform"] }\n'
    prims = "".join(f'def Sphere "s{k}" {{}}\n' for k in range(20_000))
    return {
        "nothing": file("", camera=""), "no_camera": file(sphere, camera=""), "cut": file(sphere)[:-30],
        "layer_itself": file(sphere, 'subLayers = [@layer_itself.usda@]\n'),
        "layer_passwd": file(sphere, "subLayers = [@/etc/passwd@]\n"),
        "layer_device": file(sphere, "subLayers = [@/dev/zero@]\n"),
        "layer_net": file(sphere, "subLayers = [@http://127.0.0.1:9/a.usd@]\n"),
        "reference_itself": file('def "a" ( references = @reference_itself.usda@</World> ) {}\n' + sphere),
        "reference_device": file('def "a" ( references = @/dev/zero@ ) {}\n' + sphere),
        "payload": file('def "a" ( payload = @/etc/passwd@ ) {}\n' + sphere),
        "times": file(sphere, "").replace(b"endTimeCode = 2", b"endTimeCode = 1e300"),
        "times_inf": file(sphere, "").replace(b"endTimeCode = 2", b"endTimeCode = inf"),
        "times_nan": file(sphere, "").replace(b"startTimeCode = 0", b"startTimeCode = nan"),
        "times_back": file(sphere, "").replace(b"endTimeCode = 2", b"endTimeCode = -5"),
        "radius_nan": file('def Sphere "s" { double radius = nan }\n'),
        "radius_minus": file('def Sphere "s" { double radius = -1 }\n'),
        "radius_inf": file('def Sphere "s" { double radius = inf }\n'),
        "radius_word": file('def Sphere "s" { double radius = "words" }\n'),
        "cylinder_x": file('def Cylinder "s" { uniform token axis = "X" }\n'),
        "cylinder_none": file('def Cylinder "s" { double height = None }\n'),
        "capsule_zero": file('def Capsule "s" { double height = 0\n double radius = 0 }\n'),
        "cube_none": file('def Cube "s" { double size = None }\n'),
        "curve_nan": file(curve("[(nan,0,0),(1,0,0),(1,1,0)]")), "curve_one": file(curve("[(0,0,0)]", "[1]")),
        "curve_none": file(curve("[]", "[]", "[]")), "curve_counts": file(curve(three, "[1000000000]")),
        "curve_minus": file(curve(three, "[-3]")), "curve_no_points": file('def BasisCurves "rod" {}\n'),
        "curve_huge": file(curve("[(1e38,0,0),(-1e38,0,0),(1,1,0)]")), "curve_same": file(curve("[(0,0,0),(0,0,0),(0,0,0)]")),
        "curve_long": file(curve("[" + ",".join(f"({k},0,0)" for k in range(50_000)) + "]", "[50000]")),
        "mesh_index": file(mesh(three, "[0,1,1000000]")), "mesh_minus": file(mesh(three, "[0,1,-5]")),
        "mesh_nan": file(mesh("[(nan,0,0),(1,0,0),(1,1,0)]", "[0,1,2]")), "mesh_none": file(mesh("[]", "[]", "[]")),
        "mesh_short": file(mesh(three, "[0]")), "mesh_counts": file(mesh(three, "[0,1,2]", "[3,3,3]")),
        "matrix_zero": file(moved % "((0,0,0,0),(0,0,0,0),(0,0,0,0),(0,0,0,0))"),
        "matrix_nan": file(moved % "((nan,0,0,0),(0,1,0,0),(0,0,1,0),(0,0,0,1))"),
        "matrix_flat": file(moved % "((1,0,0,0),(0,1,0,0),(0,0,0,0),(0,0,0,1))"),
        "prims": file(prims), "deep": file('def "a" {' * 3_000 + "}" * 3_000 + sphere), "deep_values": b"#usda 1.0\n(" + b"{" * 50_000,
        "name": file('def Sphere "été☃" {}\n'), "color": file('def Sphere "s" { color3f[] primvars:displayColor = [(nan,inf,-1)] }\n'),
        "color_none": file('def Sphere "s" { color3f[] primvars:displayColor = [] }\n'),
        "camera_zero": file(sphere, camera='def Camera "perspective" { float focalLength = 0\n float horizontalAperture = 0 }\n'),
        "camera_nan": file(sphere, camera='def Camera "perspective" { float focalLength = nan }\n'),
        "inherits": file('class "c" ( inherits = </World/c> ) {}\n' + sphere),
        "scale": file(sphere, "").replace(b"metersPerUnit = 1", b"metersPerUnit = 0"),
        "usdc": b"PXR-USDC\0\x08\0\0" + struct.pack("<q", 2**60) + bytes(200), "usdz": _zip({"a.usda": file(sphere)}),
        "usdz_bomb": _zip({"a.usda": b" " * 2**27}, **_QUICKLY), "words": b"words",
        "version": b"#usda 99.0\n", "samples": file(
            'def Sphere "s" { double radius.timeSamples = {'
            + ",".join(f"{k}: 1" for k in range(100_000)) + "} }\n"),
    }  # fmt: skip


def _meshes() -> dict[str, bytes]:
    solid = "solid a\nfacet normal 0 0 1\nouter loop\n%s\nendloop\nendfacet\nendsolid\n"
    corners = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0"
    ply = "ply\nformat %s 1.0\nelement vertex %s\nproperty float x\nproperty float y\nproperty float z\n"
    ply += "element face %s\nproperty list uchar int vertex_indices\nend_header\n%s"
    dae = '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
    gltf = {
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "scene": 0, "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 10**12, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 10**12}],
    }  # fmt: skip

    def buffer(uri, size=10**12):
        return json.dumps({**gltf, "buffers": [{"uri": uri, "byteLength": size}]}).encode()

    return {
        "lies.stl": bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(500),
        "short.stl": bytes(80) + struct.pack("<I", 2) + bytes(50), "empty.stl": b"", "zero.stl": bytes(84),
        "nan.stl": (solid % corners.replace("1 0 0", "nan 0 0")).encode(), "words.stl": (solid % "words").encode(),
        "two.stl": (solid % "vertex 0 0 0\nvertex 1 0 0").encode(), "far.stl": (solid % corners.replace("1", "1e38")).encode(),
        "point.stl": (solid % "vertex 0 0 0\nvertex 0 0 0\nvertex 0 0 0").encode(),
        "flat.stl": (solid % corners).encode(), "index.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 999999999\n",
        "minus.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -99\n", "nan.obj": b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "mtl.obj": b"mtllib /etc/passwd\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "mtl_zero.obj": b"mtllib /dev/zero\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "words.obj": b"v a b c\nf x y z\n", "polygon.obj": b"v 0 0 0\n" * 3 + b"f" + b" 1" * 100_000 + b"\n",
        "count.ply": (ply % ("ascii", 10**15, 1, "0 0 0\n")).encode(), "count_binary.ply": (ply % ("binary_little_endian", 10**15, 10**15, "")).encode(),
        "format.ply": (ply % ("words", 1, 1, "")).encode(), "minus.ply": (ply % ("ascii", -5, -5, "")).encode(),
        "count.off": b"OFF\n1000000000000 1000000000000 0\n0 0 0\n", "words.off": b"OFF\nwords\n", "short.off": b"OFF\n",
        "length.glb": b"glTF" + struct.pack("<III", 2, 2**32 - 1, 2**32 - 1) + b"JSON" + b"{}", "cut.glb": b"glTF\2\0",
        "passwd.gltf": buffer("/etc/passwd", 100), "zero.gltf": buffer("/dev/zero"), "net.gltf": buffer("http://127.0.0.1:9/a"),
        "data.gltf": buffer("data:application/octet-stream;base64," + "A" * 1000), "up.gltf": buffer("../../../../../etc/passwd", 100),
        "deep.gltf": b'{"a":' * 100_000, "words.gltf": b"words", "nodes.gltf": json.dumps({**gltf, "nodes": [{"children": [0], "mesh": 0}]}).encode(),
        "bomb.3mf": _zip({"3D/3dmodel.model": b" " * 2**27}, **_QUICKLY), "empty.3mf": _zip({}), "words.3mf": b"words",
        "laughs.3mf": _zip({"3D/3dmodel.model": _xml("<model>", "", "</model>")["laughs"]}),
        **{f"{kind}.dae": text for kind, text in _xml(dae, "<library_geometries/>", "</COLLADA>").items()},
        "unit.dae": f'{dae}<asset><unit meter="1e999"/></asset></COLLADA>'.encode(),
        "unknown.xyz": b"0 0 0\n", "long.stl": b"solid " + b"x" * 3_000_000,
    }  # fmt: skip


_FAMILIES = {
    "texts": _texts, "json": _json, "arrays": _arrays, "tensors": _tensors, "pictures": _pictures,
    "urdf": _urdf, "xacro": _xacro, "svg": _svg, "dxf": _dxf, "usd": _usd, "meshes": _meshes,
}  # fmt: skip
