"""A video output covered by one window of SDL 2 (zlib licence), by PySDL2: a `ScreenPort`.

Pictures are drawn by SDL's renderer with vertical synchronisation: its call returns when the previous picture has been
shown. SDL claims this of every renderer: if the video driver has no synchronisation, SDL waits by a timer and sets the
same flag (SDL_render.c, `simulate_vsync`), and Mesa's software renderers accept a swap interval that they do not keep.
So the claim is trusted only for OpenGL in hardware with a swap interval. In all other cases (virtual displays,
computers without a graphics driver) this module times the pictures itself, by the output's refresh rate, and draws by
SDL's software renderer, which on X waits until the server has drawn (SDL_x11framebuffer.c, XSync); `synchronised` says
which case it is. All calls of SDL must come from one thread: the one that opened the output.

Here: the calls. Not here: masks (`gs2ci_drivers.video_out`). Needs the extra `video`, which is imported only when an
output is opened.
"""

import ctypes
import errno
import os
import time
import warnings
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import U8
from gs2ci_drivers.failures import UnsupportedError
from gs2ci_drivers.links import xrandr
from gs2ci_drivers.ports import ScreenOutput

USUAL_HZ: Final = 60.0
"""Assumed if the video driver does not report the refresh rate."""
SESSIONS: Final = ("DISPLAY", "WAYLAND_DISPLAY")
GREY: Final = np.uint32(0x01010101)
"""A level times this is a grey pixel of four bytes."""
GL_RENDERER: Final = 0x1F01
SOFTWARE_GL: Final = (b"llvmpipe", b"softpipe", b"swrast", b"software", b"swiftshader")
"""Names of OpenGL renderers without a graphics card: Mesa's three, and those of others."""
SPIN_S: Final = 2e-3
"""The end of a wait is spent polling the clock, because the computer's scheduler is coarser."""


