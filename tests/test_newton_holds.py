"""What holds rods in Newton scenes: who moves it, what is refused, what is said."""

import warnings
from dataclasses import replace

import newton
import numpy as np
import pytest
import warp as wp
from chosen import DEVICE

import wrod
from wrod.errors import RodError, WrodWarning

ROD = wrod.RodMaterial(radius=0.0016, gravito_bending_length=0.032, length=0.2)
SolverDER = wrod.SolverDER
INERTIA = wp.mat33(*np.diag([1e-6] * 3).ravel())
LINE = np.linspace(0.0, 0.1, 11)[:, None] * np.array([1.0, 0.0, 0.0])


def scene():
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    return builder


def with_bob(**options):
    builder = scene()
    at = wp.transform((0.1, 0.0, 0.0), wp.quat_identity())
    bob = builder.add_body(xform=at, mass=0.01, label="bob", **options)
    SolverDER.add_rod(builder, LINE, ROD, start="clamped", end="pinned", end_body=bob)
    return builder, bob


def test_a_cable_does_not_stretch_without_a_word():
    """A body that another solver moves and that gets no load is named, once; one that does is not,
    nor a kinematic one."""
    builder, bob = with_bob(inertia=INERTIA)
    model = builder.finalize(device=DEVICE)
    solver, state = SolverDER(model, bodies="none"), model.state()
    with pytest.warns(WrodWarning, match=r"another solver moves \('bob'\).*add_body_forces"):
        for _ in range(4):
            solver.step(state, state, None, None, 0.005)
    solver, state = SolverDER(model, bodies="none"), model.state()
    with warnings.catch_warnings():
        warnings.simplefilter("error", WrodWarning)
        for _ in range(4):
            solver.add_body_forces(state)
            solver.step(state, state, None, None, 0.005)
    assert state.body_f.numpy()[bob, 2] < 0.0


def test_bodies_are_chosen():
    builder, bob = with_bob(inertia=INERTIA)
    other = builder.add_body(mass=0.01, inertia=INERTIA)
    model = builder.finalize(device=DEVICE)
    for chosen, moves in (("free", True), ([bob], True), ("none", False), ([], False)):
        solver, state = SolverDER(model, bodies=chosen), model.state()
        solver.step(state, state, None, None, 0.01)
        assert bool(state.body_q.numpy()[bob, 2] < 0.0) is moves
        assert state.body_q.numpy()[other, 2] == 0.0
    with pytest.raises(
        RodError, match=r"no free body that holds a rod, or may touch.*those are \[0\]"
    ):
        SolverDER(model, bodies=[other])
    with pytest.raises(RodError, match="use free, none or indices"):
        SolverDER(model, bodies="all")


def test_forces_of_the_scene_act_on_a_free_body():
    """body_f bears the bob's weight and half of the cable's: it stays where it is, within a part of
    the way that it would have fallen."""
    builder, bob = with_bob(inertia=INERTIA)
    model = builder.finalize(device=DEVICE)
    heights = []
    for bears in (True, False):
        solver, state = SolverDER(model), model.state()
        wrench = np.zeros((model.body_count, 6))
        wrench[bob, 2] = bears * 9.81 * (0.01 + 0.5 * ROD.weight / 9.81 * 0.1)
        state.body_f.assign(wrench)
        for _ in range(10):
            solver.step(state, state, None, None, 0.01)
        heights.append(state.body_q.numpy()[bob, 2])
    assert heights[1] < -0.02
    assert abs(heights[0]) < 0.05 * abs(heights[1])


def test_a_state_set_back_does_the_same_again():
    builder, bob = with_bob(inertia=INERTIA)
    model = builder.finalize(device=DEVICE)
    solver = SolverDER(model)
    ends = []
    state = model.state()
    for _ in range(2):
        for _ in range(8):
            solver.step(state, state, None, None, 0.01)
        ends.append(state.body_q.numpy()[bob].copy())
        solver.reset(state)
    assert abs(ends[0][2]) > 0.01
    assert np.abs(ends[0] - ends[1]).max() < 1e-7


def test_replicated_worlds_with_bodies():
    """Two copies swing alike, and as one alone."""
    world, bob = with_bob(inertia=INERTIA)
    builder = scene()
    places = [wp.transform_identity(), wp.transform((3.0, 0.0, 1.0), wp.quat_identity())]
    builder.replicate(world, copy_count=2, xforms=places)
    model, alone = builder.finalize(device=DEVICE), world.finalize(device=DEVICE)
    states = []
    for each in (model, alone):
        solver, state = SolverDER(each), each.state()
        for _ in range(15):
            solver.step(state, state, None, None, 0.01)
        states.append(state.body_q.numpy())
    count = alone.body_count
    first, second = states[0][bob], states[0][count + bob]
    assert first[2] < -0.03
    assert first == pytest.approx(states[1][bob], abs=1e-7)
    assert second[:3] - [3.0, 0.0, 1.0] == pytest.approx(first[:3], abs=2e-6)


def test_rest_lengths():
    """A cable whose edges want to be a tenth shorter pulls with EA / 10."""
    builder = scene()
    length = 0.01 / 1.1
    SolverDER.add_rod(builder, LINE, ROD, start="pinned", end="pinned", rest_length=length)
    model = builder.finalize(device=DEVICE)
    solver, state = SolverDER(model, scheme="euler"), model.state()
    for _ in range(5):
        solver.step(state, state, None, None, 0.05)
    reaction = solver._groups[0].dynamics.reaction.numpy()[0]
    stiffness = model.der.edge_stretching_stiffness.numpy()[0]
    assert reaction[-3] == pytest.approx(0.1 * stiffness, rel=0.01)


