"""Measurements from which little or nothing can be recovered: a valid result that reports this, or one typed error."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from gs2ci.commands.reconstruct import run
from gs2ci.core.errors import Gs2ciError, InputError, StorageError
from gs2ci.core.findings import Code, finding
from gs2ci.core.records import Shot, Truth
from gs2ci.core.storage import write_shots
from gs2ci.evaluate.report import read_report
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from tests.stability.judge import AGAINST_HELDOUT

pytestmark = pytest.mark.slow

QUICK = Settings(fit=CoarseSettings(iterations=40, densify_every=10, hold_out=HoldOut(share=0.05, look_every=10)))
SIZE = (36, 44)
FOCAL_PX = 40.0


def texture(size, seed=0):
    noise = gaussian_filter(np.random.default_rng(seed).random((*size, 3)), (1.5, 1.5, 0))
    return (noise - noise.min()) / np.ptp(noise)


def wall(count=4, size=SIZE, step=1.0):
    """A textured wall that shifts by `step` pixels from view to view, [N, H, W, 3] float32."""
    image = texture((size[0], size[1] + 40))
    y, x = np.mgrid[: size[0], : size[1]].astype(float)
    views = [
        np.stack([map_coordinates(image[..., c], (y, x + 20 + step * (i - count / 2)), order=1) for c in range(3)], -1)
        for i in range(count)
    ]
    return np.stack(views).astype(np.float32)


def turned(count, size, focal_px, step_rad):
    """A texture at infinity seen by a camera that only turns about its vertical axis."""
    image = texture((size[0] + 40, size[1] + 60))
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    rays = np.stack([(x - size[1] / 2) / focal_px, (y - size[0] / 2) / focal_px, np.ones_like(x)], axis=-1)
    views = []
    for i in range(count):
        angle = step_rad * (i - count // 2)
        cosine, sine = np.cos(angle), np.sin(angle)
        seen = rays @ np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
        at = focal_px * seen[..., :2] / seen[..., 2:]
        place = (at[..., 1] + size[0] / 2 + 19.5, at[..., 0] + size[1] / 2 + 29.5)
        views.append(np.stack([map_coordinates(image[..., c], place, order=1) for c in range(3)], axis=-1))
    return np.stack(views).astype(np.float32)


def random_masks(views, share=0.4, seed=1):
    return (np.random.default_rng(seed).random(views.shape[:3]) < share).astype(np.float32)


def expose(views, masks=None, **parts):
    masks = random_masks(views) if masks is None else masks
    height, width = views.shape[1:3]
    shot = Shot(
        measurement=(masks[..., None] * views).sum(axis=0),
        masks=masks,
        weights=np.ones(len(views), np.float32),
        intrinsics=np.array([[FOCAL_PX, 0, width / 2], [0, FOCAL_PX, height / 2], [0, 0, 1]]),
        truth=Truth(views=views),
    )
    return replace(shot, **parts).check()


def recover(shot, *phrases, settings=QUICK):
    """Reconstruct; assert that the result is sane and that its notes say each phrase."""
    found = reconstruct(shot, settings)
    result = found.result.check()
    found.scene.check()
    assert result.views.shape == (shot.views, *shot.size, shot.channels)
    # Far outside the range of light would be a fit that ran away, however finite.
    assert np.abs(result.views).max() < 5 * max(1.0, np.abs(shot.measurement).max())
    held = result.heldout_rms
    if held["decode"] is not None:
        assert held[result.verdict] <= AGAINST_HELDOUT * held["decode"]
    notes = " ".join(note.advice for note in result.notes)
    for phrase in phrases:
        assert phrase in notes
    return result


def rms(error):
    return float(np.sqrt(np.mean(np.square(error, dtype=np.float64))))


def test_masks_with_empty_rows():
    views = wall()
    masks = random_masks(views)
    masks[:, 10:14] = 0
    result = recover(expose(views, masks), f"No mask opens {4 * SIZE[1] + dark_elsewhere(masks, 10, 14)} of")
    # What no mask opened is filled in from what is above and below.
    assert rms(result.views[:, 10:14] - views[:, 10:14]) < rms(views - views.mean())


def dark_elsewhere(masks, first, last):
    dark = ~masks.any(axis=0)
    dark[first:last] = False
    return int(dark.sum())


def test_a_view_that_was_never_exposed():
    views = wall()
    masks = random_masks(views)
    masks[2] = 0
    recover(expose(views, masks), "No light reached views [2]")


def test_a_mask_of_no_weight():
    views = wall()
    shot = expose(views)
    weights = np.array([1, 1, 0, 1], np.float32)
    measurement = (weights[:, None, None, None] * shot.masks[..., None] * views).sum(axis=0)
    recover(replace(shot, weights=weights, measurement=measurement).check(), "No light reached views [2]")


def test_all_masks_fully_open():
    views = wall()
    recover(expose(views, np.ones(views.shape[:3], np.float32)), "All masks are the same")


def test_identical_masks():
    views = wall()
    recover(expose(views, np.repeat(random_masks(views)[:1], 4, axis=0)), "All masks are the same", "No mask opens")


@pytest.fixture(scope="module")
def unopened():
    """A shot some of whose pixels no mask opens, and what is recovered of it."""
    views = wall()
    masks = random_masks(views)
    masks[:, 12:24, 16:28] = 0
    shot = expose(views, masks)
    return shot, recover(shot)


def test_pixels_that_no_mask_opens(unopened):
    assert "No mask opens" in " ".join(note.advice for note in unopened[1].notes)


@pytest.mark.parametrize("opened", [1, 2])
def test_next_to_no_pixel_open(opened):
    views = wall()
    masks = np.zeros(views.shape[:3], np.float32)
    masks[0].reshape(-1)[:opened] = 1
    recover(expose(views, masks), "No mask opens", "points could be tracked")


def test_a_wholly_saturated_measurement():
    views = wall()
    shot = expose(views)
    clipped = np.full_like(shot.measurement, shot.measurement.max())
    result = recover(
        replace(shot, measurement=clipped, saturated=np.ones(SIZE, bool)),
        "100% of the pixels are saturated",
        "The measurement is",
        "No pixel was held out",
    )
    assert set(result.heldout_rms.values()) == {None}


def test_a_half_saturated_measurement():
    views = wall()
    shot = expose(views)
    level = float(np.median(shot.measurement))
    saturated = (shot.measurement >= level).any(axis=2)
    result = recover(replace(shot, measurement=np.minimum(shot.measurement, level), saturated=saturated), "saturated")
    assert result.predicted_measurement[saturated].mean() > 0.5 * level


def test_a_constant_measurement():
    shot = expose(wall())
    recover(replace(shot, measurement=np.full_like(shot.measurement, 0.7)), "The measurement is 0.7 everywhere")


def test_an_all_zero_measurement():
    shot = expose(wall())
    result = recover(replace(shot, measurement=np.zeros_like(shot.measurement)), "The measurement is zero everywhere")
    assert np.abs(result.views).max() < 0.2


def test_a_measurement_below_zero():
    """An offset that was subtracted twice, or read noise in the dark."""
    shot = expose(wall())
    noise = np.random.default_rng(2).normal(-0.05, 0.02, shot.measurement.shape).astype(np.float32)
    recover(replace(shot, measurement=noise))


@pytest.mark.parametrize("scale", [1e-6, 30.0])
def test_a_measurement_of_another_unit(scale):
    shot = expose(wall())
    result = reconstruct(replace(shot, measurement=np.float32(scale) * shot.measurement), QUICK).result.check()
    assert result.heldout_rms[result.verdict] <= result.heldout_rms["decode"]


def test_no_motion_at_all():
    views = np.repeat(wall(1, step=0), 4, axis=0)
    result = recover(expose(views), "depth cannot be found")
    assert result.geometry.verdict in ("static", "unsupported")
    assert rms(result.views - views) < 0.15


def test_pure_rotation():
    """By a processor's rounding, features of a longer decode may join the views by chance: then that is said."""
    size, focal_px = (48, 64), 50.0
    camera = np.array([[focal_px, 0, size[1] / 2], [0, focal_px, size[0] / 2], [0, 0, 1]])
    views = turned(6, size, focal_px, step_rad=0.03)
    result = recover(expose(views, intrinsics=camera))
    codes = {note.code for note in result.notes}
    if result.geometry.verdict == "rotation_only":
        assert codes & {Code.CAMERA_ONLY_TURNED, Code.PARALLAX_MAY_DROWN}
    else:
        assert {Code.PATH_UNCONFIRMED, Code.DEPTH_ORDER_OPEN} <= codes
    assert rms(result.views - views) < 0.15


