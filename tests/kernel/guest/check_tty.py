"""Stages over real ttys: GRBL on a pseudo terminal and Zaber on a USB serial gadget, against their wire twins."""

import errno
import os
import subprocess
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from pacing import Pace

from gs2ci.core.clock import WallClock
from gs2ci_drivers.failures import AccessError, DriverError, OutOfRangeError
from gs2ci_drivers.grbl.driver import GrblStage
from gs2ci_drivers.grbl.options import GrblOptions
from gs2ci_drivers.links.serial_line import SerialLine
from gs2ci_drivers.stage import Stage
from gs2ci_drivers.zaber.driver import ZaberStage
from gs2ci_drivers.zaber.options import ZaberOptions
from gs2ci_sims.wires.grbl import GrblTwin
from gs2ci_sims.wires.serial_twin import SerialTwin
from gs2ci_sims.wires.zaber import ZaberAxis, ZaberTwin
from gs2ci_sims.world import VirtualClock

GADGET = Path("/sys/kernel/config/usb_gadget/gs2ci")
MICROSTEP_MM = 0.000047625


class Far:
    """The far end of a tty, where a twin answers."""

    def __init__(self, twin: SerialTwin, clock: VirtualClock, fd: int) -> None:
        os.set_blocking(fd, False)
        self._fd = fd
        self._session = twin.open()
        self.pace = Pace(clock, self._pump)

    def _pump(self) -> None:
        try:
            data = os.read(self._fd, 4096)
        except OSError as error:  # EIO: nobody has opened the near end of a pseudo terminal yet
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise
            data = b""
        if data:
            self._session.write(data, 1.0)
        answer = self._session.read(4096, 0.0)
        if answer:
            os.write(self._fd, answer)


@pytest.fixture
def grbl() -> Iterator[tuple[str, Far]]:
    clock = VirtualClock()
    far_fd, near_fd = os.openpty()
    tty.setraw(near_fd)
    far = Far(GrblTwin(clock), clock, far_fd)
    yield os.ttyname(near_fd), far
    far.pace.stop()
    os.close(near_fd)
    os.close(far_fd)


def wait_for(find: Callable[[], str]) -> str:
    deadline_s = time.monotonic() + 30.0
    while True:
        found = find()
        if found:
            return found
        assert time.monotonic() < deadline_s
        time.sleep(0.1)


@pytest.fixture
def zaber() -> Iterator[tuple[str, Far]]:
    """A CDC ACM port: the twin on the gadget's side, the driver on the host's, a USB bus between them."""
    subprocess.run(["modprobe", "-a", "libcomposite", "cdc-acm", "dummy_hcd"], check=True)
    (GADGET / "functions/acm.0").mkdir(parents=True)
    (GADGET / "idVendor").write_text("0x1d6b")
    (GADGET / "idProduct").write_text("0x0104")
    (GADGET / "configs/c.1").mkdir()
    (GADGET / "configs/c.1/acm.0").symlink_to(GADGET / "functions/acm.0")
    bind("dummy_udc.0")
    path = wait_for(lambda: next((str(p) for p in Path("/dev").glob("ttyACM*")), ""))
    far_fd = os.open("/dev/ttyGS0", os.O_RDWR | os.O_NOCTTY)
    tty.setraw(far_fd)
    clock = VirtualClock()
    far = Far(ZaberTwin(clock, {"x": ZaberAxis()}), clock, far_fd)
    yield path, far
    far.pace.stop()
    os.close(far_fd)
    bind("")
    (GADGET / "configs/c.1/acm.0").unlink()
    (GADGET / "configs/c.1").rmdir()
    (GADGET / "functions/acm.0").rmdir()
    GADGET.rmdir()


def ask(stage: Stage, times: int) -> None:
    for _ in range(times):
        stage.positions_mm()


def bind(controller: str) -> None:
    """Plug the gadget into a controller, or with "" pull it out if it is in."""
    if (GADGET / "UDC").read_text().strip() != controller:
        (GADGET / "UDC").write_text(controller + "\n")


def move_and_refuse(stage: Stage) -> None:
    """Move 2 mm, read it back, be refused beyond the limits, stop in mid-move."""
    info = stage.connect()
    here = stage.positions_mm()["x"]
    reached = stage.move_to({"x": here + 2.0}, speed_mm_s=10.0)
    assert reached["x"] == pytest.approx(here + 2.0, abs=2 * info.axes["x"].step_mm)
    with pytest.raises(OutOfRangeError):
        stage.move_to({"x": info.axes["x"].max_mm + 5.0})
    stage.begin_move({"x": here - 20.0}, speed_mm_s=5.0)
    assert stage.status().moving
    stage.stop()
    rest = stage.positions_mm()["x"]
    assert here - 20.0 < rest < here + 2.0
    assert not stage.status().moving


def test_grbl_moves_over_a_pseudo_terminal(grbl: tuple[str, Far]) -> None:
    path, _ = grbl
    stage = GrblStage("stage0", SerialLine("stage0", path), WallClock(), GrblOptions(axes=("x",)))
    move_and_refuse(stage)
    with pytest.raises(AccessError):
        SerialLine("stage1", path)
    stage.close()


def test_zaber_moves_over_a_usb_serial_port_and_its_unplug_is_told(zaber: tuple[str, Far]) -> None:
    path, _ = zaber
    stage = ZaberStage(
        "stage0",
        SerialLine("stage0", path),
        WallClock(),
        ZaberOptions(axes={"x": 1}, microstep_mm={"x": MICROSTEP_MM}),
    )
    move_and_refuse(stage)
    bind("")
    begin_s = time.monotonic()
    with pytest.raises(DriverError, match="stage0"):
        ask(stage, 3)
    assert time.monotonic() - begin_s < 60.0
    stage.close()
