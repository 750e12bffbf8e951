"""What a procedure sees of a bench, and the searches and checks that need one."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.rig.calibrating import TerminalOperator
from gs2ci.rig.config import RigTable
from gs2ci_calibration.bench import Arrangement, Bench, Stack
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.drift import changes_since
from gs2ci_calibration.exposing import Level, find_exposure
from gs2ci_calibration.frames import Dark
from gs2ci_calibration.masks.taking import light_up, take
from gs2ci_calibration.photon_transfer import _take_full
from gs2ci_calibration.procedures import PROCEDURES
from gs2ci_calibration.refusals import CalibrationError, Reason
from gs2ci_drivers.failures import PlanRefusedError
from gs2ci_drivers.plan import Mode
from tests.bench_truth import opened
from tests.calibration.random_benches import random_table


@pytest.fixture
def bench():
    with opened(random_table(7)) as (bench, _):
        yield bench


def dark_of(bench):
    zero = np.zeros(bench.size)
    return Dark(zero + 64, zero, zero > 0, zero > 0)


def test_frames_come_pattern_by_pattern_and_pass_by_pass(bench):
    bench.please(Arrangement.FLAT)
    patterns = np.stack([bench.flat_pattern(is_open=is_open) for is_open in (False, True, False)])
    stack = bench.grab(patterns, frames=2, exposure_s=2e-3)
    assert stack.readings.shape == (3, 2, *bench.size)
    means = stack.readings.mean(axis=(2, 3))
    assert (means[1] > means[[0, 2]].max() + 50).all()
    assert (np.diff(stack.time_s.T.ravel()) > 0).all()
    assert stack.exposure_s == pytest.approx(2e-3, abs=1e-5)


def test_one_exposure_spans_all_patterns(bench):
    bench.please(Arrangement.FLAT)
    patterns = np.stack([bench.flat_pattern(is_open=is_open) for is_open in (True, False, True, False)])
    half = bench.expose(patterns, mask_s=1e-3, exposure_s=4e-3, frames=2).readings
    whole = bench.expose(patterns[[0, 2]], mask_s=2e-3, exposure_s=4e-3, frames=2).readings
    assert half.shape == (1, 2, *bench.size)
    ratio = (half.mean() - 64) / (whole.mean() - 64)
    assert ratio == pytest.approx(0.5, abs=0.05)


@pytest.fixture
def coarse(bench):
    """The bench with a modulator whose times are multiples of 7 ms."""
    modulator, step_s = bench.devices.modulator, 7e-3
    modulator._info = replace(
        modulator.connect(), exposure_step_s=step_s, min_dark_s=step_s, min_exposure_s={1: step_s}
    )
    return bench


def test_a_modulator_of_coarse_times_changes_no_exposure(coarse):
    patterns = np.stack([coarse.flat_pattern(is_open=is_open) for is_open in (True, False)])
    one_each = coarse.grab(patterns, frames=1, exposure_s=10e-3)
    assert one_each.plan.sequence.exposure_s == pytest.approx(14e-3)
    assert one_each.exposure_s == pytest.approx(10e-3, abs=1e-5)
    both = coarse.expose(patterns, mask_s=13.5e-3, exposure_s=27e-3, frames=1)
    assert both.plan.sequence.exposure_s == pytest.approx(14e-3)
    assert both.exposure_s == pytest.approx(27e-3, abs=1e-5)
    assert coarse.devices.modulator.loaded.exposure_s == both.plan.sequence.exposure_s


@pytest.mark.parametrize("shown_s", [0.0, 11e-3, 33e-3])
def test_a_gated_pass_has_times_that_the_modulator_keeps(coarse, monkeypatch, shown_s):
    monkeypatch.setattr(Bench, "_run", lambda bench, settings: settings)
    gated = replace(coarse, capture=replace(coarse.capture, mode=Mode.GATE))
    asked = gated.grab(gated.flat_pattern(is_open=True)[None], frames=1, exposure_s=10e-3, shown_s=shown_s)
    kept = asked.rounded_for(coarse.devices.modulator.info)
    assert (asked.mask_s, asked.dark_s) == (kept.mask_s, kept.dark_s)


def test_no_frames_and_no_patterns_are_refused(bench):
    pattern = bench.flat_pattern(is_open=True)
    for patterns, frames in ((pattern[None], 0), (pattern, 1), (pattern[None][:0], 1)):
        with pytest.raises(InputError, match=r"patterns \[N, Hm, Wm\]"):
            bench.grab(patterns, frames=frames, exposure_s=1e-3)


def test_a_bench_without_a_stage_says_so(bench):
    with pytest.raises(CalibrationError) as error:
        bench.move({"x": 1.0})
    assert error.value.reason is Reason.NO_STAGE


@pytest.mark.parametrize("radiance", [0.05, 4.0])
def test_an_exposure_is_found_that_fills_the_wanted_share(radiance):
    world = random_table(8).world.model_dump() | {"flat_radiance": radiance}
    with opened(RigTable.model_validate(random_table(8).model_dump() | {"world": world})) as (bench, truth):
        bench.please(Arrangement.FLAT)
        level = find_exposure(bench, "masks", dark_of(bench), 0.5)
        end_dn = truth.full_well_e / truth.gain_e_per_dn
        reached = level.rate_dn_per_s * level.exposure_s / end_dn
    assert 0.3 < reached < 0.7


def test_a_person_is_asked_once_for_each_arrangement():
    asked = []
    operator = TerminalOperator(asked.append)
    for setup, index in (
        (Arrangement.DARK, 0),
        (Arrangement.DARK, 0),
        (Arrangement.BOARD, 0),
        (Arrangement.BOARD, 1),
        (Arrangement.DARK, 0),
    ):
        operator.please(setup, index)
    assert len(asked) == 4
    assert "lens cap" in asked[0]
    assert "picture 2" in asked[2]


def test_drift_is_none_right_after_and_found_when_it_is_there():
    def table(**world):
        told = random_table(9).model_dump()
        return RigTable.model_validate({**told, "world": {**told["world"], **world}})

    with opened(table()) as (bench, _):
        bundle = Bundle()
        for step in ("dark-flat", "sensor"):
            bundle = bundle.with_section(PROCEDURES[step](bench, bundle))
        assert not [change.what for change in changes_since(bench, bundle) if change.too_far]
    sensor = table().world.sensor
    for change, what in (
        ({"sensor": {**sensor.model_dump(), "electrons_per_dn": 1.2 * sensor.electrons_per_dn}}, "gain"),
        ({"sensor": {**sensor.model_dump(), "black_level_dn": 70.0}}, "black level"),
        ({"sensor": {**sensor.model_dump(), "read_noise_e": 2 * sensor.read_noise_e}}, "dark noise"),
        ({"effects": {**table().world.effects, "prnu": {"spread": 0.06}}}, "response, rms over pixels"),
    ):
        with opened(table(**change)) as (bench, _):
            assert what in [one.what for one in changes_since(bench, bundle) if one.too_far]


def test_drift_is_not_judged_by_a_lamp_that_is_off():
    with opened(random_table(10)) as (bench, _):
        bundle = Bundle().with_section(PROCEDURES["dark-flat"](bench, Bundle()))
        blind = replace(bench, operator=_AlwaysDark(bench.operator))
        with pytest.raises(CalibrationError) as error:
            changes_since(blind, bundle)
    assert error.value.reason is Reason.NO_LIGHT


class _AlwaysDark:
    def __init__(self, operator):
        self.operator = operator

    def please(self, setup, index):
        self.operator.please(Arrangement.DARK, index)


def at_depth(bench, bits):
    return replace(bench, capture=replace(bench.capture, bit_depth=bits))


@pytest.mark.parametrize(("bits", "top", "kind"), [(1, 1, np.uint8), (8, 255, np.uint8), (10, 1023, np.uint16)])
def test_patterns_are_laid_out_at_the_depth_of_the_capture(bench, bits, top, kind):
    shown = at_depth(bench, bits).deep(bench.flat_pattern(is_open=True))
    assert (shown.dtype, shown.min(), shown.max()) == (kind, top, top)
    assert not at_depth(bench, bits).deep(bench.flat_pattern(is_open=False)).any()


def test_masks_deeper_than_a_byte_are_measured_before_the_even_light():
    table = RigTable.model_validate(
        {
            "modulator": {"kind": "santec"},
            "sensor": {"kind": "v4l2", "format": "Y12", "black_level_dn": 64.0},
            "capture": {"masks": 2, "bit_depth": 10, "mode": "per-mask", "mask_s": 0.2},
            "calibration": {"frames": 4, "mask_frames": 2},
            "world": {"scene": "planes", "height": 32, "width": 48, "flat_radiance": 0.1, "devices": "ideal"},
        }
    )
    with opened(table) as (bench, _):
        known = Bundle().with_section(PROCEDURES["dark-flat"](bench, Bundle()))
        field = light_up(bench, known, "masks")
        codes = np.full((1, *bench.codes.shape[1:]), 255, np.uint16)  # which a byte holds, unlike the references
        seen = take(bench, field, bench.lay_out(codes), frames=1, step="masks").mean(0)
    lit = field.references.valid
    assert lit.mean() > 0.9
    assert seen[lit].mean() / field.references.on[lit].mean() == pytest.approx(255 / 1023, abs=0.03)


def test_a_depth_that_the_modulator_lacks_is_refused_with_those_it_has(bench):
    with pytest.raises(PlanRefusedError, match="mask depth is 12 bits, allowed: 1, 8 bits"):
        bench.grab(bench.flat_pattern(is_open=True)[None], frames=1, exposure_s=1e-3, bit_depth=12)


def test_a_run_holds_as_many_patterns_as_the_modulator_has_room_for_at_their_depth():
    table = RigTable.model_validate(
        {
            "modulator": {"kind": "dlpc900", "trigger_out_2_bit": "disables"},
            "sensor": {"kind": "v4l2"},
            "world": {"scene": "planes", "height": 32, "width": 48},
        }
    )
    with opened(table) as (bench, _):
        assert (bench.capacity, at_depth(bench, 8).capacity) == (400, 50)


def test_readings_that_still_grow_when_the_pixels_are_full_are_refused(bench, monkeypatch):
    def unending(self, patterns, *, frames, exposure_s, **_):
        level = 64 + 1e5 * np.log1p(exposure_s)  # a tone curve
        return Stack(np.full((1, frames, *self.size), level, np.float32), np.zeros((1, frames)), exposure_s, None)

    monkeypatch.setattr(Bench, "grab", unending)
    with pytest.raises(CalibrationError, match="readings still grow by") as error:
        _take_full(bench, dark_of(bench), Level(0.01, 1e5))
    assert error.value.reason is Reason.NOT_LINEAR
