"""Sets of measurements with something hidden: the cases, their rods and poses."""

import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields, replace

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.bench import hidden_effects as hidden_in
from wrod.bench.continuous_rod import Experiment, measured
from wrod.bench.hidden_effects import TRIALS, Hidden
from wrod.bench.hidden_noise import with_noise
from wrod.bench.hidden_profiles import PROFILES
from wrod.bench.hidden_strange import CHANGING, GIVING, STRANGE
from wrod.errors import DataError
from wrod.identification.template import labels
from wrod.rods.material import RodMaterial

_REDRAWS = 3
TEST_TRIALS, MARKERS, NOISE = 8, 31, 5e-4

KNOWN: dict[str, Callable] = {
    f.__name__: f
    for f in (
        hidden_in.natural_curvature,
        hidden_in.natural_helix,
        hidden_in.natural_twist,
        hidden_in.stiffness,
        hidden_in.stiffness_gradient,
        hidden_in.anisotropic_bending,
        hidden_in.twist_stiffness,
        hidden_in.bend_twist,
        hidden_in.softening,
        hidden_in.stiffening,
        hidden_in.softening_by_tanh,
        hidden_in.softening_by_yield,
        hidden_in.point_mass,
        hidden_in.density,
        hidden_in.density_profile,
        hidden_in.gravity_tilt,
        hidden_in.air_flow,
        hidden_in.grip_slip,
        hidden_in.grip_rotation,
        hidden_in.clamp_rotation,
        hidden_in.camera_scale,
        hidden_in.camera_offset,
        hidden_in.camera_rotation,
        hidden_in.marker_offset,
    )
}
PAIRS = (
    (hidden_in.natural_curvature, hidden_in.gravity_tilt),
    (hidden_in.natural_curvature, hidden_in.point_mass),
    (hidden_in.natural_curvature, hidden_in.grip_slip),
    (hidden_in.natural_curvature, hidden_in.stiffness),
    (hidden_in.natural_curvature, hidden_in.softening),
    (hidden_in.natural_curvature, hidden_in.camera_offset),
    (hidden_in.natural_helix, hidden_in.camera_rotation),
    (hidden_in.natural_helix, hidden_in.grip_slip),
    (hidden_in.gravity_tilt, hidden_in.point_mass),
    (hidden_in.gravity_tilt, hidden_in.stiffness),
    (hidden_in.gravity_tilt, hidden_in.grip_slip),
    (hidden_in.point_mass, hidden_in.grip_slip),
    (hidden_in.point_mass, hidden_in.stiffness_gradient),
    (hidden_in.softening, hidden_in.point_mass),
    (hidden_in.stiffness, hidden_in.grip_rotation),
    (hidden_in.stiffness, hidden_in.camera_scale),
    (hidden_in.air_flow, hidden_in.grip_slip),
    (hidden_in.density_profile, hidden_in.grip_rotation),
    (hidden_in.anisotropic_bending, hidden_in.gravity_tilt),
)
# A large effect, a small one beside it, and its sizes.
SLIGHT = (
    (hidden_in.point_mass, hidden_in.stiffness, (0.03, 0.09)),
    (hidden_in.natural_curvature, hidden_in.stiffness, (0.03, 0.09)),
    (hidden_in.stiffness, hidden_in.point_mass, (0.02, 0.05)),
    (hidden_in.softening, hidden_in.point_mass, (0.02, 0.05)),
    (hidden_in.natural_curvature, hidden_in.gravity_tilt, (0.3, 0.7)),
    (hidden_in.gravity_tilt, hidden_in.grip_slip, (4e-4, 1e-3)),
)
BUILT: dict[str, Callable] = {
    f.__name__: f
    for f in (
        hidden_in.kink,
        hidden_in.half_draught,
        hidden_in.soft_spot,
        hidden_in.sleeve,
        hidden_in.magnet,
        *GIVING,
    )
}
# A softening by another law than the plug-in's.
OTHER_LAWS = (hidden_in.softening_by_tanh.__name__,)
IN_ORDER: dict[str, Callable] = {f.__name__: f for f in CHANGING}
UNCOVERED: dict[str, Callable] = {
    f.__name__: f for f in (hidden_in.sticking_roll, hidden_in.shaking_camera, *STRANGE)
}
# What says of them as much as can be said: effects, or what is another one in each trial; prints.
NEAR: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    hidden_in.sticking_roll.__name__: (("grip_roll", "clamp_roll"), ()),
    hidden_in.shaking_camera.__name__: (("camera_offset",), ()),
    **{f.__name__: near for f, near in STRANGE.items()},
    **dict.fromkeys(PROFILES, (("stretch", "local_bend"), ())),
}


