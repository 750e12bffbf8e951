"""Whole captures on a small simulated rig, without faults."""

import h5py
import numpy as np
import pytest

from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.progress import Silent
from gs2ci.core.storage import ShotWriter, count_shots, read_shot, recover
from gs2ci.core.storage.guarded_file import GuardedFile
from gs2ci_drivers.failures import NoAnswerError, PlanRefusedError
from tests.manifests import assert_manifest_fits


@pytest.mark.parametrize("stage", ["zaber", "grbl"])
def test_a_capture_gives_the_measurement_that_the_masks_and_the_motion_make(make_small, stage):
    small = make_small(stage={"kind": stage})
    small.capture()
    assert count_shots(small.out) == 3
    assert_manifest_fits(small.out)
    with h5py.File(small.out) as file:
        readings = file["meas"][:].astype(float)
    for row in range(3):
        shot = read_shot(small.out, row)
        np.testing.assert_allclose(readings[row], small.expected_dn(row, shot.masks), rtol=0, atol=0.51)


@pytest.mark.parametrize("kind", ["dlpc900", "scpi"])
def test_each_exposure_begins_with_another_mask_and_its_row_says_so(make_small, kind):
    small = make_small(modulator={"kind": kind}, capture={"shots": 4})
    small.capture()
    shots = [read_shot(small.out, row) for row in range(4)]
    for row, first in enumerate((0, 1, 2, 3)):
        np.testing.assert_array_equal(shots[row].masks, np.roll(shots[0].masks, -first, axis=0))
        with h5py.File(small.out) as file:
            reading = file["meas"][row].astype(float)
        np.testing.assert_allclose(reading, small.expected_dn(row, shots[row].masks), rtol=0, atol=0.51)


def test_masks_that_are_not_turned_are_the_same_in_each_exposure(make_small):
    small = make_small(capture={"turn_masks": False})
    small.capture()
    with h5py.File(small.out) as file:
        assert "masks/order" not in file
    np.testing.assert_array_equal(read_shot(small.out, 2).masks, read_shot(small.out, 0).masks)


def test_every_shot_of_a_sweep_sees_the_scene_from_the_same_places(make_small):
    small = make_small()
    small.capture()
    _, first, *others = small.bench.world.exposures  # the first one learns the modulator's start latency
    for exposure in others:
        for before, after in zip(first.masks, exposure.masks, strict=True):
            a = first.world_to_camera_at(before.start_s)[0, 3]
            b = exposure.world_to_camera_at(after.start_s)[0, 3]
            assert a == pytest.approx(b, abs=2e-3)  # mm: one poll of the link


@pytest.mark.parametrize("stage", ["zaber", "grbl"])
def test_telemetry_says_where_the_stage_really_was_at_each_mask(make_small, stage):
    small = make_small(stage={"kind": stage})
    small.capture()
    with h5py.File(small.out) as file:
        positions = file["frames/stage_pos"][:]
        targets = file["frames/stage_target"][:]
        stamps = file["frames/t_kernel_ns"][:]
    for row, exposure in enumerate(small.bench.world.exposures):
        assert stamps[row] * 1e-9 == pytest.approx(exposure.start_s, abs=1e-6)
        centres = [(mask.start_s + mask.end_s) / 2 for mask in exposure.masks]
        true_mm = [small.bench.stage.positions_mm_at(t)["x"] for t in centres]
        # Half of one exchange with the controller (3 ms) at 12.5 mm/s.
        assert positions[row][:, 0] == pytest.approx(true_mm, abs=0.04)
        # The modulator's start latency is learnt by the first shot.
        assert true_mm == pytest.approx(list(targets[row][:, 0]), abs=0.2 if row == 0 else 0.04)


def test_telemetry_poses_have_the_shape_of_the_true_motion(make_small):
    small = make_small()
    small.capture()
    shot = read_shot(small.out, 0)
    exposure = small.bench.world.exposures[0]
    centres = [(mask.start_s + mask.end_s) / 2 for mask in exposure.masks]
    true = np.stack([exposure.world_to_camera_at(t) for t in centres])
    moved = shot.telemetry_world_to_camera - shot.telemetry_world_to_camera[0]
    assert moved == pytest.approx(true - true[0], abs=5e-3)


def test_weights_tell_the_share_of_each_mask_inside_the_exposure(make_small):
    small = make_small(capture={"margin_s": 0.005})
    small.capture()
    shot = read_shot(small.out)
    assert shot.weights[:-1] == pytest.approx(1.0, abs=2e-3)
    assert shot.weights[-1] == pytest.approx(0.75, abs=2e-3)
    exposure = small.bench.world.exposures[0]
    real = [(mask.end_s - mask.start_s) / 0.02 for mask in exposure.masks]
    assert shot.weights == pytest.approx(real, abs=2e-3)


def test_a_gated_capture_exposes_exactly_while_masks_are_on_show(make_small):
    small = make_small(capture={"mode": "gate"})
    small.capture()
    for exposure in small.bench.world.exposures:
        assert exposure.end_s - exposure.start_s == pytest.approx(0.08, abs=1e-4)
        assert len(exposure.masks) == 4


def test_calibration_takes_one_frame_per_mask_each_under_its_own_mask(make_small):
    small = make_small(capture={"mode": "per-mask", "axis": "", "shots": 2})
    small.capture()
    assert count_shots(small.out) == 8
    shot = read_shot(small.out)
    row, column = small.bench.world.light.row, small.bench.world.light.column
    height, width = shot.size
    for i, exposure in enumerate(small.bench.world.exposures):
        (mask,) = exposure.masks
        seen = mask.levels[row : row + height, column : column + width] / mask.top
        assert np.array_equal(seen, shot.masks[i % 4])


