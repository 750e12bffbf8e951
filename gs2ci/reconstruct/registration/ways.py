"""Candidate corrections of a measurement, their descriptions, and the one that held-out pixels confirm.

Corrections without a field are judged in the middle of the picture, those with one in the corner that it moves most.
Here: the candidates and the choice. Beside them: the decodes that judge them, and the band
that displaced masks do not cover. Not here: the estimates behind them (`proposals`, `sharpen`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.ndimage import distance_transform_edt

from gs2ci.core.arrays import F32, F64, Bool, Size
from gs2ci.core.crop import corner, middle, size_of
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, decode_signed
from gs2ci.reconstruct.measurement.coding import white_reading
from gs2ci.reconstruct.measurement.holdout import Holdout, surely_larger
from gs2ci.reconstruct.registration.coarse import element_px
from gs2ci.reconstruct.registration.fine import MisfitEstimate
from gs2ci.reconstruct.registration.local_scene import Seen, blurred
from gs2ci.reconstruct.registration.misfit import Misfit
from gs2ci.reconstruct.registration.parameters import AFFINE, BY_NAME, in_words
from gs2ci.reconstruct.registration.placement import Placement
from gs2ci.reconstruct.registration.proposals import bent_px
from gs2ci.reconstruct.registration.sharpen import SharpMasks

# Whether a correction is accepted: decodes of a crop with and without it, judged by pixels that neither saw.

_VIEW_PIXELS: Final = 160_000
_LEAST_SIDE_PX: Final = 48
_HELDOUT: Final = 0.1
_ITERATIONS: Final = 15
# So many pixels are to judge. Small pictures are decoded repeatedly, each time without others of their pixels, since a
# few hundred do not tell a black level behind wide elements, which neighbours predict whatever it is.
_JUDGES: Final = 2000
_MOST_DECODES: Final = 5
# Share of the squared residuals that count as they are; larger ones count as much as the largest of these. Behind
# masks that pass a thousandth a decode divides by it, and one such neighbour would outweigh all other pixels.
_COUNTED: Final = 0.99


Corner = tuple[bool, bool]
"""Which corner of a picture: whether the lower, and whether the right one."""


def squares_of(
    shot: Shot,
    candidates: Sequence[Shot],
    scale: float,
    seed: int,
    at: Corner | None = None,
    but: Bool | None = None,
) -> F64:
    """Decode a crop of each candidate in few steps, and return the squared residuals at pixels that it did not see.

    Args:
        shot: Its masks and readings as stated, of which pixels are held out.
        candidates: The same with other masks and readings.
        scale: Divisor of the readings that brings the scene's levels to about a view's full scale.
        seed: Of the held-out pixels.
        at: The corner that is cropped; None crops the middle.
        but: Pixels that must not judge, [H, W]; None: all may.

    Returns:
        For each candidate, [D, K]; the few largest count no more than the others. K is 0 if no pixel is held out.
    """
    if but is not None:
        shot = replace(shot, saturated=but if shot.saturated is None else shot.saturated | but)
    part = _crop(shot, at)
    decodes = int(np.clip(np.ceil(_JUDGES / (_HELDOUT * part.masks[0].size)), 1, _MOST_DECODES))
    heldout = Holdout.of(part, decodes * _HELDOUT, seed).pixels
    turn = np.full(part.size, -1)
    turn[heldout] = np.arange(heldout.sum()) % decodes
    squares = np.zeros((len(candidates), *part.size))
    for left, candidate in zip(squares, candidates, strict=True):
        crop = _scaled_crop(candidate, scale, at)
        for number in range(int(turn.max()) + 1):
            holdout = Holdout(crop, turn == number)
            left[holdout.pixels] = holdout.squared_residuals(_decoded(holdout.seen))
    unseen = squares[:, heldout]
    return np.minimum(unseen, np.quantile(unseen, _COUNTED)) if unseen.size else unseen


def brief_views(shot: Shot, scale: float) -> F32:
    """Decode the middle of a measurement in few steps, [N, h, w, C]; readings are divided by the scale."""
    return _decoded(_scaled_crop(shot, scale))


def level_of(shot: Shot) -> float:
    """Return the divisor of readings that brings twice the scene's level to about full scale."""
    total = white_reading(shot)
    level = Seen.of(shot, element_px(total)).level(total)
    return max(2 * abs(float(np.median(level))), 1e-12)


def _decoded(shot: Shot) -> F32:
    return decode_signed(shot, GapTvSettings(iterations=_ITERATIONS))


def _scaled_crop(shot: Shot, scale: float, at: Corner | None = None) -> Shot:
    part = _crop(shot, at)
    return replace(part, measurement=(part.measurement / np.float32(scale)).astype(np.float32))


