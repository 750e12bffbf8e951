"""Every fault that the reference lists, driven through a whole capture.

For each: a typed error that names device and trigger (or none, where the fault is ridden out), in time; every
device that can still be reached at rest; rows taken before it intact; and the next capture works on the same
bench. What came of each is the table in docs/faults.md (`GS2CI_WRITE_DOCS=1 pytest tests/system/test_faults.py`
writes it anew).
"""

import os
from dataclasses import dataclass, field, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from gs2ci.core.progress import Silent
from gs2ci.core.storage import count_shots, recover
from gs2ci.rig.recording import prepare, record
from gs2ci_drivers import failures
from gs2ci_drivers.failures import DriverError
from gs2ci_drivers.stage import Stage
from gs2ci_sims import faults as fault_kinds

TABLE = Path(__file__).parents[2] / "docs" / "faults.md"
SHOTS = 2
RIDDEN_OUT = "ridden out"
LONGEST_S = 30.0
"""Virtual seconds that a capture of this size may take to fail: uploads, patience with moves and replies included."""


@dataclass(frozen=True)
class Case:
    """One fault at one moment.

    `moment`: "open" (before the ports are opened), "upload" (as it begins) or "shot" (when row 0 is taken).
    `outcome`: the error's class, or RIDDEN_OUT. `device`: whom the error names.
    """

    fault: str
    moment: str
    outcome: str
    device: str = ""
    skip: int = 0
    times: int = 1
    value: float = 0.0
    about: str = ""
    rig: str = "zaber"

    @property
    def family(self) -> str:
        return self.fault.split(".")[0]

    @property
    def target(self) -> str:
        families = {"dlpc900": "modulator", "panel": "modulator", "scpi": "modulator", "v4l2": "sensor"}
        return self.device_hit or families.get(self.family, "stage")

    @property
    def device_hit(self) -> str:
        return "modulator" if self.family == "serial" and self.rig == "scpi" else ""

    @property
    def name(self) -> str:
        parts = [self.rig, self.fault, self.about or "any", self.moment, str(self.skip), f"{self.value:g}"]
        return "-".join(part.replace(" ", "_") for part in parts)


def _cases():
    """All cases; the outcome of each is checked and its reason stands in the table's summary."""
    gone, mute, bad = "DisconnectedError", "NoAnswerError", "BadReplyError"
    modulator, sensor, stage = "modulator", "sensor", "stage"
    yield from _modulator_cases(gone, mute, bad, modulator)
    yield from _sensor_cases(gone, sensor)
    yield from _zaber_cases(gone, mute, bad, stage)
    yield from _grbl_cases(gone, mute, bad, stage)
    yield from _scpi_cases(gone, mute, bad, modulator)


