"""Tables in a terminal: no cell is cut off, however narrow it is."""

from pathlib import Path

import pytest

from gs2ci.commands.printed_pages import print_pages, split_tables

MEASURES = [f"measure {number}" for number in range(9)]
CELLS = [f"**{number}8.42** ± 0.32" for number in range(9)]
TABLE = "\n".join(
    ("## boxes", "", "| | " + " | ".join(MEASURES) + " |", "|---|" + "---:|" * 9, "| one | " + " | ".join(CELLS) + " |")
)


@pytest.mark.parametrize("width", [30, 80, 100, 200])
def test_every_cell_is_printed_whole(width, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(width))
    print_pages(TABLE, [Path("one.csv")])
    printed = capsys.readouterr().out
    assert all(measure in printed for measure in MEASURES)
    assert all(cell.replace("**", "") in printed for cell in CELLS)
    assert "one.csv" in printed
    assert max(map(len, printed.splitlines())) <= width


def test_brackets_in_a_path_are_no_markup(capsys):
    print_pages("", [Path("costs[draft]/t.csv"), Path("costs[/x]/t.csv")])
    assert capsys.readouterr().out.split() == ["costs[draft]/t.csv", "costs[/x]/t.csv"]


def test_a_table_that_fits_stays_one():
    fitted = split_tables(TABLE, 200)
    assert fitted.replace(" ", "") == TABLE.replace(" ", "")


def test_each_part_of_a_table_repeats_the_first_column():
    parts = split_tables(TABLE, 40).split("\n\n")[1:]
    assert [part.splitlines()[2].split(" | ")[0] for part in parts] == ["| one"] * 5
