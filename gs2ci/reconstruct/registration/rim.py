"""The band at the border that displaced masks do not cover.

A pattern displaced by 16 px leaves 16 rows or columns without known masks. Three cases are possible there: the pattern
is continued periodically (as some modulators display it), its border values are repeated, or it is unknown. Readings
confirm either of the first two if its pattern shows in them. If it is unknown, each mask gets its mean transmission
there, and readings are averaged over some elements, since a grey mask can explain only such averages.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.ndimage import distance_transform_edt

from gs2ci.core.arrays import F64, Bool
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import white_reading
from gs2ci.reconstruct.measurement.holdout import surely_larger
from gs2ci.reconstruct.registration.coarse import element_px
from gs2ci.reconstruct.registration.local_scene import Seen, blurred
from gs2ci.reconstruct.registration.misfit import Misfit

# Width of the average: a small window holds few readings of a narrow band; in a large one the scene changes.
_AVERAGED_ELEMENTS: Final = 2.0
_NARROW_PX: Final = 8.0


@dataclass(frozen=True)
class Rim:
    """The pixels without a known mask and how they were filled.

    Args:
        unknown: These pixels, [H, W].
        averaged: Whether the readings there are averages, which predict each other and judge nothing.
        notes: For the user.
    """

    unknown: Bool
    averaged: bool = False
    notes: Findings = ()


def complete(shot: Shot, misfit: Misfit, untold: Bool | None = None) -> tuple[Shot, Rim]:
    """Return a measurement with its masks displaced as they are, and the uncovered band filled.

    Args:
        shot: The measurement, with its black level subtracted.
        misfit: The errors of its masks.
        untold: Pixels that the masks do not tell although they cover them, [H, W].
    """
    stated = shot.masks.astype(np.float64)
    unknown = ~misfit.known(shot.size) | (False if untold is None else untold)
    going_on = misfit.of_masks(stated)
    if not unknown.any():
        return _with(shot, going_on), Rim(unknown)
    flat = np.where(unknown, going_on[:, ~unknown].mean(axis=1)[:, None, None], going_on)
    guesses = {
        "continues as at its border": going_on,
        "repeats periodically": np.where(unknown, misfit.of_masks(stated, wrapped=True), going_on),
    }
    left = {name: _squares(shot, guess, unknown) for name, guess in guesses.items()}
    name = min(left, key=lambda one: float(left[one].mean()))
    if surely_larger(_squares(shot, flat, unknown), left[name]):
        made = f"according to the readings, the pattern {name} there"
        return _with(shot, guesses[name]), Rim(unknown, notes=_guessed(unknown, made))
    made = "the masks are not known there, and readings were averaged over some elements"
    rim = Rim(unknown, averaged=True, notes=_guessed(unknown, made))
    return _with(replace(shot, measurement=_averaged(shot, unknown)), flat), rim


def _guessed(unknown: Bool, made: str) -> Findings:
    return (finding(Code.RIM_GUESSED, share=float(unknown.mean()), made=made),)


def _with(shot: Shot, masks: F64) -> Shot:
    return replace(shot, masks=np.clip(masks, 0, 1).astype(np.float32))


def _squares(shot: Shot, masks: F64, pixels: Bool) -> F64:
    """Return squared held-out errors of a locally constant scene at some pixels."""
    total = np.tensordot(shot.weights.astype(np.float64), masks, axes=1)
    squares: F64 = Seen.of(shot, element_px(total)).errors(total)[pixels] ** 2
    return squares


def _averaged(shot: Shot, pixels: Bool) -> np.ndarray:
    """Average readings over the valid pixels of the band around each pixel that have the same colour."""
    seen = Seen.of(shot, element_px(white_reading(shot)))
    deepest = float(distance_transform_edt(np.pad(pixels, 1, constant_values=True)).max())
    sigma = _AVERAGED_ELEMENTS * seen.window_px * (2 if deepest <= _NARROW_PX else 1)
    measured = shot.measurement.astype(np.float64).copy()
    for counts in seen.counts:
        inside = counts * pixels
        around = blurred(inside, sigma)
        for channel in range(measured.shape[2]):
            light = blurred(inside * shot.measurement[..., channel], sigma)
            level = light / np.maximum(around, 1e-9)
            measured[..., channel] = np.where(inside > 0, level, measured[..., channel])
    return measured.astype(np.float32)
