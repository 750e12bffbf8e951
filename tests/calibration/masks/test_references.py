import numpy as np
import pytest

from gs2ci_calibration.masks.references import average_references, require_in_place
from gs2ci_calibration.refusals import CalibrationError, Reason

SIZE = (12, 16)
ON, OFF = -1, -2


def frames(level, count=8, noise=2.0, seed=0):
    return (level + np.random.default_rng(seed).normal(0, noise, (count, *SIZE))).astype(np.float32)


def refusal(on, off, saturation_dn=1000.0):
    with pytest.raises(CalibrationError) as caught:
        average_references(on, off, np.full(SIZE, 20.0), saturation_dn=saturation_dn, step="masks")
    assert caught.value.step == "masks"
    return caught.value.reason


def good(on=620.0, off=50.0):
    return average_references(frames(on), frames(off, seed=1), np.full(SIZE, 20.0), saturation_dn=1000.0, step="masks")


def test_good_references_give_the_contrast_map_and_shares():
    references = good()
    assert references.leakage == pytest.approx(np.full(SIZE, 0.05), abs=0.01)
    assert references.shares(0.5 * (references.on + references.off)) == pytest.approx(np.full(SIZE, 0.5))
    assert references.valid.all()
    assert references.noise_dn == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize("which", [0, 1])
def test_a_single_frame_is_refused(which):
    stacks = [frames(620.0), frames(50.0)]
    stacks[which] = stacks[which][:1]
    assert refusal(*stacks) is Reason.TOO_FEW_FRAMES
    stacks[which] = stacks[which][0]
    assert refusal(*stacks) is Reason.TOO_FEW_FRAMES


def test_saturated_references_are_refused_and_a_few_clipped_pixels_are_not_used():
    assert refusal(frames(1000.0), frames(50.0)) is Reason.SATURATED
    on = frames(620.0)
    on[:, 3, 4] = 1000.0
    assert not average_references(on, frames(50.0), np.full(SIZE, 20.0), saturation_dn=1000.0, step="masks").valid[3, 4]


@pytest.mark.parametrize(
    ("on", "off", "reason"),
    [
        (22.0, 21.0, Reason.NO_LIGHT),
        (10.0, 10.0, Reason.NO_LIGHT),
        (50.0, 620.0, Reason.WRONG_POLARITY),
        (620.0, 620.0, Reason.LOW_CONTRAST),
        (620.0, 500.0, Reason.LOW_CONTRAST),
    ],
)
def test_references_that_are_no_good_are_refused(on, off, reason):
    assert refusal(frames(on), frames(off, seed=1)) is reason


def test_frames_without_any_noise_are_judged_without_division_by_nothing():
    assert refusal(np.full((4, *SIZE), 20.0), np.full((4, *SIZE), 20.0)) is Reason.NO_LIGHT


def test_dead_rows_and_columns_are_refused():
    on = frames(620.0)
    on[:, 5] = 21.0
    off = frames(50.0)
    off[:, 5] = 21.0
    assert refusal(on, off) is Reason.DEAD_PIXELS
    on, off = frames(620.0), frames(50.0)
    on[:, :, 7] = off[:, :, 7] = 21.0
    assert refusal(on, off) is Reason.DEAD_PIXELS


def test_many_blind_pixels_are_refused_and_few_are_marked():
    on = frames(620.0)
    on[:, ::2, ::2] = frames(50.0)[:, ::2, ::2]
    on[:, 1::4, 1::2] = frames(50.0)[:, 1::4, 1::2]
    assert refusal(on, frames(50.0)) is Reason.DEAD_PIXELS
    on = frames(620.0)
    on[:, 2, 2] = 50.0
    references = average_references(on, frames(50.0), np.full(SIZE, 20.0), saturation_dn=1000.0, step="masks")
    assert not references.valid[2, 2]
    assert references.leakage[2, 2] == 0.0
    assert references.shares(references.on)[2, 2] == 0.0


def stack_of(levels):
    return np.stack([frames(level, count=3, seed=i) for i, level in enumerate(levels)])


def test_references_in_their_places_pass_whatever_the_lamp_does():
    order = (ON, OFF, 0, 1, ON)
    for lamp in (1.0, 0.7):
        levels = [20 + lamp * level for level in (600.0, 30.0, 300.0, 320.0, 600.0)]
        require_in_place(good(), stack_of(levels), np.full(SIZE, 20.0), order, "masks")


@pytest.mark.parametrize(
    "levels",
    [(620.0, 320.0, 340.0, 620.0, 50.0), (50.0, 320.0, 620.0, 620.0, 340.0), (340.0, 50.0, 620.0, 620.0, 620.0)],
)
def test_references_out_of_place_are_refused(levels):
    with pytest.raises(CalibrationError) as caught:
        require_in_place(good(), stack_of(levels), np.full(SIZE, 20.0), (ON, OFF, 0, 1, ON), "masks")
    assert caught.value.reason is Reason.WRONG_ORDER
