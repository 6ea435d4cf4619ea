"""Clamped rods with hidden effects, made by a solver that shares nothing with the one that looks.

Every case is drawn at random from a seed: the rod, its poses, the size and the direction of what is
hidden, the noise. The layout is that of published sets: 24 trials (16 to fit on), 31 markers, a
wrist sensor, clamp A always rolled the same way.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit

from wrod.bench.continuous_rod import Experiment, constant, tangent_turn, turn_axis

TRIALS = 24
_AIR_DRAG = 1.2 * 1.2  # rho_air C_d, as the plug-in takes it [kg/m^3]
# A sleeve's ends go from a fifth to four fifths within three times this [m].
_SLEEVE_END = 5e-4
KINK_WIDTH, DRAUGHT_END, MAGNET_REACH = 0.008, 0.01, 0.05  # [m]

Truth = dict[tuple[str, ...], tuple[float, ...]]


@dataclass(frozen=True)
class Hidden:
    """What is hidden in a set.

    Attributes:
        experiment: the rod as it really is.
        truth: for each effect's name the true values of what a report says of it, by key; keys
            that make a vector stand together.
    """

    experiment: Experiment
    truth: dict[str, Truth]


# ---- effects that have a plug-in -----------------------------------------------------------------


def _between(rng, lower: float, upper: float, *, either_sign: bool = False) -> float:
    value = rng.uniform(lower, upper)
    return float(value * rng.choice([-1.0, 1.0]) if either_sign else value)


def _in_plane(rng, lower: float, upper: float) -> np.ndarray:
    angle = rng.uniform(-np.pi, np.pi)
    return rng.uniform(lower, upper) * np.array([np.cos(angle), np.sin(angle)])


def _bump(s, place: float, width: float) -> np.ndarray:
    """(K,) a bell of area 1 [1/m]."""
    return np.exp(-0.5 * ((s - place) / width) ** 2) / (width * np.sqrt(2 * np.pi))


def _vector(name: str, keys: tuple[str, ...], values) -> dict[str, Truth]:
    return {name: {keys: tuple(float(v) for v in values)}}


def stiff_along(factor: Callable, **more) -> Experiment:
    """A rod of which every stiffness, tension included, is `factor` (s) -> (K,) of the base's."""
    return Experiment(
        bending=lambda s: np.stack([factor(s)] * 2),
        twist_profile=factor,
        stretch_profile=factor,
        **more,
    )


def none(rng, rod):
    return Hidden(Experiment(), {})


def natural_curvature(rng, rod):
    k = _in_plane(rng, 0.3, 0.55) / rod.gravito_bending_length
    truth = _vector("natural_curvature", ("curvature_1", "curvature_2"), tangent_turn(k))
    return Hidden(Experiment(curvature=constant(*k)), truth)


def natural_helix(rng, rod):
    k = _in_plane(rng, 0.4, 0.6) / rod.gravito_bending_length
    rate = _between(rng, 6.0, 16.0, either_sign=True)

    def turning(s):
        c, d = np.cos(rate * s), np.sin(rate * s)
        return np.array([c * k[0] - d * k[1], d * k[0] + c * k[1]])

    truth = {
        "natural_helix": {
            ("curvature_1", "curvature_2"): tuple(map(float, tangent_turn(k))),
            ("turn_rate",): (rate,),
        }
    }
    return Hidden(Experiment(curvature=turning), truth)


def stiffness(rng, rod, log=(0.25, 0.5)):
    ratio = float(np.exp(_between(rng, *log, either_sign=True)))
    experiment = Experiment(bending=constant(ratio, ratio), twisting=ratio, stretching=ratio)
    return Hidden(experiment, _vector("stiffness", ("stiffness_ratio",), [ratio]))


def stiffness_gradient(rng, rod):
    ends = np.array([1.0, -1.0]) * rng.choice([-1, 1]) * rng.uniform(0.3, 0.55, 2)

    def factor(s):
        u = s / rod.length
        return 1.0 + ends[0] * (1.0 - u) + ends[1] * u

    truth = _vector("stiffness_gradient", ("change_at_clamp", "change_at_grip"), ends)
    return Hidden(stiff_along(factor), truth)


