import errno
import json
import os
from dataclasses import replace
from multiprocessing import get_context
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from gs2ci.core.errors import NumericsError, StorageError
from gs2ci.core.storage import sealing
from gs2ci_calibration.bundle import Bundle, Provenance, add_section, read_bundle, write_bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.refusals import CalibrationError, Reason

BENCH = Provenance("name = 'x'\n", {"sensor": ("cam", "7", "v1"), "modulator": ("dmd", "", "5.0")}, True, 31.5)


def section(name="dark-flat", value=1.5):
    return Section(
        name,
        {
            "offset_dn": Estimate(np.arange(6, dtype=np.float32).reshape(2, 3), np.float32(0.1), "DN"),
            "rate": Estimate(value, 0.25, "DN/s"),
        },
        arrays={"hot": np.eye(2, 3, dtype=np.uint8), "large": np.arange(2000)},
        facts={"frames": 32, "exposures_s": [0.1, 0.2]},
        notes=("two hot pixels",),
        measured_utc="2030-01-02T03:04:05+00:00",
    )


@pytest.fixture
def path(tmp_path):
    return tmp_path / "bench.cal.h5"


def test_a_bundle_comes_back_as_it_was_written(path):
    written = Bundle(BENCH, {"dark-flat": section()})
    write_bundle(path, written)
    read = read_bundle(path)
    assert read.provenance == BENCH
    assert read.provenance.rig_sha256 == written.provenance.rig_sha256
    assert read.created_utc == written.created_utc
    found = read.sections["dark-flat"]
    assert found.array("offset_dn").dtype == np.float32
    assert np.array_equal(found.array("offset_dn"), section().array("offset_dn"))
    assert np.array_equal(found.array("large"), np.arange(2000))
    assert (found.number("rate"), found.estimates["rate"].error, found.estimates["rate"].unit) == (1.5, 0.25, "DN/s")
    assert (found.facts, found.notes, found.measured_utc) == (
        section().facts,
        section().notes,
        section().measured_utc,
    )


def test_a_new_section_replaces_its_namesake_and_keeps_the_others(path):
    add_section(path, section(), BENCH)
    add_section(path, section("sensor"), BENCH)
    add_section(path, section(value=9.0), BENCH)
    bundle = read_bundle(path)
    assert set(bundle.sections) == {"dark-flat", "sensor"}
    assert bundle.sections["dark-flat"].number("rate") == 9.0
    assert "sensor" in bundle


def test_every_section_keeps_the_rig_and_the_temperature_of_its_own_measurement(path):
    later = replace(BENCH, rig="name = 'y'\n", temperature_c=None)
    add_section(path, section(), BENCH)
    add_section(path, section("sensor"), later)
    bundle = read_bundle(path)
    assert bundle.provenance == later
    kept = {name: (one.rig, one.temperature_c) for name, one in bundle.sections.items()}
    assert kept == {"dark-flat": (BENCH.rig, 31.5), "sensor": (later.rig, None)}


def test_sections_of_a_bundle_that_states_its_rig_once_are_of_that_rig(path):
    write_bundle(path, Bundle(BENCH, {"dark-flat": section()}))
    with h5py.File(path, "r+") as file:
        record = json.loads(file["sections/dark-flat/record"][()])
        del record["rig"], record["temperature_c"], file["sections/dark-flat/record"]
        file["sections/dark-flat/record"] = json.dumps(record)
    add_section(path, section("sensor"), replace(BENCH, rig="name = 'y'\n", temperature_c=20.0))
    old = read_bundle(path).sections["dark-flat"]
    assert (old.rig, old.temperature_c) == (BENCH.rig, 31.5)


def test_sections_of_another_bench_are_not_mixed_in(path):
    add_section(path, section(), BENCH)
    before = path.read_bytes()
    other = replace(BENCH, devices={**BENCH.devices, "sensor": ("cam", "8", "v1")})
    with pytest.raises(CalibrationError, match="the bench has cam 8, dmd") as error:
        add_section(path, section("sensor"), other)
    assert error.value.reason is Reason.DOES_NOT_FIT
    assert path.read_bytes() == before


