"""Scores of a controller against the numeric solver, on inputs that no training has seen."""

from __future__ import annotations

import numpy as np
from wrod.training.loop import figures

from wrod.bench.grasp import whole_range
from wrod.controller import Controller
from wrod.grasps import solve_grasps


def score(controller: Controller, count: int, *, seed: int, device: str = "cpu") -> dict:
    """Figures (see `wrod.training.loop.figures`) on `count` random inputs of the whole range.

    Half are uniform in l_s and half in its logarithm; kappa takes both signs.
    """
    inputs = whole_range(count, seed)
    grasps = solve_grasps(*inputs, device=device, shapes=False)
    good = grasps.converged & grasps.stable
    position, rotation = controller.predict(*inputs)
    error = np.concatenate([position - grasps.position, rotation - grasps.rotation], axis=1)
    return {**figures(error[good]), "left_out": int(np.sum(~good))}
