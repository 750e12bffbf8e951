"""Decoders on real and published measurements, briefly; `python -m tests.benchmarks decoders` has the figures."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, choose_coupling, gap_tv
from gs2ci.reconstruct.learned.ffdnet import export_ffdnet, read_ffdnet
from gs2ci.reconstruct.learned.onnx_denoiser import OnnxDenoiser


def shots_of(path):
    return import_shots(path, None, ImportOptions()).shots


@pytest.mark.parametrize(("name", "published_db"), [("runner40", 30.13), ("drop40", 34.50), ("traffic48", 20.65)])
def test_coupled_gap_tv_is_within_a_third_of_a_decibel_of_the_published_figures(shared_data, name, published_db):
    shots = shots_of(shared_data / "video_sci" / f"{name}_cacti.mat")
    settings = choose_coupling(shots[0], GapTvSettings(weight=0.3), seed=0)
    figures = [psnr_per_view(gap_tv(shot, settings), shot.truth.views) for shot in shots]
    assert np.mean(figures) > published_db - 0.3


@pytest.mark.parametrize(("name", "coupled"), [("fern_smooth", False), ("runner40", True)])
def test_held_out_pixels_find_the_coupling_that_the_truth_would_choose(shared_data, name, coupled):
    path = shared_data / f"{name}.npz" if name.startswith("fern") else shared_data / "video_sci" / f"{name}_cacti.mat"
    shot = shots_of(path)[0]
    chosen = choose_coupling(shot, GapTvSettings(weight=0.3), seed=0, candidates=(0.0, 0.6)).coupling
    apart, together = (
        np.mean(psnr_per_view(gap_tv(shot, GapTvSettings(weight=0.3, coupling=c)), shot.truth.views))
        for c in (0.0, 0.6)
    )
    assert (together > apart) == coupled == (chosen > 0)


def test_the_chopper_wheel_of_a_real_exposure_turns(shared_data):
    """The bright mark on the wheel moves steadily down and left from view to view."""
    shot = shots_of(shared_data / "real_cacti" / "4fan14_cacti.mat")[0]
    views = gap_tv(shot, GapTvSettings(weight=0.3))[..., 0]
    marks = []
    for view in views[:-1]:  # the last one is nearly dark
        smooth = gaussian_filter(view, 12, mode="constant")
        marks.append(np.unravel_index(smooth.argmax(), smooth.shape))
    rows, columns = np.array(marks, float).T
    assert (np.diff(rows) >= 0).all()
    assert (np.diff(columns) < 0).all()
    assert rows[-1] - rows[0] > 40


def test_published_weights_denoise_and_survive_the_export(shared_data, tmp_path):
    weights = shared_data / "weights" / "ffdnet_gray.pth"
    if not weights.is_file():
        pytest.skip(f"no {weights.name}")
    network = read_ffdnet(weights)
    assert len(network.layers) == 15
    denoise = OnnxDenoiser(export_ffdnet(network, tmp_path / "ffdnet.onnx"))
    truth = shots_of(shared_data / "video_sci" / "drop40_cacti.mat")[0].truth.views[:1, 60:155, 60:157]
    truth = truth.transpose(0, 3, 1, 2)
    for sigma in (25 / 255, 6 / 255):
        noise = np.random.default_rng(0).normal(0, sigma, truth.shape)
        denoised = denoise((truth + noise).astype(np.float32), sigma)
        assert np.sqrt(np.mean((denoised - truth) ** 2)) < 0.5 * sigma
