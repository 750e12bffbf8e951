"""A panel on a video output, as the twin below `ScreenPort`: refreshes by its own clock, a delay, a photodiode.

The output is refreshed at a fixed rate and takes a picture at the next refresh (double buffering, as specified for
eglSwapBuffers and glXSwapBuffers with a swap interval of 1). The display's electronics delay pictures by whole
refreshes. A photodiode with a comparator in front of a patch of the panel drives a trigger line and blocks the light of
that patch.

Here: `ScreenTwin`. Not here: a real X display (`tests/drivers/links/test_sdl_screen.py`).
"""

from errno import ENODEV
from math import floor
from typing import Any

import numpy as np

from gs2ci.core.arrays import F64, U8, U16
from gs2ci_drivers.ports import ScreenOutput
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.panel import transmissions
from gs2ci_sims.world import World

TOP = 255
FULL = 0xFFFF
"""The number that stands for a transmission of 1, so that a grey table is not rounded to 8 bits."""


class ScreenTwin:
    """A second display with its photodiode.

    Args:
        world: Clock, trigger line `<name>.out`, and where masks are shown.
        faults: The faults to inject.
        name: Prefix of its trigger line.
        height: Rows.
        width: Columns.
        refresh_hz: Pictures a second.
        frames_late: Refreshes by which its electronics delay a picture.
        patch: First row and column, rows and columns of the patch below the photodiode.
        greys: The panel's levels at transmissions 0 to 1 in equal steps, rising or falling.
    """

    def __init__(
        self,
        world: World,
        faults: FaultSet | None = None,
        *,
        name: str = "screen0",
        height: int = 1080,
        width: int = 1920,
        refresh_hz: float = 60.0,
        frames_late: int = 0,
        patch: tuple[int, int, int, int] | None = None,
        greys: tuple[int, ...] = (0, TOP),
    ) -> None:
        self.faults = faults or FaultSet()
        self.output = ScreenOutput("TWIN-1", height, width, refresh_hz)
        self.refreshes = 0
        """Number of pictures that were taken."""
        self._world, self._clock = world, world.clock
        self._line = f"{name}.out"
        self._late_s = frames_late / refresh_hz
        self._patch = patch
        self._passes = transmissions(greys, TOP, FULL)
        self.ramp: F64 = np.arange(TOP + 1) / TOP
        """Gamma ramp of the output, as another program has left it: the share of the top for each level."""
        self._plugged = True
        self._opened = False
        self._shown: U16 | None = None
        self.fault = ""

    def unplug(self) -> None:
        """Unplug the display: it goes dark."""
        self._plugged = self._opened = False
        self._show(None)

    def plug_in(self) -> None:
        """Plug it in again."""
        self._plugged = True

    def list_outputs(self) -> list[ScreenOutput]:
        """List the output if it is plugged in."""
        return [self.output] if self._plugged else []

    def open(self, name: str = "") -> ScreenOutput:
        """Open a window that covers the output.

        Raises:
            OSError: ENODEV if it is not plugged in.
        """
        del name
        if self.faults.take("screen.unplugged", "open"):
            self.unplug()
        if not self._plugged:
            raise OSError(ENODEV, "no video output; there are: none")
        self._opened = True
        return self.output

    def straighten(self) -> list[str]:
        """Make the gamma ramp straight, as xrandr --gamma 1:1:1 does."""
        middle, self.ramp = self.ramp[128] * TOP, np.arange(TOP + 1) / TOP
        return [f"a gamma ramp showed level 128 as {middle:.0f}"] if abs(middle - 128) > 1 / 2 else []

    def flip(self, levels: U8) -> int:
        """Take a picture at the next refresh and return the time of that refresh."""
        if self.faults.take("screen.unplugged", "flip"):
            self.unplug()
        if not self._plugged or not self._opened:
            raise OSError(ENODEV, "the video output is gone")
        period_s = 1 / self.output.refresh_hz
        now_s = self._clock.now_s()
        following = floor(now_s / period_s + 1e-6) + 1
        if self.faults.take("screen.doubled"):
            following += 1
        if self.faults.take("screen.dropped"):
            following = floor(now_s / period_s + 1e-6)
        due_s = following * period_s
        picture = self._passes[np.rint(TOP * self.ramp[levels]).astype(np.uint8)]
        self._clock.at(due_s + self._late_s, lambda: self._show(picture) if self._opened else None)
        self._clock.sleep_s(due_s - now_s)
        self.refreshes += 1
        return self._clock.now_ns()

    def clock_ns(self) -> int:
        """Get the time of the simulated computer."""
        return self._clock.now_ns()

    def close(self) -> None:
        """Close the window; the output is dark then."""
        if self._opened:
            self._opened = False
            self._show(None)

    def _show(self, picture: U16 | None) -> None:
        dark = picture is None or not picture.any()
        lit = False
        if not dark and self._patch is not None:
            assert picture is not None
            top, left, height, width = self._patch
            lit = bool(picture[top : top + height, left : left + width].mean() > FULL / 2)
            picture[top : top + height, left : left + width] = 0
            dark = not picture.any()
        shown = None if dark else picture
        # A panel that is set to the shown levels does not change.
        both = shown is not None and self._shown is not None
        same = shown is self._shown or (both and bool(np.array_equal(np.asarray(shown), np.asarray(self._shown))))
        if not same:
            self._world.show_mask(shown, FULL)
        self._shown = shown
        self._world.bus.drive(self._line, lit)


def simulated(world: World, settings: Any) -> ScreenTwin:
    """Build the twin that a rig file's [modulator] describes."""
    return ScreenTwin(
        world,
        world.stated.faults["modulator"],
        name="modulator",
        frames_late=settings.frames_late,
        patch=settings.trigger_patch,
        greys=settings.greys,
    )
