"""From a sequence of masks to entries, trigger bits and image blocks."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci_drivers.dlpc900.options import Dlpc900Options
from gs2ci_drivers.dlpc900.plan import digest_masks, encode_images, lut_entries
from gs2ci_drivers.dlpc900.timing import upload_s
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_sims.wires.dlpc900_images import read_image

MASKS = np.random.default_rng(5).integers(0, 2, (30, 8, 10), dtype=np.uint8)
SEQUENCE = PatternSequence(MASKS, 1, 200e-6, dark_s=50e-6, pause_s=900e-6)


def test_entries_follow_the_masks_through_images_and_bits() -> None:
    entries = lut_entries(SEQUENCE)
    assert [entry.index for entry in entries] == list(range(30))
    assert [(entry.image_index, entry.bit_position) for entry in entries] == [divmod(i, 24) for i in range(30)]
    assert {entry.exposure_us for entry in entries} == {200}
    assert [entry.dark_us for entry in entries] == [50] * 29 + [900]


@pytest.mark.parametrize(
    ("trigger", "fires"),
    [
        (TriggerOut.PER_EXPOSURE, [True] + [False] * 29),
        (TriggerOut.PER_MASK, [True] * 30),
        (TriggerOut.GATE, [False] * 30),
        (TriggerOut.NONE, [False] * 30),
    ],
)
def test_trigger_output_2_fires_where_the_mode_says(trigger: TriggerOut, fires: list[bool]) -> None:
    entries = lut_entries(replace(SEQUENCE, trigger=trigger))
    assert [entry.trigger_out_2 for entry in entries] == fires


def test_two_controllers_get_a_half_each_in_the_order_of_the_manual() -> None:
    images = encode_images(SEQUENCE, Dlpc900Options(), dual=True)
    assert [(index, secondary) for index, secondary, _ in images.in_order()] == [
        (1, True),
        (1, False),
        (0, True),
        (0, False),
    ]
    height, width = MASKS.shape[1:]
    whole = encode_images(SEQUENCE, Dlpc900Options(), dual=False).primary
    for i in range(2):
        halves = [read_image(side[i], width // 2, height) for side in (images.primary, images.secondary)]
        np.testing.assert_array_equal(np.hstack(halves), read_image(whole[i], width, height))


def test_size_and_time_are_the_sum_over_blocks() -> None:
    images = encode_images(SEQUENCE, Dlpc900Options(), dual=True)
    blocks = images.primary + images.secondary
    assert images.total_bytes == sum(len(block) for block in blocks)
    assert images.upload_s == pytest.approx(sum(upload_s(len(block)) for block in blocks))


def test_times_and_triggers_do_not_change_the_fingerprint_but_masks_and_depth_do() -> None:
    same = replace(SEQUENCE, exposure_s=1e-3, pause_s=0.0, trigger=TriggerOut.NONE, repeats=9)
    assert digest_masks(same) == digest_masks(SEQUENCE)
    assert digest_masks(replace(SEQUENCE, masks=1 - MASKS)) != digest_masks(SEQUENCE)
    deeper = replace(SEQUENCE, bit_depth=2)
    assert digest_masks(deeper) != digest_masks(SEQUENCE)
    assert digest_masks(replace(deeper, masks=3 * MASKS)) not in (
        digest_masks(deeper),
        digest_masks(replace(deeper, masks=2 * MASKS)),
    )
    assert digest_masks(replace(SEQUENCE, masks=MASKS.reshape(30, 10, 8))) != digest_masks(SEQUENCE)


def test_the_firmware_profile_decides_the_pixel_format() -> None:
    for name, pixel_format in (("rev-j", 1), ("rev-f", 0)):
        images = encode_images(SEQUENCE, Dlpc900Options(firmware=name), dual=False)
        assert images.primary[0][24] == pixel_format
