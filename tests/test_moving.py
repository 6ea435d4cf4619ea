"""Gradients through the motion of rods, against differences."""

import numpy as np
import pytest
import torch
from wrod.training.moving import move_differentiable

from wrod.errors import RodError
from wrod.rods.batch import RodBatch
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.statics import prescribe
from wrod.solvers.trace import require_differentiable


def scene(rods=2, nodes=7, softening=0.0):
    """A bent, twisted cable with a preferred bend that a hand holds by its first two nodes; rods
    differ."""
    rng = np.random.default_rng(3)
    arc = np.linspace(0.0, 0.3, nodes)
    line = np.stack([arc, 0.02 * np.sin(9.0 * arc), 0.03 * np.cos(12.0 * arc)], axis=1)
    mass = np.full(nodes, 0.01)
    batch = RodBatch(
        np.stack([line * (1.0 + 0.1 * r) for r in range(rods)]),
        stretching_stiffness=200.0, bending_stiffness=np.array([[[4e-3, 6e-3]]]),
        twisting_stiffness=5e-3, natural_curvature=rng.normal(size=2) * 2.0, natural_twist=0.4,
        softening=softening, node_mass=mass, gravity=(0.0, 0.0, -9.81),
    )  # fmt: skip
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    tensor = torch.from_numpy
    position = tensor(batch.positions() + 0.01 * rng.normal(size=batch.positions().shape))
    velocity = tensor(0.2 * rng.normal(size=position.shape))
    velocity[:, :2] = 0.0
    turn = np.linspace(0.0, 1.0, 7)[1:, None, None] * 0.02 * rng.normal(size=(rods, 1, 2, 3))
    given = {
        "position": position,
        "velocity": velocity,
        "stiffness": tensor(rng.uniform(0.8, 1.2, (rods, 3))),
        "gravity": tensor(np.array([[0.3, -0.2, -9.0]] * rods)),
        "path": position[:, None, :2] + tensor(turn),
    }
    weight = tensor(rng.normal(size=(rods, 7, nodes, 3)))
    return batch, given, weight


@pytest.mark.parametrize(
    ("scheme", "radius", "softening"),
    [("euler", 1e-4, 0.0), ("bdf2", 1e-4, 0.0), ("bdf2", 5e-3, (0.02, 0.3))],
)
def test_gradients_against_differences(scheme, radius, softening):
    """Of a loss on all positions of six steps, by every tensor: central differences along a random
    direction of each, within 1e-6, also of thick rods, whose inertia about themselves counts, and
    of such that soften."""
    batch, given, weight = scene(softening=softening)

    def loss(**changed):
        places = move_differentiable(
            batch, **(given | changed), step=0.01, steps=6, radius=radius, held=(0, 1),
            scheme=scheme, air_damping=0.7,
        )  # fmt: skip
        return (weight * places).sum() + 30.0 * (places[:, -1, -1] ** 2).sum()

    wanted = {name: value.clone().requires_grad_() for name, value in given.items()}
    loss(**wanted).backward()
    rng = np.random.default_rng(1)
    for name, value in given.items():
        way = torch.from_numpy(rng.normal(size=tuple(value.shape)))
        if name in ("position", "velocity"):
            way[:, :2] = 0.0  # what is held is the path's
        size = 1e-5 * float(value.abs().max())
        with torch.no_grad():
            up, down = (loss(**{name: value + s * size * way}) for s in (1.0, -1.0))
        found = float((wanted[name].grad * way).sum())
        assert found == pytest.approx(float(up - down) / (2.0 * size), rel=1e-6), name
    assert (batch.positions() == scene(softening=softening)[0].positions()).all()


def test_what_has_no_gradients_is_refused():
    batch, given, _ = scene()
    options = given | {"step": 0.01, "steps": 6, "radius": 1e-4}
    with pytest.raises(RodError, match="scheme"):
        move_differentiable(batch, **options, held=(0, 1), scheme="midpoint")
    relaxing = Dynamics(batch, radius=1e-4, internal_damping=0.2)
    relaxing.relax(0.1)
    with pytest.raises(RodError, match="damping that relaxes"):
        require_differentiable(relaxing)
    with pytest.raises(RodError, match="free"):
        move_differentiable(batch, **options, held=(3, 4))
    with pytest.raises(RodError, match="float64"):
        move_differentiable(batch, **options | {"velocity": given["velocity"].float()}, held=(0, 1))
