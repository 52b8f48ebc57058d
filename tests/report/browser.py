"""Headless Chromium for tests, over chromedriver's plain HTTP interface (W3C WebDriver)."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

PATIENCE_S = 300.0
"""Limit of every wait: only what hangs reaches it."""
KEYS = {"Enter": "\ue007", "Escape": "\ue00c", "ArrowDown": "\ue015", "ArrowRight": "\ue014", "ArrowLeft": "\ue012"}
_FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-dev-shm-usage",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
)  # fmt: skip


def programs() -> tuple[str, str] | None:
    """Chromium and chromedriver; None where either is missing."""
    browser = next((p for name in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(name))), None)
    driver = shutil.which("chromedriver")
    return (browser, driver) if browser and driver else None


class Browser:
    """One window with a fresh profile."""

    def __init__(self, width: int = 1280, height: int = 900) -> None:
        found = programs()
        if found is None:
            raise RuntimeError("no Chromium")
        self._profile = tempfile.mkdtemp(prefix="circlecal-chromium-")
        self._log = Path(self._profile) / "chromedriver.log"
        with self._log.open("wb") as log:
            self._driver = subprocess.Popen([found[1], "--port=0"], stdout=log, stderr=log)
        self._base = ""
        self._opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        self._session = ""
        try:
            self._base = f"http://127.0.0.1:{self._port_of_driver()}"
            options = {"binary": found[0], "args": [*_FLAGS, f"--user-data-dir={self._profile}"]}
            wanted = {
                "goog:chromeOptions": options,
                "goog:loggingPrefs": {"browser": "ALL", "performance": "ALL"},
            }
            answer = self._call("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
            self._session = f"/session/{answer['sessionId']}"
            self.resize(width, height)
        except BaseException:
            self.close()
            raise

    def _port_of_driver(self) -> int:
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end and self._driver.poll() is None:
            if told := re.search(r"started successfully on port (\d+)", self._log.read_text(errors="replace")):
                return int(told[1])
            time.sleep(0.05)
        raise RuntimeError(f"chromedriver does not start: {self._log.read_text(errors='replace')}")

    def _call(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        content = None if method == "GET" else json.dumps(body or {}).encode()
        request = urllib.request.Request(
            self._base + path, content, {"Content-Type": "application/json"}, method=method
        )
        try:
            with self._opener.open(request, timeout=PATIENCE_S) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise RuntimeError(json.load(error)["value"]["message"]) from None

    def close(self) -> None:
        """End the browser and its driver."""
        try:
            if self._session:
                self._call("DELETE", self._session)
        finally:
            self._driver.terminate()
            self._driver.wait()
            shutil.rmtree(self._profile, ignore_errors=True)

    def open(self, page: Path | str) -> None:
        """Load a page and wait for its load event."""
        address = page.resolve().as_uri() if isinstance(page, Path) else page
        self._call("POST", f"{self._session}/url", {"url": "about:blank"})
        self._call("POST", f"{self._session}/url", {"url": address})

    def run(self, script: str, *arguments: Any) -> Any:
        """Value that a script returns."""
        return self._call("POST", f"{self._session}/execute/sync", {"script": script, "args": list(arguments)})

    def wait(self, condition: str) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + PATIENCE_S
        while not self.run(f"return Boolean({condition})"):
            if time.monotonic() > end:
                raise AssertionError(f"never true: {condition}")
            time.sleep(0.03)

    def settle(self) -> None:
        """Wait until two more frames are drawn: what closed no longer lies over what a mouse points at."""
        script = "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => done()));"
        self._call("POST", f"{self._session}/execute/async", {"script": script, "args": []})

    def press(self, *keys: str) -> None:
        """Press keys one after the other where the focus is."""
        actions = [{"type": kind, "value": KEYS.get(key, key)} for key in keys for kind in ("keyDown", "keyUp")]
        self._call("POST", f"{self._session}/actions", {"actions": [{"type": "key", "id": "k", "actions": actions}]})

    def devtools(self, command: str, **arguments: Any) -> Any:
        """A command of the DevTools protocol."""
        return self._call("POST", f"{self._session}/goog/cdp/execute", {"cmd": command, "params": arguments})

    def resize(self, width: int, height: int, phone: bool = False) -> None:
        """Size of the page in CSS pixels."""
        self.devtools(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=phone
        )

    def prefer(self, scheme: str) -> None:
        """Set the system's colour scheme, light or dark."""
        feature = {"name": "prefers-color-scheme", "value": scheme}
        self.devtools("Emulation.setEmulatedMedia", features=[feature])

    def scripts(self, enabled: bool) -> None:
        """Switch JavaScript of pages on or off."""
        self.devtools("Emulation.setScriptExecutionDisabled", value=not enabled)

    def console(self) -> list[str]:
        """Messages of the console since the last call."""
        return [entry["message"] for entry in self._call("POST", f"{self._session}/se/log", {"type": "browser"})]

    def requests(self) -> list[str]:
        """Addresses that were requested since the last call."""
        entries = self._call("POST", f"{self._session}/se/log", {"type": "performance"})
        messages = [json.loads(entry["message"])["message"] for entry in entries]
        return [m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"]

    def screenshot(self, path: Path, whole: bool = False) -> None:
        """Write a PNG of the window, or of the whole page."""
        answer = self.devtools("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(answer["data"]))
