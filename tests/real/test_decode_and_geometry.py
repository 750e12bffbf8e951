"""Decode and geometry of coded renderings and photographs of a fern: the figures that the method was chosen by."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from scipy.io import loadmat

from gs2ci.core.records import Shot
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.geometry.initialise import initialise
from gs2ci.reconstruct.geometry.points import seed_points
from gs2ci.reconstruct.measurement.coding import cfa_channels, select

pytestmark = pytest.mark.slow


def load(folder, name):
    path = folder / f"{name}.npz"
    if not path.is_file():
        pytest.skip(f"no {path.name} in the shared data")
    with np.load(path) as data:
        masks = data["masks"].astype(np.float32)
        measurement, intrinsics = data["meas"].astype(np.float32), data["K"].astype(np.float64)
        shot = Shot(measurement, masks, np.ones(len(masks), np.float32), intrinsics=intrinsics).check()
        return shot, data["truth"].astype(np.float32) / 255, data["world_to_camera"].astype(np.float64)


@cache
def decoded(folder, name):
    """The decode of a shot as it is; tests do not write to it."""
    views = gap_tv(load(folder, name)[0])
    views.flags.writeable = False
    return views


def mean_psnr(views, truth):
    return float(np.mean([-10 * np.log10(np.mean((a - b) ** 2)) for a, b in zip(views, truth, strict=True)]))


@pytest.mark.parametrize(
    ("name", "least_psnr_db", "most_nate"),
    [
        ("fern_smooth", 24.1, 0.015),
        ("fern_smooth_cr16", 22.3, 0.02),
        ("fern_smooth_r50", 24.5, 0.013),
        ("fern_photos_wide", 21.5, 0.015),
    ],
)
def test_decode_and_path_reach_their_figures(shared_data, name, least_psnr_db, most_nate):
    shot, truth, poses = load(shared_data, name)
    views = decoded(shared_data, name)
    assert mean_psnr(views, truth) > least_psnr_db
    geometry = initialise(views, shot.intrinsics)
    assert geometry.verdict == "full"
    nate = trajectory_errors(geometry.world_to_camera, poses).nate
    assert nate is not None
    assert nate < most_nate
    seeds = seed_points(geometry, views)
    assert 10_000 < len(seeds.positions) < 16_000


def test_an_unknown_focal_length_hardly_hurts_the_path(shared_data):
    shot, _, poses = load(shared_data, "fern_photos_wide")
    geometry = initialise(decoded(shared_data, "fern_photos_wide"), None)
    assert geometry.focal_source == "estimated"
    assert geometry.intrinsics[0, 0] == pytest.approx(shot.intrinsics[0, 0], rel=0.2)
    nate = trajectory_errors(geometry.world_to_camera, poses).nate
    assert nate is not None
    assert nate < 0.02


def test_a_mosaic_of_the_fern_is_decoded_and_tracked(shared_data):
    shot, truth, poses = load(shared_data, "fern_smooth")
    coded = torch.from_numpy((shot.masks[..., None] * truth).sum(0))
    mosaic = select(coded, cfa_channels("RGGB", shot.size)).numpy()
    views = gap_tv(replace(shot, measurement=mosaic, cfa="RGGB").check())
    assert mean_psnr(views, truth) > 21.9
    geometry = initialise(views, shot.intrinsics)
    nate = trajectory_errors(geometry.world_to_camera, poses).nate
    assert nate is not None
    assert nate < 0.03


def test_a_real_measurement_with_grey_masks_is_decoded(shared_data):
    path = shared_data / "real_cacti" / "4fan14_cacti.mat"
    if not path.is_file():
        pytest.skip(f"no {path.name} in the shared data")
    data = loadmat(path)
    masks = data["mask"].astype(np.float32).transpose(2, 0, 1)
    masks /= masks.max()
    measurement = data["meas"].astype(np.float32).reshape(256, 256, 1)
    measurement /= measurement.max() / masks.sum(0).max()
    shot = Shot(measurement, masks, np.ones(len(masks), np.float32)).check()
    views = gap_tv(shot)
    left = measurement[..., 0] - (masks[..., None] * views).sum(0)[..., 0]
    assert np.sqrt((left**2).mean()) < 0.1 * np.sqrt((measurement**2).mean())
