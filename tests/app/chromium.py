"""A real headless Chromium, driven over its DevTools socket: just enough for the viewer's tests."""

from __future__ import annotations

import base64
import contextlib
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

import websocket

_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--disable-background-timer-throttling",
    "--remote-debugging-port=0",
    "--remote-allow-origins=*",
    "--force-device-scale-factor=1",
)


def find() -> str | None:
    """Path of a Chromium, None if there is none."""
    return os.environ.get("LUXEL_CHROMIUM") or next(filter(None, map(shutil.which, _NAMES)), None)


class Page:
    """One tab in a browser of its own.

    `messages` collects what the page wrote to its console and exceptions it did not catch.
    """

    def __init__(self, url: str, size: tuple[int, int], *, dark: bool = True) -> None:
        program = find()
        if program is None:
            raise FileNotFoundError("no Chromium found; set LUXEL_CHROMIUM")
        self._profile = tempfile.mkdtemp(prefix="luxel-chromium-")
        self.messages: list[str] = []
        self._numbers = itertools.count(1)
        self._process = subprocess.Popen(
            [
                program,
                *_FLAGS,
                f"--user-data-dir={self._profile}",
                f"--window-size={size[0]},{size[1]}",
                "about:blank",
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            self._socket = websocket.create_connection(
                self._debugger(), timeout=60, enable_multithread=False, suppress_origin=True, max_size=None
            )
            self.call("Page.enable")
            self.call("Runtime.enable")
            self.call("Log.enable")
            self.call(
                "Emulation.setDeviceMetricsOverride",
                width=size[0],
                height=size[1],
                deviceScaleFactor=1,
                mobile=False,
            )
            scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
            self.call("Emulation.setEmulatedMedia", features=[scheme])
            self.call("Page.navigate", url=url)
        except BaseException:
            self.close()
            raise

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a DevTools method and return its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            answer = json.loads(self._socket.recv())
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]
            self._note(answer)

    def run(self, script: str) -> Any:
        """Evaluate an expression in the page and return its value; promises are awaited."""
        result = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in result:
            details = result["exceptionDetails"]
            raise RuntimeError(details.get("exception", {}).get("description") or details["text"])
        return result["result"].get("value")

    def wait(self, script: str, timeout_s: float, check: Callable[[Any], bool] = bool) -> Any:
        """Evaluate `script` until `check` accepts its value; it must be safe to evaluate at any time."""
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                value = self.run(script)
            except RuntimeError as error:
                value = error
            else:
                if check(value):
                    return value
            if time.monotonic() > deadline:
                raise TimeoutError(
                    f"waited {timeout_s:g} s for {script}; last: {value!r}; page: {self.messages}"
                )
            # The page itself waits for its next frame: no guess about how long things take.
            self.call("Runtime.evaluate", expression="new Promise(requestAnimationFrame)", awaitPromise=True)

    def screenshot(self, path: Path) -> Path:
        """Save what the tab shows as PNG."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))
        return path

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 6) -> None:
        """Drag with the left mouse button."""
        self._mouse("mousePressed", start, 1)
        for k in range(1, steps + 1):
            self._mouse(
                "mouseMoved", tuple(a + (b - a) * k / steps for a, b in zip(start, end, strict=True)), 1
            )
        self._mouse("mouseReleased", end, 0)

    def close(self) -> None:
        """End the browser and remove its profile."""
        with contextlib.suppress(AttributeError, OSError, websocket.WebSocketException):
            self._socket.close()
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        shutil.rmtree(self._profile, ignore_errors=True)

    def __enter__(self) -> Page:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _mouse(self, kind: str, at: tuple[float, ...], buttons: int) -> None:
        button = "left" if kind != "mouseMoved" else "none"
        self.call(
            "Input.dispatchMouseEvent",
            type=kind,
            x=at[0],
            y=at[1],
            button=button,
            buttons=buttons,
            clickCount=1,
        )

    def _note(self, event: dict[str, Any]) -> None:
        params = event.get("params", {})
        match event.get("method"):
            case "Runtime.exceptionThrown":
                details = params["exceptionDetails"]
                self.messages.append(details.get("exception", {}).get("description") or details["text"])
            case "Runtime.consoleAPICalled":
                self.messages.append(" ".join(str(each.get("value")) for each in params["args"]))
            case "Log.entryAdded":
                self.messages.append(params["entry"]["text"])

    def _debugger(self) -> str:
        """Address of the first tab's DevTools socket; the browser writes its port to a file once it listens."""
        port_file = Path(self._profile) / "DevToolsActivePort"
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            if self._process.poll() is not None:
                raise RuntimeError(f"Chromium ended at once with code {self._process.returncode}")
            text = port_file.read_text().split() if port_file.exists() else []
            if text:
                with urllib.request.urlopen(f"http://127.0.0.1:{text[0]}/json/list", timeout=10) as answer:
                    pages = [each for each in json.load(answer) if each["type"] == "page"]
                if pages:
                    return str(pages[0]["webSocketDebuggerUrl"])
            time.sleep(0.05)  # another process's start: nothing to wait on
        raise TimeoutError("Chromium did not open its DevTools port")
