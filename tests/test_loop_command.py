import json

import pytest
from click.testing import CliRunner

import wrod
from wrod.commands import main


def run(*arguments):
    return CliRunner().invoke(main, ["loop", *map(str, arguments)])


def test_loop_height_gives_the_rod_and_its_file(tmp_path):
    out = tmp_path / "rod.json"
    # Green VPS: L_gb = 3.2 cm, whose loop stands 1.14224 L_gb high.
    height = 1.14224 * 0.032
    result = run("--height", height, "--radius", 0.0016, "--length", 0.885, "--out", out, "--json")
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    assert figures["gravito_bending_length"] == pytest.approx(0.032, rel=1e-4)
    assert figures["stretch_ratio"] == pytest.approx(1600.0, rel=2e-4)
    # E = 8 rho g L_gb^3 / h^2 (Eq. material)
    modulus = 8 * 1180.0 * 9.81 * 0.032**3 / 0.0016**2
    assert figures["youngs_modulus"] == pytest.approx(modulus, rel=3e-4)
    assert wrod.load_rod(out).length == 0.885


@pytest.mark.parametrize(
    "changed, says",
    [
        ({"--height": 0}, "'--height': 0"),
        ({"--height": "nan"}, "'--height': nan"),
        ({"--radius": -1}, "'--radius': -1"),
        ({"--length": 0}, "'--length': 0"),
        ({"--density": 0}, "'--density': 0"),
        ({"--poisson": 0.7}, "'--poisson': 0.7"),
        ({"--out": "rod.txt"}, "not a .json file name"),
    ],
)
def test_bad_measurements_are_named(changed, says):
    options = {"--height": 0.0366, "--radius": 0.0016, "--length": 0.885} | changed
    result = run(*(part for pair in options.items() for part in pair))
    assert result.exit_code == 2
    assert says in result.stderr and result.stderr.count("\n") == 1
