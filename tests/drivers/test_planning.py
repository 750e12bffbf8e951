from dataclasses import replace

import numpy as np
import pytest

from gs2ci_drivers.axis import AxisInfo
from gs2ci_drivers.failures import PlanRefusedError
from gs2ci_drivers.pattern_sequence import ModulatorInfo, TriggerOut
from gs2ci_drivers.plan import CaptureSettings, KnownOptics, Mode, Travel, table
from gs2ci_drivers.planning import CLOCK_TOLERANCE, lay_out, overlap_weights, sensor_exposure_s
from gs2ci_drivers.sensor import FrameFormat, SensorInfo, SensorSettings, TriggerMode
from gs2ci_drivers.stage import StageInfo

MODULATOR = ModulatorInfo(
    model="m", serial="", firmware="", height=6, width=8, pitch_m=8e-6,
    min_exposure_s={1: 105e-6, 8: 4046e-6}, max_exposure_s=1.0, exposure_step_s=1e-6, min_dark_s=1e-6,
    capacity={1: 16, 8: 2}, trigger_outs=frozenset(TriggerOut), start_latency_s=0.05,
)  # fmt: skip
SENSOR = SensorInfo(
    model="s", serial="", driver="", formats=(FrameFormat("Y12", 6, 8, 12),),
    min_exposure_s=1e-5, max_exposure_s=1.0, exposure_step_s=1e-5, triggers=frozenset(TriggerMode),
)  # fmt: skip
AXIS = AxisInfo("x", 0.0, 100.0, 0.001, 40.0, 0.001, 200.0)
STAGE = StageInfo("z", "", "", {"x": AXIS})


def plan(
    stage=STAGE,
    modulator=MODULATOR,
    readout_s=1e-3,
    exposure_s=None,
    full_well_e=10000.0,
    setup_changes=None,
    **changes,
):
    settings = CaptureSettings(**({"masks": np.ones((4, 6, 8), np.uint8), "mask_s": 0.01} | changes))
    setup = SensorSettings(
        SENSOR.formats[0],
        sensor_exposure_s(settings) if exposure_s is None else exposure_s,
        settings.trigger_mode,
        readout_s,
        full_well_e=full_well_e,
        **(setup_changes or {}),
    )
    return lay_out(settings, modulator, SENSOR, setup, stage)


def broken(plan_):
    return {figure.what for figure in plan_.broken}


def test_a_sound_plan_breaks_nothing_and_has_its_rows():
    sound = plan(travel=Travel("x", 40.0, 41.0), optics=KnownOptics(1e5, 900.0, 300.0, 1000.0))
    assert sound.require_sound() is sound
    assert (sound.fires, sound.frames_per_shot) == (1, 1)
    rows = {what: (value, verdict) for what, value, _, verdict in table(sound)}
    assert rows["stage speed"] == ("25.0000 mm/s", "ok")
    assert rows["motion in the picture"][0].startswith("3.00 px near, 0.90 px far")
    assert rows["parallax"][0] == "2.10 px between near and far"


def test_a_travel_in_metres_is_said_to_show_no_depth():
    small = plan(travel=Travel("x", 0.040, 0.041), optics=KnownOptics(1e5, 900.0, 300.0, 1000.0))
    rows = {what: value for what, value, *_ in table(small)}
    assert rows["parallax"] == "0.00 px between near and far; too little for depth"


def test_weights_are_the_overlap_of_mask_and_exposure():
    windows = np.array([[0.0, 1.0], [1.0, 2.0], [2.0, 3.0]])
    assert overlap_weights(windows, 0.25, 2.5) == pytest.approx([0.75, 1.0, 0.5])
    assert overlap_weights(windows, 5.0, 6.0) == pytest.approx([0.0, 0.0, 0.0])
    assert plan(margin_s=0.005).weights == pytest.approx([1.0, 1.0, 1.0, 0.5], abs=2e-3)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6, 7, 8, 9, 12, 16])
def test_turned_exposures_show_each_mask_once_in_each_interval(count):
    turned = plan(masks=np.ones((count, 6, 8), np.uint8), shots=count, turned=True)
    assert turned.turns
    assert sorted(map(turned.first_mask, range(count))) == list(range(count))
    assert turned.first_mask(count) == turned.first_mask(0) == 0


