import csv
import io
import re
from dataclasses import replace

import pytest

from gs2ci.core.errors import StorageError
from gs2ci.evaluate.tradeoff.pages import COLUMNS, Tradeoff, as_csv, markdown, write_pages


def row(trial, knob, seconds, psnr_db, **more):
    found = {"trial": trial, "knob": knob, "seconds": seconds, "psnr_db": psnr_db, "ssim": 0.9, "nate": None}
    return {**found, "heldout_db": 20.0, "iterations": 5, "gaussians": 7, **more}


FOUND = Tradeoff(
    "a shot",
    (
        row("decode", "preset", 1.0, 24.0),
        row("standard", "preset", 60.0, 31.0),
        row("100 iterations", "iterations", 70.0, 28.0),
        {"trial": "half the resolution", "knob": "resolution", "error": "too small"},
    ),
    {"paper": 7200.0},
    "gs2ci tradeoff shot.h5",
)


def test_the_section_says_prices_failures_and_omissions_and_marks_the_front():
    text = markdown(FOUND)
    assert "half the resolution failed: too small" in text
    assert "paper was left out: it would take about 2 h 00 min." in text
    assert "| **standard** | 60.0 | 31.00 | 0.9000 | – | 20.00 | 5 | 7 |" in text
    assert "| 100 iterations | 70.0 |" in text
    assert "`gs2ci tradeoff shot.h5`; " in text


def test_a_trade_off_from_python_names_no_command():
    text = markdown(replace(FOUND, command=""))
    assert "`" not in text
    assert re.search(r"^[^;]+, \d+ cores, gs2ci \S+\.$", text, re.MULTILINE)


def test_the_csv_has_a_line_for_each_trial_failed_ones_included():
    rows = list(csv.DictReader(io.StringIO(as_csv(FOUND.rows))))
    assert tuple(rows[0]) == COLUMNS
    assert [one["trial"] for one in rows] == ["decode", "standard", "100 iterations", "half the resolution"]
    assert rows[3]["error"] == "too small"


@pytest.mark.parametrize("rows", [(), FOUND.rows[3:], ({**FOUND.rows[0], "psnr_db": None, "heldout_db": None},)])
def test_nothing_to_compare_is_told_as_nothing(rows, tmp_path):
    found = Tradeoff("a shot", rows)
    assert all(page.stat().st_size for page in write_pages(tmp_path, found))


def test_a_folder_that_cannot_be_made_is_a_clear_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot be written"):
        write_pages(tmp_path / "file", FOUND)
