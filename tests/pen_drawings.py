"""Photographs of curves drawn by hand, rendered: what a first picture from a desk may be like.

Paper with a texture, squared or plain, markers in its corners; a pen whose width and darkness vary,
that trembles and that skips; a camera at a slant, shadows, blur, noise, JPEG. Everything is a
function of the case's name, so that a failure can be looked at again:

    python -m tests.pen_drawings FOLDER
"""

from __future__ import annotations

import sys
import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import CubicSpline, splev, splprep

from wrod.perception.sheet import PAPERS, MarkerSheet

_DOTS = 8000.0  # [px/m] of the paper before it is photographed
_SIZE = (1280, 960)  # [px] of the photograph
_POINTS = 4000  # of a curve
SHEET = MarkerSheet(PAPERS["a4"])


@dataclass(frozen=True)
class Case:
    """One drawing and how it is photographed.

    Attributes:
        points: (n, 2) of the curve on the sheet [m].
        width: least and largest of the pen [m].
        ink: its grey at the least and the largest pressure, 0 black.
        gaps: (share of the length, length [m]) where the pen left the paper.
        slant: how far the sheet's corners are moved, as a share of the picture.
        shadow: how much light a shadow takes, 0 none.
        squared: whether the paper has lines every 5 mm.
        tremor: of the hand [m].
    """

    points: np.ndarray
    width: tuple[float, float] = (0.7e-3, 1.0e-3)
    ink: tuple[float, float] = (0.25, 0.1)
    gaps: tuple[tuple[float, float], ...] = ()
    slant: float = 0.05
    shadow: float = 0.0
    squared: bool = False
    tremor: float = 5e-5


def _spline(*knots, closed: bool = False) -> np.ndarray:
    if closed:
        curve, _ = splprep(np.array([*knots, knots[0]]).T, s=0.0, per=True)
        return np.stack(splev(np.linspace(0.0, 1.0, _POINTS), curve), axis=1)
    knots = np.array(knots, float)
    steps = np.concatenate([[0.0], np.cumsum(np.sqrt(np.hypot(*np.diff(knots, axis=0).T)))])
    return CubicSpline(steps, knots)(np.linspace(0.0, steps[-1], _POINTS))


def _corners(*knots) -> np.ndarray:
    knots = np.array(knots, float)
    steps = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(knots, axis=0).T))])
    at = np.linspace(0.0, steps[-1], _POINTS)
    return np.stack([np.interp(at, steps, x) for x in knots.T], axis=1)


def _eight() -> np.ndarray:
    angle = np.linspace(-0.35, 2 * np.pi - 0.9, _POINTS)  # crosses itself at 0 and at pi
    return np.stack([0.15 + 0.085 * np.sin(angle), 0.105 + 0.06 * np.sin(2 * angle)], axis=1)


def _wave() -> np.ndarray:
    x = np.linspace(0.05, 0.25, _POINTS)
    return np.stack([x, 0.105 + 0.035 * np.sin(2 * np.pi * (x - 0.05) / 0.11)], axis=1)


CASES = {
    "skips": Case(
        _spline((0.06, 0.06), (0.13, 0.08), (0.15, 0.13), (0.21, 0.15), (0.25, 0.10)),
        gaps=((0.18, 3e-3), (0.43, 5e-3), (0.71, 4e-3)),
        width=(0.5e-3, 0.9e-3),
    ),
    "eight": Case(_eight(), width=(0.8e-3, 1.6e-3), shadow=0.35),
    "closed": Case(
        _spline(
            (0.15, 0.04),
            (0.21, 0.07),
            (0.23, 0.13),
            (0.15, 0.16),
            (0.08, 0.13),
            (0.08, 0.07),
            closed=True,
        ),
        shadow=0.3,
    ),
    "corners": Case(
        _corners((0.06, 0.06), (0.10, 0.15), (0.15, 0.07), (0.20, 0.15), (0.24, 0.06)),
        width=(0.8e-3, 1.2e-3),
    ),
    "pencil": Case(_wave(), width=(0.35e-3, 0.6e-3), ink=(0.62, 0.45), slant=0.08),
    "felt": Case(
        _spline((0.06, 0.15), (0.12, 0.16), (0.15, 0.11), (0.12, 0.06), (0.19, 0.05), (0.24, 0.1)),
        width=(3.5e-3, 5.5e-3),
    ),
    "slanted": Case(
        _spline((0.09, 0.16), (0.09, 0.09), (0.14, 0.05), (0.20, 0.08), (0.21, 0.16)),
        slant=0.16,
        shadow=0.55,
        tremor=2e-4,
    ),
    "squared": Case(
        _spline((0.22, 0.14), (0.15, 0.16), (0.08, 0.12), (0.10, 0.06), (0.17, 0.05), (0.22, 0.07)),
        squared=True,
        shadow=0.25,
        width=(0.6e-3, 1.1e-3),
    ),
}


def _smooth(rng, shape, scale: float) -> np.ndarray:
    """Noise of unit size that varies over `scale` pixels."""
    small = rng.standard_normal([max(4, int(np.ceil(n / scale)) + 3) for n in shape])
    small = small.astype(np.float32)
    return cv2.resize(small, shape[::-1], interpolation=cv2.INTER_CUBIC)