def test_a_section_that_is_missing_is_named_with_what_to_run():
    with pytest.raises(CalibrationError, match="run `gs2ci calibrate dark-flat` first") as error:
        Bundle(BENCH, {"sensor": section("sensor")}).need("dark-flat", "timing")
    assert error.value.reason is Reason.NEEDS


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_number_that_is_not_finite_never_gets_into_a_bundle(path, value):
    with pytest.raises(NumericsError, match="NaN"):
        Estimate(value, 0.1, "s")
    with pytest.raises(NumericsError, match="NaN"):
        Estimate(1.0, value, "s")
    bad = replace(section(), arrays={"hot": np.array([1.0, value])})
    with pytest.raises(NumericsError, match="'hot'"):
        write_bundle(path, Bundle(BENCH, {"dark-flat": bad}))
    assert not list(path.parent.iterdir())


def test_estimates_refuse_negative_errors_and_shapes_that_disagree():
    with pytest.raises(NumericsError, match="negative standard error"):
        Estimate(1.0, -0.1, "s")
    with pytest.raises(NumericsError, match="one for each value"):
        Estimate([1.0, 2.0], [0.1, 0.1, 0.1], "s")
    assert Estimate([1.0, 2.0], 0.5, "s").agrees([1.9, 3.1]).tolist() == [True, False]


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (1.0, 0.1, "1.00 ± 0.10"),
        (3801.18, 170.3, "3800 ± 170"),
        (18518.5123, 1.94, "18518.5 ± 1.9"),
        (-2.82e-6, 4.3e-6, "(-2.8 ± 4.3)e-06"),
        (-1e-9, 2e-3, "0.0000 ± 0.0020"),
        (8.0, 0.0, "8 ± 0"),
        (4.5678e9, 1.2e7, "(4.568 ± 0.012)e+09"),
        (0.0, 0.0, "0 ± 0"),
        (0.1, 1e-12, "0.1000000000000 ± 0.0000000000010"),
    ],
)
def test_estimates_are_written_as_far_as_their_error_lets_them_be_known(value, error, text):
    assert str(Estimate(value, error, "s")) == f"{text} s"


def test_an_array_is_written_as_what_was_found_of_it_or_as_median_and_rms_error():
    assert str(Estimate(1.0, 0.1, "1")) == "1.00 ± 0.10"
    assert str(Estimate([1.0, 3.0], 0.1, "px")) == "1.00 ± 0.10, 3.00 ± 0.10 px [2]"
    matrix, errors = [[50.0, 0, 8], [0, 50, 6], [0, 0, 1]], [[0.1, 0, 0.2], [0, 0.1, 0.2], [0, 0, 0]]
    said = "50.00 ± 0.10, 8.00 ± 0.20, 50.00 ± 0.10, 6.00 ± 0.20 px [3 × 3]"
    assert str(Estimate(matrix, errors, "px")) == said
    assert str(Estimate(np.arange(9.0), 0.1, "px")) == "median 4.00 ± 0.10 px [9]"
    assert str(Estimate([1.0, 3.0], 0.0, "px")) == "median 2 ± 0 px [2]"


def test_a_number_that_is_not_finite_in_a_file_is_refused(path):
    write_bundle(path, Bundle(BENCH, {"dark-flat": section()}))
    with h5py.File(path, "r+") as file:
        file["sections/dark-flat/estimates/rate/value"][()] = np.nan
    with pytest.raises(StorageError, match="NaN"):
        read_bundle(path)


@pytest.mark.parametrize("kept", [0, 100, 3000])
def test_a_file_cut_short_is_refused(path, kept):
    write_bundle(path, Bundle(BENCH, {"dark-flat": section()}))
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(StorageError):
        read_bundle(path)


def test_files_that_are_no_bundles_are_refused(path):
    with pytest.raises(StorageError, match="no such bundle"):
        read_bundle(path)
    with h5py.File(path, "w") as file:
        file.attrs["schema"] = "gs2ci.capture/1"
    with pytest.raises(StorageError, match="holds exposures: give the file that `gs2ci calibrate` wrote"):
        read_bundle(path)
    with h5py.File(path, "r+") as file:
        file.attrs["schema"] = "gs2ci.calibration/1"
        file["complete"] = np.uint8(0)
    with pytest.raises(StorageError, match="never finished"):
        read_bundle(path)


