import re

import numpy as np
import pytest

from gs2ci.evaluate.pages.camera_path import Paths, path_svg


def poses(centers):
    found = np.tile(np.eye(4), (len(centers), 1, 1))
    found[:, :3, 3] = -np.asarray(centers, float)
    return found


LINE = poses([[0, 0, 0], [1, 0, 0.1], [2, 0, 0], [3, 0, 0.3]])


def marks(svg):
    return {
        colour: [(float(x), float(y)) for c, x, y in found if c == colour]
        for found in [re.findall(r'<circle class="mark (\w+)" cx="([^"]*)" cy="([^"]*)"', svg)]
        for colour in {c for c, _, _ in found}
    }


def similar(path, scale=2.5):
    """The same path seen from another frame and in another unit."""
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    moved = path.copy()
    centers = -np.einsum("nji,nj->ni", path[:, :3, :3], path[:, :3, 3])
    moved[:, :3, :3] = path[:, :3, :3] @ turn.T
    moved[:, :3, 3] = -np.einsum("nij,nj->ni", moved[:, :3, :3], scale * centers @ turn.T + [5, 6, 7])
    return moved


def test_a_path_in_another_frame_and_unit_lies_on_the_true_one():
    drawn = marks(path_svg(Paths(similar(LINE), true=LINE), 760, unit="m"))
    np.testing.assert_allclose(drawn["accent"], drawn["truth"], atol=0.05)


def test_without_truth_the_stage_is_what_it_is_brought_onto():
    drawn = marks(path_svg(Paths(similar(LINE), stage=LINE), 760, unit="mm"))
    np.testing.assert_allclose(drawn["accent"], drawn["third"], atol=0.05)


def test_right_is_right_and_ahead_is_up():
    (x0, y0), *_, (x3, y3) = marks(path_svg(Paths(LINE), 760, unit="u"))["accent"]
    assert x3 > x0
    assert y3 < y0


def test_both_axes_have_one_scale_and_everything_is_inside():
    for width in (340, 760):
        svg = path_svg(Paths(LINE), width, unit="u")
        spots = np.array(marks(svg)["accent"])
        (dx, dy), height = spots[3] - spots[0], float(re.search(r'viewBox="0 0 \S+ (\S+)"', svg)[1])
        assert dx / -dy == pytest.approx(10, rel=0.01)
        assert (spots > 0).all()
        assert (spots < [width, height]).all()


def test_the_ruler_is_as_long_as_it_says():
    svg = path_svg(Paths(LINE), 760, unit="mm")
    spots = np.array(marks(svg)["accent"])
    length, number = float(re.search(r"v5h([\d.]+)v-5", svg)[1]), float(re.search(r">([\d.]+) mm<", svg)[1])
    assert length / number == pytest.approx((spots[3] - spots[0])[0] / 3, rel=0.01)


@pytest.mark.parametrize(
    "path",
    [
        poses([[0, 0, 0]]),
        poses([[1, 1, 1]] * 4),
        poses([[0, 0, z] for z in range(5)]),
        poses([[1e-9 * i, 0, 0] for i in range(3)]),
    ],
    ids=["one view", "standing still", "forward", "tiny"],
)
def test_degenerate_paths_are_drawn(path):
    spots = np.array(marks(path_svg(Paths(path, true=path), 340, unit="u"))["accent"])
    assert len(spots) == len(path)
    assert np.isfinite(spots).all()


def test_many_cameras_have_few_wedges():
    svg = path_svg(Paths(poses([[0.1 * i, 0, 0] for i in range(100)])), 760, unit="u")
    assert svg.count('class="wedge') == 12
    assert len(marks(svg)["accent"]) == 100
