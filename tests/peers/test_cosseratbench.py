"""Experiments that others wrote, scored by their metrics, through public names of wrod only."""

import ast
from pathlib import Path

import numpy as np
import pytest

import wrod
from wrod.errors import RodError

cosseratbench = pytest.importorskip("cosseratbench")


@pytest.mark.parametrize(
    ("name", "metric", "bound"),
    [
        ("cantilever", "tip_deflection_error", 1e-3),
        ("catenary", "shape_error", 6e-4),
        ("pendulum", "period_error", 3e-4),
        ("capstan", "slide", 5e-4),
    ],
)
def test_experiments(name, metric, bound):
    from cosseratbench import registry
    from cosseratbench.experiment import run

    from wrod.bench.cosserat_solver import WrodSolver

    summary = run(registry.load_experiment(name), WrodSolver()).summary()
    assert summary["outcome"] == "completed"
    assert summary["metrics"][metric] < bound


def test_the_adapter_needs_public_names_only():
    import wrod.bench.cosserat_solver as module

    tree = ast.parse(Path(module.__file__).read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert not node.module.startswith("wrod")
        if isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "wrod":
            assert node.attr in {*wrod.__all__, "__version__"}


def test_joined_rods_are_what_they_were():
    """Two rods that share a row have the energies of each alone, also one that remembers."""
    from wrod.rods.law import Linear, Plastic

    x = np.linspace(0.0, 0.3, 9)
    arc = np.column_stack([np.sin(6 * x), 1 - np.cos(6 * x), 0.2 * x])[None] / 6
    models = [
        wrod.RodModel(0.3, (1e-3, 2e-3), 7e-4, 900.0, 0.02, 0.002, law=law)
        for law in (Plastic(3.0, 0.1), Linear())
    ]
    batches = [
        wrod.RodBatch.of(m, x, arc + [0, 0, k], director=[0, 0, 1]) for k, m in enumerate(models)
    ]
    alone = sum(b.evaluate(order=1).energy.numpy()[0] for b in batches)
    joined, (first, second) = wrod.join_rods(batches)
    assert (first, second) == (slice(0, 9), slice(9, 18))
    assert joined.evaluate(order=1).energy.numpy()[0] == pytest.approx(alone, rel=1e-12)
    with pytest.raises(RodError, match="cut"):
        wrod.join_rods([joined, batches[0]])
