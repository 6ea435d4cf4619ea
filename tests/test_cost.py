"""Costs are said before the work, and refused where the machine has not that much."""

import math
import sys
import threading
from types import SimpleNamespace

import click
import pytest
from cli import refused

from wrod import cost, machine
from wrod.errors import DataError
from wrod.telling import json_option


@click.command()
@click.option("--out")
@cost.force_option
@json_option
@click.pass_obj
def command(work, out):
    """Does what is handed to it."""
    cost.settle(work, "work", "ask for less")


def settle(one, capsys, *given):
    command(list(map(str, given)), standalone_mode=False, obj=one)
    return capsys.readouterr().err


def test_small_work_begins_without_a_word(capsys):
    assert settle(cost.Cost(1.0, 1e6, 1e6), capsys) == ""


def test_long_work_is_said(capsys):
    said = settle(cost.Cost(7200.0, 3 * 2**30, 2e6), capsys)
    assert said == "wrod: work: about 2 h, 3 GiB of memory, 1.91 MiB on disk on this machine\n"


@pytest.mark.parametrize(
    ("one", "says"),
    [
        (cost.Cost(1.0, math.inf), "of memory are free"),
        (cost.Cost(1.0, 0.0, 1e30), "are free on the disk"),
        (cost.Cost(1e7), "more than a week"),
    ],
)
def test_what_the_machine_has_not_needs_force(one, says, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "available_memory", lambda: 1e9)
    with pytest.raises(DataError, match=f"work: about .*{says}.*ask for less, or give --force"):
        settle(one, capsys, "--out", tmp_path / "not" / "there")
    assert "about" in settle(one, capsys, "--force", "--out", tmp_path)
    assert settle(one, capsys, "--force", "--json") == ""


@pytest.mark.parametrize(
    "words",
    [
        "dataset --size 1000000000 --device cpu",
        "train --generate 500000000 --device cpu",
        "deploy line --rod green-vps --method intuitive --trials 10000 --speed 0.0005 --device cpu",
        "bench table3 --trials 10000 --device cpu",
        "bench applications --trials 10000 --case reef --device cpu",
    ],
)
def test_commands_refuse_weeks_before_they_work(words, tmp_path, monkeypatch):
    monkeypatch.setattr(cost, "usable_cores", lambda: 1)  # many would end it within a week
    out = tmp_path / "out"
    result = refused("about", *[*words.split(), "--out", str(out)])
    assert "--force" in result.output
    assert not list(out.rglob("*.safetensors")) and not list(out.rglob("*.npz"))


@pytest.mark.parametrize("bench", ["loop", "slippery"])
def test_steps_that_miss_what_happens_are_refused_before_the_work(bench, tmp_path):
    out = tmp_path / "out"
    refused("too far for what happens", "bench", bench, "--speed", "7", "--out", out)
    assert not list(out.rglob("*.*"))


def test_costs_grow_with_the_work():
    few = cost.deployments(1, 0.8, speed=0.02, step=0.01, spacing=0.005)
    many = cost.deployments(10, 0.8, speed=0.02, step=0.01, spacing=0.005)
    assert many.seconds == pytest.approx(10 * few.seconds) and many.memory > few.memory
    assert cost.pictures(4, 200, 100).seconds > cost.pictures(4, 100, 100).seconds
    small = cost.training(10, 64, 32, 3, 1000, device="cpu")
    assert cost.training(10, 64, 64, 3, 1000, device="cpu").seconds > small.seconds


def test_a_bar_that_nothing_moves_shows_that_time_goes_on(monkeypatch):
    shown = threading.Event()
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with cost.ticking(SimpleNamespace(refresh=shown.set)):
        assert shown.wait(30.0)


def test_kernels_that_have_to_be_compiled_first_are_said(tmp_path, monkeypatch, capsys):
    said = cost._say_that_kernels_are_compiled.__wrapped__
    warp = SimpleNamespace(config=SimpleNamespace(kernel_cache_dir=str(tmp_path)))
    monkeypatch.setitem(sys.modules, "warp", warp)
    said()
    assert "`wrod compile`" in capsys.readouterr().err
    (tmp_path / "wp_wrod.kernels.lanes_1").mkdir()
    said()
    assert capsys.readouterr().err == ""
