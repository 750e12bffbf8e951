"""A scene fitted from real photographs, seen as it was when the shared views were rendered from it."""

import numpy as np

from gs2ci_sims.radiance import Renderer
from gs2ci_sims.scenes.ply import scene_from_ply


def test_the_fern_file_shows_the_views_that_were_rendered_from_it(shared_data):
    known = np.load(shared_data / "fern_smooth.npz")
    poses = known["world_to_camera"]
    scene = scene_from_ply(
        shared_data / "fern.ply", known["truth"].shape[1:3], intrinsics=known["K"], world_to_camera=poses[4]
    )
    views, _ = Renderer(supersampling=1).views(scene, poses)
    error = views - known["truth"] / 255.0
    assert -10 * np.log10(np.mean(error**2)) > 40
    assert np.mean(np.isfinite(scene.depth)) > 0.9
