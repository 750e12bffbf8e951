"""Can a measurement distinguish right weights from wrong ones? The gain of other weights on held-out pixels.

    python -m tests.benchmarks brightness
    GS2CI_CASES=runner python -m tests.benchmarks brightness    cases whose names contain that word

For scenes of the simulator's library, and the files of `GS2CI_SHARED_DATA` if that is set: the share by which a
brightness estimated from one half of the pixels lowers the residual of the other half, and the largest difference of a
view's brightness from its weight, in standard errors over blocks. `BrightnessSettings.least_gain` and `least_errors`
decide. The weights are right, off by 10 % and by 30 %; for files with true views, also with views that were brightened
evenly from 0.95 to 1.05 before coding ("drift"), and with the clips of `video_sci`, which contain moving objects.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from gs2ci.core.crop import middle
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.geometry.evidence import carried_views
from gs2ci.reconstruct.geometry.prior import Request, from_tracks
from gs2ci.reconstruct.measurement.brightness import BrightnessEstimate, estimate
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.settings import Settings
from tests.tables.case_sets import TEXTURELESS, file_cases, simulated_cases
from tests.tables.cases import Case

SIZE = (96, 128)
FILE_SIZE = (176, 176)
SEEDS = range(2)
OFF = (0.0, 0.1, 0.3)


def drifting(shot: Shot, light: np.ndarray) -> Shot:
    """Code the true views of a shot, each brightened by its share of `light`, [N], under its own masks."""
    truth = shot.truth.views
    assert truth is not None
    views = (truth * light[:, None, None, None]).astype(np.float32)
    even = replace(shot, weights=np.ones(shot.views, np.float32), truth=replace(shot.truth, views=views))
    return replace(even, measurement=Coding.of(even).forward(torch.from_numpy(views)).numpy())


def estimated(shot: Shot, seed: int) -> BrightnessEstimate | None:
    """Return what the first look at a shot says of its views' brightness."""
    settings = Settings()
    holdout = Holdout.of(shot, settings.fit.hold_out.share, seed)
    decoded = gap_tv(holdout.seen, settings.decode, Silent())
    geometry = from_tracks(Request.of(holdout.seen, decoded, settings.geometry, None), Silent())
    return estimate(holdout, carried_views(decoded, geometry))


def _shots(shared: str | None) -> Iterator[tuple[str, int, Callable[[], Shot]]]:
    cases = [*simulated_cases(), Case(TEXTURELESS, scene=TEXTURELESS)]
    cases = [replace(case, size=SIZE) for case in cases]
    cases += [replace(case, size=FILE_SIZE) for case in (file_cases(Path(shared)) if shared else ())]
    for case in cases:
        for seed in SEEDS if case.scene else (0,):
            for off in OFF:
                yield f"{case.name}, {off:.0%} off", seed, partial(replace(case, weights_off=off).shot, seed)
        if case.file:
            yield f"{case.name}, drift", 0, partial(_drifting_case, case)
    for path in sorted((Path(shared) / "video_sci").glob("*.mat")) if shared else ():
        for number, shot in enumerate(import_shots(path, None, ImportOptions()).shots):
            yield f"{path.stem} {number}", 0, partial(middle, shot, FILE_SIZE)


def _drifting_case(case: Case) -> Shot:
    shot = case.shot(0)
    return drifting(shot, np.linspace(0.95, 1.05, shot.views))


def run() -> None:
    least, wanted = Settings().brightness, os.environ.get("GS2CI_CASES", "")
    print(f"{'':34} seed {'gain':>7} {'errors':>7} accepted")
    for name, seed, shot in _shots(os.environ.get("GS2CI_SHARED_DATA")):
        if wanted not in name:
            continue
        told = estimated(shot(), seed)
        said = "no estimate" if told is None else f"{told.gain:7.4f} {told.errors_away:7.1f} {told.is_sure(least)}"
        print(f"{name:34} {seed:4} {said}", flush=True)
