"""Distillation: a network learns what optimised plans do to the grip's path.

Many corrections lay a rod alike, and others do harm that are as small. What counts is therefore not
how far the network is from an optimised plan's corrections but what would lie: every plan brings
Gauss and Newton's models of its error along, around no corrections, its own, and those of networks
that were tried before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from wrod.training.plan_files import Sample

from wrod.controller.corrector import FEATURES, OUTPUTS, Corrector, CorrectorInputs, formula
from wrod.errors import DataError, needed_extras

with needed_extras():
    import torch

_WIDTH, _DEPTH, _BATCH, _RATE, _DECAY = 64, 2, 64, 3e-3, 0.05
# Plans that leave a larger error than this do not lie, and teach nothing [L_gb].
_LAID = 0.15
# Cost of the mean squared distance from corrections that were tried, near which alone the models of
# the error hold.
_APART = 3e-3
# Distance [L_gb] within which such corrections count alike, and error below which a plan counts as
# well laid [L_gb].
_NEAR, _ENOUGH = 0.02, 0.02
# Every so many plans one is held out, and every so many steps it is looked at.
_HELD_OUT, _LOOK = 8, 50


def course_of(sample: Sample) -> CorrectorInputs:
    """What a corrector is asked about the pattern of a plan."""
    return CorrectorInputs(
        sample.laid, sample.curvature, sample.length, sample.stretch_ratio, sample.friction
    )


def distil(
    samples: list[Sample],
    *,
    steps: int = 2000,
    seed: int = 0,
    progress: Callable[[], object] | None = None,
) -> Corrector:
    """Train a corrector; of every eight plans one is held out, and the weights whose corrections
    lay these best are kept.

    Args:
        samples: optimised plans.
        steps: of the optimiser.
        seed: of weights and batches.
        progress: called after each step.

    Returns:
        The corrector. `metadata` says the mean error of what lies [L_gb] by the models of the plans
        held out: "static" without corrections, "error" by the network's, "optimised" by the plans',
        "before" by those of the last network that laid them (None: none did).

    Raises:
        DataError: fewer than eight plans are left without those that err by more than 0.15 L_gb.
    """
    samples = [sample for sample in samples if sample.errors[1] < _LAID]
    if len(samples) < _HELD_OUT:
        raise DataError(
            f"{len(samples)} of the plans lay their patterns; optimise more, for {_HELD_OUT} are "
            "the least to learn from"
        )
    generator = torch.Generator().manual_seed(seed)
    apart = samples[_HELD_OUT - 1 :: _HELD_OUT]
    held = _Table.of(apart)
    rest = _Table.of([one for i, one in enumerate(samples) if (i + 1) % _HELD_OUT])
    weights = _first(rest, generator)
    learnt = [value for name, value in weights.items() if name != "scale"]
    optimiser = torch.optim.AdamW(learnt, lr=_RATE, weight_decay=_DECAY)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    best: tuple[float, dict[str, np.ndarray]] | None = None
    for step in range(1, steps + 1):
        chosen = rest[torch.randperm(len(rest), generator=generator)[:_BATCH]]
        error, besides = chosen.laid(weights)
        loss = (torch.sqrt(error + _ENOUGH**2) + besides).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        falling.step()
        if step % _LOOK == 0 or step == steps:
            with torch.no_grad():
                mean = float(held.laid(weights)[0].sqrt().mean())
            if best is None or mean < best[0]:
                best = mean, {k: v.detach().numpy().copy() for k, v in weights.items()}
        if progress is not None:
            progress()
    assert best is not None
    figures = [course_of(s).figures() for s in samples]
    limits = {
        name: [min(f[name] for f in figures), max(f[name] for f in figures)] for name in figures[0]
    }
    limits["curvature"][0] = 0.0
    errors = [sample.errors for sample in apart]
    before = [one[-1] for one in errors if len(one) > 2]
    metadata = {
        "range": limits,
        "plans": len(samples),
        "held_out": len(held),
        "steps": steps,
        "seed": seed,
        "static": float(np.mean([one[0] for one in errors])),
        "error": best[0],
        "optimised": float(np.mean([one[1] for one in errors])),
        "before": float(np.mean(before)) if before else None,
    }
    return Corrector(best[1], metadata)


def _first(table: _Table, generator: torch.Generator) -> dict[str, torch.Tensor]:
    """Weights to start from, whose corrections are small."""
    sizes = [FEATURES, *[_WIDTH] * _DEPTH, OUTPUTS]
    wanted = (table.basis @ table.anchors[:, 1])[table.there]
    weights = {"scale": wanted.std(dim=0)}
    for layer, (fan_in, fan_out) in enumerate(pairwise(sizes)):
        noise = torch.randn(fan_out, fan_in, generator=generator)
        size = fan_in**-0.5 * (0.1 if fan_out == OUTPUTS else 1.0)
        weights[f"weight.{layer}"] = (size * noise).requires_grad_()
        weights[f"bias.{layer}"] = torch.zeros(fan_out).requires_grad_()
    return weights


@dataclass(frozen=True)
class _Table:
    """Plans side by side, padded with nothing to the longest.

    features (plan, T, FEATURES), there (plan, T) whether there is a pose, basis (plan, T, n),
    inverse (plan, n, T) its pseudo-inverse, size (plan,) number of coefficients; anchors
    (plan, A, n, 3), tried (plan, A) whether there is one, and the models of the errors near them:
    value (plan, A), slope (plan, A, 3 n), matrix (plan, A, 3 n, 3 n).
    """

    features: torch.Tensor
    there: torch.Tensor
    basis: torch.Tensor
    inverse: torch.Tensor
    size: torch.Tensor
    anchors: torch.Tensor
    tried: torch.Tensor
    value: torch.Tensor
    slope: torch.Tensor
    matrix: torch.Tensor

    @classmethod
    def of(cls, samples: list[Sample]) -> _Table:
        return cls(
            _padded([course_of(s).features() for s in samples]),
            _padded([np.ones(len(s.laid)) for s in samples]) > 0.0,
            _padded([s.basis for s in samples]),
            _padded([np.linalg.pinv(s.basis) for s in samples]),
            torch.tensor([s.anchors[0].size for s in samples], dtype=torch.float32),
            _padded([s.anchors for s in samples]),
            _padded([np.ones(len(s.bowls)) for s in samples]) > 0.0,
            _padded([np.array([b.value for b in s.bowls]) for s in samples]),
            _padded([np.stack([b.slope for b in s.bowls]) for s in samples]),
            _padded([np.stack([b.matrix for b in s.bowls]) for s in samples]),
        )

    def __len__(self) -> int:
        return len(self.features)

    def __getitem__(self, chosen: torch.Tensor) -> _Table:
        return _Table(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def laid(self, weights: dict) -> tuple[torch.Tensor, torch.Tensor]:
        """(plan,) mean squared error of what lies by the network's corrections [L_gb^2], and what
        else they cost. Of the models of the error each counts the more the nearer it is."""
        moved = formula(torch, weights, self.features[self.there])
        corrections = torch.zeros(*self.there.shape, OUTPUTS, dtype=moved.dtype)
        corrections[self.there] = moved
        values = self.inverse @ corrections
        apart = (values[:, None] - self.anchors).flatten(2)
        far = (apart**2).sum(dim=2) / self.size[:, None]
        shares = self.tried / (far.detach() + _NEAR**2) ** 2
        shares = shares / shares.sum(dim=1, keepdim=True)
        half = torch.einsum("paij,paj->pai", self.matrix, apart)
        errors = self.value + ((2.0 * self.slope + half) * apart).sum(dim=2)
        error = (shares * errors.clamp(min=0.0)).sum(dim=1)
        return error, _APART * (shares * far).sum(dim=1)


def _padded(parts: list[np.ndarray]) -> torch.Tensor:
    """Arrays side by side, with zeros at the ends of those that are shorter."""
    shape = np.max([part.shape for part in parts], axis=0)
    out = np.zeros((len(parts), *shape), dtype=np.float32)
    for row, part in zip(out, parts, strict=True):
        row[tuple(slice(n) for n in part.shape)] = part
    return torch.from_numpy(out)
