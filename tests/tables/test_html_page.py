import re
from dataclasses import replace

import pytest

from gs2ci.core.errors import StorageError
from gs2ci.tables.catalogue import Table
from gs2ci.tables.columns import Measure
from gs2ci.tables.html_page import html_page, write_html_page
from gs2ci.tables.pages import Figures

TABLE = Table(
    "Methods",
    "One thing changed at a time.",
    lambda _options: [],
    (Measure("psnr_db", "PSNR, dB", 2), Measure("seconds", "s", 0, more_is_better=False)),
)


def figures(case="boxes", line="default", psnr=30.0, seconds=10.0, spread=0.5, errors=()):
    spreads = (None if psnr is None else spread, None)
    return Figures(case, line, (psnr, seconds), spreads, 0 if psnr is None else 2, errors)


TWO = [figures(), figures(line="other", psnr=31.0, seconds=20.0)]
BOTH = [*TWO, figures("corridor", psnr=25.0), figures("corridor", "other", psnr=26.0)]


def headings(text):
    return re.findall(r"<h2 id=[^>]*>([^<]*)</h2>", text)


def test_the_page_says_what_is_best_then_shows_each_case():
    text = html_page(TABLE, BOTH, "gs2ci tables methods")
    assert "<h1>Methods: other has the best PSNR in 2 of 2 cases</h1>" in text
    assert "boxes: other, 31.00 ± 0.50 (PSNR, dB)." in text
    assert headings(text) == ["boxes", "corridor", "How it was made"]
    assert "gs2ci tables methods" in text
    assert "Complete" in text


def test_the_best_of_each_column_is_set_off():
    text = html_page(TABLE, TWO, "")
    table = text[text.index("<table>") : text.index("</table>")]
    assert re.findall(r"<strong>(.*?)</strong>", table) == ["10", "31.00 ± 0.50"]


def test_a_mean_of_fewer_cells_is_told():
    text = html_page(TABLE, [replace(TWO[0], known=(1, 2)), replace(TWO[1], known=(2, 2))], "")
    assert headings(text) == ["boxes", "Means of fewer cells", "How it was made"]
    assert "boxes, default: means of fewer cells (PSNR, dB: 1 of 2)" in text
    assert "boxes, other: means" not in text


def test_a_single_case_and_a_single_line_make_no_contest():
    assert "other has the best PSNR for boxes" in html_page(TABLE, TWO, "")
    text = html_page(TABLE, TWO[:1], "")
    assert "<h1>Methods</h1>" in text
    assert "<strong>30.00" not in text


def test_what_failed_is_told_and_has_no_figure():
    text = html_page(TABLE, [*TWO, figures(line="bad", psnr=None, seconds=None, errors=("no <depth>",))], "")
    assert "With gaps" in text
    assert "boxes, bad: no &lt;depth&gt;" in text
    assert headings(text)[-2:] == ["What failed", "How it was made"]


def test_where_everything_failed_it_says_so():
    text = html_page(TABLE, [figures(psnr=None, seconds=None, errors=("no depth",))], "")
    assert "Nothing succeeded" in text
    assert '<svg class="plot"' not in text


def test_nothing_comes_from_elsewhere():
    assert not re.search(r"https?://|<link|@import", html_page(TABLE, BOTH, ""))


def test_the_page_is_written_beside_the_others(tmp_path):
    path = write_html_page(tmp_path / "bench", "methods", TABLE, TWO, "")
    assert path == tmp_path / "bench" / "methods.html"
    assert path.read_text(encoding="utf-8") == html_page(TABLE, TWO, "")


def test_a_page_that_cannot_be_written_is_a_typed_error(tmp_path):
    (tmp_path / "x.html").mkdir()
    with pytest.raises(StorageError, match="cannot be written"):
        write_html_page(tmp_path, "x", TABLE, TWO, "")
