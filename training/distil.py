"""Distillation: a network learns what optimised plans do to the grip's path."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import torch
from wrod.training.plans import Sample

from wrod.controller.corrector import FEATURES, OUTPUTS, Corrector, Course, formula

_WIDTH, _DEPTH, _BATCH, _RATE, _DECAY = 64, 3, 2048, 2e-3, 1e-3
# Every so many plans one is held out, and every so many steps it is looked at.
_HELD_OUT, _LOOK = 8, 100


def course_of(sample: Sample) -> Course:
    """What a corrector is asked about the pattern of a plan."""
    return Course(
        sample.laid, sample.curvature, sample.length, sample.stretch_ratio, sample.friction
    )


def distil(
    samples: list[Sample],
    *,
    steps: int = 6000,
    seed: int = 0,
    progress: Callable[[], object] | None = None,
) -> Corrector:
    """Train a corrector; of every eight plans one is held out, and the weights that err least on
    these are kept.

    Args:
        samples: optimised plans, eight or more.
        steps: of the optimiser.
        seed: of weights and batches.
        progress: called after each step.

    Returns:
        The corrector. `metadata` says the root mean square of its error on the plans held out and
        of their corrections [L_gb].
    """
    generator = torch.Generator().manual_seed(seed)
    parts = [samples[_HELD_OUT - 1 :: _HELD_OUT], [s for i, s in enumerate(samples) if (i + 1) % 8]]
    (seen, wanted), (x, y) = (_table(part) for part in parts)
    scale = y.std(dim=0)
    sizes = [FEATURES, *[_WIDTH] * _DEPTH, OUTPUTS]
    weights = {"scale": scale}
    for layer, (fan_in, fan_out) in enumerate(pairwise(sizes)):
        noise = torch.randn(fan_out, fan_in, generator=generator, dtype=torch.float64)
        weights[f"weight.{layer}"] = (noise * fan_in**-0.5).requires_grad_()
        weights[f"bias.{layer}"] = torch.zeros(fan_out, dtype=torch.float64).requires_grad_()
    learnt = [value for name, value in weights.items() if name != "scale"]
    optimiser = torch.optim.AdamW(learnt, lr=_RATE, weight_decay=_DECAY)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    best: tuple[float, dict[str, np.ndarray]] | None = None
    for step in range(1, steps + 1):
        rows = torch.randint(len(x), (min(_BATCH, len(x)),), generator=generator)
        loss = (((formula(torch, weights, x[rows]) - y[rows]) / scale) ** 2).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        falling.step()
        if step % _LOOK == 0 or step == steps:
            with torch.no_grad():
                error = float(((formula(torch, weights, seen) - wanted) ** 2).mean().sqrt())
            if best is None or error < best[0]:
                best = error, {k: v.detach().numpy().copy() for k, v in weights.items()}
        if progress is not None:
            progress()
    assert best is not None
    figures = [course_of(s).figures() for s in samples]
    limits = {
        name: [min(f[name] for f in figures), max(f[name] for f in figures)] for name in figures[0]
    }
    limits["curvature"][0] = 0.0
    metadata = {
        "range": limits,
        "plans": len(samples),
        "held_out": len(parts[0]),
        "steps": steps,
        "seed": seed,
        "error": best[0],
        "correction": float((wanted**2).mean().sqrt()),
    }
    return Corrector(best[1], metadata)


def _table(samples: list[Sample]) -> tuple[torch.Tensor, torch.Tensor]:
    x = np.concatenate([course_of(s).features() for s in samples])
    y = np.concatenate([s.correction for s in samples])
    return torch.from_numpy(x), torch.from_numpy(y)
