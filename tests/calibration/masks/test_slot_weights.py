from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci_calibration.masks.slot_weights import measure_slots
from gs2ci_calibration.masks.taking import light_up
from gs2ci_calibration.refusals import CalibrationError, Reason
from gs2ci_drivers.plan import Mode

RATE = 8e5


@pytest.fixture
def lit(bench_of_truth, dark_known):
    def build(**truth):
        bench = bench_of_truth(electrons_per_s=RATE, **truth)
        return bench, light_up(bench, dark_known(bench), "masks")

    return build


def test_a_late_trigger_takes_light_from_the_last_mask(lit):
    bench, field = lit(slots=(1.0, 1.0, 1.0, 0.98))
    slots = measure_slots(bench, field, 4095.0, "masks")
    assert slots.measured
    truth = np.array([1.0, 1.0, 1.0, 0.98])
    assert np.all(np.abs(slots.weights.value - truth) < 4 * slots.weights.standard_error)
    assert slots.weights.error < 2e-3


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("per_min", [-0.3, -0.1, 0.1, 0.3])
def test_a_lamp_that_drifts_changes_no_weight_and_widens_no_error(lit, per_min, seed):
    truth = np.array([0.99, 1.0, 1.0, 0.98])
    slots, steady = (
        measure_slots(*lit(slots=tuple(truth), drift_per_s=drift, seed=seed), 4095.0, "masks").weights
        for drift in (per_min / 60, 0.0)
    )
    assert np.all(np.abs(slots.value - truth) < 4 * slots.standard_error)
    assert slots.error < 2 * steady.error


@pytest.mark.parametrize("per_s2", [-2e-3, 2e-3])
def test_what_interpolation_leaves_of_a_lamps_drift_is_in_the_error(lit, per_s2):
    truth = np.array([1.0, 1.0, 1.0, 0.98])
    slots, steady = (
        measure_slots(*lit(slots=tuple(truth), drift_per_s2=drift), 4095.0, "masks").weights for drift in (per_s2, 0.0)
    )
    assert np.all(np.abs(slots.value - truth) < 3 * slots.standard_error)
    assert slots.error > 3 * steady.error


def test_a_slot_that_contradicts_the_plan_is_refused(lit):
    bench, field = lit(slots=(1.0, 1.0, 1.0, 0.7))
    with pytest.raises(CalibrationError, match="mask 3") as caught:
        measure_slots(bench, field, 4095.0, "masks")
    assert caught.value.reason is Reason.BAD_FIT


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"mode": Mode.PER_MASK}, "per-mask"),
        ({"dark_s": 1e-4}, "dark time"),
        ({"mask_s": 10.0}, "range"),
        ({"mask_s": 1e-7}, "range"),
    ],
)
def test_weights_are_as_planned_where_light_cannot_tell(lit, change, word):
    bench, field = lit()
    slots = measure_slots(replace(bench, capture=replace(bench.capture, **change)), field, 4095.0, "masks")
    assert not slots.measured
    assert word in slots.note
    assert np.array_equal(slots.weights.value, np.ones(4))


def test_weights_of_a_gated_capture_are_measured_by_its_gates(lit):
    bench, field = lit()
    slots = measure_slots(replace(bench, capture=replace(bench.capture, mode=Mode.GATE)), field, 4095.0, "masks")
    assert slots.measured


def test_a_plan_without_a_whole_slot_keeps_its_weights(lit, monkeypatch):
    bench, field = lit()
    plan = SimpleNamespace(weights=np.array([0.5, 0.9, 0.9, 0.5]), exposure_s=0.01)
    monkeypatch.setattr(type(bench), "planned", lambda self: plan)
    slots = measure_slots(bench, field, 4095.0, "masks")
    assert "no mask between" in slots.note
    assert np.array_equal(slots.weights.value, plan.weights)
