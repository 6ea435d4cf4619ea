"""What the documents tell a reader to type exists, and their Python runs."""

from __future__ import annotations

import contextlib
import re
import shlex
from pathlib import Path

import click
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


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=lambda p: p.name)
def test_python_of_documents_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for number, body in enumerate(blocks(page, "python")):
        exec(compile(body, f"{page.name}, block {number}", "exec"), names)
