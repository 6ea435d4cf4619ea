"""Laws that remember, and other energies of the section, against definitions and differences."""

import re
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from scipy.integrate import solve_ivp
from test_kernels import beyond_two_nodes, deformed_rods, displaced, fourth_order
from wrod.kernels.elastic import inelastic as kernels
from wrod.kernels.elastic.bend_twist import bend_twist_energy

import wrod
from wrod.errors import RodError
from wrod.rods.batch import RodBatch
from wrod.rods.law import Dahl, Plastic, StandardLinearSolid, law_as_json, law_of
from wrod.rods.model import RodModel
from wrod.rods.state import full_hessian

LAWS = (Plastic(7.0, 0.2), StandardLinearSolid(0.6, 0.3), Dahl(5.0, 0.4))


@wp.kernel
def take_flow(
    node: wp.array(dtype=kernels.Inelastic),
    excess: wp.array(dtype=wp.vec2d),
    weight: wp.array(dtype=wp.vec2d),
    out: wp.array(dtype=kernels.Flow),
):
    i = wp.tid()
    out[i] = kernels.flow(node[i], excess[i], weight[i])


def flows(law, start, lagging, end, weight, span=0.1):
    node = np.zeros(len(start), dtype=kernels.Inelastic.numpy_dtype())
    node["law"], node["share"], node["scale"], node["time"] = law.inelastic
    node["span"], node["excess"], node["lagging"] = span, start, lagging
    out = wp.zeros(len(start), dtype=kernels.Flow, device="cpu")
    wp.launch(
        take_flow,
        len(start),
        [
            wp.array(node, dtype=kernels.Inelastic, device="cpu"),
            wp.array(end, dtype=wp.vec2d, device="cpu"),
            wp.array(weight, dtype=wp.vec2d, device="cpu"),
        ],
        [out],
        device="cpu",
    )
    out = out.numpy()
    return out["z"].copy(), out["tangent"].copy(), out["work"].copy()


