"""The work of a cell of the calibration table."""

import pytest

from gs2ci.core.errors import InputError
from tests.tables import calibration


def test_a_cell_tells_error_stated_error_and_time(monkeypatch):
    monkeypatch.setattr(calibration, "SIZE", (48, 64))
    monkeypatch.setattr(calibration, "MASKS", 3)
    row = calibration.calibrate_masks("sharp", 2, True, 0)
    assert 0 < row["mask_error_pct"] < 2
    assert row["mask_error_pct"] / 2 < row["stated_pct"] < 0.5
    assert row["registration_px"] < 0.01
    assert row["frames"] == 2
    assert row["seconds"] > 0
    assert row["registration_seconds"] > 0


def test_an_unknown_bench_is_refused():
    with pytest.raises(InputError, match="sharp"):
        calibration.calibrate_masks("nowhere", 2, False, 0)
