import dataclasses

import numpy as np

from gs2ci_sims.moments import Moments, one_per_interval
from gs2ci_sims.path import ReversingMove, StageMove
from gs2ci_sims.signals import Shutter, nominal_slices
from gs2ci_sims.spectrum import SECTORS
from gs2ci_sims.waves import FREQUENCIES, CollectedWaves

INTERVAL_S = 0.1
INTERVALS = np.arange(4)[:, None] * INTERVAL_S + np.array([-0.2, -0.1])


def _move(scene, px_per_interval):
    """Across the image, so fast for its nearest points."""
    near, _ = scene.depth_range()
    return StageMove((px_per_interval / INTERVAL_S * near / scene.intrinsics[0, 0], 0.0, 0.0))


def test_one_view_per_mask_misses_what_linear_motion_takes_of_a_cosine(small_scene):
    waves = CollectedWaves(small_scene, _move(small_scene, 0.8), nominal_slices(INTERVALS))
    missed = waves.missed(one_per_interval(INTERVALS), INTERVAL_S)
    # Boreman, Modulation Transfer Function in Optical Systems, section 2.2: sinc(f d) of the amplitude is left.
    expected = np.maximum.accumulate(1 - np.sinc(FREQUENCIES * 0.8))
    np.testing.assert_allclose(missed[..., 0], np.tile(expected, (4, 1)), atol=4e-4)
    # Across the motion nothing turns; the last sector begins a quarter of the way before.
    steep = np.cos(np.pi / 2 * (SECTORS - 1) / SECTORS)
    across = np.maximum.accumulate(1 - np.sinc(FREQUENCIES * 0.8 * steep))
    np.testing.assert_allclose(missed[..., -1], np.tile(across, (4, 1)), atol=4e-4)


def test_a_camera_at_rest_misses_nothing(small_scene):
    waves = CollectedWaves(small_scene, StageMove((0.0, 0.0, 0.0)), nominal_slices(INTERVALS))
    assert waves.missed(Moments(INTERVALS[[0, -1], [0, 1]], 1), INTERVAL_S).max() < 1e-12


def test_objects_that_move_by_themselves_turn_cosines_too(small_scene):
    at_rest = StageMove((0.0, 0.0, 0.0))
    waves = CollectedWaves(small_scene, at_rest, nominal_slices(INTERVALS), object_px_per_s=0.8 / INTERVAL_S)
    missed = waves.missed(one_per_interval(INTERVALS), INTERVAL_S)
    np.testing.assert_allclose(missed[1, :, 0], np.maximum.accumulate(1 - np.sinc(FREQUENCIES * 0.8)), atol=4e-4)


def test_more_views_in_the_same_panels_miss_less_and_in_the_end_nothing(small_scene):
    waves = CollectedWaves(small_scene, _move(small_scene, 0.5), nominal_slices(INTERVALS))
    edges = np.unique(INTERVALS)
    missed = [waves.missed(Moments(edges, nodes), INTERVAL_S).max() for nodes in (1, 2, 4, 8)]
    assert missed == sorted(missed, reverse=True)
    assert missed[0] > 0.1
    assert missed[-1] < 1e-3


def test_light_that_is_cut_unevenly_needs_the_image_at_every_moment(small_scene):
    """With two views per mask an even light is right to the fourth order of motion, half of a mask is not."""
    even = nominal_slices(INTERVALS)
    half = dataclasses.replace(even, stop_s=even.start_s + 0.5 * INTERVAL_S)
    moments = Moments(np.unique(INTERVALS), 2)
    missed = [
        CollectedWaves(small_scene, _move(small_scene, 0.2), light).missed(moments, INTERVAL_S)[:, 6, 0].max()
        for light in (even, half)
    ]
    assert missed[1] > 4 * missed[0]


def test_rows_that_are_exposed_at_other_times_count_as_their_worst(small_scene):
    move = _move(small_scene, 0.4)
    whole = (INTERVALS[0, 0], INTERVALS[-1, 1])
    moments = Moments(np.unique(INTERVALS), 2)
    late = dataclasses.replace(nominal_slices(INTERVALS).split(8), shutter=Shutter(*whole, 0.2 / small_scene.size[0]))
    rolling, together = (
        CollectedWaves(small_scene, move, light).missed(moments, INTERVAL_S)
        for light in (late, nominal_slices(INTERVALS))
    )
    # Row 0 is exposed as without a shutter.
    assert (rolling >= together - 1e-12).all()
    assert (rolling > together + 1e-5).any()


def test_a_turn_of_the_stage_is_no_error_of_what_counts_as_exact(small_scene):
    """Panels that end where the stage turns need few views, and what they are held against turns there too."""
    near, _ = small_scene.depth_range()
    turning = ReversingMove((5.0 * near / small_scene.intrinsics[0, 0], 0.0, 0.0), 0.27)
    waves = CollectedWaves(small_scene, turning, nominal_slices(INTERVALS))
    edges = np.unique(np.concatenate([INTERVALS.ravel(), turning.kinks_s(-0.2, 0.2)]))
    assert waves.missed(Moments(edges, 8), INTERVAL_S)[:, :12].max() < 1e-4
