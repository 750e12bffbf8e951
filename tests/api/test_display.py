import io
import time

import pytest
from rich.console import Console

from gs2ci.api.display import LiveDisplay, PlainDisplay, open_display
from gs2ci.api.display.stages import describe_figures
from gs2ci.api.summary import print_summary
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Progress
from tests.evaluate.reports import a_report


class StepClock:
    """A clock on which every look takes a second, or as long as is said."""

    def __init__(self, look_s=1.0):
        self.now, self.look_s = 0.0, look_s

    def now_s(self):
        self.now += self.look_s
        return self.now

    def sleep_s(self, duration_s):
        self.now += duration_s


def terminal(width=100):
    return Console(file=io.StringIO(), force_terminal=True, width=width, color_system=None, highlight=False)


def pipe():
    return Console(file=io.StringIO(), force_terminal=False, width=80, highlight=False)


def run_through(display: Progress):
    display.stage("decode", 40)
    for done in range(1, 41):
        display.step(done)
    display.say("The focal length was [estimated]: 70.4 pixels.")
    display.stage("geometry")
    display.stage("fit", 1000)
    display.step(400, loss=0.01234, heldout=0.021, gaussians=13000)


def fail_in(display):
    def work():
        with display:
            run_through(display)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        work()


def test_a_request_is_not_drawn_over_while_it_waits(monkeypatch):
    """The bars are redrawn in their place, which was where the request stood."""
    console = terminal()
    shown = []

    def enter():
        console.file.seek(0)
        before = len(console.file.read())
        time.sleep(0.6)
        console.file.seek(0)
        shown.append(console.file.read())
        assert len(shown[-1]) == before

    monkeypatch.setattr("builtins.input", enter)
    with open_display(console) as display:
        display.ask("Put the lens cap on")
        display.stage("dark frames", 2)
        display.step(2)
        display.stage("flat frames", 2)
        display.step(1)
        display.ask("Take it off [now]")
        display.step(2)
        display.ask("Put it on again")
        display.stage("last frames", 2)
    assert shown[0].endswith("Put the lens cap on, then press Enter ")
    assert shown[1].endswith("Take it off [now], then press Enter ")
    after = console.file.getvalue()[len(shown[1]) :]
    assert "flat frames" in after
    assert "last frames" in after
    assert "dark frames" not in after


def test_a_request_in_plain_output_is_a_line(monkeypatch):
    console = pipe()
    monkeypatch.setattr("builtins.input", lambda: "")
    with open_display(console) as display:
        display.ask("Put the lens cap on")
    assert console.file.getvalue() == "Put the lens cap on, then press Enter\n"


@pytest.mark.parametrize("where", [terminal, pipe])
def test_a_request_that_nobody_can_answer_is_a_clear_error(monkeypatch, where):
    def ended():
        raise EOFError

    monkeypatch.setattr("builtins.input", ended)
    with (
        pytest.raises(InputError, match=r"lens cap on: nobody is there.*at a terminal"),
        open_display(where()) as display,
    ):
        display.ask("Put the lens cap on")


def test_plain_output_is_one_line_per_stage_and_sentence():
    console = pipe()
    with PlainDisplay(console, StepClock(0.5)) as display:
        run_through(display)
    assert console.file.getvalue().splitlines() == [
        "The focal length was [estimated]: 70.4 pixels.",
        "decode: 20.5 s, 40 steps",
        "geometry: 0.5 s",
        "fit: 1.0 s, ended after 400 of 1000 steps, loss 0.0123 · held-out 0.0210 · 13 000 Gaussians",
    ]


def test_plain_output_tells_of_a_long_stage_now_and_then():
    console, clock = pipe(), StepClock()
    with PlainDisplay(console, clock) as display:
        display.stage("candidates", 5)
        for done in range(1, 6):
            clock.sleep_s(20)
            display.step(done, psnr_db=20.0 + done)
        display.stage("checks", 1)
        display.step(1)
    assert console.file.getvalue().splitlines() == [
        "candidates: so far 43.0 s, 2 of 5 steps, PSNR 22.00 dB",
        "candidates: so far 86.0 s, 4 of 5 steps, PSNR 24.00 dB",
        "candidates: 108.0 s, 5 steps, PSNR 25.00 dB",
        "checks: 2.0 s, 1 step",
    ]


