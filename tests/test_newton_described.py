"""`newton.Rod` descriptions in `SolverDER`: chains, rings, branches."""

import re
from pathlib import Path
from types import SimpleNamespace

import newton
import newton.examples
import numpy as np
import pytest
import warp as wp
from chosen import DEVICE
from newton.viewer import ViewerNull
from scipy.spatial.transform import Rotation

import wrod
from wrod.errors import RodError
from wrod.knots.topology import name_of

SolverDER = wrod.SolverDER
STIFF = dict(radius=0.004, youngs_modulus=2e6, poissons_ratio=0.25)


def built(*rods, gravity=0.0, **options):
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, gravity))
    SolverDER.register_custom_attributes(builder)
    indices = [SolverDER.add_newton_rod(builder, rod, **options) for rod in rods]
    model = builder.finalize(device=DEVICE)
    return model, SolverDER(model, scheme="euler"), model.state(), indices


def settle(solver, state, steps=60, dt=0.02):
    for _ in range(steps):
        solver.step(state, state, None, None, dt)
    assert not solver.diverged.any()
    return state.der.node_q.numpy()


def helix(turns=1.5, count=31):
    a = np.linspace(0.0, 2 * np.pi * turns, count)
    return np.column_stack([0.05 * np.cos(a), 0.05 * np.sin(a), 0.01 * a])


def test_what_is_described_at_rest_stays():
    """A helix with a twist of its own is its rest shape: nothing moves without gravity; and the
    stiffnesses are those of the section."""
    rod = newton.Rod(helix(), **STIFF)
    model, solver, state, _ = built(rod, air_damping=5.0)
    area = np.pi * STIFF["radius"] ** 2
    bending = STIFF["youngs_modulus"] * area * STIFF["radius"] ** 2 / 4
    assert model.der.node_bending_stiffness.numpy()[5] == pytest.approx([bending] * 2)
    assert model.der.node_twisting_stiffness.numpy()[5] == pytest.approx(bending * 0.8)
    assert model.der.edge_stretching_stiffness.numpy()[3] == pytest.approx(2e6 * area)
    assert model.der.node_mass.numpy().sum() == pytest.approx(
        1000.0 * area * rod.segment_lengths.sum()
    )
    first = state.der.node_q.numpy().copy()
    assert settle(solver, state) == pytest.approx(first, abs=1e-6)


def test_joints_stiffness_and_damping_are_those_of_newton():
    """What Newton's own `add_rod` makes of a section's rigidities and a damping, given to ours, is
    the section again; Newton's defaults fill what is not said; a section goes by unequal edges."""
    line = np.linspace(0.0, 0.3, 7)[:, None] * [1.0, 0.0, 0.0]
    stiff = newton.Rod(line, **STIFF)
    theirs = newton.ModelBuilder()
    _, joints = theirs.add_rod(rod=stiff, bend_damping=3e-5)
    of_joint = theirs.joint_target_ke[theirs.joint_qd_start[joints[2]] :]
    stretch, bend, twist = of_joint[2], of_joint[3], of_joint[5]
    given = dict(stretch_stiffness=stretch, bend_stiffness=bend, twist_stiffness=twist)
    bare = newton.Rod(line, radius=STIFF["radius"])
    model, *_ = built(stiff, bare, **given, bend_damping=3e-5)
    for name in ("edge_stretching", "node_bending", "node_twisting"):
        found, said = np.split(getattr(model.der, f"{name}_stiffness").numpy(), 2)
        assert said == pytest.approx(found, rel=1e-6)
    assert model.der.rod_internal_damping.numpy()[1] == pytest.approx(3e-5 / bend)
    model, *_ = built(bare, bend_stiffness=bend)
    assert model.der.node_twisting_stiffness.numpy()[3] == pytest.approx(bend * 0.05)
    assert model.der.edge_stretching_stiffness.numpy()[3] == pytest.approx(1e5 * 0.05)
    model, *_ = built(newton.Rod(line**2, **STIFF), bend_stiffness=0.02, stretch_stiffness=1e4)
    long = np.diff(line[:, 0] ** 2)
    bends = np.concatenate([[long[0]], 0.5 * (long[1:] + long[:-1]), [long[-1]]])
    bending = model.der.node_bending_stiffness.numpy()[:, 0]
    assert bending[1:-1] == pytest.approx(0.02 * bends[1:-1], rel=1e-4)
    stretching = model.der.edge_stretching_stiffness.numpy()[:6]
    assert stretching == pytest.approx(0.5e4 * (bends[1:] + bends[:-1]), rel=1e-4)


