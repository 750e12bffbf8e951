"""A camera in a world of known light, for the tests of the V4L2 driver."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from gs2ci_drivers.sensor import SensorConfig
from gs2ci_drivers.v4l2.driver import V4l2Sensor
from gs2ci_drivers.v4l2.options import V4l2Options
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.world import Exposure, World
from tests.twins.v4l2 import CameraModel, V4l2Twin

LINE = "dmd0.out2"


class Ramp:
    """Light whose every pixel tells the exposure's index and its own place."""

    def collect(self, exposure: Exposure) -> np.ndarray:
        place = np.arange(exposure.height * exposure.width).reshape(exposure.height, exposure.width)
        return ((place + 7 * exposure.index) % 2**exposure.bits).astype(np.uint16)


def picture(index: int, height: int, width: int, bits: int) -> np.ndarray:
    """Return what `Ramp` gives for the exposure with this index."""
    return ((np.arange(height * width).reshape(height, width) + 7 * index) % 2**bits).astype(np.uint16)


@dataclass
class Bench:
    """A sensor, its twin, and a hand on the trigger line."""

    world: World
    twin: V4l2Twin
    sensor: V4l2Sensor
    config: SensorConfig

    @property
    def faults(self) -> FaultSet:
        return self.twin.faults

    def fire(self, count: int = 1, period_s: float = 0.02) -> None:
        """Send `count` edges, the first one 1 ms from now; time does not pass."""
        for index in range(count):
            self.world.clock.after(1e-3 + index * period_s, lambda: self.world.bus.pulse(LINE, 20e-6))

    def begin(self, **changes: object) -> None:
        """Connect, configure and start."""
        self.sensor.connect()
        self.sensor.configure(replace(self.config, **changes))
        self.sensor.start()

    def capture_works(self) -> None:
        """Assert that a fresh capture of two frames succeeds, on the same objects."""
        self.sensor.stop()
        self.sensor.configure(self.config)
        self.sensor.start()
        self.fire(2)
        for index in range(2):
            frame = self.sensor.read(1.0, trigger_index=index)
            assert frame.sequence == index
            height, width = frame.pixels.shape
            bits = self.sensor.settings.format.bits
            at = self.world.exposures[-1].index
            np.testing.assert_array_equal(frame.pixels, picture(at, height, width, bits))
        self.sensor.stop()


@pytest.fixture
def bench() -> Callable[..., Bench]:
    """Build a bench; keyword arguments go to the camera's model, `options` to the driver."""

    def build(options: V4l2Options | None = None, **model: object) -> Bench:
        world = World(Ramp())
        twin = V4l2Twin(world, CameraModel(**{"trigger_line": LINE, **model}))
        if options is None:
            options = V4l2Options(trigger_adapter="control")
        return Bench(world, twin, V4l2Sensor("cam0", twin, world.clock, options), SensorConfig(exposure_s=2e-3))

    return build
