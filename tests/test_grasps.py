import json

import continuum
import numpy as np
import pytest
import warp as wp

from wrod.errors import GraspError
from wrod.grasps import levels
from wrod.grasps.inputs import whole_range
from wrod.grasps.optimal import solve_grasps

needs_gpu = pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")


def errors(a, b):
    return [np.abs(getattr(a, k) - getattr(b, k)).max() for k in ("position", "rotation", "force")]


def test_grasps_of_the_continuum():
    """Twelve grasps of a continuous rod by collocation, at the default resolution."""
    entries = json.loads(continuum.STORED.read_text())
    assert [(e["ls"], e["kappa"], e["ks"]) for e in entries] == list(continuum.INPUTS)
    grasps = solve_grasps(*np.transpose(continuum.INPUTS))
    assert grasps.converged.all()
    assert grasps.stable.all()
    for name in ("position", "rotation", "force"):
        assert np.abs(getattr(grasps, name) - [e[name] for e in entries]).max() < 2e-3


def test_published_grasps_of_the_continuum(shared):
    """Twelve of somebody else's boundary-value solver."""
    entries = json.loads((shared / "reference" / "optimal_grasps.json").read_text())
    grasps = solve_grasps(*(np.array([e[k] for e in entries]) for k in ("ls", "kappa", "ks")))
    assert grasps.converged.all()
    for name, key in (("position", "q"), ("rotation", "e"), ("force", "force")):
        assert np.abs(getattr(grasps, name) - [e[key] for e in entries]).max() < 2e-3


def test_order_of_convergence_without_extrapolation():
    entries = json.loads(continuum.STORED.read_text())
    inputs = np.transpose(continuum.INPUTS)
    exact = np.array([e["position"] for e in entries])
    error = [
        np.linalg.norm(
            solve_grasps(*inputs, edge_count=n, extrapolate=False).position - exact, axis=1
        )
        for n in (64, 128, 256)
    ]
    assert (np.log2(error[0] / error[1]) > 1.8).all()
    assert (np.log2(error[1] / error[2]) > 1.8).all()


def test_whole_range_converges_and_is_accurate():
    """Cold starts over the whole range; errors against a mesh four times as fine."""
    inputs = whole_range(400, seed=1)
    grasps = solve_grasps(*inputs)
    assert grasps.converged.mean() >= 0.995
    assert grasps.stable[grasps.converged].all()
    some = slice(None, None, 8)
    fine = solve_grasps(*(i[some] for i in inputs), edge_count=512)
    ok = grasps.converged[some] & fine.converged
    for name in ("position", "rotation", "force"):
        assert np.abs(getattr(grasps, name)[some] - getattr(fine, name))[ok].max() < 2e-3


def test_zero_tension_and_weight_at_the_contact():
    grasps = solve_grasps([5.0, 20.0], [1.0, 2.0], 2000.0)
    assert np.abs(grasps.force[:, 0]).max() < 1e-8


def test_right_turns_mirror_left_turns():
    left = solve_grasps([8.0, 20.0], [1.3, 0.4], 900.0, sensitivities=True)
    right = solve_grasps([8.0, 20.0], [-1.3, -0.4], 900.0, sensitivities=True)
    assert np.allclose(right.position, left.position * [1, -1, 1], atol=1e-12)
    assert np.allclose(right.rotation, left.rotation * [-1, 1, -1], atol=1e-12)
    assert np.allclose(right.position_sensitivity[:, 1, 1], left.position_sensitivity[:, 1, 1])
    assert np.allclose(right.position_sensitivity[:, 0, 1], -left.position_sensitivity[:, 0, 1])


@pytest.mark.parametrize(
    "closure, position, size",
    [("min_force", (3.77, 0.0, 15.93), 0.695), ("zero_tension", (2.566, 0.0, 16.196), 0.758)],
)
def test_published_closures_of_the_straight_pattern(closure, position, size):
    grasps = solve_grasps(17.68, 0.0, 2087.0, closure=closure)
    assert grasps.position[0] == pytest.approx(position, abs=0.01)
    assert np.linalg.norm(grasps.force[0]) == pytest.approx(size, abs=1e-3)


@pytest.mark.parametrize("closure", ["min_force", "min_friction"])
def test_minimising_closures_are_minima_of_the_family(closure):
    """Neighbouring grasps of the same family, by their thrust, are all worse."""
    from wrod.grasps.inputs import CLOSURES
    from wrod.grasps.manifold.optima import GraspSolver

    inputs = [np.array(v) for v in ([17.68, 6.0], [2.0, 0.8], [2087.0, 500.0])]

    def objective(thrust):
        solver = GraspSolver(
            *inputs,
            edge_count=128,
            closure=CLOSURES["zero_tension"],
            device="cpu",
            guess=best.shape,
            thrust=thrust,
        )
        force = solver.run().grasps().force
        if closure == "min_friction":
            force[:, 2] = 0.0
        return np.linalg.norm(force, axis=1)

    best = solve_grasps(*inputs, closure=closure, extrapolate=False)
    assert best.converged.all()
    thrust = best.force[:, 0]
    least = objective(thrust)
    for offset in (-0.02, 0.02):
        assert (objective(thrust + offset) > least).all()


