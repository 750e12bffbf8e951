import csv
import io
import json
from dataclasses import replace

import pytest

from gs2ci.evaluate.design.pages import Design, DesignRow, as_csv, markdown, picture, record, unbeaten


@pytest.fixture
def design():
    rows = (
        DesignRow(8, 0.25, 1, 2.0, 1, 0.02, 1.0, 30.0, 31.0, 33.0, 36.0, 40.0, 41.0, 0.01, 30.5, 2, 32.0, unbeaten=True,
                  chosen=True),
        DesignRow(16, 0.25, 1, 2.0, 1, 0.01, 1.5, 60.0, 28.0, 29.0, 36.0, 40.0, 41.0, 0.0),
        DesignRow(2000, 0.25, 1, 2.0, 1, left_out="masks is 2000, allowed: at most 400"),
    )  # fmt: skip
    return Design("bench", "boxes", (72, 96), "draft", rows, "designed.toml", ("gs2ci capture",), "gs2ci design")


def test_the_table_has_every_candidate_with_all_digits(design):
    rows = list(csv.DictReader(io.StringIO(as_csv(design))))
    assert [row["masks"] for row in rows] == ["8", "16", "2000"]
    assert rows[0]["checked_db"] == "30.5"
    assert rows[2]["left_out"] == "masks is 2000, allowed: at most 400"


def test_the_record_is_whole(design):
    known = json.loads(record(design))
    assert known["scene"] == "boxes"
    assert known["rows"][1]["checked_db"] is None
    assert known["command"] == "gs2ci design"


def test_words_say_what_was_chosen_what_it_takes_and_why_others_were_left_out(design):
    said = markdown(design)
    assert "Chosen: 1 × 8 masks, 25 % open, 1 px, 2 mm: 30.5 dB as checked" in said
    assert "2 candidates were judged by what their coding tells, 2 reconstructions" in said
    assert "1 left out: masks is 2000, allowed: at most 400." in said
    assert "| **1 × 8 masks, 25 % open, 1 px, 2 mm** | 31.00 | 30.50 | 1.0 s | 30 s | 1.0 % |" in said


@pytest.mark.parametrize(
    ("checks", "words"), [(0, "tells, and none by a reconstruction."), (1, "tells, 1 reconstruction with the preset")]
)
def test_words_count_the_checks(design, checks, words):
    rows = tuple(replace(row, checks=checks * (row is design.rows[0])) for row in design.rows)
    assert words in markdown(replace(design, rows=rows))


def test_those_that_were_checked_come_first(design):
    assert [row.masks for row in design.ranked] == [8, 16]


def test_the_picture_is_a_png_with_a_panel_for_each_time_that_is_known(design):
    both = picture(design)
    untimed = replace(design, rows=tuple(replace(row, computing_s=None) for row in design.rows))
    widths = [int.from_bytes(made[16:20], "big") for made in (picture(untimed), both)]
    assert both.startswith(b"\x89PNG")
    assert widths[0] < widths[1]


def test_the_front_is_what_nothing_beats_in_both_times_and_quality():
    assert unbeaten([(1, 1, 30), (2, 1, 30), (2, 2, 31), (1, 1, 30), (3, 1, 29)]) == [True, False, True, False, False]
    assert unbeaten([]) == []
