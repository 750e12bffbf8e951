import numpy as np
import pytest
from skimage import data

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.by_name import decode_by_name, patch_settings
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, gap_tv
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.decode.patches.within_time import patch_decode
from gs2ci.reconstruct.settings import Settings

BRIEF = GapTvSettings(iterations=10)


def test_each_name_is_its_decoder(make_shot):
    shot = make_shot(slide=0.4)
    np.testing.assert_array_equal(decode_by_name(shot, "gap-tv", BRIEF), gap_tv(shot, BRIEF))
    quick = PatchSettings.quick()
    by_quick = patch_decode(shot, quick, begins=BRIEF)
    np.testing.assert_array_equal(decode_by_name(shot, "patches-quick", BRIEF), by_quick)
    assert [patch_settings(name) for name in ("gap-tv", "patches-quick", "patches")] == [None, quick, PatchSettings()]


def test_patches_are_better_on_a_sliding_photograph():
    rng = np.random.default_rng(0)
    photograph = (data.camera()[100:, 180:] / 255).astype(np.float32)
    views = np.stack([photograph[2 * i : 2 * i + 56, 3 * i : 3 * i + 56, None] for i in range(6)])
    masks = (rng.random((6, 56, 56)) < 0.5).astype(np.float32)
    shot = Shot((masks[..., None] * views).sum(0), masks, np.ones(6, np.float32)).check()
    by_tv, quick = (
        np.mean(psnr_per_view(decode_by_name(shot, name, GapTvSettings()), views))
        for name in ("gap-tv", "patches-quick")
    )
    assert quick > by_tv + 1


def test_an_unknown_name_is_refused():
    with pytest.raises(InputError, match="first_look = 'best' in Settings"):
        Settings(first_look="best").check()