@pytest.mark.parametrize("closure", ["zero_tension", "min_force", "min_friction"])
def test_every_closure_converges_wherever_inputs_are_allowed(closure):
    """Not only over the range of the physics, but up to the limits."""
    from wrod.grasps.results import LIMITS

    rng = np.random.default_rng(5)
    names = ("suspended_length", "stretch_ratio")
    ls, ks = (np.exp(rng.uniform(*np.log(LIMITS[name]), 1000)) for name in names)
    kappa = rng.uniform(*LIMITS["curvature"], 1000)
    grasps = solve_grasps(ls, kappa, ks, closure=closure, shapes=False)
    assert grasps.converged.mean() >= 0.999


def least(closure, force):
    """What the grasps of a closure have least of, of forces at the contact."""
    if closure == "min_friction":
        return np.linalg.norm(force[:, :2], axis=1)
    return force[:, 2] if closure == "zero_tension" else np.linalg.norm(force, axis=1)


@pytest.mark.parametrize("closure", ["zero_tension", "min_force", "min_friction"])
def test_wires_are_near_the_inextensible_limit(closure):
    """What a rod stretches is of first order in 1 / k_s, so that softer rods predict wires (1.5e6
    for a guide wire, 2.6e6 for nitinol of 0.5 mm). Rounding moves a wire's grip by 1e-8 where an
    optimum is flat; no other closure has less of what one has least of."""
    rng = np.random.default_rng(7)
    ls, kappa = rng.uniform(2.0, 20.0, 40), rng.uniform(-2.0, 2.0, 40)
    soft, stiff, wire = (
        solve_grasps(ls, kappa, k, closure=closure, shapes=False) for k in (1e5, 1e6, 1e7)
    )
    assert wire.converged.all()
    shaken = solve_grasps(ls * (1.0 + 1e-13), kappa, 1e7, closure=closure, shapes=False)
    assert np.abs(shaken.position - wire.position).max() < 1e-7

    def off(name, measure=np.asarray):
        a, b, c = (measure(getattr(one, name)) for one in (soft, stiff, wire))
        expected = b - (a - b) * (1e-6 - 1e-7) / (1e-5 - 1e-6)
        return np.abs(c - expected)

    for name in ("position", "rotation", "force"):
        assert off(name).max() < 1e-6
        assert np.quantile(off(name).max(axis=1), 0.95) < 1e-7
        assert np.median(off(name)) < 1e-9
    assert off("force", lambda force: least(closure, force)).max() < 1e-9
    if closure != "zero_tension":
        for other in ("zero_tension", "min_force", "min_friction"):
            force = solve_grasps(ls, kappa, 1e7, closure=other, shapes=False).force
            assert (least(closure, wire.force) < least(closure, force) + 1e-8).all()


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda:0", marks=needs_gpu)])
def test_of_no_inputs_there_are_no_grasps(device):
    found = solve_grasps([], [], [], device=device, eigenvalues=True)
    assert found.position.shape == (0, 3) and found.eigenvalue.shape == (0,)


def test_every_rod_of_the_catalogue_can_be_planned_with():
    from wrod.rods.catalogue import rod, rod_names

    ratios = [rod(name).stretch_ratio for name in rod_names()]
    assert solve_grasps(8.0, 0.2, ratios, shapes=False).converged.all()


@pytest.mark.parametrize("closure", ["zero_tension", "min_force", "min_friction"])
def test_the_way_to_a_grasp_leaves_no_trace(monkeypatch, closure):
    """Other continuation steps bring other rounding: what is left of it is what two devices may
    differ by."""
    inputs = whole_range(512, 5)
    first = solve_grasps(*inputs, closure=closure, device="cpu", shapes=False)
    monkeypatch.setattr(levels, "_FIRST_INCREMENT", 0.43)
    second = solve_grasps(*inputs, closure=closure, device="cpu", shapes=False)
    assert (first.iterations != second.iterations).any()
    assert max(errors(first, second)) < 1e-10


def test_sensitivities_against_differences():
    ls, kappa, ks = np.array([4.0, 17.68, 40.0]), np.array([1.0, 0.5, 2.5]), np.full(3, 700.0)
    grasps = solve_grasps(ls, kappa, ks, sensitivities=True)
    for j, h in enumerate((1e-3, 1e-3, 1.0)):
        shift = np.zeros(3)
        shift[j] = h
        a = solve_grasps(ls + shift[0], kappa + shift[1], ks + shift[2])
        b = solve_grasps(ls - shift[0], kappa - shift[1], ks - shift[2])
        for name in ("position", "rotation", "force"):
            numeric = (getattr(a, name) - getattr(b, name)) / (2 * h)
            exact = getattr(grasps, f"{name}_sensitivity")[:, :, j]
            assert np.abs(numeric - exact).max() < 1e-5 * max(1.0, np.abs(exact).max())


