"""Options that would do nothing, and what this machine has too little of, are refused before any
work."""

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
    "plan line --rod rope --method numeric --controller {file} --out {out}": "--controller does",
    "dataset --size 8 --closure min_force --sensitivities --out {out}": "--sensitivities does",
    "render {file} --out {out}.mp4": "pictures are .png",
    "measure --overhang 0.07 --fall 0.03 --reading 1 --radius 0.001 --length 1": "shows no fall",
    "bench grasp --patience 3": "--patience does nothing",
    "bench grasp --against {folder} --count 8": "--count does nothing beside --against",
    "bench table3 --workers 2 --out {out}": "--workers does nothing",
    "bench table4 --patterns {folder} --controller {file} --closure min_force": "--closure does",
    "bench newton --worlds 2": "--worlds does nothing",
    "bench newton --bodies --many": "--many does nothing beside --bodies",
    "bench newton --bodies --edges 4": "--edges does nothing beside no --many",
    "bench loop --recording {file} --trials 3 --out {out}": "--trials does nothing",
    "bench loop --effect stiffness --curvature 3 --out {out}": "--curvature does nothing",
    "bench loop --controller numeric --grasps 200 --out {out}": "--grasps does nothing",
    "bench hands --data {folder} --quick --folds 3 --out {out}": "--folds does nothing",
    "bench photographs --data {folder} --quick --scenarios 3 --out {out}": "--scenarios does",
    "bench photographs --data {folder} --nothing-fitted --scenarios 3 --out {out}": "--scenarios",
}


@pytest.mark.parametrize("words, says", CASES.items())
def test_an_option_that_does_nothing_is_refused(words, says, tmp_path):
    file, out = tmp_path / "file.csv", tmp_path / "out"
    file.write_text("0 0\n0.1 0\n0.2 0\n")
    given = words.format(file=file, out=out, folder=tmp_path).split()
    refused(says, *given)
    assert sorted(tmp_path.iterdir()) == [file]


def test_fewer_addresses_than_scenes_need_are_refused(tmp_path, monkeypatch):
    import resource

    unlimited = resource.RLIM_INFINITY
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (2**30, unlimited))
    for words in ("render x.usda --out {}", "plan line --rod rope --out {}", "bench newton"):
        refused("may have 1 GiB (ulimit -v)", *words.format(tmp_path / "out").split())
    assert not list(tmp_path.iterdir())


def test_a_small_stack_is_refused(monkeypatch):
    import resource

    monkeypatch.setattr(resource, "getrlimit", lambda kind: (2**18, 2**18))
    refused("may have a stack of 256 KiB, and 512 are needed; raise that limit (ulimit -s)", "rods")


def test_a_controllers_test_is_part_of_its_cost(tmp_path, monkeypatch):
    monkeypatch.setattr("wrod.machine.available_memory", lambda: 10.0 * 2**30)
    words = ["train", "--generate", 100, "--steps", 1, "--width", 8, "--batch", 8]
    refused("10 GiB of memory are free", *words, "--test", 10**6, "--out", tmp_path / "a")
    assert not list(tmp_path.iterdir())
