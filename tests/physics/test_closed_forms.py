"""Shapes and critical loads that textbooks state, through public names."""

import numpy as np
import pytest

import wrod
from wrod.errors import RodError


def strip(length=1.0, bending=(1.0, 1.0), twisting=0.8, stretching=1e7, curvature=0.0, weight=0.0):
    """A rod whose first stiffness is against bending towards the first director."""
    return wrod.RodModel(
        length=length,
        bending_stiffness=bending,
        twisting_stiffness=twisting,
        stretching_stiffness=stretching,
        line_mass=max(weight, 1e-9),
        radius=0.01,
        natural_curvature=(curvature, 0.0),
        gravity=1.0,
    )


def cantilevers(models, edges, *, tip=None, gravity=None, director=(0.0, 0.0, 1.0), spacing=None):
    """Straight guesses along x, clamped at 0 by a ghost edge, a row for each model."""
    length = models[0].length
    arc = np.linspace(0.0, length, edges + 1) if spacing is None else spacing
    s = np.concatenate([[-arc[1]], arc])
    position = np.zeros((len(models), len(s), 3))
    position[:, :, 0] = s
    load = np.zeros_like(position)
    if tip is not None:
        load[:, -1] = tip
    batch = wrod.RodBatch.of(
        models, s, position, clamped=(True, False), director=director, point_load=load,
        gravity=gravity,
    )  # fmt: skip
    wrod.prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    return batch


def test_drop_over_reach_of_a_heavy_cantilever():
    """At w L^3 / B = 1 ... 10 000, of the elastica theta'' = w (L - s) cos(theta) / B."""
    exact = {1.0: 0.12456, 10.0: 1.06680, 100.0: 5.88810, 1000.0: 21.3354, 10_000.0: 69.7088}
    edges = 240
    # Finer towards the clamp, where all the bending is.
    x = np.linspace(0.0, 1.0, edges + 1)
    arc = x * (0.15 + 0.85 * x)
    batch = cantilevers([strip(weight=w) for w in exact], edges, spacing=arc)
    found = wrod.solve_equilibria(batch, max_iterations=400)
    assert found.converged.all()
    tip = batch.positions()[:, -1]
    np.testing.assert_allclose(-tip[:, 2] / tip[:, 0], list(exact.values()), rtol=2e-3)


@pytest.mark.parametrize(("kind", "exact"), [("weight", 12.85376), ("tip", 4.01260)])
def test_lateral_buckling_of_a_narrow_strip(kind, exact):
    """q L^3 / sqrt(B C) = 12.85376 and P L^2 / sqrt(B C) = 4.01260 (Prandtl, Michell 1899)."""
    bending, twisting = 1.0, 0.7
    unit = np.sqrt(bending * twisting)

    def equilibria(loads):
        each = unit * loads
        models = [
            strip(bending=(2e4, bending), twisting=twisting, weight=q if kind == "weight" else 0.0)
            for q in each
        ]
        tip = np.zeros((len(loads), 3))
        tip[:, 2] = -each if kind == "tip" else 0.0
        batch = cantilevers(models, 80, tip=tip)
        assert wrod.solve_equilibria(batch).converged.all()
        return batch

    load, modes = wrod.find_critical_load(equilibria, 0.8 * exact, 1.2 * exact, tolerance=1e-4)
    assert modes == 1
    assert load == pytest.approx(exact, rel=1e-3)
    with pytest.raises(RodError, match="unstable"):
        wrod.find_critical_load(equilibria, 1.1 * exact, 1.2 * exact)


@pytest.mark.parametrize("ratio", [0.6, 1.0, 1.5])
def test_michells_ring(ratio):
    """A ring closed with the twist 2 pi sqrt(3) B / C writhes (Michell 1889)."""
    twisting, edges, length = ratio, 120, 2 * np.pi
    h = length / edges
    # Nodes of a regular polygon of that side, and one ghost edge more at the closed ends.
    angle = (np.arange(edges + 3) - 1) * 2 * np.pi / edges
    radius = 0.5 * h / np.sin(np.pi / edges)
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    s = (np.arange(edges + 3) - 1) * h

    def equilibria(twists):
        model = strip(length, twisting=twisting)
        position = np.broadcast_to(ring, (len(twists), *ring.shape))
        batch = wrod.RodBatch.of(
            model, s, position, clamped=(True, True), director=[0, 0, 1], gravity=[0, 0, 0]
        )
        at = np.clip((np.arange(edges + 2) - 0.5) / edges, 0.0, 1.0)
        batch.set_configuration(position, angle=twists[:, None] * at)
        wrod.prescribe(batch, clamped_nodes=(0, 1, -2, -1), clamped_angles=(0, -1))
        return batch

    exact = 2 * np.pi * np.sqrt(3) / twisting
    twist, modes = wrod.find_critical_load(
        equilibria, 0.8 * exact, 1.1 * exact, tolerance=1e-4, neutral=1e-3
    )
    assert twist == pytest.approx(exact, rel=4e-3)
    assert modes >= 1