def cases(count=20, seed=1):
    rng = np.random.default_rng(seed)
    start, change = rng.normal(size=(2, count, 2)) * [[[8.0]], [[5.0]]]
    lagging = rng.normal(size=(count, 2))
    weight = rng.uniform(0.5, 1.5, count)
    return start, lagging, start + change, np.column_stack([weight, 2 - weight])


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_lagging_curvature_follows_its_equation(law):
    start, lagging, end, weight = cases()
    span = 0.1
    z, _, work = flows(law, start, lagging, end, weight, span)
    for k in range(len(start)):
        change, w = end[k] - start[k], weight[k]
        if isinstance(law, Plastic):
            # The closest point of the ellipse |z| = k_y in the norm of the energy.
            trial = lagging[k] + change
            size = np.sqrt(np.sum(w * trial**2))
            angle = np.linspace(0, 2 * np.pi, 20_001)
            edge = 7.0 * np.column_stack([np.cos(angle), np.sin(angle)]) / np.sqrt(w)
            near = edge[np.argmin(np.sum(w * (edge - trial) ** 2, axis=1))]
            expected, bound = (trial, 1e-12) if size < 7.0 else (near, 3e-3)
            np.testing.assert_allclose(z[k], expected, atol=bound)
            continue

        def rate(_, y, change=change, w=w):
            z, moved = y[:2], change / span
            if isinstance(law, Dahl):
                dz = moved - z / 5.0 * np.sqrt(np.sum(w * moved**2))
            else:
                dz = moved - z / 0.3
            return [*dz, np.sum(w * z * moved)]

        path = solve_ivp(rate, (0, span), [*lagging[k], 0.0], rtol=1e-10, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(z[k], path[:2], rtol=1e-7, atol=1e-8)
        if isinstance(law, Dahl):
            stored = 0.5 * np.sum(w * lagging[k] ** 2)
            assert work[k] == pytest.approx(stored + path[2], rel=1e-7)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_tangent_is_the_derivative(law):
    start, lagging, end, weight = cases(seed=2)
    _, tangent, _ = flows(law, start, lagging, end, weight)
    for k in range(2):
        way = 1e-5 * np.eye(2)[k]
        more, less = (flows(law, start, lagging, end + s * way, weight)[0] for s in (1, -1))
        np.testing.assert_allclose(tangent[:, :, k], (more - less) / 2e-5, atol=1e-7)
    # A step that does not move is elastic, also to the last digits.
    z, tangent, _ = flows(law, start, lagging, start, weight, span=0.0)
    np.testing.assert_allclose(z, lagging)
    np.testing.assert_allclose(tangent, np.broadcast_to(np.eye(2), tangent.shape))


def with_energy(kind: str) -> RodBatch:
    batch = deformed_rods(seed=5)
    shape = (batch.rod_count, batch.node_count)
    rng = np.random.default_rng(6)
    if kind == "bend-twist":
        batch.add_energy(bend_twist_energy, rng.normal(size=(*shape, 2)))
        return batch
    node = np.zeros(shape, dtype=kernels.Inelastic.numpy_dtype())
    law = {
        "plastic": Plastic(1.5, 0.3),
        "sls": StandardLinearSolid(0.7, 0.2),
        "dahl": Dahl(2.0, 0.1),
    }[kind]
    node["law"], node["share"], node["scale"], node["time"] = law.inelastic
    node["span"] = 0.1
    if kind != "dahl":  # which has no energy but from where it has never been bent
        node["excess"], node["lagging"] = rng.normal(size=(2, *shape, 2)) * 0.5
    number = wp.array(node, dtype=kernels.Inelastic, device="cpu")
    batch.add_energy(kernels.inelastic_energy, number)
    return batch


@pytest.mark.parametrize("kind", ["plastic", "sls", "dahl", "bend-twist"])
def test_energies_of_the_section_have_their_derivatives(kind):
    batch = with_energy(kind)
    out = batch.evaluate(order=2)
    gradient, band = out.gradient.numpy().copy(), out.hessian.numpy().copy()
    assert not band[:, beyond_two_nodes(batch)].any()
    slope = np.empty_like(gradient)
    jacobian = np.empty((batch.rod_count, batch.dof_count, batch.dof_count))
    for a in range(batch.dof_count):
        change = np.eye(batch.dof_count)[a]

        def energy(h, change=change):
            return displaced(batch, h * change, 1).energy.numpy()

        def forces(h, change=change):
            return displaced(batch, h * change, 1).gradient.numpy()

        slope[:, a] = fourth_order(energy, 2e-4)
        jacobian[:, :, a] = fourth_order(forces, 2e-4)
    assert np.abs(slope - gradient).max() < 1e-7 * np.abs(gradient).max()
    for r in range(batch.rod_count):
        dense = full_hessian(band[r])
        symmetric = 0.5 * (jacobian[r] + jacobian[r].T)
        assert np.abs(symmetric - dense).max() < 1e-7 * np.abs(dense).max()


def test_a_coupled_rod_twists_as_it_is_bent():
    """tau / kappa = -G / C of a rod that is bent to a circle and free to twist."""
    bending, twisting, coupling, curvature, nodes = 2.0, 1.5, 0.9, 0.05, 41
    s = np.linspace(0.0, 1.0, nodes)
    position = np.column_stack([np.sin(curvature * s), 0 * s, 1 - np.cos(curvature * s)])
    position /= curvature
    batch = RodBatch(
        position[None],
        stretching_stiffness=1e5,
        bending_stiffness=bending,
        twisting_stiffness=twisting,
        director=[0.0, 0.0, 1.0],
    )
    # Against the curvature's direction as it is seen by the directors, which twist turns.
    batch.add_energy(bend_twist_energy, [coupling, 0.0])
    free = np.zeros(batch.dof_count, dtype=bool)
    free[7::4] = True
    batch.set_free(free)
    wrod.solve_equilibria(batch)
    angle = batch.state.dof.numpy()[0, 3::4]
    assert np.diff(angle)[0] * (nodes - 1) == pytest.approx(
        -coupling / twisting * curvature, rel=0.01
    )


def test_laws_travel_in_files_and_units(tmp_path):
    for law in LAWS:
        assert law_of(law_as_json(law)) == law
        model = RodModel(0.5, 1e-3, 7e-4, 900.0, 0.02, 0.002, law=law)
        assert wrod.load_rod(wrod.save_rod(model, tmp_path / "rod.json")) == model
        scaled = model.scaled(0.1, 0.3)
        once_more = scaled.law.scaled(10.0, np.sqrt(9.81 / 0.1)).inelastic
        np.testing.assert_allclose(once_more, law.inelastic)
        assert "law" in model.not_uniform()
    for wrong in [
        {"name": "plastic", "yield_curvature": 0.0, "hardening": 0.1},
        {"name": "plastic", "yield_curvature": 1.0, "hardening": 1.1},
        {"name": "dahl", "slip_curvature": -1.0, "kept_stiffness": 0.1},
        {"name": "standard-linear-solid", "added_stiffness": 0.1, "relaxation_time": 0.0},
        {"name": "standard-linear-solid", "added_stiffness": 0.1},
    ]:
        with pytest.raises(RodError):
            law_of(wrong)


def test_contributing_shows_an_energy_as_it_is():
    root = Path(__file__).parents[1]
    block = re.search(r"```python\n(@wp.func.*?)```", (root / "CONTRIBUTING.md").read_text(), re.S)
    source = (root / "kernels" / "elastic" / "bend_twist.py").read_text()
    assert block.group(1) in source
