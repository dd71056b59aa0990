"""A real browser for tests: Chromium without a screen, told over two pipes what to do.

Its protocol is JSON, a message ends with a zero byte: https://chromedevtools.github.io/devtools-protocol
"""

import base64
import contextlib
import json
import os
import pathlib
import select
import shutil
import subprocess
import sys
import time

NAMES = ("chromium", "chromium-browser", "google-chrome")
_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",  # small in containers
    "--remote-debugging-pipe",
)
_PATIENCE_S = 60.0
# The browser reads from descriptor 3 and writes to 4.
_START = """
import os, sys
os.dup2(int(sys.argv[1]), 100), os.dup2(int(sys.argv[2]), 101)
os.dup2(100, 3), os.dup2(101, 4)
os.execv(sys.argv[3], sys.argv[3:])
"""


def found():
    """Return the browser of this machine, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@contextlib.contextmanager
def opened(profile: pathlib.Path):
    """Yield a browser's page; `profile` is a new, empty folder."""
    read, to_browser = os.pipe()
    from_browser, write = os.pipe()
    piped = [sys.executable, "-c", _START, str(read), str(write), found()]
    with open(profile.with_suffix(".log"), "wb") as log:
        browser = subprocess.Popen(
            [*piped, *_FLAGS, f"--user-data-dir={profile}"],
            pass_fds=(read, write),
            stdout=log,
            stderr=log,
        )
    os.close(read)
    os.close(write)
    page = Page(to_browser, from_browser)
    try:
        page.attach()
        yield page
        page.call("Browser.close", session=False)
        browser.wait(_PATIENCE_S)
    finally:
        browser.kill()
        browser.wait()
        os.close(to_browser)
        os.close(from_browser)


class Page:
    """One tab."""

    def __init__(self, to_browser: int, from_browser: int):
        self._pipes = to_browser, from_browser
        self._session, self._number, self._rest = None, 0, b""
        self.requested = []  # every address that the page asked for
        self.complaints = []  # errors and warnings on its console

    def attach(self):
        made = self.call("Target.createTarget", url="about:blank", session=False)
        flat = {"targetId": made["targetId"], "flatten": True}
        self._session = self.call("Target.attachToTarget", session=False, **flat)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method, *, session=True, **params):
        """Return what the browser answers."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if session:
            message["sessionId"] = self._session
        os.write(self._pipes[0], json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._number:
                assert "error" not in answer, (method, answer["error"])
                return answer["result"]

    def open(self, file: pathlib.Path):
        """Load a file and wait until it stands."""
        self.call("Page.navigate", url=file.resolve().as_uri())
        until = time.monotonic() + _PATIENCE_S
        while self.run("document.readyState + location.protocol") != "completefile:":
            assert time.monotonic() < until
            time.sleep(0.02)

    def run(self, script):
        """Return the value of JavaScript."""
        options = {"returnByValue": True, "awaitPromise": True}
        found = self.call("Runtime.evaluate", expression=script, **options)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def look(self, *, width=1280, height=900, dark=False, media=""):
        """Change window, colours and medium."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", media=media, features=[scheme])

    def press(self, key, code=0):
        """Press a key and let it go."""
        text = {"text": "\r"} if key == "Enter" else {}
        named = {"key": key, "code": key, "windowsVirtualKeyCode": code}
        self.call("Input.dispatchKeyEvent", type="keyDown", **named, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", **named)

    def picture(self, file: pathlib.Path, *, whole=False):
        """Save what is seen."""
        shot = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        file.write_bytes(base64.b64decode(shot["data"]))

    def pdf(self) -> bytes:
        """Return the page as it is printed on A4."""
        paper = {"paperWidth": 8.27, "paperHeight": 11.69, "printBackground": False}
        return base64.b64decode(self.call("Page.printToPDF", **paper)["data"])

    def _receive(self):
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._pipes[1]], [], [], _PATIENCE_S)
            assert ready, "the browser says nothing"
            got = os.read(self._pipes[1], 1 << 20)
            assert got, "the browser is gone"
            self._rest += got
        message, self._rest = self._rest.split(b"\0", 1)
        answer = json.loads(message)
        params = answer.get("params", {})
        if answer.get("method") == "Network.requestWillBeSent":
            self.requested.append(params["request"]["url"])
        elif answer.get("method") == "Log.entryAdded":
            self.complaints.append(params["entry"]["text"])
        elif answer.get("method") == "Runtime.exceptionThrown":
            self.complaints.append(params["exceptionDetails"]["text"])
        return answer