def test_rest_shapes_are_taken():
    """A straight rod that wants to be an arc becomes one; an arc that wants to be straight, too."""
    s = np.linspace(0.0, 0.2, 21)
    line = np.column_stack([s, 0 * s, 0 * s])
    arc = 0.1 * np.column_stack([np.sin(s / 0.1), 1.0 - np.cos(s / 0.1), 0 * s])
    long = np.linalg.norm(arc[1] - arc[0]) * 20
    bends = newton.Rod(line * long / 0.2, rest_points=arc, **STIFF)
    opens = newton.Rod(arc + [0.0, 0.0, 1.0], rest_straight=True, **STIFF)
    _, solver, state, _ = built(bends, opens, air_damping=5.0)
    q = settle(solver, state, 200).reshape(2, 21, 3)
    chord = np.linalg.norm(q[:, -1] - q[:, 0], axis=1)
    assert chord == pytest.approx([np.linalg.norm(arc[-1] - arc[0]), long], rel=1e-4)


@pytest.mark.parametrize("straight", [False, True])
def test_a_ring_has_no_seam(straight):
    """A pre-bent ring stays; one that is straight at rest stays round too, its bending the same
    all around, within what a clamped seam of 24 edges leaves."""
    a = np.linspace(0.0, 2 * np.pi, 25)
    circle = 0.06 * np.column_stack([np.cos(a), np.sin(a), 0 * a])
    rod = newton.Rod(circle, closed=True, rest_straight=straight, **STIFF)
    _, solver, state, indices = built(rod, air_damping=5.0)
    assert indices == [[0]]
    q = settle(solver, state, 100)
    assert q[0] == pytest.approx(q[-1], abs=1e-6)
    radii = np.linalg.norm(q[:-1] - q[:-1].mean(axis=0), axis=1)
    assert radii == pytest.approx(0.06, rel=2e-3)


def test_branches_hang_from_their_junction():
    """Three arms of a Y, one held: it carries the weight of all, and the junction keeps its
    angles."""
    points = [[0.0, 0.0, 0.0]]
    edges = []
    for way in ([0.0, 0.0, 1.0], [0.8, 0.0, -0.6], [-0.8, 0.0, -0.6]):
        before = 0
        for k in range(1, 7):
            points.append([0.01 * k * c for c in way])
            edges.append((before, len(points) - 1))
            before = len(points) - 1
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    rod = newton.Rod(np.array(points), edges=edges, **STIFF)
    rods = SolverDER.add_newton_rod(builder, rod, air_damping=5.0, label="wye")
    assert rods == [0, 1, 2]
    SolverDER.attach(builder, 0, -1, node=6, kind="pinned")
    model = builder.finalize(device=DEVICE)
    solver, state = SolverDER(model, scheme="euler"), model.state()
    q = settle(solver, state, 150)
    arms = q.reshape(3, 7, 3)
    centre = arms[:, 0]
    assert np.ptp(centre, axis=0) == pytest.approx(0.0, abs=1e-6)
    ways = arms[:, 1] - arms[:, 0]
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    assert ways[1] @ ways[2] == pytest.approx(0.36 - 0.64, abs=0.05)
    (group,) = solver._groups
    total = (model.der.node_mass.numpy().sum() + model.body_mass.numpy().sum()) * 9.81
    (pin,) = [h for h in group.hold.numpy()[0] if h["kind"] == 1]
    reaction = group.dynamics.reaction.numpy()[0]
    assert reaction[4 * pin["node"] + 2] == pytest.approx(total, rel=1e-3)


