"""Does a measurement tell right weights from wrong ones? What other weights gain on pixels that were not asked.

    python -m tests.benchmarks brightness

For scenes of the simulator's library, and the files of `GS2CI_SHARED_DATA` where that is set: by which share
brightness from one half of the pixels lowers the residual of the other half (`BrightnessSettings.least_gain` decides),
with weights that are right, off by 10 % and by 30 %.
"""

import os
from dataclasses import replace
from pathlib import Path

from gs2ci.core.progress import Silent
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.geometry.evidence import carried_views
from gs2ci.reconstruct.geometry.prior import Request, from_tracks
from gs2ci.reconstruct.measurement.brightness import LinearSystem
from gs2ci.reconstruct.measurement.jury import Jury
from gs2ci.reconstruct.settings import Settings
from gs2ci.tables.cases import Case
from gs2ci.tables.catalogue import TEXTURELESS, file_cases, simulated_cases

SIZE = (96, 128)
SEEDS = range(2)
OFF = (0.0, 0.1, 0.3)


def _gain(case: Case, seed: int) -> float:
    shot, settings = case.shot(seed), Settings()
    seen = Jury.of(shot, settings.fit.hold_out.share, seed).seen
    decoded = gap_tv(seen, settings.decode, Silent())
    geometry = from_tracks(Request.of(seen, decoded, settings.geometry, None), Silent())
    system = LinearSystem.of(seen, carried_views(decoded, geometry))
    return 0.0 if system is None else system.gain()


def run() -> None:
    shared = os.environ.get("GS2CI_SHARED_DATA")
    cases = [*simulated_cases(), Case(TEXTURELESS, scene=TEXTURELESS)]
    cases = [replace(case, size=SIZE) for case in cases] + [*(file_cases(Path(shared)) if shared else ())]
    print(f"{'':22} seed " + " ".join(f"{f'{off:.0%} off':>9}" for off in OFF))
    for case in cases:
        for seed in SEEDS:
            gains = (_gain(replace(case, weights_off=off), seed) for off in OFF)
            print(f"{case.name:22} {seed:4} " + " ".join(f"{each:9.4f}" for each in gains), flush=True)
