"""What the residual decodes to, put back into a scene's views as far as the held-out pixels bear it out.

Here: how much of it. Not here: the decode (`decode.residual`), nor the choice between the refined views, the scene's
and the decode's (`pipeline`).

Without noise the residual is mostly detail that the scene lacks, in a noisy measurement mostly noise. How much of
what it decodes to belongs into the views is one number, from its least-squares share on pixels that no decode has seen.
Pixels that were seen know more of their residual than those, and a few pixels say little: so it is the largest share
that they do not surely speak against. Where that is still too much, the choice between the candidates finds it out.
"""

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.decode.residual import ResidualSettings, decode_residual
from gs2ci.reconstruct.measurement.jury import SURE, Jury


class Refinement:
    """Adds to views what their residual decodes to.

    Args:
        jury: The measurement, and the pixels of it that no decode may see.
        settings: How the residual is decoded; None puts nothing back.

    Raises:
        InputError: The settings make no sense.
    """

    def __init__(self, jury: Jury, settings: ResidualSettings | None) -> None:
        if settings is not None:
            settings.steps()
        self._jury = jury
        self._seen = jury.seen
        self._settings = settings

    def __call__(self, views: F32) -> F32:
        """Refine views, [N, H, W, C] float32; the held-out pixels stay unseen, so that they may judge the result."""
        return self.with_share(views)[0]

    def with_share(self, views: F32) -> tuple[F32, float]:
        """Refine views, [N, H, W, C] float32; tell as well which share was put back, from 0 to 1."""
        if self._settings is None:
            return views, 0.0
        added = decode_residual(self._seen, views, self._settings)
        share = self.share(views, added)
        return _plus(views, share, added), share

    def in_full(self, views: F32) -> F32:
        """Refine views, [N, H, W, C] float32, by all that their residual decodes to.

        So a fit is watched: a share that makes up for what an early scene lacks would hide how the scene improves, and
        ended a fit of photographs (`fern_photos_wide`) at its first look.
        """
        if self._settings is None:
            return views
        return _plus(views, 1.0, decode_residual(self._seen, views, self._settings))

    def in_full_and_by_share(self, views: F32) -> tuple[F32, F32]:
        """Refine views, [N, H, W, C] float32, as `in_full` and as a call do, with one decode of their residual."""
        if self._settings is None:
            return views, views
        added = decode_residual(self._seen, views, self._settings)
        in_full = views + added
        return in_full, _plus(views, self.share(views, added), added)

    def by_all_pixels(self, views: F32, share: float) -> F32:
        """Refine views, [N, H, W, C] float32, by this share of what the whole measurement's residual decodes to.

        For the end, where nothing is left to judge; the share is that of the pixels that were seen (`with_share`).
        """
        if self._settings is None:
            return views
        return _plus(views, share, decode_residual(self._jury.shot, views, self._settings))

    def share(self, views: F32, added: F32) -> float:
        """Return how much of `added` belongs into `views`, [N, H, W, C], from 0 to 1; 1 where no pixel is held out."""
        heldout = self._jury.heldout
        if not heldout.any():
            return 1.0
        left = (self._jury.shot.measurement - self._jury.coded(views))[heldout].astype(np.float64)
        gained = self._jury.coded(added)[heldout].astype(np.float64)
        if not (np.isfinite(left).all() and np.isfinite(gained).all() and gained.any()):
            return 1.0
        power = float((gained**2).sum())
        share = float((gained * left).sum()) / power
        error = float(np.linalg.norm((gained * (left - share * gained)).sum(axis=1))) / power
        return min(max(share + SURE * error, 0.0), 1.0)


def _plus(views: F32, share: float, added: F32) -> F32:
    """Return views + share * added; `added` is used up, as large shots have no room for copies."""
    added *= np.float32(share)
    added += views
    return added
