import re

import cv2
import numpy as np
import pytest
from markupsafe import Markup

from gs2ci.core.errors import InputError
from gs2ci.evaluate.pages import pieces
from gs2ci.evaluate.pages.charts import Bar, Chart, Line
from gs2ci.evaluate.pages.next_steps import NextStep


def test_columns_of_numbers_stand_right_and_others_left():
    text = pieces.table(["name", "dB", "what"], [["a", 1.5, "x"], ["b", None, "y"], ["c", "12.3 ± 0.4", "1st?"]])
    assert re.findall(r'<th scope="col"( class="n")?>', text) == ["", ' class="n"', ""]
    assert ">–<" in text


def test_marked_cells_are_set_off():
    text = pieces.table(["a", "b"], [["x", 1], ["y", 2]], marked={(1, 1)})
    assert re.findall(r"<strong>(.*?)</strong>", text) == ["2"]


def test_a_table_without_rows_has_its_headings():
    assert "<th scope" in pieces.table(["a"], [])


def test_long_tables_and_texts_are_cut_and_it_says_so():
    text = pieces.table(["a"], [[i] for i in range(300)])
    assert text.count("<tr>") == 1 + pieces.MOST_ROWS
    assert "50 more" in text
    assert len(pieces.facts({"x": "y" * 5000})) < 1000


def test_long_values_get_a_row_of_their_own():
    assert pieces.facts({"a": "short", "b": "long " * 20}).count('class="long"') == 1


@pytest.mark.parametrize(("ending", "kind"), [(".png", "png"), (".jpg", "jpeg"), (".webp", "webp")])
def test_pictures_are_recognised_by_their_bytes(ending, kind):
    content = cv2.imencode(ending, np.zeros((4, 4, 3), np.uint8))[1].tobytes()
    assert f'src="data:image/{kind};base64,' in pieces.figure(content, "alt text", caption="below")


def test_markup_of_ours_is_a_figure_too():
    assert "<svg/>" in pieces.figure(Markup("<svg/>"), "")


def test_a_picture_of_another_format_is_refused():
    with pytest.raises(InputError, match="unknown format"):
        pieces.figure(b"<svg onload='x'/>", "alt")


def test_a_chart_comes_twice_with_its_numbers_and_a_legend_where_there_are_lines_to_tell_apart():
    two = [Line("one", [1, 2], [3, 4]), Line("two", [1, 2], [5, 6], "third", dashed=True)]
    text = pieces.chart(Chart(two, "x, s", "y, dB", "alt"))
    assert text.count('<svg class="plot"') == 2
    assert text.count("<li>") == 2
    assert re.search(r"<details.*>one<.*>two<", text, re.DOTALL)
    assert "<li>" not in pieces.chart(Chart(two[:1], "x", "y", "alt"))
    assert "<details" not in pieces.chart(Chart(two, "x", "y", "alt"), tabled=False)


def test_a_legend_shows_lines_as_lines_and_clouds_as_dots():
    ways = [Line("a", [1, 2], [3, 4]), Line("b", [1, 2], [3, 4], dashed=True), Line("c", [1, 2], [3, 4], joined=False)]
    legend = re.findall(r"<li>.*?<(line|circle)[^>]*class=\"([a-z ]*)\"", pieces.chart(Chart(ways, "x", "y", "alt")))
    assert legend == [("line", "line accent"), ("line", "line accent dashed"), ("circle", "mark accent")]


def test_parts_of_a_whole_are_named_and_counted():
    text = pieces.bars([Bar("decode", 1, "1.0 s"), Bar("fit", 9, "9.0 s", "third"), Bar("none", 0, "0 s")], unit="s")
    assert text.count("<rect class") == 2
    assert "fit <b>9.0 s</b>" in text.replace('"/></svg>', "")


def test_commands_in_sentences_are_set_as_code_and_all_else_is_escaped():
    step = NextStep("Give it <more> time: `gs2ci decode --budget 5min & on`.", "It ran `once`, and one ` is alone.")
    shown = str(pieces.steps([step], title="Next", empty="")) + str(pieces.sentences(["Say `a<b`."], empty=""))
    assert (
        'Give it &lt;more&gt; time: <code>gs2ci decode <span class="whole">--budget</span> 5min &amp; on</code>.'
        in shown
    )
    assert "It ran `once`, and one ` is alone." in shown
    assert "Say <code>a&lt;b</code>." in shown


def test_steps_and_sentences_say_when_there_is_none():
    assert "nothing to do" in pieces.steps([], title="Next", empty="nothing to do")
    assert "nothing to say" in pieces.sentences([], empty="nothing to say")
