from dataclasses import replace

import cv2
import numpy as np
import pytest

from gs2ci.core.findings import Code, finding
from gs2ci.evaluate import overview
from gs2ci.evaluate.overview import COLUMNS, draw_overview, write_overview
from gs2ci.evaluate.run_report import build_report

CASES = {
    "colour": {},
    "mono": {"channels": 1},
    "no truth": {"truth": False},
    "tiny": {"size": (16, 16)},
    "big": {"size": (769, 1023), "count": 2},
    "slim": {"size": (120, 4), "truth": False},
    "wide": {"size": (30, 240)},
    "single view": {"count": 1},
}


def tiles(shot, result):
    """The tiles of a run's overview by their names, without the scale that all have in the picture."""
    return overview._tiles(shot, result, build_report(shot, result))


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_every_kind_of_run_is_drawn_whole(make_run, case):
    shot, result = make_run(**case)
    found = tiles(shot, result)
    known = ["truth", "error"] if case.get("truth", True) else []
    assert list(found) == ["measurement", "decode", "result", *known, "depth"]
    for name, tile in found.items():
        assert tile.shape == (*shot.size, 3), name
        assert tile.std() > 1, name
    picture = draw_overview(shot, result, build_report(shot, result))
    rows = -(-len(found) // COLUMNS)
    assert picture.dtype == np.uint8
    assert picture.shape[0] % rows == picture.shape[1] % COLUMNS == 0
    assert max(picture.shape[0] / rows, picture.shape[1] / COLUMNS) <= 480 + 34


def test_small_pictures_are_enlarged_pixel_by_pixel(make_run):
    shot, result = make_run(size=(16, 16))
    picture = draw_overview(shot, result, build_report(shot, result))
    shown = picture[26 : 26 + 480 : 30, 2 * 488 : 2 * 488 + 480 : 30]
    assert (shown == tiles(shot, result)["result"]).all()


def test_the_picture_is_written_in_its_colours(tmp_path, make_run):
    shot, result = make_run()
    report = build_report(shot, result)
    write_overview(tmp_path / "overview.png", shot, result, report)
    assert (cv2.imread(str(tmp_path / "overview.png"))[..., ::-1] == draw_overview(shot, result, report)).all()


def test_no_depth_is_drawn_of_a_camera_known_to_be_at_rest(make_run):
    shot, result = make_run(truth=False)
    geometry = replace(result.geometry, method="rest", verdict="static")
    assert "depth" not in tiles(shot, replace(result, geometry=geometry, notes=(finding(Code.CAMERA_GIVEN_AT_REST),)))


def test_depth_where_nothing_is_seen_stays_grey(make_run):
    shot, result = make_run()
    depth = result.depth.copy()
    depth[:, :10] = 0
    shown = tiles(shot, replace(result, depth=depth))["depth"]
    assert (shown[:10] == 128).all()
    assert not (shown[10:] == 128).all(axis=-1).any()


@pytest.mark.parametrize("depth", [0.0, 3.0, None])
def test_a_flat_depth_is_drawn_and_none_where_there_is_none(make_run, depth):
    shot, result = make_run()
    given = None if depth is None else np.full_like(result.depth, depth)
    assert ("depth" in tiles(shot, replace(result, depth=given))) == bool(depth)


def test_a_measurement_of_zeros_and_a_perfect_result_are_drawn(make_run):
    shot, result = make_run()
    found = tiles(replace(shot, measurement=0 * shot.measurement), replace(result, views=shot.truth.views))
    assert not found["measurement"].any()
    assert (found["error"] == found["error"][0, 0]).all()