def anisotropic_bending(rng, rod):
    stiff, soft = _between(rng, 1.3, 1.7), _between(rng, 0.6, 0.85)
    angle = _between(rng, -1.4, 1.4)
    # The solver's stiffnesses are about axes; the report names the direction that the rod bends to.
    truth = {
        "anisotropic_bending": {
            ("stiffer_ratio",): (stiff,),
            ("softer_ratio",): (soft,),
            ("stiffer_direction",): (float(np.degrees(angle)) + 90.0,),
        }
    }
    return Hidden(Experiment(bending=constant(stiff, soft), principal=angle), truth)


def softening(rng, rod):
    return _bent_to(rng, rod, "softening", "kept_stiffness", (0.2, 0.5))


def stiffening(rng, rod):
    return _bent_to(rng, rod, "stiffening", "final_stiffness", (1.8, 3.0))


def _bent_to(rng, rod, name: str, key: str, range_: tuple[float, float]) -> Hidden:
    """A stiffness that goes to a share of itself as the rod is bent."""
    critical = _between(rng, 0.5, 0.9) / rod.gravito_bending_length
    left = _between(rng, *range_)

    def law(e):
        one = 1.0 + (e / critical) ** 2
        return e * (left + (1 - left) / one), left + (1 - left) * (2 - one) / one**2

    truth: dict[str, Truth] = {name: {("critical_curvature",): (critical,), (key,): (left,)}}
    return Hidden(Experiment(law=law), truth)


def softening_by_tanh(rng, rod):
    """The same effect by another law: M = B (r k + (1 - r) k_c tanh(k / k_c))."""
    critical = _between(rng, 0.3, 0.6) / rod.gravito_bending_length
    kept = _between(rng, 0.2, 0.5)

    def law(e):
        th = np.tanh(e / critical)
        return kept * e + (1 - kept) * critical * th, kept + (1 - kept) * (1 - th * th)

    return Hidden(Experiment(law=law), {"softening": {}})


def softening_by_yield(rng, rod):
    """A wire that yields: stiffness B up to k_c, r B beyond (bilinear), the corner rounded."""
    critical = _between(rng, 0.3, 0.6) / rod.gravito_bending_length
    kept = _between(rng, 0.2, 0.4)

    width = 0.05 * critical  # of the rounded corner

    def law(e):
        beyond = np.logaddexp(0.0, (e - critical) / width)
        at_rest = np.logaddexp(0.0, -critical / width)
        share = 1.0 / (1.0 + np.exp((critical - e) / width))
        return e - (1 - kept) * width * (beyond - at_rest), 1.0 - (1 - kept) * share

    truth: Truth = {("yield_curvature",): (critical,), ("hardening",): (kept,)}
    return Hidden(Experiment(law=law), {"yielding": truth})


def point_mass(rng, rod, share=(0.12, 0.24)):
    whole = rod.weight / rod.gravity * rod.length
    mass, place = _between(rng, *share) * whole, _between(rng, 0.25, 0.75) * rod.length
    experiment = Experiment(mass=lambda s: mass * _bump(s, place, 0.002)[None])
    return Hidden(experiment, {"point_mass": {("mass",): (mass,), ("arc_length",): (place,)}})


def density_profile(rng, rod):
    ends = np.array([1.0, -1.0]) * rng.choice([-1, 1]) * rng.uniform(0.25, 0.5, 2)
    line = rod.weight / rod.gravity

    def extra(s):
        u = s / rod.length
        return (line * (ends[0] * (1.0 - u) + ends[1] * u))[None]

    truth = _vector("density_profile", ("change_at_clamp", "change_at_grip"), ends)
    return Hidden(Experiment(mass=extra), truth)


def density(rng, rod):
    ratio = float(np.exp(_between(rng, 0.2, 0.4, either_sign=True)))
    extra = constant((ratio - 1.0) * rod.weight / rod.gravity)
    return Hidden(Experiment(mass=extra), _vector("density", ("density_ratio",), [ratio]))


def gravity_tilt(rng, rod, degrees=(2.0, 4.0)):
    turn = np.radians(_in_plane(rng, *degrees))
    truth = _vector("gravity_tilt", ("tilt_x", "tilt_y"), turn)
    return Hidden(Experiment(gravity_turn=np.append(turn, 0.0)), truth)


