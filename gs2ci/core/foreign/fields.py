"""White and dark frames beside a measurement: what the sensor reads of an even light, and of none.

A dark frame is subtracted, and readings are divided by the white one, which takes out vignetting and the response of
each pixel. Masks that a camera recorded have both in them already: from them only the dark is subtracted, and the white
frame is not used, for measurement and masks agree. The noise of frames is kept out as far as several of them tell it.
"""

from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci.core.foreign import roles
from gs2ci.core.foreign.container import Array, Container
from gs2ci.core.foreign.options import ImportOptions

# Vignetting is even over so many pixels; what is finer is the response of pixels, and noise.
_EVEN_PX: Final = 15
# White is the brightest thousandth, so that readings there keep their unit.
_WHITE: Final = 0.999
# Where less light arrives than this, there is nothing to divide by.
_LEAST: Final = 0.02
# Masks follow the white frame if dividing by it leaves this share of the variation of their local mean.
_FOLLOWS: Final = 0.6
_VARIES: Final = 0.02
# Lenses darken the rim: a middle that is darker than this share of it speaks of another thing.
_FALLS: Final = 0.95
# Recorded masks read at least this share of the dark frame behind closed elements.
_RECORDED_DARK: Final = 0.5


@dataclass(frozen=True)
class FieldFrame:
    """The mean of one frame or several.

    Args:
        values: [H, W, C], of one channel or of the measurement's.
        noise: Standard error of each pixel's mean, as far as several frames tell it; 0: one frame.
        count: How many there were.
    """

    values: F64
    noise: float
    count: int


