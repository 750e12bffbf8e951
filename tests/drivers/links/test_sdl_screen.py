"""A modulator on a real X display: Xvfb, whose pixels are read back from its frame buffer."""

import ctypes
import errno
import os
import shutil
import subprocess
import sys
import time

import numpy as np
import pytest

from gs2ci.core.clock import WallClock
from gs2ci_drivers.failures import DisconnectedError, UnsupportedError
from gs2ci_drivers.links import xrandr
from gs2ci_drivers.links.sdl_screen import SdlScreen
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_drivers.ports import ScreenPort
from gs2ci_drivers.video_out.driver import VideoOut
from gs2ci_drivers.video_out.options import VideoOutOptions
from tests.patience import HANG_S

HEIGHT, WIDTH = 120, 160


def read_back(path):
    """Read an X window dump (XWDFile.h of the X Window System, version 7) of 32-bit pixels, [H, W, 3] RGB."""
    raw = path.read_bytes()
    head = np.frombuffer(raw, ">u4", 25)
    size, width, height, line, colours = (int(head[i]) for i in (0, 4, 5, 12, 19))
    pixels = np.frombuffer(raw, np.uint8, line * height, size + 12 * colours).reshape(height, line)
    blue_green_red = pixels[:, : 4 * width].reshape(height, width, 4)[:, :, :3]
    return blue_green_red[:, :, ::-1]


@pytest.fixture
def display(tmp_path, monkeypatch):
    """Start an X server without a screen; return the file that its pixels are in."""
    binary = shutil.which("Xvfb")
    if binary is None:
        pytest.skip("no Xvfb on this machine")
    pytest.importorskip("sdl2", reason="the extra `video` is not installed")
    reading, writing = os.pipe()
    # A server that begins anew when its last client has gone refuses who comes meanwhile, which a busy machine shows.
    command = [binary, "-noreset", "-displayfd", str(writing), "-screen", "0", f"{WIDTH}x{HEIGHT}x24"]
    command += ["-fbdir", str(tmp_path)]
    with (tmp_path / "log").open("wb") as log:
        server = subprocess.Popen(command, pass_fds=(writing,), stdout=log, stderr=log)
    os.close(writing)
    try:
        with os.fdopen(reading) as told:
            number = told.readline().strip()
        if not number:
            pytest.skip(f"{binary} does not run here: {(tmp_path / 'log').read_text()[-200:]}")
        monkeypatch.setenv("DISPLAY", f":{number}")
        monkeypatch.setenv("SDL_VIDEODRIVER", "x11")
        yield tmp_path / "Xvfb_screen0"
    finally:
        server.terminate()
        server.wait(HANG_S)


@pytest.fixture
def screen(display):
    port = SdlScreen("slm")
    yield port
    port.close()


def seen(display, wanted):
    """Wait until the display shows this; X draws a moment after it was told."""
    until = time.monotonic() + HANG_S
    while not (same := np.array_equal(read_back(display), wanted)) and time.monotonic() < until:
        time.sleep(0.005)
    return same


def grey(levels):
    return levels[:, :, None].repeat(3, axis=2)


