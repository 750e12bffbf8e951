"""The shared measurements come in without flags, and mean what a Shot means."""

import numpy as np
import pytest

from gs2ci.commands.import_ import run
from gs2ci.core.foreign.agreement import CodingConvention, fit
from gs2ci.core.storage import count_shots, read_shot


@pytest.mark.parametrize(
    ("name", "views"),
    [("fern_smooth", 8), ("fern_smooth_cr16", 16), ("fern_smooth_r50", 8), ("fern_photos_wide", 8)],
)
def test_the_colour_measurements_need_no_flags(shared_data, tmp_path, name, views):
    shot = read_shot(run(shared_data / f"{name}.npz", out=tmp_path / "shot.h5"))
    stored = np.load(shared_data / f"{name}.npz")
    assert np.array_equal(shot.measurement, stored["meas"])
    assert np.array_equal(shot.masks, stored["masks"])
    assert np.array_equal(shot.intrinsics, stored["K"])
    assert np.array_equal(shot.truth.world_to_camera, stored["world_to_camera"])
    assert np.array_equal(np.rint(shot.truth.views * 255), stored["truth"])
    assert (shot.views, shot.channels, shot.cfa, shot.saturated) == (views, 3, None, None)
    scale, residual = fit(
        shot.measurement.astype(float), CodingConvention(shot.masks, shot.weights).forward(shot.truth.views)
    )
    assert scale == pytest.approx(1, abs=1e-6)
    assert residual < 1e-6


@pytest.mark.parametrize(("name", "count"), [("drop40", 5), ("runner40", 5), ("traffic48", 6)])
def test_every_measurement_of_a_video_benchmark_is_kept_with_its_own_frames(shared_data, tmp_path, name, count):
    path = run(shared_data / "video_sci" / f"{name}_cacti.mat", out=tmp_path / "shot.h5")
    assert count_shots(path) == count
    for index in range(count):
        shot = read_shot(path, index)
        assert (shot.views, shot.size, shot.channels) == (8, (256, 256), 1)
        coded = CodingConvention(shot.masks, shot.weights).forward(shot.truth.views)
        assert np.abs(shot.measurement - coded).max() < 1e-5


def test_a_real_exposure_with_grey_masks_comes_in_as_counts(shared_data, tmp_path):
    shot = read_shot(run(shared_data / "real_cacti" / "4fan14_cacti.mat", out=tmp_path / "shot.h5"))
    assert (shot.views, shot.size, shot.channels) == (14, (256, 256), 1)
    assert shot.masks.max() == 1
    multiplicity = CodingConvention(shot.masks, shot.weights).multiplicity
    covered = multiplicity > 0.5 * np.median(multiplicity)
    assert 0.3 < np.quantile(shot.measurement[..., 0][covered] / multiplicity[covered], 0.999) < 1.1


def test_masks_turned_against_a_real_exposure_are_found_out(shared_data, tmp_path, capsys):
    stored = np.load(shared_data / "fern_smooth.npz")
    np.savez(tmp_path / "turned.npz", meas=stored["meas"], masks=stored["masks"][:, ::-1], K=stored["K"])
    run(tmp_path / "turned.npz", out=tmp_path / "shot.h5")
    assert "the masks are upside down" in capsys.readouterr().out
