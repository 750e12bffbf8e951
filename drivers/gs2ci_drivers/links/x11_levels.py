"""What an X server does to grey levels between a picture and the panel: read by RandR, and undone where it can be.

    gamma ramp       night lights (redshift, the desktops' own) and colour profiles bend or dim it, per output, while
                     they run; it is made straight, and put back on closing
    Broadcast RGB    Intel's graphics send a television's modes (1920 x 1080 among them) as 16 to 235 unless it is Full
                     (i915, intel_hdmi.c: intel_hdmi_limited_color_range): told
    scaling          a mode of another size than the desktop's: pixels of a mask are no pixels of the panel: told

Here: `X11Levels`. Not here: windows and pictures (`sdl_screen`). A computer without libXrandr tells nothing.
"""

import contextlib
import ctypes
from collections.abc import Iterator
from ctypes import POINTER, byref, c_char_p, c_int, c_long, c_uint, c_ulong, c_ushort, c_void_p
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

TOP: Final = 65535
SLACK: Final = TOP / 255 / 2
"""By how much a ramp may be off a straight one: half a level."""
RANGE: Final = b"Broadcast RGB"
FULL: Final = "Full"
ANY_TYPE, ATOMS = 0, 32


class _Resources(ctypes.Structure):
    _fields_ = (
        ("timestamp", c_ulong), ("configured", c_ulong), ("crtc_count", c_int), ("crtcs", POINTER(c_ulong)),
        ("output_count", c_int), ("outputs", POINTER(c_ulong)), ("mode_count", c_int), ("modes", c_void_p),
    )  # fmt: skip


class _Mode(ctypes.Structure):
    _fields_ = (
        ("id", c_ulong), ("width", c_uint), ("height", c_uint), ("clock", c_ulong), ("times", c_uint * 7),
        ("name", c_char_p), ("name_length", c_uint), ("flags", c_ulong),
    )  # fmt: skip


class _Crtc(ctypes.Structure):
    _fields_ = (
        ("timestamp", c_ulong), ("x", c_int), ("y", c_int), ("width", c_uint), ("height", c_uint), ("mode", c_ulong),
        ("rotation", c_ushort), ("output_count", c_int), ("outputs", POINTER(c_ulong)),
    )  # fmt: skip


class _Ramp(ctypes.Structure):
    _fields_ = (("size", c_int), *((name, POINTER(c_ushort)) for name in ("red", "green", "blue")))

    @property
    def levels(self) -> NDArray[np.uint16]:
        """Get a copy of its three channels, [3, size]."""
        return np.stack([np.ctypeslib.as_array(one, (self.size,)) for one in (self.red, self.green, self.blue)])


def straight(size: int) -> NDArray[np.uint16]:
    """Return a ramp that changes nothing, [size]."""
    return np.rint(np.linspace(0, TOP, size)).astype(np.uint16)


def bent(levels: NDArray[np.uint16]) -> bool:
    """Return whether a ramp, [3, size], changes a level by more than half of one.

    One that falls somewhere, or does not rise at all, has never been set (Xvfb): no server would show by it.
    """
    rises = bool((np.diff(levels.astype(np.int64), axis=1) >= 0).all()) and bool((levels[:, -1] > levels[:, 0]).all())
    return rises and bool((np.abs(levels - straight(levels.shape[1]).astype(np.float64)) > SLACK).any())


