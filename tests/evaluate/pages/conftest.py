"""A run folder to make pages of, and a real headless Chromium to look at them.

The browser is spoken to through a pipe (Chrome DevTools Protocol): no driver, no port.
"""

import base64
import contextlib
import fcntl
import json
import os
import select
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gs2ci.evaluate import run_folder
from gs2ci.evaluate.environment import Machine
from gs2ci.evaluate.pages.run_page import write_run_page
from gs2ci.evaluate.tradeoff.record import TradeoffRecord, Tried, write_record
from tests.evaluate.reports import GEOMETRY
from tests.patience import HANG_S

NAMES = (
    "chromium",
    "chromium-browser",
    "chromium-headless-shell",
    "chrome-headless-shell",
    "google-chrome",
    "google-chrome-stable",
)


class Tab:
    """One page under the eyes of the protocol."""

    def __init__(self, process: "Pipe", session: str) -> None:
        self._process, self._session = process, session
        self.requests: list[str] = []
        self.complaints: list[str] = []

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        return self._process.ask(method, parameters, self._session, self._note)

    def open(self, path: Path, width: int, height: int = 900, *, dark: bool = False, paper: bool = False) -> "Tab":
        """Load a file as seen on a screen of so many CSS pixels; the requests and complaints start anew."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.ask("Emulation.setEmulatedMedia", media="print" if paper else "screen", features=[scheme])
        self.ask(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )
        self.requests.clear()
        self.complaints.clear()
        self.ask("Page.navigate", url=path.resolve().as_uri())
        until = time.monotonic() + HANG_S
        while self.run("document.readyState") != "complete" and time.monotonic() < until:
            time.sleep(0.02)
        self.run("Promise.all([...document.images].map(i => i.decode().catch(() => 0))).then(() => 1)")
        return self

    def run(self, script: str) -> Any:
        """Evaluate an expression in the page; a promise is waited for."""
        found = self.ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def shoot(self) -> np.ndarray:
        """Take a screenshot of the window, [H, W, 3] RGB."""
        png = base64.b64decode(self.ask("Page.captureScreenshot")["data"])
        return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]

    def pdf(self) -> bytes:
        """Print the page that is open, as the browser's own print command would."""
        self.ask("Emulation.setEmulatedMedia", media="")
        return base64.b64decode(self.ask("Page.printToPDF", preferCSSPageSize=True, printBackground=False)["data"])

    def _note(self, event: dict[str, Any]) -> None:
        parameters = event["params"]
        match event["method"]:
            case "Network.requestWillBeSent":
                self.requests.append(parameters["request"]["url"])
            case "Runtime.exceptionThrown":
                self.complaints.append(str(parameters["exceptionDetails"]))
            # What drawing without a graphics card costs is no fault of a page.
            case "Log.entryAdded" if "GL Driver Message (OpenGL, Performance" not in parameters["entry"]["text"]:
                self.complaints.append(parameters["entry"]["text"])


class Pipe:
    """A browser process: requests on its descriptor 3, answers and events on its 4, each ended by a zero byte."""

    def __init__(self, binary: str, profile: Path) -> None:
        from_us, self._to = os.pipe()
        self._from, to_us = os.pipe()
        arguments = [
            *("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"),
            "--enable-unsafe-swiftshader",  # WebGL without a graphics card
            *("--hide-scrollbars", "--remote-debugging-pipe", f"--user-data-dir={profile}", "about:blank"),
        ]
        # Out of the way of 3 and 4 themselves.
        far = [fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, 10) for descriptor in (from_us, to_us)]
        nothing = [(os.POSIX_SPAWN_OPEN, number, os.devnull, os.O_RDWR, 0) for number in (0, 1, 2)]
        ends = [(os.POSIX_SPAWN_DUP2, descriptor, number) for descriptor, number in zip(far, (3, 4), strict=True)]
        self._process = os.posix_spawn(
            binary, [binary, *arguments], os.environ, file_actions=[*nothing, *ends], setpgroup=0
        )
        for descriptor in (from_us, to_us, *far):
            os.close(descriptor)
        self._number, self._rest = 0, b""

    def ask(self, method: str, parameters: dict[str, Any], session: str = "", note: Any = None) -> dict[str, Any]:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            if note is not None and "method" in answer:
                note(answer)

    def _read(self) -> dict[str, Any]:
        until = time.monotonic() + HANG_S
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._from], [], [], max(until - time.monotonic(), 0))
            chunk = os.read(self._from, 1 << 20) if ready else b""
            if not chunk:
                raise TimeoutError("the browser does not answer")
            self._rest += chunk
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)

    def close(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process, signal.SIGKILL)
        os.waitpid(self._process, 0)
        os.close(self._to)
        os.close(self._from)