def test_the_output_is_listed_covered_and_given_back(display, screen):
    assert isinstance(screen, ScreenPort)
    (output,) = screen.list_outputs()
    assert (output.height, output.width, output.refresh_hz) == (HEIGHT, WIDTH, 60.0)
    assert screen.open(output.name) == output
    assert seen(display, np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    screen.close()
    screen.close()
    assert screen.open("") == output


def test_every_level_of_every_pixel_arrives(display, screen):
    screen.open("")
    rng = np.random.default_rng(0)
    for _ in range(3):
        levels = rng.integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
        screen.flip(levels)
        assert seen(display, grey(levels))


def test_pictures_follow_each_other_at_the_refresh_rate(screen):
    screen.open("")
    levels = np.zeros((HEIGHT, WIDTH), np.uint8)
    times_ns = [screen.flip(levels) for _ in range(31)]
    # No picture comes early, whatever else the machine does; how late is its business. SDL waits whole milliseconds,
    # 16 of the 16.7, where the display has no refresh to wait for.
    assert (times_ns[-1] - times_ns[0]) * 1e-9 >= 30 * 15e-3
    assert times_ns == sorted(times_ns)


def test_masks_are_seen_on_the_display_through_the_driver(display, screen):
    modulator = VideoOut("slm", screen, WallClock(), VideoOutOptions(kind="video", bright_level=200, port="last"))
    info = modulator.connect()
    masks = np.zeros((2, info.height, info.width), np.uint8)
    masks[0, :, :80], masks[1, 30:60] = 1, 1
    modulator.upload(PatternSequence(masks, 1, 0.5, repeats=0, trigger=TriggerOut.NONE))
    modulator._show_dark()
    for mask in masks:
        with_levels = modulator.levels(mask, 1)
        screen.flip(with_levels)
        assert seen(display, grey(200 * mask))
    modulator.disarm()
    assert seen(display, np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    modulator.close()


def test_an_output_of_another_name_is_refused_with_those_there_are(screen):
    modulator = VideoOut("slm", screen, WallClock(), VideoOutOptions(kind="video", port="HDMI-7"))
    with pytest.raises(DisconnectedError, match="no video output 'HDMI-7'; there are: "):
        modulator.connect()


def test_without_a_display_or_the_extra_it_says_so(monkeypatch):
    with pytest.raises(OSError, match="not open") as caught:
        SdlScreen("slm").flip(np.zeros((2, 2), np.uint8))
    assert caught.value.errno == errno.ENODEV
    monkeypatch.setitem(sys.modules, "sdl2", None)
    with pytest.raises(UnsupportedError, match=r"pip install 'gs2ci\[video\]'"):
        SdlScreen("slm").list_outputs()


def test_a_computer_without_any_display_has_no_output(monkeypatch):
    pytest.importorskip("sdl2", reason="the extra `video` is not installed")
    monkeypatch.setenv("SDL_VIDEODRIVER", "x11")
    monkeypatch.setenv("DISPLAY", ":4242")
    with pytest.raises(OSError, match="is DISPLAY set"):
        SdlScreen("slm").list_outputs()
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(OSError, match="neither DISPLAY nor WAYLAND_DISPLAY is set"):
        SdlScreen("slm").list_outputs()


def test_a_display_that_has_no_refresh_of_its_own_is_timed_by_us(display, screen):
    """SDL and Mesa both say of Xvfb that they wait for its refresh, which it does not have."""
    screen.open("")
    assert not screen.synchronised


@pytest.mark.parametrize(
    ("flags", "interval", "drawn_by", "waits"),
    [
        ("SDL_RENDERER_ACCELERATED", 1, b"Mesa Intel(R) UHD Graphics 620 (KBL GT2)", True),
        ("SDL_RENDERER_ACCELERATED", 1, b"llvmpipe (LLVM 15.0.6, 256 bits)", False),
        ("SDL_RENDERER_ACCELERATED", 1, b"softpipe", False),
        ("SDL_RENDERER_ACCELERATED", 1, None, False),
        ("SDL_RENDERER_ACCELERATED", 0, b"NVIDIA GeForce GTX 1650/PCIe/SSE2", False),
        ("SDL_RENDERER_SOFTWARE", 1, b"NVIDIA GeForce GTX 1650/PCIe/SSE2", False),
    ],
)
def test_a_renderer_is_believed_only_where_hardware_waits_for_the_refresh(flags, interval, drawn_by, waits):
    sdl2 = pytest.importorskip("sdl2", reason="the extra `video` is not installed")
    text = ctypes.create_string_buffer(drawn_by or b"")
    address = ctypes.addressof(text) if drawn_by is not None else None
    asked = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_uint)(lambda name: address)

    class Sdl:
        SDL_RendererInfo = sdl2.SDL_RendererInfo
        SDL_RENDERER_ACCELERATED = sdl2.SDL_RENDERER_ACCELERATED

        @staticmethod
        def SDL_GetRendererInfo(renderer, info):
            info._obj.flags = getattr(sdl2, flags) | sdl2.SDL_RENDERER_PRESENTVSYNC

        @staticmethod
        def SDL_GL_GetSwapInterval():
            return interval

        @staticmethod
        def SDL_GL_GetProcAddress(name):
            return ctypes.cast(asked, ctypes.c_void_p).value

    port = SdlScreen("slm")
    port._sdl = Sdl()
    assert port._waits_for_refresh() is waits


def test_a_renderer_without_opengl_is_not_believed():
    sdl2 = pytest.importorskip("sdl2", reason="the extra `video` is not installed")

    class Sdl:
        SDL_RendererInfo = sdl2.SDL_RendererInfo
        SDL_RENDERER_ACCELERATED = sdl2.SDL_RENDERER_ACCELERATED

        @staticmethod
        def SDL_GetRendererInfo(renderer, info):
            info._obj.flags = sdl2.SDL_RENDERER_ACCELERATED

        @staticmethod
        def SDL_GL_GetSwapInterval():
            return 1

        @staticmethod
        def SDL_GL_GetProcAddress(name):
            return None

    port = SdlScreen("slm")
    port._sdl = Sdl()
    assert port._waits_for_refresh() is False


def test_a_gamma_ramp_of_the_output_is_made_straight_and_told(screen, monkeypatch):
    if shutil.which("xrandr") is None:
        pytest.skip("no xrandr on this machine")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    screen.open("")
    assert screen.straighten() == []
    subprocess.run(["xrandr", "--output", "screen", "--gamma", "1:1.2:1.9", "--brightness", "0.7"], check=True)
    (note,) = screen.straighten()
    assert "with gamma 1.0:0.84:0.53 and brightness 0.70 changed levels, and has been made straight" in note
    assert screen.straighten() == []


def test_a_session_that_places_windows_itself_is_refused(screen, monkeypatch):
    sdl2 = pytest.importorskip("sdl2")
    monkeypatch.setattr(sdl2, "SDL_GetCurrentVideoDriver", lambda: b"wayland")
    with pytest.raises(UnsupportedError, match=r"on which output its window goes.*SDL_VIDEODRIVER=x11"):
        screen.open("")
    monkeypatch.undo()


def test_a_compositor_that_tells_nothing_is_named(screen, monkeypatch):
    screen.open("")
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    (note,) = screen.straighten()
    assert "night light" in note


TOLD = """Screen 0: minimum 8 x 8, current 4320 x 1080, maximum 32767 x 32767
eDP-1 connected primary 1920x1080+0+0 (0x46) normal (normal left inverted right x axis y axis) 344mm x 194mm
\tGamma:      1.0:0.8:0.6
\tBrightness: 1.0
HDMI-1 connected 2400x1080+1920+0 (0x47) normal (normal left inverted right x axis y axis) 527mm x 296mm
\tGamma:      1.0:1.0:1.0
\tBrightness: 1.0
\tTransform:  1.000000 0.000000 0.000000
\t            0.000000 1.000000 0.000000
\t            0.000000 0.000000 1.000000
\t           filter:
\tBroadcast RGB: Full
\t\tsupported: Automatic, Full, Limited 16:235
"""


@pytest.mark.parametrize(
    ("was", "now", "note"),
    [
        ("", "", None),
        ("RGB: Full", "RGB: Automatic ", "Broadcast RGB is Automatic: levels"),
        ("RGB: Full", "RGB: Limited 16:235", "Broadcast RGB is Limited 16:235: levels"),
        ("Transform:  1.0", "Transform:  1.25", "scaled or turned"),
        ("0.000000 1.000000 0.0", "0.000000 1.250000 0.0", "scaled or turned"),
        ("(0x47) normal", "(0x47) left", "scaled or turned"),
        ("1.0:1.0:1.0", "0.72:0.72:0.72", "does not take another: switch it off there"),
        ("1.0:1.0:1.0\n\tBrightness: 1.0", "1.0:1.0:1.0\n\tBrightness: 0.0", None),
        ("\tGamma:      1.0:1.0:1.0\n\tBrightness: 1.0\n", "", None),
    ],
)
def test_what_changes_levels_of_that_output_is_told(monkeypatch, was, now, note):
    monkeypatch.setattr(xrandr, "_xrandr", lambda *words: TOLD.replace(was, now) if was else TOLD)
    notes = xrandr.straighten("2400x1080+1920+0")
    assert len(notes) == (note is not None)
    assert all(note in one for one in notes)


def test_where_xrandr_is_missing_or_has_no_server_nothing_is_told(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":4242")
    assert xrandr.straighten("8x8+0+0") == []
    monkeypatch.setenv("PATH", "")
    assert xrandr.straighten("8x8+0+0") == []