def test_a_disk_without_room_leaves_the_bundle_as_it_was(path, monkeypatch):
    write_bundle(path, Bundle(BENCH, {"dark-flat": section()}))
    before = path.read_bytes()
    monkeypatch.setattr(sealing.shutil, "disk_usage", lambda _: SimpleNamespace(free=1_000_000))
    with pytest.raises(StorageError, match=r"the disk has 1\.0 MB free"):
        add_section(path, section("sensor"), BENCH)
    assert path.read_bytes() == before


def test_a_bundle_whose_records_are_no_objects_is_refused(path):
    write_bundle(path, Bundle(BENCH, {"dark-flat": section()}))
    with h5py.File(path, "r+") as file:
        del file["provenance"]
        file["provenance"] = "[1]"
    with pytest.raises(StorageError, match="provenance"):
        read_bundle(path)


def test_a_link_out_of_the_file_is_not_followed(path, tmp_path):
    write_bundle(tmp_path / "other.h5", Bundle(BENCH, {"sensor": section("sensor")}))
    write_bundle(path, Bundle(BENCH, {"dark-flat": section()}))
    with h5py.File(path, "r+") as file:
        del file["sections"]
        file["sections"] = h5py.ExternalLink("other.h5", "sections")
    assert not read_bundle(path).sections


def test_a_place_that_cannot_hold_a_bundle_is_refused(path, tmp_path):
    for wrong in (tmp_path / "bench.txt", tmp_path / "no" / "bench.h5"):
        with pytest.raises(StorageError, match="not a place"):
            write_bundle(wrong, Bundle(BENCH))


def test_a_crash_while_writing_leaves_the_old_bundle(path, monkeypatch):
    write_bundle(path, Bundle(BENCH, {"dark-flat": section()}))
    before = path.read_bytes()

    def die(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", die)
    with pytest.raises(KeyboardInterrupt):
        write_bundle(path, Bundle(BENCH, {"sensor": section("sensor")}))
    assert path.read_bytes() == before


def test_a_disk_that_refuses_leaves_nothing_half_written(path, monkeypatch):
    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(h5py.Group, "create_dataset", full)
    with pytest.raises(StorageError, match="cannot be written"):
        write_bundle(path, Bundle(BENCH, {"dark-flat": section()}))
    assert not list(path.parent.iterdir())


@pytest.mark.parametrize("error", [RuntimeError("unable to write"), TypeError("what nobody foresaw")])
def test_whatever_goes_wrong_while_writing_leaves_nothing_half_written(path, monkeypatch, error):
    def fail(*arguments, **options):
        raise error

    monkeypatch.setattr(h5py.Group, "create_dataset", fail)
    with pytest.raises(StorageError if isinstance(error, RuntimeError) else TypeError):
        write_bundle(path, Bundle(BENCH, {"dark-flat": section()}))
    assert not list(path.parent.iterdir())


def add_several(path, prefix, gate):
    gate.wait()
    for k in range(6):
        add_section(path, section(f"{prefix}{k}"), BENCH)


def test_processes_that_add_to_one_bundle_at_once_lose_nothing_and_do_not_fail(path):
    context = get_context("spawn")
    gate = context.Barrier(3)
    workers = [context.Process(target=add_several, args=(path, prefix, gate)) for prefix in "abc"]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert [worker.exitcode for worker in workers] == [0, 0, 0]
    assert sorted(read_bundle(path).sections) == [f"{prefix}{k}" for prefix in "abc" for k in range(6)]
    assert sorted(file.name for file in path.parent.iterdir()) == ["bench.cal.h5", "bench.cal.json"]


def test_a_file_system_without_locks_holds_bundles_all_the_same(path, monkeypatch):
    def refuse(*arguments):
        raise OSError(errno.EBADF, "no locks here")

    monkeypatch.setattr("gs2ci.core.alone.fcntl.flock", refuse)
    add_section(path, section(), BENCH)
    assert list(read_bundle(path).sections) == ["dark-flat"]


def test_a_file_of_the_users_in_the_manifests_place_is_not_replaced(path):
    notes = path.with_suffix(".json")
    notes.write_text('{"aperture": 5.6}')
    with pytest.raises(StorageError, match="the manifest belongs there"):
        write_bundle(path, Bundle(BENCH, {"dark-flat": section()}))
    assert notes.read_text() == '{"aperture": 5.6}'
    assert not path.exists()