def test_what_is_done_after_a_stage_was_finished_is_not_its_own():
    console = pipe()
    with PlainDisplay(console, StepClock()) as display:
        display.stage("masks", 8)
        display.step(8)
        display.finish()
        display.say("camera:")
        display.finish()
    assert console.file.getvalue().splitlines() == ["masks: 2.0 s, 8 steps", "camera:"]
    with open_display(terminal()) as live:
        live.finish()
        live.stage("masks", 8)
        live.finish()
        live.step(3)
        assert [(task.completed, task.finished) for task in live._bars.tasks] == [(1, True)]


def test_a_stage_may_turn_out_longer_or_shorter_than_it_was_said_to_be():
    console = pipe()
    with PlainDisplay(console, StepClock()) as display:
        display.stage("fit", 500)
        display.expect(800)
        display.step(700)
    assert console.file.getvalue().splitlines() == ["fit: 2.0 s, ended after 700 of 800 steps"]
    live = terminal()
    with open_display(live) as display:
        display.expect(3)  # before any stage: nothing to draw
        display.stage("fit", 500)
        display.expect(800)
        display.step(700)
        display._bars.refresh()
        shown = live.file.getvalue()
    assert "700/800" in shown


def test_plain_output_of_long_sentences_is_not_broken():
    console = pipe()
    with PlainDisplay(console) as display:
        display.say("word " * 50)
    assert len(console.file.getvalue().splitlines()) == 1


def test_a_failing_stage_still_gets_its_line():
    console = pipe()
    fail_in(PlainDisplay(console, StepClock()))
    assert console.file.getvalue().splitlines()[-1].startswith("fit: broke off after 2.0 s, 400 of 1000 steps")


def test_the_display_is_chosen_by_where_output_goes():
    assert isinstance(open_display(terminal()), LiveDisplay)
    assert isinstance(open_display(pipe()), PlainDisplay)


def test_the_default_display_writes_no_control_characters_into_a_pipe(capsys):
    with open_display() as display:
        run_through(display)
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert "fit: " in out


def test_the_live_display_shows_stage_steps_figures_and_time_left():
    console = terminal()
    with open_display(console) as display:
        run_through(display)
        display._bars.refresh()
        shown = console.file.getvalue()
    assert "400/1000" in shown
    assert "loss 0.0123 · held-out 0.0210 · 13 000 Gaussians" in shown
    assert shown.index("[estimated]") < shown.index("geometry")
    assert "decode" in shown


def test_the_live_display_says_how_much_time_is_left():
    console = terminal()
    clock = StepClock()
    with LiveDisplay(console, clock) as display:
        display.stage("fit", 100)
        for done in range(1, 51):
            display.step(done)
        display._bars.refresh()
    assert " s left" in console.file.getvalue()


def test_the_live_display_fits_eighty_columns():
    console = terminal(width=80)
    with open_display(console) as display:
        run_through(display)
        display._bars.refresh()
    assert max(len(line.split("\r")[-1]) for line in console.file.getvalue().splitlines()) <= 80 + len("\x1b[2K") * 4


def test_a_stage_that_ends_early_stays_at_the_steps_it_took():
    console = terminal()
    with open_display(console) as display:
        run_through(display)
        display.stage("write", 1)
        display.step(1)
    fit = [line for line in console.file.getvalue().splitlines() if line.lstrip("\x1b[2KA\r").startswith("fit")]
    assert "400/1000" in fit[-1]
    assert "left" not in fit[-1]


def test_a_failing_run_leaves_its_bar_where_it_stood():
    console = terminal()
    fail_in(open_display(console))
    assert "400/1000" in console.file.getvalue()


def test_steps_before_any_stage_are_ignored():
    for console in (terminal(), pipe()):
        with open_display(console) as display:
            display.step(3, loss=1.0)
        assert "loss" not in console.file.getvalue()


