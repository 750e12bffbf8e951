"""The DLPC900 driver over pyusb, libusb and usbfs, against the wire twin plugged into vhci-hcd."""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pacing import Pace
from usbip_hid import HidOnVhci

from gs2ci.core.clock import WallClock
from gs2ci_drivers.dlpc900.driver import Dlpc900
from gs2ci_drivers.failures import AccessError, DisconnectedError, DriverError
from gs2ci_drivers.links.usb_hid import UsbHid
from gs2ci_drivers.modulator import ModulatorState
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_sims.wires.dlpc900 import Dlpc900Twin
from gs2ci_sims.world import World

VENDOR, PRODUCT = 0x0451, 0xC900
HEIGHT, WIDTH = 1080, 1920
PLUG_TIMEOUT_S = 30.0


class Bench:
    """A twin behind a real USB stack."""

    def __init__(self) -> None:
        self.world = World(light=None)  # type: ignore[arg-type]
        self.twin = Dlpc900Twin(self.world)
        self.pace = Pace(self.world.clock, self._pump)
        self.usb = HidOnVhci(self._on_report, VENDOR, PRODUCT)
        self.reports = 0

    def _on_report(self, report: bytes) -> None:
        with self.pace.lock:
            self.reports += 1
            self.pace.catch_up()
            self.twin.host_sends(report)

    def _pump(self) -> None:
        while (report := self.twin.device_sends()) is not None:
            self.usb.send(report)

    def open(self) -> Dlpc900:
        """Open it as a user would; the host needs a moment after the plug."""
        deadline_s = time.monotonic() + PLUG_TIMEOUT_S
        while True:
            try:
                return Dlpc900("dmd0", UsbHid("dmd0", VENDOR, PRODUCT), WallClock())
            except (AccessError, DisconnectedError):  # not yet there, or still the one that was there before
                if time.monotonic() > deadline_s:
                    raise
                time.sleep(0.2)

    def close(self) -> None:
        self.usb.unplug()
        self.pace.stop()


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


def blocks(count: int) -> np.ndarray:
    """Random masks of 120-pixel blocks: cheap to encode on a slow machine, and no two alike."""
    coarse = np.random.default_rng(5).integers(0, 2, (count, HEIGHT // 120, WIDTH // 120), dtype=np.uint8)
    return np.repeat(np.repeat(coarse, 120, axis=1), 120, axis=2)


def test_a_sequence_is_uploaded_shown_and_triggered_over_usbfs(bench: Bench) -> None:
    masks = blocks(8)
    dmd = bench.open()
    info = dmd.connect()
    assert (info.height, info.width) == (HEIGHT, WIDTH)
    sequence = PatternSequence(masks, 1, exposure_s=0.1, repeats=2, trigger=TriggerOut.PER_MASK)
    report = dmd.upload(sequence)
    assert report.payload_bytes > 1000
    dmd.arm()
    with bench.pace.lock:
        begin_s = bench.world.clock.now_s()
    dmd.start()
    assert dmd.status().state is ModulatorState.RUNNING
    dmd.wait_done(30.0)
    with bench.pace.lock:
        shown = bench.world.masks_between(begin_s, bench.world.clock.now_s())
        pulses = [when_s for when_s in bench.world.bus.rising("dmd0.out2") if when_s >= begin_s]
    assert len(shown) == 16
    for i, interval in enumerate(shown):
        np.testing.assert_array_equal(interval.levels, masks[i % 8])
        assert interval.end_s - interval.start_s == pytest.approx(0.1, abs=1e-6)
    assert len(pulses) == 16
    dmd.disarm()
    dmd.close()


def wait_for_hid(bound: bool) -> None:
    """Wait until the kernel's HID driver has, or has not, the device."""
    deadline_s = time.monotonic() + PLUG_TIMEOUT_S
    while any(Path("/sys/bus/hid/devices").glob("*:0451:C900.*")) != bound:
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


def test_the_kernels_own_driver_gets_the_interface_back(bench: Bench) -> None:
    wait_for_hid(True)
    dmd = bench.open()
    dmd.connect()
    wait_for_hid(False)
    with pytest.raises(AccessError):
        UsbHid("dmd1", VENDOR, PRODUCT)
    dmd.close()
    wait_for_hid(True)
    again = bench.open()
    assert again.connect().height == HEIGHT
    again.close()


def test_a_cable_pulled_during_the_upload_is_told_and_a_new_session_works(bench: Bench) -> None:
    dmd = bench.open()
    dmd.connect()
    sequence = PatternSequence(blocks(2), 1, exposure_s=0.1)

    def pull(share: float) -> None:
        if share > 0:
            bench.usb.unplug()

    with pytest.raises(DisconnectedError, match="dmd0"):
        dmd.upload(sequence, pull)
    with pytest.raises(DriverError):
        dmd.disarm()
    dmd.close()
    bench.usb = HidOnVhci(bench._on_report, VENDOR, PRODUCT)
    bench.twin.unplug()
    bench.twin.plug_in()
    dmd = bench.open()
    dmd.connect()
    assert dmd.status().state is not ModulatorState.FAULT
    dmd.close()