@pytest.fixture(scope="session")
def write_quickly() -> Callable[..., Path]:
    """Write run folders without their overview, which takes the time and has tests of its own."""

    def write(*parts: Any) -> Path:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(run_folder, "write_overview", lambda path, *_: path.touch())
            return run_folder.write_run(*parts)

    return write


@pytest.fixture(scope="session")
def whole_run(tmp_path_factory, make_run, scene, write_quickly, tradeoff_record) -> Path:
    """A run folder with everything in it: truth, stage's poses, simulation plan, trade-off. Not to be changed."""
    shot, result = make_run(count=8, size=(48, 64))
    effect = {"bound_rms_dn": 19.7, "simulated": True, "why": "exceeds its share", "sampling": ""}
    plan = {"tolerance_dn": 1.0, "error_dn": 0.8, "views": 60, "effects": {"shot_noise": effect}}
    shot = replace(
        shot,
        telemetry_world_to_camera=shot.truth.world_to_camera,
        saturated=np.zeros((48, 64), bool),
        provenance={"source": "simulated rig", "plan": plan},
    ).check()
    geometry = {**GEOMETRY, "focal_px": 70.4, "focal_source": "estimated", "path_error_expected": 0.0123}
    folder = write_quickly(tmp_path_factory.mktemp("whole") / "run", shot, replace(result, geometry=geometry), scene)
    write_record(folder, tradeoff_record)
    write_run_page(folder)
    return folder


@pytest.fixture(scope="session")
def tradeoff_record() -> TradeoffRecord:
    """What a trade-off may have left: three trials of the front, and one that is none."""
    return TradeoffRecord(
        "a shot",
        "psnr_db",
        ("Decode: 24.00 dB in 1 s, the quickest of all.", "half the resolution failed: too small"),
        (
            Tried("decode", "preset", 1.0, 24.0, 0.9, None, 20.0, 0, 0, unbeaten=True),
            Tried("draft", "preset", 12.0, 29.5, 0.93, 0.02, 20.5, 200, 4000, unbeaten=True),
            Tried("standard", "preset", 60.0, 31.0, 0.95, 0.01, 21.0, 1000, 5000, unbeaten=True),
            Tried("100 iterations", "iterations", 70.0, 28.0, 0.92, 0.02, 20.2, 100, 4500, unbeaten=False),
        ),
        "gs2ci tradeoff shot.h5",
        Machine("a processor", "x86_64", 4, 1000, "Linux"),
        {"gs2ci": "1.0"},
    )


@pytest.fixture
def own_run(whole_run, tmp_path) -> Path:
    """A copy of `whole_run` to damage."""
    return Path(shutil.copytree(whole_run, tmp_path / "run"))


@pytest.fixture(scope="session")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    """Open a tab of a headless Chromium; skips where there is none."""
    binary = next((found for name in NAMES if (found := shutil.which(name))), None)
    if binary is None:
        pytest.skip(f"no Chromium on this machine (looked for {', '.join(NAMES)})")
    pipe = Pipe(binary, tmp_path_factory.mktemp("chromium"))
    try:
        try:
            target = pipe.ask("Target.createTarget", {"url": "about:blank"})["targetId"]
        except (OSError, TimeoutError) as error:
            pytest.skip(f"{binary} does not run here: {error}")
        session = pipe.ask("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
        opened = Tab(pipe, session)
        for domain in ("Page", "Runtime", "Network", "Log"):
            opened.ask(f"{domain}.enable")
        yield opened
    finally:
        pipe.close()
