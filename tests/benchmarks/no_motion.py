"""Is a camera at rest, or one that only rotates, mistaken for a moving one? The paths by two halves of its tracks.

    python -m tests.benchmarks no_motion

For scenes, sizes, numbers of views and light: the verdict on the first geometry, and the difference of the paths by two
halves of the tracks if a motion were assumed (`Criteria.agreement`), as a share of the path's extent.
"""

from dataclasses import replace
from itertools import product

import numpy as np

from gs2ci.core.progress import Silent
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.geometry.prior import Request, from_tracks
from gs2ci.reconstruct.geometry.validity import Criteria
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.settings import Settings
from tests.stability.benches import Bench, still, turning

SCENES = ("boxes", "thicket", "motorcycle", "ball")
SIZES = ((96, 128), (192, 256))
PATHS = {"at rest": still, **{f"turns by {degrees:g}°": turning(degrees) for degrees in (0.5, 3, 10)}}
VIEWS = (8, 16)
PHOTONS = (None, 400)
SEED = 0


def run() -> None:
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
