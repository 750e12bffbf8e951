"""Plain areas whose depth the measurement decides."""

from dataclasses import replace

import cv2
import numba
import numpy as np
import pytest

from gs2ci.reconstruct.geometry import plane_evidence, texture_kernels
from gs2ci.reconstruct.geometry.plane_evidence import FoundPlane, Readings, found_planes, with_plane
from gs2ci.reconstruct.geometry.sightlines import Sightlines
from gs2ci.reconstruct.geometry.sweep import plane_homographies
from gs2ci.reconstruct.geometry.texture_kernels import left_over, prediction_errors

SIZE = (72, 96)
VIEWS = 6
FOCAL = 100.0
INTRINSICS = np.array([[FOCAL, 0, SIZE[1] / 2], [0, FOCAL, SIZE[0] / 2], [0, 0, 1]])
REFERENCE = 3
EXTENT = 0.3
PARALLAX_PX = FOCAL * EXTENT
SPAN = (0.2, 1.4)
WALL = 0.6
WRONG = 1.0


def poses():
    """Aside, and turned a little, seen from the reference view."""
    found = np.tile(np.eye(4), (VIEWS, 1, 1))
    found[:, 0, 3] = -np.linspace(0, EXTENT, VIEWS)
    for pose, angle in zip(found, np.linspace(0, 0.05, VIEWS), strict=True):
        pose[:3, :3] = cv2.Rodrigues(np.array([0.0, angle, 0.0]))[0]
    return found @ np.linalg.inv(found[REFERENCE])


def wall(plane=(0.0, 0.0, WALL), texture=0.02, seed=0):
    """Views of a weakly textured plane, whose texture is wider than the picture."""
    rng = np.random.default_rng(seed)
    margin = 40
    height, width = (length + 2 * margin for length in SIZE)
    canvas = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 1.2)
    canvas = (0.5 + texture * canvas / canvas.std()).astype(np.float32)
    shift = np.array([[1, 0, margin], [0, 1, margin], [0, 0, 1.0]])
    seen = []
    for pose in poses():
        half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
        through = INTRINSICS @ (pose[:3, :3] + np.outer(pose[:3, 3], plane)) @ np.linalg.inv(INTRINSICS)
        array = np.linalg.inv(half) @ through @ half
        seen.append(cv2.warpPerspective(canvas, array @ np.linalg.inv(shift), SIZE[::-1]))
    return np.stack(seen)[..., None]


def readings(views, noise=0.01, seed=1):
    rng = np.random.default_rng(seed)
    masks = (rng.random((VIEWS, *SIZE)) < 0.4).astype(np.float32)
    light = (masks * views[..., 0]).sum(axis=0) + noise * rng.normal(size=SIZE)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    rays = np.stack([(columns - SIZE[1] / 2) / FOCAL, (rows - SIZE[0] / 2) / FOCAL], axis=-1).astype(np.float32)
    return Readings(light.astype(np.float32), masks, poses(), masks.any(axis=0), rays)


def ask(taken, inverse_depth, views=None, span=SPAN):
    # What a fit shows: nothing of the texture, which noise has drowned.
    shown = np.full((VIEWS, *SIZE, 1), 0.5, np.float32) if views is None else views
    return found_planes(taken, shown, poses()[REFERENCE], INTRINSICS, REFERENCE, inverse_depth, span, PARALLAX_PX)


def flat(depth):
    return np.full(SIZE, depth, np.float32)


@pytest.mark.parametrize("plane", [(0.0, 0.0, WALL), (0.15, -0.1, WALL)])
def test_a_wall_is_found_where_no_view_shows_its_texture(plane):
    found = ask(readings(wall(plane)), flat(WRONG))
    assert len(found) == 1
    assert found[0].errors > 8
    off = readings(wall()).rays @ (found[0].plane - plane)[:2] + (found[0].plane - plane)[2]
    assert np.abs(off * PARALLAX_PX).max() < 1.0
    assert found[0].where.mean() > 0.8


