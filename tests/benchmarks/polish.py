"""Gain and cost of a sparse polish by similar patches on the delivered views.

    python -m tests.benchmarks polish
    GS2CI_POLISH_ONLY=planes,runner python -m tests.benchmarks polish    these alone

Each case is reconstructed once; its views are delivered with and without the polish. Data: scenes of the project's
simulator at rest, 72 × 96 px, one of them with noise; photographs moved by resampling (`nonrigid`), 96 × 96 px; and,
where `GS2CI_SHARED_DATA`, or `../shared/data` beside the checkout, holds them, the middle 96 px of video clips and the
middle of a path-traced light field. Seconds are those of a processor, of handing over and of the whole run.
"""

import os
import time
from collections.abc import Callable
from dataclasses import replace
from unittest import mock

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.crop import middle
from gs2ci.core.findings import Code
from gs2ci.core.records import Shot
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct import pipeline
from gs2ci.reconstruct.fusion import Recovered, hand_over
from gs2ci.reconstruct.settings import Settings
from tests.benchmarks.decoders import data_folder
from tests.benchmarks.moving import clips
from tests.benchmarks.nonrigid import exposed, videos
from tests.stability.benches import Bench
from tests.stability.changes import noisy
from tests.tables.cases import Case

SCENES = ("boxes", "planes", "thicket", "motorcycle", "corridor")
MOVED = ("crossing", "deformation")
SIZE, SIDE = (72, 96), 96


def cases() -> dict[str, Callable[[], Shot]]:
    """Name every case, and say how its shot is made."""
    made: dict[str, Callable[[], Shot]] = {
        f"{scene}, at rest": lambda scene=scene: Bench(scene).expose(SIZE)  # type: ignore[misc]
        for scene in SCENES
    }
    made["boxes, 5 % noise"] = lambda: noisy(0.05)(Bench("boxes").expose(SIZE))
    made |= {name: lambda name=name: exposed(videos(SIDE)[name]) for name in MOVED}  # type: ignore[misc]
    made |= {name: lambda shot=shot: shot for name, shot in clips(SIDE, ["drop40", "runner40", "traffic48"])}  # type: ignore[misc]
    field = data_folder() / "lightfield" / "antinous.npz"
    if field.is_file():
        made["antinous, at rest"] = lambda: middle(Case("antinous", file=str(field)).shot(0), (96, 128))
    return made


def run() -> None:
    """Print the table."""
    only = [name for name in os.environ.get("GS2CI_POLISH_ONLY", "").split(",") if name]
    print(f"{'case':20s} without  with    gain   share   handing over    whole run")
    for name, make in cases().items():
        if not only or any(part in name for part in only):
            _measure(name, make())


def _measure(name: str, shot: Shot) -> None:
    truth, handed = shot.truth.views, {}
    assert truth is not None

    def both(first: object, ensemble: object, refine: object, settings: Settings, polishing: object) -> Recovered:
        for key, one in (("without", replace(settings, polish=None)), ("with", settings)):
            began_s = time.process_time()
            given = hand_over(first, ensemble, refine, one, polishing)  # type: ignore[arg-type]
            handed[key] = given, time.process_time() - began_s
        return given

    began_s = time.process_time()
    with mock.patch.object(pipeline, "hand_over", both):
        pipeline.reconstruct(shot, Settings())
    whole_s = time.process_time() - began_s - handed["without"][1]
    without, polished = (_psnr(handed[key][0].views, truth) for key in ("without", "with"))
    shares = [note.figures["share"] for note in handed["with"][0].notes if note.code is Code.VIEWS_OF_PATCHES]
    print(
        f"{name:20s} {without:6.2f}  {polished:6.2f}  {polished - without:+.2f}  {shares[0] if shares else 0:6.0%}  "
        f"{handed['without'][1]:4.1f} and {handed['with'][1]:4.1f} s  {whole_s:6.1f} s",
        flush=True,
    )


def _psnr(views: F32, truth: F32) -> float:
    return float(np.mean(psnr_per_view(views, truth)))


if __name__ == "__main__":
    run()
