import numpy as np
import pytest
from cli import refused, run, told


def test_show_says_what_a_drawing_is_and_what_a_rod_makes_of_it(tmp_path):
    drawing = tmp_path / "l.csv"
    drawing.write_text("x [mm],y [mm]\n0,0\n250,0\n250,250\n")
    picture = tmp_path / "l.png"
    figures = told("show", drawing, "--out", picture, "--json")
    assert figures["length"] == pytest.approx(0.5, abs=1e-3)
    assert figures["size"] == pytest.approx([0.25, 0.25], abs=2e-3)
    assert figures["departure_from_points"] < 1e-3
    assert picture.read_bytes()[:4] == b"\x89PNG"
    result = run("show", drawing, "--rod", "green-vps")
    assert result.exit_code == 0 and "are rounded to 94 1/m" in result.output
    refused("less than the radius of the rod", "show", "line", "--rod", "rope", "--resize", 1e-6)
    result = run("show", "letter-U", "--rod", "cable", "--lgb", "0.5")
    assert result.exit_code == 2


@pytest.mark.parametrize(("turns", "twice"), [(1.0, False), (1.5, True)])
def test_a_rod_that_is_to_lie_on_itself_is_said(tmp_path, turns, twice):
    angle = np.linspace(0.0, 2.0 * np.pi * turns, 100)
    np.savetxt(tmp_path / "ring.txt", 0.06 * np.column_stack([np.cos(angle), np.sin(angle)]))
    said = run("show", tmp_path / "ring.txt", "--rod", "green-vps").output
    assert ("already at s = 0.37" in said and "to 0.565 m" in said) == twice
    assert ("lies on" in said) == twice
    crossed = run("show", "letter-A", "--rod", "green-vps").output
    assert "lies on" not in crossed
