"""Effects that are built from profiles along the rod: exact derivatives, right places and sizes."""

from types import SimpleNamespace

import numpy as np
import pytest
from hidden import coarse
from test_identification import synthetic

from wrod.bench.hidden_sets import BUILT, hidden_set
from wrod.errors import DataError
from wrod.identification import identify
from wrod.identification.clamped.described import Attraction, LocalBend, LocalLoad, Stretch
from wrod.identification.clamped.fit import Fit, fit_models
from wrod.identification.clamped.giving import _mixed, pulled_at_own
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.loading import measurements_from_arrays
from wrod.identification.clamped.moment_law import MomentLaw
from wrod.identification.clamped.profiles import ProfileEffect, _linearised, profiles_of, told
from wrod.identification.clamped.refinement import with_profile
from wrod.identification.clamped.steps import evident, exchanged, leaner
from wrod.identification.clamped.verdict import Round
from wrod.identification.effect import Model, effects

BASIS = np.random.default_rng(3).normal(size=(21, 2, 3))
PROBES = {
    "local_bend": (LocalBend, [0.3, -0.2, 0.22, np.log(0.02)]),
    "stretch": (Stretch, [-0.6, 0.8, 0.2, np.log(0.06), 0.4]),
    "local_load": (LocalLoad, [3e-3, -4.5e-3, 1.5e-3, 0.27, 0.15, 0.4]),
    "attraction": (Attraction, [0.05, 0.5, -0.1, 0.4, np.log(0.05)]),
    "moment_law": (lambda _: MomentLaw([2.0, 5.0, 12.0]), [0.4, -0.3, 0.5]),
    "profile": (lambda starts: ProfileEffect("curvature", BASIS), [0.4, -0.3, 0.2]),
}


@pytest.fixture(scope="module")
def laboratory():
    return Laboratory(measurements_from_arrays(synthetic(trials=6)), edge_count=40)


@pytest.mark.parametrize("name", PROBES)
def test_derivatives_are_exact(laboratory, name):
    make, values = PROBES[name]
    model, values = Model((make([]),)), np.array(values)
    _, rates = laboratory.jacobian(model, values)
    here = laboratory.solver_at(model, values)[0].saved()
    for j in range(len(values)):
        step = np.zeros(len(values))
        step[j] = h = 1e-3 * max(abs(values[j]), 0.02)
        for moved in (ways := [values + k * step for k in (1, -1, 2, -2)]):
            laboratory.remember(model, moved, laboratory.trials, here)  # from where they are solved
        ahead = [laboratory.observe(model, moved) for moved in ways]
        numeric = (8 * (ahead[0] - ahead[1]) - (ahead[2] - ahead[3])) / (12 * h)
        markers = slice(0, 63)
        size = np.abs(numeric[:, markers]).max()
        assert size > 0.0
        assert np.abs(numeric[:, markers] - rates[:, markers, j]).max() <= 2e-4 * size


@pytest.mark.parametrize("softness", [-9.0, 0.0, 1.5])
@pytest.mark.parametrize("stiff", [np.log(3.0), -1.2])
@pytest.mark.parametrize(("start", "length"), [(0.2, 0.003), (0.2013, 0.008), (0.237, 0.06)])
def test_a_stretch_gives_and_weighs_as_told_wherever_the_nodes_are(
    laboratory, start, length, stiff, softness
):
    """Sections give one after another: compliances add up to those of the rod, not stiffnesses."""
    m, base, effect = laboratory.measurements, laboratory.base, Stretch([])
    values, heavy = np.array([stiff, 1.4, start, np.log(length), softness]), 1.4
    setup = Model((effect,)).setup(base, values)
    told = {k: e.value for k, e in effect.describe(values, np.eye(5), m).items()}
    # Of what is lost nothing may be left, so softer ends keep a little more of it.
    loss = {-9.0: 1e-6, 0.0: 0.01, 1.5: 0.13}[softness] if stiff > 0.0 else 1e-9
    assert told["extra_compliance"] == pytest.approx(np.expm1(-stiff) * length, rel=loss)
    cells = base.cells()
    for was, has in (
        (base.bending[:, 0], setup.bending[:, 0]),
        (base.twisting, setup.twisting),
    ):
        softer = (was / has - 1.0) * cells
        assert softer.sum() == pytest.approx(told["extra_compliance"], rel=1e-9)
        middle = (softer * base.arc_length).sum() / softer.sum()
        assert middle == pytest.approx(start + 0.5 * length, abs=0.26 * cells[1])
    drawn = (base.stretching / setup.stretching - 1.0) * np.diff(base.arc_length)
    assert drawn.sum() == pytest.approx(told["extra_compliance"], rel=1e-9)
    extra = (setup.line_mass - base.line_mass) * cells
    assert extra.sum() == pytest.approx(heavy * base.line_mass[0] * length, rel=1e-9)
    assert told["extra_mass"] == pytest.approx(extra.sum(), rel=1e-9)