def _modulator_cases(gone, mute, bad, modulator):
    for moment, about in (("upload", "main status"), ("shot", "main status"), ("shot", "pattern control")):
        yield Case("dlpc900.reply_lost", moment, "?", modulator, about=about)
        yield Case("dlpc900.reply_late", moment, "?", modulator, about=about, value=3.0)
        yield Case("dlpc900.reply_twice", moment, "?", modulator, about=about)
        yield Case("dlpc900.reply_garbled", moment, "?", modulator, about=about)
        yield Case("dlpc900.reply_short", moment, "?", modulator, about=about)
        yield Case("dlpc900.reply_other_sequence", moment, "?", modulator, about=about)
        yield Case("dlpc900.babble", moment, "?", modulator, about=about)
    yield Case("dlpc900.stale", "open", "?", modulator)
    for about in ("display mode", "table entry", "table config", "image start"):
        yield Case("dlpc900.nack", "upload", "?", modulator, about=about, value=5)
    yield Case("dlpc900.nack", "shot", "?", modulator, about="pattern control", value=5)
    for about in ("image data", "table entry", "image start"):
        yield Case("dlpc900.report_lost", "upload", "?", modulator, about=about)
    yield Case("dlpc900.report_lost", "upload", "?", modulator, about="image data", skip=9)
    yield Case("dlpc900.write_stuck", "upload", "?", modulator, about="image data")
    yield Case("dlpc900.write_stuck", "shot", "?", modulator, about="pattern control")
    for about in ("display mode", "trigger out 2", "table entry", "table config", "image start", "image data"):
        yield Case("dlpc900.unplugged", "upload", "?", modulator, about=about)
    yield Case("dlpc900.unplugged", "open", "?", modulator, about="hardware type")
    yield Case("dlpc900.unplugged", "shot", "?", modulator, about="pattern control")
    yield Case("dlpc900.unplugged", "shot", "?", modulator, about="main status", skip=2)
    yield Case("dlpc900.power_cycle", "upload", "?", modulator, about="image data")
    yield Case("dlpc900.power_cycle", "shot", "?", modulator, about="pattern control")
    yield Case("dlpc900.parked", "shot", "?", modulator)
    yield Case("dlpc900.standby", "shot", "?", modulator)
    yield Case("dlpc900.forgets_images", "shot", "?", modulator)
    yield Case("dlpc900.ignores_stop", "shot", "?", modulator)
    yield Case("dlpc900.stops_early", "shot", "?", modulator, skip=1)
    yield Case("dlpc900.sequencer_abort", "shot", "?", modulator, skip=1)
    yield Case("dlpc900.pulse_lost", "shot", "?", "sensor")
    yield Case("dlpc900.pulse_twice", "shot", "?", "sensor")
    yield Case("dlpc900.suppress_inverted", "shot", "?", "sensor", times=9)
    yield Case("dlpc900.count_off", "shot", "?", modulator)


def _sensor_cases(gone, sensor):
    for about in ("open", "QUERYCAP"):
        yield Case("v4l2.unplugged", "open", "?", sensor, about=about)
    for about in ("REQBUFS", "QUERYBUF", "QBUF", "STREAMON"):
        yield Case("v4l2.unplugged", "upload", "?", sensor, about=about)
        yield Case("v4l2.call_fails", "upload", "?", sensor, about=about, value=5)
    yield Case("v4l2.call_fails", "open", "?", sensor, about="S_FMT", value=16)
    yield Case("v4l2.call_fails", "open", "?", sensor, about="open", value=13)
    for about in ("poll", "DQBUF"):
        yield Case("v4l2.unplugged", "shot", "?", sensor, about=about)
    yield Case("v4l2.call_fails", "shot", "?", sensor, about="DQBUF", value=5)
    yield Case("v4l2.wake_empty", "shot", "?", sensor)
    for fault in (
        "trigger_missed",
        "trigger_doubled",
        "stalled",
        "frame_dropped",
        "frame_corrupt",
        "frame_short",
        "frame_noisy",
        "stream_broken",
        "stream_ended",
        "source_changed",
    ):
        yield Case(f"v4l2.{fault}", "shot", "?", sensor)
    yield Case("v4l2.frame_repeated", "upload", "?", sensor)
    yield Case("v4l2.frame_late", "shot", "?", sensor, value=0.3)
    yield Case("v4l2.frame_late", "shot", "?", sensor, value=30.0)
    yield Case("v4l2.frame_stale", "shot", "?", sensor, value=10.0)
    yield Case("v4l2.buffers_fewer", "upload", "?", sensor, value=2)
    yield Case("v4l2.first_number", "upload", "?", sensor, value=7)
    yield Case("v4l2.size_changed", "open", "?", sensor)
    yield Case("v4l2.format_changed", "open", "?", sensor)
    yield Case("v4l2.control_ignored", "open", "?", sensor)