def _combined(parts: list[Hidden]) -> Hidden:
    """Worlds that change different things, put together."""
    base, changed, truth = Experiment(), {}, {}
    for part in parts:
        truth |= part.truth
        for field in fields(Experiment):
            value = getattr(part.experiment, field.name)
            if not np.array_equal(value, getattr(base, field.name)):
                assert field.name not in changed, f"two effects set {field.name}"
                changed[field.name] = value
    return Hidden(replace(base, **changed), truth)


def cases() -> dict[str, Callable[[np.random.Generator, RodMaterial], Hidden]]:
    """Every case by name: nothing (three rods), effects, pairs, small ones beside
    large, quantities that change along the
    rod or from trial to trial, and what no plug-in covers."""
    pairs = {
        f"{a.__name__} + {b.__name__}": lambda rng, rod, a=a, b=b: _combined(
            [a(rng, rod), b(rng, rod)]
        )
        for a, b in PAIRS
    }
    slight = {
        f"{a.__name__} + slight {b.__name__}": lambda rng, rod, a=a, b=b, size=size: _combined(
            [a(rng, rod), b(rng, rod, size)]
        )
        for a, b, size in SLIGHT
    }
    nothing = {f"none {k}": hidden_in.none for k in (1, 2, 3)}
    return {**nothing, **KNOWN, **pairs, **slight, **BUILT, **PROFILES, **IN_ORDER, **UNCOVERED}


def hidden_set(name: str, seed: int, noise: str = "white") -> tuple[dict[str, np.ndarray], Hidden]:
    """A case's measurements, as `wrod.load_measurements` reads them from a file, and its truth.

    Args:
        noise: of the markers, one of `wrod.bench.hidden_noise.NOISES`.

    Raises:
        DataError: several draws in a row have a trial without an equilibrium.
    """
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])

    def draw():
        rod = _rod(rng)
        hidden, poses = cases()[name](rng, rod), _poses(rng, rod)
        own = int(rng.integers(2**31))
        if noise == "white":
            return measured(poses, hidden.experiment, seed=own, noise=NOISE), hidden
        data = measured(poses, hidden.experiment, seed=own, noise=0.0)
        return with_noise(data, noise, own), hidden

    for _ in range(_REDRAWS):
        with suppress(DataError):  # a rod that is led through a fold
            return draw()
    return draw()


def _rod(rng) -> RodMaterial:
    """Rods like those of the published sets: 6 to 17 gravito-bending lengths long."""
    radius, density, gravito_bending_length = (
        (0.0020, 900.0, 0.034),
        (0.0018, 2100.0, 0.080),
        (0.0016, 1180.0, 0.032),
        (0.0022, 1300.0, 0.055),
    )[rng.integers(4)]
    length = round(float(rng.uniform(0.44, 0.58)), 2)
    return RodMaterial(radius, gravito_bending_length, length, density=density)


def _poses(rng, rod: RodMaterial) -> dict[str, np.ndarray]:
    """Everything but what is measured: skew arcs between a post and a gripper."""
    heading = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))
    reach = rng.uniform(0.53, 0.85, TRIALS) * rod.length
    side, rise = np.radians(rng.uniform(-18, 18, TRIALS)), rng.uniform(-0.2, 0.2, TRIALS)
    rise *= rod.length
    level = np.sqrt(reach**2 - rise**2)
    across = np.stack([level * np.cos(side), level * np.sin(side), rise], axis=1)

    def frames(azimuth, elevation, roll):
        """Columns m1, m2, tangent; without a roll m1 is level."""
        level = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
        angles = np.stack([azimuth, -elevation, roll], axis=1)
        return (heading * Rotation.from_euler("ZYX", angles, degrees=True)).as_matrix() @ level

    def uniform(lower, upper):
        return rng.uniform(lower, upper, TRIALS)

    roll = np.full(TRIALS, float(rng.integers(60, 121)))
    clamp = np.array([0.4, 0.0, 0.43]) + rng.uniform(-0.15, 0.15, 3) * [1.0, 1.6, 0.3]
    return {
        "arc_length": np.linspace(0.0, rod.length, MARKERS),
        "clamp_position": np.tile(clamp, (TRIALS, 1)),
        "clamp_rotation": frames(uniform(-28, 28), uniform(-35, 8), roll),
        "grip_position": clamp + heading.apply(across),
        "grip_rotation": frames(uniform(-30, 30), uniform(-8, 35), roll + uniform(-88, 88)),
        "train_idx": np.arange(TRIALS - TEST_TRIALS),
        "test_idx": np.arange(TRIALS - TEST_TRIALS, TRIALS),
        **labels(rod),
        "noise_std": NOISE,
    }