def test_a_stretch_with_soft_ends_spreads_as_a_sharp_one_of_its_length():
    values, s = np.array([-1.0, 0.0, 0.2, np.log(0.06), 1.5]), np.linspace(0.0, 0.46, 46001)
    setup = SimpleNamespace(fraction=s / s[-1], length=s[-1], arc_length=s)
    setup.bending, setup.line_mass = np.ones((s.size, 2)), np.ones(s.size)
    setup.twisting, setup.stretching = np.ones(s.size), np.ones(s.size - 1)
    Stretch([]).apply(setup, values)
    softer = 1.0 / setup.twisting - 1.0
    softer /= softer.sum()
    centroid = softer @ s
    assert centroid == pytest.approx(0.23, abs=1e-6)
    assert softer @ (s - centroid) ** 2 == pytest.approx(0.06**2 / 12.0, rel=1e-4)


def test_a_kink_between_nodes_bends_by_its_whole_angle(laboratory):
    base = laboratory.base
    values = np.array([0.4, -0.3, 0.2141, np.log(1e-3)])
    curvature = Model((LocalBend([]),)).setup(base, values).natural_curvature
    assert base.cells() @ curvature == pytest.approx([-0.3, -0.4], rel=1e-9)


def test_a_load_is_told_by_the_moments_of_what_pushes_the_nodes(laboratory):
    m, base, load = laboratory.measurements, laboratory.base, LocalLoad([])
    values = np.array(PROBES["local_load"][1])

    def moments(values):
        force = Model((load,)).setup(base, values).force[0]
        along = force[:, 0] / force[:, 0].sum()
        centroid = along @ base.arc_length
        return [*force.sum(axis=0), centroid, np.sqrt(along @ (base.arc_length - centroid) ** 2)]

    way = np.array([4e-3, 1e-3, -2e-3, 0.03, 0.02, 0.5])  # of one unknown that moves all parameters
    h = 1e-4
    rates = (np.array(moments(values + h * way)) - moments(values - h * way)) / (2.0 * h)
    told = load.describe(values, np.outer(way, way), m)
    for key, value, rate in zip(
        ("total_x", "total_y", "total_z", "centroid", "spread"), moments(values), rates, strict=True
    ):
        assert told[key].value == pytest.approx(value, rel=5e-3)
        assert told[key].stderr == pytest.approx(abs(rate), rel=2e-2, abs=1e-5)


def test_a_law_of_one_term_is_the_softening_of_that_curvature(laboratory):
    """M = B k (1 - p x / (1 + x)) keeps 1 - p: two kernels' sums against one kernel."""
    law = laboratory.predict(Model((MomentLaw([5.0]),)), np.array([0.6]))
    known = laboratory.predict(Model((effects()["softening"],)), np.array([np.log(5.0), 0.6]))
    assert np.abs(law - laboratory.predict(Model(), np.zeros(0))).max() > 5e-3
    assert np.abs(law - known).max() < 1e-9


