"""A table that a click sorts, in a real browser; skipped where there is none."""

import pytest

from gs2ci.evaluate.pages.frame import PageSection, page
from gs2ci.evaluate.pages.pictures import Picture
from gs2ci.evaluate.pages.pieces import MOST_SORTABLE, SortableCell, facts, sortable_table

ROWS = [("b-10", 9.5), ("a-2", None), ("b-9", 31.25), ("a-1", 100.0)]
NAMES = "[...document.querySelectorAll('tbody tr')].map(row => row.cells[1].textContent)"


@pytest.fixture
def opened(tab, tmp_path):
    picture = Picture(b"\x89PNG\r\n\x1a\n", "image/png", 4, 3)
    cells = [
        [
            SortableCell("", picture=picture, link=f"{name}/report.html"),
            SortableCell(name, link=f"{name}/report.html"),
            SortableCell("–") if value is None else SortableCell(f"{value:.2f}", number=value),
        ]
        for name, value in ROWS
    ]
    path = tmp_path / "index.html"
    path.write_text(page("Runs", [PageSection("All", sortable_table(["", "run", "PSNR"], cells))]))
    return tab.open(path, 400)


def click(tab, column):
    tab.run(f"document.querySelectorAll('thead th')[{column}].querySelector('button').click()")
    return tab.run(NAMES)


def test_a_click_sorts_by_numbers_and_what_has_none_stays_last(opened):
    assert click(opened, 2) == ["b-10", "b-9", "a-1", "a-2"]
    assert click(opened, 2) == ["a-1", "b-9", "b-10", "a-2"]


def test_names_are_sorted_as_people_count(opened):
    assert click(opened, 1) == ["a-1", "a-2", "b-9", "b-10"]
    assert opened.run("document.querySelectorAll('th')[1].getAttribute('aria-sort')") == "ascending"


def test_a_column_without_a_heading_cannot_be_sorted_by(opened):
    assert opened.run("document.querySelectorAll('thead th')[0].querySelector('button')") is None


def test_every_row_leads_to_its_run(opened):
    links = opened.run("[...document.querySelectorAll('tbody a')].map(link => link.getAttribute('href'))")
    assert links == [f"{name}/report.html" for name, _ in ROWS for _ in range(2)]


def test_a_page_says_what_it_leaves_out():
    text = sortable_table(["run"], [[SortableCell("x")]] * (MOST_SORTABLE + 3))
    assert "3 more are left out" in text


def test_a_strangers_name_stays_text():
    text = sortable_table(["run"], [[SortableCell("<script>alert(1)</script>")]])
    assert "<script>" not in text


def test_all_figures_of_many_runs_fit_a_screen_and_a_short_value_stays_whole(tab, tmp_path):
    headings = ["", "run", "state", "PSNR, dB", "SSIM", "nATE", "held-out rms", "residual rms", "doubts", "views"]
    figures = [SortableCell(f"{value:.4f}", number=value) for value in (26.3, 0.87, 0.01, 0.05, 0.02, 4, 8, 1245, 72.5)]
    words = [SortableCell("", picture=Picture(b"\x89PNG\r\n\x1a\n", "image/png", 64, 48)), *map(SortableCell, "ab")]
    runs = sortable_table([*headings, "Gaussians", "seconds"], [[*words, *figures]])
    told = facts({"standard error of the cameras' rotations against each other, the largest of all of them": "0.11°"})
    path = tmp_path / "page.html"
    path.write_text(page("Runs", [PageSection("All", runs), PageSection("Facts", told)]))
    tab.open(path, 1200)
    assert tab.run("document.querySelector('.scroll').scrollWidth <= document.querySelector('.scroll').clientWidth")
    tab.open(path, 360)
    lines = "(range => (range.selectNodeContents(document.querySelector('.facts dd')), range.getClientRects().length))"
    assert tab.run(f"{lines}(document.createRange())") == 1
