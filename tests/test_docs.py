"""What the documents tell a reader to type exists, and their Python runs."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest

from wrod.commands import main

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.M | re.S)


def blocks(page: Path, language: str) -> list[str]:
    return [body for kind, body in BLOCK.findall(page.read_text()) if kind == language]


def command_lines(page: Path) -> list[list[str]]:
    """The lines of shell blocks that call wrod, and inline code that does, as words."""
    text = page.read_text()
    lines = [line for body in blocks(page, "sh") for line in body.replace("\\\n", " ").splitlines()]
    lines += re.findall(r"`(wrod [^`]*)`", text.replace("\n", " "))
    words = [shlex.split(line, comments=True) for line in lines]
    return [w[w.index("wrod") + 1 :] for w in words if "wrod" in w and "..." not in w]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_command_and_option_exists(page):
    for words in command_lines(page):
        command: click.Command = main
        context = click.Context(main, info_name="wrod")
        while isinstance(command, click.Group) and words and not words[0].startswith("-"):
            name, *words = words
            command = command.get_command(context, name)
            assert command is not None, f"{page.name}: wrod {name}"
            context = click.Context(command, parent=context, info_name=name)
        with contextlib.suppress(click.BadOptionUsage):  # an option named without its value
            command.make_parser(context).parse_args(list(words))


LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda p: p.name)
def test_every_file_that_is_linked_is_there(page):
    links = [link for link in LINK.findall(page.read_text()) if "://" not in link]
    assert not [link for link in links if not (page.parent / link).exists()]


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # for plug-ins
def test_site_has_no_warnings(tmp_path):
    """All pages and docstrings are read and their links followed, as by `make docs`; none is
    written, which takes three times as long, nor are quotes made round."""
    application = pytest.importorskip("sphinx.application")
    from sphinx.util.docutils import docutils_namespace, patch_docutils

    said = io.StringIO()
    with patch_docutils(), docutils_namespace():
        where = (ROOT / "docs", ROOT / "docs", tmp_path, tmp_path / "trees")
        how = {"confoverrides": {"smartquotes": False}, "status": None, "warning": said}
        application.Sphinx(*where, "dummy", **how).build(force_all=True)
    assert not said.getvalue()


# Python of own-measurements.md is run with tables by test_own_tables.py.
RUN = [p for p in PAGES if blocks(p, "python") and p.stem != "own-measurements"]


@pytest.mark.parametrize("page", RUN, ids=lambda p: p.name)
def test_python_of_documents_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for number, body in enumerate(blocks(page, "python")):
        exec(compile(body, f"{page.name}, block {number}", "exec"), names)


# Commands that the slow test leaves out: benches print their own figures, a card is not everywhere,
# and of these files there are no stand-ins.
ELSEWHERE = ("wrod bench", "--device cuda:0", "...", "loop.jpg", "-train.npz", "DATA.npz")


def typed(page: Path) -> list[str]:
    """Lines of a page's shell blocks that call wrod, as a reader types them."""
    text = "\n".join(body for body in blocks(page, "sh")).replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line.startswith(("wrod ", "python -m wrod"))]
    return [line for line in lines if not any(word in line for word in ELSEWHERE)]


def stand_ins(page: Path, folder: Path, shared: Path) -> None:
    """What a page's reader has of their own: photographs, measurements, an arm, a cell, a rod."""
    import json

    from top_camera import TopCamera

    import wrod

    text, drawn = page.read_text(), shared / "images" / "drawn"
    shutil.copytree(ROOT / "examples", folder / "examples")
    (folder / "out").mkdir()
    shutil.copy(drawn / "layout.json", folder)
    shutil.copy(drawn / "images" / "A.jpg", folder / "photo.jpg")
    shutil.copy(drawn / "images" / "U.jpg", folder / "drawing.jpg")
    shutil.copy(ROOT / "scenes" / "robots" / "sawyer.urdf", folder / "arm.urdf")
    for cell in blocks(page, "json"):
        if isinstance(json.loads(cell), list):
            (folder / "cell.json").write_text(cell)
    if any("--sheet" in line for line in typed(page)):
        from PIL import Image
        from test_perception_scan import HEIGHT, WIDTH, drawing, wave

        from wrod.perception.metric import MarkerLayout

        camera = TopCamera((WIDTH / 2, HEIGHT / 2, 0.5), (WIDTH / 2, HEIGHT / 2, 0.0))
        picture = drawing(camera, MarkerLayout({}, (WIDTH, HEIGHT)), wave())
        Image.fromarray(np.asarray(picture)).save(folder / "drawing.jpg", quality=95)
    if "measurements.npz" in text:
        run_typed("wrod identify --template clamped --out out/template", folder)
        shutil.copy(folder / "out" / "template" / "clamped.npz", folder / "measurements.npz")
    if "markers.csv" in text:
        from own_tables import write_tables

        write_tables(folder)
    if "model.json" in text:
        model = wrod.RodModel.of(wrod.rod("green-vps"))
        wrod.save_rod(replace(model, natural_curvature=(0.0, 4.0)), folder / "model.json")


def run_typed(line: str, folder: Path) -> None:
    words = shlex.split(line, comments=True)
    words = words[1:] if words[0] == "python" else ["-m", "wrod", *words[1:]]
    end = subprocess.run([sys.executable, *words], cwd=folder, capture_output=True, text=True)
    assert end.returncode == 0, f"{line}\n{end.stdout[-2000:]}\n{end.stderr[-2000:]}"


@pytest.mark.slow
@pytest.mark.parametrize("page", [p for p in PAGES if typed(p)], ids=lambda p: p.stem)
def test_commands_of_documents_run(page, tmp_path, monkeypatch, shared):
    stand_ins(page, tmp_path, shared)
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for kind, body in BLOCK.findall(page.read_text()):
        if kind == "python":
            exec(compile(body, page.name, "exec"), names)
        elif kind == "sh":
            lines = body.replace("\\\n", " ").splitlines()
            for line in lines:
                if line in typed(page):
                    run_typed(line, tmp_path)
