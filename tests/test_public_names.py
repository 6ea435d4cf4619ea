"""Every public name is there in an installed wheel, outside the checkout."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from house import FOLDERS

import wrod

ROOT = Path(__file__).parents[1]
_IMPORT_ALL = """
import gc, json, sys
gc.disable()
sys.path[:0] = json.loads(sys.argv[1])
import wrod
places = {name: getattr(wrod, name).__module__ for name in wrod.__all__}
print(json.dumps([wrod.__file__, places]))
"""


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    build = f"from setuptools import build_meta; build_meta.build_wheel({str(folder)!r})"
    built = subprocess.run([sys.executable, "-c", build], capture_output=True, text=True, cwd=ROOT)
    assert built.returncode == 0, built.stderr
    (wheel,) = folder.glob("wrod-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


def test_every_public_name_imports_from_the_wheel(unpacked):
    libraries = [path for path in sys.path if path.endswith("site-packages")]
    # Without `site`, no editable install stands before the wheel.
    run = subprocess.run(
        [sys.executable, "-S", "-c", _IMPORT_ALL, json.dumps([str(unpacked), *libraries])],
        capture_output=True, text=True, cwd=unpacked.parent,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    file, places = json.loads(run.stdout)
    assert Path(file).is_relative_to(unpacked)
    assert set(places) == set(wrod.__all__)


def test_every_file_is_in_the_wheel(unpacked):
    """A folder that pyproject.toml does not list is missed by no checkout, and by every user."""
    for folder, package in FOLDERS.items():
        there = unpacked / package.replace(".", "/")
        for suffix in ("py", "pyi", "safetensors", "json", "csv", "urdf"):
            for file in (ROOT / folder).rglob(f"*.{suffix}"):
                assert (there / file.relative_to(ROOT / folder)).exists(), file
    assert (unpacked / "wrod_start.py").exists()


def test_wheel_tells_editors_its_types(unpacked):
    assert (unpacked / "wrod" / "py.typed").exists()
    assert (unpacked / "wrod" / "__init__.pyi").exists()


def test_names_are_listed():
    assert {"RodModel", "Dynamics", "plan", "identify"} <= set(dir(wrod))
    with pytest.raises(AttributeError):
        wrod.no_such_name  # noqa: B018


def test_rooms_are_reached_through_the_package():
    assert wrod.__getattr__("identification").load_motion is wrod.load_motion
    with pytest.raises(AttributeError):
        wrod.__getattr__("nosuch")
