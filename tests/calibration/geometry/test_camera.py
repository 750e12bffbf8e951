from dataclasses import replace

import numpy as np

from gs2ci.rig.calibrating import provenance_of
from gs2ci_calibration.bench import Arrangement
from gs2ci_calibration.bundle import Bundle, add_section, read_bundle
from gs2ci_calibration.geometry.camera import camera_of, measure_camera
from gs2ci_calibration.procedures import PROCEDURES
from tests.benchmarks.calibration_geometry import camera_errors


class Listening:
    """An operator who notes what was asked for."""

    def __init__(self, operator):
        self.operator, self.asked = operator, []

    def please(self, setup, index):
        self.asked.append((setup, index))
        self.operator.please(setup, index)


def test_the_camera_of_a_bench_is_found_through_its_drivers_and_comes_back_from_a_bundle(bench, tmp_path):
    made, rig, truth = bench(1, views=8)
    operator = Listening(made.operator)
    section = measure_camera(replace(made, operator=operator), Bundle())
    assert operator.asked == [(Arrangement.BOARD, index) for index in range(8)]
    errors = camera_errors(section, truth)
    assert abs(errors["fx"][0]) < 0.002 * truth.intrinsics[0, 0]
    assert abs(errors["fy"][0]) < 0.002 * truth.intrinsics[0, 0]
    # One bench: three standard errors; many are asked for two (test_intrinsics, the benchmark).
    assert all(abs(error) <= 3 * stated for error, stated in errors.values())
    add_section(tmp_path / "bench.cal.h5", section, provenance_of(rig, made.devices))
    back, first = camera_of(read_bundle(tmp_path / "bench.cal.h5").need("camera", "stage")), camera_of(section)
    assert np.array_equal(back.values, first.values)
    assert np.allclose(back.covariance, first.covariance)
    assert back.size == first.size == (160, 200)


def test_both_steps_are_on_the_command_line_the_camera_first():
    assert [name for name in PROCEDURES if name in ("camera", "stage")] == ["camera", "stage"]
