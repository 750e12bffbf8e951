"""Drawn coded measurements as files hold them, right ones and ones that were spoiled on their way into the file.

Right ones: photographs of scikit-image that move past the camera (one half of them with a second one in front), coded
by 2 to 32 masks of eight families, in colour, grey or behind a mosaic, with vignetting, noise of up to a tenth of the
mean reading, clipping of up to 30 % of the readings, stored in 8 to 16 bits or in floating point. Spoiled ones: the
same, once more, in a way of `SPOILS`. Not here: what import says of them (`imports`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Final

import numpy as np
import skimage.data
from scipy import ndimage

from gs2ci.core.arrays import F64
from gs2ci.core.records import CFA_PATTERNS

Draw = np.random.Generator

_PHOTOGRAPHS: Final = ("coffee", "astronaut", "chelsea", "rocket", "camera", "coins", "moon", "page", "brick", "gravel")


@dataclass(frozen=True)
class Drawn:
    """A measurement as it is stored.

    Args:
        measurement: [H, W] or [H, W, 3], of any type.
        masks: [N, H, W].
        views: What was shown, [N, H, W] or [N, H, W, 3], full scale 1, as the sensor sees them.
        full: Reading of a white scene under one open mask.
        cfa: Mosaic of the measurement.
        kinds: In words: family of masks, of picture, ...
        shown: Which of the masks were shown, in order.
        spoil: In which way it was spoiled; empty: it is right.
    """

    measurement: np.ndarray[Any, Any]
    masks: np.ndarray[Any, Any]
    views: F64
    full: float
    cfa: str | None = None
    kinds: dict[str, Any] = field(default_factory=dict)
    shown: tuple[int, ...] = ()
    spoil: str = ""


@cache
def _photograph(name: str) -> F64:
    picture = np.asarray(getattr(skimage.data, name)(), np.float64) / 255
    return picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)


def _views(rng: Draw, count: int, size: tuple[int, int]) -> F64:
    """Draw photographs that move at a steady pace, [N, H, W, 3]."""
    layers = 1 + int(rng.random() < 0.5)
    shown = np.zeros((count, *size, 3))
    for layer in range(layers):
        picture = _photograph(str(rng.choice(_PHOTOGRAPHS)))
        zoom = float(rng.uniform(0.5, 1.2))
        pace = rng.uniform(-1, 1, 2) * float(rng.uniform(0, 24)) / count
        room = [max(n / zoom, 1.0) for n in size]
        corner = [float(rng.uniform(0, max(p - r, 1))) for p, r in zip(picture.shape, room, strict=False)]
        rows, columns = np.mgrid[: size[0], : size[1]]
        inside = ((rows - size[0] / 2) / (0.3 * size[0])) ** 2 + ((columns - size[1] / 2) / (0.3 * size[1])) ** 2 < 1
        for k in range(count):
            at = np.stack([rows / zoom + corner[0] + k * pace[0], columns / zoom + corner[1] + k * pace[1]])
            for channel in range(3):
                seen = ndimage.map_coordinates(picture[..., channel], at, order=1, mode="mirror")
                shown[k, :, :, channel] = np.where(inside, seen, shown[k, :, :, channel]) if layer else seen
    return shown


def _binary(rng: Draw, count: int, size: tuple[int, int]) -> F64:
    share = float(rng.uniform(0.2, 0.6))
    return (rng.random((count, *size)) < share).astype(np.float64)


def _grey(rng: Draw, count: int, size: tuple[int, int]) -> F64:
    return rng.random((count, *size))


def _grey_bytes(rng: Draw, count: int, size: tuple[int, int]) -> F64:
    return np.round(255 * rng.beta(0.6, 0.6, (count, *size)))


def _soft(rng: Draw, count: int, size: tuple[int, int]) -> F64:
    return ndimage.gaussian_filter(_binary(rng, count, size), (0, *([float(rng.uniform(0.3, 0.8))] * 2)))


def _leaking(rng: Draw, count: int, size: tuple[int, int]) -> F64:
    leak = float(rng.uniform(0.02, 0.15))
    return leak + (1 - leak) * _binary(rng, count, size)


def _coarse(rng: Draw, count: int, size: tuple[int, int]) -> F64:
    half = _binary(rng, count, (-(-size[0] // 2), -(-size[1] // 2)))
    return half.repeat(2, axis=1).repeat(2, axis=2)[:, : size[0], : size[1]]


def _moved(rng: Draw, count: int, size: tuple[int, int]) -> F64:
    wide = _binary(rng, 1, (size[0] + count, size[1]))[0]
    return np.stack([wide[k : k + size[0]] for k in range(count)])


def _measured(rng: Draw, count: int, size: tuple[int, int]) -> F64:
    """Soft masks as a camera recorded them, with vignetting and a little noise."""
    masks = _soft(rng, count, size) * _vignetting(size, 0.3)
    return np.clip(masks + rng.normal(0, 0.004, masks.shape), 0, None)


MASKS: Final[dict[str, Callable[[Draw, int, tuple[int, int]], F64]]] = {
    "binary": _binary,
    "grey": _grey,
    "grey in bytes": _grey_bytes,
    "soft": _soft,
    "leaking": _leaking,
    "coarse": _coarse,
    "moved": _moved,
    "measured": _measured,
}


def _vignetting(size: tuple[int, int], strength: float) -> F64:
    rows, columns = np.mgrid[: size[0], : size[1]]
    distance = np.hypot(rows - size[0] / 2, columns - size[1] / 2) / (np.hypot(*size) / 2)
    fall: F64 = 1 - strength * distance**2
    return fall


def mosaic(image: F64, cfa: str) -> F64:
    """Keep of each pixel the colour that its filter passes."""
    channel = np.array(["RGB".index(colour) for colour in cfa]).reshape(2, 2)
    rows, columns = np.arange(image.shape[0]) % 2, np.arange(image.shape[1]) % 2
    return np.take_along_axis(image, channel[rows[:, None], columns[None, :]][..., None], axis=2)[..., 0]


@dataclass(frozen=True)
class Light:
    """A measurement before it is stored: the sum of masked views, in full scales of one view, and what was drawn."""

    total: F64
    masks: F64
    transmissions: F64
    views: F64
    cfa: str | None
    kinds: dict[str, Any]


def light(rng: Draw, views: int | None = None, family: str | None = None) -> Light:
    """Draw masks, a scene and their coded sum."""
    size = (int(rng.integers(64, 200)), int(rng.integers(64, 240)))
    count = views or round(float(np.exp(rng.uniform(np.log(2), np.log(32)))))
    family = family or str(rng.choice(list(MASKS)))
    masks = MASKS[family](rng, count, size)
    transmissions = masks / max(1.0, masks.max())
    shown = _views(rng, count, size)
    while shown.mean() < 0.08 or float(np.quantile(shown, 0.5)) < 0.03:
        shown = _views(rng, count, size)
    shown = shown * float(rng.uniform(0.5, 1.0))
    if rng.random() < 0.4:
        shown = shown * _vignetting(size, float(rng.uniform(0.2, 0.7)))[..., None]
    colour = str(rng.choice(["grey", "rgb", "mosaic"], p=[0.5, 0.25, 0.25]))
    total = np.einsum("nhw,nhwc->hwc", transmissions, shown)
    cfa = None
    if colour == "grey":
        total, shown = total.mean(axis=2), shown.mean(axis=3)
    elif colour == "mosaic":
        cfa = str(rng.choice(CFA_PATTERNS))
        total = mosaic(total, cfa)
    kinds = {"masks": family, "views": count, "colour": colour, "size": size}
    return Light(total, masks, transmissions, shown, cfa, kinds)


def stored(rng: Draw, lit: Light, *, noise: float | None = None, clipping: float | None = None) -> Drawn:
    """Expose and store it as a camera does: noise, clipping, bits."""
    noise = float(rng.choice([0.0, 0.005, 0.02, 0.05, 0.1])) if noise is None else noise
    if clipping is None:
        clipping = float(rng.choice([0.0, 0.0, 0.0, 0.01, 0.1, 0.3]))
    reading = lit.total + rng.normal(0, noise * float(lit.total.mean()) + 1e-12, lit.total.shape)
    bits = int(rng.choice([8, 10, 12, 14, 16, 0]))
    top = float(np.quantile(reading, 1 - clipping)) if clipping else float(reading.max()) * float(rng.uniform(1, 1.6))
    kinds = {**lit.kinds, "noise": noise, "clipping": clipping, "bits": bits}
    masks = lit.masks.astype(np.uint8) if lit.masks.max() > 1.5 or set(np.unique(lit.masks)) <= {0, 1} else lit.masks
    masks = masks.astype(np.float32) if masks.dtype == np.float64 else masks
    shown = tuple(range(len(masks)))
    if not bits:
        values = np.minimum(reading, top).astype(np.float32)
        return Drawn(values, masks, lit.views, 1.0, lit.cfa, kinds, shown)
    gain = (2**bits - 1) / top
    values = np.clip(np.rint(reading * gain), 0, 2**bits - 1).astype(np.uint8 if bits == 8 else np.uint16)
    return Drawn(values, masks, lit.views, gain, lit.cfa, kinds, shown)


def right(rng: Draw) -> Drawn:
    """Draw a right measurement."""
    return stored(rng, light(rng))


def _store(values: F64, like: Drawn) -> np.ndarray[Any, Any]:
    return values.astype(np.float32)


def _divided(rng: Draw) -> Drawn:
    """Divide by the masks' sum, where it is 0 by 1 or leaving 0, as networks that unfold an algorithm take it."""
    lit = light(rng)
    made = stored(rng, lit)
    total = lit.transmissions.sum(axis=0)
    total = np.where(total == 0, 1.0, total)
    values = made.measurement / (total[..., None] if made.measurement.ndim == 3 else total)
    if rng.random() < 0.3:
        values = values / values.max()
    return replace(made, measurement=values.astype(np.float32), spoil="divided by the masks' sum")