def test_of_a_large_area_the_middle_is_asked_for_the_plane(monkeypatch):
    monkeypatch.setattr(plane_evidence, "_MOST_READINGS", 2500)
    found = ask(readings(wall()), flat(WRONG))
    assert found[0].plane[2] == pytest.approx(WALL, abs=1.0 / PARALLAX_PX)
    assert found[0].where.mean() > 0.8


def test_what_suits_one_area_does_not_reach_the_next(monkeypatch):
    """The penalty is chosen for each area; the search of the next begins with the same as that of the first."""
    whole, began = plane_evidence._best_depth, []

    def watched(evidence, *arguments):
        began.append(evidence.smooth)
        return whole(evidence, *arguments)

    monkeypatch.setattr(plane_evidence, "_best_depth", watched)
    monkeypatch.setattr(plane_evidence, "_SMOOTH", (32.0,))
    both = readings(wall())
    usable = both.usable.copy()
    usable[:, 46:50] = False
    found = ask(replace(both, usable=usable), flat(WRONG))
    assert len(found) == 2
    assert len(began) >= 2
    assert set(began) == {plane_evidence._FIRST_SMOOTH}


def test_an_area_of_more_pixels_than_are_asked(monkeypatch):
    """A wall that fills 182 x 190 px."""
    size = (182, 190)
    assert size[0] * size[1] > 2**15
    middle = np.array([[FOCAL, 0, size[1] / 2], [0, FOCAL, size[0] / 2], [0, 0, 1]])
    monkeypatch.setitem(globals(), "SIZE", size)
    monkeypatch.setitem(globals(), "INTRINSICS", middle)
    found = ask(readings(wall()), flat(WRONG))
    assert found[0].plane[2] == pytest.approx(WALL, abs=1.0 / PARALLAX_PX)
    assert found[0].where.mean() > 0.8


def test_a_plane_at_the_end_of_the_range_is_none():
    assert ask(readings(wall()), flat(WRONG), span=(WALL + 0.05, 1.4)) == []


def test_a_map_that_is_right_stays():
    assert ask(readings(wall()), flat(WALL)) == []


@pytest.mark.parametrize("depth", [WALL, WRONG])
def test_noise_alone_says_nothing(depth):
    """However many planes are tried."""
    views = np.full((VIEWS, *SIZE, 1), 0.5, np.float32)
    assert [ask(readings(views, noise=0.02, seed=seed), flat(depth)) for seed in range(12)] == [[]] * 12


@pytest.mark.parametrize("smooth", [0.5, 2.0, 8.0])
def test_standard_errors_are_those_of_repeated_measurements(smooth):
    """Of what a plane gains over the map, and over no texture, in noise."""
    plane, grey = np.array([0.0, 0.0, WALL]), np.full((VIEWS, *SIZE, 1), 0.5, np.float32)
    gains, errors = [], []
    for seed in range(40):
        taken = readings(grey, noise=0.02, seed=seed)
        asked = plane_evidence._Asked.of(taken, taken.usable)
        evidence = plane_evidence.PlaneEvidence(taken, grey[0], poses()[REFERENCE], INTRINSICS)
        evidence.smooth = smooth
        on_plane = evidence.of_planes(asked, plane[None])[0]
        over = [one - on_plane for one in (evidence.of_map(asked, flat(WRONG)), evidence.without_texture(asked, plane))]
        gains.append([gain.mean() for gain in over])
        errors.append([gain.mean() / plane_evidence._errors(gain) for gain in over])
    ratio = np.std(gains, axis=0, ddof=1) / np.sqrt(np.mean(np.square(errors), axis=0))
    # Forty measurements know it to 11 %.
    assert ((ratio > 0.75) & (ratio < 1.25)).all()


def test_a_texture_a_fifth_as_strong_as_the_noise_is_enough():
    found = [ask(readings(wall(texture=0.002, seed=seed), seed=seed), flat(WRONG)) for seed in range(8)]
    assert sum(map(len, found)) >= 6
    for (one,) in filter(None, found):
        assert one.plane[2] == pytest.approx(WALL, abs=3.0 / PARALLAX_PX)


