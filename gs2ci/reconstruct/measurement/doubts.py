"""Doubts about a measurement that a user should know before relying on its results.

Here: the findings about light, masks and saturation, and about views that hardly explain the measurement. Not here:
errors (`Shot.check` refuses contradictory data), doubts about motion and depth (`geometry.path.validity`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, Bool
from gs2ci.core.findings import Code, Finding, Findings, finding
from gs2ci.core.mosaics import greens_of
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.blocks import BLOCK_PX, block_numbers, scores_over_blocks
from gs2ci.reconstruct.measurement.brightness import TOO_ALIKE, told_modes
from gs2ci.reconstruct.measurement.coding import DARK, EXCESS, beyond_white, white_reading
from gs2ci.reconstruct.measurement.holdout import Holdout

# A few clipped highlights are normal, and harmless if their neighbours are not clipped.
SATURATION_WORTH_SAYING: Final = 0.01
# Lamps, glints and defective pixels are less than this share of a picture.
_EXCESS_WORTH_SAYING: Final = 0.02
# Share of the light, of all readings. What errs in a lamp's light is spread over the scene about it.
_LAMP_WORTH_SAYING: Final = 0.1
# Share of the light of the brightest view: less than a step of an eight-bit sensor.
_FAINT_VIEW: Final = 1e-3
# Normal differences of a lamp or a moving view, as a share of the middle view's brightness, and in standard errors.
_BRIGHTER: Final = 0.1
_STANDARD_ERRORS: Final = 4.0
# Root mean square difference of the masks from their mean over the views, as a share of their mean: 1.7 if a quarter is
# open; 0.33 if 90 % is, which loses 3 dB, and 0.14 if 98 % is, which loses 4 dB, though either fits the readings well
# (`python -m tests.stability --only "mask ratio"`).
_DIFFER_LITTLE: Final = 0.35
# Share of the residual of even grey views. With right masks and little noise it is 0.1 to 0.4.
_UNEXPLAINED_WORTH_SAYING: Final = 0.6


def doubts_about(shot: Shot) -> Findings:
    """Report what in a checked shot makes views, path or depth uncertain; nothing if all is normal."""
    return (*_doubts_about_light(shot), *_doubts_about_masks(shot))


def clipped_share(shot: Shot) -> float:
    """Return the share of pixels that are marked as clipped."""
    return 0.0 if shot.saturated is None else float(shot.saturated.mean())


def doubt_about_lamps(shot: Shot) -> Findings:
    """Report a few pixels, hot ones closed, that are brighter than white and hold much of the light."""
    lit = beyond_white(shot)
    share = float(lit.mean())
    light = float(shot.measurement[lit].sum()) / max(
        float(np.abs(shot.measurement).sum()), float(np.finfo(np.float32).tiny)
    )
    if share >= _EXCESS_WORTH_SAYING or light < _LAMP_WORTH_SAYING:
        return ()
    return (finding(Code.LAMP_IN_PICTURE, share=share, light=light),)


def _doubts_about_light(shot: Shot) -> list[Finding]:
    doubts = []
    lowest, highest = float(shot.measurement.min()), float(shot.measurement.max())
    if lowest == highest:
        reading = "zero" if highest == 0 else f"{highest:.4g}"
        doubts.append(finding(Code.EMPTY_MEASUREMENT, reading=reading))
    clipped = clipped_share(shot)
    if clipped >= SATURATION_WORTH_SAYING:
        doubts.append(finding(Code.SATURATED, share=clipped))
    return [*doubts, *_doubts_about_colours(shot), *_doubts_about_scale(shot), *_doubts_about_brightness(shot)]


def _doubts_about_colours(shot: Shot) -> list[Finding]:
    """Report a single-channel measurement whose neighbours differ as those of another mosaic do."""
    if shot.measurement.shape[2] != 1:
        return []
    pair = greens_of(shot.measurement[:, :, 0].astype(np.float64), white_reading(shot))
    if pair is None or (shot.cfa is not None and shot.cfa in pair):
        return []
    return [finding(Code.OTHER_MOSAIC, pair=pair, taken=shot.cfa or "one colour")]


def _doubts_about_scale(shot: Shot) -> list[Finding]:
    """Compare the readings with those of a black and of a white scene."""
    doubts = []
    under, over = float((shot.measurement < -EXCESS).any(axis=2).mean()), float(beyond_white(shot).mean())
    if under >= _EXCESS_WORTH_SAYING:
        doubts.append(finding(Code.DARKER_THAN_DARK, share=under))
    if over >= _EXCESS_WORTH_SAYING:
        doubts.append(finding(Code.BRIGHTER_THAN_WHITE, share=over))
    share = float(np.quantile(shot.measurement, 0.999)) / float(white_reading(shot).max())
    if 0 < share < DARK:
        doubts.append(finding(Code.VERY_DARK, share=share))
    return doubts


def _doubts_about_brightness(shot: Shot) -> list[Finding]:
    """Report if some views are brighter than others, by the readings under their open elements.

    The regression of the readings on the masks gives each view's mean brightness and its standard error, from scores
    summed over blocks: behind wide or soft elements, residuals of neighbours are alike. No view has clearly negative
    light: where the regression says so, masks are correlated with the scene (masks of whole rows are), and it says
    nothing about the others either.
    """
    coded = shot.transmissions.reshape(shot.views, -1).astype(np.float64)
    gram = coded @ coded.T
    if shot.views < 2 or np.linalg.cond(gram) > TOO_ALIKE:
        return []
    reading = shot.measurement.mean(axis=2, dtype=np.float64).reshape(-1)
    inverse = np.linalg.inv(gram)
    brightness = inverse @ (coded @ reading)
    scores = coded * (reading - brightness @ coded)
    block = block_numbers(*np.divmod(np.arange(reading.size), shot.size[1]), BLOCK_PX)
    error = float(np.sqrt(np.diag(inverse @ scores_over_blocks(scores, block) @ inverse).max()))
    middle = float(np.median(brightness))
    notable = max(_BRIGHTER * middle, _STANDARD_ERRORS * error)
    least, most = float(brightness.min()), float(brightness.max())
    if middle <= 0 or least < -notable or max(most - middle, middle - least) < notable:
        return []
    return [finding(Code.UNEVEN_VIEWS, least=max(least, 0.0) / middle, most=most / middle)]


def _doubts_about_masks(shot: Shot) -> list[Finding]:
    doubts = []
    light = shot.weights * shot.masks.sum(axis=(1, 2), dtype=np.float64)
    exposed = light > 0
    faint = exposed & (light < _FAINT_VIEW * light.max())
    if shot.views == 1:
        doubts.append(finding(Code.SINGLE_VIEW))
    elif not exposed.all():
        doubts.append(finding(Code.UNLIT_VIEWS, views=np.flatnonzero(~exposed).tolist()))
    if faint.any():
        doubts.append(finding(Code.FAINT_VIEWS, views=np.flatnonzero(faint).tolist()))
    doubts += _doubts_about_differences(shot, exposed & ~faint)
    lit = shot.lit
    dark = int((~lit).sum())
    if dark:
        doubts.append(finding(Code.UNOPENED_PIXELS, count=dark, of=lit.size))
    if 2 * dark > lit.size:
        doubts.append(finding(Code.MOSTLY_UNOPENED))
    return doubts


def _doubts_about_differences(shot: Shot, bright: Bool) -> list[Finding]:
    """Report masks that are the same, in all views or in some, nearly the same in all, or complementary in pairs."""
    if shot.views < 2:
        return []
    if (shot.masks == shot.masks[0]).all():
        return [finding(Code.SAME_MASKS)]
    alike: dict[bytes, list[int]] = {}
    for view in np.flatnonzero(shot.weights * shot.masks.any(axis=(1, 2))).tolist():
        alike.setdefault(shot.masks[view].tobytes(), []).append(view)
    repeated = [finding(Code.MASKS_REPEATED, views=views) for views in alike.values() if len(views) > 1]
    mean = float(shot.masks.mean(dtype=np.float64))
    share = float(np.sqrt(shot.masks.var(axis=0, dtype=np.float64).mean())) / mean if mean > 0 else np.inf
    little = [finding(Code.MASKS_DIFFER_LITTLE, share=share)] if share < _DIFFER_LITTLE else []
    if repeated or little or not bright.any():
        return [*repeated, *little]
    views, told = told_modes(shot.masks[bright].reshape(-1, shot.lit.size)).shape
    return [finding(Code.MASKS_IN_PAIRS, untold=views - told, of=views)] if told < views else []


def doubts_about_result(holdout: Holdout, views: F32) -> Findings:
    """Report if recovered views, [N, H, W, C], explain the held-out pixels hardly better than even grey views."""
    left, grey = holdout.residual_rms(views), holdout.grey_rms()
    if left is None or grey is None or left <= _UNEXPLAINED_WORTH_SAYING * grey:
        return ()
    share = f"{left / grey:.0%}" if grey > 0 else "more"
    return (finding(Code.LITTLE_EXPLAINED, share=share),)
