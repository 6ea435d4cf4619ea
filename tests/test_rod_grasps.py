"""Grasps of rods whose properties vary along them."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import wrod
from wrod.errors import GraspError, WrodWarning
from wrod.grasps.general import curved_rods, solve_general
from wrod.grasps.inputs import GraspOptions, closure_number
from wrod.grasps.optimal import solve_grasps
from wrod.grasps.rod_grasps import solve_rod_grasps
from wrod.rods.catalogue import rod
from wrod.rods.model import RodModel
from wrod.rods.profile import Profile

GREEN = rod("green-vps")
CONTACT, CURVATURE = np.array([0.1, 0.45, 0.45]), np.array([0.0, 20.0, -40.0])
UP = 0.5 * np.pi


@pytest.mark.parametrize("closure", ["zero_tension", "min_force", "min_friction"])
def test_a_uniform_straight_rod_is_the_special_case(closure):
    lgb = GREEN.gravito_bending_length
    grasps = solve_rod_grasps(GREEN, CONTACT, CURVATURE, closure=closure)
    plain = solve_grasps(
        (GREEN.length - CONTACT) / lgb, CURVATURE * lgb, GREEN.stretch_ratio, closure=closure
    )
    assert grasps.converged.all()
    assert np.abs(grasps.position / lgb - plain.position).max() < 2e-3
    assert np.abs(grasps.force / grasps.force_unit - plain.force).max() < 1e-3
    assert np.abs(grasps.twist).max() < 1e-6


def stiffer_upwards() -> RodModel:
    model = RodModel.of(GREEN)
    ends = (0.0, model.length)
    stiffness = model.bending_stiffness[0].values[0]
    return replace(
        model,
        bending_stiffness=(
            Profile((stiffness, 2.0 * stiffness), ends),
            Profile((0.7 * stiffness, 1.4 * stiffness), ends),
        ),
        natural_curvature=(Profile((2.0, 0.0), ends), Profile((1.0, 1.0), ends)),
        natural_twist=Profile((1.0,)),
    )


def test_second_order_in_the_mesh():
    model = stiffer_upwards()
    reach = [
        solve_rod_grasps(
            model, CONTACT, CURVATURE, edge_count=n, extrapolate=False, held_roll=0.4
        ).position
        for n in (64, 128, 256, 512)
    ]
    error = [np.linalg.norm(p - reach[-1], axis=1) for p in reach]
    assert (np.log2(error[0] / error[1]) > 1.8).all()
    exact = solve_rod_grasps(model, CONTACT, CURVATURE, edge_count=512, held_roll=0.4)
    here = solve_rod_grasps(model, CONTACT, CURVATURE, held_roll=0.4)
    assert here.converged.all()
    assert np.abs(here.position - exact.position).max() < 1e-3 * GREEN.gravito_bending_length


def test_the_batch_finds_the_grasp_in_balance():
    """Energy's gradient by `RodBatch.of`, with the nodes and the rod's own frames given to it."""
    from wrod.rods.batch import RodBatch
    from wrod.solvers.statics import prescribe, solve_equilibria

    model = replace(stiffer_upwards(), natural_twist=Profile((0.0,)))
    grasps = solve_rod_grasps(model, CONTACT[1:2], CURVATURE[1:2], held_roll=UP, extrapolate=False)
    s, shape = grasps.node_arc_length[0], grasps.shape[0]
    first = shape[1] - shape[0]
    ghost = shape[0] - (s[1] - s[0]) * first * [1, -1, 1] / np.linalg.norm(first)
    batch = RodBatch.of(
        model,
        np.concatenate([[2 * s[0] - s[1]], s]),
        np.concatenate([ghost[None], shape])[None],
        director=(0.0, 0.0, 1.0),
    )
    # The contact's edges and the grip are held; the grip's roll is what brings the contact's
    # twisting moment to nothing.
    prescribe(batch, clamped_nodes=(0, 1, 2, -1), clamped_angles=(0, 1, -1))
    dof = batch.state.dof.numpy().copy()
    dof[:, -4] = grasps.twist[0]
    # Spread the twist over the rod before the rest is solved for.
    dof[:, 7:-4:4] = np.linspace(0.0, grasps.twist[0], len(s) - 1)[None, :-1]
    batch.state.dof.assign(dof)
    assert solve_equilibria(batch, prescribed=dof).converged.all()
    moved = np.abs(batch.positions()[0, 1:] - shape).max()
    assert moved < 2e-3 * grasps.length_unit
    reaction = batch.evaluate(order=1).gradient.numpy()[0]
    assert np.abs(reaction[-3]) < 1e-2 * grasps.force_unit
    assert np.abs(reaction[7]) < 1e-2 * grasps.force_unit * grasps.length_unit


def test_a_mirrored_rod_has_mirrored_grasps():
    model = stiffer_upwards()
    c1, c2 = model.natural_curvature
    other = replace(
        model,
        natural_curvature=(c1, Profile(tuple(-v for v in c2.values), c2.knots)),
        natural_twist=Profile((-1.0,)),
    )
    left = solve_rod_grasps(model, CONTACT, CURVATURE, held_roll=UP + 0.3)
    right = solve_rod_grasps(other, CONTACT, -CURVATURE, held_roll=UP - 0.3)
    assert np.allclose(right.position, left.position * [1, -1, 1], atol=1e-9)
    assert np.allclose(right.rotation, left.rotation * [-1, 1, -1], atol=1e-7)
    assert np.allclose(right.twist, -left.twist, atol=1e-7)


@pytest.mark.parametrize(
    "change, word",
    [
        ({"arc_length": [2.0]}, "arc_length"),
        ({"curvature": 1e4}, "curvature"),
        ({"closure": "least"}, "closure"),
        ({"held_roll": np.nan}, "held_roll"),
        ({"rod": replace(GREEN, natural_curvature=(2.0, 0.0))}, "how it is held"),
    ],
)
def test_bad_input_is_named(change, word):
    with pytest.raises(GraspError, match=word):
        solve_rod_grasps(**{"rod": GREEN, "arc_length": [0.4], "curvature": 1.0, **change})


def bent_cable() -> RodModel:
    """L_gb 3.2 cm; bends at rest of up to 1.5 / L_gb that change sign every 3 cm."""
    model = RodModel.of(GREEN)
    knots = np.arange(0.0, model.length, 0.03)
    bends = 45.0 * np.random.default_rng(2).uniform(-1.0, 1.0, (2, len(knots)))
    return replace(model, natural_curvature=tuple(Profile(b, knots) for b in bends))


def test_where_a_bent_rod_cannot_hang_a_straighter_one_does():
    from wrod.grasps.relaxed import solve_relaxed

    model, contact = bent_cable(), np.linspace(0.3, 0.7, 32)
    own = solve_rod_grasps(model, contact, 0.0, held_roll=UP, edge_count=32)
    lacking = ~own.converged
    assert 3 < lacking.sum() < 29
    # Most are in balance and stable all the same, but under the table.
    dips = own.stable & (own.residual < 1e-6 * own.force_unit)
    dips &= own.shape[..., 2].min(axis=1) < -1e-6 * own.length_unit
    assert dips.sum() > 0.5 * lacking.sum() and not own.converged[dips].any()
    grasps, share = solve_relaxed(model, contact, np.zeros(32), held_roll=UP, edge_count=32)
    assert grasps.converged.all()
    assert (share[lacking] < 1.0).all() and (share > 0.0).all()
    assert grasps.shape[..., 2].min() >= -1e-6 * grasps.length_unit
    whole = share == 1.0
    assert np.array_equal(grasps.position[whole], own.position[whole])
    # Half as much again of a share is too much somewhere: no less was taken than needed.
    more = solve_rod_grasps(
        model, contact, 0.0, held_roll=UP, edge_count=32,
        natural_share=np.minimum(1.5 * share, 1.0),
    )  # fmt: skip
    assert not more.converged[lacking].all()


def test_a_plan_says_which_grasps_are_of_a_straighter_rod():
    import wrod
    from wrod.patterns.pattern import Pattern
    from wrod.patterns.shapes import straight, strokes

    model = bent_cable()
    line = Pattern(*strokes(0.0, straight(0.4), []), name="line")
    with pytest.warns(WrodWarning, match="of a rod with less natural curvature"):
        path = wrod.plan(line, model, spacing=0.05, remainder=False)
    assert 0.0 < path.metadata["natural_share"] < 1.0
    straighter = replace(model, natural_curvature=(Profile((0.0,)), Profile((0.0,))))
    assert "natural_share" not in wrod.plan(line, straighter, spacing=0.05).metadata


def test_the_straight_rods_plan_is_taken_where_it_is_expected_to_lay_better(monkeypatch):
    from wrod.deployment import rivals
    from wrod.patterns.pattern import Pattern
    from wrod.patterns.shapes import straight, strokes
    from wrod.planning.plan import plan_grasps

    model = bent_cable()
    line = Pattern(*strokes(0.0, straight(0.4), []), name="line")
    how = dict(closure=None, spacing=0.05, roll="plane", controller=None, device="cpu")
    how["progress"] = None

    def chosen(*errors):
        monkeypatch.setattr(rivals, "expected_errors", lambda *a, **k: np.array(errors))
        with pytest.warns(WrodWarning, match="of a rod with less natural curvature"):
            return rivals.own_or_straight(line, model, "auto", 0.6, how)

    own, other = chosen(0.01, 0.02), chosen(0.02, 0.01)
    assert 0.0 < own.metadata["natural_share"] < 1.0 and other.metadata["natural_share"] == 0.0
    assert "as if it were straight" in other.metadata["warnings"][-1]
    assert other.metadata["rod"] == own.metadata["rod"] and other.roll == own.roll
    straightened = replace(model, natural_curvature=(0.0, 0.0))
    plain = plan_grasps(line, straightened, "auto", remainder=False, **how | {"roll": own.roll})
    assert np.array_equal(other.position, plain.position)


def test_grasps_that_know_a_spun_rods_twist_are_taken_where_they_are_expected_to_lay_better(
    monkeypatch,
):
    from wrod.deployment import rivals
    from wrod.planning.plan import plan_grasps

    line, straight = wrod.pattern("line"), rod("green-vps")
    how = dict(closure=None, spacing=0.1, roll="plane", controller=None, device="cpu", spin=8.0)
    how["progress"] = None
    plan = plan_grasps(line, straight, "auto", remainder=False, **how)

    def chosen(*errors, held=straight):
        monkeypatch.setattr(rivals, "expected_errors", lambda *a, **k: np.array(errors))
        return rivals.as_is_or_twisted(line, held, plan, 0.6, how)

    assert chosen(0.01, 0.02) is plan
    knows = chosen(0.02, 0.01)
    assert knows.spin == plan.spin and knows.metadata["method"] == "auto"
    assert (
        knows.metadata["solver"] == "rod solver" and knows.force[-1, 1] > plan.force[-1, 1] + 1e-4
    )
    tapered = replace(
        RodModel.of(straight), bending_stiffness=(Profile((1e-5, 2e-5), (0.0, 0.8)),) * 2
    )
    assert chosen(0.02, 0.01, held=tapered) is plan


def test_grasps_begin_where_others_ended():
    """Those of nearly the same rods: they are found again, in fewer iterations, and sought from
    straight rods where there is nothing to begin with or no way from there."""
    length, curvature = np.array([4.0, 6.0, 9.0, 5.0]), np.array([0.5, -1.0, 0.3, 1.2])
    stretch, roll = np.full(4, 800.0), np.zeros(4)
    natural = np.array([[0.3, 0.2], [-0.2, 0.3], [0.1, 0.1], [0.2, -0.2]])
    options = GraspOptions(
        closure_number("min_friction"), "cpu", 32, True, True, False, None, None, True
    )

    def found(share, start=None):
        rods = partial(curved_rods, length, stretch, share * natural, 0.5)
        return solve_general(length, curvature, stretch, rods, roll, options, start)

    before, fresh = found(0.9), found(1.0)
    ends = before["coarse_end"], before["fine_end"]
    for end in ends:
        end[1], end[2] = np.nan, 1e3
    again = found(1.0, ends)
    assert fresh["converged"].all() and again["converged"].all()
    for name in ("position", "rotation", "force", "twist", "fine", "eigenvalue", "growth"):
        np.testing.assert_allclose(again[name], fresh[name], rtol=1e-7, atol=1e-9, err_msg=name)
    fewer = again["iterations"] < 0.5 * fresh["iterations"]
    assert fewer.tolist() == [True, False, False, True]
