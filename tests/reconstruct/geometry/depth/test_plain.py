"""Skirts of plain areas, moved to the surface that they belong to."""

import numba
import numpy as np
import pytest

from gs2ci.reconstruct.geometry.depth.plain import continued, plain_pixels, plane_slopes, plane_votes

SIZE = (72, 96)
FOCAL = 90.0
INTRINSICS = np.array([[FOCAL, 0, 48], [0, FOCAL, 36], [0, 0, 1.0]])
BLUR_PX, WINDOW_PX = 0.5, 5
NEAR = 0.8
# The thing stands at columns 40 to 60; its skirt is the plain wall on its right, up to column 68. Its middle is plain,
# and within the thing's reach no longer.
THING, SKIRT, MIDDLE = np.s_[:, 40:60], np.s_[:, 60:68], np.s_[:, 64:67]


def poses(count: int = 4) -> np.ndarray:
    """Return poses that travel to the right, the first at the origin, [N, 4, 4]."""
    found = np.repeat(np.eye(4)[None], count, axis=0)
    found[:, 0, 3] = -0.08 * np.arange(count)
    return found


def wall(lean: float) -> np.ndarray:
    """Return the inverse depth of a wall, whose right side is nearer by `lean` per column, [H, W] float32."""
    return np.tile((0.3 + lean * np.arange(SIZE[1])).astype(np.float32), (SIZE[0], 1))


def seen(texture: float = 0.0) -> np.ndarray:
    """Show a light thing before a dark, plain wall from every pose, with a little noise, [N, H, W, 3] float32.

    `texture` is the amplitude of a picture in the skirt that moves as the thing does.
    """
    rng = np.random.default_rng(1)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    views = []
    for pose in poses():
        # A column of the first view that shows the same place of something at the thing's depth.
        first = columns - FOCAL * pose[0, 3] * NEAR
        view = np.full((*SIZE, 3), 0.3)
        band = (first >= 60) & (first < 68)
        view[band] += texture * (np.sin(0.9 * first) * np.sin(0.7 * rows))[band][:, None]
        inside = np.abs(first - 50) < 10
        view[inside] = 0.7 + 0.2 * np.sin(0.8 * rows[inside])[:, None]
        views.append(view + rng.normal(0, 1e-3, view.shape))
    return np.stack(views).astype(np.float32)


def with_skirt(lean: float = 0.0) -> np.ndarray:
    found = wall(lean)
    found[THING] = found[SKIRT] = NEAR
    return found


@pytest.mark.parametrize("lean", [0.0, 1.5e-3])
def test_a_skirt_gets_the_wall_that_it_is_part_of(lean):
    found = continued(with_skirt(lean), seen(), poses(), INTRINSICS, BLUR_PX, WINDOW_PX)
    off = np.abs(found - wall(lean))
    assert np.mean(off[MIDDLE] < 0.03) > 0.9
    assert (found[THING] == NEAR).all()
    assert np.array_equal(found[:, 80:], wall(lean)[:, 80:])


def test_a_map_without_skirts_stays():
    right = wall(1e-3)
    right[THING] = NEAR
    assert np.array_equal(continued(right, seen(), poses(), INTRINSICS, BLUR_PX, WINDOW_PX), right)


def test_views_that_contradict_are_believed():
    # Plain enough, but what little there is to see moves with the thing.
    views = seen(texture=0.025)
    assert plain_pixels(views[0])[MIDDLE].all()
    found = continued(with_skirt(), views, poses(), INTRINSICS, BLUR_PX, WINDOW_PX)
    assert np.mean(found[MIDDLE] == NEAR) > 0.8


def test_what_is_not_plain_is_left_alone():
    rng = np.random.default_rng(0)
    views = np.clip(seen() + rng.normal(0, 0.05, (4, *SIZE, 3)), 0, 1).astype(np.float32)
    assert not plain_pixels(views[0]).any()
    found = continued(with_skirt(), views, poses(), INTRINSICS, BLUR_PX, WINDOW_PX)
    assert np.array_equal(found, with_skirt())


def test_one_depth_everywhere_stays():
    flat = np.full(SIZE, 0.4, np.float32)
    assert np.array_equal(continued(flat, seen(), poses(), INTRINSICS, BLUR_PX, WINDOW_PX), flat)


@pytest.mark.parametrize("shape", [(2, 2), (1, 5), (5, 1)])
def test_small_pictures_stay_finite(shape):
    depth = np.linspace(0.2, 0.9, shape[0] * shape[1], dtype=np.float32).reshape(shape)
    views = np.full((2, *shape, 1), 0.5, np.float32)
    found = continued(depth, views, poses(2), INTRINSICS, BLUR_PX, 1)
    assert np.isfinite(found).all()
    assert ((found >= depth.min()) & (found <= depth.max())).all()


