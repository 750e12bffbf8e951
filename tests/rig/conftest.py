"""A simulated rig that is calibrated: its steps as they are, its masks as a perfect calibration would have them."""

from contextlib import contextmanager

import numpy as np
import pytest

from gs2ci.rig.calibrated import bundle_of, load
from gs2ci.rig.calibrating import bench_of, operator_of, provenance_of
from gs2ci.rig.opening import load_rig
from gs2ci_calibration.bundle import Bundle, read_bundle, write_bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.fitting import codes_sha256
from gs2ci_calibration.procedures import PROCEDURES
from tests.bench_truth import truth_of


def masks_section(bench, truth):
    """Return the section `masks` that a perfect calibration would write."""
    shut = bench.flat_pattern(is_open=False)[None]
    unshut = bench.flat_pattern(is_open=True)[None]
    masks, (off,), (on,) = (truth.masks(patterns) for patterns in (bench.capture.masks, shut, unshut))
    return Section(
        "masks",
        {
            "masks": Estimate((masks / on).astype(np.float32), np.float32(0.001), "1"),
            "contrast": Estimate(off / on, np.float32(0.001), "1"),
            "weights": Estimate(np.ones(len(masks)), 1e-4, "1"),
        },
        arrays={"patterns_sha256": codes_sha256(bench.codes)},
        facts={"mask_s": bench.capture.mask_s},
    )


@pytest.fixture
def connected(rig):
    """Open the rig as its file now says, and close its devices whatever happens."""

    @contextmanager
    def opened():
        found = load_rig(rig)
        devices = found.open()
        try:
            yield found, devices
        finally:
            devices.close()

    return opened


@pytest.fixture
def calibrate(connected):
    """Run steps on the rig, write the bundle with its masks, and return it as it is read back."""

    def run(out, *steps):
        with connected() as (rig, devices):
            bench = bench_of(rig, devices, operator_of(rig, print))
            bundle = Bundle(provenance_of(rig, devices))
            for step in steps:
                bundle = bundle.with_section(PROCEDURES[step](bench, bundle))
            write_bundle(out, bundle.with_section(masks_section(bench, truth_of(rig.bench, 12))))
        return read_bundle(out)

    return run


@pytest.fixture
def loaded(connected):
    """Load a bundle as a capture of the rig does."""

    def run(bundle, **options):
        with connected() as (rig, devices):
            found = bundle_of(rig, bundle)
            return None if found is None else load(rig, devices, found, **options)

    return run
