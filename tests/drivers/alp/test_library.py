"""The ALP driver on a stand-in for the maker's library, built here: its binary interface, loaded by alp4lib."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from gs2ci.core.clock import WallClock
from gs2ci_drivers.alp.driver import AlpModulator
from gs2ci_drivers.alp.options import AlpOptions
from gs2ci_drivers.failures import AccessError, DisconnectedError, RefusedError, UnsupportedError
from gs2ci_drivers.links import alp_library
from gs2ci_drivers.links.alp_library import AlpLibrary
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the stand-in, under the name by which alp4lib looks for the library."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler (cc) to build the stand-in library with")
    pytest.importorskip("ALP4", reason="the extra `alp` is not installed")
    built = tmp_path_factory.mktemp("alp")
    source = Path(__file__).with_name("standin.c")
    words = ["cc", "-Wall", "-Werror", "-O1", "-shared", "-fPIC", "-o", str(built / "libalp43.so"), str(source)]
    subprocess.run(words, check=True, capture_output=True)
    return built


@pytest.fixture
def device(folder):
    """The stand-in's own functions; the device is free and plugged in."""
    functions = ctypes.CDLL(str(folder / "libalp43.so"))
    functions.StandinPlug(0)
    functions.StandinPlug(1)
    return functions


@pytest.fixture
def modulator(folder, device, capsys):
    made = AlpModulator("dmd0", AlpLibrary("dmd0", "4.3", folder), WallClock(), AlpOptions(kind="alp"))
    assert capsys.readouterr().out == ""  # alp4lib prints the path
    yield made
    made.close()


MASKS = np.random.default_rng(3).integers(0, 2, (3, 48, 64), dtype=np.uint8)


def test_what_the_device_says_arrives_as_it_was_said(modulator):
    info = modulator.connect()
    assert (info.model, info.serial, info.firmware) == ("ViALUX ALP-4.3", "4711", "0x43")
    assert (info.height, info.width, info.capacity) == (48, 64, {1: 38})
    assert info.min_exposure_s[1] == pytest.approx(44e-6)
    assert info.min_dark_s == pytest.approx(44e-6)
    assert info.max_exposure_s == pytest.approx(10.0)


def test_a_temperature_below_zero_is_one(modulator):
    """A long of 64 bits, as alp4lib's own methods use, would make 16 million degrees of it."""
    modulator.connect()
    assert modulator.temperatures_c() == {"DDC FPGA": -1.5, "application FPGA": -1.5}


def test_masks_times_and_pulses_are_in_the_device_as_they_were_sent(modulator, device):
    modulator.connect()
    modulator.upload(PatternSequence(MASKS, 1, 4e-3, trigger=TriggerOut.PER_EXPOSURE))
    assert (modulator._dark, modulator._sequence) == (1, 2)
    stored = [
        [[device.StandinMirror(2, picture, row, column) for column in range(64)] for row in range(48)]
        for picture in range(4)
    ]
    np.testing.assert_array_equal(stored[:3], MASKS)
    assert not np.any(stored[3])  # uninterrupted pictures stay: the last one is dark
    assert [device.StandinTime(2, which) for which in range(6)] == [4000, 4000, 0, 100, 1, 1]
    modulator.arm()
    assert [device.StandinGate(byte) for byte in range(7)] == [4, 1, 1, 0, 0, 0, 0]


def test_a_run_lasts_as_long_as_its_pictures(modulator):
    modulator.connect()
    sequence = PatternSequence(MASKS, 1, 10e-3, dark_s=2e-3, repeats=2, pause_s=2e-3, trigger=TriggerOut.PER_MASK)
    modulator.upload(sequence)
    modulator.arm()
    begin_s = modulator.clock.now_s()
    modulator.start()
    modulator.wait_done(5.0)
    assert modulator.clock.now_s() - begin_s >= 6 * 12e-3 - 2e-3
    modulator.disarm()


def test_the_codes_of_the_library_are_kept(modulator, device):
    modulator.connect()
    device.StandinRefuse(1018)
    with pytest.raises(RefusedError, match=r"1018 \(the mirrors do not wake up\)"):
        modulator.status()
    device.StandinRefuse(1016)  # not in the header of alp4lib, whose own methods fail with a KeyError
    with pytest.raises(RefusedError, match=r"1016 \(a code that the maker's header does not have"):
        modulator.status()


def test_two_programs_cannot_have_one_device(modulator, folder):
    modulator.connect()
    other = AlpModulator("dmd1", AlpLibrary("dmd1", "4.3", folder), WallClock(), AlpOptions(kind="alp"))
    with pytest.raises(AccessError, match="another program has the device"):
        other.connect()
    other.close()


def test_unplugging_is_told(modulator, device):
    modulator.connect()
    device.StandinPlug(0)
    with pytest.raises(DisconnectedError, match="unplugged"):
        modulator.status()


def test_a_device_with_another_number_is_not_taken(folder, device):
    settings = AlpOptions(kind="alp", port="usb:12")
    other = AlpModulator("dmd0", AlpLibrary("dmd0", "4.3", folder), WallClock(), settings)
    with pytest.raises(DisconnectedError, match="no such device"):
        other.connect()
    other.close()
    with pytest.raises(OSError, match="closed"):
        other._port.call("AlpDevHalt", [1])


def test_a_library_that_is_not_there_is_named(tmp_path):
    pytest.importorskip("ALP4", reason="the extra `alp` is not installed")
    with pytest.raises(AccessError, match=r"ALP library 4\.4 cannot be loaded.*libalp44\.so.*`library`"):
        AlpLibrary("dmd0", "4.4", tmp_path)


def test_without_the_extra_it_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(alp_library.__builtins__, "__import__", _without_alp4(alp_library.__builtins__["__import__"]))
    with pytest.raises(UnsupportedError, match=r"pip install 'gs2ci\[alp\]'"):
        AlpLibrary("dmd0", "4.3", tmp_path)


def _without_alp4(original):
    def imports(name, *rest, **more):
        if name == "ALP4":
            raise ModuleNotFoundError("No module named 'ALP4'", name="ALP4")
        return original(name, *rest, **more)

    return imports
