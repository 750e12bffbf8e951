"""The patch decoder: GAP with groups of similar patches of nearly low rank, after DeSCI (Liu 2019).

Here: the schedules, and the decode that starts from given views. Not here: the one that starts from GAP-TV's and weighs
the noise that held-out pixels show (`within_time`), the loop (`pnp`), the denoiser (`denoiser`). Unlike in DeSCI,
patches of a group are searched for in windows that follow the optical flow, and each iteration uses a part of the
groups.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Self

import numpy as np
from pydantic import PositiveInt

from gs2ci.core.arrays import F32
from gs2ci.core.bounds import Bounded
from gs2ci.core.config import Positive
from gs2ci.core.errors import InputError
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.patches.denoiser import SimilarPatches
from gs2ci.reconstruct.decode.patches.matching import Lattice
from gs2ci.reconstruct.decode.planes import interleaved, planar
from gs2ci.reconstruct.decode.pnp import PlugAndPlaySettings, ReadingNoise, plug_and_play
from gs2ci.reconstruct.measurement.holdout import Holdout

# Views err more than white noise of the denoiser's level where there is detail; and the power of the noise is an upper
# bound. With 1 noisy shots gain up to 0.5 dB more, but 0.1 to 0.4 dB are lost where the scene lacks much, with 2 none.
_ERRORS_PER_LEVEL: Final = 1.5


@dataclass(frozen=True)
class PatchSettings(Bounded):
    """Schedule and parameters of a decode by similar patches.

    Args:
        iterations: GAP steps.
        first_sigma: Noise level of the first step, full scale 1.
        last_sigma: Noise level of the last; the levels between decrease geometrically.
        refind_every: After so many uses of a phase of the lattice, similar patches are searched for again.
        lattice: Where patches lie, and how many make a group.
    """

    iterations: PositiveInt = 96
    first_sigma: Positive = 60 / 255
    last_sigma: Positive = 6 / 255
    refind_every: PositiveInt = 3
    lattice: Lattice = field(default_factory=Lattice)

    @classmethod
    def quick(cls) -> "PatchSettings":
        """Return a schedule of a few rounds: most of the gain for a small part of the time."""
        return cls(iterations=8, first_sigma=40 / 255, last_sigma=10 / 255)

    @property
    def sigmas(self) -> tuple[float, ...]:
        """Get the noise level of each step."""
        return tuple(np.geomspace(self.first_sigma, self.last_sigma, self.iterations).tolist())

    def entered_at(self, sigma: float) -> "PatchSettings":
        """Return the rest of the schedule from a noise level on; all of it if it starts below that level."""
        rest = tuple(level for level in self.sigmas if level <= sigma)
        if not rest or self.first_sigma <= sigma:
            return self
        return replace(self, iterations=len(rest), first_sigma=rest[0])

    @classmethod
    def polish_sparsely(cls) -> "PatchSettings":
        """Return a schedule that polishes a scene's views for a tenth of the time of a whole decode.

        Reference patches do not overlap. Groups are half as large as those of a decode: in good views, truly similar
        patches can be told from those that only look so.
        """
        lattice = Lattice()
        few = replace(lattice.side_by_side, per_group=lattice.per_group // 2)
        return cls(iterations=12, first_sigma=25 / 255, lattice=few)

    @property
    def sparse(self) -> "PatchSettings":
        """Get the schedule with half the steps and no overlap of patches: about a third of the time for 1 dB less."""
        return replace(self, iterations=max(1, self.iterations // 2), lattice=self.lattice.side_by_side)

    @property
    def last_steps(self) -> "PatchSettings":
        """Get a third of the steps, all at the last level, to include pixels without which views were decoded."""
        return replace(self, iterations=max(1, self.iterations // 3), first_sigma=self.last_sigma)

    @classmethod
    def to_the_end(cls) -> "PatchSettings":
        """Return last steps at the lowest noise level, to include pixels without which views were decoded."""
        return cls(iterations=8, first_sigma=cls.last_sigma)

    def check(self) -> Self:
        """Return self if the numbers make sense.

        Raises:
            InputError: One is out of its bounds, or the noise level rises.
        """
        if self.last_sigma > self.first_sigma:
            raise InputError(
                f"a patch decode from sigma {self.first_sigma:.4g} to {self.last_sigma:.4g}",
                allowed="last_sigma <= first_sigma",
            )
        return super().check()


def patch_decode_from(
    shot: Shot | Sequence[Shot],
    start: F32,
    settings: PatchSettings,
    progress: Progress | None = None,
    enough: Callable[[F32], bool] | None = None,
    noise: F32 | None = None,
) -> F32:
    """Decode one coded measurement by groups of similar patches, starting from given views.

    Args:
        shot: A checked shot: RGB, mono or mosaic; binary or grey masks; saturated pixels are ignored. Several are
            measurements of the same views.
        start: The first views, in which similar patches are first searched for, [N, H, W, C] float32.
        settings: How long, and which patches.
        progress: Receives each iteration and its relative residual.
        enough: Called after each step with its views, [N, C, H, W]; if it returns True, that step is the last.
        noise: Power of the noise in each reading, [H, W, C] as the measurement; None: readings are explained exactly.

    Returns:
        Views, [N, H, W, C] float32 in [0, 1].

    Raises:
        InputError: The settings make no sense.
    """
    schedule = PlugAndPlaySettings(sigmas=settings.check().sigmas, iterations=1)
    denoiser = SimilarPatches(planar(start), settings.lattice, settings.refind_every)
    weighed = None if noise is None else ReadingNoise(noise, error_power)
    return np.clip(plug_and_play(shot, denoiser, schedule, progress, start, enough, weighed), 0, 1)


def error_power(sigma: float) -> float:
    """Return the squared error that views are expected to have before a step of this level."""
    return _ERRORS_PER_LEVEL * sigma**2


# A decode by similar patches that ends when the residual at held-out pixels no longer decreases.
#
# The best length of a decode differs: most clips improve down to the lowest noise level, but a picture full of texture
# starts to lose detail half way.

# A hurried decode continues as long as a round reduces the residual by at least this share.
LEAST_GAIN: Final = 0.02
# A few hundred pixels do not distinguish residuals that differ by less. On a piece of a clip (traffic) the held-out
# residual was smallest at step 32 of 96, and 3 % larger at step 72, whose views were 1.2 dB better; at step 96 it was
# 18 % larger, and the views were 1.4 dB worse again.
_ALIKE: Final = 0.05


@dataclass(frozen=True)
class Settled:
    """The result of a decode.

    Args:
        views: The latest with about the smallest held-out residual, [N, H, W, C] float32 in [0, 1].
        sigma: The noise level of their step, full scale 1.
        steps: How many steps were made.
    """

    views: F32
    sigma: float
    steps: int


class _Watch:
    """Keeps the latest views that are about the best, and decides when to stop.

    It looks at them after each turn of the lattice's phases, since every position has been the reference of a group
    then, and compares rounds after which groups are searched for again: the residual decreases in steps.

    Args:
        holdout: The measurement, and its held-out pixels.
        settings: The schedule.
        least_gain: The share by which a round has to reduce the residual; None: it only must not be worse throughout.
    """

    def __init__(self, holdout: Holdout, settings: PatchSettings, least_gain: float | None) -> None:
        self._holdout, self._settings, self._least_gain = holdout, settings, least_gain
        self._left: list[float] = []
        self.steps = 0
        self.best: tuple[int, F32] | None = None

    def __call__(self, planes: F32) -> bool:
        """Judge the views, [N, C, H, W], of a step; tell whether it was the last."""
        self.steps += 1
        if self.steps % self._settings.lattice.phases:
            return False
        views = np.clip(interleaved(planes), 0, 1)
        left = self._holdout.residual_rms(views)
        if left is None:
            return False
        self._left.append(left)
        most = (1 + _ALIKE) * min(self._left)
        if left <= most:
            self.best = self.steps, views
        looks = self._settings.refind_every
        if len(self._left) <= looks:
            return False
        if self._least_gain is None:
            return all(one > most for one in self._left[-looks:])
        return left > (1 - self._least_gain) * self._left[-1 - looks]


def decode_until_settled(
    holdout: Holdout,
    start: F32,
    settings: PatchSettings,
    progress: Progress | None = None,
    least_gain: float | None = LEAST_GAIN,
) -> Settled:
    """Decode a measurement without its held-out pixels, as long as the residual at these decreases.

    Args:
        holdout: The measurement, and its held-out pixels. Without any, the whole schedule is run.
        start: The first views, [N, H, W, C] float32.
        settings: The whole schedule.
        progress: Receives each iteration and its relative residual.
        least_gain: The decode ends if a round of steps reduces the residual by less than this share; None: it
            ends only if all steps of a round were clearly worse.

    Raises:
        InputError: The settings make no sense.
    """
    watch = _Watch(holdout, settings, least_gain)
    last = patch_decode_from(holdout.seen, start, settings, progress, watch)
    if watch.best is None:
        return Settled(last, settings.last_sigma, watch.steps)
    step, views = watch.best
    return Settled(views, settings.sigmas[step - 1], watch.steps)


def seen_to_the_end(holdout: Holdout, blind: F32, sigma: float) -> F32:
    """Continue a decode with all pixels, by a few last steps at the noise level at which it ended.

    On crops of two clips eight steps were within 0.03 dB of a decode of all pixels, at a twelfth of its cost.

    Args:
        holdout: The measurement.
        blind: Views decoded without the held-out pixels, [N, H, W, C].
        sigma: That level, full scale 1.
    """
    return patch_decode_from(
        holdout.shot, blind, replace(PatchSettings.to_the_end(), first_sigma=sigma, last_sigma=sigma)
    )