# In 256 pixels features of a longer decode may join the views by chance: the path is said to be uncertain then.
@pytest.mark.parametrize(("size", "said"), [((16, 16), "Do not rely on"), ((3, 40), "tracked"), ((1, 1), "tracked")])
def test_tiny_images(size, said):
    recover(expose(wall(4, size)), said)


def test_one_view():
    views = wall(1)
    result = recover(expose(views, np.ones((1, *SIZE), np.float32)), "There is one view only")
    assert rms(result.views - views) < 0.05


def test_one_coded_view():
    recover(expose(wall(1)), "There is one view only")


def test_two_views():
    recover(expose(wall(2)))


def test_a_focal_length_that_is_not_known():
    recover(replace(expose(wall()), intrinsics=None), "focal length")


@pytest.mark.parametrize("focal_px", [1e-3, 1e6])
def test_an_absurd_focal_length(focal_px):
    camera = np.array([[focal_px, 0, SIZE[1] / 2], [0, focal_px, SIZE[0] / 2], [0, 0, 1]])
    recover(replace(expose(wall()), intrinsics=camera))


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("measurement", np.full((*SIZE, 3), np.nan, np.float32)),
        ("masks", np.zeros((4, *SIZE), np.float32)),
        ("masks", np.full((4, *SIZE), -1, np.float32)),
        ("masks", np.ones((0, *SIZE), np.float32)),
        ("weights", np.zeros(4, np.float32)),
        ("intrinsics", np.zeros((3, 3))),
    ],
)
def test_a_shot_that_contradicts_itself_is_one_typed_error(part, value):
    with pytest.raises(InputError):
        reconstruct(replace(expose(wall()), **{part: value}), QUICK)


