"""Moments within masks: against motions that are known in closed form, and against the renderer without them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code
from gs2ci.reconstruct.fit.coarse.stopping import Watch
from gs2ci.reconstruct.fit.scene.mask_moments import MaskMoments, MaskMomentSettings, bounds, mask_times, needed
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.render.cpu.backend import CpuBackend
from tests.reconstruct.fit.plane_fits import QUICK, run
from tests.render import se3

MASKS = 4


def moments_of(*moments, share=1.0):
    return MaskMoments(moments, (share,) * len(moments))


def accelerated(times):
    """Poses of a camera that turns while it goes ever faster about one axis of motion, [T, 4, 4]."""
    twist = torch.tensor([0.3, -0.1, 0.05, 0.02, 0.04, -0.01], dtype=torch.float64)
    along = times + 0.2 * times**2
    return se3.exp(along[:, None] * twist)


@pytest.mark.parametrize("share", [1.0, 0.6])
def test_steady_and_evenly_accelerated_motion_is_met_exactly(share):
    middles = torch.arange(MASKS, dtype=torch.float64)
    mask_moments = moments_of(3, 1, 4, 2, share=share)
    found = torch.from_numpy(mask_moments.along(accelerated(middles)).exact)
    when = middles[mask_moments.of_mask] + mask_moments.offsets
    torch.testing.assert_close(found, accelerated(when), atol=1e-9, rtol=0)


def test_moments_are_the_middles_of_equal_parts_of_the_time_on_show():
    offsets = moments_of(2, 1, 4, share=0.8).offsets
    torch.testing.assert_close(offsets, torch.tensor([-0.2, 0.2, 0.0, -0.3, -0.1, 0.1, 0.3], dtype=torch.float64))
    times = moments_of(2, 1, 4, share=0.8).times
    assert times.tolist() == pytest.approx([-1.2, -0.8, 0.0, 0.7, 0.9, 1.1, 1.3])


def test_two_masks_go_on_steadily():
    poses = accelerated(torch.tensor([0.0, 1.0], dtype=torch.float64))
    step = se3.log(poses[1:] @ torch.linalg.inv(poses[:1]))
    found = torch.from_numpy(moments_of(2, 2).along(poses).exact)
    torch.testing.assert_close(found[0], (se3.exp(-0.25 * step) @ poses[:1])[0])
    torch.testing.assert_close(found[3], (se3.exp(0.25 * step) @ poses[1:])[0])


@pytest.fixture
def rendered(moving_plane, scattered):
    shot, geometry = moving_plane

    def make(mask_moments, given=shot):
        return ShotRenderer(given, geometry.intrinsics, CpuBackend(), None, mask_moments)

    return make, scattered(200), torch.from_numpy(geometry.world_to_camera).float(), shot


def test_one_moment_of_each_mask_gives_the_same_bits(rendered):
    make, scene, poses, shot = rendered
    plain, with_moments = make(None), make(moments_of(*[1] * shot.views))
    assert with_moments.moments_per_mask == 1
    np.testing.assert_array_equal(with_moments.measurement(scene, poses), plain.measurement(scene, poses))
    np.testing.assert_array_equal(with_moments.exposed(scene, poses), plain.views(scene, poses))
    np.testing.assert_array_equal(plain.exposed(scene, poses), plain.views(scene, poses))


@pytest.mark.parametrize("mono", [False, True])
def test_what_the_masks_saw_codes_to_the_measurement_and_keeps_its_light(rendered, mono):
    make, scene, poses, shot = rendered
    shot = replace(shot, measurement=shot.measurement[..., :1]) if mono else shot
    renderer = make(moments_of(3, 1, 4, 2), shot)
    assert renderer.moments_per_mask == 2.5
    seen = renderer.exposed(scene, poses)
    coded = Coding.of(shot).forward(torch.from_numpy(seen))
    torch.testing.assert_close(renderer.measurement(scene, poses), coded, atol=3e-5, rtol=1e-5)
    split = moments_of(3, 1, 4, 2).split(renderer.transmissions)
    torch.testing.assert_close(split[:3].sum(dim=0), renderer.transmissions[0])
    still = poses[:1].repeat(shot.views, 1, 1)
    np.testing.assert_allclose(renderer.exposed(scene, still), renderer.views(scene, still), atol=2e-6)


def textured(geometry, contrast):
    """Stripes across the motion: an rms slope of `contrast` / 2 per px along the rows."""
    height, width = geometry.inverse_depth.shape
    row = 0.5 + contrast * np.tile([0, 0.5, 0, -0.5], width // 4 + 1)[:width]
    return np.broadcast_to(row[None, None, :, None], (MASKS, height, width, 3)).astype(np.float32)


def aside(geometry, px):
    """Poses that move the picture of the plane at depth 1 by so many px from mask to mask."""
    poses = np.tile(np.eye(4), (MASKS, 1, 1))
    poses[:, 0, 3] = px * (np.arange(MASKS) - geometry.reference) / geometry.intrinsics[0, 0]
    return replace(geometry, world_to_camera=poses, inverse_depth=np.ones_like(geometry.inverse_depth))


@pytest.mark.parametrize("px", [0.5, 2.0, 6.0])
def test_the_bound_is_the_motion_times_the_slope_across_it(moving_plane, px):
    geometry = aside(moving_plane[1], px)
    view = textured(geometry, 0.2)[0]
    slope = np.sqrt(np.mean(np.gradient(view[0, :, 0].astype(float))[1:-1:3] ** 2))
    motion, found = bounds(geometry, geometry.world_to_camera, view, np.array([1.0, 1.0, 0.5, 0.0]))
    np.testing.assert_allclose(motion, px * np.array([1, 1, 0.5, 0]), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found, 0.25 * px * slope * np.array([1, 1, 0.5, 0]), rtol=1e-5, atol=1e-9)


def test_masks_get_as_many_moments_as_their_bound_calls_for(moving_plane):
    geometry, share = aside(moving_plane[1], 4.0), np.array([1.0, 1.0, 0.5, 0.0])
    views = textured(geometry, 0.2)
    _, found = bounds(geometry, geometry.world_to_camera, views[0], share)
    settings = MaskMomentSettings("moving", tolerance=found[0] / 3.5)
    mask_moments = needed(geometry, views, share, settings)
    assert mask_moments.moments == (4, 4, 2, 1)
    assert mask_moments.summary().motion_px == pytest.approx([4, 4, 2, 0], abs=1e-6)
    assert needed(geometry, views, share, replace(settings, most=2)).moments == (2, 2, 2, 1)
    assert mask_moments.note.sentence.startswith("The image moved by up to 4.0 px")


@pytest.mark.parametrize(("px", "code"), [(1.9, Code.MASKS_HAVE_MOMENTS), (2.0, Code.MASKS_BLUR)])
def test_much_motion_within_a_mask_is_a_doubt_about_the_views(px, code):
    note = replace(moments_of(4, 4), motion_px=(1.0, px)).note
    assert note.code is code
    assert note.figures == {"motion_px": px, "most": 4}


def test_where_nothing_is_at_stake_there_is_one_pose_for_each_mask(moving_plane):
    geometry, share, settings = aside(moving_plane[1], 4.0), np.ones(MASKS), MaskMomentSettings("moving")
    even = np.full((MASKS, *geometry.inverse_depth.shape, 3), 0.5, np.float32)
    assert needed(geometry, even, share, settings) is None
    assert needed(aside(geometry, 0.0), textured(geometry, 0.2), share, settings) is None
    assert needed(geometry, textured(geometry, 0.2), share, replace(settings, within_mask="still")) is None
    alone = replace(geometry, world_to_camera=geometry.world_to_camera[:1])
    assert needed(alone, even[:1], share[:1], settings) is None


def test_a_path_whose_neighbouring_views_share_nothing_gets_no_moments(moving_plane):
    share, settings = np.ones(MASKS), MaskMomentSettings("moving")
    side = min(moving_plane[1].inverse_depth.shape)
    for px, believed in ((0.45 * side, True), (0.55 * side, False)):
        geometry = aside(moving_plane[1], px)
        assert (needed(geometry, textured(geometry, 0.2), share, settings) is not None) == believed


def test_masks_are_open_evenly_over_the_exposure():
    assert mask_times(5).tolist() == [-1, -0.5, 0, 0.5, 1]


@pytest.mark.parametrize(("stated", "asked", "taken"), [
    (None, None, "still"),
    ("still", None, "still"),
    ("moving", None, "moving"),
    ("moving", "still", "still"),
    ("still", "moving", "moving"),
])  # fmt: skip
def test_whether_the_camera_moves_under_a_mask_says_the_user_or_else_the_shot(moving_plane, stated, asked, taken):
    shot = moving_plane[0]
    if stated is not None:
        shot = replace(shot, provenance={"within_mask": stated})
    settings = MaskMomentSettings(asked, most=3)
    assert settings.of(shot) == replace(settings, within_mask=taken)


@pytest.mark.parametrize("stated", ["trembling", True, ["moving"], 3])
def test_a_shot_that_states_anything_else_is_refused(moving_plane, stated):
    shot = replace(moving_plane[0], provenance={"within_mask": stated})
    with pytest.raises(InputError, match=r"within_mask = .*allowed: \"still\", \"moving\", or nothing.*--within-mask"):
        MaskMomentSettings().of(shot)
    assert MaskMomentSettings("moving").of(shot).within_mask == "moving"


def test_settings_name_a_known_motion_within_masks():
    with pytest.raises(InputError, match=r"within_mask = 'trembling' .*allowed: 'still' or 'moving'"):
        MaskMomentSettings("trembling").check()


@pytest.mark.parametrize("wrong", [{"tolerance": 0.0}, {"tolerance": np.nan}, {"most": 0}])
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(InputError, match=f"{next(iter(wrong))} = .* in MaskMomentSettings"):
        MaskMomentSettings(**wrong).check()


class Counting(CpuBackend):
    """Remembers how many moments each iteration rendered: looks do not ask for a gradient."""

    def __init__(self):
        super().__init__()
        self.moments = []

    def coded_with_pull(self, scene, world_to_camera, *others):
        image, pull = super().coded_with_pull(scene, world_to_camera, *others)

        def counted(gradient):
            self.moments.append(len(world_to_camera))
            return pull(gradient)

        return image, counted


@pytest.mark.parametrize(("begin", "plain"), [(0.0, 0), (0.5, 30), (1.0, 60)])
def test_masks_have_their_moments_from_a_share_of_the_schedule_on(moving_plane, begin, plain):
    backend = Counting()
    settings = replace(QUICK, densify_every=1000, mask_moments_from=begin)
    fit, _ = run(moving_plane, settings, backend=backend, mask_moments=moments_of(2, 1, 3, 2))
    assert backend.moments == [MASKS] * plain + [8] * (60 - plain)
    assert np.isfinite(fit.views).all()


def test_a_fit_does_not_end_before_masks_have_their_moments(moving_plane, monkeypatch):
    monkeypatch.setattr(Watch, "has_risen", lambda *_: True)
    fit, _ = run(moving_plane, QUICK, mask_moments=moments_of(2, 1, 3, 2))
    assert fit.curve[-1].iteration == 40
    other, _ = run(moving_plane, QUICK)
    assert other.curve[-1].iteration == 10


def test_until_then_a_fit_has_the_bits_of_one_without_moments(moving_plane):
    plain, _ = run(moving_plane)
    never, _ = run(moving_plane, replace(QUICK, mask_moments_from=1.0), mask_moments=moments_of(2, 1, 3, 2))
    np.testing.assert_array_equal(never.views, plain.views)


@pytest.mark.parametrize("begin", [-0.1, 1.1, float("nan")])
def test_a_share_outside_of_the_schedule_is_refused(begin):
    with pytest.raises(InputError, match="mask_moments_from"):
        replace(QUICK, mask_moments_from=begin).check()