def test_gravito_bending_length_drops_out():
    """Rods in SI units with equal dimensionless numbers hang in the same dimensionless shape."""
    from wrod.rods.batch import RodBatch
    from wrod.rods.material import RodMaterial
    from wrod.solvers.statics import prescribe, solve_equilibria

    shapes = []
    for radius, lgb, density in ((0.0016, 0.032, 1180.0), (0.004, 0.08, 700.0)):
        rod = RodMaterial(radius, lgb, 12 * lgb, density=density)
        s = np.linspace(0, rod.length, 61)
        edge = s[1]
        mass = np.full(61, density * np.pi * radius**2 * edge)
        mass[[0, -1]] /= 2
        batch = RodBatch(
            (s[:, None] * [1.0, 0, 0])[None],
            stretching_stiffness=rod.stretching_stiffness,
            bending_stiffness=rod.bending_stiffness,
            twisting_stiffness=rod.twisting_stiffness,
            node_mass=mass,
            gravity=(0, 0, -rod.gravity),
        )
        prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
        assert solve_equilibria(batch).converged.all()
        shapes.append(batch.positions()[0] / lgb)
    assert np.abs(shapes[0] - shapes[1]).max() < 1e-6


@pytest.mark.parametrize("closure", ["zero_tension", "min_friction"])
def test_threads_and_batches_do_not_change_a_bit(closure):
    inputs = whole_range(40, seed=3)
    together = solve_grasps(*inputs, threads=1, closure=closure)
    two = solve_grasps(*inputs, threads=2, closure=closure)
    apart = [solve_grasps(*(v[i : i + 1] for v in inputs), closure=closure) for i in (0, 17, 39)]
    for name in ("position", "rotation", "force", "shape", "iterations"):
        whole = getattr(together, name)
        assert np.array_equal(whole, getattr(two, name))
        for i, one in zip((0, 17, 39), apart, strict=True):
            assert np.array_equal(getattr(one, name)[0], whole[i])


@pytest.mark.parametrize(
    "inputs, word",
    [
        (([np.nan], [0.0], [2000.0]), r"suspended_length\[0\] is nan"),
        (([5.0, 900.0], [0.0], [2000.0]), r"suspended_length\[1\] is 900"),
        (([5.0], [9.0], [2000.0]), "curvature"),
        (([5.0], [0.0], [-1.0]), "stretch_ratio"),
        (([5.0, 6.0], [0.0, 1.0, 2.0], [2000.0]), "broadcast"),
    ],
)
def test_bad_inputs_are_named(inputs, word):
    with pytest.raises(GraspError, match=word):
        solve_grasps(*inputs)


def test_unknown_closure():
    with pytest.raises(GraspError, match="zero_tension, min_force, min_friction"):
        solve_grasps(5.0, 0.0, 2000.0, closure="none")


def test_what_did_not_converge_is_flagged(monkeypatch):
    from wrod.grasps import levels

    monkeypatch.setattr(levels, "_MAX_ITERATIONS", 5)
    grasps = solve_grasps([50.0, 5.0], [5.0, 0.5], 2000.0, closure="min_force")
    assert not grasps.converged.any()
    for name in ("position", "rotation", "force", "residual"):
        assert np.isfinite(getattr(grasps, name)).all()


@pytest.mark.parametrize("kind", ["torch", "warp"])
@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda:0", marks=needs_gpu)])
def test_tensors_and_device_arrays_come_back_as_what_they_were(kind, device):
    """And a GPU finds what a CPU does."""
    ls, kappa = np.array([4.0, 17.68, 30.0]), np.array([1.0, -0.5, 0.0])
    expected = solve_grasps(ls, kappa, 700.0, sensitivities=True, device="cpu")
    if kind == "torch":
        torch = pytest.importorskip("torch")
        inputs = tuple(torch.from_numpy(values).to(device) for values in (ls, kappa))
        wanted = torch.Tensor
    else:
        inputs = tuple(wp.array(v, dtype=wp.float64, device=device) for v in (ls, kappa))
        wanted = wp.array
    grasps = solve_grasps(*inputs, 700.0, sensitivities=True)
    for name in ("position", "rotation", "force", "shape", "position_sensitivity", "converged"):
        value, right = getattr(grasps, name), getattr(expected, name)
        assert isinstance(value, wanted)
        assert str(value.device) == device
        found = value.cpu().numpy() if kind == "torch" else value.numpy()
        off = np.abs(found.astype(float) - right).max()
        assert off <= (0.0 if device == "cpu" else 1e-10 * np.abs(right).max()), name


def test_bad_values_in_tensors_are_named():
    torch = pytest.importorskip("torch")
    with pytest.raises(GraspError, match=r"curvature\[1\] is 9"):
        solve_grasps(torch.full((3,), 5.0), torch.tensor([0.0, 9.0, 0.0]), 2000.0)
    with pytest.raises(GraspError, match="mix numpy and torch"):
        solve_grasps(torch.full((3,), 5.0), np.zeros(3), 2000.0)