def test_the_plan_names_the_masks_that_turned_exposures_begin_with():
    eight = plan(masks=np.ones((8, 6, 8), np.uint8), shots=3, turned=True)
    rows = {what: value for what, value, *_ in table(eight)}
    assert rows["first mask"] == "another one in each start of the modulator: 1, 4, 7"


@pytest.mark.parametrize(
    "changes", [{"shots": 1}, {"shots": 4, "burst": 4}, {"shots": 2, "mode": Mode.PER_MASK}, {"shots": 2}]
)
def test_one_start_frames_of_single_masks_and_what_is_not_asked_for_are_not_turned(changes):
    same = plan(turned=len(changes) > 1 or changes["shots"] == 1, **changes)
    assert not same.turns
    assert "first mask" not in {figure.what for figure in same.figures}
    assert same.first_mask(1) == 0


def test_a_burst_gets_the_pause_that_readout_needs():
    burst = plan(shots=4, burst=2, readout_s=3e-3)
    assert burst.sequence.pause_s == pytest.approx(3.02e-3 + CLOCK_TOLERANCE * burst.exposure_s, abs=2e-6)
    assert not burst.broken
    assert burst.fires == 2
    assert plan().sequence.pause_s == 0.0


def test_a_slow_link_spaces_frames_out_and_is_named():
    burst = plan(shots=4, burst=2, setup_changes={"link_s": 60e-3})
    assert burst.sequence.period_s == pytest.approx(60e-3 * (1 + CLOCK_TOLERANCE) + 20e-6, abs=2e-6)
    assert not burst.broken
    (row,) = (figure for figure in burst.figures if figure.what == "exposure + readout")
    assert row.value.endswith("by its link")
    assert plan(mode=Mode.PER_MASK, setup_changes={"link_s": 60e-3}).sequence.dark_s == pytest.approx(50e-3, abs=1e-4)
    faster = plan(shots=4, burst=2, setup_changes={"link_s": 5e-3})
    assert faster.sequence.period_s == plan(shots=4, burst=2).sequence.period_s


def test_rows_that_begin_one_after_the_other_need_long_masks():
    """A skew of 0.3 ms is 3 % of masks of 10 ms, and 2 % of masks of 15 ms."""
    short = plan(setup_changes={"rows_s": 0.3e-3})
    assert broken(short) == {"rolling shutter"}
    with pytest.raises(PlanRefusedError, match=r"3.0% of a mask.*at most 2%.*set `mask_s` to 0.015 or more"):
        short.require_sound()
    assert not plan(mask_s=0.015, setup_changes={"rows_s": 0.3e-3}).broken
    assert not plan(mode=Mode.PER_MASK, setup_changes={"rows_s": 0.3e-3}).broken


def test_calibration_gets_the_dark_time_that_readout_needs():
    calibration = plan(mode=Mode.PER_MASK, readout_s=3e-3)
    assert calibration.sequence.dark_s == pytest.approx(3.02e-3, abs=2e-6)
    assert calibration.frames_per_shot == 4
    assert not calibration.broken


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"mask_s": 1e-4}, "time per mask"),
        ({"mask_s": 2.0}, "time per mask"),
        ({"masks": np.ones((17, 6, 8), np.uint8)}, "masks"),
        ({"masks": np.ones((4, 5, 8), np.uint8)}, "masks"),
        ({"bit_depth": 3}, "mask depth"),
        ({"shots": 3, "burst": 2}, "shots"),
        ({"shots": 0}, "shots"),
        ({"exposure_s": 0.02}, "exposure"),
        ({"exposure_s": 0.06, "burst": 2, "shots": 2, "readout_s": -0.03}, "exposure"),
        ({"optics": KnownOptics(1e6)}, "bright pixels of a white scene"),
        ({"travel": Travel("x", 40.0, 80.0)}, "travel"),
        ({"travel": Travel("x", 99.0, 99.9)}, "travel"),
        ({"travel": Travel("q", 40.0, 41.0)}, "travel"),
        ({"travel": Travel("x", 40.0, 41.0), "stage": None}, "travel"),
        ({"travel": Travel("x", 40.0, 40.0)}, "travel"),
    ],
)
def test_every_limit_is_checked_and_named(changes, what):
    refused = plan(**changes)
    assert what in broken(refused)
    with pytest.raises(PlanRefusedError, match=what) as caught:
        refused.require_sound()
    figure = next(figure for figure in refused.broken if figure.what == what)
    assert figure.remedy in str(caught.value)
    assert (what, "NO") in [(row[0], row[3]) for row in table(refused)]