def srgb(values: F64) -> F64:
    """Encode light in 0..1 for a display (IEC 61966-2-1)."""
    return np.where(values <= 0.0031308, 12.92 * values, 1.055 * np.maximum(values, 1e-9) ** (1 / 2.4) - 0.055)


_CURVES: Final[dict[str, Callable[[F64], F64]]] = {
    "gamma 1/2.2": lambda x: x ** (1 / 2.2),
    "sRGB": srgb,
    "square root": np.sqrt,
    "logarithm": lambda x: np.log1p(100 * x) / np.log(101),
}


def _curved(name: str) -> Callable[[Draw], Drawn]:
    def spoil(rng: Draw) -> Drawn:
        made = stored(rng, light(rng))
        top = float(made.measurement.max())
        values = _CURVES[name](np.clip(made.measurement / top, 0, 1).astype(np.float64))
        in_bytes = rng.random() < 0.7
        kept = np.rint(255 * values).astype(np.uint8) if in_bytes else values.astype(np.float32)
        return replace(made, measurement=kept, spoil=name)

    return spoil


def _wrapped(rng: Draw) -> Drawn:
    """Sum frames in integers that are too small for the sum."""
    lit = light(rng)
    bits = int(rng.choice([8, 10, 12, 14, 16]))
    white = 2**bits - 1
    noise = float(rng.choice([0.0, 0.005, 0.02, 0.05, 0.1]))
    reading = lit.total + rng.normal(0, noise * float(lit.total.mean()) + 1e-12, lit.total.shape)
    share = float(rng.choice([0.01, 0.05, 0.2, 0.5]))
    # Bright enough for that share to go beyond the range.
    gain = max(white / max(float(np.quantile(reading, 1 - share)), 1e-9), 0.0)
    values = (np.rint(np.maximum(reading, 0) * gain).astype(np.int64) % 2**bits).astype(
        np.uint8 if bits == 8 else np.uint16
    )
    made = stored(rng, lit, noise=0, clipping=0)
    return replace(
        made,
        measurement=values,
        full=gain,
        kinds={**lit.kinds, "noise": noise, "bits": bits, "wrapped": share},
        spoil="sum overflowed",
    )