def _serial_cases(stage, moves, asks):
    for about in (moves, asks):
        if asks == "?" and about == "?":
            yield Case("serial.reply_late", "shot", "?", stage, about=about, value=0.7)
        for fault in (
            "reply_lost",
            "reply_twice",
            "reply_spoilt",
            "reply_cut",
            "reply_in_pieces",
            "replies_joined",
            "noise",
            "babble",
            "request_lost",
        ):
            yield Case(f"serial.{fault}", "shot", "?", stage, about=about)
        yield Case("serial.reply_late", "shot", "?", stage, about=about, value=2.0)
    yield Case("serial.unplugged", "shot", "?", stage, about=moves)
    yield Case("serial.unplugged", "shot", "?", stage, about=asks)
    yield Case("serial.unplugged", "upload", "?", stage)
    yield Case("serial.write_stuck", "shot", "?", stage, about=moves)
    yield Case("serial.stale", "open", "?", stage)


def _zaber_cases(gone, mute, bad, stage):
    yield from _serial_cases(stage, "move abs", "get pos")
    yield Case("serial.unplugged", "open", "?", stage)
    for fault in ("stall", "limit", "emergency_stop", "supply", "pre_empted", "power_cycle", "slip", "never_idle"):
        yield Case(f"zaber.{fault}", "shot", "?", stage, skip=1)
    yield Case("zaber.stall", "shot", "?", stage)
    yield Case("zaber.driver_disabled", "shot", "?", stage)
    for about in ("move abs", "set maxspeed", "get pos"):
        yield Case("zaber.reject", "shot", "?", stage, about=about)
    yield Case("zaber.bad_data", "shot", "?", stage, about="move abs")
    for fault in ("bad_checksum", "wrong_address", "wrong_id", "alert", "alert_inside"):
        yield Case(f"zaber.{fault}", "shot", "?", stage, about="get pos")
        yield Case(f"zaber.{fault}", "shot", "?", stage, about="move abs")


def _grbl_cases(gone, mute, bad, stage):
    for case in _serial_cases(stage, "$J=", "?"):
        yield replace(case, rig="grbl")
    for fault in ("hard_limit", "reset_moving", "power_cycle", "early_idle", "door", "hold", "jog_cancelled"):
        yield Case(f"grbl.{fault}", "shot", "?", stage, skip=1, rig="grbl")
    yield Case("grbl.hard_limit", "shot", "?", stage, rig="grbl")
    yield Case("grbl.error", "shot", "?", stage, rig="grbl", about="$J=", value=15)
    yield Case("grbl.banner_inside", "shot", "?", stage, rig="grbl", about="$J=")
    yield Case("grbl.message", "shot", "?", stage, rig="grbl")
    yield Case("grbl.silent_status", "shot", "?", stage, rig="grbl")
    yield Case("grbl.silent_status", "shot", "?", stage, rig="grbl", times=2)


def _scpi_cases(gone, mute, bad, modulator):
    for fault in ("block_spoilt", "block_short"):
        yield Case(f"scpi.{fault}", "upload", "?", modulator, rig="scpi")
    for fault in ("refuses", "fault", "restarts"):
        yield Case(f"scpi.{fault}", "shot", "?", modulator, rig="scpi", value=-200)
    for fault in ("reply_lost", "reply_spoilt", "reply_cut", "noise", "unplugged"):
        yield Case(f"serial.{fault}", "shot", "?", modulator, rig="scpi")
    yield Case("panel.stops_early", "shot", "?", modulator, rig="scpi", skip=1)
    yield Case("panel.pulse_lost", "shot", "?", "sensor", rig="scpi")
    yield Case("panel.pulse_twice", "shot", "?", "sensor", rig="scpi")


CASES = list(_cases())


class Trap(Silent):
    """A listener that injects the fault at its moment."""

    def __init__(self, case, bench):
        super().__init__()
        self.case, self.bench, self.where = case, bench, ""

    def stage(self, name, total=None):
        self.where = name
        if self.case.moment == name == "upload":
            self.spring()

    def step(self, done, **figures):
        if self.where == "shots" and done == 1 and self.case.moment == "shot":
            self.spring()

    def spring(self):
        case = self.case
        self.bench.faults[case.target].inject(
            case.fault, skip=case.skip, times=case.times, value=case.value, about=case.about
        )


@dataclass
class Outcome:
    error: DriverError | None
    seconds: float
    rows: int
    incidents: list[str] = field(default_factory=list)


