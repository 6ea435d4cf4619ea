"""The examples in Newton's manner meet their own criteria, and do not before they have run."""

import importlib
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from chosen import DEVICE
from newton.viewer import ViewerNull

FOLDER = Path(__file__).parents[1] / "examples" / "newton"
SLOW = ("arm_carries_cable", "gripper_picks_cable", "bundle_hysteresis", "plectoneme",
        "flick_cable")  # fmt: skip
TOOLS = ("pictures", "beside_vbd", "vbd_scene", "dismech_scene")
NAMES = sorted(path.stem for path in FOLDER.glob("*.py") if path.stem not in TOOLS)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in NAMES]
)
def test_example_meets_its_criteria(name, monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    module = importlib.import_module(name)
    example = module.Example(ViewerNull(num_frames=1), SimpleNamespace(device=DEVICE))
    example.step()
    with pytest.raises((ValueError, TypeError)):
        example.test_final()
    for _ in range(example.frame_count - 1):
        example.step()
    example.render()
    example.test_final()
    sys.modules.pop(name)
