"""Which axis is which: measurement, masks and true views brought into the order that gs2ci uses.

Every order of axes that is in use is a candidate; those in which heights and widths agree are possible; of these the
one with the most pixels wins (a mask stack has more pixels than masks), and what still differs is an error or, where a
default exists, a printed guess.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.colours import COLOURS
from gs2ci.core.foreign.container import Array
from gs2ci.core.foreign.options import ImportOptions, Layout, MaskAxis
from gs2ci.core.foreign.pattern import fine_of

# H, W: pixels; C: 1 or 3 colours; K: measurements; N: masks; T: true frames (K times N).
_MEASUREMENT_ORDERS: Final = ("HW", "HWC", "CHW", "HWK", "KHW", "KHWC", "HWCK", "HWKC", "KCHW")
_MASK_ORDERS: Final = ("HW", "NHW", "HWN")
_OWN_ORDERS: Final = ("KNHW", "HWNK", "NKHW", "HWKN")
_TRUTH_ORDERS: Final = ("THW", "HWT", "THWC", "HWCT", "TCHW", "CTHW", "HWC", "HW", "KNHW", "HWNK", "KNHWC")


@dataclass(frozen=True)
class Arranged:
    """Arrays in gs2ci's order of axes, still in the units of the file.

    Args:
        measurements: [K, H, W, C].
        masks: [N, H, W].
    """

    measurements: NDArray[Any]
    masks: NDArray[Any]


@dataclass(frozen=True)
class _Reading:
    order: str
    extents: dict[str, int]

    @property
    def size(self) -> tuple[int, int]:
        return self.extents["H"], self.extents["W"]

    def of(self, axis: str) -> int:
        return self.extents.get(axis, 1)


def arrange(
    measurement: Array, masks: Array, truth: Array | None, options: ImportOptions, guesses: list[str]
) -> Arranged:
    """Find heights, widths, measurements and masks among the axes.

    Args:
        measurement: As loaded.
        masks: As loaded.
        truth: As loaded; its shape tells RGB from a stack of three.
        options: What the user fixed.
        guesses: Sentences are added here.

    Raises:
        InputError: No order of axes fits, or several do.
    """
    measurement = _without_opacity(measurement, guesses)
    stack = _without_colour(masks)
    pairs = _fitting(measurement.values.shape, stack.shape, options)
    if not pairs and 1 in measurement.values.shape + masks.values.shape:
        short, shorter = _without_ones(measurement), _without_ones(masks)
        stack = _without_colour(shorter)
        pairs = _fitting(short.values.shape, stack.shape, options)
        if pairs:
            guesses.append(
                f"axes of length 1 were dropped: {list(measurement.values.shape)} and {list(masks.values.shape)} "
                f"became {list(short.values.shape)} and {list(stack.shape)}"
            )
            measurement, masks = short, shorter
    if not pairs:
        raise _no_fit(measurement, masks, options.mask_axis)
    most = max(m.size[0] * m.size[1] for m, _ in pairs)
    pairs = [(m, k) for m, k in pairs if m.size[0] * m.size[1] == most]
    if truth is not None:
        counted = [(m, k) for m, k in pairs if _truth_reading(truth.values.shape, m.size, m.of("K"), k.of("N"))]
        pairs = counted or pairs
    if len({k.order for _, k in pairs}) > 1:
        raise InputError(
            f"{masks.where}: shape {list(masks.values.shape)} can be read with the masks first or last",
            remedy="say --mask-axis first or --mask-axis last",
        )
    (m, k) = pairs[0]
    if any(other.order != m.order for other, _ in pairs):
        shape = list(measurement.values.shape)
        if m.of("K") == 1 and m.of("C") == 3:
            guesses.append(
                f"{measurement.where}: {shape} taken as one colour measurement; "
                "if the three are separate measurements, say --meas-layout stack"
            )
        elif m.of("K") > 1:
            guesses.append(
                f"{measurement.where}: {shape} taken as [{', '.join(m.order)}], K measurements of C colours; "
                "where that is wrong, save them as [K, H, W, C]"
            )
    guesses.append(_summary(m, k))
    return Arranged(_in_order(measurement.values, m, "KHWC"), _in_order(stack, k, "NHW"))


def _fitting(shape: tuple[int, ...], masks: tuple[int, ...], options: ImportOptions) -> list[tuple[_Reading, _Reading]]:
    return [
        (m, k)
        for m in _readings(shape, _MEASUREMENT_ORDERS)
        for k in _readings(masks, _MASK_ORDERS)
        if m.size == k.size and _allowed(m, k, options.mask_axis, options.meas_layout)
    ]


def _without_opacity(measurement: Array, guesses: list[str]) -> Array:
    """Drop the fourth plane of a colour picture that says everywhere that it is opaque."""
    values = measurement.values
    for axis in (2, 0) if values.ndim == 3 else ():
        if values.shape[axis] != COLOURS + 1:
            continue
        fourth = values.take(COLOURS, axis)
        opaque = float(np.iinfo(values.dtype).max) if values.dtype.kind in "ui" else 1.0
        if (fourth == opaque).all() and not (values.take(COLOURS - 1, axis) == opaque).all():
            guesses.append(
                f"{measurement.where}: the fourth plane of {list(values.shape)} is {opaque:g} everywhere, as the "
                "opacity of a colour picture is: left out"
            )
            return Array(measurement.where, values.take(range(COLOURS), axis))
    return measurement


def _without_ones(given: Array) -> Array:
    return Array(given.where, given.values.squeeze() if given.values.squeeze().ndim >= 2 else given.values)


def own_masks(measurement: Array, masks: Array) -> list[tuple[Array, Array]] | None:
    """Return each exposure with its masks, if a file holds masks of their own for several exposures.

    Exposures are counted first or last in both; where masks could be, too, the first exposure shows which are its own.
    """
    stored, stack = measurement.values, _without_ones(masks).values
    most = max((m.size[0] * m.size[1] for m in _readings(stored.shape, _MEASUREMENT_ORDERS)), default=0)
    pairs = [
        (_in_order(stored, m, "KHWC"), _in_order(stack, k, "KNHW"), k.order)
        for m in _readings(stored.shape, _MEASUREMENT_ORDERS)
        for k in _readings(stack.shape, _OWN_ORDERS)
        if m.size == k.size
        and m.size[0] * m.size[1] == most
        and m.of("K") == k.of("K") > 1
        and m.order.startswith("HW") == k.order.startswith("HW")
    ]
    if not pairs:
        return None
    meas, own, order = max(pairs, key=lambda pair: _likeness(*pair[:2])) if len(pairs) > 1 else pairs[0]
    # Masks that only repeat themselves are the same for all: exposures, or colours.
    if all(np.array_equal(own[0], other) for other in own[1:]):
        if len(own) == COLOURS and order not in _OWN_ORDERS[:2]:
            return None
        own = np.broadcast_to(own[0], own.shape)
    return [(Array(measurement.where, one), Array(masks.where, part)) for one, part in zip(meas, own, strict=True)]


def _likeness(measurements: NDArray[Any], masks: NDArray[Any]) -> float:
    """Correlate the fine pattern of the first measurement, [K, H, W, C], with that of its masks' sum, [K, N, H, W]."""
    seen, opened = measurements[0].mean(axis=2, dtype=np.float64), masks[0].sum(axis=0, dtype=np.float64)
    return float(np.corrcoef(fine_of(seen).ravel(), fine_of(opened).ravel())[0, 1])