def localised_helix(m, edges, length=25.0, bending=1.0, twisting=10.0):
    """A clamped rod under a tension of 1, and a torque 2 m, that has buckled in its middle, as an
    infinite one would (Coyne 1990): cos(theta) = 1 - 2 (1 - m^2) sech^2(s sqrt(1 - m^2)), and the
    helix turns by psi' = 2 m / (1 + cos(theta))."""
    fine = np.linspace(-0.5 * length, 0.5 * length, 64 * edges + 1)
    rest = np.sqrt(1.0 - m * m)
    cosine = 1.0 - 2.0 * (rest / np.cosh(fine * rest)) ** 2
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    step = fine[1] - fine[0]

    def integral(values):
        return np.concatenate([[0.0], np.cumsum(0.5 * step * (values[1:] + values[:-1]))])

    turn = integral(2.0 * m / (1.0 + cosine))
    ways = np.column_stack([cosine, sine * np.cos(turn), sine * np.sin(turn)])
    path = np.stack([integral(way) for way in ways.T], axis=1)[::64]
    h = length / edges
    ahead = np.array([[h, 0.0, 0.0]])
    position = np.concatenate([path[:1] - ahead, path, path[-1:] + ahead])[None]
    s = h * (np.arange(edges + 3) - 1)
    batch = wrod.RodBatch.of(
        strip(length, (bending, bending), twisting, 1e4), s, position, clamped=(True, True),
        director=[0, 0, 1], gravity=[0, 0, 0],
    )  # fmt: skip
    at = np.clip((np.arange(edges + 2) - 0.5) / edges, 0.0, 1.0)
    batch.set_configuration(position, angle=(2.0 * m / twisting * length * at)[None])
    wrod.prescribe(batch, clamped_nodes=(0, 1, -2, -1), clamped_angles=(0, -1))
    return batch


@pytest.mark.parametrize("m", [0.8, 0.9])
def test_localised_helical_buckling(m):
    """Ends that are so near and turned so far hold a tension of 1 and a torque of 2 m, to second
    order in the edge."""
    errors = []
    for edges in (125, 250):
        batch = localised_helix(m, edges)
        assert wrod.solve_equilibria(batch, max_iterations=200).converged.all()
        gradient = batch.evaluate(order=1).gradient.numpy()[0]
        tension, torque = gradient[-7] + gradient[-3], gradient[-4]
        errors.append((tension - 1.0, torque / (2.0 * m) - 1.0))
    errors = np.abs(errors)
    assert (errors[1] < 5e-3).all()
    assert (errors[1] < 0.35 * errors[0]).all()


def test_modes_that_cost_nothing_are_not_counted():
    """A free straight rod has six rigid motions and a spin, and none is unstable."""
    position = np.zeros((1, 41, 3))
    position[0, :, 0] = np.linspace(0.0, 1.0, 41)
    batch = wrod.RodBatch.of(strip(), position[0, :, 0], position, gravity=[0, 0, 0])
    assert wrod.count_unstable_modes(batch)[0] == 0


def test_bathes_bend():
    """The tip of a bend of 45 degrees and radius 100, loaded across its plane by 600, moves by
    (-13.4, 53.4, -23.5) (Bathe & Bolourchi 1979): section 1 x 1, E = 10^7, no Poisson's effect."""
    radius, edges = 100.0, 160
    length = 0.25 * np.pi * radius
    youngs = 1e7
    model = strip(
        length, bending=(youngs / 12, youngs / 12), twisting=youngs / 2 * 0.1406,
        stretching=youngs, curvature=1.0 / radius,
    )  # fmt: skip
    s = np.linspace(0.0, length, edges + 1)
    s = np.concatenate([[-s[1]], s])
    # From the origin along x, bending towards y.
    arc = radius * np.column_stack([np.sin(s / radius), 1 - np.cos(s / radius), 0 * s])
    arc[0] = [s[0], 0.0, 0.0]
    batch = wrod.RodBatch.of(
        model, s, arc[None], clamped=(True, False), director=[0, 1, 0], gravity=[0, 0, 0],
        point_load=np.concatenate([np.zeros((edges + 1, 3)), [[0.0, 0.0, 600.0]]])[None],
    )  # fmt: skip
    wrod.prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    assert wrod.solve_equilibria(batch, max_iterations=200).converged.all()
    moved = batch.positions()[0, -1] - arc[-1]
    # Named by them: back along the first tangent, up, and against the bend.
    np.testing.assert_allclose(moved, [-23.5, -13.4, 53.4], atol=0.4)
