"""Cameras of a real GenTL producer: the simulated ones that come with EMVA's bindings."""

import errno
import signal
from contextlib import suppress
from pathlib import Path

import numpy as np
import psutil
import pytest

from gs2ci.core.clock import WallClock
from gs2ci_drivers.failures import (
    AccessError,
    FrameLostError,
    OutOfRangeError,
    RefusedError,
    UnsupportedError,
    WrongStateError,
)
from gs2ci_drivers.genicam.driver import GenicamSensor
from gs2ci_drivers.genicam.options import GenicamOptions
from gs2ci_drivers.links import gentl
from gs2ci_drivers.links.gentl import PATHS, GenTlPort, find_producers
from gs2ci_drivers.ports import CameraPort, FeatureRefusalError
from gs2ci_drivers.sensor import SensorConfig, TriggerMode
from tests.nightly import but

genicam = pytest.importorskip("genicam", reason="the extra `genicam` is not installed")
pytest.importorskip("harvesters", reason="the extra `genicam` is not installed")

VIKY = Path(genicam.__file__).parent / "viky.cti"
FREE = SensorConfig(fourcc="Mono8", height=100, width=120, exposure_s=0.01, trigger=TriggerMode.FREE_RUN)


@pytest.fixture
def camera():
    table = {"kind": "genicam", "port": "1", "producer": str(VIKY), "features": {"AcquisitionFrameRate": 200.0}}
    sensor = GenicamSensor("cam0", GenTlPort("cam0"), WallClock(), GenicamOptions.model_validate(table))
    yield sensor
    sensor.close()


def test_the_producer_lists_its_cameras():
    port = GenTlPort("cam0")
    assert isinstance(port, CameraPort)
    assert [(one.vendor, one.model, one.serial) for one in port.list_cameras(str(VIKY))] == [
        ("Machine Vision Games Ltd.", "Viky", str(i)) for i in range(3)
    ]
    port.close()


def test_what_it_is_set_to_is_recorded_as_the_camera_lists_it(camera):
    camera.connect()
    recorded = camera.configure(FREE).recorded
    assert (recorded["Width"], recorded["AcquisitionFrameRate"]) == (120, 200.0)
    assert recorded["PixelFormat[Intensity]"] == "Mono8", "this camera has one for each of its components"
    assert "BouncingBallSize" in recorded, "the maker's own"
    assert not [name for name in recorded if name.startswith(("Chunk", "Event")) or name.endswith("Selector")]


def test_it_streams_in_order_and_twice(camera):
    assert camera.connect().driver == "GenTL Custom"
    settings = camera.configure(FREE)
    # The producer's limit of AcquisitionFrameRate, 200 Hz, is a fixed number and says nothing about the readout.
    assert (settings.format.height, settings.format.width, settings.readout_s) == (100, 120, 0.0)
    for _ in range(2):
        camera.start()
        frames = []
        while len(frames) < 10:
            with suppress(FrameLostError):  # as below
                frames.append(camera.read(2.0))
        numbers = [frame.sequence for frame in frames]
        assert numbers == sorted(set(numbers))
        assert numbers[0] <= camera.status().lost, "numbers begin anew with each start"
        assert all(frame.pixels.shape == (100, 120) and frame.pixels.any() for frame in frames)
        assert any((frames[0].pixels != frame.pixels).any() for frame in frames[1:]), "the ball does not move"
        camera.discard()
        camera.stop()


@pytest.mark.parametrize("frames", but(1, [400, 1000]))
def test_frames_leave_no_memory_behind(camera, frames):
    camera.connect()
    camera.configure(FREE)
    camera.start()
    process, readings = psutil.Process(), []
    while camera.status().delivered < frames:
        with suppress(FrameLostError):  # 200 a second are more than a busy machine takes
            camera.read(2.0)
            if camera.status().delivered % 100 == 0:
                readings.append(process.memory_info().rss)
    # A frame is 12 kB, its buffer 10 MB: a leak of buffers shows at once, one of frames in a thousand of them.
    assert max(readings[2:]) - readings[1] < 4e6


def test_ctrl_c_is_left_alone(camera):
    before = signal.getsignal(signal.SIGINT)
    camera.connect()
    assert signal.getsignal(signal.SIGINT) is before


def test_what_the_camera_refuses_is_typed(camera):
    camera.connect()
    with pytest.raises(OutOfRangeError, match="Width = 900; allowed: 100 to 800"):
        camera.configure(SensorConfig(fourcc="Mono8", width=900, trigger=TriggerMode.FREE_RUN, exposure_s=0.01))
    with pytest.raises(UnsupportedError, match="trigger mode 'edge' is not available"):
        camera.configure(SensorConfig(fourcc="Mono8", exposure_s=0.01))
    with pytest.raises(RefusedError):
        camera._features.write("AspectRatio", 2.0)  # a float that can only be read
    with pytest.raises(FeatureRefusalError, match="no feature"):
        camera._port.read("NoSuchFeature")
    assert camera._port.describe("NoSuchFeature") is None


def test_a_camera_that_is_not_there_and_one_of_several_are_told(monkeypatch):
    clock = WallClock()
    for port in ("7", "only"):
        options = GenicamOptions(kind="genicam", port=port, producer=str(VIKY))
        sensor = GenicamSensor("cam0", GenTlPort("cam0"), clock, options)
        with pytest.raises(AccessError, match=r"there are: 0 \(Viky\), 1 \(Viky\)"):
            sensor.connect()
        sensor.close()
        with pytest.raises(WrongStateError):
            sensor.connect()


def test_producers_are_found_by_path_or_in_the_folders_of_the_standard(monkeypatch, tmp_path):
    assert find_producers(str(VIKY)) == [VIKY]
    monkeypatch.setenv(PATHS, f"{tmp_path}:{VIKY.parent}")
    assert find_producers("") == [VIKY]
    monkeypatch.setenv(PATHS, str(tmp_path))
    for producer in ("", str(tmp_path / "x.cti")):
        with pytest.raises(OSError, match="no GenTL producer") as caught:
            find_producers(producer)
        assert caught.value.errno == errno.ENOENT


def test_without_the_extra_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "harvesters.core", None)
    with pytest.raises(UnsupportedError, match=r"pip install 'gs2ci\[genicam\]'"):
        GenTlPort("cam0").list_cameras(str(VIKY))


def test_nothing_can_be_asked_of_a_camera_that_is_not_open():
    with pytest.raises(OSError, match="not open"):
        GenTlPort("cam0").describe("Width")


def test_a_command_that_does_not_end_is_a_timeout(camera, monkeypatch):
    camera.connect()
    monkeypatch.setattr(gentl, "COMMAND_S", 0.0)

    class Never:
        def execute(self):
            pass

        def is_done(self):
            return False

    monkeypatch.setattr(camera._port, "_node", lambda name: Never())
    with pytest.raises(TimeoutError, match="Latch did not end"):
        camera._port.execute("Latch")


def test_an_incomplete_buffer_is_told_though_its_number_is_not(camera, monkeypatch):
    camera.connect()
    camera.configure(FREE)
    camera.start()

    def try_fetch(**kwargs):
        camera._port._acquirer._emit_callbacks(camera._port._acquirer.Events.INCOMPLETE_BUFFER)

    monkeypatch.setattr(camera._port._acquirer, "try_fetch", try_fetch)
    buffer = camera._port.fetch(0.1)
    assert (buffer.complete, buffer.frame_id) == (False, -1)
    assert np.frombuffer(buffer.data, np.uint8).size == 0
