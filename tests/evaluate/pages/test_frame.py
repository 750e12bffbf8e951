import base64
import hashlib
import re

import pytest
from jinja2 import UndefinedError
from markupsafe import Markup

from gs2ci.evaluate.pages import pieces
from gs2ci.evaluate.pages.frame import PageSection, environment, fit, page, piece


def test_sections_stand_in_order_with_links_to_them():
    text = page("Title", [PageSection(f"Part {i}: of it", pieces.paragraph(f"body {i}")) for i in range(3)])
    assert re.findall(r'<section id="([^"]*)"', text) == ["part-0-of-it", "part-1-of-it", "part-2-of-it"]
    assert re.findall(r'<li><a href="#([^"]*)"', text) == ["part-0-of-it", "part-1-of-it", "part-2-of-it"]
    assert text.index("body 0") < text.index("body 1") < text.index("body 2")
    assert "<h1>Title</h1>" in text


def test_two_sections_need_no_contents():
    assert "<nav" not in page("Title", [PageSection("One", Markup("x")), PageSection("Two", Markup("y"))])


def test_sections_whose_titles_read_alike_or_not_at_all_have_anchors_of_their_own():
    text = page("Title", [PageSection(title, Markup("x")) for title in ("夜景", "雨", "a b", "A-b", "a b!")])
    found = re.findall(r'<section id="([^"]*)"', text)
    assert found == ["section", "section--2", "a-b", "a-b--2", "a-b--3"]
    assert re.findall(r'<li><a href="#([^"]*)"', text) == found


def test_a_folded_section_is_there_with_its_lead():
    text = page("Title", [PageSection("More", pieces.paragraph("inside"), "A lead.", folded=True)])
    assert re.search(r"<details.*More.*A lead\..*inside.*</details>", text, re.DOTALL)


def test_the_policy_names_the_style_and_the_script_that_are_there():
    text = page("Title", [])
    for element, directive in (("style", "style-src"), ("script", "script-src")):
        content = re.search(rf"<{element}>(.*?)</{element}>", text, re.DOTALL)[1]
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"{directive} 'sha256-{digest}'" in text


def test_text_is_escaped_wherever_it_goes():
    bad = '<b onclick="x">&'
    text = page(
        bad,
        [
            PageSection(bad, pieces.table([bad], [[bad]], caption=bad), bad),
            PageSection("Two", pieces.facts({bad: bad}) + pieces.sentences([bad], empty="") + pieces.paragraph(bad)),
        ],
        masthead=pieces.masthead(bad, [bad], [pieces.FigureOfMerit(bad, bad, bad)], "good", bad),
        eyebrow=bad,
    )
    assert "<b onclick" not in text
    assert "&lt;b onclick=&#34;x&#34;&gt;&amp;" in text


@pytest.mark.parametrize("unfit", ["\x00", "\x1b", "\ud800", "\u202e", "\u2066", "\x7f"])
def test_characters_that_a_page_cannot_hold_are_replaced(unfit):
    assert fit(f"a{unfit}b") == "a\ufffdb"
    page("Title", [PageSection("One", pieces.paragraph(f"a{unfit}b"))]).encode("utf-8")


def test_a_value_that_a_template_misses_is_an_error():
    with pytest.raises(UndefinedError):
        environment().from_string("{{ missing }}").render()
    with pytest.raises(AttributeError):
        piece("no_such_piece")