def arrange_truth(truth: Array, measurements: int, views: int, size: tuple[int, int]) -> NDArray[Any]:
    """Bring true views into the order [K, N, H, W, C].

    Raises:
        InputError: Their number or size contradicts masks and measurements.
    """
    shape = truth.values.shape
    reading = _truth_reading(shape, size, measurements, views)
    if reading is None and 1 in shape:
        truth = _without_ones(truth)
        reading = _truth_reading(truth.values.shape, size, measurements, views)
    if reading is None:
        wanted = measurements * views
        raise InputError(
            f"{truth.where}: shape {list(shape)} does not hold the true views of {measurements} measurement(s) "
            f"under {views} masks of {size[0]} x {size[1]} pixels",
            allowed=f"{wanted} views: [{wanted}, {size[0]}, {size[1]}] or [{wanted}, {size[0]}, {size[1]}, 3]",
            remedy="check the number of masks, or leave the truth out with --truth-key none",
        )
    flat = _in_order(truth.values, reading, "KNHWC" if "K" in reading.order else "THWC")
    return flat.reshape(measurements, views, *size, reading.of("C"))


def _readings(shape: tuple[int, ...], orders: tuple[str, ...]) -> Iterator[_Reading]:
    for order in orders:
        if len(order) == len(shape):
            extents = dict(zip(order, shape, strict=True))
            if extents.get("C", 1) in (1, 3) and min(shape) > 0:
                yield _Reading(order, extents)


def _allowed(m: _Reading, k: _Reading, mask_axis: MaskAxis, layout: Layout) -> bool:
    if mask_axis != "auto" and "N" in k.order and k.order != ("NHW" if mask_axis == "first" else "HWN"):
        return False
    return layout == "auto" or ("C" in m.order if layout == "rgb" else "C" not in m.order or "K" in m.order)


def _truth_reading(shape: tuple[int, ...], size: tuple[int, int], k: int, n: int) -> _Reading | None:
    for reading in _readings(shape, _TRUTH_ORDERS):
        counts = (reading.of("K"), reading.of("N")) == (k, n) if "K" in reading.order else reading.of("T") == k * n
        if reading.size == size and counts:
            return reading
    return None