OUTCOMES: dict[str, tuple[Case, Outcome]] = {}

RIGS = {
    "zaber": {},
    "grbl": {"stage": {"kind": "grbl"}},
    "scpi": {
        "modulator": {"kind": "scpi"},
        "capture": {"density": 0.5},
    },
}


def run_with(small, trap, out, *, after_open=None):
    """Capture with a trap set; return the error, or None."""
    clock = small.bench.world.clock
    devices = small.rig.open()
    begin_s = clock.now_s()
    error = None
    try:
        if after_open:
            after_open(devices)
        record(small.rig, devices, prepare(small.rig, devices), out, replace=True, progress=trap)
    except DriverError as caught:
        error = caught
    finally:
        devices.close()
    return error, clock.now_s() - begin_s


def make_well(small, devices: Stage | None = None) -> None:
    """Do what the errors' remedies say: plug in, clear the way, home."""
    for faults in small.bench.faults.values():
        faults.clear()
    modulator, stage = small.bench.modulator, small.bench.stage
    if hasattr(modulator, "power_cycle"):
        modulator.power_cycle()
    else:
        modulator.fault = ""
    if hasattr(stage, "release"):
        stage.release()
    for twin in (modulator, small.bench.sensor, stage):
        twin.plug_in()
    small.bench.world.clock.sleep_s(3.0)


def home_if_needed(devices) -> None:
    devices.stage.connect()
    status = devices.stage.status()
    if "FO" in str(status.faults) or "FD" in str(status.faults) or "FV" in str(status.faults):
        return
    if not status.referenced or status.faults:
        devices.stage.home()


@pytest.fixture(scope="module")
def clean_rows(tmp_path_factory):
    """Pixels of a capture in which nothing goes wrong, for each rig."""
    return {}


def rows_of(path):
    with h5py.File(path) as file:
        return file["meas"][:][file["meas_valid"][:].astype(bool)]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_fault_ends_as_the_table_says(case, make_small, clean_rows, tmp_path):
    changes = {"capture": {"masks": 2, "mask_s": 0.04, "shots": SHOTS}}
    for name, change in RIGS[case.rig].items():
        changes[name] = {**changes.get(name, {}), **change}
    if case.rig not in clean_rows:
        clean = make_small(**changes)
        clean_rows[case.rig] = rows_of(clean.capture(tmp_path / "clean.h5"))
    small = make_small(**changes)
    trap = Trap(case, small.bench)
    out = tmp_path / "shot.h5"
    if case.moment == "open":
        trap.spring()
    error, seconds = run_with(small, trap, out)
    rows = 0
    partial = out.with_name("shot.h5.partial")
    taken = np.zeros((0,))
    if error is None:
        taken = rows_of(out)
    elif partial.exists() and int(h5py.File(partial)["meas_valid"][:].sum()):
        taken = rows_of(recover(partial, tmp_path / "saved.h5"))
    OUTCOMES[case.name] = (case, Outcome(error, seconds, len(taken)))
    print(
        "OUT|%s|%s|%s|%s|%s|%.2f|%d|%s"
        % (
            case.name,
            case.outcome,
            type(error).__name__,
            getattr(error, "device", ""),
            getattr(error, "trigger_index", ""),
            seconds,
            len(taken),
            error,
        )
    )
    struck = small.bench.faults[case.target].struck
    print("STRUCK", struck)
    print("NOTES", getattr(error, "__notes__", []))
    # rest
    at_rest(small, case)
    make_well(small)
    again, _ = run_with(small, Silent(), tmp_path / "again.h5", after_open=home_if_needed)
    print("AGAIN", again)
    assert struck
    assert again is None, again


def at_rest(small, case):
    clock = small.bench.world.clock
    clock.sleep_s(3.0)
    now = clock.now_s()
    print("MASK", small.bench.world.masks_between(now - 0.01, now) != ())
    a = small.bench.stage.positions_mm_at(now)
    clock.sleep_s(0.5)
    b = small.bench.stage.positions_mm_at(now + 0.5)
    print("MOVING", a != b)
