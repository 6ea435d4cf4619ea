import numpy as np
import pytest
from click.testing import CliRunner

import wrod
from wrod.commands import main
from wrod.identification import identify_motion
from wrod.identification.motion.loading import load_motion


def run(*words):
    return CliRunner().invoke(main, ["identify", *map(str, words)])


def test_clamped_template_is_a_cable_that_the_base_model_explains(tmp_path):
    from wrod.identification.clamped.laboratory import Laboratory
    from wrod.identification.effect import Model

    result = run("--template", "clamped", "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert "centerline       (12, 21, 3)" in result.output
    measured = wrod.load_measurements(tmp_path / "clamped.npz")
    laboratory = Laboratory(measured, edge_count=60)
    error = laboratory.rms(laboratory.predict(Model(), np.zeros(0)), measured.test)
    assert error == pytest.approx(measured.noise_floor, rel=0.15)


def test_motion_template_is_read_and_moves(tmp_path):
    assert run("--template", "motion", "--out", tmp_path).exit_code == 0
    recorded = load_motion(tmp_path / "motion.npz")
    assert recorded.positions.shape == (4, 60, 23, 3)
    moved = np.ptp(recorded.positions, axis=1).max(axis=(1, 2))
    assert (moved > 0.02).all() and (moved < 0.3).all()
    edges = np.linalg.norm(np.diff(recorded.positions[:, :, 1:-1], axis=2), axis=3)
    np.testing.assert_allclose(edges, 0.015, atol=3e-4)  # it bends, and does not stretch


@pytest.mark.slow
def test_nothing_that_varies_is_found_of_the_cable_in_motion(tmp_path):
    """Its grips once bent the rod inside them by half: a stiffness four times as large in the
    middle was found."""
    assert run("--template", "motion", "--out", tmp_path).exit_code == 0
    profiles = ("stiffness_profile", "natural_curvature_profile")
    found = identify_motion(
        load_motion(tmp_path / "motion.npz"), candidates=("axial_stiffness", *profiles)
    )
    assert not {effect.name for effect in found.effects} & set(profiles)
    assert found.base["stiffness"]["L_gb"].value == pytest.approx(0.05, rel=0.02)
    (damping,) = (e for e in found.effects if e.name == "internal_damping")
    assert damping.parameters["viscous_time"].value == pytest.approx(0.02, rel=0.1)
    assert found.verdict == "adequate"
    assert found.after < 2.5 * found.noise_floor


@pytest.mark.parametrize(
    "words, says",
    [
        (["--template", "photo"], "no template 'photo'; there are clamped, motion"),
        (["a.npz", "--template", "motion"], "give one or the other"),
        ([], "no measurements given"),
    ],
)
def test_what_is_not_meant_is_refused(tmp_path, words, says):
    result = run(*words, "--out", tmp_path / "out")
    assert result.exit_code == 2 and says in result.output
    assert not (tmp_path / "out").exists()
