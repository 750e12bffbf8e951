"""The patch decode from GAP-TV's views, of a number of steps or of as many as fit into a time.

The noise levels decrease to the last of the schedule, or to a lower one where held-out pixels show that the views err
less: where the residual there is smaller than the error that belongs to the last level, a decode may go on to a lower
level, as the views, and so the readings, err less.

The same pixels tell the noise of the readings. GAP explains every reading that it sees, its noise included, so their
residuals tell nothing of the noise. At held-out pixels the residual is noise and what the views err there. Without
noise it mostly decreases to the last step; if it rises in the second half of the steps, the views have probably begun
to follow noise. From then on the noise is what the residual has beyond the error that belongs to the denoiser's level.

Within a time, a short decode is best made of many cheap steps: its reference patches lie side by side and do not
overlap by half, as those of the whole schedule do. Every step is timed; the remaining time determines the number of
further steps and the next noise level. So the last step is at the last level, whatever else runs on the machine, and
the result depends on the machine's speed.

Here: these estimates, the clock, the levels, the end. Not here: where the time comes from (`gs2ci.api.decoding`), the
steps (`decoder`), how a step weighs the noise (`pnp.ReadingNoise`), the noise that the views of a fitted scene tell
(`gs2ci.reconstruct.measurement.noise`).
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.denoisers import clamped
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, decode_signed
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings, error_power
from gs2ci.reconstruct.decode.patches.denoiser import SimilarPatches
from gs2ci.reconstruct.decode.patches.matching import Lattice
from gs2ci.reconstruct.decode.planes import interleaved, planar
from gs2ci.reconstruct.decode.pnp import PlugAndPlaySettings, ReadingNoise, plug_and_play
from gs2ci.reconstruct.measurement.holdout import HELDOUT_SHARE, Holdout

# The residual's rise over its least value in the second half of the steps, from which on readings have noise that a
# decode follows. Most clips without noise decrease to the last step; water rose too, and loses 0.2 dB.
_LEAST_RISE: Final = 0.02
# Fewer views are not watched: much of what a pixel shows of one or two views is its own reading, so that a held-out
# pixel tells little of those that are seen. Nor are fewer steps: they end before noise is followed.
_LEAST_VIEWS: Final = 3
_LEAST_STEPS: Final = 24
# The last steps see all pixels: one step in so many, and at least these.
_STEPS_PER_SEEING: Final = 6
_LEAST_SEEING: Final = 4
# A decode goes down at most to this share of its last level. With 0.5, a clip of 55 dB gains 3 dB more, but clips of 37
# to 41 dB are 0.02 to 0.16 dB worse.
_LEAST_LEVEL: Final = 2 / 3
# A power beside which a reading counts for nothing, far below float32's largest number.
_UNREAD: Final = np.float32(1e12)


class HeldoutNoise:
    """Updates the power of the noise after each step of a decode.

    Args:
        shot: The measurement.
        settings: The schedule.
        seed: Seed of the draw of the pixels that all but the last steps do not see.

    Attributes:
        power: σ² of each reading, [H, W, C] as the measurement, changed in place; so large at pixels not to be seen
            that a step does not use their readings.
    """

    def __init__(self, shot: Shot, settings: PatchSettings, seed: int) -> None:
        watches = shot.views >= _LEAST_VIEWS and settings.iterations >= _LEAST_STEPS
        # After so many steps every position has been the reference of a group once.
        self._averaged = settings.lattice.phases
        self._holdout = Holdout.of(shot, HELDOUT_SHARE if watches else 0.0, seed)
        pixels = self._holdout.pixels
        self._blind = bool(pixels.any())
        self._energy = (
            float((self._holdout.weighted.astype(np.float64) ** 2).sum(axis=0).mean()) if self._blind else 0.0
        )
        self._residuals: list[float] = []
        self._now, self._least, self._shows, self._noise = float("inf"), float("inf"), False, 0.0
        self.power: F32 = np.zeros_like(shot.measurement)
        self.power[pixels] = _UNREAD

    def after(self, planes: F32, sigma: float, done: int, left: int) -> None:
        """Update the power.

        Args:
            planes: The views of a step, [N, C, H, W].
            sigma: Its noise level, full scale 1.
            done: How many steps were made.
            left: How many will follow.
        """
        if not self._blind:
            return
        self._residuals.append((self._holdout.residual_rms(interleaved(planes)) or 0.0) ** 2)
        # Denoised views err at most by about the squared level in clips that patches explain. With a quarter of it, two
        # clips gain 0.1 dB more in noise, but water without noise loses 0.6 dB instead of 0.2.
        error = self._energy * sigma**2
        self._now = now = float(np.mean(self._residuals[-self._averaged :]))
        if done > left:
            self._least = min(self._least, now)
            self._shows = self._shows or now > (1 + _LEAST_RISE) * self._least
        if self._shows:
            self._noise = max(0.0, now - error)
            self.power[:] = self._noise
        self._blind = left > max(_LEAST_SEEING, (done + left) // _STEPS_PER_SEEING)
        self.power[self._holdout.pixels] = _UNREAD if self._blind else self._noise

    def last_sigma(self, stated: float) -> float:
        """Return the noise level at which to end: the stated one, or that of the views' errors if these are smaller."""
        if np.isinf(self._now):
            return stated
        level = math.sqrt(self._now / (self._energy * error_power(1.0)))
        return min(stated, max(level, _LEAST_LEVEL * stated))