def test_large_pictures_are_asked_when_reduced(monkeypatch):
    monkeypatch.setattr("gs2ci.reconstruct.geometry.depth.plain._MOST_PIXELS", SIZE[0] * SIZE[1] // 4)
    found = continued(with_skirt(), seen(), poses(), INTRINSICS, BLUR_PX, WINDOW_PX)
    assert np.mean(np.abs(found - wall(0.0))[MIDDLE] < 0.05) > 0.8
    assert (found[THING] == NEAR).all()


def likeness(view, r, c, i, j, sigma):
    return (1 + ((view[i, j].astype(np.float64) - view[r, c]) ** 2).sum(axis=-1) / (8 * sigma**2)) ** -4


def slopes_by_definition(depth, view, plain, gate):
    """Fit d = a + g.(x, y) by weighted least squares, the slope damped by 2 px squared, in float64."""
    found = np.zeros((2, *depth.shape))
    for r, c in np.argwhere(plain):
        i, j = np.meshgrid(
            np.arange(r - min(8, r) // 4 * 4, min(r + 9, depth.shape[0]), 4),
            np.arange(c - min(8, c) // 4 * 4, min(c + 9, depth.shape[1]), 4),
            indexing="ij",
        )
        change = depth[i, j].astype(np.float64) - depth[r, c]
        weight = np.where(np.abs(depth[i, j] - depth[r, c]) > gate, 0, likeness(view, r, c, i, j, 0.1)).ravel()
        x = np.stack([(j - c).ravel(), (i - r).ravel()], axis=1).astype(np.float64)
        apart = x - np.average(x, axis=0, weights=weight)
        off = change.ravel() - np.average(change.ravel(), weights=weight)
        found[:, r, c] = np.linalg.solve((apart.T * weight) @ apart + 2 * np.eye(2), (apart.T * weight) @ off)
    return found


def votes_by_definition(depth, slopes, view, voting, asked, reach, span):
    """Return the weighted median of what is said, in float64; NaN where rounding may decide."""
    found = depth.astype(np.float64)
    for r, c in np.argwhere(asked):
        said, weight = [], []
        for i, j in np.argwhere(voting):
            if (i - r) % 2 or (j - c) % 2 or max(abs(i - r), abs(j - c)) > reach:
                continue
            alike = float(likeness(view, r, c, i, j, 0.03))
            if alike >= 1e-4:
                said.append(depth[i, j] + slopes[0, i, j] * (c - j) + slopes[1, i, j] * (r - i))
                weight.append(alike)
        cells = np.clip((np.array(said) - span[0]) / ((span[1] - span[0]) / 255) + 0.5, 0, 255)
        level = cells.astype(int)
        sums = np.bincount(level, weight, minlength=256)
        reached = np.cumsum(sums) / sums.sum()
        median = int(np.argmax(reached >= 0.5))
        same = level == median
        found[r, c] = np.clip(np.average(np.array(said)[same], weights=np.array(weight)[same]), *span)
        if np.abs(reached - 0.5).min() < 1e-4 or np.abs(cells - np.rint(cells)).min() < 1e-3:
            found[r, c] = np.nan
    return found


@pytest.mark.parametrize(("size", "channels"), [((22, 30), 3), ((3, 40), 1)])
def test_the_kernels_do_what_the_definitions_say(size, channels):
    rng = np.random.default_rng(size[1])
    view = (0.3 + 0.05 * rng.random((*size, channels))).astype(np.float32)
    depth = np.where(np.add.outer(np.arange(size[0]), np.arange(size[1])) % 17 < 8, 0.3, 0.8)
    depth = (depth + 2e-3 * np.arange(size[1]) + rng.normal(0, 2e-3, size)).astype(np.float32)
    plain, asked = rng.random(size) < 0.8, rng.random(size) < 0.5
    asked &= plain
    gate = np.float32(0.03)
    slopes = plane_slopes(depth, view, plain, gate)
    wanted = slopes_by_definition(depth, view, plain, gate)
    np.testing.assert_allclose(slopes, wanted, rtol=1e-4, atol=1e-6)
    span = (float(depth.min()), float(depth.max()))
    votes = plane_votes(depth, slopes, view, (plain, asked), 10, span)
    wanted = votes_by_definition(depth, slopes, view, plain, asked, 10, span)
    sure = np.isfinite(wanted)
    assert sure[asked].mean() > 0.6
    assert (np.abs(wanted - depth)[sure] > 0.2).any()
    np.testing.assert_allclose(votes[sure], wanted[sure], rtol=1e-4)


def test_a_map_does_not_depend_on_the_number_of_threads():
    before = numba.get_num_threads()
    try:
        found = []
        for threads in sorted({1, before}):
            numba.set_num_threads(threads)
            found.append(continued(with_skirt(), seen(), poses(), INTRINSICS, BLUR_PX, WINDOW_PX))
    finally:
        numba.set_num_threads(before)
    assert all(np.array_equal(one, found[0]) for one in found)
