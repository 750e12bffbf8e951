"""Digests of a reconstruction's results: run in two checkouts, they show whether a change altered any bit.

    GS2CI_SHARED_DATA=FOLDER python -m tests.benchmarks digests

On crops of 96 × 112 px of the shared measurements, or, without that folder, of photographs on planes. Digests differ
between processors (docs/processors.md).
"""

import hashlib

import numpy as np

from gs2ci.core.crop import middle
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.records import Shot
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.presets.named import PRESETS
from tests.benchmarks.first_table import FOLDER
from tests.benchmarks.photographs import expose

SIZE = (96, 112)
NAMES = ("fern_smooth", "fern_smooth_r50", "fern_photos_wide")


def _shots() -> list[Shot]:
    if not FOLDER.is_dir():
        return [expose(which, seed=which, size=SIZE)[0] for which in range(3)]
    return [middle(import_shots(FOLDER / f"{name}.npz", None, ImportOptions()).shots[0], SIZE) for name in NAMES]


def run() -> None:
    """Reconstruct each by the preset draft and print the digests."""
    for shot in _shots():
        result = reconstruct(shot, PRESETS["draft"]).result
        for part in ("decode", "scene_views", "views", "world_to_camera"):
            digest = hashlib.sha256(np.ascontiguousarray(getattr(result, part)).tobytes()).hexdigest()
            print(f"{shot.name:30} {part:16} {digest[:16]}", flush=True)
