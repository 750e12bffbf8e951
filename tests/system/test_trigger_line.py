"""Which masks pulse, and the event that time stamps mark: each assumption about a device is confirmed by the device."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from gs2ci.core.storage import read_shot
from gs2ci.rig.doctor import examine
from gs2ci_drivers.failures import PlanRefusedError, SequenceError

DRIVERS = ["twin", "unicam", "rp1-cfe", "uvcvideo", "other"]
FAST = {"masks": 4, "mask_s": 0.02, "shots": 1, "from_mm": 74.0, "to_mm": 75.0}  # 12.5 mm/s


def other(bit):
    return "enables" if bit == "disables" else "disables"


def findings(small):
    return {finding.what: finding for finding in examine(small.rig)}


@pytest.mark.parametrize("truth", ["disables", "enables"])
def test_nothing_is_captured_while_the_polarity_is_not_known(make_small, truth):
    small = make_small(
        dlp5500=True, modulator={"trigger_out_2_bit": ""}, capture=FAST, world={"trigger_out_2_bit": truth}
    )
    with pytest.raises(PlanRefusedError, match=r"trigger_out_2_bit is not stated.*gs2ci doctor"):
        small.capture()
    assert not small.out.exists()


@pytest.mark.parametrize("truth", ["disables", "enables"])
@pytest.mark.parametrize("stated", ["", "disables", "enables"])
def test_the_doctor_finds_the_polarity_by_number_and_by_light(make_small, truth, stated):
    small = make_small(modulator={"trigger_out_2_bit": stated}, capture=FAST, world={"trigger_out_2_bit": truth})
    found = findings(small)["trigger pulses"]
    assert f"the bit {truth} a pulse" in found.detail
    assert "the light in the frames confirms it" in found.detail
    assert found.verdict == ("ok" if stated == truth else "bad")
    assert (f'trigger_out_2_bit = "{truth}"' in found.remedy) is (stated != truth)


def test_the_doctor_finds_a_firmware_that_counts_otherwise(make_small):
    small = make_small(modulator={"firmware": "rev-f"}, capture=FAST)  # the twin counts masks, as rev-j
    found = findings(small)["trigger pulses"]
    assert found.verdict == "bad"
    assert 'firmware = "rev-j"' in found.remedy


@pytest.mark.parametrize("driver", DRIVERS)
@pytest.mark.parametrize("truth", ["disables", "enables"])
def test_a_capture_with_the_right_polarity_is_right_and_one_with_the_wrong_never_passes(make_small, driver, truth):
    world = {"trigger_out_2_bit": truth, "camera_driver": driver}
    small = make_small(dlp5500=True, modulator={"trigger_out_2_bit": truth}, capture=FAST, world=world)
    with h5py.File(small.capture()) as file:
        readings = file["meas"][:].astype(float)
    expected = small.expected_dn(-1, read_shot(small.out, 0).masks)
    np.testing.assert_allclose(readings[0], expected, rtol=0, atol=0.51)

    wrong = make_small(dlp5500=True, modulator={"trigger_out_2_bit": other(truth)}, capture=FAST, world=world)
    with pytest.raises(SequenceError, match="trigger came with a later mask"):
        wrong.capture()


@pytest.mark.parametrize("driver", DRIVERS)
def test_poses_are_where_the_camera_was_whatever_the_stamps_are_the_time_of(make_small, driver):
    small = make_small(dlp5500=True, capture=FAST, world={"camera_driver": driver})
    with h5py.File(small.capture()) as file:
        told_mm = file["frames/stage_pos"][0, :, 0]
    exposure = small.bench.world.exposures[-1]
    masks = [mask for mask in exposure.masks if mask.end_s - mask.start_s > 1e-3]
    true_mm = [small.bench.stage.positions_mm_at((mask.start_s + mask.end_s) / 2)["x"] for mask in masks]
    # At 12.5 mm/s: 0.04 mm is half of one exchange with the stage; an exposure taken for none would be 1 mm, one
    # that is taken off twice as well, and the readout of 0.5 ms 6 um.
    assert told_mm == pytest.approx(true_mm, abs=0.04)
    assert np.ptp(told_mm) == pytest.approx(0.75, abs=0.01)


@pytest.mark.parametrize(
    ("driver", "stated", "truth"),
    [
        ("twin", None, "start-of-exposure"),
        ("unicam", None, "start-of-frame"),
        ("uvcvideo", None, "start-of-frame"),
        ("other", None, "end-of-frame"),
        ("other", "start-of-frame", "end-of-frame"),
        ("unicam", "end-of-frame", "start-of-frame"),
        ("uvcvideo", "start-of-exposure", "start-of-frame"),
        ("twin", "end-of-frame", "start-of-exposure"),
    ],
)
def test_the_doctor_measures_what_time_stamps_mean(make_small, driver, stated, truth):
    sensor = {"readout_s": 4e-3} | ({"stamps": stated} if stated else {})
    small = make_small(sensor=sensor, capture=FAST, world={"camera_driver": driver, "camera_readout_s": 4e-3})
    found = findings(small)["time stamps"]
    assert found.detail.startswith(truth)
    assert found.verdict == ("bad" if stated else "ok")
    assert (f'stamps = "{truth}"' in found.remedy) is bool(stated)


EDGES = {
    "at the mask's own": {},
    "pulses later, which are another line": {"trigger_out_2": {"rise_us": 2000, "fall_us": 2020}},
    "gate later": {"trigger_out_1": {"rise_us": 2000, "fall_us": 2000}},
    "gate longer": {"trigger_out_1": {"rise_us": 100, "fall_us": 3100}},
    "gate much later": {"trigger_out_1": {"rise_us": 15_000, "fall_us": 15_000}},
}


@pytest.mark.parametrize("edges", EDGES.values(), ids=EDGES)
@pytest.mark.parametrize("shots", [{}, {"shots": 3, "burst": 3}], ids=["one", "burst"])
def test_a_gate_exposes_what_is_planned_whatever_its_edges(make_small, edges, shots):
    capture = {"masks": 4, "mask_s": 0.01, "mode": "gate", "axis": ""} | shots
    small = make_small(modulator=edges, capture=capture, world={"devices": "ideal"})
    with h5py.File(small.capture()) as file:
        weights = file["calib/weights"][:]
    for exposure in small.bench.world.exposures[-shots.get("shots", 1) :]:
        shares = [(mask.end_s - mask.start_s) / 0.01 for mask in exposure.masks]
        before = [0.0] * (4 - len(shares))  # the masks that ended before the gate began
        assert before + shares == pytest.approx(weights, abs=2e-3)


@pytest.mark.parametrize("edges", EDGES.values(), ids=EDGES)
def test_a_gate_for_each_mask_exposes_what_is_planned_whatever_its_edges(make_small, edges):
    low = edges.get("trigger_out_1", {}) | {"inverted": True}  # the IMX296 exposes while its line is low
    small = make_small(
        modulator=edges | {"trigger_out_1": low},
        sensor={"trigger_adapter": "module", "readout_s": 1e-3},
        capture={"masks": 3, "mask_s": 0.02, "shots": 1, "mode": "gate", "axis": ""},  # by which the bench is wired
    )
    each = small.rig.table.capture.model_copy(update={"mode": "per-mask"})
    small.rig = replace(small.rig, table=small.rig.table.model_copy(update={"capture": each}))
    with h5py.File(small.capture()) as file:
        weights = file["calib/weights"][:]
    for exposure, weight in zip(small.bench.world.exposures[-3:], weights, strict=True):
        assert sum(mask.end_s - mask.start_s for mask in exposure.masks) / 0.02 == pytest.approx(weight, abs=2e-3)


@pytest.mark.parametrize("shots", [1, 3])
def test_a_late_pulse_exposes_what_is_planned_and_no_mask_of_the_next_pass(make_small, shots):
    late = {"trigger_out_2": {"rise_us": 15_000, "fall_us": 15_020}, "trigger_out_1": {"rise_us": 500, "fall_us": 500}}
    capture = {"masks": 4, "mask_s": 0.01, "shots": shots, "burst": shots, "axis": ""}
    small = make_small(modulator=late, capture=capture)
    with h5py.File(small.capture()) as file:
        weights = file["calib/weights"][:]
    assert weights == pytest.approx([0, 0.5, 1, 1], abs=2e-3)
    for exposure in small.bench.world.exposures[-shots:]:
        shares = [(mask.end_s - mask.start_s) / 0.01 for mask in exposure.masks]
        assert shares == pytest.approx(weights[1:], abs=2e-3)
