"""Candidate corrections of a measurement, their descriptions, and the one that held-out pixels confirm.

Corrections without a field are judged in the middle of the picture, those with one in the corner that it moves most.
Here: the candidates and the choice. Not here: the estimates behind them (`proposals`, `sharpen`, `rim`), the decodes
that judge them (`admission`).
"""

from dataclasses import dataclass, replace

import numpy as np

from gs2ci.core.arrays import Bool, Size
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.holdout import surely_larger
from gs2ci.reconstruct.registration.admission import Corner, level_of, squares_of
from gs2ci.reconstruct.registration.field import bent_px
from gs2ci.reconstruct.registration.fine import MisfitEstimate
from gs2ci.reconstruct.registration.misfit import Misfit
from gs2ci.reconstruct.registration.parameters import AFFINE, BY_NAME, in_words
from gs2ci.reconstruct.registration.placement import Placement
from gs2ci.reconstruct.registration.rim import Rim, complete
from gs2ci.reconstruct.registration.sharpen import SharpMasks


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
