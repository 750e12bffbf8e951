"""A modulator on a video output through its driver: grey tables, the trigger's patch, refreshes counted."""

import numpy as np
import pytest
from pydantic import ValidationError

from gs2ci_drivers.failures import DisconnectedError, NoAnswerError, SequenceError
from gs2ci_drivers.modulator import ModulatorState
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_drivers.video_out.driver import VideoOut
from gs2ci_drivers.video_out.options import VideoOutOptions
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.screen import ScreenTwin
from gs2ci_sims.world import World

PATCH = (0, 50, 8, 8)


class Bench:
    def __init__(self, refresh_hz=60.0, **table):
        self.world, self.faults = World(), FaultSet()
        options = VideoOutOptions.model_validate({"kind": "video", "frames_late": 0} | table)
        self.twin = ScreenTwin(
            self.world, self.faults, height=32, width=64, refresh_hz=refresh_hz,
            frames_late=options.frames_late, patch=options.trigger_patch,
        )  # fmt: skip
        self.modulator = VideoOut("slm", self.twin, self.world.clock, options)
        self.modulator.connect()

    def sequence(self, count=3, bits=1, **changes):
        masks = np.zeros((count, 32, 64), np.uint8)
        for i in range(count):
            masks[i, 8 + i] = 2**bits - 1
        given = {"exposure_s": 0.05, "pause_s": 0.1, "trigger": TriggerOut.NONE} | changes
        return PatternSequence(masks, bits, **given)

    def play(self, sequence):
        self.modulator.upload(sequence)
        self.modulator.arm()
        begin_s = self.world.clock.now_s()
        self.modulator.start()
        self.modulator.wait_done(60.0)
        return self.world.masks_between(begin_s, self.world.clock.now_s())


def test_times_are_whole_refreshes_and_the_panel_is_as_late_as_it_is():
    bench = Bench(frames_late=2)
    begin_s = bench.world.clock.now_s()
    shown = bench.play(bench.sequence(exposure_s=0.055))  # 3.3 refreshes
    assert [mask.end_s - mask.start_s for mask in shown] == pytest.approx([0.05] * 3)
    assert shown[0].start_s > begin_s + 2 / 60
    assert bench.modulator.loaded.exposure_s == pytest.approx(0.05)
    assert not bench.world.masks_between(bench.world.clock.now_s() - 1e-6, bench.world.clock.now_s())


def test_levels_are_linear_or_by_the_table():
    mask = np.arange(256, dtype=np.uint8).reshape(16, 16)
    linear = Bench(dark_level=250, bright_level=40).modulator.levels(mask, 8)
    assert (linear[0, 0], linear[-1, -1]) == (250, 40)
    assert (np.diff(linear.ravel().astype(int)) <= 0).all()
    curved = Bench(grey_table=(0, 200, 255)).modulator.levels(np.array([[0, 1]], np.uint8), 1)
    assert curved.tolist() == [[0, 255]]
    half = Bench(grey_table=(0, 200, 255)).modulator.levels(np.array([[128]], np.uint8), 8)
    assert half[0, 0] == pytest.approx(200, abs=1)


def test_between_masks_and_at_the_end_the_panel_has_the_level_at_which_its_table_begins():
    bench = Bench(grey_table=(255, 90, 10), trigger_patch=PATCH)
    flips, flip = [], bench.twin.flip
    bench.twin.flip = lambda levels: flips.append(levels.copy()) or flip(levels)
    bench.play(bench.sequence(trigger=TriggerOut.PER_MASK))
    assert [(flips[i] == 255).all() for i in (0, -1)] == [True, True]
    patch = flips[2][PATCH[0] : PATCH[0] + PATCH[2], PATCH[1] : PATCH[1] + PATCH[3]]
    assert {int(level) for level in patch.ravel()} == {10}


@pytest.mark.parametrize(
    "table",
    [
        {"dark_level": 9, "bright_level": 9},
        {"grey_table": [3]},
        {"dark_level": 300},
        {"grey_table": [7, 7]},
        {"grey_table": [0, 200, 100]},
        {"grey_table": [10, 200], "dark_level": 0},
        {"grey_table": [0, 200], "bright_level": 255},
    ],
)
def test_levels_that_cannot_be_are_refused(table):
    with pytest.raises(ValidationError):
        VideoOutOptions.model_validate({"kind": "video"} | table)


@pytest.mark.parametrize(
    ("trigger", "pulses", "lasting_s"),
    [
        (TriggerOut.PER_EXPOSURE, 1, 1 / 60),
        (TriggerOut.PER_MASK, 3, 1 / 60),
        (TriggerOut.GATE, 1, 0.15),
    ],
)
def test_the_patch_is_lit_as_a_trigger_line_would_be_with_the_mask_itself(trigger, pulses, lasting_s):
    bench = Bench(trigger_patch=PATCH, frames_late=1)
    shown = bench.play(bench.sequence(trigger=trigger))
    edges = bench.world.bus.edges
    rises = [edge.when_s for edge in edges if edge.level]
    assert len(rises) == pulses
    assert rises[0] == pytest.approx(shown[0].start_s)
    assert [b.when_s - a.when_s for a, b in zip(edges[::2], edges[1::2], strict=True)] == pytest.approx(
        [lasting_s] * pulses
    )


@pytest.mark.parametrize("fault", ["doubled", "dropped"])
def test_a_picture_that_is_doubled_or_dropped_does_not_go_unseen(fault):
    bench = Bench()
    bench.faults.inject(f"screen.{fault}", skip=5)
    with pytest.raises(SequenceError, match=f"picture was {fault}.*compositor"):
        bench.play(bench.sequence())
    bench.world.clock.sleep_s(0.1)
    assert not bench.world.masks_between(bench.world.clock.now_s() - 0.01, bench.world.clock.now_s())
    assert len(bench.play(bench.sequence())) == 3


def test_every_refresh_of_a_minute_is_counted():
    bench = Bench()
    before = bench.twin.refreshes
    bench.play(bench.sequence(exposure_s=0.5, pause_s=0.5, repeats=30))
    # Dark before, at the end, and 60 s at 60 Hz.
    assert bench.twin.refreshes - before == 3600 + 3


def test_a_sequence_that_runs_for_ever_is_not_waited_for_longer_than_allowed():
    bench = Bench()
    bench.modulator.upload(bench.sequence(repeats=0))
    bench.modulator.arm()
    bench.modulator.start()
    with pytest.raises(NoAnswerError, match="wait longer or disarm"):
        bench.modulator.wait_done(1.0)
    assert bench.modulator.status().state is ModulatorState.RUNNING
    bench.modulator.disarm()
    assert bench.modulator.status().state is ModulatorState.LOADED


def test_an_output_that_is_unplugged_is_told():
    bench = Bench()
    bench.twin.unplug()
    with pytest.raises(DisconnectedError, match="the video output has been disconnected"):
        bench.modulator.status()


def test_a_night_light_that_comes_between_two_captures_is_undone_and_told():
    """redshift and the desktops' night lights bend the output's gamma ramp: grey 128 of a mask would pass a quarter."""
    bench = Bench()
    sequence = bench.sequence(bits=8)
    sequence.masks[:, :4] = 128
    bench.play(sequence)
    assert bench.modulator.incidents == []
    bench.twin.ramp = bench.twin.ramp**2
    shown = bench.play(sequence)
    assert {int(mask.levels[0, 0]) for mask in shown} == {round(128 / 255 * 0xFFFF)}
    assert bench.modulator.incidents == ["slm: a gamma ramp showed level 128 as 64"]
