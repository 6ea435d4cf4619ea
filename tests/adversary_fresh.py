# ruff: noqa: E501  # contents of files, which no line break helps
"""A table of hostile calls of one sort each (tests/adversary.py --listed): files that are well formed
and mean what cannot be, formats of other programs, odd ways to say an option, places that are both
read and written, and surroundings of machines that are not set up as ours.

`table(files)` gives, by "command what", what makes the call in a folder: its words and what is
around it.
"""

from __future__ import annotations

import copy
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from adversary_kinds import MORE, UNABLE
from adversary_material import VALID

Made = tuple[list[str], object]


def table(files: dict[str, str]) -> dict[str, Callable[[Path], Made]]:
    """All calls by what they are."""
    found: dict[str, Callable[[Path], Made]] = {}
    for part in (_files, _spellings, _surroundings, _shared_places, _left_overs):
        found |= part(files)
    return found


def _with_file(name: str, words: list[str], read: str, file: str, content) -> Callable:
    def make(folder: Path) -> Made:
        folder.mkdir(parents=True, exist_ok=True)
        text = content() if callable(content) else content
        (folder / file).write_bytes(text if isinstance(text, bytes) else text.encode())
        return [*name.split(), *(str(folder / file) if w == read else w for w in words)], None

    return make


# ---- files that mean what cannot be -------------------------------------------------------------

SHOW = ["{x}", "--rod", "green-vps", "--out", "{out}.png"]
FAR = ["--no-remedy", "--lay-only", "--placement", "9,9,0,0"]
PLAN = ["line", "--rod", "green-vps", "--method", "intuitive", "--spacing", "0.02", "--no-expect",
        "--out", "{out}"]  # fmt: skip
