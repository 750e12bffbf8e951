"""A video output covered by one window of SDL 2 (zlib licence), by PySDL2: a `ScreenPort`.

Pictures are handed over by SDL's renderer with vertical synchronisation, which returns when the picture before has been
shown; a video driver without it (a software renderer, a virtual display) is timed here instead, to the output's own
refresh rate, and says so in `synchronised`. SDL keeps to one thread: the one that opened the output.

Here: the calls. Not here: masks (`gs2ci_drivers.video_out`). Needs the extra `video`; it is loaded when an output is
opened and not before.
"""

import ctypes
import errno
import os
import time
import warnings
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import U8
from gs2ci_drivers.failures import UnsupportedError
from gs2ci_drivers.ports import ScreenOutput

USUAL_HZ: Final = 60.0
"""Where the video driver does not tell."""
SESSIONS: Final = ("DISPLAY", "WAYLAND_DISPLAY")
SPIN_S: Final = 2e-3
"""The last bit of a wait is not slept: the computer's scheduler is coarser."""


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
        self._output: ScreenOutput | None = None
        self._due_ns = 0
        self.synchronised = False
        """Whether the video driver waits for the refresh; otherwise we do, by the clock."""

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
        """
        outputs = self.list_outputs()
        matching = [index for index, one in enumerate(outputs) if one.name == name] if name else [len(outputs) - 1]
        if not outputs or not matching:
            self.close()
            named = ", ".join(repr(one.name) for one in outputs) or "none"
            raise OSError(errno.ENODEV, f"no video output {name!r}; there are: {named}")
        sdl, index, output = self._sdl, matching[0], outputs[matching[0]]
        bounds = sdl.SDL_Rect()
        sdl.SDL_GetDisplayBounds(index, ctypes.byref(bounds))
        flags = sdl.SDL_WINDOW_BORDERLESS | sdl.SDL_WINDOW_ALWAYS_ON_TOP | sdl.SDL_WINDOW_SHOWN
        self._window = sdl.SDL_CreateWindow(b"gs2ci", bounds.x, bounds.y, output.width, output.height, flags)
        if not self._window:
            raise self._broken("no window")
        sdl.SDL_ShowCursor(sdl.SDL_DISABLE)
        self._renderer = sdl.SDL_CreateRenderer(
            self._window, -1, sdl.SDL_RENDERER_ACCELERATED | sdl.SDL_RENDERER_PRESENTVSYNC
        ) or sdl.SDL_CreateRenderer(self._window, -1, sdl.SDL_RENDERER_SOFTWARE)
        if not self._renderer:
            raise self._broken("no renderer")
        info = sdl.SDL_RendererInfo()
        sdl.SDL_GetRendererInfo(self._renderer, ctypes.byref(info))
        accelerated = bool(info.flags & sdl.SDL_RENDERER_ACCELERATED)
        self.synchronised = accelerated and bool(info.flags & sdl.SDL_RENDERER_PRESENTVSYNC)
        self._texture = sdl.SDL_CreateTexture(
            self._renderer, sdl.SDL_PIXELFORMAT_ARGB8888, sdl.SDL_TEXTUREACCESS_STREAMING, output.width, output.height
        )
        if not self._texture:
            raise self._broken("no texture")
        self._output, self._due_ns = output, 0
        self.flip(np.zeros((output.height, output.width), np.uint8))
        return output

    def flip(self, levels: U8) -> int:
        """Hand a picture over and wait for its refresh; see `ScreenPort`.

        Raises:
            OSError: ENODEV: the output is not open, or cannot be drawn on.
        """
        if self._output is None:
            raise OSError(errno.ENODEV, "the video output is not open")
        sdl = self._sdl
        sdl.SDL_PumpEvents()  # or the window system takes us for dead
        pixels = np.ascontiguousarray(levels[:, :, None].repeat(4, axis=2))
        row_bytes = 4 * self._output.width
        if sdl.SDL_UpdateTexture(self._texture, None, pixels.ctypes.data, row_bytes):
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

    def _wait_for_refresh(self) -> None:
        """Wait until the next refresh is due by the clock; one that was missed is not made up for."""
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
                warnings.simplefilter("ignore")  # it tells which SDL it took
                import sdl2  # noqa: PLC0415
        except ImportError as error:
            raise UnsupportedError(
                self._device,
                "modulators on a video output need the extra `video`",
                asked="open",
                remedy="pip install 'gs2ci[video]'",
            ) from error
        # Without a session SDL would look for others, and take a screen that nobody sees.
        if not any(os.environ.get(name) for name in SESSIONS):
            raise OSError(errno.ENODEV, f"no display: neither {' nor '.join(SESSIONS)} is set")
        if sdl2.SDL_InitSubSystem(sdl2.SDL_INIT_VIDEO):
            raise OSError(errno.ENODEV, f"no display: {sdl2.SDL_GetError().decode()}; is DISPLAY set?")
        self._sdl = sdl2
        return sdl2

    def _broken(self, what: str) -> OSError:
        return OSError(errno.ENODEV, f"{what}: {self._sdl.SDL_GetError().decode()}")