def _drawn(case: Case, sheet: MarkerSheet, rng) -> np.ndarray:
    """(H, W, 3) the sheet as it lies, white 1; (H, W, 1) where nothing on it has a colour."""
    width, height = (round(n * _DOTS) for n in sheet.size)
    paper = 0.010 * _smooth(rng, (height, width), 3) + 0.012 * _smooth(rng, (height, width), 90)
    paper = np.repeat(0.93 + paper[..., None], 3 if case.squared else 1, axis=2)
    if case.squared:
        for k in range(1, 60):
            at = round(k * 5e-3 * _DOTS)
            paper[:, at : at + 2] *= [0.86, 0.91, 0.97]
            paper[at : at + 2] *= [0.86, 0.91, 0.97]
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    side = round(sheet.side * _DOTS)
    for number, corners in sheet.corners.items():
        left, top = (round(n * _DOTS) for n in (corners[0][0], sheet.size[1] - corners[0][1]))
        code = cv2.aruco.generateImageMarker(book, number, side)
        paper[top : top + side, left : left + side] = 0.08 + 0.84 * code[..., None] / 255.0
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(case.points, axis=0).T))])
    count = int(length[-1] / 1.5e-4)
    at = np.linspace(0.0, length[-1], count)
    points = np.stack([np.interp(at, length, x) for x in case.points.T], axis=1)
    shake = _smooth(rng, (count, 2), 60)[:, :2] * case.tremor
    force = np.clip(0.5 + 0.35 * _smooth(rng, (count, 2), 150)[:, 0], 0.0, 1.0)
    pixels = (points + shake) * [_DOTS, -_DOTS] + [0.0, height]
    lifted = np.zeros(count, bool)
    for share, gap in case.gaps:
        lifted |= np.abs(at - share * length[-1]) < gap / 2
    ink = np.ones((height, width), np.float32)
    for (x, y), press, up in zip(pixels, force, lifted, strict=True):
        if up:
            continue
        radius = _DOTS * (case.width[0] + press * (case.width[1] - case.width[0])) / 2
        grey = float(case.ink[0] + press * (case.ink[1] - case.ink[0]))
        cv2.circle(
            ink, (round(16 * x), round(16 * y)), round(16 * radius), grey, -1, cv2.LINE_AA, 4
        )
    return np.clip(paper, 0.0, 1.0) * np.minimum(ink, 1.0)[..., None]


def photograph(name: str) -> np.ndarray:
    """(960, 1280, 3) uint8 RGB of a case on `SHEET` as JPEG leaves it."""
    case = CASES[name]
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    paper = _drawn(case, SHEET, rng)
    height, width = paper.shape[:2]
    w, h = _SIZE
    corners = np.array([(0.08, 0.1), (0.92, 0.1), (0.92, 0.9), (0.08, 0.9)]) * _SIZE
    corners += rng.uniform(-1.0, 1.0, (4, 2)) * case.slant * np.array(_SIZE) * 0.5
    source = np.array([(0, 0), (width, 0), (width, height), (0, height)], np.float32)
    to_picture = cv2.getPerspectiveTransform(source, corners.astype(np.float32))
    # Shrunk by more than half: average first, as a lens does.
    paper = cv2.GaussianBlur(paper, (0, 0), 0.45 * width / (0.84 * w))
    desk = (
        np.array([0.42, 0.33, 0.25], np.float32) * (1 + 0.1 * _smooth(rng, (h, w), 25))[..., None]
    )
    there = cv2.warpPerspective(np.ones((height, width), np.float32), to_picture, _SIZE)[..., None]
    seen = cv2.warpPerspective(paper, to_picture, _SIZE).reshape(h, w, -1)
    picture = seen + (1 - there) * desk
    y, x = np.mgrid[0:h, 0:w].astype(np.float32) / max(w, h)
    angle = rng.uniform(0, 2 * np.pi)
    light = 0.95 - 0.3 * np.abs(np.cos(angle) * (x - 0.4) + np.sin(angle) * (y - 0.3))
    if case.shadow:
        edge = np.cos(angle + 1) * (x - 0.5) + np.sin(angle + 1) * (y - 0.375) - 0.03
        light = light * (1 - case.shadow / (1 + np.exp(-np.clip(edge / 0.006, -50, 50))))
    tinted = light[..., None] * np.array([1.0, 0.97, 0.9], np.float32)
    picture = cv2.GaussianBlur(picture * tinted, (0, 0), 0.8)
    picture += np.float32(0.012) * rng.standard_normal(picture.shape, np.float32)
    image = (255 * np.clip(picture, 0, 1)).astype(np.uint8)
    _, packed = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])
    return cv2.imdecode(packed, cv2.IMREAD_COLOR)[..., ::-1]


def write(folder) -> None:
    """NAME.png of every case and layout.json."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name in CASES:
        cv2.imwrite(str(folder / f"{name}.png"), photograph(name)[..., ::-1])
    SHEET.save(folder)


if __name__ == "__main__":
    write(sys.argv[1])