ROD_CHANGES: dict[str, dict] = {
    "fatter than long": {"radius": 0.5},
    "a hair": {"radius": 1e-9},
    "an atom": {"radius": 1e-15},
    "a ship's": {"radius": 10.0, "gravito_bending_length": 300.0, "length": 1e4},
    "no length": {"length": 1e-12},
    "a mile": {"length": 1600.0},
    "to the moon": {"length": 4e8},
    "stiff": {"gravito_bending_length": 1e3},
    "limp": {"gravito_bending_length": 1e-6},
    "auxetic": {"poisson": -0.999},
    "beyond poisson": {"poisson": 0.5000001},
    "poisson -1": {"poisson": -1.0},
    "aerogel": {"density": 1e-6},
    "neutron star": {"density": 1e17},
    "no gravity": {"gravity": 0.0},
    "upward": {"gravity": -9.81},
    "Jupiter": {"gravity": 1e4},
    "a coil": {"natural_curvature": [1e6, 0.0]},
    "three curvatures": {"natural_curvature": [0.1, 0.2, 0.3]},
    "one curvature": {"natural_curvature": 0.5},
    "nested": {"natural_curvature": [[0.1, 0.2]]},
    "with a unit": {"radius": "1.6 mm"},
    "a list": {"radius": [0.0016]},
    "a range": {"radius": {"min": 0.001, "max": 0.002}},
    "true": {"radius": True},
    "a comment": {"_comment": "words"},
    "a schema": {"$schema": "http://127.0.0.1:9/rod.json"},
    "camel": {"gravitoBendingLength": 0.03},
    "a Greek key": {"ρ": 1180.0},
    "a twin key": {"radius ": 0.0016},
    "other format": {"format": "wrod-rod-2"},
    "format a number": {"format": 1},
    "format upper": {"format": "WROD-ROD-1"},
    "format model": {"format": "wrod-rod-model-1"},
    "assumed a number": {"assumed": 3},
    "assumed of none": {"assumed": ["nothing"]},
    "a million keys": {f"k{k}": k for k in range(200_000)},
}
OBSTACLES = {
    "around the robot": '[{"kind": "sphere", "size": 5, "xyz": [0, 0, 0]}]',
    "of no size": '[{"kind": "sphere", "size": 0, "xyz": [0, 0, 2]}]',
    "inside out": '[{"kind": "box", "size": [-1, -1, -1], "xyz": [0, 0, 2]}]',
    "two sizes": '[{"kind": "box", "size": [1, 1], "xyz": [0, 0, 2]}]',
    "flat": '[{"kind": "box", "size": [1, 1, 0], "xyz": [0, 0, 2]}]',
    "unknown": '[{"kind": "torus", "size": 1, "xyz": [0, 0, 2]}]',
    "far": '[{"kind": "sphere", "size": 1, "xyz": [1e300, 0, 0]}]',
    "plane": '[{"kind": "plane", "xyz": [0, 0, 0]}]',
    "many": lambda: json.dumps([{"kind": "sphere", "size": 0.01, "xyz": [0, 0, 2]}] * 20_000),
    "one not in a list": '{"kind": "sphere", "size": 0.05, "xyz": [0, 0, 2]}',
    "of nothing": "[]",
    "mesh": '[{"kind": "mesh", "path": "/dev/zero", "xyz": [0, 0, 2]}]',
    "turned by nan": '[{"kind": "box", "size": [1, 1, 1], "xyz": [0, 0, 2], "rpy": [NaN, 0, 0]}]',
    "a quaternion": '[{"kind": "box", "size": [1, 1, 1], "xyz": [0, 0, 2], "quat": [0, 0, 0, 0]}]',
    "names twice": '[{"kind": "sphere", "size": 1, "xyz": [0, 0, 9], "name": "a"}, {"kind": "sphere", "size": 1, "xyz": [0, 0, 9], "name": "a"}]',
}
FRICTIONS = {
    "of oil": '{"format": "wrod-table-1", "friction": 0, "log_error": 0.1}',
    "of glue": '{"format": "wrod-table-1", "friction": 1e9, "log_error": 0.1}',
    "below zero": '{"format": "wrod-table-1", "friction": -0.4, "log_error": 0.1}',
    "unsure": '{"format": "wrod-table-1", "friction": 0.4, "log_error": 1e9}',
    "sure": '{"format": "wrod-table-1", "friction": 0.4, "log_error": 0}',
    "sure below": '{"format": "wrod-table-1", "friction": 0.4, "log_error": -1}',
    "of text": '{"format": "wrod-table-1", "friction": "0.4", "log_error": "0.1"}',
    "of a range": '{"format": "wrod-table-1", "friction": [0.2, 0.6], "log_error": 0.1}',
    "without error": '{"format": "wrod-table-1", "friction": 0.4}',
    "of another": '{"format": "wrod-rod-1", "friction": 0.4}',
}
CAMERAS = {
    "no focus": {"camera_matrix": [[0, 0, 100], [0, 0, 75], [0, 0, 1]]},
    "behind": {"camera_matrix": [[-900, 0, 100], [0, -900, 75], [0, 0, 1]]},
    "last row": {"camera_matrix": [[900, 0, 100], [0, 900, 75], [0, 0, 0]]},
    "turned": {"camera_matrix": [[900, 0, 0], [0, 900, 0], [100, 75, 1]]},
    "skew": {"camera_matrix": [[900, 1e9, 100], [0, 900, 75], [0, 0, 1]]},
    "centre off": {"camera_matrix": [[900, 0, 1e9], [0, 900, 1e9], [0, 0, 1]]},
    "wide": {"camera_matrix": [[1e-6, 0, 100], [0, 1e-6, 75], [0, 0, 1]]},
    "12 coefficients": {"distortion": [0.1] * 12},
    "13 coefficients": {"distortion": [0.1] * 13},
    "strong": {"distortion": [1e5, -1e9, 0, 0, 1e9]},
    "fisheye": {"model": "fisheye", "distortion": [0.1] * 4},
    "nested coefficients": {"distortion": [[0.1, 0.1, 0, 0, 0]]},
    "3 x 4": {"camera_matrix": [[900, 0, 100, 0], [0, 900, 75, 0], [0, 0, 1, 0]]},
    "OpenCV's YAML": {"camera_matrix": {"rows": 3, "cols": 3, "dt": "d", "data": [900] * 9}},
    "a size": {"image_width": 1, "image_height": 1},
}
LAYOUTS = {
    "one marker": {"0": [[0, 0], [0.02, 0], [0.02, -0.02], [0, -0.02]]},
    "a point": {str(k): [[0, 0]] * 4 for k in range(4)},
    "mirrored": {str(k): [[k, 0], [k, 0.02], [k + 0.02, 0.02], [k + 0.02, 0]] for k in range(4)},
    "three corners": {str(k): [[k, 0], [k + 0.02, 0], [k, 0.02]] for k in range(4)},
    "of words": {"north": [[0, 0], [0.02, 0], [0.02, -0.02], [0, -0.02]]},
    "of minus": {"-1": [[0, 0], [0.02, 0], [0.02, -0.02], [0, -0.02]]},
    "of many": {
        str(10**9 + k): [[k, 0], [k + 0.1, 0], [k + 0.1, -0.1], [k, -0.1]] for k in range(3000)
    },
    "in space": {str(k): [[k, 0, 0], [k + 0.02, 0, 0], [k, 0.02, 0], [k, 0, 1]] for k in range(4)},
    "of none": {},
}
# Tables and drawings of points by programs that nobody here has.
POINTS: dict[str, tuple[str, bytes | str | Callable]] = {
    "G-code": ("x.gcode", "G21\nG90\nG1 X0 Y0 F100\nG1 X100 Y0\nG2 X120 Y20 I0 J20\nM30\n"),
    "G-code as text": ("x.txt", "G1 X0 Y0\nG1 X100 Y0\n"),
    "GPX": ("x.gpx", '<gpx><trk><trkseg><trkpt lat="1" lon="2"/></trkseg></trk></gpx>'),
    "GeoJSON": ("x.geojson", '{"type": "LineString", "coordinates": [[0, 0], [1, 1]]}'),
    "GeoJSON as JSON": ("x.json", '{"type": "LineString", "coordinates": [[0, 0], [1, 1]]}'),
    "JSON points": ("x.json", "[[0, 0], [0.1, 0], [0.2, 0.1]]"),
    "WKT": ("x.txt", "LINESTRING (0 0, 0.1 0, 0.2 0.1)"),
    "HPGL": ("x.plt", "IN;SP1;PU0,0;PD1000,0,1000,1000;PU;"),
    "PostScript": ("x.eps", "%!PS-Adobe-3.0\nnewpath 0 0 moveto 100 100 lineto stroke showpage\n"),
    "PDF": ("x.pdf", "%PDF-1.4\n1 0 obj<<>>endobj\ntrailer<<>>\n%%EOF"),
    "TikZ": ("x.tex", "\\draw (0,0) -- (1,1);"),
    "TOML": ("x.toml", "points = [[0, 0], [1, 1]]\n"),
    "YAML": ("x.yaml", "- [0, 0]\n- [1, 1]\n- !!python/object/apply:os.system ['id']\n"),
    "STEP": ("x.step", "ISO-10303-21;\nHEADER;\nENDSEC;\nEND-ISO-10303-21;\n"),
    "PLY": ("x.ply", "ply\nformat ascii 1.0\nelement vertex 2\nend_header\n0 0 0\n1 1 1\n"),
    "OBJ": ("x.obj", "v 0 0 0\nv 1 1 0\nl 1 2\n"),
    "XYZ": ("x.xyz", "0 0 0\n0.1 0 0\n0.2 0.1 0\n"),
    "DAT": ("x.dat", "0 0\n0.1 0\n0.2 0.1\n"),
    "LVM": ("x.lvm", "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\n0\t0\n"),
    "MATLAB's": ("x.m", "p = [0 0; 0.1 0; 0.2 0.1];"),
    "R's": ("x.csv", '"","x","y"\n"1",0,0\n"2",0.1,0\n"3",0.2,0.1\n'),
    "pandas'": ("x.csv", ",x,y\n0,0,0\n1,0.1,0\n2,0.2,0.1\n"),
    "thousands": ("x.csv", "x;y\n1.000,5;2.000,5\n3.000,5;4.000,5\n5.000;6.000\n"),
    "Swiss": ("x.csv", "x,y\n1'000,2'000\n3'000,4'000\n"),
    "mixed units": ("x.csv", "x [mm],y [m]\n0,0\n100,0.1\n200,0\n"),
    "two units": ("x.csv", "# units: mm\n# units: m\n0,0\n100,0\n200,10\n"),
    "latitudes": ("x.csv", "lat,lon\n48.1,11.5\n48.2,11.6\n48.3,11.5\n"),
    "polar": ("x.csv", "r,theta\n1,0\n1,90\n1,180\n"),
    "y first": ("x.csv", "y,x\n0,0\n0.1,0.1\n0.3,0.2\n"),
    "x twice": ("x.csv", "x,x\n0,0\n0.1,0.1\n0.3,0.2\n"),
    "x y z": ("x.csv", "x,y,z\n0,0,0\n0.1,0.1,5\n0.3,0.2,9\n"),
    "t x y": ("x.csv", "t,x,y\n0,0,0\n1,0.1,0.1\n2,0.3,0.2\n"),
    "time and z": ("x.csv", "time,x,y,z\n0,0,0,0\n1,0.1,0.1,0\n2,0.3,0.2,0\n"),
    "one column": ("x.csv", "x\n0\n0.1\n0.2\n"),
    "alternating": ("x.txt", "0\n0\n0.1\n0\n0.2\n0.1\n"),
    "in brackets": ("x.txt", "[0, 0],\n[0.1, 0],\n[0.2, 0.1]\n"),
    "in parentheses": ("x.txt", "(0, 0)\n(0.1, 0)\n(0.2, 0.1)\n"),
    "complex": ("x.txt", "0+0j\n0.1+0.1j\n0.2+0j\n"),
    "Fortran's": ("x.txt", "0.0D+00 0.0D+00\n1.0D-01 0.0D+00\n2.0D-01 1.0D-01\n"),
    "Unicode minus": ("x.txt", "0 0\n0.1 −0.1\n0.2 0\n"),
    "stars": ("x.txt", "0 0\n0.1 *****\n0.2 0\n"),
    "a log": ("x.txt", "2026-01-01 INFO 0.0 0.0\n2026-01-01 INFO 0.1 0.0\n"),
    "NUL between": ("x.txt", b"0 0\x00\n0.1 0\x00\n0.2 0.1\x00\n"),
    "form feeds": ("x.txt", "0 0\f0.1 0\f0.2 0.1\f"),
    "line separators": ("x.txt", "0 0\u20280.1 0\u20280.2 0.1\u2028"),
    "no-break spaces": ("x.txt", "0\u00a00\n0.1\u00a00\n0.2\u00a00.1\n"),
    "a spike": ("x.csv", lambda: "x,y\n" + "".join(f"{k / 1000},{0.0 if k != 150 else 0.2}\n" for k in range(300))),
    "a lattice": ("x.csv", lambda: "x,y\n" + "".join(f"{k % 20},{k // 20}\n" for k in range(400))),
    "noise": ("x.csv", lambda: "x,y\n" + "".join(f"{a},{b}\n" for a, b in np.random.default_rng(0).normal(size=(500, 2)))),
    "a spiral of thousands": ("x.csv", lambda: "x,y\n" + "".join(f"{1e-4 * k * np.cos(k)},{1e-4 * k * np.sin(k)}\n" for k in range(5000))),
    "closed": ("x.csv", lambda: "x,y\n" + "".join(f"{0.1 * np.cos(k / 30)},{0.1 * np.sin(k / 30)}\n" for k in range(189))),
    "a knot": ("x.csv", lambda: "x,y\n" + "".join(f"{0.1 * np.sin(k / 50)},{0.1 * np.sin(k / 25)}\n" for k in range(320))),
    "a corner": ("x.csv", lambda: "x,y\n" + "".join(f"{min(k, 50) / 500},{max(k - 50, 0) / 500}\n" for k in range(100))),
    "in nanometres": ("x.csv", lambda: "x,y\n" + "".join(f"{k * 1e6},0\n" for k in range(300))),
    "off by a light year": ("x.csv", lambda: "x,y\n" + "".join(f"{1e16 + k},0\n" for k in range(300))),
    "at 1e8": ("x.csv", lambda: "x,y\n" + "".join(f"{1e8 + k / 1000},0\n" for k in range(300))),
    "each thrice": ("x.csv", lambda: "x,y\n" + "".join(f"{k // 3 / 300},0\n" for k in range(300))),
    "back a bit": ("x.csv", lambda: "x,y\n" + "".join(f"{(k - 3 * (k % 10 == 9)) / 500},0\n" for k in range(200))),
    "1e-12 apart": ("x.csv", lambda: "x,y\n" + "".join(f"{k * 1e-12},0\n" for k in range(300))),
    "npy of structure": ("x.npy", lambda: _npy(np.zeros(3, [("x", "f8"), ("y", "f8")]))),
    "npy of objects": ("x.npy", lambda: _npy(np.array([[0, 0], [1, None]], dtype=object))),
    "npy of three axes": ("x.npy", lambda: _npy(np.zeros((3, 2, 2)))),
    "npy of no axes": ("x.npy", lambda: _npy(np.array(3.0))),
    "npy turned": ("x.npy", lambda: _npy(np.linspace(0, 1, 40).reshape(2, 20))),
    "npy of text": ("x.npy", lambda: _npy(np.array([["0", "0"], ["0.1", "0"]]))),
    "npy of times": ("x.npy", lambda: _npy(np.zeros((3, 2), "M8[s]"))),
    "npy of 4 rows": ("x.npy", lambda: _npy(np.zeros((4, 4)))),
    "npy cut": ("x.npy", lambda: _npy(np.zeros((50, 2)))[:-8]),
    "npy longer": ("x.npy", lambda: _npy(np.cumsum(np.full((50, 2), 0.01), 0)) + b"x" * 80),
    "npy two": ("x.npy", lambda: _npy(np.zeros((5, 2))) * 2),
    "npy version 9": ("x.npy", lambda: _npy(np.zeros((5, 2))).replace(b"NUMPY\x01", b"NUMPY\x09")),
    "npy of code": ("x.npy", b"\x93NUMPY\x01\x00\x46\x00{'descr': __import__('os').system('touch ran-by-npy'), 'shape': (1,)}\n"),
}  # fmt: skip


