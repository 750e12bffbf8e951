"""The calibration of standard errors: what Gauss-Newton and residuals leave out, as a few factors for all measurements.

All were fixed on the draws 6200 and 6201 of `python -m tests.benchmarks reliability`, so that about seven errors of ten
lie within one standard error and nineteen of twenty within two, and are judged on its other draws
(docs/decisions/uncertainty.md). Errors have longer tails than a normal distribution, nearly those of Laplace's.
"""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Factors:
    """A calibration.

    Args of views:
        level: The power of a view's error, as a multiple of the geometric mean of the power that the readings seen and
            those held out leave per unit of light. A fit has followed some of the noise in the one, and errs by it in
            the other.
        unseen: The power left at held-out readings, as a multiple of that at the others, where none was held out.
        noise_order: Where the residual is all noise, the views err by less: 1 − (share of noise)³ of the power is
            theirs. The share is that of the median residual, which counts some of what scenes lack as noise, so that
            only large shares tell.
        least_of_level: However much of the residual is noise, views err by some of it.
        pattern_of_fits: Of what tells where views err, the share of differences between fits, where there are several;
            the rest is that of the residual about a pixel.
        neighbourhood_px: Residuals, and the masks' light, are averaged over so many pixels (standard deviation).
        least_light: A pixel of less light than this share of an open mask tells nothing by itself, and its reading
            takes away less.
        own_reading: The share of what a reading could take away at most from a view's error along its masks that it
            does take away.
        unknown_view: If no reading is usable, nothing is known: the standard deviation of a brightness anywhere from 0
            to 1 is 0.29.
        alike_px: Errors are attached to surfaces: at one pixel, those of two views between which the picture moves by
            much more than this, px, are independent, and otherwise the same.

    Args of depths and poses:
        position: Errors of positions that tracks or fits found, in those by Gauss-Newton, whose readings are taken to
            err independently: what a scene lacks is alike at neighbouring pixels and in all views. Beside the errors of
            given poses, readings tell by so much less.
        turn: The same for turns.
        turn_prior: No camera turns by more than about so many radians against what is known beforehand.
        unseen_px: A turn in step with the travel and a shift of all inverse depths leave the picture as it is
            (bas-relief), but for what a turn does beyond moving the picture as a whole. So many px, in the mean over
            the path, are what a single pixel tells of this, and all of them together by the root of their number less:
            the narrower the field of view, and the fewer the pixels, the larger the turn that readings do not see.
        out_of_step: So much of it is not in step with the travel, and takes the place of travel view by view.
        place_px: The error of points' places through all views, px, at best: a point that moves little through them, as
            one far down a corridor, has an uncertain depth.
        untracked_px: The same where no tracked points tell it (`depths.error_of_places`): those of a path that tracks
            did not show are the less sure.
        unknown_depth: The relative standard error of a depth that no view shows, and what is known beforehand of any;
            the relief that scenes may have, from the nearest sixth of their depths to the farthest.
    """

    level: float = 2.0
    unseen: float = 2.5
    noise_order: int = 3
    least_of_level: float = 0.1
    pattern_of_fits: float = 0.5
    neighbourhood_px: float = 2.0
    least_light: float = 0.2
    own_reading: float = 0.6
    unknown_view: float = 0.3
    alike_px: float = 1.0

    position: float = 3.45
    turn: float = 3.84
    turn_prior: float = 0.1
    unseen_px: float = 4.6
    out_of_step: float = 0.1
    place_px: float = 0.25
    untracked_px: float = 1.0
    unknown_depth: float = 0.5


factors: Final = Factors()
