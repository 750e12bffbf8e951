import cv2
import numpy as np
import pytest

from gs2ci_calibration.geometry.board import Board
from gs2ci_calibration.geometry.corners import refine_corners


def stretched(image):
    return ((image - image.min()) / np.ptp(image) * 255).astype(np.float32)


def rms(errors):
    return float(np.sqrt(np.mean(np.square(errors))))


def test_corners_are_several_times_nearer_than_those_of_opencv(cameras, photograph):
    board, ours, theirs = Board(), [], []
    ending = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
    for camera, rng in cameras(3):
        image, true = photograph(camera, fixed=True)
        grey = stretched(image)
        start = true + rng.uniform(-0.5, 0.5, true.shape)
        refined, blur_px = refine_corners(grey, start, board.corners_mm[:, :2] / 30.0, board.gap)
        good = np.isfinite(blur_px)
        assert good.mean() > 0.9
        ours.append(rms(refined[good] - true[good]))
        peer = (start[good] - 0.5).astype(np.float32).reshape(-1, 1, 2)
        both = [cv2.cornerSubPix(grey.astype(np.uint8), peer.copy(), (s, s), (-1, -1), ending) for s in (2, 3, 4)]
        theirs.append(min(rms(found.reshape(-1, 2) + 0.5 - true[good]) for found in both))
    assert rms(ours) < 0.2 * rms(theirs)
    assert rms(ours) < 0.02


@pytest.mark.parametrize("sigma_px", [0.6, 1.2, 2.0])
def test_the_blur_of_edges_is_measured_and_moves_no_corner(camera, photograph, sigma_px):
    image, true = photograph(camera, blur_px=sigma_px, noise=False)
    board = Board()
    refined, blur_px = refine_corners(stretched(image), true, board.corners_mm[:, :2] / 30.0, board.gap)
    # Markers near by make wide blurs look narrower.
    assert 0.6 * sigma_px < np.nanmedian(blur_px) < 1.1 * sigma_px
    assert rms(refined[np.isfinite(blur_px)] - true[np.isfinite(blur_px)]) < 0.06


def test_corners_without_contrast_are_marked(camera, photograph):
    _, true = photograph(camera, noise=False)
    board = Board()
    refined, blur_px = refine_corners(np.full((160, 200), 90.0), true, board.corners_mm[:, :2] / 30.0, board.gap)
    assert np.isnan(blur_px).all()
    assert np.array_equal(refined, true)


def test_corners_at_the_rim_with_too_few_pixels_are_marked(camera, photograph):
    image, true = photograph(camera, noise=False)
    cut = stretched(image)[:, : int(true[:, 0].min()) - 6]
    board = Board()
    _, blur_px = refine_corners(cut, true, board.corners_mm[:, :2] / 30.0, board.gap)
    assert np.isnan(blur_px).all()


def test_points_that_no_homography_maps_are_marked():
    same = np.full((6, 2), 50.0)
    _, blur_px = refine_corners(np.zeros((100, 100)), same, same, 0.15)
    assert np.isnan(blur_px).all()