def _npy(array) -> bytes:
    import io

    into = io.BytesIO()
    np.save(into, array, allow_pickle=True)
    return into.getvalue()


def _svg(content: str, words: str = 'width="200mm" height="100mm" viewBox="0 0 200 100"') -> str:
    return f'<svg xmlns="http://www.w3.org/2000/svg" {words}>{content}</svg>'


_D = "M 10 50 C 60 10 120 90 190 50"
DRAWINGS: dict[str, tuple[str, object]] = {
    "polyline": ("x.svg", _svg('<polyline points="10,50 60,40 190,50" fill="none"/>')),
    "polyline odd": ("x.svg", _svg('<polyline points="10,50 60"/>')),
    "polyline of nan": ("x.svg", _svg('<polyline points="10,nan 60,40"/>')),
    "polygon": ("x.svg", _svg('<polygon points="10,50 60,40 190,50"/>')),
    "line": ("x.svg", _svg('<line x1="10" y1="50" x2="190" y2="50"/>')),
    "line of none": ("x.svg", _svg("<line/>")),
    "circle": ("x.svg", _svg('<circle cx="100" cy="50" r="40"/>')),
    "circle of none": ("x.svg", _svg('<circle r="0"/>')),
    "circle below": ("x.svg", _svg('<circle r="-5"/>')),
    "ellipse": ("x.svg", _svg('<ellipse cx="100" cy="50" rx="40" ry="0"/>')),
    "rect": ("x.svg", _svg('<rect x="1" y="1" width="50" height="50" rx="9"/>')),
    "text": ("x.svg", _svg("<text x='10' y='20'>rod</text>")),
    "image": ("x.svg", _svg('<image href="/dev/zero" width="9" height="9"/>')),
    "link": ("x.svg", _svg('<a href="javascript:alert(1)"><path d="M 10 50 L 190 50"/></a>')),
    "foreign object": ("x.svg", _svg("<foreignObject><body/></foreignObject>")),
    "nested svg": ("x.svg", _svg(_svg(f'<path d="{_D}"/>', 'viewBox="0 0 0 0"'))),
    "symbol": ("x.svg", _svg(f'<symbol id="a"><path d="{_D}"/></symbol>')),
    "defs": ("x.svg", _svg(f'<defs><path d="{_D}"/></defs>')),
    "marker": ("x.svg", _svg(f'<marker id="a"><path d="M0 0L1 1"/></marker><path d="{_D}"/>')),
    "clip": ("x.svg", _svg(f'<clipPath><path d="{_D}"/></clipPath>')),
    "animated": ("x.svg", _svg(f'<path d="{_D}"><animate attributeName="d" to="M0 0"/></path>')),
    "style sheet": ("x.svg", _svg(f'<style>@import url(http://127.0.0.1:9/x.css); path{{d: path("M0 0")}}</style><path d="{_D}"/>')),
    "in percent": ("x.svg", _svg(f'<path d="{_D}"/>', 'width="100%" height="100%"')),
    "in em": ("x.svg", _svg(f'<path d="{_D}"/>', 'width="9em" height="4ex"')),
    "of no size": ("x.svg", _svg(f'<path d="{_D}"/>', 'width="0" height="0" viewBox="0 0 200 100"')),
    "size nan": ("x.svg", _svg(f'<path d="{_D}"/>', 'width="nanmm" height="1e999mm"')),
    "size below": ("x.svg", _svg(f'<path d="{_D}"/>', 'width="-200mm" height="-100mm" viewBox="0 0 200 100"')),
    "view box below": ("x.svg", _svg(f'<path d="{_D}"/>', 'width="200mm" viewBox="0 0 -200 100"')),
    "view box of 3": ("x.svg", _svg(f'<path d="{_D}"/>', 'width="200mm" viewBox="0 0 200"')),
    "view box huge": ("x.svg", _svg(f'<path d="{_D}"/>', 'width="1mm" viewBox="0 0 1e308 1e308"')),
    "slice": ("x.svg", _svg(f'<path d="{_D}"/>', 'width="200mm" height="7mm" viewBox="0 0 200 100" preserveAspectRatio="xMaxYMin slice"')),
    "transform words": ("x.svg", _svg(f'<path d="{_D}" transform="spin(3)"/>')),
    "transform short": ("x.svg", _svg(f'<path d="{_D}" transform="matrix(1,0,0"/>')),
    "transform many": ("x.svg", _svg(f'<path d="{_D}" transform="{"scale(1.1) " * 9000}"/>')),
    "scaled 1e-300": ("x.svg", _svg(f'<g transform="scale(1e-300)"><path d="{_D}"/></g>')),
    "paths by the thousand": ("x.svg", _svg(f'<path d="{_D}"/>' * 5000)),
    "two ids": ("x.svg", _svg(f'<path id="a" d="{_D}"/><path id="a" d="M 0 0 L 1 1"/>')),
    "arc huge": ("x.svg", _svg('<path d="M 10 50 A 1e9 1e9 0 1 1 190 50"/>')),
    "arc flat": ("x.svg", _svg('<path d="M 10 50 A 50 1e-9 45 1 0 190 50"/>')),
    "arc to itself": ("x.svg", _svg('<path d="M 10 50 A 50 50 0 1 1 10 50"/>')),
    "a cusp": ("x.svg", _svg('<path d="M 10 50 C 190 50 10 50 190 50"/>')),
    "a cusp in one": ("x.svg", _svg('<path d="M 10 50 C 190 90 10 90 190 50"/>')),
    "a point of a curve": ("x.svg", _svg('<path d="M 10 50 C 10 50 10 50 10 50"/>')),
    "smooth first": ("x.svg", _svg('<path d="M 10 50 S 60 10 190 50 T 5 5"/>')),
    "big jump": ("x.svg", _svg('<path d="M 10 50 L 90 50 M 91 50 L 190 50"/>')),
    "Z then on": ("x.svg", _svg('<path d="M 10 50 L 90 50 L 50 90 Z L 190 50"/>')),
    "exponents": ("x.svg", _svg('<path d="M1e1.5.5-5e1L1E+2-.5"/>')),
    "comma at the end": ("x.svg", _svg('<path d="M 10 50 L 190 50,"/>')),
    "svgz": ("x.svg", lambda: __import__("gzip").compress(_svg(f'<path d="{_D}"/>').encode())),
    "named svgz": ("x.svgz", lambda: __import__("gzip").compress(_svg(f'<path d="{_D}"/>').encode())),
    "no namespace": ("x.svg", f'<svg><path d="{_D}"/></svg>'),
    "HTML with it": ("x.svg", f'<html><body><svg><path d="{_D}"/></svg></body></html>'),
    "layers": ("x.svg", _svg(f'<g inkscape:label="L" xmlns:inkscape="x"><path d="{_D}"/></g>')),
    "undeclared prefix": ("x.svg", _svg(f'<inkscape:g><path d="{_D}"/></inkscape:g>')),
    "stroke of nothing": ("x.svg", _svg(f'<path d="{_D}" stroke="url(#none)" stroke-width="1e999"/>')),
}  # fmt: skip


def _dxf(*entities: str, header: str = "") -> str:
    head = f"0\nSECTION\n2\nHEADER\n{header}0\nENDSEC\n" if header else ""
    return head + "0\nSECTION\n2\nENTITIES\n" + "".join(entities) + "0\nENDSEC\n0\nEOF\n"


