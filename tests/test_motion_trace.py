"""The force print of motion: what is hidden in known motions leaves the right print."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from wrod.errors import DataError
from wrod.identification.effect import Effect, Model, Parameter, effects
from wrod.identification.motion.fit import MotionLaboratory
from wrod.identification.motion.loading import motion_from_arrays
from wrod.identification.motion.pace import check_pace, pace
from wrod.identification.motion.report import identify_motion
from wrod.identification.motion.trace import trace_motion

RATE, GRAVITY, MARKERS, FRAMES, SETTLING = 100.0, 9.81, 11, 130, 50
STIFFNESS, DRAG, VISCOUS = -1.2, 0.6, 0.03
WIND, MASS, HELD_AT = 2.0, 0.08, 4
# Ten stations of (m1, m2): bent in the middle, where two stations are [1/m].
BEND = np.zeros(20)
BEND[[8, 10]] = 3.0


class Wind(Effect):
    """A force per mass to +y on the last half of the rod [m/s^2]."""

    name, parameters = "wind", (Parameter("wind", "m/s^2", 1.0),)

    def apply(self, setup, values):
        half = np.clip(setup.fraction, 0.0, 1.0) > 0.5
        setup.force = setup.force + np.outer(half, [0.0, values[0], 0.0])


class Weight(Effect):
    """A mass at one free marker, per line mass [m]."""

    name, parameters = "weight", (Parameter("mass", "m", 1.0),)

    def apply(self, setup, values):
        here = np.arange(len(setup.fraction)) == setup.marker_node[HELD_AT]
        setup.node_mass = setup.node_mass + values[0] * here


HIDDEN = {
    "wind": (Wind(), (WIND,)),
    "bend": (effects("motion")["natural_curvature_profile"], tuple(BEND)),
    "weight": (Weight(), (MASS,)),
}


def grips(rods: int, seed: int) -> np.ndarray:
    """(rod, frame, 4, 3) held markers of grips that swing, every recording in a direction of its
    own, so that what is fixed in space differs from what is fixed in the rod."""
    rng = np.random.default_rng(seed)
    time = np.arange(FRAMES)[:, None, None, None] / RATE
    size = rng.uniform(0.02, 0.06, (rods, 1, 2, 3, 2))
    speed = rng.uniform(2.0, 8.0, (rods, 1, 2, 3, 2))
    phase = rng.uniform(0.0, 2 * np.pi, (rods, 1, 2, 3, 2))
    inner = np.array([[-0.2, 0.0, 0.0], [0.2, 0.0, 0.0]])
    inner = inner + (size * np.sin(speed * time + phase)).sum(axis=-1)
    lean = np.zeros((rods, FRAMES, 2, 3))
    lean[..., 0] = np.array([-0.3, 0.3]) + 2.0 * (inner[..., 0] - inner[..., 0].mean())
    lean[..., 1] = 2.0 * inner[..., 2]
    lean[..., 2] = -1.0
    outer = inner - 0.03 * lean / np.linalg.norm(lean, axis=-1, keepdims=True)
    ends = np.stack([outer[:, :, 0], inner[:, :, 0], inner[:, :, 1], outer[:, :, 1]], axis=2)
    turn = np.linspace(-0.7, 0.7, rods)
    c, s, z = np.cos(turn), np.sin(turn), np.zeros(rods)
    rotation = np.stack([c, -s, z, s, c, z, z, z, z + 1], axis=1).reshape(-1, 3, 3)
    return np.einsum("rij,rfkj->rfki", rotation, ends)


@cache
def moved(hidden=None, rods=8, seed=1, rate=RATE):
    """Recordings of a viscous rod with something hidden, each frame's grips the same at any rate.

    They are on the mesh of the print, whose own error would be a stiffness that is missing.
    """
    ends = grips(rods, seed)
    u = np.linspace(0.0, 1.0, MARKERS - 2)[:, None]
    a, b = ends[:, :, None, 1], ends[:, :, None, 2]
    loop = (1 - u) * a + u * b - np.array([0, 0, 0.22]) * np.sin(np.pi * u)
    data = {
        "positions": np.concatenate([ends[:, :, :1], loop, ends[:, :, 3:]], axis=2),
        "rate_hz": np.float64(rate),
        "held": np.array([0, 1, MARKERS - 2, MARKERS - 1]),
        "gravity": np.float64(GRAVITY),
    }
    laboratory = MotionLaboratory(motion_from_arrays(data), subdivisions=4, substeps=2)
    known = effects("motion")
    model = [known["stiffness"], known["air_damping"], known["internal_damping"]]
    values = [[STIFFNESS], [DRAG], [VISCOUS]]
    if hidden:
        model.append(hidden[0])
        values.append(hidden[1])
    setup = Model(tuple(model)).setup(laboratory.base, np.concatenate(values))
    x, _, failed = laboratory.run(laboratory.windows(range(rods)), setup)
    assert not failed.any()
    # The loop that it started from was not an equilibrium.
    x = x[:, SETTLING:]
    data["positions"] = x + np.random.default_rng(seed).normal(0.0, 1e-5, x.shape)
    return motion_from_arrays(data)


def traced(m, viscous=0.0, law=()):
    known = effects("motion")
    names = ("stiffness", "air_damping", "internal_damping", *(["softening"] if law else []))
    base = Model(tuple(known[name] for name in names))
    values = np.array([STIFFNESS, DRAG, viscous, *law])
    return trace_motion(m, base, values, range(m.recording_count), 0)


@pytest.fixture(scope="module")
def traces():
    """Of what is hidden about a base with damping, which identification fits first."""
    found = {name: traced(moved(hidden), VISCOUS) for name, hidden in HIDDEN.items()}
    m = moved()
    return found | {"nothing": traced(m), "nothing, damped": traced(m, VISCOUS)}


def named(trace, name):
    return next(p for p in trace.prints if p.name == name)


def test_internal_damping_follows_the_rate_of_bending(traces):
    trace = traces["nothing"]
    best = trace.prints[0]
    assert best.name == "moment_with_strain_rate"
    assert best.share > 0.9 and best.points_to == ("internal_damping", "relaxation")
    np.testing.assert_allclose(best.value, VISCOUS, rtol=0.15)
    # Nothing else is missing.
    assert np.median(trace.unexplained) < 0.03
    assert max(trace.remaining.values()) < 0.5


def test_the_model_that_made_a_motion_lacks_nothing(traces):
    damped, undamped = traces["nothing, damped"], traces["nothing"]
    assert np.median(damped.force.size) < 0.5 * np.median(undamped.force.size)
    assert np.median(damped.force.size) < 0.02
    viscous = named(damped, "moment_with_strain_rate")
    assert np.abs(viscous.value).max() < 0.15 * VISCOUS


def test_a_rod_that_softens_lacks_nothing_by_its_own_law():
    law = (np.log(6.0), 0.6)
    m = moved((effects("motion")["softening"], law), rods=4)
    with_law, without = traced(m, VISCOUS, law), traced(m, VISCOUS)
    assert np.median(with_law.force.size) < 0.02
    assert np.median(without.force.size) > 0.1


def test_recordings_too_short_to_tell_accelerations_have_no_trace(recordings=3, frames=12):
    short = moved(rods=recordings)
    data = {
        "positions": short.positions[:, :frames],
        "rate_hz": np.float64(RATE),
        "held": np.array([0, 1, MARKERS - 2, MARKERS - 1]),
        "gravity": np.float64(GRAVITY),
    }
    assert traced(motion_from_arrays(data)) is None


def test_wind_is_fixed_in_the_laboratory_where_it_blows(traces):
    trace = traces["wind"]
    blown, turned = (named(trace, f"force_in_{frame}") for frame in ("laboratory", "material"))
    assert trace.prints[0] is blown
    assert blown.share > turned.share and blown.share > 0.95
    assert blown.value[4:6, 1].mean() == pytest.approx(WIND / GRAVITY, rel=0.25)
    assert np.abs(blown.value[1:3, 1]).max() < 0.25 * WIND / GRAVITY
    value, _ = trace.force.mean("laboratory")
    assert np.argmax(np.abs(value).max(axis=1)) >= len(value) // 2
    assert np.argmax(np.abs(value).max(axis=0)) == 1


def test_a_bend_at_rest_is_a_moment_in_the_material_where_it_is(traces):
    best = traces["bend"].prints[0]
    assert best.name == "moment_in_material"
    along = best.value[:, 0] - 0.5 * (best.value[0, 0] + best.value[-1, 0])
    assert np.argmax(along) == len(along) // 2
    assert along.max() == pytest.approx(BEND.max(), rel=0.35)


def test_a_mass_is_found_at_its_marker(traces):
    best = traces["weight"].prints[0]
    assert best.name == "force_with_acceleration"
    assert "point_mass" in best.points_to
    heavy = best.value[:, 0]
    at = HELD_AT - 2
    assert np.argmax(heavy) == at
    # What is between two markers is shared out among them, over and under.
    found = heavy[at - 1 : at + 2].sum() * np.diff(best.arc_length).mean()
    assert found == pytest.approx(MASS, rel=0.15)


def test_the_trace_is_plain_data(traces):
    content = traces["wind"].to_dict()
    assert content["together"][0]["share"] == pytest.approx(content["prints"][0]["share_of_excess"])
    assert len(content["missing_force"]["mean_in_material"]["value"]) == MARKERS - 2
    assert content["marker_placement_mm"] < 0.2


def test_frames_that_follow_one_another_faster_than_told_are_refused():
    """The rod's weight is the clock: at a tenth of the rate it would accelerate a hundred times as
    much as its markers do."""
    m = moved()
    square, bound = pace(m)
    assert abs(square - 1.0) < 0.5 and bound < 0.6
    check_pace(m)
    slow = replace(m, rate=m.rate / 10)
    assert pace(slow)[0] == pytest.approx(100 * square, rel=0.1)
    with pytest.raises(DataError, match=r"at rate_hz .* more than \d\.\d times as fast"):
        identify_motion(slow)


@pytest.mark.parametrize("hidden", [None, "bend", "weight"])
def test_slow_motion_is_not_taken_for_a_wrong_rate(hidden):
    """Grips that take ten times as long: the inertia is a hundredth, and what is hidden is not."""
    check_pace(moved(HIDDEN.get(hidden), rods=3, rate=RATE / 10))