@pytest.mark.parametrize(
    ("figures", "text"),
    [
        ({}, ""),
        ({"loss": 0.5, "psnr_db": 31.016}, "loss 0.5000 · PSNR 31.02 dB"),
        ({"tracks": 812, "motion_model": "affine"}, "tracks 812 · motion model affine"),
        ({"gaussians": 1234567}, "1 234 567 Gaussians"),
        ({"loss": 1.234e-5}, "loss 1.23e-05"),
        ({"loss": 4321.0}, "loss 4321"),
        ({"loss": 4.321e8}, "loss 4.32e+08"),
        ({"mean_dn": 2053.4, "exposure_ms": 8.51}, "mean 2053 DN · exposure 8.51 ms"),
        ({"rms_px": 0.0123, "latency_us": 12}, "rms 0.0123 px · latency 12 µs"),
    ],
)
def test_figures_read_as_a_person_writes_them(figures, text):
    assert describe_figures(figures) == text


FOCAL = finding(Code.FOCAL_ASSUMED, why="[nobody] told it", view_angle_deg=60.0)
SCORES = {
    "name": "fern [smooth]",
    "views": 2,
    "psnr_db": {"mean": 31.02, "per_view": [30.9, 31.14]},
    "ssim": {"mean": 0.9421, "per_view": [0.94, 0.9442]},
    "scene": {"psnr_db": {"mean": 30.0, "per_view": [30.0] * 2}, "ssim": {"mean": 0.93, "per_view": [0.93] * 2}},
    "decode": {
        "psnr_db": {"mean": 24.17, "per_view": [24, 24.34]},
        "ssim": {"mean": 0.71, "per_view": [0.7, 0.72]},
    },
    "residual__heldout_rms": {"refined": 0.03, "scene": 0.031, "decode": 0.052},
}


def summary(tmp_path, **changes):
    report = a_report(FOCAL, finding(Code.SATURATED, share=0.2), **{**SCORES, **changes})
    (tmp_path / "report.json").write_text(report.text())
    console = pipe()
    print_summary(tmp_path, console)
    return console.file.getvalue()


def test_the_summary_says_how_good_how_long_and_where(tmp_path):
    text = summary(tmp_path)
    for part in (
        "fern [smooth]: 2 views from one exposure",
        "31.02 dB",
        "decode 24.17; views 30.90 to 31.14",
        "0.9421",
        "0.0010",
        "0.100°",
        "86 s",
        "decode 4.0 s, geometry 4.2 s, fit 78.0 s",
        "held-out",
        "scene 0.0310, decode 0.0520",
        "The fit ended because the held-out pixels stopped improving; they were best at iteration 500.",
        "The focal length is not known and [nobody] told it; a horizontal",
        "Give the focal length if you know it: `gs2ci reconstruct --focal-px`.",
        "bound of the light. Use less light",
        "report.html",
    ):
        assert part in " ".join(text.split())
    assert "\x1b" not in text


def test_the_summary_leaves_out_what_is_not_known(tmp_path):
    nobody, unscored = {"refined": None, "scene": None, "decode": None}, {"psnr_db": None, "ssim": None}
    text = summary(tmp_path, **unscored, scene=unscored, decode=unscored, trajectory=None, residual__heldout_rms=nobody)
    for part in ("PSNR", "SSIM", "nATE", "rotation", "held-out  ", "None"):
        assert part not in text
    assert "0.0300 rms" in text


def test_the_summary_says_how_far_depth_is_off_where_that_is_known(tmp_path):
    errors = {"scale": 0.5, "abs_rel": 0.03, "median_rel": 0.0123, "rms": 0.1, "close_share": 0.97, "known_share": 1.0}
    text = summary(tmp_path, depth={**errors, "rank": 0.98, "median_px": 0.071, "far_off_share": 0.11})
    for part in ("1.23% off", "rank correlation 0.980", "97.0% within 1.25", "0.071 px", "11.0% over 0.25"):
        assert part in text


def test_the_summary_of_a_camera_that_stands_still_has_no_nate(tmp_path):
    text = summary(tmp_path, trajectory__nate=None, trajectory__rpe_t=None, trajectory__rpe_r_deg=None)
    assert "nATE" not in text
    assert "0.100°" in text


def test_the_summary_of_no_run_is_an_error(tmp_path):
    with pytest.raises(StorageError, match="cannot be read"):
        print_summary(tmp_path, pipe())
