import json
from pathlib import Path

import numpy as np
import pytest

from gs2ci.core.errors import InputError, StorageError
from gs2ci_drivers.failures import NoAnswerError
from gs2ci_drivers.ports import port_errors
from gs2ci_drivers.sensor import SensorConfig, TriggerMode
from gs2ci_drivers.trace import Trace, TracedLibrary, TracedStream, TracedSys
from gs2ci_drivers.v4l2.driver import V4l2Sensor
from gs2ci_drivers.zaber.driver import ZaberStage
from gs2ci_drivers.zaber.options import ZaberOptions
from gs2ci_sims.wires.alp import AlpTwin
from gs2ci_sims.wires.dlpc900 import Dlpc900Twin
from gs2ci_sims.wires.v4l2 import V4l2Twin
from gs2ci_sims.wires.v4l2_camera import CameraModel
from gs2ci_sims.wires.zaber import ZaberTwin
from gs2ci_sims.world import VirtualClock, World
from tests.drivers.replay import Replay, ReplayedBytes, ReplayedHid, ReplayedSys

AXES = {"axes": {"x": 1}, "microstep_mm": {"x": 0.000047625}}


class EvenLight:
    def collect(self, exposure):
        return np.full((exposure.height, exposure.width), 7, np.uint16)


def record_stage(path, use, fault=None):
    clock = VirtualClock()
    twin = ZaberTwin(clock)
    if fault:
        twin.faults.inject(fault, times=2)
    trace = Trace(path, "stage0", "bytes", clock)
    stage = ZaberStage("stage0", TracedStream(twin.open(), trace), clock, ZaberOptions(**AXES))
    try:
        return use(stage)
    finally:
        stage.close()


def replay_stage(path, use):
    replay = Replay(path)
    stage = ZaberStage("stage0", ReplayedBytes(replay), replay, ZaberOptions(**AXES))
    try:
        return use(stage), replay
    finally:
        stage.close()


def move(stage):
    info = stage.connect()
    return info, stage.move_to({"x": 80.0}, speed_mm_s=5.0)


def test_a_replayed_stage_does_what_the_recorded_one_did(tmp_path):
    path = tmp_path / "stage.wire"
    recorded = record_stage(path, move)
    replayed, replay = replay_stage(path, move)
    assert replayed == recorded
    assert replay.finished
    assert (replay.device, replay.port) == ("stage0", "bytes")


def test_a_recorded_failure_is_replayed_as_the_same_failure(tmp_path):
    path = tmp_path / "stage.wire"

    def use(stage):
        with pytest.raises(NoAnswerError) as caught:
            stage.connect()
        return str(caught.value)

    recorded = record_stage(path, use, fault="serial.write_stuck")
    replayed, _ = replay_stage(path, use)
    assert replayed == recorded


def test_a_driver_that_does_something_else_is_told_where(tmp_path):
    path = tmp_path / "stage.wire"
    record_stage(path, lambda stage: stage.connect())
    with pytest.raises(InputError, match=r"line \d+: recorded was .* the driver does"):
        replay_stage(path, lambda stage: (stage.connect(), stage.move_to({"x": 1.0})))


def test_every_byte_is_in_the_file(tmp_path):
    path = tmp_path / "stage.wire"
    record_stage(path, lambda stage: stage.connect())
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    assert rows[0] == {"trace": "gs2ci.wire/1", "device": "stage0", "port": "bytes"}
    sent = b"".join(bytes.fromhex(data) for row in rows[1:] for data in row.get("sent", []))
    got = b"".join(bytes.fromhex(data) for row in rows[1:] for data in row.get("got", []))
    assert sent.count(b"/01 ") == sent.count(b"\n") == got.count(b"@01 ")


def test_a_trace_cut_short_by_a_crash_replays_up_to_there(tmp_path):
    path = tmp_path / "stage.wire"
    record_stage(path, lambda stage: stage.connect())
    text = path.read_text()
    path.write_text(text[:-20])
    with pytest.raises(InputError, match="its end"):
        replay_stage(path, lambda stage: (stage.connect(), stage.positions_mm()))


@pytest.mark.parametrize("text", ["", "nonsense", '{"trace": "other/1"}\n', "[]\n"])
def test_files_that_are_no_traces_are_refused(tmp_path, text):
    path = tmp_path / "x.wire"
    path.write_text(text)
    with pytest.raises(InputError, match="not a wire trace"):
        Replay(path)


def test_a_damaged_line_in_the_middle_is_refused(tmp_path):
    path = tmp_path / "stage.wire"
    record_stage(path, lambda stage: stage.connect())
    lines = path.read_text().splitlines()
    lines[3] = lines[3][:10]
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match="line 4 is not a recorded call"):
        Replay(path)


