from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.records import Truth
from gs2ci.evaluate.evaluation import ReferenceData, evaluate, write_evaluation
from gs2ci.evaluate.metrics import SensorNoise
from gs2ci.evaluate.novel_views import NovelViews
from gs2ci.evaluate.pages.run_evidence import read_run
from gs2ci.evaluate.report import read_report
from gs2ci.evaluate.run_folder import write_run
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians

pytestmark = pytest.mark.usefixtures("undrawn")


def one_gaussian():
    one = torch.zeros(1, 3)
    return Gaussians(one + torch.tensor([0.0, 0.0, 1.0]), one, torch.tensor([[1.0, 0, 0, 0]]), torch.zeros(1), one)


@pytest.fixture(scope="module")
def finished(make_run, tmp_path_factory):
    shot, result = make_run(count=4, size=(24, 32))
    return shot, result, write_run(tmp_path_factory.mktemp("runs") / "run", shot, result, one_gaussian())


def test_what_is_read_back_is_what_was_found(finished):
    _, result, folder = finished
    run = read_run(folder)
    np.testing.assert_array_equal(run.views, result.views)
    np.testing.assert_allclose(run.world_to_camera, result.world_to_camera, atol=1e-12)
    np.testing.assert_allclose(run.intrinsics, result.intrinsics)
    np.testing.assert_array_equal(run.depth, result.depth)


def test_figures_that_the_report_has_already_come_out_the_same(finished):
    shot, _, folder = finished
    found, report = evaluate(read_run(folder), ReferenceData(shot)), read_report(folder)
    assert found["psnr_db"] == asdict(report.psnr_db)
    assert found["ssim"] == asdict(report.ssim)
    assert found["trajectory"]["nate"] == pytest.approx(report.trajectory.nate)
    assert found["residual"]["rms"] == pytest.approx(report.residual.rms, rel=1e-5)


def test_views_are_coded_with_the_weights_that_the_run_corrected(make_run, tmp_path):
    shot, result = make_run(count=4, size=(24, 32))
    brightness = [0.5, 1.0, 1.5, 1.0]
    lit = replace(shot, weights=(shot.weights * np.array(brightness)).astype(np.float32))
    predicted = Coding.of(lit).forward(torch.from_numpy(result.views)).numpy()
    folder = write_run(
        tmp_path / "run", shot, replace(result, brightness=brightness, predicted_measurement=predicted), one_gaussian()
    )
    found, report = evaluate(read_run(folder), ReferenceData(shot)), read_report(folder)
    assert report.brightness == brightness
    assert found["residual"]["rms"] == pytest.approx(report.residual.rms, rel=1e-5)


def test_views_are_coded_with_the_masks_that_the_run_corrected(make_run, tmp_path):
    shot, result = make_run()
    believed = replace(shot, masks=np.ascontiguousarray(np.roll(shot.masks, 3, axis=2)))
    folder = write_run(tmp_path / "run", believed, replace(result, registered=shot), one_gaussian())
    run = read_run(folder)
    assert evaluate(run, ReferenceData(believed))["residual"]["rms"] == pytest.approx(run.report.residual.rms, abs=1e-5)


def test_what_nobody_knows_is_left_out(finished):
    shot, _, folder = finished
    found = evaluate(read_run(folder), ReferenceData(replace(shot, truth=Truth())))
    assert found["psnr_db"] is found["trajectory"] is found["depth"] is found["novel_views"] is None
    assert found["residual"]["chi2_per_pixel"] is None


def test_depth_noise_and_novel_views_are_judged_where_given(finished):
    shot, result, folder = finished
    novel = NovelViews(shot.truth.views[:2], shot.truth.world_to_camera[:2])
    evidence = ReferenceData(shot, 2 * result.depth, novel, SensorNoise(0.02))
    found = evaluate(read_run(folder), evidence)
    assert found["depth"]["scale"] == pytest.approx(2)
    assert found["residual"]["chi2_per_pixel"] == pytest.approx((found["residual"]["rms"] / 0.02) ** 2, rel=1e-4)
    assert 0 < found["novel_views"]["psnr_db"]["mean"] < 100


