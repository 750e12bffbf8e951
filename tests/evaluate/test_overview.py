from dataclasses import replace

import cv2
import numpy as np
import pytest

from gs2ci.core.findings import Code, finding
from gs2ci.core.records import Truth
from gs2ci.evaluate.overview import DPI, draw_overview, write_overview
from gs2ci.evaluate.run_report import build_report

pytestmark = pytest.mark.slow


def drawn(shot, result):
    """Draw a run; return the picture's ink, [H, W] in 0..1, the figure and its axes by title."""
    figure = draw_overview(shot, result, build_report(shot, result))
    figure.canvas.draw()
    ink = 1 - np.asarray(figure.canvas.buffer_rgba())[..., :3].mean(-1) / 255
    return (
        ink,
        figure,
        {axes.get_title("left"): axes for axes in figure.axes if axes.get_title("left")},
    )


def assert_nothing_overlaps_or_leaves_the_page(figure):
    """Titles, labels, ticks and lines of text keep apart and inside the page."""
    renderer, (width, height) = figure.canvas.get_renderer(), figure.canvas.get_width_height()
    texts = list(figure.texts)
    for axes in figure.axes:
        texts += [axes.title, axes._left_title, axes._right_title, axes.xaxis.label, axes.yaxis.label]
        texts += [*axes.get_xticklabels(), *axes.get_yticklabels()]
        low, high = sorted(axes.get_ylim())
        texts = [t for t in texts if t not in axes.get_yticklabels() or low <= t.get_position()[1] <= high]
        low, high = sorted(axes.get_xlim())
        texts = [t for t in texts if t not in axes.get_xticklabels() or low <= t.get_position()[0] <= high]
    boxes = [(t.get_text(), t.get_window_extent(renderer)) for t in texts if t.get_text().strip() and t.get_visible()]
    for name, box in boxes:
        assert box.x0 >= 0, name
        assert box.y0 >= 0, name
        assert box.x1 <= width, name
        assert box.y1 <= height, name
    for index, (name, box) in enumerate(boxes):
        for other, another in boxes[index + 1 :]:
            assert not box.padded(-1).overlaps(another.padded(-1)), (name, other)


CASES = {
    "colour": {},
    "mono": {"channels": 1},
    "no truth": {"truth": False},
    "mono without truth": {"channels": 1, "truth": False},
    "tiny": {"size": (16, 16)},
    "big": {"size": (769, 1023), "count": 2},
    "tall": {"size": (120, 40), "truth": False},
    "wide": {"size": (30, 240)},
    "single view": {"count": 1},
    "two views": {"count": 2},
    "64 views": {"count": 64, "size": (24, 32)},
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_every_kind_of_run_is_drawn_whole(make_run, case):
    shot, result = make_run(**case)
    ink, figure, axes = drawn(shot, result)
    lower = ["Depth", "Camera path"]
    known = [*lower, "Truth", "Error", "Accuracy against time"]
    wanted = known if case.get("truth", True) else [*lower, "Held-out residual"]
    assert set(axes) == {"Measurement", "Decode", "Result", *wanted}
    for name, panel in axes.items():
        box = panel.get_window_extent()
        height = ink.shape[0]
        inside = ink[int(height - box.y1) : int(height - box.y0), int(box.x0) : int(box.x1)]
        assert inside.std() > 0.01, f"{name} is blank"
    assert_nothing_overlaps_or_leaves_the_page(figure)


def test_the_picture_is_written_at_its_size(tmp_path, make_run):
    shot, result = make_run()
    report = build_report(shot, result)
    write_overview(tmp_path / "overview.png", shot, result, report)
    picture = cv2.imread(str(tmp_path / "overview.png"))
    width, height = draw_overview(shot, result, report).get_size_inches()
    assert picture.shape[:2] == (int(height * DPI), int(width * DPI))
    assert picture.std() > 10


@pytest.mark.parametrize("size", [(120, 40), (64, 64)])
def test_the_longest_titles_fit_the_narrowest_panels(make_run, size):
    shot, result = make_run(size=size, count=64)
    _, figure, _ = drawn(shot, replace(result, verdict="decode"))
    assert_nothing_overlaps_or_leaves_the_page(figure)


def test_what_was_not_found_is_said_in_its_place(make_run):
    shot, result = make_run()
    _, figure, axes = drawn(shot, replace(result, depth=None, curve=(), verdict="decode"))
    assert [text.get_text() for text in axes["Depth"].texts] == ["no depth was found"]
    assert [text.get_text() for text in axes["Accuracy against time"].texts] == ["nothing was fitted"]
    assert "Result = decode" in axes
    assert_nothing_overlaps_or_leaves_the_page(figure)


@pytest.mark.parametrize(
    ("verdict", "depth", "path"),
    [("full", "scene units", "from above"), ("unsupported", "no path found", "none found")],
)
def test_depth_and_path_say_that_no_path_was_found(make_run, verdict, depth, path):
    shot, result = make_run(truth=False)
    geometry = {**result.geometry, "verdict": verdict, "unit_of": None}
    _, figure, axes = drawn(shot, replace(result, geometry=geometry))
    assert axes["Depth"].get_title("right").endswith(depth)
    assert axes["Camera path"].get_title("right") == path
    assert_nothing_overlaps_or_leaves_the_page(figure)


@pytest.mark.parametrize("note", [finding(Code.CAMERA_AT_REST, share=0.7), finding(Code.CAMERA_GIVEN_AT_REST)])
def test_neither_depth_nor_path_is_drawn_of_a_camera_known_to_be_at_rest(make_run, note):
    shot, result = make_run(truth=False)
    geometry = {**result.geometry, "method": "rest", "verdict": "static"}
    _, figure, axes = drawn(shot, replace(result, geometry=geometry, notes=(note,)))
    assert [text.get_text() for text in axes["Depth"].texts] == ["cannot be found: the camera was at rest"]
    assert [text.get_text() for text in axes["Camera path"].texts] == ["the camera was at rest"]
    assert not axes["Depth"].images
    assert_nothing_overlaps_or_leaves_the_page(figure)


def test_depth_where_nothing_is_seen_stays_pale(make_run):
    shot, result = make_run()
    depth = result.depth.copy()
    depth[:, :10] = 0
    _, _, axes = drawn(shot, replace(result, depth=depth))
    shown = axes["Depth"].images[0].get_array()
    assert shown.mask[:10].all()
    assert not shown.mask[10:].any()


@pytest.mark.parametrize("depth", [0.0, 3.0])
def test_a_flat_or_empty_depth_is_drawn(make_run, depth):
    shot, result = make_run()
    _, figure, axes = drawn(shot, replace(result, depth=np.full_like(result.depth, depth)))
    assert bool(axes["Depth"].images) == (depth > 0)
    assert_nothing_overlaps_or_leaves_the_page(figure)


def test_a_camera_that_stands_still_is_drawn(make_run):
    shot, result = make_run()
    still = np.tile(np.eye(4), (8, 1, 1))
    _, figure, _ = drawn(replace(shot, truth=Truth(shot.truth.views, still)), replace(result, world_to_camera=still))
    assert_nothing_overlaps_or_leaves_the_page(figure)


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 1, 0)])
def test_moves_ahead_and_upwards_are_drawn(make_run, direction):
    shot, result = make_run()
    path = np.tile(np.eye(4), (8, 1, 1))
    path[:, :3, 3] = np.linspace(0, 1, 8)[:, None] * direction
    _, figure, _ = drawn(replace(shot, truth=Truth()), replace(result, world_to_camera=path))
    assert_nothing_overlaps_or_leaves_the_page(figure)


