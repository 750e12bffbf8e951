"""The rasteriser's grain behind one rig's own optics and masks, measured in short bursts of views.

Views of a moving image differ by a little that is no light (`Renderer.grain`). The constant there is the grain of a
bare view; lens and relay blur most of it, and masks seldom lie where it is largest. Here it is measured instead: views
follow each other by `SPACING_PX` of motion, what of each pixel is a polynomial of the motion is taken away, and
what is left passes the masks and the relay. It is an estimate, as the constant is, and errs upwards: motion that the
polynomial does not follow counts as grain, the worst colour counts for all, and what grain adds up to is bounded by
Cauchy and Schwarz. Not here: whether a measurement pays (`sampling`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Brightening, LightStage
from gs2ci_sims.exposure import Studio
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.moments import Moments
from gs2ci_sims.preview import GRAIN_PX, Preview
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.signals import Slices

# Bursts at even shares of the motion, views in each, and the degree of the polynomial that they are compared with.
BURSTS: Final = 3
VIEWS_EACH: Final = 6
DEGREE: Final = 3
# What lies far away moves less than this and would keep its grain from view to view if it were much smaller; if it
# were much larger, the polynomial would not follow the image. Motion that is left over counts as grain.
SPACING_PX: Final = 0.1
VIEWS: Final = BURSTS * VIEWS_EACH
LENGTH_PX: Final = SPACING_PX * (VIEWS_EACH - 1)


class MeasuredGrain:
    """What grain makes of the readings, for any moments of views.

    Args:
        look: A quick look, with all motion that is simulated.
        renderer: Draws the views.
        slices: When light is collected.
        travel: Times, seconds, and how far the image has moved until then, pixels, [T] each; `BURSTS` times
            `LENGTH_PX` in all, or more.
    """

    def __init__(self, look: Preview, renderer: Renderer, slices: Slices, travel: tuple[F64, F64]) -> None:
        self._look, self._slices, self._travelled_px = look, slices, float(travel[1][-1])
        self._square_dn2 = _squares_dn2(look, renderer, travel)

    def rms_dn(self, moments: Moments) -> float:
        """Return it for views at these moments, DN rms.

        View k collects a_kn of mask n's light, so its grain adds the square of sum_n a_kn m_n to the variance: at most
        sum_n |a_kn| times sum_n |a_kn| m_n^2 (Cauchy and Schwarz).
        """
        weights, mix = moments.weights_s(self._slices), self._slices.mix
        # A shutter takes light of a slice from some rows only: what cancels between slices may not do so there.
        collected = np.abs(weights @ mix) if self._slices.shutter is None else np.abs(weights) @ np.abs(mix)
        collected = collected / self._look.rig.timing.interval_s
        variance = float((collected.sum(axis=1)[:, None] * collected * self._square_dn2).sum())
        # Views of what hardly moves have the same grain.
        alike = max(1.0, len(moments.times_s) / (1 + self._travelled_px / GRAIN_PX))
        return float(np.sqrt(variance * alike))


def _squares_dn2(look: Preview, renderer: Renderer, travel: tuple[F64, F64]) -> F64:
    """Return the mean square of one view's grain behind each mask for its whole interval, [N] DN squared.

    Of the three colours the worst counts: a sensor may have one in each pixel.
    """
    chain = EffectChain(look.effects, look.seed, look.rig)
    studio = Studio(look.scene, look.path, chain, renderer)
    times_s, travelled_px = travel
    steps = np.linspace(-1, 1, VIEWS_EACH)
    # The directions in the space of a burst's views that no polynomial reaches, [views, views - degree - 1].
    beyond = np.linalg.qr(np.vander(steps, DEGREE + 1), mode="complete")[0][:, DEGREE + 1 :]
    squares = np.zeros((len(look.masks), 3))
    for middle_px in travelled_px[-1] * (np.arange(BURSTS) + 0.5) / BURSTS:
        moments_s = np.interp(middle_px + 0.5 * LENGTH_PX * steps, travelled_px, times_s)
        views = np.stack([studio.view(float(time_s)) for time_s in moments_s])
        for field in np.tensordot(beyond.T, views, axes=1):
            for n, mask in enumerate(look.shown):
                behind = chain.through(LightStage.PHOTONS, mask[..., None] * field)
                squares[n] += np.square(behind).mean(axis=(0, 1))
    mean = squares.max(axis=1) / (BURSTS * beyond.shape[1])
    after = [
        one
        for stage in (LightStage.CHARGE, LightStage.READOUT)
        for one in chain.at(stage)
        if isinstance(one, Brightening)
    ]
    gain = float(np.prod([max(one.brightest(look), 1.0) for one in after]))
    return mean * (look.rig.full_scale_e * look.rig.dn_per_e * gain) ** 2
