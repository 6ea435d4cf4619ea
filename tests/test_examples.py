"""Every example runs and ends in a picture that shows something."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[1] / "examples"
# What makes an example short enough for a test.
SMALL = {
    "grasps_over_curvature": {"count": 20},
    "gradients_in_torch": {"steps": 5},
    "lay_on_two_tables": {"spacing": 0.02},
    "swinging_cable": {"seconds": 0.4},
    "thousand_hanging_cables": {"count": 40},
}
NAMES = sorted(path.stem for path in FOLDER.glob("[!_]*.py"))


def test_there_are_examples():
    assert len(NAMES) >= 8


@pytest.mark.parametrize("name", NAMES)
def test_example_ends_in_a_picture(name, tmp_path, monkeypatch):
    from matplotlib import image

    monkeypatch.syspath_prepend(str(FOLDER))
    module = importlib.import_module(name)
    if not hasattr(module, "main"):
        pytest.skip("runs inside another program")
    picture = module.main(out=tmp_path, **SMALL.get(name, {}))
    pixels = image.imread(picture)[..., :3]
    assert min(pixels.shape[:2]) >= 300
    assert np.mean(np.any(pixels < 0.9, axis=2)) > 0.005  # more than a white sheet
    sys.modules.pop(name)
