"""Every fault of the reference, injected into a whole capture: `fault_cases.csv`, one line each.

One line of each family runs with every commit, all of them by night. A line states the rig, the fault, the moment
of its injection ("open": before the ports are opened, "upload": as it begins, "shot": when row 0 is taken) and the
expected outcome: the error's class, its device and its trigger, or "tolerated". In each case the error is raised in
time, every device is at rest, the rows taken before are correct, and the next capture works on the same bench without a
restart: where a fault strikes after row 0 alone, the next case's own capture shows it, on the bench that the case
before has left. docs/faults.md is the table of these outcomes; `GS2CI_WRITE_DOCS=1 pytest tests/system/test_faults.py`
writes it again.
"""

import csv
import os
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest

from gs2ci.core.progress import Silent
from gs2ci.core.storage import read_shot, recover
from gs2ci.rig.recording import prepare, record
from gs2ci_drivers.failures import DriverError
from gs2ci_sims.faults import KNOWN
from tests.nightly import but_one_of_each
from tests.system.conftest import small_rig

pytestmark = pytest.mark.slow

TABLE = Path(__file__).parents[2] / "docs" / "faults.md"
TOLERATED = "tolerated"
SHOTS = 2
LONGEST_S = 10.0
"""Virtual seconds in which a capture of this size must end with any fault: moves, uploads and replies."""
RIGS = {
    "zaber": ("DLPC900, V4L2, Zaber", {}),
    "grbl": ("DLPC900, V4L2, GRBL", {"stage": {"kind": "grbl"}}),
    "scpi": ("SCPI modulator, V4L2, Zaber", {"modulator": {"kind": "scpi"}}),
    "unicam": ("DLPC900, V4L2 by unicam, Zaber", {"world": {"camera_driver": "unicam"}}),
    "uvc": ("DLPC900, V4L2 by uvcvideo, Zaber", {"world": {"camera_driver": "uvcvideo"}}),
    "late": ("DLPC900, V4L2 stamped at the end, Zaber", {"world": {"camera_driver": "other"}}),
    "genicam": (
        "DLPC900, GenICam, Zaber",
        {"sensor": {"kind": "genicam", "height": 48, "width": 64, "format": "Mono12p", "black_level_dn": 16.0}},
    ),
    "video": (
        "second display, V4L2, Zaber",
        {
            "modulator": {"kind": "video", "trigger_patch": [0, 0, 40, 40]},
            # Masks of whole refreshes of 60 Hz.
            "capture": {"mask_s": 0.05, "axis": ""},
        },
    ),
    "gated": (
        "DLPC900, gated IMX296, Zaber",
        {
            "modulator": {"trigger_out_1": {"inverted": True}},
            "sensor": {"trigger_adapter": "module"},
            "capture": {"mode": "gate"},
            "world": {"camera_driver": "unicam"},
        },
    ),
}
VICTIMS = {
    "genicam": "sensor",
    "screen": "modulator",
    "dlpc900": "modulator",
    "scpi": "modulator",
    "panel": "modulator",
    "v4l2": "sensor",
}
MOMENTS = {"open": "at the start", "upload": "during preparation", "shot": "after row 0"}


@dataclass(frozen=True)
class Case:
    rig: str
    fault: str
    moment: str
    about: str
    skip: int
    times: int
    value: float
    outcome: str
    names: str
    trigger: int | None

    @property
    def victim(self) -> str:
        family = self.fault.split(".")[0]
        return VICTIMS.get(family, "modulator" if self.rig == "scpi" else "stage")

    @property
    def id(self) -> str:
        where = f"{self.about}-{self.moment}".strip("-").replace(" ", "_")
        return f"{self.rig}-{self.fault}-{where}-{self.skip}-{self.times}-{self.value:g}"


def read_cases() -> list[Case]:
    with (Path(__file__).parent / "fault_cases.csv").open(newline="") as file:
        return [
            Case(
                **{key: row[key] for key in ("rig", "fault", "moment", "about", "outcome", "names")},
                skip=int(row["skip"]),
                times=int(row["times"]),
                value=float(row["value"]),
                trigger=int(row["trigger"]) if row["trigger"] else None,
            )
            for row in csv.DictReader(file)
        ]


CASES = read_cases()


class Trap(Silent):
    """A listener that injects a fault at its moment."""

    def __init__(self, case, bench):
        super().__init__()
        self.case, self.bench, self.where = case, bench, ""
        if case.moment == "open":
            self.spring()

    def stage(self, name, total=None):
        self.where = name
        if self.case.moment == name == "upload":
            self.spring()

    def step(self, done, **figures):
        if (self.where, done, self.case.moment) == ("shots", 1, "shot"):
            self.spring()

    def spring(self):
        case = self.case
        self.bench.faults[case.victim].inject(
            case.fault, skip=case.skip, times=case.times, value=case.value, about=case.about
        )