@pytest.mark.parametrize("heldout", [0.0, 1e-6, 0.02])
def test_a_curve_of_one_point_is_drawn(make_run, heldout):
    shot, result = make_run(truth=False)
    only = [replace(result.curve[3], heldout=heldout)]
    _, figure, _ = drawn(
        shot, replace(result, curve=only, heldout_rms={"refined": None, "scene": None, "decode": None})
    )
    assert_nothing_overlaps_or_leaves_the_page(figure)


def test_a_measurement_of_zeros_and_a_perfect_result_are_drawn(make_run):
    shot, result = make_run()
    _, figure, _ = drawn(replace(shot, measurement=0 * shot.measurement), replace(result, views=shot.truth.views))
    assert_nothing_overlaps_or_leaves_the_page(figure)


def test_long_names_and_notes_are_cut_and_dollars_mean_dollars(make_run):
    shot, result = make_run()
    note = finding(Code.FINE_UNCHANGED, why="many words. " * 50)
    stopped = finding(Code.FIT_ALL_DONE, iterations="$many$ " * 80, best=0)
    wordy = replace(result, notes=[note] * 3, stopped=stopped)
    _, figure, _ = drawn(replace(shot, name="a $name^ of\nmany words " * 20), wordy)
    texts = [text.get_text() for text in figure.texts]
    assert "More notes are in report.json." in texts
    assert sum(text.endswith("…") for text in texts) == 2
    assert_nothing_overlaps_or_leaves_the_page(figure)


def test_doubts_stand_above_remarks(make_run):
    shot, result = make_run()
    remark = finding(Code.VIEWS_COMBINED, refined=0.5, scene=0.5, decode=0.0)
    doubt = finding(Code.DEPTH_STARTS_AS_PLANE)
    _, figure, _ = drawn(shot, replace(result, notes=(remark, doubt)))
    lines = [text.get_text() for text in figure.texts]
    assert lines.index(doubt.sentence) < next(k for k, line in enumerate(lines) if remark.sentence.startswith(line))


def test_a_bayer_measurement_is_named_by_its_pattern(make_run):
    shot, result = make_run()
    mosaic = replace(shot, measurement=shot.measurement[..., :1], cfa="RGGB")
    bayer = replace(result, predicted_measurement=result.predicted_measurement[..., :1])
    _, _, axes = drawn(mosaic, bayer)
    assert axes["Measurement"].get_title("right").startswith("RGGB mosaic")


@pytest.mark.parametrize(("unit_of", "said"), [(None, "scene units"), ("stage", "units of the stage")])
def test_depth_is_told_in_the_unit_that_it_has(make_run, unit_of, said):
    shot, result = make_run()
    _, _, axes = drawn(shot, replace(result, geometry={**result.geometry, "unit_of": unit_of}))
    assert axes["Depth"].get_title("right").endswith(said)
