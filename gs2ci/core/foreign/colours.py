"""Three channels that are one: grey or a mosaic saved as colours.

Programs save a raw mosaic as a colour picture in two ways: the same number three times, or each number in its own
channel and zeros in the others. Both hold one reading for each pixel.
"""

from typing import Any, Final

from numpy.typing import NDArray

from gs2ci.core.records import CfaPattern

_NAMES: Final = "RGB"
COLOURS: Final = len(_NAMES)


def one_reading(measurements: NDArray[Any]) -> tuple[NDArray[Any], CfaPattern | None, str]:
    """Reduce colour measurements, [K, H, W, 3], that hold one reading for each pixel to [K, H, W, 1].

    Returns:
        The measurements; the mosaic, where zeros show it; and what was done, empty if nothing was.
    """
    if measurements.shape[3] != COLOURS or not measurements.any():
        return measurements, None, ""
    if (measurements == measurements[..., :1]).all():
        return measurements[..., :1], None, "three equal channels were taken as one"
    colours = ""
    for row in (0, 1):
        for column in (0, 1):
            lit = measurements[:, row::2, column::2].any(axis=(0, 1, 2))
            if lit.sum() != 1:
                return measurements, None, ""
            colours += _NAMES[int(lit.argmax())]
    found: dict[str, CfaPattern] = {"RGGB": "RGGB", "BGGR": "BGGR", "GRBG": "GRBG", "GBRG": "GBRG"}
    cfa = found.get(colours)
    if cfa is None:
        return measurements, None, ""
    return measurements.max(axis=3, keepdims=True), cfa, f"each pixel has one colour only: taken as a mosaic {cfa}"
