import json

import numpy as np
import pytest
from cli import done, refused
from click.testing import CliRunner

from wrod.commands import main
from wrod.errors import PerceptionError

cv2 = pytest.importorskip("cv2")

from wrod.perception.metric import MarkerLayout, find_markers  # noqa: E402
from wrod.perception.scan import scan  # noqa: E402
from wrod.perception.sheet import MarkerSheet  # noqa: E402


def test_printed_sheet_is_read_back_to_a_tenth_of_a_millimetre(tmp_path):
    done("markers", "--paper", "a3", "--out", tmp_path)
    image = cv2.imread(str(tmp_path / "markers.png"))
    height, width = image.shape[:2]
    dots = 300 / 0.0254  # [1/m]
    assert (width, height) == pytest.approx((0.42 * dots, 0.297 * dots), abs=1.0)
    layout = MarkerLayout.load(tmp_path / "layout.json")
    assert sorted(layout.corners) == [0, 1, 2, 3]
    found = find_markers(image, layout)
    for number, corners in layout.corners.items():
        seen = found[number] / dots
        seen = np.column_stack([seen[:, 0], height / dots - seen[:, 1]])
        assert np.abs(seen - corners).max() < 2e-4  # two dots of 0.085 mm
    assert (tmp_path / "markers.pdf").read_bytes()[:5] == b"%PDF-"
    # The page itself is as large as the paper: PDF counts in 1/72 inch.
    box = (tmp_path / "markers.pdf").read_bytes().split(b"/MediaBox [")[1].split(b"]")[0]
    assert [float(v) for v in box.split()] == pytest.approx(
        [0, 0, 0.42 / 0.0254 * 72, 0.297 / 0.0254 * 72], abs=0.5
    )


def test_a_stroke_on_the_sheet_is_scanned_alone_in_metres(tmp_path):
    assert CliRunner().invoke(main, ["markers", "--out", str(tmp_path)]).exit_code == 0
    image = cv2.imread(str(tmp_path / "markers.png"))
    image = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    dots = 150 / 0.0254
    turn = np.linspace(0.0, np.pi, 200)
    arc = np.column_stack([0.15 - 0.06 * np.cos(turn), 0.08 + 0.06 * np.sin(turn)])
    pixels = np.column_stack([arc[:, 0], 0.21 - arc[:, 1]]) * dots
    cv2.polylines(image, [pixels.round().astype(np.int32)], False, (120, 40, 20), 9, cv2.LINE_AA)
    cv2.imwrite(str(tmp_path / "drawing.png"), image)
    pattern = scan(tmp_path / "drawing.png", markers=tmp_path / "layout.json")
    assert pattern.length == pytest.approx(0.06 * np.pi, abs=1.5e-3)
    x, y = pattern.sample(np.linspace(0.0, pattern.length, 60))[0][:, :2].T
    a, b, c = np.linalg.lstsq(np.column_stack([x, y, np.ones(60)]), x**2 + y**2, rcond=None)[0]
    radius = np.sqrt(c + (a**2 + b**2) / 4)
    assert radius == pytest.approx(0.06, abs=3e-4)
    assert np.abs(np.hypot(x - a / 2, y - b / 2) - radius).max() < 5e-4


@pytest.mark.parametrize(
    "options, says",
    [
        ({"size": (0.05, 0.05)}, "leave no room on a sheet of 50 x 50 mm"),
        ({"size": (0.3, 0.2), "side": 0.002}, "too small for a camera"),
        ({"size": (0.3, np.nan)}, "must be positive"),
    ],
)
def test_sheets_that_cannot_be_are_refused(options, says):
    with pytest.raises(PerceptionError, match=says):
        MarkerSheet(**options)


def test_bad_paper_leaves_nothing(tmp_path):
    out = tmp_path / "out"
    refused("--paper b17", "markers", "--paper", "b17", "--out", out)
    assert not out.exists()


def test_layout_is_that_of_docs(tmp_path):
    written = MarkerSheet((0.297, 0.21)).save(tmp_path)
    layout = json.loads(written[-1].read_text())
    assert layout["marker_corners_m"]["0"][0] == [0.008, 0.202]
