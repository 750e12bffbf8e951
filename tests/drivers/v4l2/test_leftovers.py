"""What another program has left set on a V4L2 camera: reset, recorded or refused; never silent."""

from errno import EIO

import numpy as np
import pytest

from gs2ci_drivers.failures import DeviceFaultError, UnsupportedError
from gs2ci_drivers.v4l2 import leftovers
from gs2ci_drivers.v4l2.options import V4l2Options
from gs2ci_sims.wires.v4l2_controls import BOOLEAN, BUTTON, INTEGER, MENU, READ_ONLY
from tests.twins.v4l2_processing import ARRAY, TwinControl, processing_controls

STATELESS = V4l2Options(trigger_adapter="control")
ALL = {one.name: one for one in processing_controls()}
BESIDES = {"Gain, Automatic": 1, "Analogue Gain": 106, "IO Mode": 3, "Vertical Blanking": 5000, "Exposure": 77}
LEFT = {name: (one.low if one.value == one.high else one.high) for name, one in ALL.items()} | BESIDES
LEFT |= {"White Balance, Automatic": 1, "Exposure, Dynamic Framerate": 1}  # on at power-up: what matters is off


def taken(b):
    b.begin(exposure_s=2e-3)
    b.fire()
    frame = b.sensor.read(0.5)
    b.sensor.stop()
    return frame.pixels


def leave(b, name, value):
    b.twin._device._controls.leave(name, value)


def outcome(b, name, baseline):
    """Return how a camera with something left on it was dealt with; "silent" is what must not happen."""
    known = name.lower().replace(", ", "_").replace(" ", "_").replace("&", "_")
    try:
        pixels = taken(b)
    except (UnsupportedError, DeviceFaultError) as error:
        return "refused" if known in str(error) else "refused without its name"
    if np.array_equal(pixels, baseline):
        named = any(f": {known} was " in text for text in b.sensor.incidents)
        return "reset" if named else "without effect"
    return "recorded" if known in b.sensor.settings.recorded else "silent"


@pytest.fixture
def baseline(bench):
    return taken(bench(processing=True))


def test_thirty_controls_are_looked_at():
    assert len(LEFT) >= 35


@pytest.mark.parametrize("left", [220, 300])
def test_a_usb_cameras_readings_are_straight_though_it_begins_with_the_gamma_of_a_screen(bench, baseline, left):
    b = bench(processing=True, driver="uvcvideo", gamma=220)
    leave(b, "Gamma", left)
    np.testing.assert_array_equal(taken(b), baseline)
    assert b.sensor.settings.recorded["gamma"] == 100
    assert any("gamma was 300" in text for text in b.sensor.incidents) == (left == 300)


@pytest.mark.parametrize("name", sorted(LEFT))
def test_a_control_that_another_program_left_is_reset_recorded_or_refused(bench, baseline, name):
    b = bench(processing=True)
    leave(b, name, LEFT[name])
    if name == "Analogue Gain":  # which an automatic would replace
        leave(b, "Gain, Automatic", 0)
    found = outcome(b, name, baseline)
    assert found == {
        "IO Mode": "refused",
        "Binning Mode": "refused",
        "HDR Mode": "refused",
        "Noise Reduction": "refused",
        # The capture sets these, or they are on at power-up already:
        "Exposure": "without effect",
        "Vertical Blanking": "without effect",
        "Gain, Automatic": "without effect",
        "White Balance, Automatic": "without effect",
        "Exposure, Dynamic Framerate": "without effect",
    }.get(name, "reset")


@pytest.mark.parametrize("seed", range(40))
def test_siblings_that_nobody_listed_are_not_silent_either(bench, seed):
    """Drawn controls: standard, private or of another class, of any kind, off their default."""
    rng = np.random.default_rng(seed)
    base = int(rng.choice([0x00980000, 0x009A0000, 0x009C0000, 0x009E0000, 0x009F0000, 0x00A50000, 0x00B70000]))
    cid = base | int(rng.choice([0x0940 + seed, 0x1000 + 16 * seed, 0xFF00 + seed]))
    kind = int(rng.choice([INTEGER, BOOLEAN, MENU]))
    low, high = (0, 1) if kind == BOOLEAN else (0, int(rng.integers(2, 400)))
    default = int(rng.integers(low, high + 1))
    menu = {i: f"entry {i}" for i in range(low, high + 1)} if kind == MENU else {}
    made = lambda: TwinControl(cid, f"Sibling {seed}", kind, low, high, 1, default, 0, menu)  # noqa: E731
    plain, b = bench(), bench()
    for one in (plain, b):
        one.twin._device._controls.add(made())
    leave(b, f"Sibling {seed}", high if default < high else low)
    found = outcome(b, f"Sibling {seed}", taken(plain))
    assert found == ("refused" if cid & 0xF000 else "reset")


def test_what_the_rig_file_requests_is_kept_and_recorded(bench):
    b = bench(processing=True)
    leave(b, "Horizontal Flip", 1)
    leave(b, "IO Mode", 2)
    b.begin(controls={"horizontal_flip": 1, "io_mode": 2})
    assert b.sensor.settings.recorded["horizontal_flip"] == 1
    assert b.sensor.settings.recorded["io_mode"] == 2
    assert b.sensor.incidents == []
    b.sensor.stop()
    b.begin(controls={"io_mode": 2})  # the next capture requests it no longer
    assert b.sensor.settings.recorded["horizontal_flip"] == 0


