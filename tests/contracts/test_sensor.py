"""The sensor contract, run on every kind of camera through its twin.

Each case is another kind of camera: single-plane or multi-plane, packed or padded, with its trigger set by a module
parameter, by a private control, or without a trigger.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from gs2ci_drivers.failures import (
    DriverError,
    FrameStaleError,
    OutOfRangeError,
    TriggerTimeoutError,
    UnsupportedError,
    WrongStateError,
)
from gs2ci_drivers.genicam.driver import GenicamSensor
from gs2ci_drivers.genicam.options import GenicamOptions
from gs2ci_drivers.sensor import Sensor, SensorConfig, TriggerMode
from gs2ci_drivers.v4l2.driver import V4l2Sensor
from gs2ci_drivers.v4l2.options import V4l2Options
from gs2ci_sims.world import Exposure, World
from tests.twins.genicam import GenicamModel, GenicamTwin
from tests.twins.v4l2 import CameraModel, V4l2Twin

LINE = "dmd0.out"


class Counting:
    """Light that tells how long an exposure was: one DN per 100 µs, plus the column."""

    def collect(self, exposure: Exposure) -> np.ndarray:
        level = round((exposure.end_s - exposure.start_s) / 1e-4)
        columns = np.arange(exposure.width) % 4
        return np.broadcast_to(level + columns, (exposure.height, exposure.width)).astype(np.uint16)


@dataclass
class Bench:
    """A sensor on its twin, with a hand on the trigger line."""

    sensor: Sensor
    world: World
    mode: TriggerMode
    unplug: Callable[[], None]
    plug_in: Callable[[], None]

    @property
    def config(self) -> SensorConfig:
        return SensorConfig(exposure_s=2e-3, trigger=self.mode)

    def ready(self) -> None:
        self.sensor.connect()
        self.sensor.configure(self.config)
        self.sensor.start()

    def fire(self, count: int = 1) -> None:
        """Trigger `count` exposures of 2 ms, 20 ms apart; a free-running sensor needs none of this."""
        gated = self.mode is TriggerMode.LEVEL  # both gated cameras here expose while their line is low
        width_s = 2e-3 if gated else 20e-6
        self.world.bus.drive(LINE, gated)
        for i in range(count):
            self.world.clock.after(1e-3 + 0.02 * i, lambda: self.world.bus.pulse(LINE, width_s, level=not gated))


def _edge_by_control() -> tuple[CameraModel, V4l2Options, TriggerMode]:
    return CameraModel(trigger_line=LINE), V4l2Options(trigger_adapter="control"), TriggerMode.EDGE


def _level_by_module() -> tuple[CameraModel, V4l2Options, TriggerMode]:
    model = CameraModel(
        trigger_line=LINE, trigger="module", exposure_offset_s=14.26e-6, formats=("Y10P",), stride_multiple=32
    )
    return model, V4l2Options(trigger_adapter="module"), TriggerMode.LEVEL


def _multi_plane() -> tuple[CameraModel, V4l2Options, TriggerMode]:
    model = CameraModel(
        trigger_line=LINE, multi_plane=True, header_bytes=64, formats=("RG12", "pRCC"), on_subdevice=True
    )
    options = V4l2Options(trigger_adapter="control", subdevice="/dev/v4l-subdev0")
    return model, options, TriggerMode.EDGE


def _webcam() -> tuple[CameraModel, V4l2Options, TriggerMode]:
    model = CameraModel(trigger="none", exposure="absolute", formats=("GREY",), driver="uvcvideo", flags_start=True)
    return model, V4l2Options(trigger_adapter="none"), TriggerMode.FREE_RUN


MAKERS = {
    "edge by control": _edge_by_control,
    "level by module": _level_by_module,
    "multi-plane": _multi_plane,
    "webcam": _webcam,
}


GENICAM = {
    "genicam by edge": (GenicamModel(trigger_line=LINE), GenicamOptions(kind="genicam"), TriggerMode.EDGE),
    "genicam by gate": (
        GenicamModel(trigger_line=LINE, transport="U3V", formats=("Mono12p",), exposure_offset_s=10e-6),
        GenicamOptions(kind="genicam", trigger_activation="FallingEdge", exposure_offset_s=10e-6),
        TriggerMode.LEVEL,
    ),
    "genicam by itself": (
        GenicamModel(formats=("Mono8",), chunks=False, gated=False),
        GenicamOptions(kind="genicam"),
        TriggerMode.FREE_RUN,
    ),
}


def _build(maker: str) -> Bench:
    world = World(Counting())
    if maker in GENICAM:
        camera, table, mode = GENICAM[maker]
        port = GenicamTwin(world, camera)
        return Bench(GenicamSensor("cam0", port, world.clock, table), world, mode, port.unplug, port.plug_in)
    model, options, mode = MAKERS[maker]()
    twin = V4l2Twin(world, model)
    return Bench(V4l2Sensor("cam0", twin, world.clock, options), world, mode, twin.unplug, twin.plug_in)


@pytest.fixture(params=sorted([*MAKERS, *GENICAM]))
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    bench = _build(request.param)
    yield bench
    bench.sensor.close()


def test_connecting_twice_tells_the_same_and_streams_nothing(bench: Bench) -> None:
    info = bench.sensor.connect()
    assert bench.sensor.connect() is info
    bench.world.clock.sleep_s(1.0)
    assert not bench.world.exposures
    assert not bench.sensor.status().streaming


def test_what_it_tells_of_itself_is_sane(bench: Bench) -> None:
    info = bench.sensor.connect()
    assert info.model
    assert info.formats
    assert 0 < info.min_exposure_s <= info.max_exposure_s
    assert 0 < info.exposure_step_s <= 1e-3
    assert TriggerMode.FREE_RUN in info.triggers
    assert bench.mode in info.triggers


def test_frames_come_in_order_with_rising_times(bench: Bench) -> None:
    bench.ready()
    bench.fire(8)
    frames = [bench.sensor.read(0.5, trigger_index=i) for i in range(8)]
    assert [frame.sequence for frame in frames] == list(range(8))
    times = [frame.t_kernel_ns for frame in frames]
    assert times == sorted(set(times))
    settings = bench.sensor.settings
    for frame in frames:
        assert frame.pixels.shape == (settings.format.height, settings.format.width)
        assert frame.pixels.dtype == np.uint16
        assert frame.pixels.max() <= settings.format.top
        assert frame.t_host_ns >= frame.t_kernel_ns
    assert bench.sensor.status().delivered == 8


def test_the_exposure_is_the_one_in_the_settings(bench: Bench) -> None:
    bench.ready()
    bench.fire()
    frame = bench.sensor.read(0.5)
    level = round((bench.sensor.settings.exposure_s + bench.sensor.settings.exposure_offset_s) / 1e-4)
    np.testing.assert_array_equal(frame.pixels[0, :4], level + np.arange(4))


def test_the_last_of_many_restarts_is_like_the_first(bench: Bench) -> None:
    bench.sensor.connect()
    for _ in range(5):
        bench.sensor.configure(bench.config)
        bench.sensor.start()
        bench.fire(2)
        assert [bench.sensor.read(0.5).sequence for _ in range(2)] == [0, 1]
        bench.sensor.stop()


def test_a_read_waits_until_its_deadline_and_not_longer(bench: Bench) -> None:
    if bench.mode is TriggerMode.FREE_RUN:
        pytest.skip("a free-running sensor has a frame at any time")
    bench.ready()
    begin_s = bench.world.clock.now_s()
    with pytest.raises(TriggerTimeoutError, match=r"cam0, trigger 5: no frame 0 after 0\.3 s") as caught:
        bench.sensor.read(0.3, trigger_index=5)
    assert bench.world.clock.now_s() - begin_s == pytest.approx(0.3)
    assert (caught.value.frame_index, caught.value.trigger_index) == (0, 5)
    bench.fire()
    assert bench.sensor.read(0.5).sequence == 0


def test_a_frame_older_than_its_trigger_is_stale_and_the_next_is_not(bench: Bench) -> None:
    bench.ready()
    bench.fire(4)
    trigger_ns = bench.world.clock.now_ns() + 50_000_000
    stale = 0
    while True:
        try:
            frame = bench.sensor.read(0.5, not_before_ns=trigger_ns, trigger_index=0)
            break
        except FrameStaleError:
            stale += 1
    assert stale in (2, 3, 4)  # 4: by its own clock at 60 Hz, from a moment before
    assert frame.t_kernel_ns >= trigger_ns
    assert frame.sequence == stale


def test_discard_empties_the_queue_without_waiting(bench: Bench) -> None:
    bench.ready()
    assert bench.sensor.discard() == 0
    bench.fire(3)
    bench.world.clock.sleep_s(0.1)
    begin_s = bench.world.clock.now_s()
    assert bench.sensor.discard() >= 3
    assert bench.sensor.discard() == 0
    assert bench.world.clock.now_s() == begin_s


def test_calls_in_the_wrong_order_are_refused_with_the_right_one(bench: Bench) -> None:
    sensor = bench.sensor
    with pytest.raises(WrongStateError, match=r"connect\(\) first"):
        _ = sensor.info
    with pytest.raises(WrongStateError, match=r"connect\(\) first"):
        sensor.configure(bench.config)
    sensor.connect()
    with pytest.raises(WrongStateError, match=r"configure\(\) first"):
        sensor.start()
    sensor.configure(bench.config)
    with pytest.raises(WrongStateError, match=r"start\(\) first"):
        sensor.read(0.1)
    sensor.start()
    with pytest.raises(WrongStateError, match=r"stop\(\) first"):
        sensor.start()
    with pytest.raises(WrongStateError, match=r"stop\(\) first"):
        sensor.configure(bench.config)


def test_stop_and_close_may_be_called_at_any_time_and_again(bench: Bench) -> None:
    bench.sensor.stop()
    assert bench.sensor.discard() == 0
    bench.ready()
    bench.sensor.stop()
    bench.sensor.stop()
    bench.sensor.start()
    bench.sensor.close()
    bench.sensor.close()
    with pytest.raises(WrongStateError, match="closed"):
        bench.sensor.start()


@pytest.mark.parametrize("exposure_s", [1e-9, 1e9])
def test_an_exposure_beyond_the_device_is_refused_with_its_limits(bench: Bench, exposure_s: float) -> None:
    if bench.mode is TriggerMode.LEVEL:
        pytest.skip("the line decides on the exposure")
    bench.sensor.connect()
    with pytest.raises(OutOfRangeError, match=r"exposure .* allowed: .* to .* s"):
        bench.sensor.configure(SensorConfig(exposure_s=exposure_s, trigger=bench.mode))


@pytest.mark.parametrize("config", [SensorConfig(buffers=0), SensorConfig(warm_up_frames=-1)])
def test_impossible_numbers_of_buffers_and_frames_are_refused(bench: Bench, config: SensorConfig) -> None:
    info = bench.sensor.connect()
    mode = next(iter(info.triggers))
    with pytest.raises(OutOfRangeError, match="buffers >= 1"):
        bench.sensor.configure(SensorConfig(buffers=config.buffers, warm_up_frames=config.warm_up_frames, trigger=mode))


def test_a_format_that_is_not_there_is_refused_with_those_that_are(bench: Bench) -> None:
    info = bench.sensor.connect()
    with pytest.raises(UnsupportedError, match=info.formats[0].fourcc):
        bench.sensor.configure(SensorConfig(fourcc="MJPG", exposure_s=2e-3, trigger=bench.mode))


def test_an_unplug_ends_the_capture_and_after_a_replug_it_goes_on(bench: Bench) -> None:
    bench.ready()
    bench.fire()
    bench.sensor.read(0.5)
    bench.unplug()
    begin_s = bench.world.clock.now_s()
    with pytest.raises(DriverError):
        bench.sensor.read(5.0)
    assert bench.world.clock.now_s() - begin_s <= 5.0
    bench.sensor.stop()
    bench.plug_in()
    bench.sensor.configure(bench.config)
    bench.sensor.start()
    bench.fire()
    assert bench.sensor.read(0.5).sequence == 0


@pytest.mark.parametrize("after_s", [1e-4, 1e-3, 4e-3, 0.02])
def test_a_start_that_is_interrupted_leaves_no_stream_and_the_next_one_works(bench: Bench, after_s: float) -> None:
    bench.sensor.connect()
    warming = SensorConfig(exposure_s=2e-3, trigger=bench.mode, warm_up_frames=9)
    bench.sensor.configure(warming)

    def interrupt() -> None:
        raise KeyboardInterrupt

    bench.world.clock.after(after_s, interrupt)
    with pytest.raises(KeyboardInterrupt):
        bench.sensor.start()
    exposed = len(bench.world.exposures)
    bench.world.clock.sleep_s(1.0)
    assert len(bench.world.exposures) <= exposed + 1  # the one that had begun
    assert not bench.sensor.status().streaming
    bench.sensor.configure(warming)
    bench.sensor.start()
    bench.fire()
    assert bench.sensor.read(0.5).sequence == 0


def test_warm_up_frames_are_never_seen(bench: Bench) -> None:
    bench.sensor.connect()
    bench.sensor.configure(SensorConfig(exposure_s=2e-3, trigger=bench.mode, warm_up_frames=2))
    bench.sensor.start()
    assert len(bench.world.exposures) >= 2
    bench.fire()
    assert bench.sensor.read(0.5).sequence == 0
