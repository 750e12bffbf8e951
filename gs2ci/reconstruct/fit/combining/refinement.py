"""Refinement: the residual of a scene is decoded into views, and a share of them is added to the scene's views.

Here: the share. Not here: the decode (`decode.gap_tv`), the choice between the refined views, the scene's and the
decode's (`fusion`).

Without noise the residual is mostly detail that the scene lacks; in a noisy measurement it is mostly noise. How much of
the decoded residual is added is one number, found by least squares at the held-out pixels. That estimate is too small
for pixels that the decode sees, since their own readings are known, and it is uncertain, since these pixels are few.
So the largest share is taken that the held-out pixels do not surely contradict. If that is still too large, the
combination of the candidates corrects it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, decode_left_over, decode_residual
from gs2ci.reconstruct.measurement.holdout import SURE, Holdout


@dataclass(frozen=True, eq=False)
class Refinement:
    """Adds the decoded residual of views to them.

    Args:
        holdout: The measurement, and its pixels that no decode may see; its repeats are decoded with it.
        settings: How the residual is decoded; None: nothing is added.
        noise: Power of the noise in each reading, [H, W, C] as the measurement, which is not decoded; None: unknown.

    Raises:
        InputError: The settings make no sense.
    """

    holdout: Holdout
    settings: GapTvSettings | None
    noise: F32 | None = None

    def __post_init__(self) -> None:
        if self.settings is not None:
            self.settings.check()

    @cached_property
    def _seen(self) -> Shot:
        return self.holdout.seen

    def __call__(self, views: F32) -> F32:
        """Refine views, [N, H, W, C] float32, without the held-out pixels, so that these may judge the result."""
        if self.settings is None:
            return views
        added = decode_residual(self.holdout.every_seen, views, self.settings, self.noise)
        return _plus(views, self.share(views, added), added)

    def decode(self, coded: F32) -> F32 | None:
        """Decode the whole residual of a coded image, [H, W, C], without the held-out pixels; None: nothing is added.

        Repeats do not contribute: a fit is judged by what each exposure's own reading tells of it.
        Running fits are judged by their views with all of it. With a fitted share, which compensates for what an early
        scene lacks, the looks would hide how the scene improves; this ended a fit of photographs (`fern_photos_wide`)
        at its first look.
        """
        return None if self.settings is None else decode_left_over(self._seen, coded, self.settings, self.noise)

    def in_full_and_by_share(self, views: F32) -> tuple[F32, F32]:
        """Refine views, [N, H, W, C] float32, by their whole residual and as a call does, with one decode."""
        if self.settings is None:
            return views, views
        added = decode_residual(self.holdout.every_seen, views, self.settings, self.noise)
        in_full = views + added
        return in_full, _plus(views, self.share(views, added), added)

    def by_all_pixels(self, views: F32) -> F32:
        """Refine views, [N, H, W, C] float32, by the whole residual decoded from all pixels.

        For the final views, which the held-out pixels no longer judge.
        """
        if self.settings is None:
            return views
        return _plus(views, 1.0, decode_residual(self.holdout.every_shot, views, self.settings, self.noise))

    def share(self, views: F32, added: F32) -> float:
        """Return the share of `added` to add to `views`, [N, H, W, C], from 0 to 1; 1 if no pixel is held out."""
        if not self.holdout.pixels.any():
            return 1.0
        left, gained = self.holdout.residual_at_pixels(views), self.holdout.coded_at_pixels(added)
        if not (np.isfinite(left).all() and np.isfinite(gained).all() and gained.any()):
            return 1.0
        power = float((gained**2).sum())
        share = float((gained * left).sum()) / power
        error = float(np.linalg.norm((gained * (left - share * gained)).sum(axis=1))) / power
        return min(max(share + SURE * error, 0.0), 1.0)


def _plus(views: F32, share: float, added: F32) -> F32:
    """Return views + share * added, computed in `added`, since memory may not hold copies of a large shot."""
    added *= np.float32(share)
    added += views
    return added