# Steps vary in duration; each further one is expected to take so many times the last of its kind.
_MARGIN: Final = 1.1


# So many steps with a sparse lattice reach the same result as the whole schedule with the dense one, in the same time.
_SPARSE: Final = PatchSettings(iterations=144, first_sigma=50 / 255, lattice=Lattice().side_by_side)


@dataclass(frozen=True)
class InTime:
    """The result of a decode within a time.

    Args:
        views: [N, H, W, C] float32 in [0, 1].
        steps: How many were made; 0 if there was only time for GAP-TV.
        settings: As used; `iterations` is the largest possible number.
    """

    views: F32
    steps: int
    settings: PatchSettings


def patch_decode(
    shot: Shot,
    settings: PatchSettings | None = None,
    progress: Progress | None = None,
    seed: int = 42,
    begins: GapTvSettings | None = None,
) -> F32:
    """Decode one coded measurement into approximate views, by groups of similar patches.

    Args:
        shot: A checked shot: RGB, mono or mosaic; binary or grey masks; saturated pixels are ignored.
        settings: How long, and which patches.
        progress: Receives each iteration and its relative residual.
        seed: Seed of the draw of the pixels that tell the noise of the readings; the last steps see them too.
        begins: Of the decode by GAP-TV with which it begins; None: the defaults.

    Returns:
        Views, [N, H, W, C] float32 in [0, 1]; C is 3 with a colour filter array.

    Raises:
        InputError: The settings make no sense.
    """
    return decode_until(shot, math.inf, settings or PatchSettings(), progress, seed=seed, begins=begins).views


def decode_until(
    shot: Shot,
    until_s: float,
    settings: PatchSettings | None = None,
    progress: Progress | None = None,
    clock: Callable[[], float] = time.monotonic,
    seed: int = 42,
    begins: GapTvSettings | None = None,
) -> InTime:
    """Decode one coded measurement by groups of similar patches, and end before a deadline.

    Args:
        shot: See `patch_decode`.
        until_s: The deadline, on `clock`. GAP-TV, with which a decode starts, does not heed it.
        settings: The first and the last noise level, the largest number of steps, and which patches.
        progress: Receives each step and its relative residual.
        clock: The time in seconds; never decreases.
        seed: Seed of the draw of the pixels that tell the noise of the readings; the last steps see them too.
        begins: As for `patch_decode`.

    Raises:
        InputError: The settings make no sense.
    """
    settings, progress = (settings or _SPARSE).check(), progress or Silent()
    start = decode_signed(shot, begins)
    patches = SimilarPatches(planar(start), settings.lattice, settings.refind_every)
    noise = HeldoutNoise(shot, settings, seed)
    steps = _Steps(patches, settings, until_s, progress, clock, noise)
    if clock() >= until_s:
        return InTime(np.clip(start, 0, 1), 0, settings)
    schedule = PlugAndPlaySettings(sigmas=(settings.first_sigma,), iterations=settings.iterations)
    weighed = ReadingNoise(noise.power, steps.error_power)
    views = plug_and_play(shot, clamped(steps.denoise), schedule, progress, start, steps.enough, weighed)
    return InTime(np.clip(views, 0, 1), len(steps.sigmas), settings)


@dataclass
class _Steps:
    """The steps of a decode, each at the level that the remaining time determines.

    Attributes:
        sigmas: Noise levels of the steps that were made.
    """

    patches: SimilarPatches
    settings: PatchSettings
    until_s: float
    progress: Progress
    clock: Callable[[], float]
    noise: HeldoutNoise
    sigmas: list[float] = field(default_factory=list)
    _began_s: float = 0.0
    # Durations of the latest step that searched for patches, and of the latest that did not.
    _searching_s: float = 0.0
    _plain_s: float | None = None

    def denoise(self, views: F32, sigma: float) -> F32:
        """Make a step; of the levels that the loop passes only the first is used."""
        if not self.sigmas:
            self._began_s = self.clock()
        else:
            left, last = max(self._affordable(), 1), self.noise.last_sigma(self.settings.last_sigma)
            sigma = self.sigmas[-1] * min(1.0, last / self.sigmas[-1]) ** (1 / left)
        self.sigmas.append(sigma)
        return self.patches(views, sigma)

    def error_power(self, sigma: float) -> float:
        """Return the squared error expected before a step; of the passed levels only the first is used."""
        return error_power(self.sigmas[-1] if self.sigmas else sigma)

    def enough(self, planes: F32) -> bool:
        """Time a step, including the loop around it, and tell whether it was the last."""
        now_s, done = self.clock(), len(self.sigmas)
        took_s, self._began_s = now_s - self._began_s, now_s
        if self.patches.seeks(done - 1):
            self._searching_s = took_s
        else:
            self._plain_s = took_s
        left = self._affordable()
        self.noise.after(planes, self.sigmas[-1], done, left)
        self.progress.expect(done + left)
        return left == 0

    def _affordable(self) -> int:
        """Return the number of steps for which there is still time."""
        done, left_s, more = len(self.sigmas), self.until_s - self.clock(), 0
        plain_s = self._searching_s if self._plain_s is None else self._plain_s
        while done + more < self.settings.iterations:
            left_s -= _MARGIN * (self._searching_s if self.patches.seeks(done + more) else plain_s)
            if left_s < 0:
                break
            more += 1
        return more