def test_the_scan_finds_the_kind_and_the_place():
    def bend(setup):
        bump = np.exp(-0.5 * ((setup.arc_length - 0.31) / 0.01) ** 2) / (0.01 * np.sqrt(2 * np.pi))
        setup.natural_curvature = setup.natural_curvature + bump[:, None] * np.array([0.15, -0.1])

    laboratory = coarse(synthetic(bend, seed=3, trials=8))
    linear = _linearised(laboratory)
    found = profiles_of(linear)
    assert found[0].kind == "curvature"
    assert found[0].effective < 0.8 * found[0].value.size
    # A profile as an effect has no numbers of which the data say little, and takes as much.
    basis = np.moveaxis(found[0].basis, 1, 0).reshape(found[0].value.size, -1)
    assert basis.shape[1] < 0.5 * len(basis)
    part = slice(linear.first["curvature"], linear.first["curvature"] + len(basis))
    towards = basis.T @ linear.towards[part]
    gram = basis.T @ linear.gram[part, part] @ basis
    kept = towards @ np.linalg.solve(gram + np.eye(len(gram)), towards)
    assert kept > 0.97 * linear.towards[part] @ found[0].value.T.ravel()
    taken, values, knot, _ = linear.scan(("curvature",), [(i, i) for i in range(1, 20)])[0]
    assert abs(knot * 0.025 - 0.31) < 0.02
    assert np.allclose(values * 0.025, [0.1, 0.15], atol=0.02)
    windows = [(i, j) for i in range(21) for j in range(i + 1, 21)]
    assert taken > linear.scan(("force",), windows)[0][0]


def stepped(size):
    """(laboratory, smooth profile, one that may have kinks, (21, 2) the truth) of a rod whose
    curvature ends half way."""
    curvature = size * np.array([4.0, -3.0])

    def step(setup):
        near = setup.arc_length < 0.24
        setup.natural_curvature = setup.natural_curvature + near[:, None] * curvature

    laboratory = coarse(synthetic(step, seed=5, trials=8))
    found = next(f for f in profiles_of(_linearised(laboratory)) if f.kind == "curvature")
    smooth = ProfileEffect("curvature", found.basis)
    (smooth,) = fit_models(laboratory, [Model((smooth,))], [smooth.start])
    rich = with_profile(laboratory, smooth, 0, "curvature")[0]
    place = np.linspace(0.0, laboratory.measurements.material.length, 21)
    return laboratory, smooth, rich, (place < 0.24)[:, None] * curvature


def test_a_step_of_curvature_is_likelier_as_a_profile_that_may_have_kinks():
    laboratory, *fits, true = stepped(1.0)
    assert evident(fits[1]) < evident(fits[0]) - 6.0
    off = [
        np.abs(told("curvature", f.model.effects[0], f.values, laboratory.measurements)[0] - true)
        for f in fits
    ]
    assert off[1].mean() < 0.7 * off[0].mean()


def test_a_profile_gives_way_to_a_constant_by_evidence():
    """The criterion takes each of its components for a number that was free."""
    laboratory, _, rich, _ = stepped(0.25)
    weighed = Round((), rich, [rich], [0.0], rich.model.names, "")
    constant = effects()["natural_curvature"]
    assert leaner(laboratory, rich, [constant], [weighed]) is rich
    (constant,) = (f for f in weighed.fits if f.model.names == ("natural_curvature",))
    assert constant.bic < rich.bic and evident(constant) > evident(rich)


def test_nothing_is_exchanged_beside_a_profile():
    model = Model((effects()["density"], ProfileEffect("curvature", BASIS)))
    fit = Fit(model, np.zeros(4), np.eye(4), 0.0, 9, 9.0, True)
    assert exchanged(None, fit, list(effects().values())) == (fit, [])


def test_a_fit_begins_at_the_base_model_where_no_path_leads_to_its_origin(laboratory, monkeypatch):
    model = Model((effects()["density"],))
    (plain,) = fit_models(laboratory, [model], [np.zeros(1)])

    def lost(*_):
        raise DataError("no equilibrium")

    monkeypatch.setattr(laboratory, "solver_at", lost)
    (fit,) = fit_models(laboratory, [model], [np.zeros(1)], origin=plain)
    assert np.array_equal(fit.values, plain.values)


@pytest.mark.slow
@pytest.mark.parametrize("name", BUILT)
def test_an_effect_without_a_plug_in_is_built(name):
    data, hidden = hidden_set(name, seed=11)
    report = identify(measurements_from_arrays(data, name=name))
    assert report.verdict == "explained"
    assert [e.name for e in report.effects] == list(hidden.truth)
    found = report.effects[0].parameters
    for keys, values in next(iter(hidden.truth.values())).items():
        away = [found[key].value - value for key, value in zip(keys, values, strict=True)]
        is_place = keys[0] in ("arc_length", "start", "x")
        limit = 0.01 if is_place else 0.15 * np.linalg.norm(values)
        assert np.linalg.norm(away) < limit * (np.sqrt(len(keys)) if is_place else 1.0)


