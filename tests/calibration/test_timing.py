from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from gs2ci_calibration import timing
from gs2ci_calibration.refusals import CalibrationError, Reason
from gs2ci_calibration.timing import Look, TimingEstimate, estimate, overlap
from gs2ci_drivers.pattern_sequence import PatternSequence
from tests.bench_truth import opened
from tests.calibration.random_benches import random_table

LATENCY_S, OFFSET_S = 23e-6, 9e-6


def look(rng, pattern_s, *, jitter_s=2e-6, flicker=0.0, frames=16, rate_dn_per_s=2e5, noise_dn=0.03, shift_s=0.0):
    """Return what a perfect optics would show: the formulae of the module's docstring, with noise."""
    spare_s = 50e-6
    begin = LATENCY_S + shift_s + jitter_s * rng.standard_normal(frames)
    lengths = {
        "closed": np.zeros(frames // 2),
        "inside": np.full(frames // 2, pattern_s),
        "edge": pattern_s - begin,
        "length": np.full(frames // 2, pattern_s + spare_s + OFFSET_S),
    }
    levels = {}
    for kind, seconds in lengths.items():
        lamp = 1 + flicker * rng.standard_normal(len(seconds))
        levels[kind] = 64 + rate_dn_per_s * seconds * lamp + noise_dn * rng.standard_normal(len(seconds))
    return Look(pattern_s, 2 * pattern_s + spare_s, levels, dict.fromkeys(levels, noise_dn**2))


def sweep(seed, **options):
    rng = np.random.default_rng(seed)
    return [look(rng, pattern_s, **options) for pattern_s in (0.5e-3, 0.75e-3, 1e-3)]


def refused(reason, looks):
    with pytest.raises(CalibrationError) as error:
        estimate(looks, 0.0)
    assert error.value.reason is reason, str(error.value)
    return str(error.value)


def test_standard_errors_are_true_over_many_sweeps():
    hits = {"latency_s": 0, "exposure_offset_s": 0, "jitter_s": 0}
    for seed in range(200):
        jitter_s = (0.0, 1e-6, 2.5e-6)[seed % 3]
        found = estimate(sweep(seed, jitter_s=jitter_s), 0.0)
        for name, true in (("latency_s", LATENCY_S), ("exposure_offset_s", OFFSET_S), ("jitter_s", jitter_s)):
            value, error = getattr(found, name)
            hits[name] += abs(value - true) <= 2 * error
    for name, count in hits.items():
        assert count >= binom.ppf(0.001, 200, 0.95), name


def test_latency_counts_from_the_triggers_edge():
    found = estimate(sweep(1), 100e-6)
    assert found.latency_s[0] == pytest.approx(LATENCY_S - 100e-6, abs=1e-6)


def test_flicker_is_not_taken_for_jitter():
    found = estimate(sweep(2, jitter_s=0.0, flicker=0.003, frames=256), 0.0)
    assert found.jitter_s[0] < 2 * found.jitter_s[1] + 0.5e-6
    assert found.flicker == pytest.approx(0.003, rel=0.2)
    refused(Reason.LAMP_FLICKERS, sweep(3, flicker=0.03))


def test_no_light_is_refused():
    assert "above the dark" in refused(Reason.NO_LIGHT, sweep(4, rate_dn_per_s=0.0, noise_dn=1e-6))
    refused(Reason.NO_LIGHT, sweep(4, rate_dn_per_s=-10.0))


def test_too_little_light_is_refused_with_what_it_amounts_to():
    assert "known to" in refused(Reason.TOO_FEW_FRAMES, sweep(5, rate_dn_per_s=1000.0))


def test_a_latency_that_depends_on_the_pattern_is_refused():
    rng = np.random.default_rng(6)
    looks = [look(rng, pattern_s, shift_s=0.05 * pattern_s) for pattern_s in (0.5e-3, 0.75e-3, 1e-3)]
    assert "changes with the time per pattern" in refused(Reason.BAD_FIT, looks)


def test_overlap_gives_each_mask_its_exposed_share():
    windows_s = PatternSequence(np.zeros((3, 2, 2), np.uint8), 1, 0.01).windows_s()
    assert overlap(windows_s, 0.029, 0.0, 0.0, 0.0) == pytest.approx([1, 1, 0.9])
    assert overlap(windows_s, 0.029, 0.002, 0.0, 0.0005) == pytest.approx([0.75, 1, 1])
    assert overlap(windows_s, 0.029, 0.0, 0.0005, 0.0) == pytest.approx([1, 1, 0.95])


def test_weights_are_of_the_exposure_that_the_sensor_grants():
    none = (0.0, 1e-7)
    with opened(random_table(1)) as (bench, _):  # its sensor grants multiples of 10 us
        hurried = replace(bench, capture=replace(bench.capture, mask_s=1e-3, margin_s=0.264e-3))
        found = timing._section(hurried, TimingEstimate(none, none, none, 0.0), [])
    assert found.array("weights") == pytest.approx([1, 1, 1, 0.74], abs=1e-6)


def test_a_sensor_that_begins_after_the_first_patterns_are_over_is_refused(monkeypatch):
    rng = np.random.default_rng(0)
    monkeypatch.setattr(timing, "_look", lambda bench, dark, pattern_s, *_: look(rng, pattern_s, shift_s=0.05))
    with pytest.raises(CalibrationError, match=r"first 40 ms after the trigger.*up to 37 ms") as error:
        timing._first_look(None, None)
    assert error.value.reason is Reason.NO_LATENCY
