import numpy as np

from gs2ci.reconstruct.geometry.tracks.brightened import brightened


def test_only_views_of_a_dark_scene_are_brightened_and_all_alike(seen):
    views = seen().views
    assert brightened(views) is views
    for light in (1e-7, 0.0, np.nan):
        black = np.full((2, 8, 8, 1), light, np.float32)
        assert brightened(black) is black
    dark = views / np.float32(64)
    dark[0] /= 2
    ratio = brightened(dark)[dark > 0] / dark[dark > 0]
    assert ratio.min() == ratio.max() > 16
    assert np.percentile(brightened(dark), 99) <= 1
