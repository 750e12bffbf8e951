"""Every rig file in the docs, on twins of exactly its devices: doctor, plan, calibration, capture."""

import tomllib
from pathlib import Path

import h5py
import numpy as np
import pytest

from gs2ci.core.progress import Silent
from gs2ci.core.storage import read_shot
from gs2ci.rig.calibrating import bench_of, operator_of
from gs2ci.rig.config import RigTable, read_rig
from gs2ci.rig.doctor import examine
from gs2ci.rig.opening import Rig
from gs2ci.rig.recording import prepare, record
from gs2ci.rig.simulated import build_bench
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.procedures import PROCEDURES
from tests.nightly import but

pytestmark = pytest.mark.slow

FILES = sorted((Path(__file__).parents[2] / "docs" / "rigs").glob("*.toml"))
# What stands on a real bench beside the devices: their true figures, and a scene.
SURROUNDINGS = {
    "real": {
        "camera_driver": "unicam",
        "camera_array": [1088, 1456],
        "height": 400,
        "width": 600,
        "trigger_exposure_offset_s": 14.26e-6,
        "scene": "planes",
        "flat_radiance": 0.5,
        "sensor": {"electrons_per_dn": 2.7, "black_level_dn": 240.0},  # at 12 bits; the file speaks of 10
    },
    "genicam": {
        "camera_array": [1088, 1456],
        "height": 400,
        "width": 600,
        "trigger_latency_s": 6e-6,
        "camera_readout_s": 6e-3,
        "scene": "planes",
        "flat_radiance": 0.5,
    },
}
SMALL = {"height": 48, "width": 80}


def twin_tables(path, *, small=False):
    """The file's tables, with ports on twins and what surrounds them."""
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    for name in ("modulator", "sensor", "stage"):
        if name in tables:
            tables[name]["port"] = "simulated"
    tables["world"] = SURROUNDINGS.get(path.stem) or tables["world"]
    if small:  # the same devices and wiring, a smaller region: light is dear
        for name in ("sensor", "world"):
            tables[name] = {**tables[name], **SMALL}
        tables["capture"]["shots"] = 1
    return tables


def on_twins(tables, folder):
    table = RigTable.model_validate(tables)
    return Rig(table, "", folder, build_bench(table))


def findings(rig):
    return {finding.what: finding for finding in examine(rig)}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_an_example_is_examined_without_a_bad_finding(path, tmp_path):
    rig = on_twins(twin_tables(path, small=True), tmp_path)
    found = findings(rig)
    assert [one for one in found.values() if one.verdict == "bad"] == []
    assert "8 triggers gave 8 frames" in found["trigger loop"].detail


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_an_example_is_planned_as_it_stands(path, tmp_path):
    read_rig(path)
    rig = on_twins(twin_tables(path), tmp_path)
    devices = rig.open()
    try:
        prepared = prepare(rig, devices)
        assert not prepared.plan.broken
        assert prepared.codes.shape[1:] == (400, 600)
    finally:
        devices.close()


@pytest.mark.parametrize("path", but(2, FILES), ids=lambda path: path.stem)
def test_an_example_is_captured_and_its_exposure_spans_all_masks(path, tmp_path):
    rig = on_twins(twin_tables(path, small=True), tmp_path)
    devices, out = rig.open(), tmp_path / "shot.h5"
    try:
        record(rig, devices, prepare(rig, devices), out, replace=True, progress=Silent())
    finally:
        devices.close()
    exposure = rig.bench.world.exposures[-1]
    shown = [mask for mask in exposure.masks if mask.end_s - mask.start_s > 1e-3]
    assert len(shown) == 8
    assert sum(mask.end_s - mask.start_s for mask in shown) == pytest.approx(0.16, abs=1e-4)
    shot = read_shot(out, 0)
    assert shot.weights == pytest.approx(1.0, abs=2e-3)
    with h5py.File(out) as file:
        told_mm = file["frames/stage_pos"][0, :, 0]
    true_mm = [rig.bench.stage.positions_mm_at((mask.start_s + mask.end_s) / 2)["x"] for mask in shown]
    assert told_mm == pytest.approx(true_mm, abs=0.05)


@pytest.mark.parametrize("path", but(2, FILES), ids=lambda path: path.stem)
def test_the_first_steps_of_calibration_work_on_an_example(path, tmp_path):
    tables = twin_tables(path, small=True)
    tables["calibration"] = {"frames": 8}
    rig = on_twins(tables, tmp_path)
    devices = rig.open()
    try:
        bench = bench_of(rig, devices, operator_of(rig, lambda text: None))
        section = PROCEDURES["dark-flat"](bench, Bundle())
        stack = bench.grab(np.stack([bench.flat_pattern(is_open=True)] * 2), frames=2, exposure_s=0.01)
    finally:
        devices.close()
    assert section.number("flat_dn_per_s") > 0
    assert stack.readings.shape == (2, 2, 48, 80)
    for exposure in rig.bench.world.exposures[-4:]:
        assert exposure.end_s - exposure.start_s == pytest.approx(0.01, abs=1e-4)
        assert len(exposure.masks) == 1


REAL = next(path for path in FILES if path.stem == "real")


def test_a_gate_of_the_wrong_polarity_is_found_by_the_doctor_and_never_captured_with(tmp_path):
    tables = twin_tables(REAL, small=True)
    del tables["modulator"]["trigger_out_1"]
    rig = on_twins(tables, tmp_path)
    found = findings(rig)["trigger gate"]
    assert found.verdict == "bad"
    assert found.remedy == "set trigger_out_1 = { inverted = true } in [modulator]"
    rig = on_twins(tables, tmp_path)
    devices, out = rig.open(), tmp_path / "shot.h5"
    try:
        with pytest.raises(Exception, match="polarity"):
            record(rig, devices, prepare(rig, devices), out, replace=True, progress=Silent())
    finally:
        devices.close()
    assert not out.exists()


def test_a_gated_sensor_that_is_asked_for_an_edge_is_answered_with_the_mode(tmp_path):
    tables = twin_tables(REAL, small=True)
    tables["capture"]["mode"] = "per-exposure"
    rig = on_twins(tables, tmp_path)
    devices = rig.open()
    try:
        with pytest.raises(Exception, match='set mode = "gate"'):
            prepare(rig, devices)
    finally:
        devices.close()
