"""The patch decoder on measurements of every kind, and on those that break decoders."""

import numba
import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, gap_tv
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.decode.patches.within_time import patch_decode

BRIEF = PatchSettings(iterations=8, first_sigma=0.1, last_sigma=0.03)


@pytest.mark.parametrize("kind", ["mono", "rgb", "mosaic", "grey"])
def test_views_come_closer_to_the_truth_than_gap_tv_brings_them(make_shot, kind):
    shot = make_shot(
        channels=3 if kind == "rgb" else 1, slide=0.4, cfa="RGGB" if kind == "mosaic" else None, grey=kind == "grey"
    )
    truth = shot.truth.views
    by_patches, by_tv = (np.mean(psnr_per_view(decode(shot), truth)) for decode in (patch_decode, gap_tv))
    assert by_patches > by_tv + 0.5


@pytest.mark.parametrize("views", [1, 2, 3, 5, 12])
def test_any_number_of_views_is_decoded(views):
    rng = np.random.default_rng(views)
    masks = (rng.random((views, 18, 20)) < 0.5).astype(np.float32)
    shot = Shot(rng.random((18, 20, 1)).astype(np.float32) * views / 2, masks, np.ones(views, np.float32)).check()
    decoded = patch_decode(shot, BRIEF)
    assert decoded.shape == (views, 18, 20, 1)
    assert np.isfinite(decoded).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (7, 2), (5, 40)])
@pytest.mark.parametrize("cfa", [None, "RGGB"])
def test_tiny_images_are_decoded(size, cfa):
    masks = np.ones((3, *size), np.float32)
    shot = Shot(np.full((*size, 1), 1.2, np.float32), masks, np.ones(3, np.float32), cfa=cfa).check()
    decoded = patch_decode(shot, BRIEF)
    assert decoded.shape == (3, *size, 3 if cfa else 1)
    # Without a green pixel beside it red is all that is known.
    np.testing.assert_allclose(decoded[..., :1], 0.4, atol=0.05)


@pytest.mark.parametrize("value", [0.0, 1.0, 1e3])
@pytest.mark.parametrize("spoil", [None, "closed pixels", "equal masks", "an empty mask"])
def test_hard_measurements_give_finite_views_in_range(value, spoil):
    masks = (np.random.default_rng(0).random((4, 20, 20)) < 0.5).astype(np.float32)
    if spoil == "closed pixels":
        masks[:, 5:9, 5:9] = 0
    elif spoil == "equal masks":
        masks[:] = masks[0]
    elif spoil == "an empty mask":
        masks[1] = 0
    decoded = patch_decode(Shot(np.full((20, 20, 1), value, np.float32), masks, np.ones(4, np.float32)).check(), BRIEF)
    assert np.isfinite(decoded).all()
    assert decoded.min() >= 0
    assert decoded.max() <= 1


def test_saturated_and_closed_pixels_cannot_spoil_the_views(make_shot):
    saturated = np.zeros((32, 40), bool)
    saturated[5:8, 5:8] = True
    clean = make_shot(saturated=saturated)
    masks, spoilt = clean.masks.copy(), clean.measurement.copy()
    masks[:, 20:22, 20:22] = 0
    spoilt[saturated] = 1e6
    spoilt[20:22, 20:22] = 1e6
    views = [
        patch_decode(type(clean)(y, masks, clean.weights, saturated=saturated).check(), BRIEF)
        for y in (clean.measurement, spoilt)
    ]
    assert np.array_equal(*views)


def test_the_result_is_the_same_for_any_number_of_threads(make_shot):
    shot, before, found = make_shot(channels=3), numba.get_num_threads(), []
    try:
        for threads in (1, min(2, before)):
            numba.set_num_threads(threads)
            found.append(patch_decode(shot, BRIEF))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(*found)


def test_progress_hears_of_the_start_and_of_every_step(make_shot):
    class Listener(Silent):
        def __init__(self):
            super().__init__()
            self.stages, self.steps = [], 0

        def stage(self, name, total=None):
            self.stages.append((name, total))

        def step(self, done, **figures):
            self.steps += 1

    listener = Listener()
    patch_decode(make_shot(), BRIEF, listener)
    assert listener.stages == [("decode", 8)]
    assert listener.steps == 8


def test_the_quick_schedule_is_a_shorter_one():
    quick, whole = PatchSettings.quick().check(), PatchSettings().check()
    assert quick.iterations * 3 <= whole.iterations


@pytest.mark.parametrize(
    "wrong",
    [{"iterations": 0}, {"refind_every": 0}, {"last_sigma": 0.0}, {"first_sigma": np.inf}, {"last_sigma": np.nan}],
)
def test_senseless_settings_are_refused(wrong):
    with pytest.raises(InputError, match=f"{next(iter(wrong))} = .* in PatchSettings"):
        PatchSettings(**wrong).check()


def test_a_noise_level_that_rises_is_refused():
    with pytest.raises(InputError, match=r"from sigma 0.01 to 0.02"):
        PatchSettings(first_sigma=0.01, last_sigma=0.02).check()


def test_a_senseless_beginning_is_refused(make_shot):
    with pytest.raises(InputError, match="iterations = 0 in GapTvSettings"):
        patch_decode(make_shot(), BRIEF, begins=GapTvSettings(iterations=0))