def air_flow(rng, rod):
    drag = _between(rng, 0.1, 0.2) * rod.weight  # on a rod straight across it [N/m]
    angle = _between(rng, -np.pi, np.pi)
    flow = np.array([np.cos(angle), np.sin(angle), 0.0])

    def force(q, t, s):
        across = flow[:, None] - (t * flow[:, None]).sum(axis=0) * t
        return drag * np.sqrt((across**2).sum(axis=0)) * across

    speed = float(np.sqrt(drag / (_AIR_DRAG * rod.radius)))
    truth = _vector("air_flow", ("drag_x", "drag_y", "drag_z"), drag * flow)
    truth["air_flow"][("speed",)] = (speed,)
    return Hidden(Experiment(drag=force), truth)


def grip_slip(rng, rod, metres=(0.005, 0.009)):
    slip = _between(rng, *metres, either_sign=True)
    return Hidden(Experiment(slip=slip), _vector("grip_slip", ("slip",), [slip]))


def grip_rotation(rng, rod):
    turn = np.append(np.radians(_in_plane(rng, 5.0, 8.0)), np.radians(rng.uniform(-8.0, 8.0)))
    truth = _vector("grip_rotation", ("rotation_1", "rotation_2", "roll"), turn)
    return Hidden(Experiment(grip_turn=turn), truth)


def clamp_rotation(rng, rod):
    turn = np.append(np.radians(_in_plane(rng, 5.0, 8.0)), np.radians(rng.uniform(-8.0, 8.0)))
    truth = _vector("clamp_rotation", ("rotation_1", "rotation_2", "roll"), turn)
    return Hidden(Experiment(clamp_turn=turn), truth)


def camera_scale(rng, rod):
    scale = _between(rng, 0.012, 0.025, either_sign=True)
    centre = rng.uniform(-0.3, 0.3, 3) + [0.4, 0.0, 0.4]
    experiment = Experiment(
        see=lambda position, frame: centre + (1.0 + scale) * (position - centre)
    )
    truth = _vector("camera_scale", ("offset_x", "offset_y", "offset_z"), -scale * centre)
    truth["camera_scale"][("scale",)] = (scale,)
    return Hidden(experiment, truth)


def camera_offset(rng, rod):
    offset = _direction(rng) * _between(rng, 0.004, 0.008)
    truth = _vector("camera_offset", ("offset_x", "offset_y", "offset_z"), offset)
    return Hidden(Experiment(see=lambda position, frame: position + offset), truth)


def camera_rotation(rng, rod):
    turn = _direction(rng) * np.radians(_between(rng, 0.8, 1.6))
    r, centre = Rotation.from_rotvec(turn).as_matrix(), rng.uniform(-0.1, 0.1, 3) + [0.4, 0.0, 0.4]
    truth = _vector("camera_rotation", ("rotation_x", "rotation_y", "rotation_z"), turn)
    return Hidden(Experiment(see=lambda x, frame: centre + (x - centre) @ r.T), truth)


def marker_offset(rng, rod):
    offset = np.append(_in_plane(rng, 0.003, 0.005), rng.uniform(-0.001, 0.001))
    truth = _vector("marker_offset", ("offset_1", "offset_2", "offset_tangent"), offset)
    return Hidden(Experiment(see=lambda position, frame: position + frame @ offset), truth)


def natural_twist(rng, rod):
    twist = _between(rng, 1.5, 3.5, either_sign=True)
    return Hidden(Experiment(twist=twist), _vector("natural_twist", ("twist",), [twist]))


def twist_stiffness(rng, rod):
    ratio = float(np.exp(_between(rng, 0.6, 1.0, either_sign=True)))
    truth = _vector("twist_stiffness", ("twist_stiffness_ratio",), [ratio])
    return Hidden(Experiment(twisting=ratio), truth)


def bend_twist(rng, rod):
    """Strands laid at an angle: the rod twists as it is bent."""
    ratio = _in_plane(rng, 0.3, 0.6)
    truth = _vector("bend_twist", ("coupling_1", "coupling_2"), ratio)
    return Hidden(Experiment(coupling=turn_axis(ratio)), truth)


