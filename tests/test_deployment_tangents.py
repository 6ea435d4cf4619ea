"""Derivatives of deployments, against differences of deployments."""

from dataclasses import replace

import numpy as np
import pytest

import wrod
from wrod.deployment.setup import Disturbance
from wrod.deployment.simulate import Trial
from wrod.deployment.tangents import Directions, lay
from wrod.errors import RodError
from wrod.rods.law import Dahl, Plastic, Softening, StandardLinearSolid
from wrod.solvers.friction import Friction

ROD = wrod.RodMaterial(0.0016, 0.032, 0.32)
MESH = wrod.Discretisation(0.014, 0.03)
OPTIONS = dict(discretisation=MESH, speed=0.05)


@pytest.fixture(scope="module")
def bend():
    """A short pattern that bends by 1 / L_gb, and its plan."""
    s = np.linspace(0.0, 0.16, 200)
    heading = 0.5 * (1.0 + np.tanh((s - 0.1) / 0.02))
    points = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0) * s[1]
    pattern = wrod.Pattern.from_points(points)
    return pattern, wrod.plan(pattern, ROD, "numeric", closure="min_friction", spacing=0.01)


def columns(trajectory):
    """Each coordinate of the pose, around the middle of the path; friction, stiffness, natural
    curvature."""
    bump = np.exp(-0.5 * ((trajectory.arc_length - 0.11) / 0.02) ** 2)
    path = np.einsum("t,cd->ctd", bump, np.eye(6))
    return Directions.of_path(path) + Directions.of_rod(len(trajectory))


def displaced(trial, directions, column, by, offset):
    """What the direction of that number leads to, without any derivative."""
    law, disturbance = trial.friction, trial.disturbance
    law = replace(law, static=law.static + by * directions.friction[column, 0])
    stiffer = np.exp(by * directions.stiffness[column] / 3.0) - 1.0
    bent = by * directions.natural_curvature[column]
    disturbance = replace(disturbance, lgb_error=stiffer, natural_curvature=bent)
    move = offset + by * directions.path[column]
    return replace(trial, friction=law, disturbance=disturbance), move


