"""What a user should know about a measurement before believing anything that is made of it.

Here: the sentences about light, masks and saturation, and about views that hardly explain the measurement. Not here:
errors (`Shot.check` refuses what contradicts itself), doubts about motion and depth (`geometry.validity`). For
`gs2ci.reconstruct.pipeline`.
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.brightness import TOO_ALIKE
from gs2ci.reconstruct.measurement.coding import EXCESS, beyond_white, white_reading
from gs2ci.reconstruct.measurement.jury import Jury

# A few clipped highlights are normal, and cost nothing where their neighbours are not clipped.
SATURATION_WORTH_SAYING: Final = 0.01
# Lamps, glints and broken pixels are fewer than this share of a picture.
_EXCESS_WORTH_SAYING: Final = 0.02
# A scene may be dark; one whose brightest point is darker than this uses less than three bits of an eight-bit sensor.
_DARK: Final = 0.02
# Of the light of the brightest view: less than a step of an eight-bit sensor.
_FAINT_VIEW: Final = 1e-3
# What a lamp or a moving view may well do, in shares of the middle view's brightness, and standard errors beside it.
_BRIGHTER: Final = 0.1
_STANDARD_ERRORS: Final = 4.0
_MOSTLY_DARK: Final = 0.5
# Of the residual that an even grey leaves. Right masks and little noise leave 0.1 to 0.4 of it.
_UNEXPLAINED_WORTH_SAYING: Final = 0.6


def doubts_about(shot: Shot) -> tuple[str, ...]:
    """Say what in a checked shot leaves views, path or depth open; nothing if all is ordinary."""
    return (*_doubts_about_light(shot), *_doubts_about_masks(shot))


def _doubts_about_light(shot: Shot) -> list[str]:
    doubts = []
    lowest, highest = float(shot.measurement.min()), float(shot.measurement.max())
    if lowest == highest:
        what = "zero" if highest == 0 else f"{highest:.4g}"
        doubts.append(f"The measurement is {what} everywhere: it shows no scene.")
    clipped = 0.0 if shot.saturated is None else float(shot.saturated.mean())
    if clipped >= SATURATION_WORTH_SAYING:
        doubts.append(f"{clipped:.0%} of the pixels are saturated and say only «at least»; use less light.")
    return [*doubts, *_doubts_about_scale(shot), *_doubts_about_brightness(shot)]


def _doubts_about_scale(shot: Shot) -> list[str]:
    """Compare the readings with those of a black and of a white scene."""
    doubts = []
    under, over = float((shot.measurement < -EXCESS).any(axis=2).mean()), float(beyond_white(shot).mean())
    if under >= _EXCESS_WORTH_SAYING:
        doubts.append(
            f"{under:.0%} of the pixels read clearly less than no light: too much of a dark level was subtracted, or "
            "there is much noise."
        )
    if over >= _EXCESS_WORTH_SAYING:
        doubts.append(
            f"{over:.0%} of the pixels read more light than a white scene would send through their masks: the masks "
            "are not those of this exposure, the unit is not the full scale of one view, or there is much noise."
        )
    share = float(np.quantile(shot.measurement, 0.999)) / float(white_reading(shot).max())
    if 0 < share < _DARK:
        doubts.append(
            f"The brightest readings are {share:.2g} of those of a white scene: the scene is very dark, or the unit is "
            "not the full scale of one view."
        )
    return doubts


def _doubts_about_brightness(shot: Shot) -> list[str]:
    """Say if some views are brighter than others, as the readings under their open elements tell.

    The readings' regression on the masks gives each view's mean brightness, and its standard error.
    """
    coded = (shot.masks * shot.weights[:, None, None]).reshape(shot.views, -1).astype(np.float64)
    gram = coded @ coded.T
    if shot.views < 2 or np.linalg.cond(gram) > TOO_ALIKE:
        return []
    reading = shot.measurement.mean(axis=2, dtype=np.float64).reshape(-1)
    brightness = np.linalg.solve(gram, coded @ reading)
    variance = np.mean((reading - brightness @ coded) ** 2)
    error = float(np.sqrt(variance * np.diag(np.linalg.inv(gram)).max()))
    middle = float(np.median(brightness))
    apart = float(np.abs(brightness - middle).max())
    if middle <= 0 or apart < max(_BRIGHTER * middle, _STANDARD_ERRORS * error):
        return []
    return [
        f"Views seem to be {brightness.min() / middle:.2f} to {brightness.max() / middle:.2f} times as bright as the "
        "middle one: the weights are not those of this exposure, the lamp flickers, or the scene changes."
    ]


def _doubts_about_masks(shot: Shot) -> list[str]:
    doubts = []
    light = shot.weights * shot.masks.sum(axis=(1, 2), dtype=np.float64)
    exposed = light > 0
    faint = exposed & (light < _FAINT_VIEW * light.max())
    if shot.views == 1:
        doubts.append("There is one view only: neither a camera path nor depth can be found.")
    elif not exposed.all():
        doubts.append(f"No light reached views {np.flatnonzero(~exposed).tolist()}: only the others tell of them.")
    if faint.any():
        doubts.append(f"Hardly any light reached views {np.flatnonzero(faint).tolist()}: little can be known of them.")
    if shot.views > 1 and (shot.masks == shot.masks[0]).all():
        doubts.append("All masks are the same: the measurement is one long exposure, and does not tell views apart.")
    lit = shot.lit
    dark = int((~lit).sum())
    if dark:
        doubts.append(f"No mask opens {dark} of {lit.size} pixels: there the views follow from their surroundings.")
    if dark > _MOSTLY_DARK * lit.size:
        doubts.append("That is most of the picture: show more masks, or masks with more open elements.")
    return doubts


def doubts_about_result(jury: Jury, views: F32) -> tuple[str, ...]:
    """Say if recovered views, [N, H, W, C], explain the held-out pixels little better than an even grey does."""
    left, grey = jury.residual_rms(views), jury.grey_rms()
    if left is None or grey is None or left <= _UNEXPLAINED_WORTH_SAYING * grey:
        return ()
    share = f"{left / grey:.0%}" if grey > 0 else "more"
    return (
        f"On the held-out pixels, the views leave {share} of what an even grey leaves unexplained: there is much noise "
        "or little to see, or the masks are not those of this exposure.",
    )