def test_refusals():
    builder, bob = with_bob(inertia=INERTIA)
    for wrong, match in [
        (dict(rod=3), "one of the builder's 1 rods"),
        (dict(node=11), "nodes 0 to 9 that can be clamped"),
        (dict(kind="glued"), "use pinned or clamped"),
        (dict(body=99), "body is 99"),
        (dict(node=9), "node 10 of rod 0 is held already"),
    ]:
        with pytest.raises(RodError, match=match):
            SolverDER.attach(builder, **{"rod": 0, "body": bob, "node": 4, **wrong})
    SolverDER.attach(builder, 0, -1, node=4, kind="pinned")
    with pytest.raises(RodError, match="node 4 of rod 0 is held already"):
        SolverDER.attach(builder, 0, -1, node=3)
    builder, _ = with_bob(inertia=INERTIA)
    model = builder.finalize(device=DEVICE)
    with pytest.raises(RodError, match="the first one covers the second"):
        SolverDER(model, rod_contact=0.3, self_contact=0.3)
    builder = scene()
    with pytest.raises(RodError, match="rest_length must be positive"):
        SolverDER.add_rod(builder, LINE, ROD, rest_length=0.0)


def test_a_body_clamped_in_the_middle_of_a_cable():
    """A cable that a small body carries in its middle, the body hung on another cable: the upper
    one bears all, and the clamped edge stays level and turns with the body."""
    builder = scene()
    bob = builder.add_body(mass=0.02, inertia=INERTIA)
    across = LINE - [0.05, 0.0, 0.0]
    rod = SolverDER.add_rod(builder, across, ROD, air_damping=5.0, director=(0, 1, 0))
    SolverDER.attach(builder, rod, bob, node=4)  # its edge is beside the middle: it tilts
    up = np.linspace(0.1, 0.0, 11)[:, None] * np.array([0.0, 0.0, 1.0])
    SolverDER.add_rod(
        builder, up, ROD, start="clamped", end="clamped", end_body=bob, air_damping=5.0
    )
    model = builder.finalize(device=DEVICE)
    solver, state = SolverDER(model, scheme="euler"), model.state()
    for _ in range(150):
        solver.step(state, state, None, None, 0.02)
    assert not solver.diverged.any()
    (group,) = solver._groups
    reaction = group.dynamics.reaction.numpy()[0]
    (world,) = [h for h in group.hold.numpy()[0] if h["kind"] and h["slot"] < 0]
    carried = reaction[4 * world["node"] + 2] + reaction[4 * world["other"] + 2]
    assert carried == pytest.approx((0.02 + model.der.node_mass.numpy().sum()) * 9.81, rel=1e-4)
    q, turn = state.der.node_q.numpy(), state.body_q.numpy()[bob]
    rotation = np.array(wp.quat_to_matrix(wp.quat(*map(float, turn[3:])))).reshape(3, 3)
    edge = (q[5] - q[4]) / np.linalg.norm(q[5] - q[4])
    assert edge == pytest.approx(rotation[:, 0], abs=1e-6)
    assert state.der.edge_director.numpy()[4] == pytest.approx(rotation[:, 1], abs=1e-6)
    assert np.linalg.norm(q[5] - q[4]) == pytest.approx(0.01, abs=1e-9)
    assert q[4] == pytest.approx(turn[:3] + rotation @ across[4], abs=1e-6)


@pytest.mark.parametrize("side", ["start", "end"])
def test_a_clamp_has_the_direction_at_its_node(side):
    """An arc that is bent so at rest stays where it is, to second order: the first edge's direction
    is that of half an edge further on, 6 % of the length at the far end of 16 edges."""
    bent, length = 10.0, 0.2
    rod = replace(wrod.RodModel.of(ROD), natural_curvature=(bent, 0.0))
    errors = []
    for edges in (16, 32):
        s = np.linspace(0.0, length, edges + 1)
        arc = np.stack([np.sin(bent * s), 1.0 - np.cos(bent * s), 0.0 * s], axis=1) / bent
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
        SolverDER.register_custom_attributes(builder)
        SolverDER.add_rod(builder, arc, rod, director=(0.0, 1.0, 0.0), **{side: "clamped"})
        model = builder.finalize(device=DEVICE)
        solver, state, other = SolverDER(model, scheme="euler"), model.state(), model.state()
        for _ in range(100):
            solver.step(state, other, None, None, 0.05)
            state, other = other, state
        errors.append(np.abs(state.der.node_q.numpy() - arc).max() / length)
    assert errors[0] < 3e-3
    assert np.log2(errors[0] / errors[1]) > 1.9


def test_points_in_millimetres_are_asked_after():
    with pytest.warns(WrodWarning, match="200 m in length.*millimetres"):
        SolverDER.add_rod(scene(), 2e3 * LINE, ROD)


def test_what_holds_nothing_is_refused():
    """A body without a way to hold, and a capsule, which goes with its rod; the sentence names the
    class that was asked."""
    builder = scene()
    hand = builder.add_body(is_kinematic=True)
    points = np.linspace([0.0, 0.0, 0.0], [0.1, 0.0, 0.0], 6)
    with pytest.raises(RodError, match="start_body is 0, and start is 'free'; give start='clamped"):
        SolverDER.add_rod(builder, points, ROD, start_body=hand)
    rod = SolverDER.add_rod(builder, points, ROD)
    with pytest.raises(RodError, match="body is 3, which shows rod 0 and goes with it"):
        SolverDER.attach(builder, rod, hand + 3, node=2)
    with pytest.raises(RodError, match=r"^SolverDER\.add_rod: material is"):
        SolverDER.add_rod(builder, points, "green-vps")