def test_where_another_surface_is_the_plane_is_not_believed():
    """The right quarter of the picture lies where the map says."""
    views, other = wall(), wall((0.0, 0.0, WRONG), seed=5)
    views[:, :, 72:] = other[:, :, 72:]
    found = ask(readings(views), flat(WRONG))
    assert len(found) >= 1
    assert found[0].where[:, :56].mean() > 0.8
    assert found[0].elsewhere[:, 80:].mean() > 0.6


def test_views_that_are_not_plain_are_not_asked():
    textured = np.random.default_rng(3).random((VIEWS, *SIZE, 1)).astype(np.float32)
    assert ask(readings(wall()), flat(WRONG), cv2.GaussianBlur(textured[..., 0].transpose(1, 2, 0), (0, 0), 2)
               .transpose(2, 0, 1)[..., None] * 4) == []  # fmt: skip


def test_pixels_that_may_not_be_looked_at_change_nothing():
    taken = readings(wall())
    hidden = np.random.default_rng(4).random(SIZE) < 0.05
    open_pixels = replace(taken, usable=taken.usable & ~hidden)
    spoilt = replace(open_pixels, light=np.where(hidden, 50.0, taken.light).astype(np.float32))
    one, other = ask(open_pixels, flat(WRONG)), ask(spoilt, flat(WRONG))
    assert [found.plane.tolist() for found in one] == [found.plane.tolist() for found in other]


def test_a_mosaic_is_asked_by_the_channel_that_each_pixel_sees():
    """A coloured wall: its channels differ by far more than its texture varies."""
    views, level = wall(), np.array([-0.2, 0.0, 0.2], np.float32)
    colours = views + level
    channels = np.indices(SIZE).sum(axis=0) % 3
    taken = readings(views)
    light = (taken.open_share * colours[:, np.arange(SIZE[0])[:, None], np.arange(SIZE[1]), channels]).sum(axis=0)
    shown = np.broadcast_to(0.5 + level, (VIEWS, *SIZE, 3)).astype(np.float32)
    found = ask(replace(taken, light=light, channels=channels), flat(WRONG), shown)
    assert len(found) == 1
    assert found[0].plane[2] == pytest.approx(WALL, abs=1.0 / PARALLAX_PX)


def entered(found, view, pose):
    views = np.broadcast_to(view, (3, *view.shape))
    return with_plane(flat(WRONG), views, found, poses()[:3], np.linalg.inv(pose), INTRINSICS)


def test_a_plane_is_entered_in_every_view_where_that_is_plain():
    where = np.zeros(SIZE, bool)
    where[20:50, 20:60] = True
    elsewhere = np.zeros(SIZE, bool)
    elsewhere[:, 62:] = True
    plane = np.array([0.1, 0.05, WALL])
    pose = poses()[0]
    changed = entered(FoundPlane(plane, where, elsewhere, 9.0), np.full((*SIZE, 1), 0.5, np.float32), pose)
    assert (changed[:, 62:] == WRONG).all()
    assert (changed[:3] == WRONG).all()
    # The plane's points in the reference view, seen from this one.
    rays = np.array([[-0.1, 0.05, 1.0], [0.0, 0.0, 1.0]])
    points = rays / (rays @ plane)[:, None] @ pose[:3, :3].T + pose[:3, 3]
    for point in points:
        column, row = ((INTRINSICS @ point)[:2] / point[2]).astype(int)
        assert changed[row, column] == pytest.approx(1 / point[2], abs=0.005)


def test_what_stands_before_a_plain_area_keeps_its_depth():
    """Just beyond the area the views show a stripe that agrees with the map, and not with the plane."""
    where = np.zeros(SIZE, bool)
    where[10:60, 10:40] = True
    views = wall((0.0, 0.0, WRONG), texture=0.01)[[3, 0, 5]]
    from_view = poses()[[3, 0, 5]]
    found = FoundPlane(np.array([0.0, 0, WALL]), where, np.zeros(SIZE, bool), 9.0)
    changed = with_plane(flat(WRONG), views, found, from_view, np.eye(4), INTRINSICS)
    assert (changed[12:58, 12:38] == np.float32(WALL)).mean() > 0.95
    assert (changed[12:58, 45:] == WRONG).mean() > 0.95


