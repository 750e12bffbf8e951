"""Recognising masks by their images: a residual cannot detect masks in a wrong order.

Every measured mask is compared with the predictions of all masks. Here: that comparison, and the cause of a mismatch
(order, polarity, orientation, a shift of the bench). Not here: predictions (`predicted`).
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64, Bool
from gs2ci_calibration.masks.predicted import Relay
from gs2ci_calibration.masks.registration import orientation
from gs2ci_calibration.refusals import CalibrationError, Reason

LIKE: Final = 0.5
"""Correlation from which on a measured mask is taken for a predicted one; unlike random masks stay below 0.2."""
BETTER: Final = 0.05
"""Another mask is preferred only if its correlation is higher by this: two masks may be the same."""
TEXTURE_MIN: Final = 1e-3
"""Standard deviation of a prediction below which there is nothing to correlate with."""
PIXELS_MIN: Final = 200
"""With fewer pixels than this, masks cannot be distinguished reliably."""
TRIED: Final = 4
"""Number of masks that are compared in other orientations."""


def correlations(seen: NDArray[np.floating], expected: NDArray[np.floating]) -> F64:
    """Return the correlations, [N, M] in [-1, 1], of images [N, P] with images [M, P]; 0 if one has no texture."""
    rows, columns = (_normalised(images) for images in (seen, expected))
    return np.clip(rows @ columns.T, -1.0, 1.0)


def require_order(
    seen: NDArray[np.floating], relay: Relay, patterns: NDArray[Any], top: int, valid: Bool, step: str
) -> F64:
    """Check by their images that the masks are the patterns that were sent, in order, upright and not inverted.

    Args:
        seen: Measured image of each mask between off (0) and on (1), [N, H, W].
        relay: The relay, which predicts them.
        patterns: The patterns that were sent, [N, Hm, Wm].
        top: Level of a fully open pixel.
        valid: Pixels that can be trusted, [H, W].
        step: For messages.

    Returns:
        Correlation of each mask with its prediction, [N].

    Raises:
        CalibrationError: Too few pixels; another order; inverted; mirrored or rotated; shifted since registration; or
            unlike all predictions.
    """
    if valid.sum() < PIXELS_MIN:
        raise CalibrationError(
            step,
            Reason.DEAD_PIXELS,
            f"{int(valid.sum())} pixels see the modulator, which is too few to distinguish masks",
            allowed=f"{PIXELS_MIN} or more",
            remedy="use a larger part of the sensor",
        )
    expected = relay.shares(patterns, top)
    images, foreseen = seen[:, valid], expected[:, valid]
    alike = correlations(images, foreseen)
    own = np.diag(alike)
    # Patterns without texture can be recognised only by their level.
    plain = foreseen.std(axis=1) < TEXTURE_MIN
    wrong = np.flatnonzero(plain & (np.abs(images.mean(axis=1) - foreseen.mean(axis=1)) > 0.5))
    if wrong.size:
        raise _other_order(step, int(wrong[0]), None)
    good = plain | ((own > LIKE) & (own > alike.max(axis=1) - BETTER))
    if good.all():
        return np.where(plain, 1.0, own)
    first = int(np.flatnonzero(~good)[0])
    raise (
        _among_the_masks(alike, first, step)
        or _turned(seen, relay, patterns[:TRIED], top, valid, step)
        or _moved(seen[first], expected[first], step)
        or _unlike_mask(alike, first, step)
    )


def require_held_out(seen: NDArray[np.floating], foreseen: NDArray[np.floating], valid: Bool, step: str) -> float:
    """Compare the held-out mask [H, W] with its prediction; return their correlation.

    Raises:
        CalibrationError: It is too low.
    """
    alike = float(correlations(seen[None, valid], foreseen[None, valid])[0, 0])
    if alike < LIKE:
        raise CalibrationError(
            step,
            Reason.MISPREDICTED,
            f"a held-out pattern differs from its prediction (correlation {alike:.2f})",
            allowed=f"{LIKE} or more",
            remedy="check that nothing moved, and run `gs2ci calibrate registration` again",
        )
    return alike


def _normalised(images: NDArray[np.floating]) -> F64:
    centred = images - images.mean(axis=1, keepdims=True, dtype=np.float64)
    length = np.linalg.norm(centred, axis=1, keepdims=True)
    textured = length > TEXTURE_MIN * np.sqrt(images.shape[1])
    return np.where(textured, centred / np.where(textured, length, 1.0), 0.0)


def _other_order(step: str, shown: int, seen: int | None) -> CalibrationError:
    what = "another one" if seen is None else f"mask {seen}"
    return CalibrationError(
        step,
        Reason.WRONG_ORDER,
        f"instead of mask {shown}, {what} is shown",
        remedy="check how patterns are packed into the modulator's images (bit and image order), and that the first "
        "trigger comes with the first pattern",
    )


def _among_the_masks(alike: F64, first: int, step: str) -> CalibrationError | None:
    """Return the error for the first wrong mask, if it is inverted or another one of the masks."""
    best = int(np.argmax(alike[first]))
    if alike[first, first] < -LIKE:
        return CalibrationError(
            step,
            Reason.WRONG_POLARITY,
            f"mask {first} is the negative of its pattern (correlation {alike[first, first]:.2f})",
            remedy="change `invert` in [modulator]",
        )
    return _other_order(step, first, best) if alike[first, best] > LIKE else None


def _turned(
    seen: NDArray[np.floating], relay: Relay, patterns: NDArray[Any], top: int, valid: Bool, step: str
) -> CalibrationError | None:
    """Return the error for masks that match their patterns in another orientation, or None."""
    for transpose, flip_x, flip_y in np.ndindex(2, 2, 2):
        turned = relay.turned(transpose=bool(transpose), flip_x=bool(flip_x), flip_y=bool(flip_y))
        foreseen = turned.shares(patterns, top)
        alike = np.diag(correlations(seen[: len(patterns), valid], foreseen[:, valid]))
        if np.median(alike) > LIKE:
            return CalibrationError(
                step,
                Reason.FLIPPED,
                f"the modulator's image is {orientation(turned.pixels)}; it was registered as "
                f"{orientation(relay.pixels)}",
                remedy="turn the modulator back, or register it again as it is now",
            )
    return None


def _moved(seen: NDArray[np.floating], foreseen: NDArray[np.floating], step: str) -> CalibrationError | None:
    """Return the error for a mask that matches its pattern some pixels away, or None: the bench has moved."""
    one, other = (image - image.mean(dtype=np.float64) for image in (seen, foreseen))
    product = np.fft.irfft2(np.fft.rfft2(one) * np.conj(np.fft.rfft2(other)), s=one.shape)
    product /= max(float(np.linalg.norm(one) * np.linalg.norm(other)), 1e-12)
    place = np.unravel_index(int(np.argmax(product)), product.shape)
    down, right = (int(p) - side if p > side // 2 else int(p) for p, side in zip(place, product.shape, strict=True))
    if product[place] <= LIKE:
        return None
    return CalibrationError(
        step,
        Reason.DOES_NOT_FIT,
        f"the modulator's image has moved by {right} px to the right and {down} px down since it was registered",
        remedy="run `gs2ci calibrate registration` again",
    )


def _unlike_mask(alike: F64, first: int, step: str) -> CalibrationError:
    return CalibrationError(
        step,
        Reason.MISPREDICTED,
        f"mask {first} matches none of the patterns that were sent (correlation {alike[first].max():.2f} at best)",
        allowed=f"{LIKE} or more",
        remedy="check the focus of the relay and what the modulator shows, and register again",
    )
