"""Grey masks under a lamp that stays on: their light, and the plan that refuses them as drawn."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci_drivers.dlpc900.driver import Dlpc900
from gs2ci_drivers.dlpc900.options import Dlpc900Options
from gs2ci_drivers.failures import PlanRefusedError
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_drivers.plan import Mode
from gs2ci_sims.wires.dlpc900 import Dlpc900Twin
from gs2ci_sims.wires.dlpc900_lamp import LOAD_S, light_of, plane_times_s
from gs2ci_sims.world import World
from tests.drivers.test_planning import MODULATOR, broken, plan

RAMP = np.arange(256, dtype=np.uint8)


@pytest.mark.parametrize("depth", range(2, 9))
@pytest.mark.parametrize("exposure_s", [4.046e-3, 5e-3, 20e-3, 0.2])
def test_planes_share_the_time_by_weight_but_none_is_shorter_than_a_load(depth, exposure_s):
    times_s = plane_times_s(depth, exposure_s)
    assert times_s.sum() == pytest.approx(exposure_s)
    assert times_s.min() >= LOAD_S * (1 - 1e-9)
    long = times_s[times_s > LOAD_S * (1 + 1e-9)]
    assert long[1:] / long[:-1] == pytest.approx(2.0)


def test_level_seven_of_eight_bits_in_five_milliseconds_passes_more_than_twice_its_share():
    light = light_of(RAMP[None], 8, 5e-3)[0] / 65_535
    assert light[7] == pytest.approx(3 * LOAD_S / 5e-3, abs=1e-4)  # 0.063, of 0.027 as drawn
    assert light[7] > 2 * 7 / 255
    assert (light[0], light[255]) == (0.0, 1.0)


def test_at_long_times_light_is_in_proportion():
    light = light_of(RAMP[None], 8, 0.2)[0] / 65_535
    assert light == pytest.approx(RAMP / 255, abs=2e-5)


def shown(lamp, masks, bits):
    world = World()
    twin = Dlpc900Twin(world, lamp=lamp, dmd=5)
    options = Dlpc900Options(trigger_out_2_bit="disables")
    dmd = Dlpc900("dmd0", twin.open(), world.clock, options)
    dmd.connect()
    dmd.upload(PatternSequence(masks, bits, 5e-3, trigger=TriggerOut.NONE))
    dmd.arm()
    begin_s = world.clock.now_s()
    dmd.start()
    dmd.wait_done(1.0)
    (interval,) = world.masks_between(begin_s, world.clock.now_s())
    return interval.levels / interval.top


def test_the_twins_mirrors_give_that_light_through_the_driver():
    masks = np.zeros((1, 768, 1024), np.uint8)
    masks[0, :, :256] = RAMP
    switched, continuous = (shown(lamp, masks, 8)[5, :256] for lamp in ("switched", "continuous"))
    assert switched == pytest.approx(RAMP / 255)
    assert continuous == pytest.approx(light_of(RAMP[None], 8, 5e-3)[0] / 65_535)
    binary = (masks > 100).astype(np.uint8)
    np.testing.assert_array_equal(shown("continuous", binary, 1), shown("switched", binary, 1))


@pytest.mark.parametrize("left", [0, 7])
@pytest.mark.parametrize(("lamp", "factor"), [("switched", 1.0), ("", None)])
def test_a_switched_lamp_follows_the_masks_again_whatever_another_program_left(left, lamp, factor):
    masks = np.full((1, 768, 1024), 7, np.uint8)
    world = World()
    twin = Dlpc900Twin(world, dmd=5)
    twin.firmware.write(0x1A07, bytes([left]))
    dmd = Dlpc900("dmd0", twin.open(), world.clock, Dlpc900Options(lamp=lamp, trigger_out_2_bit="disables"))
    dmd.connect()
    dmd.upload(PatternSequence(masks, 8, 5e-3, trigger=TriggerOut.NONE))
    (light,) = set(twin.firmware._step(twin.firmware.table[0]).levels.flat)
    top = twin.firmware._step(twin.firmware.table[0]).top
    if factor:
        assert light / top == pytest.approx(7 / 255)
        assert any("LED enables" in text for text in dmd.incidents)
    else:
        assert light / top == pytest.approx(3 * LOAD_S / 5e-3, abs=1e-4) if left else light == 0


GREY = replace(MODULATOR, grey_unsettled="its lamp stays on")
LEVELS = np.arange(4 * 6 * 8, dtype=np.uint8).reshape(4, 6, 8)[:2]


def test_grey_masks_as_drawn_are_refused_and_measured_ones_are_not():
    grey = {"masks": LEVELS, "bit_depth": 8, "modulator": GREY}
    assert broken(plan(**grey)) == {"grey masks"}
    with pytest.raises(PlanRefusedError, match=r"grey masks is as drawn; its lamp stays on.*calibrate them.*switched"):
        plan(**grey).require_sound()
    assert not broken(plan(measured=True, **grey))
    assert not broken(plan(mode=Mode.PER_MASK, **grey)), "they are measured by frames of single masks"


def test_binary_masks_and_levels_at_both_ends_are_as_drawn_under_any_lamp():
    assert not broken(plan(modulator=GREY))
    ends = np.where(LEVELS > 40, 255, 0).astype(np.uint8)
    assert not broken(plan(masks=ends, bit_depth=8, modulator=GREY))


@pytest.mark.parametrize(("lamp", "linear"), [("switched", True), ("continuous", False), ("", False)])
def test_only_a_lamp_that_is_stated_to_be_switched_makes_grey_levels_linear(lamp, linear):
    world = World()
    dmd = Dlpc900("dmd0", Dlpc900Twin(world, dmd=5).open(), world.clock, Dlpc900Options(lamp=lamp))
    assert (dmd.connect().grey_unsettled == "") is linear
