"""Refinement: the residual of a scene is decoded into views and added to the scene's views.

Without noise the residual is mostly detail that the scene lacks; in a noisy measurement it is mostly noise. So its
decode weighs the noise of the readings, which is known from what the views leave of them.

Here: these sums. Not here: the decode (`decode.gap_tv`), the noise (`measurement.noise`), the choice between the
refined views, the scene's and the decode's (`fusion`).
"""

from collections.abc import Sequence

from gs2ci.core.arrays import F32
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, decode_left_over, decode_residual
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.noise import noise_of_readings


class Refinement:
    """Adds the decoded residual of views to them.

    Args:
        holdout: The measurement, and its pixels that no decode may see; its repeats are decoded with it.
        settings: How the residual is decoded; None: nothing is added.
        noise: Power of the noise in each reading, [H, W, C] as the measurement, which is not decoded; None: what the
            views tell of it.

    Raises:
        InputError: The settings make no sense.
    """

    def __init__(self, holdout: Holdout, settings: GapTvSettings | None, noise: F32 | None = None) -> None:
        if settings is not None:
            settings.check()
        self._holdout = holdout
        self._seen = holdout.seen
        self._settings = settings
        self._noise = noise

    def with_noise(self, noise: F32) -> "Refinement":
        """Return the same refinement, the noise of the readings known, [H, W, C]."""
        return Refinement(self._holdout, self._settings, noise)

    def __call__(self, views: F32) -> F32:
        """Refine views, [N, H, W, C] float32, without the held-out pixels, so that these may judge the result."""
        return self._refined(self._holdout.every_seen, views)

    def by_all_pixels(self, views: F32) -> F32:
        """Refine views, [N, H, W, C] float32, by what all pixels leave: final ones, which no pixel judges any more."""
        return self._refined(self._holdout.every_shot, views)

    def decode(self, coded: F32) -> F32 | None:
        """Decode the whole residual of a coded image, [H, W, C], without the held-out pixels; None: nothing is added.

        Repeats do not contribute: a fit is judged by what each exposure's own reading tells of it. Nor is noise weighed
        here: what an early scene lacks would be taken for noise, and hide how the scene improves. With less of the
        residual a fit of photographs (`fern_photos_wide`) once ended at its first look.
        """
        return None if self._settings is None else decode_left_over(self._seen, coded, self._settings)

    def _refined(self, shots: Sequence[Shot], views: F32) -> F32:
        if self._settings is None:
            return views
        noise = noise_of_readings(self._holdout, views) if self._noise is None else self._noise
        added = decode_residual(shots, views, self._settings, noise)
        added += views  # in place, since memory may not hold copies of a large shot
        return added
