import numpy as np
import pytest
from scipy.spatial import cKDTree

import wrod
from tests.pen_drawings import CASES, SHEET, photograph
from wrod.perception.gaps import join_gaps
from wrod.perception.trace import Centerline

MM = 1e-3
_SHARP = {"corners"}  # rounded by what sees them: the tip is cut by millimetres


@pytest.fixture(scope="module")
def layout(tmp_path_factory):
    """Of the sheet that all are drawn on, as its files have it."""
    folder = tmp_path_factory.mktemp("sheet")
    SHEET.save(folder)
    return folder / "layout.json"


@pytest.mark.parametrize("name", CASES)
@pytest.mark.filterwarnings("ignore:.*the stroke is broken")
def test_photograph_of_a_drawing_gives_the_drawn_curve(name, layout):
    pattern = wrod.scan(photograph(name), markers=layout)
    found = pattern.sample(np.linspace(0.0, pattern.length, 1500))[0][:, :2]
    drawn = CASES[name].points
    apart = np.r_[cKDTree(drawn).query(found)[0], cKDTree(found).query(drawn)[0]]
    assert apart.mean() < 0.2 * MM
    assert apart.max() < (3.0 if name in _SHARP else 0.6) * MM
    # The grip follows what the curve does between its bends, metres of it for centimetres of rod.
    bends = pattern.sample(np.arange(0.0, pattern.length, 2.5 * MM))[2]
    assert name in _SHARP or np.abs(np.diff(bends, 2)).mean() < 3.0
    length = np.hypot(*np.diff(drawn, axis=0).T).sum()
    assert pattern.length == pytest.approx(length, rel=0.03 if name in _SHARP else 0.01)


def stroke(*points):
    points = np.array(points, float)
    along = np.linspace(0.0, 1.0, 100)[:, None]
    return Centerline(points[0] + along * (points[1] - points[0]), np.full(100, 1.5))


def test_only_ends_that_go_on_in_each_other_are_joined():
    left, right = stroke((0, 0), (100, 0)), stroke((215, 8), (115, 2))
    (joined,), (gap,) = join_gaps([left, right])
    assert gap == pytest.approx(np.hypot(15, 2))
    assert joined.length == pytest.approx(215.5, abs=1.0)
    assert np.hypot(*np.diff(joined.points, axis=0).T).max() < 2.1
    beside = stroke((0, 12), (100, 12))
    assert join_gaps([left, beside])[1] == []
    corner = stroke((110, 5), (110, 100))
    assert join_gaps([left, corner])[1] == []
    far = stroke((160, 0), (260, 0))
    assert join_gaps([left, far])[1] == []
    # A fork: either branch could be meant.
    assert join_gaps([left, right, stroke((113, -4), (215, -12))])[1] == []
