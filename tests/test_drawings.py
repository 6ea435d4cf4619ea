import numpy as np
import pytest

import wrod
from wrod.errors import PatternError

ezdxf = pytest.importorskip("ezdxf")
pytest.importorskip("svgelements")

# As Inkscape writes it: millimetres, a viewBox, layers with labels, one hidden, a transform.
INKSCAPE = """<?xml version="1.0" encoding="UTF-8" standalone="no"?>
<svg width="210mm" height="297mm" viewBox="0 0 210 297" version="1.1"
   xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"
   xmlns="http://www.w3.org/2000/svg">
  <g inkscape:label="guides" inkscape:groupmode="layer" id="layer1" style="display:none">
    <path d="M 0,0 L 210,297" id="path1" style="fill:none;stroke:#ff0000"/></g>
  <g inkscape:label="cable" inkscape:groupmode="layer" id="layer2" transform="translate(10,20)">
    <path id="path2" style="fill:none;stroke:#000000"
      d="m 20,200 h 60 c 40,0 40,-80 0,-80 l -60,0"/></g>
  <g inkscape:label="notes" inkscape:groupmode="layer" id="layer3">
    <path id="path3" d="M 150,250 L 180,250 L 200,240"/></g>
</svg>
"""


def test_inkscape_drawing_has_its_size_layers_and_upright_axes(tmp_path):
    path = tmp_path / "drawing.svg"
    path.write_text(INKSCAPE)
    with pytest.raises(PatternError, match=r"drawing\.svg: holds 2 strokes .* --stroke"):
        wrod.Pattern.load(path)
    with pytest.raises(PatternError, match="no layer 'wire'; its layers are cable, notes"):
        wrod.Pattern.load(path, layer="wire")
    with pytest.raises(PatternError, match="drop --units"):
        wrod.Pattern.load(path, units="mm")
    pattern = wrod.Pattern.load(path, layer="cable")
    t = np.linspace(0.0, 1.0, 20001)[:, None]
    control = np.array([[0.08, 0.0], [0.12, 0.0], [0.12, 0.08], [0.08, 0.08]])
    weights = np.hstack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3])
    arc = np.linalg.norm(np.diff(weights @ control, axis=0), axis=1).sum()
    assert pattern.length == pytest.approx(0.12 + arc, abs=1e-4)
    ends = pattern.sample([0.0, pattern.length])[0][:, :2]
    np.testing.assert_allclose(ends[1] - ends[0], [0.0, 0.08], atol=2e-4)  # up is up
    assert pattern.departure()[0] < 1e-4


def test_strokes_that_a_drawing_uses_from_its_definitions_are_read(tmp_path):
    path = tmp_path / "used.svg"
    used = INKSCAPE.replace('<path id="path2"', '<defs><path id="path2"', 1)
    used = used.replace('-60,0"/></g>', '-60,0"/></defs><use href="#path2" x="5"/></g>')
    path.write_text(used)
    pattern = wrod.Pattern.load(path, layer="cable")
    ends = pattern.sample([0.0, pattern.length])[0][:, :2]
    np.testing.assert_allclose(ends[:, 0], 0.035, atol=2e-4)
    np.testing.assert_allclose(ends[1] - ends[0], [0.0, 0.08], atol=2e-4)


def a_drawing(tmp_path, units=4):
    document = ezdxf.new()
    document.header["$INSUNITS"] = units
    space = document.modelspace()
    document.layers.add("cable")
    document.layers.add("frame")
    space.add_line((0, 0), (200, 0), dxfattribs={"layer": "cable"})
    space.add_arc((200, 100), 100, -90, 90, dxfattribs={"layer": "cable"})
    space.add_lwpolyline([(200, 200), (100, 200)], dxfattribs={"layer": "cable"})
    space.add_line((-50, -50), (400, -50), dxfattribs={"layer": "frame"})
    path = tmp_path / "drawing.dxf"
    document.saveas(path)
    return path


def test_dxf_joins_lines_arcs_and_polylines_of_a_layer(tmp_path):
    pattern = wrod.Pattern.load(a_drawing(tmp_path), layer="cable")
    assert pattern.length == pytest.approx(0.3 + 0.1 * np.pi, abs=1e-4)
    s = np.array([0.1, 0.2 + 0.05 * np.pi, pattern.length - 0.05])
    position, _, curvature = pattern.sample(s)
    forward = position[0][0] < position[1][0]
    assert forward and np.allclose(position[1][:2], [0.3, 0.1], atol=2e-4)
    assert curvature[1] == pytest.approx(10.0, rel=0.02)


def test_dxf_units_and_strokes_are_asked_for(tmp_path):
    path = a_drawing(tmp_path, units=0)
    with pytest.raises(PatternError, match=r"drawing\.dxf: names no units; say them with --units"):
        wrod.Pattern.load(path)
    with pytest.raises(PatternError, match="holds 2 strokes"):
        wrod.Pattern.load(path, units="mm")
    assert wrod.Pattern.load(path, units="mm", stroke=2).length == pytest.approx(0.45)
    path = a_drawing(tmp_path)
    with pytest.raises(PatternError, match="its unit is 0.001 m, but 'cm'".replace(".", r"\.")):
        wrod.Pattern.load(path, units="cm")


@pytest.mark.parametrize(
    "name, text",
    [("a.svg", "<svg"), ("a.svg", "<svg xmlns='x'/>"), ("a.dxf", "not a drawing")],
)
def test_broken_drawings_are_named(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(PatternError, match=name.replace(".", r"\.")):
        wrod.Pattern.load(path)


def test_layers_belong_to_drawings(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("0 0\n0.1 0\n0.2 0.01\n0.3 0.03\n")
    with pytest.raises(PatternError, match="belong to SVG and DXF"):
        wrod.Pattern.load(path, layer="cable")


def test_dxf_of_space_is_refused_and_what_is_invisible_is_left_out(tmp_path):
    document, path = ezdxf.new(), tmp_path / "a.dxf"
    document.header["$INSUNITS"] = 4
    space = document.modelspace()
    space.add_line((0, 0, 7), (300, 50, 7))
    hidden = space.add_line((0, 0, 0), (300, 50, 900), dxfattribs={"invisible": 1})
    document.saveas(path)
    assert wrod.Pattern.load(path).length == pytest.approx(0.3041, abs=1e-4)
    hidden.dxf.invisible = 0
    document.saveas(path)
    with pytest.raises(PatternError, match=r"rises by 0\.9 m"):
        wrod.Pattern.load(path)