# ---- effects that have none: five that `identify` builds, two that nothing explains -------------


def kink(rng, rod):
    """A sharp bend at one place."""
    place, bend = _between(rng, 0.3, 0.7) * rod.length, _in_plane(rng, 0.5, 0.8)
    truth = _vector("local_bend", ("angle_1", "angle_2"), bend)
    truth["local_bend"][("arc_length",)] = (place,)
    bent = Experiment(curvature=lambda s: bend[:, None] * _bump(s, place, KINK_WIDTH))
    return Hidden(bent, truth)


def half_draught(rng, rod):
    """A sideways force on the far half only."""
    place = _between(rng, 0.45, 0.6) * rod.length
    force = np.append(_in_plane(rng, 0.2, 0.35), 0.0)[:, None] * rod.weight
    truth = _vector("local_load", ("force_x", "force_y", "force_z"), force[:, 0])
    truth["local_load"][("start",)] = (place,)
    blown = Experiment(force=lambda s: force * expit((s - place) / DRAUGHT_END))
    return Hidden(blown, truth)


def sticking_roll(rng, rod):
    """The rod rolls in the gripper, another way in every trial."""
    return Hidden(Experiment(grip_turn=rng.normal(size=(TRIALS, 1)) * [0.0, 0.0, 0.7]), {})


def soft_spot(rng, rod):
    """A nick: four centimetres with an eighth of the stiffness, against twist as well."""
    place = _between(rng, 0.3, 0.7) * rod.length

    def factor(s):
        return 1.0 - 0.875 * np.exp(-((((s - place) / 0.02) ** 2) ** 2))

    away = np.linspace(-0.06, 0.06, 2001)
    softer = 1.0 / factor(place + away) - 1.0
    whole, spread = (np.trapezoid(x * softer, away) for x in (1.0, away**2))
    truth = _vector("stretch", ("extra_compliance",), [float(whole)])
    # It has no ends: these are those of the stretch that gives as much, as far from its middle.
    half = float(np.sqrt(3.0 * spread / whole))
    truth["stretch"][("start", "stop")] = (place - half, place + half)
    return Hidden(stiff_along(factor), truth)


def sleeve(rng, rod):
    """A stretch that something is pulled over: several times as stiff and as heavy."""
    start, length = _between(rng, 0.25, 0.6) * rod.length, _between(rng, 0.06, 0.1)
    stiff, heavy = _between(rng, 2.0, 4.0), _between(rng, 0.8, 1.6)
    line = rod.weight / rod.gravity

    def window(s):
        return expit((s - start) / _SLEEVE_END) * expit((start + length - s) / _SLEEVE_END)

    def factor(s):
        # Sections give one after another: an end is where half of the compliance is. Of a stiffness
        # half of which is there that is further out, by ln(stiff) of the end's width.
        return 1.0 / (1.0 + (1.0 / stiff - 1.0) * window(s))

    truth = _vector("stretch", ("extra_mass",), [heavy * line * length])
    truth["stretch"][("extra_compliance",)] = ((1.0 / stiff - 1.0) * length,)
    truth["stretch"][("start", "stop")] = (start, start + length)
    return Hidden(stiff_along(factor, mass=lambda s: heavy * line * window(s)[None]), truth)


def magnet(rng, rod):
    """Something in the laboratory that draws the rod towards one point."""
    point = np.array([0.4, 0.0, 0.2]) + rng.uniform(-0.05, 0.05, 3)
    strength = 2.25 * _between(rng, 0.4, 0.8) * rod.weight  # 0.1 m away [N/m]

    def force(q, t, s):
        away = point[:, None] - q
        return strength * 0.1**2 * away / ((away**2).sum(axis=0) + MAGNET_REACH**2) ** 1.5

    truth = _vector("attraction", ("x", "y", "z"), point)
    truth["attraction"][("strength",)] = (strength,)
    return Hidden(Experiment(drag=force), truth)


def shaking_camera(rng, rod):
    """Cameras that someone knocks between trials."""
    offset = 0.004 * rng.normal(size=(TRIALS, 1, 3))
    return Hidden(Experiment(see=lambda position, frame: position + offset), {})


def _direction(rng) -> np.ndarray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)