@pytest.mark.parametrize("sync", [False, True])
def test_rows_wait_for_the_storage_device_where_the_rig_file_asks_for_it(make_small, monkeypatch, sync):
    waited = []

    def wait(file):
        waited.append(file)

    monkeypatch.setattr(GuardedFile, "sync", wait)
    make_small(dlp5500=True, capture={"shots": 2, "masks": 2, "axis": "", "sync": sync}).capture()
    assert len(waited) == (2 if sync else 0)


def test_a_burst_takes_several_shots_in_one_sweep(make_small):
    small = make_small(capture={"shots": 4, "burst": 2})
    small.capture()
    starts = [exposure.start_s for exposure in small.bench.world.exposures]
    assert starts[1] - starts[0] == pytest.approx(starts[3] - starts[2], abs=1e-6)
    assert starts[1] - starts[0] < 0.1
    assert starts[2] - starts[1] > 0.3


def test_a_rig_without_a_stage_captures_at_rest(make_small):
    small = make_small(capture={"axis": ""})
    small.rig.table = small.rig.table.model_copy(update={"stage": None})
    small.capture()
    assert count_shots(small.out) == 3


def test_the_same_rig_twice_gives_the_same_pixels(make_small):
    files = []
    for _ in range(2):
        small = make_small()
        with h5py.File(small.capture()) as file:
            files.append(file["meas"][:])
    assert np.array_equal(*files)


def test_wire_traces_are_written_beside_the_file_and_hold_every_byte(make_small, tmp_path):
    small = make_small()
    devices = small.rig.open(tmp_path / "run")
    devices.modulator.connect()
    devices.stage.connect()
    devices.close()
    text = (tmp_path / "run.stage.wire").read_text()
    assert '"port": "bytes"' in text
    assert b"system.axiscount".hex() in text
    assert (tmp_path / "run.modulator.wire").stat().st_size > 100


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"capture": {"mask_s": 50e-6, "axis": ""}}, "time per mask is 50 us"),
        ({"capture": {"masks": 401, "axis": "", "mask_s": 0.0002}}, "at most 400"),
        ({"capture": {"from_mm": 10.0, "to_mm": 140.0}}, "travel is x from 10 to 140 mm"),
        ({"capture": {"from_mm": 149.0, "to_mm": 150.0}}, "travel"),
        ({"capture": {"axis": "q"}}, "axes x"),
        ({"capture": {"shots": 3, "burst": 2}}, "multiple of `burst`"),
        ({"optics": {"full_scale_e_per_s": 1e6}}, "full well of 10000 e-"),
        ({"capture": {"bit_depth": 9}}, "mask depth is 9 bits"),
    ],
)
def test_a_plan_beyond_the_limits_is_refused_before_anything_moves(make_small, change, complaint):
    small = make_small(**change)
    before = small.bench.stage.positions_mm_at(small.bench.world.clock.now_s())
    with pytest.raises(PlanRefusedError, match=complaint.replace("(", r"\(")):
        small.capture()
    assert small.bench.stage.positions_mm_at(small.bench.world.clock.now_s()) == before
    assert not small.bench.world.exposures
    assert not small.out.exists()
    assert not small.out.with_name("shot.h5.partial").exists()


def test_masks_far_beyond_what_the_modulator_holds_are_refused_before_they_are_drawn(make_small, monkeypatch):
    monkeypatch.setattr("gs2ci.rig.intent.draw_codes", lambda *_: pytest.fail("drawn"))
    with pytest.raises(InputError, match="masks = 5000 in \\[capture\\]; allowed: at most 400"):
        make_small(capture={"masks": 5000, "axis": ""}).capture()


class Interrupting:
    """A listener that ends the capture when the first shot is taken, as Ctrl-C or a full disk would."""

    def __init__(self, error):
        self.error, self.where = error, ""

    def stage(self, name, total=None):
        self.where = name

    def step(self, done, **figures):
        if self.where == "shots":
            raise self.error

    def say(self, text):
        pass


@pytest.mark.parametrize("error", [KeyboardInterrupt(), StorageError("the disk is full")], ids=["ctrl-c", "full disk"])
def test_whatever_ends_a_capture_leaves_the_devices_at_rest_and_the_row_safe(make_small, error):
    small = make_small()
    small.said = Interrupting(error)
    with pytest.raises(type(error)):
        small.capture()
    clock = small.bench.world.clock
    clock.sleep_s(1.0)
    now_s = clock.now_s()
    assert not small.bench.world.masks_between(now_s - 0.5, now_s)
    assert not small.bench.sensor.streaming
    assert small.bench.stage.positions_mm_at(now_s) == small.bench.stage.positions_mm_at(now_s - 0.5)
    saved = recover(small.out.with_name("shot.h5.partial"), small.out.with_name("saved.h5"))
    assert count_shots(saved) == 1


def test_a_disk_that_takes_no_reason_does_not_hide_the_reason(make_small, monkeypatch):
    def refuse_failed(writer, name, **details):
        if name == "failed":
            raise StorageError("no space left")
        return event(writer, name, **details)

    event = ShotWriter.event
    monkeypatch.setattr(ShotWriter, "event", refuse_failed)
    small = make_small()
    small.said = Interrupting(NoAnswerError("stage0", "move", 1.0))
    with pytest.raises(NoAnswerError, match="stage0"):
        small.capture()


def test_an_interrupted_file_is_not_overwritten_by_the_next_capture(make_small):
    small = make_small()
    small.said = Interrupting(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        small.capture()
    small.said = Silent()
    with pytest.raises(StorageError, match=r"shot\.h5\.partial"):
        small.capture()
    assert count_shots(recover(small.out.with_name("shot.h5.partial"), small.out.with_name("saved.h5"))) == 1
