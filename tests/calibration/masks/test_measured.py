import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_calibration.masks.measured import IGNORANT_SE, MaskSums, PatternKind, estimate_masks, pass_order
from gs2ci_calibration.masks.references import References

SIZE = (20, 24)
TRUE = np.random.default_rng(0).random((3, *SIZE))
LIGHT = {PatternKind.ON: 1.0, PatternKind.OFF: 0.05, PatternKind.HELD_OUT: 0.4}


def references():
    return References(np.full(SIZE, 800.0), np.full(SIZE, 40.0), np.ones(SIZE, bool), 10.0)


def filled(*, frames=6, drift=0.0, noise=True, dead=False):
    rng = np.random.default_rng(1)
    order = pass_order([0, 1, 2], held_out=True)
    sums = MaskSums(3, references(), np.full(SIZE, 20.0))
    place, k = np.mgrid[: len(order), :frames]
    time_s = 1e-2 * (place + k * len(order))
    readings = np.empty((*time_s.shape, *SIZE))
    for p, kind in enumerate(order):
        for f in range(frames):
            mean = 800.0 * LIGHT.get(kind, 1.0) * (1 + drift * time_s[p, f])
            mean = mean * (TRUE[kind] if kind >= 0 else np.ones(SIZE))
            shot = rng.normal(0, np.sqrt(0.4 * mean + 4)) if noise else 0.0
            readings[p, f] = 20 + mean + shot
    if dead:
        readings[:, :, 3, 4] = 20.0
    sums.add(readings, time_s, order)
    return sums


def test_a_pass_looks_at_the_lamp_before_after_and_among_the_masks():
    order = pass_order(range(9), held_out=True)
    assert [kind for kind in order if kind >= 0] == list(range(9))
    assert order[0] == order[-1] == PatternKind.ON
    assert order.count(PatternKind.ON) == 5
    assert order.count(PatternKind.OFF) == order.count(PatternKind.HELD_OUT) == 1
    assert PatternKind.HELD_OUT not in pass_order([4, 5])


def test_masks_and_their_standard_errors_are_true():
    found = estimate_masks(filled(), references(), 3, 0.0)
    assert found.masks == pytest.approx(TRUE, abs=0.06)
    agrees = np.abs(found.masks - TRUE) <= 2 * found.standard_error
    assert 0.92 < agrees.mean() < 0.98
    assert found.rms_se == pytest.approx(float(np.sqrt(np.mean(np.square(found.masks - TRUE)))), rel=0.1)
    assert np.mean(np.abs(found.held_out - 0.4) <= 2 * found.held_out_se) > 0.9
    assert np.mean(np.abs(found.leakage - 0.05) <= 2 * found.leakage_se) > 0.9


def test_a_drifting_lamp_is_divided_out():
    found = estimate_masks(filled(drift=0.2, frames=4), references(), 3, 0.0)
    assert float(np.mean(found.masks - TRUE)) == pytest.approx(0.0, abs=2e-3)


def test_an_uncertain_dark_reading_raises_the_standard_error():
    sure, unsure = (estimate_masks(filled(), references(), 3, error) for error in (0.0, 8.0))
    assert unsure.rms_se > sure.rms_se


def test_a_pixel_that_died_meanwhile_is_known_to_be_unknown():
    found = estimate_masks(filled(dead=True), references(), 3, 0.0)
    assert not found.valid[3, 4]
    assert np.all(found.masks[:, 3, 4] == 0)
    assert np.all(found.standard_error[:, 3, 4] == np.float32(IGNORANT_SE))
    assert np.isfinite(found.standard_error).all()


def test_a_single_frame_has_no_variance_of_its_own():
    assert not filled(frames=1).sample_variance(0).any()
    assert filled(frames=1).frames(0) == 1


@pytest.mark.parametrize(
    ("places", "times", "order"),
    [(3, (3, 2), (PatternKind.ON, 0)), (2, (3, 2), (PatternKind.ON, 0)), (2, (2, 2), (PatternKind.OFF, 0))],
)
def test_frames_that_do_not_fit_their_order_are_refused(places, times, order):
    with pytest.raises(InputError, match="places"):
        MaskSums(1, references(), np.zeros(SIZE)).add(np.zeros((places, 2, *SIZE)), np.zeros(times), order)