class X11Levels:
    """One output of the X server that $DISPLAY names.

    Args:
        place: Its first column and row on the desktop, columns and rows.
    """

    def __init__(self, place: tuple[int, int, int, int]) -> None:
        self._place = place
        self._found: dict[int, NDArray[np.uint16]] = {}
        self._randr: Any = None
        self._x11: Any = None
        self._display: Any = None
        with contextlib.suppress(OSError):
            self._x11, self._randr = ctypes.CDLL("libX11.so.6"), ctypes.CDLL("libXrandr.so.2")
            self._declare()
            self._display = self._x11.XOpenDisplay(None)

    def straighten(self) -> list[str]:
        """Make the gamma ramp straight; return what changed levels or pixels, and what still does."""
        notes = []
        for number, crtc, resources in self._driven():
            notes += self._straighten(number)
            notes += self._scaled(crtc, resources)
            notes += [note for k in range(crtc.output_count) for note in self._ranged(crtc.outputs[k])]
        return notes

    def close(self) -> None:
        """Put the gamma ramps back that were found; a second call does nothing."""
        if self._display:
            for number, levels in self._found.items():
                self._set_ramp(number, levels)
            self._x11.XCloseDisplay(self._display)
        self._display = None

    def _declare(self) -> None:
        x11, randr = self._x11, self._randr
        x11.XOpenDisplay.restype = x11.XGetAtomName.restype = c_void_p
        x11.XDefaultRootWindow.restype = x11.XInternAtom.restype = c_ulong
        x11.XGetAtomName.argtypes = (c_void_p, c_ulong)
        x11.XInternAtom.argtypes = (c_void_p, c_char_p, c_int)
        for call in (x11.XDefaultRootWindow, x11.XCloseDisplay, x11.XFree, randr.XRRFreeScreenResources):
            call.argtypes = (c_void_p,)
        x11.XSync.argtypes = (c_void_p, c_int)
        randr.XRRFreeCrtcInfo.argtypes = randr.XRRFreeGamma.argtypes = (c_void_p,)
        randr.XRRGetScreenResourcesCurrent.argtypes = randr.XRRGetCrtcGamma.argtypes = (c_void_p, c_ulong)
        randr.XRRGetScreenResourcesCurrent.restype = POINTER(_Resources)
        randr.XRRGetCrtcInfo.argtypes = (c_void_p, c_void_p, c_ulong)
        randr.XRRGetCrtcInfo.restype = POINTER(_Crtc)
        randr.XRRGetCrtcGamma.restype = randr.XRRAllocGamma.restype = POINTER(_Ramp)
        randr.XRRAllocGamma.argtypes = (c_int,)
        randr.XRRSetCrtcGamma.argtypes = (c_void_p, c_ulong, POINTER(_Ramp))
        given = (c_ulong, c_ulong, c_long, c_long, c_int, c_int, c_ulong)
        taken = (POINTER(c_ulong), POINTER(c_int), POINTER(c_ulong), POINTER(c_ulong), POINTER(c_void_p))
        randr.XRRGetOutputProperty.argtypes = (c_void_p, *given, *taken)

    def _driven(self) -> Iterator[tuple[int, _Crtc, _Resources]]:
        """Yield number, description and server's lists of what drives the output."""
        if not self._display:
            return
        found = self._randr.XRRGetScreenResourcesCurrent(self._display, self._x11.XDefaultRootWindow(self._display))
        if not found:
            return
        resources = found.contents
        for k in range(resources.crtc_count):
            number = int(resources.crtcs[k])
            crtc = self._randr.XRRGetCrtcInfo(self._display, found, number)
            if crtc:
                one = crtc.contents
                if (one.x, one.y, one.width, one.height) == self._place:
                    yield number, one, resources
                self._randr.XRRFreeCrtcInfo(crtc)
        self._randr.XRRFreeScreenResources(found)

    def _ramp(self, number: int) -> NDArray[np.uint16] | None:
        found = self._randr.XRRGetCrtcGamma(self._display, number)
        if not found:
            return None
        levels = found.contents.levels if found.contents.size > 1 else None
        self._randr.XRRFreeGamma(found)
        return levels

    def _set_ramp(self, number: int, levels: NDArray[np.uint16]) -> None:
        ramp = self._randr.XRRAllocGamma(levels.shape[1])
        for channel, name in zip(levels, ("red", "green", "blue"), strict=True):
            np.ctypeslib.as_array(getattr(ramp.contents, name), (len(channel),))[:] = channel
        self._randr.XRRSetCrtcGamma(self._display, number, ramp)
        self._x11.XSync(self._display, 0)
        self._randr.XRRFreeGamma(ramp)

    def _straighten(self, number: int) -> list[str]:
        found = self._ramp(number)
        if found is None or not bent(found):
            return []
        self._found.setdefault(number, found)
        self._set_ramp(number, np.tile(straight(found.shape[1]), (3, 1)))
        now = self._ramp(number)
        stays = now is not None and bent(now)
        middle = found[:, round(128 / 255 * (found.shape[1] - 1))] / TOP * 255
        told = ", ".join(f"{level:.0f}" for level in middle)
        end = "does not take another: switch it off there" if stays else "has been made straight until this is closed"
        return [
            f"a gamma ramp (night light, colour profile) showed level 128 as {told} of red, green and blue, and {end}"
        ]

    def _scaled(self, crtc: _Crtc, resources: _Resources) -> list[str]:
        modes = ctypes.cast(resources.modes, POINTER(_Mode))
        size = next(
            ((int(one.width), int(one.height)) for one in modes[: resources.mode_count] if one.id == crtc.mode), None
        )
        if size is None or size == (crtc.width, crtc.height):
            return []
        return [
            f"the desktop is {crtc.width} x {crtc.height} and the output's mode {size[0]} x {size[1]}: pictures are "
            "scaled or turned on their way; set the panel's own mode (xrandr --scale 1x1 --rotate normal)"
        ]

    def _ranged(self, output: int) -> list[str]:
        atom = self._x11.XInternAtom(self._display, RANGE, 1)
        if not atom:
            return []
        kind, bits, count, rest, data = c_ulong(), c_int(), c_ulong(), c_ulong(), c_void_p()
        taken = (byref(kind), byref(bits), byref(count), byref(rest), byref(data))
        self._randr.XRRGetOutputProperty(self._display, output, atom, 0, 1, 0, 0, ANY_TYPE, *taken)
        if not data or not count.value or bits.value != ATOMS:
            return []
        name = self._x11.XGetAtomName(self._display, ctypes.cast(data, POINTER(c_ulong))[0])
        value = ctypes.string_at(name).decode("ascii", "replace")
        self._x11.XFree(name)
        self._x11.XFree(data)
        if value == FULL:
            return []
        return [
            f"Broadcast RGB is {value}: levels may be sent as 16 to 235, a dark level too bright and a bright one too "
            "dark; xrandr --output NAME --set 'Broadcast RGB' Full"
        ]
