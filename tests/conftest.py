"""Fixtures that several test files use."""

import fcntl
import gc
import os
import pickle
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from compiled import leave_out_adjoints

import wrod

# Modules, kernels and tests are millions of objects that stay: looking through them again and again
# for garbage takes a quarter of the time that importing them does.
gc.disable()
gc.set_threshold(100_000, 20, 20)


# Kernels' modules that were compiled before the first test, and that tests had to wait for.
_there: dict[str, set[str]] = {}  # by the folder that they are in
_by_the_way: set[str] = set()


def pytest_collection_finish(session):
    """Leave what has been imported out of further searches for garbage, and adjoints that nobody
    launches out of what is compiled."""
    if session.items:  # one of several processes that only hands them out has none
        folder = leave_out_adjoints()
        _there[folder] = set(os.listdir(folder))
    gc.freeze()
    gc.enable()


def pytest_sessionfinish(session):
    """Tell what was compiled by the way, of each process of several."""
    told = getattr(session.config, "workeroutput", {})
    told["compiled"] = [n for f, had in _there.items() for n in os.listdir(f) if n not in had]
    _by_the_way.update(told["compiled"])


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    """A process of several has ended."""
    _by_the_way.update(getattr(node, "workeroutput", {}).get("compiled", []))


def pytest_unconfigure():
    """Nor is it looked through when the process ends."""
    gc.freeze()


@pytest.fixture
def on_coarse_meshes(monkeypatch):
    """Rods between clamps are identified on half of the edges, in half of the time."""
    from hidden import COARSE

    from wrod.identification.clamped.laboratory import Laboratory

    place = "wrod.identification.clamped.report.Laboratory"
    monkeypatch.setattr(place, partial(Laboratory, edge_count=COARSE))


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of published data that stands beside the repository; tests skip without it."""
    beside = Path(__file__).resolve().parents[1].parent / "shared"
    folder = Path(os.environ.get("WROD_SHARED", beside))
    if not folder.is_dir():
        pytest.skip("the folder of published data (../shared) is not here")
    return folder


@pytest.fixture(scope="session")
def once(tmp_path_factory):
    """A function: what a name stands for, made by another function in one of several processes."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent

    def shared_out(name, make):
        with open(folder / name, "a+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            if file.seek(0, os.SEEK_END):
                file.seek(0)
                try:
                    return replace(pickle.load(file))  # so that nobody writes into its arrays
                except (EOFError, pickle.UnpicklingError):  # of a process that was killed
                    file.truncate(0)
            made = make()
            pickle.dump(made, file)
            return made

    return shared_out


@pytest.fixture(scope="session")
def bend(once):
    """A bend of 0.25 m, and a plan of it for `vps.SHORT`."""
    import numpy as np
    from vps import SHORT

    s = np.linspace(0.0, 0.25, 400)
    heading = 0.5 * (1.0 + np.tanh((s - 0.15) / 0.04))
    points = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0) * s[1]
    pattern = wrod.Pattern.from_points(points)
    return pattern, once("bend", lambda: wrod.plan(pattern, SHORT, spacing=0.005))


@pytest.fixture(scope="session")
def letter(once):
    """An optimal trajectory of a letter C for rod 2, with the shapes of the rod."""
    pattern, rod = wrod.pattern("letter-C"), wrod.rod("green-vps")
    return once("letter", lambda: wrod.plan(pattern, rod, method="numeric", device="cpu"))


@pytest.fixture(scope="session")
def letter_path(once, letter):
    """Its joint path, placed automatically."""
    import torch

    torch.set_num_threads(1)
    return once("letter_path", lambda: wrod.solve_joint_path(letter))


@pytest.fixture
def tried(record_property):
    """Kind of hostile input -> (how many were tried, how many of them were refused)."""
    counts: dict[str, tuple[int, int]] = {}
    yield counts
    record_property("tried", counts)


def pytest_terminal_summary(terminalreporter):
    """Which kernels were compiled by the way, and which hostile inputs tried, over all tests."""
    if _by_the_way:
        names = {name.removeprefix("wp_").rpartition("_")[0] for name in _by_the_way}
        said = "kernels compiled meanwhile (`make setup` does it beforehand)"
        terminalreporter.line(f"{said}: {', '.join(sorted(names))}")
    tried, refused = Counter(), Counter()
    for reports in terminalreporter.stats.values():
        for report in reports:
            if getattr(report, "when", None) != "teardown":
                continue
            for kind, (count, out_of) in dict(report.user_properties).get("tried", {}).items():
                tried[kind] += count
                refused[kind] += out_of
    if tried:
        said = ", ".join(
            f"{n} {kind} ({refused[kind]} refused)" for kind, n in sorted(tried.items())
        )
        terminalreporter.line(f"hostile inputs tried: {tried.total()}: {said}")
