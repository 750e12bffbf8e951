"""A video output for minutes at 60 Hz: SDL on a real X display (Xvfb), and a witness process that reads its pixels.

`python -m tests.benchmarks video_out` needs Xvfb and the extra `video`; `VIDEO_OUT_S` sets the seconds (600),
`VIDEO_OUT_SIZE` the rows and columns (768x1024). Xvfb has no refresh of its own: the clock of `SdlScreen` stands for
it, so that this measures whether a computer keeps up, and no cable. Each picture carries its number; the witness, a
process of its own, reads the display's frame buffer every half millisecond and notes when which picture appears. What
it sees is held against what the driver says: a picture that was on show for another number of refreshes than one, or
never, must have been told, as a run that ended with that error.
"""

import mmap
import multiprocessing
import os
import shutil
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gs2ci.core.clock import WallClock
from gs2ci_drivers.failures import SequenceError
from gs2ci_drivers.links.sdl_screen import SdlScreen
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_drivers.video_out.driver import VideoOut
from gs2ci_drivers.video_out.options import VideoOutOptions

SIZE = tuple(int(side) for side in os.environ.get("VIDEO_OUT_SIZE", "768x1024").split("x"))
PICTURES = 64
BITS = 8
"""Pixels of the first row that carry a picture's number plus one, binary; dark pictures carry none."""
LOOK_S = 5e-4
BLINK = 0.5
"""Share of a refresh: where the witness itself was away for longer, it says nothing."""
LENGTHS = 1.5
"""A picture that stays for longer than this many refreshes was doubled."""


@dataclass
class Seen:
    """What the witness saw of one run.

    Args:
        times_ns: When each picture appeared.
        numbers: Which.
        away_ns: When it had last looked before.
    """

    times_ns: list[int] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    away_ns: list[int] = field(default_factory=list)


def run() -> None:
    """Show a new picture at each refresh; print how evenly they came, and what the driver said of it."""
    binary = shutil.which("Xvfb")
    if binary is None:
        print("no Xvfb on this machine")
        return
    seconds = float(os.environ.get("VIDEO_OUT_S", "600"))
    reading, writing = os.pipe()
    with tempfile.TemporaryDirectory() as folder, (Path(folder) / "log").open("wb") as log:
        screen = f"{SIZE[1]}x{SIZE[0]}x24"
        command = [binary, "-displayfd", str(writing), "-screen", "0", screen, "-fbdir", folder]
        server = subprocess.Popen(command, pass_fds=(writing,), stdout=log, stderr=log)
        os.close(writing)
        try:
            with os.fdopen(reading) as told:
                os.environ["DISPLAY"] = ":" + told.readline().strip()
            os.environ["SDL_VIDEODRIVER"] = "x11"
            _measure(Path(folder) / "Xvfb_screen0", seconds)
        finally:
            server.terminate()
            server.wait()


def _measure(pixels: Path, seconds: float) -> None:
    modulator = VideoOut("slm", SdlScreen("slm"), WallClock(), VideoOutOptions(kind="video", port="last"))
    info = modulator.connect()
    period_s = info.exposure_step_s
    masks = _numbered(np.random.default_rng(0), info.height, info.width)
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    witness = context.Process(target=_witness, args=(str(pixels), there), daemon=True)
    witness.start()
    assert here.recv() == "ready"
    shown = told = unseen = blinks = runs = 0
    widest = 0.0
    began_s = time.monotonic()
    while (left_s := began_s + seconds - time.monotonic()) > 1.0:
        repeats = max(1, round(left_s / (PICTURES * period_s)))
        modulator.upload(PatternSequence(masks, 1, period_s, repeats=repeats, trigger=TriggerOut.NONE))
        modulator.arm()
        time.sleep(0.1)
        here.send("look")
        modulator.start()
        ended = 0
        try:
            modulator.wait_done(2 * seconds + 10)
        except SequenceError:
            ended = 1
        time.sleep(0.1)
        here.send("tell")
        seen = here.recv()
        found = _judged(seen, period_s)
        runs, shown, told, blinks = runs + 1, shown + len(seen.numbers), told + ended, blinks + found.blinks
        unseen += max(0, found.odd - ended)
        widest = max(widest, found.widest)
    here.send("end")
    witness.join()
    modulator.close()
    print(f"{shown} pictures of {info.width} x {info.height} seen in {seconds:g} s, in {runs} runs")
    print(f"{told} runs ended with the error that a picture was doubled or dropped;")
    print(f"{unseen} pictures were seen to be doubled or dropped and not told;")
    print(f"the furthest that a picture's time on show was off without being either: {widest:.2f} refreshes;")
    print(f"{blinks} pictures came while the witness itself was away for more than half a refresh")


def _numbered(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Return masks whose first row begins with their number plus one, [PICTURES, H, W]."""
    masks = (rng.random((PICTURES, height, width)) < 0.5).astype(np.uint8)
    numbers = np.arange(1, PICTURES + 1)
    masks[:, 0, :BITS] = (numbers[:, None] >> np.arange(BITS)) & 1
    return masks


def _witness(pixels: str, pipe: object) -> None:
    """Look at the display's pixels whenever told to, in a process of its own."""
    with open(pixels, "rb") as file, mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ) as raw:
        head = np.frombuffer(raw, ">u4", 25)
        begin = int(head[0]) + 12 * int(head[19])
        del head
        pipe.send("ready")
        while pipe.recv() == "look":
            seen, last, looked_ns = Seen(), 0, time.monotonic_ns()
            while not pipe.poll():
                first_row = raw[begin : begin + 4 * BITS : 4]
                number = sum((level > 127) << bit for bit, level in enumerate(first_row))
                now_ns = time.monotonic_ns()
                if number not in (last, 0):
                    seen.times_ns.append(now_ns)
                    seen.numbers.append(number - 1)
                    seen.away_ns.append(looked_ns)
                last, looked_ns = number, now_ns
                time.sleep(LOOK_S)
            pipe.recv()
            pipe.send(seen)


@dataclass
class _Verdict:
    odd: int
    blinks: int
    widest: float


def _judged(seen: Seen, period_s: float) -> _Verdict:
    """Count pictures that were on show for another number of refreshes than one, or never, where it was looked at."""
    times, numbers = np.asarray(seen.times_ns), np.asarray(seen.numbers)
    if len(times) < 2:
        return _Verdict(0, 0, 0.0)
    away = (times - np.asarray(seen.away_ns)) * 1e-9 > BLINK * period_s
    apart = np.diff(times) * 1e-9 / period_s
    steps = np.diff(numbers) % PICTURES
    looked = ~(away[1:] | away[:-1])
    odd = looked & ((steps != 1) | (apart > LENGTHS))
    even = looked & ~odd
    widest = float(np.abs(apart[even] - 1).max()) if even.any() else 0.0
    return _Verdict(int(odd.sum()), int(away.sum()), widest)
