"""What an X server does to grey levels between a picture and the panel, as `xrandr` tells it.

    gamma ramp       night lights (redshift, the desktops' own) and colour profiles bend or dim it, per output, while
                     they run: it is made straight
    Broadcast RGB    Intel's graphics send a television's modes (1920 x 1080 among them) as 16 to 235 unless it is Full
                     (i915, intel_hdmi.c: intel_hdmi_limited_color_range): told
    scaling          pixels of a mask are no pixels of the panel: told

Here: `straighten`. Not here: windows and pictures (`sdl_screen`). A computer without xrandr tells nothing.
"""

import re
import subprocess
from typing import Final

PATIENCE_S: Final = 5.0
STRAIGHT: Final = ("1.0:1.0:1.0", "1.0")
NEVER_SET: Final = "0.0"
"""Brightness of a ramp that nobody has set (Xvfb): no server would show by it."""
UPRIGHT: Final = re.compile(r"\) normal \(.*Transform: +1\.0+ 0\.0+ 0\.0+\s+0\.0+ 1\.0+ 0\.0+\s", re.DOTALL)


def straighten(place: str) -> list[str]:
    """Make the gamma ramp of an output straight; return what changed levels or pixels, and what still does.

    Args:
        place: Columns, rows, first column and row of the output on the desktop, "1920x1080+1920+0".
    """
    told = _told(place)
    if not told:
        return []
    notes = []
    if bent := _bent(told):
        _xrandr("--output", told.split(" ")[0], "--gamma", "1:1:1", "--brightness", "1")
        end = "does not take another: switch it off there" if _bent(_told(place)) else "has been made straight"
        notes.append(f"a gamma ramp (night light, colour profile) with {bent} changed levels, and {end}")
    sent = re.search(r"Broadcast RGB: (.+?)\s*\n", told)
    if sent and sent[1] != "Full":
        notes.append(
            f"Broadcast RGB is {sent[1]}: levels may be sent as 16 to 235, a dark level too bright and a bright one "
            "too dark; xrandr --output NAME --set 'Broadcast RGB' Full"
        )
    if not UPRIGHT.search(told):
        notes.append(
            "pictures are scaled or turned on their way to the output; set the panel's own mode (xrandr --scale 1x1 "
            "--rotate normal)"
        )
    return notes


def _told(place: str) -> str:
    """Return what is told of the output at a place. Without --current outputs would be probed, which disturbs them."""
    outputs = re.split(r"\n(?=\S)", _xrandr("--current", "--verbose"))
    return next((one for one in outputs if f" {place} " in one), "")


def _bent(told: str) -> str:
    ramp = re.search(r"Gamma: +(\S+)\s+Brightness: +(\S+)", told)
    if not ramp or ramp[2] == NEVER_SET or ramp.groups() == STRAIGHT:
        return ""
    return f"gamma {ramp[1]} and brightness {ramp[2]}"


def _xrandr(*words: str) -> str:
    try:
        return subprocess.check_output(  # noqa: S603  (no word of a user's)
            ["xrandr", *words],  # noqa: S607  (wherever the system has it)
            text=True,
            stderr=subprocess.DEVNULL,
            timeout=PATIENCE_S,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
