"""Ends that give as the rod pulls at them: a clamp with play, fingers of rubber."""

import numpy as np

from wrod.identification.clamped.fit import Fit, fit_models
from wrod.identification.clamped.memory import Memory, bent
from wrod.identification.clamped.setup import rotation_of
from wrod.identification.clamped.trace import frames_of, memory_of
from wrod.identification.effect import Effect, Model, Parameter

# Times that what follows from the rods' shapes is taken from the last fit.
_SETTLES = 3
_TURN = 0.2  # [rad], as a turned end may well be
_ENDS = {"clamp": "clamp A", "grip": "the gripper"}
TURNS = {f"{end}_rotation" for end in _ENDS}


class Giving(Effect):
    """An end that turns across the rod as its moment there asks.

    Args:
        end: "clamp" or "grip".
        has_play: it turns by one angle to the side that it is pulled to; else in proportion.
        moment: (T, 3) of the rod on what holds it, across it, in the reported frame [N m].
    """

    def __init__(self, end: str, has_play: bool, moment: np.ndarray):
        size = np.linalg.norm(moment, axis=1, keepdims=True)
        self.end, self.has_play = end, has_play
        self.turn = moment / np.maximum(size, 1e-300) if has_play else moment
        key = "play" if has_play else "compliance"
        self.name = f"{end}_{key}"
        how = "by one angle to the side" if has_play else "in proportion to the moment"
        self.title = f"{_ENDS[end]} turns {how} that the rod pulls with"
        self.reference = "R -> R exp(rotation vector), along the rod's moment across its axis"
        unit, scale = ("rad", _TURN) if has_play else ("rad/(N m)", _TURN / float(size.mean()))
        self.parameters = (Parameter(key, unit, scale),)

    def apply(self, setup, values):
        turned = np.stack([rotation_of(values[0] * turn) for turn in self.turn[setup.trials]])
        field = f"{self.end}_rotation"
        setattr(setup, field, getattr(setup, field) @ turned)


def giving_of(laboratory, fit: Fit, end: str, has_play: bool) -> Giving:
    """The effect by the moments that rods have with a model."""
    m, place = laboratory.measurements, 0 if end == "clamp" else -1
    solver, setup = laboratory.solver_at(fit.model, fit.values)
    frames, tangents = frames_of(solver)
    curvature = bent(frames, tangents, m.material.length)
    own = (setup.bending * (curvature - setup.natural_curvature))[:, place]
    # The energy's slope in the angle of half an edge, of whose half the strain has the tangent.
    tangent = 0.25 * m.material.length / laboratory.edge_count * curvature[:, place]
    own *= 1.0 + (tangent**2).sum(axis=1, keepdims=True)
    # A moment is about the axis t x dt/ds; at its end the rod pulls the other way.
    along = np.stack([-own[:, 1], own[:, 0], 0.0 * own[:, 0]], axis=1)
    world = np.einsum("tij,tj->ti", frames[:, place], along if end == "clamp" else -along)
    reported = m.clamp_rotation if end == "clamp" else m.grip_rotation
    return Giving(end, has_play, np.einsum("tij,ti->tj", reported, world) * [1.0, 1.0, 0.0])


def giving_for(laboratory, fit: Fit, place: int) -> list[tuple[Effect, np.ndarray]]:
    """Ends that give, for which the effect at a place of a model may stand, with numbers to start
    from: a turn of an end for either kind there, a softer stretch for soft ends."""
    effect, values = fit.model.effects[place], fit.model.split(fit.values)[place]
    ways = {
        "clamp_rotation": [("clamp", True), ("clamp", False)],
        "grip_rotation": [("grip", True), ("grip", False)],
        "stretch": [("clamp", False), ("grip", False)],
    }.get(effect.name, [])
    found: list[tuple[Effect, np.ndarray]] = []
    for end, has_play in ways:
        giving = giving_of(laboratory, fit, end, has_play)
        size = (giving.turn**2).sum()
        turned = giving.turn.sum(axis=0) @ values / size if len(values) == 3 else 0.0
        found.append((giving, np.array([turned])))
    return found


def settled(laboratory, fit: Fit) -> Fit:
    """The fit with what follows from the rods' shapes, what they remember and how ends give, as its
    own rods have it: it was taken from those of a model before."""
    for _ in range(_SETTLES):
        own: list[Effect] = []
        for effect in fit.model.effects:
            if isinstance(effect, Memory):
                own.append(memory_of(laboratory, fit.model, fit.values))
            elif isinstance(effect, Giving):
                own.append(giving_of(laboratory, fit, effect.end, effect.has_play))
            else:
                own.append(effect)
        model = Model(tuple(own))
        if model == fit.model:
            break
        fit = fit_models(laboratory, [model], [fit.values], origin=fit, race=False)[0]
    return fit