def _line(x="0", y="0", to="300", up="0") -> str:
    return f"0\nLINE\n8\n0\n10\n{x}\n20\n{y}\n30\n0\n11\n{to}\n21\n{up}\n31\n0\n"


_LW = "0\nLWPOLYLINE\n8\n0\n90\n{n}\n70\n{closed}\n{points}"
DXF = {
    "line": _dxf(_line()),
    "line of nan": _dxf(_line(to="nan")),
    "line of 1e308": _dxf(_line(to="1e308")),
    "line of words": _dxf(_line(to="words")),
    "line of none": _dxf(_line(to="0")),
    "two lines": _dxf(_line(), _line(y="50", up="50")),
    "chained": _dxf(_line(), _line(x="300", to="400", up="80")),
    "up": _dxf(_line().replace("31\n0\n", "31\n90\n")),
    "polyline": _dxf(_LW.format(n=3, closed=0, points="10\n0\n20\n0\n10\n99\n20\n9\n10\n300\n20\n0\n")),
    "polyline closed": _dxf(_LW.format(n=3, closed=1, points="10\n0\n20\n0\n10\n99\n20\n9\n10\n300\n20\n0\n")),
    "polyline of a lie": _dxf(_LW.format(n=10**9, closed=0, points="10\n0\n20\n0\n")),
    "polyline of one": _dxf(_LW.format(n=1, closed=0, points="10\n0\n20\n0\n")),
    "bulge 1e308": _dxf(_LW.format(n=2, closed=0, points="10\n0\n20\n0\n42\n1e308\n10\n300\n20\n0\n")),
    "bulge nan": _dxf(_LW.format(n=2, closed=0, points="10\n0\n20\n0\n42\nnan\n10\n300\n20\n0\n")),
    "arc": _dxf("0\nARC\n8\n0\n10\n0\n20\n0\n40\n100\n50\n0\n51\n180\n"),
    "arc of none": _dxf("0\nARC\n8\n0\n10\n0\n20\n0\n40\n0\n50\n0\n51\n180\n"),
    "arc below": _dxf("0\nARC\n8\n0\n10\n0\n20\n0\n40\n-100\n50\n0\n51\n180\n"),
    "arc of 1e9 turns": _dxf("0\nARC\n8\n0\n10\n0\n20\n0\n40\n100\n50\n0\n51\n3.6e11\n"),
    "circle": _dxf("0\nCIRCLE\n8\n0\n10\n0\n20\n0\n40\n100\n"),
    "circle of 1e300": _dxf("0\nCIRCLE\n8\n0\n10\n0\n20\n0\n40\n1e300\n"),
    "ellipse": _dxf("0\nELLIPSE\n8\n0\n10\n0\n20\n0\n11\n100\n21\n0\n31\n0\n40\n0.5\n41\n0\n42\n3\n"),
    "ellipse flat": _dxf("0\nELLIPSE\n8\n0\n10\n0\n20\n0\n11\n100\n21\n0\n31\n0\n40\n0\n41\n0\n42\n3\n"),
    "ellipse of none": _dxf("0\nELLIPSE\n8\n0\n10\n0\n20\n0\n11\n0\n21\n0\n31\n0\n40\n0.5\n41\n0\n42\n3\n"),
    "spline": _dxf("0\nSPLINE\n8\n0\n71\n3\n72\n8\n73\n4\n" + "40\n0\n" * 4 + "40\n1\n" * 4 + "10\n0\n20\n0\n10\n99\n20\n90\n10\n200\n20\n-90\n10\n300\n20\n0\n"),
    "spline of no knots": _dxf("0\nSPLINE\n8\n0\n71\n3\n10\n0\n20\n0\n10\n99\n20\n90\n"),
    "spline of degree 99": _dxf("0\nSPLINE\n8\n0\n71\n99\n10\n0\n20\n0\n10\n99\n20\n90\n10\n200\n20\n0\n"),
    "spline of degree 0": _dxf("0\nSPLINE\n8\n0\n71\n0\n10\n0\n20\n0\n10\n99\n20\n90\n10\n200\n20\n0\n"),
    "spline falling": _dxf("0\nSPLINE\n8\n0\n71\n1\n40\n3\n40\n2\n40\n1\n40\n0\n10\n0\n20\n0\n10\n99\n20\n90\n"),
    "insert of none": _dxf("0\nINSERT\n8\n0\n2\nNOTHING\n10\n0\n20\n0\n"),
    "insert of itself": "0\nSECTION\n2\nBLOCKS\n0\nBLOCK\n8\n0\n2\nA\n70\n0\n10\n0\n20\n0\n0\nINSERT\n8\n0\n2\nA\n10\n1\n20\n1\n0\nENDBLK\n0\nENDSEC\n" + _dxf("0\nINSERT\n8\n0\n2\nA\n10\n0\n20\n0\n"),
    "a grid of inserts": _dxf("0\nINSERT\n8\n0\n2\nA\n10\n0\n20\n0\n70\n30000\n71\n30000\n"),
    "text": _dxf("0\nTEXT\n8\n0\n10\n0\n20\n0\n40\n9\n1\nrod\n"),
    "hatch": _dxf("0\nHATCH\n8\n0\n10\n0\n20\n0\n"),
    "picture": _dxf("0\nIMAGE\n8\n0\n10\n0\n20\n0\n1\n/dev/zero\n"),
    "point": _dxf("0\nPOINT\n8\n0\n10\n0\n20\n0\n"),
    "ray": _dxf("0\nRAY\n8\n0\n10\n0\n20\n0\n11\n1\n21\n0\n"),
    "units 99": _dxf(_line(), header="9\n$INSUNITS\n70\n99\n"),
    "units below": _dxf(_line(), header="9\n$INSUNITS\n70\n-1\n"),
    "units of words": _dxf(_line(), header="9\n$INSUNITS\n70\nmm\n"),
    "parsecs": _dxf(_line(), header="9\n$INSUNITS\n70\n20\n"),
    "angstroms": _dxf(_line(), header="9\n$INSUNITS\n70\n11\n"),
    "version none": _dxf(_line(), header="9\n$ACADVER\n1\nAC9999\n"),
    "version 1.0": _dxf(_line(), header="9\n$ACADVER\n1\nMC0.0\n"),
    "encoding none": _dxf(_line(), header="9\n$DWGCODEPAGE\n3\nANSI_0\n"),
    "no end": _dxf(_line())[:-20],
    "odd lines": _dxf(_line()) + "0\n",
    "a layer of none": _dxf(_line().replace("8\n0\n", "8\nNOTHING\n")),
    "frozen": _dxf(_line().replace("8\n0\n", "8\n0\n60\n1\n")),
    "a handle twice": _dxf(*[_line().replace("8\n0\n", "5\n1F\n8\n0\n", 1)] * 2),
    "extruded": _dxf(_line() + "210\n0\n220\n0\n230\n-1\n"),
    "extruded nowhere": _dxf(_line() + "210\n0\n220\n0\n230\n0\n"),
    "binary": b"AutoCAD Binary DXF\r\n\x1a\x00" + bytes(99),
    "DWG": b"AC1032" + bytes(99),
    "thousands": _dxf(_line() * 20_000),
}  # fmt: skip


