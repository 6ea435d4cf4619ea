"""Vector drawings as points: SVG (svgelements) and DXF (ezdxf), one stroke of one or of several."""

from pathlib import Path

import numpy as np

from wrod.errors import PatternError, needed_extras
from wrod.files import checked_path
from wrod.files.reading import shown
from wrod.patterns.drawing_checks import (
    MOST_STROKES,
    chained,
    check_dxf,
    check_stroke,
    check_svg,
    count_points,
)
from wrod.patterns.files import RawPoints, unit_scale

SUFFIXES = (".svg", ".dxf")
_SPACING = 0.001  # [m] between points on bent parts
EXACT = 2e-5  # [m] noise that a drawing's points are taken to have
_JOINED = 1e-4  # [m] strokes whose ends are nearer than this are one
_INCH = 0.0254
_MOST_BYTES = 16 * 2**20
# DXF $INSUNITS -> metres.
_DXF_UNITS = {
    1: _INCH,
    2: 0.3048,
    4: 1e-3,
    5: 1e-2,
    6: 1.0,
    8: 2.54e-8,
    9: 2.54e-5,
    13: 1e-6,
    14: 0.1,
}


@needed_extras()
def read_drawing(
    path: Path, units: str | None = None, layer: str | None = None, stroke: int | None = None
) -> RawPoints:
    """Points [m] of a stroke of a drawing, corners kept, y up.

    Args:
        path: SVG or DXF file.
        units: of a DXF file that names none: m, cm, mm, um or in.
        layer: the layer to read, by name; every visible one by default.
        stroke: which of several, from 1, as the message about them counts.

    Raises:
        PatternError: not a readable drawing, no stroke, several, no units, or no such layer.
    """
    path = Path(path)
    checked_path(path, "an SVG or DXF drawing", error=PatternError, limit=_MOST_BYTES)
    if path.suffix.lower() == ".svg":
        if units is not None:
            raise PatternError(f"{path}: an SVG file has units of its own; drop --units")
        strokes = _svg(path, layer)
    else:
        strokes = _dxf(path, units, layer)
    if len(strokes) > MOST_STROKES:
        raise PatternError(
            f"{path}: holds {len(strokes)} strokes; at most {MOST_STROKES} are read, so choose a "
            "--layer with fewer"
        )
    strokes = chained([check_stroke(s, path) for s in strokes if len(s) > 1], _JOINED)
    if not strokes:
        raise PatternError(f"{path}: holds no stroke; draw one curve, as a path or polyline")
    if stroke is not None:
        if not 1 <= stroke <= len(strokes):
            raise PatternError(f"{path}: has {len(strokes)} strokes, and --stroke is {stroke}")
        chosen = strokes[stroke - 1]
    elif len(strokes) > 1:
        said = ", ".join(
            f"{k + 1}: {_length(s):.3f} m from ({s[0][0]:.3f}, {s[0][1]:.3f})"
            for k, s in enumerate(strokes[:8])
        )
        raise PatternError(
            f"{path}: holds {len(strokes)} strokes ({said}); choose one with --stroke, or a "
            "--layer that has one"
        )
    else:
        chosen = strokes[0]
    return RawPoints(_evenly(chosen), str(path), "m")


def _evenly(points: np.ndarray) -> np.ndarray:
    """The points with others between those that are far apart: curves go through them all."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    spacing = max(_SPACING, steps.sum() / 1500)
    pieces = [
        a + np.linspace(0.0, 1.0, int(np.ceil(step / spacing)), endpoint=False)[:, None] * (b - a)
        for a, b, step in zip(points[:-1], points[1:], steps, strict=True)
    ]
    return np.concatenate([*pieces, points[-1:]])


def _length(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _svg(path: Path, layer: str | None) -> list[np.ndarray]:
    import svgelements

    check_svg(path)
    try:
        # 96 pixels an inch, as CSS has it; width, height and viewBox are applied.
        drawing = svgelements.SVG.parse(str(path), reify=True, ppi=96.0)
    except Exception as error:
        raise PatternError(f"{path}: not a readable SVG file ({shown(error, 200)})") from None
    if not isinstance(drawing, svgelements.SVG):
        raise PatternError(
            f'{path}: not an SVG file: its root is no <svg xmlns="http://www.w3.org/2000/svg">'
        )
    metre = _INCH / 96.0
    names = _layers(drawing, svgelements)
    if layer is not None and layer not in names:
        raise PatternError(
            f"{path}: has no layer {layer!r}; its layers are {', '.join(sorted(names)) or 'none'}"
        )
    strokes = []
    for element in _visible(drawing if layer is None else names[layer], svgelements):
        try:
            whole = svgelements.Path(element)
            whole.reify()
            parts = [svgelements.Path(sub) for sub in whole.as_subpaths()]
            strokes += [_flattened(part, metre, path, svgelements) for part in parts]
        except PatternError:
            raise
        except Exception as error:
            raise PatternError(f"{path}: a shape cannot be read ({shown(error, 200)})") from None
    for points in strokes:
        points[:, 1] *= -1.0  # y of a screen runs down
    low = min((s[:, 1].min() for s in strokes if len(s)), default=0.0)
    return [points - [0.0, low] for points in strokes]


def _layers(drawing, svgelements) -> dict:
    """Groups by Inkscape's label, or by id."""
    found = {}
    for element in drawing.elements():
        if isinstance(element, svgelements.Group) and element is not drawing:
            values = element.values.get("attributes", {})
            label = next((v for k, v in values.items() if str(k).endswith("}label")), None)
            label = label or values.get("inkscape:label") or element.id
            if label:
                found[str(label)] = element
    return found


