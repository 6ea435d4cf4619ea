"""What follows from the rods' own shapes: ends that give as the rod pulls at them, a clamp with
play or fingers of rubber, and pulls that change with the place."""

from contextlib import suppress

import numpy as np

from wrod.errors import DataError
from wrod.identification.clamped.described import Attraction
from wrod.identification.clamped.fit import Fit, fit_models
from wrod.identification.clamped.memory import Memory, bent
from wrod.identification.clamped.setup import rotation_of
from wrod.identification.clamped.trace import frames_of, memory_of
from wrod.identification.effect import Effect, Model, Parameter

# Times that what follows from the rods' shapes is taken from the last fit.
_SETTLES = 3
# Passes in which rods and the pull at them come to agree within so much [m], and shapes that the
# next is made of.
_PASSES, _AGREED, _MIXED = 8, 1e-7, 4
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
    from: a turn of an end for either kind there, a softer stretch, or a profile of the stiffness
    that may be lower at an end, for soft ends."""
    effect, values = fit.model.effects[place], fit.model.split(fit.values)[place]
    ways = {
        "clamp_rotation": [("clamp", True), ("clamp", False)],
        "grip_rotation": [("grip", True), ("grip", False)],
        "stretch": [("clamp", False), ("grip", False)],
        "profile_of_stiffness": [("clamp", False), ("grip", False)],
    }.get(effect.name, [])
    found: list[tuple[Effect, np.ndarray]] = []
    for end, has_play in ways:
        giving = giving_of(laboratory, fit, end, has_play)
        size = (giving.turn**2).sum()
        turned = giving.turn.sum(axis=0) @ values / size if effect.name in TURNS else 0.0
        found.append((giving, np.array([turned])))
    return found


def sole_ends(laboratory, fit: Fit, base: Fit) -> list[Fit]:
    """The base model's fit with an end that gives, for all of a model that has several effects: at
    an end that it has slip, offset or turned, which one that gives looks like together."""
    names = fit.model.names if len(fit.model.effects) > 1 else []
    ends = [end for end in _ENDS if any(name.startswith(f"{end}_") for name in names)]
    models = [
        Model((giving_of(laboratory, fit, end, has_play),))
        for end in ends
        for has_play in (True, False)
    ]
    return fit_models(laboratory, models, [np.zeros(1) for _ in models], origin=base, race=False)


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


def pulled_at_own(laboratory, fit: Fit) -> Fit:
    """The fit with a pull towards a point at where its own rods are, if that leaves less: beside a
    strong one, what markers err by is a force in each trial that is not there."""
    places = [k for k, e in enumerate(fit.model.effects) if isinstance(e, Attraction)]
    for place in places[:1] * 2:
        effects, start = list(fit.model.effects), fit.model.split(fit.values)[place]

        def pulled(shape, effects=effects, start=start, place=place) -> Model:
            return Model((*effects[:place], Attraction([start], shape), *effects[place + 1 :]))

        with suppress(DataError):
            model = pulled(_own_shape(laboratory, pulled, fit.values))
            own = fit_models(laboratory, [model], [fit.values], origin=fit, race=False)[0]
            fit = min(fit, own, key=lambda f: f.chi_squared)
    return fit


def _own_shape(laboratory, pulled, values: np.ndarray) -> np.ndarray:
    """(T, n + 1, 3) shapes that rods have which are pulled there (Anderson 1965): to be pulled
    where they were the pass before leads some away."""
    asked, given = [laboratory.base.measured], []
    for _ in range(_PASSES):
        solver, _ = laboratory.solver_at(pulled(asked[-1]), values)
        given.append(solver.batch.positions()[:, 1:-1])
        if np.abs(given[-1] - asked[-1]).max() < _AGREED:
            return given[-1]
        asked.append(_mixed(np.array(asked[-_MIXED:]), np.array(given[-_MIXED:])))
    raise DataError("rods that are pulled towards a point come to no shapes of their own")


def _mixed(asked: np.ndarray, given: np.ndarray) -> np.ndarray:
    """(T, n + 1, 3) combination of (k, T, n + 1, 3) shapes that changes least, trial by trial."""
    out = given[-1].copy()
    for trial in range(out.shape[0]):
        shapes = given[:, trial].reshape(len(given), -1)
        change = shapes - asked[:, trial].reshape(len(given), -1)
        share = np.linalg.lstsq(np.diff(change, axis=0).T, change[-1], rcond=1e-8)[0]
        out[trial] -= (share @ np.diff(shapes, axis=0)).reshape(out[trial].shape)
    return out
