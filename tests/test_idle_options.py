"""Options that would do nothing beside others are refused, by name and before any work."""

import pytest
from cli import refused

CASES = {
    "render {file} --out {out}.html --frames 3": "--frames does nothing beside a page",
    "render {file} --out {out}.html --size 20x20": "--size does nothing beside a page",
    "render {file} --out {out}.png --moments --camera top": "--camera does nothing",
    "render {file} --out {out}.png --moments --hide robot": "--hide does nothing",
    "show line --tolerance 0.002": "--tolerance does nothing beside a pattern without a rod",
    "show line --out {out}.pdf": "is not a .png file name",
    "deploy line --rod rope --another-rod --out {out}": "--another-rod does nothing",
    "identify --template clamped --minutes 1 --out {out}": "--minutes does nothing",
    "identify --template clamped --test {file} --out {out}": "--test does nothing",
    "identify --template clamped --effect x --out {out}": "--effect does nothing",
    "scan {file} --start dot --out {out}": "--start does nothing beside a picture without a scale",
    "scan {file} --several --out {out}": "--several does nothing",
    "scan {file} --mask --kind ink --out {out}": "--kind does nothing beside --mask",
    "scan {file} --mask --color 1,2,3 --out {out}": "--color does nothing beside --mask",
    "measure {file} --reading 0.01 --radius 0.001 --length 1": "--reading does nothing",
    "bench hands --data {folder} --quick --folds 3 --out {out}": "--folds does nothing",
    "bench photographs --data {folder} --quick --scenarios 3 --out {out}": "--scenarios does",
}


@pytest.mark.parametrize("words, says", CASES.items())
def test_an_option_that_does_nothing_is_refused(words, says, tmp_path):
    file, out = tmp_path / "file.csv", tmp_path / "out"
    file.write_text("0 0\n0.1 0\n0.2 0\n")
    given = words.format(file=file, out=out, folder=tmp_path).split()
    refused(says, *given)
    assert sorted(tmp_path.iterdir()) == [file]