def _visible(root, svgelements):
    """Shapes that are drawn: hidden layers and shapes are not."""
    queue = [root]
    while queue:
        element = queue.pop(0)
        values = getattr(element, "values", {})
        style = str(values.get("style", "")).replace(" ", "")
        hidden = (
            "display:none" in style
            or values.get("display") == "none"
            or values.get("visibility") == "hidden"
        )
        if hidden:
            continue
        if isinstance(element, (svgelements.Group, svgelements.SVG, svgelements.Use)):
            queue = [*element, *queue]
        elif isinstance(element, svgelements.Shape):
            yield element


def _flattened(whole, metre: float, path: Path, svgelements) -> np.ndarray:
    points: list[np.ndarray] = []
    for segment in whole:
        if isinstance(segment, svgelements.Move) or segment.start is None:
            continue
        count = 2
        if not isinstance(segment, (svgelements.Line, svgelements.Close)):
            coarse = segment.npoint(np.linspace(0.0, 1.0, 65)) * metre
            count = count_points(_length(check_stroke(coarse, path)), _SPACING, path)
        points.append(segment.npoint(np.linspace(0.0, 1.0, count)) * metre)
    return _without_repeats(np.concatenate(points)) if points else np.zeros((0, 2))


def _dxf(path: Path, units: str | None, layer: str | None) -> list[np.ndarray]:
    import ezdxf
    from ezdxf import disassemble
    from ezdxf import path as dxf_path

    try:
        document = ezdxf.readfile(path)
        named = _DXF_UNITS.get(int(document.header.get("$INSUNITS", 0)))
    except Exception as error:
        raise PatternError(f"{path}: not a readable DXF file ({shown(error, 200)})") from None
    if named is None and units is None:
        raise PatternError(f"{path}: names no units; say them with --units (mm for most drawings)")
    scale = unit_scale(units, str(path)) if units is not None else named
    if units is not None and named is not None and not np.isclose(scale, named):
        raise PatternError(
            f"{path}: says that its unit is {named:g} m, but {units!r} was asked for; drop --units"
        )
    names = {entry.dxf.name: entry for entry in document.layers}
    if layer is not None and layer not in names:
        raise PatternError(f"{path}: has no layer {layer!r}; its layers are {', '.join(names)}")
    strokes: list[np.ndarray] = []
    try:
        check_dxf(document, path)
        for entity in disassemble.recursive_decompose(document.modelspace()):
            on = entity.dxf.layer
            if (
                entity.dxf.get("invisible")
                or (layer is not None and on != layer)
                or (layer is None and on in names and (names[on].is_off() or names[on].is_frozen()))
            ):
                continue
            try:
                whole = dxf_path.make_path(entity)
            except TypeError:  # text, dimensions: nothing to lay
                continue
            strokes += [_dxf_points(sub, scale, path) for sub in whole.sub_paths()]
    except PatternError:
        raise
    except Exception as error:  # of whichever of its entities
        raise PatternError(f"{path}: a shape cannot be read ({shown(error, 200)})") from None
    return strokes


def _dxf_points(sub, scale: float, path: Path) -> np.ndarray:
    from ezdxf.path import Command

    points = [np.array([[sub.start.x, sub.start.y]]) * scale]
    heights = [point.z * scale for point in sub.control_vertices()]
    if max(heights) - min(heights) > 1e-3 * sum(np.ptp([*sub.control_vertices()], axis=0) * scale):
        raise PatternError(
            f"{path}: a stroke rises by {max(heights) - min(heights):.3g} m; a pattern lies in one "
            "horizontal plane"
        )
    start = sub.start
    for command in sub.commands():
        if command.type == Command.LINE_TO:
            points.append(np.array([[command.end.x, command.end.y]]) * scale)
        else:
            from ezdxf.math import Bezier3P, Bezier4P

            if command.type == Command.CURVE3_TO:
                curve = Bezier3P([start, command.ctrl, command.end])
            else:
                curve = Bezier4P([start, command.ctrl1, command.ctrl2, command.end])
            length = curve.approximated_length(64) * scale
            count = count_points(length, _SPACING, path)
            part = [curve.point(t) for t in np.linspace(0.0, 1.0, count)[1:]]
            points.append(np.array([[p.x, p.y] for p in part]) * scale)
        start = command.end
    return _without_repeats(np.concatenate(points))


def _without_repeats(points: np.ndarray) -> np.ndarray:
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    keep = np.concatenate([[True], steps > 1e-9])
    return points[keep]