def _without_colour(masks: Array) -> NDArray[Any]:
    """Drop an axis along which masks only repeat themselves: one mask acts on all colours."""
    values = masks.values
    if values.ndim != 4:
        return values
    for axis in (3, 2, 1, 0):
        if values.shape[axis] == 1:
            return values.squeeze(axis)
    for axis in (3, 2, 1):
        if values.shape[axis] == 3:
            first = values.take([0], axis)
            if np.array_equal(np.broadcast_to(first, values.shape), values):
                return first.squeeze(axis)
            raise InputError(
                f"{masks.where}: masks that differ from colour to colour",
                allowed="one transmission per pixel: [N, H, W]",
                remedy="for a Bayer sensor give the mosaic of the masks, [N, H, W]",
            )
    return values


def _in_order(values: NDArray[Any], reading: _Reading, wanted: str) -> NDArray[Any]:
    present = [axis for axis in wanted if axis in reading.order]
    moved = values.transpose([reading.order.index(axis) for axis in present])
    for index, axis in enumerate(wanted):
        if axis not in reading.order:
            moved = np.expand_dims(moved, index)
    return moved


def _summary(m: _Reading, k: _Reading) -> str:
    height, width = m.size
    count = f"{m.of('K')} measurements" if m.of("K") > 1 else "one measurement"
    colour = "RGB" if m.of("C") == 3 else "single-channel"
    where = {"NHW": "counted along the first axis", "HWN": "counted along the last axis", "HW": "a single one"}
    return f"{count}, {colour}, {height} x {width} pixels; {k.of('N')} masks, {where[k.order]}"


def _no_fit(measurement: Array, masks: Array, mask_axis: MaskAxis) -> InputError:
    shape, mask_shape = measurement.values.shape, masks.values.shape
    swapped = any(
        m.size == k.size[::-1]
        for m in _readings(shape, _MEASUREMENT_ORDERS)
        for k in _readings(mask_shape, _MASK_ORDERS)
    )
    remedy = (
        "check that masks and measurement belong together; masks count in the sensor's pixels, as it sees them "
        "(`gs2ci calibrate masks` measures that), not in the modulator's"
    )
    if swapped:
        remedy = "height and width of the masks are exchanged: transpose the masks before saving"
    pixels = shape[0] * shape[1] if len(shape) == 2 else 0
    if pixels and pixels in mask_shape:
        first = mask_shape[0] != pixels
        wanted = f"[N, {shape[0]}, {shape[1]}]" if first else f"[{shape[0]}, {shape[1]}, N]"
        remedy = f"each mask is one row of {pixels} numbers: reshape the masks to {wanted} before saving"
    elif len(shape) == 1:
        remedy = f"the measurement is one row of {shape[0]} numbers: reshape it to [H, W] before saving"
    elif bits := _packed_bits(measurement, mask_shape):
        remedy = (
            f"rows of bytes are {bits / 8:g} times as long as the masks': unpack pixels of {bits} bits before saving, "
            "or give the file that the camera wrote (a TIFF of 12 bits is unpacked)"
        )
    elif told := _enlarged(shape, mask_shape):
        remedy += f"; {told}"
    elif masks.values.dtype == np.uint8:
        remedy += "; bytes of which each bit is an element: np.unpackbits(masks, axis=-1)"
    if mask_axis != "auto":
        remedy += f", or leave out --mask-axis {mask_axis}"
    return InputError(
        f"{masks.where}: shape {list(mask_shape)} fits the measurement's {list(shape)} ({measurement.where}) "
        "in no order of axes",
        allowed="masks [N, H, W] or [H, W, N] for a measurement [H, W], [H, W, 3], [H, W, K], [K, H, W], "
        "[H, W, 3, K], [H, W, K, 3] or [K, H, W, 3]",
        remedy=remedy,
    )


def _packed_bits(measurement: Array, masks: tuple[int, ...]) -> int | None:
    """Return the bits of a pixel if bytes hold pixels of 10, 12 or 14 bits end to end."""
    shape = measurement.values.shape
    if measurement.values.dtype.itemsize != 1 or len(shape) != 2:
        return None
    wanted = ((bits, k) for bits in (10, 12, 14) for k in _readings(masks, _MASK_ORDERS))
    return next((bits for bits, k in wanted if (shape[0], 8 * shape[1]) == (k.size[0], bits * k.size[1])), None)


def _enlarged(shape: tuple[int, ...], masks: tuple[int, ...]) -> str:
    """Say how masks become as large as the measurement, if each element covers a square of whole pixels."""
    for m in _readings(shape, _MEASUREMENT_ORDERS):
        for k in _readings(masks, _MASK_ORDERS):
            times, rest = divmod(m.size[0], k.size[0])
            if not rest and times > 1 and m.size[1] == times * k.size[1]:
                rows = k.order.index("H")
                return (
                    f"where each element covers {times} x {times} pixels exactly: "
                    f"masks.repeat({times}, {rows}).repeat({times}, {rows + 1})"
                )
    return ""
