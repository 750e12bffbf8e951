from dataclasses import replace

import cv2
import numpy as np
import pytest

from gs2ci.evaluate.pages.run_evidence import read_run
from gs2ci.evaluate.pages.run_pictures import collect_pictures


@pytest.fixture(scope="module")
def evidence(whole_run):
    return read_run(whole_run)


def pixels(picture):
    return cv2.imdecode(np.frombuffer(picture.content, np.uint8), cv2.IMREAD_COLOR)


def judged(evidence, verdict):
    return collect_pictures(replace(evidence, report=evidence.report.model_copy(update={"verdict": verdict})))


def test_every_view_has_its_pictures_and_the_middle_one_is_first(evidence):
    found = collect_pictures(evidence)
    assert list(found.indices) == list(range(8))
    assert found.all_shown
    assert found.start == 4
    assert found.pixelated
    assert {len(found.recovered), len(found.maps["depth"].pictures), len(found.maps["error"].pictures)} == {8}


@pytest.mark.parametrize(
    ("verdict", "layers"),
    [
        ("refined", ["decode", "measurement", "scene", "truth"]),
        ("scene", ["decode", "measurement", "truth"]),
        ("decode", ["measurement", "truth"]),
    ],
)
def test_a_result_is_not_compared_with_itself(evidence, verdict, layers):
    assert [layer.name for layer in judged(evidence, verdict).layers] == layers


def test_depth_has_one_scale_for_all_views_from_far_to_near(evidence):
    depth = collect_pictures(evidence).maps["depth"]
    far, near = float(depth.ticks[0]), float(depth.ticks[-1])
    assert far == pytest.approx(9, rel=0.1)
    assert near == pytest.approx(2, rel=0.1)
    np.testing.assert_array_equal(pixels(depth.pictures[0]), pixels(depth.pictures[7]))


def test_a_flat_depth_and_an_empty_one_are_no_trouble(evidence):
    flat = collect_pictures(replace(evidence, depth=np.full(evidence.depth.shape, 3.0))).maps["depth"]
    assert len(set(flat.ticks)) > 1
    assert "depth" not in collect_pictures(replace(evidence, depth=np.zeros(evidence.depth.shape))).maps
    assert "depth" not in collect_pictures(replace(evidence, depth=np.full(evidence.depth.shape, np.nan))).maps
    assert "depth" not in collect_pictures(replace(evidence, depth=None)).maps


def test_where_nothing_is_seen_depth_is_grey(evidence):
    depth = np.array(evidence.depth)
    depth[:, :10, :10] = 0
    picture = pixels(collect_pictures(replace(evidence, depth=depth)).maps["depth"].pictures[3])
    assert (picture[:10, :10] == 128).all()


def test_a_result_that_is_right_looks_right(evidence):
    """Its rounding errors are not blown up to full colour."""
    right = replace(evidence, views=evidence.true_views / np.float32(255))
    error = collect_pictures(right).maps["error"]
    assert float(error.ticks[-1]) == 0.02
    assert pixels(error.pictures[0]).max() < 10
    assert "error" not in collect_pictures(replace(evidence, true_views=None)).maps


def test_a_mono_truth_is_compared_with_grey(evidence):
    mono = replace(evidence, true_views=evidence.true_views[..., :1])
    assert len(collect_pictures(mono).maps["error"].pictures) == 8