@pytest.mark.usefixtures("on_coarse_meshes")
def test_a_law_of_unknown_form_is_found_and_reported():
    """A rod that softens and then stiffens is neither of the two laws that have a name."""
    terms = np.array([[1.0 / 9.0, 1.2], [1.0 / 144.0, -2.0]])

    def law(setup):
        setup.law = terms

    names = ["softening", "stiffness", "anisotropic_bending", "natural_curvature"]
    report = identify(measurements_from_arrays(synthetic(law, seed=4, trials=8)), candidates=names)
    assert report.verdict == "explained"
    assert [e.name for e in report.effects] == ["moment_law"]
    for key, share in report.effects[0].parameters.items():
        k = float(key.split("_")[-3])
        true = 1.0 - (terms[:, 1] * terms[:, 0] * k**2 / (1.0 + terms[:, 0] * k**2)).sum()
        assert abs(share.value - true) < max(3.0 * share.stderr, 0.02)


def test_a_short_heavy_stretch_comes_near_to_a_point_mass(laboratory):
    m, base = laboratory.measurements, laboratory.base
    stretch, s = Stretch([]), base.arc_length
    values = np.array([0.0, 1.5, 0.2, np.log(0.05), 0.0])
    (name, special), *others = stretch.special_cases(values, m).items()
    assert name == "point_mass" and not others
    heavy = Model((stretch,)).setup(base, values)
    extra = (heavy.line_mass - base.line_mass) * np.gradient(s)
    assert special[0] == pytest.approx(extra.sum(), rel=0.02)
    assert special[1] == pytest.approx((extra * s).sum() / extra.sum(), abs=1e-3)
    lump = Model((effects()[name],)).setup(base, special).node_mass - base.node_mass
    assert np.sum(lump) == pytest.approx(special[0])


def test_a_bend_over_the_whole_rod_comes_near_to_a_natural_curvature(laboratory):
    m, base, bend = laboratory.measurements, laboratory.base, LocalBend([])
    length = m.material.length
    values = np.array([0.7, -1.9, 0.4 * length, np.log(20.0 * length)])
    ((name, special),) = bend.special_cases(values, m).items()
    bent, curved = (
        Model((effect,)).setup(base, own).natural_curvature
        for effect, own in ((bend, values), (effects()[name], special))
    )
    assert np.abs(bent - curved).max() < 1e-3 * np.abs(bent).max()
    narrow = bend.special_cases(np.append(values[:3], np.log(1e-3)), m)[name]
    assert narrow * length == pytest.approx([-1.9, -0.7])  # the angle, spread over the rod


@pytest.mark.slow
def test_a_pull_is_at_the_rods_own_places_and_not_where_markers_err():
    """Beside a strong one the noise of markers is a force in each trial that is not there."""
    data, hidden = hidden_set("magnet", 903)
    truth = hidden.truth["attraction"]
    lab = Laboratory(measurements_from_arrays(data))
    values = np.array([*truth[("strength",)], *truth[("x", "y", "z")], np.log(0.05)])
    fit = fit_models(lab, [Model((Attraction([values]),))], [values], race=False)[0]
    own = pulled_at_own(lab, fit)
    for trials, some in ((lab.measurements.train, 50.0), (lab.measurements.test, 20.0)):
        count = lab.read[trials].sum()
        left, less = (lab.misfit(f.model, f.values, trials).sum() for f in (fit, own))
        assert less < left - some and less < count + 1.5 * np.sqrt(2.0 * count)
    solver, _ = lab.solver_at(own.model, own.values)
    there = solver.batch.positions()[:, 1:-1]
    assert np.abs(there - own.model.effects[0].shape).max() < 2e-4


def test_what_leads_away_is_mixed_to_where_it_stands():
    """Passes of a linear map that stretches one direction and shrinks others, of two trials."""
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    map_of = turn @ np.diag([-1.5, 0.9, 0.5, 0.0, 0.0, 0.0]) @ turn.T
    stands = rng.normal(size=(2, 2, 3))
    asked = [stands + rng.normal(size=stands.shape)]
    given = []
    for _ in range(5):
        away = (asked[-1] - stands).reshape(2, 6)
        given.append(stands + (away @ map_of.T).reshape(stands.shape))
        asked.append(_mixed(np.array(asked), np.array(given)))
    assert asked[-1] == pytest.approx(stands, abs=1e-9)
