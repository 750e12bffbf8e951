"""What a camera's processing does to readings, and the V4L2 controls that set it, as in the kernel's control framework.

Numbers and names are those of linux/v4l2-controls.h and v4l2_ctrl_get_name (v4l2-ctrls-defs.c); a private control lies
0x1000 and more above its class. Gains of sensors are in steps of 0.1 dB, as imx296's. Whatever has no formula here
brightens by 3 %: enough to show that it was left on. Values stay until the camera loses power, whoever set them.

Here: `TwinControl` with arrays, the further controls of a camera with an image processor, `process`. Not here: reading
and writing them (`v4l2`).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import U16
from gs2ci_sims.wires import v4l2_controls
from gs2ci_sims.wires.v4l2_controls import BOOLEAN, BUTTON, CID_ANALOGUE_GAIN, CID_AUTOGAIN, INTEGER, MENU, READ_ONLY

ARRAY = 0x0101
INACTIVE, HAS_PAYLOAD, MODIFY_LAYOUT = 0x10, 0x100, 0x400

CID_DIGITAL_GAIN = 0x009F0905
CID_HFLIP, CID_VFLIP, CID_TEST_PATTERN = 0x00980914, 0x00980915, 0x009F0903
CID_AUTO_WHITE_BALANCE = 0x0098090C
CID_BRIGHTNESS, CID_BLACK_LEVEL, CID_GAMMA = 0x00980900, 0x0098090B, 0x00980910
CID_ZOOM = 0x009A090D


@dataclass
class TwinControl(v4l2_controls.TwinControl):
    """One control.

    Args:
        inactive_while: A switch: while it is on, this control has no effect.
    """

    inactive_while: int | None = None


def processing_controls(gamma: int = 100) -> Iterable[TwinControl]:
    """List the controls that an image processor adds, with their values at power-up, that of gamma among them."""
    yield TwinControl(CID_BRIGHTNESS, "Brightness", INTEGER, -64, 64, 1, 0)
    yield TwinControl(0x00980901, "Contrast", INTEGER, 0, 95, 1, 32)
    yield TwinControl(0x00980902, "Saturation", INTEGER, 0, 100, 1, 55)
    yield TwinControl(0x00980903, "Hue", INTEGER, -2000, 2000, 1, 0)
    yield TwinControl(CID_BLACK_LEVEL, "Black Level", INTEGER, 0, 4095, 1, 60)
    yield TwinControl(CID_AUTO_WHITE_BALANCE, "White Balance, Automatic", BOOLEAN, 0, 1, 1, 1)
    yield TwinControl(0x0098090E, "Red Balance", INTEGER, 0, 1023, 1, 256, inactive_while=CID_AUTO_WHITE_BALANCE)
    yield TwinControl(0x0098090F, "Blue Balance", INTEGER, 0, 1023, 1, 256, inactive_while=CID_AUTO_WHITE_BALANCE)
    yield TwinControl(CID_GAMMA, "Gamma", INTEGER, 64, 300, 1, gamma)
    yield TwinControl(CID_HFLIP, "Horizontal Flip", BOOLEAN, 0, 1, 1, 0, MODIFY_LAYOUT)
    yield TwinControl(CID_VFLIP, "Vertical Flip", BOOLEAN, 0, 1, 1, 0, MODIFY_LAYOUT)
    lines = {0: "Disabled", 1: "50 Hz", 2: "60 Hz"}
    yield TwinControl(0x00980918, "Power Line Frequency", MENU, 0, 2, 1, 1, 0, lines)
    yield TwinControl(0x00980919, "Hue, Automatic", BOOLEAN, 0, 1, 1, 0)
    kelvin, auto = (2800, 6500, 10, 4600), CID_AUTO_WHITE_BALANCE
    yield TwinControl(0x0098091A, "White Balance Temperature", INTEGER, *kelvin, inactive_while=auto)
    yield TwinControl(0x0098091B, "Sharpness", INTEGER, 1, 7, 1, 2)
    yield TwinControl(0x0098091C, "Backlight Compensation", INTEGER, 0, 2, 1, 1)
    yield TwinControl(0x0098091F, "Color Effects", MENU, 0, 2, 1, 0, 0, {0: "None", 1: "Black & White", 2: "Sepia"})
    yield TwinControl(0x00980920, "Brightness, Automatic", BOOLEAN, 0, 1, 1, 0)
    yield TwinControl(0x00980922, "Rotate", INTEGER, 0, 270, 90, 0)
    yield TwinControl(0x00980925, "Illuminator 1", BOOLEAN, 0, 1, 1, 0)
    yield TwinControl(0x009A0903, "Exposure, Dynamic Framerate", BOOLEAN, 0, 1, 1, 1)
    yield TwinControl(0x009A0908, "Pan, Absolute", INTEGER, -36000, 36000, 3600, 0)
    yield TwinControl(CID_ZOOM, "Zoom, Absolute", INTEGER, 100, 500, 1, 100)
    yield TwinControl(0x009A0915, "Wide Dynamic Range", BOOLEAN, 0, 1, 1, 0)
    yield TwinControl(0x009A0916, "Image Stabilization", BOOLEAN, 0, 1, 1, 0)
    yield TwinControl(0x009A091A, "Scene Mode", MENU, 0, 2, 1, 0, 0, {0: "None", 1: "Backlight", 2: "Beach/Snow"})
    modes = {0: "Off", 1: "Flash", 2: "Torch"}
    yield TwinControl(0x009C0901, "LED Mode", MENU, 0, 2, 1, 0, 0, modes)
    patterns = {0: "Disabled", 1: "Color Bars", 2: "Walking 1"}
    yield TwinControl(CID_TEST_PATTERN, "Test Pattern", MENU, 0, 2, 1, 0, 0, patterns)
    yield TwinControl(CID_DIGITAL_GAIN, "Digital Gain", INTEGER, 256, 65535, 1, 256)
    yield TwinControl(0x0098FFF4, "Binning Mode", INTEGER, 0, 2, 1, 0)
    yield TwinControl(0x0098FFF7, "HDR Mode", BOOLEAN, 0, 1, 1, 0)
    yield TwinControl(0x00989010, "Noise Reduction", INTEGER, 0, 10, 1, 0)


UNSEEN: Final = (0x00980911, 0x009A0901, 0x009A0902, 0x009E0901, 0x009E0902, 0x009819F0, 0x009819F2)
"""Controls of times and triggers, which the camera itself heeds."""
FURTHER_GAIN: Final = 1.03


def process(pixels: U16, top: int, controls: Mapping[int, v4l2_controls.TwinControl]) -> U16:
    """Return the readings with the controls' effects, [H, W]; the same array if all are at their neutral values.

    Args:
        pixels: The converter's readings.
        top: The largest reading.
        controls: The camera's controls by number.
    """
    off = {
        cid: one.value
        for cid, one in controls.items()
        if one.value != one.default and cid not in UNSEEN and one.kind != BUTTON and not one.flags & READ_ONLY
    }
    off.pop(CID_AUTOGAIN, None)  # it was on at power-up
    gamma = controls[CID_GAMMA].value if CID_GAMMA in controls else 100
    off.pop(CID_GAMMA, None)
    if not off and gamma == 100:
        return pixels
    if off.pop(CID_TEST_PATTERN, 0):
        bars = np.linspace(0, top, pixels.shape[1]).astype(np.uint16)
        return np.ascontiguousarray(np.broadcast_to(bars, pixels.shape))
    if off.pop(CID_HFLIP, 0):
        pixels = pixels[:, ::-1]
    if off.pop(CID_VFLIP, 0):
        pixels = pixels[::-1]
    values = pixels * 10 ** (off.pop(CID_ANALOGUE_GAIN, 0) * 0.1 / 20) * off.pop(CID_DIGITAL_GAIN, 256) / 256
    values = top * np.clip(values / top, 0, 1) ** (100 / gamma)
    black = controls[CID_BLACK_LEVEL].default if CID_BLACK_LEVEL in controls else 0
    values = values + off.pop(CID_BRIGHTNESS, 0) + off.pop(CID_BLACK_LEVEL, black) - black
    inert = [cid for cid in off if _inactive(controls, cid)]
    values = values * FURTHER_GAIN ** (len(off) - len(inert))
    return np.ascontiguousarray(np.clip(np.rint(values), 0, top).astype(np.uint16))


def _inactive(controls: Mapping[int, v4l2_controls.TwinControl], cid: int) -> bool:
    switch = getattr(controls[cid], "inactive_while", None)
    return switch is not None and bool(controls[switch].value)
