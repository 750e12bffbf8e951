"""Is a camera at rest, or one that only rotates, mistaken for a moving one? The paths by two halves of its tracks.

    python -m tests.benchmarks no_motion

For scenes, sizes, numbers of views and light: the verdict on the first geometry, and the difference of the paths by two
halves of the tracks if a motion were assumed (`Criteria.agreement`), as a share of the path's extent. With
`GS2CI_WHOLE=1` the smaller measurements of eight views are reconstructed instead: the verdict of each report, and
whether the path was sought, found and taken in the views of a fit (`path_found_in_fit`).
"""

import os
from collections import Counter
from dataclasses import replace
from itertools import product

import numpy as np

from gs2ci.core.findings import Code
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.geometry.path.validity import Criteria
from gs2ci.reconstruct.geometry.prior import Request, from_tracks
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from tests.processes import side_by_side
from tests.stability.benches import Bench, still, turning

SCENES = ("boxes", "thicket", "motorcycle", "ball")
SIZES = ((96, 128), (192, 256))
PATHS = {"at rest": still, **{f"turns by {degrees:g}°": turning(degrees) for degrees in (0.5, 3, 10)}}
VIEWS = (8, 16)
PHOTONS = (None, 400)
SEED = 0
WHOLE = os.environ.get("GS2CI_WHOLE") == "1"


def run() -> None:
    if WHOLE:
        _whole()
    else:
        _first()


def _whole() -> None:
    cases = list(product(SCENES, PATHS, PHOTONS))
    outcomes = []
    for line, outcome in side_by_side(_reconstructed, cases):
        print(line, flush=True)
        outcomes.append(outcome)
    print(", ".join(f"{outcome}: {count}" for outcome, count in sorted(Counter(outcomes).items())) + "\n")


def _reconstructed(case: tuple[str, str, float | None]) -> tuple[str, str]:
    """Reconstruct one measurement; return its line and what is counted."""
    scene, path, photons = case
    result = reconstruct(Bench(scene=scene, path=PATHS[path], views=VIEWS[0], photons=photons).expose(SIZES[0])).result
    codes = {note.code for note in result.notes}
    outcome = "found in a fit" if Code.PATH_FOUND_IN_FIT in codes else str(result.geometry.verdict)
    tried = ", another attempt was made" if Code.ATTEMPTS_RANKED in codes else ""
    return f"{scene}{'' if photons is None else ', dim'}, {path}: {outcome}{tried}", outcome


def _first() -> None:
    settings, found = Settings(), []
    moved = replace(settings.geometry, criteria=Criteria(parallax_px=0.0, unexplained=0.0))
    for scene, size, (path, camera), views, photons in product(SCENES, SIZES, PATHS.items(), VIEWS, PHOTONS):
        shot = Bench(scene=scene, path=camera, views=views, photons=photons).expose(size)
        holdout = Holdout.of(shot, settings.fit.hold_out.share, SEED)
        request = Request.of(holdout.seen, gap_tv(holdout.seen, settings.decode, Silent()), settings.geometry, None)
        verdict = from_tracks(request, Silent()).verdict
        error = from_tracks(replace(request, settings=moved), Silent()).path_error_expected
        light = "" if photons is None else ", dim"
        what = f"{scene} {size[1]} x {size[0]}, {views} views{light}, {path}"
        print(f"{what:54} {verdict:14} {'' if error is None else f'{error:.3f}'}", flush=True)
        if error is not None:
            found.append((verdict == "full", error))
    wrong, errors = np.array(found).T
    print(
        f"{len(found)} paths: halves disagree by {errors.min():.2f} to {errors.max():.2f} of the path (5 % quantile "
        f"{np.quantile(errors, 0.05):.2f}); {int(wrong.sum())} were taken for a motion\n"
    )
