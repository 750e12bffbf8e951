"""Whether exposures are enough: what can be asked, when they are judged, and what is said of them."""

import json
import math
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci.core.errors import GeometryError, InputError
from gs2ci.core.findings import Code, finding
from gs2ci.rig.session import SessionLog
from gs2ci.rig.until import CaptureTarget, Until, check_judged
from gs2ci_drivers.plan import Mode


@dataclass
class Taken:
    """A file with some exposures."""

    rows_written: int = 0

    def shot(self, row):
        return row


@dataclass
class Bench:
    """A clock that is set by hand, and what was said."""

    seconds: float = 0.0
    said: list = field(default_factory=list)

    def now_s(self):
        return self.seconds


def result(views=0.01, depth=0.02, notes=()):
    """A result whose standard errors are known: of views, and of depths of 2."""
    depths = np.full((2, 4, 5), 2.0, np.float32)
    depths[0, 0, 0] = 0
    errors = SimpleNamespace(
        views=np.full((2, 4, 5), views), depth=None if depth is None else np.full((2, 4, 5), depth)
    )
    return SimpleNamespace(depth=depths, uncertainty=errors, notes=notes)


def judged(text, solve, most=32, counts=range(1, 33)):
    """Judge one exposure after another; return at which counts something was solved, and what was said."""
    bench, solved = Bench(), []
    until = Until(
        CaptureTarget.parse(text),
        most,
        bench.now_s,
        bench.said.append,
        lambda shots: solved.append(len(shots)) or solve(len(shots)),
    )
    log = SessionLog(SimpleNamespace(name="shot.h5", with_name=lambda name: name), "info")
    for count in counts:
        if until(Taken(count), log):
            break
    return solved, bench.said, [json.loads(line) for line in log._waiting]


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("35dB", "views", 35.0),
        (" 32.5 db ", "views", 32.5),
        ("depth 1%", "depth", 1.0),
        ("Depth 0.5 %", "depth", 0.5),
        ("10min", "time", 600.0),
        ("90s", "time", 90.0),
    ],
)
def test_views_depth_and_time_can_be_asked_for(text, kind, value):
    assert CaptureTarget.parse(text) == CaptureTarget(kind, value)


@pytest.mark.parametrize(
    "text", ["", "soon", "35", "4dB", "90dB", "-35dB", "depth", "depth 0%", "depth 60%", "1%", "0s", "nandB", "3 years"]
)
def test_anything_else_is_refused_with_what_is_allowed(text):
    with pytest.raises(InputError, match="--until") as caught:
        CaptureTarget.parse(text)
    assert "35dB" in caught.value.allowed
    assert "10min" in caught.value.allowed


@pytest.mark.parametrize(("mode", "continuous"), [(Mode.PER_MASK, False), (Mode.PER_EXPOSURE, True)])
def test_frames_of_single_masks_and_continuous_captures_cannot_be_judged(mode, continuous):
    plan = SimpleNamespace(settings=SimpleNamespace(mode=mode, continuous=continuous))
    with pytest.raises(InputError, match="--until with"):
        check_judged(plan)


def test_the_first_exposures_are_judged_singly_and_later_ones_every_quarter_more():
    solved, said, _ = judged("35dB", lambda count: result(0.1))
    assert solved == [1, 2, 3, 4, 5, 7, 9, 12, 15, 19, 24, 30, 32]
    assert said[0] == "1 exposure: 20.0 dB, asked for 35.0 dB"
    assert said[-1].endswith("no more are taken than --shots allows")


def test_a_capture_ends_when_the_views_are_accurate_enough():
    solved, said, log = judged("25dB", lambda count: result(0.1 / np.sqrt(count)))
    assert solved == [1, 2, 3, 4]
    assert said[-1] == "4 exposures together: 26.0 dB, asked for 25.0 dB"
    assert [line["enough"] for line in log] == [False, False, False, True]
    assert log[-1]["exposures"] == 4


def test_depth_is_judged_by_its_median_where_there_is_one():
    solved, said, _ = judged("depth 1%", lambda count: result(depth=0.03 / count))
    assert solved == [1, 2]
    assert said == [
        "1 exposure: depth 1.5 %, asked for depth 1 %",
        "2 exposures together: depth 0.75 %, asked for depth 1 %",
    ]


def test_what_says_nothing_of_the_target_or_fails_ends_nothing():
    def solve(count):
        if count == 1:
            raise GeometryError("nothing ties them")
        if count == 2:
            return SimpleNamespace(depth=None, uncertainty=None)
        return result(depth=None) if count == 3 else result(depth=0.001)

    solved, said, log = judged("depth 1%", solve)
    assert solved == [1, 2, 3, 4]
    assert said[0] == "1 exposure: nothing ties them, asked for depth 1 %"
    assert (
        said[1]
        == said[2].replace("3", "2")
        == "2 exposures together: they give no standard error of depth, asked for depth 1 %"
    )
    assert [line["figure"] for line in log[:3]] == [None] * 3


def test_views_that_held_out_pixels_expect_to_err_more_are_not_taken_for_better():
    def expected(share):
        return finding(Code.VIEWS_ERR, share=share, psnr_db=-20 * math.log10(share))

    target = CaptureTarget("views", 30.0)
    assert target.figure(result(views=0.01)) == pytest.approx(40)
    assert target.figure(result(views=0.01, notes=[expected(0.1), expected(0.05)])) == pytest.approx(20)
    assert target.figure(result(views=0.2, notes=[expected(0.1)])) == pytest.approx(-20 * math.log10(0.2))
    own = expected(0.1)
    of_one = finding(Code.OF_EXPOSURE, **{**own.figures, "name": "a-1", "sentence": own.sentence, "code": own.code})
    assert target.figure(result(views=0.01, notes=[of_one])) == pytest.approx(20)
    assert CaptureTarget("depth", 1.0).figure(result(depth=0.02, notes=[own])) == pytest.approx(1.0)


def test_a_result_without_any_depth_gives_no_figure():
    nowhere = result()
    nowhere.depth[:] = 0
    assert CaptureTarget("depth", 1.0).figure(nowhere) is None
    assert CaptureTarget("views", 30.0).figure(result(views=0.0)) == pytest.approx(120)


def test_a_time_needs_no_reconstruction_and_counts_from_the_beginning():
    bench = Bench(seconds=100.0)
    until = Until(CaptureTarget.parse("10min"), 32, bench.now_s, bench.said.append, None)
    log = SessionLog(SimpleNamespace(name="shot.h5", with_name=lambda name: name), "off")
    assert not until(Taken(1), log)
    bench.seconds = 701.0
    assert until(Taken(2), log)
    assert bench.said == ["2 exposures together: 10 min 01 s, asked for 10 min 00 s"]
    assert not Until(CaptureTarget.parse("10min"), 3, bench.now_s, bench.said.append, None)(Taken(3), log)
    assert "--shots" in bench.said[-1]
