"""Kernels compiled ahead, and a scene drawn by a process of its own."""

import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib import import_module
from threading import Event

import pytest
import warp as wp
from wrod.kernels import compiling
from wrod.kernels.stepping import deployment_tangents

from wrod.commands import compile as ahead
from wrod.scene import beside

DRAWS = "import sys; scene = sys.stdin.read(); sys.stdout.write('\x89PNG ' + scene)"
FAILS = "import sys; sys.stdin.read(); sys.exit(1)"


@pytest.fixture
def painted(monkeypatch, tmp_path):
    """What a process that runs this code makes of a scene, and whether it has ended after that."""

    def paint(code):
        encoding = "import sys; sys.stdout.reconfigure(encoding='latin-1'); "
        monkeypatch.setattr(beside, "_RUN", [sys.executable, "-c", encoding + code])
        painter = beside.Painter()
        painter.begin(tmp_path / "scene.usdc")
        picture = painter.finish()
        painter.end()
        return picture, painter._process.returncode

    return paint


def test_a_picture_comes_out_of_the_process(painted, tmp_path):
    picture, code = painted(DRAWS)
    assert picture == b"\x89PNG " + str(tmp_path / "scene.usdc").encode() and code == 0


@pytest.mark.parametrize("code", [FAILS, "import os; os._exit(3)", "print('no picture')"])
def test_a_process_that_draws_nothing_says_so(painted, code):
    assert painted(code)[0] is None


def test_the_process_ends_with_what_needed_it(monkeypatch):
    waits = [sys.executable, "-c", "import sys; sys.stdin.read(); import time; time.sleep(60)"]
    monkeypatch.setattr(beside, "_RUN", waits)
    monkeypatch.setattr(beside, "usable_cores", lambda: 2)
    monkeypatch.setattr(beside, "find_spec", lambda name: name)
    monkeypatch.delitem(sys.modules, "newton", raising=False)
    with beside.painting():
        process = beside.painter()._process
        assert process.poll() is None
    assert process.returncode is not None and beside.painter() is None
    monkeypatch.setattr(beside, "usable_cores", lambda: 1)
    with beside.painting():
        assert beside.painter() is None


def test_kernels_that_a_cpu_needs_are_compiled():
    """Each once, and with --all whatever there is for a CPU."""
    names, whole = ahead._wanted(rare=False), ahead._wanted(rare=True)
    assert {"wrod.kernels.elastic.bending", "wrod.kernels.contact.planes"} <= set(names)
    assert "wrod.kernels.contact.rods" not in names
    assert not any(name.endswith("adjoint") for name in names)
    assert len(set(whole)) == len(whole) and set(ahead._modules()) <= set(whole)
    assert set(names) < set(whole)
    assert not any(name.endswith(("_lanes", "_ends")) for name in whole)
    for name in whole:
        place, _, kernel = name.partition(":")
        assert hasattr(import_module(place), kernel or "__doc__")


def test_kernels_of_any_vector_are_compiled_for_those_of_a_cpu(monkeypatch):
    """What a module is compiled for is part of its name in the cache."""
    loaded = []
    monkeypatch.setattr(wp, "force_load", lambda device, modules, block_dim: loaded.extend(modules))
    ahead._compile_module(deployment_tangents.__name__)
    (module,) = loaded
    before = module.get_module_hash(1)
    deployment_tangents.vector_of(deployment_tangents.PACK)  # as a deployment does
    assert module.get_module_hash(1) == before
    generic = [kernel for kernel in module.kernels.values() if kernel.is_generic]
    assert generic and all(kernel.overloads for kernel in generic)


def test_what_cannot_be_compiled_is_said():
    assert "nowhere" in ahead._compile("cpu", "wrod.kernels.nowhere")


def test_where_waiting_is_interrupted_no_more_is_begun(monkeypatch):
    class Interrupted:
        def result(self):
            raise KeyboardInterrupt

    monkeypatch.setattr(compiling, "_compilers", cache(lambda: ThreadPoolExecutor(1)))
    going, end = Event(), Event()
    first = compiling._compilers().submit(lambda: going.set() or end.wait())
    next_one = compiling._compilers().submit(int)
    going.wait()
    with pytest.raises(KeyboardInterrupt):
        compiling.wait([Interrupted(), next_one])
    assert next_one.cancelled() and not first.cancelled()
    end.set()
    assert compiling._compilers().submit(int).result() == 0
