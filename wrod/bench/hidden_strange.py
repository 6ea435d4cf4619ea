"""Clamped rods that change while they are measured, or in which something is wrong that no effect
of `identify` describes.

Nothing here has a plug-in. What changes in order is built from a print. What may be said of the
others is that they are not explained, or an effect at the right place of the right kind.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wrod.bench.continuous_rod import Experiment, constant, tangent_turn
from wrod.bench.hidden_effects import TRIALS, Hidden, _between, _direction, _in_plane, _vector


def warming(rng, rod):
    """The rod softens while it is measured, in every way alike, from trial to trial."""
    loss, pace = _between(rng, 0.3, 0.5), _between(rng, 6.0, 12.0)

    def left(trial):
        return 1.0 - loss * (1.0 - np.exp(-trial / pace))

    def each(trial, past):
        own = left(trial)
        return {"bending": constant(own, own), "twisting": own, "stretching": own}

    change = left(TRIALS - 1) / left(0) - 1.0
    truth = _vector("drift_of_stiffness", ("change_of_stiffness_ratio",), [change])
    return Hidden(Experiment(each=each), truth)


def moody(rng, rod):
    """The rod is stiffer in some trials than in others, in no order."""
    spread = _between(rng, 0.1, 0.25)
    factor = np.exp(spread * rng.normal(size=TRIALS))

    def each(trial, past):
        own = factor[trial]
        return {"bending": constant(own, own), "twisting": own, "stretching": own}

    return Hidden(Experiment(each=each), {})


def drying(rng, rod):
    """A wet rope: its weight falls from trial to trial."""
    water, pace = _between(rng, 0.4, 0.7), _between(rng, 6.0, 12.0)
    line = rod.weight / rod.gravity

    def left(trial):
        return water * np.exp(-trial / pace)

    change = (1.0 + left(TRIALS - 1)) / (1.0 + left(0)) - 1.0
    return Hidden(
        Experiment(each=lambda trial, past: {"mass": constant(left(trial) * line)}),
        _vector("drift_of_density", ("change_of_density_ratio",), [change]),
    )


def unwinding(rng, rod):
    """A rod off a spool loses its bend, by the logarithm of time."""
    bend, loss = _in_plane(rng, 0.3, 0.55) / rod.gravito_bending_length, _between(rng, 0.3, 0.6)

    def left(trial):
        return 1.0 - loss * np.log1p(trial) / np.log(TRIALS)

    keys = "change_of_curvature_1", "change_of_curvature_2"
    return Hidden(
        Experiment(each=lambda trial, past: {"curvature": constant(*(left(trial) * bend))}),
        _vector("drift_of_natural_curvature", keys, -loss * tangent_turn(bend)),
    )


def sinking_camera(rng, rod):
    """A tripod gives way, as much from each trial to the next."""
    way = _direction(rng) * _between(rng, 0.004, 0.008)
    gone = np.linspace(0.0, 1.0, TRIALS)[:, None, None]
    keys = tuple(f"change_of_offset_{axis}" for axis in "xyz")
    return Hidden(
        Experiment(see=lambda position, frame: position + gone * way),
        _vector("drift_of_camera_offset", keys, way),
    )


def creep(rng, rod):
    """The rod keeps a share of the curvature that the trial before gave it."""
    kept = _between(rng, 0.12, 0.2)

    def each(trial, past):
        if past is None:
            return {}
        s, curvature = past
        return {"curvature": lambda at: kept * np.stack([np.interp(at, s, c) for c in curvature])}

    return Hidden(Experiment(each=each), _vector("memory", ("kept_share",), [kept]))


def loose_clamp(rng, rod):
    """Clamp A has play: the rod lies against it on the side that it is bent to."""
    play = np.radians(_between(rng, 2.5, 4.5))

    def give(moment):
        across = moment * [1.0, 1.0, 0.0]
        return play * across / np.linalg.norm(across)

    return Hidden(Experiment(clamp_give=give), _vector("clamp_play", ("play",), [play]))


def soft_grip(rng, rod):
    """The gripper's fingers are rubber: they turn as the rod's moment asks."""
    compliance = _between(rng, 0.012, 0.025) * rod.length / rod.bending_stiffness
    return Hidden(
        Experiment(grip_give=lambda moment: compliance * moment * [1.0, 1.0, 0.5]),
        _vector("grip_compliance", ("compliance",), [compliance]),
    )


def sliding_markers(rng, rod):
    """Markers on half of the rod slide along it, further in each trial."""
    step = _between(rng, 4e-4, 7e-4, either_sign=True)
    place = _between(rng, 0.35, 0.65)

    def see(position, frame):
        u = np.linspace(0.0, 1.0, position.shape[1])
        loose = 1.0 / (1.0 + np.exp((place - u) / 0.02))
        slid = step * np.arange(TRIALS)[:, None] * loose * (u < 1.0)
        return position + slid[:, :, None] * frame[..., 2]

    return Hidden(Experiment(see=see), {})


def lens(rng, rod):
    """One camera's lens bends what is far from its axis."""
    bend = _between(rng, 0.15, 0.3, either_sign=True)
    axis, centre = _direction(rng), np.array([0.4, 0.0, 0.4]) + rng.uniform(-0.1, 0.1, 3)

    def see(position, frame):
        away = position - centre
        across = away - (away @ axis)[..., None] * axis
        return position + bend * (across**2).sum(axis=-1, keepdims=True) * across

    return Hidden(Experiment(see=see), {})


def rolling_shutter(rng, rod):
    """The camera is carried along while its picture is read out row after row, faster in some
    trials than in others."""
    skew = _between(rng, 0.015, 0.03, either_sign=True)  # way over height read meanwhile
    rail, centre = _direction(rng), np.array([0.4, 0.0, 0.4]) + rng.uniform(-0.1, 0.1, 3)
    rows = np.cross(rail, _direction(rng))
    rows /= np.linalg.norm(rows)
    pace = skew * rng.uniform(0.5, 1.5, TRIALS)

    def see(position, frame):
        return position + pace[:, None, None] * ((position - centre) @ rows)[..., None] * rail

    return Hidden(Experiment(see=see), {})


def shelf(rng, rod):
    """Something soft below: it pushes up where the rod hangs lower, in some trials only."""
    height = 0.43 - _between(rng, 0.3, 0.42) * rod.length
    stiff = _between(rng, 25.0, 50.0) * rod.weight  # [N/m] per metre of depth

    def force(q, t, s):
        up = np.zeros_like(q)
        up[2] = stiff * 2e-3 * np.logaddexp(0.0, (height - q[2]) / 2e-3)
        return up

    return Hidden(Experiment(drag=force), {})


# What comes or goes in the order of the trials, by one law or another.
CHANGING: tuple[Callable, ...] = (warming, drying, unwinding, sinking_camera, creep)
# Ends that give as the rod pulls at them.
GIVING: tuple[Callable, ...] = (loose_clamp, soft_grip)
# For each other kind: names that say what it is as far as they can, prints that are near the truth.
STRANGE: dict[Callable, tuple[tuple[str, ...], tuple[str, ...]]] = {
    moody: (("stiffness",), ("moment_with_curvature",)),
    sliding_markers: (("marker_offset",), ("markers",)),
    lens: (("camera_scale",), ("camera",)),
    rolling_shutter: (("camera_rotation",), ("camera",)),
    shelf: (("local_load",), ("force_in_laboratory", "force_in_material")),
}
