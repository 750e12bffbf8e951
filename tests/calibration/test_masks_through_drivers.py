"""Registration and masks of whole simulated benches, through the drivers, held against what is true of them."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.rig.config import RigTable
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.procedures import PROCEDURES
from gs2ci_calibration.refusals import CalibrationError, Reason
from tests.bench_truth import opened
from tests.calibration.random_benches import compare


def table(**world):
    return RigTable.model_validate(
        {
            "modulator": {"kind": "dlpc900", "trigger_out_2_bit": "disables"},
            "sensor": {"kind": "v4l2", "format": "Y12", "black_level_dn": 64.0},
            "capture": {"masks": 4, "density": 0.5, "mask_s": 0.004},
            "registration": {"superpixel": 2},
            "optics": {"full_scale_e_per_s": 2e6},
            "calibration": {"frames": 8, "mask_frames": 4},
            "world": {
                "scene": "planes",
                "height": 48,
                "width": 64,
                "effects": {
                    "finite_contrast": {"contrast": 15.0},
                    "modulator_psf": {"sigma_px": 0.5, "diffraction": False},
                    "misregistration": {"right_px": 1.2, "down_px": -0.6, "turn_mrad": 5.0, "magnification": 1.004},
                    "prnu": {"spread": 0.01},
                },
            }
            | world,
        }
    )


@pytest.fixture(scope="module")
def calibrated():
    with opened(table()) as (bench, truth):
        known = Bundle()
        for step in ("dark-flat", "registration"):
            known = known.with_section(PROCEDURES[step](bench, known))
        masks = [PROCEDURES["masks"](replace(bench, fast=fast), known) for fast in (False, True)]
        yield known, masks, truth, truth.masks(bench.capture.masks)


def test_the_map_and_the_blur_are_found(calibrated):
    known, _, truth, _ = calibrated
    for one in compare(known.sections["registration"], truth):
        # Far from the field the map's offset is known less well than on it.
        assert abs(one.error) < 0.02, one.name
    assert known.sections["registration"].facts["rms_se_px"] < 0.005


@pytest.mark.parametrize(("which", "limit"), [(0, 0.01), (1, 0.02)])
def test_masks_are_those_that_the_solver_needs(calibrated, which, limit):
    _, masks, _, truth = calibrated
    estimate = masks[which].estimates["masks"]
    assert np.sqrt(np.mean(np.square(estimate.value - truth))) < limit
    assert estimate.agrees(truth).mean() > 0.9
    assert masks[which].estimates["weights"].value == pytest.approx(np.ones(4), abs=5e-3)


def test_predicting_takes_less_time_on_the_bench_than_measuring(calibrated):
    _, (measured, predicted), _, _ = calibrated
    assert predicted.facts["seconds"] < measured.facts["seconds"]


def test_a_dmd_upside_down_is_refused_by_registration():
    with opened(table(quarter_turns=2)) as (bench, _):
        known = Bundle()
        known = known.with_section(PROCEDURES["dark-flat"](bench, known))
        with pytest.raises(CalibrationError, match="upside down") as refused:
            PROCEDURES["registration"](bench, known)
    assert refused.value.reason is Reason.FLIPPED
