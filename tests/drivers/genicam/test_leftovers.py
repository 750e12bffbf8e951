"""What another program has left set on a GenICam camera: reset, recorded or refused; never silent."""

import re

import numpy as np
import pytest

from gs2ci_drivers.failures import DeviceFaultError, DriverError
from gs2ci_drivers.genicam.options import GenicamOptions
from gs2ci_sims.wires.genicam_nodes import Node
from tests.drivers.genicam.test_manners import Bench
from tests.twins.genicam_processing import further_features

ALL = further_features()


def off(node):
    """Return a value other than the one at power-up."""
    if node.kind == "boolean":
        return True
    if node.kind == "enumeration":
        return node.symbols[-1]
    return node.high() if node.value != node.high() else node.low()


LEFT = {name: off(node) for name, node in ALL.items() if not name.endswith("Selector")}
LEFT |= {
    "BinningHorizontal": 2,
    "BinningVertical": 2,
    "ReverseX": True,
    "Gamma": 0.45,
    "TestPattern": "GreyHorizontalRamp",
    "Gain": 12.0,
    "GainAuto": "Continuous",
    "ExposureAuto": "Continuous",
    "ExposureTime": 77.0,
    "AcquisitionMode": "SingleFrame",
    "AcquisitionFrameRate": 3.0,
}


def outcome(one, name, baseline):
    """Return how a camera with something left on it was dealt with; "silent" is what must not happen."""
    try:
        pixels = one.take(height=32, width=48, top=0, left=0)
    except DriverError as error:
        return "refused" if name in str(error) else "refused without its name"
    if any(f": {name} was " in text or f": {name}[" in text for text in one.sensor.incidents):
        return "reset" if np.array_equal(pixels, baseline) else "reset in vain"
    if any(key.split("[")[0] == name for key in one.sensor.settings.recorded):
        return "recorded"
    return "without effect" if np.array_equal(pixels, baseline) else "silent"


@pytest.fixture(scope="module")
def baseline():
    return Bench(processing=True).take(height=32, width=48, top=0, left=0)


def test_thirty_features_are_looked_at():
    assert len(LEFT) >= 35


@pytest.mark.parametrize("name", sorted(LEFT))
def test_a_feature_that_another_program_left_is_reset_recorded_or_refused(baseline, name):
    one = Bench(processing=True, auto_gain=10.6)
    if name != "GainAuto":
        one.twin.nodes.write("GainAuto", "Off")
    one.twin.nodes.write(name, LEFT[name])
    found = outcome(one, name, baseline)
    recorded = {"BlackLevel", "BalanceRatio", "AutoTargetBrightness", "RemoveLimits", "MultiShotHdrMode"}
    recorded |= {
        "NoiseReductionMode",
        "DefectCorrectStaticEnable",
        "ShadingCorrectionMode",
        "BslVignettingCorrectionMode",
    }
    recorded |= {"ExposureTime", "AcquisitionMode", "AcquisitionFrameRate", "ExposureAuto", "GainAuto"}
    recorded |= {"BalanceWhiteAuto", "BlackLevelAuto"}  # switched off, and recorded as off
    assert found == ("recorded" if name in recorded else "reset")


def test_switches_that_are_on_and_not_known_are_named_in_the_events(baseline):
    one = Bench(processing=True)
    one.twin.nodes.write("DefectCorrectStaticEnable", True)
    one.twin.nodes.write("ShadingCorrectionMode", "Pixel")
    one.take()
    said = " ".join(one.sensor.incidents)
    assert "DefectCorrectStaticEnable is True; what it does to readings is not known here" in said
    assert "ShadingCorrectionMode is Pixel" in said
    assert "AutoTargetBrightness" not in said


@pytest.mark.parametrize("seed", range(40))
def test_siblings_that_nobody_listed_are_not_silent_either(baseline, seed):
    """Drawn features of any kind, in a category of the standard's or the maker's own, off their value at power-up."""
    rng = np.random.default_rng(seed)
    name = f"{rng.choice(['Vendor', 'pgr', 'Lut', 'Iso'])}Thing{seed}{rng.choice(['', 'Enable', 'Mode', 'Auto'])}"
    kind = rng.choice(["boolean", "enumeration", "integer", "float"])
    category = str(rng.choice(["AnalogControl", "ImageFormatControl", "ImageProcessingControl", "MakersOwnControl"]))
    made = {
        "boolean": lambda: Node("boolean", False),
        "enumeration": lambda: Node("enumeration", "Off", symbols=("Off", "Fast", "Strong")),
        "integer": lambda: Node("integer", 3, lambda: 0.0, lambda: 40.0),
        "float": lambda: Node("float", 1.0, lambda: 0.0, lambda: 4.0, 0.01),
    }[kind]()
    made.category = category
    one = Bench(processing=True)
    one.twin.nodes.add(name, made)
    one.twin.nodes.write(name, off(made))
    assert outcome(one, name, baseline) == "recorded"
    wanted = "Off" if name.endswith("Auto") and kind == "enumeration" else made.value
    assert one.sensor.settings.recorded[name] == wanted


def test_gain_frozen_where_automatic_gain_stood_is_set_back():
    one = Bench(auto_gain=10.6)
    one.twin.nodes.write("GainAuto", "Continuous")
    assert one.take().mean() == 400
    assert [text for text in one.sensor.incidents if "Gain was 10.6 and has been reset to 0" in text]


def test_a_frame_rate_limit_that_was_left_on_loses_no_trigger():
    """Another program's limit of 3 Hz made a camera miss its triggers (blackfly_nodelet issue 15)."""
    one = Bench(processing=True)
    one.twin.nodes.write("AcquisitionFrameRateEnable", True)
    one.twin.nodes.write("AcquisitionFrameRate", 3.0)
    one.start()
    one.pulse(4)
    assert [one.sensor.read(0.5).sequence for _ in range(4)] == [0, 1, 2, 3]