class SdlScreen:
    """One video output.

    Args:
        device: Name of the modulator, for messages.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._sdl: Any = None
        self._window: Any = None
        self._renderer: Any = None
        self._texture: Any = None
        self._pixels: NDArray[np.uint32] | None = None
        self._output: ScreenOutput | None = None
        self._due_ns = 0
        self._place = ""
        self.synchronised = False
        """Whether the video driver waits for the refresh; otherwise this object does, by the clock."""

    def list_outputs(self) -> list[ScreenOutput]:
        """List the video outputs; see `ScreenPort`."""
        sdl = self._load()
        found = []
        for index in range(sdl.SDL_GetNumVideoDisplays()):
            mode = sdl.SDL_DisplayMode()
            sdl.SDL_GetDesktopDisplayMode(index, ctypes.byref(mode))
            name = (sdl.SDL_GetDisplayName(index) or b"").decode() or f"display {index}"
            found.append(ScreenOutput(name, int(mode.h), int(mode.w), float(mode.refresh_rate or USUAL_HZ)))
        return found

    def open(self, name: str) -> ScreenOutput:
        """Cover an output; see `ScreenPort`.

        Raises:
            OSError: ENODEV: there is none of that name, or it cannot be drawn on.
            UnsupportedError: The session does not let a window be placed.
        """
        outputs = self.list_outputs()
        matching = [index for index, one in enumerate(outputs) if one.name == name] if name else [len(outputs) - 1]
        if not outputs or not matching:
            self.close()
            named = ", ".join(repr(one.name) for one in outputs) or "none"
            raise OSError(errno.ENODEV, f"no video output {name!r}; there are: {named}")
        sdl, index, output = self._sdl, matching[0], outputs[matching[0]]
        if sdl.SDL_GetCurrentVideoDriver() == b"wayland":
            self.close()
            raise UnsupportedError(
                self._device,
                "under Wayland no program can say on which output its window goes (libsdl-org/SDL issue 7197)",
                asked=f"cover {output.name!r}",
                remedy="log into a session of X, or set SDL_VIDEODRIVER=x11",
            )
        bounds = sdl.SDL_Rect()
        sdl.SDL_GetDisplayBounds(index, ctypes.byref(bounds))
        flags = sdl.SDL_WINDOW_BORDERLESS | sdl.SDL_WINDOW_ALWAYS_ON_TOP | sdl.SDL_WINDOW_SHOWN
        self._window = sdl.SDL_CreateWindow(b"gs2ci", bounds.x, bounds.y, output.width, output.height, flags)
        if not self._window:
            raise self._broken("no window")
        sdl.SDL_ShowCursor(sdl.SDL_DISABLE)
        self._renderer = sdl.SDL_CreateRenderer(
            self._window, -1, sdl.SDL_RENDERER_ACCELERATED | sdl.SDL_RENDERER_PRESENTVSYNC
        )
        self.synchronised = bool(self._renderer) and self._waits_for_refresh()
        if not self.synchronised:
            if self._renderer:
                sdl.SDL_DestroyRenderer(self._renderer)
            self._renderer = sdl.SDL_CreateRenderer(self._window, -1, sdl.SDL_RENDERER_SOFTWARE)
        if not self._renderer:
            raise self._broken("no renderer")
        self._texture = sdl.SDL_CreateTexture(
            self._renderer, sdl.SDL_PIXELFORMAT_ARGB8888, sdl.SDL_TEXTUREACCESS_STREAMING, output.width, output.height
        )
        if not self._texture:
            raise self._broken("no texture")
        self._pixels = np.empty((output.height, output.width), np.uint32)
        self._output, self._due_ns = output, 0
        self._place = f"{bounds.w}x{bounds.h}+{bounds.x}+{bounds.y}"
        self.flip(np.zeros((output.height, output.width), np.uint8))
        return output

    def straighten(self) -> list[str]:
        """Make the gamma ramp straight; see `ScreenPort`."""
        if os.environ.get("WAYLAND_DISPLAY"):
            return [
                "a Wayland compositor draws the output and does not tell how: switch off its night light, colour "
                "profile, HDR and scaling for this output, or log into a session of X"
            ]
        return xrandr.straighten(self._place)

    def flip(self, levels: U8) -> int:
        """Draw a picture and wait for its refresh; see `ScreenPort`.

        Raises:
            OSError: ENODEV: the output is not open, or cannot be drawn on.
        """
        if self._output is None:
            raise OSError(errno.ENODEV, "the video output is not open")
        sdl = self._sdl
        sdl.SDL_PumpEvents()  # otherwise the window system considers the program hung
        assert self._pixels is not None  # allocated by `open`
        np.multiply(levels, GREY, out=self._pixels, casting="unsafe")
        if sdl.SDL_UpdateTexture(self._texture, None, self._pixels.ctypes.data, self._pixels.strides[0]):
            raise self._broken("the picture is not taken")
        if sdl.SDL_RenderCopy(self._renderer, self._texture, None, None):
            raise self._broken("the picture is not drawn")
        if not self.synchronised:
            self._wait_for_refresh()
        sdl.SDL_RenderPresent(self._renderer)
        return self.clock_ns()

    def clock_ns(self) -> int:
        """Get the computer's monotonic time."""
        return time.clock_gettime_ns(time.CLOCK_MONOTONIC)

    def close(self) -> None:
        """Uncover the output; a second call does nothing."""
        sdl, self._sdl, self._output = self._sdl, None, None
        if sdl is None:
            return
        for what, end in ((self._texture, sdl.SDL_DestroyTexture), (self._renderer, sdl.SDL_DestroyRenderer)):
            if what:
                end(what)
        if self._window:
            sdl.SDL_DestroyWindow(self._window)
        self._texture = self._renderer = self._window = None
        sdl.SDL_QuitSubSystem(sdl.SDL_INIT_VIDEO)

    def _waits_for_refresh(self) -> bool:
        """Return whether hardware draws the pictures and waits for the refresh."""
        sdl, info = self._sdl, self._sdl.SDL_RendererInfo()
        sdl.SDL_GetRendererInfo(self._renderer, ctypes.byref(info))
        if not info.flags & sdl.SDL_RENDERER_ACCELERATED or sdl.SDL_GL_GetSwapInterval() < 1:
            return False
        address = sdl.SDL_GL_GetProcAddress(b"glGetString")
        if not address:
            return False
        drawn_by = ctypes.CFUNCTYPE(ctypes.c_char_p, ctypes.c_uint)(address)(GL_RENDERER) or b""
        return bool(drawn_by) and not any(name in drawn_by.lower() for name in SOFTWARE_GL)

    def _wait_for_refresh(self) -> None:
        """Wait until the next refresh is due by the clock; one that was missed is skipped."""
        assert self._output is not None
        period_ns = round(1e9 / self._output.refresh_hz)
        now_ns = self.clock_ns()
        if now_ns > self._due_ns + period_ns:  # the first one, or too late: on the grid again
            self._due_ns = now_ns
        left_s = (self._due_ns - now_ns) * 1e-9
        if left_s > SPIN_S:
            time.sleep(left_s - SPIN_S)
        while self.clock_ns() < self._due_ns:
            pass
        self._due_ns += period_ns

    def _load(self) -> Any:
        if self._sdl is not None:
            return self._sdl
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the import warns which SDL it loaded
                import sdl2  # noqa: PLC0415
        except ImportError as error:
            raise UnsupportedError(
                self._device,
                "modulators on a video output need the extra `video`",
                asked="open",
                remedy="pip install 'gs2ci[video]'",
            ) from error
        # Without a graphical session SDL would try other video drivers and might take one without a visible screen.
        if not any(os.environ.get(name) for name in SESSIONS):
            raise OSError(errno.ENODEV, f"no display: neither {' nor '.join(SESSIONS)} is set")
        sdl2.SDL_SetHint(b"SDL_VIDEODRIVER", b"x11,wayland")  # sdl2-compat would begin with Wayland
        if sdl2.SDL_InitSubSystem(sdl2.SDL_INIT_VIDEO):
            raise OSError(errno.ENODEV, f"no display: {sdl2.SDL_GetError().decode()}; is DISPLAY set?")
        self._sdl = sdl2
        return sdl2

    def _broken(self, what: str) -> OSError:
        return OSError(errno.ENODEV, f"{what}: {self._sdl.SDL_GetError().decode()}")