def test_no_plain_area_keeps_a_map():
    found = FoundPlane(np.array([0.0, 0, WALL]), np.zeros(SIZE, bool), np.zeros(SIZE, bool), 9.0)
    assert (entered(found, np.full((*SIZE, 1), 0.5, np.float32), np.eye(4)) == WRONG).all()


def evidence_of(taken):
    return plane_evidence.PlaneEvidence(taken, wall()[REFERENCE], poses()[REFERENCE], INTRINSICS)


def test_places_through_a_plane_are_those_of_its_homography():
    """The sweep's homographies, the other way round."""
    taken, plane = readings(wall()), np.array([0.0, 0.0, WALL])
    asked = plane_evidence._Asked.of(taken, taken.usable)
    lines, from_reference = asked.sightlines, poses() @ np.linalg.inv(poses()[REFERENCE])
    places = lines.on_planes(plane[None], from_reference, INTRINSICS)[0]
    forward = plane_homographies(poses(), INTRINSICS, np.array([WALL]))[0]
    again = np.einsum("eij,ej->ei", forward[lines.view], np.concatenate([places, np.ones((len(places), 1))], axis=1))
    reading = np.repeat(np.arange(len(asked.light)), np.diff(lines.begin))
    at = np.stack([asked.at[1], asked.at[0]], axis=1)[reading]
    assert np.abs(again[:, :2] / again[:, 2:] - at).max() < 1e-5
    # A map of that plane sends them to the same places.
    by_map = lines.on_map(flat(WALL), from_reference, INTRINSICS)[0]
    assert np.abs(by_map - places).max() < 1e-3


def test_lines_are_those_of_open_masks():
    taken = readings(wall())
    rows, columns = (at.astype(np.int64) for at in np.nonzero(taken.usable))
    lines = Sightlines.of(taken.open_share, rows, columns, np.ones((len(rows), 3)))
    whole = np.zeros((len(rows), VIEWS))
    whole[np.repeat(np.arange(len(rows)), np.diff(lines.begin)), lines.view] = lines.share
    assert (whole == taken.open_share[:, rows, columns].T).all()
    assert (lines.share != 0).all()


