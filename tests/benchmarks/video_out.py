"""A video output for ten minutes at 60 Hz: SDL on a real X display (Xvfb), each refresh timed.

`python -m tests.benchmarks video_out` needs Xvfb and the extra `video`. Xvfb has no refresh of its own: the
clock of `SdlScreen` stands for it, so that this measures whether a computer keeps up, and no cable.
"""

import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from gs2ci.core.clock import WallClock
from gs2ci_drivers.failures import SequenceError
from gs2ci_drivers.links.sdl_screen import SdlScreen
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_drivers.video_out.driver import VideoOut
from gs2ci_drivers.video_out.options import VideoOutOptions

MINUTES = 10.0
SIZE = (768, 1024)


class Timed(SdlScreen):
    """Notes when each picture was shown."""

    times_ns: list[int]

    def flip(self, levels):
        shown_ns = super().flip(levels)
        self.times_ns.append(shown_ns)
        return shown_ns


def run() -> None:
    """Show a new picture at each refresh, and print how evenly they came and what the driver said of it."""
    binary = shutil.which("Xvfb")
    if binary is None:
        print("no Xvfb on this machine")
        return
    reading, writing = os.pipe()
    with tempfile.TemporaryDirectory() as folder, (Path(folder) / "log").open("wb") as log:
        screen = f"{SIZE[1]}x{SIZE[0]}x24"
        command = [binary, "-displayfd", str(writing), "-screen", "0", screen]
        server = subprocess.Popen(command, pass_fds=(writing,), stdout=log, stderr=log)
        os.close(writing)
        try:
            with os.fdopen(reading) as told:
                os.environ["DISPLAY"] = ":" + told.readline().strip()
            os.environ["SDL_VIDEODRIVER"] = "x11"
            _measure()
        finally:
            server.terminate()
            server.wait()


def _measure() -> None:
    port = Timed("slm")
    port.times_ns = []
    modulator = VideoOut("slm", port, WallClock(), VideoOutOptions(kind="video", port="last"))
    info = modulator.connect()
    masks = (np.random.default_rng(0).random((8, info.height, info.width)) < 0.5).astype(np.uint8)
    refreshes = round(MINUTES * 60 / info.exposure_step_s)
    modulator.upload(
        PatternSequence(masks, 1, info.exposure_step_s, repeats=refreshes // len(masks), trigger=TriggerOut.NONE)
    )
    began_s, told, shown, unseen = time.monotonic(), 0, 0, 0
    while time.monotonic() < began_s + MINUTES * 60:
        modulator.arm()
        port.times_ns.clear()
        modulator.start()
        ended = 0
        try:
            modulator.wait_done(2 * MINUTES * 60)
        except SequenceError:
            ended = 1
        # The last one is the dark picture.
        apart = np.diff(port.times_ns[:-1]) * 1e-9 / info.exposure_step_s
        uneven = int((np.abs(apart - 1) > 0.5).sum())
        shown, told, unseen = shown + len(apart) + 1, told + ended, unseen + max(0, uneven - ended)
    modulator.close()
    print(f"{shown} pictures of {info.width} x {info.height} in {MINUTES:g} minutes")
    print(f"{told} times one came more than half a refresh early or late, and the run ended with that error;")
    print(f"{unseen} times that was not told")