def test_gain_that_automatic_gain_left_behind_is_set_back(bench):
    """Frozen gain made readings 3.4 times as bright (report of a UVC camera: the automatic stood at 10.6 dB)."""
    b = bench(auto_gain=106)
    b.begin()
    assert b.sensor.settings.recorded["analogue_gain"] == 0
    assert [text for text in b.sensor.incidents if "analogue_gain was 106 and has been reset to 0" in text]


def test_a_gain_that_is_requested_is_set_and_is_no_leftover(bench):
    b = bench(STATELESS.model_copy(update={"gain_db_per_unit": 0.1}), auto_gain=106)
    b.begin(gain_db=6.0)
    assert b.sensor.settings.recorded["analogue_gain"] == 60
    assert not [text for text in b.sensor.incidents if "analogue_gain" in text]


def test_all_unknown_ones_are_named_at_once(bench):
    b = bench(processing=True)
    leave(b, "HDR Mode", 1)
    leave(b, "Noise Reduction", 4)
    said = r"hdr_mode = 1 \(default 0\), noise_reduction = 4 \(default 0\)|noise_reduction = 4 .*, hdr_mode = 1"
    with pytest.raises(UnsupportedError, match=said):
        b.begin()


def test_a_control_that_does_not_let_itself_be_reset_ends_the_configuration(bench):
    b = bench(processing=True)
    leave(b, "Horizontal Flip", 1)
    b.faults.inject("v4l2.control_ignored", about="Horizontal Flip")
    with pytest.raises(DeviceFaultError, match=r"reset horizontal_flip.*stays at 1 instead of 0"):
        b.begin()


def test_an_array_is_named_unless_it_concerns_no_pixels(bench):
    """Lens shading, curves and tables of gains are arrays, which a list of plain controls does not show."""
    b = bench()
    for cid, name in ((0x009F0940, "Lens Shading"), (0x00A30903, "Detection Grid")):
        b.twin._device._controls.add(TwinControl(cid, name, ARRAY, 0, 255, 1, 0))
    b.begin()
    (note,) = b.sensor.incidents
    assert "lens_shading is an array, which stays as another program has left it" in note


def test_a_control_that_cannot_be_read_is_recorded_as_such(bench):
    b = bench()
    b.twin._device._controls.add(TwinControl(0x009D0903, "Compression Quality", INTEGER, 0, 9, 1, 3))
    batch = b.twin._device._controls.batch

    def broken(argument, payload, *, write):
        if payload[:4] == (0x009D0903).to_bytes(4, "little"):
            raise OSError(EIO, "control")
        batch(argument, payload, write=write)

    b.twin._device._controls.batch = broken
    b.begin()
    assert b.sensor.settings.recorded["compression_quality"].startswith("not readable: ")


def test_a_region_that_another_program_left_is_undone(bench):
    b = bench(crops=True)
    b.begin(height=32, width=84, top=4, left=4)
    b.sensor.close()
    again = type(b.sensor)("cam0", b.twin, b.world.clock, STATELESS)
    again.connect()
    settings = again.configure(b.config)
    assert (settings.format.height, settings.format.width) == (64, 96)
    assert settings.recorded["region"] == "64 x 96 at 0, 0"


def test_what_another_program_left_before_the_camera_was_opened_is_found(bench):
    b = bench()
    b.faults.inject("v4l2.gain_left", value=106)
    b.begin()
    assert b.sensor.settings.recorded["analogue_gain"] == 0
    b = bench()
    b.faults.inject("v4l2.private_left", value=3)
    with pytest.raises(UnsupportedError, match=r"io_mode = 3 \(default 0\)"):
        b.begin()


def test_what_cannot_change_pixels_or_cannot_be_set_is_left_alone(bench):
    b = bench()
    for control in (
        TwinControl(0x009D0903, "Compression Quality", INTEGER, 1, 100, 1, 90),
        TwinControl(0x009A090A, "Focus, Absolute", INTEGER, 0, 255, 1, 0),
        TwinControl(0x009E0990, "Unit Cell", INTEGER, 0, 9, 1, 3, READ_ONLY),
        TwinControl(0x0098F001, "Calibrate", BUTTON, 0, 0, 0, 0),
    ):
        b.twin._device._controls.add(control)
    leave(b, "Compression Quality", 40)
    leave(b, "Focus, Absolute", 120)
    b.begin()
    recorded = b.sensor.settings.recorded
    assert (recorded["compression_quality"], recorded["focus_absolute"], recorded["unit_cell"]) == (40, 120, 3)
    assert "calibrate" not in recorded


def test_controls_of_the_capture_node_beside_a_subdevice_are_looked_at_too(bench):
    table = STATELESS.model_copy(update={"subdevice": "/dev/v4l-subdev0"})
    b = bench(table, on_subdevice=True, processing=True)
    leave(b, "Horizontal Flip", 1)
    b.begin()
    assert b.sensor.settings.recorded["horizontal_flip"] == 0


def test_the_record_tells_driver_format_region_and_trigger(bench):
    b = bench(crops=True)
    b.begin(fourcc="Y12", height=32, width=84)
    recorded = b.sensor.settings.recorded
    assert recorded["driver"] == "twin 6.1.0"
    assert recorded["format"] == "Y12 32 x 84"
    assert recorded["region"] == "32 x 84 at 16, 4"
    assert recorded["trigger_mode"] == 1


def test_a_default_outside_a_menu_is_not_asked_for():
    from gs2ci_drivers.v4l2 import abi  # noqa: PLC0415
    from gs2ci_drivers.v4l2.controls import Control  # noqa: PLC0415

    holes = Control(0x009A0901, "auto_exposure", abi.ControlType.MENU, 0, 3, 1, abi.ControlFlag(0), {3: "priority"}, 3)
    assert leftovers.neutral_of(holes) == 3