def test_a_frame_rate_that_the_rig_file_requests_keeps_its_switch():
    one = Bench({"features": {"AcquisitionFrameRate": 30.0}}, processing=True)
    one.twin.nodes.write("AcquisitionFrameRateEnable", True)
    one.start()
    assert one.sensor.settings.recorded["AcquisitionFrameRateEnable"] is True


def test_each_entry_of_a_selector_is_recorded_and_the_choice_put_back():
    one = Bench(processing=True)
    one.twin.nodes.write("BalanceRatioSelector", "Blue")
    one.twin.nodes.write("BalanceRatio", 1.7)
    one.start()
    recorded = one.sensor.settings.recorded
    assert [recorded[f"BalanceRatio[{colour}]"] for colour in ("Red", "Green", "Blue")] == [1.0, 1.0, 1.7]
    assert one.twin.nodes.read("BalanceRatioSelector") == "Blue"


def test_the_record_says_the_trigger_as_it_is_when_frames_come():
    one = Bench(locks_triggers=True)
    one.start()
    recorded = one.sensor.settings.recorded
    assert (recorded["TriggerMode"], recorded["TriggerSource"]) == ("On", "Line1")
    assert (recorded["PixelFormat"], recorded["ExposureTime"]) == ("Mono12", 2000.0)


def test_a_feature_that_does_not_let_itself_be_reset_ends_the_configuration():
    one = Bench(processing=True)
    one.twin.nodes.write("DigitalShift", 2)
    write = one.twin.nodes.write
    one.twin.nodes.write = lambda name, value: None if name == "DigitalShift" else write(name, value)
    with pytest.raises(DeviceFaultError, match=r"reset DigitalShift.*stays at 2 instead of 0"):
        one.start()


# ---- what the rig file requests, beside what a capture sets itself


@pytest.mark.parametrize("factor", [{"BinningHorizontal": 2}, {"BinningHorizontal": 2, "BinningVertical": 2}])
def test_a_region_counts_binned_pixels_whatever_the_order(factor):
    """docs.baslerweb.com/image-roi: "the settings for the image ROI refer to the binned lines and columns"."""
    one = Bench({"features": {"DigitalShift": 1} | factor}, processing=True)
    pixels = one.take()
    assert pixels.shape == (64 // factor.get("BinningVertical", 1), 48)
    assert one.sensor.settings.format.width == 48
    placed = Bench({"features": factor}).take(height=16, width=24, top=4, left=8)
    assert placed.shape == (16, 24)


def test_a_requested_frame_rate_holds_triggers_back_and_is_counted():
    """Basler, pylon plug-in, pull request 147: "an upper limit", also of a camera that is triggered."""
    features = {"AcquisitionFrameRateEnable": True, "AcquisitionFrameRate": 25.0}
    one = Bench({"features": features}, processing=True)
    one.start()
    assert one.sensor.settings.link_s == pytest.approx(0.04)
    assert [text for text in one.sensor.incidents if "AcquisitionFrameRate is 25 Hz: frames are 40 ms apart" in text]
    one.pulse(3)  # 20 ms apart: the second one is lost
    assert [one.sensor.read(0.5).sequence for _ in range(2)] == [0, 1]


@pytest.mark.parametrize("requested", [{"AcquisitionFrameRate": 25.0}, {"AcquisitionFrameRateEnable": False}])
def test_a_frame_rate_that_is_switched_off_holds_nothing_back(requested):
    one = Bench({"features": requested}, processing=True)
    one.start()
    assert one.sensor.settings.link_s == 0.0


def test_an_exposure_is_set_behind_the_features_that_limit_it():
    """Teledyne DALSA FA-80: "the range is limited by the frame rate"; here to 5 ms, which the plan then knows."""
    features = {"AcquisitionFrameRateEnable": True, "AcquisitionFrameRate": 200.0}
    one = Bench({"features": features}, rate_limits=100.0)
    one.start(exposure_s=8e-3)
    assert one.sensor.settings.exposure_s == pytest.approx(5e-3)
    assert one.twin.nodes.number("ExposureTime") == pytest.approx(5000.0)


def test_a_gain_that_is_requested_twice_is_told():
    one = Bench({"features": {"Gain": 3.0}})
    one.start(gain_db=6.0)
    assert [text for text in one.sensor.incidents if "Gain = 3.0 was requested, 6.0 is set" in text]


@pytest.mark.parametrize(
    ("name", "value", "by"),
    [
        ("PixelFormat", "Mono8", "format"),
        ("Width", 48, "width"),
        ("ExposureTimeBaseAbs", 20.0, "the times in [capture]"),
        ("TriggerMode", "Off", "mode in [capture]"),
        ("TriggerDelayAbs", 5.0, "trigger_delay_s"),
    ],
)
def test_a_feature_that_a_capture_sets_itself_is_refused_by_name(name, value, by):
    with pytest.raises(ValueError, match=re.escape(f"{name} ({by})")):
        GenicamOptions.model_validate({"kind": "genicam", "features": {name: value}})


def test_leftovers_are_reset_once_for_each_capture():
    one = Bench(processing=True)
    one.twin.nodes.write("DefectCorrectStaticEnable", True)
    looks = []
    for _ in range(2):
        one.twin.calls.clear()
        one.sensor.prepare()
        one.start()
        looks.append(list(one.twin.calls).count("describe DefectCorrectStaticEnable"))
        assert sum("DefectCorrectStaticEnable is True" in text for text in one.sensor.incidents) == len(looks)
        one.sensor.stop()
    assert looks == [2, 2]  # for the note, and for the record