def test_a_trigger_that_the_modulator_lacks_is_named():
    lacking = replace(MODULATOR, trigger_outs=frozenset({TriggerOut.PER_MASK}))
    assert broken(plan(modulator=lacking)) == {"trigger output"}


def coarse(step_s):
    return replace(MODULATOR, exposure_step_s=step_s, min_exposure_s={1: step_s}, min_dark_s=1.5 * step_s)


@pytest.mark.parametrize("seed", range(20))
def test_an_upload_changes_no_time_of_a_plan(seed):
    rng = np.random.default_rng(seed)
    step_s = float(rng.choice([1e-6, 1e-3, 1 / 59.94, 1 / 60, 7e-3]))
    laid = plan(
        modulator=coarse(step_s),
        mode=list(Mode)[seed % 3],
        mask_s=rng.uniform(0.3, 9) * step_s,
        dark_s=rng.uniform(0, 3) * step_s * (seed % 2),
        burst=int(rng.integers(1, 4)),
        readout_s=rng.uniform(0, 0.05),
    )
    sequence = laid.sequence
    for time_s in (sequence.exposure_s, sequence.dark_s, sequence.pause_s):
        assert coarse(step_s).quantise_s(time_s) == time_s
    assert (laid.settings.mask_s, laid.weights.max() <= 1) == (sequence.exposure_s, True)


@pytest.mark.parametrize(
    ("key", "asked_s", "what", "nearest"),
    [
        ("mask_s", 0.025, "rounded time per mask", "0.01666667 or 0.03333333"),
        ("mask_s", 0.03, "rounded time per mask", "0.01666667 or 0.03333333"),
        ("mask_s", 0.002, "rounded time per mask", "0.01666667"),
        ("dark_s", 0.005, "rounded dark time", "0.03333333"),  # the shortest is one and a half refreshes
        ("dark_s", 0.04, "rounded dark time", "0.03333333 or 0.05"),
    ],
)
def test_a_time_that_the_modulator_would_round_too_far_is_refused_with_those_it_keeps(key, asked_s, what, nearest):
    changes = {"mask_s": 1 / 60, "full_well_e": None, key: asked_s}
    refused = plan(modulator=coarse(1 / 60), **changes)
    figure = next(figure for figure in refused.broken if figure.what == what)
    assert figure.remedy == f"set `{key}` to {nearest}"
    assert figure.limit == f"steps of 16.667 ms; {nearest} s"
    for allowed in nearest.split(" or "):
        assert what not in {
            one.what for one in plan(modulator=coarse(1 / 60), **changes | {key: float(allowed)}).figures
        }


def test_a_time_that_is_rounded_a_little_is_planned_as_it_will_be_shown_and_said():
    rounded = plan(modulator=coarse(1 / 60), mask_s=0.032, travel=Travel("x", 40.0, 41.0), exposure_s=4 / 60)
    assert rounded.sequence.exposure_s == pytest.approx(2 / 60)
    assert rounded.weights == pytest.approx([1, 1, 0, 0], abs=1e-3)  # of the exposure that the sensor got here
    assert rounded.sweep.speed_mm_s == pytest.approx(60 / 8)
    values = {figure.what: figure.value for figure in rounded.figures}
    assert values["rounded time per mask"] == "33.333 ms for mask_s = 0.032 s"
    assert "rounded time per mask" not in broken(rounded)


def test_the_sweep_has_room_for_the_modulators_start():
    moving = plan(travel=Travel("x", 40.0, 41.0))
    assert moving.sweep.from_mm == pytest.approx(40.0 - 25.0 * 0.05)
    assert moving.sweep.to_mm == pytest.approx(41.0 + 25.0 * 0.05)
    back = plan(travel=Travel("x", 41.0, 40.0))
    assert back.sweep.from_mm == pytest.approx(41.0 + 25.0 * 0.05)
    assert back.sweep.to_mm == pytest.approx(40.0 - 25.0 * 0.05)