def test_descriptions_that_say_too_little():
    builder = newton.ModelBuilder()
    SolverDER.register_custom_attributes(builder)
    with pytest.raises(RodError, match="no stiffness"):
        SolverDER.add_newton_rod(builder, newton.Rod(helix(), radius=0.004))
    with pytest.raises(RodError, match=r"must be a newton\.Rod"):
        SolverDER.add_newton_rod(builder, helix())


@pytest.mark.parametrize(
    "changed",
    [
        {"radius": "x"}, {"youngs_modulus": []}, {"shear_modulus": np.nan}, {"rest_straight": []},
        {"_edges": [(0, 9)]}, {"_points": np.nan}, {"_quaternions": np.zeros((3, 3))},
    ],
)  # fmt: skip
def test_descriptions_that_were_changed_are_checked(changed):
    builder = newton.ModelBuilder()
    wrod.SolverDER.register_custom_attributes(builder)
    points = [[0.1 * k, 0.0, 1.0] for k in range(5)]
    rod = newton.Rod(points, radius=0.003, youngs_modulus=1e6, poissons_ratio=0.4)
    for name, value in changed.items():
        setattr(rod, name, value)
    with pytest.raises(RodError, match=f"Rod: {min(changed).strip('_')} "):
        wrod.SolverDER.add_newton_rod(builder, rod)


@pytest.mark.parametrize(("friction", "name"), [(0.1, "right trefoil"), (None, "unknot")])
def test_a_tied_spline_stays_tied(friction, name):
    """A ring through points of a trefoil, straight at rest, opens until it lies on itself; one that
    passes through itself comes undone."""
    t = np.linspace(0.0, 2.0 * np.pi, 61)
    r = 0.04 + 0.02 * np.cos(3.0 * t)
    knot = np.column_stack([r * np.cos(2.0 * t), r * np.sin(2.0 * t), -0.02 * np.sin(3.0 * t)])
    rod = newton.Rod(knot, closed=True, rest_straight=True, **STIFF)
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    SolverDER.register_custom_attributes(builder)
    SolverDER.add_newton_rod(builder, rod, air_damping=3.0, internal_damping=0.01)
    model = builder.finalize(device=DEVICE)
    solver, state = SolverDER(model, scheme="euler", self_contact=friction), model.state()
    assert name_of([knot[:-1]]) == "right trefoil"
    q = settle(solver, state, 150)
    assert name_of([q[:-1]]) == name
    assert solver.penetration().max() < 0.05 * STIFF["radius"]


def drop_in(path):
    """One of Newton's own examples, with the three edits that docs/newton.md names."""
    register = "wrod.SolverDER.register_custom_attributes(builder)\n"
    text = (Path(newton.examples.__file__).parent / path).read_text()
    for before, after in (
        (r"( *)(builder = newton.ModelBuilder.*\n)", r"\1\2\1" + register),
        (r"builder\.add_rod\(", "wrod.SolverDER.add_cable(builder, "),
        (r"newton\.solvers\.SolverVBD\([^)]*\)", "wrod.SolverDER(self.model)"),
    ):
        text, count = re.subn(before, after, text)
        assert count == 1
    module = {"__name__": "example", "wrod": wrod}
    exec(compile(text, path, "exec"), module)
    with wp.ScopedDevice(DEVICE):
        return module["Example"](ViewerNull(num_frames=1), SimpleNamespace(device=DEVICE))