def _more(rng: Draw) -> Drawn:
    """Keep masks in the file that were not shown."""
    made = stored(rng, light(rng, views=int(rng.integers(2, 17))))
    n = len(made.masks)
    extra = MASKS[made.kinds["masks"]](rng, int(rng.integers(1, n + 1)), made.masks.shape[1:])
    before = rng.random() < 0.3
    extra = extra.astype(made.masks.dtype)
    masks = np.concatenate([extra, made.masks] if before else [made.masks, extra])
    first = len(extra) if before else 0
    return replace(made, masks=masks, shown=tuple(range(first, first + n)), spoil="more masks than shown")


def _fewer(rng: Draw) -> Drawn:
    """Lose masks that were shown."""
    made = stored(rng, light(rng, views=int(rng.integers(3, 17))))
    lost = int(rng.integers(1, max(2, len(made.masks) // 3)))
    return replace(made, masks=made.masks[:-lost], views=made.views[:-lost], spoil="fewer masks than shown")


SPOILS: Final[dict[str, Callable[[Draw], Drawn]]] = {
    "divided": _divided,
    "gamma": _curved("gamma 1/2.2"),
    "srgb": _curved("sRGB"),
    "sqrt": _curved("square root"),
    "log": _curved("logarithm"),
    "wrapped": _wrapped,
    "more": _more,
    "fewer": _fewer,
}


def spoiled(rng: Draw, how: str | None = None) -> Drawn:
    """Draw a spoiled measurement."""
    return SPOILS[how or str(rng.choice(list(SPOILS)))](rng)