def _urdfs(text: str) -> dict[str, str]:
    """Of the Sawyer."""

    def inside(content: str) -> str:
        return text.replace("</robot>", content + "</robot>")

    def first(old: str, new: str) -> str:
        return text.replace(old, new, 1)

    def joint(content: str) -> str:
        return text.replace("</joint>", content + "</joint>")

    return {
        "mimic all": joint('<mimic joint="right_j0" multiplier="2" offset="1"/>'),
        "mimic nan": joint('<mimic joint="right_j0" multiplier="nan"/>'),
        "mimic words": joint('<mimic joint="right_j0" multiplier="two"/>'),
        "continuous with limits": text.replace('type="revolute"', 'type="continuous"'),
        "prismatic all": text.replace('type="revolute"', 'type="prismatic"'),
        "fixed all": text.replace('type="revolute"', 'type="fixed"'),
        "type upper": text.replace('type="revolute"', 'type="Revolute"'),
        "safety": joint('<safety_controller k_velocity="nan" soft_lower_limit="9" soft_upper_limit="-9"/>'),
        "calibration": joint('<calibration rising="x"/>'),
        "friction nan": joint('<dynamics damping="nan" friction="-1"/>'),
        "effort below": text.replace("effort=", 'effort="-5" old='),
        "velocity of 1e300": __import__("re").sub(r'velocity="[^"]*"', 'velocity="1e300"', text),
        "limits of 1e300": __import__("re").sub(r'lower="[^"]*"', 'lower="-1e300"', text),
        "limits of one": __import__("re").sub(r'upper="[^"]*"', 'upper="-9"', text),
        "commas": __import__("re").sub(r'xyz="([^ "]+) ([^ "]+) ', r'xyz="\1,\2 ', text),
        "tabs": __import__("re").sub(r'xyz="([^ "]+) ', 'xyz="\\1\t\n', text),
        "axis long": __import__("re").sub(r'<axis xyz="[^"]*"', '<axis xyz="0 0 1e200"', text),
        "axis short": __import__("re").sub(r'<axis xyz="[^"]*"', '<axis xyz="0 0 1e-200"', text),
        "axes parallel": __import__("re").sub(r'<axis xyz="[^"]*"', '<axis xyz="0 0 1"', text),
        "no origins": __import__("re").sub(r"<origin [^>]*>", "", text),
        "turned by 1e17": __import__("re").sub(r'rpy="[^"]*"', 'rpy="1e17 0 0"', text),
        "no inertia": __import__("re").sub(r"<inertial>.*?</inertial>", "", text, flags=16),
        "materials": inside('<material name="a"><color rgba="2 -1 nan"/></material>' * 2),
        "a texture": inside('<material name="t"><texture filename="/dev/zero"/></material>'),
        "name empty": __import__("re").sub(r'<robot name="[^"]*"', '<robot name=""', text),
        "no name": __import__("re").sub(r'<robot name="[^"]*"', "<robot", text),
        "name a path": __import__("re").sub(r'<robot name="[^"]*"', '<robot name="../../x"', text),
        "root other": text.replace("<robot", "<Robot").replace("</robot>", "</Robot>"),
        "two robots": text + text,
        "inside another": f"<a>{text[text.index('<robot') :]}</a>",
        "gripper of two": inside('<link name="f1"/><link name="f2"/>' + "".join(f'<joint name="g{k}" type="prismatic"><parent link="right_hand"/><child link="f{k}"/><axis xyz="1 0 0"/><limit lower="0" upper="0.1" effort="1" velocity="1"/><mimic joint="g{3 - k}"/></joint>' for k in (1, 2))),
        "meshes gone": __import__("re").sub(r"<geometry>.*?</geometry>", '<geometry><mesh filename="package://sawyer_description/meshes/none.DAE"/></geometry>', text, flags=16),
        "meshes by file": __import__("re").sub(r"<geometry>.*?</geometry>", '<geometry><mesh filename="file:///nothing/x.stl"/></geometry>', text, flags=16),
        "meshes by URL": __import__("re").sub(r"<geometry>.*?</geometry>", '<geometry><mesh filename="https://127.0.0.1:9/x.stl"/></geometry>', text, flags=16),
        "meshes above": __import__("re").sub(r"<geometry>.*?</geometry>", '<geometry><mesh filename="../../../../../../../../etc/passwd"/></geometry>', text, flags=16),
        "drake": inside('<drake:joint xmlns:drake="x" name="d" type="ball"/>'),
        "transmissions": inside("<transmission name='t'/>" * 3000),
        "xacro properties": first("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ').replace("</robot>", '<xacro:property name="a" value="${1/0}"/></robot>'),
        "UTF-7": text.replace("<?xml", "<?xml").replace('encoding="UTF-8"', 'encoding="UTF-7"').replace('encoding="utf-8"', 'encoding="UTF-7"'),
        "standalone": '<?xml version="1.1" standalone="maybe"?>' + text[text.index("<robot") :],
        "CDATA": inside("<![CDATA[ words ]]>"),
        "instructions": '<?xml-stylesheet href="/dev/zero"?>' + text[text.index("<robot") :],
    }  # fmt: skip


XACRO = {
    "import": "<xacro:property name=\"a\" value=\"${__import__('os').system('touch ran-by-xacro')}\"/>",
    "loop": '<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>',
    "power": '<xacro:property name="a" value="${9**9**9}"/><link name="${a}"/>',
    "text of 1e9": "<link name=\"${'a' * 10**9}\"/>",
    "an argument": '<xacro:arg name="x" default="1"/><link name="$(arg x)"/>',
    "no argument": '<link name="$(arg nothing)"/>',
    "yaml": '<xacro:property name="a" value="${load_yaml(\'/dev/zero\')}"/><link name="${a}"/>',
    "itself": '<xacro:include filename="x.xacro"/>',
    "a device": '<xacro:include filename="/dev/zero"/>',
    "eval": "<link name=\"$(eval open('/etc/passwd').read())\"/>",
    "dirname": '<link name="$(dirname)"/>',
    "if words": '<xacro:if value="maybe"><link name="a"/></xacro:if>',
    "unknown": "<xacro:nothing/>",
    "division": '<link name="${1/0}"/>',
    "recursion": '<xacro:property name="a" value="${b}"/><xacro:property name="b" value="${a}"/><link name="${a}"/>',
}


def _files(files: dict[str, str]) -> dict:
    """Calls with a file that means what cannot be."""
    found: dict[str, Callable] = {}

    def add(command, kind, words, file, content):
        found[f"{command} {kind}"] = _with_file(command, words, "{x}", file, content)

    rod = json.loads(Path(files["rod.json"]).read_text())
    show_rod = ["{points.csv}", "--rod", "{x}", "--out", "{out}.png"]
    for kind, change in ROD_CHANGES.items():
        add("show", f"rod {kind}", show_rod, "rod.json", json.dumps(rod | change))
    for kind in ("fatter than long", "a hair", "limp", "stiff", "a coil", "neutron star", "a mile"):
        content = json.dumps(rod | ROD_CHANGES[kind])
        add(
            "plan",
            f"rod {kind}",
            [*["{x}" if w == "green-vps" else w for w in PLAN], "--no-robot"],
            "rod.json",
            content,
        )
    for kind, content in OBSTACLES.items():
        add("plan", f"obstacle {kind}", [*PLAN, *FAR, "--obstacles", "{x}"], "o.json", content)
    for kind, content in FRICTIONS.items():
        add("plan", f"table {kind}", [*PLAN, "--no-robot", "--friction", "{x}"], "t.json", content)
    camera = json.loads(Path(files["camera.json"]).read_text())
    scan = ["{marked.png}", "--markers", "{layout.json}", "--camera", "{x}", "--out", "{out}"]
    for kind, change in CAMERAS.items():
        add("scan", f"camera {kind}", scan, "camera.json", json.dumps(camera | change))
    for kind, corners in LAYOUTS.items():
        content = json.dumps({"marker_corners_m": corners})
        add(
            "scan",
            f"markers {kind}",
            ["{marked.png}", "--markers", "{x}", "--out", "{out}"],
            "m.json",
            content,
        )
    for kind, (file, text) in POINTS.items():
        add("show", f"points {kind}", SHOW, file, text)
    for kind, (file, text) in DRAWINGS.items():
        add("show", f"drawing {kind}", SHOW, file, text)
    for kind, text in DXF.items():
        add("show", f"DXF {kind}", SHOW, "x.dxf", text)
    for kind, text in _urdfs(Path(files["arm.urdf"]).read_text()).items():
        add("plan", f"arm {kind}", [*PLAN, *FAR, "--robot", "{x}"], "arm.urdf", text)
    for kind, text in XACRO.items():
        content = f'<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro">{text}</robot>'
        add("plan", f"xacro {kind}", [*PLAN, *FAR, "--robot", "{x}"], "x.xacro", content)
    for kind, change in _fixture_changes(
        json.loads(Path(files["fixtures.json"]).read_text())
    ).items():
        deploy = ["line", "--rod", "green-vps", "--trajectory", "{plan.npz}", "--speed", "0.5",
                  "--fixtures", "{x}", "--device", "cpu", "--out", "{out}"]  # fmt: skip
        add("deploy", f"fixtures {kind}", deploy, "f.json", json.dumps(change))
    return found


def _fixture_changes(valid: dict) -> dict[str, object]:
    lists = [key for key, value in valid.items() if isinstance(value, list) and value]

    def each(change) -> dict:
        made = copy.deepcopy(valid)
        for key in lists:
            for item in filter(lambda item: isinstance(item, dict), made[key]):
                change(item)
        return made

    def numbers(factor) -> dict:
        def scaled(value):
            if isinstance(value, list):
                return [scaled(one) for one in value]
            real = isinstance(value, (int, float)) and not isinstance(value, bool)
            return factor * value if real else value

        return each(lambda item: item.update({k: scaled(v) for k, v in item.items()}))

    return {
        "all twice": {**valid, **{key: valid[key] * 2 for key in lists}},
        "by the thousand": {**valid, **{key: valid[key] * 3000 for key in lists}},
        "of giants": numbers(1e6), "of dwarfs": numbers(1e-9), "turned about": numbers(-1.0),
        "without": {**valid, **{key: [] for key in lists}},
        "of nulls": {**valid, **{key: [None] for key in lists}},
        "of lists": {**valid, **{key: [[]] for key in lists}},
        "of maps": {**valid, **{key: {"0": valid[key][0]} for key in lists}},
        "named long": {**valid, "name": "x" * 100_000}, "named null": {**valid, "name": None},
        "named a path": {**valid, "name": "../../x"}, "noted a list": {**valid, "note": ["a"]},
        "with more": each(lambda item: item.update(colour="red")),
    }  # fmt: skip


# ---- how options are said -----------------------------------------------------------------------


def _spellings(files: dict[str, str]) -> dict:
    found: dict[str, Callable] = {}

    def add(command, kind, words):
        found[f"{command} {kind}"] = lambda folder: ([*command.split(), *words], None)

    for name in ("loop", "measure", "plan", "deploy", "scan", "markers", "dataset", "bench grasp"):
        valid = VALID[name]
        flags = [k for k, w in enumerate(valid) if w.startswith("--")]
        at = next(
            (k for k in flags if valid[k] not in ("--out", "--no-robot", "--no-expect")), flags[0]
        )
        flag, value = valid[at], valid[at + 1]
        rest = valid[:at] + valid[at + 2 :]
        for kind, words in {
            "shortened": [*rest, flag[:-2], value], "one dash": [*rest, flag[1:], value],
            "en dash": [*rest, "–" + flag[2:], value], "em dash": [*rest, "—" + flag[2:], value],
            "Unicode hyphens": [*rest, flag.replace("-", "‐"), value],
            "upper": [*rest, flag.upper(), value], "with =": [*rest, f"{flag}={value}"],
            "with = and spaces": [*rest, f"{flag} = {value}"], "with :": [*rest, f"{flag}:{value}"],
            "= empty": [*rest, f"{flag}="], "= twice": [*rest, f"{flag}=={value}"],
            "underscores": [*rest, "--" + flag[2:] + "_", value], "slash": [*rest, "/" + flag[2:], value],
            "twice the same": [*valid, flag, value], "twice, other": [*valid, flag, value + "9"],
            "last without": [*rest, flag], "after --": ["--", *valid], "-- at the end": [*valid, "--"],
            "-- in between": [*rest, "--", flag, value], "a response file": ["@args.txt", *valid],
            "no-": [*valid, "--no-" + flag[2:]], "in quotes": [*rest, f'"{flag}"', value],
            "all in one word": [" ".join(valid)], "help beside": [*valid, "--help"],
            "version beside": [*valid, "--version"], "empty words": ["", *valid, ""],
            "a space after": [*rest, flag + " ", value], "tab before": [*rest, "\t" + flag, value],
            "zero width": [*rest, flag + "\u200b", value], "backspace": [*rest, flag + "\b", value],
            "minus exponent": [*rest, flag, "-1e3"], "minus exponent =": [*rest, f"{flag}=-1e3"],
            "a flag as value": [*rest, flag, "--json"], "NUL-like": [*rest, flag, "\\x00"],
            "a megabyte": [*rest, flag, "9" * 100_000], "many words": [*valid, *["x"] * 5000],
            "JSON": [*rest, flag, '{"value": 1}'], "env": [*rest, flag, "${HOME}"],
            "json and json": [*valid, "--json", "--json"], "traceback": [*valid, "--traceback"],
        }.items():  # fmt: skip
            add(name, f"said {kind}", words)
    for kind, words in {
        "nothing": [], "help": ["help"], "bench alone": ["bench"], "bench of none": ["bench", "none"],
        "upper": ["PLAN"], "prefix": ["pl"], "option first": ["--rod", "green-vps", "plan", "line"],
        "two commands": ["loop", "rods"], "empty": [""], "space": [" "], "dash": ["-"], "--": ["--"],
        "version twice": ["--version", "--version"], "version rods": ["--version", "rods"],
        "path": ["/bin/sh"], "module": ["wrod.commands.plan"], "private": ["_hidden"],
        "underscore": ["bench_grasp"], "dotted": ["bench.grasp"], "unicode": ["plаn"],
        "surrogate": ["\udcff"], "long": ["x" * 100_000], "newline": ["rods\n"], "braces": ["{0}"],
        "bench help": ["bench", "--help"], "bench version": ["bench", "--version"],
    }.items():  # fmt: skip
        found[f"rods said {kind}"] = lambda folder, words=words: (words, None)
    return found


# ---- machines that are not set up as ours -------------------------------------------------------

ENVIRONMENTS: dict[str, dict] = {
    "a matplotlibrc of rubbish": {"MATPLOTLIBRC": "{made}/matplotlibrc"},
    "LaTeX asked for": {"MATPLOTLIBRC": "{made}/tex"},
    "fonts gone": {"FONTCONFIG_FILE": "/dev/null", "FONTCONFIG_PATH": "/proc"},
    "font list of rubbish": {"MPLCONFIGDIR": "{made}/mpl"},
    "kernels of rubbish": {"WARP_CACHE_PATH": "{made}/kernels"},
    "kernels read-only": {"WARP_CACHE_PATH": "/usr/lib"},
    "temporary folder a file": {"TMPDIR": "{made}/matplotlibrc"},
    "home a file": {"HOME": "{made}/matplotlibrc", "XDG_CACHE_HOME": "{made}/matplotlibrc"},
    "home with spaces": {"HOME": "{made}/a b\n"},
    "C and no UTF-8 mode": {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "Shift-JIS out": {"PYTHONIOENCODING": "shift_jis:strict"},
    "EBCDIC out": {"PYTHONIOENCODING": "cp037"},
    "UTF-7 out": {"PYTHONIOENCODING": "utf-7"},
    "no such encoding": {"PYTHONIOENCODING": ":nothing"},
    "hash seed 0": {"PYTHONHASHSEED": "0"},
    "optimised": {"PYTHONOPTIMIZE": "1"},
    "warnings are errors": {"PYTHONWARNINGS": "error::RuntimeWarning,error::DeprecationWarning"},
    "no bytes warnings": {"PYTHONWARNINGS": "x::y::z"},
    "threads of 1e9": {"OMP_NUM_THREADS": "1000000000", "OPENBLAS_NUM_THREADS": "1000000000"},
    "threads bound": {"OMP_PROC_BIND": "true", "GOMP_CPU_AFFINITY": "99999"},
    "OpenBLAS of old": {"OPENBLAS_CORETYPE": "PRESCOTT"},
    "OpenBLAS of none": {"OPENBLAS_CORETYPE": "Nothing", "OPENBLAS_VERBOSE": "2"},
    "NumPy without": {"NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F"},
    "torch loud": {"TORCH_CPP_LOG_LEVEL": "INFO", "TORCH_SHOW_CPP_STACKTRACES": "1"},
    "torch unsafe": {"TORCH_FORCE_NO_WEIGHTS_ONLY_LOAD": "1"},
    "torch determined": {"CUBLAS_WORKSPACE_CONFIG": "x", "TORCH_ALLOW_TF32_CUBLAS_OVERRIDE": "x"},
    "CUDA nowhere": {
        "CUDA_HOME": "/dev/null",
        "CUDA_DEVICE_ORDER": "x",
        "NVIDIA_VISIBLE_DEVICES": "void",
    },
    "USD plugins": {"PXR_PLUGINPATH_NAME": "{made}", "PXR_DISABLE_STANDARD_PLUG_SEARCH_PATH": "1"},
    "USD resolver": {
        "PXR_AR_DEFAULT_SEARCH_PATH": "/dev/zero:::/proc",
        "USD_DEFAULT_RENDERER": "x",
    },
    "USD abort": {"TF_FATAL_THROW": "1", "PXR_ENABLE_GLOBAL_TRACE": "1"},
    "OpenCV's": {
        "OPENCV_IO_ENABLE_OPENEXR": "x",
        "OPENCV_VIDEOIO_DEBUG": "1",
        "OPENCV_OPENCL_RUNTIME": "x",
    },
    "Qt's": {"QT_PLUGIN_PATH": "/proc", "QT_DEBUG_PLUGINS": "1", "XDG_SESSION_TYPE": "wayland"},
    "no display": {"DISPLAY": "", "WAYLAND_DISPLAY": "", "MPLBACKEND": "QtAgg"},
    "a proxy": {"http_proxy": "http://127.0.0.1:9", "https_proxy": "x", "no_proxy": "*"},
    "debugger": {"PYTHONBREAKPOINT": "nothing.at_all"},
    "startup": {"PYTHONSTARTUP": "/dev/zero", "PYTHONINSPECT": ""},
    "no site": {"PYTHONNOUSERSITE": "1", "PYTHONUSERBASE": "/dev/null"},
    "tqdm off": {"TQDM_DISABLE": "0", "TQDM_LEAVE": "x", "TQDM_BAR_FORMAT": "{nothing}"},
    "columns 0": {"COLUMNS": "0", "LINES": "0", "TERM": "unknown"},
    "terminal of 1e9": {"COLUMNS": "1000000000"},
    "colours": {"CLICOLOR_FORCE": "1", "FORCE_COLOR": "3", "NO_COLOR": "", "TERM": "xterm"},
    "slurm": {"SLURM_PROCID": "x", "SLURM_NTASKS": "0", "PMI_RANK": "-1"},
    "torchrun": {"MASTER_ADDR": "nowhere.invalid", "MASTER_PORT": "x", "LOCAL_WORLD_SIZE": "0"},
    "CI": {"CI": "true", "GITHUB_ACTIONS": "true"},
    "malloc checks": {"MALLOC_CHECK_": "3", "MALLOC_PERTURB_": "85"},
    "arenas": {"MALLOC_MMAP_THRESHOLD_": "0", "MALLOC_TOP_PAD_": "9999999"},
    "locale of bytes": {"LC_ALL": "\udcff", "LANGUAGE": "\udcfe"},
    "a path of bytes": {"PATH": "\udcff:/proc:.", "WROD_SHARED": "/dev/zero"},
    "gtk": {"LC_NUMERIC": "fr_FR.UTF-8", "LC_TIME": "ar_EG.UTF-8", "LC_COLLATE": "x"},
    "time zone": {"TZ": ":/dev/zero"},
    "perf": {"PYTHONPERFSUPPORT": "1", "PYTHONFROZENMODULES": "off"},
    "int digits": {"PYTHONINTMAXSTRDIGITS": "0", "PYTHONDEBUG": "x"},
    "malloc stats": {"PYTHONMALLOCSTATS": "1"},
}
USER = "setpriv --reuid=65534 --regid=65534 --clear-groups"
SCRIPTS: dict[str, str] = {
    "a user without a name": "mkdir -p $OUT.home; chmod 777 .. . $OUT.home; "
    "env HOME=/nonexistent USER= setpriv --reuid=54321 --regid=54321 --clear-groups CALL; echo EXIT $?\n",
    "nobody": f"chmod 777 .. .; {USER} CALL; echo EXIT $?\n",
    "nothing around": "env -i PYTHONPATH=$PYTHONPATH CALL; echo EXIT $?\n",
    "no network": "unshare -rn CALL; echo EXIT $?\n",
    "first process": "unshare -rpf --mount-proc CALL; echo EXIT $?\n",
    "no host name": "unshare -ru bash -c 'hostname \" \" 2> /dev/null; CALL; echo EXIT $?'\n",
    "no processor's file": "unshare -rm bash -c 'mount --bind /dev/null /proc/cpuinfo || exit 0\nCALL; echo EXIT $?'\n",
    "no memory's file": "unshare -rm bash -c 'mount --bind /dev/null /proc/meminfo || exit 0\nCALL; echo EXIT $?'\n",
    "rubbish in memory's file": "printf 'MemTotal: x kB\\nMemAvailable: -1\\n' > ../m\nunshare -rm bash -c 'mount --bind ../m /proc/meminfo || exit 0\nCALL; echo EXIT $?'\n",
    "no groups": "unshare -rm bash -c 'mount -t tmpfs none /sys/fs/cgroup || exit 0\nCALL; echo EXIT $?'\n",
    "rubbish in groups": "unshare -rm bash -c 'mount -t tmpfs none /sys/fs/cgroup || exit 0\nprintf \"max x\" > /sys/fs/cgroup/cpu.max; printf \"\" > /sys/fs/cgroup/memory.max; printf \"-5\" > /sys/fs/cgroup/memory.current\nCALL; echo EXIT $?'\n",
    "no /tmp": "unshare -rm bash -c 'mount -t tmpfs -o ro none /var/tmp || exit 0\nTMPDIR=/var/tmp CALL; echo EXIT $?'\n",
    "no passwords": "unshare -rm bash -c 'mount --bind /dev/null /etc/passwd || exit 0\nenv -u HOME -u USER CALL; echo EXIT $?'\n",
    "one processor": "taskset -c 0 CALL; echo EXIT $?\n",
    "idle priority": "nice -n 19 CALL; echo EXIT $?\n",
    "no session": "setsid CALL; echo EXIT $?\n",
    "nohup": "nohup CALL < /dev/null; echo EXIT $?\n",
    "stdout is stderr's file": "CALL > ../log 2>&1; a=$?; cat ../log; echo EXIT $a\n",
    "stdout to a folder's file": "CALL >> ../log 2>> ../log; a=$?; cat ../log; echo EXIT $a\n",
    "stdout read-only": "CALL 1< /dev/null; echo EXIT $?\n",
    "stderr read-only": "CALL 2< /dev/null; echo EXIT $?\n",
    "stdin write-only": "CALL 0> /dev/null; echo EXIT $?\n",
    "through tee": "CALL 2>&1 | tee ../log; echo EXIT ${PIPESTATUS[0]}\n",
    "slow reader": "CALL 2>&1 | (sleep 1; cat); echo EXIT ${PIPESTATUS[0]}\n",
    "non-blocking": "CALL 2>&1 | python3 -c 'import os, sys, time; os.set_blocking(0, False); time.sleep(1)\nwhile True:\n    try: part = os.read(0, 9)\n    except BlockingIOError: continue\n    if not part: break\n    os.write(1, part)'; echo EXIT ${PIPESTATUS[0]}\n",
    "a background job of a terminal": "script -qec 'stty tostop; bash ../call.sh' ../typed < /dev/null > ../log; a=$?\ncat ../log; echo EXIT $a\n",
    "terminal of no size": "script -qec 'stty cols 0 rows 0; exec bash ../call.sh' ../typed < /dev/null > ../log; a=$?\ncat ../log; echo EXIT $a\n",
    "hangs up": "script -qec 'bash ../call.sh' ../typed < /dev/null > ../log & p=$!\nsleep 1; kill -HUP $p; wait $p; echo EXIT 0\n",
    "files 3 to 200 open": "for k in $(seq 10 200); do eval \"exec $k</dev/null\"; done; CALL; echo EXIT $?\n",
    "standard files closed": "exec 0<&- ; CALL 2>&1; echo EXIT $?\n",
    "folder not readable": f"mkdir d; cd d; chmod 000 .; {UNABLE} CALL; a=$?; chmod 755 .; cd ..; rmdir d; echo EXIT $a\n",
    "folder moved": "mkdir d; cd d; mv ../d ../e; CALL; a=$?; cd ..; rmdir e; echo EXIT $a\n",
    "deep folder": "for k in $(seq 60); do mkdir -p " + "d" * 80 + " && cd " + "d" * 80 + "; done; CALL; a=$?; cd ${OUT%/*}; rm -rf here/d*; echo EXIT $a\n",
    "folder of bytes": "mkdir $'\\xff\\xfe'; cd $'\\xff\\xfe'; CALL; a=$?; cd ..; rmdir $'\\xff\\xfe'; echo EXIT $a\n",
    "folder of line ends": "mkdir $'a\\nb'; cd $'a\\nb'; CALL; a=$?; cd ..; rmdir $'a\\nb'; echo EXIT $a\n",
    "umask 777 and no root": f"umask 777; {UNABLE} CALL; a=$?; chmod -R u+rwx $OUT* 2> /dev/null; echo EXIT $a\n",
    "a file of 1 kB at most": "ulimit -f 1; CALL; echo EXIT $?\n",
    "no core, no lock, no queue": "ulimit -c 0 -l 0 -q 0; CALL; echo EXIT $?\n",
    "address space of 3 GB": "ulimit -v 3000000; CALL; echo EXIT $?\n",
    "few processes": "ulimit -u 5; setpriv --reuid=54322 --regid=54322 --clear-groups CALL; echo EXIT $?\n",
    "all signals ignored": "trap '' INT TERM HUP QUIT USR1 USR2 ALRM CHLD; CALL; echo EXIT $?\n",
    "child signals ignored": "trap '' CHLD; CALL; echo EXIT $?\n",
    "interrupted twice": "set -m; CALL & p=$!\nsleep 1; kill -INT -- -$p; sleep 0.05; kill -INT -- -$p\nwait $p; a=$?\nfind $(dirname $OUT) -name '.*' -type f -printf 'HALF %p\\n'\n[ $a = 130 ] && a=0; echo EXIT $a\n",
    "interrupted at once": "set -m; CALL & p=$!\nsleep 0.15; kill -INT -- -$p\nwait $p; a=$?\n[ $a = 130 ] && a=0; echo EXIT $a\n",
    "terminated at once": "set -m; CALL & p=$!\nsleep 0.3; kill -TERM -- -$p\nwait $p; a=$?\n[ $a = 143 ] && a=0; echo EXIT $a\n",
    "quit": "set -m; CALL & p=$!\nsleep 1; kill -QUIT -- -$p\nwait $p; a=$?\n[ $a = 131 ] && a=0; echo EXIT $a\n",
    "pipe signal": "set -m; CALL & p=$!\nsleep 1; kill -PIPE -- -$p\nwait $p; a=$?\n[ $a = 141 ] && a=0; echo EXIT $a\n",
    "user signal": "set -m; CALL & p=$!\nsleep 1; kill -USR1 -- -$p\nwait $p; a=$?\n[ $a = 138 ] && a=0; echo EXIT $a\n",
    "resized": "set -m; CALL & p=$!\nsleep 1; kill -WINCH -- -$p\nwait $p; echo EXIT $?\n",
    "three at once": "CALL > ../1 2>&1 & p=$!\nCALL > ../2 2>&1 & q=$!\nCALL; a=$?\nwait $p; b=$?; wait $q; c=$?; cat ../1 ../2; echo EXIT $a $b $c\n",
    "one after the other": "CALL > ../1 2>&1; a=$?; CALL; b=$?; cat ../1; echo EXIT $a $b\n",
    "output made read-only between": f"CALL > ../1 2>&1; a=$?; chmod -R a-w $OUT* 2> /dev/null; {UNABLE} CALL; b=$?; chmod -R u+w $OUT* 2> /dev/null; cat ../1; echo EXIT $a $b\n",
    "output emptied between": "CALL > ../1 2>&1; a=$?; find $OUT* -type f -exec truncate -s 0 {} + 2> /dev/null; CALL; b=$?; cat ../1; echo EXIT $a $b\n",
    "output cut between": "CALL > ../1 2>&1; a=$?; find $OUT* -type f -exec truncate -s -7 {} + 2> /dev/null; CALL; b=$?; cat ../1; echo EXIT $a $b\n",
    "output of zeros between": "CALL > ../1 2>&1; a=$?; find $OUT* -type f -exec sh -c 's=$(stat -c %s \"$1\"); head -c $s /dev/zero > \"$1\"' x {} \\; 2> /dev/null; CALL; b=$?; cat ../1; echo EXIT $a $b\n",
    "output full of folders": "CALL > ../1 2>&1; a=$?; find $OUT* -type f 2> /dev/null | while read -r f; do rm \"$f\"; mkdir \"$f\"; done; CALL; b=$?; cat ../1; rm -rf $OUT*; echo EXIT $a $b\n",
    "output full of links": "CALL > ../1 2>&1; a=$?; find $OUT* -type f 2> /dev/null | while read -r f; do ln -sf /dev/full \"$f\"; done; CALL; b=$?; cat ../1; echo EXIT $a $b\n",
    "output full of pipes": "CALL > ../1 2>&1; a=$?; find $OUT* -type f 2> /dev/null | while read -r f; do rm \"$f\"; mkfifo \"$f\"; done; CALL; b=$?; cat ../1; rm -rf $OUT*; echo EXIT $a $b\n",
}  # fmt: skip


def _surroundings(files: dict[str, str]) -> dict:
    found: dict[str, Callable] = {}

    def made_in(folder: Path) -> None:
        for name in ("mpl", "kernels", "a b\n"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        (folder / "matplotlibrc").write_text(
            "font.size: x\nfigure.dpi: nan\n\0\nsavefig.format: svg\n"
        )
        (folder / "tex").write_text("text.usetex: True\n")
        (folder / "mpl" / "matplotlibrc").write_text("axes.prop_cycle: __import__('os')\n")
        for name in ("fontlist-v390.json", "fontlist-v400.json", "fontlist-v330.json"):
            (folder / "mpl" / name).write_text('{"_class": "FontManager", "ttflist": 3')
        for k in range(9):
            (folder / "kernels" / f"wp_{k}").write_text("rubbish")

    def environment(command, change):
        def make(folder: Path) -> Made:
            made_in(folder)
            around = {k: v.replace("{made}", str(folder)) for k, v in change.items()}
            return [*command.split(), *VALID[command]], around

        return make

    def script(command, kind, text):
        return lambda folder: ([*command.split(), *VALID[command]], f"# {kind}\n{text}")

    for command in ("show", "loop", "scan", "plan"):
        for kind, change in ENVIRONMENTS.items():
            found[f"{command} with {kind}"] = environment(command, change)
    for command in ("show", "dataset", "plan"):
        for kind, text in SCRIPTS.items():
            found[f"{command} in {kind}"] = script(command, kind, text)
    return found


# ---- what is read and written at once -----------------------------------------------------------


def _shared_places(files: dict[str, str]) -> dict:
    """Calls whose output is an input of theirs, or beside it."""
    found: dict[str, Callable] = {}

    def onto(command, words, how):
        def make(folder: Path) -> Made:
            folder.mkdir(parents=True, exist_ok=True)
            read = next(w for w in words if w.strip("{}") in files)
            file = Path(files[read.strip("{}")])
            mine = folder / file.name
            (shutil.copytree if file.is_dir() else shutil.copy)(file, mine)
            out = mine
            if how == "link to it":
                out = folder / f"link{file.suffix}"
                out.symlink_to(mine)
            elif how == "hard link to it" and mine.is_file():
                out = folder / f"hard{file.suffix}"
                os.link(mine, out)
            elif how == "its folder":
                out = folder
            elif how == "by dots":
                out = folder / ".." / folder.name / file.name
            elif how == "below it":
                out = mine / "x"
            changed = [str(mine) if w == read else w for w in words]
            return [
                *command.split(),
                *(str(out) if w.startswith("{out}") else w for w in changed),
            ], None

        return make

    for command, valid in VALID.items():
        calls = [valid, *MORE.get(command, [])]
        calls = [
            w
            for w in calls
            if any(one.strip("{}") in files for one in w) and "{out}" in " ".join(w)
        ]
        for k, words in enumerate(
            calls[:2]
            if command not in ("bench robot", "bench cables", "bench photographs", "bench hands")
            else []
        ):
            for how in (
                "itself",
                "link to it",
                "hard link to it",
                "its folder",
                "by dots",
                "below it",
            ):
                found[f"{command} onto {how} {k}"] = onto(command, words, how)
    return found


# ---- what an earlier run may have left ----------------------------------------------------------


def _left_overs(files: dict[str, str]) -> dict:
    """Calls into folders that hold what no run of theirs left."""
    found: dict[str, Callable] = {}
    names = {
        "dataset": ["manifest.json", "grasps-00000.safetensors", ".lock", "grasps-99999.safetensors"],
        "train": ["checkpoint.pt", "history.csv", "controller.safetensors", ".lock"],
        "bench table3": ["trials.jsonl", "summary.json", "table3.json", ".lock"],
        "bench slippery": ["rows.jsonl", "slippery.jsonl", "slippery.md", ".lock"],
        "plan": ["trajectory.npz", "plan.json", "trajectory.csv", "plan.png", ".lock"],
        "deploy": ["deployment.npz", "deployment.json", "trials.jsonl", ".lock"],
        "scan": ["pattern.npz", "scan.json", "scan.png"],
        "identify": ["report.json", "rod.json", "report.html"],
        "markers": ["sheet.png", "markers.pdf", "layout.json", "markers.json"],
    }  # fmt: skip
    contents: dict[str, bytes | None] = {
        "empty": b"", "rubbish": b"\x93NUMPY\x01" + bytes(range(256)), "a list": b"[1, 2]\n",
        "half a line": b'{"a": 1}\n{"b": ', "NUL at the end": b'{"a": 1}\n' + bytes(4096),
        "a folder": None,
    }  # fmt: skip

    def into(command, file, content):
        def make(folder: Path) -> Made:
            out = folder / "out"
            out.mkdir(parents=True, exist_ok=True)
            (out / file).write_bytes(content) if content is not None else (out / file).mkdir()
            return [
                *command.split(),
                *(str(out) if w == "{out}" else w for w in VALID[command]),
            ], None

        return make

    for command, list_of in names.items():
        for file in list_of:
            for kind, content in contents.items():
                found[f"{command} after {file} {kind}"] = into(command, file, content)
    return found