@dataclass(frozen=True)
class Fields:
    """White and dark frames, as far as a file holds them.

    Args:
        white: Of an even light, or None.
        dark: Without light, or None.
        where: The white frame's place, for messages.
    """

    white: FieldFrame | None
    dark: FieldFrame | None
    where: str

    @classmethod
    def of(cls, container: Container, options: ImportOptions, shape: tuple[int, ...], guesses: list[str]) -> "Fields":
        """Take the frames of a file for a measurement of shape [H, W, C]."""
        found: dict[str, FieldFrame | None] = {"white": None, "dark": None}
        where = ""
        for role, said in (("white", options.white_key), ("dark", options.dark_key)):
            key = roles.key_of(container, cast("roles.Role", role), said, guesses)
            if key is None:
                continue
            if role == "dark" and options.offset is not None:
                guesses.append(f"{container.where(key)}: not used, because --offset says the reading without light")
                container.used.add(key)
                continue
            frame = found[role] = frame_from(container.load(key), (shape[0], shape[1]), shape[2])
            where = container.where(key) if role == "white" else where
            noise = f", noise {frame.noise:.3g}" if frame.count > 1 else ""
            guesses.append(
                f"{container.where(key)}: {role} frame, mean {float(frame.values.mean()):.6g}, of {frame.count}{noise}"
            )
        return cls(found["white"], found["dark"], where)

    @property
    def black(self) -> F64:
        """Get the reading without light, which broadcasts to [H, W, C]."""
        return np.zeros((1, 1, 1)) if self.dark is None else self.dark.values

    def without_dark(self, masks: NDArray[Any], where: str, guesses: list[str]) -> NDArray[Any]:
        """Subtract the dark frame from masks, [N, H, W], that the same camera recorded."""
        if self.dark is None or not have_dark(masks.astype(np.float64), self.dark):
            return masks
        guesses.append(f"{where}: the dark frame was subtracted from the masks, which lie on it")
        return np.maximum(masks - self.dark.values.mean(axis=2), 0)

    def flattened(self, readings: F64, masks: NDArray[Any], guesses: list[str]) -> F64:
        """Divide readings, [K, H, W, C], by what each pixel sees of an even light."""
        if self.white is None:
            return readings
        seen = response(self.white, self.dark)
        if were_recorded(masks.astype(np.float64), seen):
            guesses.append(
                f"{self.where}: the masks show the fall-off of the white frame: they were recorded through the same "
                "optics, and account for it; the readings were not divided"
            )
            return readings
        rows, columns = (slice(n // 4, n - n // 4) for n in seen.shape[:2])
        rim = (seen.sum() - seen[rows, columns].sum()) / max(seen.size - seen[rows, columns].size, 1)
        doubt = ""
        if float(seen[rows, columns].mean()) < _FALLS * rim:
            doubt = "; WARNING: it is brighter at the rim: if it holds factors of correction, save 1 / it"
        guesses.append(
            f"{self.where}: readings divided by the white frame, {float(seen.min()):.2g} to 1 (--white-key none: not)"
            + doubt
        )
        return readings / seen


def frame_from(given: Array, size: tuple[int, int], channels: int) -> FieldFrame:
    """Average frames.

    Args:
        given: One reading for all pixels, [H, W], [H, W, C], or several along the first or the last axis.
        size: Height and width of the measurement.
        channels: Of the measurement, C.

    Raises:
        InputError: Of another size, or not finite.
    """
    values = np.asarray(given.values, np.float64)
    values = np.full(size, values) if values.size == 1 else values if values.shape == size else values.squeeze()
    stack = None
    if values.shape == size:
        stack = values[None, ..., None]
    elif values.ndim == 3 and values.shape == (*size, 3) and channels == 3:
        stack = values[None]
    elif values.ndim == 3 and values.shape[1:] == size:
        stack = values[..., None]
    elif values.ndim == 3 and values.shape[:2] == size:
        stack = np.moveaxis(values, -1, 0)[..., None]
    elif values.ndim == 4 and values.shape[1:] == (*size, channels):
        stack = values
    if stack is None or not np.isfinite(stack).all():
        raise InputError(
            f"{given.where}: frames of shape {list(given.values.shape)} for a measurement of {size[0]} x {size[1]} "
            "pixels",
            allowed=f"finite readings: [{size[0]}, {size[1]}], or several of them",
            remedy="give frames of the same camera and region, or say --white-key none, --dark-key none",
        )
    count = len(stack)
    noise = float(np.sqrt(stack.var(axis=0, ddof=1).mean() / count)) if count > 1 else 0.0
    return FieldFrame(stack.mean(axis=0), noise, count)


def response(white: FieldFrame, dark: FieldFrame | None) -> F64:
    """Return what each pixel sees of an even light, 1 at the brightest, [H, W, C].

    Structure finer than vignetting is kept as far as it stands out from the frames' noise (Wiener's share).

    Raises:
        InputError: The white frame is no brighter than the dark one.
    """
    light = white.values - (0.0 if dark is None else dark.values)
    even = ndimage.uniform_filter(light, (_EVEN_PX, _EVEN_PX, 0), mode="nearest")
    fine = light - even
    variance = float(fine.var())
    noise = white.noise**2 + (0.0 if dark is None else dark.noise**2)
    kept = max(1 - noise / variance, 0.0) if variance > 0 else 1.0
    light = even + kept * fine
    bright = float(np.quantile(light, _WHITE))
    if bright <= 0:
        raise InputError(
            "the white frame is no brighter than the dark one",
            allowed="a frame of an even light with all masks open",
            remedy="leave it out with --white-key none",
        )
    return np.maximum(light / bright, _LEAST)


def were_recorded(masks: F64, seen: F64) -> bool:
    """Tell whether masks, [N, H, W], have the fall-off of the white frame, [H, W, C], in them."""
    even = ndimage.uniform_filter(masks.mean(axis=0), _EVEN_PX, mode="nearest")
    fall = ndimage.uniform_filter(seen.mean(axis=2), _EVEN_PX, mode="nearest")
    usable = (even > 0.05 * even.max()) & (fall > 2 * _LEAST)
    if not usable.any():
        return False
    stated = np.log(even[usable])
    left = stated - np.log(fall[usable])
    return bool(stated.std() > _VARIES and left.std() < _FOLLOWS * stated.std())


def have_dark(masks: F64, dark: FieldFrame) -> bool:
    """Tell whether masks, [N, H, W], as stored, lie on a dark frame, as those recorded by the same camera do."""
    level = float(np.median(dark.values))
    return level > 0 and float(np.quantile(masks, 0.001)) > _RECORDED_DARK * level
