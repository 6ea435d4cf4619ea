import numpy as np
import pytest
from scipy.spatial import cKDTree

import wrod
from tests.pen_drawings import CASES, photograph

MM = 1e-3
_SHARP = {"corners"}  # rounded by what sees them: the tip is cut by millimetres


@pytest.mark.parametrize("name", [name for name in CASES if name != "skips"])
def test_photograph_of_a_drawing_gives_the_drawn_curve(name, tmp_path):
    image, sheet = photograph(name)
    sheet.save(tmp_path)
    pattern = wrod.scan(image, markers=tmp_path / "layout.json")
    found = pattern.sample(np.linspace(0.0, pattern.length, 1500))[0][:, :2]
    drawn = CASES[name].points
    apart = np.r_[cKDTree(drawn).query(found)[0], cKDTree(found).query(drawn)[0]]
    assert apart.mean() < 0.2 * MM
    assert apart.max() < (3.0 if name in _SHARP else 0.6) * MM
    length = np.hypot(*np.diff(drawn, axis=0).T).sum()
    assert pattern.length == pytest.approx(length, rel=0.03 if name in _SHARP else 0.01)
