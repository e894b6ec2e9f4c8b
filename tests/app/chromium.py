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

# Only ever waited for when a test is about to fail: on a busy machine, kernels are compiled meanwhile.
_TIMEOUT_S = 300.0
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


class Browser:
    """A headless Chromium with a profile of its own; `flags` come on top of those that tests need."""

    def __init__(self, *flags: str) -> None:
        program = find()
        if program is None:
            raise FileNotFoundError("no Chromium found; set LUXEL_CHROMIUM")
        self._profile = tempfile.mkdtemp(prefix="luxel-chromium-")
        self.process = subprocess.Popen(
            [program, *_FLAGS, *flags, f"--user-data-dir={self._profile}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            self._root = f"http://127.0.0.1:{self._port()}/json"
            while not any(each["type"] == "page" for each in self._ask("list")):
                time.sleep(0.05)  # another process's start: nothing to wait on
            version = self._ask("version")
            self._socket = websocket.create_connection(
                version["webSocketDebuggerUrl"], timeout=_TIMEOUT_S, suppress_origin=True
            )
        except BaseException:
            self.close()
            raise

    def tab(self) -> tuple[str, Callable[[], None]]:
        """Open a tab; return the address of its DevTools socket, and what closes it."""
        # A window of its own, or the browser puts all tabs but one to sleep.
        made = self._call("Target.createTarget", url="about:blank", newWindow=True)["targetId"]
        found = next(each for each in self._ask("list") if each["id"] == made)
        return str(found["webSocketDebuggerUrl"]), lambda: self._ask(f"close/{made}")

    def close(self) -> None:
        """End the browser and remove its profile."""
        with contextlib.suppress(AttributeError, OSError, websocket.WebSocketException):
            self._socket.close()
        self.process.terminate()
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        shutil.rmtree(self._profile, ignore_errors=True)

    def __enter__(self) -> Browser:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _ask(self, what: str) -> Any:
        with urllib.request.urlopen(f"{self._root}/{what}", timeout=10) as answer:
            text = answer.read()
        return json.loads(text) if text.startswith((b"{", b"[")) else None

    def _call(self, method: str, **params: Any) -> Any:
        self._socket.send(json.dumps({"id": 1, "method": method, "params": params}))
        while True:
            answer = json.loads(self._socket.recv())
            if answer.get("id") == 1:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]

    def _port(self) -> str:
        """Port of its DevTools; the browser writes it to a file once it listens."""
        port_file = Path(self._profile) / "DevToolsActivePort"
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            if self.process.poll() is not None:
                raise RuntimeError(f"Chromium ended at once with code {self.process.returncode}")
            text = port_file.read_text().split() if port_file.exists() else []
            if text:
                return text[0]
            time.sleep(0.05)  # another process's start: nothing to wait on
        raise TimeoutError("Chromium did not open its DevTools port")


class Page:
    """One tab, of `browser` or else in a browser of its own.

    `messages` collects what the page wrote to its console and exceptions it did not catch; `requests` the addresses
    that it asked for, once the test has called ``Network.enable``.
    """

    def __init__(
        self, url: str, size: tuple[int, int], *, dark: bool = True, browser: Browser | None = None
    ) -> None:
        self.browser = browser or Browser()
        self._owned = browser is None
        self.messages: list[str] = []
        self.requests: list[str] = []
        self._numbers = itertools.count(1)
        try:
            address, self._end = self.browser.tab()
            self._socket = websocket.create_connection(
                address, timeout=_TIMEOUT_S, enable_multithread=False, suppress_origin=True, max_size=None
            )
            for domain in ("Page", "Runtime", "Log"):
                self.call(f"{domain}.enable")
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

    def click(self, at: tuple[float, float]) -> None:
        """Click with the left mouse button."""
        self._mouse("mousePressed", at, 1)
        self._mouse("mouseReleased", at, 0)

    def press(self, key: str, *, shift: bool = False) -> None:
        """Press and release a key, named as in a KeyboardEvent, where the focus is."""
        code = {
            "Tab": 9,
            "Enter": 13,
            "Escape": 27,
            " ": 32,
            "ArrowLeft": 37,
            "ArrowUp": 38,
            "ArrowRight": 39,
        }
        code["ArrowDown"] = 40
        what = {"key": key, "modifiers": 8 if shift else 0, "windowsVirtualKeyCode": code.get(key, 0)}
        text = {"Enter": "\r"}.get(key, key if len(key) == 1 else "")
        self.call("Input.dispatchKeyEvent", type="keyDown", **what, **({"text": text} if text else {}))
        self.call("Input.dispatchKeyEvent", type="keyUp", **what)

    def close(self) -> None:
        """Close the tab, and its browser if it has one of its own."""
        with contextlib.suppress(AttributeError, OSError, websocket.WebSocketException):
            self._socket.close()
        if self._owned:
            self.browser.close()
        else:
            with contextlib.suppress(AttributeError, OSError):
                self._end()

    def __enter__(self) -> Page:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _mouse(self, kind: str, at: tuple[float, ...], buttons: int) -> None:
        button = "left" if buttons or kind == "mouseReleased" else "none"
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
                text = params["entry"]["text"]
                if (
                    "performance warning" not in text and "too many errors" not in text
                ):  # of drawing by software
                    self.messages.append(text)
            case "Network.requestWillBeSent":
                self.requests.append(params["request"]["url"])
