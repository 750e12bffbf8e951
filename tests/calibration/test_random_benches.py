"""Calibration of whole simulated benches through the drivers, held against what is true of them."""

from collections import defaultdict

import numpy as np
import pytest
from scipy.stats import binom

from gs2ci.rig.config import RigTable
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.procedures import PROCEDURES
from gs2ci_calibration.refusals import CalibrationError
from tests.bench_truth import opened
from tests.calibration.random_benches import SPOILED, compare, random_table, spoiled_table

pytestmark = pytest.mark.slow

STEPS = ("dark-flat", "sensor", "timing")
BENCHES = 14
TIMED = 6
FRAMES = 12


def compared_over_benches():
    """Return, by estimate, its comparisons with the truth over the benches; timing for the first few alone."""
    found = defaultdict(list)
    for seed in range(100, 100 + BENCHES):
        with opened(random_table(seed, frames=FRAMES)) as (bench, truth):
            known = Bundle()
            for step in STEPS if seed < 100 + TIMED else STEPS[:2]:
                section = PROCEDURES[step](bench, known)
                known = known.with_section(section)
                for one in compare(section, truth):
                    found[one.name].append(one)
    return found


def relative_errors(ones):
    return np.abs([one.error / one.value for one in ones])


@pytest.mark.nightly
def test_figures_of_random_benches_are_as_good_as_promised_and_as_sure_as_stated():
    # One test, so that the benches are calibrated once however tests are spread over processes.
    compared = compared_over_benches()
    check_errors(compared)
    check_standard_errors_of_figures(compared)
    check_standard_errors_of_maps(compared)


def check_errors(compared):
    assert np.median(relative_errors(compared["gain_e_per_dn"])) < 0.01
    assert relative_errors(compared["gain_e_per_dn"]).max() < 0.02
    assert relative_errors(compared["read_noise_e"]).max() < 0.05
    assert relative_errors(compared["full_well_e"]).max() < 0.03
    assert np.abs([one.error for one in compared["latency_s"]]).max() < 2e-6
    assert np.abs([one.error for one in compared["exposure_offset_s"]]).max() < 2e-6
    assert np.abs([one.error for one in compared["linearity_error"]]).max() < 0.002


def check_standard_errors_of_figures(compared):
    names = ("gain_e_per_dn", "read_noise_e", "full_well_e", "linearity_error", "dsnu_dn", "prnu")
    names += ("dark_noise_rms_dn", "latency_s", "exposure_offset_s", "jitter_s")
    for name in names:
        hits = sum(one.within for one in compared[name])
        # So few hits come by chance in one of a thousand tests of a true error.
        assert hits >= binom.ppf(0.001, len(compared[name]), 0.95), name


def check_standard_errors_of_maps(compared):
    for name in ("offset_dn", "dark_current_dn_per_s", "response", "dark_noise_dn"):
        shares = [one.within for one in compared[name]]
        assert 0.93 < np.mean(shares) < 0.98, name
        assert min(shares) > 0.90, name


@pytest.mark.parametrize("what", SPOILED)
def test_a_spoiled_bench_is_refused_for_the_right_reason(what):
    last, reason, _ = SPOILED[what]
    known = Bundle()
    with opened(spoiled_table(what, 1)) as (bench, _):
        for step in STEPS[: STEPS.index(last)]:
            known = known.with_section(PROCEDURES[step](bench, known))
        with pytest.raises(CalibrationError) as refused:
            PROCEDURES[last](bench, known)
    assert (refused.value.step, refused.value.reason) == (last, reason)
    assert refused.value.remedy


def test_timing_is_refused_where_the_host_steps_the_patterns():
    table = RigTable.model_validate(random_table(1).model_dump() | {"modulator": {"kind": "santec"}})
    with opened(table) as (bench, _), pytest.raises(CalibrationError, match="no time of their own"):
        PROCEDURES["timing"](bench, Bundle())


def test_steps_say_which_section_they_miss():
    with opened(random_table(1)) as (bench, _):
        for step in ("sensor", "timing"):
            with pytest.raises(CalibrationError, match="run `gs2ci calibrate dark-flat` first"):
                PROCEDURES[step](bench, Bundle())
