import base64
import io
import json
import shutil
import subprocess
import time
import urllib.request

import numpy as np
import pytest

import wrod
from wrod.scene.page import write_deployment_page

pytest.importorskip("viser")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


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
    for mark in ('src="http', "src='http", 'href="http'):
        assert mark not in text  # nothing is fetched from elsewhere


def pictures(page, folder, seconds):
    """Pictures (H, W, 3) of a page in headless Chromium, one every few seconds, while asked for."""
    from PIL import Image
    from websockets.sync.client import connect

    command = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader", "--disable-background-networking", "--window-size=900,700",
        "--remote-debugging-port=0", f"--user-data-dir={folder}", page.as_uri(),
    ]  # fmt: skip
    browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + seconds
        port = folder / "DevToolsActivePort"
        while not port.is_file() and time.monotonic() < deadline:
            time.sleep(0.5)
        address = f"http://127.0.0.1:{port.read_text().split()[0]}/json"
        tabs = json.loads(urllib.request.urlopen(address, timeout=30).read())
        tab = next(tab for tab in tabs if tab["type"] == "page")
        with connect(tab["webSocketDebuggerUrl"], max_size=None, open_timeout=30) as socket:
            number = 0
            while time.monotonic() < deadline:
                number += 1
                socket.send(json.dumps({"id": number, "method": "Page.captureScreenshot"}))
                while "result" not in (answer := json.loads(socket.recv(timeout=seconds))):
                    pass
                data = base64.b64decode(answer["result"]["data"])
                yield np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)
                time.sleep(2.0)
    finally:
        browser.terminate()
        browser.wait(30)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to look at the page with")
def test_page_shows_table_and_rod(page, tmp_path):
    rod = table = 0
    for pixels in pictures(page, tmp_path / "profile", 150.0):
        seen = pixels[60:600, 320:]  # beside notes, above the player
        red, green, blue = (seen[..., k] for k in range(3))
        # The rod lies two centimetres off everywhere: red. The table is brown.
        rod = ((red - green > 60) & (red - blue > 60)).sum()
        table = ((red - blue > 25) & (red - green > 5) & (red - green < 60)).sum()
        if rod > 100 and table > 2000:
            return
    pytest.fail(f"{rod} pixels of the rod and {table} of the table")


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