def run(small, progress, out):
    """Open the rig, capture, close it; return the error, or None, and how long it took on the world's clock."""
    clock = small.bench.world.clock
    begin_s, error = clock.now_s(), None
    devices = small.rig.open()
    try:
        record(small.rig, devices, prepare(small.rig, devices), out, replace=True, progress=progress)
    except DriverError as caught:
        error = caught
    finally:
        devices.close()
    return error, clock.now_s() - begin_s


def home_if_needed(small):
    devices = small.rig.open()
    try:
        devices.stage.connect()
        status = devices.stage.status()
        if not status.referenced or status.faults:
            devices.stage.home()
    finally:
        devices.close()


def do_what_the_remedies_say(small):
    """Plug in, switch off and on, release the emergency stop or the hold, let it cool down."""
    modulator, sensor, stage = small.bench.modulator, small.bench.sensor, small.bench.stage
    for faults in small.bench.faults.values():
        faults.clear()
    if small.rig.table.modulator.kind == "dlpc900":
        modulator.power_cycle()
    else:
        modulator.fault = ""
    stage.release()
    if hasattr(sensor, "unplug"):
        sensor.unplug()  # a camera forgets what others have set when it loses power
    for twin in (modulator, sensor, stage):
        twin.plug_in()
    small.bench.world.clock.sleep_s(3.0)
    home_if_needed(small)


def check_at_rest(small):
    world = small.bench.world
    world.clock.sleep_s(1.0)
    before_s = world.clock.now_s()
    world.clock.sleep_s(1.0)
    now_s = world.clock.now_s()
    assert not world.masks_between(before_s, now_s), "the modulator still shows masks"
    assert not small.bench.sensor.streaming, "the sensor still streams"
    stage = small.bench.stage
    assert stage.positions_mm_at(before_s) == stage.positions_mm_at(now_s), "the stage still moves"


def check_rows(small, path, expected_rows):
    """Hold every row against the light's formula at the exposure that it says it came from."""
    with h5py.File(path) as file:
        readings, stamps = file["meas"][:].astype(float), file["frames/t_kernel_ns"][:]
    assert len(readings) == expected_rows
    for row, stamp in enumerate(stamps):
        exposures = small.bench.world.exposures
        index = min(range(len(exposures)), key=lambda i: abs(exposures[i].start_s - stamp * 1e-9))
        expected = small.expected_dn(index, read_shot(path, row).masks)
        np.testing.assert_allclose(readings[row], expected, rtol=0, atol=0.51)


def check_that_it_works(small, folder):
    """Capture without a fault."""
    error, _ = run(small, Silent(), folder / "again.h5")
    assert error is None, str(error)
    check_rows(small, folder / "again.h5", SHOTS)


@pytest.fixture(scope="module")
def benches(tmp_path_factory):
    """Benches that a fault has left, by their rigs, of which no capture has shown yet that they work."""
    left = {}
    yield left
    for small in left.values():
        check_that_it_works(small, tmp_path_factory.mktemp("again"))


def family(case):
    """What is alike: one fault at one moment with one outcome, whatever is asked of the device just then."""
    return case.fault, case.moment, case.outcome, "" if case.rig in ("zaber", "grbl") else case.rig


@pytest.mark.parametrize("case", but_one_of_each(family, CASES), ids=lambda case: case.id)
def test_a_fault_ends_in_time_and_typed_and_the_next_capture_works(case, benches, tmp_path):
    # Row 0 of a capture that is disturbed later shows that the bench works.
    small = benches.pop(case.rig, None) if case.moment == "shot" else None
    if small is None:
        changes = RIGS[case.rig][1]
        # Masks in one order: what is asked of a modulator between two exposures is then no more than to start again.
        capture = {"masks": 2, "mask_s": 0.04, "shots": SHOTS, "turn_masks": False} | changes.get("capture", {})
        small = small_rig(tmp_path, dlp5500=True, **(changes | {"capture": capture}))
    out = tmp_path / "shot.h5"
    partial = tmp_path / "shot.h5.partial"

    faults = small.bench.faults[case.victim]
    faults.struck.clear()

    error, seconds = run(small, Trap(case, small.bench), out)

    assert faults.struck, "the fault had no opportunity"
    assert seconds < LONGEST_S
    outcome = TOLERATED if error is None else type(error).__name__
    assert outcome == case.outcome, str(error)
    check_at_rest(small)
    if error is None:
        check_rows(small, out, SHOTS)
    else:
        assert (error.device, error.trigger_index) == (case.names, case.trigger)
        assert error.device in str(error)
        assert error.remedy or error.allowed
        assert not out.exists()
        if case.moment == "shot":
            check_rows(small, recover(partial, tmp_path / "saved.h5"), 1)

    do_what_the_remedies_say(small)
    if case.moment == "shot":
        benches[case.rig] = small
    else:
        check_that_it_works(small, tmp_path)


