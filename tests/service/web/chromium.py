"""Drive a headless Chromium over its DevTools protocol: enough for looking at a page and clicking on it."""

from __future__ import annotations

import atexit
import base64
import json
import shutil
import subprocess
import tempfile
import time
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
_OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--disable-backgrounding-occluded-windows",
    "--disable-renderer-backgrounding",
    "--remote-debugging-port=0",
)

_PATIENCE_S = 300.0  # what hangs ends by it; a busy machine is slow
_CLICK_PATIENCE_S = 20.0


def find_chromium() -> str | None:
    """Find the program, None where there is none."""
    return next((path for name in PROGRAMS if (path := shutil.which(name))), None)


@cache
def _browser(program: str) -> str:
    """Start a browser that ends with this process, and return the address of its DevTools."""
    folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
    browser = subprocess.Popen(
        [program, *_OPTIONS, f"--user-data-dir={folder.name}", "about:blank"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )

    def end() -> None:
        browser.terminate()
        browser.wait(10.0)
        folder.cleanup()

    atexit.register(end)
    told, patient_until = Path(folder.name) / "DevToolsActivePort", time.monotonic() + _PATIENCE_S
    while time.monotonic() < patient_until:
        if browser.poll() is not None:
            raise RuntimeError("Chromium ended at once")
        lines = told.read_text().split() if told.exists() else []
        if len(lines) == 2:
            return f"ws://127.0.0.1:{lines[0]}{lines[1]}"
        time.sleep(0.05)
    raise TimeoutError("Chromium did not open its DevTools port")


class Page:
    """One page of somebody new to the browser; `errors` are what the page's own programs complain about."""

    def __init__(self, program: str, width: int, height: int) -> None:
        self._number = 0
        self._session: str | None = None
        self.errors: list[str] = []
        self._ending = ExitStack()
        wire = connect(_browser(program), max_size=None, compression=None)
        self._socket = self._ending.enter_context(wire)
        self._person = self._call("Target.createBrowserContext", {})["browserContextId"]
        wanted = {"url": "about:blank", "browserContextId": self._person, "newWindow": True}
        target = self._call("Target.createTarget", wanted)["targetId"]
        self._session = self._call("Target.attachToTarget", {"targetId": target, "flatten": True})[
            "sessionId"
        ]
        for domain in ("Page", "Runtime", "Log"):
            self._call(f"{domain}.enable", {})
        self.show_on(width, height)

    def show_on(self, width: int, height: int, dark: bool = False) -> None:
        """Show the page on a screen of another size, or to somebody who likes it dark."""
        self._call(
            "Emulation.setDeviceMetricsOverride",
            {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600},
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._call("Emulation.setEmulatedMedia", {"features": [scheme]})

    def _call(self, method: str, parameters: dict[str, Any]) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        self._socket.send(json.dumps(message))
        while True:
            heard = json.loads(self._socket.recv(timeout=_PATIENCE_S))
            if heard.get("id") == self._number:
                if "error" in heard:
                    raise RuntimeError(f"{method}: {heard['error']}")
                return dict(heard["result"])
            self._note(heard)

    def _note(self, event: dict[str, Any]) -> None:
        if event.get("method") == "Runtime.exceptionThrown":
            details = event["params"]["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description") or details["text"])
        elif event.get("method") == "Log.entryAdded" and event["params"]["entry"]["level"] == "error":
            self.errors.append(event["params"]["entry"]["text"])

    def open(self, url: str) -> None:
        """Go to an address and wait until the page is there."""
        self._call("Page.navigate", {"url": url})
        self.wait("document.readyState === 'complete'")

    def run(self, script: str) -> Any:
        """Evaluate an expression in the page and return its value."""
        result = self._call(
            "Runtime.evaluate", {"expression": script, "returnByValue": True, "awaitPromise": True}
        )
        if "exceptionDetails" in result:
            raise RuntimeError(f"{script}: {result['exceptionDetails']['text']}")
        return result["result"].get("value")

    def run_in_frame(self, script: str) -> Any:
        """Evaluate an expression in the first frame of the page, None where it has none."""
        frames = self._call("Page.getFrameTree", {})["frameTree"].get("childFrames", ())
        for frame in frames:
            world = self._call("Page.createIsolatedWorld", {"frameId": frame["frame"]["id"]})
            result = self._call(
                "Runtime.evaluate",
                {"expression": script, "returnByValue": True, "contextId": world["executionContextId"]},
            )
            return result["result"].get("value")
        return None

    def wait(self, condition: str) -> Any:
        """Wait until an expression is true in the page."""
        end = time.monotonic() + _PATIENCE_S
        while time.monotonic() < end:
            if value := self.run(condition):
                return value
            time.sleep(0.05)
        raise AssertionError(
            f"{condition} stayed false; the page says: {self.run('document.body.innerText')}"
        )

    def click(self, selector: str) -> None:
        """Press the mouse in the middle of an element, as a person would: what covers it gets the click.

        Where the page moved on under the mouse, a person tries again, and moves the mouse by what it is off:
        on a busy machine an emulated phone is scrolled elsewhere than its page believes.
        """
        element = f"document.querySelector({selector!r})"
        self.run(f"window.heard = 0, {element}.addEventListener('click', () => window.heard = 1)")
        self.run("window.addEventListener('mousedown', e => window.at = [e.clientX, e.clientY], true)")
        off, end = [0.0, 0.0], time.monotonic() + _CLICK_PATIENCE_S
        while time.monotonic() < end:
            self.run(f"window.at = null, {element}.scrollIntoView({{block: 'center'}})")
            box = self.run(
                f"(() => {{ const r = {element}.getBoundingClientRect();"
                " return [r.x + r.width / 2, r.y + r.height / 2, r.width]; })()"
            )
            assert box[2] > 0, f"{selector} is not shown"
            for kind in ("mousePressed", "mouseReleased"):
                self._mouse(kind, box[0] + off[0], box[1] + off[1])
            if self.run("window.heard"):
                return
            if landed := self.run("window.at"):
                off = [o + wanted - got for o, wanted, got in zip(off, box, landed, strict=False)]
            time.sleep(0.1)
        raise AssertionError(f"{selector} does not get the click")

    def press(self, key: str) -> None:
        """Press a key: Tab, Enter, ArrowLeft, +."""
        pressed = {"key": key, "windowsVirtualKeyCode": {"Tab": 9, "Enter": 13}.get(key, 0)}
        text = {"text": "\r"} if key == "Enter" else {}
        self._call("Input.dispatchKeyEvent", {"type": "keyDown", **pressed, **text})
        self._call("Input.dispatchKeyEvent", {"type": "keyUp", **pressed})

    def hover(self, selector: str) -> tuple[float, float]:
        """Put the mouse over the middle of an element, and return where that is."""
        x, y = self.run(
            f'(() => {{ const e = document.querySelector("{selector}");'
            " e.scrollIntoView({block: 'center'}); const r = e.getBoundingClientRect();"
            " return [r.x + r.width / 2, r.y + r.height / 2]; })()"
        )
        self._mouse("mouseMoved", x, y)
        return x, y

    def drag(self, selector: str, right: float, down: float) -> None:
        """Drag the mouse from the middle of an element."""
        x, y = self.hover(selector)
        self._mouse("mousePressed", x, y)
        for part in (0.5, 1.0):
            self._mouse("mouseMoved", x + part * right, y + part * down)
        self._mouse("mouseReleased", x + right, y + down)

    def _mouse(self, kind: str, x: float, y: float) -> None:
        button = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
        self._call("Input.dispatchMouseEvent", {"type": kind, "x": x, "y": y, **button})

    def run_scripts(self, wanted: bool) -> None:
        """Let the pages that are opened from now on run their scripts, or not."""
        self._call("Emulation.setScriptExecutionDisabled", {"value": not wanted})

    def tab_to(self, selector: str, most: int = 20) -> None:
        """Reach an element by the Tab key alone."""
        for _ in range(most):
            if self.run(f"document.activeElement === document.querySelector({selector!r})"):
                return
            self.press("Tab")
        raise AssertionError(f"{selector} is not reached by the keyboard")

    def text(self, selector: str) -> str:
        """Return what an element says."""
        return str(self.run(f"document.querySelector({selector!r}).innerText"))

    def screenshot(self, path: Path, whole: bool = False) -> None:
        """Save what is seen, or the whole page."""
        self.run("new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))")
        path.parent.mkdir(parents=True, exist_ok=True)
        picture = self._call(
            "Page.captureScreenshot", {"captureBeyondViewport": whole} if not whole else self._all()
        )
        path.write_bytes(base64.b64decode(picture["data"]))

    def _all(self) -> dict[str, Any]:
        size = self._call("Page.getLayoutMetrics", {})["cssContentSize"]
        clip = {"x": 0, "y": 0, "width": size["width"], "height": size["height"], "scale": 1}
        return {"captureBeyondViewport": True, "clip": clip}

    def close(self) -> None:
        """End the page, and forget who looked at it."""
        self._session = None
        self._call("Target.disposeBrowserContext", {"browserContextId": self._person})
        self._ending.close()
