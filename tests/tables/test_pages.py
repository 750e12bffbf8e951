"""Means, spreads and the three files."""

import csv
from dataclasses import replace

import cv2
import pytest

from gs2ci.core.errors import StorageError
from tests.tables.catalogue import Table, TableEntry
from tests.tables.cells import Cell
from tests.tables.columns import Measure
from tests.tables.making import TableMade
from tests.tables.pages import as_csv, collect, draw, markdown, write_pages

TABLE = Table(
    "Title",
    "About.",
    lambda _options: [],
    (Measure("psnr_db", "PSNR, dB", 2), Measure("seconds", "s", 0, more_is_better=False)),
)
CELL = Cell(dict, {})
ENTRIES = [TableEntry("one", line, CELL) for line in ("default", "default", "other", "broken")]
ROWS = [
    {"psnr_db": 30.0, "seconds": 10.0},
    {"psnr_db": 31.0, "seconds": 12.0},
    {"psnr_db": 29.0, "seconds": None},
    {"error": "no depth"},
]


@pytest.fixture
def figures():
    return collect(TABLE, ENTRIES, ROWS)


def test_seeds_share_a_line_with_mean_and_sample_standard_deviation(figures):
    assert [one.line for one in figures] == ["default", "other", "broken"]
    assert figures[0].means == (30.5, 11.0)
    assert figures[0].spreads[0] == pytest.approx(0.5**0.5)
    assert figures[1].spreads == (None, None)


def test_what_failed_or_is_unknown_has_no_figure_and_its_reason_is_told(figures):
    assert figures[1].means == (29.0, None)
    assert figures[2].means == (None, None)
    assert figures[2].errors == ("no depth",)
    text = markdown(TABLE, figures, "python -m tests.tables x")
    assert "broken: no depth" in text
    assert "| broken | – | – |" in text


def test_a_result_that_is_inside_out_has_failed_however_good_its_views():
    entries = [TableEntry("one", "default", CELL)] * 2
    rows = [
        {"psnr_db": 30.0, "seconds": 9.0, "failure": ""},
        {"psnr_db": 40.0, "seconds": 9.0, "failure": "inside out"},
    ]
    (one,) = collect(TABLE, entries, rows)
    assert (one.means[0], one.count, one.errors) == (30.0, 1, ("inside out",))


def test_markdown_marks_the_best_and_names_the_command(figures):
    text = markdown(TABLE, figures, "python -m tests.tables x")
    assert "`python -m tests.tables x`" in text
    assert "| default | **30.50** ± 0.71 | 11 ± 1 |" in text
    assert "| other | 29.00 | – |" in text


def test_less_is_better_where_the_measure_says_so():
    entries = [TableEntry("one", line, CELL) for line in ("slow", "fast")]
    figures = collect(TABLE, entries, [{"psnr_db": 1.0, "seconds": 9.0}, {"psnr_db": 2.0, "seconds": 3.0}])
    assert "| fast | **2.00** | **3** |" in markdown(TABLE, figures, "")


def test_csv_holds_all_digits(figures):
    rows = list(csv.DictReader(as_csv(TABLE, figures).splitlines()))
    assert rows[0]["psnr_db"] == "30.5"
    assert float(rows[0]["psnr_db_sd"]) == pytest.approx(0.5**0.5)
    assert (rows[2]["cells"], rows[2]["psnr_db"], rows[2]["errors"]) == ("0", "", "no depth")


def test_csv_and_records_tell_of_how_many_cells_each_mean_is():
    rows = [{"psnr_db": 29.0, "seconds": 9.0}, {"psnr_db": None, "seconds": 8.0}, {"error": "no depth"}]
    figures = collect(TABLE, [TableEntry("one", "mixed", CELL)] * 3, rows)
    (line,) = csv.DictReader(as_csv(TABLE, figures).splitlines())
    assert (line["cells"], line["psnr_db_n"], line["seconds_n"]) == ("2", "1", "2")
    (record,) = TableMade(("psnr_db", "seconds"), figures, "", []).records()
    assert (record["count"], record["known"]) == (2, {"psnr_db": 1, "seconds": 2})


def test_of_figures_that_nobody_counted_no_number_is_told(figures):
    uncounted = [replace(one, known=()) for one in figures]
    rows = list(csv.DictReader(as_csv(TABLE, uncounted).splitlines()))
    assert [row["psnr_db_n"] for row in rows] == ["", "", ""]
    assert TableMade(("psnr_db", "seconds"), uncounted, "", []).records()[0]["known"] == {}


def test_three_files_are_written(figures, tmp_path):
    paths = write_pages(tmp_path / "bench", "x", TABLE, figures, "python -m tests.tables x")
    assert [path.name for path in paths] == ["x.md", "x.csv", "x.png"]
    assert cv2.imread(str(paths[2])) is not None


def test_the_picture_shows_the_first_line_on_top_and_cuts_no_point(figures):
    low, high = draw(TABLE, figures).axes[0].get_ylim()
    assert (low, high) == (1.5, -0.5)


def test_reasons_are_told_each_on_a_line_of_its_own():
    entries = [TableEntry("one", line, CELL) for line in ("16 views", "32 views")]
    text = markdown(TABLE, collect(TABLE, entries, [{"error": "holds 8"}, {"error": "holds 8"}]), "")
    assert "\n\n- 16 views: holds 8\n- 32 views: holds 8\n" in text


def test_a_mean_of_fewer_seeds_than_its_neighbours_says_so():
    entries = [TableEntry("one", "still", CELL)] * 2 + [TableEntry("one", "mixed", CELL)] * 3
    rows = [{"psnr_db": 30.0, "seconds": 9.0}] * 2
    rows += [{"psnr_db": 29.0, "seconds": 9.0}, {"psnr_db": None, "seconds": 9.0}, {"error": "no depth"}]
    text = markdown(TABLE, collect(TABLE, entries, rows), "")
    assert text.endswith("\n\n- mixed: no depth\n- mixed: means of fewer cells (PSNR, dB: 1 of 2)\n")
    assert "still: means" not in text
    # A column without any figure has a dash, and needs no words.
    assert "means of" not in markdown(TABLE, collect(TABLE, entries[:1], [{"psnr_db": None, "seconds": 9.0}]), "")


def test_cases_are_one_blank_line_apart():
    entries = [TableEntry(case, "default", CELL) for case in ("one", "two")]
    assert "\n\n\n" not in markdown(TABLE, collect(TABLE, entries, [{"psnr_db": 1.0, "seconds": 9.0}] * 2), "")


def test_a_folder_that_cannot_be_made_is_a_clear_error(figures, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot be written"):
        write_pages(tmp_path / "file", "x", TABLE, figures, "python -m tests.tables x")


def test_a_table_against_an_axis_is_drawn_even_where_every_cell_failed(tmp_path):
    table = replace(TABLE, axis="tolerance, DN")
    entries = [TableEntry("one", line, CELL) for line in ("everything", "0.5 DN")]
    figures = collect(table, entries, [{"error": "no rig"}] * 2)
    pages = write_pages(tmp_path, "table", table, figures, "python -m tests.tables x")
    assert all(page.stat().st_size for page in pages)
