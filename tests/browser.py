"""A page in headless Chromium, driven through its DevTools: what the page tests look with."""

from __future__ import annotations

import base64
import io
import json
import os
import shutil
import subprocess
import time
import urllib.request

import numpy as np

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
_TRACK = """(() => {
    const thumb = document.querySelector('[role=slider]');
    const box = thumb && thumb.parentElement.getBoundingClientRect();
    return box ? [box.x, box.y, box.width, box.height, Number(thumb.ariaValueNow),
                  Number(thumb.ariaValueMax)] : null;
})()"""


class Browser:
    """A page that plays a recorded scene.

    Args:
        page: its file.
        folder: of the browser's profile.
        seconds: that everything may take.
    """

    def __init__(self, page, folder, seconds: float = 300.0):
        self._deadline = time.monotonic() + seconds
        self._number = 0
        command = [
            CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader", "--disable-background-networking", "--no-first-run",
            "--window-size=800,600", "--remote-debugging-port=0", f"--user-data-dir={folder}",
            page.as_uri(),
        ]  # fmt: skip
        # Its language is then none that JavaScript takes, as on many machines without a screen.
        self._process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env=os.environ | {"LANG": "C", "LC_ALL": "C"},
        )  # fmt: skip
        self._port = folder / "DevToolsActivePort"

    def __enter__(self) -> Browser:
        from websockets.sync.client import connect

        try:
            port = self._until(lambda: self._port.is_file() and self._port.read_text().split())[0]
            address = f"http://127.0.0.1:{port}/json"

            def tab():
                tabs = json.loads(urllib.request.urlopen(address, timeout=30).read())
                return next((tab for tab in tabs if tab["type"] == "page"), None)

            at = self._until(tab)["webSocketDebuggerUrl"]
            self._socket = connect(at, max_size=None, open_timeout=60)
            self._until(self._track)
        except BaseException:
            self._process.kill()
            raise
        return self

    def __exit__(self, *exception) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait(30)

    def picture(self) -> np.ndarray:
        """(H, W, 3) of what is to be seen now, 0 to 255."""
        from PIL import Image

        data = base64.b64decode(self._call("Page.captureScreenshot")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)

    def slide(self, share: float) -> np.ndarray:
        """The picture after the slider was put to a share of the time, once it stands still."""
        x, y, width, height, _, last = self._track()
        place = {"x": x + share * width, "y": y + height / 2, "button": "left", "clickCount": 1}
        for kind in ("mousePressed", "mouseReleased"):
            self._call("Input.dispatchMouseEvent", type=kind, **place)
        self._until(lambda: abs(self._track()[4] / last - share) < 0.02)
        before = self.picture()

        def still():
            nonlocal before
            time.sleep(0.5)
            last, before = before, self.picture()
            return (last == before).all() and before is not None

        self._until(still)
        return before

    def _track(self):
        return self._call("Runtime.evaluate", expression=_TRACK, returnByValue=True)["result"].get(
            "value"
        )

    def _call(self, method: str, **parameters) -> dict:
        self._number += 1
        request = {"id": self._number, "method": method, "params": parameters}
        self._socket.send(json.dumps(request))
        while True:
            answer = json.loads(self._socket.recv(timeout=self._left()))
            if answer.get("id") == self._number:
                return answer["result"]

    def _until(self, ask):
        while not (answer := ask()):
            self._left()
            time.sleep(0.3)
        return answer

    def _left(self) -> float:
        left = self._deadline - time.monotonic()
        if left < 0:
            raise TimeoutError("the page did not answer in time")
        return left
