import dataclasses
import math

import pytest

import wrod
from wrod.errors import RodError, WrodWarning


def test_table_2_stretch_ratio_is_the_section_ratio():
    rod = wrod.rod("green-vps")
    assert rod.stretch_ratio == pytest.approx(1600.0)
    assert rod.stretching_stiffness * rod.gravito_bending_length**2 / rod.bending_stiffness == (
        pytest.approx(rod.stretch_ratio)
    )


def test_weight_in_dimensionless_units_is_one_half():
    rod = wrod.rod("rope")
    unit_force = rod.bending_stiffness / rod.gravito_bending_length**2
    assert rod.weight * rod.gravito_bending_length / unit_force == pytest.approx(0.5)


def test_youngs_modulus_round_trip():
    rod = wrod.RodMaterial.from_youngs_modulus(1.3e6, 0.0016, 0.9, density=1180.0)
    assert rod.youngs_modulus == pytest.approx(1.3e6)
    assert rod.stretching_stiffness == pytest.approx(1.3e6 * math.pi * 0.0016**2)


@pytest.mark.parametrize("field", ["radius", "gravito_bending_length", "length", "density"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_unphysical_values_are_named(field, value):
    values = {"radius": 0.0016, "gravito_bending_length": 0.03, "length": 0.9, field: value}
    with pytest.raises(RodError, match=field):
        wrod.RodMaterial(**values)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"radius": 0.4}, "gravito_bending_length .* at least 2 radii"),
        ({"length": 1e-3}, "length .* at least 10 radii"),
        ({"natural_curvature": (1e12, 0.0)}, "tighter than its own radius"),
        ({"gravito_bending_length": 5.0}, "stiffer than diamond"),
        ({"gravity": 9810.0}, "gravity is 9810.0; no rod has that"),
    ],
)
def test_what_is_no_rod_is_refused(changed, says):
    values = {"radius": 0.0016, "gravito_bending_length": 0.03, "length": 0.9} | changed
    with pytest.raises(RodError, match=says):
        wrod.RodMaterial(**values)


def test_models_that_are_no_rods_are_refused_where_they_are_read_and_planned(tmp_path):
    lump = dataclasses.replace(wrod.RodModel.of(wrod.rod("green-vps")), radius=0.4)
    with pytest.raises(RodError, match="at least 2 radii"):
        wrod.load_rod(wrod.save_rod(lump, tmp_path / "lump.json"))
    with pytest.raises(RodError, match="at least 2 radii"):
        wrod.plan(wrod.pattern("line"), lump, "intuitive")


def test_unknown_rod_lists_the_known_ones():
    with pytest.raises(RodError, match="green-vps"):
        wrod.rod("spaghetti")


def test_rod_file_round_trip(tmp_path):
    rod = wrod.RodMaterial(0.002, 0.03, 0.8, density=1000.0)
    assert wrod.load_rod(wrod.save_rod(rod, tmp_path / "rod.json")) == rod


@pytest.mark.parametrize(
    "content, says",
    [
        ("{", "ends in the middle of its JSON"),
        ("[1]", "must be an object, but is a list"),
        ('{"radius": 0.001}', "not a wrod-rod-1 file"),
        ('{"format": "wrod-rod-1", "radius": 0.001}', "gravito_bending_length"),
        ('{"format": "wrod-rod-1", "colour": 1}', "colour"),
        (
            '{"format": "wrod-rod-1", "radius": -1, "gravito_bending_length": 1, "length": 1}',
            "radius must be a number > 0",
        ),
        (
            '{"format": "wrod-rod-1", "radius": "a", "gravito_bending_length": 1, "length": 1}',
            "radius must be a number, but is text",
        ),
    ],
)
def test_bad_rod_files_are_named(tmp_path, content, says):
    path = tmp_path / "rod.json"
    path.write_text(content)
    with pytest.raises(RodError, match=rf"rod\.json: .*{says}"):
        wrod.load_rod(path)


@pytest.mark.parametrize(("radius", "lgb", "length"), [(1.6, 32.0, 885.0), (1.6e-3, 0.032, 885.0)])
def test_a_rod_in_millimetres_is_asked_after(radius, lgb, length):
    with pytest.warns(WrodWarning, match="millimetres"):
        wrod.RodMaterial(radius, lgb, length)
