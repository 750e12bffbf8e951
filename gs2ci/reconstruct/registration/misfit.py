"""How the true masks differ from the stated ones: all estimated parameters, with defaults that mean no difference.

    y(p) = black + Σ wᵢ ((1 − leak) · G_blur[ Mᵢ(widening, placement) ](p) + leak) · Xᵢ(p)

Here: how the parameters change masks and their sum. Not here: their list (`parameters`), their estimation (`fine`,
`light`), orientation and order of the masks (`coarse`, `sequence`).
"""

import math
from collections.abc import Container, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Final, Self

import numpy as np
from scipy import fft

from gs2ci.core.arrays import F64
from gs2ci.reconstruct.registration.parameters import BY_NAME
from gs2ci.reconstruct.registration.placement import Placement
from gs2ci.reconstruct.registration.widening import MaskSum, widened

# Sharpening amplifies the noise of a calibration as well: no frequency is amplified by more than this.
_MOST_SHARPENING: Final = 30.0
# Taps farther away than so many standard deviations are left out, as the common image libraries do.
_TRUNCATE: Final = 4.0


@dataclass(frozen=True)
class Misfit(Placement):
    """The errors of the masks as stated: where they lie (`Placement`), and how light passes them.

    Args:
        blur_px2: Variance of the Gaussian blur of the true masks relative to the stated ones; negative: they are stated
            softer than they were.
        leak: Share of the light that passes closed elements.
        black: Reading without light, in the measurement's unit.
        widening_px: How far open elements reach beyond their stated edges, in pixels of the stated masks; negative:
            they end short of them.
    """

    blur_px2: float = 0.0
    leak: float = 0.0
    black: float = 0.0
    widening_px: float = 0.0

    @property
    def blur_sigma_px(self) -> float:
        """Get the standard deviation of the blur, px; negative if masks are stated softer than they were."""
        return 0.0 if self.blur_px2 == 0 else math.copysign(sigma_of(abs(self.blur_px2)), self.blur_px2)

    def of_masks(self, masks: F64, *, wrapped: bool = False) -> F64:
        """Return transmissions, [N, H, W], from the stated ones.

        Args:
            masks: As stated, [N, H, W].
            wrapped: The pattern is continued periodically; otherwise its border values are.
        """
        wider = widened(masks, self.widening_px)
        placed = wider if self.is_identity else self.sample(wider, wrapped=wrapped)
        blurred = gaussian(placed, self.blur_px2)
        return np.clip((1 - self.leak) * blurred + self.leak, 0.0, 1.0)

    def of_sum(self, masks: MaskSum) -> F64:
        """Return the reading of a white scene, [H, W], from the sum of the stated masks."""
        wider = masks.widened(self.widening_px)
        placed = wider if self.is_identity else self.sample(wider[None])[0]
        return (1 - self.leak) * gaussian(placed[None], self.blur_px2)[0] + self.leak * masks.weight

    def values(self) -> dict[str, float]:
        """Return the parameters by name, and the blur as a standard deviation."""
        return asdict(self) | {"blur_sigma_px": self.blur_sigma_px}

    def stepped(self, by: Mapping[str, float]) -> Self:
        """Return the same with parameters changed by so much, within their limits."""
        limited = {k: float(np.clip(getattr(self, k) + change, *BY_NAME[k].limits)) for k, change in by.items()}
        return replace(self, **limited)

    def only(self, names: Container[str]) -> Self:
        """Return the same with the defaults of all parameters but these."""
        return replace(self, **{name: 0.0 for name in BY_NAME if name not in names})


def gaussian(stack: F64, variance_px2: float) -> F64:
    """Blur pictures, [N, H, W], by a sampled Gaussian of this variance, mirrored at the border; negative: sharpen.

    Its taps are exp(−n² / 2σ²), normalised, with variance σ² above half a pixel and less below. The blur depends
    smoothly on the variance down to zero, unlike on σ. Sharpening is the inverse, but no frequency is amplified by more
    than `_MOST_SHARPENING`.
    """
    if variance_px2 == 0:
        return stack
    factor = transfer(abs(variance_px2), stack.shape[1:])
    if variance_px2 < 0:
        factor = 1 / np.maximum(factor, 1 / _MOST_SHARPENING)
    return fft.idctn(fft.dctn(stack, axes=(1, 2), norm="ortho") * factor, axes=(1, 2), norm="ortho")


def transfer(variance_px2: float, size: tuple[int, ...]) -> F64:
    """Return a blur's transfer at each frequency of the half-sample symmetric cosine transform, [H, W]."""
    down, across = (_transfer(variance_px2, np.pi * np.arange(n) / n) for n in size)
    return down[:, None] * across[None, :]


def _transfer(variance_px2: float, frequencies: F64) -> F64:
    taps = _taps(sigma_of(variance_px2))
    return taps @ np.cos(np.arange(len(taps))[:, None] * frequencies[None, :])


def _taps(sigma_px: float) -> F64:
    """Return the middle tap and twice each tap on one side of it."""
    count = max(2, int(_TRUNCATE * sigma_px + 0.5) + 1)
    taps = np.exp(-0.5 * (np.arange(count) / max(sigma_px, 1e-3)) ** 2)
    taps[1:] *= 2
    return taps / taps.sum()


def variance_of(sigma_px: float) -> float:
    """Return the variance, px², of the sampled Gaussian of a standard deviation in pixels."""
    taps = _taps(sigma_px)
    return float((taps * np.arange(len(taps)) ** 2).sum())


def sigma_of(variance_px2: float) -> float:
    """Return the standard deviation, px, at which a sampled Gaussian has this variance."""
    return float(np.interp(variance_px2, _VARIANCES, _SIGMAS))


_SIGMAS: Final = np.concatenate([np.linspace(0.1, 1.5, 281), np.linspace(1.55, 8, 130)])
_VARIANCES: Final = np.array([variance_of(float(sigma)) for sigma in _SIGMAS])
