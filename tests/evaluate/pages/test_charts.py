import math
import re

import pytest

from gs2ci.core.errors import InputError
from gs2ci.evaluate.pages.charts import Bar, Chart, Line, bars_svg, chart_svg, chart_table


def chart(x, y, **parts):
    return Chart([Line("line", x, y)], "x", "y", "alt", **parts)


def marks(svg):
    return [(float(x), float(y)) for x, y in re.findall(r'<circle class="mark[^>]*cx="([^"]*)" cy="([^"]*)"', svg)]


def ticks(svg):
    """The ticks' labels on the y and on the x axis."""
    grid = re.search(r'<g class="grid">(.*?)</g>', svg, re.DOTALL)[1]
    return [re.findall(rf'text-anchor="{anchor}">([^<]*)</text>', grid) for anchor in ("end", "middle")]


def test_points_stand_in_proportion():
    (x0, y0), (x1, y1), (x2, y2) = marks(chart_svg(chart([0, 1, 4], [10, 12, 18]), 400, 300))
    assert (x2 - x0) / (x1 - x0) == pytest.approx(4, rel=1e-3)
    assert (y2 - y0) / (y1 - y0) == pytest.approx(4, rel=1e-3)
    assert x0 < x1
    assert y0 > y1


def test_on_logarithmic_axes_ratios_are_distances():
    (x0, y0), (x1, y1), (x2, y2) = marks(chart_svg(chart([1, 10, 100], [1, 2, 4], x_log=True, y_log=True), 400, 300))
    assert x2 - x1 == pytest.approx(x1 - x0, abs=0.02)
    assert y2 - y1 == pytest.approx(y1 - y0, abs=0.02)


@pytest.mark.parametrize(("low", "high"), [(0, 1), (27.1, 27.2), (-3, 4e5), (1e-7, 3e-7), (31, 31), (0, 0), (-5, -5)])
@pytest.mark.parametrize("width", [340, 760])
def test_there_are_at_least_two_ticks_and_they_differ(low, high, width):
    for labels in ticks(chart_svg(chart([low, high], [low, high]), width, 300)):
        assert 2 <= len(labels) <= 16
        assert len(set(labels)) == len(labels)


@pytest.mark.parametrize(("low", "high"), [(1, 1000), (69, 91), (0.05, 0.09), (3, 3), (1e-6, 1e6)])
def test_logarithmic_axes_have_ticks_too(low, high):
    drawn = chart_svg(chart([low, high], [1, 2], x_log=True), 340, 300)
    labels = ticks(drawn)[1]
    assert 2 <= len(labels) <= 8
    assert len(set(labels)) == len(labels)


def test_points_that_are_none_are_left_out():
    nan, inf = math.nan, math.inf
    assert len(marks(chart_svg(chart([1, 2, nan, 4], [1, inf, 2, 3]), 400, 300))) == 2
    assert len(marks(chart_svg(chart([0, 1, 2], [1, 2, 3], x_log=True), 400, 300))) == 2


def test_a_chart_without_any_point_is_refused():
    for drawn in (chart([], []), chart([math.nan], [1]), chart([-1], [1], x_log=True)):
        with pytest.raises(InputError, match="without a point"):
            chart_svg(drawn, 400, 300)


def test_a_level_is_inside_and_named():
    drawn = chart_svg(chart([1, 2], [10, 20], levels=[("decode", 5), ("never", math.inf)]), 400, 300)
    assert "decode" in drawn
    assert "never" not in drawn
    assert 0 < float(re.search(r'class="line muted dashed" x1="[^"]*" y1="([^"]*)"', drawn)[1]) < 300


def test_one_point_is_drawn_though_dots_were_not_asked_for():
    assert len(marks(chart_svg(Chart([Line("l", [1], [1], dots=False)], "x", "y", "alt"), 400, 300))) == 1


def test_names_stand_beside_their_points():
    lines = [Line("l", [1, math.nan, 3], [1, 2, 3], names=("first", "lost", "last"))]
    drawn = chart_svg(Chart(lines, "x", "y", "alt"), 400, 300)
    assert ">first<" in drawn
    assert ">last<" in drawn
    assert "lost" not in drawn


def test_the_table_holds_every_number():
    headings, rows = chart_table(Chart([Line("a", [1], [0.123456]), Line("b", [2], [math.nan])], "x", "y", "alt"))
    assert headings == ["line", "x", "y"]
    assert rows == [["a", "1", "0.12346"], ["b", "2", "–"]]
    assert chart_table(chart([1], [2]))[0] == ["x", "y"]


def test_bars_share_the_width_and_nothing_leaves_nothing():
    drawn = bars_svg([Bar("a", 1, "1 s"), Bar("b", 3, "3 s"), Bar("c", 0, "0 s")], "s")
    widths = [float(width) for width in re.findall(r'width="([\d.]+)" height="26"', drawn)]
    assert widths == pytest.approx([247, 747])
    assert "<rect" not in bars_svg([Bar("a", 0, "0 s")], "s")


def test_a_cloud_s_points_say_their_titles_and_only_named_ones_are_large():
    cloud = Line("tried", [1, 2, 3], [5, 6, 7], joined=False, names=["", "2", ""], titles=["one", "two", "three"])
    drawn = str(chart_svg(Chart([cloud], "s", "dB", "dots"), 400, 200))
    assert re.findall(r'r="(\d)"><title>([^<]*)</title>', drawn) == [
        ("3", "one: 1, 5"),
        ("5", "two: 2, 6"),
        ("3", "three: 3, 7"),
    ]
    assert cloud.style == "dots"