def test_novel_views_are_a_pinholes_whatever_the_lens(make_run, tmp_path):
    """A true scene on the true path scores as exact beside views of a pinhole, though its shot was seen by a lens."""
    shot, result = make_run(count=4, size=(24, 32))
    bent, poses = np.array([-0.15, 0.05, 0, 0, 0]), shot.truth.world_to_camera
    given = replace(shot, intrinsics=result.intrinsics, distortion=bent)
    found = replace(result, world_to_camera=poses, distortion=bent)
    folder = write_run(tmp_path / "run", given, found, one_gaussian())
    pinhole = ShotRenderer(shot, result.intrinsics, load_backend())
    novel = NovelViews(pinhole.views(one_gaussian(), torch.from_numpy(poses).float()), poses)
    assert evaluate(read_run(folder), ReferenceData(given, novel=novel))["novel_views"]["psnr_db"]["mean"] > 60


@pytest.mark.parametrize("channels", [1, 3])
def test_a_perceptual_distance_sees_clamped_images_of_three_channels(make_run, tmp_path, channels):
    shot, result = make_run(count=3, size=(16, 20), channels=channels)
    bright = replace(result, views=result.views + np.float32(2))
    folder = write_run(tmp_path / "run", shot, bright, one_gaussian())
    seen = []

    class Distance:
        name = "LPIPS"

        def __call__(self, image, target):
            seen.append((tuple(image.shape), float(image.max()), tuple(target.shape)))
            return (image - target).abs().mean()

    found = evaluate(read_run(folder), ReferenceData(shot, lpips=Distance()))
    assert seen == [((16, 20, 3), 1.0, (16, 20, 3))] * 3
    assert found["lpips"]["per_view"] == pytest.approx([float(1 - view.mean()) for view in shot.truth.views], abs=1e-5)
    assert evaluate(read_run(folder), ReferenceData(shot))["lpips"] is None


def test_a_mono_run_is_judged_in_one_channel(make_run, tmp_path):
    shot, result = make_run(count=3, size=(16, 20), channels=1)
    folder = write_run(tmp_path / "run", shot, result, one_gaussian())
    assert evaluate(read_run(folder), ReferenceData(shot))["psnr_db"] == asdict(read_report(folder).psnr_db)


def test_another_shot_and_novel_views_without_a_true_path_are_refused(finished, make_run):
    shot, _, folder = finished
    other, _ = make_run(count=3, size=(24, 32))
    with pytest.raises(InputError, match="beside a shot"):
        evaluate(read_run(folder), ReferenceData(other))
    novel = NovelViews(shot.truth.views, shot.truth.world_to_camera)
    with pytest.raises(InputError, match="true camera path"):
        evaluate(read_run(folder), ReferenceData(replace(shot, truth=Truth()), novel=novel))


def test_a_folder_that_is_no_whole_run_is_refused(make_run, tmp_path):
    shot, result = make_run(count=3, size=(16, 20))
    folder = write_run(tmp_path / "run", shot, result, one_gaussian())
    (folder / "cameras.json").write_text("{}")
    with pytest.raises(StorageError, match="cannot be read as a run"):
        read_run(folder)
    (folder / "cameras.json").write_text("[]")
    with pytest.raises(StorageError, match="cannot be read as a run"):
        read_run(folder)
    write_run(folder, shot, result, one_gaussian(), overwrite=True)
    (folder / "views.npy").write_bytes(b"")
    with pytest.raises(StorageError, match="cannot be read as a run"):
        read_run(folder)
    with pytest.raises(StorageError):
        read_run(tmp_path / "nowhere")


def test_a_place_that_cannot_be_written_is_a_clear_error(tmp_path):
    with pytest.raises(StorageError, match="cannot be written"):
        write_evaluation(tmp_path, {})


@pytest.mark.parametrize("crop", [np.s_[:, :-1], np.s_[:, :, 1:], np.s_[:, ::2, ::2]])
def test_novel_views_of_another_size_are_refused(finished, crop):
    shot, _, folder = finished
    novel = NovelViews(shot.truth.views[crop], shot.truth.world_to_camera)
    with pytest.raises(InputError, match=r"novel views of \d+ x \d+ px beside a run of .*crop and scale them"):
        evaluate(read_run(folder), ReferenceData(shot, novel=novel))