@pytest.mark.parametrize(
    ("fault", "about", "outcome"),
    [
        ("dlpc900.parked", "", TOLERATED),
        ("dlpc900.standby", "", TOLERATED),
        ("dlpc900.reply_lost", "table entry", "NoAnswerError"),
        ("dlpc900.unplugged", "table entry", "DisconnectedError"),
        ("dlpc900.power_cycle", "table entry", "DisconnectedError"),
    ],
)
def test_a_fault_while_the_masks_get_another_order_names_the_trigger_that_it_kept(tmp_path, fault, about, outcome):
    small = small_rig(tmp_path, dlp5500=True, capture={"masks": 2, "mask_s": 0.04, "shots": SHOTS})
    out = tmp_path / "shot.h5"
    case = Case("zaber", fault, "shot", about, 0, 1, 0.0, outcome, "modulator", 1)
    error, seconds = run(small, Trap(case, small.bench), out)
    assert small.bench.faults["modulator"].struck
    assert seconds < LONGEST_S
    check_at_rest(small)
    assert (TOLERATED if error is None else type(error).__name__) == outcome, str(error)
    if error is None:
        check_rows(small, out, SHOTS)
    else:
        assert (error.device, error.trigger_index) == ("modulator", 1)
        check_rows(small, recover(tmp_path / "shot.h5.partial", tmp_path / "saved.h5"), 1)
    do_what_the_remedies_say(small)
    check_that_it_works(small, tmp_path)


def render_table() -> str:
    lines = [
        "# Faults and their outcomes",
        "",
        "Written by `tests/system/test_faults.py`, which injects each fault into a whole capture on simulated",
        "devices with the real drivers. In every case the capture ends in bounded time, all devices that can be",
        "reached are at rest, rows taken before are intact, and the next capture works without a restart of the",
        "program. *Tolerated*: the capture continued, and every row is correct. An error names the device and the",
        "trigger that was being processed; before the first plan there is no trigger. Masks are shown in one order.",
        "",
        "| rig | fault | what happens | when | during | outcome | names | trigger |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for case in CASES:
        summary = KNOWN[case.fault].replace("`value`", f"{case.value:g}").replace("|", "\\|")
        trigger = "" if case.trigger is None else str(case.trigger)
        about = f"`{case.about}`" if case.about else ""
        lines.append(
            f"| {RIGS[case.rig][0]} | {case.fault} | {summary} | {MOMENTS[case.moment]} | {about} | "
            f"{case.outcome} | {case.names} | {trigger} |"
        )
    struck = {case.fault for case in CASES}
    lines += ["", f"{len(CASES)} cases of {len(struck)} kinds of fault.", ""]
    return "\n".join(lines)


def test_the_table_in_the_docs_is_what_happens():
    """The cases above compare each line with its outcome; this compares the page with the lines."""
    text = render_table()
    if os.environ.get("GS2CI_WRITE_DOCS"):
        TABLE.write_text(text, encoding="utf-8")
    assert TABLE.read_text(encoding="utf-8") == text, "write it again with GS2CI_WRITE_DOCS=1"


def test_at_least_eighty_faults_are_driven_through_whole_captures():
    assert len(CASES) >= 80
    assert len({case.id for case in CASES}) == len(CASES)


@pytest.mark.parametrize("fault", ["v4l2.frame_corrupt", "v4l2.trigger_missed", "v4l2.frame_stale"])
def test_a_shot_that_went_astray_is_taken_again_when_retries_are_allowed(fault, make_small, tmp_path):
    small = make_small(capture={"masks": 2, "mask_s": 0.04, "shots": SHOTS, "retries": 1})
    small.bench.faults["sensor"].inject(fault, value=10.0)
    error, _ = run(small, Silent(), tmp_path / "shot.h5")
    assert error is None
    check_rows(small, tmp_path / "shot.h5", SHOTS)
    with h5py.File(tmp_path / "shot.h5") as file:
        flags = file["frames/flags"][:]
        events = " ".join(text.decode() for text in file["events"][:])
    assert flags[0] & 8
    assert not flags[1] & 8
    assert "tried again" in events
