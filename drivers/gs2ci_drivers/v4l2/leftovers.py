"""What other programs have left set on a V4L2 camera: reset, recorded, or refused by name.

The kernel keeps controls until the camera loses power, whoever set them. So before each capture every control that may
change readings is brought to a known value, unless the rig file requests another. The rule is by what may be unknown:

    requested by [sensor], or set by the driver itself        kept
    in `RECORDED`, or of a class in `ELSEWHERE`               kept, and stored with the others in the shot file
    standard (linux/v4l2-controls.h)                          reset to `NEUTRAL`, else to the driver's default
    private to a driver and off its default                   refused by name: nobody here knows what it does

Here: the rule. Not here: reading and writing controls (`controls`), gain and exposure of a capture (`setup`).
"""

from collections.abc import Collection, Iterable
from typing import Final

from gs2ci_drivers.failures import DeviceFaultError, UnsupportedError
from gs2ci_drivers.v4l2 import abi
from gs2ci_drivers.v4l2.controls import Control, ControlTable

CLASS_MASK: Final = 0x0FFF0000
PRIVATE_BITS: Final = 0xF000
"""Controls that a driver defines itself lie 0x1000 or more above their class (linux/v4l2-controls.h)."""
ELSEWHERE: Final = {
    0x00990000: "codec",
    0x009B0000: "FM transmitter",
    0x009D0000: "JPEG",
    0x00A00000: "digital video",
    0x00A10000: "FM receiver",
    0x00A20000: "radio tuner",
    0x00A30000: "motion detection",
    0x00A40000: "stateless codec",
}
"""Classes of controls that do not change raw pixels."""
RECORDED: Final = {
    0x00980905: "audio volume",
    0x00980906: "audio balance",
    0x00980907: "audio bass",
    0x00980908: "audio treble",
    0x00980909: "audio mute",
    0x0098090A: "audio loudness",
    0x009A090A: "focus: set for the scene, by hand",
    0x009A090B: "focus, relative",
    0x009A0911: "iris: set for the lamp, by hand",
    0x009A0912: "iris, relative",
    0x009E0906: "gains that are told to the sensor for its own focus pixels",
    0x009F0901: "link frequency",
}
"""Standard controls that may differ between sessions; their values are in the shot file."""
AUTOMATIC: Final = {
    abi.Cid.EXPOSURE_AUTO: abi.EXPOSURE_MANUAL,
    abi.Cid.AUTOGAIN: 0,
    0x0098090C: 0,  # white balance
    0x00980919: 0,  # hue
    0x0098091D: 0,  # chroma gain
    0x00980920: 0,  # brightness
    0x009A0903: 0,  # frame rate lowered for longer exposures
    0x009A090C: 0,  # focus
    0x009A0914: 0,  # white balance with presets: 0 is manual
    0x009A0918: 0,  # ISO sensitivity: 0 is manual
}
"""Settings by which the camera changes others; switched off before them."""
NEUTRAL: Final = {
    **AUTOMATIC,
    abi.Cid.HFLIP: 0,
    abi.Cid.VFLIP: 0,
    0x0098091E: 0,  # colour killer
    0x0098091F: 0,  # colour effects
    0x00980922: 0,  # rotation
    0x00980925: 0,  # illuminators
    0x00980926: 0,
    0x009A0910: 0,  # privacy: a black picture
    0x009A0915: 0,  # wide dynamic range
    0x009A0916: 0,  # image stabilisation
    0x009A091A: 0,  # scene mode
    0x009F0903: 0,  # test pattern
}
"""Standard controls whose neutral value is known, whatever the driver's default."""


OF_DRIVERS: Final[dict[str, dict[int, int]]] = {"uvcvideo": {0x00980910: 100}}
"""Neutral values by the standard of a kernel driver's devices: USB cameras count gamma in hundredths, and begin with
"100 (gamma = 1) or 220 (gamma = 2.2)" (Microsoft, KSPROPERTY_VIDEOPROCAMP_GAMMA; UVC 1.5, Gamma Control)."""


def is_automatic(control: Control) -> bool:
    """Return whether a control lets the camera change others."""
    return control.cid in AUTOMATIC


def changes_layout(control: Control) -> bool:
    """Return whether setting a control may change the pixel format: flips exchange the colours of a mosaic."""
    return bool(control.flags & abi.ControlFlag.MODIFY_LAYOUT) or control.cid in (abi.Cid.HFLIP, abi.Cid.VFLIP)


def neutral_of(control: Control, driver: str = "") -> int | None:
    """Return the value that a control is to have if nobody requests another; None if any may stay."""
    if control.cid & CLASS_MASK in ELSEWHERE or control.cid in RECORDED:
        return None
    wanted = (NEUTRAL | OF_DRIVERS.get(driver, {})).get(control.cid, control.default)
    there = wanted in control.menu if control.menu else control.minimum <= wanted <= control.maximum
    return wanted if there else control.default


def reset(
    table: ControlTable, device: str, kept: Collection[int], only: Iterable[Control], driver: str = ""
) -> list[str]:
    """Reset controls that are off their neutral value; return a note for each that was.

    Args:
        table: The controls of one node.
        device: Name of the sensor, for messages.
        kept: Numbers of the controls that the capture sets itself.
        only: Which controls are looked at.
        driver: Name of the kernel driver.

    Raises:
        UnsupportedError: Private controls are off their default; all of them are named.
        DeviceFaultError: A control does not take its neutral value.
        DriverError: The node does not answer.
    """
    notes, unknown = [], []
    for listed in only:
        # What an automatic setting made inactive is active again without it.
        control = table.renewed(listed) if listed.flags & abi.ControlFlag.INACTIVE else listed
        passive = not control.settable or not control.has_value or control.flags & abi.ControlFlag.INACTIVE
        wanted = None if passive or control.cid in kept else neutral_of(control, driver)
        if wanted is None:
            continue
        found = table.get(control.cid)
        if found == wanted:
            continue
        if control.cid & PRIVATE_BITS:
            unknown.append(f"{control.name} = {found} (default {wanted})")
            continue
        in_force = table.set(control.cid, wanted).applied
        if in_force != wanted:
            raise DeviceFaultError(
                device,
                f"reset {control.name}",
                [f"it stays at {in_force} instead of {wanted}"],
                remedy=f"set `{control.name}` in [sensor.controls] to what is wanted, or power the camera off",
            )
        if found != control.default:  # what a camera switches on by itself is nobody's leftover
            notes.append(
                f"{device}: {control.name} was {found} and has been reset to {wanted}; [sensor.controls] can set it"
            )
    if unknown:
        raise UnsupportedError(
            device,
            f"another program has set what is not known here: {', '.join(unknown)}",
            asked="configure",
            allowed="their defaults, or what [sensor.controls] states",
            remedy="write the values that are wanted into [sensor.controls], by these names",
        )
    return notes


def name_tables(table: ControlTable, device: str) -> list[str]:
    """Return a note for each array or structure that may change readings, of which the values are not known here."""
    return [
        f"{device}: {name} is an array, which stays as another program has left it and is not recorded"
        for cid, name in table.tables.items()
        if cid & CLASS_MASK not in ELSEWHERE and cid not in RECORDED
    ]
