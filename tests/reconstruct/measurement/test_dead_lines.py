from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.findings import Code, finding
from gs2ci.reconstruct.measurement.coding import without_pixels
from gs2ci.reconstruct.measurement.faulty import close_dead_lines


def with_lines(shot, rows=(), columns=(), reading=0.0):
    measurement = shot.measurement.copy()
    measurement[list(rows)] = reading
    measurement[:, list(columns)] = reading
    return replace(shot, measurement=measurement)


def test_a_sound_measurement_is_left_alone(smooth_shot):
    assert close_dead_lines(smooth_shot) == (smooth_shot, ())


@pytest.mark.parametrize("reading", [0.0, 1.0])
def test_dead_rows_and_columns_are_closed_and_named(smooth_shot, reading):
    closed, notes = close_dead_lines(with_lines(smooth_shot, (5, 9, 10), (20,), reading))
    dead = np.zeros(smooth_shot.size, bool)
    dead[[5, 9, 10]], dead[:, 20] = True, True
    np.testing.assert_array_equal(closed.masks, smooth_shot.masks * ~dead)
    assert (closed.measurement[dead] == 0).all()
    np.testing.assert_array_equal(closed.measurement[~dead], smooth_shot.measurement[~dead])
    assert notes == (
        finding(Code.DEAD_LINES, count=3, of=32, lines="rows", first=5),
        finding(Code.DEAD_LINES, count=1, of=40, lines="columns", first=20),
    )


@pytest.mark.parametrize("row_is_read_last", [False, True])
def test_dead_lines_that_cross_and_read_different_values_are_all_found(smooth_shot, row_is_read_last):
    measurement = smooth_shot.measurement.copy()
    measurement[9] = 0.0
    measurement[:, 20] = 1.7
    measurement[9, 20] = 0.0 if row_is_read_last else 1.7
    closed, notes = close_dead_lines(replace(smooth_shot, measurement=measurement))
    assert [(note.figures["lines"], note.figures["first"]) for note in notes] == [("rows", 9), ("columns", 20)]
    assert not closed.masks[:, 9].any()
    assert not closed.masks[:, :, 20].any()


@pytest.mark.parametrize("known", ["closed", "saturated"])
def test_a_dead_line_with_a_pixel_that_is_known_to_be_bad_is_found(smooth_shot, known):
    shot, bad = with_lines(smooth_shot, columns=(20,), reading=1.7), np.zeros(smooth_shot.size, bool)
    bad[5, 20] = True
    shot.measurement[bad] = 2.5
    marked = without_pixels(shot, bad) if known == "closed" else replace(shot, saturated=bad)
    (note,) = close_dead_lines(marked)[1]
    assert (note.code, note.figures["lines"], note.figures["first"]) == (Code.DEAD_LINES, "columns", 20)


def test_black_bars_along_the_border_are_told_and_kept(smooth_shot):
    shot = with_lines(smooth_shot, (0, 1, 30, 31))
    kept, notes = close_dead_lines(shot)
    assert kept is shot
    assert notes == (finding(Code.STUCK_BORDER_LINES, count=4, of=32, lines="rows", first=0),)


def test_a_constant_measurement_has_no_dead_lines(smooth_shot):
    shot = replace(smooth_shot, measurement=np.full_like(smooth_shot.measurement, 0.5))
    assert close_dead_lines(shot) == (shot, ())


def test_clipped_rows_are_not_dead(smooth_shot):
    shot = with_lines(smooth_shot, (7,), reading=2.0)
    saturated = np.zeros(shot.size, bool)
    saturated[7] = True
    assert close_dead_lines(replace(shot, saturated=saturated))[1] == ()


def test_rows_where_no_mask_opens_are_not_dead(smooth_shot):
    shot = with_lines(smooth_shot, (7,))
    masks = shot.masks.copy()
    masks[:, 7] = 0
    assert close_dead_lines(replace(shot, masks=masks))[1] == ()


def test_lines_of_few_pixels_are_never_dead(smooth_shot):
    narrow = replace(smooth_shot, measurement=smooth_shot.measurement[:, :4], masks=smooth_shot.masks[:, :, :4])
    assert close_dead_lines(with_lines(narrow, (7,)))[1] == ()


def test_bars_that_meet_no_live_line_are_kept(smooth_shot):
    """Every row reads one value, each its own."""
    measurement = np.broadcast_to(np.arange(32, dtype=np.float32)[:, None, None], smooth_shot.measurement.shape)
    shot = replace(smooth_shot, measurement=measurement)
    assert close_dead_lines(shot)[0] is shot
