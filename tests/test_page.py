import numpy as np
import pytest

import wrod
from tests.browser import CHROMIUM, Browser
from wrod.scene.page import write_deployment_page
from wrod.scene.page_parts import expected_errors

pytest.importorskip("viser")


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    rod = wrod.rod("rope")
    trajectory = wrod.plan(wrod.pattern("line"), rod, method="intuitive", spacing=0.02)
    out = tmp_path_factory.mktemp("page") / "scene.html"
    count = len(trajectory)
    shapes = np.linspace(trajectory.contact, trajectory.position, 30, axis=1)
    errors = np.full((count, 30), 0.02)
    return write_deployment_page(
        out, trajectory, rod=rod, shapes=shapes, errors=errors, captions=["a caption"]
    )


def test_page_holds_everything(page):
    text = page.read_text(encoding="utf-8")
    assert len(text) < 6e6
    assert "<title>line</title><style>" in text
    for mark in ('src="http', "src='http", 'href="http'):
        assert mark not in text  # nothing is fetched from elsewhere


@pytest.fixture(scope="module")
def arm_page(tmp_path_factory):
    """A short line laid by a Sawyer, from and to its neutral pose."""
    rod = wrod.rod("green-vps")
    pattern = wrod.Pattern.from_expression("0*x", start=0.0, stop=0.4, name="line")
    trajectory = wrod.plan(pattern, rod, method="numeric", spacing=0.01)
    path = wrod.solve_joint_path(trajectory, whole_job=True)
    out = tmp_path_factory.mktemp("page") / "scene.html"
    return write_deployment_page(out, trajectory, path, pattern=pattern, rod=rod)


def test_what_lies_is_coloured_by_what_is_expected_of_it():
    pattern = wrod.pattern("line")
    trajectory = wrod.plan(pattern, wrod.rod("rope"), method="intuitive", spacing=0.02)
    x = np.linspace(0.0, 0.8, 81)
    z = trajectory.contact[0, 2] + np.clip(x - 0.4, 0.0, None)
    shapes = np.column_stack([x, 0.0 * x, z])[None]
    assert expected_errors(trajectory, pattern, shapes) is None
    trajectory.metadata["expected"] = {"error_along": np.linspace(0.0, 0.01, 50).tolist()}
    (errors,) = expected_errors(trajectory, pattern, shapes)
    lies = x < 0.401
    np.testing.assert_allclose(errors[lies], 0.01 * x[lies] / pattern.length, atol=1e-9)
    assert (errors[~lies] == 0.0).all()


looks = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to look at the page with")


def coloured(pixels):
    """Where a picture (H, W, 3) is red as the arm, green as the rod, blue as the pattern and brown
    as the table: dictionary of masks; left out are the browser's note and the player."""
    seen = pixels[:-60]
    red, green, blue = (seen[..., k] for k in range(3))
    masks = {
        "red": (red - green > 60) & (red - blue > 60),
        "green": (green - red > 25) & (green - blue > 15),
        "blue": (blue - red > 45) & (blue - green > 20),
        "brown": (red - blue > 25) & (red - green > 5) & (red - green < 60),
    }
    for mask in masks.values():
        mask[:200, :330] = False
    return masks


@looks
def test_page_shows_arm_rod_and_pattern_and_its_slider_moves_them(arm_page, tmp_path):
    with Browser(arm_page, tmp_path / "profile") as browser:
        early, late, end = (coloured(browser.slide(share)) for share in (0.04, 0.6, 0.98))
    for moment in (early, late, end):
        assert moment["red"].sum() > 1500  # the arm
        assert moment["brown"].sum() > 5000  # the table
        assert moment["green"].sum() > 60  # the rod
    assert min(moment["blue"].sum() for moment in (early, late)) > 100  # the pattern
    for first, second in ((early, late), (late, end)):
        assert (first["red"] ^ second["red"]).sum() > 1000
        assert (first["green"] ^ second["green"]).sum() > 60

    def top(moment):
        return np.flatnonzero(moment["green"].any(axis=1))[0]

    # It hangs from high over the table at first, from lower later, and lies in the end.
    assert top(early) + 20 < top(late) < top(end) - 20


@looks
def test_page_shows_where_a_rod_lies_astray(page, tmp_path):
    with Browser(page, tmp_path / "profile") as browser:
        seen = coloured(browser.slide(0.9))
    # The rod lies two centimetres off everywhere: red.
    assert seen["red"].sum() > 100 and seen["green"].sum() < 20
    assert seen["brown"].sum() > 2000


def test_a_laid_rod_is_coloured_where_it_lies_astray(tmp_path, monkeypatch):
    from types import SimpleNamespace

    from wrod.errors import SceneError
    from wrod.scene import page as module

    rod, pattern = wrod.rod("rope"), wrod.pattern("line")
    trajectory = wrod.plan(pattern, rod, method="intuitive", spacing=0.02)
    s = np.linspace(0.0, rod.length, 60)
    on = pattern.sample(np.clip(s, 0.0, pattern.length))[0]
    frames = np.repeat(on[None], 3, axis=0)
    frames[1:, 30:, 2] += 0.1  # still in the air: no error, wherever it is
    frames[1:, 30:, 1] += 0.05
    frames[2, 10:15, 1] += 0.004  # lies 4 mm aside
    laid = SimpleNamespace(frames=frames, arc_length=s, error_mean=0.001, released_error_mean=0.002)
    seen = {}
    monkeypatch.setattr(module, "write_deployment_page", lambda out, *a, **k: seen.update(k) or out)
    out = module.write_laying_page(tmp_path / "a.html", laid, trajectory, pattern, rod, 0.25)
    assert out == tmp_path / "a.html" and seen["time"].tolist() == [0.0, 0.25, 0.5]
    wanted = np.zeros((3, 60))
    wanted[2, 10:15] = 0.004
    np.testing.assert_allclose(seen["errors"], wanted, atol=1e-9)
    assert seen["captions"][0].startswith("0.10 cm from the pattern")
    laid.frames = None
    with pytest.raises(SceneError, match="has no frames"):
        module.write_laying_page(tmp_path / "b.html", laid, trajectory, pattern, rod, 0.25)
