"""What a number of seconds buys: views within a time budget, polished and not, beside the presets without a budget.

    python -m tests.benchmarks budgets
    GS2CI_BUDGETS=20,60 GS2CI_CASES=boxes python -m tests.benchmarks budgets    these seconds, these cases alone

Data: scenes of the project's simulator, 120 × 160 px, eight views; and, where `GS2CI_SHARED_DATA`, or `../shared/data`
beside the checkout, holds them, a rendered scene of the original code (264 × 353 px) and the middle of a path-traced
light field, 192 × 192 px. Seconds are wall-clock seconds of the reconstruction alone, from its first line to its last;
a budget also counts starting, the report and closing, which are not part of this. They depend on the machine.
"""

import os
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gs2ci.core.crop import middle
from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code
from gs2ci.core.records import Shot
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.presets.budget import Budget
from gs2ci.reconstruct.presets.named import PRESETS
from gs2ci.reconstruct.settings import Settings
from tests.benchmarks.decoders import data_folder
from tests.stability.benches import Bench
from tests.tables.cases import Case

SCENES = ("boxes", "planes", "thicket")
SIZE = (120, 160)
SECONDS = (15.0, 30.0, 60.0, 120.0)


def cases() -> dict[str, Callable[[], Shot]]:
    """Name every case, and say how its shot is made."""
    made: dict[str, Callable[[], Shot]] = {
        scene: lambda scene=scene: Bench(scene).expose(SIZE)  # type: ignore[misc]
        for scene in SCENES
    }
    field, rendered = data_folder() / "lightfield" / "antinous.npz", data_folder() / "fern_smooth.npz"
    if field.is_file():
        made["antinous"] = lambda: middle(Case("antinous", file=str(field)).shot(0), (192, 192))
    if rendered.is_file():
        made["fern_smooth"] = lambda: Case("fern_smooth", file=str(rendered)).shot(0)
    return made


def run() -> None:
    """Print the table."""
    seconds = [float(one) for one in os.environ.get("GS2CI_BUDGETS", "").split(",") if one] or SECONDS
    only = [name for name in os.environ.get("GS2CI_CASES", "").split(",") if name]
    print(f"{'case':12s} {'within':>12s}  PSNR, dB  iterations  polished  took, s")
    for name, make in cases().items():
        if only and not any(part in name for part in only):
            continue
        shot = make()
        for preset in ("draft", "standard"):
            _measure(name, preset, shot, PRESETS[preset], None)
        for one in seconds:
            for settings in (replace(Settings(), polish=None), Settings()):
                _measure(name, f"{one:g} s", shot, settings, one)


def _measure(name: str, within: str, shot: Shot, settings: Settings, seconds: float | None) -> None:
    truth = shot.truth.views
    assert truth is not None
    began_s = time.monotonic()
    budget = None if seconds is None else Budget(seconds, began_s)
    try:
        result = reconstruct(shot, settings, budget=budget).result
    except InputError as error:
        print(f"{name:12s} {within:>12s}  {error.allowed}", flush=True)
        return
    took_s = time.monotonic() - began_s
    shares = [note.figures["share"] for note in result.notes if note.code is Code.VIEWS_OF_PATCHES]
    psnr_db = float(np.mean(psnr_per_view(result.views, truth)))
    print(
        f"{name:12s} {within:>12s}  {psnr_db:8.2f}  {result.curve[-1].iteration:10d}  "
        f"{shares[0] if shares else 0:8.0%}  {took_s:7.1f}",
        flush=True,
    )


if __name__ == "__main__":
    run()
