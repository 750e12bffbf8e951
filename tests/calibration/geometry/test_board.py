from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import ValidationError

from gs2ci.core.errors import InputError
from gs2ci_calibration.geometry.board import Board, Sighting
from gs2ci_calibration.geometry.pictures import Pictures, without_colours
from gs2ci_calibration.options import BoardSpec
from gs2ci_sims.targets import BoardPlane


def test_corners_are_found_to_hundredths_of_a_pixel_through_a_distorting_lens(cameras, photograph):
    board, errors, found = Board(), [], 0
    for camera, _ in cameras(5):
        for index in range(2):
            image, true = photograph(camera, index)
            sighting = board.find(image)
            assert np.allclose(sighting.corners_mm, board.corners_mm[sighting.ids])
            errors.append(sighting.corners_px - true[sighting.ids])
            found += len(sighting.ids)
    assert found > 0.9 * 10 * 24
    assert np.sqrt(np.mean(np.square(np.concatenate(errors)))) < 0.04


@pytest.mark.parametrize("colours", [[[0.6, 1.0], [1.0, 0.7]], [[1.0, 0.5], [0.35, 1.0]], [[1.0, 0.2], [0.2, 0.06]]])
def test_corners_in_a_mosaic_are_as_precise_as_in_grey_in_whatever_light(cameras, photograph, colours):
    board, errors, found = Board(), [], 0
    for camera, _ in cameras(2, (161, 199)):
        image, true = photograph(camera)
        row, column = np.indices(image.shape) % 2
        mosaic = np.rint(64 + np.array(colours)[row, column] * (image - 64)).astype(np.float32)
        devices = SimpleNamespace(sensor=SimpleNamespace(settings=SimpleNamespace(format=SimpleNamespace(cfa="RGGB"))))
        bench = SimpleNamespace(
            devices=devices,
            flat_pattern=lambda is_open: np.ones((2, 2), np.uint8),
            grab=lambda *_, readings=mosaic, **__: SimpleNamespace(readings=readings[None, None]),
        )
        sighting = Pictures(bench, "camera", board).take(0.01, 1)
        errors.append(sighting.corners_px - true[sighting.ids])
        found += len(sighting.ids)
    assert found > 0.9 * 2 * 24
    assert np.sqrt(np.mean(np.square(np.concatenate(errors)))) < 0.02


def test_a_picture_without_anything_in_it_has_no_colours_to_take_out():
    assert not without_colours(np.full((6, 7), 64.0)).any()


def test_a_board_partly_outside_of_the_frame_gives_the_corners_inside(camera, photograph):
    image, true = photograph(camera, noise=False)
    middle = int(np.median(true[:, 0]))
    sighting = Board().find(image[:, :middle])
    assert 6 <= len(sighting.ids) < 24
    assert np.abs(sighting.corners_px - true[sighting.ids]).max() < 0.15


@pytest.mark.parametrize(
    "image",
    [np.zeros((60, 80)), np.full((60, 80), 4095.0), np.random.default_rng(0).normal(100, 5, (120, 160))],
    ids=["black", "saturated", "noise"],
)
def test_no_board_is_found_where_there_is_none(image):
    assert Board().find(image) is None


def test_another_board_is_not_found(camera, photograph):
    other = BoardPlane(7, 5, 30.0, 21.0, "DICT_6X6_50")
    image, _ = photograph(camera, plane=other, noise=False)
    assert Board().find(image) is None


def test_corners_on_one_line_are_told_from_corners_in_a_plane():
    corners = Board().corners_mm
    on_line = np.flatnonzero(corners[:, 1] == corners[0, 1])
    for ids, collinear in ((on_line, True), (np.arange(12), False)):
        assert Sighting(ids, corners[ids, :2], corners[ids]).collinear is collinear


def test_one_row_of_corners_in_view_is_a_collinear_sighting(camera, photograph):
    image, true = photograph(camera, noise=False, fixed=True)
    rows = true.reshape(4, 6, 2)[..., 1]
    below = int(rows[0].max() + 0.75 * (rows[1].min() - rows[0].max()))
    sighting = Board().find(image[:below])
    assert sighting is None or sighting.collinear


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (BoardSpec(marker_mm=30.0), "markers of 30"),
        (BoardSpec(dictionary="DICT_NONE"), "dictionary 'DICT_NONE'"),
    ],
)
def test_a_board_that_cannot_be_is_refused(spec, message):
    with pytest.raises(InputError, match=message):
        Board(spec)


@pytest.mark.parametrize("wrong", [{"columns": 2}, {"square_mm": float("inf")}, {"marker_mm": 0.0}])
def test_a_board_of_impossible_numbers_is_refused_when_it_is_read(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        BoardSpec(**wrong)


def test_a_board_with_more_markers_than_its_dictionary_is_refused():
    with pytest.raises(InputError, match="needs 60 markers"):
        Board(BoardSpec(columns=12, rows=10)).find(np.zeros((60, 80)))