def test_hid_reports_are_recorded_and_replayed(tmp_path):
    world = World(EvenLight())
    port = TracedStream(Dlpc900Twin(world).open(), Trace(tmp_path / "m.wire", "dmd0", "hid", world.clock))
    request = bytes.fromhex("c0040200 0c1a").ljust(64, b"\0")
    port.write(request, 1.0)
    answer = port.read(1.0)
    silence = port.read(0.1)
    port.close()
    replayed = ReplayedHid(Replay(tmp_path / "m.wire"))
    replayed.write(request, 1.0)
    assert replayed.read(1.0) == answer
    assert replayed.read(0.1) == silence == b""
    replayed.close()


def test_a_camera_replays_with_its_pixels_and_controls(tmp_path):
    def use(sensor):
        sensor.connect()
        sensor.configure(SensorConfig(exposure_s=0.001, trigger=TriggerMode.FREE_RUN))
        sensor.start()
        frames = [sensor.read(1.0) for _ in range(2)]
        sensor.stop()
        sensor.close()
        return frames

    world = World(EvenLight())
    trace = Trace(tmp_path / "c.wire", "cam0", "sys", world.clock)
    recorded = use(V4l2Sensor("cam0", TracedSys(V4l2Twin(world, CameraModel()), trace), world.clock))
    trace.close()
    replay = Replay(tmp_path / "c.wire")
    replayed = use(V4l2Sensor("cam0", ReplayedSys(replay), replay))
    for before, after in zip(recorded, replayed, strict=True):
        assert (before.pixels == after.pixels).all()
        assert (before.sequence, before.t_kernel_ns, before.flags) == (after.sequence, after.t_kernel_ns, after.flags)
    assert recorded[0].pixels.max() == 7


def test_small_files_and_node_lists_are_recorded_too(tmp_path):
    world = World(EvenLight())
    twin = V4l2Twin(world, CameraModel(trigger="module"))
    trace = Trace(tmp_path / "s.wire", "cam0", "sys", world.clock)
    port = TracedSys(twin, trace)
    path = "/sys/module/imx296/parameters/trigger_mode"
    nodes, before = port.list_nodes("/dev/video*"), port.read_file(path)
    port.write_file(path, b"1\n")
    trace.close()
    replayed = ReplayedSys(Replay(tmp_path / "s.wire"))
    assert replayed.list_nodes("/dev/video*") == nodes == ["/dev/video0"]
    assert replayed.read_file(path) == before
    replayed.write_file(path, b"1\n")


class Line:
    """A port that takes everything and says nothing."""

    def write(self, data, timeout_s):
        self.written = data

    def close(self):
        self.written = b""


def test_a_trace_that_cannot_be_begun_is_refused_with_its_place(tmp_path):
    with pytest.raises(StorageError, match=r"wire trace .*nowhere.x\.wire cannot be written"):
        Trace(tmp_path / "nowhere" / "x.wire", "stage0", "bytes", VirtualClock())


def test_a_full_disk_is_told_before_anything_is_opened():
    with pytest.raises(StorageError, match="No space left"):
        Trace(Path("/dev/full"), "stage0", "bytes", VirtualClock())


def test_a_disk_that_fills_up_under_a_trace_is_not_taken_for_the_device(tmp_path, monkeypatch):
    trace = Trace(tmp_path / "x.wire", "stage0", "bytes", VirtualClock())
    port = TracedStream(Line(), trace)
    trace.close()
    full = Path("/dev/full").open("w", buffering=1)  # noqa: SIM115  the trace closes it
    monkeypatch.setattr(trace, "_file", full)
    with pytest.raises(StorageError, match="No space left"), port_errors("stage0", "move"):
        port.write(b"/1 home", 1.0)
    port.write(b"/1 stop", 1.0)  # what puts a device to rest still gets through
    port.close()
    assert full.closed


def test_calls_of_a_makers_library_are_written_down_with_their_codes(tmp_path):
    world = World()
    trace = Trace(tmp_path / "alp.wire", "dmd0", "library", world.clock)
    port = TracedLibrary(AlpTwin(world).open(), trace)
    assert port.ask("AlpDevAlloc", [0, 0]) == (0, 7)
    assert port.call("AlpDevControlEx", [7, 2023], bytes(18)) == 0
    assert port.call("AlpSeqFree", [7, 3]) == 1003
    port.close()
    trace.close()
    rows = [json.loads(line) for line in (tmp_path / "alp.wire").read_text().splitlines()][1:]
    assert [row["op"] for row in rows] == ["AlpDevAlloc", "AlpDevControlEx", "AlpSeqFree", "close"]
    assert [row.get("result") for row in rows] == [["0", "7"], 0, 1003, None]
    assert rows[1]["sent"] == [bytes(18).hex()]
