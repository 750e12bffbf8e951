"""Whole shots on a GPU: the parts of `gpu` that reconstruct. Not here: the parts that measure pieces (`gpu_parts`)."""

import subprocess
import sys
import threading
import time
from dataclasses import replace
from functools import cache

import numpy as np

from gs2ci.core.progress import Silent
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct import pipeline
from gs2ci.reconstruct.presets.named import preset
from gs2ci.reconstruct.settings import Settings
from gs2ci_sims.effects.motion_blur import MotionBlur
from tests.benchmarks.gpu_parts import Asked, beside_asked
from tests.stability.benches import Bench

# Less than twice what the part may take: what it began would go on without it.
_TWO_CORES_S = 200.0


def standard(asked: Asked) -> None:
    """A whole standard of 264 × 353 px by stage, on the device and on two of this machine's cores."""
    shot = ("draft", (24, 32)) if asked.small else ("standard", (264, 353))
    there_s = whole(f"warp:{asked.place}", *shot)
    beside_asked("a standard, 264 × 353 × 8", f"{there_s:.1f} s", "6 s")
    here_s = _on_two_cores(*shot)
    beside_asked("the same beside two cores", f"{here_s / there_s:.1f} times as fast", "10 times")


def large_draft(asked: Asked) -> None:
    """A draft of 1920 × 1080 px and 16 views, on the device alone."""
    size, views = ((24, 32), 4) if asked.small else ((1080, 1920), 16)
    beside_asked("a draft, 1920 × 1080 × 16", f"{whole(f'warp:{asked.place}', 'draft', size, views):.1f} s", "20 s")


def exponent(asked: Asked) -> None:
    """Seconds of whole drafts from 256² to 2048² px, and the exponent of their growth in pixels."""
    took: dict[int, float] = {}
    for side in (16, 24) if asked.small else (256, 512, 1024, 2048):
        took[side] = whole(f"warp:{asked.place}", "draft", (side, side))
        if len(took) > 1:
            slope = float(np.polyfit(np.log(np.square(list(took))), np.log(list(took.values())), 1)[0])
            beside_asked(f"the exponent in pixels, {min(took)}² to {side}²", f"{slope:.2f}", "0.6")


class _Told(Silent):
    """Prints each stage when it begins: what is ended before its end tells where it was."""

    def __init__(self) -> None:
        super().__init__()
        self._began = time.perf_counter()

    def stage(self, name: str, total: int | None = None) -> None:
        print(f"  at {time.perf_counter() - self._began:.1f} s: {name}", flush=True)


def whole(backend: str, name: str, size: tuple[int, int], views: int = 8) -> float:
    """Reconstruct an exposure by a preset, and return its seconds; a small one before loads what all need."""
    settings = replace(preset(name), backend=backend)
    _load(settings)
    # One view behind each mask: integrals over time would take longer to simulate than a card to reconstruct.
    began = time.perf_counter()
    shot = Bench("motorcycle", views=views, effects=(MotionBlur(nodes=1),)).expose(size)
    print(f"  exposed in {time.perf_counter() - began:.1f} s, not counted", flush=True)
    began = time.perf_counter()
    found = pipeline.reconstruct(shot, settings, _Told()).result
    took = time.perf_counter() - began
    psnr_db = float(np.mean(psnr_per_view(found.views, shot.truth.views)))
    stages = ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in found.seconds.items())
    print(f"{name}, {size[0]} × {size[1]} × {views}, {backend}: {took:.1f} s ({stages}), {psnr_db:.2f} dB", flush=True)
    return took


@cache
def _load(settings: Settings) -> None:
    """Reconstruct something small, once."""
    brief = replace(settings, fit=replace(settings.fit, iterations=8))
    pipeline.reconstruct(Bench("motorcycle", views=4).expose((24, 32)), brief)


def _on_two_cores(name: str, size: tuple[int, int]) -> float:
    """Do the same by the CPU's renderer in a process that may use two cores."""
    program = (
        "import os; os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2]); "
        f"from tests.benchmarks.gpu_whole import whole; print(whole('cpu', {name!r}, {size}))"
    )
    command = [sys.executable, "-u", "-c", program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        ends = threading.Timer(_TWO_CORES_S, process.kill)
        ends.start()
        line = ""
        assert process.stdout is not None
        for line in process.stdout:  # what it prints is seen as it goes
            print(line, end="", flush=True)
        ends.cancel()
    if process.returncode:
        raise RuntimeError(f"not done on two cores within {_TWO_CORES_S:.0f} s, or ended: {process.returncode}")
    return float(line)