def _crop(shot: Shot, at: Corner | None) -> Shot:
    size = size_of(shot, _VIEW_PIXELS, _LEAST_SIDE_PX)
    part = middle(shot, size) if at is None else corner(shot, size, lower=at[0], right=at[1])
    if part.measurement.shape[2] == 3:  # grey gives the same information in a third of the time
        part = replace(part, measurement=part.measurement.mean(axis=2, keepdims=True))
    return part


# The band at the border that displaced masks do not cover.
#
# A pattern displaced by 16 px leaves 16 rows or columns without known masks. Three cases are possible there: the
# pattern is continued periodically (as some modulators display it), its border values are repeated, or it is unknown.
# Readings confirm either of the first two if its pattern shows in them. If it is unknown, each mask gets its mean
# transmission there, and readings are averaged over some elements, since a grey mask can explain only such averages.

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
    return Seen.of(shot, element_px(total)).errors(total)[pixels] ** 2


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


@dataclass(frozen=True)
class Way:
    """A corrected measurement, its description and that of its border, and whether masks were sharpened by a filter."""

    shot: Shot
    misfit: Misfit
    errors: dict[str, float]
    found: str
    rim: Rim
    is_filtered: bool = False

    @property
    def is_bent(self) -> bool:
        """Get whether masks are moved by a smooth field beyond the affine."""
        return bool(self.misfit.field.any())


def way_of(shot: Shot, estimate: MisfitEstimate, untold: Bool | None = None) -> Way:
    """Return the shot corrected by an estimate; `untold` as for `complete`."""
    misfit, errors = estimate.misfit, dict(estimate.errors)
    found = in_words(misfit.values(), errors)
    readings = (shot.measurement - np.float32(misfit.black)).astype(np.float32)
    corrected, rim = complete(replace(shot, measurement=readings) if misfit.black else shot, misfit, untold)
    return Way(corrected, misfit, errors, found, rim, is_filtered=misfit.blur_px2 < 0)


def from_source(shot: Shot, estimate: MisfitEstimate, source: SharpMasks) -> Way:
    """Return a shot with the source of its masks, corrected by an estimate from these.

    What is said and recorded of the correction is how the masks differ from the stated ones.
    """
    how = f"their elements are open or closed, and stated {source.how}"
    way = way_of(replace(shot, masks=source.masks), estimate, source.unknown)
    moved, place = way.misfit, source.placement
    both = Placement.from_affine(moved.matrix @ place.matrix, moved.matrix @ place.shift_px + moved.shift_px)
    affine = {name: getattr(both, name) for name in AFFINE}
    misfit = replace(moved, **affine, blur_px2=moved.blur_px2 - source.blur_px2)
    # Restored elements may be blurred again as much as they are stated.
    alike = abs(misfit.blur_px2) < BY_NAME["blur_px2"].least
    errors = {name: error for name, error in way.errors.items() if not (alike and name == "blur_px2")}
    said = "; ".join(filter(None, (how, in_words(misfit.values(), errors))))
    return replace(way, is_filtered=False, misfit=misfit, errors=errors, found=said)


def chosen(shot: Shot, ways: list[Way], rival: Way | None, seed: int) -> Way | None:
    """Return the correction whose decode predicts held-out pixels best, if it is surely better than a rival.

    A field is judged in the corner that it moves most, against the correction without a field: if that corner is dark
    or noisy, it carries no information on the shift of the whole picture. Pixels without a known mask do not judge.

    Args:
        shot: Its masks and readings as stated.
        ways: The candidates, either all with a field or none.
        rival: The correction that is used otherwise; None stands for the shot as it is.
        seed: Of the held-out pixels.
    """
    if not ways:
        return rival
    bent = max((way.misfit for way in ways), key=lambda one: bent_px(one, shot.size))
    # Readings may have been averaged where a mask is not known, and averages predict each other.
    unknown = np.any([way.rim.unknown for way in (*ways, *(() if rival is None else (rival,)))], axis=0)
    shots = [shot if rival is None else rival.shot, *(way.shot for way in ways)]
    before, *squares = squares_of(shot, shots, level_of(ways[0].shot), seed, _most_bent(bent, shot.size), unknown)
    if not before.size:
        return rival
    best = int(np.argmin([float(one.mean()) for one in squares]))
    return ways[best] if surely_larger(before, squares[best]) else rival


def _most_bent(misfit: Misfit, size: Size) -> Corner | None:
    """Return the corner that a field moves most; None without a field."""
    if not misfit.field.any():
        return None
    corners = [(lower, right) for lower in (False, True) for right in (False, True)]
    places = (np.array(corners) - 0.5) * (np.array(size) - 1)
    return corners[int(np.linalg.norm(misfit.field_px(places), axis=1).argmax())]