def some_readings(count=60, size=(7, 9), seed=0):
    """Places, [K, 3, 2], of which each reading sees some."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1, 1, (count, 3, 2)) * np.array([6, 5]) + np.array([4, 3])
    return places, (rng.random((count, 3)) < 0.6).astype(float), rng.normal(size=count), rng.random(count) < 0.7, size


def listed(places, open_share):
    """Places and transmissions along open lines, [E, 2] and [E], and where those of each reading begin, [K + 1]."""
    through = open_share != 0
    return places[through], open_share[through], np.concatenate([[0], np.cumsum(through.sum(axis=1))])


def matrix(places, open_share, size):
    found = np.zeros((len(places), size[0] * size[1]))
    for k in range(len(places)):
        for v in range(places.shape[1]):
            x, y = (np.clip(places[k, v, axis], 0, size[1 - axis] - 1) for axis in (0, 1))
            c, r = min(int(x), size[1] - 2), min(int(y), size[0] - 2)
            for dr in (0, 1):
                for dc in (0, 1):
                    share = (x - c if dc else 1 - x + c) * (y - r if dr else 1 - y + r)
                    found[k, (r + dr) * size[1] + c + dc] += open_share[k, v] * share
    return found


def by_least_squares(coded, light, seen, size, smooth):
    """What is left of readings by dense normal equations."""
    number = np.arange(size[0] * size[1]).reshape(size)
    pairs = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:])]
    rough = np.concatenate([
        np.eye(number.size)[one.ravel()] - np.eye(number.size)[other.ravel()] for one, other in pairs
    ])  # fmt: skip
    normal = coded[seen].T @ coded[seen] + smooth * rough.T @ rough
    return light - coded @ np.linalg.lstsq(normal, coded[seen].T @ light[seen], rcond=None)[0]


@numba.njit
def estimate(places, low, begin, share, light, seen, texture, smooth, iterations):
    return left_over(places, low, begin, share, light, seen, texture, smooth, iterations)


def left_by_kernel(places, open_share, light, seen, size, smooth, iterations=6):
    there, share, begin = listed(places, open_share)
    return estimate(there, np.zeros(2), begin, share, light, seen, np.zeros(size), smooth, iterations)


def test_what_is_left_is_that_of_least_squares():
    """To 1e-9 of the readings, once conjugate gradients have converged."""
    places, open_share, light, seen, size = some_readings()
    coded = matrix(places, open_share, size)
    left = left_by_kernel(places, open_share, light, seen, size, 0.5, iterations=300)
    assert np.abs(left - by_least_squares(coded, light, seen, size, 0.5)).max() < 1e-9


def test_each_fold_is_predicted_from_the_others_beside_what_is_known(monkeypatch):
    """Two surfaces with a penalty of their own, and two channels, to 1e-9; the last fold is not asked for."""
    monkeypatch.setattr(texture_kernels, "_ITERATIONS", 300)
    places, open_share, light, _, size = some_readings()
    rng = np.random.default_rng(1)
    slow = rng.random((2, *size)).astype(np.float32)
    channel, fold = rng.integers(0, 2, len(light)), rng.integers(0, 3, len(light))
    smooth = np.array([0.5, 2.0])
    surfaces = [places, places[::-1].copy()]
    there, share, begin = zip(*(listed(one, open_share) for one in surfaces), strict=True)
    lines = Sightlines(begin[0], np.zeros(len(share[0]), np.int64), share[0], np.ones((len(light), 3)))
    found = prediction_errors(np.stack(there), lines, light, slow, channel, fold, 2, smooth)
    known = [slow[c].astype(np.float64).ravel() for c in channel]
    for at, weight, errors in zip(surfaces, smooth, found, strict=True):
        # The texture covers all places, some of them beyond the known picture.
        seen_there = at[open_share != 0]
        low = np.floor(seen_there.min(axis=0)) - 1
        columns, rows = (np.ceil(seen_there.max(axis=0)) + 2 - low).astype(int)
        by_known = (matrix(at, open_share, size) * np.stack(known)).sum(axis=1)
        coded = matrix(at - low, open_share, (rows, columns))
        for out in (0, 1):
            expected = by_least_squares(coded, light - by_known, fold != out, (rows, columns), weight) ** 2
            assert np.abs(errors - expected)[fold == out].max() < 1e-9
        assert (errors[fold == 2] == 0).all()


def test_errors_have_the_same_bits_on_any_number_of_threads():
    taken = readings(wall())
    asked = plane_evidence._Asked.of(taken, taken.usable)
    planes = np.array([[0.0, 0.0, WALL], [0.1, -0.1, WRONG]])
    found, threads = [], numba.get_num_threads()
    try:
        for count in (1, threads):
            numba.set_num_threads(count)
            found.append(evidence_of(taken).of_planes(asked, planes))
    finally:
        numba.set_num_threads(threads)
    assert (found[0] == found[1]).all()


def test_of_nothing_that_is_seen_everything_is_left():
    places, open_share, light, seen, size = some_readings()
    assert (left_by_kernel(places, open_share, light, np.zeros_like(seen), size, 1.0) == light).all()
    dark = np.zeros_like(open_share)
    assert (left_by_kernel(places, dark, light, seen, size, 1.0) == light).all()


def test_readings_behind_closed_masks_alone_give_numbers():
    taken = readings(wall())
    dark = replace(taken, open_share=np.zeros_like(taken.open_share))
    asked = plane_evidence._Asked.of(dark, taken.usable)
    errors = evidence_of(dark).of_planes(asked, np.array([[0.0, 0.0, WALL]]))
    assert np.allclose(errors, asked.light**2)


def test_a_plane_that_is_seen_from_its_edge_gives_numbers():
    taken = readings(wall())
    asked = plane_evidence._Asked.of(taken, taken.usable)
    assert np.isfinite(evidence_of(taken).of_planes(asked, np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))).all()