def check_tangents(pattern, rod, trajectory, friction, scheme, shares=None, tolerance=1e-11):
    """Every column of the derivatives against differences: to 5e-4 of its largest, or up to shares
    of the largest by any place, turn, and number of the rod's."""
    trial = Trial(pattern, rod, trajectory, friction)
    directions = columns(trajectory)
    # Beside the plan, so that rotation vectors are not at their origin.
    offset = 0.002 * np.sin(20.0 * trajectory.arc_length)[:, None] * [1, 1, 1, 20, 20, 20]
    options = OPTIONS | {"discretisation": replace(MESH, tolerance=tolerance, scheme=scheme)}
    laid = lay([trial], [directions], [offset], **options)[0]
    assert not laid.diverged
    assert (laid.slip.max() > 2e-3) == (friction.static < 0.2)
    until = np.searchsorted(laid.arc_length, trajectory.arc_length[-1])
    # So small that no node changes between sticking and sliding on the way.
    size = 2e-7
    trials, moves = [], []
    for column in range(len(directions)):
        scale = 100.0 if directions.natural_curvature[column] else 1.0
        for sign in (1.0, -1.0):
            one, move = displaced(trial, directions, column, sign * scale * size, offset)
            trials.append(one)
            moves.append(move)
    beside = lay(trials, None, moves, **options)
    # Other steps would be another function.
    assert {one.steps for one in beside} == {laid.steps}
    ends = np.array([one.centerline for one in beside])
    for column in range(len(directions)):
        scale = 100.0 if directions.natural_curvature[column] else 1.0
        difference = (ends[2 * column] - ends[2 * column + 1]) / (2.0 * scale * size)
        error = np.abs(difference - laid.tangent[column])[:until].max()
        largest, share = np.abs(laid.tangent[column])[:until].max(), 5e-4
        assert largest > 0.0
        if shares is not None:
            kind = [c for c in range(len(directions)) if c // 3 == column // 3 < 2 or c == column]
            largest, share = (
                np.abs(laid.tangent[kind])[:, :until].max(),
                shares[min(column // 3, 2)],
            )
        assert error < share * largest + 1e-6, (column, error, largest)


# Sticking: all agree. Sliding at friction 0.16: so do they, as far as the step's tolerance allows.
@pytest.mark.parametrize("friction, scheme", [(4.0, "euler"), (0.16, "bdf2"), (0.16, "euler")])
def test_tangents_are_limits_of_differences(bend, friction, scheme):
    pattern, trajectory = bend
    check_tangents(pattern, ROD, trajectory, Friction(friction), scheme)


@pytest.mark.parametrize("relaxation_time", [0.0, 0.02])
def test_so_they_are_of_a_rod_with_sides_that_softens_and_is_damped(bend, relaxation_time):
    """Its roll is held by torques that do not reach their bound, which tangents take as given."""
    pattern, _ = bend
    stiffness = ROD.bending_stiffness
    rod = replace(
        wrod.RodModel.of(ROD),
        bending_stiffness=({"knots": [0.0, 0.32], "values": [1.3 * stiffness, 0.8 * stiffness]},
                           0.8 * stiffness),
        principal_angle=0.6, natural_curvature=(3.0, -2.0), natural_twist=2.0,
        law=Softening(30.0, 0.5), internal_damping=0.05, relaxation_time=relaxation_time,
    )  # fmt: skip
    trajectory = wrod.plan(pattern, rod, "numeric", closure="min_friction", spacing=0.01, roll=0.3)
    check_tangents(pattern, rod, trajectory, Friction(4.0, roll=1e4), "bdf2")


# Of Dahl's law what is not symmetric lacks, so that steps are found slowly; a wire has a kink
# wherever it begins to yield.
@pytest.mark.parametrize(
    "law, shares, tolerance",
    [
        (StandardLinearSolid(0.5, 0.3), None, 1e-11),
        (Plastic(12.0, 0.4), (5e-4, 5e-4, 5e-4), 1e-11),
        (Dahl(12.0, 0.4), (0.03, 0.03, 0.15), 1e-9),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_so_they_are_of_rods_that_remember(bend, law, shares, tolerance):
    pattern, trajectory = bend
    rod = replace(wrod.RodModel.of(ROD), law=law)
    check_tangents(pattern, rod, trajectory, Friction(4.0, roll=1e4), "bdf2", shares, tolerance)


def test_friction_by_place_is_a_limit_of_differences(bend):
    """A rod that slides on a table where friction rises along the first axis."""
    pattern, trajectory = bend
    trial, options = (
        Trial(pattern, ROD, trajectory, Friction(0.3)),
        OPTIONS | {"discretisation": replace(MESH, tolerance=1e-9)},
    )
    ends = []
    for by in (1e-5, -1e-5):
        field = wrod.FrictionField.of(lambda x, y, by=by: 1.0 + by * x, (-1.0, 1.0), (-1.0, 1.0))
        ends.append(lay([trial], friction_field=field, **options)[0].centerline)
    difference = (ends[0] - ends[1]) / 2e-5
    # Under points of the rod, where it lies in the end: those that slid lay up to 4 mm elsewhere.
    (laid,) = lay([trial], **options)
    at = np.linspace(0.0, ROD.length, 200)
    rates = 0.3 * np.interp(at, laid.arc_length, laid.centerline[:, 0])
    none = np.zeros((2, 1))
    uniform = np.full(200, 0.3 * rates.mean())
    columns = Directions(
        np.zeros((2, len(trajectory), 6)), np.stack([rates, uniform]), none[:, 0], none[:, 0]
    )
    (laid,) = lay([trial], [columns], **options)
    until = np.searchsorted(laid.arc_length, trajectory.arc_length[-1])
    error = [np.abs(difference - one)[:until].max() for one in laid.tangent]
    largest = np.abs(difference[:until]).max()
    assert error[0] < 0.02 * largest < 0.1 * error[1]


def test_a_batch_holds_what_its_rods_hold_alone(bend):
    pattern, trajectory = bend
    trials = [
        Trial(pattern, ROD, trajectory, Friction(mu), Disturbance(yaw=yaw))
        for mu, yaw in ((0.8, 0.0), (0.2, 0.3))
    ]
    directions = [columns(trajectory)] * 2
    together = lay(trials, directions, **OPTIONS)
    for trial, one in zip(trials, together, strict=True):
        alone = lay([trial], directions[:1], **OPTIONS)[0]
        np.testing.assert_allclose(one.centerline, alone.centerline, atol=1e-12)
        np.testing.assert_allclose(one.tangent, alone.tangent, atol=1e-9)


def test_what_a_tangent_cannot_know_is_refused(bend):
    pattern, trajectory = bend
    trial = Trial(pattern, ROD, trajectory, Friction(0.5, rolling=True))
    with pytest.raises(RodError, match="roll"):
        lay([trial], [columns(trajectory)], **OPTIONS)
    with pytest.raises(RodError, match="sets of directions"):
        lay([trial], [columns(trajectory)] * 2, **OPTIONS)
    with pytest.raises(RodError, match="one for each pose"):
        still = replace(trial, friction=Friction(0.5))
        lay([still], [Directions.of_path(np.zeros((1, 3, 6)))], **OPTIONS)
    with pytest.raises(RodError, match="midpoint"):
        mesh = replace(MESH, scheme="midpoint")
        lay([still], [columns(trajectory)], discretisation=mesh)


def test_torch_gradients_are_limits_of_differences(bend):
    torch = pytest.importorskip("torch")
    from wrod.training.autograd import lay_differentiable

    torch.set_num_threads(1)
    pattern, trajectory = bend
    trials = [Trial(pattern, ROD, trajectory, Friction(mu)) for mu in (1.5, 0.3)]
    options = OPTIONS | {"discretisation": replace(MESH, tolerance=1e-9), "points": 12}
    rng = np.random.default_rng(3)
    start = [
        5e-4 * rng.standard_normal((2, 4, 6)) * [1, 1, 1, 20, 20, 20],
        np.array([1.5, 0.3]),
        np.array([0.032, 0.033]),
        np.array([0.0, 0.3]),
    ]
    weights = torch.tensor(rng.standard_normal((2, 12, 3)))

    def objective(*tensors):
        return (weights * lay_differentiable(trials, *tensors, **options)).sum(dim=(1, 2))

    tensors = [torch.tensor(value, requires_grad=True) for value in start]
    objective(*tensors).sum().backward()
    # Along a random direction of each tensor, so little that no node changes between sticking and
    # sliding on the way.
    for k, (value, tensor) in enumerate(zip(start, tensors, strict=True)):
        way = rng.standard_normal(value.shape) * (1e-8 if k in (0, 2) else 1e-6)
        ends = []
        for sign in (1.0, -1.0):
            moved = [torch.tensor(v + sign * way if j == k else v) for j, v in enumerate(start)]
            ends.append(objective(*moved).numpy())
        difference = 0.5 * (ends[0] - ends[1])
        along = (tensor.grad.numpy() * way).reshape(2, -1).sum(axis=1)
        print(k, along, difference)
        assert np.abs(along).min() > 0.0
        np.testing.assert_allclose(along, difference, rtol=1e-3, atol=1e-13)


def test_torch_asks_for_no_more_than_it_needs(bend):
    torch = pytest.importorskip("torch")
    from wrod.training.autograd import lay_differentiable

    pattern, trajectory = bend
    trials = [Trial(pattern, ROD, trajectory, Friction(0.3))]
    friction = torch.tensor(0.4, requires_grad=True)
    laid = lay_differentiable(trials, friction=friction, **OPTIONS)
    same = lay([replace(trials[0], friction=Friction(0.4))], **OPTIONS)[0]
    s = np.linspace(0.0, pattern.length, 50) + trajectory.metadata["remainder_length"]
    for c in range(3):
        expected = np.interp(s, same.arc_length, same.centerline[:, c])
        np.testing.assert_allclose(laid[0, :, c].detach().numpy(), expected, atol=1e-6)
    assert laid.dtype == torch.float32
    laid.square().sum().backward()
    assert friction.grad.shape == () and friction.grad != 0.0
    with pytest.raises(RodError, match="2 knots"):
        lay_differentiable(trials, torch.zeros(1, 1, 6))
    with pytest.raises(RodError, match="not positive"):
        lay_differentiable(trials, friction=torch.tensor([-0.1]))
    with pytest.raises(RodError, match="give a tensor"):
        lay_differentiable(trials)
    with pytest.raises(RodError, match="shape"):
        lay_differentiable(trials, friction=torch.ones(2))
