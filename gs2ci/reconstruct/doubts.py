"""What a user should know about a measurement before believing anything that is made of it.

Here: the sentences about light, masks and saturation. Not here: errors (`Shot.check` refuses what contradicts
itself), doubts about motion and depth (`geometry.validity`). For `gs2ci.reconstruct.pipeline`.
"""

from typing import Final

import numpy as np

from gs2ci.core.records import Shot

# A few clipped highlights are normal, and cost nothing where their neighbours are not clipped.
_SATURATION_WORTH_SAYING: Final = 0.01


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
    if clipped >= _SATURATION_WORTH_SAYING:
        doubts.append(f"{clipped:.0%} of the pixels are saturated and say only «at least»; use less light.")
    return doubts


def _doubts_about_masks(shot: Shot) -> list[str]:
    doubts = []
    exposed = shot.masks.any(axis=(1, 2)) & (shot.weights > 0)
    if shot.views == 1:
        doubts.append("There is one view only: neither a camera path nor depth can be found.")
    elif not exposed.all():
        doubts.append(f"No light reached views {np.flatnonzero(~exposed).tolist()}: only the others tell of them.")
    if shot.views > 1 and (shot.masks == shot.masks[0]).all():
        doubts.append("All masks are the same: the measurement is one long exposure, and does not tell views apart.")
    opened = shot.masks[exposed].any(axis=0)
    dark = int((~opened).sum())
    if dark:
        doubts.append(f"No mask opens {dark} of {opened.size} pixels: there the views follow from their surroundings.")
    return doubts