def test_open_masks_of_no_weight_beside_closed_ones_are_one_typed_error():
    shot = expose(wall())
    masks = shot.masks.copy()
    masks[1:] = 0
    with pytest.raises(InputError, match="closed or has weight zero"):
        reconstruct(replace(shot, masks=masks, weights=np.array([0, 1, 1, 1], np.float32)), QUICK)


def test_a_reading_where_no_light_came_is_not_taken_for_light(unopened):
    shot, dark = unopened
    measurement = shot.measurement.copy()
    measurement[~shot.masks.any(axis=0)] = 0.5
    result = recover(replace(shot, measurement=measurement), "No mask opens")
    assert rms(result.decode - shot.truth.views) < 1.1 * rms(dark.decode - shot.truth.views)


def test_the_hardest_case_still_makes_a_whole_run_folder_without_a_nan(tmp_path):
    shot = expose(wall())
    dark = replace(shot, measurement=np.zeros_like(shot.measurement), intrinsics=None, truth=Truth())
    folder = run(write_shots(tmp_path / "shot.h5", [dark]), tmp_path / "run", iterations=10)
    report = read_report(folder)
    assert finding(Code.EMPTY_MEASUREMENT, reading="zero") in report.notes
    assert np.isfinite(np.load(folder / "views.npy")).all()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", "shot.h5", "shot.json"]


def test_an_error_during_the_fit_leaves_nothing_behind(tmp_path, monkeypatch):
    measured = write_shots(tmp_path / "shot.h5", [expose(wall())])

    def fail(*_, **__):
        raise Gs2ciError("the fit failed")

    monkeypatch.setattr("gs2ci.reconstruct.hypotheses.fitting.CoarseRun", fail)
    with pytest.raises(Gs2ciError, match="the fit failed"):
        run(measured, tmp_path / "run")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["shot.h5", "shot.json"]


def test_a_disk_that_refuses_at_the_end_leaves_nothing_behind(tmp_path, monkeypatch):
    measured = write_shots(tmp_path / "shot.h5", [expose(wall())])

    def refuse(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gs2ci.evaluate.run_folder.write_overview", refuse)
    with pytest.raises(StorageError, match="No space left"):
        run(measured, tmp_path / "run", iterations=2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["shot.h5", "shot.json"]