def test_newtons_cantilevers_run_with_three_edits():
    """Its own criteria, by a step a frame; and deflection times stiffness is that of a chain of
    joints."""
    example = drop_in("vbd/example_cable_bend_stiffness.py")
    example.sim_substeps, example.sim_dt = 1, example.frame_dt
    for _ in range(510):
        example.step()
    example.test_final()
    joint = 0.1 * np.arange(1, 16)
    expected = 0.5 * ((1.55 - joint) * (1.5 - joint)).sum()
    assert example._measured_tip_state()[2][0] * 900.0 == pytest.approx(expected, rel=2e-3)


def test_newtons_junction_runs_with_three_edits():
    """It hangs from the tip without mass; joints between capsules, which its own criterion follows,
    are none of ours."""
    example = drop_in("cable/example_cable_y_junction.py")
    first = example.state_0.body_q.numpy().copy()
    for _ in range(60):
        example.step()
    now = example.state_0.body_q.numpy()
    assert (now[example.pinned_body] == first[example.pinned_body]).all()
    assert not example.solver.diverged.any()
    assert np.abs(now - first)[:, 2].max() > 1e-3
    ends = example.state_0.der.node_q.numpy()[[0, 21, 42]]
    assert np.ptp(ends, axis=0) == pytest.approx(0.0, abs=1e-6)  # they still meet


def cantilever(**options):
    """A rod of ten edges of a cable, whose first one has no mass."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    SolverDER.register_custom_attributes(builder)
    line = newton.Rod(np.linspace((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 11), radius=0.01)
    bodies, joints = SolverDER.add_cable(
        builder, rod=line, bend_stiffness=50.0, bend_damping=2.5, stretch_damping=1.0, **options
    )
    assert [builder.joint_child[j] for j in joints] == bodies
    builder.body_mass[bodies[0]] = builder.body_inv_mass[bodies[0]] = 0.0
    builder.body_inertia[bodies[0]] = builder.body_inv_inertia[bodies[0]] = wp.mat33(0.0)
    model = builder.finalize(device=DEVICE)
    return SolverDER(model, scheme="euler", tolerance=1e-10), model.state(), bodies


def test_forces_on_capsules_bend_a_rod():
    """A force at the middle of the last edge, and a torque across it, turn each joint by its share,
    here for small ones; and what is along the edge pulls."""
    solver, state, bodies = cantilever()
    wrench = state.body_f.numpy()
    wrench[bodies[-1]] = [0.0, 1e-3, 2e-3, 0.0, 3e-3, 0.0]
    state.body_f.assign(wrench)
    q = settle(solver, state, 100, 0.05)
    joint = 0.1 * np.arange(1, 10)
    turn = np.stack([1e-3 * (0.95 - joint), 2e-3 * (0.95 - joint) - 3e-3], axis=1) / 50.0
    expected = ((1.0 - joint)[:, None] * turn).sum(axis=0)
    assert q[10, 1:] == pytest.approx(expected, rel=1e-4)


def test_a_capsule_without_mass_carries_its_edge():
    solver, state, bodies = cantilever()
    settle(solver, state, 1)
    poses = state.body_q.numpy()
    turn = Rotation.from_rotvec([0.1, 0.3, -0.2])
    place = np.array([0.2, 0.1, 0.3])
    poses[bodies[0], :3] = place
    poses[bodies[0], 3:] = (turn * Rotation.from_quat(poses[bodies[0], 3:])).as_quat()
    first = state.der.node_q.numpy().copy()
    state.body_q.assign(poses)
    q = settle(solver, state, 200, 0.05)
    assert q == pytest.approx(place + turn.apply(first - [0.05, 0.0, 0.0]), abs=1e-5)
    assert state.body_q.numpy()[bodies[0]] == pytest.approx(poses[bodies[0]], abs=0.0)


def test_cables_take_what_newtons_take():
    with pytest.raises(RodError, match="knows no 'colour'"):
        cantilever(colour=(1.0, 0.0, 0.0))
    with pytest.raises(RodError, match="no stiffness"):
        builder = newton.ModelBuilder()
        SolverDER.register_custom_attributes(builder)
        SolverDER.add_cable(builder, rod=newton.Rod(helix(), radius=0.004))
