"""What a GenICam camera's processing does to readings, and the features that set it.

By SFNC 2.7: Analog Control (Gain, BlackLevel, BalanceRatio), Image Format Control (mirroring, decimation), LUT Control,
Color Transformation Control, Defect Correction; by makers: DigitalShift (docs.baslerweb.com/digital-shift: n multiplies
by 2^n), BslBrightness and BslContrast, sharpening, noise reduction, shading correction. A written value stays until the
camera loses power. Whatever has no formula here brightens by 3 %: enough to show that it was left on.

Here: those features, `process`. Not here: the camera (`genicam`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import U16
from gs2ci_sims.wires.genicam_nodes import Node

FURTHER_GAIN: Final = 1.03
BLACK_DN: Final = 1.0


def further_features() -> dict[str, Node]:
    """Return the features that a camera with much processing adds, with their values at power-up."""

    def number(value: float, low: float, high: float, unit: str = "", **more: str) -> Node:
        return Node("float", value, lambda: low, lambda: high, 0.01, unit=unit, **more)  # type: ignore[arg-type]

    def whole(value: int, low: int, high: int) -> Node:
        return Node("integer", value, lambda: float(low), lambda: float(high))

    def switch(name: str, *names: str) -> Node:
        return Node("enumeration", name, symbols=(name, *names))

    return {
        "ReverseY": Node("boolean", False, locked=True),
        "DigitalShift": whole(0, 0, 4),
        "BlackLevel": number(0.0, 0.0, 63.0),
        "AcquisitionFrameRateEnable": Node("boolean", False),
        "LUTEnable": Node("boolean", False),
        "GammaEnable": Node("boolean", False),
        "BalanceRatioSelector": switch("Red", "Green", "Blue"),
        "BalanceRatio": number(1.0, 0.1, 8.0, selector="BalanceRatioSelector"),
        "BalanceWhiteAuto": switch("Off", "Once", "Continuous"),
        "BlackLevelAuto": switch("Off", "Continuous"),
        "ColorTransformationEnable": Node("boolean", False),
        "BslBrightness": number(0.0, -1.0, 1.0),
        "BslContrast": number(0.0, -1.0, 1.0),
        "BslContrastMode": switch("Linear", "SCurve"),
        "BslHue": number(0.0, -180.0, 180.0),
        "BslSaturation": number(1.0, 0.0, 2.0),
        "BslNoiseReduction": number(0.0, 0.0, 2.0),
        "BslSharpnessEnhancement": number(1.0, 1.0, 3.98),
        "SharpeningEnable": Node("boolean", False),
        "SaturationEnable": Node("boolean", False),
        "NoiseReductionMode": switch("Off", "On"),
        "DefectCorrectStaticEnable": Node("boolean", False),
        "ShadingCorrectionMode": switch("Off", "Pixel"),
        "AutoTargetBrightness": number(0.3, 0.1, 0.9),
        "BslVignettingCorrectionMode": switch("Off", "On"),
        "MultiShotHdrMode": switch("Off", "On"),
        "SequencerMode": switch("Off", "On"),
        "TriggerDivider": whole(1, 1, 8),
        "RemoveLimits": Node("boolean", False),
    }


def process(pixels: U16, top: int, off: dict[str, Node], *, factor: bool) -> U16:
    """Return the readings with the features' effects, [H, W]; the same array if all are at their neutral values.

    Args:
        pixels: The converter's readings, binned and mirrored.
        top: The largest reading.
        off: The features that are off their values at power-up, by name.
        factor: Whether Gain is a factor, and not in decibels.
    """
    off = {name: node for name, node in off.items() if name in _PROCESSING or node.category in _UNKNOWN}
    if not off:
        return pixels
    if off.pop("ReverseY", None):
        pixels = pixels[::-1]
    told = {name: float(off.pop(name).value) for name in ("Gain", "DigitalShift", "BlackLevel") if name in off}
    gain = told.get("Gain", 1.0 if factor else 0.0)
    values = pixels * (gain if factor else 10 ** (gain / 20)) * 2.0 ** told.get("DigitalShift", 0.0)
    values = (values + told.get("BlackLevel", 0.0) * BLACK_DN) * FURTHER_GAIN ** len(off)
    return np.ascontiguousarray(np.clip(np.rint(values), 0, top).astype(np.uint16))


_PROCESSING: Final = frozenset(further_features()) - {
    "AcquisitionFrameRateEnable",
    "BalanceRatioSelector",
    "BalanceWhiteAuto",
    "BlackLevelAuto",
} | {"Gain"}
_UNKNOWN: Final = frozenset({"ImageProcessingControl"})
